//! An arm of two links in a vertical plane, a motor at each joint.

use std::f64::consts::FRAC_PI_2;

use myactuator_host_std::sim::mechanics::{Failure, Mechanics, Shaft};
use myactuator_protocol_core::time::Duration;

/// Standard gravity.
const GRAVITY_M_S2: f64 = 9.806_65;
/// How many iterations balance the friction of the two joints in a step: enough for links of which one is a
/// hundred times the other.
const ROUNDS: usize = 64;

/// A rigid link; lengths count from its joint.
#[derive(Clone, Copy)]
pub(super) struct Link {
    pub(super) mass_kg: f64,
    /// To the next joint. It does not matter for the last link.
    pub(super) length_m: f64,
    /// To its centre of mass.
    pub(super) centre_m: f64,
    /// About its centre of mass.
    pub(super) inertia_kg_m2: f64,
}

/// An arm of two links in a vertical plane. At 0° and 0° it hangs straight down. The angle of the second joint is the
/// angle between the links.
///
/// One step is a leapfrog, like that of the motors. Friction, which the arm couples, too, takes from both joints as
/// much as it can, and reverses none.
#[derive(Clone, Copy)]
pub(super) struct TwoLinks {
    links: [Link; 2],
    motors_kg_m2: [f64; 2],
}

impl TwoLinks {
    /// An arm of these links, from the shoulder on. Each motor has this inertia at its output shaft.
    pub(super) fn new(links: [Link; 2], motors_kg_m2: [f64; 2]) -> Self {
        Self { links, motors_kg_m2 }
    }

    /// Inertia between the joints at these angles, kg·m²: torques are this times accelerations.
    fn inertia(&self, angle_rad: [f64; 2]) -> [[f64; 2]; 2] {
        let [upper, fore] = self.links;
        let coupling = fore.mass_kg * upper.length_m * fore.centre_m * angle_rad[1].cos();
        let of_fore = fore.inertia_kg_m2 + fore.mass_kg * fore.centre_m * fore.centre_m;
        let of_upper = upper.inertia_kg_m2
            + upper.mass_kg * upper.centre_m * upper.centre_m
            + fore.mass_kg * upper.length_m * upper.length_m;
        let off = of_fore + coupling;
        [
            [of_upper + of_fore + 2.0 * coupling + self.motors_kg_m2[0], off],
            [off, of_fore + self.motors_kg_m2[1]],
        ]
    }

    /// The torques of gravity and of the movement itself on the joints, N·m.
    fn own_torque_nm(&self, angle_rad: [f64; 2], speed: [f64; 2]) -> [f64; 2] {
        let [upper, fore] = self.links;
        let whirl = fore.mass_kg * upper.length_m * fore.centre_m * angle_rad[1].sin();
        let shoulder_kg_m = upper.mass_kg * upper.centre_m + fore.mass_kg * upper.length_m;
        let fore_nm =
            GRAVITY_M_S2 * fore.mass_kg * fore.centre_m * (angle_rad[0] + angle_rad[1]).sin();
        let upper_nm = GRAVITY_M_S2 * shoulder_kg_m * angle_rad[0].sin() + fore_nm;
        let turning = speed[1] * (2.0 * speed[0] + speed[1]);
        [whirl * turning - upper_nm, -whirl * speed[0] * speed[0] - fore_nm]
    }

    /// Angles and speeds a step later, rad and rad/s.
    fn moved(
        &self,
        angle: [f64; 2],
        speed: [f64; 2],
        torque_nm: [f64; 2],
        friction_nm: [f64; 2],
        seconds: f64,
    ) -> ([f64; 2], [f64; 2]) {
        let add =
            |to: [f64; 2], what: [f64; 2], by: f64| [to[0] + what[0] * by, to[1] + what[1] * by];
        let middle = add(angle, speed, seconds / 2.0);
        let yielding = inverse(self.inertia(middle));
        // The speed after so long, as if it were `speed_there` on the way.
        let speed_after = |seconds: f64, speed_there| {
            let torque = add(torque_nm, self.own_torque_nm(middle, speed_there), 1.0);
            let freely = add(speed, times(yielding, torque), seconds);
            rubbed(yielding, freely, friction_nm.map(|it| it * seconds))
        };
        let halfway = speed_after(seconds / 2.0, speed);
        let after = speed_after(seconds, halfway);
        (add(middle, after, seconds / 2.0), after)
    }
}

fn inverse([[a, b], [c, d]]: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let determinant = a * d - b * c;
    [[d / determinant, -b / determinant], [-c / determinant, a / determinant]]
}

fn times(matrix: [[f64; 2]; 2], vector: [f64; 2]) -> [f64; 2] {
    matrix.map(|[first, second]| first * vector[0] + second * vector[1])
}

/// The speeds that dry friction leaves. It takes at most `most` of each joint's momentum; a joint that it
/// holds with less than that stands.
fn rubbed(yielding: [[f64; 2]; 2], freely: [f64; 2], most: [f64; 2]) -> [f64; 2] {
    let mut taken = [0.0_f64; 2];
    let speed = |taken: [f64; 2]| {
        let back = times(yielding, taken);
        [freely[0] - back[0], freely[1] - back[1]]
    };
    for _ in 0..ROUNDS {
        for joint in 0..2 {
            let wanted = taken[joint] + speed(taken)[joint] / yielding[joint][joint];
            taken[joint] = wanted.clamp(-most[joint], most[joint]);
        }
    }
    let mut left = speed(taken);
    for joint in 0..2 {
        if taken[joint].abs() < most[joint] {
            left[joint] = 0.0;
        }
    }
    left
}

impl Mechanics for TwoLinks {
    fn step(&mut self, period: Duration, shafts: &mut [Shaft]) -> Result<(), Failure> {
        let count = shafts.len();
        let [shoulder, elbow] = shafts else {
            return Err(format!("two links have 2 shafts, found {count}: lead two drives").into());
        };
        let (angle, speed) = self.moved(
            [shoulder.angle_deg, elbow.angle_deg].map(f64::to_radians),
            [shoulder.speed_dps, elbow.speed_dps].map(f64::to_radians),
            [shoulder.acting.torque_nm, elbow.acting.torque_nm],
            [shoulder.acting.friction_nm, elbow.acting.friction_nm],
            period.as_micros() as f64 * 1e-6,
        );
        for (shaft, (angle, speed)) in
            [shoulder, elbow].into_iter().zip(angle.into_iter().zip(speed))
        {
            (shaft.angle_deg, shaft.speed_dps) = (angle.to_degrees(), speed.to_degrees());
        }
        Ok(())
    }
}

const NONE: [f64; 2] = [0.0; 2];

/// Two rods of 1 kg and 1 m.
fn arm() -> TwoLinks {
    let rod = Link { mass_kg: 1.0, length_m: 1.0, centre_m: 0.5, inertia_kg_m2: 1.0 / 12.0 };
    TwoLinks::new([rod, rod], [1e-9; 2])
}

#[test]
fn the_inertia_of_two_rods_is_the_textbooks() {
    // Stretched: 1/3 * 2 kg * (2 m)² about the shoulder, 1/3 about the elbow, 1/3 + 1/2 between.
    let [[shoulder, between], [_, elbow]] = arm().inertia([0.3, 0.0]);
    assert!((shoulder - 8.0 / 3.0).abs() < 1e-6 && (elbow - 1.0 / 3.0).abs() < 1e-6);
    assert!((between - 5.0 / 6.0).abs() < 1e-6);
    // Folded at a right angle: 1/3 + 1 + 1/3.
    let [[shoulder, between], _] = arm().inertia([0.3, FRAC_PI_2]);
    assert!((shoulder - 5.0 / 3.0).abs() < 1e-6 && (between - 1.0 / 3.0).abs() < 1e-6);
}

#[test]
fn own_torque_is_that_of_two_rods_held_level() {
    // Held out level: 1 kg at 0.5 m and 1 kg at 1.5 m; 1 kg at 0.5 m.
    let torque = arm().own_torque_nm([FRAC_PI_2, 0.0], NONE);
    assert!((torque[0] + 2.0 * 9.806_65).abs() < 1e-9 && (torque[1] + 4.903_325).abs() < 1e-9);
}

#[test]
fn free_swings_keep_their_energy() {
    let arm = arm();
    let energy = |angle: [f64; 2], speed: [f64; 2]| {
        let momentum = times(arm.inertia(angle), speed);
        let height = -1.5 * angle[0].cos() - 0.5 * (angle[0] + angle[1]).cos();
        0.5 * (speed[0] * momentum[0] + speed[1] * momentum[1]) + GRAVITY_M_S2 * height
    };
    let (mut angle, mut speed) = ([2.0, 1.0], NONE);
    let before = energy(angle, speed);
    let mut widest: f64 = 0.0;
    for _ in 0..50_000 {
        (angle, speed) = arm.moved(angle, speed, NONE, NONE, 2e-4);
        widest = widest.max((energy(angle, speed) - before).abs());
    }
    // Of the 39.2 J between hanging and standing.
    assert!(widest < 0.004, "{widest} J");
}

#[test]
fn a_held_joint_stands_and_is_a_part_of_the_other_link() {
    let arm = arm();
    // The elbow is held at a right angle; the shoulder is pushed with 5/3 N·m more than the weight:
    // 1 rad/s² for 5/3 kg·m².
    let angle = [0.0, FRAC_PI_2];
    let weight = arm.own_torque_nm(angle, NONE);
    let push = [5.0 / 3.0 - weight[0], 0.0];
    let (_, speed) = arm.moved(angle, NONE, push, [0.0, 100.0], 1e-3);
    assert_eq!(speed[1], 0.0);
    assert!((speed[0] - 1e-3).abs() < 1e-8, "{}", speed[0]);
    // Let go, the elbow stays behind.
    let (_, speed) = arm.moved(angle, NONE, push, NONE, 1e-3);
    assert!(speed[1] < 0.0, "{}", speed[1]);
    // What friction holds does not creep.
    let held = (angle, NONE);
    let still = (0..1_000).fold(held, |(a, v), _| arm.moved(a, v, NONE, [20.0; 2], 1e-3));
    assert_eq!(still, held);
}

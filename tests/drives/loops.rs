//! The drive's loops on every model of the library, with loads from none to the heaviest that its torque can sensibly
//! move: they follow, stop and stand still.

use std::fmt::Debug;

use myactuator_host_std::sim::plant::{EndStop, Load, MODELS, MotorParameters};
use myactuator_host_std::sim::{CanFleet, Fleet, SimulatedDrive};
use myactuator_protocol_core::command::{
    AccelerationIndex, Command, ForcePosition, MotionSetPoint, PidIndex, Stop, WriteAcceleration,
    WritePidRam,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::Acceleration;
use myactuator_protocol_core::{AnyCommand, MotorId};
use myactuator_tests::values::{degrees, gain, go_to, millis, percent, turn, up_to};

/// The largest swing of a shaft that stands still, degrees. A hundredth is the unit of the bus.
const STILL_DEG: f64 = 0.01;

/// A load's share of the heaviest, for the default model of a fleet.
const SHARES: [f64; 6] = [0.0, 0.01, 0.05, 0.2, 0.5, 1.0];

/// For the others, whose loops are tuned by the same rule.
const ENDS: [f64; 2] = [0.0, 1.0];

/// The heaviest load that a motor can sensibly move, kg·m². Its rated torque, which it has for hours, brings this load
/// to its rated speed in a second. For an X8-120 that is 3.2 kg·m², 55 times the inertia of its rotor. It is about the
/// arm of half a metre whose weight the same torque just holds (m g l = 43 N·m, m l² = 2.2 kg·m²). For a slow motor it
/// is less: what its peak torque brings to 1375 dps in a second.
fn heaviest_kg_m2(model: &MotorParameters) -> f64 {
    let rated_rad_s = model.rating.speed_rpm * std::f64::consts::TAU / 60.0;
    let in_a_second = model.rating.torque_nm / rated_rad_s;
    in_a_second.min(model.rating.peak_torque_nm / 24.0) - model.inertia_kg_m2()
}

/// A drive with its motor and no bus. The test sets the time.
pub(super) struct Alone {
    fleet: CanFleet,
    now: Instant,
}

impl Alone {
    pub(super) fn new(model: &MotorParameters, load_kg_m2: f64) -> Self {
        let fleet = Fleet::new(1).model(model.clone()).on_can(1_000_000).unwrap();
        let mut alone = Self { fleet, now: Instant::ZERO };
        let load = Load { inertia_kg_m2: load_kg_m2, ..Load::NONE };
        alone.with(|drive| drive.plant_mut().set_load(load).unwrap());
        alone.run(millis(5));
        alone
    }

    fn with<T>(&mut self, work: impl FnOnce(&mut SimulatedDrive) -> T) -> T {
        self.fleet.drives[0].with(work)
    }

    /// Sends a command and ignores the answer.
    pub(super) fn command<C: Command + Into<AnyCommand>>(&mut self, command: C) {
        let packet = command.into().packet(MotorId::MIN.into()).unwrap();
        let now = self.now;
        self.with(|drive| drive.handle_packet(&packet, now));
    }

    pub(super) fn run(&mut self, span: Duration) {
        self.now += span;
        let now = self.now;
        self.with(|drive| {
            while drive.clock() + drive.parameters().control_period <= now {
                drive.advance(now);
            }
        });
    }

    /// On the motor's side of the gear's play, because the loops see that side.
    pub(super) fn angle_deg(&mut self) -> f64 {
        self.with(|drive| drive.plant().motor_side_angle_deg())
    }

    pub(super) fn speed_dps(&mut self) -> f64 {
        self.with(|drive| drive.plant().motor_side_speed_dps())
    }

    /// The smallest and the largest angle, read every millisecond.
    fn range(&mut self, span: Duration) -> (f64, f64) {
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for _ in 0..span.as_millis() {
            self.run(millis(1));
            let angle = self.angle_deg();
            (least, most) = (least.min(angle), most.max(angle));
        }
        (least, most)
    }

    /// Asserts that it stands still.
    #[track_caller]
    fn is_still(&mut self, case: &dyn Debug) {
        self.swings_by(STILL_DEG, case);
    }

    /// Asserts that it swings by no more than this and has no errors.
    #[track_caller]
    fn swings_by(&mut self, limit_deg: f64, case: &dyn Debug) {
        let (least, most) = self.range(millis(1_000));
        assert!(most - least <= limit_deg, "{case:?}: swings between {least} and {most}");
        let errors = self.with(|drive| drive.state().errors);
        assert!(errors.is_empty(), "{case:?}: {errors}");
    }
}

/// Each model with its loads.
fn each_load(mut test: impl FnMut(&MotorParameters, f64, &dyn Debug)) {
    for model in MODELS {
        let parameters = MotorParameters::named(model.name).unwrap();
        let is_default = model.name == "RMD-X6-P20-60";
        for &share in if is_default { &SHARES[..] } else { &ENDS } {
            let load = share * heaviest_kg_m2(&parameters);
            test(&parameters, load, &format!("{} with {load:.3} kg m2", model.name));
        }
    }
}

pub(super) fn plan_all(alone: &mut Alone, dps2: u32) {
    let acceleration = Acceleration::try_from_raw(dps2).unwrap();
    for &index in AccelerationIndex::ALL {
        alone.command(WriteAcceleration { index, acceleration });
    }
}

/// 2.21.1: a motion that is planned within the motor's torque is followed to the target, and hardly beyond it. 1000
/// dps/s is two thirds of what the X8-PRO's peak torque gives its heaviest load.
#[test]
fn a_planned_step_is_followed_with_every_load() {
    each_load(|model, load, case| {
        let mut alone = Alone::new(model, load);
        plan_all(&mut alone, 1_000);
        alone.command(go_to(90.0, 180));
        // 180 ms up and down, and 57.6 degrees at 180 dps between: 680 ms.
        let (_, most) = alone.range(millis(680));
        let (least, later) = alone.range(millis(500));
        let most = most.max(later);
        assert!(most < 92.0, "{case:?}: overshoots to {most}");
        assert!(least > 88.0, "{case:?}: lags at {least}");
        // For the last hundredths, where friction holds the shaft, the speed loop's integral takes time.
        alone.run(millis(2_000));
        let end = alone.angle_deg();
        assert!((end - 90.0).abs() < 0.05, "{case:?}: ends at {end}");
        alone.is_still(case);
    });
}

/// A plan beyond the torque, such as the factory's 10000 dps/s with a heavy load. The shaft is late and overshoots, but
/// ends at its target, from every speed.
#[test]
fn a_step_beyond_the_torque_still_ends_at_its_target() {
    each_load(|model, load, case| {
        for max_dps in [90, 0] {
            let mut alone = Alone::new(model, load);
            alone.command(go_to(90.0, max_dps));
            let (_, most) = alone.range(millis(4_000));
            assert!(max_dps == 0 || most < 93.0, "{case:?}: overshoots to {most}");
            let end = alone.angle_deg();
            assert!((end - 90.0).abs() < 0.05, "{case:?}, {max_dps} dps: ends at {end}");
            alone.is_still(case);
        }
    });
}

/// 2.21.1: direct tracking, without a planned motion.
#[test]
fn direct_tracking_ends_at_its_target() {
    each_load(|model, load, case| {
        let mut alone = Alone::new(model, load);
        let none = Acceleration::NONE;
        alone.command(WriteAcceleration {
            index: AccelerationIndex::POSITION_ACCELERATION,
            acceleration: none,
        });
        alone.command(go_to(90.0, 90));
        let (_, most) = alone.range(millis(4_000));
        assert!(most < 92.0, "{case:?}: overshoots to {most}");
        let end = alone.angle_deg();
        assert!((end - 90.0).abs() < 0.05, "{case:?}: ends at {end}");
        alone.is_still(case);
    });
}

/// 2.18.1: 0x81 brings the shaft to rest within the distance that its torque, or the deceleration setting, needs. It
/// holds the shaft there.
#[test]
fn a_stop_runs_on_no_farther_than_it_must() {
    each_load(|model, load, case| {
        for fast in [false, true] {
            let dps = if fast { model.rating.speed_rpm * 6.0 } else { 90.0 };
            let mut alone = Alone::new(model, load);
            alone.command(turn(dps as f32));
            alone.run(millis(3_000));
            let (before, speed) = (alone.angle_deg(), alone.speed_dps());
            assert!((speed - dps).abs() < 0.01 * dps, "{case:?}: {speed}");
            alone.command(Stop);
            let (_, most) = alone.range(millis(2_000));
            let inertia = model.inertia_kg_m2() + load;
            let torque_dps2 = (model.rating.peak_torque_nm / inertia).to_degrees();
            let way = speed * speed / (2.0 * torque_dps2.min(10_000.0));
            let runs_on = most - before;
            // The loop takes time to reach the full torque, and to lose the last of the speed.
            assert!(runs_on < way * 1.25 + 2.0, "{case:?}: from {speed} dps runs on by {runs_on}");
            let end = alone.angle_deg();
            assert!(most - end < 0.2, "{case:?}: comes back by {}", most - end);
            alone.is_still(case);
        }
    });
}

/// 2.20.1: a speed is reached with every load, hardly exceeded, and kept to a hundredth of it.
#[test]
fn a_speed_is_reached_with_every_load() {
    each_load(|model, load, case| {
        let dps = model.rating.speed_rpm * 6.0;
        let mut alone = Alone::new(model, load);
        alone.command(turn(dps as f32));
        let mut fastest = 0.0_f64;
        for _ in 0..3_000 {
            alone.run(millis(1));
            fastest = fastest.max(alone.speed_dps());
        }
        assert!(fastest < 1.05 * dps, "{case:?}: {fastest} for {dps}");
        let end = alone.speed_dps();
        assert!((end - dps).abs() < 0.01 * dps, "{case:?}: {end} for {dps}");
    });
}

/// Half of the rated torque always pulls at the shaft, as an arm does. The drive holds and moves it nevertheless, in
/// both directions.
#[test]
fn a_weight_is_held_and_moved_with_every_load() {
    each_load(|model, load, case| {
        let mut alone = Alone::new(model, load);
        alone.command(go_to(0.0, 90));
        let pull =
            Load { inertia_kg_m2: load, torque_nm: -0.5 * model.rating.torque_nm, ..Load::NONE };
        alone.with(|drive| drive.plant_mut().set_load(pull).unwrap());
        let (least, _) = alone.range(millis(2_000));
        assert!(least > -5.0, "{case:?}: gives way by {least}");
        for target in [90.0, 0.0] {
            alone.command(go_to(target, 90));
            let (least, most) = alone.range(millis(4_000));
            assert!(least > -3.0 && most < 93.0, "{case:?}: from {least} to {most}");
            let end = alone.angle_deg();
            assert!((end - f64::from(target)).abs() < 0.05, "{case:?}: ends at {end}");
            // For the last hundredths the speed loop's integral takes time to overcome friction.
            alone.run(millis(6_000));
            alone.is_still(case);
        }
    });
}

/// 5.1: the stiffest spring of motion mode does not swing up, even if the master asks for no damping. Sampling takes
/// away damping, half a period times kp. The motor's own friction gives more than that.
#[test]
fn the_stiffest_motion_mode_does_not_swing_up() {
    each_load(|model, load, case| {
        for kd in [0.0, 0.1, 1.0] {
            let mut alone = Alone::new(model, load);
            let ranges = model.motion_ranges().unwrap();
            let hold =
                MotionSetPoint { position_rad: 0.05, kp: 500.0, kd, ..MotionSetPoint::default() };
            alone.command(ranges.quantise(&hold).unwrap());
            // The first swing begins with the step itself.
            let [first, second, third] = [50, 1_000, 1_000].map(|span| {
                let (least, most) = alone.range(millis(span));
                most - least
            });
            let dies_away = third < 0.9 * second || third <= STILL_DEG;
            assert!(dies_away, "{case:?}, kd {kd}: {first}, {second}, {third}");
        }
    });
}

/// The margin of the factory gains: each gain alone may be doubled or halved, and the shaft stands still with every
/// load as before.
#[test]
fn every_loop_has_a_margin_of_two() {
    each_load(|model, load, case| {
        for index in [PidIndex::SPEED_KP, PidIndex::SPEED_KI, PidIndex::POSITION_KP] {
            for factor in [0.5, 2.0] {
                let mut alone = Alone::new(model, load);
                let factory = alone.with(|drive| drive.settings().gains.get(index).unwrap());
                alone.command(WritePidRam { index, value: gain(factory.value() * factor) });
                alone.command(go_to(90.0, 90));
                let (_, most) = alone.range(millis(4_000));
                let case = format!("{case:?}, gain {index:?} times {factor}");
                assert!(most < 94.0, "{case:?}: overshoots to {most}");
                // With half of the stiffness friction may let it stick and slip.
                alone.swings_by(0.1, &case);
            }
        }
    });
}

/// A shaft that was pushed against an end stop is let go without a kick.
#[test]
fn nothing_winds_up_against_a_stop() {
    each_load(|model, load, case| {
        let mut alone = Alone::new(model, load);
        let stop = EndStop { at_deg: 30.0, stiffness_nm_per_rad: 2_000.0, restitution: 1.0 };
        let walled = Load { inertia_kg_m2: load, upper_stop: Some(stop), ..Load::NONE };
        alone.with(|drive| drive.plant_mut().set_load(walled).unwrap());
        let gently =
            ForcePosition { max_torque: percent(100), max_speed: up_to(90), angle: degrees(90.0) };
        alone.command(gently);
        alone.run(millis(3_000));
        let leaning = alone.speed_dps();
        // The stop itself takes no energy away.
        assert!(leaning.abs() < 10.0, "{case:?}: bounces at {leaning}");
        alone.command(go_to(0.0, 90));
        let (least, _) = alone.range(millis(3_000));
        assert!(least > -3.0, "{case:?}: overshoots to {least}");
        alone.is_still(case);
    });
}

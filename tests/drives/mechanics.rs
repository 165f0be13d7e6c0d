//! Drives whose shafts are moved by a program's own mechanics.

use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::Arc;

use myactuator_host_std::sim::mechanics::{AlreadyLed, Failure, Mechanics, Remote, Shaft};
use myactuator_host_std::sim::plant::{MODELS, MotorParameters, SimulatedMotor};
use myactuator_host_std::sim::{CanFleet, Fleet, Robot};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ReadMultiTurnAngle, ReadStatus2, ReleaseBrake};
use myactuator_protocol_core::drive::{Actuation, Plant as _};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::time::Duration;
use myactuator_tests::values::{go_to, id, millis};

use super::two_links::{Link, TwoLinks};

const PERIOD: Duration = Duration::from_micros(500);

fn model() -> MotorParameters {
    MotorParameters::named("RMD-X8-P20-120").unwrap()
}

/// Rods of 4 kg and 2 kg, half a metre long each.
fn arm() -> TwoLinks {
    let rod = |mass_kg: f64| Link {
        mass_kg,
        length_m: 0.5,
        centre_m: 0.25,
        inertia_kg_m2: mass_kg * 0.25 / 12.0,
    };
    TwoLinks::new([rod(4.0), rod(2.0)], [model().inertia_kg_m2(); 2])
}

fn fleet() -> CanFleet {
    Fleet::new(2).model(model()).on_can(1_000_000).unwrap()
}

fn angles_deg(fleet: &CanFleet) -> [f64; 2] {
    [0, 1].map(|place| fleet.drives[place].with(|it| it.plant().output_angle_deg()))
}

/// Both joints go to 90° and 0°: the arm is held out level.
fn hold_level(fleet: &CanFleet) {
    let mut master = fleet.master::<2>();
    master.ask(id(1), go_to(90.0, 90)).unwrap();
    master.ask(id(2), go_to(0.0, 90)).unwrap();
    fleet.world.run_for(Duration::from_secs(4));
}

#[test]
fn an_arm_of_two_links_is_held_level_with_the_torque_of_its_weight() {
    let fleet = fleet();
    fleet.lead(&fleet.drives, PERIOD, arm()).unwrap();
    hold_level(&fleet);
    let [shoulder, elbow] = angles_deg(&fleet);
    assert!((shoulder - 90.0).abs() < 0.1 && elbow.abs() < 0.1, "{shoulder} {elbow}");
    // Shoulder: 9.81 * (4 kg * 0.25 m + 2 kg * 0.75 m) = 24.5 N·m, elbow: 9.81 * 2 kg * 0.25 m = 4.9 N·m. At rest,
    // static friction may hold 1.5 N·m of that, and the gear's loss 1.4 % of the torque.
    let mut master = fleet.master::<2>();
    for (motor, weight_nm) in [(1, 24.517), (2, 4.903)] {
        let current = master.ask(id(motor), ReadStatus2).unwrap().current.amperes();
        let torque_nm = f64::from(current) * 2.656 / 0.986;
        assert!((torque_nm - weight_nm).abs() < 1.5 + 0.02 * weight_nm, "{motor}: {torque_nm}");
    }
    assert_eq!(fleet.mechanics_failure(), None);
}

#[test]
fn a_shoulder_that_starts_pushes_the_elbow() {
    let pushed = |links| {
        let fleet = fleet();
        if links {
            fleet.lead(&fleet.drives, PERIOD, arm()).unwrap();
        }
        let mut master = fleet.master::<2>();
        master.ask(id(1), go_to(90.0, 180)).unwrap();
        master.ask(id(2), go_to(0.0, 90)).unwrap();
        let mut widest: f64 = 0.0;
        for _ in 0..300 {
            fleet.world.run_for(millis(1));
            widest = widest.max(angles_deg(&fleet)[1].abs());
        }
        widest
    };
    assert!(pushed(true) > 0.02 && pushed(false) == 0.0, "{}", pushed(true));
}

#[test]
fn a_closed_brake_holds_what_the_mechanics_move() {
    let fleet = Fleet::new(2).model(model()).brakes(true).start_angle_deg(45.0);
    let fleet = fleet.on_can(1_000_000).unwrap();
    fleet.lead(&fleet.drives, PERIOD, arm()).unwrap();
    fleet.world.run_for(Duration::from_secs(1));
    assert!(angles_deg(&fleet).iter().all(|angle| (angle - 45.0).abs() < 1e-9));
    fleet.master::<2>().ask(id(1), ReleaseBrake).unwrap();
    fleet.world.run_for(Duration::from_secs(1));
    let [shoulder, elbow] = angles_deg(&fleet);
    assert!(shoulder < 40.0 && (elbow - 45.0).abs() < 1e-9, "{shoulder} {elbow}");
}

/// The motor and a hand act on a led shaft, less viscous friction. Dry friction is reported separately.
#[test]
fn the_torques_on_a_led_shaft_are_reported() {
    let friction = model().friction;
    let mut motor = SimulatedMotor::new(model()).unwrap();
    motor.set_external_torque_nm(2.0).unwrap();
    let off = Actuation { current_a: 0.0, output_on: false, brake_released: true };
    for (speed_dps, dry_nm) in [(0.0, friction.static_nm), (90.0, friction.coulomb_nm)] {
        motor.lead(0.0, speed_dps).unwrap();
        motor.advance(&off, millis(10));
        let acting = motor.acting();
        let expected_nm = 2.0 - friction.viscous_nm_s_per_rad * speed_dps.to_radians();
        assert!((acting.torque_nm - expected_nm).abs() < 1e-9, "{acting:?}");
        assert!((acting.friction_nm - dry_nm).abs() < 1e-9, "{acting:?}");
    }
    assert!(friction.viscous_nm_s_per_rad > 0.0);
}

/// Fails once, after this many periods.
struct Failing(u32);

impl Mechanics for Failing {
    fn step(&mut self, _: Duration, shafts: &mut [Shaft]) -> Result<(), Failure> {
        if self.0 == 0 {
            self.0 = u32::MAX;
            return Err("the engine has crashed".into());
        }
        self.0 -= 1;
        for shaft in shafts {
            shaft.angle_deg += 0.5;
            shaft.speed_dps = 1_000.0;
        }
        Ok(())
    }
}

#[test]
fn shafts_stand_where_mechanics_fail() {
    let fleet = fleet();
    fleet.lead(&fleet.drives[1..], PERIOD, Failing(100)).unwrap();
    fleet.world.run_for(millis(51));
    let failed = angles_deg(&fleet);
    fleet.world.run_for(millis(100));
    assert_eq!(fleet.mechanics_failure().as_deref(), Some("the engine has crashed"));
    assert_eq!(angles_deg(&fleet), failed);
    assert!(failed[0] == 0.0 && (failed[1] - 50.0).abs() < 1.0, "{failed:?}");

    let fleet = self::fleet();
    let nowhere = |_: Duration, shafts: &mut [Shaft]| shafts[0].angle_deg = f64::NAN;
    fleet.lead(&fleet.drives[..1], PERIOD, Moving(nowhere)).unwrap();
    fleet.world.run_for(millis(2));
    let failure = fleet.mechanics_failure().unwrap();
    assert!(failure.starts_with("the shaft of motor 1: output angle must be"), "{failure}");
}

#[test]
fn a_drive_is_led_by_one_until_that_has_failed() {
    let fleet = fleet();
    let put = |angle_deg: f64| {
        Moving(move |_: Duration, shafts: &mut [Shaft]| {
            shafts.iter_mut().for_each(|shaft| shaft.angle_deg = angle_deg);
        })
    };
    let twice = [0, 1, 0].map(|place| fleet.drives[place].clone());
    let refused = fleet.lead(&twice, PERIOD, put(70.0)).unwrap_err();
    assert_eq!(refused, AlreadyLed { motor: id(1) });
    fleet.lead(&fleet.drives[1..], PERIOD, Failing(10)).unwrap();
    let second = fleet.lead(&fleet.drives, PERIOD, put(60.0)).unwrap_err();
    assert_eq!(second, AlreadyLed { motor: id(2) });
    fleet.world.run_for(millis(4));
    let [free, led] = angles_deg(&fleet);
    assert!(free == 0.0 && led < 10.0, "{free} {led}");
    fleet.world.run_for(millis(4));
    assert_eq!(fleet.mechanics_failure().as_deref(), Some("the engine has crashed"));
    fleet.lead(&fleet.drives, PERIOD, put(50.0)).unwrap();
    fleet.world.run_for(millis(2));
    assert!(angles_deg(&fleet).iter().all(|angle| (angle - 50.0).abs() < 1e-9));
}

/// The world keeps nothing of them.
#[test]
fn mechanics_that_are_over_are_gone() {
    let fleet = fleet();
    let alive = Arc::new(());
    for _ in 0..3 {
        let held = Arc::clone(&alive);
        let nowhere = move |_: Duration, shafts: &mut [Shaft]| {
            drop(Arc::clone(&held));
            shafts[0].angle_deg = f64::NAN;
        };
        fleet.lead(&fleet.drives, PERIOD, Moving(nowhere)).unwrap();
        fleet.world.run_for(millis(1));
    }
    assert_eq!((fleet.world.planned(), Arc::strong_count(&alive)), (0, 1));
}

/// Mechanics move a shaft whatever its drive does.
#[test]
fn a_led_shaft_turns_on_while_its_drive_has_no_power() {
    let fleet = fleet();
    let turning = |period: Duration, shafts: &mut [Shaft]| {
        shafts[0].speed_dps = 100.0;
        shafts[0].angle_deg += 100.0 * period.as_micros() as f64 * 1e-6;
    };
    fleet.lead(&fleet.drives[..1], PERIOD, Moving(turning)).unwrap();
    fleet.world.run_for(millis(100));
    fleet.world.reset(fleet.drives[0].station());
    fleet.world.run_for(millis(900));
    let [angle, _] = angles_deg(&fleet);
    assert!((angle - 100.0).abs() < 0.2, "{angle}");
    let message = fleet.master::<1>().ask(id(1), ReadMultiTurnAngle).unwrap().angle.degrees();
    assert!((message - 100.0).abs() < 0.5, "{message}");
    assert_eq!(fleet.mechanics_failure(), None);
}

struct Moving<F>(F);

impl<F: FnMut(Duration, &mut [Shaft]) + Send> Mechanics for Moving<F> {
    fn step(&mut self, period: Duration, shafts: &mut [Shaft]) -> Result<(), Failure> {
        (self.0)(period, shafts);
        Ok(())
    }
}

/// A process that moves the shafts as [`TwoLinks`] does, over a socket.
fn process(stream: UnixStream) {
    use std::io::{BufRead, BufReader, Write};
    let mut arm = arm();
    let mut answers = stream.try_clone().unwrap();
    for line in BufReader::new(stream).lines().map_while(Result::ok) {
        let asked: serde_json::Value = serde_json::from_str(&line).unwrap();
        let number = |shaft: &serde_json::Value, name: &str| shaft[name].as_f64().unwrap();
        let shafts = asked["shafts"].as_array().unwrap().iter().map(|it| Shaft {
            motor: MotorId::new(it["motor"].as_u64().unwrap() as u8).unwrap(),
            acting: myactuator_host_std::sim::plant::ShaftTorque {
                torque_nm: number(it, "torque_nm"),
                friction_nm: number(it, "friction_nm"),
            },
            angle_deg: number(it, "angle_deg"),
            speed_dps: number(it, "speed_dps"),
        });
        let mut shafts: Vec<_> = shafts.collect();
        let period = Duration::from_micros(asked["period_us"].as_u64().unwrap());
        arm.step(period, &mut shafts).unwrap();
        let moved = shafts
            .iter()
            .map(|it| serde_json::json!({ "angle_deg": it.angle_deg, "speed_dps": it.speed_dps }));
        let answer = serde_json::json!({ "shafts": moved.collect::<Vec<_>>() });
        writeln!(answers, "{answer}").unwrap();
    }
}

#[test]
fn a_process_that_a_robots_file_names_moves_the_shafts_of_its_bus() {
    let folder = tempfile::tempdir().unwrap();
    let file = r#"
        [[bus]]
        name = "arm"
        kind = "can"
        bit_rate = 1_000_000
        mechanics = { socket = "arm.sock", period_us = 500 }

        [[bus.motor]]
        ids = "1-2"
        model = "RMD-X8-P20-120"
        start_angle_deg = 90
    "#;
    let robot = Robot::from_toml(file, folder.path()).unwrap();
    let nobody = robot.can("arm").unwrap_err().to_string();
    assert!(nobody.contains("arm.sock\": start the process that listens there first"), "{nobody}");

    let listener = UnixListener::bind(folder.path().join("arm.sock")).unwrap();
    let other = std::thread::spawn(move || process(listener.accept().unwrap().0));
    let fleet = robot.can("arm").unwrap();
    // Level and folded back, and not held: it falls.
    fleet.world.run_for(millis(500));
    let [shoulder, _] = angles_deg(&fleet);
    assert!(shoulder < 80.0, "{shoulder}");
    assert_eq!(fleet.mechanics_failure(), None);
    drop(fleet);
    other.join().unwrap();

    let slow = file.replace("period_us = 500", "period_us = 99");
    let error = Robot::from_toml(&slow, folder.path()).unwrap_err().to_string();
    assert_eq!(error, "line 6: expected a period of 100 to 100000 us, found 99");
}

#[test]
fn another_process_moves_the_shafts_as_exactly_as_this_one() {
    let run = |mechanics: Option<UnixStream>| {
        let fleet = fleet();
        match mechanics {
            Some(stream) => fleet.lead(&fleet.drives, PERIOD, Remote::new(stream)),
            None => fleet.lead(&fleet.drives, PERIOD, arm()),
        }
        .unwrap();
        let log = fleet.world.log();
        let mut master = fleet.master::<2>();
        master.ask(id(1), go_to(30.0, 90)).unwrap();
        fleet.world.run_for(millis(300));
        master.ask(id(2), ReadStatus2).unwrap();
        (angles_deg(&fleet).map(f64::to_bits), format!("{:?}", log.take()))
    };
    let (near, far) = UnixStream::pair().unwrap();
    let other = std::thread::spawn(move || process(far));
    let remote = run(Some(near));
    other.join().unwrap();
    assert_eq!(remote, run(None));
}

/// Bare shafts with this inertia each.
struct Bare {
    inertia_kg_m2: f64,
}

impl Mechanics for Bare {
    fn step(&mut self, period: Duration, shafts: &mut [Shaft]) -> Result<(), Failure> {
        let seconds = period.as_micros() as f64 * 1e-6;
        for shaft in shafts {
            let freely = shaft.speed_dps
                + (shaft.acting.torque_nm / self.inertia_kg_m2).to_degrees() * seconds;
            let taken = (shaft.acting.friction_nm / self.inertia_kg_m2).to_degrees() * seconds;
            shaft.speed_dps = (freely.abs() - taken).max(0.0).copysign(freely);
            shaft.angle_deg += shaft.speed_dps * seconds;
        }
        Ok(())
    }
}

/// The periods that the documentation of `mechanics` calls safe: 200 us with the smallest inertia that there can be, 1
/// ms with four times that.
#[test]
fn every_models_loops_are_calm_with_the_documented_periods() {
    for (times, period_us) in [(1.0, 200), (4.0, 1_000)] {
        for model in MODELS.iter().map(|it| MotorParameters::named(it.name).unwrap()) {
            let inertia_kg_m2 = times * model.inertia_kg_m2();
            let case = format!("{} with {times} times its inertia", model.name);
            let fleet = Fleet::new(1).model(model).on_can(1_000_000).unwrap();
            let bare = Bare { inertia_kg_m2 };
            fleet.lead(&fleet.drives, Duration::from_micros(period_us), bare).unwrap();
            fleet.master::<1>().ask(id(1), go_to(20.0, 90)).unwrap();
            fleet.world.run_for(millis(700));
            let speeds_dps = (0..100).map(|_| {
                fleet.world.run_for(millis(1));
                fleet.drives[0].with(|it| it.plant().output_speed_dps().abs())
            });
            let fastest_dps = speeds_dps.fold(0.0, f64::max);
            assert!(fastest_dps < 1.0, "{case}: {fastest_dps}");
            let angle = fleet.drives[0].with(|it| it.plant().output_angle_deg());
            assert!((angle - 20.0).abs() < 0.5, "{case}: {angle}");
        }
    }
}

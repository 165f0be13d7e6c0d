//! Drives with loads, as their master sees them: they hold, drop and run into an end.

use myactuator_host_std::sim::plant::{Arm, EndStop, Load, MODELS, MotorParameters};
use myactuator_host_std::sim::{CanFleet, DriveHandle, Fleet};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ErrorFlags, ReadMultiTurnAngle, Shutdown};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::time::Duration;
use myactuator_tests::values::{GRAVITY_M_S2, go_to, id, millis, turn};

const MOTOR: MotorId = MotorId::MIN;

/// An arm of half a metre that hangs at 0°. This share of the rated torque can just hold it level.
fn arm(model: &MotorParameters, share: f64) -> Load {
    let mass_kg = share * model.rating.torque_nm / (GRAVITY_M_S2 * 0.5);
    Load { arm: Some(Arm { mass_kg, length_m: 0.5, down_deg: 0.0 }), ..Load::NONE }
}

fn models() -> impl Iterator<Item = MotorParameters> {
    MODELS.iter().map(|model| MotorParameters::named(model.name).unwrap())
}

/// On the motor's side of the gear's play, because a drive holds that side.
fn angle_deg(drive: &DriveHandle) -> f64 {
    drive.with(|drive| drive.plant().motor_side_angle_deg())
}

/// The smallest and the largest angle, read every millisecond.
fn range_deg(fleet: &CanFleet, span: Duration) -> (f64, f64) {
    let (mut least, mut most) = (f64::MAX, f64::MIN);
    for _ in 0..span.as_millis() {
        fleet.world.run_for(millis(1));
        let angle = angle_deg(&fleet.drives[0]);
        (least, most) = (least.min(angle), most.max(angle));
    }
    (least, most)
}

/// A fleet of one. 0xA4 has brought its arm to 90°, and the arm has settled.
fn holding(model: &MotorParameters, share: f64, brake: bool) -> CanFleet {
    let fleet = Fleet::new(1).model(model.clone()).load(arm(model, share)).brakes(brake);
    let fleet = fleet.on_can(1_000_000).unwrap();
    fleet.master::<1>().ask(MOTOR, go_to(90.0, 90)).unwrap();
    // For the last hundredths, where friction holds the shaft, the speed loop's integral takes time.
    fleet.world.run_for(Duration::from_secs(8));
    fleet
}

/// Every model brings an arm level and holds it there, still and within 0.1°.
#[test]
fn an_arm_is_held_level() {
    for model in models() {
        for share in [0.1, 0.5, 0.9] {
            let fleet = holding(&model, share, false);
            let (least, most) = range_deg(&fleet, millis(1_000));
            let case = format!("{} at {share}: {least} to {most}", model.name);
            assert!((least - 90.0).abs() < 0.1 && (most - 90.0).abs() < 0.1, "{case}");
            assert!(most - least <= 0.01, "{case}");
            fleet.drives[0].with(|drive| assert!(drive.state().errors.is_empty(), "{case}"));
        }
    }
}

/// 0x80 lets an arm fall to where it hangs, give or take what friction holds. A brake keeps it up.
#[test]
fn an_arm_falls_when_its_motor_is_shut_down_unless_a_brake_holds_it() {
    for model in models() {
        let weight_nm = 0.5 * model.rating.torque_nm;
        for brake in [false, true] {
            let fleet = holding(&model, 0.5, brake);
            fleet.master::<1>().ask(MOTOR, Shutdown).unwrap();
            let (least, most) = range_deg(&fleet, Duration::from_secs(30));
            let case = format!("{} with brake {brake}: {least} to {most}", model.name);
            if brake {
                assert!(least > 89.5 && most < 90.5, "{case}");
                continue;
            }
            let held_deg = (model.friction.static_nm / weight_nm).asin().to_degrees();
            assert!(least < held_deg, "{case}");
            let (least, most) = range_deg(&fleet, millis(1_000));
            assert_eq!(least, most, "{}: it has come to rest", model.name);
            assert!(least.abs() <= held_deg, "{}: rests at {least}, not {held_deg}", model.name);
        }
    }
}

/// While the drive holds, its load changes and a hand pushes. It gives way and comes back.
#[test]
fn drive_holds_a_load_that_changes_while_it_runs() {
    for model in models() {
        let fleet = holding(&model, 0.2, false);
        let drive = &fleet.drives[0];
        for (share, push) in [(0.6, 0.0), (0.6, 0.3), (0.2, 0.0)] {
            // Static friction could hide a push of up to twice its own torque, so the push is larger.
            let push_nm = -push * (model.rating.torque_nm + 8.0 * model.friction.static_nm);
            drive.with(|drive| {
                drive.plant_mut().set_load(arm(&model, share)).unwrap();
                drive.plant_mut().set_external_torque_nm(push_nm).unwrap();
            });
            let (least, most) = range_deg(&fleet, millis(3_000));
            let moved = (least - 90.0).abs().max((most - 90.0).abs());
            let case = format!("{} at {share}, {push}: {least} to {most}", model.name);
            assert!((0.01..5.0).contains(&moved), "{case}");
            let (least, most) = range_deg(&fleet, millis(500));
            let case = format!("{case}, then {least} to {most}");
            assert!((least - 90.0).abs() < 0.1 && (most - 90.0).abs() < 0.1, "{case}");
        }
    }
}

/// Each motor has a start angle and a load of its own: one motor's arm starts upright and falls, its neighbour's shaft
/// is bare and stays.
#[test]
fn motors_of_a_fleet_start_at_their_angle_with_their_own_load() {
    let model = MotorParameters::named("RMD-X8-PRO").unwrap();
    let loaded = arm(&model, 0.5);
    let fleet = Fleet::new(2).start_angle_deg(120.0).motor(id(2), |motor| motor.load = loaded);
    let fleet = fleet.on_can(1_000_000).unwrap();
    let mut master = fleet.master::<2>();
    for motor in [id(1), id(2)] {
        let reported = master.ask(motor, ReadMultiTurnAngle).unwrap().angle.degrees();
        assert!((reported - 120.0).abs() < 0.5, "{motor}: {reported}");
    }
    fleet.world.run_for(Duration::from_secs(20));
    assert!((angle_deg(&fleet.drives[0]) - 120.0).abs() < 1e-9);
    assert!(angle_deg(&fleet.drives[1]).abs() < 45.0);
}

/// A speed command drives a joint into its end stop. The joint stops there and pushes without chatter.
#[test]
fn a_joint_driven_into_its_end_stands_there() {
    for restitution in [0.0, 0.3, 0.7] {
        let stop = EndStop { at_deg: 30.0, stiffness_nm_per_rad: 5_000.0, restitution };
        let load = Load { upper_stop: Some(stop), inertia_kg_m2: 0.1, ..Load::NONE };
        let fleet = Fleet::new(1).load(load).on_can(1_000_000).unwrap();
        fleet.master::<1>().ask(MOTOR, turn(90.0)).unwrap();
        let (_, most) = range_deg(&fleet, millis(800));
        // 90°/s * √(0.13/5000) is 0.46°, and the peak torque of 25 N·m presses it in by 0.29°.
        assert!(most < 31.0, "{restitution}: {most}");
        let (least, most) = range_deg(&fleet, millis(200));
        assert!(least >= 30.0 && most - least < 0.01, "{restitution}: {least} to {most}");
        // A second at the stall current is a stall. The drive lets go, and the end stop pushes the joint out.
        fleet.world.run_for(millis(1_000));
        let errors = fleet.drives[0].with(|drive| drive.state().errors);
        assert_eq!(errors, ErrorFlags::STALL, "{restitution}");
    }
}

//! Robots from one file: each motor is what the file says, and a run is the same every time.

use embassy_futures::join::join;
use myactuator_host_std::protocol::command::{ReadModel, ReadMultiTurnAngle};
use myactuator_host_std::protocol::io::{AsyncRunner, Runner};
use myactuator_host_std::protocol::time::{Duration, Instant};
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::{self, Medium, trace};
use myactuator_host_std::sim::{BusFleet, Robot};
use myactuator_tests::values::{go_to, id};

const ROBOT: &str = r#"
    [[bus]]
    name = "arm"
    kind = "can"
    bit_rate = 1_000_000

    [bus.defaults]
    load = { arm = { mass_kg = 1, length_m = 0.5, down_deg = 0 } }
    start_angle_deg = 150

    [[bus.motor]]
    id = 9

    [[bus.motor]]
    id = 4
    brake = true

    [[bus.motor]]
    id = 5
    load = { spring = { rest_deg = 170, stiffness_nm_per_rad = 20 } }

    [[bus]]
    name = "tool"
    kind = "rs485"
    bit_rate = 115_200

    [[bus.motor]]
    ids = "1-2"
    model = "RMD-X8-P20-120"
    response_ms = [2, 3]
"#;

fn robot() -> Robot {
    Robot::from_toml(ROBOT, "").unwrap()
}

fn angles_deg<B: Medium>(fleet: &BusFleet<B>) -> Vec<f64> {
    let angle =
        |drive: &mut myactuator_host_std::sim::SimulatedDrive| drive.plant().output_angle_deg();
    fleet.drives.iter().map(|drive| drive.with(angle)).collect()
}

/// 1 kg at 0.5 m pulls with 4.9 N·m sin. It falls from 150 degrees and comes to rest near 0, unless a brake holds it. A
/// spring of 20 N·m/rad moves the joint towards 170 degrees.
#[test]
fn each_motor_carries_its_load_from_where_it_starts() {
    let arm = robot().can("arm").unwrap();
    assert_eq!(angles_deg(&arm), [150.0; 3]);
    let mut master = arm.master::<3>();
    for motor in [9, 4, 5] {
        let reported = master.ask(id(motor), ReadMultiTurnAngle).unwrap().angle.degrees();
        assert!((reported - 150.0).abs() < 0.5, "{motor}: {reported}");
    }
    arm.world.run_for(Duration::from_secs(20));
    let [falls, held, pulled] = angles_deg(&arm)[..] else { panic!() };
    assert!(falls.abs() < 25.0, "{falls}");
    assert!((held - 150.0).abs() < 0.5, "{held}");
    assert!((160.0..=172.0).contains(&pulled), "{pulled}");
}

#[test]
fn two_buses_of_a_robot_are_two_tasks_of_one_clock() {
    let robot = robot();
    let (arm, tool) = (robot.can("arm").unwrap(), robot.rs485("tool").unwrap());
    let (mut of_arm, mut of_tool) = (arm.async_master::<3>(), tool.async_master::<2>());
    let both = join(
        async {
            of_arm.ask(id(4), ReadModel).await.unwrap();
            (of_arm.ask(id(5), ReadModel).await.unwrap().model, of_arm.now())
        },
        async { (of_tool.ask(id(2), ReadModel).await.unwrap().model, of_tool.now()) },
    );
    let ((x6, at_arm), (x8, at_tool)) = bus::block_on(&[&arm.world, &tool.world], both);
    assert_eq!((x6.as_str(), x8.as_str()), (Some("X6-60"), Some("X8-120")));
    // On CAN two answers after 0.7 to 0.9 ms. On RS485 one after 2 to 3 ms, and 2 * 13 bytes of 87 us.
    let within = |at: Instant, from, to| (from..=to).contains(&at.as_micros());
    assert!(within(at_arm, 1_600, 2_500), "{at_arm:?}");
    assert!(within(at_tool, 4_250, 5_400), "{at_tool:?}");
    assert_eq!(arm.world.now(), tool.world.now());
}

/// Moves all motors of a bus that loses frames, and returns everything that was on it.
fn on_the_wire(robot: &Robot) -> Vec<trace::Record<impl PartialEq + std::fmt::Debug + use<>>> {
    let arm = robot.can("arm").unwrap();
    let lossy = FaultPlan { lose: 0.2, ..FaultPlan::NONE };
    arm.world.set_faults(Direction::ToPorts, lossy);
    let log = arm.world.log();
    let mut master = arm.master::<3>();
    for motor in [9, 4, 5].into_iter().cycle().take(60) {
        // The call may fail: which replies are lost depends on the seed.
        let _ = master.ask(id(motor), go_to(140.0, 90));
    }
    log.take()
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_does_not() {
    let first = on_the_wire(&robot());
    assert!(first.len() > 120, "{}", first.len());
    assert!(first == on_the_wire(&robot()), "one seed, one run");
    assert!(first != on_the_wire(&robot().seed(2)), "another seed");
    let seeded = Robot::from_toml(&format!("seed = 2\n{ROBOT}"), "").unwrap();
    assert!(on_the_wire(&seeded) == on_the_wire(&robot().seed(2)), "the file's seed");
}

#[test]
fn two_equal_buses_of_a_robot_have_different_seeds() {
    let bus = |name| {
        format!(
            "[[bus]]\nname = \"{name}\"\nkind = \"can\"\nbit_rate = 1_000_000\nmotor = [{{ id = 1 }}]\n"
        )
    };
    let robot = Robot::from_toml(&(bus("left") + &bus("right")), "").unwrap();
    let answered_at = |name| {
        let mut master = robot.can(name).unwrap().master::<1>();
        [(); 5].map(|()| {
            master.ask(id(1), ReadMultiTurnAngle).unwrap();
            master.now()
        })
    };
    assert_eq!(answered_at("left"), answered_at("left"));
    assert_ne!(answered_at("left"), answered_at("right"));
}

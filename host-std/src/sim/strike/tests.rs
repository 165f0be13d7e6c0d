use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    ErrorFlags, FunctionControl, ReadMultiTurnAngle, ReadStatus1, Switch,
};
use myactuator_protocol_core::drive::Event;
use myactuator_protocol_core::io::{CanMaster, Runner};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::{Duration, Instant};

use crate::sim::bus::{Medium, trace};
use crate::sim::{BusFleet, DriveLog, Fleet, LogEvent, Robot};

const MS: Duration = Duration::from_millis(1);

/// Two buses with the same two motors, the second of which has an arm that falls from the horizontal.
fn robot(faults: &str) -> Robot {
    let bus = |name, kind| {
        format!(
            r#"
            [[bus]]
            name = "{name}"
            kind = "{kind}"
            bit_rate = 1_000_000
            faults = [{faults}]

            [[bus.motor]]
            id = 1

            [[bus.motor]]
            id = 2
            model = "RMD-X8-P20-120"
            start_angle_deg = 90
            load = {{ arm = {{ mass_kg = 4, length_m = 0.5, down_deg = 0 }} }}
            "#
        )
    };
    Robot::from_toml(&[bus("arm", "can"), bus("tool", "rs485")].concat(), "").unwrap()
}

/// When something is done to a bus or a drive in the first second, and to which motor: as the bus has it, and the
/// drives' log.
fn struck<B: Medium>(fleet: &BusFleet<B>) -> Vec<(u64, u8, String)> {
    let (seen, mut log) = (fleet.world.log(), DriveLog::of(fleet));
    fleet.world.run_for(Duration::from_secs(1));
    let of_drives = log.poll(fleet.world.now()).into_iter().filter_map(|it| match it.event {
        LogEvent::Drive(event @ (Event::FaultRaised(_) | Event::FaultCleared(_))) => {
            Some((it.at.as_micros() * 1_000, it.motor.get(), format!("{event:?}")))
        }
        _ => None,
    });
    let of_bus = seen.take().into_iter().filter_map(|it| match it.event {
        trace::Event::Cut | trace::Event::Mended | trace::Event::Reset => {
            let motor = fleet.drives.iter().find(|drive| drive.station() == it.station)?.motor();
            Some((it.at_ns, motor.get(), format!("{:?}", it.event)))
        }
        _ => None,
    });
    let mut all: Vec<_> = of_drives.chain(of_bus).collect();
    all.sort();
    all
}

/// The first millisecond, and its nanoseconds, after which the second motor's shaft is below this angle.
fn falls_below<B: Medium>(fleet: &BusFleet<B>, angle_deg: f64) -> u64 {
    let is_there = || fleet.drives[1].with(|drive| drive.plant().output_angle_deg() < angle_deg);
    while !is_there() {
        fleet.world.run_for(MS);
    }
    fleet.world.now_ns()
}

#[test]
fn faults_of_a_robot_file_strike_in_a_program_in_virtual_time() {
    let planned = robot(
        r#""cut@1+500ms", "mend@1+602ms", "reset@1+0.7s", "over-voltage@1+3ms", "over-speed@2?angle<80""#,
    );
    let without = robot("");
    let falls = [
        falls_below(&without.can("arm").unwrap(), 80.0),
        falls_below(&without.rs485("tool").unwrap(), 80.0),
    ];
    assert!((20_000_000..400_000_000).contains(&falls[0]), "{falls:?}");
    let expected = |falls: u64| {
        let mut all = [
            (3_000_000, 1, "FaultRaised(ErrorFlags(OVER_VOLTAGE))"),
            (falls, 2, "FaultRaised(ErrorFlags(OVER_SPEED))"),
            (500_000_000, 1, "Cut"),
            (602_000_000, 1, "Mended"),
            (700_000_000, 1, "Reset"),
        ]
        .map(|(at_ns, motor, what)| (at_ns, motor, what.to_owned()));
        all.sort();
        all.to_vec()
    };
    // A restart has no errors.
    let reported = |all: Vec<(u64, u8, String)>| -> Vec<_> {
        all.into_iter().filter(|(_, _, what)| !what.starts_with("FaultCleared")).collect()
    };
    assert_eq!(reported(struck(&planned.can("arm").unwrap())), expected(falls[0]));
    assert_eq!(reported(struck(&planned.rs485("tool").unwrap())), expected(falls[1]));
}

#[test]
fn fleet_from_a_file_has_its_faults_on_either_bus() {
    let file = "[[bus]]\nname = \"arm\"\nkind = \"can\"\nbit_rate = 500_000\nfaults = [\"cut@1+7ms\"]\n\
                motor = [{ id = 1 }]";
    let fleet = Robot::from_toml(file, "").unwrap().buses.remove(0).fleet;
    let cut = [(7_000_000, 1, "Cut".to_owned())];
    let (can, line) = (fleet.on_can(1_000_000).unwrap(), fleet.on_rs485(115_200).unwrap());
    let (of_can, of_line) = (can.drives[0].station(), line.drives[0].station());
    let is_cut = || (can.world.is_cut(of_can), line.world.is_cut(of_line));
    assert_eq!(is_cut(), (false, false));
    assert_eq!(struck(&can), cut);
    assert_eq!(struck(&line), cut);
    assert_eq!(is_cut(), (true, true));
}

#[test]
fn fault_waiting_for_its_condition_changes_nothing() {
    let run = |faults: &str| {
        let fleet = robot(faults).can("arm").unwrap();
        let log = fleet.world.log();
        let mut master = fleet.master::<2>();
        for _ in 0..50 {
            master.ask(MotorId::new(2).unwrap(), ReadMultiTurnAngle).unwrap();
        }
        log.take()
    };
    assert!(run("\"cut@2?angle>1000\"") == run(""));
}

/// A drive whose shaft is put to 95° at so many microseconds, with a fault for above 90°: when that strikes, µs.
fn struck_us(fault: &str, moved_us: u64) -> Option<u64> {
    let fleet = Fleet::new(1).faults([fault.parse().unwrap()]).on_can(1_000_000).unwrap();
    let mut log = DriveLog::of(&fleet);
    fleet.world.run_until(Instant::from_micros(moved_us));
    fleet.drives[0].with(|drive| drive.plant_mut().set_output_angle_deg(95.0)).unwrap();
    fleet.world.run_for(Duration::from_millis(100));
    let events = log.poll(fleet.world.now());
    let of_error = |event| event == LogEvent::Drive(Event::FaultRaised(ErrorFlags::OVER_SPEED));
    events.into_iter().find(|it| of_error(it.event)).map(|it| it.at.as_micros())
}

#[test]
fn conditions_are_checked_each_millisecond_from_their_time_on() {
    assert_eq!(struck_us("over-speed@1?angle>90", 10_300), Some(11_000));
    assert_eq!(struck_us("over-speed@1?angle>90", 11_000), Some(12_000));
    assert_eq!(struck_us("over-speed@1?angle>90+30ms", 10_300), Some(30_000));
    assert_eq!(struck_us("over-speed@1?angle>96", 10_300), None);
}

#[test]
fn a_condition_is_each_drives_own_and_strikes_it_once() {
    let shared = Fleet::new(3).all_with_id(MotorId::MIN);
    let fleet = shared.faults(["over-speed@1?angle>90".parse().unwrap()]).on_can(1_000_000);
    let fleet = fleet.unwrap();
    let errors = |turned: usize| {
        for (drive, angle_deg) in fleet.drives.iter().zip([0.0; 3]) {
            drive.with(|drive| drive.plant_mut().set_output_angle_deg(angle_deg)).unwrap();
        }
        fleet.drives[turned].with(|it| it.plant_mut().set_output_angle_deg(95.0)).unwrap();
        fleet.world.run_for(Duration::from_millis(2));
        [0, 1, 2].map(|place| !fleet.drives[place].with(|it| it.state().errors.is_empty()))
    };
    assert_eq!(errors(1), [false, true, false]);
    assert_eq!(errors(0), [true, true, false]);
    fleet.plan("clear".parse().unwrap());
    assert_eq!(errors(1), [false, false, false]);
    assert_eq!(errors(2), [false, false, true]);
}

#[test]
fn fault_that_waits_in_vain_is_dropped_with_its_world() {
    let fleet = Fleet::new(1).faults(["cut@1?angle>90".parse().unwrap()]);
    let fleet = fleet.on_can(1_000_000).unwrap();
    let seat = std::sync::Arc::downgrade(&fleet.drives[0].seat);
    drop(fleet);
    assert!(seat.upgrade().is_none());
}

/// Two drives with these faults, and whether each of them answers.
fn answers(faults: &[&str]) -> [bool; 2] {
    let faults = faults.iter().map(|fault| fault.parse().unwrap());
    let fleet = Fleet::new(2).faults(faults).on_can(1_000_000).unwrap();
    let config = Config { attempts: 1, ..Config::CAN };
    let mut master = CanMaster::<_, _, 2>::new(fleet.world.port(), fleet.world.clock(), config);
    [1, 2].map(|id| master.ask(MotorId::new(id).unwrap(), ReadMultiTurnAngle).is_ok())
}

#[test]
fn faults_strike_the_motor_and_direction_that_they_name() {
    assert_eq!(answers(&[]), [true, true]);
    assert_eq!(answers(&["lose=1"]), [false, false]);
    assert_eq!(answers(&["lose=1@2"]), [true, false]);
    assert_eq!(answers(&["lose=1@2,from-drives"]), [true, false]);
    assert_eq!(answers(&["cut@1"]), [false, true]);
    assert_eq!(answers(&["slow=1s@2"]), [true, false]);
}

#[test]
fn later_faults_add_to_earlier_ones() {
    assert_eq!(answers(&["lose=1@2", "duplicate=0.5"]), [true, false]);
    assert_eq!(answers(&["lose=1", "duplicate=0.5@2"]), [false, false]);
    assert_eq!(answers(&["lose=1@2", "lose=0"]), [true, true]);
    assert_eq!(answers(&["lose=1", "lose=0@2"]), [false, true]);
    assert_eq!(answers(&["cut", "slow=1s", "babble@1", "mend"]), [true, true]);
}

#[test]
fn errors_are_raised_and_cleared() {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let mut master = fleet.master::<1>();
    let mut named = |fault: &str| {
        fleet.plan(fault.parse().unwrap());
        let errors = master.ask(MotorId::MIN, ReadStatus1).unwrap().errors;
        errors.each().filter_map(|error| error.name()).collect::<Vec<_>>()
    };
    assert_eq!(named("over-speed"), ["over-speed"]);
    assert_eq!(named("stall@1"), ["stall", "over-speed"]);
    // Stall is of level one, which only a restart ends (8.2).
    assert_eq!(named("clear"), ["stall"]);
    assert_eq!(named("stall@2"), ["stall"]);
}

#[test]
fn a_drive_that_is_mended_babbles_no_more() {
    let faults = ["babble=1ms@1", "mend@1+10ms"].map(|fault| fault.parse().unwrap());
    let fleet = Fleet::new(1).faults(faults).on_can(1_000_000).unwrap();
    let log = fleet.world.log();
    let sent = || {
        fleet.world.run_for(Duration::from_millis(20));
        let is_sent = |it: &trace::Record<_>| matches!(it.event, trace::Event::Carried { .. });
        log.take().iter().filter(|it| is_sent(it)).count()
    };
    // Who acknowledges it.
    let _listens = fleet.world.port();
    assert!((10..=11).contains(&sent()));
    assert_eq!(sent(), 0);
}

/// The report does not wait for the next time at which the drive would check its errors.
#[test]
fn an_error_that_strikes_is_reported_at_once() {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let mut master = fleet.master::<1>();
    master.ask(MotorId::MIN, FunctionControl::ErrorReporting(Switch::On)).unwrap();
    fleet.plan("over-speed@1+25.3ms".parse().unwrap());
    let log = fleet.world.log();
    let strikes = fleet.world.now_ns() + 25_300_000;
    fleet.world.run_for(Duration::from_millis(30));
    let sent = log.take().into_iter().find_map(|it| match it.event {
        trace::Event::Carried { started_ns, .. } => Some(started_ns),
        _ => None,
    });
    let late_ns = sent.unwrap() - strikes;
    assert!(late_ns < 100_000, "{late_ns}");
}

#[test]
fn random_fault_strikes_only_the_direction_that_is_named() {
    let struck = |fault: &str| {
        let fleet = Fleet::new(1).faults([fault.parse().unwrap()]).on_can(1_000_000).unwrap();
        let log = fleet.world.log();
        let _ = fleet.master::<1>().ask(MotorId::MIN, ReadStatus1);
        let all = log.take();
        let lost = all.iter().any(|it| matches!(it.event, trace::Event::Faulted { .. }));
        let carried = all.iter().filter(|it| matches!(it.event, trace::Event::Carried { .. }));
        // A question that is not heard has no answer.
        (lost, carried.map(|it| it.station).collect::<std::collections::BTreeSet<_>>().len())
    };
    for of_motor in ["@", "@1,"] {
        assert_eq!(struck(&format!("lose=1{of_motor}to-drives")), (true, 1));
        assert_eq!(struck(&format!("lose=1{of_motor}from-drives")), (true, 2));
    }
}

#[test]
fn begin_and_end_of_slowness_and_babble_are_logged() {
    let faults = ["mend", "slow=2ms@2+1ms", "slow=2ms@2+2ms", "babble=1ms@1+3ms", "mend+9ms"];
    let faults = faults.map(|it| it.parse().unwrap());
    let fleet = Fleet::new(2).faults(faults).on_can(1_000_000).unwrap();
    let mut log = DriveLog::of(&fleet);
    fleet.world.run_for(Duration::from_millis(10));
    let reported: Vec<_> =
        log.poll(fleet.world.now()).into_iter().map(|it| it.to_string()).collect();
    assert_eq!(
        reported,
        [
            "0.003000 s  can motor 1 babbles: it sends frames by itself, by a fault",
            "0.009000 s  can motor 1 babbles no more",
            "0.001000 s  can motor 2 is slow: what it sends comes 2000 us later, by a fault",
            "0.009000 s  can motor 2 is as fast as ever again",
        ]
    );
}

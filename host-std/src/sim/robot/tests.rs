use myactuator_protocol_core::Firmware;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{MotionLimits, MotionRanges, VersionDate};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::time::Duration;

use super::*;
use crate::sim::plant::{Arm, EndStop, Load, MODELS, MotorParameters, Spring};
use crate::sim::{FaultKind, MotorSetup};

/// A bus whose first line is the file's first.
const BUS: &str = "[[bus]]\nname = \"arm\"\nkind = \"can\"\nbit_rate = 1_000_000\n";
const MOTOR: &str = "[[bus.motor]]\n";

fn robot(text: &str) -> Robot {
    Robot::from_toml(text, "").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// What is said of a text that is none of a robot's.
fn refused(text: &str) -> String {
    Robot::from_toml(text, "").map(|_| ()).expect_err(text).to_string()
}

/// The motors of a bus with these lines behind its own four.
fn motors(lines: &str) -> Vec<MotorSetup> {
    robot(&format!("{BUS}{lines}")).buses[0].fleet.motors().to_vec()
}

fn ids(lines: &str) -> Vec<u8> {
    motors(lines).iter().map(|motor| motor.id.get()).collect()
}

fn id(number: u8) -> MotorId {
    MotorId::new(number).unwrap()
}

#[test]
fn motor_with_only_an_id_is_the_default_one() {
    assert_eq!(motors("[[bus.motor]]\nid = 5"), [MotorSetup::new(id(5))]);
}

/// What the documentation says of a key in its third column.
fn without_it(key: &str) -> &'static str {
    let row = format!("/// | `{key}` | ");
    let row = include_str!("../robot.rs").lines().find_map(|line| line.strip_prefix(&row));
    row.unwrap().trim_end_matches(" |").rsplit(" | ").next().unwrap()
}

#[test]
fn the_documentation_names_the_usual_model() {
    let fleet = robot(&format!("{BUS}{MOTOR}id = 1")).can("arm").unwrap();
    let name = fleet.drives[0].with(|drive| drive.plant().parameters().name.clone());
    assert_eq!(without_it("model"), format!("`\"{name}\"`"));
}

#[test]
fn every_key_of_a_motor_is_read_there_and_in_the_defaults() {
    let keys = r#"
        model = "rmd-x6-p20-60"
        firmware = "v4.4"
        motion = { position_rad = 12.5, velocity_rad_s = 45, kp = 500, kd = 5, torque_nm = 60 }
        version_date = 2026042402
        quirks = ["slow-boot", "turns-lost"]
        response_ms = [0.25, 1.5]
        brake = true
        start_angle_deg = -400.5

        [TABLE.load]
        torque_nm = 1
        inertia_kg_m2 = 0.02
        damping_nm_s_per_rad = 0.1
        arm = { mass_kg = 2, length_m = 0.3, down_deg = -90 }
        spring = { rest_deg = 10, stiffness_nm_per_rad = 5 }
        upper_stop = { at_deg = 500, stiffness_nm_per_rad = 900, restitution = 0.3 }
        lower_stop = { at_deg = -500, stiffness_nm_per_rad = 800, restitution = 0.2 }
    "#;
    let limits = MotionLimits {
        position_rad: 12.5,
        velocity_rad_s: 45.0,
        kp: 500.0,
        kd: 5.0,
        torque_nm: 60.0,
    };
    let stop = |at_deg, stiffness_nm_per_rad, restitution| {
        Some(EndStop { at_deg, stiffness_nm_per_rad, restitution })
    };
    let expected = MotorSetup {
        id: id(3),
        model: Some(MotorParameters::named("RMD-X6-P20-60").unwrap()),
        firmware: Some(Firmware::V4_4),
        motion_ranges: Some(MotionRanges::new(limits).unwrap()),
        version_date: Some(VersionDate::from_raw(2_026_042_402)),
        quirks: Quirks { slow_boot: true, turns_lost: true, ..Quirks::default() },
        response: (Duration::from_micros(250), Duration::from_micros(1_500)),
        has_brake: true,
        load: Load {
            torque_nm: 1.0,
            inertia_kg_m2: 0.02,
            arm: Some(Arm { mass_kg: 2.0, length_m: 0.3, down_deg: -90.0 }),
            spring: Some(Spring { rest_deg: 10.0, stiffness_nm_per_rad: 5.0 }),
            damping_nm_s_per_rad: 0.1,
            upper_stop: stop(500.0, 900.0, 0.3),
            lower_stop: stop(-500.0, 800.0, 0.2),
        },
        start_angle_deg: -400.5,
    };
    let own = format!("[[bus.motor]]\nid = 3\n{}", keys.replace("TABLE", "bus.motor"));
    assert_eq!(motors(&own), std::slice::from_ref(&expected));
    let keys = keys.replace("TABLE", "bus.defaults");
    let shared = format!("[bus.defaults]\n{keys}\n[[bus.motor]]\nid = 3\n");
    assert_eq!(motors(&shared), std::slice::from_ref(&expected));

    // What a motor says itself counts, and a load counts as a whole.
    let own = "brake = false\nload = { torque_nm = 2 }\nquirks = []";
    let load = Load { torque_nm: 2.0, ..Load::NONE };
    let expected = MotorSetup { has_brake: false, load, quirks: Quirks::default(), ..expected };
    assert_eq!(motors(&format!("{shared}{own}")), [expected]);
}

#[test]
fn ids_are_one_or_several() {
    assert_eq!(ids("[[bus.motor]]\nids = \"2-4\"\n[[bus.motor]]\nid = 1"), [2, 3, 4, 1]);
    assert_eq!(ids("[[bus.motor]]\nids = [32, 7]"), [32, 7]);
    assert_eq!(
        ids("shared_ids = true\n[[bus.motor]]\nids = [1, 1]\n[[bus.motor]]\nid = 1"),
        [1, 1, 1]
    );
}

#[test]
fn every_key_of_a_bus_is_read() {
    let robot = robot(
        r#"
        [[bus]]
        name = "left-arm_1"
        kind = "can"
        bit_rate = 500_000
        interface = "vcan0"
        faults = ["cut@2+5s", "lose=0.1"]
        motor = [{ ids = "1-2" }]

        [[bus]]
        name = "tool"
        kind = "rs485"
        bit_rate = 115_200
        adapter = "echo-noise"
        bursts_ms = 16
        motor = [{ id = 9 }]
        "#,
    );
    let [arm, tool] = &robot.buses[..] else { panic!("{robot:?}") };
    assert_eq!((arm.name(), arm.kind, arm.bit_rate), ("left-arm_1", BusKind::Can, 500_000));
    assert_eq!(arm.interface.as_deref(), Some("vcan0"));
    let faults = &arm.fleet.faults;
    let kind = faults[0].kind;
    let faults: Vec<_> = faults.iter().map(|fault| (fault.motor, fault.after)).collect();
    assert_eq!(faults, [(Some(id(2)), Duration::from_secs(5)), (None, Duration::ZERO)]);
    assert_eq!(kind, FaultKind::Cut);
    assert_eq!((tool.name(), tool.kind, tool.bit_rate), ("tool", BusKind::Rs485, 115_200));
    assert_eq!((tool.adapter, &tool.interface), (Adapter::EchoNoise, &None));
    assert_eq!(tool.bursts.as_millis(), 16);
    assert!(tool.adapter.transceiver().echo && tool.adapter.transceiver().switch_noise > 0.0);
    assert!(!Adapter::Plain.transceiver().echo);

    let (can, line) = (robot.can("left-arm_1").unwrap(), robot.rs485("tool").unwrap());
    assert_eq!((can.name.as_str(), can.bit_rate, can.drives.len()), ("left-arm_1", 500_000, 2));
    assert_eq!((line.name.as_str(), line.bit_rate, line.drives.len()), ("tool", 115_200, 1));
    let error = robot.can("right").unwrap_err().to_string();
    assert_eq!(error, "there is no bus \"right\", only left-arm_1, tool");
    let error = robot.can("tool").unwrap_err().to_string();
    assert!(error.starts_with("the bus \"tool\" is of the kind rs485"), "{error}");
}

#[test]
fn the_motors_of_a_bus_may_share_a_supply() {
    let supply = "{ voltage_v = 24, resistance_ohm = 0.1, feedback_resistance_ohm = 20, capacitance_f = 0.01 }";
    let text = format!("{BUS}supply = {supply}\n{MOTOR}ids = \"1-2\"");
    let fleet = Robot::from_toml(&text, "").unwrap().can("arm").unwrap();
    assert_eq!(fleet.shared_supply().unwrap().supply().voltage_v, 24.0);
    fleet.world.run_for(Duration::from_millis(50));
    for drive in &fleet.drives {
        let voltage_v = drive.with(|drive| drive.state().measurement.supply_voltage_v);
        assert!((voltage_v - 24.0).abs() < 0.1, "{voltage_v}");
    }
}

#[test]
fn errors_of_a_robot_file_name_their_line() {
    // Lines 1 to 4 are the bus's, 5 is the motor's head.
    let in_motor = |lines: &str| format!("{BUS}{MOTOR}{lines}");
    let mut others = Vec::new();
    for (text, expected) in [
        (in_motor("id = 0"), "line 6: motor id must be 1 to 32, but 0 was given"),
        (
            in_motor("ids = \"6-1\""),
            "line 6: expected ids such as \"1-6\" or [1, 2, 5], each from 1 to 32, found string \"6-1\"",
        ),
        (in_motor("ids = []"), "line 6: invalid length 0, expected ids such as"),
        (in_motor("ids = 3"), "line 6: expected ids such as"),
        (in_motor("brake = true"), "line 5: expected id or ids, found neither"),
        (in_motor("id = 1\nids = [2]"), "line 5: expected either id or ids, found both"),
        (
            in_motor("id = 1\n[[bus.motor]]\nids = \"1-2\""),
            "line 7: motor 1 of the bus \"arm\" is in line 5 already: take another id, or say shared_ids = true",
        ),
        (
            in_motor("id = 1\nbrakes = true"),
            "line 7: unknown field `brakes`, expected one of `id`, `ids`",
        ),
        (
            format!(
                "{BUS}supply = {{ voltage_v = 48, resistance_ohm = 0, feedback_resistance_ohm = 1, capacitance_f = 0.01 }}\n{MOTOR}id = 1"
            ),
            "line 5: supply resistance must be 0.0001 to",
        ),
        (in_motor("id = 1\nbrake = 1"), "line 7: expected true or false, found integer `1`"),
        (in_motor("id = 1\nload = 5"), "line 7: expected a table, found integer `5`"),
        (in_motor("id = 1\nload = { arm = 5 }"), "line 7: expected a table, found integer `5`"),
        (
            in_motor("id = 1\nload = { torque_nm = \"5\" }"),
            "line 7: expected a number, found string",
        ),
        (
            in_motor("id = 1\nresponse_ms = 1"),
            "line 7: expected a list of 2 numbers, found integer",
        ),
        (
            in_motor("id = 1\nquirks = \"echo\""),
            "line 7: expected a list in brackets, found string",
        ),
        (
            in_motor("id = 1\nmodel = \"RMD-X9\""),
            "line 7: no motor model is called \"RMD-X9\"; there are RMD-X2",
        ),
        (
            in_motor("id = 1\nmodel = \"none.toml\""),
            "line 7: the model's file \"none.toml\" cannot be read",
        ),
        (
            in_motor("id = 1\nfirmware = \"v4\""),
            "line 7: unknown variant `v4`, expected `v4.3` or `v4.4`",
        ),
        (
            in_motor("id = 1\nfirmware = \"v4.4\""),
            "line 5: firmware: the scales of v4.4's motion mode depend on the motor",
        ),
        (in_motor("id = 1\nquirks = [\"slow\"]"), "line 7: expected one of slow-boot, slow-brake"),
        (
            in_motor("id = 1\nresponse_ms = [2, 1]"),
            "line 7: expected the shortest and the longest time",
        ),
        (
            in_motor("id = 1\nresponse_ms = [0, inf]"),
            "line 7: expected the shortest and the longest time",
        ),
        (
            in_motor("id = 1\nload = { weight_kg = 1 }"),
            "line 7: unknown field `weight_kg`, expected one of `torque_nm`",
        ),
        (in_motor("id = 1\nload = { inertia_kg_m2 = -1 }"), "line 5: load inertia must be 0 to"),
        (in_motor("id = 1\nstart_angle_deg = nan"), "line 5: "),
        (
            in_motor(
                "id = 1\nstart_angle_deg = 90\nload = { upper_stop = { at_deg = 45, \
                 stiffness_nm_per_rad = 5000, restitution = 0 } }",
            ),
            "line 5: angle of the shaft between its end stops must be -1000000000 to 4",
        ),
        (BUS.to_owned(), "line 1: the bus \"arm\" has no [[bus.motor]]"),
        (
            format!("{BUS}[bus.defaults]\nid = 1\n[[bus.motor]]\nid = 1"),
            "line 5: [bus.defaults] has no id",
        ),
        (
            format!("{BUS}speed = 1\n{MOTOR}id = 1"),
            "line 5: unknown field `speed`, expected one of `name`",
        ),
        (
            format!("{BUS}adapter = \"echo\"\n{MOTOR}id = 1"),
            "line 5: adapter is for buses of the kind rs485",
        ),
        (
            format!("{BUS}faults = [\"cut@1\",\n\"cut@2\"]\n{MOTOR}id = 1"),
            "line 6: the fault is for motor 2, which is not on this bus",
        ),
        (
            format!("{BUS}faults = [\"cur\"]\n{MOTOR}id = 1"),
            "line 5: expected lose, corrupt, undetected",
        ),
        (
            format!("{}{MOTOR}id = 1", BUS.replace("\"can\"", "\"rs485\"\ninterface = \"vcan0\"")),
            "line 4: interface is for buses of the kind can",
        ),
        (
            format!("{}{MOTOR}id = 1", BUS.replace("1_000_000", "2_000_000")),
            "line 4: expected 10000 to 1000000 bit/s, found 2000000",
        ),
        (
            format!("{}{MOTOR}id = 1", BUS.replace("can", "usb")),
            "line 3: expected can or rs485, found \"usb\"",
        ),
        (
            format!("{}{MOTOR}id = 1", BUS.replace("arm", "../arm")),
            "line 2: expected 1 to 64 letters, digits, \"-\" or \"_\", found \"../arm\"",
        ),
        (format!("{}{MOTOR}id = 1", BUS.replace("arm", "")), "line 2: expected 1 to 64 letters"),
        (
            format!("{BUS}{MOTOR}id = 1\n{BUS}{MOTOR}id = 2"),
            "line 8: the bus in line 2 is called \"arm\", too",
        ),
        (BUS.replace("name = \"arm\"\n", ""), "line 1: missing field `name`"),
        (BUS.replace("kind = \"can\"\n", ""), "line 1: missing field `kind`"),
        (BUS.replace("bit_rate = 1_000_000\n", ""), "line 1: missing field `bit_rate`"),
        ("seed = 3".to_owned(), "line 1: expected at least one [[bus]], found none"),
        (
            "seed = -3".to_owned(),
            "line 1: expected a whole number that is not negative, found integer `-3`",
        ),
        (
            format!("{BUS}bursts_ms = -1\n{MOTOR}id = 1"),
            "line 5: expected a whole number from 0 to 65535, found integer `-1`",
        ),
        (
            format!("{BUS}mechanics = \"a\"\n{MOTOR}id = 1"),
            "line 5: expected a table, found string \"a\"",
        ),
        ("robots = 3".to_owned(), "line 1: unknown field `robots`, expected `seed` or `bus`"),
        ("\n[[bus".to_owned(), "line 2: "),
        (
            "[bus] # one".to_owned(),
            "line 1: expected [[bus]], for there may be several, found [bus]",
        ),
        (
            format!("{BUS}{MOTOR}id = 1\n[bus]\nname = \"leg\""),
            "line 7: expected [[bus]], for there may be several, found [bus]",
        ),
        (
            format!("{BUS}[bus.motor]\nid = 1"),
            "line 5: expected [[bus.motor]], for there may be several, found [bus.motor]",
        ),
        (
            format!("{BUS}{MOTOR}id = 1\nquirks = [\"slow-boot\", \"echo\"]"),
            "line 7: \"echo\" is the line's: say adapter = \"echo\" in its [[bus]]",
        ),
        (
            format!("{BUS}{MOTOR}id = 1\nquirks = [\"bursts\"]"),
            "line 7: \"bursts\" is the bus's: say bursts_ms = 16 in its [[bus]]",
        ),
    ] {
        let message = refused(&text);
        if !message.starts_with(expected) || message.contains('\n') {
            others.push(format!("{message}\n  instead of {expected}"));
        }
    }
    assert!(others.is_empty(), "{}", others.join("\n"));
}

#[test]
fn model_files_are_looked_for_beside_the_robot_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut own = MODELS[0].toml.replace(MODELS[0].name, "my own");
    std::fs::write(folder.path().join("mine.toml"), &own).unwrap();
    let path = folder.path().join("robot.toml");
    std::fs::write(&path, format!("{BUS}{MOTOR}id = 1\nmodel = \"mine.toml\"")).unwrap();
    let robot = Robot::from_file(&path).unwrap();
    let found = robot.buses[0].fleet.motors()[0].model.clone().unwrap();
    assert_eq!(found.name, "my own");

    own.push_str("\nnonsense = 1\n");
    std::fs::write(folder.path().join("mine.toml"), own).unwrap();
    let message = Robot::from_file(&path).unwrap_err().to_string();
    assert!(
        message.starts_with(&format!("{}, line 7: the model's file ", path.display())),
        "{message}"
    );
    assert!(message.contains("mine.toml\", line ") && !message.contains('\n'), "{message}");
    assert!(message.contains(": unknown field `nonsense`"), "{message}");

    let message = Robot::from_file(folder.path().join("none.toml")).unwrap_err().to_string();
    assert!(
        message.starts_with("the robot's file ") && message.contains("cannot be read"),
        "{message}"
    );
}

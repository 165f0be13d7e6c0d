//! The subcommands that work on motors, on the simulated buses, as their users run them.

use std::process::{Output, Stdio};

use serde_json::Value;

use crate::run::{myactuator, rows, run_words, text};

const SIMULATED: &str = "simulated drives: ";

/// Runs this on simulated motors unless it names a bus.
fn run_simulated(arguments: &str) -> Output {
    let mut program = myactuator();
    program.env("MYACTUATOR_BUS", "sim").args(arguments.split_whitespace());
    program.stdin(Stdio::null()).output().unwrap()
}

/// The output of this; it must succeed, and say that the drives are simulated.
fn done(arguments: &str) -> Vec<String> {
    let output = run_simulated(arguments);
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{arguments}: {errors}");
    assert!(errors.lines().any(|line| line.starts_with(SIMULATED)), "{arguments}: {errors}");
    assert!(!errors.contains("error"), "{arguments}: {errors}");
    text(&output.stdout).lines().map(str::to_owned).collect()
}

fn objects(arguments: &str) -> Vec<Value> {
    done(arguments).iter().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The exit status of this, and its one error.
fn refused(arguments: &str) -> (i32, String) {
    let output = run_simulated(arguments);
    let errors = text(&output.stderr);
    let mut sentences = errors.lines().filter_map(|line| line.strip_prefix("error: "));
    let sentence = sentences.next().unwrap_or_else(|| panic!("{arguments}: {errors:?}"));
    assert_eq!(sentences.next(), None, "{arguments}: {errors}");
    (output.status.code().unwrap(), sentence.to_owned())
}

/// The number in front of this word.
fn before(line: &str, unit: &str) -> f64 {
    let words: Vec<&str> = line.split_whitespace().collect();
    let place = words.iter().position(|word| *word == unit).unwrap_or_else(|| panic!("{line}"));
    words[place - 1].parse().unwrap_or_else(|_| panic!("{line}"))
}

#[test]
fn scan_finds_all_motors() {
    let lines = done("scan");
    assert_eq!(lines.len(), 4);
    assert!(lines[3].starts_with("motor 4: model X6-60, "), "{}", lines[3]);
    assert!(lines[3].ends_with("voltage 48 V, no error"), "{}", lines[3]);
    for bus in ["sim:32", "sim:3,rs485"] {
        let motors = objects(&format!("scan --json --bus {bus}"));
        let ids: Vec<u64> = motors.iter().map(|motor| motor["id"].as_u64().unwrap()).collect();
        let count = if bus == "sim:32" { 32 } else { 3 };
        assert_eq!(ids, (1..=count).collect::<Vec<u64>>());
        assert!(motors.iter().all(|motor| motor["bus"] == bus && motor["model"] == "X6-60"));
    }
}

#[test]
fn info_prints_model_version_and_settings() {
    let lines = done("info --id 2");
    assert_eq!(lines[0], "motor 2");
    assert!(lines[1].starts_with("  model X6-60, version date "), "{}", lines[1]);
    assert!(lines[2].contains(" ms, nothing runs (mode 0), offset "), "{}", lines[2]);
    let motors = objects("info --json --bus sim:2,rs485");
    assert_eq!(motors.len(), 2);
    assert_eq!(motors[1]["id"], 2);
    assert_eq!(motors[1]["model"], "X6-60");
    assert_eq!(motors[1]["offset_pulses"], 0);
    assert!(motors[1]["run_time_ms"].as_u64().unwrap() < 10_000);
}

#[test]
fn status_prints_the_state_of_motors() {
    let lines = done("status --id 1");
    assert_eq!(lines.len(), 4, "{lines:?}");
    assert!(lines[1].starts_with("  angle 0 deg, current 0 A, speed 0 dps, "), "{}", lines[1]);
    assert!(lines[3].ends_with("brake lock (0), voltage 48 V, no error"), "{}", lines[3]);
    let motors = objects("status --json");
    assert_eq!(motors.len(), 4);
    for motor in &motors {
        assert_eq!(motor["angle_deg"], 0.0);
        assert_eq!(motor["voltage_v"], 48.0);
        assert_eq!((&motor["brake"], &motor["brake_raw"]), (&"lock".into(), &0.into()));
        assert_eq!(motor["phase_b_current_a"], 0.0);
        assert_eq!(motor["errors"], Value::Array(vec![]));
    }
}

#[test]
fn move_goes_to_an_angle_on_either_bus() {
    for bus in ["sim", "sim:4,rs485"] {
        let lines = done(&format!("move --bus {bus} --id 3 --angle-deg 90 --max-speed-dps 180"));
        let (end, way) = lines.split_last().unwrap();
        assert!(end.starts_with("motor 3 has arrived at "), "{end}");
        assert!(
            end.ends_with("holds its position unless its protection (0xB3) ends that"),
            "{end}"
        );
        assert!((before(end, "deg") - 90.0).abs() <= 0.2, "{end}");
        // 90 degrees at 180 dps take half a second at least.
        assert!((0.5..2.0).contains(&before(end, "s")), "{end}");
        assert!(way.iter().any(|line| before(line, "dps") == 180.0), "{way:?}");
        assert!(way.iter().all(|line| before(line, "dps") <= 185.0), "{way:?}");
    }
}

#[test]
fn move_goes_on_by_an_angle_with_and_without_a_limit_of_torque() {
    for torque in ["", "--max-torque-pct 50"] {
        let lines = done(&format!("move --id 1 --relative --angle-deg -30 {torque}"));
        let end = lines.last().unwrap();
        assert!((before(end, "deg") + 30.0).abs() <= 0.2, "{end}");
    }
}

#[test]
fn a_motor_that_never_moves_is_stopped_also_if_it_may_press() {
    // 1 % of the rated torque does not overcome friction.
    for press in ["", "--press"] {
        let (status, message) =
            refused(&format!("move --id 1 --angle-deg 90 --max-torque-pct 1 {press}"));
        assert_eq!(status, 1);
        assert!(message.contains("comes no nearer to 90 deg"), "{message}");
        assert!(
            message.ends_with(
                "motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
            ),
            "{message}"
        );
    }
}

#[test]
fn a_motor_that_does_not_arrive_in_time_is_stopped() {
    let (status, message) = refused("move --id 1 --angle-deg 720 --timeout-s 1");
    assert_eq!(status, 1);
    assert!(message.starts_with("motor 1 has not arrived: it is at "), "{message}");
    assert!(message.contains("not at 720 deg when its time is up"), "{message}");
    assert!(
        message.ends_with(
            "motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
        ),
        "{message}"
    );
}

#[test]
fn speed_turns_the_motor_and_then_holds_it() {
    for bus in ["sim", "sim:1,rs485"] {
        let lines = done(&format!("speed --bus {bus} --id 1 --speed-dps -90 --for-s 0.5"));
        let (end, way) = lines.split_last().unwrap();
        let message = "motor 1 has run for 0.5 s; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that";
        assert_eq!(end, message);
        assert_eq!(before(way.last().unwrap(), "dps"), -90.0);
    }
}

#[test]
fn torque_releases_the_brake_and_locks_it_again() {
    let lines = done("torque --id 1 --current-a 1 --for-s 0.5");
    let (end, way) = lines.split_last().unwrap();
    assert!(end.ends_with("its brake locked again (0x78) and it is off (0x80)"), "{end}");
    // Against a locked brake it would stand still.
    assert!(before(way.last().unwrap(), "dps") > 100.0, "{way:?}");
    assert_eq!(before(way.last().unwrap(), "A"), 1.0);
}

#[test]
fn motion_runs_to_its_position_by_the_given_ranges() {
    let motion = "motion --id 2 --position-rad 1 --kp 40 --kd 2 --for-s 0.5";
    let lines = done(motion);
    for ranges in ["--firmware v4.3", "--ranges 12.5,45,500,5,24"] {
        assert_eq!(done(&format!("{motion} {ranges}")), lines, "{ranges}");
    }
    let (end, way) = lines.split_last().unwrap();
    assert!(
        end.ends_with(
            "motor 2 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
        ),
        "{end}"
    );
    assert!((before(way.last().unwrap(), "rad") - 1.0).abs() < 0.05, "{way:?}");
    // Scales other than its firmware's would multiply the torque.
    let (status, message) = refused(&format!("{motion} --ranges 12.566,45,500,5,60"));
    assert!(status == 1 && message.contains("has scales of its own"), "{status}: {message}");
    assert_eq!(refused(&format!("{motion} --ranges v4.3")).0, 2);
    assert_eq!(refused("send --id 2 --firmware v4.4 read-single-turn-angle-v4.4").0, 1);
    let (status, message) = refused(&format!("{motion} --bus sim:2,rs485"));
    assert_eq!((status, message.as_str()), (2, "--bus: motion exists on CAN only"));
}

/// Commands, and their output.
const ANSWERS: &str = "
--id 2 read-multi-turn-angle => 242#9200000000000000  motor 2  reply  read-multi-turn-angle (0x92): angle 0 deg
--id 2 raw 92 0 0 0 0 0 0 0 => 242#9200000000000000  motor 2  reply  read-multi-turn-angle (0x92): angle 0 deg
--bus sim:1,rs485 --id 1 read-model => 3E 01 08 B5 58 36 2D 36 30 00 00 4F 90  motor 1  reply  read-model (0xB5): model X6-60
--bus sim:1 bus-id --access read => 300#7900010000004102  all motors  reply  bus-id (0x79): access read (1), motor id 1
write-pid-rom --index speed-kp --value 0.5 --id 1 => 241#320400000000003F  motor 1  reply  write-pid-rom (0x32): index speed-kp (4), value 0.5
--id 1 reset => motor 1: sent reset (0x76); no reply is awaited
--id 1 function-control --index set-can-id --value 7 => motor 1: sent function-control (0x20): index set-can-id (5), value 7; no reply is awaited
";

#[test]
fn any_command_is_sent_and_its_reply_explained() {
    for (arguments, answer) in rows(ANSWERS) {
        assert_eq!(done(&format!("send {arguments}")), [answer], "{arguments}");
    }
    let motion = "motion --position-rad 0 --velocity-rad-s 0 --kp 1 --kd 1 --torque-nm 0";
    let message = objects(&format!("send --json --id 1 {motion}"));
    assert_eq!(message[0]["fields"]["id_byte"], 1);
    assert_eq!(message[0]["fields"]["position_raw"], 32_768);
    assert_eq!(objects("send --json --id 1 reset"), [Value::Null; 0]);
}

#[test]
fn a_command_to_all_is_answered_by_each() {
    let mut voltages = objects("send --id all read-status1 --json --bus sim:5");
    voltages.sort_by_key(|message| message["id"].as_u64());
    let ids: Vec<u64> = voltages.iter().map(|message| message["id"].as_u64().unwrap()).collect();
    assert_eq!(ids, [1, 2, 3, 4, 5]);
    assert!(voltages.iter().all(|message| message["fields"]["voltage_v"] == 48.0));
}

#[test]
fn stop_and_shutdown_reach_one_or_all() {
    let others = "; no other id has confirmed: a motor that is not named here may go on";
    let by_brakes =
        "are stopped and run nothing (mode 0): their brakes hold them, which they report as locked";
    let all = format!("motors 1 2 3 4 {by_brakes}");
    assert_eq!(done("stop"), [format!("{all}{others}")]);
    let by_brake = "motor 2 is stopped and runs nothing (mode 0): its brake holds it, which it reports as locked";
    assert_eq!(done("stop --id 2"), [by_brake]);
    let off = "are off (0x80): their shafts are free unless brakes hold them";
    assert_eq!(
        done("shutdown --id all --bus sim:3,rs485"),
        [format!("motors 1 2 3 {off}{others}")]
    );
    let off = "motor 1 is off (0x80): its shaft is free unless a brake holds it";
    assert_eq!(done("shutdown --id 1"), [off]);
    assert!(!done("stop --bus sim:32")[0].contains("no other id"));
    let (status, message) = refused("stop --id 9");
    assert_eq!(status, 1);
    let doubt = "no confirmation of the stop from motor 9: if it is on this bus, cut its power";
    assert_eq!(message, doubt);
}

/// The standard error when this is sent.
fn stderr_of_send(command: &str) -> String {
    let output = run_simulated(&format!("send --yes --json {command}"));
    assert_eq!(output.status.code(), Some(0), "{command}");
    text(&output.stderr).to_owned()
}

#[test]
fn send_notes_which_motors_may_go_on() {
    let turn = "speed --speed-dps 90 --max-torque-pct 0";
    let message = stderr_of_send(&format!("--id 1 {turn}"));
    let ends = "'myactuator stop --bus sim:4 --id 1' ends that\n";
    assert!(message.contains(&format!("note: motor 1 may go on: {ends}")), "{message}");
    let message = stderr_of_send(&format!("--id all {turn}"));
    let ends = "'myactuator stop --bus sim:4 --id all' ends that\n";
    assert!(message.contains(&format!("note: motors 1 2 3 4 may go on: {ends}")), "{message}");
    assert!(!stderr_of_send("--id 1 read-status2").contains("note"));
    assert!(!stderr_of_send("--id 1 stop").contains("note"));
}

/// 2.10.1.
#[test]
fn send_notes_what_has_to_follow() {
    let note =
        "note: this takes effect after a restart: 'myactuator reset --bus sim:4 --id 1' (0x76)\n";
    let message = stderr_of_send("--id 1 set-current-position-zero");
    assert!(message.ends_with(note), "{message}");
    let message = stderr_of_send("--id all set-current-position-zero");
    let note = note.replace("reset --bus sim:4 --id 1", "send reset --bus sim:4 --id all");
    assert!(message.ends_with(&note), "{message}");
}

#[test]
fn the_brake_is_released_and_locked() {
    assert_eq!(
        done("brake release --id 1"),
        ["motor 1: brake released: a load can turn its shaft now, unless the motor holds it"]
    );
    assert_eq!(done("brake lock --id 1 --bus sim:1,rs485"), ["motor 1: brake locked"]);
}

#[test]
fn a_motor_is_restarted_and_protected() {
    for bus in ["sim:2", "sim:2,rs485"] {
        let message = done(&format!("reset --bus {bus} --id 2"));
        assert_eq!(message, ["motor 2 has restarted: it read 0 deg and reads 0 deg"]);
        let message = done(&format!("timeout --bus {bus} --id 2 --time-ms 500"));
        assert!(message[0].starts_with("motor 2 cuts its output when it hears nothing for 500 ms"));
        let message = done(&format!("timeout --bus {bus} --id 2 --time-ms 0"));
        assert_eq!(message, ["motor 2: the communication-loss protection is off"]);
    }
}

#[test]
fn protection_too_short_for_this_programs_commands_is_noted() {
    let beside = |millis: &str| {
        let output = run_simulated(&format!("timeout --yes --id 1 --time-ms {millis}"));
        assert_eq!(output.status.code(), Some(0), "{millis}");
        text(&output.stderr).to_owned()
    };
    let message = beside("49");
    let note = "note: below 50 ms the protection may end a movement of this program: it sends every 10 to 20 ms, and \
                less often on a busy machine\n";
    assert!(message.ends_with(note), "{message}");
    for millis in ["0", "50"] {
        assert!(!beside(millis).contains("note"), "{millis}");
    }
}

#[test]
fn zero_is_kept_over_the_restart() {
    let lines = done("zero --id 4");
    assert_eq!(lines.len(), 1);
    assert!(lines[0].starts_with("motor 4: what was 0 deg is the zero"), "{}", lines[0]);
    assert!(lines[0].ends_with("after its restart the motor reads 0 deg"), "{}", lines[0]);
}

#[test]
fn an_id_is_changed_on_either_bus() {
    for bus in ["sim:1", "sim:1,rs485"] {
        assert_eq!(done(&format!("id --bus {bus} --new-id 7")), ["motor 1 is motor 7 now"]);
    }
    for bus in ["sim:3", "sim:3,rs485"] {
        let message = done(&format!("id --bus {bus} --id 2 --new-id 7"));
        assert_eq!(message, ["motor 2 is motor 7 now"]);
    }
    assert_eq!(done("id --bus sim:1 --id 1 --new-id 1"), ["motor 1 has this id already"]);
    let (status, message) = refused("id --bus sim:4 --new-id 7");
    assert_eq!(status, 1);
    assert!(message.ends_with("(there are: 1 2 3 4)"), "{message}");
    let (status, message) = refused("id --bus sim:1 --id 2 --new-id 7");
    assert_eq!((status, message.as_str()), (1, "the only motor has id 1, not 2"));
}

#[test]
fn absent_motor_is_reported() {
    let nobody = "motor 9: no reply: is the motor powered, and is this its id?";
    for command in ["info", "status", "move --angle-deg 1", "zero", "brake lock", "reset"] {
        let (status, message) = refused(&format!("{command} --id 9"));
        assert_eq!((status, message.as_str()), (1, nobody), "{command}");
    }
}

/// Commands, and the sentences that refuse them.
const REFUSALS: &str = r#"
stop 1 => unexpected argument '1' found; if a motor is meant, --id names it
status --id 33 => --id: motor id must be 1 to 32, or all, but "33" was given
move --id 0 --angle-deg 1 => --id: motor id must be 1 to 32, but 0 was given
move --id 1 --angle-deg 1 --max-speed-dps 70000 => --max-speed-dps: maximum speed must be 1 to 65535 dps (0: no limit in direct tracking), but 70000 dps was given
move --id 1 --angle-deg 1 --max-speed-dps 0.4 => --max-speed-dps: maximum speed must be 1 to 65535 dps (0: no limit in direct tracking), but 0.4 dps was given
move --id 1 --angle-deg 1 --max-torque-pct 0 => --max-torque-pct: 0 leaves no torque to move with: give 1 to 255, or leave it out
speed --id 1 --speed-dps 1 --for-s 0 => --for-s: time must be 0.01 to 3600 s, but 0 s was given
torque --id 1 --current-a 400 => --current-a: torque current must be -327.68 to 327.67 A, but 400 A was given
motion --id 1 --position-rad 13 --kp 1 --kd 1 => position must be -12.5 to 12.5 rad, but 13 rad was given
send stop => --id is missing: say which motor, 1 to 32, or all
send --id 1 bus-id --access read => --id: bus-id (0x79) reaches every motor that is connected and names none: send it to all
send --id 1 --firmware v4.4 read-model => --firmware: v4.4 has no read-model (0xB5)
send --id 1 --firmware v4.4 read-single-turn-angle => --firmware: v4.4 has no read-single-turn-angle (0x94): take read-single-turn-angle-v4.4
send --id 1 --bus sim:1,rs485 active-reply --command 0x60 --enable on --interval-ms 10 => --bus: active-reply (0xB6) exists on CAN only
send --id 1 set-baud-rate --baud-rate rs485-1m => --baud-rate: 2 is no bit rate of CAN by the manual: take can-500k-rs485-115200 (0) or can-1m-rs485-500k (1)
send --id 1 --bus sim:1,rs485 set-baud-rate --baud-rate 3 => --baud-rate: 3 is no bit rate of RS485 by the manual: take can-500k-rs485-115200 (0) or can-1m-rs485-500k (1) or rs485-1m (2)
send --id 1 speed --speed-dps 1 => --max-torque-pct is missing: The largest torque; 0 for no limit but the stall current. 1 to 255 % of rated current.
send --id 1 raw 92 => expected eight bytes, found 1
send --id 1 raw 92 0 0 0 0 0 0 0 0 => expected eight bytes, found 9
send --id 1 raw G2 0 0 0 0 0 0 0 => expected hexadecimal bytes 00 to FF separated by spaces or commas, found "0xG2"
id --new-id 33 => --new-id: motor id must be 1 to 32, but 33 was given
scan --all-rates => --all-rates: all simulated motors have the rate of their bus
"#;

#[test]
fn values_out_of_range_are_refused_with_the_range() {
    for (arguments, sentence) in rows(REFUSALS) {
        assert_eq!(refused(arguments), (2, sentence.to_owned()), "{arguments}");
    }
}

#[test]
fn acting_commands_need_a_bus_and_reading_ones_default_to_simulation() {
    let acts = "
stop
shutdown
move --id 1 --angle-deg 1
speed --id 1 --speed-dps 1
torque --id 1 --current-a 1
motion --id 1 --position-rad 0 --kp 0 --kd 0
brake release --id 1
brake lock --id 1
zero --id 1
reset --id 1
timeout --id 1 --time-ms 500
id --new-id 7
send --id 1 stop
send --id 1 lock-brake
send --id 1 write-pid-ram --index speed-kp --value 0.5
send --id 1 raw C0 0 0 0 0 0 0 0";
    for arguments in acts.lines().skip(1) {
        let output = run_words(arguments);
        let message = text(&output.stderr);
        assert_eq!((output.status.code(), text(&output.stdout)), (Some(2), ""), "{arguments}");
        assert!(message.starts_with("error: --bus is missing: "), "{arguments}: {message}");
        assert!(
            message.contains("MYACTUATOR_BUS") && message.contains("or sim for simulated ones")
        );
    }
    for arguments in ["scan", "status --id 1", "send --id 1 read-status1"] {
        let output = run_words(arguments);
        assert!(output.status.success(), "{arguments}");
        assert!(text(&output.stderr).starts_with(SIMULATED), "{arguments}");
    }
}

#[test]
fn the_environment_names_a_bus_and_the_command_line_another() {
    let with = |bus: &str, arguments: &[&str]| {
        myactuator().env("MYACTUATOR_BUS", bus).args(arguments).output().unwrap()
    };
    let stopped = "motors 1 2 are stopped and run nothing (mode 0): their brakes hold them, which they report as locked; no \
                   other id has confirmed: a motor that is not named here may go on\n";
    assert_eq!(text(&with("sim:2", &["stop"]).stdout), stopped);
    assert_eq!(text(&with("sim:3", &["stop", "--bus", "sim:2"]).stdout), stopped);
    assert_eq!(with("", &["stop"]).status.code(), Some(2));
    let message = with("sim:0", &["scan"]);
    assert_eq!(message.status.code(), Some(2));
    assert!(text(&message.stderr).starts_with("error: MYACTUATOR_BUS: expected "));
}

#[test]
fn a_string_that_names_no_bus_is_refused() {
    for (bus, found) in [("usb:7", "found \"usb:7\""), ("sim:0", "found \"0\"")] {
        let (status, message) = refused(&format!("scan --bus {bus}"));
        assert_eq!(status, 2);
        assert!(message.starts_with("--bus: expected ") && message.ends_with(found), "{message}");
    }
}

#[test]
fn missing_bus_is_reported_in_one_sentence() {
    for command in [
        "scan",
        "status",
        "stop",
        "move --yes --id 1 --angle-deg 1",
        "send --id 1 read-model",
        "send --yes --id 1 reset",
    ] {
        let (status, message) = refused(&format!("{command} --bus no-such-can"));
        assert_eq!(status, 1);
        assert!(message.starts_with("there is no CAN interface \"no-such-can\": "), "{message}");
        assert!(message.contains("sim:4, can0, slcan:/dev/ttyACM0@1000000"), "{message}");
        let (status, message) = refused(&format!("{command} --bus rs485:/no/such/port@115200"));
        assert_eq!(status, 1);
        assert!(message.starts_with("there is no serial port \"/no/such/port\""), "{message}");
    }
}

#[test]
fn without_a_terminal_a_real_motor_moves_only_with_consent() {
    for command in [
        "move --id 1 --angle-deg 1",
        "speed --id 1 --speed-dps 1",
        "torque --id 1 --current-a 1",
        "motion --id 1 --position-rad 0 --kp 0 --kd 0",
        "brake release --id 1",
        "zero --id 1",
        "reset --id 1",
        "timeout --id 1 --time-ms 500",
        "id --new-id 2",
        "send --id 1 torque --current-a 1",
        "send --id 1 release-brake",
        "send --id 1 reset",
        "send --id 1 write-pid-rom --index current-kp --value 1",
        "send --id 1 raw C0 0 0 0 0 0 0 0",
    ] {
        let (status, message) = refused(&format!("{command} --bus can0"));
        assert_eq!(status, 2, "{command}");
        assert!(message.starts_with("--yes is missing"), "{command}: {message}");
    }
}

#[test]
fn every_run_is_the_same() {
    let command = "move --id 1 --angle-deg 45";
    assert_eq!(done(command), done(command));
}

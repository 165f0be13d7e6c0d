//! `myactuator encode` and `decode`.

use std::process::{Output, Stdio};

use assert_cmd::assert::OutputAssertExt;
use myactuator_host_std::explain::Dbc;
use myactuator_protocol_core::command::{MotionLimits, MotionRanges};
use myactuator_protocol_core::{Firmware, MotorId};
use serde_json::Value;

use crate::run::{lines, myactuator, objects, rows, run, run_words, text, vectors};

fn run_on(input: impl AsRef<[u8]>, arguments: &[&str]) -> Output {
    assert_cmd::Command::from(myactuator())
        .args(arguments)
        .write_stdin(input.as_ref())
        .output()
        .unwrap()
}

/// The one sentence of a refusal.
fn refusal(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    assert_eq!(text(&output.stdout), "", "{arguments:?}");
    let explained = text(&output.stderr);
    let sentence =
        explained.strip_prefix("error: ").and_then(|explained| explained.strip_suffix('\n'));
    let sentence = sentence.unwrap_or_else(|| panic!("{arguments:?}: {explained:?}"));
    assert!(!sentence.contains('\n'), "{arguments:?}: {explained:?}");
    sentence.to_owned()
}

fn string<'a>(row: &'a Value, key: &str) -> &'a str {
    row[key].as_str().unwrap()
}

fn same(explained: &Value, expected: &Value) -> bool {
    match (explained.as_f64(), expected.as_f64()) {
        (Some(explained), Some(expected)) => {
            (explained - expected).abs() <= 1e-9 * expected.abs().max(1e-300)
        }
        _ => explained == expected,
    }
}

fn same_fields(explained: &Value, expected: &Value) -> bool {
    let (Some(explained), Some(expected)) = (explained.as_object(), expected.as_object()) else {
        return false;
    };
    // If a code's name or its number is expected, the other may stand beside it.
    let has_number = |key: &str| expected.contains_key(&format!("{key}_raw"));
    let has_value = |key: &str| {
        let name = key.strip_suffix("_raw");
        name.is_some_and(|name| expected.keys().any(|key| key.starts_with(name)))
    };
    let is_known = |key: &str| expected.contains_key(key) || has_number(key) || has_value(key);
    expected
        .iter()
        .all(|(key, value)| explained.get(key).is_some_and(|explained| same(explained, value)))
        && explained.keys().map(String::as_str).all(is_known)
}

/// Decodes rows of one direction in one run, and compares all but the direction.
fn decode_rows(rows: &[Value], arguments: &[&str]) -> Vec<Value> {
    let input: Vec<&str> = rows.iter().map(|row| string(row, "frame")).collect();
    let output = run_on(input.join("\n"), &[&["decode", "--json"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stdout));
    let explained = objects(&output);
    assert_eq!(explained.len(), rows.len());
    for (explained, row) in explained.iter().zip(rows) {
        assert_eq!(explained["raw"], row["frame"]);
        assert_eq!(explained["bus"], row["bus"]);
        assert_eq!(explained["id"], row["id"], "{row}");
        assert_eq!(explained["name"], row["name"], "{row}");
        assert_eq!(explained["canonical"], row["frame"], "{row}");
        assert_eq!(explained.get("error"), None);
    }
    explained
}

/// Frames, and the direction, id and fields that they are decoded to.
const READINGS: &str = r#"
# An id in either byte (7.3 and 7.4) makes it a reply, on either bus.
300#7900010000000200 => reply "all" {"access":"read","access_raw":1,"motor_id":2}
300#7900010000000002 => reply "all" {"access":"read","access_raw":1,"motor_id":2}
3E CD 08 79 00 01 00 00 00 02 00 F9 F5 => reply "all" {"access":"read","access_raw":1,"motor_id":2}
300#7900010000004202 => reply "all" {"access":"read","access_raw":1,"motor_id":2}
3E CD 08 79 00 01 00 00 00 00 02 79 54 => reply "all" {"access":"read","access_raw":1,"motor_id":2}
# A write and its echo are the same bytes.
300#7900000000000002 => either "all" {"access":"write","access_raw":0,"motor_id":2}
# An acceleration of 0 is no planning (2.20.2).
141#4303000000000000 => command 1 {"index":"speed-deceleration","index_raw":3,"acceleration_dps2":0}
# What no firmware knows, is raw.
141#C001020304050607 => command 1 {}
241#C001020304050607 => reply 1 {}
241#F100000000000000 => reply 1 {}
"#;

#[test]
fn frames_that_are_easily_misread_are_read_right() {
    for (frame, reading) in rows(READINGS) {
        let bus = if frame.contains('#') { "can" } else { "rs485" };
        let output = run(&["decode", "--json", "--bus", bus, frame]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stdout));
        let explained = &objects(&output)[0];
        let fields = explained["fields"].to_string();
        let read = format!("{} {} {fields}", string(explained, "direction"), explained["id"]);
        assert_eq!(read, reading, "{frame}");
        assert!(explained["canonical"].is_string(), "{explained}");
    }
    // The identifier says which motor answers, whatever the first byte says (5.4).
    let explained = &objects(&run(&["decode", "--json", "501#02E66682EB550000"]))[0];
    assert_eq!((&explained["id"], &explained["fields"]["id_byte"]), (&1.into(), &2.into()));
    let output = run(&["decode", "141#C001020304050607"]);
    let raw = "141#C001020304050607  motor 1  command  raw: command byte 0xC0 is not known";
    assert_eq!(lines(&output), [raw]);
}

#[test]
fn every_example_of_the_manual_is_explained() {
    for (bus, direction) in
        [("can", "command"), ("can", "reply"), ("rs485", "command"), ("rs485", "reply")]
    {
        let mut rows = vectors(bus);
        rows.retain(|row| row["direction"] == direction);
        let explained = decode_rows(&rows, &["--bus", bus, "--direction", direction]);
        for (explained, row) in explained.iter().zip(&rows) {
            assert_eq!(explained["direction"], direction, "{row}");
            assert!(same_fields(&explained["fields"], &row["fields"]), "{explained}\n{row}");
        }
        // Without --direction the answer is right or open, and never open if a CAN identifier decides it.
        for (explained, row) in decode_rows(&rows, &["--bus", bus]).iter().zip(&rows) {
            let is_open = explained["direction"] == "either";
            let may_be_open = bus == "rs485" || string(row, "frame").starts_with("300#");
            assert!(
                explained["direction"] == direction || is_open && may_be_open,
                "{explained}\n{row}"
            );
            let as_reply = explained.get("fields_if_reply").filter(|_| direction == "reply");
            let fields = as_reply.unwrap_or(&explained["fields"]);
            assert!(same_fields(fields, &row["fields"]), "{explained}\n{row}");
        }
    }
}

/// The flags that encode a command with these fields: the JSON keys in kebab-case. A code is given by
/// its number under the name's flag.
fn flags(row: &Value) -> Vec<String> {
    let fields = row["fields"].as_object().unwrap().iter();
    let flag = |(key, value): (&String, &Value)| {
        let name = key.strip_suffix("_raw").unwrap_or(key).replace('_', "-");
        let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        [format!("--{name}"), value]
    };
    fields.flat_map(flag).collect()
}

#[test]
fn every_command_of_the_manual_is_encoded_from_its_fields() {
    for bus in ["can", "rs485"] {
        let rows = vectors(bus);
        let commands: Vec<&Value> =
            rows.iter().filter(|row| row["direction"] == "command").collect();
        assert_eq!(commands.len(), if bus == "can" { 50 } else { 48 });
        for row in commands {
            let id = row["id"].as_str().map_or_else(|| row["id"].to_string(), str::to_owned);
            let flags = flags(row);
            let mut arguments = vec!["encode", "--firmware", "v4.3", "--bus", bus, "--id", &id];
            arguments.push(string(row, "name"));
            arguments.extend(flags.iter().map(String::as_str));
            let output = run(&arguments);
            assert_eq!(text(&output.stderr), "", "{arguments:?}");
            assert_eq!(lines(&output), [string(row, "frame")], "{arguments:?}");
            assert_eq!(output.status.code(), Some(0));
        }
    }
}

/// Commands, and the frames that they are.
const FRAMES: &str = "
absolute-position --angle -360 --max-speed 500 => 141#A400F4016073FFFF
read-pid --index current-kp => 141#3001000000000000
read-acceleration --index position-deceleration => 141#4201000000000000
function-control --index can-id-filter --value 1 => 141#2002000001000000
function-control --index clear-multi-turn => 141#2001000000000000
function-control --index 7 --value -90 => 141#20070000A6FFFFFF
active-reply --command read-multi-turn-encoder --enable on --interval 10 => 141#B660010100000000
active-reply --command 0x60 --enable off --interval 0 => 141#B660000000000000
set-baud-rate --baud-rate can-1m-rs485-500k => 141#B400000000000001
speed --speed-dps 100 --max-torque-pct 0 => 141#A200000010270000
single-turn-position --direction counter-clockwise --angle 359.99 --max-speed 1 => 141#A60101009F8C0000
# The ends of the ranges: 2147483647 and -2147483648 hundredths, 32767 and -32768.
absolute-position --angle-deg 21474836.47 --max-speed-dps 65535 => 141#A400FFFFFFFFFF7F
absolute-position --angle-deg -21474836.48 --max-speed-dps 0 => 141#A400000000000080
speed --speed-dps 21474836.47 --max-torque-pct 255 => 141#A2FF0000FFFFFF7F
torque --current-a 327.67 => 141#A1000000FF7F0000
torque --current-a -327.68 => 141#A100000000800000
write-acceleration --index 0 --acceleration-dps2 100 => 141#4300000064000000
write-acceleration --index 0 --acceleration-dps2 60000 => 141#4300000060EA0000
# 0 is no planning (2.20.2, 2.21.1).
write-acceleration --index 0 --acceleration-dps2 0 => 141#4300000000000000
# Codes that the manual does not name are sent as they are.
read-acceleration --index 4 => 141#4204000000000000
set-baud-rate --baud-rate 255 => 141#B4000000000000FF
communication-loss-protection --timeout-ms 4294967295 => 141#B3000000FFFFFFFF
active-reply --command 0x9A --enable true --interval-ms 655350 => 141#B69A01FFFF000000
set-encoder-zero --offset-pulses -2147483648 => 141#6300000000000080
# -0.1 as a single: 0xBDCCCCCD.
write-pid-ram --index 7 --value -0.1 => 141#31070000CDCCCCBD
";

#[test]
fn codes_have_names_and_flags_may_be_short() {
    for (arguments, frame) in rows(FRAMES) {
        let output = run_words(&format!("encode --id 1 {arguments}"));
        assert_eq!(text(&output.stderr), "", "{arguments}");
        assert_eq!(lines(&output), [frame], "{arguments}");
    }
    // Bus and id may stand after the command; bus-id names no motor.
    assert_eq!(lines(&run(&["encode", "stop", "--id", "32"])), ["160#8100000000000000"]);
    let read = run(&["encode", "bus-id", "--access", "read"]);
    assert_eq!(lines(&read), ["300#7900010000000000"]);
    assert_eq!(lines(&run(&["encode", "--id", "all", "stop"])), ["280#8100000000000000"]);
}

/// Commands, and the sentences that refuse them.
const REFUSALS: &str = r#"
--id 33 stop => --id: motor id must be 1 to 32, or all, but "33" was given
--id 0 stop => --id: motor id must be 1 to 32, or all, but "0" was given
--id -1 stop => --id: motor id must be 1 to 32, or all, but "-1" was given
stop => --id is missing: say which motor, 1 to 32, or all
--id 1 absolute-position --max-speed 1 --angle 21474836.48 => --angle-deg: angle must be -21474836.48 to 21474836.47 deg, but 21474836.48 deg was given
--id 1 absolute-position --max-speed 1 --angle -21474836.49 => --angle-deg: angle must be -21474836.48 to 21474836.47 deg, but -21474836.49 deg was given
--id 1 absolute-position --max-speed 1 --angle up => --angle-deg: angle must be -21474836.48 to 21474836.47 deg, but "up" is no number
--id 1 absolute-position --max-speed 65536 --angle 1 => --max-speed-dps: maximum speed must be 1 to 65535 dps (0: no limit in direct tracking), but 65536 dps was given
--id 1 absolute-position --max-speed -1 --angle 1 => --max-speed-dps: maximum speed must be 1 to 65535 dps (0: no limit in direct tracking), but -1 dps was given
--id 1 speed --max-torque 0 --speed 21474836.48 => --speed-dps: speed must be -21474836.48 to 21474836.47 dps, but 21474836.48 dps was given
--id 1 speed --speed 1 --max-torque 256 => --max-torque-pct: maximum torque must be 1 to 255 % of rated current (0: no limit in a speed command), but 256 % of rated current was given
--id 1 torque --current 327.68 => --current-a: torque current must be -327.68 to 327.67 A, but 327.68 A was given
--id 1 torque --current NaN => --current-a: torque current must be -327.68 to 327.67 A, but NaN A was given
--id 1 torque --current -inf => --current-a: torque current must be -327.68 to 327.67 A, but -inf A was given
--id 1 single-turn-position --max-speed 1 --direction clockwise --angle 360.01 => --angle-deg: single-turn angle must be 0 to 360 deg, but 360.01 deg was given
--id 1 single-turn-position --max-speed 1 --direction left --angle 1 => --direction: direction must be clockwise (0), counter-clockwise (1) or another number up to 255, but "left" was given
--id 1 write-acceleration --index 0 --acceleration-dps2 99 => --acceleration-dps2: acceleration must be 100 to 60000 dps/s (0: no planning), but 99 dps/s was given
--id 1 write-acceleration --index 0 --acceleration-dps2 60001 => --acceleration-dps2: acceleration must be 100 to 60000 dps/s (0: no planning), but 60001 dps/s was given
--id 1 write-acceleration --index 0 --acceleration-dps2 0.4 => --acceleration-dps2: acceleration must be 100 to 60000 dps/s (0: no planning), but 0.4 dps/s was given
--id 1 communication-loss-protection --timeout-ms 4294967296 => --timeout-ms: time must be 1 to 4294967295 ms (0: off as a protection time), but 4294967296 ms was given
--id 1 communication-loss-protection --timeout-ms 1.5 => --timeout-ms: time must be 1 to 4294967295 ms (0: off as a protection time) in steps of 1 ms, but 1.5 ms was given
--id 1 active-reply --command 0x60 --enable on --interval 4 => --interval-ms: report interval must be 0 to 655350 ms in steps of 10 ms, but 4 ms was given
--id 1 active-reply --command 0x60 --enable on --interval 655360 => --interval-ms: report interval must be 0 to 655350 ms, but 655360 ms was given
--id 1 set-encoder-zero --offset-pulses 2147483648 => --offset-pulses: encoder position must be -2147483648 to 2147483647 pulses, but 2147483648 pulses was given
--id 1 write-pid-ram --index 7 --value inf => --value: gain must be a finite number, but inf was given
--id 1 set-baud-rate --baud-rate 256 => --baud-rate: baud code must be can-500k-rs485-115200 (0), can-1m-rs485-500k (1), rs485-1m (2) or another number up to 255, but "256" was given
--id 1 read-acceleration --index 256 => --index: acceleration index must be position-acceleration (0), position-deceleration (1), speed-acceleration (2), speed-deceleration (3) or another number up to 255, but "256" was given
--id 1 read-acceleration --index fast => --index: acceleration index must be position-acceleration (0), position-deceleration (1), speed-acceleration (2), speed-deceleration (3) or another number up to 255, but "fast" was given
--id 1 function-control --index 2 --value 2 => --value: switch must be on or off, but "2" was given
--id 1 function-control --index 5 --value 300 => --value: motor id must be 1 to 32, but 300 was given
--id 1 function-control --index 1 --value 1 => --value: this form of function-control (0x20) takes none
--id 1 function-control --index 3 => --value is missing: Whether it is on. Either on or off.
bus-id --access write --motor-id 33 => --motor-id: motor id must be 1 to 32, but 33 was given
bus-id --access write => --motor-id is missing: The new id. 1 to 32.
bus-id --access read --motor-id 2 => --motor-id: this form of bus-id (0x79) takes none
bus-id --access 2 => access must be 0 to 1, but 2 was given
--id 1 bus-id --access read => --id: bus-id (0x79) reaches every motor that is connected and names none: send it to all
--id 1 --firmware v4.3 motion --position-rad 0 --velocity-rad-s 0 --kp 0 --kd 0 --torque-nm 24.1 => --torque-nm: torque must be -24 to 24 N·m, but 24.1 N·m was given
--id 1 --firmware v4.3 motion --position-rad 0 --velocity-rad-s 0 --kp 0 --kd 0 --torque-nm x => --torque-nm: torque must be -24 to 24 N·m, but "x" is no number
--id all motion --position-rad 0 --velocity-rad-s 0 --kp 0 --kd 0 --torque-nm 0 => --id: motion goes to one motor only: name its id
--firmware v4.4 bus-id --access read => --firmware: v4.4 has no bus-id (0x79)
--id 1 read-single-turn-angle-v4.4 => --firmware: v4.3 has no read-single-turn-angle-v4.4 (0x94): take read-single-turn-angle
--id 1 --firmware v4.5 stop => --firmware: firmware must be one of v4.3 v4.4, but "v4.5" was given
--id 1 motion --position-rad 0 --velocity-rad-s 0 --kp 0 --kd 0 --torque-nm 0 => --firmware or --ranges is missing: the scales of motion mode differ between firmwares, and the wrong ones multiply the torque
--id 1 raw C0 01 => expected eight bytes, found 2
--id 1 --firmware v4.4 motion --position-rad 0 --velocity-rad-s 0 --kp 0 --kd 0 --torque-nm 0 => --ranges is missing: the scales of this firmware's motion mode depend on the motor
--id 1 --firmware v4.3 --bus rs485 motion --position-rad 0 --velocity-rad-s 0 --kp 0 --kd 0 --torque-nm 0 => --bus: motion exists on CAN only
--id 1 --bus rs485 active-reply --command 0x60 --enable on --interval 10 => --bus: active-reply (0xB6) exists on CAN only
"#;

#[test]
fn wrong_values_are_refused_in_one_sentence_with_what_is_allowed() {
    for (arguments, sentence) in rows(REFUSALS) {
        let words: Vec<&str> = ["encode"].into_iter().chain(arguments.split(' ')).collect();
        assert_eq!(refusal(&words), sentence, "{arguments}");
    }
    // A refusal of the parser is one sentence, too.
    for (arguments, part) in [
        (vec!["encode", "--id", "1", "speeed"], "'speeed'"),
        (vec!["encode", "--id", "1", "absolute-position", "--angle", "1"], "--max-speed-dps"),
        (vec!["encode", "--id", "1", "stop", "--hard"], "'--hard'"),
        (vec!["encode", "--bus", "spi", "--id", "1", "stop"], "[possible values: can, rs485]"),
        (vec!["encode", "--id", "1"], "requires a subcommand"),
        (vec!["encode", "nonsense"], "'nonsense'; --help lists them"),
        (vec!["decode", "--direction", "up"], "[possible values: command, reply]"),
        (vec!["decode", "--binary", "--bus", "can"], "--binary"),
        (vec!["decode", "no-such-file"], "\"no-such-file\" is neither a frame on can nor a file"),
    ] {
        let sentence = refusal(&arguments);
        assert!(sentence.contains(part), "{arguments:?}: {sentence}");
    }
}

#[test]
fn a_firmware_has_its_own_layouts_and_commands() {
    // -9000 hundredths are 0xFFFFDCD8; V4.3's angle is the last two bytes, 65535 hundredths.
    for (revision, name, degrees) in [
        ("v4.3", "read-single-turn-angle", 655.35),
        ("v4.4", "read-single-turn-angle-v4.4", -90.0),
        ("V4.4", "read-single-turn-angle-v4.4", -90.0),
    ] {
        let frame = "241#94000000D8DCFFFF";
        let explained = objects(&run(&["decode", "--json", "--firmware", revision, frame]));
        assert_eq!(
            (&explained[0]["name"], &explained[0]["opcode"]),
            (&name.into(), &"0x94".into())
        );
        assert_eq!(explained[0]["fields"]["angle_deg"], degrees, "{revision}");
    }
    // V4.4 has dropped 0x79, and the scales of its motion mode depend on the motor.
    let output = run(&["decode", "--firmware", "v4.4", "300#7900010000000000"]);
    assert!(lines(&output)[0].ends_with("raw: command byte 0x79 is not known"), "{output:?}");
    let motion = "501#01E66682EB550000";
    let explained = objects(&run(&["decode", "--json", "--firmware", "v4.4", motion]));
    assert_eq!(explained[0]["fields"]["torque_nm"], Value::Null);
    let of_60 = ["--ranges", "12.566,45,500,5,60"];
    let explained =
        objects(&run(&[&["decode", "--json", "--firmware", "v4.4", motion], &of_60[..]].concat()));
    // 2901 of 4095 steps from -60 to 60.
    assert_eq!(explained[0]["fields"]["torque_nm"], 2901.0 * 120.0 / 4095.0 - 60.0);
}

#[test]
fn each_line_of_a_can_log_is_explained_with_time_and_interface() {
    let log = "\
# a comment, and an empty line

141#8100000000000000\r
  can0  141   [8]  81 00 00 00 00 00 00 00
(0000000012.000345) vcan1 141#8100000000000000
 (2015-07-10 06:57:32.249713)  can0  141   [8]  81 00 00 00 00 00 00 00
(1436509052.249713123) can0 141#F1
(1436509052.249713) can0 141##1A4
 (1436509053.000001)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME
(1436509052.249713) can0 nonsense
";
    let output = run_on(log, &["decode", "--json", "-"]);
    assert_eq!(output.status.code(), Some(1));
    let explained = objects(&output);
    let (stops, errors) = explained.split_at(4);
    assert!(stops.iter().all(|object| object["name"] == "stop" && object["error"].is_null()));
    for object in errors {
        assert!(object["error"].is_string() && object["canonical"].is_null(), "{object}");
    }
    let kept: Vec<[Option<&str>; 3]> = explained
        .iter()
        .map(|object| ["time", "interface", "raw"].map(|key| object.get(key)?.as_str()))
        .collect();
    let stop = Some("141#8100000000000000");
    let (can0, vcan1) = (Some("can0"), Some("vcan1"));
    assert_eq!(
        kept,
        [
            [None, None, stop],
            [None, can0, stop],
            [Some("0000000012.000345"), vcan1, stop],
            [Some("2015-07-10 06:57:32.249713"), can0, stop],
            // Lines that are not frames of a motor have them, too.
            [Some("1436509052.249713123"), can0, Some("141#F1")],
            [Some("1436509052.249713"), can0, Some("141##1A4")],
            [
                Some("1436509053.000001"),
                can0,
                Some("20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME")
            ],
            // A line that no tool writes is printed as it is.
            [None, None, Some("(1436509052.249713) can0 nonsense")],
        ]
    );
    let output = run_on(log, &["decode"]);
    let explained = lines(&output);
    let stop = "141#8100000000000000  motor 1  command  stop (0x81)";
    assert_eq!(explained[..2], [stop.to_owned(), format!("can0 {stop}")]);
    let sentence = "this is a CAN FD frame, and the protocol uses classic CAN frames only";
    assert_eq!(explained[5], format!("(1436509052.249713) can0 141##1A4  error: {sentence}"));
}

/// Input must not control the terminal that shows it.
#[test]
fn control_characters_are_shown_not_sent() {
    // Escape, bell, delete, and U+009B, which starts a sequence as escape does.
    let line = "\u{1b}[31m\u{7}\u{7f}\u{9b}é";
    let shown = r"\u001b[31m\u0007\u007f\u009bé";
    let output = run_on(line, &["decode"]);
    assert!(lines(&output)[0].starts_with(&format!("{shown}  error: ")), "{output:?}");
    let output = run_on(line, &["decode", "--json"]);
    assert!(text(&output.stdout).contains(&format!("\"raw\":\"{shown}\"")), "{output:?}");
    assert_eq!(objects(&output)[0]["raw"], line);
    let output = run_on(line, &["decode", "--bus", "rs485"]);
    assert_eq!(lines(&output)[0].matches(shown).count(), 2, "{output:?}");
    let output = run_on("(1) c\u{1b}n0 141#8100000000000000", &["decode"]);
    assert!(lines(&output)[0].starts_with(r"(1) c\u001bn0 141#81"), "{output:?}");

    let name = "no\u{1b}\u{7f}\nfile";
    for arguments in [
        ["decode", name].as_slice(),
        &["decode", "--binary", name],
        &["encode", "--id", name, "stop"],
        &["status", "--bus", name],
        &["status", "--bus", "slcan:/dev/\u{1b}\u{7f}\n@1000000"],
        &["sim", "--fault", name],
        &["sim", "--memory", "/dev/null/\u{1b}\u{7f}\n"],
    ] {
        let output = run(arguments);
        let explained = text(&output.stderr);
        let sentence = explained.strip_suffix('\n').unwrap();
        assert!(sentence.contains(r"\u001b\u007f\u000a"), "{arguments:?}: {explained:?}");
        assert!(!sentence.contains(char::is_control), "{arguments:?}: {explained:?}");
    }
}

#[test]
fn bytes_that_mean_nothing_show_in_the_canonical_frame() {
    let output = run(&["decode", "--json", "141#81000000000000FF"]);
    let explained = &objects(&output)[0];
    assert_eq!(explained["canonical"], "141#8100000000000000");
    assert_eq!(explained["raw"], "141#81000000000000FF");
    let keys: Vec<&String> = explained.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["raw", "bus", "id", "direction", "name", "opcode", "fields", "canonical"]);
}

#[test]
fn rs485_bytes_come_as_arguments_text_or_raw() {
    let frame = "3E 01 08 76 00 00 00 00 00 00 00 7C 07";
    let expected = frame.to_owned() + "  motor 1  command  reset (0x76)";
    let raw: Vec<u8> = frame.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    let decimal: Vec<String> = raw.iter().map(u8::to_string).collect();
    let on = ["decode", "--bus", "rs485"];
    for output in [
        run(&[&on[..], &[frame]].concat()),
        run(&[&on[..], &frame.split(' ').collect::<Vec<_>>()].concat()),
        run(&[&on[..], &[frame.replace(' ', "").as_str()]].concat()),
        run_on(frame.replace(' ', ", 0x"), &on),
        run_on(decimal.join(","), &on),
        run_on(&raw, &["decode", "--binary"]),
        run_on(&raw, &["decode", "--binary", "--bus", "rs485", "-"]),
    ] {
        assert_eq!(lines(&output), [&expected]);
        assert_eq!(output.status.code(), Some(0));
    }
}

#[test]
fn noise_between_rs485_frames_is_reported() {
    let frame = "3E 01 08 76 00 00 00 00 00 00 00 7C 07";
    let output = run_on(
        format!("00 3E {frame} {frame}\nnonsense\n3E 01"),
        &["decode", "--bus", "rs485", "--json"],
    );
    assert_eq!(output.status.code(), Some(1));
    let explained = objects(&output);
    let raw: Vec<&Value> = explained.iter().map(|object| &object["raw"]).collect();
    assert_eq!(raw, ["00 3E", frame, frame, "nonsense", "3E 01"]);
    let errors: Vec<bool> = explained.iter().map(|object| object.get("error").is_some()).collect();
    assert_eq!(errors, [true, false, false, true, true]);
}

#[test]
fn unreadable_file_does_not_keep_others_from_being_read() {
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("decode.log");
    std::fs::write(&path, "141#8100000000000000\n").unwrap();
    let inputs = ["no-such-file", path.to_str().unwrap(), "142#8000000000000000"];
    let explained = [
        "141#8100000000000000  motor 1  command  stop (0x81)",
        "142#8000000000000000  motor 2  command  shutdown (0x80)",
    ];
    for (inputs, status) in [(&inputs[..], 2), (&inputs[1..], 0)] {
        let output = run(&[&["decode"], inputs].concat());
        assert_eq!(lines(&output), explained);
        assert_eq!(output.status.code(), Some(status));
    }
}

#[test]
fn reader_that_leaves_early_is_no_error() {
    let frames = "141#8100000000000000\n".repeat(100_000);
    let mut child = myactuator()
        .arg("decode")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    // The program may leave before it has read everything.
    let _ = std::io::Write::write_all(&mut child.stdin.take().unwrap(), frames.as_bytes());
    let output = child.wait_with_output().unwrap();
    output.assert().code(0).stderr("");
}

#[test]
fn a_dbc_file_is_for_one_motor_or_all_and_for_a_firmware() {
    let all = Dbc::new(Firmware::V4_3);
    let limits = MotionLimits { torque_nm: 60.0, ..MotionRanges::V4_3.limits() };
    let ranges = MotionRanges::new(limits).ok();
    for (arguments, file) in [
        ("dbc", all),
        (
            "dbc --id 3 --ranges 12.5,45,500,5,60",
            Dbc { ranges, motor: MotorId::new(3).ok(), ..all },
        ),
        ("dbc --firmware v4.4", Dbc::new(Firmware::V4_4)),
    ] {
        run_words(arguments).assert().code(0).stderr("").stdout(file.to_string());
    }
    assert_eq!(refusal(&["dbc", "--id", "33"]), "--id: motor id must be 1 to 32, but 33 was given");
}

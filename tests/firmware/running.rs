//! What the tests have in common: a program of a board, and how it is brought to move its motors.

use std::env;
use std::fs::File;
use std::io::Write as _;
use std::time::Duration;

use myactuator_host_std::sim::Fleet;
use myactuator_tests::emulator::board::Board;
use myactuator_tests::emulator::drives::Adapter;
use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::log::Line;

/// How many drives there are.
pub(crate) const DRIVES: u8 = 4;
/// Longer than anything takes that has no time of its own.
pub(crate) const PATIENCE: Duration = Duration::from_secs(5);
/// How long it is watched that nothing starts by itself: for longer than the firmware, which was stopped by something else,
/// takes no press of its button, a second since then. Whatever comes late makes it longer.
pub(crate) const WATCHED: Duration = Duration::from_millis(1_200);
/// How long motors that were not heard need until they are told to hold again, from which time on the firmware takes no
/// press for a second: on RS485 four silent motors get one more stop only every 400 ms, and each then answers two
/// questions of a round of 40 ms.
pub(crate) const BACK: Duration = Duration::from_millis(700);
/// At this speed, degrees a second, a movement is well under way: at its fastest it has 30.
pub(crate) const UNDER_WAY_DPS: f32 = 15.0;

/// A board's program, which is named after its bus.
pub(crate) type Program = (Board, &'static str);

pub(crate) const MPS2_RS485: Program = (Board::Mps2An386, "rs485");
pub(crate) const MPS2_CAN: Program = (Board::Mps2An386, "can");
pub(crate) const MPS2_RS485_ASYNC: Program = (Board::Mps2An386, "rs485_async");
pub(crate) const MPS2_CAN_ASYNC: Program = (Board::Mps2An386, "can_async");
pub(crate) const NETDUINO_RS485: Program = (Board::NetduinoPlus2, "rs485");

/// Makes a test of each function for each program; or for two that have every board, wire and loop between them, where
/// what is tried is the application's affair, which all of them have in common, and so are tests without an emulator.
macro_rules! on {
    (every program: $($name:ident)+) => {
        $crate::firmware::running::on! {
            MPS2_RS485 as mps2_rs485, MPS2_RS485_ASYNC as mps2_rs485_async, MPS2_CAN as mps2_can,
            MPS2_CAN_ASYNC as mps2_can_async, NETDUINO_RS485 as netduino_rs485: $($name)+
        }
    };
    (two programs: $($name:ident)+) => {
        $crate::firmware::running::on! {
            MPS2_CAN_ASYNC as mps2_can_async, NETDUINO_RS485 as netduino_rs485: $($name)+
        }
    };
    ($($program:ident as $module:ident),+: $($name:ident)+) => {
        $crate::firmware::running::on!(@all [$($program as $module),+] [$($name)+]);
    };
    (@all [$($program:ident as $module:ident),+] $names:tt) => {
        $($crate::firmware::running::on!(@one $program $module $names);)+
    };
    (@one $program:ident $module:ident [$($name:ident)+]) => {
        mod $module {
            $(#[test] fn $name() { super::$name($crate::firmware::running::$program); })+
        }
    };
}
pub(crate) use on;

/// Tells what this machine could not show: in the file that `NOT_JUDGED` names, of which `.ci/run` tells, or here.
pub(crate) fn not_judged(what: &str) {
    let file = env::var_os("NOT_JUDGED");
    let told = file.map(|file| File::options().create(true).append(true).open(file));
    match told {
        Some(Ok(mut file)) => writeln!(file, "{what}").expect("a file that can be written"),
        Some(Err(error)) => panic!("NOT_JUDGED names no file: {error}"),
        None => println!("NOT JUDGED: {what}"),
    }
}

pub(crate) fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// A firmware that waits for the button.
pub(crate) fn stopped(program: Program) -> Firmware {
    stopped_behind(program, Adapter::Kind)
}

/// The same, behind an adapter.
pub(crate) fn stopped_behind((board, program): Program, adapter: Adapter) -> Firmware {
    let fleet = Fleet::new(DRIVES).brakes(true);
    let mut firmware = Firmware::start(board, program, &fleet, adapter);
    firmware.wait_for("Started { cause: Power }", PATIENCE);
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware
}

/// A firmware whose motors are well under way.
pub(crate) fn moving(program: Program) -> Firmware {
    let mut firmware = stopped(program);
    go(&mut firmware);
    firmware
}

/// Presses the button, and waits until the motors are well under way.
#[track_caller]
pub(crate) fn go(firmware: &mut Firmware) {
    let pressed = firmware.drives().now();
    firmware.press();
    firmware.wait_for("State(Running)", PATIENCE);
    firmware.wait_until_moving(UNDER_WAY_DPS);
    // Who takes this for standing still would take anything for it.
    if firmware.truth.moved_for(pressed).iter().any(Duration::is_zero) {
        firmware.fail("nobody has seen the shafts move");
    }
}

/// Waits for the trouble that begins so, for which the application stops the motors at once. Gives what it
/// says of it.
#[track_caller]
pub(crate) fn stops_for(firmware: &mut Firmware, trouble: &str) -> Line {
    let told = firmware.wait_for(&format!("Trouble({trouble}"), PATIENCE);
    let then = firmware.wait_for("", PATIENCE);
    if then.text != "State(Stopping)" {
        firmware.fail(&format!("{told}, then {then}"));
    }
    told
}

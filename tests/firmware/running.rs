//! What the tests share: the boards' programs, and the steps that start and stop their motors.

use std::env;
use std::fs::File;
use std::io::Write as _;
use std::panic::{self, AssertUnwindSafe};
use std::thread;
use std::time::Duration;

use myactuator_host_std::sim::Fleet;
use myactuator_tests::emulator::board::Board;
use myactuator_tests::emulator::drives::Adapter;
use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::log::Line;
use myactuator_tests::emulator::processor;

/// The number of drives.
pub(crate) const DRIVES: u8 = 4;
/// The cycle of the emulated boards.
const CYCLE: Duration = Duration::from_millis(20);
/// How often the application queries a motor's angle, its errors and its run time: each cycle has one query.
pub(crate) const QUERY_PERIOD: Duration = CYCLE.saturating_mul(3 * DRIVES as u32);
/// For each step without a time limit of its own.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(5);
/// How long a test watches that nothing starts on its own. After a stop that was not caused by the button, the firmware
/// ignores the button for one second. This is longer, so that the next press counts even if something came late.
pub(crate) const WATCH: Duration = Duration::from_millis(1_200);
/// For this time after its start the firmware ignores a press: the motors may have been running until then.
const IGNORES_PRESSES: Duration = Duration::from_millis(1_000);
/// How long silent motors need, once they are reachable again, until the firmware has sent them a command to hold. From
/// then on it ignores the button for one second. On RS485 four silent motors get another stop only every 400 ms, and
/// each then answers two queries of a round of 80 ms.
pub(crate) const RECOVERY: Duration = Duration::from_millis(700);
/// From this speed on a movement is well under way, degrees per second. The highest speed of the movement is 30.
pub(crate) const UNDER_WAY_DPS: f32 = 15.0;

/// A board and its program, which is named after its bus.
pub(crate) type Program = (Board, &'static str);

pub(crate) const MPS2_RS485: Program = (Board::Mps2An386, "rs485");
pub(crate) const MPS2_CAN: Program = (Board::Mps2An386, "can");
pub(crate) const MPS2_RS485_ASYNC: Program = (Board::Mps2An386, "rs485_async");
pub(crate) const MPS2_CAN_ASYNC: Program = (Board::Mps2An386, "can_async");
pub(crate) const NETDUINO_RS485: Program = (Board::NetduinoPlus2, "rs485");

/// Makes a test of each function for each program. `two programs` is for what only the application decides: all
/// programs share it, and tests without an emulator cover it as well. The two have every board, wire and kind of loop
/// between them.
macro_rules! tests_on {
    (every program: $($name:ident)+) => {
        $crate::firmware::running::tests_on! {
            MPS2_RS485 as mps2_rs485, MPS2_RS485_ASYNC as mps2_rs485_async, MPS2_CAN as mps2_can,
            MPS2_CAN_ASYNC as mps2_can_async, NETDUINO_RS485 as netduino_rs485: $($name)+
        }
    };
    (two programs: $($name:ident)+) => {
        $crate::firmware::running::tests_on! {
            MPS2_CAN_ASYNC as mps2_can_async, NETDUINO_RS485 as netduino_rs485: $($name)+
        }
    };
    ($($program:ident as $module:ident),+: $($name:ident)+) => {
        $crate::firmware::running::tests_on!(@all [$($program as $module),+] [$($name)+]);
    };
    (@all [$($program:ident as $module:ident),+] $names:tt) => {
        $($crate::firmware::running::tests_on!(@one $program $module $names);)+
    };
    (@one $program:ident $module:ident [$($name:ident)+]) => {
        mod $module {
            $(#[test] fn $name() {
                use $crate::firmware::running;
                running::judge(|| super::$name(running::$program));
            })+
        }
    };
}
pub(crate) use tests_on;

/// Runs a test. A failure counts as not judged if the machine was slower than the firmware tolerates.
pub(crate) fn judge(test: impl FnOnce()) {
    let Err(failure) = panic::catch_unwind(AssertUnwindSafe(test)) else { return };
    let longest = processor::longest_in_this_test();
    if !processor::excuses_failure(longest) {
        panic::resume_unwind(failure);
    }
    let text = failure.downcast_ref::<String>().map(String::as_str);
    let text = text.or(failure.downcast_ref::<&str>().copied()).unwrap_or_default();
    let (thread, first) = (thread::current(), text.lines().next().unwrap_or_default());
    let test = thread.name().unwrap_or_default();
    not_judged(&format!(
        "{test}: this machine kept threads waiting for {longest:?} of a tenth of a second: {first}"
    ));
}

/// Reports what this machine could not show: in the file that `NOT_JUDGED` names, which `.ci/run` reads, or here.
pub(crate) fn not_judged(what: &str) {
    let file = env::var_os("NOT_JUDGED");
    let opened = file.map(|file| File::options().create(true).append(true).open(file));
    match opened {
        Some(Ok(mut file)) => {
            writeln!(file, "{what}").expect("NOT_JUDGED names a file that can be written")
        }
        Some(Err(error)) => panic!("the file that NOT_JUDGED names cannot be opened: {error}"),
        None => println!("NOT JUDGED: {what}"),
    }
}

pub(crate) fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// Firmware that waits for the button.
pub(crate) fn stopped(program: Program) -> Firmware {
    stopped_with(program, Adapter::Ideal)
}

/// The same, with this adapter.
pub(crate) fn stopped_with((board, program): Program, adapter: Adapter) -> Firmware {
    let fleet = Fleet::new(DRIVES).brakes(true);
    let mut firmware = Firmware::start(board, program, &fleet, adapter);
    firmware.wait_for("Started { cause: Power }", TIMEOUT);
    firmware.wait_for("State(Stopped)", TIMEOUT);
    thread::sleep(IGNORES_PRESSES);
    firmware
}

/// Firmware whose motors are well under way.
pub(crate) fn moving(program: Program) -> Firmware {
    let mut firmware = stopped(program);
    start_moving(&mut firmware);
    firmware
}

/// Presses the button, and waits until the motors are well under way.
#[track_caller]
pub(crate) fn start_moving(firmware: &mut Firmware) {
    let pressed = firmware.drives().now();
    firmware.press();
    firmware.wait_for("State(Running)", TIMEOUT);
    firmware.wait_until_moving(UNDER_WAY_DPS);
    // A check that misses this motion would pass for any motion.
    if firmware.truth.moved_for(pressed).iter().any(Duration::is_zero) {
        firmware.fail("the motors run, but no motion of a shaft was observed");
    }
}

/// Waits until the application reports a trouble that begins with `trouble`, and stops the motors at once. Returns its
/// report.
#[track_caller]
pub(crate) fn wait_for_trouble(firmware: &mut Firmware, trouble: &str) -> Line {
    let reported = firmware.wait_for(&format!("Trouble({trouble}"), TIMEOUT);
    let next = firmware.wait_for("", TIMEOUT);
    if next.text != "State(Stopping)" {
        firmware.fail(&format!("after \"{reported}\": expected State(Stopping), found \"{next}\""));
    }
    reported
}

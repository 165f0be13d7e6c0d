//! First contact, motion and shutdown; and long motion without a lost reply.

use std::time::Duration;

use myactuator_protocol_core::command::{BrakeCommand, LockBrake, Shutdown, Stop};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::{Channel, Data, MotorId, Target};
use myactuator_tests::emulator::drives::Heard;
use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::fleet::state;

use super::running::{
    DRIVES, MPS2_CAN, MPS2_CAN_ASYNC, MPS2_RS485, MPS2_RS485_ASYNC, NETDUINO_RS485, Program,
    QUERY_PERIOD, TIMEOUT, WATCH, judge, not_judged, stopped, tests_on, wait_for_trouble,
};

tests_on! {
    every program:
    motors_are_found_moved_and_shut_down
}

/// How far a shaft may be from its set-point, degrees.
const FOLLOWS_DEG: f32 = 2.0;
/// How old the angle that is reported may be.
const ANGLE_AGE: Duration = QUERY_PERIOD.saturating_add(Duration::from_millis(60));
/// How far the application moves the motors, degrees.
const AMPLITUDE_DEG: f32 = 20.0;
/// Within this time a press of the button stops the motors: the application polls the button every 20 ms.
const BUTTON_STOPS: Duration = Duration::from_millis(100);
/// An interrupt at the deepest point of the stack, which need not occur in the first seconds: 104 bytes that the
/// processor stores, and the stack of the handler.
const INTERRUPT_BYTES: u32 = 256;
/// The size of the stack in the boards' memory.x.
const STACK_BYTES: u32 = 12 * 1024;
/// The size of the boards' receive queues.
const QUEUE_BYTES: u32 = 256;
/// So many more bytes than in the first seconds may wait: a reply of each drive, as lines of the CAN adapter, which are
/// the longest.
const REPLIES_BYTES: u32 = 22 * DRIVES as u32;

/// The replies in a second, one in a hundred, that may be lost because the machine was busy for less time than is
/// noticed otherwise. The test reports each.
const FEW_LOST: usize = DRIVES as usize;

/// The least number of set-points per second that each motor answers: one in each cycle of 20 ms, except for some that
/// come late.
const LEAST_RATE: u32 = 45;

/// A busy machine may miss the least rate, and the test reports that. Only wrong firmware misses it by more than this
/// factor.
const BUSY_TIMES: u32 = 3;

fn motors_are_found_moved_and_shut_down(program: Program) {
    let mut firmware = stopped(program);
    firmware.check_stays_stopped(WATCH);
    let heard = firmware.drives().heard_since(Instant::ZERO);
    // Stops, and queries: angle, errors, run time, and whether a shaft stands behind its brake.
    let harmless = [0x81, 0x92, 0x9A, 0x9C, 0xB1];
    let is_harmless = |heard: &Heard| harmless.contains(&heard.packet.data[0]);
    assert_eq!(heard.iter().find(|heard| !is_harmless(heard)), None);
    for motor in MotorId::all().take(DRIVES.into()) {
        let channel = Channel::Command(Target::Motor(motor));
        let first = heard.iter().find(|heard| heard.packet.channel == channel);
        assert_eq!(first.map(|heard| heard.packet.data), Some(Stop.encode()), "{motor}");
    }
    for sample in firmware.samples() {
        assert!(sample.angle_deg.abs() < 0.1, "{sample:?}");
    }

    firmware.press();
    for id in 1..=DRIVES {
        let found = firmware.wait_for("Found", TIMEOUT);
        assert_eq!(found.number("motor"), Some(id.into()), "{found}");
        // RMD-X6-P20-60, as the maker's catalogue calls it.
        assert!(found.text.contains("X6-60"), "{found}");
        assert!(found.text.contains("20250512"), "{found}");
    }
    for id in 1..=DRIVES {
        let ready = firmware.wait_for("Ready", TIMEOUT);
        assert_eq!(ready.number("motor"), Some(id.into()), "{ready}");
    }
    firmware.wait_for("State(Running)", TIMEOUT);
    let running = firmware.drives().now();
    for drive in firmware.drives().handles() {
        assert_eq!(state(drive).brake, BrakeCommand::RELEASE);
    }

    let seconds: Vec<_> = (0..3).map(|_| firmware.wait_for_second()).collect();
    assert!(firmware.is_light_on());
    for id in 1..=DRIVES {
        let measured = firmware.wait_for("Measured", TIMEOUT);
        assert_eq!(measured.number("motor"), Some(id.into()), "{measured}");
        // The report comes at the end of the range, where the shaft is slow.
        let measured_deg = measured.number("angle").unwrap_or(f64::NAN) as f32 / 100.0;
        let now = firmware.drives().now();
        let before = Instant::from_micros(now.as_micros() - ANGLE_AGE.as_micros() as u64);
        let (least_deg, most_deg) = firmware.truth.reached_deg(before, now)[usize::from(id) - 1];
        assert!(
            (least_deg - FOLLOWS_DEG..most_deg + FOLLOWS_DEG).contains(&measured_deg),
            "expected a true angle of the last {ANGLE_AGE:?}, {least_deg} to {most_deg}, found \"{measured}\""
        );
    }
    let now = firmware.drives().now();
    for (least_deg, most_deg) in firmware.truth.reached_deg(running, now) {
        assert!(least_deg > -FOLLOWS_DEG, "{least_deg}");
        assert!((most_deg - AMPLITUDE_DEG).abs() < FOLLOWS_DEG, "{most_deg}");
    }
    let slowest = seconds.iter().map(|second| second.slowest).min().unwrap_or(0);
    keeps_rate(&firmware, program, slowest);

    let pressed = firmware.drives().now();
    firmware.press();
    wait_for_trouble(&mut firmware, "Button");
    firmware.wait_for("Stopped { unconfirmed: [] }", TIMEOUT);
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(WATCH);
    firmware.check_still(pressed, BUTTON_STOPS);

    let held = firmware.drives().now();
    firmware.hold();
    firmware.wait_for("State(ShuttingDown)", TIMEOUT);
    firmware.wait_for("State(Stopped)", TIMEOUT);
    // The motors hold until the brakes had time to lock.
    let heard = firmware.drives().heard_since(held);
    let is = |command: Data| move |heard: &&Heard| heard.packet.data == command;
    let locked = heard.iter().rfind(is(LockBrake.encode())).map(|heard| heard.at);
    let off = heard.iter().find(is(Shutdown.encode())).map(|heard| heard.at);
    let (Some(locked), Some(off)) = (locked, off) else {
        panic!("expected brakes locked and motors shut down, found {heard:?}")
    };
    assert!(
        off >= locked + Quirks::SLOW_BRAKE_MAX,
        "brakes locked at {locked:?}, but shut down at {off:?}"
    );
    for drive in firmware.drives().handles() {
        let state = state(drive);
        assert!(!state.output_on && state.brake == BrakeCommand::LOCK, "{state:?}");
    }
    firmware.check_stays_stopped(WATCH);
    firmware.check_log();
}

tests_on! {
    MPS2_CAN as ten_seconds_of_mps2_can, NETDUINO_RS485 as ten_seconds_of_netduino_rs485:
    nothing_is_lost_in_ten_seconds
}
fn nothing_is_lost_in_ten_seconds(program: Program) {
    nothing_is_lost(program, 10);
}

/// Run these by hand: `-- --ignored nothing_is_lost_in_ten_minutes`. Add the name of a program to run only that one.
mod nothing_is_lost_in_ten_minutes {
    use super::*;

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_rs485() {
        judge(|| nothing_is_lost(MPS2_RS485, 600));
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_rs485_async() {
        judge(|| nothing_is_lost(MPS2_RS485_ASYNC, 600));
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_can() {
        judge(|| nothing_is_lost(MPS2_CAN, 600));
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_can_async() {
        judge(|| nothing_is_lost(MPS2_CAN_ASYNC, 600));
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_netduino_rs485() {
        judge(|| nothing_is_lost(NETDUINO_RS485, 600));
    }
}

/// Whether each motor answers its set-points. Fails if it answers far too few.
fn keeps_rate(firmware: &Firmware, program: Program, slowest: u32) -> bool {
    if slowest < LEAST_RATE / BUSY_TIMES {
        firmware.fail(&format!(
            "expected {LEAST_RATE} answered set-points per second, found {slowest}"
        ));
    } else if slowest < LEAST_RATE {
        not_judged(&format!(
            "the rate of {program:?}: a motor answered {slowest} set-points per second and not \
             {LEAST_RATE}; this machine was too busy, or the firmware is too slow"
        ));
    }
    slowest >= LEAST_RATE
}

fn nothing_is_lost(program: Program, seconds: u32) {
    let mut firmware = stopped(program);
    firmware.press();
    firmware.wait_for("State(Running)", TIMEOUT);
    let (mut stack, mut queued, mut lost_before) = (0, 0, 0);
    for second in 1..=seconds {
        let report = firmware.wait_for_second();
        if report.dropped > 0 {
            firmware.fail(&format!("{report:?}: expected no byte lost on the board"));
        }
        // Set-points that were neither answered nor lost were not sent: the emulator is slower than real time, and
        // replies are late.
        let lost_now = report.lost - lost_before;
        lost_before = report.lost;
        if !keeps_rate(&firmware, program, report.slowest + lost_now) {
            return;
        }
        let (lost, excused) = (report.lost as usize, firmware.excused());
        if lost > excused + second as usize * FEW_LOST {
            firmware.fail(&format!("{report:?}: expected no lost reply on an undisturbed bus"));
        }
        if second <= 5 {
            (stack, queued) = (report.stack, report.queued);
        }
        if report.stack > stack + INTERRUPT_BYTES || report.stack > STACK_BYTES * 3 / 4 {
            firmware.fail(&format!("{report:?}: the stack grows, at first it was {stack}"));
        }
        if report.queued > queued + REPLIES_BYTES || report.queued > QUEUE_BYTES * 3 / 4 {
            firmware.fail(&format!("{report:?}: the queue grows, at first it was {queued}"));
        }
        if second == seconds && lost > 0 {
            not_judged(&format!(
                "lost replies of {program:?}: {lost} were lost; this machine was too busy, or the firmware loses them"
            ));
        }
    }
    firmware.check_log();
}

//! First contact, motion, shutdown; and that it goes on like that.

use std::time::Duration;

use myactuator_protocol_core::command::{BrakeCommand, LockBrake, Shutdown, Stop};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::time::Instant;
use myactuator_protocol_core::{Channel, Data, MotorId, Target};
use myactuator_tests::emulator::board::Wire;
use myactuator_tests::emulator::drives::Heard;
use myactuator_tests::fleet::state;

use super::running::{
    DRIVES, MPS2_CAN, MPS2_CAN_ASYNC, MPS2_RS485, MPS2_RS485_ASYNC, NETDUINO_RS485, PATIENCE,
    Program, WATCHED, not_judged, on, stopped, stops_for,
};

on! {
    every program:
    motors_are_found_moved_and_shut_down
}

/// How far from its place a shaft may be that follows a set-point, degrees.
const FOLLOWS_DEG: f32 = 2.0;
/// How far the application moves the motors, degrees.
const AMPLITUDE_DEG: f32 = 20.0;
/// An application that is stopped by the button has stopped the motors by then: it looks at the button
/// every millisecond.
const BUTTON_STOPS: Duration = Duration::from_millis(100);
/// An interrupt at the deepest place of the stack, which need not come in the first seconds: 104 bytes that
/// the processor puts there, and what the handler takes.
const INTERRUPT_BYTES: u32 = 256;
/// The stack that the boards' memory.x has.
const STACK_BYTES: u32 = 12 * 1024;
/// Bytes that the boards' receive queues hold.
const QUEUE_BYTES: u32 = 256;
/// So many more may wait than in the first seconds, for once: a reply of each drive, as the CAN adapter's
/// lines, the longest.
const REPLIES_BYTES: u32 = 22 * DRIVES as u32;

/// Lost replies that may be excused besides one a second: two moments in which the emulator stands still, each
/// with a question on its way besides the drives' set-points. Where more are, the machine was too busy to say
/// anything of lost replies, and that is told.
const AT_FIRST: usize = 2 * (DRIVES as usize + 1);

/// What the emulator takes to hand a byte to the firmware or to take one from it: twice the some 30 µs that
/// were seen, for time is real, and the machine may be busy.
const EMULATOR_BYTE_US: u32 = 60;

/// A machine that does other things beside misses the least rate, which is told; by more than so many times only
/// firmware does.
const BUSY_TIMES: u32 = 3;

/// The least set-points a second that each motor answers: what the wire carries, were it not for the
/// emulator's bytes.
fn least_rate(program: &str) -> u32 {
    let exchange_us = match Wire::of_program(program) {
        // Two frames of 13 bytes, each 0.13 ms on the line; the drive's 0.8 ms; a pause of 0.1 ms.
        Ok(Wire::Rs485) => 2 * 130 + 800 + 100 + 2 * 13 * EMULATOR_BYTE_US,
        // Several motors at a time, but the adapter's serial port carries one byte after another: 22 of the
        // command, 2 that accept it, 22 of the reply.
        _ => (22 + 2 + 22) * EMULATOR_BYTE_US,
    };
    // A question every 10 ms goes in between.
    (1_000_000 / exchange_us - 100) / u32::from(DRIVES)
}

fn motors_are_found_moved_and_shut_down(program: Program) {
    let mut firmware = stopped(program);
    firmware.check_stays_stopped(WATCHED);
    let heard = firmware.drives().heard_since(Instant::ZERO);
    // Stops, and questions: angle, errors, run time.
    let harmless = [0x81, 0x92, 0x9A, 0xB1];
    let is_harmless = |heard: &Heard| harmless.contains(&heard.packet.data[0]);
    assert_eq!(heard.iter().find(|heard| !is_harmless(heard)), None);
    for motor in MotorId::all().take(DRIVES.into()) {
        let channel = Channel::Command(Target::Motor(motor));
        let first = heard.iter().find(|heard| heard.packet.channel == channel);
        assert_eq!(first.map(|heard| heard.packet.data), Some(Stop.encode()), "{motor}");
    }
    for look in firmware.looks() {
        assert!(look.angle_deg.abs() < 0.1, "{look:?}");
    }

    firmware.press();
    for id in 1..=DRIVES {
        let found = firmware.wait_for("Found", PATIENCE);
        assert_eq!(found.number("motor"), Some(id.into()), "{found}");
        // RMD-X6-P20-60, as the maker's catalogue calls it.
        assert!(found.text.contains("X6-60"), "{found}");
        assert!(found.text.contains("20250512"), "{found}");
    }
    for id in 1..=DRIVES {
        let ready = firmware.wait_for("Ready", PATIENCE);
        assert_eq!(ready.number("motor"), Some(id.into()), "{ready}");
    }
    firmware.wait_for("State(Running)", PATIENCE);
    let running = firmware.drives().now();
    for drive in firmware.drives().handles() {
        assert_eq!(state(drive).brake, BrakeCommand::RELEASE);
    }

    let seconds: Vec<_> = (0..3).map(|_| firmware.wait_for_second()).collect();
    assert!(firmware.is_light_on());
    for id in 1..=DRIVES {
        let told = firmware.wait_for("Measured", PATIENCE);
        assert_eq!(told.number("motor"), Some(id.into()), "{told}");
        // It is told at the end of a way, where a shaft is slow.
        let told_deg = told.number("angle").unwrap_or(f64::NAN) as f32 / 100.0;
        let true_deg = firmware.looks()[usize::from(id) - 1].angle_deg;
        assert!((told_deg - true_deg).abs() < FOLLOWS_DEG, "{told}, but it is at {true_deg}");
    }
    let now = firmware.drives().now();
    for (least_deg, most_deg) in firmware.truth.reached_deg(running, now) {
        assert!(least_deg > -FOLLOWS_DEG, "{least_deg}");
        assert!((most_deg - AMPLITUDE_DEG).abs() < FOLLOWS_DEG, "{most_deg}");
    }
    let (least, slowest) =
        (least_rate(program.1), seconds.iter().map(|second| second.slowest).min());
    let slowest = slowest.unwrap_or(0);
    if slowest < least / BUSY_TIMES {
        firmware
            .fail(&format!("a motor answered {slowest} set-points in a second, and not {least}"));
    } else if slowest < least {
        not_judged(&format!(
            "the rate of {program:?}: this machine was too busy, or a motor answers {slowest} set-points in a \
             second and not {least}"
        ));
    }

    let pressed = firmware.drives().now();
    firmware.press();
    stops_for(&mut firmware, "Button");
    firmware.wait_for("Stopped { unconfirmed: [] }", PATIENCE);
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(WATCHED);
    firmware.check_still(pressed, BUTTON_STOPS);

    let held = firmware.drives().now();
    firmware.hold();
    firmware.wait_for("State(ShuttingDown)", PATIENCE);
    firmware.wait_for("State(Stopped)", PATIENCE);
    // Brakes have time to lock while the motors hold.
    let heard = firmware.drives().heard_since(held);
    let is = |command: Data| move |heard: &&Heard| heard.packet.data == command;
    let locked = heard.iter().rfind(is(LockBrake.encode())).map(|heard| heard.at);
    let off = heard.iter().find(is(Shutdown.encode())).map(|heard| heard.at);
    let (Some(locked), Some(off)) = (locked, off) else { panic!("{heard:?}") };
    assert!(off >= locked + Quirks::SLOW_BRAKE_MAX, "{locked:?} {off:?}");
    for drive in firmware.drives().handles() {
        let state = state(drive);
        assert!(!state.output_on && state.brake == BrakeCommand::LOCK, "{state:?}");
    }
    firmware.check_stays_stopped(WATCHED);
    firmware.check_log();
}

on! {
    MPS2_CAN as a_minute_of_mps2_can, NETDUINO_RS485 as a_minute_of_netduino_rs485:
    nothing_is_lost_in_a_minute
}
fn nothing_is_lost_in_a_minute(program: Program) {
    nothing_is_lost(program, 60);
}

/// By hand: `-- --ignored nothing_is_lost_in_ten_minutes`, with a program's name for it alone.
mod nothing_is_lost_in_ten_minutes {
    use super::*;

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_rs485() {
        nothing_is_lost(MPS2_RS485, 600);
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_rs485_async() {
        nothing_is_lost(MPS2_RS485_ASYNC, 600);
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_can() {
        nothing_is_lost(MPS2_CAN, 600);
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_mps2_can_async() {
        nothing_is_lost(MPS2_CAN_ASYNC, 600);
    }

    #[test]
    #[ignore = "takes ten minutes"]
    fn of_netduino_rs485() {
        nothing_is_lost(NETDUINO_RS485, 600);
    }
}

fn nothing_is_lost(program: Program, seconds: u32) {
    let mut firmware = stopped(program);
    firmware.press();
    firmware.wait_for("State(Running)", PATIENCE);
    let (mut stack, mut queued) = (0, 0);
    for second in 1..=seconds {
        let told = firmware.wait_for_second();
        if told.dropped > 0 {
            firmware.fail(&format!("{told:?}: bytes were lost on the board"));
        }
        // Where the machine had something else to do, a reply may be late.
        let (lost, excused) = (told.lost as usize, firmware.excused());
        if lost > excused {
            firmware.fail(&format!("{told:?}: a reply was lost on a clean bus"));
        }
        if second <= 5 {
            (stack, queued) = (told.stack, told.queued);
        }
        if told.stack > stack + INTERRUPT_BYTES || told.stack > STACK_BYTES * 3 / 4 {
            firmware.fail(&format!("{told:?}: the stack grows, it was {stack}"));
        }
        if told.queued > queued + REPLIES_BYTES || told.queued > QUEUE_BYTES * 3 / 4 {
            firmware.fail(&format!("{told:?}: more and more bytes wait, {queued} at first"));
        }
        if second == seconds && excused > second as usize + AT_FIRST {
            not_judged(&format!(
                "lost replies of {program:?}: this machine was too busy, {lost} of up to {excused} are excused"
            ));
        }
    }
    firmware.check_log();
}

//! The application on CAN, and its end.

use board_stm32f4::{Countdown, MOTORS, TimeBase, end, motors};
use bxcan::Frame;
use myactuator_mcu_example::{Board, Movement, RestartCause, Setup, run};
use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::io::CanMaster;
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::{Packet, wire};

use super::mailboxes::Mailboxes;
use super::port::CanPort;

/// How long a frame may wait for a mailbox: the time of some other frames.
const FRAME_MICROS: u32 = 2_000;

/// Runs the application on the bus forever.
pub fn run_can(port: CanPort, time: TimeBase, board: &mut impl Board, cause: RestartCause) -> ! {
    let mut bus = CanMaster::<_, _, MOTORS>::new(port, time, Config::CAN);
    let movement = Movement::Motion { ranges: MotionRanges::V4_3, kp: 50.0, kd: 2.0 };
    let setup = Setup { search: motors(), ..Setup::new(movement) };
    run(&mut bus, board, setup, cause)
}

/// The end after a panic, a fault, or an exception without a handler: stops the motors, and restarts.
pub extern "C" fn end_on_can(at: u32) -> ! {
    end(at, take_bus, say)
}

/// Takes the bus, and drops what was about to be sent: it may be a set-point.
fn take_bus() -> Mailboxes {
    let mut mailboxes = Mailboxes::take();
    mailboxes.abort();
    mailboxes
}

/// Sends a packet, and waits until it was sent, so that the reset does not take it back. Gives up on a bus that takes
/// nothing.
fn say(mailboxes: &mut Mailboxes, packet: &Packet) {
    let Some(frame) = wire::can::encode::<Frame>(packet) else { return };
    if mailboxes.send(&frame) {
        Countdown::of_micros(FRAME_MICROS).wait_unless(|| mailboxes.are_empty());
    }
}

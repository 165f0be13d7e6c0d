//! The end of a firmware that cannot go on.

use cortex_m::peripheral::SCB;
use myactuator_mcu_example::{RestartCause, last_words};
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::master::MotorSet;

use crate::note::leave_note;

/// Leaves a note of the cause, sends the last words to these motors, and resets.
///
/// Interrupts are off from here on. `send` is called with each packet in turn. It has to poll the controller's
/// registers, to give up on a bus that takes nothing, and, where answers and commands share a line, to wait for as long
/// as a motor needs to answer. `linger` is called last, before the reset.
///
/// The note comes first, so that it is there when the watchdog bites because something goes wrong here, too.
pub fn restart(
    cause: RestartCause,
    motors: MotorSet,
    mut send: impl FnMut(&Packet),
    linger: impl FnOnce(),
) -> ! {
    cortex_m::interrupt::disable();
    leave_note(cause);
    for packet in last_words(motors) {
        send(&packet);
    }
    linger();
    SCB::sys_reset()
}

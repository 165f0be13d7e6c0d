//! The end of a firmware that cannot go on.

use cortex_m::peripheral::SCB;
use myactuator_mcu_example::{RestartCause, last_words};
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::master::MotorSet;

use crate::note::leave_note;

/// Leaves a note of the cause, sends the last words to these motors, and resets.
///
/// From here on there are no interrupts. `send` is called with one packet after the other: it has to
/// poll the controller's registers, to give up on a bus that takes nothing, and to wait as long as a
/// motor needs to answer where answers and commands share a line. `linger` comes last, before the reset.
///
/// The note comes first: should the rest go wrong too, it is there when the watchdog bites.
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

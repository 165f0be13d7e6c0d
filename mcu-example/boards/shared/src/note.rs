//! A note for the next start, in RAM that a reset leaves unchanged.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use myactuator_mcu_example::RestartCause;

/// The note's first word is this and the cause's number. The second word is the complement of the first. After power-on
/// RAM holds random values; these two words tell a note from them.
const MAGIC: u32 = 0x0FF1_CE00;

struct Note(UnsafeCell<MaybeUninit<[u32; 2]>>);

// SAFETY: only one thread runs on these processors, and each access is a volatile one of whole words. An exception in
// between finds a note or none, but never a wrong one, since the second word proves the first.
unsafe impl Sync for Note {}

// The start-up code initialises nothing in this section.
#[unsafe(link_section = ".uninit.NOTE")]
static NOTE: Note = Note(UnsafeCell::new(MaybeUninit::uninit()));

/// Leaves a note of why the firmware is about to restart. A note that is there already stays: what goes wrong while a
/// firmware ends is a consequence.
pub(crate) fn leave_note(cause: RestartCause) {
    if read().is_none() {
        let first = MAGIC | number(cause);
        write([first, !first]);
    }
}

/// Takes the note of why the firmware restarted itself. None after any other start. Call it once, before anything else.
pub fn take_note() -> Option<RestartCause> {
    let cause = read();
    write([0, 0]);
    cause
}

const CAUSES: [RestartCause; 4] =
    [RestartCause::Power, RestartCause::Watchdog, RestartCause::Panic, RestartCause::Fault];

const fn number(cause: RestartCause) -> u32 {
    match cause {
        RestartCause::Power => 0,
        RestartCause::Watchdog => 1,
        RestartCause::Panic => 2,
        RestartCause::Fault => 3,
    }
}

fn read() -> Option<RestartCause> {
    // SAFETY: the pointer is to a static of this type, whose words hold some value, as any RAM does. Volatile, since
    // the value is from before this program's start.
    let [first, second] = unsafe { NOTE.0.get().cast::<[u32; 2]>().read_volatile() };
    let is_note = first == !second && first & !0xFF == MAGIC;
    CAUSES.into_iter().find(|&cause| is_note && first == MAGIC | number(cause))
}

fn write(words: [u32; 2]) {
    // SAFETY: as in `read`. Volatile, since only the next start reads it.
    unsafe { NOTE.0.get().cast::<[u32; 2]>().write_volatile(words) }
}

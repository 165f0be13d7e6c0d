//! What every firmware here shares on the emulated machine: however it ends, the emulator ends with
//! it, with exit code 0 after [`finish`]`(Ok(()))` and another after an error, a panic or a fault.
#![no_std]

use core::fmt::Debug;

use cortex_m_rt::{ExceptionFrame, exception};
use cortex_m_semihosting::{
    debug::{self, EXIT_FAILURE, EXIT_SUCCESS},
    hprintln,
};
use panic_semihosting as _; // The panic handler: prints the message, exits with a failure.

/// Ends the emulator with the firmware's outcome.
pub fn finish(outcome: Result<(), impl Debug>) -> ! {
    match outcome {
        Ok(()) => debug::exit(EXIT_SUCCESS),
        Err(error) => {
            hprintln!("failed: {:?}", error);
            debug::exit(EXIT_FAILURE);
        }
    }
    unreachable!("no emulator or debugger took the exit call")
}

/// Without this a fault would loop forever.
///
/// # Safety
/// For the processor to call, never for a program.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    panic!("hard fault at {:#010x}", frame.pc())
}

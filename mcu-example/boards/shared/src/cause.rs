//! What ended a firmware: a panic or a fault.

use myactuator_mcu_example::RestartCause;

unsafe extern "C" {
    /// The first byte of the code; cortex-m-rt's linker script has it.
    static __stext: u16;
    /// The byte behind its last.
    static __etext: u16;
}

/// The instruction `udf #0`, which no compiler makes: it puts `udf #254` where nothing may go on.
const UDF: u16 = 0xDE00;

/// What led to an exception that was raised at this address.
///
/// panic-probe tells a panic by the log, and ends in `udf #0`, which is a fault. One that comes while it
/// tells that, as of a stack that is used up, is the cause then.
pub fn cause_of_end(address: u32) -> RestartCause {
    let instruction = core::ptr::with_exposed_provenance::<u16>(address as usize);
    let code = &raw const __stext..&raw const __etext;
    let is_panic = code.contains(&instruction)
        && instruction.is_aligned()
        // SAFETY: there is code, which may be read as the half words that it consists of.
        && unsafe { instruction.read_volatile() } == UDF;
    if is_panic { RestartCause::Panic } else { RestartCause::Fault }
}

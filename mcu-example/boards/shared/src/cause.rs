//! What ended a firmware: a panic or a fault.

use myactuator_mcu_example::RestartCause;

unsafe extern "C" {
    /// The first byte of the code; cortex-m-rt's linker script has it.
    static __stext: u16;
    /// The byte after its last.
    static __etext: u16;
}

/// The instruction `udf #0`. The compiler itself never emits it: for code that must not be reached it uses `udf #254`.
const UDF: u16 = 0xDE00;

/// The cause of an exception that was raised at this address.
///
/// panic-probe logs a panic, and ends in `udf #0`, which is a fault. If another fault comes while it logs, such as a
/// stack overflow, that is the cause.
pub fn cause_of_end(address: u32) -> RestartCause {
    let instruction = core::ptr::with_exposed_provenance::<u16>(address as usize);
    let code = &raw const __stext..&raw const __etext;
    let is_panic = code.contains(&instruction)
        && instruction.is_aligned()
        // SAFETY: this is code, which may be read as the half words of which it consists.
        && unsafe { instruction.read_volatile() } == UDF;
    if is_panic { RestartCause::Panic } else { RestartCause::Fault }
}

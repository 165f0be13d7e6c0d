//! Exceptions that never return, and trust nothing that was before them.

/// Defines exceptions that put the stack pointer back to the top of the stack before anything else, and
/// go on in a function that does not return: `on_fresh_stack!(HardFault, DefaultHandler => function)`,
/// where `function` is an `extern "C" fn(u32) -> !`. It is given the address of the instruction that was
/// to come next, which [`cause_of_end`](crate::cause_of_end) wants; 0 where that is lost.
///
/// A stack that has overflowed is one of the reasons for a fault. Whatever lies on the stack is lost.
/// `DefaultHandler` is every exception and interrupt that nobody handles.
#[macro_export]
macro_rules! on_fresh_stack {
    ($($exception:ident),+ => $function:path) => {$(
        /// An exception, entered by the processor alone.
        #[allow(non_snake_case, reason = "cortex-m-rt's vectors have these names")]
        #[unsafe(no_mangle)]
        #[unsafe(naked)]
        unsafe extern "C" fn $exception() -> ! {
            const _: extern "C" fn(u32) -> ! = $function;
            ::core::arch::naked_asm!(
                // The processor has put eight words onto the stack, the seventh is the address. A stack
                // that has overflowed has no place for them.
                "movs r0, #0",
                "mrs r1, msp",
                "ldr r2, =_stack_end",
                "cmp r1, r2",
                "blo 1f",
                "adds r1, #32",
                "ldr r2, =_stack_start",
                "cmp r1, r2",
                "bhi 1f",
                "ldr r0, [r1, #-8]",
                "1:",
                // The floating point registers of what was interrupted are kept only when this one
                // uses such registers, in a place that may lie beyond the stack: forget them
                // (FPCCR.LSPACT).
                "ldr r1, =0xE000EF34",
                "ldr r2, [r1]",
                "bic r2, r2, #1",
                "str r2, [r1]",
                "ldr r1, =_stack_start",
                "msr msp, r1",
                "isb",
                "b {function}",
                function = sym $function,
            )
        }
    )+};
}

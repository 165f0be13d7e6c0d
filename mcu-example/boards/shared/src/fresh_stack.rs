//! Exceptions that never return, and trust nothing that was before them.

/// Defines an exception that puts the stack pointer back to the top of the stack before anything else,
/// and goes on in a function that does not return: `on_fresh_stack!(HardFault => function)`, where
/// `function` is an `extern "C" fn() -> !`.
///
/// A stack that has overflowed is one of the reasons for a fault. Whatever lies on the stack is lost.
#[macro_export]
macro_rules! on_fresh_stack {
    ($exception:ident => $function:path) => {
        /// An exception, entered by the processor alone.
        #[allow(non_snake_case, reason = "cortex-m-rt's vectors have these names")]
        #[unsafe(no_mangle)]
        #[unsafe(naked)]
        unsafe extern "C" fn $exception() -> ! {
            const _: extern "C" fn() -> ! = $function;
            ::core::arch::naked_asm!(
                // The floating point registers of what was interrupted are kept only when this one
                // uses such registers, in a place that may lie beyond the stack: forget them
                // (FPCCR.LSPACT).
                "ldr r0, =0xE000EF34",
                "ldr r1, [r0]",
                "bic r1, r1, #1",
                "str r1, [r0]",
                "ldr r0, =_stack_start",
                "msr msp, r0",
                "isb",
                "b {function}",
                function = sym $function,
            )
        }
    };
}

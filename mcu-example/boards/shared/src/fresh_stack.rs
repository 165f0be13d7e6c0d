//! Exceptions that never return, and do not rely on the state before them.

/// Defines exceptions that first set the stack pointer back to the top of the stack, and then call a function that does
/// not return: `on_fresh_stack!(HardFault, DefaultHandler => function)`, where `function` is an `extern "C" fn(u32) ->
/// !`. Its argument is the address of the next instruction, for [`cause_of_end`](crate::cause_of_end), or 0 if that is
/// lost.
///
/// One reason for a fault is a stack overflow. What is on the stack is lost. `DefaultHandler` stands for every
/// exception and interrupt without a handler.
#[macro_export]
macro_rules! on_fresh_stack {
    ($($exception:ident),+ => $function:path) => {$(
        /// An exception. Only the processor enters it.
        #[allow(non_snake_case, reason = "cortex-m-rt's vectors have these names")]
        #[unsafe(no_mangle)]
        #[unsafe(naked)]
        unsafe extern "C" fn $exception() -> ! {
            const _: extern "C" fn(u32) -> ! = $function;
            ::core::arch::naked_asm!(
                // The processor has pushed eight words; the seventh is the address. A stack that has overflowed has no
                // room for them.
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
                // The floating point registers of the interrupted code are saved only when this exception uses such
                // registers, and the place for them may be beyond the stack. So give up saving them (FPCCR.LSPACT).
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

//! Counts instructions, exactly and the same on every machine: the emulator executes one in 64 ns
//! (`-icount shift=6`), and its SysTick counts 40 ns.

use core::hint::black_box;

use cortex_m::peripheral::{Peripherals, SYST, syst::SystClkSource};

/// Starts counting. Once only.
pub(crate) fn start() {
    let mut syst = Peripherals::take().expect("nobody else takes them").SYST;
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(0x00FF_FFFF);
    syst.clear_current();
    syst.enable_counter();
}

/// Instructions of `work`: less than ten million, after which the counter begins anew.
pub(crate) fn instructions(work: impl FnOnce()) -> u32 {
    let start = SYST::get_current();
    work();
    // SysTick counts down, 24 bits. One tick is 40 ns, one instruction 64 ns.
    let ticks = start.wrapping_sub(SYST::get_current()) & 0x00FF_FFFF;
    ticks * 5 / 8
}

/// How often each job runs.
const RUNS: u32 = 1_000;

/// Instructions of one run of `job`, beyond those of `nothing`, rounded to the nearest: less than ten
/// thousand.
///
/// # Panics
/// If there are none.
pub(crate) fn cost<A, B>(
    input: &A,
    output: &mut B,
    job: impl Fn(&A, &mut B),
    nothing: impl Fn(&A, &mut B),
) -> u32 {
    let with = repeated(input, output, job);
    let without = repeated(input, output, nothing);
    assert!(with >= without + RUNS, "the compiler has left the job out");
    (with - without + RUNS / 2) / RUNS
}

fn repeated<A, B>(input: &A, output: &mut B, job: impl Fn(&A, &mut B)) -> u32 {
    instructions(|| {
        for _ in 0..RUNS {
            job(black_box(input), black_box(output));
        }
    })
}

/// What every job is compared to: a call and a return. A pointer that the compiler cannot see through,
/// so that the arguments are passed although nobody reads them.
pub(crate) fn nothing<A, B>() -> fn(&A, &mut B) {
    #[inline(never)]
    fn nothing<A, B>(_: &A, _: &mut B) {
        black_box(());
    }
    black_box(nothing::<A, B>)
}

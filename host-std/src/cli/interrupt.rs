//! The signals that ask the program to end, or to halt: while a motor moves they stop it first.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};

use signal_hook::consts::{
    SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGTERM, SIGTSTP, SIGTTOU, SIGUSR1, SIGUSR2,
    SIGVTALRM, SIGXCPU, SIGXFSZ,
};

/// Ctrl-C, Ctrl-\, Ctrl-Z, a request to end, a hang-up, the halt of a background job that prints, and whatever else
/// would end a program that does nothing about it: what a user or a limit sends to it.
const SIGNALS: [i32; 14] = [
    SIGINT, SIGQUIT, SIGTSTP, SIGTERM, SIGHUP, SIGTTOU, SIGUSR1, SIGUSR2, SIGALRM, SIGVTALRM,
    SIGPROF, SIGIO, SIGXCPU, SIGXFSZ,
];

static CAME: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);
static AGAIN: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// Set when one of them has come.
pub(super) fn flag() -> Arc<AtomicBool> {
    Arc::clone(&CAME)
}

/// The same, to be cleared by whoever has done something about it: set again, the user does not want to wait.
pub(super) fn again() -> Arc<AtomicBool> {
    Arc::clone(&AGAIN)
}

/// From now on they only set the flags.
pub(super) fn watch() -> io::Result<()> {
    for signal in SIGNALS {
        signal_hook::flag::register(signal, flag())?;
        signal_hook::flag::register(signal, again())?;
    }
    Ok(())
}

pub(super) fn has_come() -> bool {
    CAME.load(Ordering::Relaxed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of `signal(7)`, those that end or halt a program that does nothing about them, and that are not a fault of
    /// its own, which no handler may return from. SIGKILL and SIGSTOP nobody can catch; what a program reads while
    /// motors move is no terminal (SIGTTIN).
    const THAT_END_OR_HALT: [(&str, u32); 14] = [
        ("HUP", 1),
        ("INT", 2),
        ("QUIT", 3),
        ("USR1", 10),
        ("USR2", 12),
        ("ALRM", 14),
        ("TERM", 15),
        ("TSTP", 20),
        ("TTOU", 22),
        ("XCPU", 24),
        ("XFSZ", 25),
        ("VTALRM", 26),
        ("PROF", 27),
        ("IO", 29),
    ];

    #[test]
    fn no_signal_that_can_be_caught_ends_the_program_before_its_motors_are_stopped() {
        watch().unwrap();
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
        let caught = u64::from_str_radix(caught.trim(), 16).unwrap();
        for (name, number) in THAT_END_OR_HALT {
            assert!(caught & 1 << (number - 1) != 0, "SIG{name}");
        }
    }
}

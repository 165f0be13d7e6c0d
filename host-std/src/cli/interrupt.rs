//! The signals that ask the program to end, or to halt: while a motor moves they stop it first.

use std::io;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};

use signal_hook::consts::{
    SIGABRT, SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGSYS, SIGTERM, SIGTRAP, SIGTSTP,
    SIGTTOU, SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU, SIGXFSZ,
};

/// Two that have a number on Linux and no constant here.
const SIGSTKFLT: i32 = 16;
const SIGPWR: i32 = 30;

/// Ctrl-C, Ctrl-\, Ctrl-Z, a request to end, a hang-up, the halt of a background job that prints, and whatever else
/// would end a program that does nothing about it: what a user, a watchdog or a limit sends to it.
const SIGNALS: [i32; 19] = [
    SIGINT, SIGQUIT, SIGTSTP, SIGTERM, SIGHUP, SIGTTOU, SIGUSR1, SIGUSR2, SIGALRM, SIGVTALRM,
    SIGPROF, SIGIO, SIGXCPU, SIGXFSZ, SIGABRT, SIGTRAP, SIGSYS, SIGSTKFLT, SIGPWR,
];

/// They would, too. The C library keeps the first few to itself, and refuses them.
const REAL_TIME: RangeInclusive<i32> = 32..=64;

/// The kernel keeps from it whatever would end it (pid_namespaces(7)).
const FIRST_PROCESS: u32 = 1;

/// The last of them that has come; 0 for none.
static LAST: LazyLock<Arc<AtomicUsize>> = LazyLock::new(Arc::default);
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
        set_flags_at(signal)?;
    }
    for signal in REAL_TIME {
        let _ = set_flags_at(signal);
    }
    Ok(())
}

fn set_flags_at(signal: i32) -> io::Result<()> {
    // Before the flags, by which others know that there is one.
    let number = usize::try_from(signal).unwrap_or_default();
    signal_hook::flag::register_usize(signal, Arc::clone(&LAST), number)?;
    signal_hook::flag::register(signal, flag())?;
    signal_hook::flag::register(signal, again())?;
    Ok(())
}

pub(super) fn has_come() -> bool {
    CAME.load(Ordering::Relaxed)
}

/// Ends the program by the signal that has come while they were watched for, if one has. A shell ends its loop only for a
/// program that Ctrl-C has ended: one that exits, with whatever status, has dealt with it, and the next motor would
/// move. So the other keys count as Ctrl-C: it goes on behind a program that Ctrl-\ has ended, and one that Ctrl-Z has
/// halted would keep the bus.
/// Gives the exit status that a shell would report for one that cannot end a program so: none ends the first process of a
/// container, which would abort in its place.
pub(super) fn end_by_it() -> Option<u8> {
    let signal = i32::try_from(LAST.load(Ordering::SeqCst)).ok().filter(|signal| *signal != 0)?;
    let ends = if matches!(signal, SIGQUIT | SIGTSTP | SIGTTOU) { SIGINT } else { signal };
    if std::process::id() != FIRST_PROCESS {
        let _ = signal_hook::low_level::emulate_default_handler(ends);
    }
    u8::try_from(ends).ok().and_then(|number| number.checked_add(128))
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// Of `signal(7)`, those that end or halt a program that does nothing about them, and that are not a fault of
    /// its own, which no handler may return from. SIGKILL and SIGSTOP nobody can catch; what a program reads while
    /// motors move is no terminal (SIGTTIN).
    const THAT_END_OR_HALT: [(&str, u32); 19] = [
        ("HUP", 1),
        ("INT", 2),
        ("QUIT", 3),
        ("TRAP", 5),
        ("ABRT", 6),
        ("USR1", 10),
        ("USR2", 12),
        ("ALRM", 14),
        ("TERM", 15),
        ("STKFLT", 16),
        ("TSTP", 20),
        ("TTOU", 22),
        ("XCPU", 24),
        ("XFSZ", 25),
        ("VTALRM", 26),
        ("PROF", 27),
        ("IO", 29),
        ("PWR", 30),
        ("SYS", 31),
    ];

    const IN_A_PROCESS_OF_ITS_OWN: &str = "MYACTUATOR_TEST_OF_SIGNALS";

    #[test]
    fn no_signal_that_can_be_caught_ends_the_program_before_its_motors_are_stopped() {
        // Where tests hang, nobody could end a process that watches by a signal any more.
        if std::env::var_os(IN_A_PROCESS_OF_ITS_OWN).is_none() {
            let mut test = Command::new(std::env::current_exe().unwrap());
            test.arg("no_signal_that_can_be_caught").env(IN_A_PROCESS_OF_ITS_OWN, "");
            let ended = test.output().unwrap();
            let told = String::from_utf8(ended.stdout).unwrap();
            assert!(ended.status.success() && told.contains("1 passed"), "{told}");
            return;
        }
        watch().unwrap();
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
        let caught = u64::from_str_radix(caught.trim(), 16).unwrap();
        for (name, number) in THAT_END_OR_HALT {
            assert!(caught & 1 << (number - 1) != 0, "SIG{name}");
        }
        // The C library keeps the first real-time signals to itself, 35 is SIGRTMIN of all.
        for number in 35..=64 {
            assert!(caught & 1 << (number - 1) != 0, "real-time signal {number}");
        }
    }
}

//! Signals that ask the program to end or to halt. While a motor moves they stop it first.

use std::fs::File;
use std::io;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};

use rustix::process::{Signal, getpgrp, kill_current_process_group};
use rustix::termios::tcgetpgrp;
use signal_hook::consts::{
    SIGABRT, SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGSYS, SIGTERM, SIGTRAP, SIGTSTP,
    SIGTTOU, SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU, SIGXFSZ,
};

/// Two signals that have a number on Linux and no constant in the crate.
const SIGSTKFLT: i32 = 16;
const SIGPWR: i32 = 30;

/// Ctrl-C, Ctrl-\, Ctrl-Z, a request to end, a hang-up, the halt of a background job that prints, and every other
/// signal from a user, a watchdog or a limit that would end a program without a handler.
const SIGNALS: [i32; 19] = [
    SIGINT, SIGQUIT, SIGTSTP, SIGTERM, SIGHUP, SIGTTOU, SIGUSR1, SIGUSR2, SIGALRM, SIGVTALRM,
    SIGPROF, SIGIO, SIGXCPU, SIGXFSZ, SIGABRT, SIGTRAP, SIGSYS, SIGSTKFLT, SIGPWR,
];

/// Real-time signals would end it, too. The C library reserves the first few, and refuses handlers for them.
const REAL_TIME: RangeInclusive<i32> = 32..=64;

/// The first process of a container. The kernel does not deliver signals that would end it (pid_namespaces(7)).
const FIRST_PROCESS: u32 = 1;

/// The last signal that has come; 0 for none.
static LAST: LazyLock<Arc<AtomicUsize>> = LazyLock::new(Arc::default);
static CAME: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);
static AGAIN: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// Set when one of the signals has come.
pub(super) fn flag() -> Arc<AtomicBool> {
    Arc::clone(&CAME)
}

/// The same, but cleared once something was done about the signal. If it is set again, the user does not want to wait.
pub(super) fn again() -> Arc<AtomicBool> {
    Arc::clone(&AGAIN)
}

/// From now on the signals only set the flags.
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
    // Registered before the flags: when those are set, the number must be there.
    let number = usize::try_from(signal).unwrap_or_default();
    signal_hook::flag::register_usize(signal, Arc::clone(&LAST), number)?;
    signal_hook::flag::register(signal, flag())?;
    signal_hook::flag::register(signal, again())?;
    Ok(())
}

pub(super) fn has_come() -> bool {
    CAME.load(Ordering::Relaxed)
}

/// Ends the program by the signal that has come, if one has.
///
/// A shell ends its loop only if Ctrl-C itself has ended the program. If the program exits, with any status, the loop
/// goes on, and the next motor would move. Other keys therefore count as Ctrl-C: a loop goes on after a program that
/// Ctrl-\ has ended, and a program that Ctrl-Z has halted would keep the bus.
///
/// Returns the exit status that a shell would report if the signal cannot end the program. That is so for the first
/// process of a container, which would abort instead.
pub(super) fn end_by_it() -> Option<u8> {
    let signal = i32::try_from(LAST.load(Ordering::SeqCst)).ok().filter(|signal| *signal != 0)?;
    let ends = if matches!(signal, SIGQUIT | SIGTSTP | SIGTTOU) { SIGINT } else { signal };
    if matches!(signal, SIGQUIT | SIGTSTP) && has_the_keys() {
        // A script ends its loop only if the signal has reached it, too.
        let _ = kill_current_process_group(Signal::INT);
    }
    if std::process::id() != FIRST_PROCESS {
        let _ = signal_hook::low_level::emulate_default_handler(ends);
    }
    u8::try_from(ends).ok().and_then(|number| number.checked_add(128))
}

/// Whether the keys of the terminal reach this program's process group: that of the script that runs it, if one does.
fn has_the_keys() -> bool {
    let terminal = File::open("/dev/tty").and_then(|it| Ok(tcgetpgrp(it)?));
    terminal.is_ok_and(|foreground| foreground == getpgrp())
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// The signals of `signal(7)` that end or halt a program without a handler. Left out: faults of the program, from
    /// which no handler may return; SIGKILL and SIGSTOP, which cannot be caught; and SIGTTIN, since the program reads
    /// no terminal while motors move.
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
        // In a process of its own: no signal could end a hanging test process that watches for signals.
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
        // The C library reserves the first real-time signals; 35 is the highest SIGRTMIN.
        for number in 35..=64 {
            assert!(caught & 1 << (number - 1) != 0, "real-time signal {number}");
        }
    }
}

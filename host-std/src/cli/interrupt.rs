//! The signals that ask the program to end, or to halt: while a motor moves they stop it first.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP, SIGTTOU};

/// Ctrl-C, Ctrl-\, Ctrl-Z, a request to end, a hang-up, and the halt of a background job that prints.
const SIGNALS: [i32; 6] = [SIGINT, SIGQUIT, SIGTSTP, SIGTERM, SIGHUP, SIGTTOU];

static CAME: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// Set when one of them has come.
pub(super) fn flag() -> Arc<AtomicBool> {
    Arc::clone(&CAME)
}

/// From now on they only set the flag.
pub(super) fn watch() -> io::Result<()> {
    for signal in SIGNALS {
        signal_hook::flag::register(signal, flag())?;
    }
    Ok(())
}

pub(super) fn has_come() -> bool {
    CAME.load(Ordering::Relaxed)
}

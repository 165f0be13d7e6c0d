//! What leads out of the simulation.

use std::os::fd::BorrowedFd;
use std::time::Duration;

use super::{Notice, ServeError};

/// A way between a port of a simulated bus and a program outside.
pub(super) trait End {
    /// What to wait for, while more is wanted from outside.
    fn source(&self) -> Option<BorrowedFd<'_>>;

    /// Carries all that waits, both ways.
    fn pump(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError>;

    /// When to pump again at the latest, whatever else happens; `None` for not by itself.
    fn patience(&mut self) -> Option<Duration>;
}

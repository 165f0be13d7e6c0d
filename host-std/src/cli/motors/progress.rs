//! How far a motor has come: a bar on a terminal, lines elsewhere.

use std::io::{self, IsTerminal};

use myactuator_protocol_core::time::{Duration, Instant};
use rustix::termios::tcgetwinsize;

use crate::cli::{Outcome, printer, unwritten};

/// How often a line is printed where there is no terminal, and how often the bar is drawn.
const LINE_EVERY: Duration = Duration::from_millis(200);
const BAR_EVERY: Duration = Duration::from_millis(50);
/// The bar's length in characters.
const LENGTH: usize = 20;
/// The width of a terminal that does not report it.
const USUAL_WIDTH: usize = 80;
/// Goes to the start of the line and erases it.
const ERASE: &str = "\r\x1b[K";

/// Shows progress from 0 to 1. What a slow reader does not take is left out.
#[derive(Debug)]
pub(super) struct Progress {
    on_terminal: bool,
    next: Instant,
}

impl Progress {
    pub(super) fn new(start: Instant) -> Self {
        Self { on_terminal: io::stdout().is_terminal(), next: start }
    }

    /// Shows `share` of the way and a line about the motor. The line is made only if it is shown.
    pub(super) fn show(
        &mut self,
        now: Instant,
        share: f64,
        line: impl FnOnce() -> String,
    ) -> Outcome {
        if now < self.next {
            return Ok(());
        }
        let (every, text) = if self.on_terminal {
            (BAR_EVERY, format!("{ERASE}{}", bar(share, &line(), width())))
        } else {
            (LINE_EVERY, format!("{}\n", line()))
        };
        self.next = now + every;
        printer::OUT.show(text).map_err(|error| unwritten(&error))
    }
}

/// Erases the bar from the terminal, however the command ends.
impl Drop for Progress {
    fn drop(&mut self) {
        if self.on_terminal {
            // Without a reader there is no bar.
            let _ = printer::OUT.print(ERASE);
        }
    }
}

fn width() -> usize {
    let columns = tcgetwinsize(io::stdout()).map_or(0, |size| size.ws_col.into());
    if columns == 0 { USUAL_WIDTH } else { columns }
}

/// The bar and the line, cut to the width of the terminal.
fn bar(share: f64, line: &str, width: usize) -> String {
    let done = (share.clamp(0.0, 1.0) * LENGTH as f64) as usize;
    let bar = format!("[{:<LENGTH$}] {line}", "#".repeat(done));
    bar.chars().take(width.saturating_sub(1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_grows_and_stays_on_its_line() {
        assert_eq!(bar(0.5, "90 dps", 80), "[##########          ] 90 dps");
        assert_eq!(bar(-1.0, "", 80), "[                    ] ");
        assert_eq!(bar(7.0, "90 dps", 12), "[##########");
    }
}

//! How far a motor has come: a bar on a terminal, lines elsewhere.

use std::io::{self, IsTerminal};

use indicatif::{ProgressBar, ProgressStyle};
use myactuator_protocol_core::time::{Duration, Instant};

use super::session::say;
use crate::cli::Outcome;

/// How often a line is printed where there is no terminal.
const LINE_EVERY: Duration = Duration::from_millis(200);
/// The bar's length in steps.
const STEPS: u64 = 1000;

/// Shows progress from 0 to 1.
#[derive(Debug)]
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    next_line: Instant,
}

impl Progress {
    pub(super) fn new(start: Instant) -> Self {
        let bar = (io::stdout().is_terminal() && io::stderr().is_terminal()).then(bar);
        Self { bar, next_line: start }
    }

    /// Shows `share` of the way and a line about the motor, which is made only when it is shown.
    pub(super) fn show(
        &mut self,
        now: Instant,
        share: f64,
        line: impl FnOnce() -> String,
    ) -> Outcome {
        if let Some(bar) = &self.bar {
            bar.set_position((share.clamp(0.0, 1.0) * STEPS as f64) as u64);
            bar.set_message(line());
        } else if now >= self.next_line {
            self.next_line = now + LINE_EVERY;
            return say(&line());
        }
        Ok(())
    }
}

/// Whatever the end, nothing of the bar is left on the terminal.
impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(STEPS).with_style(style)
}

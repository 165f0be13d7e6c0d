//! How a subcommand ends, and what is printed.

use std::cell::Cell;
use std::fmt::Display;
use std::io::{self, Write};
use std::time::{Duration, Instant};

use super::{interrupt, printer};

/// Why a subcommand did not finish.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Unfinished {
    /// Wrong usage.
    Usage(String),
    /// It failed.
    Failed(String),
    /// It failed, and has already reported why.
    FailedAndReported,
    /// Ctrl-C or the like ended it.
    Interrupted(String),
    /// The reader of its output has gone, which is not an error: `… | head`.
    ReaderLeft,
}

pub(super) type Outcome<T = ()> = Result<T, Unfinished>;

pub(super) const FAILED: u8 = 1;
pub(super) const WRONG_USAGE: u8 = 2;
const INTERRUPTED: u8 = 130;

/// How long the last output of each stream may take after Ctrl-C and the like.
const LAST_WORDS: Duration = Duration::from_millis(300);
/// How long an error waits for what was printed before it.
pub(super) const IN_ORDER: Duration = Duration::from_millis(100);

/// Reports why it did not finish, waits until all is printed, and returns the exit status.
///
/// A slow reader may take any time (`… | less`), since no motor moves any more. After Ctrl-C or the like it is limited
/// to [`LAST_WORDS`].
pub(super) fn end(outcome: Outcome) -> u8 {
    let status = report_end(outcome);
    match wait_for_reader(&printer::OUT) {
        Ok(true) => {}
        Ok(false) => return if status == 0 { INTERRUPTED } else { status },
        Err(error) if status == 0 => return last(report_end(Err(unsaid(&error)))),
        Err(_) => {}
    }
    last(status)
}

/// Waits until the message of the panic hook is printed, and returns the exit status of a Rust program that panics.
pub(super) fn end_of_panic() -> u8 {
    last(101)
}

/// Waits until the errors are printed, and returns this exit status.
fn last(status: u8) -> u8 {
    // Nobody is left to tell if that fails.
    let _ = wait_for_reader(&printer::ERR);
    status
}

/// Reports how it ended, and returns the exit status for that.
fn report_end(outcome: Outcome) -> u8 {
    let (sentence, status) = match outcome {
        Ok(()) | Err(Unfinished::ReaderLeft) => return 0,
        Err(Unfinished::FailedAndReported) => return FAILED,
        Err(Unfinished::Failed(sentence)) => (sentence, FAILED),
        Err(Unfinished::Usage(sentence)) => (sentence, WRONG_USAGE),
        Err(Unfinished::Interrupted(sentence)) => (sentence, INTERRUPTED),
    };
    let _ = printer::OUT.wait_for(IN_ORDER);
    report("error", sentence);
    status
}

/// Waits until all is written; after Ctrl-C or the like only for a short time. Returns whether all is written.
fn wait_for_reader(stream: &printer::Printer) -> io::Result<bool> {
    let since = Cell::new(None);
    stream.wait(|| {
        if interrupt::has_come() && since.get().is_none() {
            since.set(Some(Instant::now()));
        }
        since.get().is_some_and(|since| since.elapsed() >= LAST_WORDS)
    })
}

/// Prints a line in order, and does not wait until it is written: for subcommands that run motors.
pub(super) fn say(line: &str) -> Outcome {
    printer::OUT.print(format!("{}\n", printable(line))).map_err(|error| unwritten(&error))
}

/// The command is done, but its output cannot be written.
fn unsaid(error: &io::Error) -> Unfinished {
    match unwritten(error) {
        Unfinished::Failed(why) => Unfinished::Failed(format!("{why}; the command itself is done")),
        other => other,
    }
}

/// Output that cannot be written, of subcommands on motors.
pub(super) fn unwritten(error: &io::Error) -> Unfinished {
    match error.kind() {
        io::ErrorKind::BrokenPipe => Unfinished::ReaderLeft,
        _ => Unfinished::Failed(format!("cannot write: {error}")),
    }
}

/// A mistake in the arguments.
impl From<String> for Unfinished {
    fn from(sentence: String) -> Self {
        Self::Usage(sentence)
    }
}

/// Output that cannot be written, of subcommands that only print: for them status 1 means something else.
impl From<io::Error> for Unfinished {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Self::ReaderLeft,
            _ => Self::Usage(format!("cannot write: {error}")),
        }
    }
}

/// Prints a line at once.
pub(super) fn print_line(line: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{}", printable(line))?;
    out.flush()
}

/// Prints one sentence to standard error, in order: an `error`, a `warning` or a `note`.
pub(super) fn report(kind: &str, sentence: impl Display) {
    // Nobody is left to tell if that fails.
    let _ = printer::ERR.print(format!("{kind}: {}\n", printable(&sentence.to_string())));
}

/// Replaces control characters, which may come from a decoded frame or a name, and could control the terminal. They are
/// written as in JSON, so that JSON keeps its meaning.
pub(super) fn printable(line: &str) -> String {
    let mut shown = String::with_capacity(line.len());
    for character in line.chars() {
        if character.is_control() {
            shown.push_str(&format!("\\u{:04x}", u32::from(character)));
        } else {
            shown.push(character);
        }
    }
    shown
}

//! How a subcommand ends, and what is printed.

use std::cell::Cell;
use std::fmt::Display;
use std::io::{self, Write};
use std::time::{Duration, Instant};

use super::{interrupt, printer};

/// Why a subcommand did not come to its end.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Unfinished {
    /// It was asked for wrongly.
    Usage(String),
    /// It could not be done.
    Failed(String),
    /// It failed, and has reported why.
    FailedAndReported,
    /// Ctrl-C, or the like, ended it.
    Interrupted(String),
    /// Nobody reads what it prints, which is no error: `… | head`.
    ReaderLeft,
}

pub(super) type Outcome<T = ()> = Result<T, Unfinished>;

pub(super) const FAILED: u8 = 1;
pub(super) const WRONG_USAGE: u8 = 2;
const INTERRUPTED: u8 = 130;

/// How long the last words may take after Ctrl-C and the like, each stream.
const LAST_WORDS: Duration = Duration::from_millis(300);
/// How long an error waits for what was printed before it.
pub(super) const IN_ORDER: Duration = Duration::from_millis(100);

/// Reports why it did not come to its end, sees that all is printed, and gives the exit status.
///
/// That may take as long as the reader likes, `… | less`: no motor moves any more. Once Ctrl-C or the like has
/// come it takes no longer than the last words.
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

/// Sees that the hook's words are printed, and gives the exit status of a Rust program that panics.
pub(super) fn end_of_panic() -> u8 {
    last(101)
}

/// The exit status, when the errors are reported.
fn last(status: u8) -> u8 {
    // Nobody is left to tell if that fails.
    let _ = wait_for_reader(&printer::ERR);
    status
}

/// Reports how it ended, and gives the exit status for that.
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

/// Whether all is written. It may not be once Ctrl-C or the like has come.
fn wait_for_reader(stream: &printer::Printer) -> io::Result<bool> {
    let since = Cell::new(None);
    stream.wait(|| {
        if interrupt::has_come() && since.get().is_none() {
            since.set(Some(Instant::now()));
        }
        since.get().is_some_and(|since| since.elapsed() >= LAST_WORDS)
    })
}

/// Prints a line in its turn and does not wait until it is written: for whoever runs motors.
pub(super) fn say(line: &str) -> Outcome {
    printer::OUT.print(format!("{}\n", printable(line))).map_err(|error| unwritten(&error))
}

/// What was asked is done, and cannot be said.
fn unsaid(error: &io::Error) -> Unfinished {
    match unwritten(error) {
        Unfinished::Failed(why) => Unfinished::Failed(format!("{why}; the command itself is done")),
        other => other,
    }
}

/// Output that cannot be written, where the status says how the motors did.
pub(super) fn unwritten(error: &io::Error) -> Unfinished {
    match error.kind() {
        io::ErrorKind::BrokenPipe => Unfinished::ReaderLeft,
        _ => Unfinished::Failed(format!("cannot write: {error}")),
    }
}

/// What is wrong with what was typed.
impl From<String> for Unfinished {
    fn from(sentence: String) -> Self {
        Self::Usage(sentence)
    }
}

/// Output that cannot be written: status 1 of what only prints means something else.
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

/// Prints one sentence beside the output, in its turn: an `error`, a `warning` or a `note`.
pub(super) fn report(kind: &str, sentence: impl Display) {
    // Nobody is left to tell if that fails.
    let _ = printer::ERR.print(format!("{kind}: {}\n", printable(&sentence.to_string())));
}

/// A line without control characters, which may come from whatever is decoded or named, and could
/// steer a terminal. They are written as in JSON, so that JSON keeps its meaning.
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

//! How a subcommand ends, and what is printed.

use std::fmt::Display;
use std::io::{self, Write};

/// Why a subcommand did not come to its end.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Unfinished {
    /// It was asked for wrongly.
    Usage(String),
    /// It could not be done.
    Failed(String),
    /// It failed, and has told why.
    FailedAndTold,
    /// Ctrl-C, or the like, ended it.
    Interrupted(String),
    /// Nobody reads what it prints, which is no error: `… | head`.
    ReaderLeft,
}

pub(super) type Outcome<T = ()> = Result<T, Unfinished>;

pub(super) const FAILED: u8 = 1;
pub(super) const WRONG_USAGE: u8 = 2;

/// Tells why it did not come to its end, and gives the exit status.
pub(super) fn end(outcome: Outcome) -> u8 {
    let (sentence, status) = match outcome {
        Ok(()) | Err(Unfinished::ReaderLeft) => return 0,
        Err(Unfinished::FailedAndTold) => return FAILED,
        Err(Unfinished::Failed(sentence)) => (sentence, FAILED),
        Err(Unfinished::Usage(sentence)) => (sentence, WRONG_USAGE),
        Err(Unfinished::Interrupted(sentence)) => (sentence, 130),
    };
    tell("error", sentence);
    status
}

/// What is wrong with what was typed.
impl From<String> for Unfinished {
    fn from(sentence: String) -> Self {
        Self::Usage(sentence)
    }
}

/// Output that cannot be written: status 1 of what only prints tells something else.
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

/// Prints one sentence beside the output: an `error` or a `note`.
pub(super) fn tell(kind: &str, sentence: impl Display) {
    // Nobody is left to tell if that fails.
    let _ = writeln!(io::stderr(), "{kind}: {}", printable(&sentence.to_string()));
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

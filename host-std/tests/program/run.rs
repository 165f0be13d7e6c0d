//! Runs the program, and reads what it printed.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use assert_cmd::cargo::cargo_bin;
use serde_json::Value;

use crate::question::terminal;

/// Every example frame of the manual as data, with the fields that the text beside it describes.
const VECTORS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/vectors/manual-v4.3.jsonl");

pub(crate) fn myactuator() -> Command {
    let mut program = Command::new(cargo_bin("myactuator"));
    program.env_remove("MYACTUATOR_BUS");
    program
}

pub(crate) fn run(arguments: &[&str]) -> Output {
    myactuator().args(arguments).stdin(Stdio::null()).output().unwrap()
}

/// Repeats this, a few times at most, if a program has given up on a motor because the machine is busy: programs wait a
/// tenth of a second for an answer, and a busy machine may take longer. The machine is not busy if a byte always goes
/// through a pseudo-terminal at once.
pub(crate) fn unless_late<T>(
    mut attempt: impl FnMut() -> T,
    has_given_up: impl Fn(&T) -> bool,
) -> T {
    for _ in 0..4 {
        let is_over = AtomicBool::new(false);
        let (outcome, is_late) = thread::scope(|scope| {
            let watching = scope.spawn(|| is_late_until(&is_over));
            // A failed test ends the watch, too.
            let ends = Ends(&is_over);
            let outcome = attempt();
            drop(ends);
            (outcome, watching.join().unwrap())
        });
        if !(is_late && has_given_up(&outcome)) {
            return outcome;
        }
    }
    attempt()
}

/// Whether the machine is late at any time until this is over.
fn is_late_until(is_over: &AtomicBool) -> bool {
    const A_MOMENT: Duration = Duration::from_millis(1);
    const LATE: Duration = Duration::from_millis(20);
    let (mut keys, program) = terminal();
    let mut program = File::from(program);
    let mut is_late = false;
    while !is_over.load(Ordering::Relaxed) {
        let begun = Instant::now();
        program.write_all(b"x").unwrap();
        keys.read_exact(&mut [0]).unwrap();
        thread::sleep(A_MOMENT);
        is_late |= begun.elapsed() > LATE;
    }
    is_late
}

struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Whether a program says that a motor did not answer.
pub(crate) fn tells_of_silence(message: &str) -> bool {
    let silence = ["no reply", "does not answer", "errors cannot be read", "but not always"];
    silence.iter().any(|words| message.contains(words))
}

/// As [`run`], with arguments without spaces.
pub(crate) fn run_words(arguments: &str) -> Output {
    run(&arguments.split_whitespace().collect::<Vec<_>>())
}

pub(crate) fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

pub(crate) fn lines(output: &Output) -> Vec<&str> {
    text(&output.stdout).lines().collect()
}

pub(crate) fn objects(output: &Output) -> Vec<Value> {
    lines(output).into_iter().map(|line| serde_json::from_str(line).unwrap()).collect()
}

pub(crate) fn vectors(bus: &str) -> Vec<Value> {
    let data = std::fs::read_to_string(VECTORS).unwrap();
    let rows: Vec<Value> = data.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(rows.len(), 199); // 101 CAN, 98 RS485
    rows.into_iter().filter(|row| row["bus"] == bus).collect()
}

/// Rows of a table in text: the input, an arrow, and the expected output.
pub(crate) fn rows(table: &str) -> impl Iterator<Item = (&str, &str)> {
    let rows = table.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    rows.map(|row| row.split_once(" => ").unwrap_or_else(|| panic!("no arrow in {row:?}")))
}

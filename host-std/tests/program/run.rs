//! Runs the program, and reads what it printed.

use std::process::{Command, Output, Stdio};

use assert_cmd::cargo::cargo_bin;
use serde_json::Value;

/// Every example frame of the manual, as data with the fields that the text beside it tells.
const VECTORS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/vectors/manual-v4.3.jsonl");

pub(crate) fn myactuator() -> Command {
    let mut program = Command::new(cargo_bin("myactuator"));
    program.env_remove("MYACTUATOR_BUS");
    program
}

pub(crate) fn run(arguments: &[&str]) -> Output {
    myactuator().args(arguments).stdin(Stdio::null()).output().unwrap()
}

/// As [`run`], with arguments that hold no spaces.
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

/// Rows of a table that is written as text: what is put in, an arrow, and what is to come out.
pub(crate) fn rows(table: &str) -> impl Iterator<Item = (&str, &str)> {
    let rows = table.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    rows.map(|row| row.split_once(" => ").unwrap_or_else(|| panic!("no arrow in {row:?}")))
}

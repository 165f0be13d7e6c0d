//! Prints what happens in drives: for people to standard error, as JSON to standard output.

use myactuator_host_std::sim::LogRecord;
use serde_json::json;

use crate::cli::printable;
use crate::cli::printer::{self, Printer};

/// How many lines may wait for the reader; later ones are left out.
const ROOM: usize = 1_000;

/// Never waits for the reader, so that the drives go on.
pub(super) struct LogPrinter {
    is_json: bool,
    stream: &'static Printer,
    left_out: u32,
}

impl LogPrinter {
    pub(super) fn new(is_json: bool) -> Self {
        let stream = if is_json { &printer::OUT } else { &printer::ERR };
        Self { is_json, stream, left_out: 0 }
    }

    pub(super) fn print(&mut self, record: &LogRecord) {
        if self.left_out > 0 && self.offer(&left_out(self.left_out, self.is_json)) {
            self.left_out = 0;
        }
        if !self.offer(&line(record, self.is_json)) {
            self.left_out += 1;
        }
    }

    fn offer(&self, line: &str) -> bool {
        // The reader may leave; the drives go on.
        self.stream.offer(format!("{}\n", printable(line)), ROOM).unwrap_or(true)
    }
}

fn line(record: &LogRecord, is_json: bool) -> String {
    if !is_json {
        return record.to_string();
    }
    let mut object = json!(record);
    object["kind"] = json!("log");
    object["text"] = json!(record.to_string());
    object.to_string()
}

fn left_out(lines: u32, is_json: bool) -> String {
    if is_json {
        json!({ "kind": "log", "left_out": lines }).to_string()
    } else {
        format!("{lines} lines of the log were left out: they came faster than they were read")
    }
}

//! The log of the firmware.

use std::fmt;
use std::io::Read;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use defmt_decoder::{DecodeError, StreamDecoder, Table};

use super::Failure;

/// A line of the log.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// When it arrived.
    pub came: Instant,
    /// The firmware's time stamp, if it logs one.
    pub at: Option<Duration>,
    /// The message.
    pub text: String,
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(at) = self.at {
            write!(f, "{:9.3} s  ", at.as_secs_f64())?;
        }
        f.write_str(&self.text)
    }
}

/// The report that a running application logs every second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Second {
    /// The cycles since the motors began to run.
    pub cycles: u32,
    /// How many of the cycles began late.
    pub overruns: u32,
    /// The answered set-points in this second, of the motor with the fewest.
    pub slowest: u32,
    /// Commands that got no reply in time since the motors began to run.
    pub lost: u32,
    /// The deepest stack since the start, in bytes.
    pub stack: u32,
    /// The most that was queued for the loop since the start, in bytes.
    pub queued: u32,
    /// The bytes lost on the board since the start.
    pub dropped: u32,
}

impl Line {
    /// The number after `field:`, as in `Second { cycles: 1000 }`.
    pub fn number(&self, field: &str) -> Option<f64> {
        let (_, rest) = self.text.split_once(&format!("{field}: "))?;
        let is_of_number = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-');
        let number = rest.trim_start_matches(|c: char| !is_of_number(c));
        number.split(|c| !is_of_number(c)).next()?.parse().ok()
    }

    /// The report of a second, if the line is one.
    pub fn second(&self) -> Option<Second> {
        if !self.text.starts_with("Second") {
            return None;
        }
        let number = |field| self.number(field).map(|number| number as u32);
        Some(Second {
            cycles: number("cycles")?,
            overruns: number("overruns")?,
            slowest: number("slowest")?,
            lost: number("lost")?,
            stack: number("stack")?,
            queued: number("queued")?,
            dropped: number("dropped")?,
        })
    }
}

#[derive(Debug, Default)]
struct Entries {
    lines: Vec<Line>,
    /// The number of frames that could not be decoded.
    garbled: usize,
    /// The log has ended.
    is_over: bool,
}

/// Everything that the firmware has logged. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct Log(Arc<(Mutex<Entries>, Condvar)>);

/// A position in a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Mark(usize);

impl Log {
    /// Decodes `source` until it ends, and calls `on_line` with each line.
    ///
    /// # Errors
    /// If the image's file does not describe its log.
    pub fn decode(
        image: &Path,
        mut source: impl Read + Send + 'static,
        mut on_line: impl FnMut(&Line) + Send + 'static,
    ) -> Result<Self, Failure> {
        let table = Table::parse(&std::fs::read(image)?)
            .map_err(|error| format!("{}: {error}", image.display()))?
            .ok_or_else(|| format!("{} has no defmt log", image.display()))?;
        let log = Self::default();
        let writer = log.clone();
        thread::spawn(move || {
            let mut decoder = table.new_stream_decoder();
            let mut chunk = [0; 4096];
            while let Ok(length @ 1..) = source.read(&mut chunk) {
                decoder.received(chunk.get(..length).unwrap_or_default());
                writer.take(decoder.as_mut(), &mut on_line);
            }
            writer.lock().is_over = true;
            writer.0.1.notify_all();
        });
        Ok(log)
    }

    fn take(&self, decoder: &mut dyn StreamDecoder, on_line: &mut dyn FnMut(&Line)) {
        loop {
            let read = match decoder.decode() {
                Ok(frame) => {
                    let at = frame.display_timestamp().and_then(|at| seconds(&at.to_string()));
                    let text = frame.display_message().to_string();
                    Some(Line { came: Instant::now(), at, text })
                }
                Err(DecodeError::UnexpectedEof) => return,
                Err(DecodeError::Malformed) => None,
            };
            if let Some(line) = &read {
                on_line(line);
            }
            let mut entries = self.lock();
            match read {
                Some(line) => entries.lines.push(line),
                None => entries.garbled += 1,
            }
            self.0.1.notify_all();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The end of the log so far.
    pub fn mark(&self) -> Mark {
        Mark(self.lock().lines.len())
    }

    /// The lines after a mark.
    pub fn since(&self, mark: Mark) -> Vec<Line> {
        self.lock().lines.get(mark.0..).unwrap_or_default().to_vec()
    }

    /// The number of frames that could not be decoded.
    pub fn garbled(&self) -> usize {
        self.lock().garbled
    }

    /// Whether the firmware can still log.
    pub fn is_open(&self) -> bool {
        !self.lock().is_over
    }

    /// Waits for the first line after `mark` that satisfies the condition. Returns it with the mark after it.
    pub fn wait(
        &self,
        mark: Mark,
        within: Duration,
        is_it: impl Fn(&Line) -> bool,
    ) -> Option<(Line, Mark)> {
        let until = Instant::now() + within;
        let mut entries = self.lock();
        let mut next = mark.0;
        loop {
            while let Some(line) = entries.lines.get(next) {
                next += 1;
                if is_it(line) {
                    return Some((line.clone(), Mark(next)));
                }
            }
            let left = until.saturating_duration_since(Instant::now());
            if entries.is_over || left.is_zero() {
                return None;
            }
            (entries, _) =
                self.0.1.wait_timeout(entries, left).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The last lines, as text.
    pub fn tail(&self, lines: usize) -> String {
        let entries = self.lock();
        let skipped = entries.lines.len().saturating_sub(lines);
        entries.lines.iter().skip(skipped).map(|line| format!("  {line}\n")).collect()
    }
}

/// A time stamp in seconds, with a decimal point.
fn seconds(text: &str) -> Option<Duration> {
    Duration::try_from_secs_f64(text.trim().parse().ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(text: &str) -> Line {
        Line { came: Instant::now(), at: None, text: text.into() }
    }

    #[test]
    fn numbers_are_found_by_their_names() {
        let measured = line("Measured { motor: motor 3, angle: Angle(-1250) }");
        assert_eq!(measured.number("motor"), Some(3.0));
        assert_eq!(measured.number("angle"), Some(-1_250.0));
        assert_eq!(measured.number("speed"), None);
        assert_eq!(measured.second(), None);
        let report = "Second { cycles: 3000, overruns: 2, slowest: 214, lost: 1, stack: 1736, \
                    queued: 26, dropped: 3 }";
        let expected = Second {
            cycles: 3_000,
            overruns: 2,
            slowest: 214,
            lost: 1,
            stack: 1_736,
            queued: 26,
            dropped: 3,
        };
        assert_eq!(line(report).second(), Some(expected));
    }
}

//! A number that equal states share, at any time and after any number of requests.
//!
//! It is made from the master's `Debug` text, so that no field can be forgotten. Times count from now, and the rounds
//! of the motors from the master's round.
//!
//! Fields that only count, name, or answer callers are left out: health, tickets, whether the newest set-point was
//! dropped, and by when a drive has started. They can only change what is reported, with two exceptions that do not
//! occur here:
//!
//! - When a motor was heard last matters after a second.
//! - By when it has started matters if its run time is read.

use std::fmt::{self, Debug, Write};
use std::hash::{BuildHasher, Hash, Hasher};

use foldhash::quality::{FixedState, FoldHasher};
use myactuator_protocol_core::time::{Duration, Instant};

/// If something is longer ago than this, it makes no difference how long, except for a sent frame.
const PAST: Duration = Duration::from_millis(1);
/// The same for a sent frame.
const LONG_AGO: Duration = Duration::from_millis(4);
/// The same for a sent frame that may come back.
const NO_ECHO: Duration = Duration::from_millis(101);

/// The number of a state, of a master or of a loop that runs one. `hash_world` adds the rest of the state.
pub(crate) fn number(
    master: &impl Debug,
    now: Instant,
    hash_world: impl FnOnce(&mut FoldHasher<'static>),
) -> u64 {
    let mut sink = Sink::new(now);
    // Writing to a hash cannot fail.
    let _ = write!(sink, "{master:?}");
    let [pace, rounds @ ..] = [sink.pace, sink.rounds[0], sink.rounds[1]];
    rounds.map(|round| pace.wrapping_sub(round)).hash(&mut sink.hasher);
    hash_world(&mut sink.hasher);
    sink.hasher.finish()
}

/// A time relative to now.
pub(crate) fn from_now(at: Instant, now: Instant, past: Duration) -> i64 {
    // The master's values for "not" and "never".
    if at == Instant::ZERO {
        return i64::MIN;
    }
    if at.as_micros() == u64::MAX {
        return i64::MAX;
    }
    let ahead = (at - now).as_micros() as i64;
    let behind = (now - at).as_micros().min(past.as_micros()) as i64;
    ahead - behind
}

/// The meaning of the number after a field's name.
#[derive(Clone, Copy, PartialEq)]
enum Field {
    Plain,
    Sent,
    /// A sent frame that may come back.
    MayEcho,
    Round,
    Pace,
    Misses,
    Ignored,
}

/// Takes the pieces that `Debug` writes: each is a name, a sign or a number. If the pieces came differently, fewer
/// states would be found equal, but none wrongly.
struct Sink {
    hasher: FoldHasher<'static>,
    now: Instant,
    field: Field,
    is_instant: bool,
    last_word: Field,
    /// Depth inside a struct that is left out.
    depth_left_out: usize,
    leaves_out: bool,
    pace: u32,
    rounds: [u32; 2],
    rounds_seen: usize,
}

impl Sink {
    fn new(now: Instant) -> Self {
        Self {
            hasher: FixedState::default().build_hasher(),
            now,
            field: Field::Plain,
            is_instant: false,
            last_word: Field::Plain,
            depth_left_out: 0,
            leaves_out: false,
            pace: 0,
            rounds: [0; 2],
            rounds_seen: 0,
        }
    }

    fn number(&mut self, number: u64) {
        if std::mem::take(&mut self.is_instant) {
            let past = match self.field {
                Field::Sent => LONG_AGO,
                Field::MayEcho => NO_ECHO,
                _ => PAST,
            };
            from_now(Instant::from_micros(number), self.now, past).hash(&mut self.hasher);
            return;
        }
        match self.field {
            Field::Round => {
                if let Some(round) = self.rounds.get_mut(self.rounds_seen) {
                    *round = number as u32;
                }
                self.rounds_seen += 1;
            }
            Field::Pace => self.pace = number as u32,
            Field::Misses => (number > 0).hash(&mut self.hasher),
            Field::Ignored => {}
            Field::Plain | Field::Sent | Field::MayEcho => number.hash(&mut self.hasher),
        }
    }
}

impl Write for Sink {
    fn write_str(&mut self, piece: &str) -> fmt::Result {
        if self.leaves_out {
            match piece {
                " { " => self.depth_left_out += 1,
                " }" => {
                    self.depth_left_out -= 1;
                    self.leaves_out = self.depth_left_out > 0;
                }
                _ => {}
            }
            return Ok(());
        }
        match piece {
            ": " => self.field = self.last_word,
            ", " | " { " | " }" | "(" | ")" => {}
            "Instant" => self.is_instant = true,
            "Record" | "Config" => self.leaves_out = true,
            "true" | "false" if self.field == Field::Ignored => {}
            _ => {
                if let Ok(number) = piece.parse() {
                    self.number(number);
                    return Ok(());
                }
                self.last_word = match piece {
                    "sent" => Field::Sent,
                    "at" | "forgotten" => Field::MayEcho,
                    "round" => Field::Round,
                    "pace" => Field::Pace,
                    "misses" => Field::Misses,
                    "ticket" | "last_ticket" | "is_newest_dropped" | "started_by" => Field::Ignored,
                    // Bytes that are already processed, or are no frame.
                    "chunk" | "next" | "end" | "held" | "garbled" => Field::Ignored,
                    _ => Field::Plain,
                };
                piece.hash(&mut self.hasher);
            }
        }
        Ok(())
    }
}

//! A number that equal states share, at any time and after any number of requests.
//!
//! It is made from the master's `Debug` text, so that no field can be forgotten. Times count from now, and the rounds
//! of the motors from the master's round.
//!
//! Fields that only count, name, or answer callers are left out: health, tickets, whether the newest set-point was
//! dropped, and by when a drive has started. Of when a motor was heard last, only whether that was after its last
//! command. They can only change what is reported, with three exceptions that make no difference here:
//!
//! - When a motor was heard last matters after a second.
//! - By when it has started matters if its run time is read.
//! - Tickets show whether a request or a command to all was put first. So do the numbers of the calls in their data.
//!
//! What is longer ago than 1 ms, or 4 ms for a sent frame, counts as equally long ago, although the master may look
//! back for a time-out and a late window, 8 ms here. So a few states pass for others that they are not. To search them
//! too, set both to 8 ms: that takes several times as long.

use std::fmt::{self, Debug, Write};
use std::hash::{BuildHasher, Hash, Hasher};

use foldhash::quality::{FixedState, FoldHasher};
use myactuator_protocol_core::time::{Duration, Instant};

/// If something is longer ago than this, it counts as so long ago, except for a sent frame.
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
    /// When a motor was heard last.
    Heard,
    Round,
    Pace,
    Misses,
    Ignored,
}

/// The structs with such fields. Other structs may have fields of the same names.
#[derive(Clone, Copy, PartialEq)]
enum Owner {
    Other,
    Master,
    Broadcast,
    Motor,
    EchoFilter,
    /// A frame that may come back.
    Sent,
    Record,
    Line,
    Receiver,
    LeftOut,
}

impl Owner {
    fn named(name: &str) -> Self {
        match name {
            "Master" => Self::Master,
            "Broadcast" => Self::Broadcast,
            "Motor" => Self::Motor,
            "EchoFilter" => Self::EchoFilter,
            "Sent" => Self::Sent,
            "Line" => Self::Line,
            "Receiver" => Self::Receiver,
            "Record" => Self::Record,
            "Config" => Self::LeftOut,
            _ => Self::Other,
        }
    }

    fn field(self, name: &str) -> Field {
        if self == Self::Other {
            return Field::Plain;
        }
        match (self, name) {
            (Self::Broadcast | Self::Motor, "sent") | (Self::Master, "stop_to_all_sent") => Field::Sent,
            (Self::EchoFilter, "forgotten") | (Self::Sent, "at") => Field::MayEcho,
            (Self::Record, "heard_at") => Field::Heard,
            (Self::Motor, "round") => Field::Round,
            (Self::Master, "pace") => Field::Pace,
            (Self::Motor, "misses") => Field::Misses,
            (Self::Master, "last_ticket" | "looked_at" | "looked_ticket" | "garbled")
            | (Self::Broadcast, "ticket")
            | (Self::Motor, "ticket" | "is_newest_dropped" | "started_by")
            // Bytes that are already processed, or are no frame.
            | (Self::Line, "chunk" | "next" | "end")
            | (Self::Receiver, "held")
            | (Self::Record, _) => Field::Ignored,
            _ => Field::Plain,
        }
    }
}

/// Takes the pieces that `Debug` writes: each is a name, a sign or a number. If the pieces came differently, fewer
/// states would be found equal, but none wrongly.
struct Sink {
    hasher: FoldHasher<'static>,
    now: Instant,
    field: Field,
    is_instant: bool,
    /// The last names of a field and of a struct.
    last_field: Field,
    last_owner: Owner,
    /// The structs around the next piece, the outermost first.
    owners: Vec<Owner>,
    pace: u32,
    /// When the motor that is written was sent its last command.
    sent: u64,
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
            last_field: Field::Plain,
            last_owner: Owner::Other,
            owners: Vec::new(),
            pace: 0,
            sent: 0,
            rounds: [0; 2],
            rounds_seen: 0,
        }
    }

    /// The struct around the next piece.
    fn owner(&self) -> Owner {
        self.owners.last().copied().unwrap_or(Owner::Other)
    }

    fn number(&mut self, number: u64) {
        if std::mem::take(&mut self.is_instant) {
            if self.field == Field::Heard {
                return (number < self.sent).hash(&mut self.hasher);
            }
            if self.field == Field::Sent && self.owner() == Owner::Motor {
                self.sent = number;
            }
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
            // None, one, or so many that the motor counts as silent.
            Field::Misses => number.min(2).hash(&mut self.hasher),
            Field::Ignored => {}
            Field::Plain | Field::Sent | Field::MayEcho | Field::Heard => {
                number.hash(&mut self.hasher)
            }
        }
    }
}

impl Sink {
    /// A number or a name. Most are told apart by their first letter, because this is most of the work of a search.
    fn word(&mut self, piece: &str) {
        match piece.as_bytes() {
            [b'0'..=b'9', ..] => {
                if let Ok(number) = piece.parse() {
                    return self.number(number);
                }
            }
            [b'A'..=b'Z', ..] if piece == "Instant" => return self.is_instant = true,
            [b'A'..=b'Z', ..] => self.last_owner = Owner::named(piece),
            b"true" | b"false" if self.field == Field::Ignored => return,
            b"true" | b"false" => {}
            // Which fields there are follows from the name of the struct.
            [b'a'..=b'z', ..] => return self.last_field = self.owner().field(piece),
            _ => self.last_field = Field::Plain,
        }
        self.hasher.write(piece.as_bytes());
    }
}

impl Write for Sink {
    fn write_str(&mut self, piece: &str) -> fmt::Result {
        // By bytes, as in `word`.
        match piece.as_bytes() {
            b" { " => {
                // What is in a struct that is left out is left out, too.
                let is_left_out = self.owner() == Owner::LeftOut;
                self.owners.push(if is_left_out { Owner::LeftOut } else { self.last_owner });
            }
            b" }" => {
                self.owners.pop();
            }
            _ if self.owner() == Owner::LeftOut => {}
            b": " => self.field = self.last_field,
            b", " | b"(" | b")" => {}
            _ => self.word(piece),
        }
        Ok(())
    }
}

#[test]
fn a_field_is_ignored_only_in_its_own_struct() {
    #[derive(Debug)]
    struct Receiver {
        #[expect(dead_code, reason = "only printed")]
        held: u8,
    }
    #[derive(Debug)]
    struct Broadcast {
        #[expect(dead_code, reason = "only printed")]
        held: u8,
    }
    let of_receiver = |held| number(&Receiver { held }, Instant::ZERO, |_| {});
    assert_eq!(of_receiver(1), of_receiver(2));
    let of_broadcast = |held| number(&Broadcast { held }, Instant::ZERO, |_| {});
    assert_ne!(of_broadcast(1), of_broadcast(2));
}

/// The master treats a motor that has missed one reply otherwise than one that counts as silent.
#[test]
fn motors_that_have_missed_one_reply_and_two_differ() {
    #[derive(Debug)]
    struct Motor {
        #[expect(dead_code, reason = "only printed")]
        misses: u8,
    }
    let after = |misses| number(&Motor { misses }, Instant::ZERO, |_| {});
    assert_ne!(after(0), after(1));
    assert_ne!(after(1), after(2));
    assert_eq!(after(2), after(3));
}

#[test]
fn whether_a_motor_was_heard_after_its_last_command_matters_and_not_how_long_after() {
    #[derive(Debug)]
    #[expect(dead_code, reason = "only printed")]
    struct Record {
        heard_at: Instant,
        answered: u8,
    }
    #[derive(Debug)]
    #[expect(dead_code, reason = "only printed")]
    struct Motor {
        sent: Instant,
        health: Record,
    }
    let heard = |at, answered| {
        let health = Record { heard_at: Instant::from_micros(at), answered };
        number(&Motor { sent: Instant::from_micros(5), health }, Instant::from_micros(100), |_| {})
    };
    assert_ne!(heard(4, 0), heard(5, 0));
    assert_eq!(heard(5, 0), heard(9, 3));
}

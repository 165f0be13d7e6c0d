//! What is still to be sent to an SLCAN adapter.

use std::time::Duration;

use crate::port::PortError;
use crate::text::slcan::AdapterCommand;

/// A port that takes nothing for so long holds stale frames.
const LONGEST_STALL: Duration = Duration::from_millis(20);

/// After any part of a line that an adapter has, this makes the line too long to be a command. Some firmware checks how a
/// line begins and not where it ends, and drops it only when its buffer is full: with CAN FD, after up to 165
/// characters.
const JUNK: [u8; 192] = [b'?'; 192];

/// The rest of a line that the port has not taken yet.
///
/// It never leaves late: if the port fails, or takes nothing for too long, the rest of a line is dropped. The adapter
/// may then hold all of that line but its end, or of an earlier line, whose end is thrown away with what the port
/// holds. So [`JUNK`] goes before anything else.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    rest: Vec<u8>,
    /// Since when the port takes nothing; time since the machine started.
    blocked_since: Option<Duration>,
}

impl Outbox {
    pub(super) fn put(&mut self, command: AdapterCommand) {
        command.encode(&mut self.rest);
    }

    /// Invalidates any part of a line that the adapter may have, whichever program began it.
    pub(super) fn put_junk(&mut self) {
        self.rest.extend(JUNK);
        AdapterCommand::Nothing.encode(&mut self.rest);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    /// Hands the port what it has not taken yet; `write` returns how much it takes. False if the rest has become stale
    /// and was dropped.
    pub(super) fn send_on(
        &mut self,
        now: Duration,
        write: impl FnOnce(&[u8]) -> Result<usize, PortError>,
    ) -> Result<bool, PortError> {
        if self.rest.is_empty() {
            return Ok(true);
        }
        let blocked_for = self.blocked_since.map(|since| now.saturating_sub(since));
        // Also if the port would take it now, since the program may have been suspended meanwhile.
        if blocked_for.is_some_and(|span| span >= LONGEST_STALL) {
            self.drop_rest();
            return Ok(false);
        }
        match write(&self.rest) {
            Ok(0) => {
                self.blocked_since.get_or_insert(now);
            }
            Ok(taken) => {
                self.rest.drain(..taken);
                self.blocked_since = (!self.rest.is_empty()).then_some(now);
            }
            Err(error) => {
                self.drop_rest();
                return Err(error);
            }
        }
        Ok(true)
    }

    /// Drops what the port has not taken.
    pub(super) fn drop_rest(&mut self) {
        *self = Self::default();
        self.put_junk();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{Frame as _, StandardId};
    use myactuator_protocol_core::wire::can::SimpleFrame;

    const START: Duration = Duration::from_secs(100);

    /// One that is to send a torque command.
    fn with_torque() -> Outbox {
        let id = StandardId::new(0x141).unwrap();
        let frame = SimpleFrame::new(id, &[0xA1, 0, 0, 0, 50, 0, 0, 0]).unwrap();
        let mut outbox = Outbox::default();
        outbox.put(AdapterCommand::Transmit(frame));
        outbox
    }

    /// What the port gets when it takes so many bytes.
    fn sent(outbox: &mut Outbox, at_ms: u64, takes: usize) -> (bool, Vec<u8>) {
        let mut got = Vec::new();
        let is_fresh = outbox.send_on(START + Duration::from_millis(at_ms), |bytes| {
            let taken = takes.min(bytes.len());
            got.extend_from_slice(&bytes[..taken]);
            Ok(taken)
        });
        (is_fresh.unwrap(), got)
    }

    /// What makes of any part of a line one that is too long.
    fn junk() -> Vec<u8> {
        [&[b'?'; 192][..], b"\r"].concat()
    }

    #[test]
    fn a_line_leaves_in_pieces_as_the_port_takes_it() {
        let mut outbox = with_torque();
        assert_eq!(sent(&mut outbox, 0, 5), (true, b"t1418".to_vec()));
        // Each piece is progress.
        for (at_ms, piece) in [(19, &b"A100"[..]), (38, b"0000"), (57, b"3200")] {
            assert_eq!(sent(&mut outbox, at_ms, 4), (true, piece.to_vec()));
        }
        assert_eq!(sent(&mut outbox, 76, 100), (true, b"0000\r".to_vec()));
        assert!(outbox.is_empty());
    }

    #[test]
    fn line_that_was_reported_as_failed_is_never_sent() {
        let mut outbox = with_torque();
        let failed = outbox.send_on(START, |_| Err(PortError::Stalled("made up".into())));
        assert!(failed.is_err());
        assert_eq!(sent(&mut outbox, 0, 1_000), (true, junk()));
        assert!(outbox.is_empty());
    }

    #[test]
    fn a_line_that_the_port_takes_too_late_is_dropped() {
        // A part, and all but its end, was taken before the program was held for a minute.
        for takes in [5, 21] {
            let mut outbox = with_torque();
            assert!(sent(&mut outbox, 0, takes).0);
            assert_eq!(sent(&mut outbox, 60_000, 100), (false, vec![]));
            assert_eq!(sent(&mut outbox, 60_000, 1_000), (true, junk()));
            assert!(outbox.is_empty());
        }
        // None of it: the adapter may have some of a line before it, of which the port is emptied.
        let mut outbox = with_torque();
        assert!(sent(&mut outbox, 0, 0).0);
        assert_eq!(sent(&mut outbox, 60_000, 100), (false, vec![]));
        assert_eq!(sent(&mut outbox, 60_000, 1_000), (true, junk()));
        assert!(outbox.is_empty());
        // A port that takes nothing all the while.
        let mut outbox = with_torque();
        assert_eq!([0, 19, 20].map(|at_ms| sent(&mut outbox, at_ms, 0).0), [true, true, false]);
    }
}

//! The line after the port: an adapter that hands over bytes in the order of the line, with or without echoes, and
//! drives, of which one may be missing.

use std::collections::VecDeque;
use std::hash::{Hash, Hasher};

use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::rs485::{FRAME_LENGTH, Frame};
use myactuator_protocol_core::{Data, MotorId, Target};
use myactuator_tests::values::LOST_MASTER;

use crate::interleavings::canonical::from_now;
use crate::interleavings::world::motor_at;

/// How long a drive takes to answer.
const RESPONSE: Duration = Duration::from_millis(1);
/// An answer that comes later than this after its command was sent is late.
const IN_TIME: Duration = Duration::from_millis(2);
/// No answer comes later, as the master's documentation demands.
const LAST_ANSWER: Duration = Duration::from_millis(4);
/// No echo comes later than this.
const LAST_ECHO: Duration = Duration::from_millis(99);

const STATUS: Data = [0x9A, 50, 30, 1, 0xE5, 1, 0, 0];
/// Bytes that are no frame, although one could begin at each header.
const NOISE: [u8; FRAME_LENGTH] = *b">\x01\x08>\x01\x08>\x01\x08>\x01\x08>";

/// Bytes in flight to the port.
#[derive(Clone, Debug)]
struct Heard {
    bytes: Vec<u8>,
    is_echo: bool,
    /// When its command was sent.
    sent: Instant,
    /// When it is on the line.
    at: Instant,
    /// Its delay was counted as a fault.
    is_late: bool,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Drive {
    pub(super) is_there: bool,
    /// It has lost its master and hands the next command back.
    ignores: bool,
    /// The command bytes that it has heard and executed since each was last awaited.
    executed: Vec<u8>,
}

impl Drive {
    /// Forgets that it has executed this: from now on it is awaited.
    pub(super) fn look_for(&mut self, byte: u8) {
        self.executed.retain(|&it| it != byte);
    }

    pub(super) fn has_executed(&self, byte: u8) -> bool {
        self.executed.contains(&byte)
    }

    fn answer(&mut self, command: Data) -> Data {
        let [byte, ..] = command;
        if std::mem::take(&mut self.ignores) {
            return command;
        }
        if !self.executed.contains(&byte) {
            self.executed.push(byte);
            self.executed.sort_unstable();
        }
        // An angle of 0 and acknowledgements are the command's own bytes.
        if byte == STATUS[0] { STATUS } else { command }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Line {
    pub(super) echoes: bool,
    pub(super) drives: [Drive; 2],
    heard: VecDeque<Heard>,
    /// Two stations have sent at the same time.
    pub(super) have_met: bool,
    /// A drive's message that it has lost its master did not arrive.
    lost_master_untold: bool,
    /// An answer has come twice.
    has_doubled: bool,
}

impl Line {
    pub(super) fn new(echoes: bool, is_there: [bool; 2]) -> Self {
        let drives = is_there.map(|is_there| Drive { is_there, ..Drive::default() });
        let (have_met, lost_master_untold, has_doubled) = (false, false, false);
        Self { echoes, drives, heard: VecDeque::new(), have_met, lost_master_untold, has_doubled }
    }

    pub(super) fn hash_from_now<H: Hasher>(&self, now: Instant, hasher: &mut H) {
        for Heard { bytes, is_echo, sent, at, is_late } in &self.heard {
            (bytes, is_echo, is_late).hash(hasher);
            from_now(*sent, now, LAST_ECHO).hash(hasher);
            from_now(*at, now, Duration::ZERO).hash(hasher);
        }
        for drive in &self.drives {
            (drive.ignores, &drive.executed).hash(hasher);
        }
        (self.have_met, self.lost_master_untold, self.has_doubled).hash(hasher);
    }

    /// Carries bytes: a frame, or part of one. Drives may not hear them.
    pub(super) fn carry(&mut self, bytes: &[u8], now: Instant, is_heard: bool) {
        let meets = self.heard.iter_mut().filter(|it| it.at > now);
        let mut is_clear = true;
        for other in meets {
            (other.bytes, is_clear) = (NOISE.into(), false);
        }
        self.have_met |= !is_clear;
        if self.echoes {
            let echo = if is_clear { bytes.to_vec() } else { NOISE.into() };
            self.put(echo, true, now, now);
        }
        let frame = bytes.try_into().ok().and_then(|bytes| Frame::decode(bytes).ok());
        if let Some(frame) = frame.filter(|_| is_heard && is_clear) {
            self.answer(&frame, now);
        }
    }

    fn answer(&mut self, command: &Frame, now: Instant) {
        let mut answers = Vec::new();
        for (index, drive) in self.drives.iter_mut().enumerate() {
            let motor = motor_at(index);
            let is_to_it = [Target::All, Target::Motor(motor)].contains(&command.address);
            if is_to_it && drive.is_there {
                answers.push(Frame { address: motor.into(), data: drive.answer(command.data) });
            }
        }
        match answers[..] {
            [] => {}
            [answer] => self.put(answer.encode().into(), false, now, now + RESPONSE),
            // They collide.
            _ => self.put(NOISE.into(), false, now, now + RESPONSE),
        }
    }

    fn put(&mut self, bytes: Vec<u8>, is_echo: bool, sent: Instant, at: Instant) {
        self.heard.push_back(Heard { bytes, is_echo, sent, at, is_late: false });
    }

    pub(super) fn is_free(&self) -> bool {
        self.heard.is_empty()
    }

    /// A drive has lost its master and reports that.
    pub(super) fn lose_master(&mut self, index: usize, now: Instant) {
        self.drives[index].ignores = true;
        let frame = Frame { address: motor_at(index).into(), data: LOST_MASTER };
        self.put(frame.encode().into(), false, now, now);
    }

    /// When the next bytes are on the line.
    pub(super) fn next_at(&self) -> Option<Instant> {
        self.heard.front().map(|heard| heard.at)
    }

    /// The next bytes, if they are there.
    pub(super) fn hand_over(&mut self, now: Instant) -> Option<Vec<u8>> {
        self.heard.pop_front_if(|heard| heard.at <= now).map(|heard| heard.bytes)
    }

    /// The next bytes are lost, or are no frame any more.
    pub(super) fn harm(&mut self, is_lost: bool, now: Instant) -> bool {
        let Some(next) = self.heard.front_mut().filter(|heard| heard.at <= now) else {
            return false;
        };
        let bytes = std::mem::replace(&mut next.bytes, NOISE.into());
        if is_lost {
            self.heard.pop_front();
        }
        self.lose(&bytes);
        true
    }

    /// Notes that these bytes are lost.
    pub(super) fn lose(&mut self, bytes: &[u8]) {
        let is_it = |frame: &[u8]| frame.starts_with(&LOST_MASTER);
        self.lost_master_untold |= bytes.windows(LOST_MASTER.len()).any(is_it);
    }

    /// The next bytes come twice, if they are an answer.
    pub(super) fn double(&mut self, now: Instant) -> bool {
        let next = self.heard.front().filter(|heard| !heard.is_echo && heard.at <= now).cloned();
        let is_there = next.is_some();
        self.has_doubled |= is_there;
        next.into_iter().for_each(|next| self.heard.push_front(next));
        is_there
    }

    /// How many messages become late by this time; `None` if one must have come by then.
    pub(super) fn late_at(&mut self, until: Instant) -> Option<u8> {
        let mut late = 0;
        for heard in &mut self.heard {
            let last = if heard.is_echo { LAST_ECHO } else { LAST_ANSWER };
            if until > heard.sent + last {
                return None;
            }
            if until > heard.sent + IN_TIME && !heard.is_late {
                heard.is_late = true;
                late += 1;
            }
        }
        Some(late)
    }

    /// The program was halted for long: everything has come.
    pub(super) fn all(&mut self) -> Vec<u8> {
        self.heard.drain(..).flat_map(|heard| heard.bytes).collect()
    }

    /// The program was halted for long. The adapter still holds the echoes.
    pub(super) fn hold_echoes(&mut self, now: Instant) -> bool {
        let lost: Vec<_> = self.heard.iter().filter(|it| !it.is_echo).cloned().collect();
        lost.iter().for_each(|heard| self.lose(&heard.bytes));
        self.heard.retain(|heard| heard.is_echo);
        self.heard.iter_mut().for_each(|heard| heard.sent = now);
        !self.heard.is_empty()
    }

    /// Whether an answer of this motor may pass for the answer to a command that it has not heard. The master's
    /// documentation says when. A motor that is not there answers nothing, whatever the others do.
    pub(super) fn may_be_older(&self, motor: MotorId) -> bool {
        let is_there = self.drives[motor.index()].is_there;
        is_there && (self.has_doubled || self.lost_master_untold)
    }

    pub(super) fn drive_of(&mut self, motor: MotorId) -> &mut Drive {
        &mut self.drives[motor.index()]
    }
}

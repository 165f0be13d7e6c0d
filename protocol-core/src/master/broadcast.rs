//! A command to all motors, and who has answered it.

use crate::command::{Reset, Shutdown};
use crate::data::Data;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::master::late::Question;
use crate::master::schedule::Earliest;
use crate::master::{Config, Event, Master, MotorSet, StopKind};
use crate::packet::Packet;
use crate::time::{Duration, Instant};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    None,
    Waiting,
    /// It was told that it is over, and handed back then: it goes once more, and nothing is reported of that.
    Again,
    InFlight,
    /// It was sent and nobody is expected to answer; to be reported.
    Sent,
    /// It is over; to be reported.
    Done,
    /// It was never sent; to be reported.
    Dropped,
}

/// When one was put that ends motion, and the motors that were stopped since, to be held or to be off: it is not to
/// undo that, however late a controller hands it back.
#[derive(Clone, Copy, Debug)]
struct End {
    put: Instant,
    held: MotorSet,
    off: MotorSet,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Broadcast {
    kind: Option<Kind>,
    data: Data,
    expected: MotorSet,
    answered: MotorSet,
    sent: Instant,
    deadline: Instant,
    state: State,
    /// The last one that was sent may still be answered by those who are not in `heard`.
    may_be_late: bool,
    /// Its command byte, and who has answered it, expected or not.
    sent_byte: u8,
    heard: MotorSet,
    end_of_motion: Option<End>,
    /// The last one that was sent may move whoever is not in `heard`, or switch off who is to be held, and one
    /// before it these.
    moves: bool,
    moved_before: MotorSet,
    /// Nothing was heard on the bus since, but what was on its way: it may be cut, and what moves in a mailbox, for
    /// as long as that lasts.
    is_unheard: bool,
    /// Until when it may be late or move, or restart a motor.
    late_until: Instant,
}

impl Broadcast {
    pub(super) fn put(&mut self, kind: Kind, data: Data, expected: MotorSet, now: Instant) {
        if kind.ends_motion() {
            let (held, off) = (MotorSet::EMPTY, MotorSet::EMPTY);
            self.end_of_motion = Some(End { put: now, held, off });
        }
        self.kind = Some(kind);
        self.data = data;
        self.expected = expected;
        self.answered = MotorSet::EMPTY;
        self.state = State::Waiting;
    }

    pub(super) fn is_active(&self) -> bool {
        self.state != State::None
    }

    /// Requests wait while it waits or is in flight. Not until it is told that it is over: who then begins
    /// the next one at once would keep them back for ever.
    pub(super) fn keeps_requests_back(&self) -> bool {
        self.is_waiting() || self.is_in_flight()
    }

    pub(super) fn is_waiting(&self) -> bool {
        matches!(self.state, State::Waiting | State::Again)
    }

    pub(super) fn waits_to_move(&self) -> bool {
        self.is_waiting() && self.kind.is_some_and(Kind::moves)
    }

    pub(super) fn is_in_flight(&self) -> bool {
        self.state == State::InFlight
    }

    pub(super) fn cancel(&mut self) {
        self.state = match self.state {
            State::None | State::Again => State::None,
            State::Waiting | State::Dropped => State::Dropped,
            State::InFlight | State::Sent | State::Done => State::Done,
        };
    }

    /// A motor is to end its motion: what may move all motors may move that one.
    pub(super) fn cancel_what_moves(&mut self) {
        if self.kind.is_some_and(Kind::is_refused_while_stopped) {
            self.cancel();
        }
    }

    /// A motor is stopped by itself.
    pub(super) fn was_overtaken(&mut self, motor: MotorId, by: StopKind) {
        let Some(End { held, off, .. }) = &mut self.end_of_motion else { return };
        held.remove(motor);
        off.remove(motor);
        match by {
            StopKind::Hold => held.insert(motor),
            StopKind::Off => off.insert(motor),
        }
    }

    /// The motors that were stopped since all were told last to end their motion: to be held, and to be off.
    pub(super) fn stopped_since(&self) -> (MotorSet, MotorSet) {
        self.end_of_motion.map_or_else(Default::default, |end| (end.held, end.off))
    }

    /// This motor is to be held. A controller that keeps no order sends what switches all off behind that.
    pub(super) fn may_let_go(&mut self, motor: MotorId, now: Instant) {
        let [off, reset] = [Shutdown.encode()[0], Reset.encode()[0]];
        let is_reset_late = self.sent_byte == reset && self.late_until > now;
        if !self.moves && (is_reset_late || self.may_be_mistaken(off, motor.into())) {
            (self.moves, self.is_unheard) = (true, true);
        }
    }

    pub(super) fn packet(&self) -> Option<Packet> {
        let channel = self.kind?.channel_to(Target::All).ok()?;
        Some(Packet { channel, data: self.data })
    }

    /// What it asks.
    pub(super) fn question(&self) -> Option<Question> {
        Some(Question::of(self.kind?, &self.data))
    }

    /// What is or was sent last.
    pub(super) fn command(&self) -> (Option<Kind>, Data) {
        (self.kind, self.data)
    }

    pub(super) fn was_sent(&mut self, now: Instant, config: &Config) {
        let has_reply = self.kind.is_some_and(Kind::has_reply);
        let awaits_reply = has_reply && !self.expected.is_empty();
        self.state = match self.state {
            State::Again => State::None,
            _ if awaits_reply => State::InFlight,
            _ => State::Sent,
        };
        self.sent = now;
        self.deadline = now + config.reply_timeout;
        self.may_be_late = has_reply;
        self.sent_byte = self.data[0];
        if self.moves {
            // Who answers one of the two may be moved by the other yet.
            self.moved_before = MotorSet::ALL.without(self.heard.without(self.moved_before));
        }
        self.heard = MotorSet::EMPTY;
        self.moves = self.kind.is_some_and(Kind::may_move);
        self.is_unheard = self.may_move_any() && !config.is_rs485();
        self.late_until = self.late_until.max(self.deadline + config.late_window);
    }

    /// What was sent last is answered no more, and what moves has reached the drives or never will.
    fn is_over_for_good(&mut self) {
        self.may_be_late = false;
        if !self.is_unheard {
            (self.moves, self.moved_before) = (false, MotorSet::EMPTY);
        }
    }

    /// Something was heard. What was on its way before the bus was cut is heard within the usual time-out.
    pub(super) fn was_something_heard(&mut self, now: Instant, late_window: Duration) {
        if self.is_unheard && self.deadline <= now {
            self.bus_is_alive(now, late_window);
        }
    }

    /// The bus is whole: what lay in a mailbox all the time comes now.
    pub(super) fn bus_is_alive(&mut self, now: Instant, late_window: Duration) {
        if core::mem::take(&mut self.is_unheard) {
            self.extend(now + late_window);
        }
    }

    /// Whether the answer of one of `motors` to the last broadcast may still come, expected or not,
    /// and could be mistaken for the answer to a command with this byte.
    pub(super) fn may_be_mistaken(&self, byte: u8, motors: MotorSet) -> bool {
        self.may_be_late && self.sent_byte == byte && !motors.without(self.heard).is_empty()
    }

    /// Whether what was sent may still reach this motor and move it, for a time that is known: on a bus that may be
    /// cut only an answer tells when that ends.
    pub(super) fn may_move_for_a_while(&self, motor: MotorId) -> bool {
        !self.is_unheard && self.may_move(motor)
    }

    /// Whether what was sent may still reach this motor and move it.
    pub(super) fn may_move(&self, motor: MotorId) -> bool {
        self.moves && !self.heard.contains(motor) || self.moved_before.contains(motor)
    }

    fn may_move_any(&self) -> bool {
        self.moves || !self.moved_before.is_empty()
    }

    /// When all were told last to end their motion.
    pub(super) fn ended_motion(&self) -> Option<Instant> {
        self.end_of_motion.map(|end| end.put)
    }

    /// The bus carries nothing: late answers come later, and so does what was sent.
    pub(super) fn extend(&mut self, until: Instant) {
        self.late_until = self.late_until.max(until);
    }

    /// Whether this broadcast may go, as far as the one before it is concerned: nobody among the
    /// `known` motors and the expected ones can still answer that.
    pub(super) fn may_go(&self, known: MotorSet) -> bool {
        let late = |motors: MotorSet| !motors.without(self.heard).is_empty();
        !self.may_be_late || !(late(known) || late(self.expected))
    }

    /// Whether this reply of `motor` answers the broadcast; each motor that is expected to does so
    /// once.
    #[inline(never)]
    pub(super) fn take_reply(
        &mut self,
        motor: MotorId,
        data: &Data,
        shortest: Duration,
        now: Instant,
    ) -> bool {
        // What comes sooner is a reply from before, doubled.
        if self.is_in_flight() && now - self.sent < shortest {
            return false;
        }
        if self.may_be_late && data[0] == self.sent_byte {
            self.heard.insert(motor);
        }
        let answers = self.is_in_flight()
            && self.expected.contains(motor)
            && self.kind.is_some_and(|kind| kind.answers(&self.data, data))
            && !self.answered.contains(motor);
        if answers {
            self.answered.insert(motor);
            if self.expected.without(self.answered).is_empty() {
                self.state = State::Done;
            }
        }
        answers
    }

    pub(super) fn poll_at(&self, earliest: &mut Earliest) {
        if self.is_in_flight() {
            earliest.take(self.deadline);
        }
    }

    /// A controller has handed it back: it was never on the bus, and moves nobody. Gives whether it ends motion, so
    /// that it goes once more.
    pub(super) fn was_pushed_out(&mut self, packet: &Packet) -> bool {
        if self.packet().as_ref() != Some(packet) {
            return false;
        }
        // Nobody has heard it, so that it need not wait for answers to itself.
        (self.moves, self.may_be_late, self.sent_byte) = (false, false, 0);
        if matches!(self.state, State::InFlight | State::Sent) {
            self.state = State::Waiting;
        }
        let is_decided = matches!(self.state, State::Again | State::Dropped);
        !is_decided && self.kind.is_some_and(Kind::ends_motion)
    }

    pub(super) fn goes_again(&mut self) {
        self.state = match self.state {
            State::None => State::Again,
            State::Done => State::Waiting,
            state => state,
        };
    }

    /// Until when something may have to wait for late answers.
    pub(super) fn late_until(&self) -> Option<Instant> {
        let is_over = !self.may_be_late && (self.is_unheard || !self.may_move_any());
        (!is_over).then_some(self.late_until)
    }

    /// That it is over, once.
    pub(super) fn take_result(&mut self) -> Option<Event> {
        let was_sent = match self.state {
            State::Sent | State::Done => true,
            State::Dropped => false,
            State::None | State::Waiting | State::Again | State::InFlight => return None,
        };
        self.state = State::None;
        Some(Event::BroadcastDone { silent: self.silent(), was_sent })
    }

    fn silent(&self) -> MotorSet {
        self.expected.without(self.answered)
    }
}

impl<const N: usize> Master<N> {
    pub(super) fn has_any_restarted(&self) -> bool {
        self.at(self.places.taken).any(|(_, motor)| motor.has_restarted)
    }

    /// What would move a motor that has restarted does not go by itself.
    pub(super) fn cancel_move_after_restart(&mut self) {
        if self.broadcast.waits_to_move() && self.has_any_restarted() {
            self.broadcast.cancel();
        }
    }

    /// Ends a broadcast whose time is up, or that would move a motor which has restarted. The silent ones may
    /// still answer it late.
    pub(super) fn age_broadcast(&mut self, now: Instant) {
        self.cancel_move_after_restart();
        if self.broadcast.late_until <= now {
            self.broadcast.is_over_for_good();
        }
        if !self.broadcast.is_in_flight() || self.broadcast.deadline > now {
            return;
        }
        self.broadcast.state = State::Done;
        self.due = now;
        for motor in self.broadcast.silent().iter() {
            self.change(motor, |motor, config| motor.has_missed(config, now));
        }
    }
}

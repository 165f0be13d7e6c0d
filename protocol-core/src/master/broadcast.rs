//! A command to all motors, and which of them have answered it.

use crate::command::Command;
use crate::data::Data;
use crate::error::RequestError;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::master::late::Question;
use crate::master::motor::is_before;
use crate::master::on_its_way::OnItsWay;
use crate::master::request::Purpose;
use crate::master::{Config, Event, Master, MotorSet, StopKind};
use crate::opcode::Opcode;
use crate::packet::Packet;
use crate::time::Instant;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    None,
    Waiting,
    /// It was reported as over and then handed back: it goes once more, and nothing is reported of that.
    Again,
    InFlight,
    /// It was sent and no motor is expected to answer; to be reported.
    Sent,
    /// It is over, sent or not; to be reported.
    Over,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Broadcast {
    state: State,
    /// It was sent, and not handed back since.
    is_sent: bool,
    kind: Option<Kind>,
    data: Data,
    /// The number of its ticket, which nobody gets.
    ticket: u32,
    /// The motors that are expected to answer it and have not.
    silent: MotorSet,
    /// The motors whose answer counted as lost when its time was up.
    lost: MotorSet,
    /// The motors that were stopped since it was put, to be held and to be off. If it ends motion it must not undo
    /// that, however late a controller hands it back.
    held: MotorSet,
    off: MotorSet,
    /// The last one that was sent: when, its command byte, and which motors may still answer it, expected or not.
    sent: Instant,
    sent_byte: u8,
    may_answer: MotorSet,
    /// What the last one may still do; and what those sent before it, and stops to all, may still do.
    last: MayUndo,
    others: MayUndo,
    /// A command that may move was sent, or motors were found that have no place. A stop of all must reach motors that
    /// were not named.
    pub(super) may_be_unnamed: bool,
    /// CAN: a command that may move was sent since these motors ended their motion, and they have not answered it. It
    /// may still be in a mailbox, even after cuts that went unnoticed.
    moved_since: MotorSet,
    /// Until when what was sent may still reach a drive, and be answered.
    pub(super) on_its_way: OnItsWay,
}

/// The motors that a frame which was sent may still reach, and what it would undo there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct MayUndo {
    /// It moves these.
    moves: MotorSet,
    /// It lets these go: it switches them off or restarts them, so that loads fall.
    lets_go: MotorSet,
    /// It holds these, and switches them on.
    holds: MotorSet,
}

impl MayUndo {
    /// What this command to all does. On CAN, arbitration may send it after what one motor is told. RS485 keeps the
    /// order of the commands that end motion.
    fn by(kind: Kind, config: &Config) -> Self {
        let is_can = !config.is_rs485();
        Self {
            moves: all_if(kind.may_move()),
            lets_go: all_if(is_can && kind.lets_go()),
            holds: all_if(is_can && kind == Kind::Known(Opcode::Stop)),
        }
    }

    fn with(self, other: Self) -> Self {
        Self {
            moves: self.moves.with(other.moves),
            lets_go: self.lets_go.with(other.lets_go),
            holds: self.holds.with(other.holds),
        }
    }

    fn without(self, motor: MotorId) -> Self {
        let motor = MotorSet::from(motor);
        Self {
            moves: self.moves.without(motor),
            lets_go: self.lets_go.without(motor),
            holds: self.holds.without(motor),
        }
    }

    /// Whether it may undo this end of the motion of a motor.
    fn undoes(self, end: Kind, motor: MotorId) -> bool {
        let undone = match StopKind::by(end) {
            Some(StopKind::Hold) => self.moves.with(self.lets_go),
            Some(StopKind::Off) => self.moves.with(self.holds),
            None => self.moves,
        };
        undone.contains(motor)
    }
}

fn all_if(is_so: bool) -> MotorSet {
    if is_so { MotorSet::ALL } else { MotorSet::EMPTY }
}

impl Broadcast {
    pub(super) fn put(&mut self, kind: Kind, data: Data, expected: MotorSet, ticket: u32) {
        self.ticket = ticket;
        (self.held, self.off) = (MotorSet::EMPTY, MotorSet::EMPTY);
        self.kind = Some(kind);
        self.data = data;
        (self.silent, self.lost) = (expected, MotorSet::EMPTY);
        (self.state, self.is_sent) = (State::Waiting, false);
    }

    pub(super) fn is_active(&self) -> bool {
        self.state != State::None
    }

    pub(super) fn is_waiting(&self) -> bool {
        matches!(self.state, State::Waiting | State::Again)
    }

    /// Whether it was put after this request.
    pub(super) fn is_after(&self, ticket: u32) -> bool {
        is_before(ticket, self.ticket)
    }

    /// What is to be sent, if anything.
    pub(super) fn waiting(&self) -> Option<Kind> {
        if self.is_waiting() { self.kind } else { None }
    }

    /// Whether this motor must answer twice what ends its motion. The first answer shows that the bus is intact; what
    /// is in a mailbox leaves it then.
    pub(super) fn has_moved_since(&self, motor: MotorId) -> bool {
        self.moved_since.contains(motor)
    }

    /// The motor has answered what is to end its motion: if a move is still in a mailbox, it leaves it now.
    pub(super) fn note_answer_of(&mut self, motor: MotorId, now: Instant, config: &Config) {
        self.on_its_way.note_bus_alive(now, config);
        if self.moved_since.contains(motor) {
            self.on_its_way.extend(now, config);
        }
    }

    pub(super) fn note_motion_ended_of(&mut self, motor: MotorId) {
        self.moved_since.remove(motor);
    }

    /// Whether it waits to move this motor, or what was sent may still do so.
    pub(super) fn may_yet_move(&self, motor: MotorId) -> bool {
        self.others.with(self.last).moves.contains(motor)
            || self.waiting().is_some_and(Kind::may_move)
    }

    pub(super) fn is_in_flight(&self) -> bool {
        self.state == State::InFlight
    }

    pub(super) fn cancel(&mut self) {
        self.state = match self.state {
            State::None | State::Again => State::None,
            State::Waiting | State::InFlight | State::Sent | State::Over => State::Over,
        };
    }

    /// A motor is to end its motion: a command that may move all motors may move that one.
    pub(super) fn cancel_what_moves(&mut self) {
        if self.kind.is_some_and(Kind::is_refused_while_stopped) {
            self.cancel();
        }
    }

    /// These motors are stopped in this way, individually or with all others, also those without a place.
    pub(super) fn was_overtaken(&mut self, by: StopKind, motors: MotorSet) {
        (self.held, self.off) = (self.held.without(motors), self.off.without(motors));
        match by {
            StopKind::Hold => self.held = self.held.with(motors),
            StopKind::Off => self.off = self.off.with(motors),
        }
    }

    /// The motors that were stopped since the last broadcast was put: to be held, and to be off.
    pub(super) fn stopped_since(&self) -> (MotorSet, MotorSet) {
        (self.held, self.off)
    }

    pub(super) fn packet(&self) -> Option<Packet> {
        let channel = self.kind?.channel_to(Target::All).ok()?;
        Some(Packet { channel, data: self.data })
    }

    pub(super) fn question(&self) -> Option<Question> {
        Some(Question::of(self.kind?, &self.data))
    }

    /// The command that is to be sent or was sent last.
    pub(super) fn command(&self) -> (Option<Kind>, Data) {
        (self.kind, self.data)
    }

    pub(super) fn was_sent(&mut self, now: Instant, config: &Config) {
        let Some(kind) = self.kind else { return };
        let awaits_reply = kind.has_reply() && !self.silent.is_empty();
        self.state = match self.state {
            State::Again => State::None,
            _ if awaits_reply => State::InFlight,
            _ => State::Sent,
        };
        (self.is_sent, self.sent, self.sent_byte) = (true, now, self.data[0]);
        self.may_answer = all_if(kind.has_reply());
        self.may_be_unnamed |= kind.may_move();
        self.others = self.others.with(self.last);
        if kind.may_move() && !config.is_rs485() {
            // The answer to this one says nothing about those before it.
            self.others.moves = self.others.moves.with(self.moved_since);
            self.moved_since = MotorSet::ALL;
        }
        self.last = MayUndo::by(kind, config);
        let may_be_cut = !config.is_rs485() && self.others.with(self.last) != MayUndo::default();
        self.on_its_way.put(now + config.reply_timeout, may_be_cut, config);
    }

    /// CAN: a stop to all was sent, which is due to be answered by then. Its answers are not counted here.
    pub(super) fn stop_was_sent(&mut self, stop: Kind, due: Instant, config: &Config) {
        self.others = self.others.with(MayUndo::by(stop, config));
        self.on_its_way.put(due, true, config);
    }

    fn age(&mut self, now: Instant, heard_at: Instant, config: &Config) {
        if !self.on_its_way.is_any() {
            return;
        }
        self.on_its_way.age(now, heard_at, config);
        if self.on_its_way.end_on_whole_bus().is_none_or(|end| end <= now) {
            self.may_answer = MotorSet::EMPTY;
        }
        if !self.on_its_way.is_any() {
            (self.last, self.others) = (MayUndo::default(), MayUndo::default());
        }
    }

    /// Whether the answer of this motor to the last broadcast may still come, expected or not, and could be mistaken
    /// for the answer to a command with this byte.
    pub(super) fn may_be_mistaken(&self, byte: u8, motor: MotorId) -> bool {
        self.may_answer.contains(motor) && self.sent_byte == byte
    }

    /// Whether what was sent may still reach this motor and undo this end of its motion.
    pub(super) fn may_undo(&self, end: Kind, motor: MotorId) -> bool {
        self.others.with(self.last).undoes(end, motor)
    }

    /// The same, if it is known when that ends: on a bus that may be cut only an answer shows it.
    pub(super) fn may_undo_for_a_while(&self, end: Kind, motor: MotorId) -> bool {
        self.on_its_way.end().is_some() && self.may_undo(end, motor)
    }

    /// When it can no longer be answered, or undo anything.
    pub(super) fn next_end(&self) -> Option<Instant> {
        let is_answered = self.may_answer.is_empty();
        if is_answered { self.on_its_way.end() } else { self.on_its_way.end_on_whole_bus() }
    }

    /// Whether this broadcast may go after the one before it: no `known` or expected motor can still answer that.
    pub(super) fn may_go(&self, known: MotorSet) -> bool {
        let asked = known.with(self.silent);
        asked.without(self.may_answer) == asked
    }

    /// The motor has answered with this command byte. Returns whether that may be its answer to the last broadcast.
    pub(super) fn take_owed(&mut self, byte: u8, motor: MotorId) -> bool {
        let is_owed = self.may_be_mistaken(byte, motor);
        if is_owed {
            self.may_answer.remove(motor);
            if self.last.moves.contains(motor) && !self.others.moves.contains(motor) {
                self.moved_since.remove(motor);
            }
            self.last = self.last.without(motor);
        }
        is_owed
    }

    /// Whether this reply of `motor` answers this broadcast; each motor that is expected to answer does so once.
    pub(super) fn take_answer(&mut self, motor: MotorId, reply: &Packet) -> bool {
        let answers = self.is_in_flight()
            && self.silent.contains(motor)
            && self.question().is_some_and(|asked| asked.is_answered_by(reply));
        if answers {
            self.silent.remove(motor);
            if self.silent.is_empty() {
                self.state = State::Over;
            }
        }
        answers
    }

    /// When it was sent; while it waits, when the one before it was sent.
    pub(super) fn sent_at(&self) -> Instant {
        self.sent
    }

    pub(super) fn in_flight_since(&self) -> Option<Instant> {
        self.is_in_flight().then_some(self.sent)
    }

    /// When it is over although not all motors have answered.
    pub(super) fn deadline(&self, config: &Config) -> Option<Instant> {
        self.in_flight_since().map(|sent| sent + config.reply_timeout)
    }

    /// Whether this frame, which is handed back, may be it. If it was not sent, the frame only looks like it.
    pub(super) fn may_be(&self, packet: &Packet) -> bool {
        self.is_sent && self.packet().as_ref() == Some(packet)
    }

    /// A controller has handed it back: it was never on the bus, and moves no motor. Returns the motors whose answer
    /// counted as lost.
    pub(super) fn was_pushed_out(&mut self) -> MotorSet {
        // No motor has heard it, so that it need not wait for answers to itself.
        self.may_answer = MotorSet::EMPTY;
        self.last = MayUndo::default();
        self.is_sent = false;
        self.state = match self.state {
            State::InFlight | State::Sent => State::Waiting,
            // What ends motion goes all the same. Anything else was ended for another reason.
            State::Over if self.kind.is_some_and(Kind::ends_motion) => State::Waiting,
            state => state,
        };
        core::mem::take(&mut self.lost)
    }

    pub(super) fn goes_again(&mut self) {
        if self.state == State::None {
            self.state = State::Again;
        }
    }

    /// Reports once that it is over.
    pub(super) fn take_result(&mut self) -> Option<Event> {
        if !matches!(self.state, State::Sent | State::Over) {
            return None;
        }
        self.state = State::None;
        Some(Event::BroadcastDone { silent: self.silent, was_sent: self.is_sent })
    }
}

impl<const N: usize> Master<N> {
    /// Sends a command to all motors at once (CAN 0x280, RS485 0xCD) and collects the answers of `expected` until all
    /// have come or the time is up.
    ///
    /// - It waits for the requests in flight. While it waits, requests that were put before it are still sent, and
    ///   those that end motion. All others wait until it is over.
    /// - The next broadcast waits until all motors that have a place have answered this one, or can no longer answer
    ///   it.
    /// - On CAN it reaches motors whose id filter (function 2) is off. On RS485 the answers of several motors are
    ///   likely to collide.
    /// - `expected` should name all motors that answer: the answers of others come as [`Event::Stray`].
    ///
    /// # One that moves
    /// If the command moves, or opens brakes, name in `expected` all motors that it may reach. Each takes a place, so
    /// that [`stop_all`](Self::stop_all) sends it a stop of its own, which it confirms. On CAN a motor that has not
    /// answered the broadcast confirms its next stop only with a second answer, 50 ms or so after the first: the move
    /// may be in a controller's mailbox until then.
    ///
    /// # One that ends motion
    /// To end motion at once use [`stop_all`](Self::stop_all). A broadcast is slower, proves less and forbids nothing:
    ///
    /// - Whatever is put after it is sent: the next set-points of a stream move the motors on.
    /// - It waits for what is in flight, and for a stop for as long as a motor does not confirm that.
    /// - One that holds (0x81) waits for each Shutdown (0x80) that was requested before, even if that waits for the end
    ///   of a restart.
    /// - An answer to it does not show that nothing sent before can move the motor any more.
    ///
    /// It drops the set-points and moves that wait. If it lets motors go (0x80, 0x76), a Stop (0x81) of one motor that
    /// is under way becomes a Shutdown of that motor, which is confirmed as a stop.
    ///
    /// If one motor is [stopped](Self::stop) individually while the broadcast waits, or before a controller hands it
    /// back, and the broadcast would undo that stop, the broadcast is over. Each other motor that has a place gets the
    /// command individually, as a stop; a restart goes to no motor. Motors without a place then get nothing. The same
    /// applies to a broadcast that holds (0x81) while a stop in force keeps a motor off.
    ///
    /// # Errors
    /// [`RequestError`], and nothing is sent, in these cases:
    ///
    /// - The command has no form for all motors, or none on this bus.
    /// - Another broadcast is under way. That includes one that ends motion, was already reported as over, and goes
    ///   once more because a controller has handed it back.
    /// - The motors were stopped.
    /// - It moves motors, and one has [restarted](Event::Restarted) or there is no place for all of `expected`.
    pub fn broadcast<C: Command>(
        &mut self,
        command: C,
        expected: MotorSet,
    ) -> Result<(), RequestError> {
        let data = command.encode();
        self.put_broadcast(command.kind().of_bytes(&data), data, expected)
    }

    /// Compiled once for all types.
    #[inline(never)]
    fn put_broadcast(
        &mut self,
        kind: Kind,
        data: Data,
        expected: MotorSet,
    ) -> Result<(), RequestError> {
        let now = self.now;
        self.check(kind, Target::All)?;
        if kind.moves() {
            self.change_all(|motor, config| motor.note_restart_if_silent(config, now));
            if self.has_any_restarted() {
                return Err(RequestError::Restarted);
            }
        }
        if self.broadcast.is_active() {
            return Err(RequestError::Busy);
        }
        if kind.may_move() {
            self.give_places(expected)?;
        }
        self.last_ticket = self.last_ticket.wrapping_add(1);
        self.broadcast.put(kind, data, expected, self.last_ticket);
        if self.stop_to_all.is_none() {
            self.for_all = self.for_all.put_anew();
        }
        if kind.ends_motion() {
            // What was offered may be a set-point that this command ends.
            self.offer = None;
            self.is_any_off_since |= kind == Kind::Known(Opcode::Shutdown);
            if kind.lets_go() {
                self.let_line_answer();
            }
            let off = kind.lets_go().then(|| self.stop_of(StopKind::Off.command(), Purpose::Stop));
            self.change_all(|motor, config| motor.end_with_all(off, config, now));
            // It may have to go to each motor individually.
            self.end_motion_of_all();
        }
        Ok(())
    }

    /// Ends a broadcast whose time is up, or that would move a motor that has restarted.
    pub(super) fn age_broadcast(&mut self, now: Instant) {
        self.cancel_move_after_restart();
        self.broadcast.age(now, self.heard_at_least(), &self.config);
        if self.broadcast.deadline(&self.config).is_none_or(|deadline| deadline > now) {
            return;
        }
        self.broadcast.state = State::Over;
        self.broadcast.lost = self.broadcast.silent;
        for motor in self.broadcast.lost.iter() {
            self.change(motor, |motor, config| motor.note_miss(config, now));
        }
    }
}

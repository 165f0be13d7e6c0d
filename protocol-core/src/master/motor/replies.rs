//! What a reply means to its motor: every reply is compared with what is in flight and with what may come late.

use crate::command::{AnyReply, Command, ReadRunTime};
use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::broadcast::Broadcast;
use crate::master::late::{Of, Question};
use crate::master::motor::Motor;
use crate::master::motor::restarts::{HALF_A_TURN_TAKES, Position};
use crate::master::request::{Asked, Proof, Purpose, Request};
use crate::master::stop::{STOP_ATTEMPTS, StopKind};
use crate::master::stream::SetPoint;
use crate::master::{Config, Failure, MotorSet, TicketId};
use crate::opcode::{Opcode, Repeat};
use crate::packet::Packet;
use crate::time::{Duration, Instant};

/// What a reply is, as far as its motor knows. How long it took is known unless it may answer one of several sendings.
pub(crate) enum Meaning {
    /// It answers a set-point.
    Feedback(AnyReply, Option<Duration>),
    /// It shows that the set-point in flight was ignored.
    SetPointIgnored,
    /// It answers the caller's request of this kind.
    Answer(TicketId, Kind, Option<Duration>),
    /// It confirms the stop.
    StopConfirmed(Option<Duration>),
    /// It answers what was asked, but does not end it: there is nothing to report.
    Nothing,
    /// It may also answer the broadcast, and ends nothing.
    OfBroadcast,
    /// It is the late answer to something that was given up.
    Late,
    /// It is none of these, or the last answer doubled.
    Unasked { is_doubled: bool },
}

/// A reply, and what the master knows of its motor.
pub(crate) struct Heard<'a> {
    pub(crate) config: &'a Config,
    pub(crate) from: MotorId,
    pub(crate) packet: &'a Packet,
    pub(crate) at: Instant,
    pub(crate) to_all: &'a mut Broadcast,
    pub(crate) lost_master: &'a mut MotorSet,
}

impl Heard<'_> {
    /// Whether it may be the answer to a broadcast.
    fn may_answer_broadcast(&self) -> bool {
        !self.packet.is_motion() && self.to_all.may_be_mistaken(self.packet.data[0], self.from)
    }

    /// Whether it may be a command that a drive without a master has ignored and sent back.
    fn may_be_ignored_one(&self) -> bool {
        self.lost_master.contains(self.from)
    }

    /// The same for a reply to the command in flight. The drive ignores only one command. If this reply may be from
    /// before its message, the ignored command may be the next one, since an answer may equal its command.
    fn take_ignored_one(&mut self, may_be_of_before: bool) -> bool {
        let may_be = self.may_be_ignored_one();
        if may_be && !may_be_of_before {
            self.lost_master.remove(self.from);
        }
        may_be
    }
}

impl Motor {
    pub(crate) fn take(&mut self, heard: &mut Heard<'_>) -> Meaning {
        let &mut Heard { config, packet, at: now, .. } = heard;
        let is_same = |question: Question| question.is_answered_by(packet);
        let may_be_doubled = self.was_heard(config, now) && self.last_answered.is_some_and(is_same);
        let shortest = match config.shortest_response {
            clear if may_be_doubled && clear > Duration::ZERO => clear.max(config.doubled_within()),
            clear => clear,
        };
        let is_in_time = now - self.sent >= shortest;
        let answers = |question: Question| is_in_time && is_same(question);
        if let Some(&set_point) = self.stream.in_flight().filter(|sent| answers(sent.question)) {
            self.last_answered = Some(set_point.question);
            return self.take_feedback(&set_point, heard);
        }
        if let Some(&asked) = self.request.answerable().filter(|asked| answers(asked.question)) {
            self.last_answered = Some(asked.question);
            return self.take_what_may_answer(asked, may_be_doubled, heard);
        }
        // It came too soon after the last sending: it answers an earlier one, or a stop to all. As a stray it would look
        // like another master's stop.
        let is_of_end = |asked: &Asked| {
            let was_sent_before = asked.unanswered > 1 || may_be_doubled;
            asked.ends_motion() && was_sent_before && is_same(asked.question)
        };
        if self.request.under_way().is_some_and(is_of_end) {
            return Meaning::Nothing;
        }
        self.take_what_answers_nothing(may_be_doubled, heard)
    }

    /// A reply that matches this request, but may belong to something else.
    fn take_what_may_answer(
        &mut self,
        asked: Asked,
        may_be_doubled: bool,
        heard: &mut Heard<'_>,
    ) -> Meaning {
        // If the request waits to be sent again, this is the last answer doubled.
        if may_be_doubled && self.request.waiting().is_some() {
            return Meaning::Nothing;
        }
        if !asked.is_stop() {
            return self.take_answer(asked, heard);
        }
        // A reply that belongs to a broadcast or an earlier stop comes first, and says nothing about this one.
        if heard.may_answer_broadcast() {
            self.request = Request::Waiting(asked);
            return Meaning::OfBroadcast;
        }
        if self.take_late(heard.packet, may_be_doubled).is_none() {
            return self.take_answer(asked, heard);
        }
        // What may be the last reply doubled does not count: each would cause one more stop.
        if !may_be_doubled {
            self.go_on_unconfirmed(asked, heard.config);
        }
        Meaning::Nothing
    }

    /// A reply that matches nothing under way.
    #[inline(never)]
    fn take_what_answers_nothing(&mut self, may_be_doubled: bool, heard: &Heard<'_>) -> Meaning {
        let &Heard { config, packet, .. } = heard;
        if heard.may_answer_broadcast() {
            // It looks like a late reply, and may not be one: that does not show that the move has arrived.
            self.is_beyond_late |= self.may_yet_move();
        }
        match self.take_late(packet, may_be_doubled) {
            None => Meaning::Unasked {
                is_doubled: may_be_doubled && config.shortest_response > Duration::ZERO,
            },
            Some(Of::Nobody) => Meaning::Nothing,
            Some(Of::Request | Of::RequestStopped | Of::RequestAnswered) => Meaning::Late,
            // It may be a set-point that was ignored, or from before that: the bytes of the set-point are no longer
            // known.
            Some(_) if heard.may_be_ignored_one() || self.may_be_sent_back(packet) => Meaning::Late,
            Some(_) => match AnyReply::decode(packet, config.firmware) {
                Ok(reply) => self.feedback(reply, Position::of(&reply), None, heard),
                Err(_) => Meaning::Late,
            },
        }
    }

    /// Feedback of its stream has come.
    fn feedback(
        &mut self,
        reply: AnyReply,
        position: Option<Position>,
        round_trip: Option<Duration>,
        heard: &Heard<'_>,
    ) -> Meaning {
        let &Heard { config, at: now, .. } = heard;
        if let Some(position) = position {
            self.note_position(position, config, now);
        }
        self.latest = Some((reply, now));
        Meaning::Feedback(reply, round_trip)
    }

    /// A reply to the set-point in flight.
    fn take_feedback(&mut self, set_point: &SetPoint, heard: &mut Heard<'_>) -> Meaning {
        let &mut Heard { config, packet, at: now, .. } = heard;
        let Ok(reply) = AnyReply::decode(packet, config.firmware) else {
            return Meaning::Unasked { is_doubled: false };
        };
        self.on_its_way.note_bus_alive(now, config);
        // An earlier set-point may be what was ignored, and its bytes are no longer known.
        let mut is_one_late = self.prolong_late(set_point.question, config, now);
        let may_be_of_all = heard.may_answer_broadcast();
        if may_be_of_all {
            // If it belongs to the broadcast, the reply to this set-point is still to come.
            self.expect_late(set_point.question, Of::StreamAnswered, 1, now, config);
            is_one_late = true;
        }
        let is_echo = set_point.data == packet.data;
        let is_handed_back = is_echo && set_point.question.kind.is_handed_back(&packet.data);
        self.stream.take_in_flight();
        let is_of_before = self.was_told_before_it_lost_master();
        if heard.take_ignored_one(is_of_before) && (is_one_late || is_echo) || is_handed_back {
            self.has_let_go();
            return Meaning::SetPointIgnored;
        }
        if !self.is_steady() && self.may_be_sent_back(packet) {
            // It shows that the motor is spoken to: the feedback of some drives always looks like this.
            self.note_there();
            return Meaning::SetPointIgnored;
        }
        let round_trip = now - self.sent;
        self.answered(Some(round_trip));
        // An echo says nothing about the position, even if it is not known why it came.
        let position = Position::of(&reply).filter(|_| !is_echo);
        let meaning = self.feedback(reply, position, Some(round_trip), heard);
        // If it answers an earlier set-point it is hardly older, and a missed jump is worse than a false one.
        if let Some(position) =
            position.filter(|_| !may_be_of_all && round_trip <= HALF_A_TURN_TAKES)
        {
            (self.position, self.position_at) = (Some(position), now);
        }
        meaning
    }

    /// Its answer may belong to an earlier stop, so it is sent again: at once or, if stops go on and on, when no earlier
    /// answer can come. Otherwise each stop would leave more of them pending.
    fn go_on_unconfirmed(&mut self, stop: Asked, config: &Config) {
        if stop.purpose == Purpose::StopCalledAgain || stop.unanswered > STOP_ATTEMPTS / 2 {
            self.waits_to_go_once_more(stop, Proof::WaitsForOwed, config);
        } else {
            self.request = Request::Waiting(stop);
        }
    }

    /// What ends its motion is sent once more, when no earlier answer can be taken for that to the last.
    fn waits_to_go_once_more(&mut self, mut asked: Asked, proof: Proof, config: &Config) {
        let due = self.sent + asked.timeout;
        let (of, replies) = (asked.of_others(), core::mem::take(&mut asked.unanswered));
        self.expect_late(asked.question, of, replies, due, config);
        asked.proof = proof;
        self.request = Request::Waiting(asked);
    }

    /// A reply to the request in flight.
    fn take_answer(&mut self, mut asked: Asked, heard: &mut Heard<'_>) -> Meaning {
        let &mut Heard { config, from: motor, packet: &Packet { data, .. }, at: now, .. } = heard;
        asked.unanswered = asked.unanswered.saturating_sub(1);
        let is_in_flight = self.request.in_flight().is_some();
        self.request = Request::InFlight(asked);
        let is_echo = asked.data == data;
        let is_handed_back = is_echo && asked.kind().is_handed_back(&data);
        let is_of_before =
            self.was_told_before_it_lost_master() || asked.unanswered > 0 && !asked.is_stop();
        if heard.take_ignored_one(is_of_before) && is_echo || is_handed_back {
            self.has_let_go();
            // The drive ignores one command, and no more.
            if asked.may_go_again() && asked.kind().repeat() == Repeat::Harmless {
                self.request = Request::Waiting(asked);
            } else {
                self.request_has_failed(Failure::NotExecuted, config, now);
            }
            return Meaning::Nothing;
        }
        // The drive may have lost its master, in a silence or before this one was there to hear of it. Then it has
        // ignored this, too.
        // Where commands are echoed, an answer that comes behind a further attempt passes for its echo: then equal
        // answers might use up all attempts.
        let may_be_behind = config.echoes() && asked.unanswered > 0;
        let may_be_ignored = is_echo && self.is_anew() && !may_be_behind;
        if may_be_ignored && asked.kind().is_read() && asked.may_go_again() {
            self.answered(None);
            asked.attempts_left = asked.attempts_left.saturating_add(1);
            self.request = Request::Waiting(asked);
            return Meaning::Nothing;
        }
        // With more than one attempt under way it is not known which one this answers.
        let round_trip = (is_in_flight && asked.unanswered == 0).then_some(now - self.sent);
        if is_in_flight {
            self.answered(round_trip);
        } else {
            // The command counted as lost, or was to all.
            self.note_there();
        }
        let kind = asked.kind();
        if kind.ends_motion() {
            let may_undo = heard.to_all.may_undo(kind, motor);
            let may_lie = heard.to_all.has_moved_since(motor) || self.may_lie_in_mailbox(config);
            // The bus is intact at last: what is in a mailbox leaves it now.
            if asked.proof == Proof::First && may_lie && !may_undo {
                self.may_move_after(now, config);
            }
            if may_undo || self.may_yet_move() {
                // Nothing that moves it, alone or with all, goes between the attempts to end its motion.
                self.on_its_way.note_bus_alive(now, config);
                heard.to_all.note_answer_of(motor, now, config);
                self.waits_to_go_once_more(asked, Proof::Waits, config);
                return Meaning::Nothing;
            }
            if StopKind::by(kind) == Some(StopKind::Hold) && !self.is_steady() {
                asked.was_answered_early();
                // With a long pause before each sending it never obeys for sure.
                if asked.may_go_again() {
                    self.request = Request::Waiting(asked);
                } else {
                    self.request_has_failed(Failure::NotExecuted, config, now);
                }
                return Meaning::Nothing;
            }
            self.note_motion_ended(kind);
            heard.to_all.note_motion_ended_of(motor);
        }
        self.finish_request(asked.of_others(), config, now);
        if asked.is_stop() {
            return Meaning::StopConfirmed(round_trip);
        }
        if let (Kind::Known(Opcode::ReadRunTime), Ok(reply)) =
            (kind, ReadRunTime::decode_reply(&data))
        {
            // It may answer one of several sendings, each of which waited for its turn after the time-out of the last.
            let earlier = asked.timeout.times(2 * u32::from(asked.unanswered));
            self.note_run_time(reply, earlier, config, now);
        }
        let ticket = TicketId { motor, number: self.ticket };
        Meaning::Answer(ticket, kind, round_trip)
    }
}

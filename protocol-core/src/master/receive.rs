//! What a received frame means to the master.

use crate::command::{AnyReply, BusId, Command, ReadRunTime};
use crate::data::Data;
use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::broadcast::Broadcast;
use crate::master::late::{Of, Question};
use crate::master::motor::reports::reported_bit;
use crate::master::motor::restarts::{HALF_A_TURN_TAKES, Place};
use crate::master::motor::{DOUBLED_WITHIN, LastSent, Motor};
use crate::master::request::{Asked, Purpose, Request, Round};
use crate::master::stop::STOP_ATTEMPTS;
use crate::master::stream::SetPoint;
use crate::master::{Config, Event, Failure, Master, MotorSet, TicketId};
use crate::opcode::{LOST_MASTER_BYTE, Opcode, Repeat};
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::wire::{can, rs485};

/// What a reply is, as far as its motor knows. How long it took is known unless it may answer one of
/// several sendings.
enum Meaning {
    /// It answers a set-point.
    Feedback(AnyReply, Option<Duration>),
    /// It shows that the set-point in flight was ignored.
    SetPointIgnored,
    /// It answers the caller's request of this kind.
    Answer(TicketId, Kind, Option<Duration>),
    /// It confirms the stop.
    StopConfirmed(Option<Duration>),
    /// It answers what was asked, but does not end it: nothing is to be reported.
    Nothing,
    /// It answers what ends motion, which goes once more: something sent before may move the motor yet.
    OnceMore,
    /// It may as well answer the broadcast, and ends nothing.
    OfBroadcast,
    /// It is the late answer to something that was given up.
    Late,
    /// It is what was answered last, once more.
    Doubled,
    /// It is none of these.
    Unasked,
}

/// A reply, and what the master knows of the motor that it is from.
struct Heard<'a> {
    from: MotorId,
    packet: &'a Packet,
    at: Instant,
    to_all: &'a Broadcast,
    lost_master: &'a mut MotorSet,
}

impl Heard<'_> {
    /// Whether it may be the answer to what all were told.
    fn may_answer_broadcast(&self) -> bool {
        let is_motion = matches!(self.packet.channel, Channel::MotionReply(_));
        !is_motion && self.to_all.may_be_mistaken(self.packet.data[0], self.from)
    }

    /// Whether it may be the echo of a drive that has lost its master and ignored the command.
    fn may_be_ignored_one(&self) -> bool {
        self.lost_master.contains(self.from)
    }

    /// The same, of what answers the command in flight. It ignores one, and no more: the next, if this may be of before
    /// it said so, since an answer may equal its command.
    fn take_ignored_one(&mut self, may_be_of_before: bool) -> bool {
        let may_be = self.may_be_ignored_one();
        if may_be && !may_be_of_before {
            self.lost_master.remove(self.from);
        }
        may_be
    }
}

impl<const N: usize> Master<N> {
    /// Takes a frame from the CAN bus. Commands of other masters, foreign frames and frames of a
    /// wrong length complete nothing.
    pub fn handle_frame(&mut self, frame: &can::Received, now: Instant) -> Option<Event> {
        self.frame_has_come(now);
        match frame {
            can::Received::Packet(packet) => self.handle_packet(packet, now),
            &can::Received::WrongLength { channel: Channel::Reply(motor), first, .. } => {
                if first == Some(LOST_MASTER_BYTE) {
                    return Some(self.lost_master(motor, now));
                }
                self.count_stray(motor);
                None
            }
            _ => None,
        }
    }

    /// Takes a reply from the RS485 line. What the adapter hands back of one's own bytes is none: see
    /// [`EchoFilter`](crate::io::EchoFilter).
    pub fn handle_line(&mut self, frame: &rs485::Frame, now: Instant) -> Option<Event> {
        let before = self.busy_until;
        self.line_is_free_after_turnaround(now);
        // Whoever fills the line holds no stop up.
        let is_stop_due = match self.choose_interruption() {
            Some((at, _)) => at <= now,
            None => self.choose_stop().is_some(),
        };
        if is_stop_due {
            self.busy_until = before.min(self.busy_until);
        }
        self.handle_packet(&frame.as_reply()?, now)
    }

    /// When something was last heard on the bus, and earlier by as much as the late window has grown: what was sent
    /// may have been given less time.
    pub(super) fn heard_at_least(&self) -> Instant {
        let more = self.round_trips.map_or(Duration::ZERO, |trips| trips.more());
        Instant::ZERO + ((self.heard_at - Instant::ZERO) - more)
    }

    /// A frame on its way to us held up those that are queued.
    fn frame_has_come(&mut self, now: Instant) {
        self.heard_at = now;
        if self.busy_until > now {
            // What is queued is not answered. Without that bound a bus that is always full would seem busy
            // for ever longer, since frames are shorter than they may be.
            let queued = self.config.frame_time.times(self.places.in_flight.count());
            self.busy_until = (self.busy_until + self.config.frame_time).min(now + queued);
        } else {
            self.busy_until = now;
        }
    }

    fn handle_packet(&mut self, packet: &Packet, now: Instant) -> Option<Event> {
        self.now = now;
        let data = &packet.data;
        match packet.channel {
            Channel::Reply(motor) if data[0] == LOST_MASTER_BYTE => {
                Some(self.lost_master(motor, now))
            }
            Channel::Reply(motor) | Channel::MotionReply(motor) => {
                self.handle_reply(motor, packet, now)
            }
            Channel::BusId => {
                let reply = BusId::decode_reply(data).ok()?;
                let (motor, reply) = (reply.id(), AnyReply::BusId(reply));
                let is_answer = self.answers_broadcast(motor, data, now);
                is_answer.then_some(Event::BroadcastReply { motor, reply })
            }
            Channel::Command(_) | Channel::Motion(_) => None,
        }
    }

    fn handle_reply(&mut self, id: MotorId, packet: &Packet, now: Instant) -> Option<Event> {
        let mut heard = Heard {
            from: id,
            packet,
            at: now,
            to_all: &self.broadcast,
            lost_master: &mut self.lost_master,
        };
        let meaning = self.places.of(id).and_then(|place| {
            let take = |motor: &mut Motor| motor.take(&mut heard, &self.config);
            self.places.change(&mut self.motors, place, take)
        });
        if !matches!(meaning, Some(Meaning::Feedback(..))) {
            self.due = now;
            self.stop_who_is_back(id, now);
        }
        match meaning.unwrap_or(Meaning::Unasked) {
            Meaning::Feedback(reply, round_trip) => {
                self.measured(round_trip);
                Some(Event::Feedback { motor: id, reply })
            }
            Meaning::SetPointIgnored => Some(Event::SetPointUnanswered { motor: id }),
            Meaning::Answer(ticket, kind, round_trip) => {
                self.measured(round_trip);
                if kind.ends_motion() {
                    self.broadcast.has_ended_motion_of(id);
                }
                Some(Event::Reply { ticket, kind, data: packet.data })
            }
            Meaning::StopConfirmed(round_trip) => {
                self.measured(round_trip);
                self.broadcast.has_ended_motion_of(id);
                Some(Event::StopConfirmed { motor: id })
            }
            Meaning::Nothing => None,
            Meaning::OnceMore => {
                // No move to all goes between the attempts of that, either.
                self.broadcast.is_answered_by(id, now, &self.config);
                None
            }
            Meaning::OfBroadcast => {
                let is_answer = self.answers_broadcast(id, &packet.data, now);
                let reply = AnyReply::decode(packet, self.config.firmware).ok();
                reply.filter(|_| is_answer).map(|reply| Event::BroadcastReply { motor: id, reply })
            }
            Meaning::Late => {
                if let Some(trips) = &mut self.round_trips {
                    trips.was_too_short(&mut self.config);
                }
                Some(self.stray(id, &packet.data))
            }
            Meaning::Doubled => Some(self.handle_unasked(id, packet, now, true)),
            Meaning::Unasked => Some(self.handle_unasked(id, packet, now, false)),
        }
    }

    fn measured(&mut self, round_trip: Option<Duration>) {
        if let (Some(trips), Some(round_trip)) = (&mut self.round_trips, round_trip) {
            let before = self.config.reply_timeout;
            trips.measured(round_trip, &mut self.config);
            // What else is in flight may be late sooner than it was.
            if self.config.reply_timeout < before {
                self.due = self.now;
            }
        }
    }

    /// Whether this reply of `motor` answers the broadcast.
    fn answers_broadcast(&mut self, motor: MotorId, data: &Data, now: Instant) -> bool {
        // What a drive has ignored that has lost its master is no answer.
        let (kind, command) = self.broadcast.command();
        let is_echo = self.broadcast.may_be_mistaken(data[0], motor) && command == *data;
        let is_handed_back = kind.is_some_and(|kind| kind.is_handed_back(data));
        if is_echo && (self.lost_master.contains(motor) || is_handed_back) {
            if !self.motor(motor).is_some_and(Motor::was_told_before_it_lost_master) {
                self.lost_master.remove(motor);
            }
            return false;
        }
        let shortest = self.config.shortest_response;
        let was_owed = self.broadcast.may_be_mistaken(data[0], motor);
        let is_answer = self.broadcast.take_reply(motor, data, shortest, now);
        let is_taken = was_owed && !self.broadcast.may_be_mistaken(data[0], motor);
        if is_answer || is_taken {
            // Also of one that is over: the same once more answers nothing else.
            let asked = Opcode::from_byte(data[0]).map(|known| Question::of(known.into(), data));
            let asked = asked.or(self.broadcast.question());
            self.change(motor, |motor, _| {
                motor.last_answered = asked;
                if is_answer {
                    motor.answered(None);
                }
            });
        }
        is_answer
    }

    /// An answer to the broadcast, a report, or anything else that nobody waits for.
    fn handle_unasked(
        &mut self,
        id: MotorId,
        packet: &Packet,
        now: Instant,
        is_doubled: bool,
    ) -> Event {
        // Motion mode has no command byte: its first byte is the drive's id and says nothing.
        if let Channel::MotionReply(_) = packet.channel {
            return self.stray(id, &packet.data);
        }
        let Ok(reply) = AnyReply::decode(packet, self.config.firmware) else {
            return self.stray(id, &packet.data);
        };
        if !is_doubled && self.answers_broadcast(id, &packet.data, now) {
            return Event::BroadcastReply { motor: id, reply };
        }
        let bit = Opcode::from_byte(packet.data[0]).and_then(reported_bit).unwrap_or(0);
        let is_report = match (self.motor(id), &reply) {
            // Errors are reported without having been asked for, too (function 3).
            (Some(_), AnyReply::ReadStatus1(_)) => {
                !self.broadcast.may_be_mistaken(packet.data[0], id)
            }
            (Some(motor), _) => motor.reports(bit, now),
            (None, _) => bit != 0,
        };
        if is_report { Event::Report { motor: id, reply } } else { self.stray(id, &packet.data) }
    }

    fn lost_master(&mut self, motor: MotorId, now: Instant) -> Event {
        self.due = now;
        self.lost_master.insert(motor);
        self.change(motor, |motor, config| {
            motor.was_heard(config, now);
            motor.last_sent.insert(LastSent::BEFORE_IT_LOST_MASTER);
        });
        Event::LostMaster { motor }
    }

    fn stray(&mut self, motor: MotorId, data: &Data) -> Event {
        self.count_stray(motor);
        Event::Stray { motor, data: *data }
    }

    fn count_stray(&mut self, motor: MotorId) {
        self.change(motor, |motor, _| motor.health.stray = motor.health.stray.saturating_add(1));
    }
}

impl Motor {
    /// Holds a reply against what is expected: what is in flight, and what may come late.
    fn take(&mut self, heard: &mut Heard<'_>, config: &Config) -> Meaning {
        let &mut Heard { packet, at: now, .. } = heard;
        let is_motion = matches!(packet.channel, Channel::MotionReply(_));
        let data = &packet.data;
        let is_same = |question: Question| question.is_answered_by(is_motion, data);
        let may_be_doubled = self.was_heard(config, now) && self.last_answered.is_some_and(is_same);
        let shortest = match config.shortest_response {
            clear if may_be_doubled && clear > Duration::ZERO => clear.max(DOUBLED_WITHIN),
            clear => clear,
        };
        let is_in_time = now - self.sent >= shortest;
        let answers = |question: Question| is_in_time && is_same(question);
        if let Some(&set_point) = self.stream.in_flight().filter(|sent| answers(sent.question)) {
            self.last_answered = Some(set_point.question);
            return self.take_feedback(&set_point, heard, config);
        }
        if let Some(&asked) = self.request.answerable().filter(|asked| answers(asked.question)) {
            self.last_answered = Some(asked.question);
            // Of what waits to be sent again: the last answer doubled.
            if may_be_doubled && self.request.waiting().is_some() {
                return Meaning::Nothing;
            }
            // One that is owed to a broadcast or an earlier stop says nothing of this one, and comes first.
            if asked.is_stop() && heard.to_all.may_be_mistaken(data[0], heard.from) {
                self.request = Request::Waiting(asked);
                return Meaning::OfBroadcast;
            }
            let late =
                if asked.is_stop() { self.take_late(false, data, may_be_doubled) } else { None };
            if late.is_none() {
                return self.take_answer(asked, heard, config);
            }
            // Nobody counts what may be the last one again: each would send one more.
            if !may_be_doubled {
                self.is_not_confirmed_by_that(asked, config);
            }
            return Meaning::Nothing;
        }
        // Too soon after that: to one sent before, or to all.
        let is_of_stop =
            |asked: &Asked| asked.is_stop() && asked.unanswered > 1 && is_same(asked.question);
        if self.request.in_flight().is_some_and(is_of_stop) {
            return Meaning::Nothing;
        }
        if heard.may_answer_broadcast() {
            self.late_replies_say_nothing();
        }
        match self.take_late(is_motion, data, may_be_doubled) {
            None if may_be_doubled && config.shortest_response > Duration::ZERO => Meaning::Doubled,
            Some(Of::Nobody) => Meaning::Nothing,
            Some(Of::Request | Of::RequestStopped | Of::RequestAnswered) => Meaning::Late,
            // Or it comes from before that, and the next command is what is ignored: nobody knows its bytes any more.
            Some(_) if heard.may_be_ignored_one() => Meaning::Late,
            Some(_) => match AnyReply::decode(packet, config.firmware) {
                Ok(reply) => self.feedback(reply, Place::of(&reply), None, config, now),
                Err(_) => Meaning::Late,
            },
            None => Meaning::Unasked,
        }
    }

    /// Feedback of its stream has come.
    fn feedback(
        &mut self,
        reply: AnyReply,
        place: Option<Place>,
        round_trip: Option<Duration>,
        config: &Config,
        now: Instant,
    ) -> Meaning {
        if let Some(place) = place {
            self.note_place(place, config, now);
        }
        (self.latest, self.latest_at) = (Some(reply), now);
        Meaning::Feedback(reply, round_trip)
    }

    /// A reply to the set-point in flight.
    fn take_feedback(
        &mut self,
        set_point: &SetPoint,
        heard: &mut Heard<'_>,
        config: &Config,
    ) -> Meaning {
        let &mut Heard { packet, at: now, .. } = heard;
        let Ok(reply) = AnyReply::decode(packet, config.firmware) else { return Meaning::Unasked };
        self.on_its_way.bus_is_alive(now, config);
        // An earlier one may be what was ignored, and nobody knows its bytes any more.
        let mut is_one_late = self.prolong_late(set_point.question, config, now);
        let may_be_of_all = heard.may_answer_broadcast();
        if may_be_of_all {
            // If it is that of all, this one's is still to come.
            let until = now + config.late_window;
            self.expect_late(set_point.question, Of::StreamAnswered, 1, until, config);
            is_one_late = true;
        }
        let is_echo = set_point.data == packet.data;
        let is_handed_back = is_echo && set_point.question.kind.is_handed_back(&packet.data);
        self.stream.take_in_flight();
        let is_of_before = self.was_told_before_it_lost_master();
        if heard.take_ignored_one(is_of_before) && (is_one_late || is_echo) || is_handed_back {
            return Meaning::SetPointIgnored;
        }
        let round_trip = now - self.sent;
        self.answered(Some(round_trip));
        // Also where nobody has heard why, an echo says nothing of that.
        let place = Place::of(&reply).filter(|_| !is_echo);
        let meaning = self.feedback(reply, place, Some(round_trip), config, now);
        // That to a set-point before is hardly older, and a jump that is missed is worse than one that is none.
        if let Some(place) = place.filter(|_| !may_be_of_all && round_trip <= HALF_A_TURN_TAKES) {
            (self.place, self.placed_at) = (Some(place), now);
        }
        meaning
    }

    /// Its answer may be owed to an earlier stop, so that it goes once more: at once, unless the motor was stopped before
    /// and this is called again, or that has happened before. Then it waits until nothing is owed any more: stops
    /// that go on would go on owing.
    fn is_not_confirmed_by_that(&mut self, stop: Asked, config: &Config) {
        if stop.purpose == Purpose::StopCalledAgain || stop.unanswered > STOP_ATTEMPTS / 2 {
            self.waits_to_go_once_more(stop, Round::WaitsForOwed, config);
        } else {
            self.request = Request::Waiting(stop);
        }
    }

    /// What ends its motion goes once more, when nobody can take an answer of before for that to the last.
    fn waits_to_go_once_more(&mut self, mut asked: Asked, round: Round, config: &Config) {
        let until = self.sent + asked.timeout + config.late_window;
        let (of, replies) = (asked.of_others(), core::mem::take(&mut asked.unanswered));
        self.expect_late(asked.question, of, replies, until, config);
        asked.round = round;
        self.request = Request::Waiting(asked);
    }

    /// A reply to the request in flight.
    fn take_answer(&mut self, mut asked: Asked, heard: &mut Heard<'_>, config: &Config) -> Meaning {
        let &mut Heard { from: motor, at: now, packet: &Packet { data, .. }, .. } = heard;
        asked.unanswered = asked.unanswered.saturating_sub(1);
        let is_in_flight = self.request.in_flight().is_some();
        self.request = Request::InFlight(asked);
        let is_echo = asked.data == data;
        let is_handed_back = is_echo && asked.kind().is_handed_back(&data);
        let is_of_before =
            self.was_told_before_it_lost_master() || asked.unanswered > 0 && !asked.is_stop();
        if heard.take_ignored_one(is_of_before) && is_echo || is_handed_back {
            if asked.is_stop() {
                // It ignores one, and no more.
                self.request = Request::Waiting(asked);
            } else if asked.attempts_left > 0 && asked.kind().repeat() == Repeat::Harmless {
                self.request = Request::Waiting(asked);
            } else {
                self.request_has_failed(Failure::NotExecuted, config, now);
            }
            return Meaning::Nothing;
        }
        // With more than one attempt under way nobody knows which one this answers.
        let round_trip = (is_in_flight && asked.unanswered == 0).then_some(now - self.sent);
        if is_in_flight {
            self.answered(round_trip);
        } else {
            // That counted as lost, or was to all.
            self.is_there();
        }
        let kind = asked.kind();
        if kind.ends_motion() {
            let may_undo = heard.to_all.may_undo(kind, motor);
            let may_lie = heard.to_all.has_moved_since(motor) || self.may_lie_in_mailbox(config);
            // The bus is whole, at last: what lies in a mailbox comes now.
            if asked.round == Round::First && may_lie && !may_undo {
                self.may_move_until(now + config.late_window, config);
            }
            if may_undo || self.may_yet_move() {
                // Nothing that moves it goes between the attempts of what ends its motion.
                self.on_its_way.bus_is_alive(now, config);
                self.waits_to_go_once_more(asked, Round::Waits, config);
                return Meaning::OnceMore;
            }
            self.has_ended_motion(kind);
        }
        self.finish_request(Request::None, config, now);
        if asked.is_stop() {
            return Meaning::StopConfirmed(round_trip);
        }
        if let (Kind::Known(Opcode::ReadRunTime), Ok(reply)) =
            (kind, ReadRunTime::decode_reply(&data))
        {
            self.has_run_for(reply, config, now);
        }
        let ticket = TicketId { motor, number: self.ticket };
        Meaning::Answer(ticket, kind, round_trip)
    }
}

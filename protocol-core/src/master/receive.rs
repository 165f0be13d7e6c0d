//! What a received frame means to the master.

use crate::command::{AnyReply, BusId, Command, ReadStatus1};
use crate::data::Data;
use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::arbitration::LastReply;
use crate::master::late::Question;
use crate::master::motor::replies::{Heard, Meaning};
use crate::master::motor::reports::reported_bit;
use crate::master::motor::{LastSent, Motor};
use crate::master::transmit::ForAll;
use crate::master::{Event, Master, has_errors};
use crate::opcode::{LOST_MASTER_BYTE, Opcode, ReplyRule};
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::wire::{can, rs485};

impl<const N: usize> Master<N> {
    /// Takes a frame from the CAN bus. Commands of other masters, foreign frames and frames of a wrong length answer
    /// nothing.
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

    /// Takes a reply from the RS485 line. An echo is no reply, and must not be passed: see
    /// [`EchoFilter`](crate::io::EchoFilter).
    pub fn handle_line(&mut self, frame: &rs485::Frame, now: Instant) -> Option<Event> {
        let before = self.busy_until;
        self.free_line_after_turnaround(now);
        // Frames that nobody asked for do not hold up a command that is due.
        if self.exchange_leaves_line_at() <= now && self.choose(now).is_some() {
            self.busy_until = before.min(self.busy_until);
        }
        self.handle_packet(&frame.as_reply()?, now)
    }

    /// When something was last heard on the bus, minus the time by which the late window has grown: what was sent may
    /// have been given less time.
    pub(super) fn heard_at_least(&self) -> Instant {
        let more = self.round_trips.map_or(Duration::ZERO, |trips| trips.more);
        self.heard_at - more
    }

    /// A frame that comes to us has held up those that are queued.
    fn frame_has_come(&mut self, now: Instant) {
        self.bursts.frame_has_come(now - self.heard_at, &self.config);
        self.heard_at = now;
        if self.busy_until > now {
            // Only commands that are not answered can be queued. Without this bound a bus that is always full would
            // seem busy for longer and longer, since frames are shorter than assumed.
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
                self.last_reply = LastReply::new(packet.channel, now);
                self.handle_reply(motor, packet)
            }
            Channel::BusId => {
                let reply = BusId::decode_reply(data).ok()?;
                let (motor, reply) = (reply.id(), AnyReply::BusId(reply));
                let is_answer = self.answers_broadcast(motor, packet);
                is_answer.then_some(Event::BroadcastReply { motor, reply })
            }
            Channel::Command(_) | Channel::Motion(_) => None,
        }
    }

    fn handle_reply(&mut self, id: MotorId, packet: &Packet) -> Option<Event> {
        let now = self.now;
        let mut heard = Heard {
            config: &self.config,
            from: id,
            packet,
            at: now,
            to_all: &mut self.broadcast,
            lost_master: &mut self.lost_master,
        };
        let meaning = self.places.of(id).and_then(|place| {
            self.places.change(&mut self.motors, place, |motor| motor.take(&mut heard))
        });
        if !matches!(meaning, Some(Meaning::Feedback(..))) {
            self.due = now;
            self.stop_who_is_back(id);
        }
        match meaning.unwrap_or(Meaning::Unasked { is_doubled: false }) {
            Meaning::Feedback(reply, round_trip) => {
                self.measured(round_trip);
                Some(Event::Feedback { motor: id, reply })
            }
            Meaning::SetPointIgnored => Some(Event::SetPointUnanswered { motor: id }),
            Meaning::Answer(ticket, kind, round_trip) => {
                self.measured(round_trip);
                Some(Event::Reply { ticket, kind, data: packet.data })
            }
            Meaning::StopConfirmed(round_trip) => {
                self.measured(round_trip);
                Some(Event::StopConfirmed { motor: id })
            }
            Meaning::Nothing => None,
            Meaning::OfBroadcast => {
                let is_answer = self.answers_broadcast(id, packet);
                let reply = AnyReply::decode(packet, self.config.firmware).ok();
                reply.filter(|_| is_answer).map(|reply| Event::BroadcastReply { motor: id, reply })
            }
            Meaning::Late => Some(self.handle_late(id, packet)),
            Meaning::Unasked { is_doubled } => Some(self.handle_unasked(id, packet, is_doubled)),
        }
    }

    fn measured(&mut self, round_trip: Option<Duration>) {
        if let (Some(trips), Some(round_trip)) = (&mut self.round_trips, round_trip) {
            let before = self.config.reply_timeout;
            trips.measured(round_trip, &mut self.config);
            // What else is in flight may now be late sooner.
            if self.config.reply_timeout < before {
                self.due = self.now;
            }
        }
    }

    /// Whether this reply of `motor` answers the broadcast.
    fn answers_broadcast(&mut self, motor: MotorId, packet: &Packet) -> bool {
        let data = &packet.data;
        // If a drive that has lost its master has ignored the command, its reply is no answer.
        let (kind, command) = self.broadcast.command();
        let is_echo = self.broadcast.may_be_mistaken(data[0], motor) && command == *data;
        let is_handed_back = kind.is_some_and(|kind| kind.is_handed_back(data));
        if is_echo && (self.lost_master.contains(motor) || is_handed_back) {
            if !self.motor(motor).is_some_and(Motor::was_told_before_it_lost_master) {
                self.lost_master.remove(motor);
            }
            return false;
        }
        // What comes sooner is an earlier reply, doubled.
        if self.now - self.broadcast.sent_at() < self.config.shortest_response {
            return false;
        }
        let is_owed = self.broadcast.take_owed(data[0], motor);
        let is_answer = self.broadcast.take_answer(motor, packet);
        if !is_owed && !is_answer {
            return false;
        }
        // A broadcast that was answered has left its mailbox, also on a bus that is never quiet.
        if is_answer && self.for_all.may_lie() && self.broadcast.sent_at() == self.told_all_at() {
            self.for_all = ForAll::Gone;
        }
        // Also for a broadcast that is over: the same reply, doubled, answers nothing else.
        let asked = Opcode::from_byte(data[0]).map(|known| Question::of(known.into(), data));
        let asked = asked.or(self.broadcast.question());
        self.change(motor, |motor, _| {
            motor.last_answered = asked;
            if is_answer {
                motor.answered(None);
            }
        });
        is_answer
    }

    /// An answer to the broadcast, a report, or anything else that nothing waits for.
    fn handle_unasked(&mut self, id: MotorId, packet: &Packet, is_doubled: bool) -> Event {
        // It may answer another master, or be the last answer once more.
        let byte = packet.data[0];
        let unknown = Kind::Raw { byte, reply: ReplyRule::Values, moves: true };
        let kind = match packet.is_motion() {
            true => Opcode::Motion.into(),
            false => Opcode::from_byte(byte).map_or(unknown, Kind::Known),
        };
        self.change(id, |motor, _| {
            let last = motor.last_answered.filter(|last| last.is_answered_by(packet));
            motor.note_deed(last.map_or(kind, |last| last.kind));
        });
        // Motion mode has no command byte: its first byte is the drive's id and says nothing.
        if packet.is_motion() {
            return self.stray(id, &packet.data);
        }
        let Ok(reply) = AnyReply::decode(packet, self.config.firmware) else {
            return self.stray(id, &packet.data);
        };
        if !is_doubled && self.answers_broadcast(id, packet) {
            return Event::BroadcastReply { motor: id, reply };
        }
        let bit = Opcode::from_byte(packet.data[0]).map_or(0, reported_bit);
        let is_report = match (self.motor(id), &reply) {
            _ if has_errors(&reply) => true,
            // A status without errors is also reported unasked (function 3).
            // No drive reports a supply of 0 V: that is a read which it has sent back.
            (Some(_), AnyReply::ReadStatus1(_)) => {
                packet.data != ReadStatus1.encode()
                    && !self.broadcast.may_be_mistaken(packet.data[0], id)
            }
            (Some(motor), _) => motor.reports(bit, self.now),
            (None, _) => bit != 0,
        };
        if is_report { Event::Report { motor: id, reply } } else { self.stray(id, &packet.data) }
    }

    /// An answer has come too late. If it shows errors, it may be a report of them (function 3).
    #[inline(never)]
    fn handle_late(&mut self, motor: MotorId, packet: &Packet) -> Event {
        if let Some(trips) = &mut self.round_trips {
            trips.was_too_short(&mut self.config);
        }
        match ReadStatus1::decode_reply(&packet.data).map(AnyReply::ReadStatus1) {
            Ok(reply) if has_errors(&reply) => Event::Report { motor, reply },
            _ => self.stray(motor, &packet.data),
        }
    }

    fn lost_master(&mut self, motor: MotorId, now: Instant) -> Event {
        self.lost_master.insert(motor);
        self.change(motor, |motor, config| {
            motor.was_heard(config, now);
            motor.has_let_go();
            motor.last_sent.insert(LastSent::BEFORE_IT_LOST_MASTER);
        });
        Event::LostMaster { motor }
    }

    #[inline(never)]
    fn stray(&mut self, motor: MotorId, data: &Data) -> Event {
        self.count_stray(motor);
        Event::Stray { motor, data: *data }
    }

    fn count_stray(&mut self, motor: MotorId) {
        self.change(motor, |motor, _| motor.health.stray = motor.health.stray.saturating_add(1));
    }
}

//! What a received frame means to the master.

use crate::command::{AnyReply, BusId, Command};
use crate::data::Data;
use crate::id::MotorId;
use crate::master::lane::{Flags, RequestState};
use crate::master::{Event, Master, TicketId, reported_bit};
use crate::opcode::{LOST_MASTER_BYTE, Opcode, Repeat, Usage};
use crate::packet::{Channel, Packet};
use crate::time::Instant;
use crate::wire::{can, rs485};

impl<const N: usize> Master<N> {
    /// Takes a frame from the CAN bus. Commands of other masters, foreign frames and frames of a
    /// wrong length complete nothing.
    pub fn handle_frame(&mut self, frame: &can::Received, now: Instant) -> Option<Event> {
        self.frame_has_come(now);
        match frame {
            can::Received::Packet(packet) => self.handle_packet(packet, now),
            &can::Received::WrongLength { channel: Channel::Reply(motor), first, .. } => {
                if first == Some(LOST_MASTER_BYTE) {
                    return self.lost_master(motor, now);
                }
                self.count_stray(motor);
                None
            }
            _ => None,
        }
    }

    /// Takes what the RS485 [`Receiver`](rs485::Receiver) made of a byte.
    ///
    /// With an echoing adapter the first frame after a sending, or thirteen bytes that are none, are
    /// the echo: see [`Bus::Rs485`](crate::master::Bus::Rs485).
    pub fn handle_line(&mut self, fed: &rs485::Fed, now: Instant) -> Option<Event> {
        match *fed {
            rs485::Fed::Wanting => None,
            rs485::Fed::Discarded { bytes, .. } => {
                let bytes = u8::try_from(bytes).unwrap_or(u8::MAX);
                self.echo_left = self.echo_left.saturating_sub(bytes);
                None
            }
            rs485::Fed::Frame(_) if self.echo_left > 0 => {
                self.echo_left = 0;
                None
            }
            rs485::Fed::Frame(frame) => {
                self.line_is_free_after_turnaround(now);
                self.handle_packet(&frame.as_reply()?, now)
            }
        }
    }

    /// A frame on its way to us held up those that are queued.
    fn frame_has_come(&mut self, now: Instant) {
        if self.busy_until > now {
            self.bus_is_busy(now);
        } else {
            self.busy_until = now;
        }
    }

    fn handle_packet(&mut self, packet: &Packet, now: Instant) -> Option<Event> {
        let data = &packet.data;
        match packet.channel {
            Channel::Reply(motor) if data[0] == LOST_MASTER_BYTE => self.lost_master(motor, now),
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

    fn handle_reply(&mut self, motor: MotorId, packet: &Packet, now: Instant) -> Option<Event> {
        let may_be_late = self.may_be_late_reply(motor, packet, now);
        if let Some(event) = self.match_lane(motor, packet, now) {
            return event;
        }
        Some(self.handle_unasked(motor, packet, may_be_late, now))
    }

    /// Gives the reply to what is in flight at its motor; `None` if it belongs to nothing there.
    fn match_lane(
        &mut self,
        motor: MotorId,
        packet: &Packet,
        now: Instant,
    ) -> Option<Option<Event>> {
        let config = self.config;
        let data = &packet.data;
        let is_motion = matches!(packet.channel, Channel::MotionReply(_));
        let lane = self.lane_of(motor)?;
        lane.health.last_seen = Some(now);

        let is_request = lane.request == RequestState::InFlight;
        let round_trip = now - lane.sent;
        if !lane.is_in_flight() || round_trip < config.shortest_response {
            return None;
        }
        if !is_request {
            if !is_motion && !is_control(data[0]) {
                return None;
            }
            let reply = AnyReply::decode(packet, config.firmware).ok()?;
            lane.flags.remove(Flags::SET_POINT_IN_FLIGHT);
            let sent = lane.set_point;
            if lane.is_ignored(&sent, data) {
                return Some(Some(Event::SetPointUnanswered { motor }));
            }
            lane.answered(Some(round_trip));
            return Some(Some(Event::Feedback { motor, reply }));
        }

        let kind = lane.request_kind?;
        if kind.is_motion() != is_motion || !kind.answers(&lane.request_data, data) {
            return None;
        }
        lane.reply_has_come();
        let command = lane.request_data;
        if lane.is_doubtful() && lane.attempts_left > 0 {
            lane.request = RequestState::Waiting;
            return Some(None);
        }
        if lane.is_ignored(&command, data) {
            if lane.attempts_left > 0 && kind.repeat() == Repeat::Harmless {
                lane.request = RequestState::Waiting;
            } else {
                lane.finish_request(RequestState::NotExecuted, now, config.late_window);
            }
            return Some(None);
        }
        // With more than one attempt under way nobody knows which one this answers.
        lane.answered((!lane.is_owed()).then_some(round_trip));
        let is_stop = lane.flags.contains(Flags::STOP);
        let ticket = TicketId { motor, generation: lane.generation };
        lane.finish_request(RequestState::Idle, now, config.late_window);
        Some(Some(if is_stop {
            Event::StopConfirmed { motor }
        } else {
            Event::Reply { ticket, kind, data: *data }
        }))
    }

    /// Whether this reply of `motor` answers the broadcast.
    fn answers_broadcast(&mut self, motor: MotorId, data: &Data, now: Instant) -> bool {
        self.broadcast.take_reply(motor, data, self.config.shortest_response, now)
    }

    /// Whether a reply that nothing waits for is surely the late one of a request, and not doubled,
    /// feedback of a lost set-point, a broadcast's answer or an error report.
    fn may_be_late_reply(&self, motor: MotorId, packet: &Packet, now: Instant) -> bool {
        let byte = packet.data[0];
        let mut lanes = self.lanes.iter();
        let Some(lane) = lanes.find(|lane| lane.motor == Some(motor)) else { return false };
        let is_feedback = matches!(packet.channel, Channel::MotionReply(_)) || is_control(byte);
        let is_something_else = lane.was_just_seen(now)
            || is_feedback && lane.flags.contains(Flags::SET_POINT_LATE)
            || self.broadcast.may_be_mistaken(byte, motor.into())
            || Opcode::ReadStatus1.byte() == Some(byte);
        !is_something_else
    }

    /// An answer to the broadcast, a report, a late reply, or anything else that no request waits for.
    fn handle_unasked(
        &mut self,
        motor: MotorId,
        packet: &Packet,
        may_be_late: bool,
        now: Instant,
    ) -> Event {
        let reply = AnyReply::decode(packet, self.config.firmware);
        // Motion mode has no command byte: its first byte is the drive's id and says nothing.
        if let Channel::MotionReply(_) = packet.channel {
            if let (true, Some(lane)) = (may_be_late, self.lane_of(motor)) {
                lane.late_reply_has_come();
            }
            return self.stray(motor, &packet.data);
        }
        match reply {
            Ok(reply) if self.answers_broadcast(motor, &packet.data, now) => {
                return Event::BroadcastReply { motor, reply };
            }
            _ => {}
        }
        let reported = Opcode::from_byte(packet.data[0]).and_then(reported_bit).unwrap_or(0);
        let is_report = match (self.lane_of(motor), &reply) {
            (Some(lane), _) if lane.reported & reported != 0 => true,
            (Some(lane), Ok(AnyReply::ReadStatus1(_))) => !lane.is_late_reply_due(),
            (Some(lane), _) => {
                if may_be_late {
                    lane.late_reply_has_come();
                }
                false
            }
            (None, _) => reported != 0,
        };
        match reply {
            Ok(reply) if is_report => Event::Report { motor, reply },
            _ => self.stray(motor, &packet.data),
        }
    }

    fn lost_master(&mut self, motor: MotorId, now: Instant) -> Option<Event> {
        if let Some(lane) = self.lane_of(motor) {
            lane.health.last_seen = Some(now);
            lane.flags.insert(Flags::LOST_MASTER);
        }
        Some(Event::LostMaster { motor })
    }

    fn stray(&mut self, motor: MotorId, data: &Data) -> Event {
        self.count_stray(motor);
        Event::Stray { motor, data: *data }
    }

    fn count_stray(&mut self, motor: MotorId) {
        if let Some(lane) = self.lane_of(motor) {
            lane.health.stray = lane.health.stray.saturating_add(1);
        }
    }
}

/// Whether this is the command byte of a command that moves the motor (2.19 to 2.24).
fn is_control(byte: u8) -> bool {
    Opcode::from_byte(byte)
        .is_some_and(|opcode| matches!(opcode.usage(), Usage::Move | Usage::SetPoint))
}

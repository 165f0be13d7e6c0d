//! Frames that a controller hands back because a more urgent one came: they were never on the bus.

use crate::kind::Kind;
use crate::master::event::Failure;
use crate::master::late::Of;
use crate::master::motor::stopping::StopSent;
use crate::master::motor::{LastSent, Motor};
use crate::master::request::{Asked, Request};
use crate::opcode::Opcode;
use crate::packet::Packet;
use crate::time::Instant;

impl Motor {
    /// A controller has handed back a frame that it had taken. The frame waits again, unless it is too old.
    pub(crate) fn was_pushed_out(&mut self, packet: &Packet) {
        // It has had no turn.
        self.round = self.round.wrapping_sub(1);
        let is_this = |question, data| self.packet(question, data).as_ref() == Some(packet);
        // If the request was not sent yet, this is another frame like it.
        let is_unsent = self.request.waiting().is_some_and(|asked| asked.unanswered == 0);
        let asked = self.request.asked().filter(|asked| is_this(asked.question, asked.data));
        if let Some(&asked) = asked.filter(|_| !is_unsent) {
            self.request_was_pushed_out(asked);
        } else if self.stream.in_flight().is_some_and(|it| is_this(it.question, it.data)) {
            self.set_point_was_pushed_out();
        } else {
            self.given_up_was_pushed_out(packet);
        }
    }

    fn request_was_pushed_out(&mut self, mut asked: Asked) {
        match self.request {
            // It has no reply, and its sending was not reported yet.
            Request::Sent(_) => self.settled_at = Instant::ZERO,
            // Its time was up, and it counted as lost.
            Request::Waiting(_) => self.health.uncount_miss(),
            _ => {}
        }
        asked.attempts_left = asked.attempts_left.saturating_add(1);
        asked.unanswered = asked.unanswered.saturating_sub(1);
        if self.stop_sent == StopSent::UnderWay && asked.was_never_sent() {
            self.stop_sent = StopSent::None;
        }
        self.last_sent.insert(LastSent::REQUESTS_TURN);
        if asked.is_stop() || self.is_silent() {
            self.last_sent.insert(LastSent::MAKES_WAY);
        }
        let is_old = self.last_sent.contains(LastSent::IS_OLD);
        self.request = match asked.may_move() {
            true if self.has_restarted && (is_old || asked.kind().moves()) => {
                Request::Failed(Failure::Dropped)
            }
            true if is_old => Request::Failed(Failure::Stopped),
            _ if asked.may_go_again() => Request::Waiting(asked),
            _ => Request::Failed(Failure::Dropped),
        };
    }

    fn set_point_was_pushed_out(&mut self) {
        self.last_sent.set(LastSent::MAKES_WAY, self.is_silent());
        // Nor was it the set-point's turn.
        self.last_sent.remove(LastSent::REQUESTS_TURN);
        let is_newest = self.stream.was_pushed_out();
        if !is_newest {
            self.health.superseded = self.health.superseded.saturating_add(1);
        } else if self.last_sent.contains(LastSent::IS_OLD) {
            // It is stale: what ends motion was put since, a restart was noticed, or its caller has left.
            self.drop_waiting_set_point();
        }
    }

    /// A stop took its place, or its time was up: it will not be answered.
    fn given_up_was_pushed_out(&mut self, packet: &Packet) {
        let command = Opcode::from_byte(packet.data[0]).filter(|_| !packet.is_motion());
        if command.is_some_and(|it| Kind::Known(it).ends_motion()) {
            // It may be the command that told the motor to stop.
            self.stop_sent = StopSent::None;
        }
        match self.take_late(packet, false) {
            Some(Of::Request | Of::Stream) => self.health.uncount_miss(),
            Some(Of::RequestAnswered | Of::StreamAnswered) => {
                // What was taken for its answer was a late one, to a command that counted as lost.
                self.health.answered = self.health.answered.saturating_sub(1);
            }
            Some(Of::RequestStopped | Of::StreamStopped | Of::Nobody) | None => {}
        }
    }
}

//! What the master sends, and what becomes of it.

use crate::command::ReadStatus1;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::master::Master;
use crate::master::late::{Of, Question};
use crate::master::motor::{LastSent, Motor, is_before};
use crate::master::request::Asked;
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};

/// What the transport asks a motor.
const STATUS: Question = Question::without_key(Kind::Known(Opcode::ReadStatus1));

/// What [`Master::poll_transmit`] has offered last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Offer {
    /// Of the motor at this place.
    Request(u8),
    /// Of the motor at this place.
    SetPoint(u8),
    Broadcast,
    StopToAll,
    /// A read of the status of the motor at this place, for the transport.
    Status(u8),
}

/// CAN: where the last command to all is, as far as is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ForAll {
    /// The bus has carried it: the bus was quiet since.
    Gone,
    /// It may be in a mailbox.
    Lies,
    /// A controller has handed it back.
    HandedBack,
    /// It may be in a mailbox once more: only what ends motion may push it out again.
    LiesAgain,
}

impl ForAll {
    pub(super) fn may_lie(self) -> bool {
        matches!(self, Self::Lies | Self::LiesAgain)
    }

    /// The state when another command to all is put.
    pub(super) fn put_anew(self) -> Self {
        if self == Self::HandedBack { Self::Gone } else { self }
    }

    /// The state when a command to all is sent.
    fn sent(self) -> Self {
        match self {
            Self::Gone | Self::Lies => Self::Lies,
            Self::HandedBack | Self::LiesAgain => Self::LiesAgain,
        }
    }
}

impl<const N: usize> Master<N> {
    /// Returns what to send next. It counts as sent only after [`handle_transmitted`](Self::handle_transmitted). Until
    /// then each call chooses anew, so that what is offered is never older than what waits.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Packet> {
        self.now = now;
        self.offer = None;
        if self.config.is_rs485() && self.line_is_free_at() > now {
            return None;
        }
        let offer = self.choose(now)?;
        self.offer = Some(offer);
        match offer {
            Offer::Request(place) => self.motors.get(usize::from(place))?.request_packet(),
            Offer::SetPoint(place) => self.motors.get(usize::from(place))?.set_point_packet(),
            Offer::Broadcast => self.broadcast.packet(),
            Offer::StopToAll => self.stop_to_all_packet(),
            Offer::Status(_) => None,
        }
    }

    /// Whether the first attempt of a stop is offered.
    pub(crate) fn offers_first_stop(&self) -> bool {
        let offer = self.offer.and_then(|offer| self.requested_of(offer));
        offer.is_some_and(Motor::waits_for_first_stop)
    }

    #[inline]
    fn requested_of(&self, offer: Offer) -> Option<&Motor> {
        let Offer::Request(place) = offer else { return None };
        self.motors.get(usize::from(place))
    }

    /// RS485: this motor is asked for its status before what was offered. Nothing else goes until it has answered or
    /// its time is up. `None` if its late answer could not be told from another, or if the caller asks the same.
    pub(crate) fn let_status_go_first(&mut self, motor: MotorId) -> Option<Packet> {
        let place = self.places.of(motor)?;
        let motor = self.motors.get(place)?;
        let asks_same = |asked: &Asked| asked.question == STATUS;
        if motor.request.waiting().is_some_and(asks_same) || !motor.late.has_room() {
            return None;
        }
        self.offer = Some(Offer::Status(place as u8));
        Some(ReadStatus1.packet(motor.id?))
    }

    /// The bus has taken what [`poll_transmit`](Self::poll_transmit) offered last. On RS485: its last byte was sent.
    ///
    /// Do not put or stop anything between the two calls. That withdraws the offer: a frame that the bus took all the
    /// same would count as never sent, and would be sent again.
    pub fn handle_transmitted(&mut self, now: Instant) {
        self.now = now;
        let Some(offer) = self.offer.take() else { return };
        // What the transport asks is no motor's turn.
        if !matches!(offer, Offer::Status(_)) {
            let motor = self.requested_of(offer);
            self.is_turn_of_others = motor.is_some_and(Motor::stop_leaves_turns);
        }
        // An answer may come although nothing waits for it, and must not collide with a command.
        let mut silence = Duration::ZERO;
        let on_line = if self.config.is_rs485() { self.places.taken.count() } else { 0 };
        match offer {
            Offer::Request(place) => {
                let sent = self.change_at(usize::from(place), |motor, config| {
                    motor.note_pause(on_line, now);
                    let is_over = motor.request_was_sent(now, config)?;
                    Some((is_over, motor.round))
                });
                let Some((is_over, round)) = sent.flatten() else { return };
                self.due = now;
                // Stops that go on and on do not put the others forward.
                if !self.is_turn_of_others {
                    self.keep_pace(round);
                }
                if is_over {
                    // It may have been a restart.
                    self.cancel_move_after_restart();
                    silence = self.config.settle_time;
                }
            }
            Offer::SetPoint(place) => {
                self.due = self.due.min(now + self.config.longest_response);
                let round = self.change_at(usize::from(place), |motor, _| {
                    motor.note_pause(on_line, now);
                    motor.set_point_was_sent(now);
                    motor.round
                });
                if let Some(round) = round {
                    self.keep_pace(round);
                }
            }
            Offer::Broadcast => {
                if let (Some(kind), data) = self.broadcast.command() {
                    if kind.is_refused_while_stopped() || kind.ends_motion() {
                        self.stop_to_all_was = None;
                    }
                    self.change_all(|motor, config| {
                        motor.note_sent(kind, &data, config, now);
                        motor.last_sent.remove(LastSent::BEFORE_IT_LOST_MASTER);
                    });
                }
                self.broadcast.was_sent(now, &self.config);
                if !self.broadcast.is_in_flight() {
                    silence = self.config.settle_time;
                }
            }
            Offer::StopToAll => {
                self.stop_to_all_was_sent();
                silence = self.config.settle_time;
            }
            Offer::Status(place) => {
                silence = self.stop_timeout();
                self.due = now;
                self.change_at(usize::from(place), |motor, config| {
                    motor.expect_late(STATUS, Of::Nobody, 1, now + silence, config);
                });
            }
        }
        if self.config.is_rs485() {
            self.free_line_after_turnaround(now + silence);
        } else {
            self.note_bus_busy(now);
            if matches!(offer, Offer::Broadcast | Offer::StopToAll) {
                self.for_all = self.for_all.sent();
            }
        }
    }

    /// No motor has had more turns than the pace says. A stop of a motor that has rested does not set it back.
    #[inline]
    fn keep_pace(&mut self, round: u32) {
        if is_before(self.pace, round) {
            self.pace = round;
        }
    }

    /// The bus has handed back a frame that it had taken, because another was more urgent: it was not sent. It waits
    /// again, unless something newer does. What [`poll_transmit`](Self::poll_transmit) offered last then counts as
    /// taken. So this may be called before [`handle_transmitted`](Self::handle_transmitted) or after it.
    pub fn handle_pushed_out(&mut self, packet: &Packet) {
        self.handle_transmitted(self.now);
        self.mailboxes_until.get_or_insert(self.now);
        match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => {
                let now = self.now;
                self.change(motor, |motor, _| {
                    motor.was_pushed_out(packet);
                    // It may be offered again before the next look at the time.
                    motor.drop_what_is_too_old(now);
                });
            }
            Channel::Command(Target::All) | Channel::BusId => {
                self.for_all = ForAll::HandedBack;
                self.stop_to_all_was = None;
                // An earlier command to all may have been the same.
                let is_broadcast = self.broadcast.may_be(packet);
                let is_newest = is_broadcast && self.broadcast.is_active();
                let is_stop_to_all = !is_newest && self.stop_to_all_was_pushed_out(packet);
                if !is_stop_to_all && is_broadcast {
                    for motor in self.broadcast.was_pushed_out().iter() {
                        self.change(motor, |motor, _| motor.health.uncount_miss());
                    }
                    self.end_motion_of_all();
                }
                self.cancel_move_after_restart();
            }
            Channel::Reply(_) | Channel::MotionReply(_) => {}
        }
    }
}

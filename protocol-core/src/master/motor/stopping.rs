//! What stops a motor: its own stop, commands to all, and what becomes of a stop that is not confirmed.
//!
//! # The way of a stop
//! 1. It takes the place of whatever waits ([`put_stop`](Motor::put_stop)), unless an equal one is under way
//!    ([`keep_stop_under_way`](Motor::keep_stop_under_way)). Nothing that moves is sent before that one is over, even
//!    if it was lifted meanwhile. From then on, answers to what was sent before are pending.
//! 2. It is sent ([`schedule`](crate::master::schedule)), first stops before any other. A stop that was called
//!    again ([`Purpose::StopCalledAgain`]) leaves turns to others.
//! 3. An answer comes ([`replies`](crate::master::motor::replies)).
//!    - If it may belong to what was sent before, the stop is sent again: at once or, if stops go on and on, when no
//!      such answer is pending any more ([`WaitsForOwed`](crate::master::request::Proof::WaitsForOwed)).
//!    - If it is the stop's, but something sent before may still move the motor, the stop is sent once more when that
//!      is over, and the answer to that counts ([`Waits`](crate::master::request::Proof::Waits),
//!      [`Second`](crate::master::request::Proof::Second)).
//!    - Otherwise the motor has confirmed it ([`note_motion_ended`](Motor::note_motion_ended)).
//! 4. If none comes in time, the stop is sent again ([`deadlines`](crate::master::motor::deadlines)) until it has no
//!    attempts left. Then it is given up ([`stop_was_given_up`](Motor::stop_was_given_up)), which is reported. While it
//!    is in force it is sent once more from time to time, and when the motor is heard ([`Purpose::StopAgain`]).

use crate::kind::Kind;
use crate::master::config::Config;
use crate::master::event::Failure;
use crate::master::late::{Of, Question};
use crate::master::motor::{Motor, News};
use crate::master::on_its_way::OnItsWay;
use crate::master::request::{Asked, Purpose, Request};
use crate::master::stop::{STOP_ATTEMPTS, StopKind};
use crate::opcode::Opcode;
use crate::packet::Packet;
use crate::time::Instant;

/// Whether a stop was sent to a motor, and nothing since that a stop would refuse.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum StopSent {
    /// No stop was sent, or something was since that may have moved it.
    #[default]
    None,
    /// The stop under way was sent. If a controller hands it back, it was not.
    UnderWay,
    /// An earlier one was sent.
    Earlier,
}

/// What became of a motor's last stop.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum LastStop {
    /// There was none, it is under way, or the motor was told to stop in another way since.
    #[default]
    None,
    /// It has confirmed this one.
    Confirmed(StopKind),
    /// It has confirmed that it holds, and has [let go](crate::master::motor::steady) since, perhaps.
    MayHaveLetGo,
    /// It has not confirmed it.
    Unconfirmed {
        /// How it was stopped, or told to stop since.
        kind: StopKind,
        /// How many stop frames were sent, each of which may still be answered.
        sendings: u8,
        /// When the stop was last given up.
        since: Instant,
    },
}

impl LastStop {
    fn is_like(self, stop: &Asked) -> bool {
        match self {
            Self::None | Self::MayHaveLetGo => false,
            Self::Confirmed(kind) | Self::Unconfirmed { kind, .. } => {
                kind.question() == stop.question
            }
        }
    }
}

impl Motor {
    /// Keeps an equal stop that is under way; returns whether there is one. If that stop was given up before and is
    /// sent once more, it gets all its attempts from here. If its last attempt was sent, it gets one more.
    fn keep_stop_under_way(&mut self, stop: &Asked) -> bool {
        let is_same = |asked: &&mut Asked| asked.is_stop() && asked.question == stop.question;
        let Some(asked) = self.request.under_way_mut().filter(is_same) else { return false };
        if asked.purpose == Purpose::StopAgain {
            (asked.purpose, asked.attempts_left) = (Purpose::StopCalledAgain, stop.attempts_left);
            // What became of an earlier stop says nothing about this one.
            self.news.remove(News::UNCONFIRMED);
        } else if asked.attempts_left == 0 && asked.unanswered < 2 * STOP_ATTEMPTS {
            // Each call gets an attempt of its own, but not for ever: a caller in every cycle must learn that none is
            // confirmed.
            (asked.purpose, asked.attempts_left) = (Purpose::StopCalledAgain, 1);
        }
        self.drop_waiting_set_point();
        true
    }

    /// The motor is stopped in this way. If nothing has undone an equal stop since, that stop is called again. If it
    /// was given up, an answer to any of its frames confirms this one.
    pub(crate) fn stop(&mut self, mut stop: Asked, config: &Config, now: Instant) {
        if self.keep_stop_under_way(&stop) {
            return;
        }
        let last = self.last_stop;
        if self.stop_sent != StopSent::None && last.is_like(&stop) {
            if stop.purpose == Purpose::Stop {
                stop.purpose = Purpose::StopCalledAgain;
            }
            if let LastStop::Unconfirmed { sendings, .. } = last {
                stop.unanswered = sendings;
            }
        }
        self.put_stop(stop, config, now);
        self.late.withdraw(stop.question, stop.unanswered);
    }

    /// This or another master has told it this. After whatever may move it or ends its hold it is not left to hold.
    pub(crate) fn note_deed(&mut self, kind: Kind) {
        let holds = kind == Kind::Known(Opcode::Stop);
        if !holds && (kind.may_move() || kind.ends_motion()) {
            self.is_left_to_hold = false;
        }
    }

    /// Puts a stop in the place of whatever waits. What is in flight may still be answered.
    pub(crate) fn put_stop(&mut self, stop: Asked, config: &Config, now: Instant) {
        // What became of an earlier one says nothing about this one.
        self.last_stop = LastStop::None;
        if self.stop_sent == StopSent::UnderWay {
            self.stop_sent = StopSent::Earlier;
        }
        self.end_stream();
        if stop.purpose != Purpose::StopAgain {
            self.news.remove(News::UNCONFIRMED);
        }
        // Also for a request whose outcome was not reported yet: each request has one.
        if !self.request.is_none() && !self.request.asked().is_some_and(Asked::is_stop) {
            self.news.insert(match stop.purpose {
                Purpose::StopAgain => News::STOPPED_AGAIN,
                _ => News::STOPPED,
            });
        }
        if !self.is_settled(now) {
            self.may_move_after(now + stop.timeout, config);
        }
        let is_waiting = self.request.waiting().is_some();
        let of = if is_waiting { Of::Request } else { Of::RequestStopped };
        self.give_request_up(of, config, self.last_chance(now));
        self.let_other_stop_come_first(&stop, config, now);
        self.request = Request::Waiting(stop);
    }

    /// What ends motion must not count while an earlier stop of the other kind may still arrive. A controller that
    /// keeps no order may send that one later: a load that is held falls, or a motor that is off is switched on.
    #[inline(never)]
    pub(crate) fn let_other_stop_come_first(&mut self, end: &Asked, config: &Config, now: Instant) {
        let off = StopKind::Off.question();
        let other = if end.question == off { StopKind::Hold.question() } else { off };
        if self.late.may_be_mistaken(other) {
            self.may_move_after(now + end.timeout, config);
        }
    }

    /// It was told this, individually or with all. If this stops it, an unconfirmed stop is repeated in this form: a
    /// hold would switch on a motor that was switched off since.
    pub(super) fn note_told(&mut self, kind: Kind) {
        let Some(told) = StopKind::by(kind) else { return };
        match &mut self.last_stop {
            LastStop::MayHaveLetGo if told == StopKind::Off => self.last_stop = LastStop::None,
            LastStop::Confirmed(kind) if *kind != told => self.last_stop = LastStop::None,
            LastStop::Unconfirmed { kind, sendings, .. } if *kind != told => {
                (*kind, *sendings) = (told, 0);
            }
            _ => {}
        }
    }

    /// Its stop was not confirmed. This is reported once, as an event: no caller has a ticket for a stop.
    pub(super) fn stop_was_given_up(&mut self, stop: &Asked, now: Instant) {
        if stop.purpose != Purpose::StopAgain {
            self.news.insert(News::UNCONFIRMED);
        }
        let (sendings, since) = (stop.unanswered, now);
        let unconfirmed = |kind| LastStop::Unconfirmed { kind, sendings, since };
        self.last_stop = StopKind::by(stop.kind()).map(unconfirmed).unwrap_or_default();
    }

    /// It has answered this, which ends its motion.
    pub(crate) fn note_motion_ended(&mut self, by: Kind) {
        self.on_its_way = OnItsWay::No;
        // A drive without a brake also acknowledges its lock, and turns on.
        if let Some(stop) = StopKind::by(by) {
            self.last_stop = LastStop::Confirmed(stop);
            self.is_left_to_hold = stop == StopKind::Hold;
            self.news.remove(News::UNCONFIRMED);
        }
    }

    /// The stop that it has not confirmed, and since when nothing was done about it.
    pub(crate) fn unconfirmed_stop(&self) -> Option<(StopKind, Instant)> {
        match self.last_stop {
            _ if self.request.under_way().is_some_and(Asked::ends_motion) => None,
            LastStop::Unconfirmed { kind, since, .. } => Some((kind, since)),
            LastStop::None | LastStop::Confirmed(_) | LastStop::MayHaveLetGo => None,
        }
    }

    /// A stop to all was sent, which the motor may answer in addition to its own stop. On CAN, if both are the same, it
    /// counts as one more sending of its own. On RS485 the answers of several motors collide, so it is not known
    /// whether this one's will come: it confirms nothing.
    pub(crate) fn stop_to_all_was_sent(&mut self, told: Question, due: Instant, config: &Config) {
        self.stop_set_point(due, config);
        match self.own_stop(told).filter(|_| !config.is_rs485()) {
            Some(stop) => stop.unanswered = stop.unanswered.saturating_add(1),
            None => self.expect_late(told, Of::Nobody, 1, due, config),
        }
    }

    /// A stop that is due to be answered by then takes the place of the set-point in flight, which may still arrive.
    pub(super) fn stop_set_point(&mut self, due: Instant, config: &Config) {
        if let Some(set_point) = self.stream.take_in_flight() {
            self.expect_late(set_point.question, Of::StreamStopped, 1, due, config);
        }
    }

    /// The stop to all was handed back: it will not be answered.
    pub(crate) fn stop_to_all_was_pushed_out(&mut self, told: Question, packet: &Packet) {
        match self.own_stop(told) {
            Some(stop) if stop.unanswered > 0 => stop.unanswered -= 1,
            _ => {
                self.take_late(packet, false);
            }
        }
    }

    /// The stop under way that tells it this. A stop that waits to be sent once more is confirmed by its own answer
    /// alone.
    fn own_stop(&mut self, told: Question) -> Option<&mut Asked> {
        let stop = self.request.under_way_mut()?;
        (stop.is_stop() && stop.question == told && !stop.proof.waits()).then_some(stop)
    }

    /// All are told to end their motion: nothing older of this motor is sent after that. With `off` they are let go: a
    /// hold of this motor under way, or sent again, would switch it on.
    pub(crate) fn end_with_all(&mut self, off: Option<Asked>, config: &Config, now: Instant) {
        let holds = |asked: &Asked| asked.kind() == Kind::Known(Opcode::Stop);
        if let Some(off) = off.filter(|_| self.request.under_way().is_some_and(holds)) {
            self.put_stop(off, config, now);
        }
        self.drop_what_moves(Failure::Stopped, config, now);
    }
}

//! What was given up: its replies may come late, and until when it may still move the motor.

use crate::master::config::Config;
use crate::master::late::{Of, Question};
use crate::master::motor::Motor;
use crate::master::on_its_way::OnItsWay;
use crate::packet::Packet;
use crate::time::Instant;

impl Motor {
    /// Whether a command that was given up may still reach the drive and move it.
    pub(in crate::master) fn may_yet_move(&self) -> bool {
        self.on_its_way.is_any()
    }

    /// What moves, or switches off what is to be held, was sent, and no late reply tells that it has come.
    #[inline(never)]
    pub(in crate::master) fn may_move_until(&mut self, until: Instant, config: &Config) {
        self.may_move_until_answered(until, config);
        self.is_beyond_late = true;
    }

    /// What moves was given up.
    fn may_move_until_answered(&mut self, until: Instant, config: &Config) {
        if let OnItsWay::No = self.on_its_way {
            self.is_beyond_late = false;
        }
        self.on_its_way.put(until, !config.is_rs485());
    }

    /// What ends its motion was not answered: the bus may be cut, and have been all the time.
    pub(super) fn note_bus_may_be_cut(&mut self, now: Instant, config: &Config) {
        if self.may_lie_in_mailbox(config) {
            self.may_move_until(now + config.late_window, config);
        }
    }

    /// Whether what was given up is over by time alone, of which a mailbox knows nothing.
    pub(in crate::master) fn may_lie_in_mailbox(&self, config: &Config) -> bool {
        matches!(self.on_its_way, OnItsWay::OverByTime(_)) && !config.is_rs485()
    }

    /// What looks like one of the late replies may be another: it does not say that what moves has come.
    pub(in crate::master) fn note_late_replies_say_nothing(&mut self) {
        self.is_beyond_late |= self.may_yet_move();
    }

    /// The reply to this question, which was sent so often, may come late.
    pub(in crate::master) fn expect_late(
        &mut self,
        question: Question,
        of: Of,
        replies: u8,
        until: Instant,
        config: &Config,
    ) {
        if replies > 0 {
            self.is_beyond_late |= self.late.expect(question, of, replies, until);
            if question.kind.may_move() {
                self.may_move_until_answered(until, config);
            }
        }
    }

    /// Takes a reply that may come late, or one whose command was never sent; see
    /// [`LateReplies::take`](crate::master::late::LateReplies::take).
    pub(in crate::master) fn take_late(
        &mut self,
        reply: &Packet,
        may_be_doubled: bool,
    ) -> Option<Of> {
        let (of, question) = self.late.take(reply, may_be_doubled)?;
        self.last_answered = Some(question);
        if !self.late.may_move() && !self.is_beyond_late {
            self.on_its_way.finish();
        }
        Some(of)
    }

    /// Feedback has come that may be that to another set-point, so that the newest may be still to come.
    pub(in crate::master) fn prolong_late(
        &mut self,
        question: Question,
        config: &Config,
        now: Instant,
    ) -> bool {
        if self.late.is_empty() {
            return false;
        }
        let until = now + config.late_window;
        let is_one_late = self.late.prolong(question, until);
        if is_one_late && !config.is_rs485() {
            self.may_move_until_answered(until, config);
        }
        is_one_late
    }
}

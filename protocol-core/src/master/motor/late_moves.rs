//! Commands that were given up: their replies may come late, and they may still move the motor for a while.

use crate::master::config::Config;
use crate::master::late::{Of, Question};
use crate::master::motor::Motor;
use crate::master::on_its_way::OnItsWay;
use crate::packet::Packet;
use crate::time::Instant;

impl Motor {
    /// Whether a command that was given up may still reach the drive and move it.
    pub(crate) fn may_yet_move(&self) -> bool {
        self.on_its_way.is_any()
    }

    /// A command was sent that moves the motor, or that would undo its stop, and was due by then. No late reply will
    /// show that it has arrived.
    #[inline(never)]
    pub(crate) fn may_move_after(&mut self, due: Instant, config: &Config) {
        self.may_move_until_answered(due, config);
        self.is_beyond_late = true;
    }

    /// A command that moves, and was due by then, was given up.
    fn may_move_until_answered(&mut self, due: Instant, config: &Config) {
        if let OnItsWay::No = self.on_its_way {
            self.is_beyond_late = false;
        }
        self.on_its_way.put(due, !config.is_rs485(), config);
    }

    /// What ends its motion was not answered: the bus may be cut, and may have been all the time.
    pub(super) fn note_bus_may_be_cut(&mut self, now: Instant, config: &Config) {
        if self.may_lie_in_mailbox(config) {
            self.may_move_after(now, config);
        }
    }

    /// Whether what was given up is over by time alone, so that it may still be in a mailbox.
    pub(crate) fn may_lie_in_mailbox(&self, config: &Config) -> bool {
        matches!(self.on_its_way, OnItsWay::OverByTime(_)) && !config.is_rs485()
    }

    /// Replies to this question were due by then and may come late, at most this many.
    pub(crate) fn expect_late(
        &mut self,
        question: Question,
        of: Of,
        replies: u8,
        due: Instant,
        config: &Config,
    ) {
        if replies > 0 {
            self.is_beyond_late |= self.late.expect(question, of, replies, due, config);
            if question.kind.may_move() {
                self.may_move_until_answered(due, config);
            }
        }
    }

    /// Takes a reply that may come late, or a command that was handed back; see
    /// [`LateReplies::take`](crate::master::late::LateReplies::take).
    pub(crate) fn take_late(&mut self, reply: &Packet, may_be_doubled: bool) -> Option<Of> {
        let (of, question) = self.late.take(reply, may_be_doubled)?;
        self.last_answered = Some(question);
        if !self.late.may_move() && !self.is_beyond_late {
            self.on_its_way = OnItsWay::No;
        }
        Some(of)
    }

    /// Feedback has come that may belong to another set-point, so that the reply to the newest may still come.
    pub(crate) fn prolong_late(
        &mut self,
        question: Question,
        config: &Config,
        now: Instant,
    ) -> bool {
        if self.late.is_empty() {
            return false;
        }
        let is_one_late = self.late.prolong(question, now, config);
        if is_one_late && !config.is_rs485() {
            self.may_move_until_answered(now, config);
        }
        is_one_late
    }
}

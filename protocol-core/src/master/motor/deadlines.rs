//! What time alone does to a motor: something is late, too old or over.

use crate::master::arbitration::LastReply;
use crate::master::config::Config;
use crate::master::event::Failure;
use crate::master::late::Of;
use crate::master::motor::{LastSent, Motor, News};
use crate::master::request::{Proof, Request};
use crate::master::schedule::Earliest;
use crate::packet::Channel;
use crate::time::{Duration, Instant};

/// Feedback that takes this many times longer than usual is lost.
const USUAL_TIMES: u32 = 3;

/// What the master knows of its bus.
pub(crate) struct Hearing {
    /// The bus has been quiet: no reply waits for it.
    pub(crate) is_quiet: bool,
    /// When anything was last heard.
    pub(crate) at: Instant,
    pub(crate) last_reply: LastReply,
    /// How long ago the frame of a reply may have begun that is heard now.
    pub(crate) reply_takes: Duration,
}

impl Motor {
    /// Whether time alone changes anything about it, although nothing is under way.
    pub(crate) fn lingers(&self) -> bool {
        self.settled_at > Instant::ZERO || self.may_yet_move() || !self.late.is_empty()
    }

    /// When what is in flight counts as lost.
    fn deadline(&self, config: &Config) -> Option<Instant> {
        let timeout = match (self.request.in_flight(), self.stream.in_flight()) {
            (Some(asked), _) => asked.timeout,
            (None, Some(_)) => self.set_point_timeout(config),
            (None, None) => return None,
        };
        Some(self.sent + timeout)
    }

    /// How long to wait for feedback. The wait is shorter on a quiet bus, since a stream does not stop for what is
    /// lost; RS485, with one exchange at a time, is always quiet. It is not shorter if the usual round trip is unknown,
    /// or if feedback fails to come again and again.
    fn set_point_timeout(&self, config: &Config) -> Duration {
        let usual = self.health.round_trip();
        let is_known = usual > Duration::ZERO && !self.is_silent();
        if !is_known || !(self.had_its_chance() || config.is_rs485()) {
            return config.reply_timeout;
        }
        config.longest_response.max(usual.times(USUAL_TIMES)).min(config.reply_timeout)
    }

    pub(crate) fn drop_what_is_too_old(&mut self, now: Instant) {
        if self.stream.expiry().is_some_and(|expiry| expiry <= now) {
            self.drop_waiting_set_point();
        }
    }

    /// Whether its reply, if it only waited for the bus, must have come: the bus was quiet, or has carried one that
    /// loses arbitration, or the usual time-out is over.
    fn reply_had_its_chance(&self, now: Instant, heard: &Hearing, config: &Config) -> bool {
        let ready = self.sent + config.longest_response;
        let came_instead = |id| {
            let is_motion = self.stream.in_flight().is_some_and(|it| it.question.kind.is_motion());
            let reply = if is_motion { Channel::MotionReply(id) } else { Channel::Reply(id) };
            heard.last_reply.came_instead_of(reply, ready, heard.reply_takes)
        };
        now >= ready
            && (heard.is_quiet
                || self.id.is_some_and(came_instead)
                || now >= self.sent + config.reply_timeout)
    }

    /// Takes note of the time: drops what is too old, and sends again or gives up what is overdue.
    pub(crate) fn handle_timeout(&mut self, now: Instant, heard: &Hearing, config: &Config) {
        if self.reply_had_its_chance(now, heard, config) {
            self.last_sent.insert(LastSent::HAD_ITS_CHANCE);
        }
        self.on_its_way.age(now, heard.at, config);
        self.is_beyond_late |= self.late.expire(now);
        if self.settled_at <= now {
            self.settled_at = Instant::ZERO;
        }
        self.drop_what_is_too_old(now);
        if self.deadline(config).is_none_or(|deadline| deadline > now) {
            return;
        }
        self.note_miss(config, now);
        if let Some(set_point) = self.stream.take_in_flight() {
            self.expect_late(set_point.question, Of::Stream, 1, now, config);
            self.news.insert(News::UNANSWERED);
        }
        let Request::InFlight(mut asked) = self.request else { return };
        if asked.ends_motion() {
            // An answer from before a cut says nothing about what is still in a mailbox.
            asked.proof = Proof::First;
            self.note_bus_may_be_cut(now, config);
        }
        if asked.may_go_again() {
            self.request = Request::Waiting(asked);
            return;
        }
        self.request_has_failed(Failure::NoReply, config, now);
    }

    /// When something is late, lost or too old, or the reply in flight is due on a bus that is quiet at `quiet_at`.
    /// Also when something may go because of the time, if anything waits.
    pub(crate) fn poll_at(
        &self,
        is_any_waiting: bool,
        quiet_at: Instant,
        config: &Config,
        earliest: &mut Earliest,
    ) {
        earliest.take(self.deadline(config));
        earliest.take(self.stream.expiry());
        // Not used on RS485, where only one motor is asked at a time.
        if self.is_in_flight() && !self.had_its_chance() && !config.is_rs485() {
            let latest = quiet_at.min(self.sent + config.reply_timeout);
            earliest.take(latest.max(self.sent + config.longest_response));
        }
        if is_any_waiting {
            earliest.take(Some(self.settled_at).filter(|&at| at > Instant::ZERO));
            earliest.take(self.on_its_way.end());
            earliest.take(self.late.next_end());
        }
    }
}

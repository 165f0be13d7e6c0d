//! What the master keeps for one motor: its request, its stream, and what may still arrive.

pub(super) mod deadlines;
mod late_moves;
mod outages;
mod pushed_out;
pub(super) mod replies;
pub(super) mod reports;
pub(super) mod restarts;
pub(super) mod steady;
pub(super) mod stopping;

use bitflags::bitflags;

use crate::command::{AnyReply, awaits_reply};
use crate::data::Data;
use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::config::Config;
use crate::master::event::Failure;
use crate::master::health::{Health, Presence, Record, SILENT_AFTER};
use crate::master::late::{LateReplies, Of, Question};
use crate::master::on_its_way::OnItsWay;
use crate::master::request::{Asked, Purpose, Request};
use crate::master::schedule::LONGEST_LEAD;
use crate::master::stop::LONGEST_STOP_TIMEOUT;
use crate::master::stream::{SetPoint, Stream};
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use restarts::{Position, RESTART_TAKES};
use steady::Answered;
use stopping::{LastStop, StopSent};

bitflags! {
    /// What to report of a motor, apart from the outcome of its request.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub(super) struct News: u8 {
        /// A set-point was not answered.
        const UNANSWERED = 1 << 0;
        /// A set-point was dropped.
        const DROPPED = 1 << 1;
        /// A stop took the place of the caller's request.
        const STOPPED = 1 << 2;
        /// The motor did not confirm the stop.
        const UNCONFIRMED = 1 << 3;
        /// The motor has restarted.
        const RESTARTED = 1 << 4;
        /// A stop that it has not confirmed is sent once more, and took the place of the caller's request.
        const STOPPED_AGAIN = 1 << 5;
    }
}

bitflags! {
    /// What is known of the last command that was sent to a motor.
    #[derive(Clone, Copy, Debug, Default)]
    pub(super) struct LastSent: u8 {
        /// It was a set-point, or a request that was handed back: a waiting request is next.
        const REQUESTS_TURN = 1 << 0;
        /// The bus was quiet when its reply was due, or the reply time-out is over. The reply does not wait for the
        /// bus, and the others do not wait for it.
        const HAD_ITS_CHANCE = 1 << 1;
        /// Since then it or all were to end their motion, it has restarted, or the caller no longer waits for its
        /// feedback. Nothing older that moves is sent again.
        const IS_OLD = 1 << 2;
        /// The drive has said since that it has lost its master: it may have heard this command before.
        const BEFORE_IT_LOST_MASTER = 1 << 3;
        /// Since its last answer, or the last that did not come, a controller has handed back its stop, or any frame if
        /// the motor is silent: the frame made way for a more urgent one.
        const MAKES_WAY = 1 << 4;
        /// The caller has resumed it since its last answer, or the last that did not come.
        const IS_RESUMED = 1 << 5;
        /// What another command does not clear.
        const GOES_ON = Self::MAKES_WAY.bits() | Self::IS_RESUMED.bits();
    }
}

/// A silent motor is waited for once in this many commands.
const SILENT_ONES_TURN: u8 = 8;

/// How many rounds a motor that waits for its turn may be behind the others.
const LONGEST_CLAIM: u32 = 4;

/// Whether a round is before another. Rounds wrap.
pub(super) const fn is_before(round: u32, other: u32) -> bool {
    (round.wrapping_sub(other) as i32) < 0
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motor {
    pub(super) id: Option<MotorId>,
    pub(super) request: Request,
    /// The number of the request's ticket.
    pub(super) ticket: u32,
    pub(super) stream: Stream,
    pub(super) late: LateReplies,
    pub(super) news: News,
    pub(super) last_sent: LastSent,
    /// Its newest set-point was dropped before it was sent, whatever is in flight.
    pub(super) is_newest_dropped: bool,
    pub(super) stop_sent: StopSent,
    /// It has restarted: no set-points until the caller knows.
    pub(super) has_restarted: bool,
    /// Commands in a row that were not answered in time; after 255 it goes on at 3.
    misses: u8,
    /// How often in a row it could not be sent a command, because the bus carried nothing.
    unreached: u8,
    /// Which reports (0xB6) are on, one bit each.
    reports: u8,
    /// The longest of their intervals, in 10 ms.
    report_interval: u16,
    /// How many commands it was sent; after a rest, put forward to the count of the others.
    pub(super) round: u32,
    /// When the last command was sent.
    pub(super) sent: Instant,
    /// The motor restarts, or settles after another command without reply: it is sent nothing before this.
    settled_at: Instant,
    /// What was given up and may still move it, or undo the stop that it is told.
    pub(super) on_its_way: OnItsWay,
    /// Part of that is not among `late`: late replies say nothing about it.
    is_beyond_late: bool,
    /// As far as is known, its drive had started by this step (`restarts::steps`): it was heard then, or has said how
    /// long it had run, or it may have been about to restart.
    started_by: u32,
    answered: Answered,
    /// What it answered last.
    pub(super) last_answered: Option<Question>,
    /// The newest feedback of its stream, and when it came.
    pub(super) latest: Option<(AnyReply, Instant)>,
    /// Its position as last reported just after it was measured, and when that was.
    pub(super) position: Option<Position>,
    pub(super) position_at: Instant,
    pub(super) last_stop: LastStop,
    /// It has confirmed that it holds, and nothing has moved it or ended that since, as far as is known.
    is_left_to_hold: bool,
    pub(super) health: Record,
}

impl Motor {
    pub(super) fn is_in_flight(&self) -> bool {
        self.stream.in_flight().is_some() || self.request.in_flight().is_some()
    }

    pub(super) fn is_waiting(&self) -> bool {
        self.stream.waiting().is_some() || self.request.waiting().is_some()
    }

    pub(super) fn is_stop_waiting(&self) -> bool {
        self.request.waiting().is_some_and(Asked::is_stop)
    }

    /// Whether it was not yet told to stop, and may be moving.
    pub(super) fn waits_for_first_stop(&self) -> bool {
        let is_first = |asked: &Asked| asked.purpose == Purpose::Stop && asked.was_never_sent();
        self.stop_sent == StopSent::None && self.request.waiting().is_some_and(is_first)
    }

    #[inline(never)]
    pub(super) fn is_stop_called_again(&self) -> bool {
        self.request.waiting().is_some_and(|asked| asked.purpose == Purpose::StopCalledAgain)
    }

    /// Whether its stop waits and leaves turns to others on RS485: it was called again, or was sent before to a motor
    /// that is silent. Otherwise a caller that stops a motor in every cycle, or a dead motor, would keep all others off
    /// the line for long, and those that hold a load would hear nothing and let it go (0xB3).
    pub(super) fn stop_leaves_turns(&self) -> bool {
        let was_sent = |stop: &Asked| stop.is_stop() && !stop.was_never_sent();
        self.is_stop_called_again()
            || self.is_silent() && self.request.waiting().is_some_and(was_sent)
    }

    /// Whether it has nothing under way and nothing to report, and nothing that was sent may still move it. A stop that
    /// was given up, and is sent again and again, does not count.
    pub(super) fn is_idle(&self, now: Instant) -> bool {
        let goes_again = |asked: &Asked| asked.purpose == Purpose::StopAgain;
        (self.request.is_none() || self.request.under_way().is_some_and(goes_again))
            && self.stream.is_none()
            && self.news.is_empty()
            && self.is_settled(now)
            && !self.may_yet_move()
    }

    pub(super) fn has_news(&self) -> bool {
        let is_over = matches!(self.request, Request::Sent(_) | Request::Failed(_));
        is_over || !self.news.is_empty()
    }

    pub(super) fn put_set_point(&mut self, set_point: SetPoint, expiry: Instant) {
        self.is_newest_dropped = false;
        if self.stream.put(set_point, expiry).is_some() {
            self.health.superseded = self.health.superseded.saturating_add(1);
        }
    }

    #[inline(never)]
    pub(super) fn drop_waiting_set_point(&mut self) {
        if self.stream.drop_waiting().is_some() {
            self.is_newest_dropped = true;
            self.news.insert(News::DROPPED);
            self.health.superseded = self.health.superseded.saturating_add(1);
        }
    }

    /// Its newest set-point is not sent if it waits, nor again if it is handed back.
    pub(super) fn end_stream(&mut self) {
        self.drop_waiting_set_point();
        if self.stream.in_flight().is_some() {
            self.last_sent.insert(LastSent::IS_OLD);
        }
    }

    /// What a stop would refuse is not sent from now on, for the first time or again. If it was never sent, it fails for
    /// this reason: its caller has to know whether it was.
    pub(super) fn withdraw(&mut self, never_sent: Failure, config: &Config, now: Instant) {
        let refused = |asked: &&Asked| asked.kind().is_refused_while_stopped();
        if let Some(asked) = self.request.asked().filter(refused) {
            let why = if asked.unanswered > 0 { Failure::NoReply } else { never_sent };
            self.drop_request(why, config, now);
        }
    }

    /// Drops what waits and would move it. A move that was sent is not sent again, whatever becomes of it.
    pub(super) fn drop_what_moves(&mut self, why: Failure, config: &Config, now: Instant) {
        self.drop_waiting_set_point();
        self.last_sent.insert(LastSent::IS_OLD);
        if self.request.asked().is_some_and(Asked::may_move) {
            self.drop_request(why, config, now);
        }
    }

    /// The request is not sent from now on: it fails for this reason if it waits.
    fn drop_request(&mut self, why: Failure, config: &Config, now: Instant) {
        match &mut self.request {
            Request::Waiting(_) => self.request_has_failed(why, config, now),
            Request::InFlight(asked) | Request::Sent(asked) => asked.purpose = Purpose::Once,
            Request::None | Request::Failed(_) => {}
        }
    }

    pub(super) fn is_behind(&self, round: u32) -> bool {
        is_before(self.round, round)
    }

    /// After a rest or a silence, puts it forward, so that it is only as far behind the others as they may get ahead of
    /// it: it has no claim to turns that it did not use. A motor that waits for its turn, for example because its
    /// frames were handed back, keeps a claim, but only to a few turns: it may itself be what it waits for.
    pub(super) fn join(&mut self, pace: u32) {
        let waits = self.is_waiting() || self.is_in_flight();
        let claim = if waits { LONGEST_CLAIM } else { LONGEST_LEAD };
        // A motor that was stopped again and again may be further ahead: it is put back.
        let latest = pace.wrapping_add(LONGEST_LEAD);
        if is_before(latest, self.round) {
            self.round = latest;
        }
        let earliest = pace.wrapping_sub(claim);
        if self.is_behind(earliest) {
            self.round = earliest;
        }
    }

    pub(super) fn is_settled(&self, now: Instant) -> bool {
        self.settled_at <= now
    }

    /// Whether its drive has said since the last command that it has lost its master.
    pub(super) fn was_told_before_it_lost_master(&self) -> bool {
        self.last_sent.contains(LastSent::BEFORE_IT_LOST_MASTER)
    }

    /// Whether its last reply was due while the bus was quiet.
    pub(super) fn had_its_chance(&self) -> bool {
        self.last_sent.contains(LastSent::HAD_ITS_CHANCE)
    }

    pub(super) fn health(&self) -> Health {
        self.health.health(match self.misses.max(self.unreached) {
            SILENT_AFTER.. => Presence::Silent,
            _ if self.misses > 0 => Presence::Late,
            _ if self.health.last_seen().is_some() => Presence::Present,
            _ => Presence::Unknown,
        })
    }

    /// Whether it did not answer the last command.
    pub(super) fn was_missed(&self) -> bool {
        self.misses > 0
    }

    /// Whether it did not answer at least two commands in a row: one answer may be lost.
    pub(super) fn is_silent(&self) -> bool {
        self.misses > 1
    }

    /// Whether it did not answer so many commands in a row that it hardly hears any.
    pub(super) fn is_silent_for_long(&self) -> bool {
        self.misses >= SILENT_ONES_TURN
    }

    /// Whether motors at this round wait for this one's turn to answer or to be sent something. They do while it is
    /// behind. If it is silent, they do at every eighth command only: it may be back, and on a full bus its answers
    /// lose every arbitration. They always do if it is to end its motion, or if its frame made way for another, so that
    /// this does not happen for ever. They never do once its reply [had its chance](LastSent::HAD_ITS_CHANCE).
    #[inline]
    pub(super) fn is_waited_for(&self, round: u32) -> bool {
        let makes_way = self.last_sent.contains(LastSent::MAKES_WAY);
        let ends_motion = || self.request.in_flight().is_some_and(Asked::ends_motion);
        let is_its_turn = || self.misses < SILENT_AFTER || self.misses % SILENT_ONES_TURN == 0;
        let may_answer = || is_its_turn() || ends_motion();
        (makes_way || self.is_behind(round) && may_answer()) && !self.had_its_chance()
    }

    /// Whether it did not answer the last time, and nothing was heard of it since the last command.
    pub(super) fn seems_dead(&self) -> bool {
        self.was_missed() && self.health.last_seen().is_none_or(|seen| seen < self.sent)
    }

    /// Whether the waiting set-point may go. What ends motion was requested before it, and goes first however often it
    /// is sent.
    #[inline]
    pub(super) fn may_send_set_point(&self) -> bool {
        self.stream.waiting().is_some() && self.late.has_room() && !self.waits_to_end_motion()
    }

    #[inline]
    pub(super) fn waits_to_end_motion(&self) -> bool {
        self.request.waiting().is_some_and(Asked::ends_motion)
    }

    pub(super) fn request_packet(&self) -> Option<Packet> {
        let asked = self.request.waiting()?;
        self.packet(asked.question, asked.data)
    }

    pub(super) fn set_point_packet(&self) -> Option<Packet> {
        let set_point = self.stream.waiting()?;
        self.packet(set_point.question, set_point.data)
    }

    #[inline]
    fn packet(&self, question: Question, data: Data) -> Option<Packet> {
        let motor = self.id?;
        let is_motion = question.kind.is_motion();
        let channel =
            if is_motion { Channel::Motion(motor) } else { Channel::Command(motor.into()) };
        Some(Packet { channel, data })
    }

    fn was_sent(&mut self, what: LastSent, now: Instant) {
        (self.last_sent, self.sent) = (what | self.last_sent & LastSent::GOES_ON, now);
        self.round = self.round.wrapping_add(1);
    }

    /// The waiting request was sent. Returns whether it is over: one without a reply is, and keeps everything else back
    /// for a while.
    pub(super) fn request_was_sent(&mut self, now: Instant, config: &Config) -> Option<bool> {
        let Request::Waiting(mut asked) = self.request else { return None };
        let due = now + asked.timeout;
        self.was_sent(LastSent::empty(), now);
        self.note_sent(asked.kind(), &asked.data, config, now);
        if asked.is_stop() && self.stop_sent == StopSent::None {
            self.stop_sent = StopSent::UnderWay;
        }
        asked.attempts_left = asked.attempts_left.saturating_sub(1);
        if !awaits_reply(asked.kind(), &asked.data) {
            self.settled_at = self.settled_at.max(now + config.hold_after(asked.kind()));
            if asked.may_move() {
                self.may_move_after(due, config);
            }
            self.request = Request::Sent(asked);
            return Some(true);
        }
        // Only a stop is sent while something is in flight, which may still arrive. On RS485 it waits for that.
        if asked.is_stop() && !config.is_rs485() {
            self.late.extend(due + config.late_window);
        }
        self.stop_set_point(due, config);
        asked.unanswered = asked.unanswered.saturating_add(1);
        asked.proof = asked.proof.begun();
        self.request = Request::InFlight(asked);
        Some(false)
    }

    pub(super) fn set_point_was_sent(&mut self, now: Instant) {
        self.was_sent(LastSent::REQUESTS_TURN, now);
        self.stream.was_sent();
        (self.stop_sent, self.is_left_to_hold) = (StopSent::None, false);
    }

    /// When what is in flight has had its time. A caller's own time-out does not make this longer than that of a stop.
    pub(super) fn last_chance(&self, now: Instant) -> Instant {
        let timeout = self.request.in_flight().map(|asked| asked.timeout.min(LONGEST_STOP_TIMEOUT));
        timeout.map_or(now, |timeout| now.max(self.sent + timeout))
    }

    /// Replies to the request under way are too late from then on.
    fn give_request_up(&mut self, of: Of, config: &Config, at: Instant) {
        if let Some(asked) = self.request.under_way() {
            let (question, replies) = (asked.question, asked.unanswered);
            self.expect_late(question, of, replies, at, config);
        }
    }

    /// The request is over; replies that come late belong to this.
    pub(super) fn finish_request(&mut self, of: Of, config: &Config, now: Instant) {
        // If one of several sendings is answered, the newest may still be answered. For an old read that is not worth a
        // wait.
        let ends_motion = self.request.under_way().is_some_and(Asked::ends_motion);
        let last_chance = if ends_motion { self.last_chance(now) } else { now };
        self.give_request_up(of, config, last_chance);
        self.request = Request::None;
    }

    /// The request has no answer.
    pub(super) fn request_has_failed(&mut self, why: Failure, config: &Config, now: Instant) {
        let stop = self.request.under_way().copied().filter(Asked::is_stop);
        self.finish_request(Of::Request, config, now);
        match stop {
            Some(stop) => self.stop_was_given_up(&stop, now),
            None => self.request = Request::Failed(why),
        }
    }

    /// A reply has not come in time.
    pub(super) fn note_miss(&mut self, config: &Config, now: Instant) {
        self.last_sent.remove(LastSent::GOES_ON);
        self.misses = self.misses.checked_add(1).unwrap_or(SILENT_AFTER);
        self.health.count_miss();
        self.note_silence(config, now);
    }

    pub(super) fn note_there(&mut self) {
        self.last_sent.remove(LastSent::GOES_ON);
        self.misses = 0;
        self.note_answer();
    }

    pub(super) fn answered(&mut self, round_trip: Option<Duration>) {
        self.note_there();
        self.health.count_answer(round_trip);
    }

    /// Something was heard of it. Returns whether that came just after something else, so that it may be the same frame
    /// doubled.
    #[inline]
    pub(super) fn was_heard(&mut self, config: &Config, now: Instant) -> bool {
        let was_asked_in_vain = self.misses | core::mem::take(&mut self.unreached) > 0;
        let Some(before) = self.health.note_heard(now) else {
            self.note_first_heard(config, now);
            return false;
        };
        let silence = now - before;
        self.note_silence_of(silence, was_asked_in_vain, now);
        if self.was_missed() && silence >= RESTART_TAKES {
            self.begin_anew(config, now);
        }
        silence < config.doubled_within()
    }

    /// It was sent this, individually or with all. Keeps track of whether it knows its position, what it reports
    /// unasked, and how it was stopped last.
    pub(super) fn note_sent(&mut self, kind: Kind, data: &Data, config: &Config, now: Instant) {
        if kind.is_refused_while_stopped() {
            self.stop_sent = StopSent::None;
        }
        self.note_deed(kind);
        match kind.opcode() {
            Some(Opcode::Reset) => self.begin_anew(config, now),
            Some(Opcode::ActiveReply) => self.note_reports(data),
            _ => self.note_told(kind),
        }
    }
}

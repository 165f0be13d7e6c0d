//! What the master keeps for one motor: a request, the newest set-point, and what is in flight.

use bitflags::bitflags;

use crate::data::Data;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::master::config::Patience;
use crate::master::health::Health;
use crate::master::schedule::Earliest;
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};

/// Where a motor's request stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum RequestState {
    /// There is none.
    #[default]
    Idle,
    /// It is to be sent, for the first time or again.
    Waiting,
    /// It was sent, and its reply is awaited.
    InFlight,
    /// It was sent and has no reply; to be told.
    Sent,
    /// It failed; to be told.
    NoReply,
    /// It was answered without effect and may not be sent again; to be told.
    NotExecuted,
    /// It was dropped because the bus is down; to be told.
    BusDown,
}

bitflags! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub(super) struct Flags: u16 {
        /// A set-point waits to be sent.
        const SET_POINT_WAITING = 1 << 0;
        /// A set-point was sent and its feedback is awaited.
        const SET_POINT_IN_FLIGHT = 1 << 1;
        /// The set-point is a motion mode command.
        const SET_POINT_MOTION = 1 << 2;
        /// A set-point was sent last, so that it is a waiting request's turn.
        const SET_POINT_LAST = 1 << 3;
        /// The request is a stop: before everything else, whatever is in flight.
        const STOP = 1 << 5;
        /// No request may go out before the quarantine is over.
        const HELD = 1 << 6;
        /// The motor has lost its master and will ignore the next command.
        const LOST_MASTER = 1 << 7;
        /// To be told: a set-point was not answered.
        const TELL_UNANSWERED = 1 << 8;
        /// To be told: a set-point was dropped.
        const TELL_DROPPED = 1 << 9;
        /// To be told: a stop took the place of the caller's request.
        const TELL_STOPPED = 1 << 10;
        /// To be told: the motor did not confirm the stop.
        const TELL_UNCONFIRMED = 1 << 11;
        /// The bus was quiet when this motor's reply was due: it does not wait for the bus, and nobody
        /// waits for it.
        const OVERDUE = 1 << 14;
        /// The motor restarts, or settles after another command without reply: it gets nothing.
        const SETTLING = 1 << 13;
        /// Feedback of a set-point that was given up may still come: no request of its kind may go.
        const SET_POINT_LATE = 1 << 15;
    }
}

/// How many stop frames a motor gets before it counts as not stopped.
const STOP_ATTEMPTS: u8 = 15;
/// No reply comes sooner than that.
const SHORTEST_TIMEOUT: Duration = Duration::from_millis(1);
/// A doubled frame comes so soon after the first.
const DOUBLED_WITHIN: Duration = Duration::from_millis(1);

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lane {
    pub(super) motor: Option<MotorId>,
    pub(super) generation: u8,
    pub(super) request: RequestState,
    pub(super) flags: Flags,
    /// Replies to requests that may still come, in flight or late.
    owed: u8,
    /// How often the request may still be sent.
    pub(super) attempts_left: u8,
    /// Commands in a row that were not answered in time.
    misses: u8,
    /// Replies that may still come, look like a stop's confirmation, and belong to an earlier command.
    doubts: u8,
    timeout: Duration,
    /// Which reports (0xB6) are on, a bit each.
    pub(super) reported: u8,
    /// What the request is, or the last one was.
    pub(super) request_kind: Option<Kind>,
    pub(super) request_data: Data,
    pub(super) set_point: Data,
    /// When the last command was sent.
    pub(super) sent: Instant,
    /// How many commands it was sent, wrapping, put forward to the others' after a rest.
    pub(super) round: u8,
    /// When the waiting set-point is too old.
    pub(super) set_point_expiry: Instant,
    /// While [`Flags::HELD`] or [`Flags::SET_POINT_LATE`]: until when.
    held_until: Instant,
    pub(super) health: Health,
}

impl Lane {
    pub(super) fn is_in_flight(&self) -> bool {
        self.request == RequestState::InFlight || self.flags.contains(Flags::SET_POINT_IN_FLIGHT)
    }

    /// Whether it has nothing under way and nothing to tell.
    pub(super) fn is_idle(&self) -> bool {
        let busy = Flags::SET_POINT_WAITING | Flags::SET_POINT_IN_FLIGHT | Flags::TELL_UNANSWERED;
        let busy = busy | Flags::TELL_DROPPED | Flags::TELL_STOPPED | Flags::TELL_UNCONFIRMED;
        self.request == RequestState::Idle && !self.flags.intersects(busy | Flags::SETTLING)
    }

    pub(super) fn put_request(&mut self, kind: Kind, data: Data, patience: Patience) {
        self.request = RequestState::Waiting;
        self.request_kind = Some(kind);
        self.request_data = data;
        self.timeout = patience.reply_timeout.max(SHORTEST_TIMEOUT);
        self.attempts_left = patience.attempts.clamp(1, 15);
    }

    /// Puts a stop in the place of whatever waits. What is in flight stays owed.
    pub(super) fn put_stop(&mut self, kind: Kind, data: Data, timeout: Duration) {
        // Also one whose outcome is not told yet: each request has one.
        let had_request = self.request != RequestState::Idle;
        if had_request && !self.flags.contains(Flags::STOP) {
            self.flags.insert(Flags::TELL_STOPPED);
        }
        let answers_something_else =
            self.request == RequestState::InFlight && self.request_kind != Some(kind);
        self.doubts = self.owed.saturating_sub(u8::from(answers_something_else));
        self.drop_set_point();
        self.flags.insert(Flags::STOP);
        self.put_request(kind, data, Patience { reply_timeout: timeout, attempts: STOP_ATTEMPTS });
    }

    pub(super) fn put_set_point(&mut self, kind: Kind, data: Data, expiry: Instant) {
        if self.flags.contains(Flags::SET_POINT_WAITING) {
            self.health.superseded = self.health.superseded.saturating_add(1);
        }
        self.flags.insert(Flags::SET_POINT_WAITING);
        self.flags.set(Flags::SET_POINT_MOTION, kind.is_motion());
        self.set_point = data;
        self.set_point_expiry = expiry;
    }

    #[inline(never)]
    pub(super) fn drop_set_point(&mut self) {
        if self.flags.contains(Flags::SET_POINT_WAITING) {
            self.flags.remove(Flags::SET_POINT_WAITING);
            self.flags.insert(Flags::TELL_DROPPED);
            self.health.superseded = self.health.superseded.saturating_add(1);
        }
    }

    /// Whether the set-point is what this motor should be sent next, rather than the request.
    pub(super) fn is_set_point_next(&self, request_may_go: bool) -> bool {
        self.flags.contains(Flags::SET_POINT_WAITING)
            && !(request_may_go && self.flags.contains(Flags::SET_POINT_LAST))
    }

    pub(super) fn may_send_request(&self) -> bool {
        self.request == RequestState::Waiting && !self.flags.contains(Flags::HELD)
    }

    /// Whether it is behind the other in rounds.
    pub(super) fn is_behind(&self, round: u8) -> bool {
        (self.round.wrapping_sub(round) as i8) < 0
    }

    /// Puts it forward after a rest, so that it is one round behind the others at the most: what it
    /// did not ask for then it has no claim to now.
    pub(super) fn join(&mut self, pace: u8) {
        let one_behind = pace.wrapping_sub(1);
        if self.is_behind(one_behind) {
            self.round = one_behind;
        }
    }

    /// Whether it has a set-point that could be sent now, or a request that may go.
    pub(super) fn is_ready(&self, request_may_go: bool) -> bool {
        let waits = self.flags.contains(Flags::SET_POINT_WAITING) || request_may_go;
        waits && !self.is_in_flight() && !self.flags.contains(Flags::SETTLING)
    }

    /// Whether feedback of the motor's stream may still come that would look like a reply to this.
    pub(super) fn is_streamed(&self, kind: Kind) -> bool {
        let busy = Flags::SET_POINT_WAITING | Flags::SET_POINT_IN_FLIGHT | Flags::SET_POINT_LATE;
        let is_motion = self.flags.contains(Flags::SET_POINT_MOTION);
        let byte = if is_motion { None } else { Some(self.set_point[0]) };
        self.flags.intersects(busy) && kind.byte() == byte
    }

    /// Ends the wait for the feedback of the set-point in flight.
    pub(super) fn give_set_point_up(&mut self, now: Instant, late_window: Duration) {
        self.flags.remove(Flags::SET_POINT_IN_FLIGHT);
        self.flags.insert(Flags::TELL_UNANSWERED | Flags::SET_POINT_LATE);
        // A hold goes on as it is, so that lost set-points cannot keep requests back for ever.
        if !self.flags.contains(Flags::HELD) {
            self.held_until = now + late_window;
        }
    }

    pub(super) fn request_packet(&self) -> Option<Packet> {
        let motor = self.motor?;
        let motion = self.request_kind.is_some_and(Kind::is_motion);
        Some(Packet { channel: channel(motor, motion), data: self.request_data })
    }

    pub(super) fn set_point_packet(&self) -> Option<Packet> {
        let motor = self.motor?;
        let motion = self.flags.contains(Flags::SET_POINT_MOTION);
        Some(Packet { channel: channel(motor, motion), data: self.set_point })
    }

    pub(super) fn request_was_sent(&mut self, now: Instant, awaits_reply: bool, hold: Duration) {
        self.flags.remove(Flags::SET_POINT_LAST | Flags::OVERDUE);
        self.sent = now;
        self.round = self.round.wrapping_add(1);
        self.attempts_left = self.attempts_left.saturating_sub(1);
        if awaits_reply {
            // Only a stop is sent on top of a set-point in flight; its feedback is not awaited then.
            self.flags.remove(Flags::SET_POINT_IN_FLIGHT);
            self.request = RequestState::InFlight;
            self.owed = self.owed.saturating_add(1);
        } else {
            self.request = RequestState::Sent;
            self.flags.insert(Flags::SETTLING);
            self.hold(now, hold);
        }
    }

    pub(super) fn set_point_was_sent(&mut self, now: Instant) {
        self.sent = now;
        self.round = self.round.wrapping_add(1);
        self.flags.remove(Flags::SET_POINT_WAITING | Flags::OVERDUE);
        self.flags.insert(Flags::SET_POINT_IN_FLIGHT | Flags::SET_POINT_LAST);
    }

    /// When what is in flight counts as lost; a set-point after `set_point_timeout`.
    pub(super) fn deadline(&self, set_point_timeout: Duration) -> Instant {
        let is_request = self.request == RequestState::InFlight;
        self.sent + if is_request { self.timeout } else { set_point_timeout }
    }

    /// Whether a reply of this motor may be waiting for the bus. Not one that did not answer last
    /// time, nor one that the quiet bus has shown to be silent.
    pub(super) fn may_be_answering(&self) -> bool {
        self.is_in_flight() && self.misses == 0 && !self.flags.contains(Flags::OVERDUE)
    }

    /// Lets no request out until `span` has passed.
    #[inline(never)]
    pub(super) fn hold(&mut self, now: Instant, span: Duration) {
        self.flags.insert(Flags::HELD);
        self.held_until = now + span;
    }

    /// As [`hold`](Self::hold), but never shortens what holds already.
    pub(super) fn hold_longer(&mut self, now: Instant, span: Duration) {
        if !self.flags.contains(Flags::HELD) || self.held_until < now + span {
            self.hold(now, span);
        }
    }

    /// The reply to the request in flight has come.
    pub(super) fn reply_has_come(&mut self) {
        self.owed = self.owed.saturating_sub(1);
    }

    /// A reply has come that was given up. After the last of those nothing can be mistaken any more.
    pub(super) fn late_reply_has_come(&mut self) {
        let in_flight = self.request == RequestState::InFlight;
        if self.owed <= u8::from(in_flight) {
            return;
        }
        self.owed -= 1;
        self.doubts = self.doubts.saturating_sub(1);
        if self.owed == 0 && !self.flags.contains(Flags::SETTLING) {
            self.flags.remove(Flags::HELD);
        }
    }

    /// Whether replies to requests that were given up may still come.
    pub(super) fn is_late_reply_due(&self) -> bool {
        self.owed > u8::from(self.request == RequestState::InFlight)
    }

    /// Whether something was heard of the motor just before `now`, so that what comes now may be the
    /// same once more.
    pub(super) fn was_just_seen(&self, now: Instant) -> bool {
        self.health.last_seen.is_some_and(|seen| now < seen + DOUBLED_WITHIN)
    }

    /// Whether this reply to a stop may be one to an earlier command. Then the next one counts.
    pub(super) fn is_doubtful(&mut self) -> bool {
        let doubts = self.doubts;
        self.doubts = doubts.saturating_sub(1);
        self.flags.contains(Flags::STOP) && doubts > 0
    }

    /// Ends a request that was answered or given up. Replies that may still come keep it quiet.
    #[inline(never)]
    pub(super) fn finish_request(
        &mut self,
        outcome: RequestState,
        now: Instant,
        late_window: Duration,
    ) {
        self.request = outcome;
        self.flags.remove(Flags::STOP);
        if self.owed > 0 {
            self.hold(now, late_window);
        }
    }

    pub(super) fn missed(&mut self) {
        self.misses = self.misses.saturating_add(1);
        self.health.count_miss(self.misses);
    }

    pub(super) fn answered(&mut self, round_trip: Option<Duration>) {
        self.misses = 0;
        self.health.count_answer(round_trip);
    }

    /// Ends a hold that is over.
    pub(super) fn age(&mut self, now: Instant, late_window: Duration) {
        if self.held_until > now {
            return;
        }
        if self.flags.contains(Flags::HELD) {
            self.flags.remove(Flags::HELD | Flags::SETTLING);
            // What was given up meanwhile has its own time from here on.
            self.held_until = now + late_window;
            if self.request != RequestState::InFlight {
                self.owed = 0;
            }
        } else {
            self.flags.remove(Flags::SET_POINT_LATE);
        }
    }

    /// Whether this reply is the echo of a drive that has lost its master and ignored the command.
    /// It does so once.
    pub(super) fn is_ignored(&mut self, command: &Data, reply: &Data) -> bool {
        let had_lost = self.flags.contains(Flags::LOST_MASTER);
        self.flags.remove(Flags::LOST_MASTER);
        had_lost && command == reply
    }

    pub(super) fn is_owed(&self) -> bool {
        self.owed > 0
    }

    /// Whether a broadcast has to wait for this motor, because its answer to a request may still come.
    pub(super) fn keeps_broadcast_back(&self) -> bool {
        self.request == RequestState::InFlight || self.is_owed()
    }

    /// While a broadcast waits for this motor: until when, if time ends that.
    pub(super) fn keeps_broadcast_until(&self) -> Option<Instant> {
        let held = self.flags.contains(Flags::HELD) && self.keeps_broadcast_back();
        held.then_some(self.held_until)
    }

    /// Tells when this motor has something to do by itself.
    pub(super) fn poll_at(&self, set_point_timeout: Duration, earliest: &mut Earliest) {
        if self.is_in_flight() {
            earliest.take(self.deadline(set_point_timeout));
        }
        let waits =
            self.request == RequestState::Waiting || self.flags.contains(Flags::SET_POINT_WAITING);
        if waits && self.flags.contains(Flags::HELD) {
            earliest.take(self.held_until);
        }
        if self.flags.contains(Flags::SET_POINT_WAITING) {
            earliest.take(self.set_point_expiry);
        }
    }
}

fn channel(motor: MotorId, motion: bool) -> Channel {
    if motion { Channel::Motion(motor) } else { Channel::Command(Target::Motor(motor)) }
}

//! Whose turn it is on the bus, and when.

use core::cmp::Reverse;

use crate::master::lane::{Flags, Lane, RequestState};
use crate::master::{Bus, Master, MotorSet, Offer};
use crate::packet::Packet;
use crate::time::Instant;

/// The earliest of several points in time.
#[derive(Debug, Default)]
pub(super) struct Earliest(pub(super) Option<Instant>);

impl Earliest {
    #[inline(never)]
    pub(super) fn take(&mut self, at: Instant) {
        if self.0.is_none_or(|earliest| at < earliest) {
            self.0 = Some(at);
        }
    }
}

impl<const N: usize> Master<N> {
    /// The round of the motor that is furthest behind of those whose reply may wait for the bus.
    #[inline(never)]
    pub(super) fn slowest_round(&self) -> Option<u8> {
        let mut slowest = None;
        for lane in self.lanes.iter().filter(|lane| lane.may_be_answering()) {
            if slowest.is_none_or(|slowest| lane.is_behind(slowest)) {
                slowest = Some(lane.round);
            }
        }
        slowest
    }

    /// Notes one more frame on the bus: behind what is queued already, or right now.
    #[inline(never)]
    pub(super) fn bus_is_busy(&mut self, now: Instant) {
        self.busy_until = self.busy_until.max(now) + self.config.frame_time;
    }

    /// RS485: the drives turn around before the next command.
    pub(super) fn line_is_free_after_turnaround(&mut self, now: Instant) {
        if let Bus::Rs485 { turnaround, .. } = self.config.bus {
            self.busy_until = now + turnaround;
        }
    }

    /// When the bus has been quiet for so long that a reply which only waited for it must have come.
    #[inline(never)]
    pub(super) fn quiet_at(&self) -> Instant {
        self.busy_until + self.config.frame_time.times(2)
    }

    /// When waiting for motors that may be answering ends. On RS485 only one is asked at a time.
    pub(super) fn courtesy_ends(&self) -> Option<Instant> {
        let mut first_sent = Earliest::default();
        for lane in self.lanes.iter().filter(|lane| lane.may_be_answering()) {
            first_sent.take(lane.sent);
        }
        let due = first_sent.0? + self.config.longest_response;
        Some(due.max(self.quiet_at()))
    }

    /// Stops first, then a broadcast that is due, then the motor that has waited longest.
    pub(super) fn choose(&self) -> Option<(Offer, Packet)> {
        let lanes = || self.lanes.iter().enumerate();
        let stops = lanes().filter(|(_, lane)| {
            lane.flags.contains(Flags::STOP) && lane.request == RequestState::Waiting
        });
        // Whoever was sent fewest: a motor that is not there keeps the others waiting for one stop only.
        let stop = stops.min_by_key(|(_, lane)| Reverse(lane.attempts_left));
        if let Some((place, lane)) = stop {
            return Some((Offer::Request(place as u8), lane.request_packet()?));
        }
        let requests_quiet = !self.lanes.iter().any(Lane::keeps_broadcast_back);
        if self.broadcast.is_waiting() && requests_quiet && self.broadcast.may_go(self.motors()) {
            return Some((Offer::Broadcast, self.broadcast.packet()?));
        }
        let mut first: Option<(usize, &Lane)> = None;
        for (place, lane) in lanes() {
            if lane.is_ready(self.request_may_go(lane))
                && first.is_none_or(|(_, first)| lane.is_behind(first.round))
            {
                first = Some((place, lane));
            }
        }
        let (place, lane) = first?;
        // One round ahead of a motor that may be waiting for its turn to answer is enough.
        let slowest = self.slowest_round();
        if slowest.is_some_and(|slowest| lane.round != slowest && !lane.is_behind(slowest)) {
            return None;
        }
        if lane.is_set_point_next(self.request_may_go(lane)) {
            Some((Offer::SetPoint(place as u8), lane.set_point_packet()?))
        } else {
            Some((Offer::Request(place as u8), lane.request_packet()?))
        }
    }

    /// Whether a motor's request could be sent now.
    #[inline(never)]
    pub(super) fn request_may_go(&self, lane: &Lane) -> bool {
        // A broadcast that waits lets attempts of what has begun go on: it waits for their end.
        let has_begun = self.broadcast.is_waiting() && lane.is_owed();
        lane.may_send_request()
            && (has_begun || !self.broadcast.is_active())
            && !self.is_confusable(lane)
    }

    /// Whether a motor's answer to the last broadcast could be taken for that to its request.
    pub(super) fn is_confusable(&self, lane: &Lane) -> bool {
        let motor = lane.motor.map_or(MotorSet::EMPTY, MotorSet::from);
        self.broadcast.may_be_mistaken(lane.request_data[0], motor)
    }

    /// Tells when a broadcast, or a request that waits because of one, may go.
    pub(super) fn broadcast_wait(&self, earliest: &mut Earliest) {
        let echo_matters = if self.broadcast.is_waiting() {
            let held = self.lanes.iter().filter_map(Lane::keeps_broadcast_until);
            held.for_each(|until| earliest.take(until));
            !self.broadcast.may_go(self.motors())
        } else {
            self.lanes.iter().any(|lane| lane.may_send_request() && self.is_confusable(lane))
        };
        if echo_matters {
            if let Some(end) = self.broadcast.echo_until() {
                earliest.take(end);
            }
        }
    }
}

//! Whose turn it is on the bus, and when.

use crate::master::late::Question;
use crate::master::motor::{LastSent, Motor};
use crate::master::request::{Asked, Proof};
use crate::master::stop::LONGEST_STOP_TIMEOUT;
use crate::master::transmit::ForAll;
use crate::master::{Bus, Master, Offer, StopKind};
use crate::time::{Duration, Instant};

/// How many rounds a motor may get ahead of one that may be waiting for its turn to answer. If there are more motors
/// than [`MOST_TWO_AHEAD`], it is one round.
pub(super) const LONGEST_LEAD: u32 = 2;

/// The most motors that can each send three commands, and answer them, within [`Config::reply_timeout`]: 128 frames.
const MOST_TWO_AHEAD: u32 = 21;

/// The earliest of several points in time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Earliest(pub(super) Option<Instant>);

impl Earliest {
    #[inline]
    pub(super) fn take(&mut self, at: impl Into<Option<Instant>>) {
        if let Some(at) = at.into() {
            self.0 = Some(self.0.map_or(at, |earliest| earliest.min(at)));
        }
    }
}

impl<const N: usize> Master<N> {
    /// RS485: whether anything but a stop may go, once the line is free.
    pub(crate) fn sends_more_than_stops(&self, now: Instant) -> bool {
        self.choose_other(now).is_some()
    }

    /// RS485: when the exchange under way no longer keeps a stop off the line, whatever its time-out.
    pub(super) fn exchange_leaves_line_at(&self) -> Instant {
        self.in_flight_since().map_or(Instant::ZERO, |sent| sent + LONGEST_STOP_TIMEOUT)
    }

    /// RS485: from when [what is chosen](Self::choose) may go.
    pub(super) fn line_is_free_at(&self) -> Instant {
        self.busy_until.max(self.exchange_leaves_line_at())
    }

    /// What goes next: stops first. On RS485 only a stop does while an exchange is under way.
    pub(super) fn choose(&self, now: Instant) -> Option<Offer> {
        if self.config.is_rs485() && self.is_anything_in_flight() {
            return self.choose_stop();
        }
        if let Some(stop) = self.choose_stop() {
            return Some(self.stop_or_other(stop, now));
        }
        self.choose_other(now)
    }

    /// A broadcast that is due, or else the motor that was served least.
    fn choose_other(&self, now: Instant) -> Option<Offer> {
        if self.broadcast.is_waiting() && self.broadcast_may_go() && !self.is_stops_turn() {
            return Some(Offer::Broadcast);
        }
        self.choose_motor(now)
    }

    /// RS485: if all stops that may go, and the last frame sent, [leave turns to others](Motor::stop_leaves_turns),
    /// something else goes first: a broadcast that is due, or the motor that was sent nothing for longest. Rounds do
    /// not help here: the stops are ahead.
    #[inline(never)]
    fn stop_or_other(&self, stop: Offer, now: Instant) -> Offer {
        if !self.config.is_rs485()
            || !self.is_turn_of_others
            || stop == Offer::StopToAll
            || !self.ready_stops().all(|(_, motor)| motor.stop_leaves_turns())
        {
            return stop;
        }
        if self.broadcast.is_waiting() && self.broadcast_may_go() {
            return Offer::Broadcast;
        }
        let others = self.at(self.places.waiting.without(self.places.stops));
        let settled = others.filter(|(_, motor)| motor.is_settled(now));
        let ready =
            settled.filter_map(|(place, motor)| Some((motor.sent, self.next_of(place, motor)?)));
        ready.min_by_key(|&(sent, _)| sent).map_or(stop, |(_, offer)| offer)
    }

    /// The stop to all, then the most urgent stop of one motor.
    fn choose_stop(&self) -> Option<Offer> {
        if self.stop_to_all.is_some() {
            return Some(Offer::StopToAll);
        }
        if self.places.stops.is_empty() {
            return None;
        }
        self.most_urgent_stop()
    }

    /// Each motor's first stop goes before any second. On RS485 motors that were heard last time come first, since a
    /// motor that is not there occupies the line for the time-out of a stop. After the first stops, one that answers and
    /// may not obey yet comes first, as it has to be spoken to steadily. Among equals, the motor that was sent nothing
    /// for longest.
    #[inline(never)]
    fn most_urgent_stop(&self) -> Option<Offer> {
        let urgency = |(_, motor): &(_, &Motor)| {
            let turn = match (motor.waits_for_first_stop(), motor.seems_dead()) {
                (true, is_dead) => u8::from(is_dead),
                _ if !motor.is_steady() && !motor.was_missed() => 2,
                _ => 3,
            };
            (turn, motor.sent)
        };
        self.ready_stops().min_by_key(urgency).map(|(place, _)| Offer::Request(place as u8))
    }

    /// The motors with a stop that may go.
    fn ready_stops(&self) -> impl Iterator<Item = (usize, &Motor)> {
        self.at(self.places.stops).filter(|(_, motor)| {
            motor.request.waiting().is_some_and(|stop| !self.waits_for_proof(motor, stop))
                && !(motor.is_stop_called_again() && self.gives_way(motor))
        })
    }

    /// CAN: whether this motor's stop, which was called again, waits. It waits for a command to all, and for motors
    /// that were sent no more commands than this one, and whose command or answer may still wait for the bus. Otherwise
    /// a caller that stops it in every cycle would fill the bus, or the broadcast or another motor's stop would be
    /// handed back again and again.
    fn gives_way(&self, motor: &Motor) -> bool {
        if self.config.is_rs485() {
            return false;
        }
        let next = motor.round.wrapping_add(1);
        let mut all = self.at(self.places.in_flight);
        all.any(|(_, other)| other.is_behind(next) && !other.had_its_chance())
            || self.for_all.may_lie()
            || self.broadcast.is_waiting() && !self.has_given_way(motor) && self.broadcast_may_go()
    }

    /// Whether a command to all was sent after this motor's last.
    fn has_given_way(&self, motor: &Motor) -> bool {
        motor.sent < self.told_all_at()
    }

    /// CAN: whether a stop that was called again has given way to the last command to all, and so goes before the next.
    fn is_stops_turn(&self) -> bool {
        let mut stops = self.at(self.places.stops);
        !self.config.is_rs485()
            && stops.any(|(_, motor)| motor.is_stop_called_again() && self.has_given_way(motor))
    }

    /// Of the motors that have something to send now, and no stop, the one that was served least.
    fn choose_motor(&self, now: Instant) -> Option<Offer> {
        let is_held_back = self.for_all == ForAll::LiesAgain;
        let ready = self.places.waiting.without(self.places.in_flight).without(self.places.stops);
        let mut first: Option<(u32, Offer)> = None;
        for (place, motor) in self.at(ready) {
            let is_first = first.is_none_or(|(round, _)| motor.is_behind(round));
            let may_go = || motor.is_settled(now) && (!is_held_back || motor.waits_to_end_motion());
            if is_first && may_go() {
                first = self.next_of(place, motor).map(|offer| (motor.round, offer)).or(first);
            }
        }
        let (round, offer) = first?;
        let behind = round.wrapping_add(1).wrapping_sub(self.lead(now));
        let mut all = self.at(self.places.in_flight);
        (!all.any(|(_, motor)| motor.is_waited_for(behind))).then_some(offer)
    }

    /// What may go of this motor. If both may, its set-point and its request alternate.
    #[inline]
    fn next_of(&self, place: usize, motor: &Motor) -> Option<Offer> {
        let (set_point, request) = (Offer::SetPoint(place as u8), Offer::Request(place as u8));
        let asked = motor.request.waiting();
        let request_may_go = asked.is_some_and(|asked| self.request_may_go(motor, asked));
        match (motor.may_send_set_point(), request_may_go) {
            (true, true) if motor.last_sent.contains(LastSent::REQUESTS_TURN) => Some(request),
            (true, _) => Some(set_point),
            (false, true) => Some(request),
            (false, false) => None,
        }
    }

    /// Whether a motor's request could be sent now.
    #[inline(never)]
    fn request_may_go(&self, motor: &Motor, asked: &Asked) -> bool {
        // No request goes while a broadcast is in flight. Once it is over they go, even before that is reported: a
        // caller that then begins the next one at once would keep them back for ever. While a broadcast waits, what
        // ends motion, requests that were put before it and further attempts go first, and it waits for them.
        let is_first =
            asked.unanswered > 0 || self.broadcast.is_after(motor.ticket) || asked.ends_motion();
        motor.late.has_room()
            && !motor.late.may_be_mistaken(asked.question)
            && !self.waits_for_proof(motor, asked)
            && !self.broadcast.is_in_flight()
            && (is_first || !self.broadcast.is_waiting())
            && !motor.id.is_some_and(|id| self.broadcast.may_be_mistaken(asked.data[0], id))
    }

    /// Whether this is to end motion once more and has to wait: until no answer to an earlier attempt can be taken for
    /// that to the last, and, if it was certainly answered, until nothing that was sent before can move the motor any
    /// more.
    fn waits_for_proof(&self, motor: &Motor, asked: &Asked) -> bool {
        let may_move = || motor.may_yet_move() || self.is_undone_with_all(motor, asked);
        asked.proof.waits()
            && (asked.proof == Proof::Waits && may_move()
                || motor.late.may_be_mistaken(asked.question))
    }

    /// Whether a command to all may still reach a motor and undo this, if it is known when that ends.
    fn is_undone_with_all(&self, motor: &Motor, asked: &Asked) -> bool {
        motor.id.is_some_and(|id| self.broadcast.may_undo_for_a_while(asked.kind(), id))
    }

    /// Whether the waiting broadcast may go: no answer that looks like its own can come from a request or from the
    /// broadcast before it. One that moves does not go while any motor counts as restarted.
    #[inline(never)]
    fn broadcast_may_go(&self) -> bool {
        let Some(question) = self.broadcast.question() else { return false };
        !self.at(self.places.taken).any(|(_, motor)| self.keeps_back(motor, question))
            && (!question.kind.moves() || !self.has_any_restarted())
            && self.broadcast.may_go(self.motors())
    }

    /// Whether a motor keeps back the waiting broadcast, which asks this.
    fn keeps_back(&self, motor: &Motor, question: Question) -> bool {
        let all = question.kind;
        // A stream of this kind, however long it goes on, does not: feedback is not taken for the answer.
        if motor.late.may_be_mistaken(question) && !motor.stream.is_of(question) {
            return true;
        }
        let Some(asked) = motor.request.under_way() else { return false };
        // What one motor was told before must not undo what all are told now.
        let holds_again = StopKind::by(asked.kind()) == Some(StopKind::Off)
            && StopKind::by(all) == Some(StopKind::Hold);
        if asked.unanswered > 0 || all.may_move() && asked.ends_motion() || holds_again {
            return true;
        }
        // If a command waits to be sent once more until no command to all can undo it, it goes first: the broadcast
        // would prolong that wait.
        let goes_again = || asked.proof != Proof::First && self.is_undone_with_all(motor, asked);
        // A request that was put before the broadcast goes first, unless the broadcast ends motion. One of its kind
        // does even if it waits for a late reply: otherwise it would also wait for the answers to the broadcast.
        let was_put_before = || {
            !all.ends_motion()
                && !asked.is_stop()
                && self.broadcast.is_after(motor.ticket)
                && motor.is_settled(self.now)
                && (asked.kind().byte() == all.byte() || self.request_may_go(motor, asked))
        };
        motor.request.waiting().is_some() && (goes_again() || was_put_before())
    }

    /// Notes one more frame on the bus: after those that are queued already, or right now.
    pub(super) fn note_bus_busy(&mut self, now: Instant) {
        self.busy_until = self.busy_until.max(now) + self.config.frame_time;
        // No reply comes between these frames: commands win every arbitration against replies.
        if let Some(until) = &mut self.mailboxes_until {
            *until = now.max(*until) + self.config.frame_time;
        }
    }

    /// RS485: the drives turn around before the next command.
    pub(super) fn free_line_after_turnaround(&mut self, now: Instant) {
        if let Bus::Rs485 { turnaround, .. } = self.config.bus {
            self.busy_until = now + turnaround;
        }
    }

    /// How many rounds a motor may now get ahead of one that may be waiting for its turn: one fewer for each frame
    /// beyond the first that may be in a mailbox, where it could be pushed out.
    #[inline]
    fn lead(&self, now: Instant) -> u32 {
        let frame_time = self.config.frame_time;
        // For a small master this count costs nothing.
        let is_many = N as u32 > MOST_TWO_AHEAD && self.places.taken.count() > MOST_TWO_AHEAD;
        match self.mailboxes_until.map_or(Duration::ZERO, |until| until - now) {
            lie if lie <= frame_time && !is_many => LONGEST_LEAD,
            lie if lie <= frame_time + frame_time => 1,
            _ => 0,
        }
    }

    /// When the next of those frames has left its mailbox.
    fn lead_grows_at(&self) -> Option<Instant> {
        let lie = self.mailboxes_until? - self.now;
        let times = [2, 1].map(|frames| lie - self.config.frame_time.times(frames));
        times.into_iter().find(|time| *time > Duration::ZERO).map(|time| self.now + time)
    }

    /// When the bus has been quiet for so long that a reply that only waited for the bus must have come, and was not
    /// held back. Lost frames also look quiet, but seldom three in a row.
    pub(super) fn quiet_at(&self) -> Instant {
        self.busy_until + self.config.frame_time.times(3) + self.bursts.pause()
    }

    /// CAN: when the last command to all has left its mailbox, if it may still be there.
    #[inline]
    pub(super) fn all_are_told_at(&self) -> Option<Instant> {
        let latest = || self.told_all_at() + self.config.reply_timeout;
        self.for_all.may_lie().then(|| self.quiet_at().min(latest()))
    }

    /// When the last command to all was sent, a broadcast or a stop.
    pub(super) fn told_all_at(&self) -> Instant {
        self.broadcast.sent_at().max(self.stop_to_all_sent)
    }

    /// When [`handle_timeout`](Self::handle_timeout) and [`poll_transmit`](Self::poll_transmit) have something to do
    /// because of the time; `None` while only a frame or a request can change anything.
    pub fn poll_at(&self) -> Option<Instant> {
        let mut earliest = Earliest::default();
        let (is_all_waiting, quiet_at) = (self.broadcast.is_waiting(), self.quiet_at());
        for (_, motor) in self.at(self.places.taken) {
            let is_any_waiting = is_all_waiting || motor.is_waiting();
            motor.poll_at(is_any_waiting, quiet_at, &self.config, &mut earliest);
        }
        if self.config.is_rs485() {
            let free_at = self.line_is_free_at();
            earliest.take(self.choose(free_at).map(|_| free_at));
        } else if !self.places.waiting.without(self.places.in_flight).is_empty() {
            earliest.take(self.lead_grows_at());
        }
        earliest.take(self.broadcast.deadline(&self.config));
        let mut stops = self.at(self.places.stops);
        if self.for_all == ForAll::LiesAgain || stops.any(|(_, motor)| motor.is_stop_called_again())
        {
            earliest.take(self.all_are_told_at());
        }
        earliest.take(self.stops_again_at());
        if is_all_waiting || !self.places.waiting.is_empty() {
            earliest.take(self.broadcast.next_end());
        }
        earliest.0
    }
}

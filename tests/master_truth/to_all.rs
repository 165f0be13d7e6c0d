//! Commands to all, and what becomes of those that end motion. After one, nothing older moves a motor. If one motor is
//! stopped on its own before the command is sent, the others get the command separately, as a stop.

use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::{Channel, Data, MotorId, Packet, Target};

use super::bounds::{Quiet, STOP_ATTEMPTS};
use super::names::Name;
use super::truth::Truth;

pub(super) const SHUTDOWN: u8 = 0x80;
pub(super) const STOP: u8 = 0x81;

/// The longest that a stop waits for commands that it pushes aside.
const STOP_TAKES: Duration = Duration::from_millis(100);

/// The newest command to all of a caller.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ToAll {
    name: Name,
    /// How often the bus took it and did not hand it back.
    pub(crate) taken: u32,
    /// The motors that were stopped since: those to be held and those to be off.
    held: MotorSet,
    off: MotorSet,
    /// The bus may have been down while it was pending, so it may have been dropped.
    may_be_dropped: bool,
    /// It must not be sent to all any more, because all were stopped or each motor gets its own.
    is_over: bool,
}

impl ToAll {
    /// Whether the master may report that it was not sent.
    pub(crate) fn may_be_unsent(&self) -> bool {
        !self.name.is_ending() || self.is_over || self.may_be_dropped
    }
}

impl Truth {
    /// A caller has put this command, for all. `holding`: the motors that have a request to hold in flight, as far as
    /// the caller knows.
    pub(crate) fn put_to_all(&mut self, data: &Data, known: MotorSet, holding: MotorSet) {
        self.clocks.disturb(Quiet::Calm);
        let put = self.next_moment();
        let name = Name::of(&Packet { channel: Channel::Command(Target::All), data: *data });
        self.known = known;
        self.to_all = Some(ToAll {
            name,
            taken: 0,
            held: MotorSet::EMPTY,
            off: MotorSet::EMPTY,
            may_be_dropped: self.failure_is_kept,
            is_over: false,
        });
        if !name.moves() && !name.is_ending() {
            return;
        }
        for motor in MotorId::all() {
            let page = self.page(motor);
            page.sendings.entry(name).or_default().put = put;
            if !name.is_ending() {
                continue;
            }
            page.ended_with_all = put;
            page.set_points.may_be_dropped();
            if name.byte != SHUTDOWN {
                continue;
            }
            page.let_go = put;
            if page.is_stopping && page.stop.byte == STOP {
                // Then the motor is to be off.
                (page.stop.byte, page.stop.token) = (SHUTDOWN, 0);
                page.is_begun_anew = true;
            } else if !page.is_stopping
                && (holding.contains(motor) || page.may_be_stopping && page.stop.byte == STOP)
            {
                // Unless that request is over and not reported yet, or was dropped.
                page.may_be_stopping(Name { byte: SHUTDOWN, token: 0 }, put);
            }
        }
        if name.is_ending() {
            // A command to hold must not reach a motor that a stop keeps off.
            self.undo_nobody();
        }
    }

    /// The bus has taken a caller's command to all, not one of the master's own stops.
    pub(super) fn caller_reaches_all(&mut self, name: Name) {
        if name.byte == STOP {
            // A motor that was off before is held now, and may be held again.
            self.pages.iter_mut().for_each(|page| page.let_go = 0);
        }
        let wrong = match &mut self.to_all {
            Some(it) if it.name == name => {
                it.taken += 1;
                it.is_over.then_some("goes to all, though that was to be undone or is over")
            }
            _ => Some("goes to all, and is not the newest"),
        };
        if let Some(wrong) = wrong {
            self.breaks(format!("{name:X?} {wrong}"));
        }
    }

    /// The controller has handed it back. It is sent once more, or each motor gets its own.
    pub(super) fn command_to_all_is_handed_back(&mut self, name: Name) {
        let Some(it) = self.to_all.as_mut().filter(|it| it.name == name) else { return };
        it.taken -= 1;
        // Nothing has happened yet that may drop it.
        (it.may_be_dropped, it.is_over) = (false, false);
        self.undo_nobody();
    }

    /// Whether a command that ends the motion of all was handed back and is sent once more. Meanwhile nothing else goes
    /// to all.
    pub(crate) fn all_are_told_again(&self) -> bool {
        let goes = |it: ToAll| it.taken == 0 && !it.is_over && !it.may_be_dropped;
        self.to_all.is_some_and(|it| it.name.is_ending() && goes(it))
    }

    /// The command may have been dropped, if it is pending.
    pub(super) fn command_to_all_may_be_dropped(&mut self) {
        if let Some(it) = &mut self.to_all {
            it.may_be_dropped |= it.taken == 0;
        }
    }

    /// A caller ends the motion of one motor.
    pub(crate) fn ends_alone(&mut self, motor: MotorId, byte: u8) {
        let Some(it) = &mut self.to_all else { return };
        let (set, other) =
            if byte == STOP { (&mut it.held, &mut it.off) } else { (&mut it.off, &mut it.held) };
        set.insert(motor);
        other.remove(motor);
        if it.taken == 0 && !it.is_over {
            self.undo_nobody();
        }
    }

    /// If a pending command that ends the motion of all would undo a stop of one motor, the other motors get their own
    /// instead.
    fn undo_nobody(&mut self) {
        let Some(it) = self.to_all else { return };
        let undone = match it.name.byte {
            SHUTDOWN => it.held,
            STOP => it.off.with(self.switched_off),
            _ => return,
        };
        if undone.is_empty() {
            return;
        }
        if let Some(it) = &mut self.to_all {
            it.is_over = true;
        }
        let others = self.known.without(it.held.with(it.off).with(undone));
        for motor in others.iter() {
            if it.may_be_dropped {
                let moment = self.next_moment();
                self.page(motor).may_be_stopping(it.name, moment);
            } else {
                self.turned += 1;
                self.begin_stop(motor, it.name, false);
            }
        }
    }

    /// A caller has stopped these motors: one, or all.
    pub(crate) fn stop(&mut self, motors: MotorSet, kind: StopKind, is_all: bool, known: MotorSet) {
        self.known = known;
        if let Some(it) = self.to_all.as_mut().filter(|it| it.taken == 0 && is_all) {
            it.is_over = true;
        }
        if is_all {
            let is_again = motors.iter().any(|motor| self.pages[motor.index()].is_stopped);
            self.stops_all(kind, is_again);
        }
        let (asked, steady) = (self.next_moment(), self.clocks.steady);
        for motor in motors.iter() {
            let is_off = kind == StopKind::Off || self.switched_off.contains(motor);
            if is_off {
                self.switched_off.insert(motor);
            }
            let byte = if is_off { SHUTDOWN } else { STOP };
            self.ends_alone(motor, byte);
            let page = self.page(motor);
            page.stop_asked = asked;
            page.set_points.may_be_dropped();
            let is_again = std::mem::replace(&mut page.is_stopped, true);
            // Nothing moves the motor before its stop is over, lifted or not.
            let goes_on = page.is_stopping && page.stop.byte == byte;
            let stop = Name { byte, token: 0 };
            // A stop that may be in flight goes on, if it is of this kind.
            let others = page.other_stops.iter();
            let is_unsure = (page.may_be_stopping || others.len() > 0)
                && others.chain([&page.stop]).any(|other| other.byte == byte);
            if goes_on && page.stops_taken >= STOP_ATTEMPTS || is_again && is_unsure {
                // Unless the stop is over after all its attempts and not reported yet.
                (page.is_begun_anew, page.is_stopping, page.stopping_since) = (true, true, steady);
                if page.stop.byte != byte {
                    page.other_stops.push(page.stop);
                    page.stop = stop;
                }
            } else if !goes_on {
                self.begin_stop(motor, stop, is_again);
            }
        }
    }

    /// The request to hold this motor is over, because all are let go. A stop of its own switches it off.
    pub(crate) fn is_let_go(&mut self, motor: MotorId) {
        let (was_due, now, world) = (self.is_first_stop_due(), self.now, self.world);
        let steady = self.clocks.steady;
        let page = self.page(motor);
        if page.may_be_stopping {
            (page.is_stopping, page.may_be_stopping) = (true, false);
            page.stop_called = page.may_be_stopping_since;
            page.stop_due_since = page.stop_called;
            (page.stop_called_at, page.stopping_since) = (now, steady);
            if !was_due {
                self.offers.since = world;
            }
        }
    }

    /// Begins a stop of a motor. `is_again`: the motor is stopped already, and that was not lifted.
    fn begin_stop(&mut self, motor: MotorId, stop: Name, is_again: bool) {
        if !self.is_first_stop_due() {
            self.offers.since = self.world;
        }
        let (called, now, steady) = (self.next_moment(), self.now, self.clocks.steady);
        let (answers, until) = (self.answers(motor), now + STOP_TAKES + self.late_window);
        let page = self.page(motor);
        page.turning.was_given_up(until);
        let may_go_on = page.stop == stop || page.may_be_stopping;
        if !may_go_on || !is_again && !page.is_told {
            page.stop_due_since = called;
        }
        page.other_stops.clear();
        page.stop_before = page.is_stopping.then_some(page.stop);
        // A stop that may be in flight already may go on in its place, with its remaining attempts.
        page.is_begun_anew = page.may_be_stopping;
        let goes_on = page.may_be_stopping && page.stop.byte == stop.byte;
        let taken = if goes_on { page.stops_taken } else { 0 };
        if page.may_be_stopping {
            page.other_stops.push(page.stop);
        }
        (page.is_stopping, page.may_be_stopping, page.is_confirmed) = (true, false, false);
        (page.stop_called, page.stop_called_at) = (called, now);
        page.may_be_untold &= page.stops_taken == 0;
        (page.stops_taken, page.is_told_with_all, page.was_told) = (taken, false, page.is_told);
        page.stop = stop;
        page.was_given_up = false;
        page.stopping_since = steady;
        page.answers = answers;
        page.set_points.may_be_dropped();
        self.clocks.disturb(Quiet::Steady);
    }
}

//! How the motors are stopped, and what is seen to behind that.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};

use super::script::Script;
use super::state::State;
use super::{App, Moment};
use crate::board::Board;
use crate::report::{Report, Trouble};

/// How long a stop is waited for before whoever has not confirmed it is reported, and all are told to stop once
/// more. It is shorter than a protection: on RS485 the stops to motors that do not answer leave room for
/// nothing else that the others could hear.
const LONGEST_STOP: Duration = Duration::from_millis(400);
/// How often a stop is repeated for motors that have not confirmed it: they may come back, still moving. Shorter
/// than a protection, too.
const STOP_AGAIN: Duration = Duration::from_millis(400);
/// Whoever presses the button so soon after the motors were stopped by something else meant to stop them.
pub(super) const STOPPED_BY_ITSELF: Duration = Duration::from_secs(1);

impl<const N: usize> App<N> {
    /// Tells what is wrong and stops all motors. Where they are stopped already, only errors are told.
    pub(super) fn trouble(&mut self, trouble: Trouble, at: &mut Moment<'_, N, impl Board>) {
        if let Trouble::Errors { motor, .. } = trouble {
            // Told before or not: it confirms a stop and holds nothing, and its brake may have been told to open.
            self.locks.want(motor);
            if self.failed.contains(motor) {
                return;
            }
            self.failed.insert(motor);
        }
        let is_error = matches!(trouble, Trouble::Errors { .. });
        let goes_on = match self.state {
            State::Stopping { .. } | State::Stopped { .. } => true,
            // Nothing else keeps those that turn from being held again.
            State::Looking { .. } => {
                !matches!(trouble, Trouble::Turns { .. } | Trouble::Refused { .. })
            }
            // It has cut its output, and its brake is told to lock: the others are shut down all the same.
            State::ShuttingDown { .. } => is_error,
            _ => false,
        };
        if goes_on && !is_error {
            return;
        }
        at.board.log(&Report::Trouble(trouble));
        if goes_on {
            return;
        }
        if trouble != Trouble::Button {
            self.may_start_at = at.now + STOPPED_BY_ITSELF;
        }
        match (&mut self.state, trouble) {
            // It holds again once all were looked at.
            (
                State::ShuttingDown { turning, .. } | State::Looking { turning, .. },
                Trouble::Turns { motor },
            ) => turning.insert(motor),
            // With a brake that is not locked, off is no stop; behind one that slips, nor is that.
            (State::ShuttingDown { script, .. }, _) => {
                self.shows_at = script.shows_at(at.now);
                self.unseen = self.expected;
                self.stop(self.setup.stop, at);
            }
            _ => self.stop(self.setup.stop, at),
        }
    }

    pub(super) fn stop(&mut self, kind: StopKind, at: &mut Moment<'_, N, impl Board>) {
        let all = self.known();
        // Those that the master has no place for stay unconfirmed.
        let _ = at.master.stop_all(kind, all);
        let waiting: MotorSet = at.master.motors();
        let unconfirmed = all.without(waiting);
        let until = at.now + LONGEST_STOP;
        self.enter(State::Stopping { kind, waiting, unconfirmed, until }, at);
    }

    /// One cycle in which motors are stopped, or were.
    pub(super) fn go_on_stopping(&mut self, at: &mut Moment<'_, N, impl Board>) {
        match &mut self.state {
            State::Stopping { kind, waiting, unconfirmed, until } => {
                let (kind, unconfirmed) = (*kind, waiting.with(*unconfirmed));
                let is_over = waiting.is_empty() || at.now >= *until;
                // Who has not confirmed it by then is not waited for: a load may fall.
                let is_looking =
                    (is_over || at.now >= self.shows_at) && self.look(kind, unconfirmed, at);
                if is_over && !is_looking {
                    self.tell_stopped(kind, unconfirmed, at);
                }
            }
            State::Stopped { kind, unconfirmed, again } => {
                let (kind, unconfirmed) = (*kind, *unconfirmed);
                if !unconfirmed.is_empty() && at.now >= *again {
                    *again = at.now + STOP_AGAIN;
                    // Those that the master has no place for stay unconfirmed.
                    let _ = at.master.stop_all(kind, unconfirmed);
                }
                self.look(kind, unconfirmed, at);
            }
            _ => {}
        }
    }

    pub(super) fn stop_is_over(&mut self, stopped: MotorId, is_confirmed: bool) {
        if is_confirmed {
            self.expected.insert(stopped);
        }
        match &mut self.state {
            State::Stopping { waiting, unconfirmed, .. } => {
                waiting.remove(stopped);
                if !is_confirmed {
                    unconfirmed.insert(stopped);
                }
            }
            State::Stopped { unconfirmed, .. } | State::Looking { unconfirmed, .. }
                if is_confirmed =>
            {
                unconfirmed.remove(stopped);
            }
            _ => {}
        }
    }

    /// Where all are stopped, who may have let go is stopped once more: whoever has lost its master, or has restarted,
    /// holds nothing until then, and may have confirmed a stop all the same.
    pub(super) fn hold_again(&mut self, motor: MotorId, now: Instant) {
        if let State::Stopped { unconfirmed, again, .. } = &mut self.state {
            unconfirmed.insert(motor);
            *again = now;
        }
    }

    /// Looks at the shafts of those that have confirmed their stop, and that nobody has looked at since a shutdown was
    /// broken off, however late that is: until then a load may fall. Whether there are any.
    fn look(
        &mut self,
        kind: StopKind,
        unconfirmed: MotorSet,
        at: &mut Moment<'_, N, impl Board>,
    ) -> bool {
        let motors = self.unseen.without(unconfirmed);
        if motors.is_empty() {
            return false;
        }
        self.unseen = self.unseen.without(motors);
        let (script, turning) = (Script::look(motors, self.shows_at), MotorSet::EMPTY);
        self.enter(State::Looking { script, turning, kind, unconfirmed }, at);
        true
    }

    fn tell_stopped(
        &mut self,
        kind: StopKind,
        unconfirmed: MotorSet,
        at: &mut Moment<'_, N, impl Board>,
    ) {
        let unheard = unconfirmed.without(self.expected);
        if !unheard.is_empty() {
            at.board.log(&Report::Unheard { motors: unheard });
        }
        at.board.log(&Report::Stopped { unconfirmed: unconfirmed.without(unheard) });
        self.rounds.doubt(unconfirmed);
        // The unheard get their stop again, too: one whose replies are lost may hear it.
        self.enter(State::Stopped { kind, unconfirmed, again: at.now }, at);
    }
}

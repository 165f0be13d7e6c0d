//! How the motors are stopped, and what follows a stop.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};

use super::belief::{Belief, Seen};
use super::script::{Part, Script};
use super::state::State;
use super::{App, Moment};
use crate::board::Board;
use crate::report::{Report, Trouble};

/// How long motors may take to confirm a stop. After that the others are reported, and all are stopped once more. It is
/// shorter than a protection: on RS485 the stops to motors that do not answer leave little room for anything else that
/// the others could hear.
const LONGEST_STOP: Duration = Duration::from_millis(400);
/// How often a stop is repeated for motors that have not confirmed it: they may come back, still moving. Also shorter
/// than a protection.
const STOP_AGAIN: Duration = Duration::from_millis(400);

impl<const N: usize> App<N> {
    /// Reports what is wrong and stops all motors. If they are stopped already, only errors are reported.
    pub(super) fn trouble(&mut self, trouble: Trouble, at: &mut Moment<'_, N, impl Board>) {
        if let Trouble::Errors { motor, .. } = trouble {
            self.beliefs.see(motor, Seen::Failed);
            if !self.locks.fails(motor) {
                return;
            }
        }
        let is_error = matches!(trouble, Trouble::Errors { .. });
        let goes_on = match self.state {
            State::Stopping { .. } | State::Stopped { .. } => true,
            // Whatever else is wrong, motors that turn are told to hold again first.
            State::Looking { .. } => {
                !matches!(trouble, Trouble::Turns { .. } | Trouble::Refused { .. })
            }
            // The motor has cut its output, and its brake is told to lock. The others are still shut down.
            State::ShuttingDown { .. } => is_error,
            _ => false,
        };
        if is_error || !goes_on {
            at.board.log(&Report::Trouble(trouble));
        }
        if goes_on {
            return;
        }
        match trouble {
            Trouble::Button => {}
            Trouble::Turns { .. } => self.button.fell(at.now),
            _ => self.button.stopped(at.now),
        }
        match (&mut self.state, trouble) {
            // It is told to hold again once all shafts were checked.
            (
                State::ShuttingDown { turning, .. } | State::Looking { turning, .. },
                Trouble::Turns { motor },
            ) => {
                turning.insert(motor);
                self.beliefs.see(motor, Seen::Turns);
            }
            // The others are checked all the same.
            (State::Looking { script, .. }, Trouble::Refused { motor }) => {
                script.leave_out(motor);
                self.beliefs.see(motor, Seen::Stands);
            }
            // If a brake is not locked, off is no stop. If a locked brake slips, holding is none either.
            (State::ShuttingDown { script, .. }, _) => {
                self.shows_at = script.shows_at(at.now);
                self.beliefs.see_all(self.expected, Seen::MayTurn);
                self.stop(self.setup.stop, at);
            }
            // A motor that is off stays off.
            (&mut State::Finding { kind, .. }, _) => self.stop(kind, at),
            // Brakes may be opening.
            (State::Preparing(_), _) => {
                self.locks.move_now(self.expected, at.now);
                self.stop(self.setup.stop, at);
            }
            _ => self.stop(self.setup.stop, at),
        }
    }

    /// A motor has let go. That stops all motors if it was found.
    pub(super) fn has_let_go(
        &mut self,
        motor: MotorId,
        trouble: Trouble,
        at: &mut Moment<'_, N, impl Board>,
    ) {
        self.see(motor, Seen::LetGo, at.now);
        if self.motor(motor).is_some() {
            self.trouble(trouble, at);
        }
    }

    /// Takes note that a motor has let go, or may have. Until its brake has locked, its shaft may turn.
    pub(super) fn see(&mut self, motor: MotorId, seen: Seen, now: Instant) {
        let [before, after] = self.beliefs.see(motor, seen);
        if after.is_watched() && !before.is_watched() {
            self.locks.move_now(motor.into(), now);
        }
    }

    pub(super) fn stop(&mut self, kind: StopKind, at: &mut Moment<'_, N, impl Board>) {
        let all = self.known();
        // Motors without a place in the master stay unconfirmed.
        let _ = at.master.stop_all(kind, all);
        let waiting: MotorSet = at.master.motors();
        let unconfirmed = all.without(waiting);
        let until = at.now + LONGEST_STOP;
        self.enter(State::Stopping { kind, waiting, unconfirmed, until }, at);
    }

    /// One cycle in which motors are stopped or being stopped.
    pub(super) fn go_on_stopping(&mut self, at: &mut Moment<'_, N, impl Board>) {
        match &mut self.state {
            State::Stopping { kind, waiting, unconfirmed, until } => {
                let (kind, unconfirmed) = (*kind, waiting.with(*unconfirmed));
                let is_over = waiting.is_empty() || at.now >= *until;
                // From then on motors that have not confirmed the stop are not waited for: a load may fall.
                let is_looking =
                    (is_over || at.now >= self.shows_at) && self.look(kind, unconfirmed, at);
                if is_over && !is_looking {
                    self.tell_stopped(kind, unconfirmed, at);
                }
                self.ask_watched(at);
            }
            State::Stopped { kind, unconfirmed, again } => {
                let (kind, unconfirmed) = (*kind, *unconfirmed);
                if !unconfirmed.is_empty() && at.now >= *again {
                    *again = at.now + STOP_AGAIN;
                    // Motors without a place in the master stay unconfirmed.
                    let _ = at.master.stop_all(kind, unconfirmed);
                }
                self.look(kind, unconfirmed, at);
                self.ask_watched(at);
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

    /// If all are stopped, stops a motor once more that may have let go. A motor that has lost its master or restarted
    /// holds nothing until then, although it may have confirmed a stop. Nor does one that had an error.
    pub(super) fn hold_again(
        &mut self,
        motor: MotorId,
        before: Belief,
        at: &mut Moment<'_, N, impl Board>,
    ) {
        if let State::Stopped { kind, unconfirmed, .. } = &mut self.state {
            unconfirmed.insert(motor);
            // At once: in the next cycle a press may start the motors.
            let _ = at.master.stop_all(*kind, *unconfirmed);
        }
        // A motor that never answers one of the questions comes here again and again, and has not let go.
        if before.has_let_go() || before.has_failed() {
            self.button.caught(motor, at.now);
        }
        if before.has_let_go() {
            self.trouble(Trouble::Restarted { motor }, at);
        }
    }

    /// The motors that are asked in every round whether their shafts stand: their brakes have to hold instead of them.
    pub(super) fn watched(&self, now: Instant) -> MotorSet {
        let asked = match &self.state {
            State::Stopped { kind: StopKind::Hold, unconfirmed, .. } => {
                self.beliefs.those(Belief::is_watched).without(*unconfirmed)
            }
            State::Stopping { kind: StopKind::Hold, waiting, unconfirmed, .. } => {
                self.beliefs.those(Belief::is_watched).without(waiting.with(*unconfirmed))
            }
            // They are to hold soon, whatever the last stop was. Ids without a motor may keep them waiting. The button
            // may have been pressed before all were checked.
            State::Finding { .. } | State::Preparing(_) => {
                self.beliefs.those(|it| it.is_watched() || it.is_unchecked())
            }
            // Their shafts are checked, or nothing holds them, or they move.
            _ => return MotorSet::EMPTY,
        };
        let gone = self.beliefs.those(Belief::has_let_go);
        self.locks.among(asked.without(gone), now)
    }

    /// A motor that is watched turns. What makes one brake slip may make others slip, so all that are watched are
    /// checked: at once while motors are looked for, otherwise in the next cycle. Motors that are being prepared are
    /// stopped before, so that those whose brakes open hold.
    pub(super) fn slips(&mut self, at: &mut Moment<'_, N, impl Board>) {
        self.beliefs.see_all(self.watched(at.now), Seen::MayTurn);
        match self.state {
            // A stop would wait for ids without a motor.
            State::Finding { kind, .. } => _ = self.look(kind, MotorSet::EMPTY, at),
            State::Preparing(_) => self.stop(self.setup.stop, at),
            _ => return,
        }
        self.button.fell(at.now);
    }

    /// Asks the next of the watched motors. Both rounds may want the same one: the one that has waited for longer is
    /// first.
    pub(super) fn ask_watched(&mut self, at: &mut Moment<'_, N, impl Board>) {
        let is_second = !self.attended().is_empty()
            && self.rounds.is_due(at.now)
            && self.rounds.is_before(&self.watch);
        if self.watch.is_due(at.now) && !is_second {
            let (motors, asked) = (self.watched(at.now), self.rounds.asked());
            self.watch.ask(motors, asked, &self.setup, at.master, at.now);
        }
    }

    /// Begins to check unchecked shafts of motors that have confirmed their stop, however late that is: until then a
    /// load may fall. Returns whether there are any.
    fn look(
        &mut self,
        kind: StopKind,
        unconfirmed: MotorSet,
        at: &mut Moment<'_, N, impl Board>,
    ) -> bool {
        let motors = self.beliefs.those(Belief::is_unchecked).without(unconfirmed);
        if motors.is_empty() {
            return false;
        }
        let (script, turning) = (Script::new(Part::Look, motors, self.shows_at), MotorSet::EMPTY);
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
        for motor in unconfirmed.iter() {
            self.see(motor, Seen::Missed, at.now);
        }
        // Ids that were not heard are stopped again, too: a motor whose replies are lost may hear that.
        self.enter(State::Stopped { kind, unconfirmed, again: at.now }, at);
    }
}

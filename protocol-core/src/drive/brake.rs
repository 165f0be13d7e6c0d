//! The holding brake (manual 2.27, 2.28, 2.19.1), as [`decisions`](super::decisions) says.

use crate::command::BrakeCommand;
use crate::drive::{Drive, Quirks};
use crate::time::Instant;

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Locked { at: Instant },
    Released { at: Instant, by_request: bool },
}

/// A brake moves some time after its command. The `at` of each command is when it has moved, if it begins now.
#[derive(Clone, Debug)]
pub(super) struct Brake {
    fitted: bool,
    state: State,
}

impl Brake {
    pub(super) const fn new(fitted: bool) -> Self {
        Self { fitted, state: State::Locked { at: Instant::ZERO } }
    }

    /// 0x77.
    pub(super) fn release(&mut self, at: Instant, now: Instant) {
        self.state = State::Released { at: self.lets_go_at(at, now), by_request: true };
    }

    /// For a command that needs the shaft free.
    pub(super) fn release_for_motion(&mut self, at: Instant, now: Instant) {
        if matches!(self.state, State::Locked { .. }) {
            self.state = State::Released { at: self.lets_go_at(at, now), by_request: false };
        }
    }

    fn lets_go_at(&self, at: Instant, now: Instant) -> Instant {
        match self.state {
            State::Released { at, .. } => at,
            State::Locked { at: closes } if now < closes => now,
            State::Locked { .. } => at,
        }
    }

    pub(super) fn lock(&mut self, at: Instant, now: Instant) {
        let at = match self.state {
            State::Locked { at } => at,
            State::Released { at: opens, .. } if now < opens => now,
            State::Released { .. } => at,
        };
        self.state = State::Locked { at };
    }

    /// For 0x80.
    pub(super) fn lock_unless_requested(&mut self, at: Instant, now: Instant) {
        if !matches!(self.state, State::Released { by_request: true, .. }) {
            self.lock(at, now);
        }
    }

    /// The last command (0x9A). What is not there locks nothing.
    pub(super) const fn command(&self) -> BrakeCommand {
        match self.state {
            State::Locked { .. } if self.fitted => BrakeCommand::LOCK,
            State::Locked { .. } | State::Released { .. } => BrakeCommand::RELEASE,
        }
    }

    /// Whether the motor may not run because of it.
    pub(super) fn holds(&self) -> bool {
        self.fitted && matches!(self.state, State::Locked { .. })
    }

    /// Whether the plant's brake is to be open at `now`. A motor without a brake turns freely.
    pub(super) fn is_open(&self, now: Instant) -> bool {
        !self.fitted
            || match self.state {
                State::Locked { at } => now < at,
                State::Released { at, .. } => at <= now,
            }
    }
}

impl<P, M> Drive<P, M> {
    /// What 0x9A says of it.
    pub(super) fn told_brake(&self) -> BrakeCommand {
        if !self.parameters.quirks.brake_told_by_motion {
            self.brake.command()
        } else if self.controller.is_off() {
            BrakeCommand::LOCK
        } else {
            BrakeCommand::RELEASE
        }
    }

    /// Whether the brake lets the shaft go at `now`. Once it holds, the output that held the shaft until then goes off.
    pub(super) fn follow_brake(&mut self, now: Instant) -> bool {
        let is_open = self.brake.is_open(now);
        if !is_open && self.brake.holds() {
            self.controller.shut_down();
        }
        is_open
    }

    /// When the brake lets the shaft go, or holds it, if it gets the command for that now.
    pub(super) fn brake_moves_at(&mut self, now: Instant) -> Instant {
        if self.parameters.quirks.slow_brake {
            now + self.random.between(Quirks::SLOW_BRAKE_MIN, Quirks::SLOW_BRAKE_MAX)
        } else {
            now
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LATER: Instant = Instant::from_millis(100);

    #[test]
    fn a_second_command_does_not_delay_the_first() {
        let mut brake = Brake::new(true);
        brake.release(Instant::from_millis(50), Instant::ZERO);
        brake.release(LATER, Instant::ZERO);
        assert!(brake.is_open(Instant::from_millis(50)));
        brake.lock(Instant::from_millis(150), LATER);
        brake.lock(Instant::from_millis(200), Instant::from_millis(149));
        assert!(brake.is_open(Instant::from_millis(149)) && brake.holds());
        assert!(!brake.is_open(Instant::from_millis(150)));
    }

    #[test]
    fn opposite_command_before_a_brake_moves_leaves_it_as_it_is() {
        let mut brake = Brake::new(true);
        brake.release(LATER, Instant::ZERO);
        brake.lock(Instant::from_millis(150), Instant::from_millis(50));
        assert!(!brake.is_open(LATER));
        brake.release(LATER, Instant::from_millis(50));
        brake.lock(Instant::from_millis(300), Instant::from_millis(200));
        brake.release_for_motion(Instant::from_millis(400), Instant::from_millis(250));
        assert!(brake.is_open(Instant::from_millis(300)));
    }

    #[test]
    fn shutdown_locks_a_brake_only_if_its_release_was_not_requested() {
        let mut brake = Brake::new(true);
        brake.release_for_motion(Instant::ZERO, Instant::ZERO);
        brake.lock_unless_requested(Instant::ZERO, Instant::ZERO);
        assert!(brake.holds());
        brake.release(Instant::ZERO, Instant::ZERO);
        brake.release_for_motion(Instant::ZERO, Instant::ZERO);
        brake.lock_unless_requested(Instant::ZERO, Instant::ZERO);
        assert!(!brake.holds());
    }
}

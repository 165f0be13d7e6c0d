//! The holding brake (manual 2.27, 2.28, 2.19.1), as [`decisions`](super::decisions) says.

use crate::command::BrakeCommand;
use crate::drive::{Drive, Quirks};
use crate::time::Instant;

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Locked,
    Released { at: Instant, by_request: bool },
}

#[derive(Clone, Debug)]
pub(super) struct Brake {
    fitted: bool,
    state: State,
}

impl Brake {
    pub(super) const fn new(fitted: bool) -> Self {
        Self { fitted, state: State::Locked }
    }

    /// 0x77.
    pub(super) fn release(&mut self, at: Instant) {
        let since = if let State::Released { at, .. } = self.state { at } else { at };
        self.state = State::Released { at: since, by_request: true };
    }

    /// For a command that needs the shaft free.
    pub(super) fn release_for_motion(&mut self, at: Instant) {
        if self.state == State::Locked {
            self.state = State::Released { at, by_request: false };
        }
    }

    pub(super) fn lock(&mut self) {
        self.state = State::Locked;
    }

    /// For 0x80.
    pub(super) fn lock_unless_requested(&mut self) {
        if !matches!(self.state, State::Released { by_request: true, .. }) {
            self.lock();
        }
    }

    /// The last command (0x9A). What is not there locks nothing.
    pub(super) const fn command(&self) -> BrakeCommand {
        match self.state {
            State::Locked if self.fitted => BrakeCommand::LOCK,
            State::Locked | State::Released { .. } => BrakeCommand::RELEASE,
        }
    }

    /// Whether the motor may not run because of it.
    pub(super) fn holds(&self) -> bool {
        self.fitted && self.state == State::Locked
    }

    /// Whether the plant's brake is to be open at `now`. A motor without a brake turns freely.
    pub(super) fn is_open(&self, now: Instant) -> bool {
        !self.fitted || matches!(self.state, State::Released { at, .. } if at <= now)
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

    /// When the brake begins to let the shaft go if it gets its command to open now.
    pub(super) fn brake_opens_at(&mut self, now: Instant) -> Instant {
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
    fn a_second_release_does_not_delay_the_first() {
        let mut brake = Brake::new(true);
        brake.release(Instant::from_millis(50));
        brake.release(LATER);
        assert!(brake.is_open(Instant::from_millis(50)));
    }

    #[test]
    fn shutdown_locks_only_what_was_not_asked_for() {
        let mut brake = Brake::new(true);
        brake.release_for_motion(Instant::ZERO);
        brake.lock_unless_requested();
        assert!(brake.holds());
        brake.release(Instant::ZERO);
        brake.release_for_motion(Instant::ZERO);
        brake.lock_unless_requested();
        assert!(!brake.holds());
    }
}

//! What has happened to a motor since a caller began to work with it.

use myactuator_protocol_core::Kind;
use myactuator_protocol_core::master::StopKind;

/// What has happened to a motor that nothing older may follow.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Past {
    /// How often its motion was to be ended, by a stop or otherwise.
    ended: u32,
    /// Whether it was let go since it was last held or commanded to move.
    is_let_go: bool,
    /// How often it was reported to have restarted.
    restarts: u32,
    /// How often it was told to move.
    moves: u32,
}

impl Past {
    /// Of a caller's own copy: what it has sent itself does not hold back what it sends next.
    pub(super) fn note_own(&mut self, kind: Kind) {
        if kind.ends_motion() {
            self.ended = self.ended.wrapping_add(1);
        }
        self.note_command(kind);
    }

    /// Its motion is to be ended: by a stop of this kind, which `stays_off` if it was switched off, or by a command
    /// that does not switch the motor on, such as one that locks its brake.
    pub(super) fn note_end(&mut self, by: Option<StopKind>, stays_off: bool) {
        self.ended = self.ended.wrapping_add(1);
        self.is_let_go = match by {
            Some(StopKind::Off) => true,
            Some(StopKind::Hold) => stays_off,
            None => self.is_let_go,
        };
    }

    /// The master has accepted a command.
    pub(super) fn note_command(&mut self, kind: Kind) {
        // The motor may run from now on, so a stop that holds it must not leave it off.
        if kind.may_move() {
            self.is_let_go = false;
            self.moves = self.moves.wrapping_add(1);
        }
    }

    pub(super) fn note_restart(&mut self) {
        self.restarts = self.restarts.wrapping_add(1);
    }

    pub(super) fn was_ended_since(&self, since: Self) -> bool {
        self.ended != since.ended
    }

    /// Whether it was ended since, and was let go and not held again.
    pub(super) fn was_let_go_since(&self, since: Self) -> bool {
        self.was_ended_since(since) && self.is_let_go
    }

    pub(super) fn has_restarted_since(&self, since: Self) -> bool {
        self.restarts != since.restarts
    }

    pub(super) fn was_moved_since(&self, since: Self) -> bool {
        self.moves != since.moves
    }
}

//! What is under way.

use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Instant;

use super::script::Script;
use crate::report::StateName;

/// The state, with what belongs to it.
#[derive(Debug)]
pub(super) enum State {
    Stopping {
        kind: StopKind,
        waiting: MotorSet,
        unconfirmed: MotorSet,
        until: Instant,
    },
    Stopped {
        kind: StopKind,
        unconfirmed: MotorSet,
        again: Instant,
    },
    Finding {
        script: Script,
        /// Of the stop, which is in force until motors are prepared.
        kind: StopKind,
    },
    Preparing(Script),
    Running {
        since: Instant,
        cycles: u32,
        overruns: u32,
        next_second: Instant,
    },
    ShuttingDown {
        script: Script,
        turning: MotorSet,
    },
    /// A shutdown was broken off, or a motor that is watched turns. Behind a locked brake no motor holds, and the brake
    /// may slip.
    Looking {
        script: Script,
        turning: MotorSet,
        kind: StopKind,
        unconfirmed: MotorSet,
    },
}

impl State {
    pub(super) fn name(&self) -> StateName {
        match self {
            Self::Stopping { .. } => StateName::Stopping,
            Self::Stopped { .. } => StateName::Stopped,
            Self::Finding { .. } => StateName::Finding,
            Self::Preparing(_) => StateName::Preparing,
            Self::Running { .. } => StateName::Running,
            Self::ShuttingDown { .. } => StateName::ShuttingDown,
            Self::Looking { .. } => StateName::Looking,
        }
    }

    /// The script of this state.
    pub(super) fn script(&mut self) -> Option<&mut Script> {
        match self {
            Self::Finding { script, .. }
            | Self::Preparing(script)
            | Self::ShuttingDown { script, .. }
            | Self::Looking { script, .. } => Some(script),
            Self::Stopping { .. } | Self::Stopped { .. } | Self::Running { .. } => None,
        }
    }
}

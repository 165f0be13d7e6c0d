//! What can go wrong with a bus in a thread of its own.

use std::fmt;
use std::sync::Arc;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::Trouble;
use myactuator_protocol_core::master::Failure;

use crate::open::BusError;

/// Why a call to a [`SharedBus`](super::SharedBus) has no answer: the cases of
/// [`CallError`](myactuator_protocol_core::io::CallError), and what may have become of the thread.
#[derive(thiserror::Error)]
pub enum SharedBusError<E = BusError> {
    /// The bus driver reports an error; several callers may get the same error. A command may have been sent
    /// nevertheless.
    #[error("the bus reports an error: {0:?}")]
    Bus(Arc<E>),
    /// The command could not be sent as asked.
    #[error("motor {motor}: {refusal}")]
    Refused {
        /// The motor that it was for.
        motor: MotorId,
        /// Why it could not be sent.
        refusal: RequestError,
    },
    /// It has no answer. The failure says whether it may have been sent.
    #[error("motor {motor}: {failure}")]
    Failed {
        /// The motor that was asked.
        motor: MotorId,
        /// Why there is no answer.
        failure: Failure,
    },
    /// The bus driver has kept its thread for 2 s, or for the longest silence of a [`Watch`](super::Watch) that looks
    /// (or the program was frozen). It is not known whether a command was sent, or will still be sent in the round in
    /// which the driver hangs. After that round no command that a stop would refuse, such as a move, is sent any more.
    #[error(
        "the driver of the bus does not come back, so it is not known whether the command is sent: if a motor must stop now, cut its power"
    )]
    Held,
    /// The thread of the bus has ended: its driver panicked, with this message, or the last handle was dropped.
    #[error("the thread of the bus has ended: {0}")]
    Panicked(Arc<str>),
}

impl<E> Clone for SharedBusError<E> {
    fn clone(&self) -> Self {
        match self {
            Self::Bus(error) => Self::Bus(Arc::clone(error)),
            Self::Refused { motor, refusal } => Self::Refused { motor: *motor, refusal: *refusal },
            Self::Failed { motor, failure } => Self::Failed { motor: *motor, failure: *failure },
            Self::Held => Self::Held,
            Self::Panicked(words) => Self::Panicked(Arc::clone(words)),
        }
    }
}

/// The same sentence as `Display`, as for [`BusError`]. An error of the driver prints only its own words, since a
/// [`CallError`](myactuator_protocol_core::io::CallError) already says that they are the driver's.
impl<E: fmt::Debug> fmt::Debug for SharedBusError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(error) => error.fmt(f),
            other => fmt::Display::fmt(other, f),
        }
    }
}

/// Why a control loop over handles has ended, as [`io::LoopError`](myactuator_protocol_core::io::LoopError) is for a
/// loop over a master. Both kinds of errors become one by `?`.
#[derive(thiserror::Error)]
pub enum LoopError<E: fmt::Debug + 'static = BusError> {
    /// What a [`Watch`](super::Watch) has found.
    #[error(transparent)]
    Trouble(#[from] Trouble),
    /// All motors are stopped, or all or one that is watched were since the first look of a [`Watch`](super::Watch).
    #[error(
        "the motors, or one of them, were stopped: leave the loop, even if the stop was lifted"
    )]
    Stopped,
    /// A call has no answer.
    #[error(transparent)]
    Call(#[from] SharedBusError<E>),
}

/// The same sentence as `Display`.
impl<E: fmt::Debug> fmt::Debug for LoopError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

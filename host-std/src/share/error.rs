//! What can go wrong with a bus in a thread of its own.

use std::fmt;
use std::sync::Arc;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::master::Failure;

use crate::open::BusError;

/// Why a call to a [`SharedBus`](super::SharedBus) has no answer: what
/// [`CallError`](myactuator_protocol_core::io::CallError) is to a loop, and what may have become of the
/// thread.
#[derive(thiserror::Error)]
pub enum SharedBusError<E = BusError> {
    /// The bus driver reports an error; several callers may get the same. A command may have been sent
    /// all the same.
    #[error("the bus reports an error: {0:?}")]
    Bus(Arc<E>),
    /// The command could not be sent as asked.
    #[error("motor {motor}: {refusal}")]
    Refused {
        /// Whom it was for.
        motor: MotorId,
        /// Why it could not be sent.
        refusal: RequestError,
    },
    /// It was sent, and has no answer, or a stop came before it.
    #[error("motor {motor}: {failure}")]
    Failed {
        /// Who was asked.
        motor: MotorId,
        /// Why there is no answer.
        failure: Failure,
    },
    /// The bus driver keeps its thread for 2 s already (or the program was frozen). Whether a command was sent is
    /// not known, nor whether the driver sends it yet in the round in which it hangs; after that round no command that a
    /// stop would refuse, a move say, is sent any more.
    #[error(
        "the driver of the bus does not come back, so it is not known whether the command is sent: if a motor must stop now, cut its power"
    )]
    Held,
    /// The bus driver panicked, with these words, and the thread has ended.
    #[error("the thread of the bus has panicked: {0}")]
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

/// The same sentence as `Display`, as [`BusError`] has it; of the driver's error its own words alone, since a
/// [`CallError`](myactuator_protocol_core::io::CallError) says itself whose they are.
impl<E: fmt::Debug> fmt::Debug for SharedBusError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(error) => error.fmt(f),
            other => fmt::Display::fmt(other, f),
        }
    }
}

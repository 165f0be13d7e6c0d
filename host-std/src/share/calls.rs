//! What callers lay on the desk, and where their answers go.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::sync::{Arc, Weak};
use std::time::Duration;

use myactuator_protocol_core::command::{RawReply, SetPoint};
use myactuator_protocol_core::master::{MotorSet, Patience, StopKind};
use myactuator_protocol_core::{Command, Data, DecodeError, Kind, MotorId, time};

use super::SharedBusError;

/// A command whose type only its caller knows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Untyped {
    pub(super) kind: Kind,
    data: Data,
}

impl Untyped {
    pub(super) fn of(command: &impl Command) -> Self {
        let data = command.encode();
        Self { kind: command.kind().of_bytes(&data), data }
    }
}

impl Command for Untyped {
    type Reply = RawReply;

    fn kind(&self) -> Kind {
        self.kind
    }

    fn encode(&self) -> Data {
        self.data
    }

    fn decode_reply(data: &Data) -> Result<RawReply, DecodeError> {
        Ok(RawReply(*data))
    }
}

// Whether it is one the master sees by its kind.
impl SetPoint for Untyped {}

/// Where the answer to a call goes.
pub(super) type Answer<T, E> = SyncSender<Result<T, SharedBusError<E>>>;

/// Where a caller waits for it, if the call could be laid down.
pub(super) type Awaited<T, E> = Result<Waiting<T, E>, SharedBusError<E>>;

/// Who waits for an answer.
#[derive(Debug)]
pub(super) struct Waiting<T, E> {
    pub(super) answered: Receiver<Result<T, SharedBusError<E>>>,
    /// Says that somebody still does.
    pub(super) asker: Arc<()>,
}

/// An answer, or that there is nobody who could give one.
pub(super) type Told<T, E> = Result<Result<T, SharedBusError<E>>, RecvTimeoutError>;

impl<T, E> Waiting<T, E> {
    /// The answer, if it comes within this.
    pub(super) fn take(&self, longest: Duration) -> Option<Told<T, E>> {
        match self.answered.recv_timeout(longest) {
            Err(RecvTimeoutError::Timeout) => None,
            answer => Some(answer),
        }
    }
}

/// How often a question is put, and how long each answer is waited for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Insistence {
    /// As the master does with such a command.
    Usual,
    /// With the patience of now, so often at the most.
    Attempts(u8),
    Of(Patience),
}

/// A question that is still to be put.
#[derive(Debug)]
pub(super) struct Question<E> {
    /// Gone when nobody waits for the answer any more.
    pub(super) asker: Weak<()>,
    pub(super) motor: MotorId,
    pub(super) command: Untyped,
    pub(super) insistence: Insistence,
    /// Until when it waits for its turn, on the clock of the bus, once it was there to be put.
    pub(super) turn_ends: Option<time::Instant>,
    pub(super) answer: Answer<Data, E>,
}

/// What goes before all questions and set-points, in the order in which it was said.
#[derive(Debug)]
pub(super) enum Order<E> {
    StopAll {
        kind: StopKind,
        also: MotorSet,
        answer: Answer<MotorSet, E>,
    },
    Stop {
        motor: MotorId,
        kind: StopKind,
        answer: Answer<MotorSet, E>,
    },
    LiftStop,
    LiftStopOf(MotorId),
    Resume(MotorId),
    NoteRestart(MotorId),
    Forget(MotorId),
    /// The answer, which comes no sooner than `until`, is what time it is then.
    Wait {
        until: time::Instant,
        answer: Answer<time::Instant, E>,
    },
}

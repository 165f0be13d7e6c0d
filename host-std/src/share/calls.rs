//! What callers lay on the desk, and where their answers go.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
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

// Whether it really is a set-point, the master sees by its kind.
impl SetPoint for Untyped {}

/// Where the answer to a call goes.
pub(super) type Answer<T, E> = SyncSender<Result<T, SharedBusError<E>>>;

/// Where a caller waits for the answer, if the call could be laid down.
pub(super) type Awaited<T, E> = Result<Waiting<T, E>, SharedBusError<E>>;

/// A caller that waits for an answer.
#[derive(Debug)]
pub(super) struct Waiting<T, E> {
    answered: Receiver<Result<T, SharedBusError<E>>>,
    pub(super) asker: Arc<Asker>,
}

/// A caller, for as long as it waits.
#[derive(Debug, Default)]
pub(super) struct Asker {
    has_answer: AtomicBool,
}

impl Asker {
    /// Whether it has taken its answer. One that is sent may never be looked at.
    pub(super) fn has_answer(&self) -> bool {
        self.has_answer.load(Ordering::Relaxed)
    }
}

impl<T, E> Waiting<T, E> {
    /// Where an answer goes, and where its caller waits for it.
    pub(super) fn new() -> (Answer<T, E>, Self) {
        let (answer, answered) = sync_channel(1);
        (answer, Self { answered, asker: Arc::default() })
    }

    /// The answer, if it comes within `longest`. Only a thread that has ended gives none, and it has said why.
    pub(super) fn take(
        &self,
        longest: Duration,
        last_words: impl FnOnce() -> SharedBusError<E>,
    ) -> Option<Result<T, SharedBusError<E>>> {
        match self.answered.recv_timeout(longest) {
            Ok(answer) => {
                self.asker.has_answer.store(true, Ordering::Relaxed);
                Some(answer)
            }
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => Some(Err(last_words())),
        }
    }
}

/// How often a question is put, and how long to wait for each answer.
#[derive(Clone, Copy, Debug)]
pub(super) enum Insistence {
    /// As the master does with such a command.
    Usual,
    /// With the present patience, at most so often.
    Attempts(u8),
    Of(Patience),
}

/// A question that is still to be put.
#[derive(Debug)]
pub(super) struct Question<E> {
    /// Gone when the caller no longer waits for the answer.
    pub(super) asker: Weak<Asker>,
    pub(super) motor: MotorId,
    pub(super) command: Untyped,
    pub(super) insistence: Insistence,
    /// Until when it waits for its turn, on the clock of the bus; set when it could first be put.
    pub(super) turn_ends: Option<time::Instant>,
    pub(super) answer: Answer<Data, E>,
}

impl<E> Question<E> {
    /// What ends motion is sent even if nobody waits for it any more. Not a restart: if it comes late, a load may fall.
    pub(super) fn outlives_its_caller(&self) -> bool {
        let kind = self.command.kind;
        kind.ends_motion() && !kind.is_refused_while_stopped()
    }
}

/// Goes before all questions and set-points; orders keep their order.
#[derive(Debug)]
pub(super) enum Order<E> {
    StopAll {
        kind: StopKind,
        also: MotorSet,
        asker: Arc<Asker>,
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
    /// It has arrived where one call has moved it.
    NoteArrival(MotorId),
    Forget(MotorId),
    /// The answer comes no sooner than `until`, and is the time then.
    Wait {
        until: time::Instant,
        answer: Answer<time::Instant, E>,
    },
}

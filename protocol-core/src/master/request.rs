//! A motor's request: what was asked, and how far it is.

use crate::data::Data;
use crate::kind::Kind;
use crate::master::config::Patience;
use crate::master::event::Failure;
use crate::master::late::{Of, Question};
use crate::time::Duration;

/// No reply comes sooner than that.
const SHORTEST_TIMEOUT: Duration = Duration::from_millis(1);

/// Who wants it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// The caller, who has a ticket for it.
    Caller,
    /// The caller, but it is not sent again: nobody waits for it any more, or all were told to end their motion since.
    Once,
    /// A stop: before everything else, whatever is in flight.
    Stop,
}

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    pub(super) question: Question,
    pub(super) data: Data,
    pub(super) purpose: Purpose,
    /// How long a reply is waited for.
    pub(super) timeout: Duration,
    /// How often it may still be sent.
    pub(super) attempts_left: u8,
    /// How often it was sent without a reply that came.
    pub(super) unanswered: u8,
    /// It ends motion and was answered, but something that was sent before it may still move the motor: it is
    /// sent once more when that is over.
    pub(super) once_more: bool,
}

impl Asked {
    pub(super) fn new(
        purpose: Purpose,
        question: Question,
        data: Data,
        patience: Patience,
    ) -> Self {
        Self {
            question,
            data,
            purpose,
            timeout: patience.reply_timeout.max(SHORTEST_TIMEOUT),
            attempts_left: patience.attempts.clamp(1, 15),
            unanswered: 0,
            once_more: false,
        }
    }

    pub(super) fn is_stop(&self) -> bool {
        self.purpose == Purpose::Stop
    }

    /// What its other sendings are of, once one has an answer.
    pub(super) fn of_others(&self) -> Of {
        if self.is_stop() { Of::StopAnswered } else { Of::RequestAnswered }
    }

    /// It is not sent again.
    pub(super) fn withdraw(&mut self) {
        if self.purpose == Purpose::Caller {
            self.purpose = Purpose::Once;
        }
    }

    pub(super) fn is_withdrawn(&self) -> bool {
        self.purpose == Purpose::Once
    }

    pub(super) fn kind(&self) -> Kind {
        self.question.kind
    }
}

/// How far a request is.
#[derive(Clone, Copy, Debug, Default)]
pub(super) enum Request {
    /// There is none.
    #[default]
    None,
    /// It is to be sent, for the first time or again.
    Waiting(Asked),
    /// It was sent, and its reply is awaited.
    InFlight(Asked),
    /// It was sent and has no reply; to be reported.
    Sent(Asked),
    /// It has failed; to be reported.
    Failed(Failure),
}

impl Request {
    pub(super) fn is_none(&self) -> bool {
        matches!(self, Self::None)
    }

    /// What is to be sent, if it is.
    pub(super) fn waiting(&self) -> Option<&Asked> {
        match self {
            Self::Waiting(asked) => Some(asked),
            _ => None,
        }
    }

    /// What a reply is awaited to, if one is.
    pub(super) fn in_flight(&self) -> Option<&Asked> {
        match self {
            Self::InFlight(asked) => Some(asked),
            _ => None,
        }
    }

    /// What an answer may come to: what is in flight, and a stop whose next sending waits.
    pub(super) fn answerable(&self) -> Option<&Asked> {
        match self {
            Self::InFlight(asked) => Some(asked),
            Self::Waiting(asked) if asked.is_stop() && asked.unanswered > 0 => Some(asked),
            _ => None,
        }
    }

    /// What is under way: waiting or in flight.
    pub(super) fn under_way(&self) -> Option<&Asked> {
        self.waiting().or(self.in_flight())
    }

    pub(super) fn under_way_mut(&mut self) -> Option<&mut Asked> {
        match self {
            Self::Waiting(asked) | Self::InFlight(asked) => Some(asked),
            Self::None | Self::Sent(_) | Self::Failed(_) => None,
        }
    }
}

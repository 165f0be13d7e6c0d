//! What a master reports, and the tickets by which a caller recognizes its answers.

use core::fmt;
use core::marker::PhantomData;

use crate::command::{AnyReply, Command, Feedback};
use crate::data::Data;
use crate::error::DecodeError;
use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::MotorSet;

/// Names one request. Its [`Ticket`] also carries the type of the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct TicketId {
    pub(super) motor: MotorId,
    pub(super) number: u32,
}

impl TicketId {
    /// The motor that was asked.
    pub const fn motor(self) -> MotorId {
        self.motor
    }
}

/// A request under way: finds its answer among the events, and knows the answer's type.
#[must_use = "the ticket is how the answer is known"]
pub struct Ticket<C> {
    id: TicketId,
    command: PhantomData<fn() -> C>,
}

impl<C> Ticket<C> {
    pub(super) const fn new(id: TicketId) -> Self {
        Self { id, command: PhantomData }
    }

    /// The name of this request.
    pub const fn id(&self) -> TicketId {
        self.id
    }
}

impl<C: Command> Ticket<C> {
    /// The outcome of this request if the event carries it. For a command that is over once it was sent, this is what
    /// was sent: nothing ([`NoReply`](crate::command::NoReply)), or the id of function 5, which drives were seen to
    /// take without an answer.
    pub fn outcome(&self, event: &Event) -> Option<Result<C::Reply, Failure>> {
        match *event {
            Event::Reply { ticket, data, .. } | Event::Sent { ticket, data }
                if ticket == self.id =>
            {
                Some(C::decode_reply(&data).map_err(Failure::Unreadable))
            }
            Event::Failed { ticket, failure, .. } if ticket == self.id => Some(Err(failure)),
            _ => None,
        }
    }
}

impl<C> Clone for Ticket<C> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C> Copy for Ticket<C> {}

impl<C> fmt::Debug for Ticket<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Ticket({:?})", self.id)
    }
}

#[cfg(feature = "defmt")]
impl<C> defmt::Format for Ticket<C> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "Ticket({})", self.id);
    }
}

/// Why a request has no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum Failure {
    /// No reply came in time, after all attempts. The command may have been carried out. If nobody acknowledged it, a
    /// controller may keep it: then it is carried out when the bus is intact again. Stop the motor, or cut its power,
    /// before the wire is repaired.
    #[error("no reply: is the motor powered, and is this its id?")]
    NoReply,
    /// The drive had lost its master and answered without doing anything (it does so once after its 0xF1 frames).
    /// Commands that may be sent again were sent again; this one may not. If a drive acknowledges with the command's
    /// own bytes, it may have been executed after all: both look alike.
    ///
    /// Also of a command to hold (0x81) that the motor has answered each time, with a pause of more than 150 ms before
    /// each: it may have lost its master in all of them.
    #[error(
        "the drive had lost its master and ignored the command: send it again if it is still wanted"
    )]
    NotExecuted,
    /// A reply came, but a field holds a value that is not allowed.
    #[error("the reply cannot be read: {0}")]
    Unreadable(DecodeError),
    /// A stop, or a request that ends motion, took its place before it was sent or answered: it may have been carried
    /// out. This is also reported if it had failed for another reason that was not polled yet.
    #[error("the motors were stopped first")]
    Stopped,
    /// A stop that the motor [has not confirmed](Event::StopUnconfirmed) took its place, for example that of a read:
    /// the stop goes once more every 100 ms or so, before anything else. The motor is silent, or the bus takes nothing.
    #[error(
        "the motor has not confirmed the stop, which goes once more before this: it may be silent"
    )]
    StopUnconfirmed,
    /// The bus carried nothing while the command waited, for the first time or to be sent again. With an
    /// [`AsyncCan`](crate::io::AsyncCan) whose `transmit` is not done at its first poll, every request ends so.
    #[error(
        "the bus carried nothing, so the command was dropped: check its wiring, its bit rate and the motors' power"
    )]
    BusDown,
    /// Dropped before it was sent. A set-point: it waited too long, the bus carried nothing, or the motor was stopped
    /// or has restarted. Another command that a stop would refuse: its caller no longer waits for the outcome, or the
    /// loop was held up for seconds; or its motor has restarted, and then it may have been sent once.
    #[error("it could not be sent in time, so it was dropped")]
    Dropped,
}

/// What a master reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum Event {
    /// A request was answered. [`Ticket::outcome`] reads it.
    Reply {
        /// Which request.
        ticket: TicketId,
        /// The kind of its command.
        kind: Kind,
        /// The reply's data field.
        data: Data,
    },
    /// A command that is over once it was sent: the controller has taken it. If the controller hands it back after this
    /// was reported, it is not sent again.
    Sent {
        /// Which request.
        ticket: TicketId,
        /// Its data field.
        data: Data,
    },
    /// A request has no answer.
    Failed {
        /// Which request.
        ticket: TicketId,
        /// Why.
        failure: Failure,
    },
    /// A motor answered its set-point stream. Feedback describes the motor's state, and does not name its set-point.
    Feedback {
        /// The motor.
        motor: MotorId,
        /// Its reply.
        reply: AnyReply,
    },
    /// A set-point was not answered in time. The next one is sent all the same.
    SetPointUnanswered {
        /// The motor.
        motor: MotorId,
    },
    /// A set-point was dropped before it was sent: it waited too long, the bus carried nothing, the motor was told to
    /// end its motion or has restarted, or the caller that waited for its feedback has left.
    SetPointDropped {
        /// The motor.
        motor: MotorId,
    },
    /// A motor answered a broadcast.
    BroadcastReply {
        /// The motor.
        motor: MotorId,
        /// Its reply.
        reply: AnyReply,
    },
    /// A broadcast is over: every expected motor has answered, the time is up, or it was dropped.
    BroadcastDone {
        /// The expected motors that were silent. On CAN, motors whose id filter is on
        /// ([`Target::All`](crate::Target::All)) always are.
        silent: MotorSet,
        /// Whether it was sent. `false` if a stop, a bus that was down or a restart that was noticed dropped it before.
        was_sent: bool,
    },
    /// A motor has confirmed the stop. Also reported if a [broadcast](crate::master::Master::broadcast) that ends
    /// motion went to each motor individually, because another motor was stopped meanwhile.
    StopConfirmed {
        /// The motor.
        motor: MotorId,
    },
    /// A motor has not confirmed the stop, after many attempts: cut its power.
    ///
    /// While the stop is in force it is still [sent](crate::master::Master::stop_all), until the motor has answered it
    /// or another command that stops it (0x80, 0x81). Then [`StopConfirmed`](Self::StopConfirmed), or that command's
    /// reply, follows.
    ///
    /// Not reported while the bus takes nothing at all: have a
    /// [time limit of your own](crate::master::Master::stop_all).
    StopUnconfirmed {
        /// The motor.
        motor: MotorId,
    },
    /// A motor reports unasked: active reply (0xB6) or error reporting (function 3). Also reported if the answer to a
    /// read of its status shows errors and comes too late, twice, or unexpected.
    Report {
        /// The motor.
        motor: MotorId,
        /// Its reply.
        reply: AnyReply,
    },
    /// A motor has restarted, or may have. One of these signs was seen:
    ///
    /// - The bus has taken 0x76 for it (which a controller may still hand back).
    /// - Nothing was heard of it for a second, even if it was not asked anything, and then it did not answer, or could
    ///   not be asked three times because the bus took nothing. This is reported when its answer does not come or when
    ///   it is to be moved next, and once more when it is heard again.
    /// - Its answer to a read of its run time (0xB1) is too short: shorter than the time since it was first heard, or
    ///   than its last answer and the time since. The difference must be more than 250 ms plus 1/64 of the answer,
    ///   since clocks differ. This does not apply if the motor has been known for 48 days, or to answers to a command
    ///   to all. The run time starts anew after 49.7 days, which is taken for a restart if it was not read since the
    ///   motor was first heard or reported to have restarted.
    /// - Its stream's feedback reports a position that is more than half a turn beyond what 10,000 degrees/s could have
    ///   turned since the last feedback that came within 18 ms of its set-point. In motion mode: an eighth of the scale
    ///   beyond 500 steps of it per millisecond. Feedback that answers requests shows nothing.
    ///
    /// Only the last two signs show that a motor lost its supply for less than a second, **or for longer while it was
    /// not asked anything, for example when an emergency stop cut the power**: read its run time after each silence,
    /// and before you lift a stop.
    ///
    /// Its turns may be lost. Commands that move it are refused until
    /// [`Master::resume`](crate::master::Master::resume). It still carries out a command that it has heard since its
    /// restart: [stop](crate::master::Master::stop) it.
    Restarted {
        /// The motor.
        motor: MotorId,
    },
    /// A motor has lost its master and says so (0xF1). Its output is cut, and it ignores the next command.
    LostMaster {
        /// The motor.
        motor: MotorId,
    },
    /// A reply that nothing waits for: late, doubled, or to another master.
    Stray {
        /// The motor.
        motor: MotorId,
        /// The data field.
        data: Data,
    },
    /// The controller had no room for a frame that came: the command that it answered counts as unanswered. Look at the
    /// bus more often.
    Overrun,
}

impl Event {
    /// Temperature, torque current, speed and angle, if the event carries them. The feedback of motion mode does not:
    /// it is an [`AnyReply::Motion`], which [`MotionRanges::feedback`](crate::command::MotionRanges::feedback) scales.
    pub const fn feedback(&self) -> Option<(MotorId, Feedback)> {
        match self {
            Self::Feedback { motor, reply }
            | Self::BroadcastReply { motor, reply }
            | Self::Report { motor, reply } => match feedback_of(reply) {
                Some(feedback) => Some((*motor, feedback)),
                None => None,
            },
            _ => None,
        }
    }
}

/// Whether a reply says that the drive has errors.
pub(crate) fn has_errors(reply: &AnyReply) -> bool {
    matches!(reply, AnyReply::ReadStatus1(status) if !status.errors.is_empty())
}

/// The [`Feedback`] in a reply that can come without a ticket, if it is in that form.
pub(super) const fn feedback_of(reply: &AnyReply) -> Option<Feedback> {
    match reply {
        AnyReply::Torque(feedback)
        | AnyReply::Speed(feedback)
        | AnyReply::AbsolutePosition(feedback)
        | AnyReply::ForcePosition(feedback)
        | AnyReply::ReadStatus2(feedback) => Some(*feedback),
        _ => None,
    }
}

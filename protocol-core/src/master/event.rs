//! What a master reports, and the tickets by which a caller knows its own answers.

use core::fmt;
use core::marker::PhantomData;

use crate::command::{AnyReply, Command, Feedback};
use crate::data::Data;
use crate::error::DecodeError;
use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::MotorSet;

/// Names one request; its [`Ticket`] carries the type of its answer.
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

/// A request under way: it knows its answer among the events, and the answer's type.
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
    /// The outcome of this request if the event brings it. Of a command that is over when it was sent it
    /// says what was sent: nothing ([`NoReply`](crate::command::NoReply)), or the id of function 5, which
    /// drives were seen to take without an answer.
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
    /// No reply came in time, after all attempts. It may have been carried out; and what a controller keeps because
    /// nobody acknowledges it will be, when the bus is whole again: stop the motor, or cut its power, before anybody
    /// mends the wire.
    #[error("no reply: is the motor powered, and is this its id?")]
    NoReply,
    /// The drive had lost its master and answered without doing anything (it does so once after its
    /// 0xF1 frames). What may be sent again has been; this one may not. Where a drive acknowledges by
    /// the command's own bytes it may have been executed all the same: that looks alike.
    #[error(
        "the drive had lost its master and ignored the command: send it again if it is still wanted"
    )]
    NotExecuted,
    /// A reply came, but its fields hold what is not allowed.
    #[error("the reply cannot be read: {0}")]
    Unreadable(DecodeError),
    /// A stop took its place, before it was sent or before it was answered: it may have been carried out. The same is
    /// reported where it had failed for another reason that nobody had polled yet.
    #[error("the motors were stopped first")]
    Stopped,
    /// A stop that the motor [has not confirmed](Event::StopUnconfirmed) took its place, a read's for example: it goes
    /// once more every 100 ms or so, before anything else. The motor is silent, or the bus takes nothing.
    #[error(
        "the motor has not confirmed the stop, which goes once more before this: it may be silent"
    )]
    StopUnconfirmed,
    /// The bus carried nothing while the command waited. With an [`AsyncCan`](crate::io::AsyncCan) whose `transmit` is
    /// not done at its first poll every request ends so.
    #[error("the bus carried nothing, so the command was dropped")]
    BusDown,
    /// A set-point was dropped before it was sent: it waited for too long, the bus carried nothing, or the
    /// motor was stopped or has restarted. Or a move was dropped: its motor has restarted, or nobody waits for its
    /// outcome any more.
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
    /// A command that is over with that was sent: the controller has taken it. One that the controller hands
    /// back after this was reported is not sent again.
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
    /// A motor answered its set-point stream. Feedback says how the motor is, not which set-point
    /// it is about.
    Feedback {
        /// The motor.
        motor: MotorId,
        /// Its reply.
        reply: AnyReply,
    },
    /// A set-point was not answered in time. The next one goes out all the same.
    SetPointUnanswered {
        /// The motor.
        motor: MotorId,
    },
    /// A set-point was dropped before it was sent: it waited too long, the bus carried nothing, the motor was told to
    /// end its motion or has restarted, or whoever waited for its feedback has left.
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
        /// Whether it was sent: not if a stop or a bus that was down dropped it before, or a restart that was seen.
        was_sent: bool,
    },
    /// A motor has confirmed the stop. Also where a [broadcast](crate::master::Master::broadcast) that ends motion
    /// went to each motor by itself, because another motor was stopped meanwhile.
    StopConfirmed {
        /// The motor.
        motor: MotorId,
    },
    /// A motor has not confirmed the stop, after many attempts: cut its power. While the stop is in force it goes on
    /// being sent, every 100 ms or so and as soon as the motor is heard again, until it has answered that, or another
    /// command that stops it (0x80, 0x81): then [`StopConfirmed`](Self::StopConfirmed), or that command's reply, follows.
    /// Not reported while a bus takes nothing at all: then the stop waits, and nothing need say so. Have a time limit of
    /// your own.
    StopUnconfirmed {
        /// The motor.
        motor: MotorId,
    },
    /// A motor reports by itself: active reply (0xB6) or error reporting (function 3). So, too, is told that it has errors
    /// where it answers a read of its status too late, twice, or though nobody expects that of it.
    Report {
        /// The motor.
        motor: MotorId,
        /// Its reply.
        reply: AnyReply,
    },
    /// A motor has restarted, or may have. One of these says so:
    ///
    /// - The bus has taken 0x76 for it (which a controller may still hand back).
    /// - It was silent for a second, also because nobody asked it anything, and does not answer then. This is reported
    ///   when it does not answer, or is to be moved then, and once more when it answers again. One that lost its supply for
    ///   less, **or for longer while nobody asked it anything, behind an emergency stop that cuts the power for example**,
    ///   shows by nothing but the next two: read its run time after each silence, and before a stop is lifted.
    /// - It says in answer to a request (0xB1) that it has run for less long than since it was first heard, or than it said
    ///   before and the time since: by more than 250 ms and 1/64 of what it says, for its clock may differ. Not where it is
    ///   known for 48 days, and not in answer to a command to all. So does one that has not restarted, whose time begins
    ///   anew after 49.7 days: if it was not read since it was first heard, or said to have restarted.
    /// - Its stream's feedback tells a place that is more than half a turn beyond what 10,000 degrees/s could have
    ///   turned since it told one within 18 ms of a set-point; in motion mode, an eighth of the scale beyond 500 steps of
    ///   it in a millisecond. Feedback that answers requests tells nothing of it.
    ///
    /// Its turns may be lost. Whatever moves it is refused until
    /// [`Master::resume`](crate::master::Master::resume). A command that it has heard since its restart it carries
    /// out all the same: [stop](crate::master::Master::stop) it.
    Restarted {
        /// The motor.
        motor: MotorId,
    },
    /// A motor has lost its master and says so (0xF1). Its output is cut; it ignores the first
    /// command from now on.
    LostMaster {
        /// The motor.
        motor: MotorId,
    },
    /// A reply that nothing waits for: late, doubled, or to somebody else.
    Stray {
        /// The motor.
        motor: MotorId,
        /// The data field.
        data: Data,
    },
    /// The controller had no place for a frame that came: what it answered counts as unanswered. Look at the bus
    /// more often.
    Overrun,
}

impl Event {
    /// Temperature, torque current, speed and angle, if the event brings them. The feedback of motion mode does not:
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

/// What a reply that can come without a ticket says in the form of [`Feedback`].
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

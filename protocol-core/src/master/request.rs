//! A motor's request: what was asked, and how far it is.

use crate::command::Command;
use crate::data::Data;
use crate::error::RequestError;
use crate::id::MotorId;
use crate::kind::Kind;
use crate::master::late::{Of, Question};
use crate::master::motor::News;
use crate::master::motor::reports::reported_bit;
use crate::master::stop::STOP_ATTEMPTS;
use crate::master::{Failure, Master, Patience, StopKind, Ticket, TicketId};
use crate::time::Duration;

/// No reply comes sooner than that.
pub(super) const SHORTEST_TIMEOUT: Duration = Duration::from_millis(1);

/// Who wants it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// The caller, who has a ticket for it.
    Caller,
    /// The caller, but it is not sent again: nobody waits for it any more, or it moves and all were told to end their
    /// motion since, or its motor has restarted.
    Once,
    /// A stop: before everything else, whatever is in flight.
    Stop,
    /// A stop like one that came to its end, with nothing sent since that a stop would refuse. On a line every second
    /// turn is somebody else's; on CAN it waits for whom was sent no more and may be waiting for its turn.
    StopCalledAgain,
    /// A stop that was given up and goes once more.
    StopAgain,
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
    pub(super) proof: Proof,
}

/// How far it is shown that motion has ended: what ends it may have to be answered twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Proof {
    /// It was not answered.
    First,
    /// Perhaps it was not: its answers may be owed to earlier ones. It waits until nothing is owed any more.
    WaitsForOwed,
    /// It was, but something that was sent before it may still move the motor: it waits until that is over.
    Waits,
    /// It was, and has been sent once more.
    Second,
}

impl Proof {
    pub(super) fn waits(self) -> bool {
        matches!(self, Self::WaitsForOwed | Self::Waits)
    }

    /// The same when it is sent.
    pub(super) fn begun(self) -> Self {
        match self {
            Self::First | Self::WaitsForOwed => Self::First,
            Self::Waits | Self::Second => Self::Second,
        }
    }
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
            proof: Proof::First,
        }
    }

    pub(super) fn is_stop(&self) -> bool {
        matches!(self.purpose, Purpose::Stop | Purpose::StopCalledAgain | Purpose::StopAgain)
    }

    /// What its other sendings are of, once one has an answer.
    pub(super) fn of_others(&self) -> Of {
        if self.is_stop() { Of::Nobody } else { Of::RequestAnswered }
    }

    /// Whether this stop was not sent yet, or handed back.
    pub(super) fn was_never_sent(&self) -> bool {
        self.attempts_left == STOP_ATTEMPTS
    }

    /// It is not sent again.
    pub(super) fn withdraw(&mut self) {
        self.purpose = Purpose::Once;
    }

    /// Whether it may be sent once more.
    pub(super) fn may_go_again(&self) -> bool {
        self.attempts_left > 0 && self.purpose != Purpose::Once
    }

    pub(super) fn kind(&self) -> Kind {
        self.question.kind
    }

    pub(super) fn ends_motion(&self) -> bool {
        self.kind().ends_motion()
    }

    pub(super) fn may_move(&self) -> bool {
        self.kind().may_move()
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

impl<const N: usize> Master<N> {
    /// Sends one motor a command and waits for its reply, where it has one, with the configuration's
    /// patience.
    ///
    /// A command that [ends motion](Kind::ends_motion) drops the motor's waiting set-point and a waiting command to
    /// all that may move it, and its reply counts only once nothing that was sent before it can move the motor any
    /// more.
    ///
    /// # Errors
    /// [`RequestError`]: the command does not go to one motor or not over this bus, the motor's
    /// earlier request is under way, the motor follows a stream of this kind, the motors were stopped, the
    /// command moves a motor that has [restarted](crate::master::Event::Restarted), or there is no place for one more.
    pub fn request<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<Ticket<C>, RequestError> {
        self.put_request(motor, &command, None)
    }

    /// As [`request`](Self::request), with a patience of its own.
    ///
    /// # Errors
    /// As [`request`](Self::request).
    pub fn request_with<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Patience,
    ) -> Result<Ticket<C>, RequestError> {
        self.put_request(motor, &command, Some(patience))
    }

    /// As [`request`](Self::request), with a patience of its own or the configuration's.
    pub(crate) fn put_request<C: Command>(
        &mut self,
        motor: MotorId,
        command: &C,
        patience: Option<Patience>,
    ) -> Result<Ticket<C>, RequestError> {
        let data = command.encode();
        let ticket = self.put(motor, command.kind().of_bytes(&data), data, patience)?;
        Ok(Ticket::new(ticket))
    }

    /// As [`put_request`](Self::put_request), in one piece of code for all types.
    #[inline(never)]
    fn put(
        &mut self,
        motor: MotorId,
        kind: Kind,
        data: Data,
        patience: Option<Patience>,
    ) -> Result<TicketId, RequestError> {
        self.check(kind, motor.into())?;
        let patience = patience.unwrap_or_else(|| self.config.patience(kind));
        let question = Question::of(kind, &data);
        // What was offered may be a set-point that this ends.
        self.offer = None;
        let (pace, now, number) = (self.pace, self.now, self.last_ticket.wrapping_add(1));
        let place = self.place_for(motor)?;
        self.change_at(place, |motor, config| {
            if !motor.request.is_none()
                || motor.news.intersects(News::STOPPED | News::STOPPED_AGAIN)
            {
                return Err(RequestError::Busy);
            }
            if kind.moves() && motor.note_restart_if_silent(config, now) {
                return Err(RequestError::Restarted);
            }
            if let Some(opcode) = kind.opcode() {
                if motor.reports(reported_bit(opcode), now) {
                    return Err(RequestError::Reported(opcode));
                }
                if motor.stream.is_of(question) {
                    return Err(RequestError::Streamed(opcode));
                }
            }
            let asked = Asked::new(Purpose::Caller, question, data, patience);
            if kind.ends_motion() {
                motor.drop_waiting_set_point();
                motor.let_other_stop_come_first(&asked, config, now);
            }
            motor.join(pace);
            motor.request = Request::Waiting(asked);
            motor.ticket = number;
            Ok(())
        })
        .unwrap_or(Err(RequestError::TooManyMotors { capacity: N }))?;
        if kind.ends_motion() {
            self.let_line_answer();
            self.broadcast.cancel_what_moves();
            if let Some(by) = StopKind::by(kind) {
                self.is_any_off_since |= by == StopKind::Off;
                self.overtakes_broadcast(motor, by);
            }
        }
        self.last_ticket = number;
        Ok(TicketId { motor, number })
    }

    /// Nobody waits for the outcome of this request any more. If a stop would refuse it, as it would a move, it must
    /// not be sent, or sent again, at any later time:
    ///
    /// - One that waits fails with [`Failure::Dropped`].
    /// - One that is on the wire, or lies in a controller's mailbox, is not called back: it is carried out, its answer
    ///   still comes, and only a [stop](Self::stop) ends what it does. If it is lost or handed back it is not sent
    ///   once more.
    ///
    /// What reads, writes or ends motion goes on. A request that is over is left alone. The `ask` of the
    /// [loops](crate::io) withdraws what it asked when it is left.
    pub fn withdraw(&mut self, TicketId { motor, number }: TicketId) {
        let now = self.now;
        self.change(motor, |motor, config| match &mut motor.request {
            _ if motor.ticket != number => {}
            Request::Waiting(asked) | Request::InFlight(asked) | Request::Sent(asked)
                if !asked.kind().is_refused_while_stopped() => {}
            Request::InFlight(asked) | Request::Sent(asked) => asked.withdraw(),
            Request::Waiting(_) => {
                motor.finish_request(Request::Failed(Failure::Dropped), config, now);
            }
            Request::None | Request::Failed(_) => {}
        });
    }
}

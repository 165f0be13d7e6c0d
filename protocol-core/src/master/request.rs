//! A motor's request: what was asked, and its state.

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

/// No reply comes sooner than this.
pub(super) const SHORTEST_TIMEOUT: Duration = Duration::from_millis(1);

/// What a request is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// A caller, who has a ticket for it.
    Caller,
    /// A caller, who wants a motor to hold that has answered and may not obey yet: it has the attempts of a stop.
    AnsweredEarly,
    /// A caller, but it is not sent again: the caller no longer waits for it, or it moves and all were told to end
    /// their motion since, or its motor has restarted.
    Once,
    /// A stop: sent before everything else, whatever is in flight.
    Stop,
    /// A stop that was called again: the equal one before it is over or was sent as often as it may be, and nothing was
    /// sent since that a stop would refuse. It leaves turns to others.
    StopCalledAgain,
    /// A stop that was given up and is sent once more.
    StopAgain,
}

/// What is asked.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    pub(super) question: Question,
    pub(super) data: Data,
    pub(super) purpose: Purpose,
    /// How long to wait for a reply.
    pub(super) timeout: Duration,
    /// How often it may still be sent.
    pub(super) attempts_left: u8,
    /// How many of its sendings were not answered.
    pub(super) unanswered: u8,
    pub(super) proof: Proof,
}

/// How far it is proven that motion has ended: what ends it may have to be answered twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Proof {
    /// No answer yet.
    First,
    /// No certain answer: those that came may belong to earlier commands. It waits until none of these can come any
    /// more.
    WaitsForOwed,
    /// Answered, but something sent before may still move the motor: it waits until that is over.
    Waits,
    /// Answered, and sent once more.
    Second,
}

impl Proof {
    pub(super) fn waits(self) -> bool {
        matches!(self, Self::WaitsForOwed | Self::Waits)
    }

    /// The same once it is sent.
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

    /// What its other sendings count as, once one has an answer.
    pub(super) fn of_others(&self) -> Of {
        if self.is_stop() { Of::Nobody } else { Of::RequestAnswered }
    }

    /// Whether this stop was not sent yet, or was handed back.
    pub(super) fn was_never_sent(&self) -> bool {
        self.attempts_left == STOP_ATTEMPTS
    }

    /// It is to hold, and was answered by a motor that [may not obey yet](crate::master::motor::steady).
    pub(super) fn was_answered_early(&mut self) {
        match self.purpose {
            Purpose::Caller => {
                (self.purpose, self.attempts_left) = (Purpose::AnsweredEarly, STOP_ATTEMPTS - 1);
            }
            Purpose::StopAgain => self.attempts_left = 1,
            _ => {}
        }
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

/// The state of a request.
#[derive(Clone, Copy, Debug, Default)]
pub(super) enum Request {
    /// There is none.
    #[default]
    None,
    /// Waits to be sent, for the first time or again.
    Waiting(Asked),
    /// Sent, and waits for its reply.
    InFlight(Asked),
    /// Sent, and has no reply; to be reported.
    Sent(Asked),
    /// Failed; to be reported.
    Failed(Failure),
}

impl Request {
    pub(super) fn is_none(&self) -> bool {
        matches!(self, Self::None)
    }

    /// What was asked, unless it has failed.
    pub(super) fn asked(&self) -> Option<&Asked> {
        match self {
            Self::Waiting(asked) | Self::InFlight(asked) | Self::Sent(asked) => Some(asked),
            Self::None | Self::Failed(_) => None,
        }
    }

    /// What is to be sent, if anything.
    pub(super) fn waiting(&self) -> Option<&Asked> {
        match self {
            Self::Waiting(asked) => Some(asked),
            _ => None,
        }
    }

    /// What waits for its reply, if anything.
    pub(super) fn in_flight(&self) -> Option<&Asked> {
        match self {
            Self::InFlight(asked) => Some(asked),
            _ => None,
        }
    }

    /// What a reply may answer: what is in flight, or a stop that was sent and waits to be sent again.
    pub(super) fn answerable(&self) -> Option<&Asked> {
        match self {
            Self::InFlight(asked) => Some(asked),
            Self::Waiting(asked) if asked.is_stop() && asked.unanswered > 0 => Some(asked),
            _ => None,
        }
    }

    /// What is waiting or in flight.
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
    /// Sends one motor a command and waits for its reply, if it has one, with the time-out and attempts of the
    /// configuration.
    ///
    /// A command that [ends motion](Kind::ends_motion) drops the motor's waiting set-point and a waiting broadcast that
    /// may move it. If it is refused because the motor is busy, it is not put: ask again, or [stop](Self::stop) the
    /// motor. What waits and may move the motor is dropped all the same, as by a stop, and nothing of that is sent
    /// again. Its reply counts only once nothing that was sent before it can move the motor any more.
    ///
    /// # Errors
    /// [`RequestError`] in these cases:
    ///
    /// - The command does not go to one motor, or not over this bus.
    /// - The motor's earlier request is under way, or the motor follows a stream of this kind, or reports this unasked
    ///   (0xB6).
    /// - The motors were stopped.
    /// - The command moves a motor that has [restarted](crate::master::Event::Restarted).
    /// - There is no place for one more motor.
    pub fn request<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
    ) -> Result<Ticket<C>, RequestError> {
        self.put_request(motor, &command, None)
    }

    /// As [`request`](Self::request), with its own time-out and attempts.
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

    /// As [`request`](Self::request), with its own time-out and attempts or those of the configuration.
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

    /// Compiled once for all types.
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
        // What was offered may be a set-point that this command ends.
        self.offer = None;
        let (pace, now, number) = (self.pace, self.now, self.last_ticket.wrapping_add(1));
        self.place_for(motor)?;
        if kind.ends_motion() {
            self.let_line_answer();
            self.broadcast.cancel_what_moves();
        }
        self.change(motor, |motor, config| {
            if !motor.request.is_none()
                || motor.news.intersects(News::STOPPED | News::STOPPED_AGAIN)
            {
                if kind.ends_motion() {
                    // It is asked for again later. What it is to end does not go on until then.
                    motor.drop_what_moves(Failure::Stopped, config, now);
                }
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
                motor.end_stream();
                motor.let_other_stop_come_first(&asked, config, now);
            }
            motor.join(pace);
            motor.request = Request::Waiting(asked);
            motor.ticket = number;
            Ok(())
        })
        .unwrap_or(Err(RequestError::TooManyMotors { capacity: N }))?;
        if let Some(by) = StopKind::by(kind) {
            self.is_any_off_since |= by == StopKind::Off;
            self.overtakes_broadcast(motor, by);
        }
        self.last_ticket = number;
        Ok(TicketId { motor, number })
    }

    /// The caller no longer waits for the outcome of this request. If a stop would refuse the command (a move, a
    /// restart, a write to ROM), it must not be sent, or sent again, at any later time:
    ///
    /// - If it waits, it fails with [`Failure::Dropped`].
    /// - If it is on the wire, or in a controller's mailbox, it is not called back. It is carried out, its answer still
    ///   comes, and only a [stop](Self::stop) ends what it does. If it is lost or handed back, it is not sent again.
    ///
    /// Other commands go on: reads, writes to RAM, a stop, a shutdown. A request that is over is left alone.
    /// When an `ask` of the [loops](crate::io) is dropped, it withdraws its request.
    pub fn withdraw(&mut self, TicketId { motor, number }: TicketId) {
        let now = self.now;
        self.change(motor, |motor, config| {
            if motor.ticket == number {
                motor.withdraw(Failure::Dropped, config, now);
            }
        });
    }
}

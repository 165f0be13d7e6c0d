//! Questions to one motor after the other.

use myactuator_protocol_core::command::{
    Command, CommunicationLossProtection, ErrorFlags, FunctionControl, LockBrake, ModelName,
    ReadModel, ReadMultiTurnAngle, ReadRunTime, ReadStatus1, ReadStatus2, ReadVersionDate,
    ReleaseBrake, Shutdown, Stop, Switch, VersionDate,
};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::bring_up::{BRAKE_MOVES, turns};
use myactuator_protocol_core::master::{Event, Master, MotorSet, Patience, TicketId};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::Angle;
use myactuator_protocol_core::{Data, MotorId};

use super::Setup;

/// How long to wait for a write, which may be one to ROM. Writing a second time does no harm here.
const WRITE: Patience = Patience { reply_timeout: Duration::from_millis(50), attempts: 3 };

/// How long after nothing holds a shaft any more it is checked: it turns by then, and has not fallen far.
const FALLS: Duration = Duration::from_millis(50);

/// A request to a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Question {
    VersionDate,
    Model,
    Errors,
    Protection,
    ErrorReports,
    ReleaseBrake,
    /// Output on, at rest.
    Hold,
    Angle,
    /// Where it is, which is where it is to begin.
    Home,
    RunTime,
    LockBrake,
    /// Whether its shaft stands.
    Stands,
    /// Output off.
    Off,
}

/// Its outcome.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Answer {
    /// No answer came, or it cannot be read.
    None,
    /// It was done, or its shaft stands.
    Done,
    /// It reports no error.
    Sound,
    Version(VersionDate),
    Model(ModelName),
    Errors(ErrorFlags),
    Angle(Angle),
    Home(Angle),
    /// Its shaft does not stand.
    Turns,
}

impl Question {
    /// Sends it to a motor.
    pub(super) fn ask<const N: usize>(
        self,
        motor: MotorId,
        setup: &Setup,
        master: &mut Master<N>,
    ) -> Result<TicketId, RequestError> {
        match self {
            Self::VersionDate => master.request(motor, ReadVersionDate).map(|t| t.id()),
            Self::Model => master.request(motor, ReadModel).map(|t| t.id()),
            Self::Errors => master.request(motor, ReadStatus1).map(|t| t.id()),
            Self::Protection => {
                // Written to ROM each time, but to the same value.
                let command = CommunicationLossProtection { timeout: setup.protection };
                master.request_with(motor, command, WRITE).map(|t| t.id())
            }
            Self::ErrorReports => {
                // No command reads whether it is on, and nothing says that it is saved. So it is set each
                // time.
                let command = FunctionControl::ErrorReporting(Switch::On);
                master.request_with(motor, command, WRITE).map(|t| t.id())
            }
            Self::Hold => master.request(motor, Stop).map(|t| t.id()),
            Self::ReleaseBrake => master.request(motor, ReleaseBrake).map(|t| t.id()),
            Self::Angle | Self::Home => master.request(motor, ReadMultiTurnAngle).map(|t| t.id()),
            Self::RunTime => master.request(motor, ReadRunTime).map(|t| t.id()),
            Self::LockBrake => master.request(motor, LockBrake).map(|t| t.id()),
            Self::Stands => master.request(motor, ReadStatus2).map(|t| t.id()),
            Self::Off => master.request(motor, Shutdown).map(|t| t.id()),
        }
    }

    /// Reads the answer from an event, if the event is the outcome of this request.
    pub(super) fn answer(self, ticket: TicketId, event: &Event) -> Option<Answer> {
        match event {
            Event::Reply { ticket: of, data, .. } if *of == ticket => {
                Some(self.read(data).unwrap_or(Answer::None))
            }
            Event::Failed { ticket: of, .. } if *of == ticket => Some(Answer::None),
            _ => None,
        }
    }

    fn read(self, data: &Data) -> Option<Answer> {
        let answer = match self {
            Self::VersionDate => {
                Answer::Version(ReadVersionDate::decode_reply(data).ok()?.version_date)
            }
            Self::Model => Answer::Model(ReadModel::decode_reply(data).ok()?.model),
            Self::Errors => match ReadStatus1::decode_reply(data).ok()?.errors {
                errors if errors.is_empty() => Answer::Sound,
                errors => Answer::Errors(errors),
            },
            Self::Angle => Answer::Angle(ReadMultiTurnAngle::decode_reply(data).ok()?.angle),
            Self::Home => Answer::Home(ReadMultiTurnAngle::decode_reply(data).ok()?.angle),
            Self::Stands if turns(ReadStatus2::decode_reply(data).ok()?.speed) => Answer::Turns,
            Self::Protection
            | Self::ErrorReports
            | Self::Hold
            | Self::ReleaseBrake
            // The master sees in the run time whether the motor has restarted.
            | Self::RunTime
            | Self::LockBrake
            | Self::Stands
            | Self::Off => Answer::Done,
        };
        Some(answer)
    }
}

/// The questions of a script. Each part is done for all motors before the next: so all brakes open at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// Which motors are there, what they are, and whether they report errors.
    Find,
    Protect,
    ReportErrors,
    /// Opens the brake. The shaft then falls unless its motor holds it, which a motor does not do after a shutdown or a
    /// restart.
    ///
    /// So the motor is told to hold right after the brake is told to open, before it is open: behind a locked brake a
    /// stop may have no effect. A motor with an error opens its brake but does not hold. So its errors are read before,
    /// and once more at the end.
    Release,
    /// Where the motors are is read last, once their brakes are open, since a shaft may sink until then. So is whether
    /// a motor has restarted meanwhile, which locks its brake.
    Begin,
    /// Before the outputs are switched off: without power the shafts are free.
    Lock,
    SwitchOff,
    /// Whether the shafts stand.
    Look,
}

impl Part {
    const fn questions(self) -> &'static [Question] {
        use Question as Q;
        match self {
            Self::Find => &[Q::VersionDate, Q::Model, Q::Errors, Q::RunTime],
            Self::Protect => &[Q::Protection],
            Self::ReportErrors => &[Q::ErrorReports],
            Self::Release => &[Q::Errors, Q::ReleaseBrake, Q::Hold, Q::Errors],
            Self::Begin => &[Q::RunTime, Q::Home],
            Self::Lock => &[Q::LockBrake],
            Self::SwitchOff => &[Q::Stands, Q::Off],
            Self::Look => &[Q::Stands],
        }
    }
}

/// What a script did in this cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    Waiting,
    /// The master does not take the request to this motor.
    Refused(MotorId),
    Over,
}

/// A script: the same questions to one motor after the other.
#[derive(Debug)]
pub(super) struct Script {
    part: Part,
    /// Which question is next.
    next: usize,
    /// Motors that have not answered all questions, including the one that is being asked.
    left: MotorSet,
    /// The request in flight.
    asked: Option<TicketId>,
    not_before: Instant,
}

impl Script {
    /// Asks these motors the questions of this part, not before this time.
    pub(super) const fn new(part: Part, motors: MotorSet, not_before: Instant) -> Self {
        Self { part, next: 0, left: motors, asked: None, not_before }
    }

    /// What follows in preparing these motors, which begins with [`Part::Protect`].
    pub(super) fn next_of_preparing(
        &self,
        setup: &Setup,
        motors: MotorSet,
        now: Instant,
    ) -> Option<Self> {
        match self.part {
            Part::Protect if setup.error_reports => {
                Some(Self::new(Part::ReportErrors, motors, now))
            }
            Part::Protect | Part::ReportErrors => Some(Self::new(Part::Release, motors, now)),
            Part::Release => Some(Self::new(Part::Begin, motors, now + BRAKE_MOVES)),
            _ => None,
        }
    }

    /// What follows in shutting down these motors, which begins with [`Part::Lock`], or in a check alone, which is
    /// [`Part::Look`]. Until the brakes hold, the outputs may have to. Motors that turn behind a locked brake, or
    /// without a brake once their output is off, are told to hold their loads again.
    pub(super) fn next_of_shutting_down(
        &self,
        motors: MotorSet,
        turning: MotorSet,
        now: Instant,
    ) -> Option<Self> {
        match self.part {
            Part::Lock => Some(Self::new(Part::SwitchOff, motors, now + BRAKE_MOVES)),
            Part::Release => None,
            _ if !turning.is_empty() => Some(Self::new(Part::Release, turning, now)),
            Part::SwitchOff => Some(Self::new(Part::Look, motors, now + FALLS)),
            _ => None,
        }
    }

    /// When the shafts can be checked if this shutdown is broken off now. What holds a shaft then has begun to.
    pub(super) fn shows_at(&self, now: Instant) -> Instant {
        match self.part {
            Part::Lock => now + BRAKE_MOVES,
            _ => self.not_before.max(now + FALLS),
        }
    }

    /// Asks the next question if none is in flight.
    pub(super) fn go_on<const N: usize>(
        &mut self,
        setup: &Setup,
        master: &mut Master<N>,
        now: Instant,
    ) -> Step {
        if self.asked.is_some() || now < self.not_before {
            return Step::Waiting;
        }
        let Some(motor) = self.left.iter().next() else { return Step::Over };
        let Some(question) = self.part.questions().get(self.next) else { return Step::Over };
        match question.ask(motor, setup, master) {
            Ok(ticket) => {
                self.asked = Some(ticket);
                Step::Waiting
            }
            Err(RequestError::Busy) => Step::Waiting,
            Err(_) => Step::Refused(motor),
        }
    }

    /// Asks a motor nothing more.
    pub(super) fn leave_out(&mut self, motor: MotorId) {
        self.left.remove(motor);
        self.next = 0;
    }

    /// Returns the answer if the event brings it. If anything is wrong with a motor, it is asked nothing more.
    pub(super) fn take(&mut self, event: &Event) -> Option<(MotorId, Answer)> {
        let asked = self.asked?;
        let answer = self.part.questions().get(self.next)?.answer(asked, event)?;
        self.asked = None;
        self.next += 1;
        let is_amiss = matches!(answer, Answer::None | Answer::Errors(_) | Answer::Turns);
        if is_amiss || self.next == self.part.questions().len() {
            self.leave_out(asked.motor());
        }
        Some((asked.motor(), answer))
    }
}

//! A motor's stream of set-points: the newest waits, the one before it may be in flight.

use crate::command;
use crate::data::Data;
use crate::error::RequestError;
use crate::id::MotorId;
use crate::master::Master;
use crate::master::late::Question;
use crate::master::request::Asked;
use crate::opcode::Usage;
use crate::time::Instant;

/// One set-point.
#[derive(Clone, Copy, Debug)]
pub(super) struct SetPoint {
    pub(super) question: Question,
    pub(super) data: Data,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stream {
    /// Waits to be sent.
    waiting: Option<SetPoint>,
    /// Sent, and waits for its feedback.
    in_flight: Option<SetPoint>,
    /// When the waiting set-point is too old; without one, when the one in flight would be.
    expiry: Instant,
}

impl Stream {
    /// The set-point that is to be sent.
    pub(super) fn waiting(&self) -> Option<&SetPoint> {
        self.waiting.as_ref()
    }

    /// The set-point that waits for its feedback.
    pub(super) fn in_flight(&self) -> Option<&SetPoint> {
        self.in_flight.as_ref()
    }

    pub(super) fn is_none(&self) -> bool {
        self.waiting.is_none() && self.in_flight.is_none()
    }

    pub(super) fn expiry(&self) -> Option<Instant> {
        self.waiting.map(|_| self.expiry)
    }

    /// Returns the one that it replaces.
    pub(super) fn put(&mut self, set_point: SetPoint, expiry: Instant) -> Option<SetPoint> {
        self.expiry = expiry;
        self.waiting.replace(set_point)
    }

    /// The waiting set-point is not to be sent any more.
    pub(super) fn drop_waiting(&mut self) -> Option<SetPoint> {
        self.waiting.take()
    }

    /// The waiting set-point was sent.
    pub(super) fn was_sent(&mut self) {
        self.in_flight = self.waiting.take();
    }

    /// The wait for its feedback is over.
    pub(super) fn take_in_flight(&mut self) -> Option<SetPoint> {
        self.in_flight.take()
    }

    /// The one in flight was not sent after all: it waits again, unless a newer one does. Returns whether it waits.
    pub(super) fn was_pushed_out(&mut self) -> bool {
        let pushed_out = self.in_flight.take();
        let is_newest = self.waiting.is_none();
        if is_newest {
            self.waiting = pushed_out;
        }
        is_newest
    }

    /// Whether feedback of this stream may come that looks like a reply to this question.
    pub(super) fn is_of(&self, question: Question) -> bool {
        let mut all = self.waiting.iter().chain(&self.in_flight);
        all.any(|set_point| set_point.question == question)
    }
}

impl<const N: usize> Master<N> {
    /// Puts a set-point in a motor's stream. A set-point that still waits is replaced and counted, never queued. One
    /// that waits for longer than [`Config::set_point_max_age`](crate::master::Config::set_point_max_age) is dropped.
    ///
    /// Each set-point without an answer is reported as an event
    /// ([`SetPointUnanswered`](crate::master::Event::SetPointUnanswered)). It is never an error, even if the motor was
    /// never heard, for example because of a wrong id: see when its [feedback](Self::latest_feedback) came last.
    ///
    /// # Errors
    /// [`RequestError`]: the command is no set-point, or does not go over this bus; the motors were stopped; the motor has
    /// [restarted](crate::master::Event::Restarted); a request of the same kind is under way; or there is no place for one
    /// more motor.
    pub fn set_point<C: command::SetPoint>(
        &mut self,
        motor: MotorId,
        command: C,
        now: Instant,
    ) -> Result<(), RequestError> {
        let data = command.encode();
        let kind = command.kind().of_bytes(&data);
        self.check(kind, motor.into())?;
        if let Some(opcode) = kind.opcode().filter(|it| it.usage() != Usage::SetPoint) {
            return Err(RequestError::NotASetPoint(opcode));
        }
        let set_point = SetPoint { question: Question::of(kind, &data), data };
        let expiry = now + self.config.set_point_max_age;
        // What was offered is older than this set-point.
        self.offer = None;
        self.due = self.due.min(expiry);
        let pace = self.pace;
        let place = self.place_for(motor)?;
        self.change_at(place, |motor, config| {
            if motor.note_restart_if_silent(config, now) {
                return Err(RequestError::Restarted);
            }
            let is_same = |asked: &Asked| asked.question == set_point.question;
            if motor.request.under_way().is_some_and(is_same) {
                return Err(RequestError::Busy);
            }
            motor.join(pace);
            motor.put_set_point(set_point, expiry);
            Ok(())
        })
        .unwrap_or(Err(RequestError::TooManyMotors { capacity: N }))
    }

    /// The caller no longer waits for the feedback of a motor's newest set-point: it is not sent if it waits, nor again
    /// if it is handed back.
    pub(crate) fn withdraw_set_point(&mut self, motor: MotorId) {
        self.change(motor, |motor, _| motor.end_stream());
    }

    /// Whether a motor's newest set-point was dropped before it was sent.
    pub(crate) fn is_newest_set_point_dropped(&self, motor: MotorId) -> bool {
        self.motor(motor).is_some_and(|motor| motor.is_newest_dropped)
    }

    /// Whether a motor's newest set-point still waits to be sent or answered.
    pub(crate) fn has_set_point_under_way(&self, motor: MotorId) -> bool {
        self.motor(motor).is_some_and(|motor| !motor.stream.is_none())
    }
}

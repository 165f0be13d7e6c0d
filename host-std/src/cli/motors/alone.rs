//! Whether two motors share an id, as factory motors do: both answer then, one behind the other.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    Command, ReadMultiTurnAngle, ReadRunTime, ReadStatus1, ReadStatus2, ReadStatus3,
};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Event, Failure};
use myactuator_protocol_core::time::Duration;

use super::session::Session;
use crate::cli::{Outcome, Unfinished};

/// How long a second answer may take behind the first: an adapter may hold it back for 16 ms.
const SECOND_ANSWER: Duration = Duration::from_millis(25);
/// How often all is asked. On CAN two answers that are the same, bit by bit and in time, look like one.
const ROUNDS: usize = 3;

impl Session {
    /// Refuses an id that more than one motor has, as far as that can be heard.
    pub(super) fn has_one(&mut self, motor: MotorId) -> Outcome {
        for _ in 0..ROUNDS {
            self.answers_once(motor, ReadStatus2)?;
            self.answers_once(motor, ReadRunTime)?;
            self.answers_once(motor, ReadStatus3)?;
            self.answers_once(motor, ReadMultiTurnAngle)?;
            self.answers_once(motor, ReadStatus1)?;
        }
        Ok(())
    }

    fn answers_once<C: Command>(&mut self, motor: MotorId, command: C) -> Outcome {
        let mut more = false;
        let is_second =
            |event: &Event| matches!(event, Event::Stray { motor: from, .. } if *from == motor);
        let answer = self.master.ask_with(motor, command, None, |event| more |= is_second(&event));
        match answer {
            Ok(_) => {}
            Err(CallError::Failed(Failure::NoReply | Failure::Unreadable(_))) => more = true,
            Err(error) => return Err(Unfinished::of_motor(motor)(error)),
        }
        self.listen(SECOND_ANSWER, |event| more |= is_second(event))?;
        if more {
            return Err(Unfinished::Failed(format!(
                "motor {motor} answers some questions twice or not at all: two motors seem to have this id, \
                 so nothing was written: connect only one of them"
            )));
        }
        Ok(())
    }

    /// Hears what comes for so long.
    pub(super) fn listen(&mut self, time: Duration, mut hear: impl FnMut(&Event)) -> Outcome {
        let end = self.master.now() + time;
        while self.master.now() < end {
            match self.master.poll()? {
                Some(event) => hear(&event),
                None => self.master.idle(end),
            }
        }
        Ok(())
    }
}

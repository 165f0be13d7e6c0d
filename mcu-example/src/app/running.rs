//! The motors run.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::time::{Duration, Instant};

use super::motor::Motor;
use super::state::State;
use super::{App, Moment};
use crate::board::{Board, Usage};
use crate::report::{Report, Trouble};

/// A running motor that was not heard for this long is gone.
const SILENT_AFTER: Duration = Duration::from_millis(100);
/// While a line waits for the answer of a motor that is gone, no other motor is asked. If no motor at all was heard for
/// this much longer than that wait, the bus is down.
const ROUND: Duration = Duration::from_millis(10);
/// The watchdog is fed only while each running motor was heard within this time.
pub(super) const SEEN_WITHIN: Duration = Duration::from_millis(50);
pub(super) const SECOND: Duration = Duration::from_secs(1);

/// The motor that was not heard for the longest time, and how long that is.
pub(super) type Silence = (Option<MotorId>, Duration);

impl<const N: usize> App<N> {
    /// One cycle of motion.
    pub(super) fn control(&mut self, longest: Silence, at: &mut Moment<'_, N, impl Board>) {
        if let (Some(motor), silence) = longest
            && silence > SILENT_AFTER
        {
            return self.trouble(self.silent(motor, at), at);
        }
        let State::Running { since, next_second, .. } = &self.state else { return };
        let (since, is_second) = (*since, at.now >= *next_second);
        for motor in &self.motors {
            if !motor.put_set_point(&self.setup, at.now - since, at.master, at.now) {
                let motor = motor.id;
                // The event that reports it may not have come yet.
                let trouble = match at.master.has_restarted(motor) {
                    true => Trouble::Restarted { motor },
                    false => Trouble::Refused { motor },
                };
                return self.trouble(trouble, at);
            }
        }
        if is_second {
            self.report_second(at);
        }
    }

    fn report_second(&mut self, at: &mut Moment<'_, N, impl Board>) {
        let State::Running { cycles, overruns, next_second, .. } = &mut self.state else { return };
        *next_second += SECOND;
        let (cycles, overruns) = (*cycles, *overruns);
        let lost = self.motors.iter().map(|motor| motor.lost(at.master.health(motor.id))).sum();
        let slowest = self.motors.iter_mut().map(Motor::take_answered).min().unwrap_or(0);
        let Usage { stack, queued, dropped } = at.board.usage();
        let second = Report::Second { cycles, overruns, slowest, lost, stack, queued, dropped };
        at.board.log(&second);
        for motor in &self.motors {
            at.board.log(&Report::Measured { motor: motor.id, angle: motor.angle });
        }
    }

    pub(super) fn is_running(&self) -> bool {
        matches!(self.state, State::Running { .. })
    }

    pub(super) fn longest_silence(&self, now: Instant) -> Silence {
        let silences = self.motors.iter().map(|motor| (Some(motor.id), motor.silence(now)));
        silences.max_by_key(|&(_, silence)| silence).unwrap_or((None, Duration::ZERO))
    }

    /// What to report if this motor is not heard. With a single motor nothing shows whether the motor or the bus is
    /// gone. Then the motor is reported, since that is where to look first.
    pub(super) fn silent(&self, motor: MotorId, at: &Moment<'_, N, impl Board>) -> Trouble {
        let longest_wait = at.master.config().reply_timeout + ROUND;
        let is_bus = self.is_running()
            && self.motors.len() > 1
            && self.motors.iter().all(|motor| motor.silence(at.now) > longest_wait);
        if is_bus { Trouble::BusDown } else { Trouble::Silent { motor } }
    }
}

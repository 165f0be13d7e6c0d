//! Errors: how they come and how they go (manual 2.14.3, 8), as [`decisions`](super::decisions) says.

use crate::command::{ErrorFlags, ErrorLevel};
use crate::drive::parameters::{FaultLimits, Parameters};
use crate::drive::plant::Measurement;
use crate::time::Duration;

/// What the indicator light shows (manual 8.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Indicator {
    /// The drive has no supply.
    Dark,
    /// Steadily on: the motor runs normally.
    On,
    /// Slow blinking: an error that ends on its own.
    SlowBlink,
    /// Fast blinking: an error that needs a restart.
    FastBlink,
}

/// How an error ends, also for errors that the manual gives no level.
pub(super) fn level(error: ErrorFlags) -> ErrorLevel {
    match error.level() {
        Some(level) => level,
        None if error == ErrorFlags::COMPONENT_OVER_TEMPERATURE => ErrorLevel::Two,
        None => ErrorLevel::One,
    }
}

/// Whether any of these errors stands until a restart.
pub(super) fn needs_restart(errors: ErrorFlags) -> bool {
    errors.each().any(|error| level(error) == ErrorLevel::One)
}

fn of_level(errors: ErrorFlags, wanted: ErrorLevel) -> ErrorFlags {
    errors.each().filter(|&error| level(error) == wanted).collect()
}

/// A measurement against its limit.
#[derive(Clone, Copy)]
struct Check {
    error: ErrorFlags,
    beyond: bool,
    back: bool,
    confirm: Duration,
}

const CHECKS: usize = 9;

fn checks(m: &Measurement, parameters: &Parameters) -> [Check; CHECKS] {
    let limits: &FaultLimits = &parameters.limits;
    let speed = m.speed_dps.abs();
    let [a, b, c] = m.phase_currents_a.map(f32::abs);
    let phase = a.max(b).max(c).max(m.current_a.abs());
    let check = |error, beyond, back| Check { error, beyond, back, confirm: limits.confirm_time };
    // Beyond a limit, and back again only by a margin.
    let above = |error, x, limit, margin| check(error, x > limit, x < limit - margin);
    let keep = 1.0 - limits.relative_margin;
    let above_by_part = |error, x, limit| check(error, x > limit, x < limit * keep);
    let volts = m.supply_voltage_v;
    let hot_by = limits.temperature_margin_c;
    // The current approaches its cap from below and never quite reaches it: 5 % below counts.
    let stalls =
        m.current_a.abs() >= 0.95 * parameters.stall_current_a && speed < limits.stall_speed_dps;
    [
        above(ErrorFlags::UNDER_VOLTAGE, -volts, -limits.under_voltage_v, limits.voltage_margin_v),
        above(ErrorFlags::OVER_VOLTAGE, volts, limits.over_voltage_v, limits.voltage_margin_v),
        check(ErrorFlags::OVER_CURRENT, phase > limits.over_current_a, false),
        above_by_part(ErrorFlags::OVER_POWER, m.supply_current_a, limits.supply_current_a),
        above_by_part(ErrorFlags::OVER_SPEED, speed, limits.over_speed_dps),
        above(
            ErrorFlags::COMPONENT_OVER_TEMPERATURE,
            m.mos_temperature_c,
            limits.mos_temperature_c,
            hot_by,
        ),
        above(
            ErrorFlags::MOTOR_OVER_TEMPERATURE,
            m.motor_temperature_c,
            limits.motor_temperature_c,
            hot_by,
        ),
        check(ErrorFlags::ENCODER_DATA, !m.encoder_ok, false),
        Check { error: ErrorFlags::STALL, beyond: stalls, back: false, confirm: limits.stall_time },
    ]
}

#[derive(Clone, Debug, Default)]
pub(super) struct Faults {
    /// Errors of level one, until a restart.
    latched: ErrorFlags,
    /// Errors of level two that measurements cause.
    measured: ErrorFlags,
    /// Errors of level two raised by hand.
    by_hand: ErrorFlags,
    /// How long each check has contradicted the present state.
    lasting: [Duration; CHECKS],
}

impl Faults {
    pub(super) fn all(&self) -> ErrorFlags {
        self.latched | self.measured | self.by_hand
    }

    /// Judges a measurement that stood for `span`.
    pub(super) fn observe(&mut self, m: &Measurement, parameters: &Parameters, span: Duration) {
        for (check, lasting) in checks(m, parameters).iter().zip(&mut self.lasting) {
            let recovers = level(check.error) == ErrorLevel::Two;
            let stands = if recovers { self.measured } else { self.latched }.contains(check.error);
            if stands != if stands { !check.back } else { check.beyond } {
                *lasting = *lasting + span;
                if *lasting >= check.confirm {
                    *lasting = Duration::ZERO;
                    let errors = if recovers { &mut self.measured } else { &mut self.latched };
                    errors.set(check.error, !stands);
                }
            } else {
                *lasting = Duration::ZERO;
            }
        }
    }

    /// Raises errors by hand: those of level two until [`take_away`](Self::take_away), the others
    /// until a restart.
    pub(super) fn raise(&mut self, errors: ErrorFlags) {
        self.latched |= of_level(errors, ErrorLevel::One);
        self.by_hand |= of_level(errors, ErrorLevel::Two);
    }

    /// Ends the cause of errors raised by hand. Those of level one stay.
    pub(super) fn take_away(&mut self, errors: ErrorFlags) {
        self.by_hand &= !errors;
    }

    /// A restart ends level one. Causes that last raise their errors again.
    pub(super) fn restart(&mut self) {
        *self = Self { by_hand: self.by_hand, ..Self::default() };
    }

    pub(super) fn indicator(&self) -> Indicator {
        if !self.latched.is_empty() {
            Indicator::FastBlink
        } else if self.all().is_empty() {
            Indicator::On
        } else {
            Indicator::SlowBlink
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: Duration = Duration::from_millis(1);

    fn good() -> Measurement {
        Measurement { supply_voltage_v: 48.0, encoder_ok: true, ..Measurement::default() }
    }

    fn after(faults: &mut Faults, measurement: Measurement, millis: u32) -> ErrorFlags {
        for _ in 0..millis {
            faults.observe(&measurement, &Parameters::default(), STEP);
        }
        faults.all()
    }

    #[test]
    fn each_measurement_raises_its_own_error_and_level_two_recovers() {
        let bad = [
            (Measurement { supply_voltage_v: 11.9, ..good() }, ErrorFlags::UNDER_VOLTAGE),
            (Measurement { supply_voltage_v: 58.1, ..good() }, ErrorFlags::OVER_VOLTAGE),
            (
                Measurement { phase_currents_a: [0.0, -41.0, 0.0], ..good() },
                ErrorFlags::OVER_CURRENT,
            ),
            (Measurement { supply_current_a: 26.0, ..good() }, ErrorFlags::OVER_POWER),
            (Measurement { speed_dps: -2_501.0, ..good() }, ErrorFlags::OVER_SPEED),
            (
                Measurement { mos_temperature_c: 86.0, ..good() },
                ErrorFlags::COMPONENT_OVER_TEMPERATURE,
            ),
            (
                Measurement { motor_temperature_c: 91.0, ..good() },
                ErrorFlags::MOTOR_OVER_TEMPERATURE,
            ),
            (Measurement { encoder_ok: false, ..good() }, ErrorFlags::ENCODER_DATA),
        ];
        for (measurement, error) in bad {
            let mut faults = Faults::default();
            assert_eq!(after(&mut faults, measurement, 9), ErrorFlags::empty(), "{error:?}");
            assert_eq!(after(&mut faults, measurement, 1), error);
            let gone = after(&mut faults, good(), 20).is_empty();
            assert_eq!(gone, level(error) == ErrorLevel::Two, "{error:?}");
            faults.restart();
            assert_eq!(faults.all(), ErrorFlags::empty());
        }
    }

    #[test]
    fn a_short_dip_is_no_error_and_an_error_needs_its_margin_to_go() {
        let mut faults = Faults::default();
        let low = Measurement { supply_voltage_v: 11.0, ..good() };
        for _ in 0..10 {
            after(&mut faults, low, 9);
            assert_eq!(after(&mut faults, good(), 1), ErrorFlags::empty());
        }
        assert_eq!(after(&mut faults, low, 10), ErrorFlags::UNDER_VOLTAGE);
        let within_margin = Measurement { supply_voltage_v: 12.5, ..good() };
        assert_eq!(after(&mut faults, within_margin, 1_000), ErrorFlags::UNDER_VOLTAGE);
        let above = Measurement { supply_voltage_v: 13.5, ..good() };
        assert_eq!(after(&mut faults, above, 10), ErrorFlags::empty());
    }

    #[test]
    fn a_stall_takes_current_standstill_and_time() {
        let stalled = Measurement { current_a: -12.0, ..good() };
        let mut faults = Faults::default();
        assert_eq!(after(&mut faults, stalled, 999), ErrorFlags::empty());
        assert_eq!(after(&mut faults, stalled, 1), ErrorFlags::STALL);
        assert_eq!(after(&mut faults, good(), 5_000), ErrorFlags::STALL);
        let turning = Measurement { speed_dps: 10.0, ..stalled };
        assert_eq!(after(&mut Faults::default(), turning, 5_000), ErrorFlags::empty());
    }

    #[test]
    fn by_hand_level_two_goes_when_taken_away_and_level_one_with_a_restart() {
        let mut faults = Faults::default();
        faults.raise(ErrorFlags::STALL | ErrorFlags::ENCODER_CALIBRATION);
        assert_eq!(faults.indicator(), Indicator::FastBlink);
        faults.restart();
        assert_eq!(faults.all(), ErrorFlags::ENCODER_CALIBRATION);
        assert_eq!(faults.indicator(), Indicator::SlowBlink);
        faults.raise(ErrorFlags::STALL);
        faults.take_away(ErrorFlags::all());
        assert_eq!(faults.all(), ErrorFlags::STALL);
    }
}

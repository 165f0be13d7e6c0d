//! The three cascaded loops of [`decisions`](crate::drive::decisions): position to speed, speed to
//! current, current to output.
//!
//! Every output is limited. No integral grows while its output is limited, and what is not a number becomes 0.

use crate::drive::settings::Gains;

/// The share of a missing current that a current KP of 1 makes up in a second: all of it within 0.1 ms.
const CURRENT_RATE_PER_S: f32 = 10_000.0;

/// The loops' memory: their integrals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Loops {
    position_dps: f32,
    speed_a: f32,
}

/// What a loop puts out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Output {
    /// Within its limit.
    pub(crate) value: f32,
    /// What the limit took away.
    pub(crate) beyond: f32,
}

impl Loops {
    /// Starts the loops again, with `current_a` already flowing in the speed loop.
    pub(crate) fn restart(&mut self, current_a: f32) {
        *self = Self { speed_a: current_a, ..Self::default() };
    }

    /// The speed loop's integral: the current that the load takes, A.
    pub(crate) const fn load_a(&self) -> f32 {
        self.speed_a
    }

    /// The speed wanted, degrees per second.
    pub(crate) fn position(
        &mut self,
        gains: &Gains,
        error_deg: f32,
        feed_dps: f32,
        speed_dps: f32,
        max_dps: f32,
        dt: f32,
    ) -> f32 {
        let ahead = feed_dps + gains.position_kd.value() * (feed_dps - speed_dps);
        let (kp, ki) = (gains.position_kp.value(), gains.position_ki.value());
        limited_pi(&mut self.position_dps, kp * error_deg, ki * error_deg * dt, ahead, max_dps)
            .value
    }

    /// The current wanted while the shaft stands where it should, A. The integral does not grow: otherwise it would
    /// break the shaft away and bring it to the other side, for ever.
    pub(crate) fn speed_at_rest(&mut self, gains: &Gains, error_dps: f32, limit_a: f32) -> Output {
        self.speed(gains, error_dps, limit_a, 0.0)
    }

    /// The current wanted, A.
    pub(crate) fn speed(&mut self, gains: &Gains, error_dps: f32, limit_a: f32, dt: f32) -> Output {
        let (kp, ki) = (gains.speed_kp.value(), gains.speed_ki.value());
        limited_pi(&mut self.speed_a, kp * error_dps, ki * error_dps * dt, 0.0, limit_a)
    }
}

/// The output current, A. A winding keeps its current. So the gains set how fast the current comes and never how much
/// of it, and nothing can overshoot.
pub(crate) fn current(gains: &Gains, wanted_a: f32, measured_a: f32, limit_a: f32, dt: f32) -> f32 {
    let rate = gains.current_kp.value() * CURRENT_RATE_PER_S + gains.current_ki.value();
    let share = number(rate * dt).clamp(0.0, 1.0);
    if share == 1.0 {
        return limited(wanted_a, limit_a);
    }
    let measured_a = number(measured_a);
    limited(measured_a + share * (number(wanted_a) - measured_a), limit_a)
}

fn limited_pi(integral: &mut f32, proportional: f32, grows: f32, ahead: f32, limit: f32) -> Output {
    let next = limited(*integral + grows, limit);
    let output = number(ahead) + number(proportional) + next;
    // Beyond the limit the integral may only shrink the output.
    if output.abs() <= limit || output * grows < 0.0 {
        *integral = next;
    }
    let output = number(ahead) + number(proportional) + *integral;
    let value = limited(output, limit);
    Output { value, beyond: output - value }
}

fn number(x: f32) -> f32 {
    if x.is_nan() { 0.0 } else { x.clamp(-1e30, 1e30) }
}

/// `x` within ±`limit`; 0 if either is not a number or the limit is negative.
pub(crate) fn limited(x: f32, limit: f32) -> f32 {
    let limit = limit.max(0.0);
    number(x).max(-limit).min(limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::PidIndex;
    use crate::units::Gain;

    const DT: f32 = 0.001;

    fn gains(index: PidIndex, value: f32) -> Gains {
        let mut gains = Gains::tuned(0.0, 0.0, 0.0);
        for &index in PidIndex::ALL {
            gains.set(index, Gain::new(0.0).unwrap());
        }
        gains.set(index, Gain::new(value).unwrap());
        gains
    }

    #[test]
    fn each_gain_acts_on_its_own_term() {
        let mut l = Loops::default();
        assert_eq!(l.position(&gains(PidIndex::POSITION_KP, 10.0), 2.0, 3.0, 1.0, 1e6, DT), 23.0);
        assert_eq!(l.position(&gains(PidIndex::POSITION_KD, 0.5), 2.0, 3.0, 1.0, 1e6, DT), 4.0);
        assert_eq!(l.speed(&gains(PidIndex::SPEED_KP, 0.1), 20.0, 1e6, DT).value, 2.0);
        let mut sum = 0.0;
        for _ in 0..1_000 {
            sum = l.speed(&gains(PidIndex::SPEED_KI, 2.0), 3.0, 1e6, DT).value;
        }
        assert!((sum - 6.0).abs() < 1e-3);
        for _ in 0..1_000 {
            sum = l.position(&gains(PidIndex::POSITION_KI, 2.0), 3.0, 0.0, 0.0, 1e6, DT);
        }
        assert!((sum - 6.0).abs() < 1e-3);
    }

    #[test]
    fn a_current_comes_at_the_rate_of_its_gains() {
        for (kp, ki, after_1_ms) in [(1.0, 0.0, 5.0), (0.0, 100.0, 0.5), (0.05, 0.0, 2.5)] {
            let mut gains = gains(PidIndex::CURRENT_KP, kp);
            gains.set(PidIndex::CURRENT_KI, Gain::new(ki).unwrap());
            assert!((current(&gains, 5.0, 0.0, 1e6, DT) - after_1_ms).abs() < 1e-6, "{kp} {ki}");
            assert_eq!(current(&gains, 5.0, 5.0, 1e6, DT), 5.0);
        }
        for wild in [-1.0, 0.0, 1.5, 1e38, f32::MIN, f32::MAX] {
            let gains = gains(PidIndex::CURRENT_KP, wild);
            for measured in [0.0, 3.0, f32::NAN, f32::INFINITY] {
                assert!(current(&gains, 5.0, measured, 6.0, DT).abs() <= 6.0, "{wild} {measured}");
            }
        }
    }

    #[test]
    fn no_gain_makes_it_exceed_the_limit_or_fail() {
        let values = [0.0, -1.0, 1e38, -1e38, f32::MAX, f32::MIN];
        for kp in values {
            for ki in values {
                let mut gains = gains(PidIndex::SPEED_KP, kp);
                gains.set(PidIndex::SPEED_KI, Gain::new(ki).unwrap());
                let mut l = Loops::default();
                for error in [0.0, 1e30, -1e30, f32::MAX, f32::NAN, f32::INFINITY, 3.0, 0.0] {
                    let output = l.speed(&gains, error, 5.0, DT).value;
                    assert!(output.abs() <= 5.0, "{kp} {ki} {error}");
                }
                assert!(l.speed_a.is_finite());
            }
        }
        assert_eq!(limited(3.0, f32::NAN), 0.0);
        assert_eq!(limited(3.0, -1.0), 0.0);
    }
}

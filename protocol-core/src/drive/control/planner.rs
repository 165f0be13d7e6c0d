//! Set-points on the way to a target: the trapezoid profile of position commands and the ramp of
//! speed commands (manual 2.4.4, 2.20.2, 2.21.1), as [`decisions`](crate::drive::decisions) says.

/// A moving set-point of the position loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Profile {
    pub(crate) position_deg: f64,
    pub(crate) speed_dps: f32,
}

/// How a profile may move. All positive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    pub(crate) max_speed_dps: f32,
    pub(crate) acceleration_dps2: f32,
    pub(crate) deceleration_dps2: f32,
}

impl Profile {
    /// Moves on for `dt` seconds towards `target_deg`, and comes to rest exactly there.
    ///
    /// Distances are compared as v² against 2·d·s, so no root is needed. Braking uses the deceleration that just
    /// reaches the target, v²/2s, which stays the same until the target is reached. A target that is too close to stop
    /// at is passed, and then returned to.
    pub(crate) fn advance(&mut self, target_deg: f64, pace: &Pace, dt: f32) {
        let away = target_deg - self.position_deg;
        if away == 0.0 && self.speed_dps == 0.0 {
            return;
        }
        let sign = if away < 0.0 { -1.0_f32 } else { 1.0 };
        let distance = away.abs() as f32;
        let speed = self.speed_dps * sign;
        let braking = pace.deceleration_dps2;
        // Whether a step that ends at this speed leaves room to stop.
        let stops = |end: f32| {
            let left = distance - (speed + end) / 2.0 * dt;
            left >= 0.0 && end * end <= 2.0 * braking * left
        };
        let next = if speed < 0.0 {
            (speed + braking * dt).min(0.0)
        } else if speed > pace.max_speed_dps {
            (speed - braking * dt).max(pace.max_speed_dps)
        } else if stops(speed) {
            // Faster by as much as leaves room to stop, found by halving down to a thousandth.
            let mut gain = pace.acceleration_dps2 * dt;
            let mut next = None;
            for _ in 0..=10 {
                let faster = (speed + gain).min(pace.max_speed_dps);
                if stops(faster) {
                    next = Some(faster);
                    break;
                }
                gain /= 2.0;
            }
            match next {
                Some(faster) => faster,
                // At rest, and closer than one step can go: arrived.
                None if speed == 0.0 => return self.arrive(target_deg),
                None => speed,
            }
        } else {
            let needed = (speed * speed / (2.0 * distance)).min(braking);
            let slower = (speed - needed * dt).max(0.0);
            if slower == 0.0 && distance <= speed * dt {
                return self.arrive(target_deg);
            }
            slower
        };
        self.position_deg += f64::from((speed + next) / 2.0 * dt * sign);
        self.speed_dps = next * sign;
    }

    fn arrive(&mut self, target_deg: f64) {
        *self = Self { position_deg: target_deg, speed_dps: 0.0 };
    }
}

/// The next speed on the way from `speed_dps` to `target_dps`. Uses the deceleration if the motor slows down and keeps
/// its direction; otherwise the acceleration, which a reversal uses from end to end. 0 for either means at once.
pub(crate) fn ramp(
    speed_dps: f32,
    target_dps: f32,
    acceleration_dps2: f32,
    deceleration_dps2: f32,
    dt: f32,
) -> f32 {
    let reverses = (speed_dps < 0.0 && target_dps > 0.0) || (speed_dps > 0.0 && target_dps < 0.0);
    let slows_down = !reverses && target_dps.abs() < speed_dps.abs();
    let rate_dps2 = if slows_down { deceleration_dps2 } else { acceleration_dps2 };
    if rate_dps2 <= 0.0 {
        target_dps
    } else if target_dps > speed_dps {
        (speed_dps + rate_dps2 * dt).min(target_dps)
    } else {
        (speed_dps - rate_dps2 * dt).max(target_dps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const DT: f32 = 0.001;
    const PACE: Pace =
        Pace { max_speed_dps: 500.0, acceleration_dps2: 10_000.0, deceleration_dps2: 5_000.0 };

    fn run(profile: Profile, target: f64, pace: Pace, steps: usize) -> Vec<Profile> {
        run_by(profile, target, pace, DT, steps)
    }

    fn run_by(
        mut profile: Profile,
        target: f64,
        pace: Pace,
        dt: f32,
        steps: usize,
    ) -> Vec<Profile> {
        (0..steps)
            .map(|_| {
                profile.advance(target, &pace, dt);
                profile
            })
            .collect()
    }

    const REST: Profile = Profile { position_deg: 0.0, speed_dps: 0.0 };

    #[test]
    fn a_short_way_is_a_triangle_either_way_round() {
        for target in [1.0, -1.0] {
            let run = run(REST, target, PACE, 200);
            assert_eq!(run.last().unwrap().position_deg, target);
            // v² = 2·s·a·d/(a+d) = 2 * 1 * 10000 * 5000 / 15000: 81.6 dps.
            let fastest = run.iter().map(|p| p.speed_dps.abs()).fold(0.0, f32::max);
            assert!((70.0..82.0).contains(&fastest), "{fastest}");
        }
    }

    #[test]
    fn a_target_too_close_is_passed_and_come_back_to() {
        let fast = Profile { position_deg: 0.0, speed_dps: 500.0 };
        let run = run(fast, 5.0, PACE, 1_000);
        assert!(run.iter().any(|p| p.position_deg > 25.0 - 5.1));
        assert_eq!(run.last().unwrap(), &Profile { position_deg: 5.0, speed_dps: 0.0 });
    }

    #[test]
    fn every_way_ends_at_its_target() {
        for (way, speed) in
            [(0.0_f64, 0.0), (0.004, 0.0), (0.3, 499.0), (-7.7, 250.0), (1e4, -500.0)]
        {
            for pace in [
                PACE,
                Pace { max_speed_dps: 1.0, ..PACE },
                Pace { acceleration_dps2: 60_000.0, deceleration_dps2: 100.0, ..PACE },
            ] {
                let start = Profile { position_deg: 12.0, speed_dps: speed };
                let there = Profile { position_deg: 12.0 + way, speed_dps: 0.0 };
                let seconds = 40.0 + way.abs() / f64::from(pace.max_speed_dps);
                // The longest way takes too many steps of the drive's own length.
                let steps: &[f32] = if seconds < 1_000.0 { &[DT, DT / 10.0] } else { &[DT] };
                for &dt in steps {
                    let count = (seconds / f64::from(dt)) as usize;
                    let end = *run_by(start, 12.0 + way, pace, dt, count).last().unwrap();
                    assert_eq!(end, there, "{pace:?}, step {dt}");
                }
            }
        }
    }

    #[test]
    fn a_speed_reverses_at_the_acceleration_and_comes_to_rest_at_the_deceleration() {
        let steps = |from: f32, to: f32| {
            let mut speed = from;
            (1..100).find(|_| {
                speed = ramp(speed, to, 1_000.0, 500.0, DT);
                speed == to
            })
        };
        for sign in [1.0, -1.0] {
            assert_eq!(steps(10.0 * sign, -10.0 * sign), Some(20));
            assert_eq!(steps(0.0, 10.0 * sign), Some(10));
            assert_eq!(steps(10.0 * sign, 0.0), Some(20));
        }
        assert_eq!(ramp(0.0, -300.0, 0.0, 0.0, DT), -300.0);
        assert_eq!(ramp(300.0, -300.0, 0.0, 500.0, DT), -300.0);
        assert_eq!(ramp(200.0, 100.0, 1_000.0, 0.0, DT), 100.0);
    }
}

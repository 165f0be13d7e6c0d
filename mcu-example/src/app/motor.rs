//! What is known of one motor.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    AbsolutePosition, AnyReply, MotionRanges, MotionSetPoint, VersionDate,
};
use myactuator_protocol_core::master::{Health, Master};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::Angle;

use super::path::place;
use super::{Movement, Setup};

/// A motor that was found.
#[derive(Debug)]
pub(super) struct Motor {
    pub(super) id: MotorId,
    pub(super) version_date: VersionDate,
    /// Where it was when it got ready. It moves to one side of that and back.
    pub(super) home: Angle,
    /// Where it was last seen.
    pub(super) angle: Angle,
    /// When its last set-point was answered.
    heard: Instant,
    /// Set-points that were answered since the last count.
    answered: u16,
    /// Commands that were lost before it began to move.
    lost_before: u16,
}

impl Motor {
    pub(super) const fn new(id: MotorId, version_date: VersionDate) -> Self {
        let zero = Angle::from_raw(0);
        Self {
            id,
            version_date,
            home: zero,
            angle: zero,
            heard: Instant::ZERO,
            answered: 0,
            lost_before: 0,
        }
    }

    /// The motion begins now. What was lost before does not count: a stop takes the place of a request in flight.
    pub(super) fn begin(&mut self, health: Health, now: Instant) {
        self.lost_before = health.lost;
        self.heard = now;
        self.answered = 0;
    }

    /// A set-point was answered.
    pub(super) fn feedback(
        &mut self,
        reply: &AnyReply,
        ranges: Option<MotionRanges>,
        now: Instant,
    ) {
        self.heard = now;
        self.answered = self.answered.saturating_add(1);
        if let (AnyReply::Motion(raw), Some(ranges)) = (reply, ranges) {
            let position_rad = ranges.feedback(raw).position_rad;
            if let Ok(angle) = Angle::from_degrees(position_rad.to_degrees()) {
                self.angle = angle;
            }
        }
    }

    /// How long ago its last set-point was answered.
    pub(super) fn silence(&self, now: Instant) -> Duration {
        now - self.heard
    }

    /// Returns how many set-points were answered since the last call.
    pub(super) fn take_answered(&mut self) -> u16 {
        core::mem::take(&mut self.answered)
    }

    /// Commands that got no reply in time since it began to move.
    pub(super) fn lost(&self, health: Health) -> u32 {
        health.lost.saturating_sub(self.lost_before).into()
    }

    /// Sets where it begins. Returns whether its commands can express the whole movement from there.
    pub(super) fn can_begin_at(&mut self, home: Angle, setup: &Setup) -> bool {
        self.home = home;
        [0.0, 1.0].into_iter().all(|part| match setup.movement {
            Movement::Motion { ranges, kp, kd } => {
                ranges.quantise(&self.motion(setup, part, 0.0, kp, kd)).is_ok()
            }
            Movement::Position { .. } => self.target(setup, part).is_some(),
        })
    }

    /// Puts the set-point for `since` in its stream. `false` if it is not taken.
    pub(super) fn put_set_point<const N: usize>(
        &self,
        setup: &Setup,
        since: Duration,
        master: &mut Master<N>,
        now: Instant,
    ) -> bool {
        let place = place(since, setup.period);
        match setup.movement {
            Movement::Motion { ranges, kp, kd } => {
                let wanted = self.motion(setup, place.part, place.per_second, kp, kd);
                let raw = ranges.quantise(&wanted);
                raw.is_ok_and(|raw| master.set_point(self.id, raw, now).is_ok())
            }
            Movement::Position { max_speed } => self
                .target(setup, place.part)
                .map(|angle| AbsolutePosition { max_speed, angle })
                .is_some_and(|wanted| master.set_point(self.id, wanted, now).is_ok()),
        }
    }

    fn motion(
        &self,
        setup: &Setup,
        part: f32,
        per_second: f32,
        kp: f32,
        kd: f32,
    ) -> MotionSetPoint {
        let home_rad = self.home.degrees().to_radians();
        let amplitude_rad = setup.amplitude.degrees().to_radians();
        MotionSetPoint {
            position_rad: home_rad + amplitude_rad * part,
            velocity_rad_s: amplitude_rad * per_second,
            kp,
            kd,
            torque_nm: 0.0,
        }
    }

    fn target(&self, setup: &Setup, part: f32) -> Option<Angle> {
        let way = (setup.amplitude.raw() as f32 * part) as i32;
        self.home.raw().checked_add(way).map(Angle::from_raw)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_velocity_that_is_fed_forward_is_the_position_s() {
        let (ranges, kp, kd) = (MotionRanges::V4_3, 50.0, 2.0);
        let setup = Setup::new(Movement::Motion { ranges, kp, kd });
        let motor = Motor::new(MotorId::MIN, VersionDate::from_raw(0));
        for ms in [100, 900, 1_100, 1_900] {
            let [now, then] = [ms, ms + 1].map(|ms| {
                let place = place(Duration::from_millis(ms), setup.period);
                motor.motion(&setup, place.part, place.per_second, kp, kd)
            });
            let turned_rad_s = (then.position_rad - now.position_rad) * 1_000.0;
            let mean_rad_s = (now.velocity_rad_s + then.velocity_rad_s) / 2.0;
            assert!((turned_rad_s - mean_rad_s).abs() < 0.01, "{turned_rad_s} {mean_rad_s}");
        }
    }
}

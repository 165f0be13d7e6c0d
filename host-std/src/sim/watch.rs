//! Shows the true state of drives while a master runs them.

use std::sync::Arc;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::time::{Duration, Instant};

use super::bus::{Medium, lock};
use super::{BusFleet, SimulatedDrive};

impl<B: Medium> BusFleet<B> {
    /// From now on shows each drive to `look` once per period of the bus's time (at least a microsecond), with the id
    /// that the drive started with. So a test can check that no load ever falls, whatever runs meanwhile. This does not
    /// change the run. `look` must not use the bus, which is in the middle of something, nor a
    /// [handle](super::DriveHandle).
    ///
    /// ```
    /// use std::sync::mpsc::channel;
    ///
    /// use myactuator_host_std::protocol::MotorId;
    /// use myactuator_host_std::protocol::io::bring_up;
    /// use myactuator_host_std::protocol::time::Duration;
    /// use myactuator_host_std::sim::Fleet;
    /// use myactuator_host_std::sim::plant::Load;
    ///
    /// let hangs = Load { torque_nm: -3.0, ..Load::NONE };
    /// let fleet = Fleet::new(1).brakes(true).load(hangs).on_can(1_000_000)?;
    /// let (falls, fallen) = channel();
    /// fleet.watch(Duration::from_millis(1), move |at, motor, drive| {
    ///     if drive.plant().output_angle_deg() < -1.0 {
    ///         let _ = falls.send((at, motor));
    ///     }
    /// });
    ///
    /// let mut bus = fleet.master::<1>();
    /// bring_up::release_brake(&mut bus, MotorId::MIN).map_err(|error| error.to_string())?;
    /// bring_up::lock_brake(&mut bus, MotorId::MIN).map_err(|error| error.to_string())?;
    /// assert_eq!(fallen.try_iter().next(), None);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn watch(
        &self,
        period: Duration,
        mut look: impl FnMut(Instant, MotorId, &SimulatedDrive) + Send + 'static,
    ) {
        // No handles: these hold the world, which holds this.
        let drives: Vec<_> =
            self.drives.iter().map(|it| (it.motor(), Arc::clone(&it.seat))).collect();
        self.world.every(period, move |now| {
            for (motor, seat) in &drives {
                let mut seat = lock(seat);
                seat.catch_up(now);
                look(now, *motor, &seat.drive);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use myactuator_protocol_core::command::{ReleaseBrake, Shutdown, Torque};
    use myactuator_protocol_core::io::Runner;
    use myactuator_protocol_core::units::Current;

    use super::*;
    use crate::sim::Fleet;
    use crate::sim::plant::Load;

    #[test]
    fn each_drive_is_shown_once_a_period() {
        let fleet = Fleet::new(2).start_angle_deg(30.0).on_can(1_000_000).unwrap();
        let (saw, seen) = channel();
        fleet.world.run_for(Duration::from_millis(1));
        fleet.watch(Duration::from_millis(2), move |at, motor, drive| {
            let degrees = drive.plant().output_angle_deg().round();
            // Of itself a drive that nobody speaks to is up to 10 ms behind.
            let is_of_now = at - drive.clock() <= Duration::from_millis(1);
            saw.send((at.as_micros(), motor.get(), degrees, is_of_now)).unwrap();
        });
        fleet.world.run_for(Duration::from_millis(5));
        let seen: Vec<_> = seen.try_iter().collect();
        let at = |micros| [(micros, 1, 30.0, true), (micros, 2, 30.0, true)];
        assert_eq!(seen, [at(3_000), at(5_000)].concat());
    }

    /// The brake opens, and nothing holds the load for 100 ms.
    #[test]
    fn watched_load_falls_exactly_as_an_unwatched_one() {
        let run = |is_watched: bool| {
            let hangs = Load { torque_nm: -3.0, ..Load::NONE };
            let fleet = Fleet::new(1).brakes(true).load(hangs).on_can(1_000_000).unwrap();
            let (saw, seen) = channel();
            if is_watched {
                fleet.watch(Duration::from_millis(1), move |at, _, drive| {
                    let _ = saw.send((at, drive.plant().output_speed_dps()));
                });
            }
            let log = fleet.world.log();
            let mut bus = fleet.master::<1>();
            let push = Torque { current: Current::from_amperes(0.5).unwrap() };
            bus.ask(MotorId::MIN, Shutdown).unwrap();
            bus.ask(MotorId::MIN, ReleaseBrake).unwrap();
            for _ in 0..50 {
                let next = bus.now() + Duration::from_millis(2);
                bus.set_point(MotorId::MIN, push).unwrap();
                bus.run_until(next, |_| {}).unwrap();
            }
            let truth = fleet.drives[0].with(|drive| drive.plant().output_speed_dps());
            (format!("{:?}", log.take()), truth, bus.now(), seen.try_iter().last())
        };
        let (unseen_log, unseen_speed, _, _) = run(false);
        let (log, speed, end, last) = run(true);
        assert!(speed < -10.0, "it falls: {speed}");
        assert_eq!((log, speed), (unseen_log, unseen_speed));
        let (at, dps) = last.unwrap();
        assert!(end - at <= Duration::from_millis(1));
        assert!(dps < -10.0, "{dps}");
    }
}

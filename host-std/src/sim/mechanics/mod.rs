//! Mechanics of your own: coupled joints, a game engine, MuJoCo, a rig.
//!
//! A motor of the [`plant`](super::plant) moves only its own shaft, with its load. If shafts act on each
//! other, or if another program simulates the robot's body, [`Mechanics`] moves them instead. Once per period it gets
//! the torques of the motors on their shafts, and returns the angles and speeds of the shafts. Within a period a shaft
//! keeps its speed. Windings, supply, heat and encoders stay with the plant.
//!
//! ```
//! use myactuator_host_std::protocol::time::Duration;
//! use myactuator_host_std::sim::Fleet;
//! use myactuator_host_std::sim::mechanics::{Failure, Mechanics, Shaft};
//!
//! /// Two shafts in one, which has 0.5 kg·m².
//! struct Joined;
//!
//! impl Mechanics for Joined {
//!     fn step(&mut self, period: Duration, shafts: &mut [Shaft]) -> Result<(), Failure> {
//!         let seconds = period.as_micros() as f64 * 1e-6;
//!         let torque_nm: f64 = shafts.iter().map(|shaft| shaft.acting.torque_nm).sum();
//!         for shaft in shafts {
//!             shaft.angle_deg += shaft.speed_dps * seconds;
//!             shaft.speed_dps += (torque_nm / 0.5).to_degrees() * seconds;
//!         }
//!         Ok(())
//!     }
//! }
//!
//! let fleet = Fleet::new(2).on_can(1_000_000)?;
//! fleet.lead(&fleet.drives, Duration::from_micros(500), Joined)?;
//! fleet.drives[0].with(|drive| drive.plant_mut().set_external_torque_nm(1.0))?;
//! fleet.world.run_for(Duration::from_secs(1));
//! let angle_deg = |place: usize| fleet.drives[place].with(|it| it.plant().output_angle_deg());
//! // At most 1 N·m / 0.5 kg·m² / 2 * (1 s)², 1 rad; viscous friction takes some.
//! assert!(angle_deg(0) == angle_deg(1) && (40.0..57.3).contains(&angle_deg(1)));
//! assert_eq!(fleet.mechanics_failure(), None);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # How long a period may be
//! The drives' loops see the speed of a shaft once per period, so a period adds its own length to their delay. With
//! factory gains 200 µs is safe for the smallest inertia that a shaft can have, the motor's own; for a shaft that
//! carries four times that, 1 ms is enough.
//!
//! # In another process
//! [`Remote`] asks a process over a socket, with one line of JSON in each direction per period:
//!
//! ```text
//! to it    {"period_us":1000,"shafts":[{"motor":1,"torque_nm":1.5,"friction_nm":0.2,"angle_deg":0.0,"speed_dps":0.0}]}
//! from it  {"shafts":[{"angle_deg":0.0,"speed_dps":0.9}]}
//! ```
//!
//! The shafts have the same order in both lines. `examples/mechanics.py` of this package is such a process.
//!
//! Mechanics move the shafts of one bus. Each bus has its own clock, and waits for its own answer while the others
//! stand. A process that moves a robot of several buses listens at one socket for each bus, and answers each question
//! at once. For the other buses it uses the last torques that it got, which are up to a period old.

mod remote;

use std::sync::{Arc, Mutex};

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::time::{Duration, Instant};

use super::bus::{Medium, lock};
use super::plant::ShaftTorque;
use super::seat::Seat;
use super::{BusFleet, DriveHandle};

pub use remote::Remote;

/// Why mechanics cannot go on.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Moves the shafts of simulated motors. See the [module](self).
pub trait Mechanics: Send {
    /// Moves the shafts on by a period. Each shaft holds the torques that acted on it in the period, and its angle and
    /// speed at the beginning of the period. Set angle and speed to those at its end.
    ///
    /// # Errors
    /// Why it cannot go on. Then this is not called again, the shafts stand, and
    /// [`BusFleet::mechanics_failure`] returns the reason.
    fn step(&mut self, period: Duration, shafts: &mut [Shaft]) -> Result<(), Failure>;
}

/// A motor's output shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shaft {
    /// The id that its drive started with.
    pub motor: MotorId,
    /// The mean of what acted on it in the period.
    pub acting: ShaftTorque,
    /// Its angle, degrees, turns included.
    pub angle_deg: f64,
    /// Its speed, degrees per second.
    pub speed_dps: f64,
}

/// Other mechanics already move the shaft.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("motor {motor} is led already: one mechanics moves a shaft, and may move several")]
pub struct AlreadyLed {
    /// The id that its drive started with.
    pub motor: MotorId,
}

/// Whether it was led before.
fn set_led(seat: &Mutex<Seat>, is_led: bool) -> bool {
    std::mem::replace(&mut lock(seat).is_led, is_led)
}

/// The first reason why shafts of a fleet stand. Clones share it.
#[derive(Clone, Debug, Default)]
pub(in crate::sim) struct MechanicsFailure(Arc<Mutex<Option<String>>>);

impl MechanicsFailure {
    fn reason(&self) -> Option<String> {
        lock(&self.0).clone()
    }

    fn report(&self, reason: String) {
        lock(&self.0).get_or_insert(reason);
    }
}

impl<B: Medium> BusFleet<B> {
    /// Lets `mechanics` move the shafts of these drives from now on, with one step per `period`. Their loads have no
    /// effect then. Only one [`Mechanics`] leads a drive, until it has failed.
    ///
    /// # Errors
    /// [`AlreadyLed`]; then these mechanics move nothing.
    pub fn lead(
        &self,
        drives: &[DriveHandle],
        period: Duration,
        mechanics: impl Mechanics + 'static,
    ) -> Result<(), AlreadyLed> {
        if let Some(place) = drives.iter().position(|drive| set_led(&drive.seat, true)) {
            for drive in drives.iter().take(place) {
                set_led(&drive.seat, false);
            }
            return Err(AlreadyLed { motor: drives[place].motor() });
        }
        let period = period.max(Duration::from_micros(1));
        let mut leader = Leader {
            seats: drives.iter().map(|drive| Arc::clone(&drive.seat)).collect(),
            shafts: drives.iter().map(Shaft::of).collect(),
            period,
            mechanics,
            failure: self.mechanics_failure.clone(),
        };
        self.world.plan(period, move |_, now| leader.step(now).then_some(period));
        Ok(())
    }

    /// Why shafts stand, if their mechanics have failed or led them to an impossible place.
    pub fn mechanics_failure(&self) -> Option<String> {
        self.mechanics_failure.reason()
    }
}

impl Shaft {
    fn of(drive: &DriveHandle) -> Self {
        let (angle_deg, speed_dps) = drive.with(|it| {
            let (angle_deg, speed_dps) =
                (it.plant().output_angle_deg(), it.plant().output_speed_dps());
            // It can be led to where it is.
            let _ = it.plant_mut().lead(angle_deg, speed_dps);
            (angle_deg, speed_dps)
        });
        let motor = drive.motor();
        Self { motor, acting: ShaftTorque::default(), angle_deg, speed_dps }
    }
}

struct Leader<M> {
    /// A seat for each shaft.
    seats: Vec<Arc<Mutex<Seat>>>,
    shafts: Vec<Shaft>,
    period: Duration,
    mechanics: M,
    failure: MechanicsFailure,
}

impl<M: Mechanics> Leader<M> {
    /// Whether it goes on.
    fn step(&mut self, now: Instant) -> bool {
        for (seat, shaft) in self.seats.iter().zip(&mut self.shafts) {
            let mut seat = lock(seat);
            seat.catch_up(now);
            shaft.acting = seat.drive.plant().acting();
        }
        let moved = self.mechanics.step(self.period, &mut self.shafts).map_err(|it| it.to_string());
        let Err(reason) = moved.and_then(|()| self.lead()) else { return true };
        self.stand();
        self.failure.report(reason);
        false
    }

    /// Puts all shafts where the mechanics have them.
    fn lead(&mut self) -> Result<(), String> {
        for (seat, shaft) in self.seats.iter().zip(&self.shafts) {
            let mut seat = lock(seat);
            let led = seat.drive.plant_mut().lead(shaft.angle_deg, shaft.speed_dps);
            led.map_err(|error| format!("the shaft of motor {}: {error}", shaft.motor))?;
        }
        Ok(())
    }

    /// Makes all shafts stand where they are.
    fn stand(&self) {
        for seat in &self.seats {
            let mut seat = lock(seat);
            let angle_deg = seat.drive.plant().output_angle_deg();
            // It can be led to where it is.
            let _ = seat.drive.plant_mut().lead(angle_deg, 0.0);
            seat.is_led = false;
        }
    }
}

//! Thin loops that tie the master to embedded-can, embedded-io and their async counterparts.
//!
//! | bus | loop |
//! |---|---|
//! | CAN, `embedded_can::nb` | [`CanMaster`] |
//! | CAN, `embedded_can::blocking` | [`CanMaster`] over [`BlockingCan`] |
//! | CAN, async | [`AsyncCanMaster`] over an [`AsyncCan`] |
//! | RS485, `embedded_io` | [`SerialMaster`] |
//! | RS485, `embedded_io_async` | [`AsyncSerialMaster`] |
//! | RS485 with a direction pin | either over [`HalfDuplex`] |
//!
//! The loops that poll are [`Runner`]s, the async ones [`AsyncRunner`]s: what works on one bus works
//! on the other, [`bring_up`] for example. None of them decides anything: that is the
//! [`Master`](crate::master::Master)'s.
//!
//! # A control loop
//! ```
//! use myactuator_protocol_core::MotorId;
//! use myactuator_protocol_core::command::{AnyReply, MotionFeedback, MotionRanges, MotionSetPoint};
//! use myactuator_protocol_core::io::Runner;
//! use myactuator_protocol_core::master::{Event, MotorSet, Presence, StopKind};
//! use myactuator_protocol_core::time::Duration;
//!
//! /// Moves eight motors at 500 Hz until `plan` has nothing more to say or something fails, and stops
//! /// them. Gives those that have not confirmed the stop: cut their power.
//! fn run<R: Runner<8>>(
//!     bus: &mut R,
//!     mut plan: impl FnMut(MotorId, Option<&MotionFeedback>) -> Option<MotionSetPoint>,
//! ) -> MotorSet {
//!     let scale = MotionRanges::V4_3; // that of these drives' firmware: never guess it
//!     let arm: MotorSet = MotorId::all().take(8).collect();
//!     let mut measured: [Option<MotionFeedback>; 8] = [None; 8];
//!     let mut next = bus.now();
//!     'control: loop {
//!         for motor in arm.iter() {
//!             let Some(wanted) = plan(motor, measured[motor.index()].as_ref()) else { break 'control };
//!             let Ok(raw) = scale.quantise(&wanted) else { break 'control };
//!             if bus.set_point(motor, raw).is_err() { break 'control }
//!         }
//!         next += Duration::from_millis(2);
//!         while bus.now() < next {
//!             match bus.poll() {
//!                 Ok(Some(Event::Feedback { motor, reply: AnyReply::Motion(raw) })) => {
//!                     measured[motor.index()] = Some(scale.feedback(&raw));
//!                 }
//!                 Ok(Some(Event::SetPointUnanswered { motor }))
//!                     if bus.master().health(motor).presence == Presence::Silent => break 'control,
//!                 Ok(Some(_)) => {}
//!                 Ok(None) => bus.idle(next),
//!                 Err(_) => break 'control,
//!             }
//!         }
//!     }
//!     bus.stop_all(StopKind::Hold, arm)
//! }
//! ```

mod async_can;
mod async_clock;
mod async_runner;
mod async_serial;
pub mod bring_up;
mod can;
mod clock;
mod half_duplex;
mod line;
mod runner;
mod serial;
mod stuck;
#[cfg(test)]
mod tests;

pub use async_can::{AsyncCan, AsyncCanMaster, CanHalves};
pub use async_clock::{AsyncClock, DelayClock};
pub use async_runner::AsyncRunner;
pub use async_serial::AsyncSerialMaster;
pub use can::{BlockingCan, CanMaster};
pub use clock::{Clock, FnClock};
pub use half_duplex::{HalfDuplex, HalfDuplexError};
pub use runner::{CallError, LONGEST_STOP, Runner};
pub use serial::SerialMaster;

//! One bus for many threads: a thread of its own runs the master, and everybody else has handles.
//!
//! Stands above [`open`](crate::open), and takes any other loop as well. A [`SharedBus`] is a handle:
//! clone it and give the clones away. Calls from several threads are under way at the same time, so
//! eight threads that ask eight motors fill the bus as one control loop does.
//!
//! ```
//! use std::thread;
//!
//! use myactuator_host_std::open::BusAddress;
//! use myactuator_host_std::protocol::MotorId;
//! use myactuator_host_std::protocol::command::{ReadMultiTurnAngle, ReleaseBrake, Speed};
//! use myactuator_host_std::protocol::master::{MotorSet, StopKind};
//! use myactuator_host_std::protocol::units::{MaxTorque, SpeedTarget};
//! use myactuator_host_std::share::SharedBus;
//!
//! let address: BusAddress = "sim:4".parse()?;
//! let bus = SharedBus::open(&address, StopKind::Hold)?;
//!
//! // Every motor is asked by a thread of its own.
//! let asking = MotorId::all().take(4).map(|motor| {
//!     let bus = bus.clone();
//!     thread::spawn(move || bus.ask(motor, ReadMultiTurnAngle))
//! });
//! for asking in asking.collect::<Vec<_>>() {
//!     let reading = asking.join().expect("the thread ends")?;
//!     assert_eq!(reading.angle.degrees(), 0.0);
//! }
//!
//! // A set-point never waits for the bus; what the motor says of it is kept.
//! let elbow = MotorId::new(2)?;
//! bus.release_brake(elbow)?;
//! let turn = Speed { max_torque: MaxTorque::from_raw(50), speed: SpeedTarget::from_dps(30.0)? };
//! while bus.latest(elbow).is_none() {
//!     bus.set_point(elbow, turn)?;
//!     thread::yield_now();
//! }
//!
//! // Any thread may stop all motors; who has not confirmed it needs its power cut.
//! let unconfirmed = bus.stop_all(StopKind::Hold, MotorSet::EMPTY)?;
//! assert!(unconfirmed.is_empty());
//! assert!(bus.set_point(elbow, turn).is_err(), "until the stop is lifted");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Before it is shared
//! A handle is no [`Runner`](myactuator_protocol_core::io::Runner), and
//! [`bring_up`](myactuator_protocol_core::io::bring_up) needs one, but for brakes, moves that are watched to their
//! end, protection and restarts ([`release_brake`](SharedBus::release_brake), [`lock_brake`](SharedBus::lock_brake),
//! [`check_brake`](SharedBus::check_brake), [`move_to`](SharedBus::move_to), [`protect`](SharedBus::protect), [`restart`](SharedBus::restart)): first contact,
//! zeroing, another id. Do these on the master, and share it then. [`SharedBus::new`] takes any master;
//! its calls wait for up to 1 ms more than those of [`SharedBus::open`]. Whoever opens the port, and so has its clock,
//! is spared that by [`with_wake`](SharedBus::with_wake).
//!
//! ```
//! use myactuator_host_std::open::AnyMaster;
//! use myactuator_host_std::protocol::io::bring_up;
//! use myactuator_host_std::protocol::master::{MotorSet, StopKind};
//! use myactuator_host_std::share::SharedBus;
//!
//! let mut master = AnyMaster::<32>::open(&"sim:4".parse()?)?;
//! let found = bring_up::scan(&mut master, MotorSet::ALL, |_, _| {})?;
//! for motor in found.iter() {
//!     bring_up::release_brake(&mut master, motor)?;
//! }
//! let bus = SharedBus::new(master, StopKind::Hold);
//! # drop(bus);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # A motor that restarts
//! Its turns may be gone, so that moves and set-points are refused from then on. [Subscriptions](Subscription) hear of it
//! ([`Restarted`](myactuator_protocol_core::master::Event::Restarted)), and so does whoever moves it. Until it is stopped
//! it may turn on, as it was told last. Stop it, read where it believes to be, and [`resume`](SharedBus::resume); lift
//! the stop, and open its brake again. The same holds behind a [`restart`](SharedBus::restart) that you call for.
//!
//! # What ends it
//! A thread that leaves its control loop while others have handles leaves the motors as they are: [`Guard`] stops them.
//! When the last handle is dropped, all motors are stopped and the thread ends; the drop waits for that. Who
//! has not confirmed this stop is told to [subscriptions](Subscription) that have room alone, as the last that they hear
//! ([`StopUnconfirmed`](myactuator_protocol_core::master::Event::StopUnconfirmed)): call
//! [`stop_all`](SharedBus::stop_all) first to be told yourself.
//!
//! Nobody stops the motors of a program that is killed, aborts, calls `exit`, is ended by a signal (Ctrl-C) that it does
//! not handle, or **returns from `main` while another thread has a handle or a [`Guard`]**: that ends all threads where
//! they are. Join them first. A thread that waits for signals stops the motors by
//! [`begin_stop_all`](SharedBus::begin_stop_all), as the example `threads` has it. For the rest set the motors'
//! communication-loss protection (0xB3).
//!
//! An error of the bus is told to all who wait for an answer, and to all who ask or move a motor until it works again; if
//! it does so before anybody was told, to whoever comes next. A command that ends motion is taken all the same. The
//! thread goes on and tries again. A panic in the bus's driver stops the motors, as far as that driver still works, and
//! is told to everybody from then on; who has not confirmed this stop is told to subscriptions, too, and all are if the
//! driver panics again. Nobody waits for a driver that does not come back: after 2 s each call says so, and each stop
//! has nobody's confirmation.

mod calls;
mod desk;
mod error;
mod guard;
mod shared_bus;
mod state;
mod subscription;
#[cfg(test)]
mod tests;
mod ways;
mod worker;

pub use error::SharedBusError;
pub use guard::{Guard, Guards};
pub use shared_bus::{SharedBus, Stopping, WeakBus};
pub use state::Latest;
pub use subscription::Subscription;

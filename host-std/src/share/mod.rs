//! One bus for many threads: a thread of its own runs the master, and the other threads have handles.
//!
//! This module stands above [`open`](crate::open), and takes any other loop as well. A [`SharedBus`] is a handle:
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
//! [`bring_up`](myactuator_protocol_core::io::bring_up) needs a [`Runner`](myactuator_protocol_core::io::Runner), which
//! a handle is not. A handle itself offers what robots that run need:
//! [`wait_until_there`](SharedBus::wait_until_there), [`identify`](SharedBus::identify),
//! [`release_brake`](SharedBus::release_brake), [`lock_brake`](SharedBus::lock_brake),
//! [`check_brake`](SharedBus::check_brake), [`wait_until_stands`](SharedBus::wait_until_stands),
//! [`move_to`](SharedBus::move_to), [`protect`](SharedBus::protect) and [`restart`](SharedBus::restart). Do the rest
//! (scans, zeroing, another id) on the master, and share it then. Open brakes and stop motors after that, or the bus
//! does not know that they [hold](self#motors-that-hold).
//!
//! [`SharedBus::new`] takes any master; its calls wait for up to 1 ms more than those of [`SharedBus::open`]. If you
//! open the port yourself, and so have its clock, [`with_wake`](SharedBus::with_wake) avoids that.
//!
//! ```
//! use myactuator_host_std::open::AnyMaster;
//! use myactuator_host_std::protocol::io::bring_up;
//! use myactuator_host_std::protocol::master::{MotorSet, StopKind};
//! use myactuator_host_std::share::SharedBus;
//!
//! let mut master = AnyMaster::<32>::open(&"sim:4".parse()?)?;
//! let found = bring_up::scan(&mut master, MotorSet::ALL, |_, _| {})?;
//! let bus = SharedBus::new(master, StopKind::Hold);
//! for motor in found.iter() {
//!     bus.release_brake(motor)?;
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # A control loop in a thread
//! Leave it through a [`Guard`], and have a [`Watch`] look in each cycle, as with a loop without threads: a set-point is
//! accepted also for a motor that is cut off, or that has cut its output because of an error. The watch also has the
//! thread of the bus stop the motors if the loop hangs.
//!
//! A command of another thread ends the loop, too, if it is of the kind that the motor is streamed: until it is
//! answered, the motor's set-points are refused as
//! [`Busy`](myactuator_protocol_core::error::RequestError::Busy).
//!
//! # Motors that hold
//! The thread of the bus speaks to a motor that holds still, about every 100 ms, so that its communication-loss
//! protection (0xB3) does not let its load fall: let that be 500 ms or more. A motor holds, also behind a locked brake:
//!
//! - after a stop that holds, of any thread, and after a [`Stop`](myactuator_protocol_core::command::Stop) (0x81);
//! - after [`release_brake`](SharedBus::release_brake);
//! - when a [`move_to`](SharedBus::move_to) has arrived.
//!
//! It does so until it is told to move, to restart or to switch off, or reports an error. So a motor is held while its
//! robot waits for a person or for another bus, and also if all other threads hang; a gripper that
//! [presses](myactuator_protocol_core::io::bring_up::WhenStalled::Press) goes on pressing. If a motor may have let
//! go because it heard nothing, or has restarted, and a stop in force is to hold it, it is told again; also once that
//! stop is lifted, and after [`release_brake`](SharedBus::release_brake), unless it may have restarted. One that holds because it has arrived is not told
//! again, and nothing says so: where motors have no brakes, hold them by a stop. A motor that was told to move is
//! spoken to only by whoever moves it, so that its protection ends what a thread that hangs has begun. One that is off,
//! or that reports an error, is left to its protection, which locks its brake. Errors that the bus finds so are
//! published as a [`Report`](myactuator_protocol_core::master::Event::Report).
//!
//! The bus does not know what motors do since before it was shared: stop them with a handle, then they hold.
//!
//! # A motor that restarts
//! Its turns may be lost, so moves and set-points are refused from then on. [Subscriptions](Subscription) get
//! [`Restarted`](myactuator_protocol_core::master::Event::Restarted), and a thread that moves it gets an error. Until
//! it is stopped it may go on turning, as it was last commanded. The same holds after a [`restart`](SharedBus::restart)
//! that you call.
//!
//! 1. Stop it, and read its angle: it may have lost its turns.
//! 2. [`resume`](SharedBus::resume)
//! 3. Lift the stop, and open its brake again.
//!
//! # What ends it
//! - **A thread leaves its control loop** while others have handles: the motors go on. A [`Guard`] stops them.
//! - **The last handle is dropped:** all motors are stopped and the thread ends; the drop waits for that, unless such a
//!   stop was just waited for and nothing was done since. Motors that have not confirmed this stop are reported only to
//!   [subscriptions](Subscription) that have room, as their last events
//!   ([`StopUnconfirmed`](myactuator_protocol_core::master::Event::StopUnconfirmed)). To know them yourself call
//!   [`stop_all`](SharedBus::stop_all) first.
//! - **The program ends without that:** it is killed, aborts, calls `exit`, is ended by a signal (Ctrl-C) that it does
//!   not handle, or **returns from `main` while another thread has a handle or a [`Guard`]**, which ends all threads
//!   where they are. Then nothing stops the motors. Join the threads first. Have a thread wait for signals and stop the
//!   motors with [`begin_stop_all`](SharedBus::begin_stop_all), as in the example `threads`. For the rest set the
//!   motors' communication-loss protection (0xB3).
//!
//! # When the bus fails
//! - **The bus reports an error:** every call that waits for an answer gets it, and so does every call that asks or
//!   moves a motor until the bus works again. If it works again before any call got the error, the next call gets it. A
//!   command that ends motion is accepted nevertheless. The thread goes on and tries again.
//! - **The driver of the bus panics:** the motors are stopped, as far as the driver still works, and every call says so
//!   from then on. Nobody speaks to them any more: their protection lets their loads go. Subscriptions get the motors
//!   that have not confirmed this stop; if the driver panics again, all motors.
//! - **The driver does not return:** after 2 s each call says so, and each stop counts as unconfirmed.

mod calls;
mod desk;
mod error;
mod guard;
mod past;
mod shared_bus;
mod state;
mod subscription;
#[cfg(test)]
mod tests;
mod told;
mod watch;
mod ways;
mod worker;

pub use error::{LoopError, SharedBusError};
pub use guard::{Guard, Guards};
pub use shared_bus::{SharedBus, Stopping, WeakBus};
pub use state::Latest;
pub use subscription::Subscription;
pub use watch::Watch;

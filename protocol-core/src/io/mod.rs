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
//! The loops that poll are [`Runner`]s, the async ones are [`AsyncRunner`]s, and [`Polled`] makes one of the latter of
//! one of the former. What works on one bus works on the other:
//! [`bring_up`] for example, or [`async_bring_up`] for tasks. The loops decide nothing; the
//! [`Master`](crate::master::Master) does.
//!
//! **One task, or one thread, runs one bus.** Where several tasks need a bus, one of them owns the loop and carries out
//! what the others send it by a signal or a channel (from `embassy_sync`, for example), a stop before anything else.
//! The example `several_tasks` of `myactuator-host-std` shows that; the `share` of that crate does it for threads.
//! Several buses run in one task each, or in one task that `join`s their futures, as in the example `two_arms`.
//!
//! # What a driver reports
//! | what has happened | what the driver returns |
//! |---|---|
//! | it has no room for a frame | `WouldBlock`; a task's `transmit` is pending |
//! | a received CAN frame found no room | an error of kind `Overrun`, which is an [`Event::Overrun`] |
//! | a CAN frame was disturbed | nothing, or an error of kind `Bit`, `Stuff`, `Crc`, `Form` or `Acknowledge` |
//! | bytes on RS485 were disturbed or found no room | nothing: the checksum shows it |
//! | bus-off, or the driver has failed | any other error |
//!
//! A disturbed frame on CAN is sent again by whoever has sent it. So when receiving, up to eight such errors in a round
//! are passed over; one more is any other error. An error of `transmit` always says that the frame was not taken and
//! will not be sent: a move that is reported so may be put again.
//!
//! Any other error ends the call, except for a stop, and for a question that is answered all the same. So it ends a
//! control loop that hands errors on. What waits and may move a motor is dropped. If only receiving fails, questions
//! and stops are still sent: a controller that complains of many errors (warning, passive) at each look is soon content
//! again if frames are sent. It is better not to report that at all.
//!
//! [`Event::Overrun`]: crate::master::Event::Overrun
//!
//! # A motor that falls silent
//! | who waits for it | what it gets |
//! |---|---|
//! | [`ask`](Runner::ask), [`bring_up`] | [`CallError::Failed`] with [`Failure::NoReply`](crate::master::Failure::NoReply) |
//! | a control loop with a [`Watch`] | [`LoopError::Trouble`] with [`Trouble::Silent`] |
//! | [`bring_up::move_to`] | [`NotArrived`](bring_up::NotArrived) with [`MoveFailure::Call`](bring_up::MoveFailure::Call) |
//! | [`stop`](Runner::stop), [`stop_all`](Runner::stop_all) | the motor as one that has not confirmed |
//! | whoever takes events | [`Event::Failed`], [`Event::SetPointUnanswered`], [`Event::StopUnconfirmed`] |
//!
//! [`Event::Failed`]: crate::master::Event::Failed
//! [`Event::SetPointUnanswered`]: crate::master::Event::SetPointUnanswered
//! [`Event::StopUnconfirmed`]: crate::master::Event::StopUnconfirmed
//!
//! README.md shows a control loop for eight motors, with a [`Guard`] and a [`Watch`]. The whole program is the example
//! `control_loop` of `myactuator-host-std`.

mod asking;
pub mod async_bring_up;
mod async_can;
mod async_runner;
mod async_serial;
mod brake;
pub mod bring_up;
mod calls;
mod can;
mod change_id;
mod clock;
mod echo;
mod elapsed;
mod guard;
mod half_duplex;
mod keep_alive;
mod line;
mod move_to;
mod on_drop;
mod outcome;
mod polled;
mod presence;
mod pump;
mod rest;
mod restart;
mod runner;
mod serial;
mod standing;
#[cfg(test)]
mod tests;
mod watch;

pub use asking::CallError;
pub use async_can::{AsyncCan, AsyncCanMaster};
pub use async_runner::AsyncRunner;
pub use async_serial::AsyncSerialMaster;
pub use can::{BlockingCan, CanMaster};
pub use clock::{AsyncClock, Clock};
pub use echo::EchoFilter;
pub use elapsed::Elapsed;
pub use guard::{Guard, Guards, guarded};
pub use half_duplex::{HalfDuplex, HalfDuplexError};
pub use keep_alive::KeepAlive;
pub use polled::Polled;
pub use runner::{LONGEST_STOP, LONGEST_TURN, Runner, longest_stop};
pub use serial::SerialMaster;
pub use watch::{LoopError, Trouble, Watch};

//! Master firmware for microcontrollers: the application, without a board.
//!
//! Read it in this order:
//!
//! 1. [`Board`]: what a board has to supply beside its bus. The boards are in `boards/`, a package
//!    each, a program a bus.
//! 2. [`run`] and [`run_async`]: the loop that every board's program ends in.
//! 3. [`App`]: what happens in each cycle, a small state machine without a clock or I/O of its own.
//!
//! ```text
//!                 button                    all motors ready
//!    Stopped ────────────────▶ Finding, Preparing ────────────▶ Running
//!     ▲    │                        │                              │
//!     │    │ button held            │ trouble, button              │ trouble, button
//!     │    ▼                        ▼                              │
//!     │  ShuttingDown ──────────▶ Stopping ◀───────────────────────┘
//!     │                           │  │ ▲ ▲
//!     └───────────────────────────┘  │ │ └── every start, whatever its cause
//!        all confirmed, or too late  ▼ │
//!                                  Looking
//! ```
//!
//! `Looking` follows only where a shutdown was broken off, at each motor once it has confirmed its stop: where that is
//! late, also from `Stopped`.
//!
//! Nothing moves until the button was pressed, whatever happened before.
#![no_std]
#![forbid(unsafe_code)]

mod app;
mod board;
mod last_words;
mod report;
mod run;

pub use app::{App, Moment, Movement, Setup};
pub use board::{Board, RestartCause, Usage};
pub use last_words::last_words;
pub use report::{Report, StateName, Trouble};
pub use run::{cycle, cycle_async, run, run_async};

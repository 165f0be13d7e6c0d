//! Master firmware for microcontrollers: the application, without a board.
//!
//! Read it in this order:
//!
//! 1. [`Board`]: what a board has to supply besides its bus. The boards are in `boards/`: one package for each board,
//!    one program for each bus.
//! 2. [`run`] and [`run_async`]: the loop in which every board's program ends.
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
//! `Looking` follows if a shutdown was broken off: for each motor, once that motor has confirmed its stop. If the
//! confirmation is late, it follows from `Stopped`. So it does if a motor that stands behind its locked brake turns,
//! and then also at once from `Finding`.
//!
//! Nothing moves until the button is pressed, whatever happened before.
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

//! The firmware of a board in an emulator, on a bus of simulated drives.
//!
//! ```text
//!   this process                                    QEMU
//!   ┌──────────────────────────┐      socket        ┌─────────────────────┐
//!   │ Drives, a simulated bus  │◀──────────────────▶│ UART ◀─▶ firmware   │
//!   │                          │      socket        │            │  │     │
//!   │ Panel, a button          │◀──────────────────▶│ UART ◀─────┘  │     │
//!   │ Log, decoded             │◀───────────────────│ semihosting ◀─┘     │
//!   └──────────────────────────┘   standard output  └─────────────────────┘
//! ```
//!
//! | module | for |
//! |---|---|
//! | [`board`] | which boards are emulated, how, and where their wires are |
//! | [`image`](mod@image) | the firmware's file: found, or built |
//! | [`qemu`] | the emulator's process |
//! | [`panel`] | the button, and ways to break the firmware |
//! | [`log`] | what the firmware logs |
//! | [`drives`] | the simulated drives: disturbed, and asked what they heard |
//! | [`truth`] | where the shafts really were, and when they stood still |
//! | [`urgency`] | the priority of all of this |
//! | [`Emulated`] | a board with its drives |
//! | [`firmware`] | that, with checks of both ends, for tests |
//!
//! Emulated time is real time, and tests wait in real time. The bus is a socket and not a pseudo-terminal, although the
//! drives have one for programs: Linux hands a pseudo-terminal's bytes over in a thread of its own, which on a busy
//! machine comes milliseconds late.

pub mod board;
pub mod drives;
mod emulated;
pub mod firmware;
pub mod image;
pub mod log;
pub mod panel;
pub mod qemu;
mod socket;
pub mod truth;
pub mod urgency;

use std::path::PathBuf;

pub use emulated::Emulated;

/// Why firmware cannot be emulated: a sentence for the user.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Where the workspace builds.
pub fn target_dir() -> PathBuf {
    let workspace = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    match std::env::var_os("CARGO_TARGET_DIR") {
        // Cargo takes it as relative to the directory of the call, which was the workspace.
        Some(folder) => PathBuf::from(workspace).join(folder),
        None => PathBuf::from(workspace).join("target"),
    }
}

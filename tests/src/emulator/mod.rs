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
//! | [`log`] | what the firmware tells |
//! | [`drives`] | the simulated drives: disturbed, and asked what they heard |
//! | [`truth`] | where the shafts really were, and when they stood still |
//! | [`urgency`] | the processor's time for all of this |
//! | [`Emulated`] | a board with its drives |
//! | [`firmware`] | that, and whoever looks at both ends, for tests |
//!
//! The emulated time is real time: what a test waits for, it really waits for. The bus is a socket and no
//! pseudo-terminal, though the drives have one for programs: Linux hands a pseudo-terminal's bytes over in
//! a thread of its own, which on a busy machine comes milliseconds late.

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

/// Why firmware cannot be emulated: a sentence for the person in front of it.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Where the workspace builds.
pub fn target_dir() -> PathBuf {
    let workspace = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    match std::env::var_os("CARGO_TARGET_DIR") {
        // Cargo takes it as relative to where it was called; that was the workspace.
        Some(folder) => PathBuf::from(workspace).join(folder),
        None => PathBuf::from(workspace).join("target"),
    }
}

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
//! | [`board`] | the emulated boards, how QEMU emulates them, and where their wires are |
//! | [`image`](mod@image) | the image file of the firmware, found or built |
//! | [`qemu`] | the emulator's process |
//! | [`panel`] | the button, and ways to break the firmware |
//! | [`log`] | the log of the firmware |
//! | [`drives`] | the simulated drives, with faults to inject, and the commands that they received |
//! | [`truth`] | where the shafts really were, and when they stood still |
//! | [`processor`] | one processor for emulator and simulation, and how long the machine kept it from them |
//! | [`Emulated`] | a board with its drives |
//! | [`firmware`] | a board with its drives, and checks of both ends, for tests |
//!
//! Emulated time is real time, and tests wait in real time. The bus is a socket, although simulated drives can also use
//! a pseudo-terminal: Linux passes on a pseudo-terminal's bytes in a thread of its own, which on a busy machine runs
//! milliseconds late.

pub mod board;
pub mod drives;
mod emulated;
pub mod firmware;
pub mod image;
pub mod log;
pub mod panel;
pub mod processor;
pub mod qemu;
mod socket;
pub mod truth;

use std::path::PathBuf;

pub use emulated::Emulated;

/// The reason why firmware cannot be emulated: a sentence for the user.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// The folder in which the workspace is built.
pub fn target_dir() -> PathBuf {
    let workspace = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    match std::env::var_os("CARGO_TARGET_DIR") {
        // A relative path is relative to the directory in which Cargo was called: the workspace.
        Some(folder) => PathBuf::from(workspace).join(folder),
        None => PathBuf::from(workspace).join("target"),
    }
}

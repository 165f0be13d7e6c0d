//! Helpers shared by the tests of the workspace.

pub mod bench;
pub mod dice;
#[cfg(feature = "emulator")]
pub mod emulator;
pub mod fleet;
pub mod listen;
pub mod requirements;
pub mod rig;
pub mod script;
pub mod tapped;
pub mod values;
pub mod vectors;
pub mod wire;

/// The code in `README.md` is compiled and run as documentation tests.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
pub struct Readme;

//! The firmware of the emulated boards, end to end.

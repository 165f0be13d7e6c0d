//! The emulated board.
#![no_std]

//! Firmware that does nothing: the sizes of the others are what they take beyond it.
#![no_std]
#![no_main]

#[path = "../size/mod.rs"]
mod size;

use cortex_m_rt::entry;

#[entry]
fn main() -> ! {
    size::finish(true)
}

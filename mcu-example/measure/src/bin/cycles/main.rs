//! What everything costs: instructions on the emulated Cortex-M4F, beside plain C where there is a
//! counterpart, and beside the budget. Each job is a function that is not inlined; the same call of a
//! function that does nothing is subtracted.
#![no_std]
#![no_main]

mod application;
mod c;
mod codecs;
mod counter;
mod engine;
mod table;

use cortex_m_rt::entry;
use measure::finish;
use myactuator_protocol_core::DecodeError;

use crate::table::Table;

#[derive(Debug)]
enum Trouble {
    NotReadable(#[allow(dead_code, reason = "printed")] DecodeError),
    OverBudget(#[allow(dead_code, reason = "printed")] u32),
}

#[entry]
fn main() -> ! {
    finish(run())
}

fn run() -> Result<(), Trouble> {
    counter::start();
    let mut table = Table::default();
    table.head("instructions");
    codecs::measure(&mut table).map_err(Trouble::NotReadable)?;
    engine::measure(&mut table);
    application::measure(&mut table);
    match table.over() {
        0 => Ok(()),
        rows => Err(Trouble::OverBudget(rows)),
    }
}

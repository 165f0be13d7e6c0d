//! The log, by defmt. Where it goes to is the board's affair.

use myactuator_mcu_example::Report;
use myactuator_protocol_core::io::Clock as _;

use crate::line::take_line_errors;
use crate::time::TimeBase;

defmt::timestamp!("{=u64:us}", TimeBase::read().now().as_micros());

/// Tells a report; with that of a second also what was wrong on the RS485 line since the last one.
pub fn log(report: &Report) {
    defmt::info!("{}", report);
    if let Report::Second { .. } = report {
        let errors = take_line_errors();
        if !errors.is_empty() {
            defmt::warn!("{}", errors);
        }
    }
}

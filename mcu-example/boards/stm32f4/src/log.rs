//! The log, by defmt. The board chooses its output.

use myactuator_mcu_example::Report;
use myactuator_protocol_core::io::Clock as _;

use crate::line::take_line_errors;
use crate::time::TimeBase;

defmt::timestamp!("{=u64:us}", TimeBase::read().now().as_micros());

/// Logs a report. With the report of a second it also logs the errors of the RS485 line since the last one.
pub fn log(report: &Report) {
    defmt::info!("{}", report);
    if let Report::Second { .. } = report {
        let errors = take_line_errors();
        if !errors.is_empty() {
            defmt::warn!("{}", errors);
        }
    }
}

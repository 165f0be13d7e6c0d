//! The names of errors in JSON.

use myactuator_protocol_core::command::ErrorFlags;

/// The name of a single error; one without a name keeps its bit.
pub(crate) fn error_name(error: ErrorFlags) -> String {
    match error.name() {
        Some(name) => name.to_owned(),
        None => format!("unknown-0x{:04X}", error.bits()),
    }
}

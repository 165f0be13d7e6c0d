//! Values of the library that have names, as arguments.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use myactuator_host_std::BusKind;
use myactuator_host_std::explain::Sender;

/// A bus by its name.
pub(super) fn bus() -> impl TypedValueParser<Value = BusKind> {
    let named = BusKind::ALL.map(|bus| {
        PossibleValue::new(bus.name()).help(match bus {
            BusKind::Can => "CAN, standard identifiers, eight data bytes",
            BusKind::Rs485 => "RS485, 13 bytes a frame",
        })
    });
    PossibleValuesParser::new(named).try_map(|name| name.parse())
}

/// A sender by the name of what it sends.
pub(super) fn sender() -> impl TypedValueParser<Value = Sender> {
    let named = Sender::ALL.map(|sender| {
        PossibleValue::new(sender.name()).help(match sender {
            Sender::Master => "The master: it is a command",
            Sender::Motor => "A motor: it is a reply",
        })
    });
    PossibleValuesParser::new(named).try_map(|name| name.parse())
}

//! Values of the library that have names, as arguments.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use myactuator_host_std::BusKind;
use myactuator_host_std::explain::FrameDirection;

pub(super) fn bus() -> impl TypedValueParser<Value = BusKind> {
    let named = BusKind::ALL.map(|bus| {
        PossibleValue::new(bus.name()).help(match bus {
            BusKind::Can => "CAN, standard identifiers, eight data bytes",
            BusKind::Rs485 => "RS485, 13 bytes a frame",
        })
    });
    PossibleValuesParser::new(named).try_map(|name| name.parse())
}

pub(super) fn direction() -> impl TypedValueParser<Value = FrameDirection> {
    let named = [
        (FrameDirection::Command, "The master: it is a command"),
        (FrameDirection::Reply, "A motor: it is a reply"),
    ];
    let values = named.map(|(direction, help)| PossibleValue::new(direction.name()).help(help));
    PossibleValuesParser::new(values).map(move |name| {
        let known = named.iter().find(|(direction, _)| direction.name() == name);
        known.map_or(FrameDirection::Either, |(direction, _)| *direction)
    })
}

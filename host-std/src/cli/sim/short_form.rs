//! What is served without a file: equal drives on an RS485 line and on a CAN bus.

use myactuator_host_std::BusKind;
use myactuator_host_std::sim::{Fleet, RobotBus};
use myactuator_protocol_core::Firmware;

use super::serving::Served;
use super::{Arguments, Way, options};
use crate::cli::arguments as parse;

/// The buses that the arguments ask for.
pub(super) fn buses(arguments: &Arguments) -> Result<Vec<Served>, String> {
    check(arguments)?;
    let fleet = fleet(arguments)?;
    let bus = |kind, bit_rate| RobotBus {
        fleet: fleet.clone(),
        kind,
        bit_rate,
        adapter: options::adapter(&arguments.quirks),
        bursts: options::bursts(&arguments.quirks),
        mechanics: None,
        interface: None,
    };
    let wanted = |way| arguments.only.is_none_or(|only| only == way);
    let link = |way, name: &str| wanted(way).then(|| name.to_owned());
    let mut served = Vec::new();
    if let Some(link) = link(Way::Rs485, "rs485") {
        served.push(Served { bus: bus(BusKind::Rs485, arguments.rs485_rate), link: Some(link) });
    }
    let interface = arguments.can.clone().filter(|_| wanted(Way::Can));
    let link = link(Way::Slcan, "slcan");
    if link.is_some() || interface.is_some() {
        let bus = bus(BusKind::Can, arguments.bit_rate.bits_per_second());
        served.push(Served { bus: RobotBus { interface, ..bus }, link });
    }
    Ok(served)
}

fn check(arguments: &Arguments) -> Result<(), String> {
    match (arguments.only, &arguments.can) {
        (Some(Way::Can), None) => Err("--only can needs --can with the interface's name"),
        (Some(Way::Rs485 | Way::Slcan), Some(_)) => {
            Err("--can serves an interface, but --only leaves it out: drop one of them")
        }
        _ => Ok(()),
    }?;
    let has_ranges = |firmware: Firmware| firmware.motion_ranges().or(arguments.ranges).is_some();
    if !arguments.firmware.is_none_or(has_ranges) {
        return Err(parse::RANGES_ARE_MISSING.into());
    }
    Ok(())
}

/// The drives of either bus.
fn fleet(arguments: &Arguments) -> Result<Fleet, String> {
    let quirks = options::drives_quirks(&arguments.quirks).map_err(|error| error.to_string())?;
    let mut fleet = Fleet::new(arguments.count)
        .quirks(quirks)
        .faults(arguments.faults.iter().copied())
        .seed(arguments.seed.unwrap_or(1))
        .brakes(arguments.brakes);
    if let Some(id) = arguments.same_id {
        fleet = fleet.all_with_id(id);
    }
    if let Some(model) = &arguments.model {
        fleet = fleet.model(model.clone());
    }
    if let Some(firmware) = arguments.firmware {
        fleet = fleet.firmware(firmware);
    }
    if let Some(ranges) = arguments.ranges {
        fleet = fleet.motion_ranges(ranges);
    }
    let motors = fleet.ids();
    let mut named = arguments.faults.iter().filter_map(|fault| fault.motor);
    match named.find(|&motor| !motors.contains(motor)) {
        Some(motor) => Err(format!("--fault names motor {motor}, but the motors are {motors}")),
        None => Ok(fleet),
    }
}

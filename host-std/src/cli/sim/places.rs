//! Prints where drives are served.

use std::path::PathBuf;

use myactuator_host_std::open::BusAddress;
use myactuator_host_std::sim::RobotBus;
use myactuator_protocol_core::MotorId;
use serde_json::{Value, json};

/// A place where drives are served.
#[derive(Debug)]
pub(super) struct Place {
    /// The name of the bus.
    name: String,
    /// For --bus of other subcommands.
    address: BusAddress,
    path: Option<PathBuf>,
    link: Option<PathBuf>,
    bit_rate: u32,
    /// In order; some may have the same id.
    motors: Vec<MotorId>,
}

impl Place {
    pub(super) fn on_terminal(
        bus: &RobotBus,
        address: impl FnOnce(PathBuf) -> BusAddress,
        path: PathBuf,
        link: Option<PathBuf>,
    ) -> Self {
        let address = address(link.as_ref().unwrap_or(&path).clone());
        Self { path: Some(path), link, ..Self::of(bus, address) }
    }

    pub(super) fn on_interface(bus: &RobotBus, interface: &str) -> Self {
        Self::of(bus, BusAddress::SocketCan { interface: interface.to_owned() })
    }

    fn of(bus: &RobotBus, address: BusAddress) -> Self {
        let name = bus.name().to_owned();
        let mut motors: Vec<MotorId> = bus.fleet.motors().iter().map(|motor| motor.id).collect();
        motors.sort_unstable();
        Self { name, address, path: None, link: None, bit_rate: bus.bit_rate, motors }
    }

    /// Its kind for scripts, and for people.
    const fn kind(&self) -> (&'static str, &'static str) {
        match self.address {
            BusAddress::Rs485 { .. } => ("rs485", "RS485 line"),
            BusAddress::Slcan { .. } => ("slcan", "SLCAN"),
            BusAddress::SocketCan { .. } | BusAddress::Simulated { .. } => ("can", "CAN"),
        }
    }

    fn text(&self, with_name: bool) -> String {
        let place = match (&self.link, &self.path) {
            (Some(link), Some(path)) => format!("{} -> {}", link.display(), path.display()),
            (_, Some(path)) => path.display().to_string(),
            _ => self.address.to_string(),
        };
        let rate = match self.address {
            BusAddress::Rs485 { echo, .. } => {
                let echo = if echo { ", echo" } else { "" };
                format!("{} bit/s{echo}", self.bit_rate)
            }
            _ => format!("CAN at {} bit/s", self.bit_rate),
        };
        let name = if with_name { format!("{:<12} ", self.name) } else { String::new() };
        let motors: String = self.motors.iter().map(|motor| format!(" {motor}")).collect();
        format!("{name}{:<12} {place:<12} {rate}   motors{motors}", self.kind().1)
    }

    fn json(&self) -> Value {
        let mut object = json!({ "name": self.name, "kind": self.kind().0 });
        if let Some(path) = &self.path {
            object["path"] = json!(path);
        }
        if let Some(link) = &self.link {
            object["link"] = json!(link);
        }
        if let BusAddress::SocketCan { interface } = &self.address {
            object["interface"] = json!(interface);
        }
        object["bit_rate"] = json!(self.bit_rate);
        object["motors"] = self.motors.iter().map(|motor| motor.get()).collect();
        object["bus"] = json!(self.address.to_string());
        object
    }
}

/// The lines to print. The buses of a file are named; without a file their kinds tell them apart. In lock-step there is
/// no line to try: a program that waits for an answer would wait for time.
pub(super) fn lines(
    places: &[Place],
    is_file: bool,
    is_in_lock_step: bool,
    json: bool,
) -> Vec<String> {
    if json {
        return places.iter().map(|place| place.json().to_string()).collect();
    }
    let mut lines: Vec<String> = places.iter().map(|place| place.text(is_file)).collect();
    let has = |kind| places.iter().any(|place| place.kind().0 == kind);
    let is_twice = |pair: &[Place]| matches!(pair, [one, other] if one.name == other.name);
    if is_file {
        if places.windows(2).any(is_twice) {
            lines.push("Places of the same name lead to the same motors.".into());
        }
    } else {
        if has("rs485") && places.len() > 1 {
            lines.push(
                "The motors on RS485 are not those on CAN, although they have the same ids.".into(),
            );
        }
        if has("slcan") && has("can") {
            lines.push("SLCAN and CAN lead to the same motors.".into());
        }
    }
    if let Some(place) = places.first().filter(|_| !is_in_lock_step) {
        lines.push(format!("try: myactuator scan --bus {}", place.address));
    }
    lines.push("Ctrl-C ends it.".into());
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_host_std::BusKind;
    use myactuator_host_std::sim::{Adapter, Fleet};
    use myactuator_host_std::text::slcan::Rate;
    use myactuator_protocol_core::time::Duration;

    fn bus(name: Option<&str>, kind: BusKind, bit_rate: u32) -> RobotBus {
        let fleet = Fleet::new(2);
        let fleet = match name {
            Some(name) => fleet.name(name),
            None => fleet,
        };
        let (adapter, interface) = (Adapter::Plain, None);
        let bursts = Duration::ZERO;
        RobotBus { fleet, kind, bit_rate, adapter, bursts, mechanics: None, interface }
    }

    fn printed(names: [Option<&str>; 2], json: bool) -> Vec<String> {
        lines(&served(names), names[0].is_some(), false, json)
    }

    fn served(names: [Option<&str>; 2]) -> [Place; 3] {
        let of_line = bus(names[0], BusKind::Rs485, 115_200);
        let of_can = bus(names[1], BusKind::Can, 500_000);
        let line = |path| BusAddress::Rs485 { path, bit_rate: 115_200, echo: true };
        let adapter = |path| BusAddress::Slcan { path, rate: Rate::Kbit500 };
        let (path, link) = (PathBuf::from("/dev/pts/7"), PathBuf::from("here/slcan"));
        [
            Place::on_terminal(&of_line, line, path.clone(), None),
            Place::on_terminal(&of_can, adapter, path, Some(link)),
            Place::on_interface(&of_can, "vcan0"),
        ]
    }

    #[test]
    fn lock_step_output_does_not_suggest_a_scan() {
        let printed = lines(&served([None; 2]), false, true, false);
        assert!(!printed.iter().any(|line| line.contains("try:")), "{printed:?}");
        assert_eq!(printed.last().unwrap(), "Ctrl-C ends it.");
    }

    #[test]
    fn places_as_text() {
        assert_eq!(
            printed([None; 2], false),
            [
                "RS485 line   /dev/pts/7   115200 bit/s, echo   motors 1 2",
                "SLCAN        here/slcan -> /dev/pts/7 CAN at 500000 bit/s   motors 1 2",
                "CAN          vcan0        CAN at 500000 bit/s   motors 1 2",
                "The motors on RS485 are not those on CAN, although they have the same ids.",
                "SLCAN and CAN lead to the same motors.",
                "try: myactuator scan --bus rs485:/dev/pts/7@115200,echo",
                "Ctrl-C ends it.",
            ]
        );
        assert_eq!(
            printed([Some("gripper"), Some("arm")], false),
            [
                "gripper      RS485 line   /dev/pts/7   115200 bit/s, echo   motors 1 2",
                "arm          SLCAN        here/slcan -> /dev/pts/7 CAN at 500000 bit/s   motors 1 2",
                "arm          CAN          vcan0        CAN at 500000 bit/s   motors 1 2",
                "Places of the same name lead to the same motors.",
                "try: myactuator scan --bus rs485:/dev/pts/7@115200,echo",
                "Ctrl-C ends it.",
            ]
        );
    }

    #[test]
    fn motors_with_the_same_id_are_listed_each() {
        let mut bus = bus(None, BusKind::Can, 500_000);
        bus.fleet = Fleet::new(3).all_with_id(MotorId::MIN);
        let place = Place::on_interface(&bus, "vcan0");
        assert!(place.text(false).ends_with("motors 1 1 1"), "{}", place.text(false));
        assert_eq!(place.json()["motors"], json!([1, 1, 1]));
    }

    #[test]
    fn places_as_json() {
        let rs485 = r#"{"name":"rs485","kind":"rs485","path":"/dev/pts/7","bit_rate":115200,"motors":[1,2],"bus":"rs485:/dev/pts/7@115200,echo"}"#;
        let slcan = r#"{"name":"can","kind":"slcan","path":"/dev/pts/7","link":"here/slcan","bit_rate":500000,"motors":[1,2],"bus":"slcan:here/slcan@500000"}"#;
        let can = r#"{"name":"can","kind":"can","interface":"vcan0","bit_rate":500000,"motors":[1,2],"bus":"vcan0"}"#;
        assert_eq!(printed([None; 2], true), [rs485, slcan, can]);
    }
}

//! Says where drives are served.

use std::path::PathBuf;

use myactuator_host_std::open::{BusAddress, Echo};
use myactuator_protocol_core::master::MotorSet;
use serde_json::{Value, json};

/// A place where drives are served.
#[derive(Debug)]
pub(super) struct Place {
    /// As other subcommands take it.
    address: BusAddress,
    path: Option<PathBuf>,
    link: Option<PathBuf>,
    bit_rate: u32,
}

impl Place {
    pub(super) fn on_terminal(
        address: impl FnOnce(PathBuf) -> BusAddress,
        path: PathBuf,
        link: Option<PathBuf>,
        bit_rate: u32,
    ) -> Self {
        let address = address(link.as_ref().unwrap_or(&path).clone());
        Self { address, path: Some(path), link, bit_rate }
    }

    pub(super) fn on_interface(interface: &str, bit_rate: u32) -> Self {
        let address = BusAddress::SocketCan { interface: interface.to_owned() };
        Self { address, path: None, link: None, bit_rate }
    }

    /// Its kind for scripts, and for people.
    const fn kind(&self) -> (&'static str, &'static str) {
        match self.address {
            BusAddress::Rs485 { .. } => ("rs485", "RS485 line"),
            BusAddress::Slcan { .. } => ("slcan", "SLCAN"),
            BusAddress::SocketCan { .. } | BusAddress::Simulated { .. } => ("can", "CAN"),
        }
    }

    fn text(&self, motors: MotorSet) -> String {
        let place = match (&self.link, &self.path) {
            (Some(link), Some(path)) => format!("{} -> {}", link.display(), path.display()),
            (_, Some(path)) => path.display().to_string(),
            _ => self.address.to_string(),
        };
        let rate = match self.address {
            BusAddress::Rs485 { echo, .. } => {
                let echo = if echo == Echo::Present { ", echo" } else { "" };
                format!("{} bit/s{echo}", self.bit_rate)
            }
            _ => format!("CAN at {} bit/s", self.bit_rate),
        };
        format!("{:<12} {place:<12} {rate}   motors {motors}", self.kind().1)
    }

    fn json(&self, motors: MotorSet) -> Value {
        let mut object = json!({ "kind": self.kind().0 });
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
        object["motors"] = motors.iter().map(|motor| motor.get()).collect();
        object["bus"] = json!(self.address.to_string());
        object
    }
}

pub(super) fn lines(places: &[Place], motors: MotorSet, json: bool) -> Vec<String> {
    if json {
        return places.iter().map(|place| place.json(motors).to_string()).collect();
    }
    let mut lines: Vec<String> = places.iter().map(|place| place.text(motors)).collect();
    let has = |kind| places.iter().any(|place| place.kind().0 == kind);
    if has("rs485") && places.len() > 1 {
        lines.push("The motors on RS485 are others than those on CAN, with the same ids.".into());
    }
    if has("slcan") && has("can") {
        lines.push("SLCAN and CAN lead to the same motors.".into());
    }
    if let Some(place) = places.first() {
        lines.push(format!("try: myactuator scan --bus {}", place.address));
    }
    lines.push("Ctrl-C ends it.".into());
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_host_std::text::slcan::Rate;
    use myactuator_protocol_core::MotorId;

    fn told(json: bool) -> Vec<String> {
        let motors = MotorId::all().take(2).collect();
        let line = |path| BusAddress::Rs485 { path, bit_rate: 115_200, echo: Echo::Present };
        let adapter = |path| BusAddress::Slcan { path, rate: Rate::Kbit500 };
        let (path, link) = (PathBuf::from("/dev/pts/7"), PathBuf::from("here/slcan"));
        let places = [
            Place::on_terminal(line, path.clone(), None, 115_200),
            Place::on_terminal(adapter, path, Some(link), 500_000),
            Place::on_interface("vcan0", 500_000),
        ];
        lines(&places, motors, json)
    }

    #[test]
    fn people_read() {
        assert_eq!(
            told(false),
            [
                "RS485 line   /dev/pts/7   115200 bit/s, echo   motors 1 2",
                "SLCAN        here/slcan -> /dev/pts/7 CAN at 500000 bit/s   motors 1 2",
                "CAN          vcan0        CAN at 500000 bit/s   motors 1 2",
                "The motors on RS485 are others than those on CAN, with the same ids.",
                "SLCAN and CAN lead to the same motors.",
                "try: myactuator scan --bus rs485:/dev/pts/7@115200,echo",
                "Ctrl-C ends it.",
            ]
        );
    }

    #[test]
    fn scripts_read() {
        let rs485 = r#"{"kind":"rs485","path":"/dev/pts/7","bit_rate":115200,"motors":[1,2],"bus":"rs485:/dev/pts/7@115200,echo"}"#;
        let slcan = r#"{"kind":"slcan","path":"/dev/pts/7","link":"here/slcan","bit_rate":500000,"motors":[1,2],"bus":"slcan:here/slcan@500000"}"#;
        let can =
            r#"{"kind":"can","interface":"vcan0","bit_rate":500000,"motors":[1,2],"bus":"vcan0"}"#;
        assert_eq!(told(true), [rs485, slcan, can]);
    }
}

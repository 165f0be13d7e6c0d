//! Prints what goes over a bus, a packet a line.
//!
//! ```text
//! candump -L can0 | cargo run -p myactuator-protocol-core --example bus_monitor
//! cargo run -p myactuator-protocol-core --example bus_monitor -- v4.4 < candump.log
//! stty -F /dev/ttyUSB0 115200 raw
//! cargo run -p myactuator-protocol-core --example bus_monitor -- rs485 < /dev/ttyUSB0
//! ```

use std::env;
use std::error::Error;
use std::io::{self, Read};

use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::wire::rs485::{Fed, Frame, Receiver};
use myactuator_protocol_core::{Firmware, Target};

fn main() -> Result<(), Box<dyn Error>> {
    let mut firmware = Firmware::V4_3;
    let mut is_rs485 = false;
    for argument in env::args().skip(1) {
        match argument.as_str() {
            "rs485" => is_rs485 = true,
            name => firmware = name.parse::<Firmware>().map_err(|error| error.to_string())?,
        }
    }
    let watched = if is_rs485 { watch_rs485(firmware) } else { watch_can(firmware) };
    Ok(watched?)
}

/// Lines as `candump -L` writes them: `(1436509052.249713) can0 141#9200000000000000`.
fn watch_can(firmware: Firmware) -> io::Result<()> {
    for line in io::stdin().lines() {
        let line = line?;
        let (before, text) = line.trim().rsplit_once(' ').unwrap_or(("", line.trim()));
        let Some(frame) = candump_frame(text) else {
            println!("{line}: no frame");
            continue;
        };
        match can::decode(&frame) {
            Received::Packet(packet) => println!("{before} {}", packet.as_of(firmware)),
            other => println!("{before} {text}: {other:?}"),
        }
    }
    Ok(())
}

fn candump_frame(text: &str) -> Option<SimpleFrame> {
    let (id, data) = text.split_once('#')?;
    let raw = u32::from_str_radix(id, 16).ok()?;
    let id: Id = match id.len() {
        3 => StandardId::new(u16::try_from(raw).ok()?)?.into(),
        _ => ExtendedId::new(raw)?.into(),
    };
    if let Some(length) = data.strip_prefix('R') {
        return SimpleFrame::new_remote(id, length.parse().unwrap_or(0));
    }
    let pairs = (0..data.len()).step_by(2).map(|at| data.get(at..at + 2));
    let bytes = pairs.map(|pair| u8::from_str_radix(pair?, 16).ok());
    SimpleFrame::new(id, &bytes.collect::<Option<Vec<_>>>()?)
}

/// The bytes of a serial port that listens to the line.
fn watch_rs485(firmware: Firmware) -> io::Result<()> {
    let mut receiver = Receiver::new();
    let mut command: Option<Frame> = None;
    for byte in io::stdin().lock().bytes() {
        match receiver.feed(byte?) {
            Fed::Wanting => {}
            Fed::Discarded { bytes, fault } => println!("bytes discarded: {bytes} ({fault})"),
            Fed::Frame(frame) => {
                // Commands and replies look alike here: what could be the reply to the last command
                // counts as that. So does, wrongly, a command that is sent again for want of a reply.
                let reply =
                    frame.as_reply().filter(|_| command.is_some_and(|c| answers(&c, &frame)));
                command = match (reply, command) {
                    (None, _) => Some(frame),
                    (Some(_), Some(Frame { address: Target::All, .. })) => command,
                    (Some(_), _) => None,
                };
                println!("{}", reply.unwrap_or_else(|| frame.as_command()).as_of(firmware));
            }
        }
    }
    Ok(())
}

fn answers(command: &Frame, frame: &Frame) -> bool {
    command.data[0] == frame.data[0]
        && (command.address == frame.address || command.address == Target::All)
}

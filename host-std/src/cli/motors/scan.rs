//! `myactuator scan`: which motors are on a bus.

use myactuator_host_std::open::{BusAddress, BusError};
use myactuator_host_std::port::PortError;
use myactuator_host_std::text::slcan::Rate;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ReadModel, ReadStatus1};
use myactuator_protocol_core::io::{CallError, Runner, bring_up};
use myactuator_protocol_core::master::{Failure, MotorSet};

use super::group::Group;
use super::hints::other_rates;
use super::on_bus::OnBus;
use super::session::{Session, say};
use crate::cli::{Outcome, Unfinished};

/// The rates of RS485 that the manual names (1.2), bit/s.
const LINE_RATES: [u32; 5] = [115_200, 500_000, 1_000_000, 1_500_000, 2_500_000];
/// The rates of CAN that motors can be set to (2.32.4).
const CAN_RATES: [Rate; 2] = [Rate::Mbit1, Rate::Kbit500];

/// Find out which motors are on a bus: ids 1 to 32 are asked
///
/// Exit status: 0 a motor answers, 1 none does, 2 wrong usage.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    on: OnBus,
    /// Try every bit rate that motors can have, on RS485 and SLCAN. On a CAN bus a wrong rate disturbs all traffic: let
    /// no motor run meanwhile.
    #[arg(long)]
    all_rates: bool,
    /// Print one JSON object a motor, with a note if two seem to have its id.
    #[arg(long)]
    json: bool,
}

/// The motors that were found, or why the bus carries nothing at this rate.
type Found = Result<MotorSet, BusError>;

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let bus = arguments.on.to_look()?;
    let addresses = if arguments.all_rates { at_each_rate(&bus)? } else { vec![bus] };
    let mut anybody = false;
    for address in addresses {
        let config = address.config();
        let (mut session, found) = match Session::open_with(address.clone(), config) {
            Ok(mut session) => {
                if !arguments.all_rates {
                    session.note_slow_adapter();
                }
                let found = look(&mut session)?;
                (Some(session), found)
            }
            Err(error) => (None, Err(error)),
        };
        match &found {
            Err(error) if !(arguments.all_rates && is_of_rate(error)) => {
                return Err(Unfinished::Failed(error.to_string()));
            }
            _ if arguments.all_rates && !arguments.json => say(&told_of_rate(&address, &found))?,
            _ => {}
        }
        if let (Some(session), Ok(motors)) = (&mut session, found) {
            if motors.is_empty() && !arguments.all_rates {
                return Err(session.nobody());
            }
            anybody |= !motors.is_empty();
            session.note_garbled();
            for motor in motors.iter() {
                say(&describe(session, motor, arguments.json)?)?;
            }
        }
    }
    if anybody {
        return Ok(());
    }
    Err(Unfinished::Failed(
        "no motor answers at any bit rate: check the motors' power and the wiring".to_owned(),
    ))
}

/// Whether the rate may be the cause, so that others are tried.
const fn is_of_rate(error: &BusError) -> bool {
    error.is_outage() || matches!(error, BusError::Port(PortError::LineRate { .. }))
}

fn look(session: &mut Session) -> Outcome<Found> {
    match bring_up::scan(&mut session.master, MotorSet::ALL, |_, _| {}) {
        Ok(motors) => Ok(Ok(motors)),
        Err(CallError::Bus(error)) if error.is_outage() => Ok(Err(error)),
        Err(error) => Err(Unfinished::of_scan(error)),
    }
}

fn told_of_rate(address: &BusAddress, found: &Found) -> String {
    let told = match found.as_ref().map(|motors| motors.len()) {
        Ok(0) => "no motor",
        Ok(1) => "1 motor",
        Ok(count) => &format!("{count} motors"),
        Err(BusError::Port(PortError::LineRate { .. })) => "the serial port cannot run at it",
        Err(_) => "no motor, the bus carries nothing",
    };
    format!("{} bit/s: {told}", address.bit_rate().unwrap_or_default())
}

/// The line about a motor that answers. If two motors seem to have its id, a note says so; the JSON has the note, too.
fn describe(session: &mut Session, motor: MotorId, as_json: bool) -> Outcome<String> {
    let model = match session.master.ask(motor, ReadModel) {
        Ok(model) => Ok(Group::default().and(&model)),
        // Firmware V4.4 does not answer this.
        Err(CallError::Failed { failure: Failure::NoReply, .. }) => Ok(Group::default()),
        Err(error) => Err(error.into()),
    };
    let status = session.ask(motor, ReadStatus1);
    let read = model.and_then(|model| Ok(model.and(&status?)));
    // A motor that does not always answer is reported below.
    let mut note = session.note_shared(motor);
    let (group, line) = match read {
        Ok(group) => (group.clone(), group.to_string()),
        Err(Unfinished::Failed(sentence)) => {
            let unsure =
                format!("answers, but not always ({sentence}); do two motors have this id?");
            note.get_or_insert_with(|| unsure.clone());
            (Group::default(), unsure)
        }
        Err(other) => return Err(other),
    };
    if !as_json {
        return Ok(format!("motor {motor}: {line}"));
    }
    Ok(session.json(motor, &[group], note).to_string())
}

/// The same bus at each rate that motors can have.
fn at_each_rate(bus: &BusAddress) -> Outcome<Vec<BusAddress>> {
    match bus {
        BusAddress::Rs485 { path, echo, .. } => Ok(LINE_RATES
            .map(|bit_rate| BusAddress::Rs485 { path: path.clone(), bit_rate, echo: *echo })
            .to_vec()),
        BusAddress::Slcan { path, .. } => {
            Ok(CAN_RATES.map(|rate| BusAddress::Slcan { path: path.clone(), rate }).to_vec())
        }
        BusAddress::SocketCan { .. } | BusAddress::Simulated { .. } => {
            Err(Unfinished::Usage(format!("--all-rates: {}", other_rates(bus))))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_host_std::sim::Fleet;
    use serde_json::Value;

    #[test]
    fn json_carries_the_note_that_two_motors_have_an_id() {
        let object = |fleet: Fleet| -> Value {
            let fleet = fleet.on_can(1_000_000).unwrap();
            let line = describe(&mut Session::on(&fleet), MotorId::MIN, true).unwrap();
            serde_json::from_str(&line).unwrap()
        };
        let shared = object(Fleet::new(2).all_with_id(MotorId::MIN));
        assert_eq!(shared["note"], "two motors seem to have id 1: connect only one of them");
        let alone = object(Fleet::new(1));
        assert_eq!((&alone["model"], alone.get("note")), (&"X6-60".into(), None));
    }

    fn rates(bus: &str) -> Vec<String> {
        let buses = at_each_rate(&bus.parse().unwrap()).unwrap();
        buses.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn every_rate_of_the_manual_is_tried_on_the_same_port() {
        assert_eq!(
            rates("rs485:/dev/ttyUSB0@115200,echo"),
            [115_200, 500_000, 1_000_000, 1_500_000, 2_500_000]
                .map(|rate| format!("rs485:/dev/ttyUSB0@{rate},echo"))
        );
        assert_eq!(
            rates("slcan:/dev/ttyACM0@1000000"),
            ["slcan:/dev/ttyACM0@1000000", "slcan:/dev/ttyACM0@500000"]
        );
    }
}

//! Errors with a hint: the likely cause, and the command to type.

use myactuator_host_std::open::{BusAddress, BusError};
use myactuator_protocol_core::command::ErrorFlags;
use myactuator_protocol_core::io::bring_up::BringUpError;
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::Failure;
use myactuator_protocol_core::{MotorId, Target};

use super::session::Session;
use crate::cli::{Outcome, Unfinished, report};

/// Bytes arrived on RS485 that cannot be understood.
const NO_FRAME: &str = "bytes arrive that are no valid frame (two motors with one id? connect only one of them; or \
                        another bit rate, or noise on the line)";

/// How to try other bit rates on this bus.
pub(super) fn other_rates(address: &BusAddress) -> String {
    match address {
        BusAddress::Rs485 { .. } | BusAddress::Slcan { .. } => {
            format!("'myactuator scan --all-rates --bus {address}' tries the others")
        }
        BusAddress::SocketCan { interface } => format!(
            "the bit rate of {interface} is set outside this program: scan again after 'sudo ip link set {interface} down' \
             and 'sudo ip link set {interface} up type can bitrate 500000', or 1000000"
        ),
        BusAddress::Simulated { .. } => {
            "all simulated motors have the rate of their bus".to_owned()
        }
    }
}

impl Session {
    /// The command to type for this on this bus.
    pub(super) fn hint(&self, subcommand: &str, whom: impl Into<Target>) -> String {
        let whom = match whom.into() {
            Target::Motor(motor) => motor.to_string(),
            Target::All => "all".to_owned(),
        };
        format!("'myactuator {subcommand} --bus {} --id {whom}'", self.address)
    }

    /// How to try other bit rates.
    pub(super) fn other_rates(&self) -> String {
        other_rates(&self.address)
    }

    /// Why a call has no answer, with the likely cause.
    pub(super) fn failed(&mut self, error: CallError<BusError>) -> Unfinished {
        match error {
            CallError::Failed { failure: Failure::NoReply, .. } if self.has_garbled() => {
                Unfinished::Failed(format!("{error}; {NO_FRAME}{}", self.other_adapter()))
            }
            CallError::Failed { failure: Failure::NoReply, .. } => Unfinished::Failed(format!(
                "{error}{}{}",
                self.echo_told_of(),
                self.other_adapter()
            )),
            error => error.into(),
        }
    }

    /// Why something was not done with a motor, with the likely cause.
    pub(super) fn not_brought_up(&mut self, error: BringUpError<BusError>) -> Unfinished {
        match error {
            BringUpError::NotThere(_) => Unfinished::Failed(format!(
                "{error}: check its power, the wiring and what may have changed with the restart, its id \
                 ('myactuator scan --bus {}') and the bit rate ({})",
                self.address,
                self.other_rates()
            )),
            BringUpError::Call(error) => self.failed(error),
            // The second answer may be one that counted as the echo.
            BringUpError::IdShared(_) => {
                Unfinished::Failed(format!("{error}{}", self.echo_told_of()))
            }
            error => error.into(),
        }
    }

    /// Whether this motor was heard on this bus, so that it exists.
    pub(super) fn has_heard(&mut self, motor: MotorId) -> bool {
        self.master.master().health(motor).last_seen.is_some()
    }

    /// Says that the adapter of a serial port may be of the other kind, if no motor was heard.
    fn other_adapter(&mut self) -> String {
        if MotorId::all().any(|motor| self.has_heard(motor)) {
            return String::new();
        }
        match &self.address {
            BusAddress::Rs485 { path, .. } => {
                format!("; if the adapter speaks SLCAN, use slcan:{}@1000000", path.display())
            }
            BusAddress::Slcan { path, .. } => {
                format!("; if the adapter is for RS485, use rs485:{}@115200", path.display())
            }
            _ => String::new(),
        }
    }

    /// Fails if there are errors, and says what to do about them.
    pub(super) fn healthy(&self, motor: MotorId, errors: ErrorFlags) -> Outcome {
        if errors.is_empty() {
            return Ok(());
        }
        let remedy = if errors.needs_restart() {
            let reset = self.hint("reset", motor);
            format!(
                "remove the cause, then restart the motor: {reset} (0x76), or switch its supply off and on"
            )
        } else {
            "it runs again on its own once the cause is gone".to_owned()
        };
        Err(Unfinished::Failed(format!("motor {motor} reports an error ({errors}): {remedy}")))
    }

    /// Says that no motor answers, and what to check.
    pub(super) fn nobody(&mut self) -> Unfinished {
        let other_adapter = self.other_adapter();
        Unfinished::Failed(format!(
            "no motor answers on {}{}: check the motors' power, the wiring and the bit rate ({}){other_adapter}",
            self.address,
            self.garbled(),
            self.other_rates()
        ))
    }

    /// Says that garbled bytes have arrived, if they have.
    pub(super) fn garbled(&self) -> String {
        if self.has_garbled() { format!(", but {NO_FRAME}") } else { String::new() }
    }

    /// The same, as a note.
    pub(super) fn note_garbled(&self) {
        if self.has_garbled() {
            report("note", NO_FRAME);
        }
    }

    /// Sends something to all motors. Their answers collide on a line, which says nothing about the line.
    pub(super) fn tell_all<T>(&mut self, send: impl FnOnce(&mut Self) -> T) -> T {
        let garbled = self.master.bus.garbled();
        let result = send(self);
        self.garbled_by_all += self.master.bus.garbled() - garbled;
        result
    }

    const fn has_garbled(&self) -> bool {
        self.master.bus.garbled() != self.garbled_by_all
    }

    /// A likely cause of a missing answer if the address says ',echo': an answer that equals its command counts as the
    /// echo, even if the adapter does not echo.
    pub(super) const fn echo_told_of(&self) -> &'static str {
        match self.address {
            BusAddress::Rs485 { echo: true, .. } => {
                " (if the adapter does not echo what it sends, leave out ',echo')"
            }
            _ => "",
        }
    }
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::open::AnyMaster;
    use myactuator_host_std::sim::Fleet;
    use myactuator_protocol_core::command::ReadStatus1;

    use super::super::simulated::echo_is_missing;
    use super::*;

    #[test]
    fn an_error_of_level_one_asks_for_a_restart_and_one_of_level_two_for_patience() {
        let session = Session::on(&Fleet::new(1).on_can(1_000_000).unwrap());
        let message = |errors| match session.healthy(MotorId::MIN, errors) {
            Err(Unfinished::Failed(sentence)) => sentence,
            other => panic!("{other:?}"),
        };
        assert_eq!(session.healthy(MotorId::MIN, ErrorFlags::empty()), Ok(()));
        let stall = message(ErrorFlags::STALL);
        assert!(stall.starts_with("motor 1 reports an error (motor stalled): "), "{stall}");
        let reset = "restart the motor: 'myactuator reset --bus sim:1 --id 1' (0x76)";
        assert!(stall.contains(reset), "{stall}");
        let low = message(ErrorFlags::UNDER_VOLTAGE);
        assert!(low.contains("on its own") && !low.contains("restart"), "{low}");
    }

    /// The error of a question to this motor, which does not answer.
    fn error_of_question(fleet: &Fleet, id: u8) -> String {
        let fleet = fleet.on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        let outcome = session.standing(MotorId::new(id).unwrap());
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        message
    }

    #[test]
    fn invalid_bytes_of_two_motors_that_answer_at_once_are_reported() {
        let both = error_of_question(&Fleet::new(2).all_with_id(MotorId::MIN), 1);
        assert!(both.ends_with(NO_FRAME), "{both}");
        assert!(both.contains("two motors with one id") && both.contains("noise"), "{both}");
        let nobody = error_of_question(&Fleet::new(1), 2);
        assert!(nobody.ends_with("is this its id?"), "{nobody}");
    }

    #[test]
    fn serial_port_without_any_reply_hints_at_the_other_kind_of_adapter() {
        for (address, other) in [
            ("rs485:/dev/ttyUSB0@115200", "speaks SLCAN, use slcan:/dev/ttyUSB0@1000000"),
            ("slcan:/dev/ttyACM0@500000", "is for RS485, use rs485:/dev/ttyACM0@115200"),
        ] {
            let fleet = Fleet::new(1).on_rs485(115_200).unwrap();
            let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
            session.address = address.parse().unwrap();
            let other = format!("; if the adapter {other}");
            let nobody = session.nobody();
            let silent = session.standing(MotorId::new(2).unwrap());
            session.standing(MotorId::MIN).unwrap();
            let later = session.standing(MotorId::new(2).unwrap());
            for (outcome, is_told) in [(Err(nobody), true), (silent, true), (later, false)] {
                let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
                assert_eq!(message.ends_with(&other), is_told, "{message}");
            }
        }
    }

    #[test]
    fn missing_configured_echo_is_named_when_a_reply_was_taken_for_it() {
        let mut session = echo_is_missing();
        session.ask(MotorId::MIN, ReadStatus1).unwrap();
        let outcome = session.release_brake(MotorId::MIN);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.contains("leave out ',echo'"), "{message}");
        assert!(message.ends_with("its brake may be open even so"), "{message}");
    }
}

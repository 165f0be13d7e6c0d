//! Events as sentences for people: what happened, why, and what to do where that helps.

use core::fmt::{self, Display, Formatter};

use super::faults::needs_restart;
use crate::command::AnyCommand;
use crate::command::print::raw;
use crate::firmware::Firmware;

use super::{Event, IgnoreReason, Limit, NotRunReason};

/// What the drive did, without its name: "does not run torque (0xA1): its brake is locked …".
impl Display for Event {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ignored { packet, reason } => {
                let means = |&firmware: &Firmware| AnyCommand::decode(packet, firmware).is_ok();
                if Firmware::ALL.iter().any(means) {
                    return write!(f, "ignores a {packet}: {reason}");
                }
                // Its own text would also say that it means nothing.
                write!(f, "ignores a {}: ", packet.channel)?;
                raw(f, &packet.data)?;
                write!(f, ": {reason}")
            }
            Self::NotRun { opcode, reason } => {
                write!(f, "answers {opcode} and does not run it: {reason}")
            }
            Self::FaultRaised(errors) => write!(f, "cuts its output for an error: {errors}"),
            Self::FaultCleared(errors) => write!(f, "has this error no more: {errors}"),
            Self::ProtectionTripped => f.write_str(
                "cuts its output and locks its brake: no command came within its time-out (0xB3)",
            ),
            Self::ProtectionRecovered => {
                f.write_str("runs again: communication is steady (0xB3)")
            }
            Self::Reset => f.write_str("restarts, as it was told to (0x76)"),
            Self::Started => f.write_str("has started and hears commands"),
            Self::PoweredOff => f.write_str("has lost its supply"),
            Self::BitRateChanged(code) => {
                write!(f, "speaks at another bit rate from now on (0xB4, code {})", code.raw())
            }
            Self::MemoryFailed => f.write_str(
                "could not read or write its memory: what was to be stored is not, and it is not answered",
            ),
            Self::Limited(limit) => write!(f, "does less than it was told to: {limit}"),
            Self::Unlimited(Limit::CommandTorque) => {
                f.write_str("is below its command's torque limit again")
            }
            Self::Unlimited(Limit::StallCurrent) => {
                f.write_str("is below its largest current again")
            }
            Self::Unlimited(Limit::Temperature) => {
                f.write_str("is below the current again that its heat leaves it")
            }
            Self::Unlimited(Limit::Voltage) => f.write_str("has voltage enough again"),
            Self::TargetLimited { opcode, asked_deg, limit_deg } => write!(
                f,
                "goes to {limit_deg:.2} deg and not to {asked_deg:.2} deg, as {opcode} says: its angle is limited \
                 (0x20, functions 6 and 7)"
            ),
        }
    }
}

impl Display for IgnoreReason {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Malformed(error) => return error.fmt(f),
            Self::UnknownCommand => "its firmware has no such command",
            Self::Starting => "it is starting and hears nothing yet; send it again later",
            Self::PoweredOff => "it has no supply",
            Self::IdFilter => {
                "its filter keeps commands to all away (0x20, function 2); name the motor, or switch the filter off"
            }
            Self::CanOnly(_) => "this command exists on CAN only",
            Self::UnknownCode(_) => "the manual has no such index or code for this bus",
            Self::AnothersReply => "it takes it for another drive's reply, which looks the same",
            Self::ReportedActively(_) => {
                "it reports this by itself (0xB6) and so is not asked; switch that off to ask"
            }
        })
    }
}

impl Display for NotRunReason {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Fault(errors) => {
                let remedy = if needs_restart(*errors) {
                    "restart it (0x76) when its cause is gone"
                } else {
                    "it goes with its cause"
                };
                return write!(f, "an error stands ({errors}); {remedy}");
            }
            Self::CommunicationLost => {
                "communication was lost (0xB3) and is not steady yet; go on sending commands in time"
            }
            Self::BrakeLocked => {
                "its brake is locked; open it (0x77), or send a speed or a position, which opens it"
            }
            Self::NotSingleTurn => {
                "it keeps its turns over power-off (0x20, function 4); switch that off, or send another position command"
            }
            Self::NotShutDown => "it changes this only while its output is off; shut it down first (0x80)",
        })
    }
}

impl Display for Limit {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CommandTorque => "the command's own torque limit (0xA2, 0xA9)",
            Self::StallCurrent => "it gives its largest current; the load is too heavy or the way too steep",
            Self::Temperature => {
                "it is hot and gives less current; let it cool, or ask less of it"
            }
            Self::Voltage => {
                "its supply's voltage drives no more current at this speed; go slower, or raise the voltage"
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;
    use crate::command::{ErrorFlags, Reset};
    use crate::id::MotorId;
    use crate::opcode::Opcode;
    use crate::packet::Packet;

    #[test]
    fn events_are_sentences_with_a_reason_and_a_remedy() {
        let not_run = |reason| Event::NotRun { opcode: Opcode::Torque, reason }.to_string();
        assert_eq!(
            not_run(NotRunReason::BrakeLocked),
            "answers torque (0xA1) and does not run it: its brake is locked; open it (0x77), or send a speed or \
             a position, which opens it"
        );
        // 8.2: a stall ends only with a restart, an over-speed on its own.
        assert!(
            not_run(NotRunReason::Fault(ErrorFlags::STALL))
                .ends_with("(motor stalled); restart it (0x76) when its cause is gone")
        );
        assert!(
            not_run(NotRunReason::Fault(ErrorFlags::OVER_SPEED))
                .ends_with("it goes with its cause")
        );
        // 8.2 gives these two no level; by `decisions` heat goes on its own.
        for (error, remedy) in [
            (ErrorFlags::COMPONENT_OVER_TEMPERATURE, "it goes with its cause"),
            (ErrorFlags::ENCODER_DATA, "restart it (0x76) when its cause is gone"),
        ] {
            assert!(not_run(NotRunReason::Fault(error)).ends_with(remedy), "{error}");
        }
        let packet = Reset.packet(MotorId::MIN);
        assert_eq!(
            Event::Ignored { packet, reason: IgnoreReason::PoweredOff }.to_string(),
            "ignores a command to motor 1: reset (0x76): it has no supply"
        );
        // 70 000 °/s²: 2.6 ends at 60 000.
        let packet = Packet { data: [0x43, 0, 0, 0, 0x70, 0x11, 1, 0], ..packet };
        let error = AnyCommand::decode(&packet, Firmware::V4_3).unwrap_err();
        assert_eq!(
            Event::Ignored { packet, reason: error.into() }.to_string(),
            std::format!("ignores a command to motor 1: raw 43 00 00 00 70 11 01 00: {error}")
        );
    }
}

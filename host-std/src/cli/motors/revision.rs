//! Which revision of the protocol a motor speaks: the one that the user gives, else that of its version date. It is
//! never guessed: scales of V4.3 sent to a V4.4 have given 2.5 times the torque.

use myactuator_protocol_core::command::{MotionRanges, ReadVersionDate, VersionDate};
use myactuator_protocol_core::{Firmware, MotorId, Opcode};

use super::session::Session;
use crate::cli::{Outcome, Unfinished, arguments as parse, report};

/// What the user says about a motor.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct MotorRevision {
    /// The revision of the protocol that the motor speaks, v4.3 or v4.4 [default: that of its version date (0xB2), if
    /// that is a known one].
    #[arg(long, global = true, value_parser = parse::firmware)]
    pub(super) firmware: Option<Firmware>,
    /// The scales of its motion mode: the largest position, velocity, kp, kd and torque, as in 12.5,45,500,5,24. Wrong
    /// scales multiply the torque [default: the firmware's own, if it has them].
    #[arg(long, global = true, value_parser = parse::ranges)]
    pub(super) ranges: Option<MotionRanges>,
}

/// The firmware of a motor, or its version date if that is not that of a known firmware.
pub(super) type Found = Result<Firmware, VersionDate>;

impl MotorRevision {
    /// The firmware that was given, else that of the motor's version date. If both are known they must agree.
    pub(super) fn find(&self, session: &mut Session, motor: MotorId) -> Outcome<Found> {
        let date = session.ask(motor, ReadVersionDate)?.version_date;
        match (self.firmware, Firmware::of_version_date(date)) {
            (Some(given), Some(known)) if given != known => Err(Unfinished::Failed(format!(
                "motor {motor} reports version date {}, which is {known}'s, but --firmware {given} \
                 was given",
                date.raw()
            ))),
            (Some(firmware), _) | (None, Some(firmware)) => Ok(Ok(firmware)),
            (None, None) => Ok(Err(date)),
        }
    }

    /// Fails if the motor's firmware does not have the command, whatever firmware was given. If the firmware is not
    /// known, prints a note.
    pub(super) fn check_has(
        &self,
        session: &mut Session,
        motor: MotorId,
        opcode: Opcode,
    ) -> Outcome {
        let in_all = Firmware::ALL.iter().all(|firmware| opcode.is_in(*firmware));
        if in_all {
            return Ok(());
        }
        match self.find(session, motor)? {
            Ok(firmware) if opcode.is_in(firmware) => {}
            Ok(firmware) => {
                let why = parse::lacks(opcode, firmware);
                return Err(Unfinished::Failed(format!("motor {motor} speaks {firmware}: {why}")));
            }
            Err(date) => report(
                "note",
                format!(
                    "motor {motor} reports version date {}, which is not that of a known firmware: it \
                     may know {opcode} with another layout, or not at all",
                    date.raw()
                ),
            ),
        }
        Ok(())
    }

    /// The scales that were given, else those of the motor's firmware.
    pub(super) fn scales(&self, session: &mut Session, motor: MotorId) -> Outcome<MotionRanges> {
        let found = self.find(session, motor)?;
        if let Some(ranges) = self.ranges {
            return match found {
                Ok(firmware) if firmware.motion_ranges().is_some_and(|own| own != ranges) => {
                    Err(Unfinished::Failed(format!(
                        "motor {motor} speaks {firmware}, which has scales of its own, and --ranges \
                         differs from them: wrong scales multiply its torque, so nothing was sent"
                    )))
                }
                _ => Ok(ranges),
            };
        }
        let firmware = found.map_err(|date| {
            Unfinished::Failed(format!(
                "motor {motor} reports version date {}, which is not that of a known firmware: \
                 wrong scales multiply its torque, so nothing was sent; give --firmware v4.3 if \
                 its manual says so, or its own scales by --ranges",
                date.raw()
            ))
        })?;
        firmware.motion_ranges().ok_or_else(|| {
            let missing = parse::RANGES_ARE_MISSING;
            Unfinished::Failed(format!("motor {motor} speaks {firmware}: {missing}"))
        })
    }
}

//! What the application reports.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ErrorFlags, ModelName, VersionDate};
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::units::Angle;

use crate::board::RestartCause;

/// A line of the log.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Report {
    /// The firmware has started.
    Started {
        /// Why.
        cause: RestartCause,
    },
    /// The application has entered another state.
    State(StateName),
    /// A motor answers.
    Found {
        /// Its id.
        motor: MotorId,
        /// Its model.
        model: ModelName,
        /// The date of its software.
        version_date: VersionDate,
    },
    /// A motor is ready to run.
    Ready {
        /// The motor.
        motor: MotorId,
        /// Where its shaft is.
        angle: Angle,
    },
    /// What made the application stop the motors, or not start them.
    Trouble(Trouble),
    /// Nothing at these ids has confirmed the stop, and nothing has answered there since the start. As far as is known
    /// no motor has these ids. If one of them belongs to a motor that may have moved before the start, after a crash
    /// for example: cut its power.
    Unheard {
        /// The ids.
        motors: MotorSet,
    },
    /// The stop is over.
    Stopped {
        /// Motors that are there and have not confirmed it: cut their power.
        unconfirmed: MotorSet,
    },
    /// Once a second while the motors run. What the board cannot measure is 0: see [`Usage`](crate::Usage).
    Second {
        /// Cycles since the motors began to run.
        cycles: u32,
        /// How many of them began more than half a period late.
        overruns: u32,
        /// Set-points that the slowest motor has answered in this second.
        slowest: u16,
        /// Commands that got no reply in time since the motors began to run, of all motors.
        lost: u32,
        /// The deepest use of the stack since the start, in bytes.
        stack: u32,
        /// The most that was queued for the loop at one time since the start: bytes or frames.
        queued: u32,
        /// What came from the bus and was lost on the board since the start: bytes or frames.
        dropped: u32,
    },
    /// Once a second while the motors run, for each motor.
    Measured {
        /// The motor.
        motor: MotorId,
        /// Where its shaft is.
        angle: Angle,
    },
}

/// Why the motors are stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Trouble {
    /// The button was pressed.
    Button,
    /// No motor answers.
    NoMotor,
    /// A motor's firmware is not the one that this application is set up for. It is not known what that firmware would
    /// do with the same commands.
    OtherFirmware {
        /// The motor.
        motor: MotorId,
        /// The date of its software.
        version_date: VersionDate,
    },
    /// A motor reports errors, so it holds nothing: its brake is told to lock. Reported once between two presses of the
    /// button, also while the motors are stopped.
    Errors {
        /// The motor.
        motor: MotorId,
        /// Which.
        flags: ErrorFlags,
    },
    /// A motor is too far from zero for its movement.
    OutOfRange {
        /// The motor.
        motor: MotorId,
    },
    /// A motor that is required, or has answered before, does not answer, or its answer cannot be read. If you take a
    /// motor away on purpose, switch the board off and on, so that it forgets the motor. While shafts are checked, it
    /// means that the motor confirms its stops, and does not say whether its shaft stands or cannot be told to hold:
    /// its load may fall.
    Silent {
        /// The motor.
        motor: MotorId,
    },
    /// A motor has restarted, so that it may have lost its turns, or it let go otherwise right before the button was
    /// pressed.
    Restarted {
        /// The motor.
        motor: MotorId,
    },
    /// A motor has lost its master and cut its output.
    LostMaster {
        /// The motor.
        motor: MotorId,
    },
    /// A motor's shaft turns although its brake was told to lock. So does the shaft of a motor with a load and without
    /// a brake once its output is off. The motor is told to hold again.
    Turns {
        /// The motor.
        motor: MotorId,
    },
    /// The master does not take a command for a motor.
    Refused {
        /// The motor.
        motor: MotorId,
    },
    /// The bus driver reports an error, or none of several motors is heard any more.
    BusDown,
}

/// The states of the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StateName {
    /// The motors are being stopped.
    Stopping,
    /// All wait for the button.
    Stopped,
    /// Each motor is asked for its firmware, model and errors.
    Finding,
    /// Protections and error reports are set, brakes are opened, and the shafts' positions are read.
    Preparing,
    /// The motors move.
    Running,
    /// Brakes are locked and outputs switched off. Then the shafts are checked.
    ShuttingDown,
    /// A shutdown was broken off, or a motor turns behind its locked brake, which also ends a start. The shafts of the
    /// motors whose brakes were told to lock, or have locked, are checked, and the motors whose shafts turn are told to
    /// hold again.
    Looking,
}

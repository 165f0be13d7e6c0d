//! What the application reports.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ErrorFlags, ModelName, VersionDate};
use myactuator_protocol_core::master::MotorSet;
use myactuator_protocol_core::units::Angle;

use crate::board::RestartCause;

/// Something worth telling.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Report {
    /// The firmware has started.
    Started {
        /// Why.
        cause: RestartCause,
    },
    /// The application went on to another state.
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
    /// A motor is ready to run from here.
    Ready {
        /// The motor.
        motor: MotorId,
        /// Where its shaft is.
        angle: Angle,
    },
    /// What made the application stop the motors, or not start them.
    Trouble(Trouble),
    /// Nobody has confirmed the stop at these ids, and nobody has answered there since the start: as far as
    /// is known, nobody has them. Only if a motor with one of them may have moved before the start, as
    /// after a crash: cut its power.
    Unheard {
        /// The ids.
        motors: MotorSet,
    },
    /// The stop is over.
    Stopped {
        /// The motors that are there and have not confirmed it: cut their power.
        unconfirmed: MotorSet,
    },
    /// Every second while the motors run. What the board cannot tell is 0: see
    /// [`Usage`](crate::Usage).
    Second {
        /// Cycles since the motors run.
        cycles: u32,
        /// Cycles of these that began more than half a period late.
        overruns: u32,
        /// Set-points that were answered in this second, of the motor with the fewest.
        slowest: u16,
        /// Commands without a reply in time since the start, of all motors.
        lost: u32,
        /// The deepest that the stack has been since the start, in bytes.
        stack: u32,
        /// The most that has waited at once for the loop since the start: bytes or frames.
        queued: u32,
        /// What came from the bus and was lost on the board since the start: bytes or frames.
        dropped: u32,
    },
    /// Every second while the motors run, for each.
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
    /// A motor's firmware is not the one that this application is set up for: what it would make of
    /// the same commands is not known.
    OtherFirmware {
        /// The motor.
        motor: MotorId,
        /// The date of its software.
        version_date: VersionDate,
    },
    /// A motor reports errors, so that it holds nothing: its brake is told to lock. Told once from one press of the
    /// button to the next, also while the motors are stopped.
    Errors {
        /// The motor.
        motor: MotorId,
        /// Which.
        flags: ErrorFlags,
    },
    /// A motor is too far from zero to be moved from where it is.
    OutOfRange {
        /// The motor.
        motor: MotorId,
    },
    /// A motor that is required, or has answered before, does not answer, or what it answers cannot be
    /// read. One that was taken away on purpose is forgotten when the board is switched off and on.
    Silent {
        /// The motor.
        motor: MotorId,
    },
    /// A motor has restarted: its turns may be lost.
    Restarted {
        /// The motor.
        motor: MotorId,
    },
    /// A motor had lost its master and has cut its output.
    LostMaster {
        /// The motor.
        motor: MotorId,
    },
    /// A motor's shaft turns although its brake was told to lock, as one does that has no brake and a load once
    /// its output is off. It is told to hold again.
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
    /// Waits for the button.
    Stopped,
    /// Asks for each motor's firmware, model and errors.
    Finding,
    /// Sets protections and error reports, opens brakes, reads where the shafts are.
    Preparing,
    /// Moves the motors.
    Running,
    /// Locks brakes and switches outputs off, and looks whether the shafts stand then.
    ShuttingDown,
    /// A shutdown was broken off: looks whether the shafts stand behind the brakes that were told to lock, and has
    /// those that turn hold again.
    Looking,
}

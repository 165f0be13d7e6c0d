//! What a product would set.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{MotionRanges, VersionDate};
use myactuator_protocol_core::firmware::Firmware;
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, MaxSpeed, Milliseconds};

/// How the motors are moved: there and back. Each begins where it is when it gets ready.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Movement {
    /// In motion mode, which only CAN has.
    Motion {
        /// The scales of these motors' firmware.
        ranges: MotionRanges,
        /// Gain on the position error, N·m/rad.
        kp: f32,
        /// Gain on the velocity error, N·m·s/rad.
        kd: f32,
    },
    /// By positions (0xA4), on both buses.
    Position {
        /// The highest speed.
        max_speed: MaxSpeed,
    },
}

/// What a product would set.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// The ids that are searched. On RS485 each id without a motor occupies the line for 80 ms at 1 Mbit/s whenever it
    /// is stopped. With more than seven of them, a motor may hear too little to go on holding.
    pub search: MotorSet,
    /// Motors that must be there before any runs. They are searched, too.
    ///
    /// A motor that has answered anything since the firmware started must be there as well, whether it is named here or
    /// not. After a restart nothing else is known: an arm with a missing joint starts then, unless that joint is named
    /// here.
    pub required: MotorSet,
    /// The firmware that all of them must have.
    pub firmware: Firmware,
    /// A version date (0xB2) that is not known to be that firmware's, but that you have tried with everything that is
    /// set here, the scales of motion mode above all.
    pub tried_version: Option<VersionDate>,
    /// How they are moved.
    pub movement: Movement,
    /// How far they turn from where they get ready; to the other side if negative.
    pub amplitude: Angle,
    /// How long it takes there and back.
    pub period: Duration,
    /// The cycle: at most 10 ms with real motors. A shutdown and a check ask each motor one question in each cycle, so
    /// the longer it is, the further a load falls until it is caught.
    pub cycle: Duration,
    /// After how long without a command a motor cuts its output on its own (0xB3). 500 ms or more: if other motors do
    /// not confirm a stop, it may hear nothing for 400 ms.
    pub protection: Milliseconds,
    /// Whether motors are told to report errors on their own (0x20, function 3), which is faster than asking them in
    /// turn. Only on CAN: on RS485 such a report collides with whatever else is on the line.
    pub error_reports: bool,
    /// How motors are stopped.
    pub stop: StopKind,
}

impl Setup {
    /// Whether a motor with software of this date may be moved.
    pub(super) fn accepts(&self, version_date: VersionDate) -> bool {
        Firmware::of_version_date(version_date) == Some(self.firmware)
            || self.tried_version == Some(version_date)
    }

    /// The motors of ids 1 to 8 that are there, with firmware V4.3. They move there and back by 20 degrees within 2 s,
    /// with 1000 set-points a second; stopped, they hold. In motion mode, which only CAN has, they report errors on
    /// their own. If you move them by positions on CAN, you may set that, too.
    pub fn new(movement: Movement) -> Self {
        Self {
            search: MotorId::all().take(8).collect(),
            required: MotorSet::EMPTY,
            firmware: Firmware::V4_3,
            tried_version: None,
            movement,
            amplitude: Angle::from_raw(2_000),
            period: Duration::from_secs(2),
            cycle: Duration::from_millis(1),
            protection: Milliseconds::from_raw(500),
            error_reports: matches!(movement, Movement::Motion { .. }),
            stop: StopKind::Hold,
        }
    }
}

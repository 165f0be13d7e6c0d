//! What a product would set.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{MotionRanges, VersionDate};
use myactuator_protocol_core::firmware::Firmware;
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, MaxSpeed, Milliseconds};

/// How the motors are moved: there and back, each from the place where it is when it gets ready.
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
    /// By positions (0xA4), on either bus.
    Position {
        /// The fastest turning.
        max_speed: MaxSpeed,
    },
}

/// What a product would set.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Where motors are looked for. On RS485 an id that nobody has keeps the line for 80 ms at 1 Mbit/s
    /// whenever it is stopped: beside more than seven of them a motor may hear too little to go on holding.
    pub search: MotorSet,
    /// Motors that must be there for any to run; they are looked for, too. Whoever has answered anything
    /// since the firmware started must be there as well, whether it is named here or not; but after a
    /// restart nothing else is known, and then an arm whose joint is missing starts unless this names it.
    pub required: MotorSet,
    /// The firmware that all of them must have.
    pub firmware: Firmware,
    /// A version date (0xB2) that is not known to be that firmware's, and that whoever makes the product has
    /// tried with everything that stands here: the scales of motion mode above all.
    pub tried_version: Option<VersionDate>,
    /// How they are moved.
    pub movement: Movement,
    /// How far they turn away from where they are when they get ready; to the other side if it is negative.
    pub amplitude: Angle,
    /// How long it takes there and back.
    pub period: Duration,
    /// The cycle.
    pub cycle: Duration,
    /// After how long without a command a motor cuts its output by itself (0xB3): 500 ms or more, for
    /// beside motors that do not confirm a stop it may hear nothing for 400 ms.
    pub protection: Milliseconds,
    /// Whether motors are told to report errors by themselves (0x20, function 3), which tells sooner than
    /// asking them in turn does. Only on CAN: on RS485 such a report meets whatever else is on the line.
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

    /// Motors 1 to 8, those of them that are there, of firmware V4.3, moved to and fro by 20 degrees within
    /// 2 s, 1000 set-points a second; stopped, they hold still. In motion mode, which is on CAN, they report
    /// errors by themselves; who moves them by positions on CAN may set that, too.
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

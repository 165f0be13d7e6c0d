//! Short ways to make values that are known to be in range.

use myactuator_protocol_core::command::{AbsolutePosition, ForcePosition, Speed, Torque};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, Current, Gain, MaxSpeed, MaxTorque, SpeedTarget};
use myactuator_protocol_core::{Data, MotorId};

/// Standard gravity.
pub const GRAVITY_M_S2: f64 = 9.806_65;

/// What a drive sends that has lost its master.
pub const LOST_MASTER: Data = [0xF1, 0, 0, 0, 0, 0, 0, 0];

/// The id of a motor.
pub fn id(number: u8) -> MotorId {
    MotorId::new(number).expect("1 to 32")
}

/// A span of milliseconds.
pub const fn millis(count: u64) -> Duration {
    Duration::from_millis(count)
}

/// A speed to keep.
pub fn dps(dps: f32) -> SpeedTarget {
    SpeedTarget::from_dps(dps).unwrap()
}

/// An angle.
pub fn degrees(degrees: f32) -> Angle {
    Angle::from_degrees(degrees).unwrap()
}

/// A limit of the speed, in degrees per second.
pub fn up_to(dps: u16) -> MaxSpeed {
    MaxSpeed::from_raw(dps)
}

/// A limit of the torque, in percent of the rated current.
pub fn percent(percent: u8) -> MaxTorque {
    MaxTorque::from_raw(percent)
}

/// A gain of a loop.
pub fn gain(value: f32) -> Gain {
    Gain::new(value).unwrap()
}

/// 0xA1: this current.
pub fn push(current_a: f32) -> Torque {
    Torque { current: Current::from_amperes(current_a).unwrap() }
}

/// 0xA2: this speed, with all available torque.
pub fn turn(speed_dps: f32) -> Speed {
    Speed { max_torque: percent(0), speed: dps(speed_dps) }
}

/// 0xA4: to this angle, at no more than this speed.
pub fn go_to(angle_deg: f32, max_dps: u16) -> AbsolutePosition {
    AbsolutePosition { max_speed: up_to(max_dps), angle: degrees(angle_deg) }
}

/// 0xA9: to this angle, with no more than this percentage of the rated torque.
pub fn grip_at(angle_deg: f32, percent_of_rated: u8) -> ForcePosition {
    ForcePosition {
        max_torque: percent(percent_of_rated),
        max_speed: up_to(90),
        angle: degrees(angle_deg),
    }
}

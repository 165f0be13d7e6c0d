//! What a drive acts on: the motor, its sensors and its supply.

use crate::time::Duration;

/// What a drive puts out until the next control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Actuation {
    /// Torque current that the current loop wants, A. 0 while the output is off.
    pub current_a: f32,
    /// Whether the output stage is on. Off, the motor turns freely.
    pub output_on: bool,
    /// Whether the brake is being opened. A closed brake holds the shaft.
    pub brake_released: bool,
}

/// What a drive measures after a control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Measurement {
    /// Encoder position in pulses of the motor shaft, turns included, from the encoder's own zero.
    pub encoder_pulses: i64,
    /// Speed of the output shaft, degrees per second.
    pub speed_dps: f32,
    /// Torque current that flows, A.
    pub current_a: f32,
    /// Currents of the phases A, B and C, A.
    pub phase_currents_a: [f32; 3],
    /// Motor temperature, °C.
    pub motor_temperature_c: f32,
    /// Temperature of the output stage, °C.
    pub mos_temperature_c: f32,
    /// Supply voltage, V.
    pub supply_voltage_v: f32,
    /// Supply current, A; negative while the motor feeds back.
    pub supply_current_a: f32,
    /// Whether the encoder's data can be trusted.
    pub encoder_ok: bool,
}

/// A motor with its gearbox, load, encoder, brake and supply: real or simulated.
pub trait Plant {
    /// Applies `actuation` for `span`, then measures. A span of zero only measures.
    fn advance(&mut self, actuation: &Actuation, span: Duration) -> Measurement;
}

//! The true state, in JSON.

use myactuator_protocol_core::MotorId;
use serde::Serialize;

use super::request::Stuck;
use crate::sim::SimulatedDrive;
use crate::sim::plant::{Load, Supply};
use crate::text::error_name;

/// A bus, with the motors that were asked for.
#[derive(Clone, Debug, Serialize)]
pub(in crate::serve) struct BusState {
    pub(in crate::serve) bus: String,
    pub(in crate::serve) bit_rate: u32,
    pub(in crate::serve) traffic: Traffic,
    /// The supply that the motors share, if they do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::serve) supply: Option<Supply>,
    /// The voltage of that supply between the motors' cables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::serve) supply_voltage_v: Option<f64>,
    /// The first reason why mechanics have failed. The shafts that they led stand from then on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::serve) mechanics_failure: Option<String>,
    pub(in crate::serve) motors: Vec<MotorState>,
}

/// What was on the wire since serving began.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(in crate::serve) struct Traffic {
    /// Frames that were carried whole.
    pub(in crate::serve) frames: u64,
    /// Frames that went wrong.
    pub(in crate::serve) broken: u64,
    /// How long the wire was busy with either.
    pub(in crate::serve) busy_us: u64,
}

/// The true state of a motor, whatever its encoder and its drive say.
#[derive(Clone, Debug, Serialize)]
pub(in crate::serve) struct MotorState {
    /// The id that it started with, and the one that it listens to.
    motor: MotorId,
    id: MotorId,
    /// Its own, which need not be the bus's (0xB4).
    bit_rate: u32,
    /// Of the output shaft, turns included.
    angle_deg: f64,
    speed_dps: f64,
    /// The angle that its drive reports, from its own zero.
    reported_angle_deg: f64,
    current_a: f32,
    /// The torque of that current at the output shaft, before friction.
    torque_nm: f64,
    /// The torque of the load there.
    load_torque_nm: f64,
    /// Whether mechanics move the shaft, which then feels no load.
    led: bool,
    /// The torque of a hand there.
    push_nm: f64,
    motor_temperature_c: f32,
    mosfet_temperature_c: f32,
    supply_voltage_v: f32,
    supply_current_a: f32,
    errors: Vec<String>,
    /// The loop that runs, `null` for none.
    mode: Option<&'static str>,
    output_on: bool,
    /// The drive's last command to its brake.
    brake: Option<&'static str>,
    /// How the brake sticks, whatever its drive commands; `null` if it works.
    brake_stuck: Option<Stuck>,
    powered: bool,
    /// Whether it hears commands.
    running: bool,
    communication_lost: bool,
    /// Whether its cable is cut.
    cut: bool,
    load: Load,
    supply: Supply,
}

impl MotorState {
    pub(in crate::serve) fn of(
        motor: MotorId,
        drive: &SimulatedDrive,
        bus_rate: u32,
        cut: bool,
    ) -> Self {
        let (state, plant) = (drive.state(), drive.plant());
        let measured = state.measurement;
        let (angle_deg, speed_dps) = (plant.output_angle_deg(), plant.output_speed_dps());
        Self {
            motor,
            id: drive.id(),
            bit_rate: drive.bit_rate().unwrap_or(bus_rate),
            angle_deg,
            speed_dps,
            reported_angle_deg: state.angle_deg,
            current_a: measured.current_a,
            torque_nm: plant.parameters().motor.torque_constant_nm_per_a
                * f64::from(measured.current_a),
            load_torque_nm: if plant.is_led() {
                0.0
            } else {
                plant.load().torque_at(angle_deg.to_radians(), speed_dps.to_radians())
            },
            led: plant.is_led(),
            push_nm: plant.external_torque_nm(),
            motor_temperature_c: measured.motor_temperature_c,
            mosfet_temperature_c: measured.mos_temperature_c,
            supply_voltage_v: measured.supply_voltage_v,
            supply_current_a: measured.supply_current_a,
            errors: state.errors.each().map(error_name).collect(),
            mode: state.mode.name(),
            output_on: state.output_on,
            brake: state.brake.name(),
            brake_stuck: plant
                .forced_brake()
                .map(|open| if open { Stuck::Released } else { Stuck::Locked }),
            powered: state.powered,
            running: state.running,
            communication_lost: state.communication_lost,
            cut,
            load: *plant.load(),
            supply: *plant.supply(),
        }
    }
}

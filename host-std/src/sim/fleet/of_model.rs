//! The drive of a motor model.

use myactuator_protocol_core::command::{BaudCode, ModelName, VersionDate};
use myactuator_protocol_core::drive::{Derating, FaultLimits, Gains, Parameters};

use crate::sim::plant::{BROWN_OUT_V, MotorParameters, ParameterError, catalogue_name};

/// The speed loop's bandwidth that factory gains aim at, rad/s.
const BANDWIDTH_RAD_S: f32 = 1_000.0;

/// A drive's parameters for a motor of this model: its firmware, limits, scales and factory gains.
pub(super) fn parameters_of(model: &MotorParameters) -> Result<Parameters, ParameterError> {
    let rating = &model.rating;
    let peak_a = rating.peak_current_a as f32;
    let no_load_dps = (rating.no_load_speed_rpm * 6.0) as f32;
    let supply_a = (rating.peak_torque_nm * rating.speed_rpm * std::f64::consts::TAU
        / 60.0
        / rating.voltage_v) as f32;
    // Without a known date, one that leads to no firmware.
    let dates = model.firmware.version_dates();
    let version_date = dates.first().copied().unwrap_or(VersionDate::from_raw(0));
    Ok(Parameters {
        model: model_name(&model.name),
        firmware: model.firmware,
        version_date,
        motion_ranges: model.motion_ranges()?,
        baud_rate: BaudCode::CAN_1M_RS485_500K,
        encoder_bits: model.encoder.bits,
        output_encoder: model.encoder.output_bits > 0,
        gear_ratio: model.gear.ratio,
        torque_constant_nm_per_a: rating.torque_constant_nm_per_a as f32,
        rated_current_a: rating.current_a as f32,
        stall_current_a: peak_a,
        max_speed_dps: no_load_dps,
        derating: model.derating.as_ref().map(|it| Derating {
            motor_from_c: it.motor_from_c as f32,
            motor_to_c: it.motor_to_c as f32,
            mos_from_c: it.mos_from_c as f32,
            mos_to_c: it.mos_to_c as f32,
        }),
        limits: FaultLimits {
            under_voltage_v: rating.min_voltage_v as f32 * 0.9,
            over_voltage_v: rating.max_voltage_v as f32,
            // Headroom over the peak current's phase amplitude.
            over_current_a: peak_a * model.motor.current_scale.amplitude_per_ampere() as f32 * 1.5,
            supply_current_a: supply_a.max(5.0) * 2.0,
            over_speed_dps: no_load_dps * 1.5,
            ..FaultLimits::default()
        },
        brown_out_voltage_v: BROWN_OUT_V as f32,
        factory_gains: Gains::tuned(
            model.inertia_kg_m2() as f32,
            rating.torque_constant_nm_per_a as f32,
            BANDWIDTH_RAD_S,
        ),
        ..Parameters::default()
    })
}

/// Up to seven characters of the model's name, without the maker's "RMD-"; for a long name those of the catalogue's.
fn model_name(name: &str) -> ModelName {
    let mut bytes = [0; 7];
    let whole = name.strip_prefix("RMD-").unwrap_or(name);
    let short = if whole.len() > bytes.len() { catalogue_name(name) } else { whole.to_owned() };
    for (byte, character) in bytes.iter_mut().zip(short.bytes().filter(u8::is_ascii_graphic)) {
        *byte = character;
    }
    ModelName::from_bytes(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_models_name_is_the_catalogues() {
        let names = [
            ("RMD-X8-PRO", "X8-PRO"),
            ("RMD-X8-P20-120", "X8-120"),
            ("RMD-X6-P20-60", "X6-60"),
            ("RMD-X4", "X4"),
            ("a name of my own", "anameof"),
        ];
        for (name, short) in names {
            assert_eq!(model_name(name).as_str(), Some(short));
        }
    }
}

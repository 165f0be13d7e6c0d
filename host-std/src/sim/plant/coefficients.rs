//! The coefficients of a step, from a motor's figures and its load.

use std::f64::consts::TAU;

use super::motor::STEP_S;
use super::shaft::{Inertia, Play};
use super::{Load, MotorParameters, ParameterError};

/// Fastest electromechanical rate, 1/s: half of the speed error corrected in one step.
const MAX_ELECTRIC_RATE_PER_S: f64 = 0.5 / STEP_S;
/// Highest angular frequency of a spring, 1/s: 31 steps a period, at which the period is right to
/// 0.2 %.
const MAX_SPRING_RATE_PER_S: f64 = 0.2 / STEP_S;
/// The same for a load alone, while it crosses the gear's play. It only has to stay stable, which ends at 2.
const MAX_LOOSE_RATE_PER_S: f64 = 1.0 / STEP_S;

/// What a step needs that changes only with the load.
#[derive(Clone, Copy, Debug)]
pub(super) struct Coefficients {
    /// Motor, gear and load together.
    pub(super) whole: Inertia,
    /// The two sides of the gear's play, if it has any.
    pub(super) play: Option<Play>,
    pub(super) air_gap_nm_per_a: f64,
    pub(super) gear_loss: f64,
    pub(super) amplitude_per_a: f64,
    /// Amplitude of a phase's back-EMF per speed of the output shaft, V·s/rad.
    pub(super) emf_v_s_per_rad: f64,
    pub(super) pulses_per_rad: f64,
    /// Radians of the cogging torque's period per radian of the output shaft.
    pub(super) cogging_per_rad: f64,
    pub(super) electrical_turns_per_rad: f64,
}

impl Coefficients {
    pub(super) fn new(parameters: &MotorParameters, load: &Load) -> Result<Self, ParameterError> {
        let inertia = parameters.inertia_kg_m2() + load.total_inertia_kg_m2();
        let load_inertia = parameters.gear.output_inertia_kg_m2 + load.total_inertia_kg_m2();
        let motor_inertia = inertia - load_inertia;
        let friction = parameters.friction.viscous_nm_s_per_rad;
        let damping = load.damping_nm_s_per_rad;
        let has_play = parameters.gear.backlash_arcmin > 0.0;
        let play = has_play.then(|| Play {
            half_rad: (parameters.gear.backlash_arcmin / 120.0).to_radians(),
            motor: Inertia::new(motor_inertia, friction, STEP_S),
            load: Inertia::new(load_inertia, damping, STEP_S),
        });

        // Before any loss: the power that becomes mechanical is this times current times speed.
        let air_gap_nm_per_a =
            parameters.motor.torque_constant_nm_per_a / parameters.gear.efficiency;
        let amplitude_per_a = parameters.motor.current_scale.amplitude_per_ampere();
        // Power balance: 3/2 of EMF amplitude times current amplitude is torque times speed.
        let emf_v_s_per_rad = air_gap_nm_per_a / (1.5 * amplitude_per_a);

        // The smallest inertia that the motor turns.
        let turned_kg_m2 = if has_play { motor_inertia } else { inertia };
        let resistance = parameters.motor.phase_resistance_ohm;
        let electric_rate_per_s =
            1.5 * emf_v_s_per_rad * emf_v_s_per_rad / (resistance * turned_kg_m2);
        if electric_rate_per_s > MAX_ELECTRIC_RATE_PER_S {
            return Err(ParameterError::TooFast {
                what: "torque constant squared over phase resistance and inertia",
                rate_per_s: electric_rate_per_s,
                limit_per_s: MAX_ELECTRIC_RATE_PER_S,
            });
        }
        let cogging_per_rad = parameters.gear.ratio * f64::from(parameters.motor.cogging_periods);
        let cogging_rate_per_s =
            (parameters.motor.cogging_nm * cogging_per_rad / turned_kg_m2).sqrt();
        if cogging_rate_per_s > MAX_SPRING_RATE_PER_S {
            return Err(ParameterError::TooFast {
                what: "square root of cogging torque times its periods times gear ratio over inertia",
                rate_per_s: cogging_rate_per_s,
                limit_per_s: MAX_SPRING_RATE_PER_S,
            });
        }
        let (part, stiffness_nm_per_rad) = load.stiffness();
        let loosely = has_play.then_some((load_inertia, MAX_LOOSE_RATE_PER_S));
        let limits = [(inertia, MAX_SPRING_RATE_PER_S)].into_iter().chain(loosely);
        for (inertia_kg_m2, rate_per_s) in limits {
            let most_nm_per_rad = inertia_kg_m2 * rate_per_s * rate_per_s;
            if stiffness_nm_per_rad > most_nm_per_rad {
                return Err(ParameterError::TooStiff {
                    part,
                    stiffness_nm_per_rad,
                    most_nm_per_rad,
                    inertia_kg_m2,
                });
            }
        }

        Ok(Self {
            whole: Inertia::new(inertia, friction + damping, STEP_S),
            play,
            air_gap_nm_per_a,
            gear_loss: 1.0 - parameters.gear.efficiency,
            amplitude_per_a,
            emf_v_s_per_rad,
            pulses_per_rad: parameters.gear.ratio * f64::from(1_u32 << parameters.encoder.bits)
                / TAU,
            cogging_per_rad,
            electrical_turns_per_rad: parameters.gear.ratio
                * f64::from(parameters.motor.pole_pairs)
                / TAU,
        })
    }
}

//! Where the power comes from, and where it goes when the motor feeds back.

use super::figure::{ImpossibleFigure, check};
use serde::{Deserialize, Serialize};

/// A voltage source behind a resistance, with the capacitor at the drive's input.
///
/// While the drive draws power its voltage sags by current times resistance. While the motor feeds
/// back, the voltage rises by current times *feedback* resistance: small for a battery, large for a
/// power supply that takes nothing back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supply {
    /// Voltage without load, V.
    pub voltage_v: f64,
    /// Internal resistance, wires included, Ω.
    pub resistance_ohm: f64,
    /// Resistance against current that flows back, Ω.
    pub feedback_resistance_ohm: f64,
    /// Capacitor at the drive's input, F.
    pub capacitance_f: f64,
}

impl Supply {
    /// A battery: 50 mΩ both ways. The capacitor of this and of [`bench`](Self::bench) is the
    /// 1000 µF that the maker's X-series manual (V1.1, 5.1) asks for.
    pub const fn battery(voltage_v: f64) -> Self {
        Self {
            voltage_v,
            resistance_ohm: 0.05,
            feedback_resistance_ohm: 0.05,
            capacitance_f: 1000e-6,
        }
    }

    /// A bench supply: 50 mΩ, and 20 Ω against feedback, so that a braking motor raises the voltage.
    pub const fn bench(voltage_v: f64) -> Self {
        Self { feedback_resistance_ohm: 20.0, ..Self::battery(voltage_v) }
    }

    pub(super) fn check(&self) -> Result<(), ImpossibleFigure> {
        check_voltage(self.voltage_v)?;
        for resistance_ohm in [self.resistance_ohm, self.feedback_resistance_ohm] {
            check("supply resistance", "Ω", 0.000_1..=1_000_000.0, resistance_ohm)?;
        }
        check("input capacitance", "F", 0.000_1..=100.0, self.capacitance_f)?;
        Ok(())
    }
}

pub(super) fn check_voltage(voltage_v: f64) -> Result<f64, ImpossibleFigure> {
    check("supply voltage", "V", 0.0..=1000.0, voltage_v)
}

/// The voltage at the drive's input as time goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Link {
    pub(super) supply: Supply,
    voltage_v: f64,
    /// The voltage that a test holds, whatever is drawn.
    pub(super) held_v: Option<f64>,
    /// Share of the distance to the steady voltage that is left after one step.
    remaining: f64,
    remaining_feedback: f64,
}

/// Below this voltage the current is reckoned as if at it: power through zero volts has no meaning.
const FLOOR_V: f64 = 1.0;

impl Link {
    pub(super) fn new(supply: Supply, step_s: f64) -> Self {
        let remaining = |resistance: f64| libm::exp(-step_s / (resistance * supply.capacitance_f));
        Self {
            voltage_v: supply.voltage_v,
            held_v: None,
            remaining: remaining(supply.resistance_ohm),
            remaining_feedback: remaining(supply.feedback_resistance_ohm),
            supply,
        }
    }

    pub(super) fn voltage_v(&self) -> f64 {
        self.held_v.unwrap_or(self.voltage_v)
    }

    /// Keeps the voltage at the capacitor and what a test holds, on another source.
    pub(super) fn replace_supply(&mut self, supply: Supply, step_s: f64) {
        *self =
            Self { voltage_v: self.voltage_v, held_v: self.held_v, ..Self::new(supply, step_s) };
    }

    /// One step in which the drive draws `power_w`; returns the current into the drive, A. Exact
    /// for a current that is constant over the step.
    pub(super) fn step(&mut self, power_w: f64) -> f64 {
        let current_a = power_w / self.voltage_v().max(FLOOR_V);
        if self.held_v.is_none() {
            let source_v = self.supply.voltage_v;
            let (resistance_ohm, remaining) = if self.voltage_v > source_v {
                (self.supply.feedback_resistance_ohm, self.remaining_feedback)
            } else {
                (self.supply.resistance_ohm, self.remaining)
            };
            let steady_v = source_v - resistance_ohm * current_a;
            self.voltage_v = (steady_v + (self.voltage_v - steady_v) * remaining).max(0.0);
        }
        current_a
    }
}

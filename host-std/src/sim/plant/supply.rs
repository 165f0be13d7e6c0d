//! Where the power comes from, and where it goes when the motor feeds back.

use super::figure::{ImpossibleFigure, check};
use serde::{Deserialize, Serialize};

/// The largest voltage, V.
const MOST_V: f64 = 1000.0;

/// A voltage source behind a resistance, with the capacitor at the drive's input. If drives
/// [share](crate::sim::Fleet::supply) the supply, the capacitor is at the point where their cables meet.
///
/// While the drive draws power, its voltage sags by current times resistance. While the motor feeds
/// back, the voltage rises by current times *feedback* resistance, which is small for a battery, and large for a
/// power supply that takes nothing back. A brake resistor burns what is not taken.
///
/// Below 4 V at its input (an estimate) a drive goes off and draws nothing. It starts when there are 5 V again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supply {
    /// Voltage without load, 0 to 1000 V.
    pub voltage_v: f64,
    /// Internal resistance, wires included, 0.0001 to 1,000,000 Ω.
    pub resistance_ohm: f64,
    /// Resistance against current that flows back, 0.0001 to 1,000,000 Ω.
    pub feedback_resistance_ohm: f64,
    /// Capacitor at the drive's input, 0.0001 to 100 F.
    pub capacitance_f: f64,
    /// The resistor that burns power that is fed back; `None` by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brake_resistor: Option<BrakeResistor>,
}

/// A resistor across the drive's input that is switched on while the voltage is too high.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrakeResistor {
    /// It is switched on above this voltage, at most 1000 V, and not below the supply's own.
    pub on_above_v: f64,
    /// It is switched off below this voltage, V; at most [`on_above_v`](Self::on_above_v), and not below the supply's
    /// own.
    pub off_below_v: f64,
    /// Resistance, 0.01 to 1,000,000 Ω.
    pub resistance_ohm: f64,
}

impl Supply {
    /// A battery: 50 mΩ in both directions, and the capacitor of 1000 µF that the maker's X-series manual (V1.1, 5.1)
    /// asks for.
    pub const fn battery(voltage_v: f64) -> Self {
        Self {
            voltage_v,
            resistance_ohm: 0.05,
            feedback_resistance_ohm: 0.05,
            capacitance_f: 1000e-6,
            brake_resistor: None,
        }
    }

    /// With capacitors beside its own.
    fn beside(self, others_f: f64) -> Self {
        Self { capacitance_f: self.capacitance_f + others_f, ..self }
    }

    /// Its resistance and capacitor behind a common point with this voltage.
    fn cable_to(self, voltage_v: f64) -> Self {
        let feedback_resistance_ohm = self.resistance_ohm;
        Self { voltage_v, feedback_resistance_ohm, brake_resistor: None, ..self }
    }

    pub(crate) fn check(&self) -> Result<(), ImpossibleFigure> {
        check_voltage(self.voltage_v)?;
        for resistance_ohm in [self.resistance_ohm, self.feedback_resistance_ohm] {
            check("supply resistance", "Ω", 0.000_1..=1_000_000.0, resistance_ohm)?;
        }
        check("input capacitance", "F", 0.000_1..=100.0, self.capacitance_f)?;
        if let Some(brake) = self.brake_resistor {
            // If the supply kept it on, it would burn.
            let goes_on = "voltage at which the brake resistor goes on";
            let on_above_v = check(goes_on, "V", self.voltage_v..=MOST_V, brake.on_above_v)?;
            let off = "voltage at which the brake resistor goes off";
            check(off, "V", self.voltage_v..=on_above_v, brake.off_below_v)?;
            check("brake resistor", "Ω", 0.01..=1_000_000.0, brake.resistance_ohm)?;
        }
        Ok(())
    }
}

pub(super) fn check_voltage(voltage_v: f64) -> Result<f64, ImpossibleFigure> {
    check("supply voltage", "V", 0.0..=MOST_V, voltage_v)
}

/// The voltage at the drive's input as time goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Link {
    pub(super) supply: Supply,
    voltage_v: f64,
    /// The voltage that a test holds, whatever is drawn.
    pub(super) held_v: Option<f64>,
    drawn: Path,
    fed_back: Path,
    /// While the brake resistor is on.
    burnt: Path,
    burns: bool,
    step_s: f64,
    /// What a drive behind a common point has drawn since the last call, C.
    taken_c: Option<f64>,
}

/// What the capacitor sees as long as nothing is switched: a voltage behind a resistance.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Path {
    source_v: f64,
    resistance_ohm: f64,
    /// Share of the distance to the steady voltage that is left after one step.
    remaining: f64,
}

impl Path {
    fn new(source_v: f64, resistance_ohm: f64, capacitance_f: f64, step_s: f64) -> Self {
        let remaining = libm::exp(-step_s / (resistance_ohm * capacitance_f));
        Self { source_v, resistance_ohm, remaining }
    }

    /// The voltage a step after `voltage_v`, if the drive draws this current.
    fn after(&self, voltage_v: f64, current_a: f64) -> f64 {
        let steady_v = self.source_v - self.resistance_ohm * current_a;
        (steady_v + (voltage_v - steady_v) * self.remaining).max(0.0)
    }
}

/// Below this voltage the current is calculated as at this voltage, since power at zero volts has no meaning.
const FLOOR_V: f64 = 1.0;

impl Link {
    pub(super) fn new(supply: Supply, step_s: f64) -> Self {
        let Supply { voltage_v, resistance_ohm, feedback_resistance_ohm, capacitance_f, .. } =
            supply;
        let path = |source_v, ohm| Path::new(source_v, ohm, capacitance_f, step_s);
        let fed_back = path(voltage_v, feedback_resistance_ohm);
        // Both resistances at once are a divider of the source's voltage.
        let burnt =
            supply.brake_resistor.map_or(fed_back, |BrakeResistor { resistance_ohm, .. }| {
                let share = resistance_ohm / (feedback_resistance_ohm + resistance_ohm);
                path(voltage_v * share, feedback_resistance_ohm * share)
            });
        let drawn = path(voltage_v, resistance_ohm);
        Self {
            voltage_v,
            held_v: None,
            drawn,
            fed_back,
            burnt,
            burns: false,
            step_s,
            taken_c: None,
            supply,
        }
    }

    pub(super) fn voltage_v(&self) -> f64 {
        self.held_v.unwrap_or(self.voltage_v)
    }

    /// Changes the source, and keeps the voltage at the capacitor and what a test holds. Behind a common point, that
    /// stays the source, and only the cable and the capacitor change.
    pub(super) fn replace_supply(&mut self, supply: Supply, step_s: f64) {
        let supply = match self.taken_c {
            Some(_) => supply.cable_to(self.supply.voltage_v),
            None => supply,
        };
        *self = Self {
            voltage_v: self.voltage_v,
            held_v: self.held_v,
            taken_c: self.taken_c,
            burns: self.burns && supply.brake_resistor.is_some(),
            ..Self::new(supply, step_s)
        };
    }

    /// From now on its source is a common point with this voltage.
    pub(super) fn join(&mut self, source_v: f64, step_s: f64) {
        self.replace_supply(self.supply.cable_to(source_v), step_s);
        self.taken_c = Some(0.0);
    }

    /// Sets the voltage of the common point.
    pub(super) fn follow(&mut self, source_v: f64) {
        self.supply.voltage_v = source_v;
        for path in [&mut self.drawn, &mut self.fed_back, &mut self.burnt] {
            path.source_v = source_v;
        }
    }

    /// What the drive has drawn from the common point since the last call, C.
    pub(super) fn take_charge_c(&mut self) -> f64 {
        self.taken_c.as_mut().map_or(0.0, std::mem::take)
    }

    /// One step in which the drive draws `power_w`; returns the current into the drive, A. Exact
    /// for a current that is constant over the step.
    pub(super) fn step(&mut self, power_w: f64) -> f64 {
        let current_a = power_w / self.voltage_v().max(FLOOR_V);
        self.draw(current_a);
        current_a
    }

    /// One step in which the drive draws this current.
    fn draw(&mut self, current_a: f64) {
        if self.held_v.is_none() {
            if let Some(taken_c) = &mut self.taken_c {
                *taken_c += current_a * self.step_s;
            }
            if let Some(brake) = self.supply.brake_resistor {
                let limit_v = if self.burns { brake.off_below_v } else { brake.on_above_v };
                self.burns = self.voltage_v > limit_v;
            }
            let path = match self.voltage_v > self.supply.voltage_v {
                true if self.burns => &self.burnt,
                true => &self.fed_back,
                false => &self.drawn,
            };
            self.voltage_v = path.after(self.voltage_v, current_a);
        }
    }
}

/// The point where the cables of several drives meet that share a supply.
#[derive(Clone, Copy, Debug)]
pub(in crate::sim) struct CommonPoint {
    supply: Supply,
    /// The drives' capacitors, with the effect of the cables neglected, F.
    drives_f: f64,
    link: Link,
}

impl CommonPoint {
    pub(in crate::sim) fn new(supply: Supply, drives_f: f64, step_s: f64) -> Self {
        let link = Link::new(supply.beside(drives_f), step_s);
        Self { supply, drives_f, link }
    }

    pub(in crate::sim) const fn supply(&self) -> &Supply {
        &self.supply
    }

    /// Another supply; the capacitors keep their voltage and follow.
    pub(in crate::sim) fn replace_supply(&mut self, supply: Supply) {
        self.supply = supply;
        self.link.replace_supply(supply.beside(self.drives_f), self.link.step_s);
    }

    pub(in crate::sim) const fn voltage_v(&self) -> f64 {
        self.link.voltage_v
    }

    /// Drives have drawn this charge in this many steps.
    pub(in crate::sim) fn draw_c(&mut self, charge_c: f64, steps: u32) {
        let current_a = charge_c / (self.link.step_s * f64::from(steps));
        (0..steps).for_each(|_| self.link.draw(current_a));
    }
}

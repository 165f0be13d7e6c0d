//! A body that heats up by losses and cools to the air.

/// One temperature: heat capacity and thermal resistance to ambient.
///
/// Its step is exact for a loss that is constant over the step: it approaches the steady temperature exponentially,
/// with the time constant capacity times resistance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ThermalNode {
    temperature_c: f64,
    is_held: bool,
    resistance_k_per_w: f64,
    /// Share of the distance to the steady temperature that is left after one step.
    remaining: f64,
}

impl ThermalNode {
    /// A body at `temperature_c` that is stepped every `step_s` seconds. Capacity in J/K,
    /// resistance in K/W.
    pub(super) fn new(
        temperature_c: f64,
        capacity_j_per_k: f64,
        resistance_k_per_w: f64,
        step_s: f64,
    ) -> Self {
        let remaining = libm::exp(-step_s / (capacity_j_per_k * resistance_k_per_w));
        Self { temperature_c, is_held: false, resistance_k_per_w, remaining }
    }

    /// One step with `loss_w` watts of heating, in air (or in a housing) of `ambient_c`, unless its temperature is
    /// held. Returns the power that it passes on, in the mean of the step, W.
    pub(super) fn step(&mut self, loss_w: f64, ambient_c: f64) -> f64 {
        let before_c = self.temperature_c;
        if !self.is_held {
            let steady_c = ambient_c + loss_w * self.resistance_k_per_w;
            self.temperature_c = steady_c + (before_c - steady_c) * self.remaining;
        }
        (0.5 * (before_c + self.temperature_c) - ambient_c) / self.resistance_k_per_w
    }

    /// The temperature, °C.
    pub(super) const fn temperature_c(&self) -> f64 {
        self.temperature_c
    }

    /// Holds the body at a temperature, °C; `None` lets it go on from there.
    pub(super) const fn hold_c(&mut self, held_c: Option<f64>) {
        self.is_held = held_c.is_some();
        if let Some(held_c) = held_c {
            self.temperature_c = held_c;
        }
    }
}

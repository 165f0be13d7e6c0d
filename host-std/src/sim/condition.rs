//! A condition on a motor, as people type it: `angle>90`.

use std::str::FromStr;

use crate::Unexpected;
use crate::sim::SimulatedDrive;

/// What a motor must reach: a quantity, `>` or `<`, and a number.
///
/// | quantity | unit | what it is |
/// |---|---|---|
/// | `angle` | degrees | the true angle of the output shaft, turns included |
/// | `speed` | degrees per second | its true speed, negative for a falling angle |
/// | `current` | A | the torque current |
/// | `temperature` | °C | of the winding |
/// | `voltage` | V | at the drive's input |
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// What is compared.
    pub quantity: ConditionQuantity,
    /// Whether the quantity must be above the threshold, or below it.
    pub above: bool,
    /// The threshold, in the quantity's unit.
    pub threshold: f64,
}

/// The quantity that a condition compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConditionQuantity {
    /// `angle`, degrees.
    Angle,
    /// `speed`, degrees per second.
    Speed,
    /// `current`, A.
    Current,
    /// `temperature`, °C.
    Temperature,
    /// `voltage`, V.
    Voltage,
}

impl Condition {
    /// Whether the drive meets it now.
    pub fn is_met(&self, drive: &SimulatedDrive) -> bool {
        let (plant, measured) = (drive.plant(), drive.state().measurement);
        let value = match self.quantity {
            ConditionQuantity::Angle => plant.output_angle_deg(),
            ConditionQuantity::Speed => plant.output_speed_dps(),
            ConditionQuantity::Current => measured.current_a.into(),
            ConditionQuantity::Temperature => measured.motor_temperature_c.into(),
            ConditionQuantity::Voltage => measured.supply_voltage_v.into(),
        };
        if self.above { value > self.threshold } else { value < self.threshold }
    }
}

impl FromStr for Condition {
    type Err = Unexpected;

    fn from_str(text: &str) -> Result<Self, Unexpected> {
        let wrong = || {
            let expected = "angle, speed, current, temperature or voltage, above or below a number, such as angle>90";
            Unexpected::new(expected, text)
        };
        let at = text.find(['<', '>']).ok_or_else(wrong)?;
        let (name, rest) = text.split_at(at);
        let quantity = match name {
            "angle" => ConditionQuantity::Angle,
            "speed" => ConditionQuantity::Speed,
            "current" => ConditionQuantity::Current,
            "temperature" => ConditionQuantity::Temperature,
            "voltage" => ConditionQuantity::Voltage,
            _ => return Err(wrong()),
        };
        let threshold: f64 = rest[1..].parse().map_err(|_| wrong())?;
        if !threshold.is_finite() {
            return Err(wrong());
        }
        Ok(Self { quantity, above: rest.starts_with('>'), threshold })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Fleet;

    #[test]
    fn each_quantity_is_its_own() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let drive = &fleet.drives[0];
        drive.with(|drive| {
            drive.plant_mut().set_output_angle_deg(-90.0).unwrap();
            drive.plant_mut().set_output_speed_dps(30.0).unwrap();
        });
        let is_met = |text: &str| {
            let condition: Condition = text.parse().unwrap();
            drive.with(|drive| condition.is_met(drive))
        };
        // 25 °C, and a battery of 48 V, at the start.
        for met in [
            "angle<-89",
            "angle>-91",
            "speed>29",
            "speed<31",
            "current<0.1",
            "current>-0.1",
            "temperature>24.9",
            "temperature<25.1",
            "voltage>47",
            "voltage<49",
        ] {
            assert!(is_met(met), "{met}");
            let other_way = met.replace(['<', '>'], if met.contains('<') { ">" } else { "<" });
            assert!(!is_met(&other_way), "{other_way}");
        }
    }

    #[test]
    fn wrong_conditions_are_refused_with_what_is_expected() {
        for wrong in ["", "angle", "angle=5", "angel>5", "angle>", "angle>x", "angle>inf"] {
            let message = wrong.parse::<Condition>().unwrap_err().to_string();
            assert!(message.starts_with("expected angle, speed, current"), "{message}");
        }
    }
}

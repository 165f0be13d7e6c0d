//! The physics of a simulated drive: a motor with its gearbox, load, brake, encoder and supply.
//! This module knows no bus and no frames.
//!
//! [`SimulatedMotor`] implements the [`Plant`](myactuator_protocol_core::drive::Plant) that a drive
//! acts on. Its parts:
//!
//! | part | model | where |
//! |---|---|---|
//! | mechanics | one inertia (rotor through the gear, gear, load); viscous, Coulomb and static friction; a gear loss in proportion to the torque; a brake that slips | [`SimulatedMotor`] |
//! | cogging | a sine of the motor's angle; it stores energy and returns it | [`WindingParameters`] |
//! | backlash | two inertias, motor with friction and brake on one side and output with load on the other, that meet without bouncing | [`GearParameters`] |
//! | load | an inertia, a weight on an arm, a spring, a damper, end stops that return a part of the energy, a constant torque | [`Load`] |
//! | electrics | torque current limited by voltage and back-EMF, diodes, phase currents, electronics' own power | [`SimulatedMotor`] |
//! | encoders | whole pulses, one on the motor's side with noise, one on the output | [`EncoderParameters`] |
//! | supply | a source with internal resistance, cable included, and a capacitor; feedback raises the voltage, up to a brake resistor | [`Supply`] |
//! | heat | the winding, through a housing if the file has one, and the output stage, each cooling to ambient | [`SimulatedMotor`] |
//!
//! Everything is calculated at the output shaft, in SI units and f64. The same calls give the same bits on any machine:
//! the step is fixed ([`STEP`]), nothing reads a clock, noise is a function of a seed and of the step, and sines and
//! exponentials are those of `libm`, not of the system.
//!
//! ```
//! use myactuator_host_std::sim::plant::{MotorParameters, SimulatedMotor};
//! use myactuator_host_std::protocol::drive::{Actuation, Plant};
//! use myactuator_host_std::protocol::time::Duration;
//!
//! let mut motor = SimulatedMotor::new(MotorParameters::named("RMD-X8-PRO")?)?;
//! let push = Actuation { current_a: 2.0, output_on: true, brake_released: true };
//! let measured = motor.advance(&push, Duration::from_millis(100));
//! assert!(measured.speed_dps > 0.0);
//! # Ok::<(), myactuator_host_std::sim::plant::ParameterError>(())
//! ```

mod coefficients;
mod encoder;
mod figure;
mod led;
mod load;
mod models;
mod motor;
mod parameters;
mod shaft;
mod supply;
mod thermal;

pub use figure::ImpossibleFigure;
pub use led::ShaftTorque;
pub use load::{Arm, EndStop, Load, Spring};
pub(in crate::sim) use models::catalogue_name;
pub use models::{MODELS, Model};
pub(in crate::sim) use motor::BROWN_OUT_V;
pub(in crate::sim) use motor::ShaftPlace;
pub use motor::{STEP, SimulatedMotor};
pub use parameters::{
    BrakeParameters, CurrentScale, DeratingParameters, EncoderParameters, FrictionParameters,
    GearParameters, InverterParameters, MotorParameters, ParameterError, Rating, ThermalParameters,
    WindingParameters,
};
pub(in crate::sim) use supply::CommonPoint;
pub use supply::{BrakeResistor, Supply};

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    /// Functions of a float that are exact, or rounded as the standard of floats says, are the same on every
    /// machine; of these the standard library leaves the last bits to the system.
    const SYSTEMS_OWN: [&str; 26] = [
        "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh",
        "asinh", "acosh", "atanh", "exp", "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10",
        "powi", "powf", "cbrt", "hypot",
    ];

    #[test]
    fn the_physics_has_its_functions_from_libm() {
        let sim = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/sim");
        let mut folders = vec![sim.join("plant"), sim.join("mechanics")];
        let mut files = 0;
        while let Some(folder) = folders.pop() {
            for file in fs::read_dir(folder).unwrap() {
                let path = file.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                    continue;
                }
                let text = fs::read_to_string(&path).unwrap();
                let code = text.split("#[cfg(test)]").next().unwrap();
                for name in SYSTEMS_OWN {
                    for call in
                        [format!(".{name}("), format!("f64::{name}"), format!("f32::{name}")]
                    {
                        let path = path.display();
                        assert!(!code.contains(&call), "{path} has {call}: take libm's instead");
                    }
                }
                files += 1;
            }
        }
        assert!(files >= 10, "{files}");
    }
}

//! The figures of a motor's data sheet, from a TOML file, checked.

use super::figure::{ImpossibleFigure, check};
use super::models::MODELS;
use myactuator_protocol_core::Firmware;
use myactuator_protocol_core::command::MotionRanges;
use serde::{Deserialize, Serialize};

/// One table of the file: its struct, and the range next to each figure.
macro_rules! table {
    (
        $(#[$attr:meta])*
        $name:ident [$key:literal] {
            $($(#[$field_attr:meta])* $field:ident: $type:ident, $what:literal, $unit:literal, $min:literal..=$max:literal;)*
            $(@plain { $(#[$plain_attr:meta])* $plain:ident: $plain_type:ty })?
        }
    ) => {
        $(#[$attr])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[$field_attr])* #[doc = concat!("\n\nAllowed: ", stringify!($min), " to ", stringify!($max), ".")] pub $field: $type,)*
            $($(#[$plain_attr])* pub $plain: $plain_type,)?
        }

        impl $name {
            fn check(&self) -> Result<(), ParameterError> {
                $(
                    let key = concat!($key, ".", stringify!($field));
                    check($what, $unit, $min..=$max, self.$field.into())
                        .map_err(|error| ParameterError::OutOfRange { key, error })?;
                )*
                Ok(())
            }
        }
    };
}

table! {
    /// `[rating]`: the ratings of the data sheet. Software uses them; the physics does not.
    Rating ["rating"] {
        /// Nominal supply voltage, V.
        voltage_v: f64, "nominal supply voltage", "V", 1.0..=1000.0;
        /// Lowest supply voltage at which the drive works, V.
        min_voltage_v: f64, "lowest supply voltage", "V", 1.0..=1000.0;
        /// Highest supply voltage that the drive withstands, V.
        max_voltage_v: f64, "highest supply voltage", "V", 1.0..=1000.0;
        /// Rated torque at the output shaft, N·m.
        torque_nm: f64, "rated torque", "N·m", 0.001..=100_000.0;
        /// Torque current at the rated torque, A: 100 % of a force limit.
        current_a: f64, "rated current", "A", 0.01..=300.0;
        /// Peak torque at the output shaft, N·m.
        peak_torque_nm: f64, "peak torque", "N·m", 0.001..=100_000.0;
        /// Torque current at the peak torque, A.
        peak_current_a: f64, "peak current", "A", 0.01..=300.0;
        /// Speed of the output shaft at rated torque, revolutions a minute.
        speed_rpm: f64, "rated speed", "rpm", 0.1..=100_000.0;
        /// Speed of the output shaft without load at the nominal voltage, revolutions a minute.
        no_load_speed_rpm: f64, "no-load speed", "rpm", 0.1..=100_000.0;
        /// Torque per ampere as printed, N·m/A at the output shaft, with friction at the rated point
        /// already subtracted. Software that converts torque to current uses it.
        torque_constant_nm_per_a: f64, "rated torque constant", "N·m/A", 0.000_1..=10_000.0;
        /// Mass, kg.
        mass_kg: f64, "mass", "kg", 0.001..=10_000.0;
    }
}

table! {
    /// `[gear]`: the reducer.
    GearParameters ["gear"] {
        /// Turns of the motor shaft for one of the output shaft.
        ratio: f64, "gear ratio", "", 1.0..=10_000.0;
        /// Share of the air-gap torque that the teeth transmit. The rest is friction in proportion to
        /// that torque, in both directions of turning.
        efficiency: f64, "gear efficiency", "", 0.05..=1.0;
        /// Inertia of what turns with the output shaft, kg·m².
        output_inertia_kg_m2: f64, "output inertia", "kg·m²", 0.0..=10_000.0;
        /// How far the output turns between the teeth's two sides while the motor stands, minutes of arc; 0,
        /// which is the default, for a gear without play. With play the output needs an inertia.
        #[serde(default)]
        backlash_arcmin: f64, "backlash", "arcmin", 0.0..=600.0;
    }
}

table! {
    /// `[motor]`: rotor and winding.
    WindingParameters ["motor"] {
        /// Pole pairs.
        pole_pairs: u8, "pole pairs", "", 1.0..=100.0;
        /// Resistance of one phase, terminal to star point, at 25 °C, Ω.
        phase_resistance_ohm: f64, "phase resistance", "Ω", 0.000_1..=1_000.0;
        /// Increase of that resistance with temperature, 1/K; copper: 0.00393.
        resistance_coefficient_per_k: f64, "temperature coefficient of resistance", "1/K", 0.0..=0.1;
        /// Torque per ampere of torque current, at the output shaft, after the gear's loss and before
        /// any other friction, N·m/A. The back-EMF follows from it.
        torque_constant_nm_per_a: f64, "torque constant", "N·m/A", 0.000_1..=10_000.0;
        /// Inertia of the rotor at the motor shaft, kg·m².
        rotor_inertia_kg_m2: f64, "rotor inertia", "kg·m²", 0.000_000_001..=100.0;
        /// Amplitude of the torque between the magnets and the teeth of the iron, N·m at the output shaft;
        /// 0 by default.
        #[serde(default)]
        cogging_nm: f64, "cogging torque", "N·m", 0.0..=10_000.0;
        /// Periods of that torque in a turn of the motor shaft: the least common multiple of poles and
        /// slots; 0 by default.
        #[serde(default)]
        cogging_periods: u16, "cogging periods", "", 0.0..=10_000.0;
        @plain {
            /// The meaning of an ampere of torque current.
            current_scale: CurrentScale
        }
    }
}

table! {
    /// `[friction]`: at the output shaft, without the gear's loss in proportion to torque.
    FrictionParameters ["friction"] {
        /// Torque that breaks the shaft away from rest, N·m; at least the Coulomb friction.
        static_nm: f64, "static friction", "N·m", 0.0..=10_000.0;
        /// Friction while it turns, at any speed, N·m.
        coulomb_nm: f64, "Coulomb friction", "N·m", 0.0..=10_000.0;
        /// Friction in proportion to speed, N·m·s/rad.
        viscous_nm_s_per_rad: f64, "viscous friction", "N·m·s/rad", 0.0..=10_000.0;
    }
}

table! {
    /// `[brake]`: the holding brake.
    BrakeParameters ["brake"] {
        /// Torque at the output shaft beyond which the closed brake slips, N·m.
        holding_torque_nm: f64, "brake holding torque", "N·m", 0.0..=100_000.0;
    }
}

table! {
    /// `[encoder]`: the encoder on the motor shaft, and that on the output shaft, if there is one.
    EncoderParameters ["encoder"] {
        /// Bits: a turn of the motor shaft has 2 to the power of this many pulses.
        bits: u8, "encoder bits", "", 8.0..=24.0;
        /// Bits of the encoder on the output shaft; 0 if there is none. Without it the drive knows after a
        /// start where the output is only within a turn of the motor shaft. Angles are read from the motor's encoder.
        output_bits: u8, "output encoder bits", "", 0.0..=24.0;
        /// Noise of the encoder on the motor shaft, pulses rms; 0 by default. The speed is reported without noise,
        /// since a drive smooths it.
        #[serde(default)]
        noise_pulses: f64, "encoder noise", "pulses", 0.0..=100_000.0;
    }
}

table! {
    /// `[inverter]`: the output stage.
    InverterParameters ["inverter"] {
        /// On-resistance in the path of one phase, Ω.
        mos_resistance_ohm: f64, "output stage resistance", "Ω", 0.0..=10.0;
        /// Largest amplitude of a phase's voltage, as a share of the supply voltage: 0.577 with
        /// sinusoidal currents and no reserve, 0.637 in six steps.
        modulation_limit: f64, "modulation limit", "", 0.01..=0.637;
        /// Power that the electronics themselves draw, W.
        idle_power_w: f64, "idle power", "W", 0.0..=1_000.0;
    }
}

table! {
    /// `[thermal]`: winding and output stage, each cooling to the air separately; the winding through the housing,
    /// if that has figures.
    ThermalParameters ["thermal"] {
        /// Heat that warms the winding by 1 K, J/K.
        winding_capacity_j_per_k: f64, "winding heat capacity", "J/K", 0.001..=1_000_000.0;
        /// Steady rise of the winding per watt of copper loss, K/W.
        winding_resistance_k_per_w: f64, "winding thermal resistance", "K/W", 0.000_1..=10_000.0;
        /// Heat that warms the housing by 1 K, J/K; 0, which is the default, for no housing between winding and air.
        #[serde(default)]
        housing_capacity_j_per_k: f64, "housing heat capacity", "J/K", 0.0..=1_000_000.0;
        /// The part of the winding's thermal resistance that is between housing and air, K/W; 0 by default,
        /// and more than 0 with a capacity.
        #[serde(default)]
        housing_resistance_k_per_w: f64, "housing thermal resistance", "K/W", 0.0..=10_000.0;
        /// Heat that warms the output stage by 1 K, J/K.
        mos_capacity_j_per_k: f64, "output stage heat capacity", "J/K", 0.001..=1_000_000.0;
        /// Steady rise of the output stage per watt of its loss, K/W.
        mos_resistance_k_per_w: f64, "output stage thermal resistance", "K/W", 0.000_1..=10_000.0;
    }
}

table! {
    /// `[derating]`: how the drive's largest current falls with heat, in a straight line from all of it to none.
    /// In any case a simulated drive cuts its output above 90 °C of the winding and 85 °C of the output stage
    /// ([`FaultLimits`](myactuator_protocol_core::drive::FaultLimits)), so a line takes effect only below these.
    DeratingParameters ["derating"] {
        /// Winding temperature above which there is less current, °C.
        motor_from_c: f64, "motor temperature where derating begins", "°C", 0.0..=1_000.0;
        /// Winding temperature from which there is no current, °C.
        motor_to_c: f64, "motor temperature where derating ends", "°C", 0.0..=1_000.0;
        /// Temperature of the output stage above which there is less current, °C.
        mos_from_c: f64, "output stage temperature where derating begins", "°C", 0.0..=1_000.0;
        /// Temperature of the output stage from which there is no current, °C.
        mos_to_c: f64, "output stage temperature where derating ends", "°C", 0.0..=1_000.0;
    }
}

/// The meaning of an ampere of torque current; data sheets print either.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CurrentScale {
    /// An ampere (rms) in each phase of the turning motor: a phase peaks at √2 A.
    Rms,
    /// A phase current whose amplitude is one ampere.
    Amplitude,
}

impl CurrentScale {
    /// Amplitude of a phase current per ampere of torque current.
    pub const fn amplitude_per_ampere(self) -> f64 {
        match self {
            Self::Rms => std::f64::consts::SQRT_2,
            Self::Amplitude => 1.0,
        }
    }
}

/// A motor with its gearbox, brake, encoder and output stage.
///
/// Its fields are the tables of the file. If you set them by hand you need not check them:
/// [`SimulatedMotor::new`](super::SimulatedMotor::new) does.
///
/// ```
/// use myactuator_host_std::sim::plant::MotorParameters;
///
/// let x8 = MotorParameters::named("rmd-x8-pro")?;
/// assert_eq!(x8.gear.ratio, 9.0);
/// let error = MotorParameters::named("RMD-X9").unwrap_err();
/// assert!(error.to_string().contains("RMD-X8-PRO"));
/// # Ok::<(), myactuator_host_std::sim::plant::ParameterError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorParameters {
    /// The maker's name of the model.
    pub name: String,
    /// The revision of the protocol that its drive speaks: `"v4.3"`, `"v4.4"`.
    pub firmware: Firmware,
    /// The ratings of the data sheet.
    pub rating: Rating,
    /// The reducer.
    pub gear: GearParameters,
    /// Rotor and winding.
    pub motor: WindingParameters,
    /// Friction at the output shaft.
    pub friction: FrictionParameters,
    /// The holding brake.
    pub brake: BrakeParameters,
    /// The encoder.
    pub encoder: EncoderParameters,
    /// The output stage.
    pub inverter: InverterParameters,
    /// Heating and cooling.
    pub thermal: ThermalParameters,
    /// How the drive's largest current falls with heat; a file may leave it out if it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub derating: Option<DeratingParameters>,
    /// The scales of motion mode, if they are not the firmware's own; a file may leave them out, unless they
    /// depend on the motor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<MotionRanges>,
}

impl MotorParameters {
    /// A model that comes with the library, by its full name or by that of the maker's catalogue, which drives
    /// report: "RMD-X8-P20-120" or "X8-120". Case does not matter.
    ///
    /// # Errors
    /// [`ParameterError::UnknownModel`], which lists all models.
    pub fn named(name: &str) -> Result<Self, ParameterError> {
        match MODELS.iter().find(|model| model.is_called(name.trim())) {
            Some(model) => Self::from_toml(model.toml),
            None => Err(ParameterError::UnknownModel { name: name.to_owned() }),
        }
    }

    /// The parameters in the text of a file. Every key is required, except for the tables [`derating`](Self::derating)
    /// and [`motion`](Self::motion) and keys whose documentation gives a default. No other keys are allowed.
    ///
    /// # Errors
    /// [`ParameterError`]: it names the key, what was expected and what was found.
    pub fn from_toml(text: &str) -> Result<Self, ParameterError> {
        let parameters: Self =
            toml::from_str(text).map_err(|error| ParameterError::Toml(Box::new(error)))?;
        parameters.check()?;
        Ok(parameters)
    }

    /// Checks that a motor can be made of these figures.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`] for a single figure, [`ParameterError::Contradiction`] for
    /// two figures that do not fit together, [`ParameterError::NoMotionRanges`].
    pub fn check(&self) -> Result<(), ParameterError> {
        self.rating.check()?;
        self.gear.check()?;
        self.motor.check()?;
        self.friction.check()?;
        self.brake.check()?;
        self.encoder.check()?;
        self.inverter.check()?;
        self.thermal.check()?;
        let ThermalParameters { housing_resistance_k_per_w, winding_resistance_k_per_w, .. } =
            self.thermal;
        if self.thermal.housing_capacity_j_per_k > 0.0 {
            let most = 0.999 * winding_resistance_k_per_w;
            check("housing thermal resistance", "K/W", 0.000_1..=most, housing_resistance_k_per_w)
                .map_err(|error| ParameterError::OutOfRange {
                    key: "thermal.housing_resistance_k_per_w",
                    error,
                })?;
        }
        if let Some(derating) = &self.derating {
            derating.check()?;
            let DeratingParameters { motor_from_c, motor_to_c, mos_from_c, mos_to_c } = *derating;
            at_most("derating.motor_from_c", motor_from_c, "derating.motor_to_c", motor_to_c)?;
            at_most("derating.mos_from_c", mos_from_c, "derating.mos_to_c", mos_to_c)?;
        }
        self.motion_ranges()?;
        if self.gear.backlash_arcmin > 0.0 {
            let given = self.gear.output_inertia_kg_m2;
            check("output inertia of a gear with backlash", "kg·m²", 1e-9..=10_000.0, given)
                .map_err(|error| ParameterError::OutOfRange {
                    key: "gear.output_inertia_kg_m2",
                    error,
                })?;
        }

        let Rating { voltage_v, min_voltage_v, max_voltage_v, .. } = self.rating;
        at_most("rating.min_voltage_v", min_voltage_v, "rating.voltage_v", voltage_v)?;
        at_most("rating.voltage_v", voltage_v, "rating.max_voltage_v", max_voltage_v)?;
        let Rating { current_a, peak_current_a, torque_nm, peak_torque_nm, .. } = self.rating;
        at_most("rating.current_a", current_a, "rating.peak_current_a", peak_current_a)?;
        at_most("rating.torque_nm", torque_nm, "rating.peak_torque_nm", peak_torque_nm)?;
        let FrictionParameters { coulomb_nm, static_nm, .. } = self.friction;
        at_most("friction.coulomb_nm", coulomb_nm, "friction.static_nm", static_nm)
    }

    /// The scales of motion mode: its own, or else its firmware's.
    ///
    /// # Errors
    /// [`ParameterError::NoMotionRanges`].
    pub fn motion_ranges(&self) -> Result<MotionRanges, ParameterError> {
        let ranges = self.motion.or(self.firmware.motion_ranges());
        ranges.ok_or(ParameterError::NoMotionRanges(self.firmware))
    }

    /// Inertia of rotor, gear and output at the output shaft, kg·m².
    pub fn inertia_kg_m2(&self) -> f64 {
        self.motor.rotor_inertia_kg_m2 * self.gear.ratio * self.gear.ratio
            + self.gear.output_inertia_kg_m2
    }
}

fn at_most(
    low_key: &'static str,
    low: f64,
    high_key: &'static str,
    high: f64,
) -> Result<(), ParameterError> {
    if low <= high {
        Ok(())
    } else {
        Err(ParameterError::Contradiction { low_key, low, high_key, high })
    }
}

/// Why a motor cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ParameterError {
    /// No model of that name comes with the library.
    #[error(
        "no motor model is called \"{name}\"; there are {}, or write a parameter file of your own",
        MODELS.map(|model| model.name).join(", ")
    )]
    UnknownModel {
        /// The name that was asked for.
        name: String,
    },
    /// Not TOML, a key missing, unknown or of another type.
    #[error("motor parameters: {0}")]
    Toml(#[source] Box<toml::de::Error>),
    /// A figure that is impossible.
    #[error("{key}: {error}")]
    OutOfRange {
        /// Table and key of the figure.
        key: &'static str,
        /// What is allowed, and what was given.
        error: ImpossibleFigure,
    },
    /// A load, a supply or the like that is impossible.
    #[error("{0}")]
    Setting(#[from] ImpossibleFigure),
    /// Two figures that contradict each other.
    #[error("{low_key} must be at most {high_key}, but they are {low} and {high}: change either")]
    Contradiction {
        /// Table and key of the figure that must be the smaller one or equal.
        low_key: &'static str,
        /// Its value.
        low: f64,
        /// Table and key of the figure that must be the larger one or equal.
        high_key: &'static str,
        /// Its value.
        high: f64,
    },
    /// The scales of this firmware's motion mode depend on the motor, and were not given.
    #[error(
        "firmware: the scales of {0}'s motion mode depend on the motor: give the largest values in \
         [motion], which are position_rad, velocity_rad_s, kp, kd and torque_nm"
    )]
    NoMotionRanges(Firmware),
    /// Figures that make something faster than the step of the simulation can follow.
    #[error(
        "{what}: the rate must be at most {limit_per_s:.0} /s for the simulation's step, but it is \
         {rate_per_s:.0} /s"
    )]
    TooFast {
        /// What it is, and which figures to change.
        what: &'static str,
        /// How fast it is, 1/s.
        rate_per_s: f64,
        /// The fastest that the step can follow, 1/s.
        limit_per_s: f64,
    },
    /// A load that swings faster than the step of the simulation can follow.
    #[error(
        "the load is too stiff for the simulation's step: {stiffness_nm_per_rad:.0} N·m/rad, but with \
         {inertia_kg_m2:.4} kg·m² at the output shaft at most {most_nm_per_rad:.0} N·m/rad: make its \
         {part} softer or give it more inertia"
    )]
    TooStiff {
        /// The stiffest part.
        part: &'static str,
        /// Stiffness of all parts that act together, N·m/rad.
        stiffness_nm_per_rad: f64,
        /// The largest that the step can follow with this inertia: 4·10⁶ N·m/rad for each kg·m², or 10⁸ for
        /// each of the load's own behind a gear with backlash.
        most_nm_per_rad: f64,
        /// Inertia at the output shaft, kg·m²: motor and load, or only the load behind a gear with backlash.
        inertia_kg_m2: f64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::plant::catalogue_name;

    const X6: crate::sim::plant::Model = MODELS[5];

    fn edited(from: &str, to: &str) -> Result<MotorParameters, ParameterError> {
        let text = X6.toml;
        assert_eq!(text.matches(from).count(), 1, "{from} in the model file");
        MotorParameters::from_toml(&text.replace(from, to))
    }

    #[test]
    fn every_model_loads_under_its_name_and_reads_back_as_it_is_written() {
        for model in MODELS {
            let parameters = MotorParameters::named(&model.name.to_lowercase()).unwrap();
            assert!(parameters.name.starts_with(model.name), "{}", parameters.name);
            let catalogue = catalogue_name(model.name);
            assert_eq!(MotorParameters::named(&catalogue).as_ref(), Ok(&parameters), "{catalogue}");
            let text = toml::to_string(&parameters).unwrap();
            assert_eq!(MotorParameters::from_toml(&text), Ok(parameters));
        }
    }

    #[test]
    fn errors_of_a_key_are_explained() {
        let ratio = "ratio = 19.612";
        for (wrong, message) in [
            ("ratio = 19.612\nteeth = 12", &["teeth", "ratio"][..]),
            ("", &["missing field `ratio`"]),
            ("ratio = \"twenty\"", &["ratio", "f64", "twenty"]),
        ] {
            let text = edited(ratio, wrong).unwrap_err().to_string();
            assert!(message.iter().all(|word| text.contains(word)), "{text}");
        }
        // Whole numbers are figures too.
        assert_eq!(edited(ratio, "ratio = 20").unwrap().gear.ratio, 20.0);
    }

    #[test]
    fn file_needs_its_firmware_and_the_scales_that_this_leaves_open() {
        let v4_3 = "firmware = \"v4.3\"";
        assert!(edited(v4_3, "").unwrap_err().to_string().contains("missing field `firmware`"));
        let text = edited(v4_3, "firmware = \"v9\"").unwrap_err().to_string();
        assert!(text.contains("`v4.3` or `v4.4`"), "{text}");
        let v4_4 = "firmware = \"v4.4\"";
        assert_eq!(edited(v4_3, v4_4), Err(ParameterError::NoMotionRanges(Firmware::V4_4)));
        let motion = |torque: &str| {
            let values = "position_rad = 12.566\nvelocity_rad_s = 45\nkp = 500\nkd = 5";
            let text = X6.toml.replace(v4_3, v4_4);
            MotorParameters::from_toml(&format!("{text}\n[motion]\n{values}\n{torque}\n"))
        };
        let parameters = motion("torque_nm = 60").unwrap();
        let limits = parameters.motion_ranges().unwrap().limits();
        assert_eq!((limits.position_rad, limits.torque_nm), (12.566, 60.0));
        let text = toml::to_string(&parameters).unwrap();
        assert_eq!(MotorParameters::from_toml(&text), Ok(parameters));
        for (wrong, message) in [
            ("", "missing field `torque_nm`"),
            ("torque_nm = -60", "torque range must be"),
            ("torque_nm = 60\nki = 1", "unknown field `ki`"),
        ] {
            let text = motion(wrong).unwrap_err().to_string();
            assert!(text.contains(message), "{text}");
        }
    }

    /// No figure of the file is taken unchecked.
    #[test]
    fn every_figure_has_a_range() {
        let whole: toml::Table = X6.toml.parse().unwrap();
        let refuses = |table: &str, key: &str, wrong: toml::Value| {
            let mut changed = whole.clone();
            changed[table][key] = wrong;
            let error = MotorParameters::from_toml(&changed.to_string()).unwrap_err();
            let full = format!("{table}.{key}");
            assert!(
                matches!(error, ParameterError::OutOfRange { key, .. } if key == full),
                "{changed}: {error}"
            );
            assert!(error.to_string().starts_with(&full), "{error}");
        };
        let mut figures = 0;
        for (table, keys) in
            whole.iter().filter_map(|(name, value)| Some((name, value.as_table()?)))
        {
            for (key, value) in keys.iter().filter(|(_, value)| !value.is_str()) {
                let wrong: &[toml::Value] = match value {
                    toml::Value::Integer(_) if key == "pole_pairs" || key == "bits" => {
                        &[0.into(), 127.into()]
                    }
                    toml::Value::Integer(_) if key == "output_bits" => &[127.into()],
                    _ => &[(-1.0).into(), f64::NAN.into(), f64::INFINITY.into()],
                };
                for wrong in wrong {
                    refuses(table, key, wrong.clone());
                }
                figures += 1;
            }
        }
        assert_eq!(figures, 33);
        refuses("gear", "ratio", 0.0.into());
        refuses("motor", "rotor_inertia_kg_m2", 0.0.into());
    }

    #[test]
    fn figures_that_contradict_each_other_are_refused() {
        let text = edited("static_nm = 1.6", "static_nm = 1").unwrap_err().to_string();
        assert_eq!(
            text,
            "friction.coulomb_nm must be at most friction.static_nm, but they are 1.44 and 1: change either"
        );
        assert!(edited("min_voltage_v = 24", "min_voltage_v = 50").is_err());
        assert!(edited("peak_current_a = 29.1", "peak_current_a = 9.4").is_err());
    }
}

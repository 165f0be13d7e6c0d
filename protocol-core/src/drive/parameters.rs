//! What distinguishes one drive from another: its motor, its bus, its limits.

use crate::command::{BaudCode, ModelName, MotionRanges, VersionDate};
use crate::drive::derating::Derating;
use crate::drive::quirks::Quirks;
use crate::drive::settings::Gains;
use crate::firmware::Firmware;
use crate::id::MotorId;
use crate::time::Duration;

/// The bus that a drive is built for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Bus {
    /// CAN.
    #[default]
    Can,
    /// RS485.
    Rs485,
}

impl Bus {
    /// Bits per second that this code means on the bus (2.32); `None` for a code without a meaning there.
    pub const fn bits_per_second(self, code: BaudCode) -> Option<u32> {
        match self {
            Self::Can => code.can_bits_per_second(),
            Self::Rs485 => code.rs485_bits_per_second(),
        }
    }
}

/// A struct whose fields each have their default beside them.
macro_rules! defaults {
    ($(#[$attr:meta])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ pub $field:ident: $type:ty = $default:expr,)+
    }) => {
        $(#[$attr])*
        pub struct $name {
            $($(#[doc = $doc])+ pub $field: $type,)+
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)+ }
            }
        }
    };
}

defaults! {
    /// The measurements at which errors come (manual 8.2). The manual gives no numbers: the maker sets them for each
    /// model.
    ///
    /// A measurement beyond its limit for [`confirm_time`](Self::confirm_time) raises its error. An error of level two
    /// ends once the measurement has been back by the margin for as long.
    ///
    /// The defaults are for a supply of 24 to 48 V.
    #[derive(Clone, Copy, Debug, PartialEq)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
    pub struct FaultLimits {
        /// Lowest supply voltage, V.
        pub under_voltage_v: f32 = 12.0,
        /// Highest supply voltage, V.
        pub over_voltage_v: f32 = 58.0,
        /// How far the voltage must be back, V.
        pub voltage_margin_v: f32 = 1.0,
        /// Largest phase current either way, A.
        pub over_current_a: f32 = 40.0,
        /// Largest supply current, A: what the manual calls power.
        pub supply_current_a: f32 = 25.0,
        /// Largest speed of the output shaft either way, degrees per second.
        pub over_speed_dps: f32 = 2_500.0,
        /// Highest temperature of the output stage, °C.
        pub mos_temperature_c: f32 = 85.0,
        /// Highest motor temperature, °C.
        pub motor_temperature_c: f32 = 90.0,
        /// How far a temperature must be back, °C.
        pub temperature_margin_c: f32 = 10.0,
        /// How far supply current and speed must be back, as a part of their limits, 0 to 1.
        pub relative_margin: f32 = 0.1,
        /// Below this speed of the output shaft, degrees per second, a motor at its stall current
        /// stalls.
        pub stall_speed_dps: f32 = 3.0,
        /// For how long it must do so.
        pub stall_time: Duration = Duration::from_millis(1_000),
        /// For how long any other measurement must be beyond its limit, or back.
        pub confirm_time: Duration = Duration::from_millis(10),
    }
}

defaults! {
    /// Everything about a drive that no command changes.
    ///
    /// The defaults are those of a middling motor with the encoder and gear of the manual's example
    /// (2.15.4) and the model name of 2.33.4.
    ///
    /// ```
    /// use myactuator_protocol_core::drive::{Bus, Parameters};
    ///
    /// let parameters = Parameters { bus: Bus::Rs485, has_brake: true, ..Parameters::default() };
    /// assert_eq!(parameters.pulses_per_output_turn(), 98_304); // 2.15.4: 16384 pulses, a gear of 6
    /// ```
    #[derive(Clone, Copy, Debug, PartialEq)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
    pub struct Parameters {
        /// The id that an empty memory starts with.
        pub id: MotorId = MotorId::MIN,
        /// The bus.
        pub bus: Bus = Bus::Can,
        /// The bit rate that an empty memory starts with.
        pub baud_rate: BaudCode = BaudCode::CAN_1M_RS485_500K,
        /// The model's name (0xB5).
        pub model: ModelName = ModelName::from_bytes(*b"X8S2V10"),
        /// Which revision of the protocol it speaks: its commands and their layouts.
        pub firmware: Firmware = Firmware::V4_3,
        /// The date of the software (0xB2).
        pub version_date: VersionDate = VersionDate::from_raw(20_250_512),
        /// Bits of the encoder on the motor shaft: 14 for 16384 pulses in a turn. At most 24.
        pub encoder_bits: u8 = 14,
        /// Whether there is a second encoder on the output shaft. With only the one on the motor shaft, after a start
        /// the drive knows where the output is only within a turn of the motor shaft.
        pub output_encoder: bool = true,
        /// Turns of the motor shaft in one of the output shaft.
        pub gear_ratio: f64 = 6.0,
        /// Torque at the output shaft for a current of 1 A, N·m/A.
        pub torque_constant_nm_per_a: f32 = 2.0,
        /// Rated current, A: the 100 % of torque limits.
        pub rated_current_a: f32 = 6.0,
        /// Stall current, A: the largest that any command gets.
        pub stall_current_a: f32 = 12.0,
        /// How the stall current falls with heat; `None` if it does not.
        pub derating: Option<Derating> = None,
        /// The fastest that a planned position profile turns the output shaft, degrees per second,
        /// where its command sets no limit.
        pub max_speed_dps: f32 = 1_500.0,
        /// When errors come.
        pub limits: FaultLimits = FaultLimits::default(),
        /// Below this supply voltage, V, the electronics stop, as without a supply; above it by
        /// [`voltage_margin_v`](FaultLimits::voltage_margin_v) they start again. 0 for never.
        pub brown_out_voltage_v: f32 = 0.0,
        /// Gains that an empty memory starts with.
        pub factory_gains: Gains = Gains::tuned(0.02, 2.0, 1_000.0),
        /// The scales of motion mode.
        pub motion_ranges: MotionRanges = MotionRanges::V4_3,
        /// Whether the motor has a brake. Without one the brake commands are answered and do
        /// nothing.
        pub has_brake: bool = false,
        /// The shortest time from a command to its reply.
        pub response_delay_min: Duration = Duration::from_micros(800),
        /// The longest time from a command to its reply.
        pub response_delay_max: Duration = Duration::from_micros(800),
        /// Seed of everything that the drive does at random. The same seed gives the same run.
        pub seed: u32 = 1,
        /// The step of the control loops; at least 1 µs. The factory gains are for the default.
        pub control_period: Duration = Duration::from_micros(100),
        /// How long the drive is deaf after a start.
        pub boot_time: Duration = Duration::ZERO,
        /// Behaviour that the manual does not describe.
        pub quirks: Quirks = Quirks::default(),
    }
}

impl Parameters {
    /// Encoder pulses in a turn of the motor shaft.
    pub const fn pulses_per_motor_turn(&self) -> i64 {
        let bits = if self.encoder_bits > 24 { 24 } else { self.encoder_bits };
        1 << bits
    }

    /// Encoder pulses in a turn of the output shaft, to the nearest pulse. A gear ratio that is no
    /// positive number counts as 1.
    pub fn pulses_per_output_turn(&self) -> i64 {
        crate::round::round_f64(self.exact_pulses_per_output_turn()) as i64
    }

    pub(super) fn exact_pulses_per_output_turn(&self) -> f64 {
        let ratio = self.gear_ratio;
        let ratio = if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 };
        (self.pulses_per_motor_turn() as f64 * ratio).clamp(1.0, (1_u64 << 40) as f64)
    }

    /// How long the drive is deaf after a start, its quirk included.
    pub(super) fn start_time(&self) -> Duration {
        if self.quirks.slow_boot { self.boot_time.max(Quirks::SLOW_BOOT) } else { self.boot_time }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn senseless_numbers_do_no_harm() {
        for gear_ratio in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let parameters = Parameters { gear_ratio, encoder_bits: 255, ..Parameters::default() };
            assert_eq!(parameters.pulses_per_output_turn(), 1 << 24);
        }
    }
}

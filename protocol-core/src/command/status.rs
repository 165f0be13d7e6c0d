//! The three status reads (manual 2.14 to 2.16), and the feedback that control commands share.
//!
//! # Errors on the indicator light
//! | light (8.1) | the motor |
//! |---|---|
//! | steadily on | runs normally |
//! | slow blinking | has an error of [level two](ErrorLevel::Two) |
//! | fast blinking | has an error of [level one](ErrorLevel::One) |
//!
//! Hardware over-current, of level one, is in the table of errors and their levels (8.2) but has no bit among the
//! [`ErrorFlags`] of 0x9A (2.14.3): only the light shows it.

use core::fmt;

use bitflags::bitflags;

use crate::data::{self, Data};
use crate::quantity::{Form, Name, OutOfRange, Quantity, Unit};
use crate::units::{CoarseAngle, CoarseSpeed, Current, Temperature, Voltage};

command! {
    /// Read temperatures, brake, voltage and error flags: 0x9A (2.14).
    ReadStatus1 -> Status1
}

reply! {
    /// Temperatures, brake, supply voltage and error flags (2.14.3). A drive whose error reporting
    /// is on sends it unasked every 100 ms while an error lasts (function 3, 2.35.4).
    Status1 {
        /// Motor temperature.
        temperature: Temperature => 1,
        /// MOSFET temperature.
        mosfet_temperature: Temperature => 2,
        /// The brake's last command.
        brake: BrakeCommand => 3,
        /// Supply voltage.
        voltage: Voltage => 4,
        /// Everything that is wrong.
        errors: ErrorFlags => 6,
    }
}

code! {
    /// The brake's last command (2.14.3). It is the command, not the brake's true state, and on
    /// some firmware 1 only while a command runs.
    BrakeCommand "brake" {
        /// Lock.
        LOCK = 0 "lock",
        /// Release.
        RELEASE = 1 "release",
    }
}

/// How bad an error is, and what the indicator light shows (8.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ErrorLevel {
    /// The motor cannot recover: find the cause, then restart it. The light blinks fast.
    One,
    /// The motor runs again on its own once the conditions for that are met. The light blinks slowly, then is steadily
    /// on again.
    Two,
}

macro_rules! error_flags {
    ($($(#[doc = $doc:literal])+ $flag:ident = $bit:literal $name:literal $level:expr, $text:literal;)+) => {
        bitflags! {
            /// Everything that is wrong with a motor, one bit each (2.14.3). Bits that the manual
            /// does not name are kept. Hardware over-current (8.2) has none.
            ///
            /// ```
            /// use myactuator_protocol_core::command::ErrorFlags;
            ///
            /// let errors = ErrorFlags::from_bits_retain(0x0016); // the manual's example
            /// assert_eq!(
            ///     errors.to_string(),
            ///     "motor stalled, supply voltage too low, phase current too high"
            /// );
            /// assert!(errors.needs_restart());
            /// ```
            #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
            #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
            pub struct ErrorFlags: u16 {
                $($(#[doc = $doc])+ const $flag = $bit;)+
                const _ = !0;
            }
        }

        impl ErrorFlags {
            /// The names of the named errors.
            pub const QUANTITY: Quantity = Quantity {
                name: "errors",
                unit: Unit::None,
                form: Form::Flags(&[$(Name { raw: $bit, name: $name, meaning: $text }),+]),
            };

            /// Every error that the manual names.
            pub const NAMED: &'static [Self] = &[$(Self::$flag),+];

            /// The name in tools of a single error, `None` for an unnamed bit or several.
            pub const fn name(self) -> Option<&'static str> {
                match self.bits() { $($bit => Some($name),)+ _ => None }
            }

            /// What a single error means, for people; `None` for an unnamed bit or several.
            pub const fn description(self) -> Option<&'static str> {
                match self.bits() { $($bit => Some($text),)+ _ => None }
            }

            /// The level of a single error (8.2). `None` where the manual gives none, for unnamed
            /// bits and for several.
            pub const fn level(self) -> Option<ErrorLevel> {
                match self.bits() { $($bit => $level,)+ _ => None }
            }
        }
    };
}

error_flags! {
    /// The current is at its stall value, the speed is low, and it lasts: too much load.
    STALL = 0x0002 "stall" Some(ErrorLevel::One), "motor stalled";
    /// Supply voltage below its limit.
    UNDER_VOLTAGE = 0x0004 "under-voltage" Some(ErrorLevel::Two), "supply voltage too low";
    /// Supply voltage above its limit.
    OVER_VOLTAGE = 0x0008 "over-voltage" Some(ErrorLevel::Two), "supply voltage too high";
    /// Phase current above its limit, as the drive's software measures it: a short, a lost phase, loss
    /// of control, a broken motor.
    OVER_CURRENT = 0x0010 "over-current" Some(ErrorLevel::One), "phase current too high";
    /// Supply current above its limit: too much load, or too fast.
    OVER_POWER = 0x0040 "over-power" Some(ErrorLevel::Two), "power too high";
    /// Calibration values could not be written (2.14.3) or were lost and could not be read (8.2).
    CALIBRATION_PARAMETERS = 0x0080 "calibration-write" Some(ErrorLevel::One), "calibration values lost";
    /// Speed above its limit: over-voltage, or driven from outside.
    OVER_SPEED = 0x0100 "over-speed" Some(ErrorLevel::Two), "speed too high";
    /// Power electronics too hot. The manual gives no level.
    COMPONENT_OVER_TEMPERATURE = 0x0800 "component-over-temperature" None, "power electronics too hot";
    /// Motor too hot.
    MOTOR_OVER_TEMPERATURE = 0x1000 "motor-over-temperature" Some(ErrorLevel::Two), "motor too hot";
    /// Encoder calibration too far from the standard value.
    ENCODER_CALIBRATION = 0x2000 "encoder-calibration" Some(ErrorLevel::Two), "encoder calibration off";
    /// Encoder data wrong. The manual gives no level.
    ENCODER_DATA = 0x4000 "encoder-data" None, "encoder data wrong";
}

impl ErrorFlags {
    /// Each error on its own, lowest bit first, unnamed bits included.
    pub fn each(self) -> impl Iterator<Item = Self> + Clone {
        (0..16)
            .map(|bit| Self::from_bits_retain(1 << bit))
            .filter(move |&error| self.contains(error))
    }

    /// Whether any error ends only with a restart. Errors whose level the manual does not give count as such, so that
    /// nobody waits for a recovery that may not come.
    pub fn needs_restart(self) -> bool {
        self.each().any(|error| error.level() != Some(ErrorLevel::Two))
    }

    pub(crate) const BYTES: u8 = 2;

    #[inline(always)]
    pub(crate) const fn put<const AT: usize>(self, data: &mut Data) {
        data::put_u16::<AT>(data, self.bits());
    }

    #[inline(always)]
    pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
        Ok(Self::from_bits_retain(data::get_u16::<AT>(data)))
    }
}

impl fmt::Display for ErrorFlags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return f.write_str("no error");
        }
        for (place, error) in self.each().enumerate() {
            if place > 0 {
                f.write_str(", ")?;
            }
            match error.description() {
                Some(text) => f.write_str(text)?,
                None => write!(f, "unknown error 0x{:04X}", error.bits())?,
            }
        }
        Ok(())
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for ErrorFlags {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "ErrorFlags({=u16:#06x})", self.bits());
    }
}

command! {
    /// Read temperature, torque current, speed and angle: 0x9C (2.15).
    ReadStatus2 -> Feedback
}

reply! {
    /// The present state of the motor: what 0x9C reads and most control commands answer with (2.15.3, 2.19.3, 2.20.3,
    /// 2.21.3, 2.23.3, 2.24.3).
    Feedback {
        /// Motor temperature.
        temperature: Temperature => 1,
        /// Torque current.
        current: Current => 2,
        /// Speed of the output shaft.
        speed: CoarseSpeed => 4,
        /// Angle of the output shaft from its zero; it ends at ±32767 degrees.
        angle: CoarseAngle => 6,
    }
}

command! {
    /// Read temperature and phase currents: 0x9D (2.16).
    ReadStatus3 -> Status3
}

reply! {
    /// Temperature and phase currents (2.16.3).
    Status3 {
        /// Motor temperature.
        temperature: Temperature => 1,
        /// Current of phase A.
        phase_a_current: Current => 2,
        /// Current of phase B.
        phase_b_current: Current => 4,
        /// Current of phase C.
        phase_c_current: Current => 6,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn errors_the_manual_does_not_name_are_kept_and_printed() {
        let errors = ErrorFlags::from_bits_retain(0x0020 | 0x0002);
        assert_eq!(errors.bits(), 0x0022);
        assert_eq!(errors.to_string(), "motor stalled, unknown error 0x0020");
        assert_eq!(ErrorFlags::empty().to_string(), "no error");
    }
}

//! The description of a field: what the macros of [`layout`](super::layout) make besides the code.

use core::fmt;

use crate::command::{ErrorFlags, ModelName, MotionRanges, VersionDate};
use crate::data::Data;
use crate::quantity::{Form, OutOfRange, Place, Quantity, Steps};
use crate::round::round_f64;
use crate::units::decimal;

/// One field of a command or reply: its name, meaning, quantity and place, and a way to read and to write it.
///
/// ```
/// use myactuator_protocol_core::Opcode;
///
/// let [max_speed, angle] = Opcode::AbsolutePosition.command_fields() else { panic!() };
/// assert_eq!((max_speed.name, angle.name), ("max_speed", "angle"));
/// assert_eq!(angle.quantity.unit.symbol(), "deg");
///
/// let mut data = [0xA4, 0, 0, 0, 0, 0, 0, 0];
/// angle.put(&mut data, angle.quantity.nearest(360.0)?)?;
/// assert_eq!(data, [0xA4, 0, 0, 0, 0xA0, 0x8C, 0, 0]);
/// assert_eq!(angle.quantity.amount(angle.raw(&data)), 360.0);
/// # Ok::<(), myactuator_protocol_core::OutOfRange>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct Field {
    /// Its name in code: `"max_speed"`.
    pub name: &'static str,
    /// What it means, for people.
    pub meaning: &'static str,
    /// What it holds.
    pub quantity: &'static Quantity,
    /// Where it lies.
    pub place: Place,
    /// Which frames have it: a function's value means something else for each function.
    pub when: When,
}

/// In which frames of its kind a field is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum When {
    /// In all.
    Always,
    /// In those whose byte at the first place has the second value.
    Byte(u8, u8),
    /// In those whose byte at the first place has none of these values.
    NoneOf(u8, &'static [u8]),
}

impl Field {
    /// A field of whole bytes that is in every frame of its kind.
    pub(crate) const fn bytes(
        name: &'static str,
        meaning: &'static str,
        quantity: &'static Quantity,
        first: u8,
        count: u8,
    ) -> Self {
        let place = Place::Bytes { first, count };
        Self { name, meaning, quantity, place, when: When::Always }
    }

    /// The same field, only in frames whose byte `at` is `code`.
    pub(crate) const fn only_when(self, at: u8, code: u8) -> Self {
        Self { when: When::Byte(at, code), ..self }
    }

    /// The same field, only in frames whose byte `at` is none of `codes`.
    pub(crate) const fn only_when_none(self, at: u8, codes: &'static [u8]) -> Self {
        Self { when: When::NoneOf(at, codes), ..self }
    }

    /// Its name followed by its unit, for programs: `"max_speed_dps"`.
    pub fn key(&self) -> Key {
        Key(self.name, self.quantity.unit.key())
    }

    /// Whether a data field has this field.
    pub fn is_in(&self, data: &Data) -> bool {
        let byte = |at: u8| data.get(usize::from(at)).copied();
        match self.when {
            When::Always => true,
            When::Byte(at, code) => byte(at) == Some(code),
            When::NoneOf(at, codes) => byte(at).is_some_and(|byte| !codes.contains(&byte)),
        }
    }

    /// The number on the wire, with its sign where it has one.
    pub fn raw(&self, data: &Data) -> i64 {
        let bits = self.place.get(data);
        match self.quantity.form {
            Form::Steps(Steps { min, .. }) if min < 0 => {
                let unused = (64 - self.place.bits()) % 64;
                (bits << unused) as i64 >> unused
            }
            Form::ReplyIdentifier => i64::from(super::bus_id::told_id(bits as u16)),
            _ => bits as i64,
        }
    }

    /// Puts a number there.
    ///
    /// # Errors
    /// [`OutOfRange`] for what the quantity does not allow.
    pub fn put(&self, data: &mut Data, raw: i64) -> Result<(), OutOfRange> {
        let fits = match self.quantity.form {
            // These allow no number that does not fit.
            Form::Steps(_) | Form::Float | Form::Switch | Form::ReplyIdentifier => true,
            _ => raw >= 0 && raw as u64 >> (self.place.bits() % 64) == 0,
        };
        if !fits || !self.quantity.allows(raw) {
            let given = self.quantity.amount(raw).into();
            return Err(OutOfRange { quantity: self.quantity, given });
        }
        let bits = match self.quantity.form {
            Form::ReplyIdentifier => 0x240 + raw as u64,
            _ => raw as u64,
        };
        self.place.put(data, bits);
        Ok(())
    }

    /// As text for people, with name and unit. A motion value is converted by these scales, or printed as its step if
    /// they are not known.
    pub(super) fn print(
        &self,
        f: &mut fmt::Formatter<'_>,
        data: &Data,
        ranges: Option<&MotionRanges>,
    ) -> fmt::Result {
        let raw = self.raw(data);
        let symbol = self.quantity.unit.symbol();
        if !matches!(self.quantity.form, Form::Flags(_)) {
            self.print_name(f)?;
        }
        match self.quantity.form {
            Form::Steps(steps) => decimal::print(f, raw, &steps, symbol),
            Form::Float => write!(f, "{}", f32::from_bits(raw as u32)),
            Form::Code(_) => match self.quantity.name_of(raw) {
                Some(name) => write!(f, "{name} ({raw})"),
                None => write!(f, "unknown code {raw}"),
            },
            Form::Switch => f.write_str(if raw == 1 { "on" } else { "off" }),
            Form::Flags(_) => match ErrorFlags::from_bits_retain(raw as u16) {
                none if none.is_empty() => write!(f, "{none}"),
                errors if errors.needs_restart() => {
                    write!(f, "errors: {errors} (a restart is needed)")
                }
                errors => write!(f, "errors: {errors}"),
            },
            Form::Date => match VersionDate::from_raw(raw as u32) {
                date if date.year_month_day().is_some() => write!(f, "{raw} ({date})"),
                _ => write!(f, "{raw}"),
            },
            Form::Text => write!(f, "{}", ModelName::of(data)),
            Form::ReplyIdentifier => write!(f, "{raw}"),
            Form::Motion(scale) => match ranges {
                // Further decimals only come from the scale, and mean nothing.
                Some(ranges) => {
                    let value = round_f64(ranges.value(scale, raw as u16) * 1e4) / 1e4;
                    write!(f, "{value} {symbol}")
                }
                None => write!(f, "step {raw}"),
            },
        }
    }

    fn print_name(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for word in self.name.split('_') {
            write!(f, "{word} ")?;
        }
        Ok(())
    }
}

/// A field's name and unit in one word: see [`Field::key`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Key(&'static str, &'static str);

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)?;
        if self.1.is_empty() { Ok(()) } else { write!(f, "_{}", self.1) }
    }
}

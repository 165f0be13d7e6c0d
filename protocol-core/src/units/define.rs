//! The macro that makes a quantity's type from one line: its range, its scale, and its conversions.

/// One quantity: its integer on the wire, its name, its unit, and a step in that unit.
///
/// - `in` restricts the numbers on the wire; without it every one is allowed.
/// - `zero` says what 0 means if it is not an amount. Then no amount becomes it, not even 0: what is computed may come
///   down to 0, and must not mean "no limit".
/// - `floats` and `doubles` name the conversions from the unit, to the nearest allowed value and to
///   the unit; `radians` those from and to radians, over the conversions in degrees.
/// - `arithmetic` gives it `-x`, `x + y` and `x - y`.
macro_rules! quantity {
    (
        $(#[$attr:meta])*
        $name:ident($raw:ident $put:ident $get:ident) $what:literal $unit:ident, step $numerator:literal/$denominator:literal
        $(, zero $zero:literal)? $(, in $min:literal..=$max:literal)?
        $(; floats $($floats:ident)+)?
        $(; doubles $($doubles:ident)+)?
        $(; radians $($radians:ident)+)?
        $(; signed $arithmetic:ident)?
    ) => {
        $(#[$attr])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name($raw);

        impl $name {
            const MIN_RAW: $raw = quantity!(@min $raw [$($zero)?] [$($min)?]);
            const MAX_RAW: $raw = quantity!(@max $raw [$($max)?]);
            const STEPS: Steps = Steps {
                min: Self::MIN_RAW as i64,
                max: Self::MAX_RAW as i64,
                zero: quantity!(@zero $($zero)?),
                numerator: $numerator,
                denominator: $denominator,
            };
            /// Name, unit, scale and allowed range.
            pub const QUANTITY: Quantity =
                Quantity { name: $what, unit: Unit::$unit, form: Form::Steps(Self::STEPS) };
            /// The smallest amount.
            pub const MIN: Self = Self(Self::MIN_RAW);
            /// The largest amount.
            pub const MAX: Self = Self(Self::MAX_RAW);
        }

        quantity!(@default $name [$($zero)?] [$($min)?]);
        quantity!(@raw $name $raw [$($min)?]);
        quantity!(@wire $name($raw $put $get));
        $(quantity!(@floats $name $raw f32 round_f32 $unit $($floats)+);)?
        $(quantity!(@floats $name $raw f64 round_f64 $unit $($doubles)+);)?
        $(quantity!(@radians $name $($radians)+);)?
        $(quantity!(@$arithmetic $name);)?
    };
    (@zero) => { None };
    (@zero $zero:literal) => { Some($zero) };
    (@min $raw:ident [] []) => { $raw::MIN };
    (@min $raw:ident [$zero:literal] []) => { 1 };
    (@min $raw:ident [$($zero:literal)?] [$min:literal]) => { $min };
    (@max $raw:ident []) => { $raw::MAX };
    (@max $raw:ident [$max:literal]) => { $max };
    (@default $name:ident [] []) => {
        /// Nothing: 0.
        impl Default for $name {
            fn default() -> Self {
                Self(0)
            }
        }
    };
    // A 0 that means "no limit" must not be a default.
    (@default $name:ident [$($zero:literal)?] [$($min:literal)?]) => {};
    (@raw $name:ident $raw:ident []) => {
        impl $name {
            /// The quantity with this integer on the wire.
            #[inline]
            pub const fn from_raw(raw: $raw) -> Self {
                Self(raw)
            }

            #[inline(always)]
            const fn checked(raw: $raw) -> Result<Self, OutOfRange> {
                Ok(Self(raw))
            }
        }
    };
    (@raw $name:ident $raw:ident [$min:literal]) => {
        impl $name {
            /// The quantity with this integer on the wire.
            ///
            /// # Errors
            /// [`OutOfRange`] for what [`QUANTITY`](Self::QUANTITY) does not allow.
            #[inline]
            pub const fn try_from_raw(raw: $raw) -> Result<Self, OutOfRange> {
                if Self::STEPS.allow(raw as i64) {
                    Ok(Self(raw))
                } else {
                    let given = Given::steps(raw as u32, Self::STEPS.per_unit() as u16);
                    Err(OutOfRange { quantity: &Self::QUANTITY, given })
                }
            }

            #[inline(always)]
            const fn checked(raw: $raw) -> Result<Self, OutOfRange> {
                Self::try_from_raw(raw)
            }
        }

        impl TryFrom<$raw> for $name {
            type Error = OutOfRange;
            fn try_from(raw: $raw) -> Result<Self, OutOfRange> {
                Self::try_from_raw(raw)
            }
        }

        impl From<$name> for $raw {
            fn from(quantity: $name) -> $raw {
                quantity.0
            }
        }
    };
    (@wire $name:ident($raw:ident $put:ident $get:ident)) => {
        impl $name {
            /// The integer on the wire.
            #[inline]
            pub const fn raw(self) -> $raw {
                self.0
            }

            pub(crate) const BYTES: u8 = size_of::<$raw>() as u8;

            #[inline(always)]
            pub(crate) const fn put<const AT: usize>(self, data: &mut Data) {
                data::$put::<AT>(data, self.0);
            }

            #[inline(always)]
            pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
                Self::checked(data::$get::<AT>(data))
            }
        }

        /// The amount and its unit, by the format's width and precision.
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                decimal::print(f, self.0.into(), &Self::STEPS, Self::QUANTITY.unit.symbol())
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!(stringify!($name), "({})"), self)
            }
        }

        /// The amount in the unit for formats that people read, the integer on the wire for others.
        #[cfg(feature = "serde")]
        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                if serializer.is_human_readable() {
                    serializer.serialize_f64(Self::QUANTITY.amount(self.0.into()))
                } else {
                    self.0.serialize(serializer)
                }
            }
        }

        #[cfg(feature = "serde")]
        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let raw = if deserializer.is_human_readable() {
                    const { &Self::QUANTITY }
                        .nearest(f64::deserialize(deserializer)?)
                        .map_err(serde::de::Error::custom)? as $raw
                } else {
                    $raw::deserialize(deserializer)?
                };
                Self::checked(raw).map_err(serde::de::Error::custom)
            }
        }
    };
    (@floats $name:ident $raw:ident $float:ident $round:ident $unit:ident
        $from:ident $saturating:ident $to:ident) => {
        impl $name {
            #[doc = concat!("From [`", stringify!($unit), "`](Unit::", stringify!($unit), "), rounded to the nearest step.")]
            ///
            /// # Errors
            /// [`OutOfRange`] for NaN and for what [`QUANTITY`](Self::QUANTITY) does not allow.
            #[inline]
            pub const fn $from(value: $float) -> Result<Self, OutOfRange> {
                let steps = $round(value * Self::STEPS.per_unit() as $float);
                if steps >= Self::MIN_RAW as $float && steps <= Self::MAX_RAW as $float {
                    Ok(Self(steps as $raw))
                } else {
                    Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::$float(value) })
                }
            }

            #[doc = concat!("From [`", stringify!($unit), "`](Unit::", stringify!($unit), "), the nearest allowed amount.")]
            ///
            /// # Errors
            /// [`OutOfRange`] for NaN only.
            #[inline]
            pub const fn $saturating(value: $float) -> Result<Self, OutOfRange> {
                let steps = $round(value * Self::STEPS.per_unit() as $float);
                if value.is_nan() {
                    Err(OutOfRange { quantity: &Self::QUANTITY, given: Given::$float(value) })
                } else if steps < Self::MIN_RAW as $float {
                    Ok(Self::MIN)
                } else if steps > Self::MAX_RAW as $float {
                    Ok(Self::MAX)
                } else {
                    Ok(Self(steps as $raw))
                }
            }

            #[doc = concat!("In [`", stringify!($unit), "`](Unit::", stringify!($unit), ").")]
            #[inline]
            pub const fn $to(self) -> $float {
                self.0 as $float / Self::STEPS.per_unit() as $float
            }
        }
    };
    (@radians $name:ident $from:ident $to:ident by $from_degrees:ident $degrees:ident) => {
        impl $name {
            /// From radians (a second), rounded to the nearest step.
            ///
            /// # Errors
            /// [`OutOfRange`] for NaN and for what [`QUANTITY`](Self::QUANTITY) does not allow.
            pub const fn $from(value: f32) -> Result<Self, OutOfRange> {
                Self::$from_degrees(value.to_degrees())
            }

            /// In radians (a second).
            pub const fn $to(self) -> f32 {
                self.$degrees().to_radians()
            }
        }
    };
    (@arithmetic $name:ident) => {
        /// For the most negative amount, returns the most positive.
        impl core::ops::Neg for $name {
            type Output = Self;
            fn neg(self) -> Self {
                Self(self.0.saturating_neg())
            }
        }

        /// If the sum lies beyond the range, returns the end of the range.
        impl core::ops::Add for $name {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0.saturating_add(other.0))
            }
        }

        /// If the difference lies beyond the range, returns the end of the range.
        impl core::ops::Sub for $name {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0.saturating_sub(other.0))
            }
        }
    };
}

//! Macros that turn a list of fields and their places into a type that encodes, decodes, prints and
//! describes itself.

#[cfg(feature = "serde")]
use core::fmt;

use crate::command::Field;
use crate::data::Data;
use crate::error::DecodeError;

/// What fills a data field after its command byte: a command or a reply.
pub trait Fields: Sized + 'static {
    /// What each field is and where it lies, in the order of the manual's tables.
    const FIELDS: &'static [Field];

    /// Puts them in their places.
    fn put(&self, data: &mut Data);

    /// Takes them from their places, whatever the command byte.
    ///
    /// # Errors
    /// [`DecodeError`] if one holds what is not allowed.
    fn read(data: &Data) -> Result<Self, DecodeError>;
}

/// A command whose fields each fill fixed bytes: `Name -> Reply { field: Type => first byte }`.
/// `-> Self` is for those that a drive answers with the same bytes.
macro_rules! command {
    ($(#[$attr:meta])* $name:ident -> $reply:ident) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct $name;
        command!(@impl $name {});
        command!(@reply $name $reply);
    };
    ($(#[$attr:meta])* $name:ident -> $reply:ident { $($fields:tt)+ }) => {
        fields!(@struct $(#[$attr])* $name { $($fields)+ });
        command!(@impl $name { $($fields)+ });
        command!(@reply $name $reply);
    };
    (@impl $name:ident { $($(#[doc = $doc:literal])+ $field:ident: $type:ty => $at:literal,)* }) => {
        impl $name {
            /// The data field.
            #[inline]
            #[allow(unused_mut, reason = "there may be no fields to put")]
            pub const fn encode(&self) -> $crate::Data {
                let mut data = $crate::command::with_opcode($crate::Opcode::$name);
                $(self.$field.put::<$at>(&mut data);)*
                data
            }
        }

        fields!($name { $($(#[doc = $doc])+ $field: $type => $at,)* });
        table_command!($name, $crate::Opcode::$name);
        targeted!($name);
    };
    (@reply $name:ident Self) => {
        reply_to!($name -> $name);
        reply_type!($name);
    };
    (@reply $name:ident $reply:ident) => {
        reply_to!($name -> $reply);
    };
}

/// The packets of a command to one motor or to all.
macro_rules! targeted {
    ($name:ident) => {
        impl $name {
            /// The command to one motor: at compile time too, and without [`AnyCommand`](crate::AnyCommand).
            #[inline]
            pub const fn packet(&self, motor: $crate::MotorId) -> $crate::Packet {
                self.packet_to($crate::Target::Motor(motor))
            }

            /// The command to one motor or to [all](crate::Target::All), on CAN those with their id
            /// filter off.
            #[inline]
            pub const fn packet_to(&self, target: $crate::Target) -> $crate::Packet {
                $crate::Packet { channel: $crate::Channel::Command(target), data: self.encode() }
            }
        }
    };
}

/// What every command of the table has, however its fields lie.
macro_rules! table_command {
    ($name:ident, $opcode:expr) => {
        impl $name {
            /// Its row in the table.
            pub const OPCODE: $crate::Opcode = $opcode;

            /// The command from a data field.
            ///
            /// # Errors
            /// [`DecodeError`](crate::DecodeError) if the command byte is another's or a field holds
            /// what is not allowed.
            #[inline]
            pub fn decode(data: &$crate::Data) -> Result<Self, $crate::DecodeError> {
                $crate::command::expect_opcode(data, Self::OPCODE)?;
                $crate::command::Fields::read(data)
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                let fields = <Self as $crate::command::Fields>::FIELDS;
                $crate::command::print::named(f, Self::OPCODE, fields, &self.encode())
            }
        }
    };
}

/// Ties a command of the table to its reply.
macro_rules! reply_to {
    ($name:ident -> $reply:ty) => {
        impl $crate::command::Command for $name {
            type Reply = $reply;

            #[inline]
            fn kind(&self) -> $crate::Kind {
                $crate::Kind::Known(Self::OPCODE)
            }

            #[inline]
            fn encode(&self) -> $crate::Data {
                Self::encode(self)
            }

            #[inline]
            fn decode_reply(data: &$crate::Data) -> Result<$reply, $crate::DecodeError> {
                $crate::command::expect_opcode(data, Self::OPCODE)?;
                $crate::command::Fields::read(data)
            }
        }
    };
}

/// Fields that each fill fixed bytes.
macro_rules! fields {
    (@struct $(#[$attr:meta])* $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $type:ty => $at:literal,)+
    }) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct $name {
            $($(#[doc = $doc])+ pub $field: $type,)+
        }
    };
    ($name:ident { $($(#[doc = $doc:literal])+ $field:ident: $type:ty => $at:literal,)* }) => {
        impl $crate::command::Fields for $name {
            const FIELDS: &'static [$crate::command::Field] = &[$($crate::command::Field::bytes(
                stringify!($field),
                concat!($($doc),+).trim_ascii(),
                &<$type>::QUANTITY,
                $at,
                <$type>::BYTES,
            )),*];

            #[inline(always)]
            fn put(&self, _data: &mut $crate::Data) {
                $(self.$field.put::<$at>(_data);)*
            }

            #[inline(always)]
            fn read(_data: &$crate::Data) -> Result<Self, $crate::DecodeError> {
                Ok(Self { $($field: <$type>::read::<$at>(_data)?,)* })
            }
        }
    };
}

/// A reply, and how it is taken out of an [`AnyReply`](crate::AnyReply).
macro_rules! reply_type {
    ($name:ident) => {
        impl $crate::command::Reply for $name {}

        /// Returns the reply if it is of this type, and otherwise the other one unchanged.
        impl TryFrom<$crate::AnyReply> for $name {
            type Error = $crate::AnyReply;
            fn try_from(reply: $crate::AnyReply) -> Result<Self, $crate::AnyReply> {
                reply.fields().downcast_ref().copied().ok_or(reply)
            }
        }
    };
}

/// A reply whose fields each fill fixed bytes.
macro_rules! reply {
    ($(#[$attr:meta])* $name:ident {
        $($(#[doc = $doc:literal])+ $field:ident: $type:ty => $at:literal,)+
    }) => {
        fields!(@struct $(#[$attr])* $name { $($(#[doc = $doc])+ $field: $type => $at,)+ });
        fields!($name { $($(#[doc = $doc])+ $field: $type => $at,)+ });
        reply_type!($name);

        impl $name {
            /// The data field of this answer to a command of kind `to`.
            #[inline]
            pub const fn encode(&self, to: $crate::Opcode) -> $crate::Data {
                let mut data = $crate::command::with_opcode(to);
                $(self.$field.put::<$at>(&mut data);)+
                data
            }
        }

        /// Its fields as a phrase.
        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                let mut data = [0; 8];
                $crate::command::Fields::put(self, &mut data);
                let fields = <Self as $crate::command::Fields>::FIELDS;
                $crate::command::Phrase { fields, data: &data, ranges: None }.fmt(f)
            }
        }
    };
}

/// A one-byte code. It holds any byte. The codes that the manual names have constants, so a code without a name can
/// never be taken for one with a name.
macro_rules! code {
    ($(#[$attr:meta])* $name:ident $what:literal {
        $($(#[doc = $doc:literal])+ $variant:ident = $raw:literal $kebab:literal,)+
    }) => {
        $(#[$attr])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name(u8);

        impl $name {
            $($(#[doc = $doc])+ pub const $variant: Self = Self($raw);)+

            /// Every code that the manual names.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The names of the named codes.
            pub const QUANTITY: $crate::quantity::Quantity = $crate::quantity::Quantity {
                name: $what,
                unit: $crate::quantity::Unit::None,
                form: $crate::quantity::Form::Code(&[$($crate::quantity::Name {
                    raw: $raw,
                    name: $kebab,
                    meaning: concat!($($doc),+).trim_ascii(),
                }),+]),
            };
        }

        code_methods!($name);
    };
}

/// What every code has, once it has a `QUANTITY` with its names.
macro_rules! code_methods {
    ($name:ident) => {
        impl $name {
            /// The code with this byte on the wire, named or not.
            #[inline]
            pub const fn from_raw(raw: u8) -> Self {
                Self(raw)
            }

            /// The byte on the wire.
            #[inline]
            pub const fn raw(self) -> u8 {
                self.0
            }

            /// Its name in tools, `None` where the manual gives none.
            pub fn name(self) -> Option<&'static str> {
                Self::QUANTITY.name_of(self.0.into())
            }
        }

        #[allow(dead_code, reason = "not every code is the type of a field")]
        impl $name {
            pub(crate) const BYTES: u8 = 1;

            #[inline(always)]
            pub(crate) const fn put<const AT: usize>(self, data: &mut $crate::Data) {
                data[AT] = self.0;
            }

            #[inline(always)]
            pub(crate) const fn read<const AT: usize>(
                data: &$crate::Data,
            ) -> Result<Self, $crate::OutOfRange> {
                Ok(Self(data[AT]))
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self.name() {
                    Some(name) => f.pad(name),
                    None => write!(f, "unknown code {}", self.0),
                }
            }
        }

        impl core::fmt::Debug for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                write!(f, concat!(stringify!($name), "({})"), self)
            }
        }

        /// By its name for formats that people read, where it has one; else by its number.
        #[cfg(feature = "serde")]
        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                match self.name().filter(|_| serializer.is_human_readable()) {
                    Some(name) => serializer.serialize_str(name),
                    None => serializer.serialize_u8(self.0),
                }
            }
        }

        #[cfg(feature = "serde")]
        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                $crate::command::layout::code_from(deserializer, &Self::QUANTITY).map(Self)
            }
        }
    };
}

/// A code by its name or number.
#[cfg(feature = "serde")]
pub(super) fn code_from<'de, D: serde::Deserializer<'de>>(
    deserializer: D,
    quantity: &'static crate::quantity::Quantity,
) -> Result<u8, D::Error> {
    struct Visitor(&'static crate::quantity::Quantity);
    impl serde::de::Visitor<'_> for Visitor {
        type Value = u8;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a name or number of {}", self.0.name)
        }
        fn visit_str<E: serde::de::Error>(self, given: &str) -> Result<u8, E> {
            let raw = self.0.code_of(given).and_then(|raw| u8::try_from(raw).ok());
            raw.ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(given), &self))
        }
        fn visit_u64<E: serde::de::Error>(self, raw: u64) -> Result<u8, E> {
            let wrong = serde::de::Unexpected::Unsigned(raw);
            u8::try_from(raw).map_err(|_| E::invalid_value(wrong, &self))
        }
        fn visit_i64<E: serde::de::Error>(self, raw: i64) -> Result<u8, E> {
            let wrong = serde::de::Unexpected::Signed(raw);
            u8::try_from(raw).map_err(|_| E::invalid_value(wrong, &self))
        }
        fn visit_u8<E: serde::de::Error>(self, raw: u8) -> Result<u8, E> {
            Ok(raw)
        }
    }
    if deserializer.is_human_readable() {
        deserializer.deserialize_any(Visitor(quantity))
    } else {
        deserializer.deserialize_u8(Visitor(quantity))
    }
}

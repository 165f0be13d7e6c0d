//! Macros that turn a list of fields and their places into a type that encodes and decodes.

use crate::error::DecodeError;
use crate::field::Data;

/// A request whose fields each fill fixed bytes: `Name -> Reply { field: Type => first byte }`.
/// `-> Self` is for those that a drive answers with the same bytes.
macro_rules! command {
    ($(#[$attr:meta])* $name:ident -> $reply:ty) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct $name;
        command!(@impl $name -> $reply {});
    };
    ($(#[$attr:meta])* $name:ident -> $reply:ty {
        $($(#[$field_attr:meta])* $field:ident: $type:ty => $at:literal,)+
    }) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct $name {
            $($(#[$field_attr])* pub $field: $type,)+
        }
        command!(@impl $name -> $reply { $($field: $type => $at,)+ });
    };
    (@impl $name:ident -> $reply:ty { $($field:ident: $type:ty => $at:literal,)* }) => {
        impl $name {
            /// The data field.
            #[inline]
            pub const fn encode(&self) -> $crate::Data {
                let mut data = [0; 8];
                if let Some(byte) = $crate::Opcode::$name.byte() {
                    data[0] = byte;
                }
                $(self.$field.put::<$at>(&mut data);)*
                data
            }
        }

        impl $crate::command::Command for $name {
            const OPCODE: $crate::Opcode = $crate::Opcode::$name;
            type Reply = $reply;

            #[inline]
            fn encode(&self) -> $crate::Data {
                Self::encode(self)
            }

            #[inline]
            fn decode(data: &$crate::Data) -> Result<Self, $crate::DecodeError> {
                $crate::command::expect_opcode(data, Self::OPCODE)?;
                $crate::command::layout::Fields::read(data)
            }
        }

        fields!($name { $($field: $type => $at,)* });
    };
}

/// The fields of a data field, all but the command byte.
pub(super) trait Fields: Sized {
    /// Puts them in their places.
    fn put(&self, data: &mut Data);

    /// Takes them from their places.
    fn read(data: &Data) -> Result<Self, DecodeError>;
}

/// Fields that each fill fixed bytes.
macro_rules! fields {
    ($name:ident { $($field:ident: $type:ty => $at:literal,)* }) => {
        impl $crate::command::layout::Fields for $name {
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

/// Makes a request its own reply: the drive answers with the same bytes.
macro_rules! echo {
    ($($name:ident),+) => {$(
        impl $crate::command::Reply for $name {
            #[inline]
            fn to_data(&self, _: $crate::Opcode) -> $crate::Data {
                Self::encode(self)
            }

            #[inline]
            fn from_data(data: &$crate::Data) -> Result<Self, $crate::DecodeError> {
                $crate::command::Command::decode(data)
            }
        }
    )+};
}

/// A reply whose fields each fill fixed bytes.
macro_rules! reply {
    ($(#[$attr:meta])* $name:ident {
        $($(#[$field_attr:meta])* $field:ident: $type:ty => $at:literal,)+
    }) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct $name {
            $($(#[$field_attr])* pub $field: $type,)+
        }

        impl $name {
            /// The data field of this answer to a command of kind `to`.
            #[inline]
            pub const fn to_data(&self, to: $crate::Opcode) -> $crate::Data {
                let mut data = [0; 8];
                if let Some(byte) = to.byte() {
                    data[0] = byte;
                }
                $(self.$field.put::<$at>(&mut data);)+
                data
            }
        }

        impl $crate::command::Reply for $name {
            #[inline]
            fn to_data(&self, to: $crate::Opcode) -> $crate::Data {
                Self::to_data(self, to)
            }

            #[inline]
            fn from_data(data: &$crate::Data) -> Result<Self, $crate::DecodeError> {
                $crate::command::layout::Fields::read(data)
            }
        }

        fields!($name { $($field: $type => $at,)+ });
    };
}

/// A one-byte code. What the manual does not name is kept as `Unknown`.
macro_rules! code {
    ($(#[$attr:meta])* $name:ident {
        $($(#[$variant_attr:meta])* $variant:ident = $raw:literal $kebab:literal,)+
    }) => {
        $(#[$attr])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
        pub enum $name {
            $($(#[$variant_attr])* $variant,)+
            /// A code that the manual does not name.
            Unknown(u8),
        }

        impl $name {
            /// Every named code.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The code's meaning.
            #[inline]
            pub const fn from_raw(raw: u8) -> Self {
                match raw {
                    $($raw => Self::$variant,)+
                    unknown => Self::Unknown(unknown),
                }
            }

            /// The byte on the wire.
            #[inline]
            pub const fn raw(self) -> u8 {
                match self {
                    $(Self::$variant => $raw,)+
                    Self::Unknown(raw) => raw,
                }
            }

            /// Its name in tools, `"unknown"` where the manual gives none.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $kebab,)+
                    Self::Unknown(_) => "unknown",
                }
            }

            #[inline(always)]
            pub(crate) const fn put<const AT: usize>(self, data: &mut $crate::Data) {
                data[AT] = self.raw();
            }

            #[inline(always)]
            pub(crate) const fn read<const AT: usize>(data: &$crate::Data) -> Result<Self, $crate::OutOfRange> {
                Ok(Self::from_raw(data[AT]))
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    Self::Unknown(raw) => write!(f, "unknown code {raw}"),
                    named => f.write_str(named.name()),
                }
            }
        }
    };
}

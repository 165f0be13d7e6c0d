//! The data field of a frame, and little-endian integers at fixed places of it.
//!
//! The place is a constant parameter, so that no bounds check is left at run time.

/// The data field of every frame: eight bytes, the command byte first.
pub type Data = [u8; 8];

macro_rules! little_endian {
    ($($put:ident $get:ident $int:ty: $($offset:literal)+;)+) => {$(
        #[inline(always)]
        pub(crate) const fn $put<const AT: usize>(data: &mut Data, value: $int) {
            let bytes = value.to_le_bytes();
            $(data[AT + $offset] = bytes[$offset];)+
        }

        #[inline(always)]
        pub(crate) const fn $get<const AT: usize>(data: &Data) -> $int {
            <$int>::from_le_bytes([$(data[AT + $offset]),+])
        }
    )+};
}

little_endian! {
    put_u8 get_u8 u8: 0;
    put_i8 get_i8 i8: 0;
    put_u16 get_u16 u16: 0 1;
    put_i16 get_i16 i16: 0 1;
    put_u32 get_u32 u32: 0 1 2 3;
    put_i32 get_i32 i32: 0 1 2 3;
}

//! The same work in plain C, in `mcu-example/c/`.

use core::ffi::c_void;

/// `struct absolute_position`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AbsolutePosition {
    pub(crate) max_speed_dps: u16,
    pub(crate) angle_centidegrees: i32,
}

/// `struct feedback`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Feedback {
    pub(crate) temperature_celsius: i8,
    pub(crate) current_centiamperes: i16,
    pub(crate) speed_dps: i16,
    pub(crate) angle_degrees: i16,
}

/// `struct motion_set_point`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MotionSetPoint {
    pub(crate) position_rad: f32,
    pub(crate) velocity_rad_s: f32,
    pub(crate) kp: f32,
    pub(crate) kd: f32,
    pub(crate) torque_nm: f32,
}

/// `struct motion_feedback`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MotionFeedback {
    pub(crate) position_rad: f32,
    pub(crate) velocity_rad_s: f32,
    pub(crate) torque_nm: f32,
}

/// `struct receiver`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub(crate) struct Receiver {
    line: [u8; 13],
    length: u8,
    crc: u16,
}

impl Receiver {
    pub(crate) const fn new() -> Self {
        Self { line: [0; 13], length: 0, crc: 0xFFFF }
    }
}

mod linked {
    use super::{AbsolutePosition, Feedback, MotionFeedback, MotionSetPoint, Receiver, c_void};

    unsafe extern "C" {
        pub(super) fn c_encode_absolute_position(
            command: *const AbsolutePosition,
            data: *mut [u8; 8],
        );
        pub(super) fn c_decode_feedback(data: *const [u8; 8], feedback: *mut Feedback) -> bool;
        pub(super) fn c_encode_motion(set_point: *const MotionSetPoint, data: *mut [u8; 8])
        -> bool;
        pub(super) fn c_decode_motion(data: *const [u8; 8], feedback: *mut MotionFeedback);
        pub(super) fn c_encode_line(id: u8, data: *const [u8; 8], line: *mut [u8; 13]);
        pub(super) fn c_feed(receiver: *mut Receiver, byte: u8) -> u8;
        pub(super) fn c_want(receiver: *mut Receiver, byte: u8) -> u8;
        pub(super) fn c_nothing(input: *const c_void, output: *mut c_void);
    }
}

// SAFETY, of all calls here: each pointer is a reference to as much as its C declaration says, and no
// function keeps one.

#[inline(always)]
pub(crate) fn encode(command: &AbsolutePosition, data: &mut [u8; 8]) {
    unsafe { linked::c_encode_absolute_position(command, data) }
}

#[inline(always)]
pub(crate) fn decode(data: &[u8; 8], feedback: &mut Feedback) -> bool {
    unsafe { linked::c_decode_feedback(data, feedback) }
}

#[inline(always)]
pub(crate) fn encode_motion(set_point: &MotionSetPoint, data: &mut [u8; 8]) -> bool {
    unsafe { linked::c_encode_motion(set_point, data) }
}

#[inline(always)]
pub(crate) fn decode_motion(data: &[u8; 8], feedback: &mut MotionFeedback) {
    unsafe { linked::c_decode_motion(data, feedback) }
}

#[inline(always)]
pub(crate) fn encode_line(id: u8, data: &[u8; 8], line: &mut [u8; 13]) {
    unsafe { linked::c_encode_line(id, data, line) }
}

/// 0 for a frame that goes on, 1 for one that is whole, 2 for one that is broken.
#[inline(always)]
pub(crate) fn feed(receiver: &mut Receiver, byte: u8) -> u8 {
    unsafe { linked::c_feed(receiver, byte) }
}

/// Takes the byte and asks for more.
#[inline(always)]
pub(crate) fn want(receiver: &mut Receiver, byte: u8) -> u8 {
    unsafe { linked::c_want(receiver, byte) }
}

/// A call and a return.
#[inline(always)]
pub(crate) fn nothing<A, B>(input: &A, output: &mut B) {
    unsafe { linked::c_nothing((&raw const *input).cast(), (&raw mut *output).cast()) }
}

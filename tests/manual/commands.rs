//! Commands and measurements that several chapters share.

use myactuator_protocol_core::command::*;
use myactuator_protocol_core::drive::Measurement;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::*;
use myactuator_protocol_core::{AnyCommand, Opcode};
use myactuator_tests::bench::*;
use myactuator_tests::values::*;

/// A turn of the output shaft: 16384 pulses, gear 6.
pub(super) const TURN: i32 = 98_304;

pub(super) fn plan(bench: &mut Bench, index: AccelerationIndex, dps2: u32) {
    let acceleration = Acceleration::try_from_raw(dps2).unwrap();
    bench.write(WriteAcceleration { index, acceleration });
}

/// 0xA8 by this angle, at no more than 500 dps.
pub(super) fn on_by(angle_deg: f32) -> IncrementalPosition {
    IncrementalPosition { max_speed: up_to(500), angle: degrees(angle_deg) }
}

/// 0xA9 to this angle, at no more than 500 dps.
pub(super) fn force_to(angle_deg: f32, torque_percent: u8) -> ForcePosition {
    let (max_torque, max_speed) = (percent(torque_percent), up_to(500));
    ForcePosition { max_torque, max_speed, angle: degrees(angle_deg) }
}

/// 0xA6 to this angle within a turn, at no more than 500 dps.
pub(super) fn within_a_turn(direction: Direction, angle_deg: f32) -> SingleTurnPosition {
    let angle = SingleTurnTarget::from_degrees(angle_deg).unwrap();
    SingleTurnPosition { direction, max_speed: up_to(500), angle }
}

/// Runs the command for 1.5 s and checks that the shaft is then at this angle.
#[track_caller]
pub(super) fn ends_at<C: Command + Into<AnyCommand>>(
    bench: &mut Bench,
    command: C,
    angle_deg: f64,
) {
    bench.go(command, millis(1_500));
    assert!((bench.angle() - angle_deg).abs() < 0.02, "{}, not {angle_deg}", bench.angle());
}

/// The largest value that `figure` returns in this span, read every millisecond.
pub(super) fn most(bench: &mut Bench, span: Duration, figure: fn(&Measurement) -> f32) -> f32 {
    let mut largest = 0.0_f32;
    bench.watch(span, |state| largest = largest.max(figure(&state.measurement)));
    largest
}

pub(super) fn report(opcode: Opcode, enable: Switch, interval: u16) -> ActiveReply {
    let command = ReportedCommand::of(opcode).unwrap();
    ActiveReply { command, enable, interval: ReportInterval::from_raw(interval) }
}

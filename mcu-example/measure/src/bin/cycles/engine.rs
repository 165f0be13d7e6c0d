//! The master: one round trip a motor - set-point in, frame out, feedback in, event out.

use core::hint::black_box;

use myactuator_protocol_core::command::{MotionRanges, MotionSetPoint, RawMotion};
use myactuator_protocol_core::master::{Config, Event, Master};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::Received;
use myactuator_protocol_core::{Channel, MotorId, Packet};

use crate::counter::instructions;
use crate::table::{Limit, Table};

/// Rounds before the first that counts, and rounds that count.
const WARM_UP: u32 = 10;
const ROUNDS: u32 = 20;

pub(crate) fn measure(table: &mut Table) {
    table.row(
        "round trip, 1 motor",
        round_trip::<1>(),
        Limit::Ceiling { budget: 800, ceiling: CEILINGS[0] },
    );
    table.row(
        "round trip a motor, of 8",
        round_trip::<8>(),
        Limit::Ceiling { budget: 800, ceiling: CEILINGS[1] },
    );
    table.row(
        "round trip a motor, of 32",
        round_trip::<32>(),
        Limit::Ceiling { budget: 1_000, ceiling: CEILINGS[2] },
    );
    let size = |bytes: usize| bytes as u32;
    table.head("bytes of RAM");
    let limit = |budget, ceiling| Limit::Ceiling { budget, ceiling };
    table.row("master of 8 motors", size(size_of::<Master<8>>()), limit(1_024, 2_456));
    table.row("master of 32 motors", size(size_of::<Master<32>>()), limit(4_096, 8_600));
}

/// What it costs today, for 1, 8 and 32 motors.
const CEILINGS: [u32; 3] = [1_300, 1_275, 1_440];

/// Instructions a motor.
fn round_trip<const N: usize>() -> u32 {
    let mut master = Master::<N>::new(Config::CAN);
    let mut now = Instant::from_millis(1);
    let raw = MotionRanges::V4_3
        .quantise(&MotionSetPoint { kp: 10.0, ..MotionSetPoint::default() })
        .expect("within its scales");
    for _ in 0..WARM_UP {
        round(&mut master, raw, &mut now);
    }
    let spent = instructions(|| {
        for _ in 0..ROUNDS {
            round(&mut master, raw, &mut now);
        }
    });
    spent / ROUNDS / N as u32
}

/// Set-points for all are put, and each is answered 1 ms after it was sent.
fn round<const N: usize>(master: &mut Master<N>, raw: RawMotion, now: &mut Instant) {
    for motor in MotorId::all().take(N) {
        master.set_point(motor, raw, *now).expect("there is a place for each");
    }
    let mut sent = 0;
    while let Some(packet) = master.poll_transmit(*now) {
        black_box(packet);
        master.handle_transmitted(*now);
        *now += Duration::from_micros(130);
        sent += 1;
    }
    assert_eq!(sent, N, "every set-point is sent");
    *now += Duration::from_millis(1);
    for motor in MotorId::all().take(N) {
        let data = [motor.get(), 0x80, 0x00, 0x80, 0x08, 0x00, 0, 0];
        let packet = Packet { channel: Channel::MotionReply(motor), data };
        let event = master.handle_frame(&Received::Packet(packet), *now);
        assert!(matches!(black_box(event), Some(Event::Feedback { .. })), "it is answered");
    }
    master.handle_timeout(*now);
    assert!(master.poll_event().is_none(), "nothing was lost");
}

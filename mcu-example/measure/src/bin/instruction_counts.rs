//! What encoding and decoding cost: instructions on the emulated Cortex-M4F, next to the budget.
//!
//! The emulator executes one instruction in 64 ns (`-icount shift=6`) and its SysTick counts 40 ns,
//! so the figures are exact and the same on every machine. Each job is a function that is not
//! inlined; the same call of a function that does nothing is subtracted.
#![no_std]
#![no_main]

use core::hint::black_box;

use cortex_m::peripheral::{Peripherals, SYST, syst::SystClkSource};
use cortex_m_rt::entry;
use cortex_m_semihosting::hprintln;
use measure::finish;
use myactuator_protocol_core::{
    Command, Data, DecodeError, MotorId, Target,
    command::{
        AbsolutePosition, Feedback, MotionFeedback, MotionRanges, MotionSetPoint, RawMotion,
        ReadStatus2,
    },
    master::Master,
    units::{Angle, MaxSpeed},
    wire::rs485::{FRAME_LENGTH, Fed, Frame, Receiver},
};

/// How often each job runs.
const RUNS: u32 = 1_000;
/// RAM for a master of 32 motors, in bytes.
const MASTER_BUDGET: u32 = 4_096;

#[derive(Debug)]
enum Trouble {
    NoSysTick,
    NotReadable(#[allow(dead_code, reason = "printed")] DecodeError),
    OverBudget(#[allow(dead_code, reason = "printed")] u32),
}

impl From<DecodeError> for Trouble {
    fn from(error: DecodeError) -> Self {
        Self::NotReadable(error)
    }
}

#[entry]
fn main() -> ! {
    finish(run())
}

/// Instructions of one run of `job`, beyond those of `nothing`, rounded to the nearest.
fn cost<A, B>(
    input: &A,
    output: &mut B,
    job: impl Fn(&A, &mut B),
    nothing: impl Fn(&A, &mut B),
) -> u32 {
    let with = instructions(input, output, job);
    let without = instructions(input, output, nothing);
    (with.saturating_sub(without) + RUNS / 2) / RUNS
}

fn instructions<A, B>(input: &A, output: &mut B, job: impl Fn(&A, &mut B)) -> u32 {
    let start = SYST::get_current();
    for _ in 0..RUNS {
        job(black_box(input), black_box(output));
    }
    // SysTick counts down, 24 bits. One tick is 40 ns, one instruction 64 ns.
    let ticks = start.wrapping_sub(SYST::get_current()) & 0x00FF_FFFF;
    ticks * 5 / 8
}

#[inline(never)]
fn encode(command: &AbsolutePosition, data: &mut Data) {
    *data = command.encode();
}

#[inline(never)]
fn decode(data: &Data, feedback: &mut Result<Feedback, DecodeError>) {
    *feedback = ReadStatus2::decode_reply(data);
}

#[inline(never)]
fn encode_motion(set_point: &MotionSetPoint, data: &mut Data) -> bool {
    let raw = MotionRanges::V4_3.quantise(set_point);
    if let Ok(raw) = &raw {
        *data = raw.encode();
    }
    raw.is_ok()
}

#[inline(never)]
fn decode_motion(data: &Data, feedback: &mut MotionFeedback) -> bool {
    let raw = RawMotion::decode_reply(data);
    if let Ok(raw) = &raw {
        *feedback = MotionRanges::V4_3.feedback(raw);
    }
    raw.is_ok()
}

#[inline(never)]
fn encode_line(frame: &Frame, line: &mut [u8; FRAME_LENGTH]) {
    *line = frame.encode();
}

#[inline(never)]
fn feed(receiver: &mut Receiver, byte: u8) -> Fed {
    receiver.feed(byte)
}

/// What every job is compared to: a call and a return.
#[inline(never)]
fn nothing<A, B>(_: &A, _: &mut B) {
    black_box(());
}

fn run() -> Result<(), Trouble> {
    let mut syst = Peripherals::take().ok_or(Trouble::NoSysTick)?.SYST;
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(0x00FF_FFFF);
    syst.clear_current();
    syst.enable_counter();

    let mut over = 0;
    // The budget is what we aim at, the ceiling what may not get worse.
    let mut row = |name: &str, count: u32, budget: u32, ceiling: u32| {
        let verdict = match count {
            _ if count > ceiling => " TOO MANY",
            _ if count > budget => " (over budget)",
            _ => "",
        };
        over += u32::from(count > ceiling);
        hprintln!("{:<36} {:>6} {:>6}{}", name, count, budget, verdict);
    };
    hprintln!("{:<36} {:>6} {:>6}", "instructions", "spent", "budget");

    let max_speed = MaxSpeed::from_raw(500);
    let go = AbsolutePosition { max_speed, angle: Angle::from_raw(36_000) };
    let mut data = [0; 8];
    row("encode a command", cost(&go, &mut data, encode, nothing), 20, 20);

    let reply = [0x9C, 0x32, 0x64, 0x00, 0xF4, 0x01, 0x2D, 0x00]; // 2.15.4
    let mut feedback = ReadStatus2::decode_reply(&[0; 8]);
    row("decode a reply", cost(&reply, &mut feedback, decode, nothing), 30, 30);
    assert_eq!(feedback?.speed.raw(), 500);

    let set_point = MotionSetPoint {
        position_rad: 10.0,
        velocity_rad_s: 1.0,
        kp: 10.0,
        kd: 1.0,
        torque_nm: 10.0,
    };
    let job = |set_point: &MotionSetPoint, data: &mut Data| {
        black_box(encode_motion(set_point, data));
    };
    row("quantise and encode a motion command", cost(&set_point, &mut data, job, nothing), 70, 70);
    assert_eq!(RawMotion::decode(&data).position, 58_982); // 5.4

    let reply = [0x01, 0xE6, 0x66, 0x82, 0xEB, 0x55, 0, 0]; // 5.4
    let id = MotorId::MIN;
    let mut motion = MotionFeedback { position_rad: 0.0, velocity_rad_s: 0.0, torque_nm: 0.0 };
    let job = |reply: &Data, motion: &mut MotionFeedback| {
        black_box(decode_motion(reply, motion));
    };
    row("decode and scale a motion reply", cost(&reply, &mut motion, job, nothing), 70, 70);
    assert!((motion.position_rad - 10.0).abs() < 0.001);

    let frame = Frame { address: Target::Motor(id), data: go.encode() };
    let mut line = [0; FRAME_LENGTH];
    row("encode an RS485 frame", cost(&frame, &mut line, encode_line, nothing), 220, 220);
    assert_eq!(line, [0x3E, 1, 8, 0xA4, 0x00, 0xF4, 0x01, 0xA0, 0x8C, 0x00, 0x00, 0x3B, 0xDD]);

    let mut receiver = Receiver::new();
    let each = line.map(|byte| {
        let start = (receiver.clone(), byte);
        let job = |(before, byte): &(Receiver, u8), receiver: &mut Receiver| {
            receiver.clone_from(before);
            black_box(feed(black_box(receiver), *byte));
        };
        let nothing = |(before, byte): &(Receiver, u8), receiver: &mut Receiver| {
            receiver.clone_from(before);
            nothing(byte, black_box(receiver));
        };
        let spent = cost(&start, &mut receiver, job, nothing);
        receiver = start.0;
        feed(&mut receiver, byte);
        spent
    });
    assert!(!receiver.is_within_frame(), "the frame is complete");
    let average = each.iter().sum::<u32>().div_ceil(FRAME_LENGTH as u32);
    row("receive an RS485 byte, on average", average, 45, 45);
    row("receive an RS485 byte, at worst", each.into_iter().max().unwrap_or(0), 45, 47);

    hprintln!("{:<36} {:>6} {:>6}", "bytes of RAM", "spent", "budget");
    row("master of 32 motors", size_of::<Master<32>>() as u32, MASTER_BUDGET, MASTER_BUDGET);
    if over == 0 { Ok(()) } else { Err(Trouble::OverBudget(over)) }
}

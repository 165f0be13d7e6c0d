//! A few whole runs of a simulated drive, in a form that a person can read.
//!
//! Each run is first compared with what the manual or a closed form says of it, and then with its picture in
//! `snapshots/`, which shows what happens in between. If a change of the drive or the physics is meant to change a run,
//! and only the comparison with the picture fails, draw the pictures anew and read the difference before you commit it:
//!
//! ```text
//! INSTA_UPDATE=always cargo test -p myactuator-tests --test drives runs
//! git diff tests/drives/snapshots
//! ```
//!
//! Otherwise a run that differs from its picture fails and leaves the new picture beside the old one as `*.snap.new`.
//! With `INSTA_UPDATE=no`, or if `CI` is set, it only fails.

use std::fmt::{Debug, Write as _};

use myactuator_host_std::sim::bus::can::{CanBus, frame_bits};
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_host_std::sim::bus::trace::{Event as OnBus, Record};
use myactuator_host_std::sim::plant::{EndStop, Load, MotorParameters};
use myactuator_host_std::sim::{CanFleet, DriveHandle, Fleet};
use myactuator_host_std::text;
use myactuator_protocol_core::command::{
    AccelerationIndex, BrakeCommand, CommunicationLossProtection, ErrorFlags, ForcePosition, Mode,
    ReadMultiTurnAngle, ReadStatus1, ReadStatus2, Reset, Shutdown, WriteAcceleration,
};
use myactuator_protocol_core::drive::{Event as Happened, Indicator, State};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Event, MotorSet};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Acceleration, Milliseconds};
use myactuator_protocol_core::wire::can::SimpleFrame;
use myactuator_protocol_core::wire::rs485::Receiver;
use myactuator_protocol_core::{Channel, Data, MotorId, Opcode, Packet, Target};
use myactuator_tests::fleet::{happened, master};
use myactuator_tests::listen::{listen, listen_until};
use myactuator_tests::values::{degrees, go_to, id, millis, percent, turn, up_to};
use myactuator_tests::wire::Wire;

const MOTOR: MotorId = MotorId::MIN;
const MODEL: &str = "RMD-X6-P20-60";

fn one_drive(brake: bool) -> CanFleet {
    let model = MotorParameters::named(MODEL).unwrap();
    Fleet::new(1).model(model).brakes(brake).on_can(1_000_000).unwrap()
}

/// The state of the drive at this time.
fn state_at(drive: &DriveHandle, now: Instant) -> State {
    drive.with(|drive| {
        drive.advance(now);
        drive.state()
    })
}

/// Compares the run with its picture.
macro_rules! assert_picture {
    ($name:literal, $title:expr, $run:expr) => {
        insta::with_settings!({
            prepend_module_to_snapshot => false,
            omit_expression => true,
            description => $title,
        }, {
            insta::assert_snapshot!($name, $run);
        });
    };
}

/// A number as it is printed, without the sign of a negative zero.
fn rounded(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let is_zero = text.bytes().all(|byte| matches!(byte, b'-' | b'0' | b'.'));
    if is_zero { text.trim_start_matches('-').to_owned() } else { text }
}

fn on_off(on: bool) -> &'static str {
    if on { "on" } else { "off" }
}

fn locked_open(brake: BrakeCommand) -> &'static str {
    if brake == BrakeCommand::LOCK { "locked" } else { "open" }
}

// ---- position profile ----

/// Position and speed of a trapezoid from 0 to `way` after `t` seconds, up and down at the same acceleration.
fn trapezoid(way: f64, max_speed: f64, acceleration: f64, t: f64) -> (f64, f64) {
    let ramp = max_speed / acceleration;
    let end = way / max_speed + ramp;
    let begun = |t: f64| {
        if t < ramp { 0.5 * acceleration * t * t } else { max_speed * (t - 0.5 * ramp) }
    };
    let (t, left) = (t.clamp(0.0, end), (end - t).clamp(0.0, end));
    let angle = if left < ramp { way - begun(left) } else { begun(t) };
    (angle, (acceleration * t.min(left)).min(max_speed))
}

/// 2.21.1: with an acceleration that is not 0, 0xA4 "runs in the mode with a planned speed, and the
/// motor itself accelerates and decelerates".
#[test]
fn position_profile() {
    const WAY_DEG: f64 = 90.0;
    const MAX_SPEED_DPS: f64 = 180.0;
    const ACCELERATION_DPS2: f64 = 1_000.0;
    const STEP: Duration = millis(40);

    let fleet = one_drive(false);
    let drive = &fleet.drives[0];
    let mut master = fleet.master::<1>();
    let acceleration = Acceleration::try_from_raw(ACCELERATION_DPS2 as u32).unwrap();
    for index in
        [AccelerationIndex::POSITION_ACCELERATION, AccelerationIndex::POSITION_DECELERATION]
    {
        master.ask(MOTOR, WriteAcceleration { index, acceleration }).unwrap();
    }
    // The command reaches the drive on a whole millisecond, where a step of its loops begins.
    let start = Instant::from_millis(20);
    listen_until(&mut master, Instant::from_micros(19_870));
    master.ask(MOTOR, go_to(WAY_DEG as f32, MAX_SPEED_DPS as u16)).unwrap();

    let friction = &drive.with(|drive| drive.plant().parameters().clone()).friction;
    // While cruising the current only overcomes friction: its torque over the data sheet's 2.1 N·m/A.
    let cruising_a =
        (friction.coulomb_nm + friction.viscous_nm_s_per_rad * MAX_SPEED_DPS.to_radians()) / 2.1;
    let mut table =
        String::from(" time    angle    speed  current\n   ms      deg    deg/s        A\n");
    for step in 0..=20 {
        let now = start + STEP.times(step);
        listen_until(&mut master, now);
        let state = state_at(drive, now);
        let measured = state.measurement;
        let seconds = f64::from((now - start).as_secs_f32());
        let (angle_deg, speed_dps) = trapezoid(WAY_DEG, MAX_SPEED_DPS, ACCELERATION_DPS2, seconds);
        let ms = (now - start).as_millis();

        // The loops follow the profile closely: 3 degrees are 17 ms at full speed.
        assert!((state.angle_deg - angle_deg).abs() < 3.0, "{ms} ms: {}", state.angle_deg);
        let off_dps = (f64::from(measured.speed_dps) - speed_dps).abs();
        assert!(off_dps < 20.0, "{ms} ms: {} dps", measured.speed_dps);
        if (300..=480).contains(&ms) {
            let off_a = (f64::from(measured.current_a) - cruising_a).abs();
            assert!(off_a < 0.1, "{ms} ms: {} A, expected {cruising_a}", measured.current_a);
        }
        assert_eq!(state.mode, Mode::POSITION);

        writeln!(
            table,
            "{ms:5} {:>8} {:>8} {:>8}  |{:<45}|",
            rounded(state.angle_deg, 1),
            rounded(f64::from(measured.speed_dps), 0),
            rounded(f64::from(measured.current_a), 1),
            "#".repeat((state.angle_deg / 2.0).round().max(0.0) as usize),
        )
        .unwrap();
    }
    listen(&mut master, millis(1_000));
    let arrived = master.ask(MOTOR, ReadMultiTurnAngle).unwrap().angle.degrees();
    assert!((arrived - 90.0).abs() < 0.2, "{arrived}");
    assert_picture!(
        "position_profile",
        "An RMD-X6-P20-60 goes to 90 deg at 180 deg/s at the most, 1000 deg/s² up and down.",
        table
    );
}

// ---- communication loss ----

/// 2.31.1: "If communication is interrupted for longer than the set time, the output is cut and the
/// brake locked. To run again, steady communication must be established first."
#[test]
fn communication_loss() {
    const PROTECTION: Duration = millis(100);
    const TICK: Duration = millis(20);
    /// The ticks in which the master sends a speed command: a stream, silence, a single one, a stream.
    const SPEAKS: [std::ops::Range<u32>; 3] = [0..10, 20..21, 30..40];

    let fleet = one_drive(true);
    let drive = &fleet.drives[0];
    let mut master = fleet.master::<1>();
    let timeout = Milliseconds::from_raw(PROTECTION.as_millis() as u32);
    master.ask(MOTOR, CommunicationLossProtection { timeout }).unwrap();
    listen_until(&mut master, Instant::from_millis(20));

    let start = master.now();
    let mut table = String::from(
        " time  master   speed  output  brake   what happens\n   ms           deg/s\n",
    );
    happened(drive);
    for tick in 0..40 {
        let speaks = SPEAKS.iter().any(|ticks| ticks.contains(&tick));
        if speaks {
            master.set_point(MOTOR, turn(90.0)).unwrap();
        }
        let answers = listen_until(&mut master, start + TICK.times(tick + 1));
        assert!(answers.iter().all(|event| matches!(event, Event::Feedback { .. })));
        let state = state_at(drive, master.now());
        let speed_dps = state.measurement.speed_dps;
        match tick {
            // At the factory's 10000 deg/s² the 90 deg/s are reached at once.
            5..10 | 36..40 => assert!((speed_dps - 90.0).abs() < 9.0, "tick {tick}: {speed_dps}"),
            // The brake holds 25 N·m. A single command is not steady communication.
            15..30 => assert_eq!((speed_dps, state.output_on), (0.0, false), "tick {tick}"),
            // A first command does not run yet.
            30 => assert!(!state.output_on),
            _ => {}
        }
        // Losing the master is no error (2.14.3 has none for it).
        assert!(state.errors.is_empty());

        let what: Vec<String> = happened(drive)
            .iter()
            .map(|event| match event {
                Happened::NotRun { opcode, .. } => format!("{opcode} is not run"),
                Happened::ProtectionTripped => "the protection trips".to_owned(),
                Happened::ProtectionRecovered => "communication is steady".to_owned(),
                other => format!("{other:?}"),
            })
            .collect();
        let row = format!(
            "{:5}  {:7} {:>6}  {:6}  {:6}  {}",
            (master.now() - start).as_millis(),
            if speaks { "turn!" } else { "" },
            rounded(f64::from(speed_dps), 0),
            on_off(state.output_on),
            locked_open(state.brake),
            what.join(", "),
        );
        writeln!(table, "{}", row.trim_end()).unwrap();
    }
    assert_picture!(
        "communication_loss",
        "A drive with a brake, protected after 100 ms. Its master turns it at 90 deg/s, falls silent, \
         speaks once, and then steadily again. Each row is the end of 20 ms.",
        table
    );
}

// ---- stall ----

/// 8.2: stall is "the current has reached the stall current, the speed is low, and that lasts". It is of level one, of
/// which 8.1 says that "the motor cannot recover; find the cause and restart it".
#[test]
fn stall() {
    const STOP: EndStop = EndStop { at_deg: 30.0, stiffness_nm_per_rad: 1_500.0, restitution: 1.0 };
    const ROW: Duration = millis(100);
    /// Torque current at the rated torque, and the stall current: the data sheet's 9.5 and 29.1 A.
    const RATED_A: f32 = 9.5;
    const STALL_A: f32 = 29.1;

    let fleet = one_drive(true);
    let drive = &fleet.drives[0];
    drive.with(|drive| {
        drive.plant_mut().set_load(Load { upper_stop: Some(STOP), ..Load::NONE }).unwrap();
    });
    let model = drive.with(|drive| drive.plant().parameters().clone());
    let air_gap_nm_per_a = model.motor.torque_constant_nm_per_a / model.gear.efficiency;
    let motor_nm = air_gap_nm_per_a * f64::from(RATED_A);
    let held_nm = model.friction.static_nm + (1.0 - model.gear.efficiency) * motor_nm;
    let mut master = fleet.master::<1>();
    let gently =
        ForcePosition { max_torque: percent(100), max_speed: up_to(100), angle: degrees(90.0) };

    let start = master.now();
    let mut table = String::from(
        " time    angle  current  output  brake   errors         light      what is said\n   ms      deg        A\n",
    );
    for row in 0..=45 {
        let at = start + ROW.times(row);
        listen_until(&mut master, at);
        let said = match row {
            0 => {
                master.ask(MOTOR, gently).unwrap();
                "0xA9: to 90 deg, with 100 % torque"
            }
            20 => {
                master.ask(MOTOR, go_to(90.0, 100)).unwrap();
                "0xA4: to 90 deg"
            }
            35 => {
                let status = master.ask(MOTOR, ReadStatus1).unwrap();
                // 2.14.3: 0x0002 is stall.
                assert_eq!(status.errors.bits(), 0x0002);
                assert!(status.errors.needs_restart());
                master.ask(MOTOR, go_to(0.0, 100)).unwrap();
                "0xA4: to 0 deg"
            }
            38 => {
                master.ask(MOTOR, Reset).unwrap();
                // The frame still has to reach the drive.
                listen(&mut master, millis(1));
                "0x76"
            }
            40 => {
                // A new master, because the old one leaves a motor alone for 2 s after 0x76.
                master = fleet.master::<1>();
                assert_eq!(master.ask(MOTOR, ReadStatus1).unwrap().errors, ErrorFlags::empty());
                master.ask(MOTOR, go_to(0.0, 100)).unwrap();
                "0xA4: to 0 deg"
            }
            _ => "",
        };
        let state = state_at(drive, master.now());
        let current_a = state.measurement.current_a;
        match row {
            // Against the stop the torque is limited. The current is far from the stall current, so it is no stall.
            8..=19 => {
                assert!((current_a - RATED_A).abs() < 0.1, "row {row}: {current_a}");
                assert_eq!(state.errors, ErrorFlags::empty());
                // The motor's torque presses the stop in, give or take what friction and gear hold.
                let angle_deg = drive.with(|drive| drive.plant().output_angle_deg());
                let bent_nm = STOP.stiffness_nm_per_rad * (angle_deg - STOP.at_deg).to_radians();
                let off_nm = (bent_nm - motor_nm).abs();
                assert!(off_nm <= held_nm, "row {row}: {bent_nm} N·m, expected {motor_nm}");
            }
            // Without the limit the current is the stall current.
            24..=28 => assert!((current_a - STALL_A).abs() < 0.5, "row {row}: {current_a}"),
            // It has lasted, so it is a stall. The error stays until 0x76, whatever is commanded.
            34..=37 => {
                assert_eq!(state.errors, ErrorFlags::STALL, "row {row}");
                assert!(!state.output_on && state.brake == BrakeCommand::LOCK, "row {row}");
                assert_eq!(state.indicator, Indicator::FastBlink);
                assert!(state.angle_deg > 30.0, "row {row}: it has moved to {}", state.angle_deg);
            }
            38.. => assert_eq!(state.errors, ErrorFlags::empty(), "row {row}"),
            _ => {}
        }

        let row = format!(
            "{:5} {:>8} {:>8}  {:6}  {:6}  {:13}  {:9}  {said}",
            (at - start).as_millis(),
            rounded(state.angle_deg, 1),
            rounded(f64::from(current_a), 1),
            on_off(state.output_on),
            locked_open(state.brake),
            state.errors,
            format!("{:?}", state.indicator),
        );
        writeln!(table, "{}", row.trim_end()).unwrap();
    }
    let back = state_at(drive, master.now()).angle_deg;
    assert!(back.abs() < 0.5, "{back}");
    assert_picture!(
        "stall",
        "A drive with a brake runs into a stop at 30 deg: first with the rated torque, then with all \
         that it has. Rows tell how it does just after the command has been answered.",
        table
    );
}

// ---- bus traces ----

/// The commands that [`exchanges`] sends, and to which motor. They are examples of the manual where it has one.
const COMMANDS: [(u8, Data); 6] = [
    (1, [0x9A, 0, 0, 0, 0, 0, 0, 0]),             // 2.14.4
    (2, [0x92, 0, 0, 0, 0, 0, 0, 0]),             // 2.12.4
    (1, [0xA4, 0, 0xF4, 0x01, 0xA0, 0x8C, 0, 0]), // 2.21.4: 500 deg/s at the most, to 360 deg
    (1, [0x9C, 0, 0, 0, 0, 0, 0, 0]),             // 2.15.4
    (1, [0x80, 0, 0, 0, 0, 0, 0, 0]),             // 2.17.2
    (2, [0x80, 0, 0, 0, 0, 0, 0, 0]),             // 2.17.2
];

/// Asks two motors for something, moves one and shuts both down.
fn exchanges<R: Runner<8, Error: Debug>>(master: &mut R) {
    let [one, two] = [1, 2].map(id);
    master.ask(one, ReadStatus1).unwrap();
    master.ask(two, ReadMultiTurnAngle).unwrap();
    master.ask(one, go_to(360.0, 500)).unwrap();
    listen(master, millis(100));
    master.ask(one, ReadStatus2).unwrap();
    for motor in [one, two] {
        master.ask(motor, Shutdown).unwrap();
    }
    assert!(master.master().motors() == MotorSet::from_iter([one, two]));
}

/// Everything on the bus during [`exchanges`]: one line per frame, with the time at which it ends. Checks first how
/// long each frame takes and what it contains. A drive begins a reply after 0.7 to 0.9 ms.
fn trace<W: Wire>(
    frame_ns: fn(&W::Frame) -> u64,
    reply_begins_late_ns: u64,
    print: fn(&str, &W::Frame) -> String,
) -> String {
    // At 0 its angle would be asked for twice: a reply that is the first of a motor, and equals its command, may be the
    // command, ignored by a drive that has lost its master.
    let turned = Fleet::new(2).motor(id(2), |motor| motor.start_angle_deg = 45.0);
    let bus = W::drives(&turned).unwrap();
    let log = bus.world.log();
    exchanges(&mut master(&bus));
    let mut records = log.take();
    // Before it asks motor 2 for its angle, the loop reads its status to see that the line has no echo.
    let shows_echo = |packet: Packet| {
        let two = matches!(packet.channel, Channel::Command(Target::Motor(it)) | Channel::Reply(it) if it == id(2));
        two && packet.data[0] == 0x9A
    };
    records.retain(|record| match &record.event {
        OnBus::Carried { frame, .. } => ![true, false].into_iter().any(|is_command| {
            W::packet(&mut Receiver::new(), frame, is_command).is_some_and(shows_echo)
        }),
        _ => true,
    });
    assert_eq!(records.len(), 2 * COMMANDS.len());
    let mut lines = String::new();
    let mut command_over_ns = 0;
    for (place, Record { at_ns, event, .. }) in records.iter().enumerate() {
        let OnBus::Carried { frame, started_ns } = event else {
            panic!("nothing else happens on a bus without faults: {event:?}")
        };
        assert_eq!(at_ns - started_ns, frame_ns(frame));
        let is_reply = place % 2 == 1;
        let packet = W::packet(&mut Receiver::new(), frame, !is_reply).unwrap();
        let (motor, data) = COMMANDS[place / 2];
        if is_reply {
            let took_ns = started_ns - command_over_ns;
            // The drive counts in microseconds.
            let latest_ns = 901_000 + reply_begins_late_ns;
            assert!((700_000..=latest_ns).contains(&took_ns), "{took_ns} ns");
            assert_eq!((packet.channel, packet.data[0]), (Channel::Reply(id(motor)), data[0]));
            // 2.17.3: the same data.
            assert!(packet.data == data || data[0] != 0x80, "{packet}");
        } else {
            assert_eq!(packet, Packet { channel: Channel::Command(id(motor).into()), data });
            command_over_ns = *at_ns;
        }
        let micros = at_ns.div_ceil(1_000);
        let stamp = format!("({:010}.{:06})", micros / 1_000_000, micros % 1_000_000);
        let name = Opcode::from_byte(data[0]).map_or("?", Opcode::name);
        let whose = if is_reply { ", reply" } else { "" };
        writeln!(lines, "{}  {name}{whose}", print(&stamp, frame)).unwrap();
    }
    lines
}

#[test]
fn trace_of_a_can_bus() {
    // A bit takes 1000 ns. The three bits of intermission do not belong to the frame.
    let frame_ns = |frame: &SimpleFrame| (u64::from(frame_bits(frame)) - 3) * 1_000;
    let lines = trace::<CanBus>(frame_ns, 0, |stamp, frame| {
        let line = format!("{stamp} can0 {}", text::can::frame(frame));
        // It can be read back, as a log of candump.
        assert_eq!(text::can::parse_line(&line).as_ref(), Ok(frame));
        line
    });
    assert_picture!(
        "trace_of_a_can_bus",
        "A status, an angle, a movement to 360 deg, a status 100 ms later, and both motors shut down, \
         at 1 Mbit/s. Each frame with the time when it is over.",
        lines
    );
}

#[test]
fn trace_of_an_rs485_line() {
    // 13 bytes of 10 bits. The drive's transceiver takes time to switch direction.
    let lines = trace::<Rs485Line>(
        |_| 130_000,
        100_000,
        |stamp, bytes| format!("{stamp} {}", text::rs485::bytes(bytes)),
    );
    assert_picture!("trace_of_an_rs485_line", "The same exchanges as on CAN, at 1 Mbit/s.", lines);
}

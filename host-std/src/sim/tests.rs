//! Async masters on simulated drives, as tasks of one executor, under the virtual clock.

use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use myactuator_protocol_core::command::{
    AbsolutePosition, MotionRanges, MotionSetPoint, ReadMultiTurnAngle, ReadStatus1, Speed,
};
use myactuator_protocol_core::io::{AsyncCan, AsyncClock, AsyncRunner, Clock, guarded};
use myactuator_protocol_core::master::{Event, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, MaxSpeed, MaxTorque, SpeedTarget};
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{Channel, MotorId, Packet, Target};

use super::bus::can::ControllerConfig;
use super::bus::rs485::SerialWorld;
use super::bus::{self, trace};
use super::{CanFleet, DriveHandle, Fleet};

fn on_can(motors: u8) -> CanFleet {
    Fleet::new(motors).on_can(1_000_000).unwrap()
}

fn id(number: u8) -> MotorId {
    MotorId::new(number).unwrap()
}

fn angle_deg(drive: &DriveHandle) -> f64 {
    drive.with(|drive| drive.plant().output_angle_deg())
}

/// Has eight motors hold 1 rad for a second at 500 Hz. Gives how often each answered, where they are in
/// the end, and all that was on the wire.
fn hold_one_radian() -> ([u32; 8], Vec<f64>, Vec<trace::Record<SimpleFrame>>) {
    let fleet = on_can(8);
    let log = fleet.world.log();
    let mut bus = fleet.async_master::<8>();
    let there = MotionSetPoint {
        position_rad: 1.0,
        velocity_rad_s: 0.0,
        kp: 40.0,
        kd: 2.0,
        torque_nm: 0.0,
    };
    let there = MotionRanges::V4_3.quantise(&there).unwrap();
    let moving = guarded(&mut bus, StopKind::Hold, async |bus| {
        let (mut heard, mut next) = ([0; 8], bus.now());
        for _ in 0..500 {
            MotorId::all().take(8).for_each(|motor| bus.set_point(motor, there).unwrap());
            next += Duration::from_millis(2);
            while bus.now() < next {
                if let Some(Event::Feedback { motor, .. }) = bus.run(Some(next)).await.unwrap() {
                    heard[motor.index()] += 1;
                }
            }
        }
        heard
    });
    let (heard, unconfirmed) = fleet.block_on(moving);
    assert!(unconfirmed.is_empty(), "{unconfirmed}");
    (heard, fleet.drives.iter().map(angle_deg).collect(), log.take())
}

#[test]
fn a_task_moves_eight_motors_in_motion_mode() {
    let (heard, angles, log) = hold_one_radian();
    // A cycle of eight takes 1.9 ms of the wire and the drives: every set-point is answered, but for the
    // last, which the stop may cut short.
    assert!(heard.iter().all(|&count| count >= 499), "{heard:?}");
    // 1 rad = 57.3 degrees; friction keeps a spring of 40 N·m/rad a little away from it.
    assert!(angles.iter().all(|angle| (angle - 57.3).abs() < 3.0), "{angles:?}");
    assert!(hold_one_radian() == (heard, angles, log), "one seed, one run");
}

#[test]
fn dropped_question_costs_no_other_question_its_reply() {
    let fleet = on_can(2);
    fleet.drives[0].with(|drive| drive.plant_mut().set_output_angle_deg(30.0)).unwrap();
    let (mut bus, mut clock) = (fleet.async_master::<2>(), fleet.world.clock());
    fleet.block_on(async {
        clock.wait_until(Instant::from_millis(10)).await;
        // At that time the command is on the wire, which takes some 0.1 ms, and no drive answers
        // sooner than after 0.7 ms.
        let soon = clock.now() + Duration::from_micros(300);
        let asking = bus.ask(id(1), ReadStatus1);
        assert!(matches!(select(asking, clock.wait_until(soon)).await, Either::Second(())));
        assert_eq!(clock.now(), soon);

        // Its answer still comes, and is nobody's; the next gets its own.
        let mut heard = Vec::new();
        let asked = bus.ask_with(id(1), ReadMultiTurnAngle, None, |event| heard.push(event));
        let angle = asked.await.unwrap().angle;
        assert!((angle.degrees() - 30.0).abs() < 0.1, "{angle}");
        assert!(matches!(heard[..], [Event::Reply { .. }]), "{heard:?}");
    });
}

#[test]
fn a_task_controls_while_another_watches() {
    let fleet = on_can(2);
    let mut bus = fleet.async_master::<2>();
    let mut ear = fleet.world.port();
    let speed = SpeedTarget::from_dps(90.0).unwrap();
    let turn = Speed { max_torque: MaxTorque::NO_LIMIT, speed };
    let (mut commands, mut replies) = (0, 0);
    let watch = async {
        loop {
            match can::decode(&AsyncCan::receive(&mut ear).await.unwrap()) {
                Received::Packet(packet) if matches!(packet.channel, Channel::Command(_)) => {
                    commands += 1;
                }
                Received::Packet(packet) if matches!(packet.channel, Channel::Reply(_)) => {
                    replies += 1;
                }
                other => panic!("{other:?}"),
            }
        }
    };
    let control = async {
        let mut answered = 0;
        while answered < 200 {
            for motor in [id(1), id(2)] {
                bus.set_point(motor, turn).unwrap();
            }
            let until = bus.now() + Duration::from_millis(5);
            while let Some(event) = bus.run(Some(until)).await.unwrap() {
                answered += u32::from(matches!(event, Event::Feedback { .. }));
            }
        }
        assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).await, MotorSet::EMPTY);
        answered
    };
    let watching = select(watch, control);
    // The watch has no end of its own.
    let Either::Second(answered) = fleet.block_on(watching);
    // All that was sent, and all that was answered, and the two stops.
    assert_eq!((commands, replies), (answered + 2, answered + 2));
    // 90 degrees a second for 100 rounds of 5 ms, less the start.
    assert!((35.0..=45.0).contains(&angle_deg(&fleet.drives[1])));
}

/// Asks a hundred times and gives the time when that is done.
async fn ask_often<R: AsyncRunner<1>>(bus: &mut R) -> Instant {
    for _ in 0..100 {
        bus.ask(MotorId::MIN, ReadMultiTurnAngle).await.unwrap();
    }
    bus.now()
}

#[test]
fn two_buses_are_two_tasks_and_as_fast_as_each_alone() {
    let fleets = || (on_can(1), Fleet::new(1).on_rs485(115_200).unwrap());
    let (can, line) = fleets();
    let (mut of_can, mut of_line) = (can.async_master::<1>(), line.async_master::<1>());
    let both = join(ask_often(&mut of_can), ask_often(&mut of_line));
    let together = bus::block_on(&[&can.world, &line.world], both);

    let (can, line) = fleets();
    let (mut of_can, mut of_line) = (can.async_master::<1>(), line.async_master::<1>());
    let alone = (can.block_on(ask_often(&mut of_can)), line.block_on(ask_often(&mut of_line)));
    assert_eq!(together, alone);
    assert!(together.0 < together.1, "{together:?}");
}

#[test]
fn on_rs485_a_task_asks_moves_and_stops() {
    let fleet = Fleet::new(3).on_rs485(1_000_000).unwrap();
    let (mut bus, mut clock) = (fleet.async_master::<4>(), fleet.world.clock());
    let goal = AbsolutePosition {
        max_speed: MaxSpeed::from_raw(360),
        angle: Angle::from_degrees(45.0).unwrap(),
    };
    fleet.block_on(async {
        for motor in MotorId::all().take(3) {
            bus.ask(motor, goal).await.unwrap();
        }
        clock.wait_until(clock.now() + Duration::from_secs(1)).await;
        let angle = bus.ask(id(3), ReadMultiTurnAngle).await.unwrap().angle;
        assert!((angle.degrees() - 45.0).abs() < 1.0, "{angle}");
        // Nobody has id 4.
        let unconfirmed = bus.stop_all(StopKind::Off, id(4).into()).await;
        assert_eq!(unconfirmed, MotorSet::from(id(4)));
    });
}

#[test]
fn sending_waits_for_a_full_controller_and_for_the_last_byte() {
    let fleet = on_can(1);
    let mut port = fleet.world.port_with(ControllerConfig::MAILBOXES);
    let channel = Channel::Command(Target::Motor(MotorId::MIN));
    let read = Packet { channel, data: ReadMultiTurnAngle.encode() };
    let frame: SimpleFrame = can::encode(&read).unwrap();
    fleet.block_on(async {
        for _ in 0..5 {
            assert_eq!(AsyncCan::transmit(&mut port, &frame).await, Ok(None));
        }
    });
    // Three mailboxes: the fifth is taken when two frames have left. Without its stuff bits a frame has
    // 108 bits, and 3 bits later the next begins.
    assert!(fleet.world.now() >= Instant::from_micros(2 * 108 + 3), "{:?}", fleet.world.now());

    let world = SerialWorld::new(115_200, 1);
    let mut port = world.port();
    world.block_on(async {
        assert_eq!(embedded_io_async::Write::write(&mut port, &[0; 13]).await, Ok(13));
        assert_eq!(world.now(), Instant::ZERO);
        embedded_io_async::Write::flush(&mut port).await.unwrap();
    });
    // 130 bits / 115200 bit/s.
    assert_eq!(world.now(), Instant::from_micros(1_129));
}

//! Loops that are lent what they run on, and ports and controllers that have little room.

use embedded_io::ReadReady as _;

use super::world::{Broken, TestCan, TestClock, TestSerial, block_on, on_can, on_rs485};
use super::{id, step};
use crate::command::{ReadMultiTurnAngle, ReadStatus1, Stop};
use crate::io::{
    AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CanMaster, Clock, HalfDuplex, Runner,
    SerialMaster, longest_stop,
};
use crate::master::{Bus, Config, Master, MotorSet, Patience, StopKind};
use crate::time::{Duration, Instant};
use crate::wire::rs485::Frame;

fn serial() -> (TestSerial, TestClock, SerialMaster<TestSerial, TestClock, 4>) {
    on_rs485(SerialMaster::new)
}

#[test]
fn borrowed_clock_returns_the_same_time() {
    fn now(clock: impl Clock) -> Instant {
        clock.idle(clock.now() + Duration::from_micros(20));
        clock.now()
    }
    let clock = TestClock::default();
    clock.advance(1_000);
    assert_eq!(now(&clock), Instant::from_micros(1_020));
    assert_eq!(clock.micros(), 1_020);
}

#[test]
fn borrowed_controller_sends_and_receives() {
    let clock = TestClock::default();
    let mut bus = TestCan::new(&clock);
    let mut arm = AsyncCanMaster::<_, _, 4>::new(&mut bus, clock, Config::CAN);
    assert_eq!(block_on(arm.ask(id(1), ReadMultiTurnAngle)).unwrap().angle.degrees(), 360.0);
}

#[test]
fn noise_on_the_line_is_counted() {
    let (port, _, mut arm) = serial();
    for count in 1..=2 {
        port.hear(&[0x55]);
        assert_eq!(arm.poll(), Ok(None));
        assert_eq!(arm.garbled(), count);
    }
}

#[test]
fn frame_that_a_serial_port_refused_is_not_in_flight() {
    let (port, clock, mut arm) = serial();
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    clock.advance(1_000);
    port.state().write_fails = true;
    let _ = arm.master().request(id(1), step()).unwrap();
    assert_eq!(arm.poll(), Err(Broken));
    assert!(!arm.master().is_anything_in_flight());
}

/// The last byte leaves when the time for an answer would be up already.
#[test]
fn reply_time_out_begins_when_the_last_byte_has_left() {
    let once = Some(Patience { reply_timeout: Duration::from_millis(5), attempts: 1 });
    let (port, _, mut arm) = serial();
    port.state().flush_takes = 10_000;
    let angle = arm.ask_with(id(1), ReadMultiTurnAngle, once, |_| {}).unwrap().angle;
    assert_eq!(angle.degrees(), 360.0);
    let (port, _, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    port.state().flush_takes = 10_000;
    let angle = block_on(arm.ask_with(id(1), ReadMultiTurnAngle, once, |_| {})).unwrap().angle;
    assert_eq!(angle.degrees(), 360.0);
}

#[test]
fn stop_is_confirmed_at_once_after_an_adapter_stopped_echoing() {
    let (port, clock, mut arm) = serial();
    port.state().echoes = true;
    // An echo that is not configured is found.
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    assert!(arm.stop(id(1), StopKind::Hold));
    port.state().echoes = false;
    for _ in 0..5 {
        arm.ask(id(1), ReadStatus1).unwrap();
        let end = clock.now() + Duration::from_millis(140);
        arm.run_until(end, |_| {}).unwrap();
    }
    arm.master().lift_stop();
    port.forget();
    assert!(arm.stop(id(1), StopKind::Hold));
    let stop = Frame::from_packet(&Stop.packet(id(1))).unwrap().encode();
    let stops = port.written().windows(stop.len()).filter(|bytes| *bytes == stop).count();
    assert_eq!(stops, 1, "its confirmation is no echo");
}

/// A pin that is not looked at.
struct Pin;

impl embedded_hal::digital::ErrorType for Pin {
    type Error = core::convert::Infallible;
}

impl embedded_hal::digital::OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

#[test]
fn a_port_with_a_direction_pin_says_whether_bytes_have_come() {
    let port = TestSerial::new(&TestClock::default());
    let mut line = HalfDuplex::new(port.clone(), Pin, (), 0, 0).unwrap();
    assert_eq!(line.read_ready(), Ok(false));
    port.hear(&[0x3E]);
    assert_eq!(line.read_ready(), Ok(true));
}

#[test]
fn on_can_a_stop_is_tried_for_longer_while_a_motor_that_it_waits_for_is_heard() {
    let (_, clock, mut arm) = on_can(CanMaster::<_, _, 4>::new);
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    let _ = arm.master().request(id(2), ReadMultiTurnAngle).unwrap();
    let heard = clock.now();
    let mut longest = |motor, after| {
        longest_stop(arm.master(), MotorSet::from(id(motor)), heard + Duration::from_millis(after))
    };
    assert_eq!(longest(1, 249), Duration::from_secs(3));
    assert_eq!(longest(1, 250), Duration::from_secs(1));
    assert_eq!(longest(2, 0), Duration::from_secs(1));
}

#[test]
fn on_a_line_a_stop_is_tried_for_longer_if_motors_are_many_and_while_any_is_heard() {
    let longest = |rate, motors: u8| {
        let mut master = Master::<32>::new(Config::rs485(rate, false));
        for motor in 1..=motors {
            let _ = master.request(id(motor), ReadMultiTurnAngle).unwrap();
        }
        longest_stop(&master, MotorSet::ALL, Instant::ZERO)
    };
    assert_eq!(longest(115_200, 32), Duration::from_secs(1));
    // A time-out: 5 ms and two frames of 13 bytes of 10 bits, each rounded up to a microsecond.
    assert_eq!(longest(9_600, 32), Duration::from_micros(2 * 32 * (5_000 + 2 * 13_542)));
    let (_, clock, mut arm) = serial();
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    arm.master().stop(id(2), StopKind::Hold).unwrap();
    let heard = clock.now();
    let mut longest = |after| {
        longest_stop(arm.master(), MotorSet::from(id(2)), heard + Duration::from_millis(after))
    };
    assert_eq!(longest(999), Duration::from_secs(3));
    assert_eq!(longest(1_000), Duration::from_secs(1));
    // Two turns of 32 motors of 50 ms each.
    let slow = Config { reply_timeout: Duration::from_millis(50), ..Config::rs485(9_600, false) };
    let port = TestSerial::new(&clock);
    let mut arm = SerialMaster::<_, _, 32>::new(port, clock, slow);
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    for motor in 2..=32 {
        let _ = arm.master().request(id(motor), ReadMultiTurnAngle).unwrap();
    }
    let heard = arm.now();
    let mut longest =
        |after| longest_stop(arm.master(), id(2).into(), heard + Duration::from_millis(after));
    assert_eq!(longest(3_199), Duration::from_millis(9_600));
    assert_eq!(longest(3_200), Duration::from_millis(3_200));
}

#[test]
fn a_configuration_for_the_other_bus_is_taken_as_one_for_this_bus() {
    let clock = TestClock::default();
    let (can, line) = (TestCan::new(&clock), TestSerial::new(&clock));
    let for_line = Config::rs485(115_200, true);
    let mut arm = CanMaster::<_, _, 4>::new(can.clone(), clock.clone(), for_line);
    assert_eq!(*arm.master().config(), Config { bus: Bus::Can, ..for_line });
    let mut arm = AsyncCanMaster::<_, _, 4>::new(can, clock.clone(), for_line);
    assert_eq!(*arm.master().config(), Config { bus: Bus::Can, ..for_line });

    let Config { bus, frame_time, shortest_response, .. } = Config::rs485(115_200, false);
    let on_line = Config { bus, frame_time, shortest_response, ..Config::CAN };
    let mut arm = SerialMaster::<_, _, 4>::new(line.clone(), clock.clone(), Config::CAN);
    assert_eq!(*arm.master().config(), on_line);
    let mut arm = AsyncSerialMaster::<_, _, 4>::new(line, clock, Config::CAN);
    assert_eq!(*arm.master().config(), on_line);
}

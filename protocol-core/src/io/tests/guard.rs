//! However a control loop is left, the motors are stopped.

use core::cell::Cell;
use core::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::world::{
    Broken, CanState, TestCan, TestClock, TestSerial, block_on, on_can, on_rs485, polls,
};
use super::{id, step, torque};
use crate::command::{ReadMultiTurnAngle, Shutdown, Stop};
use crate::error::RequestError;
use crate::id::Target;
use crate::io::async_bring_up::move_to;
use crate::io::bring_up::{self, MoveLimits};
use crate::io::{
    AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CallError, CanMaster, Clock, Guard, Guards,
    LONGEST_STOP, Runner, SerialMaster, guarded,
};
use crate::master::{Config, Event, Failure, MotorSet, StopKind};
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::wire::rs485::Frame;

/// The error of a call for motor 1 while it is stopped.
fn refused<E>() -> CallError<E> {
    CallError::Refused { motor: id(1), refusal: RequestError::Stopped }
}

/// Leaves a control loop in this way on either bus, and checks that the stop was the last thing sent.
macro_rules! is_stopped_after {
    (|$bus:ident| $leave:expr) => {{
        let (bus, _, mut arm) = on_can(CanMaster::<TestCan, TestClock, 4>::new);
        is_left!(arm, |$bus| $leave);
        assert_eq!(bus.commands().last(), Some(&Stop.encode()));
        assert_eq!(arm.set_point(id(1), torque()), Err(refused()));

        let (port, _, mut arm) = on_rs485(SerialMaster::<TestSerial, TestClock, 4>::new);
        is_left!(arm, |$bus| $leave);
        assert_eq!(port.commands().last(), Some(&Stop.encode()));
        assert_eq!(arm.set_point(id(1), torque()), Err(refused()));
    }};
}

macro_rules! is_left {
    ($arm:ident, |$bus:ident| $leave:expr) => {{
        $arm.ask(id(1), ReadMultiTurnAngle).unwrap();
        #[allow(unused_mut, reason = "not every way changes anything")]
        let mut $bus = Guard::new(&mut $arm, StopKind::Hold);
        $leave;
    }};
}

/// Streams, and fails at a motor that is not there.
fn control(bus: &mut impl Runner<4, Error = Broken>) -> Result<(), CallError<Broken>> {
    bus.set_point(id(1), torque())?;
    bus.ask(id(9), ReadMultiTurnAngle)?;
    unreachable!("nobody answers");
}

#[test]
fn guard_stops_motors_after_an_error() {
    is_stopped_after!(|bus| assert!(control(&mut bus).is_err()));
}

#[test]
#[expect(clippy::never_loop, reason = "it is left")]
fn guard_stops_motors_after_a_break() {
    is_stopped_after!(|bus| {
        loop {
            bus.set_point(id(1), torque()).unwrap();
            bus.run_until(bus.now(), |_| {}).unwrap();
            break;
        }
    });
}

#[test]
fn guard_stops_motors_after_a_panic() {
    is_stopped_after!(|bus| {
        let result = catch_unwind(AssertUnwindSafe(move || {
            bus.set_point(id(1), torque()).unwrap();
            panic!("in the middle");
        }));
        assert!(result.is_err());
    });
}

#[test]
fn guard_stops_motors_when_it_is_finished() {
    is_stopped_after!(|bus| assert_eq!(bus.finish(), MotorSet::EMPTY));
}

/// On a line a stop to all reaches motors that the master does not know, though none of them can confirm it.
#[test]
fn on_rs485_guard_stops_all_though_no_motor_is_known() {
    let stop = Packet { channel: Channel::Command(Target::All), data: Stop.encode() };
    let stop = Frame::from_packet(&stop).unwrap().encode();
    let (port, clock, mut arm) = on_rs485(SerialMaster::<_, _, 4>::new);
    arm.master().broadcast(torque(), MotorSet::EMPTY).unwrap();
    arm.poll().unwrap();
    assert_eq!(Guard::new(&mut arm, StopKind::Hold).finish(), MotorSet::EMPTY);
    assert!(port.written().ends_with(&stop), "{:?}", port.written());
    assert!(clock.micros() < 20_000, "{}", clock.micros());

    let (port, clock, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    assert_eq!(block_on(arm.stop_all(StopKind::Hold, MotorSet::EMPTY)), MotorSet::EMPTY);
    assert!(port.written().ends_with(&stop), "{:?}", port.written());
    assert!(clock.micros() < 20_000, "{}", clock.micros());
}

#[test]
fn guard_stops_motors_that_only_a_broadcast_has_moved() {
    let (bus, _, mut arm) = on_can(CanMaster::<_, _, 4>::new);
    let moved = [id(1), id(9)].into_iter().collect();
    arm.master().broadcast(torque(), moved).unwrap();
    arm.poll().unwrap();
    assert_eq!(bus.sent(), [torque().encode()]);
    // Nobody is at 9.
    assert_eq!(Guard::new(&mut arm, StopKind::Hold).finish(), id(9).into());
}

#[test]
fn guarded_task_stops_motors_after_an_error() {
    let (bus, _, mut arm) = on_can(AsyncCanMaster::<_, _, 4>::new);
    let (result, unconfirmed) = block_on(guarded(&mut arm, StopKind::Hold, async |bus| {
        bus.set_point(id(1), torque())?;
        bus.ask(id(1), ReadMultiTurnAngle).await?;
        bus.set_point(id(1), torque())?;
        Err::<(), _>(CallError::Bus(Broken))
    }));
    assert_eq!(result, Err(CallError::Bus(Broken)));
    assert_eq!(unconfirmed, MotorSet::EMPTY);
    assert_eq!(bus.sent().last(), Some(&Stop.encode()));
}

#[test]
fn dropped_guarded_future_stops_motors() {
    let (bus, _, mut arm) = on_can(AsyncCanMaster::<_, _, 4>::new);
    assert!(polls(guarded(&mut arm, StopKind::Hold, streaming), 50).is_none());
    // Nothing runs the bus just now; whatever runs it next sends the stop first.
    let before = bus.sent().len();
    let _event = block_on(arm.next_event());
    assert_eq!(bus.sent().get(before), Some(&Stop.encode()));
    assert_eq!(arm.set_point(id(1), torque()), Err(refused()));
}

#[test]
fn dropped_move_future_stops_the_motor() {
    let (bus, _, mut arm) = on_can(AsyncCanMaster::<_, _, 4>::new);
    let limits = MoveLimits::default();
    let go_on = |_: &_| ControlFlow::Continue(());
    assert!(polls(move_to(&mut arm, id(1), step(), &limits, go_on), 50).is_none());
    let before = bus.sent().len();
    assert!(bus.sent().contains(&step().encode()), "it was on its way");
    let _event = block_on(arm.next_event());
    assert_eq!(bus.sent().get(before), Some(&Stop.encode()));
    assert_eq!(arm.set_point(id(1), torque()), Err(refused()));
}

/// Works for ever.
async fn streaming<R: AsyncRunner<4, Error = Broken>>(bus: &mut R) {
    loop {
        bus.set_point(id(1), torque()).unwrap();
        bus.next_event().await.unwrap();
    }
}

#[test]
fn on_rs485_guarded_task_stops_motors_after_an_error() {
    let (port, _, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    let (result, unconfirmed) = block_on(guarded(&mut arm, StopKind::Hold, async |bus| {
        bus.set_point(id(1), torque())?;
        bus.ask(id(9), ReadMultiTurnAngle).await?;
        Ok::<(), CallError<Broken>>(())
    }));
    assert_eq!(result, Err(CallError::Failed { motor: id(9), failure: Failure::NoReply }));
    assert_eq!(unconfirmed, id(9).into());
    assert!(port.commands().ends_with(&[Stop.encode(); 2]));
    assert_eq!(arm.set_point(id(1), torque()), Err(refused()));
}

#[test]
fn on_rs485_dropped_guarded_future_stops_motors() {
    let (port, _, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    block_on(arm.ask(id(1), ReadMultiTurnAngle)).unwrap();
    assert!(polls(guarded(&mut arm, StopKind::Hold, streaming), 20).is_none());
    let before = port.commands().len();
    assert!(before > 1, "it was at work");
    while block_on(arm.next_event()).unwrap() != (Event::StopConfirmed { motor: id(1) }) {}
    // First to all, then to the motor; and once more, since its answer may be that to the first.
    assert_eq!(port.commands()[before..], [Stop.encode(); 3]);
    assert_eq!(arm.set_point(id(1), torque()), Err(refused()));
}

/// Has set a motor in motion.
async fn panicking<R: AsyncRunner<4, Error = Broken>>(bus: &mut R) {
    bus.ask(id(1), ReadMultiTurnAngle).await.unwrap();
    bus.set_point(id(1), torque()).unwrap();
    panic!("in the middle");
}

#[test]
fn guarded_task_stops_motors_after_a_panic() {
    let (bus, _, mut arm) = on_can(AsyncCanMaster::<_, _, 4>::new);
    let task = || block_on(guarded(&mut arm, StopKind::Hold, panicking));
    assert!(catch_unwind(AssertUnwindSafe(task)).is_err());
    let before = bus.sent().len();
    while block_on(arm.next_event()).unwrap() != (Event::StopConfirmed { motor: id(1) }) {}
    // It has answered one command before.
    assert_eq!(bus.sent()[before..], [Stop.encode(); 2]);
    assert_eq!(arm.set_point(id(1), torque()), Err(refused()));

    let (port, _, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    let task = || block_on(guarded(&mut arm, StopKind::Hold, panicking));
    assert!(catch_unwind(AssertUnwindSafe(task)).is_err());
    let before = port.commands().len();
    while block_on(arm.next_event()).unwrap() != (Event::StopConfirmed { motor: id(1) }) {}
    assert_eq!(port.commands()[before..], [Stop.encode(); 4], "to all, and three of its own");
    assert_eq!(arm.set_point(id(1), torque()), Err(refused()));
}

/// The motor has confirmed the stop, so that whoever uses the loop next owes it nothing.
#[test]
fn guarded_task_that_ends_stops_its_motor_once() {
    let (bus, _, mut arm) = on_can(AsyncCanMaster::<TestCan, TestClock, 4>::new);
    let (is_done, unconfirmed) = block_on(guarded(&mut arm, StopKind::Hold, async |bus| {
        bus.ask(id(1), ReadMultiTurnAngle).await.is_ok()
            && bus.ask(id(1), ReadMultiTurnAngle).await.is_ok()
    }));
    assert!(is_done && unconfirmed.is_empty());
    let stops = |bus: &TestCan| bus.sent().iter().filter(|&&data| data == Stop.encode()).count();
    assert_eq!(stops(&bus), 1);
    block_on(arm.ask(id(2), ReadMultiTurnAngle)).unwrap();
    assert_eq!(stops(&bus), 1);
}

type BothBuses<'a> = Guards<'a, CanMaster<TestCan, TestClock, 4>, 2, 4>;

/// Two buses at one clock, with motor 1 on each.
fn both_buses() -> ([TestCan; 2], [CanMaster<TestCan, TestClock, 4>; 2]) {
    let clock = TestClock::default();
    let cans = [TestCan::new(&clock), TestCan::new(&clock)];
    let mut buses = cans.clone().map(|can| CanMaster::new(can, clock.clone(), Config::CAN));
    for bus in &mut buses {
        bus.ask(id(1), ReadMultiTurnAngle).unwrap();
    }
    (cans, buses)
}

/// Of these buses the first carries nothing any more. Leaves them in this way; returns when motor 1 of the second was
/// sent its stop, after that, and how long it took in all.
fn of_two_the_first_is_cut(
    cut: fn(&mut CanState),
    leave: impl FnOnce(BothBuses<'_>),
) -> [Duration; 2] {
    let (cans, mut buses) = both_buses();
    cut(&mut cans[0].state());
    let begun = buses[1].now();
    leave(Guards::new(buses.each_mut(), [StopKind::Hold; 2]));
    assert_eq!(cans[1].commands().last(), Some(&Stop.encode()));
    for bus in &mut buses {
        assert_eq!(bus.set_point(id(1), torque()), Err(refused()));
    }
    [cans[1].sent_at(Stop.encode()) - begun, buses[1].now() - begun]
}

#[test]
fn guards_of_several_buses_do_not_wait_for_each_other() {
    let ways: [fn(BothBuses<'_>); 3] = [
        |buses| assert_eq!(buses.finish(), [id(1).into(), MotorSet::EMPTY]),
        |buses| drop(buses),
        |mut buses| {
            buses[1].set_point(id(1), torque()).unwrap();
            let panics = AssertUnwindSafe(|| {
                let _buses = buses;
                panic!("a test that panics");
            });
            catch_unwind(panics).unwrap_err();
        },
    ];
    let cuts: [fn(&mut CanState); 2] =
        [|can| can.full_until = u64::MAX, |can| can.transmit_fails = true];
    for (cut, leave) in cuts.into_iter().flat_map(|cut| ways.map(|leave| (cut, leave))) {
        let [stopped, all] = of_two_the_first_is_cut(cut, leave);
        assert!(stopped <= Duration::from_millis(6), "{stopped}");
        assert!(all <= LONGEST_STOP + Duration::from_millis(20), "{all}");
    }
}

#[test]
fn guards_stop_each_bus_in_its_own_way() {
    let (cans, mut buses) = both_buses();
    let kinds = [StopKind::Off, StopKind::Hold];
    assert_eq!(Guards::new(buses.each_mut(), kinds).finish(), [MotorSet::EMPTY; 2]);
    let stops = [Shutdown.encode(), Stop.encode()];
    assert_eq!(cans.map(|can| can.commands().last().copied()), stops.map(Some));
}

/// The limits of the move say that it ends with the motor off, but another stop holds the motor.
#[test]
fn refused_move_does_not_switch_off_a_held_motor() {
    let limits = MoveLimits { stop: StopKind::Off, ..MoveLimits::default() };
    let go_on = |_: &_| ControlFlow::Continue(());
    let (bus, _, mut arm) = on_can(CanMaster::<TestCan, TestClock, 4>::new);
    assert!(arm.stop(id(1), StopKind::Hold));
    let moved = bring_up::move_to(&mut arm, id(1), step(), &limits, go_on);
    assert!(moved.unwrap_err().is_stopped);
    assert!(!bus.sent().contains(&Shutdown.encode()));
}

#[test]
fn clock_that_panics_leaves_the_other_buses_stopped() {
    let clock = TestClock::default();
    let cans = [TestCan::new(&clock), TestCan::new(&clock)];
    let mut buses =
        cans.map(|can| CanMaster::<TestCan, _, 4>::new(can, PanicsOnce::of(&clock), Config::CAN));
    for bus in &mut buses {
        bus.ask(id(1), ReadMultiTurnAngle).unwrap();
    }
    let guards = Guards::new(buses.each_mut(), [StopKind::Hold; 2]);
    PANICS.set(true);
    catch_unwind(AssertUnwindSafe(|| guards.finish())).unwrap_err();
    assert_eq!(buses[1].set_point(id(1), torque()), Err(refused()));
}

std::thread_local! {
    static PANICS: Cell<bool> = const { Cell::new(false) };
}

/// A clock that panics when it is asked to, once.
struct PanicsOnce(TestClock);

impl PanicsOnce {
    fn of(clock: &TestClock) -> Self {
        Self(clock.clone())
    }
}

impl Clock for PanicsOnce {
    fn now(&self) -> Instant {
        assert!(!PANICS.replace(false), "a test that panics");
        self.0.now()
    }

    fn idle(&self, until: Instant) {
        self.0.idle(until);
    }
}

/// A gripper that is to be switched off, and not to hold with all its torque what it has reached.
#[test]
fn a_move_is_stopped_as_its_limits_say_however_it_is_left() {
    let limits = MoveLimits { stop: StopKind::Off, ..MoveLimits::default() };
    let sent_last = |bus: &TestCan| bus.sent().last().copied();
    let (bus, _, mut arm) = on_can(CanMaster::<TestCan, TestClock, 4>::new);
    let moved = bring_up::move_to(&mut arm, id(1), step(), &limits, |_| ControlFlow::Break(()));
    assert!(moved.unwrap_err().is_stopped);
    assert_eq!(sent_last(&bus), Some(Shutdown.encode()));

    let (bus, _, mut arm) = on_can(CanMaster::<TestCan, TestClock, 4>::new);
    let moves = AssertUnwindSafe(|| {
        bring_up::move_to(&mut arm, id(1), step(), &limits, |_| panic!("a test that panics"))
    });
    catch_unwind(moves).unwrap_err();
    assert_eq!(sent_last(&bus), Some(Shutdown.encode()));

    let (bus, _, mut arm) = on_can(AsyncCanMaster::<TestCan, TestClock, 4>::new);
    let go_on = |_: &_| ControlFlow::Continue(());
    assert!(polls(move_to(&mut arm, id(1), step(), &limits, go_on), 50).is_none());
    let _ = block_on(arm.run(Some(arm.now())));
    assert_eq!(sent_last(&bus), Some(Shutdown.encode()));
}

/// A clock that idles until its own port has something, as one does that waits for one file.
struct ClockOf(TestClock, TestSerial);

impl Clock for ClockOf {
    fn now(&self) -> Instant {
        self.0.now()
    }

    fn idle(&self, until: Instant) {
        while self.now() < until && !self.1.is_ready() {
            self.0.idle(until);
        }
    }
}

/// How long it takes to stop a line of three motors and one that is dead, alone or beside a line of one motor.
fn line_stops_in(is_alone: bool) -> Duration {
    let clock = TestClock::default();
    let line = |_| {
        let port = TestSerial::new(&clock);
        let own = ClockOf(clock.clone(), port.clone());
        SerialMaster::<_, _, 4>::new(port, own, Config::rs485(115_200, false))
    };
    let mut lines = [(), ()].map(line);
    lines[0].ask(id(1), ReadMultiTurnAngle).unwrap();
    for motor in [1, 2, 3] {
        lines[1].ask(id(motor), ReadMultiTurnAngle).unwrap();
    }
    lines[1].ask(id(9), ReadMultiTurnAngle).unwrap_err();
    let begun = clock.now();
    let unconfirmed = match is_alone {
        true => [MotorSet::EMPTY, lines[1].stop_all(StopKind::Hold, MotorSet::EMPTY)],
        false => Guards::new(lines.each_mut(), [StopKind::Hold; 2]).finish(),
    };
    assert_eq!(unconfirmed, [MotorSet::EMPTY, id(9).into()]);
    clock.now() - begun
}

#[test]
fn line_is_stopped_as_soon_beside_one_that_is_stopped_already() {
    let [alone, beside] = [true, false].map(line_stops_in);
    // While both are being stopped, each idles for the other, too.
    assert!(beside <= alone + Duration::from_millis(10), "{alone} and {beside}");
}

/// Whether a stop is reported depends on the motor that is stopped alone.
#[test]
fn stop_takes_no_longer_beside_a_dead_motor() {
    let config = Config { reply_timeout: Duration::from_secs(1), ..Config::CAN };
    let times = [false, true].map(|is_one_dead| {
        let clock = TestClock::default();
        let mut arm = CanMaster::<_, _, 4>::new(TestCan::new(&clock), clock.clone(), config);
        arm.ask(id(1), ReadMultiTurnAngle).unwrap();
        if is_one_dead {
            arm.ask(id(9), ReadMultiTurnAngle).unwrap_err();
        }
        clock.advance(150_000);
        let begun = arm.now();
        assert!(arm.stop(id(1), StopKind::Hold));
        arm.now() - begun
    });
    assert_eq!(times[0], times[1]);
}

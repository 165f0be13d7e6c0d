//! Threads on one bus of simulated drives, in real time.

mod desk;
mod failing;
mod holding;
mod watch;

use std::any::Any;
use std::fmt::{Debug, Display};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, sync_channel};
use std::sync::{Arc, Barrier};
use std::{thread, time};

use myactuator_protocol_core::command::{
    AbsolutePosition, Command, ErrorFlags, IncrementalPosition, MotionRanges, MotionSetPoint,
    ReadMultiTurnAngle, ReadStatus1, ReleaseBrake, Shutdown, Speed, Stop,
};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::bring_up::MoveLimits;
use myactuator_protocol_core::io::{CallError, CanMaster, LONGEST_TURN, Runner, SerialMaster};
use myactuator_protocol_core::master::{
    Bus, Config, Event, Failure, Master, MotorSet, Patience, StopKind,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, MaxSpeed, MaxTorque, Milliseconds, SpeedTarget};
use myactuator_protocol_core::wire::can::{self, Received, SimpleFrame};
use myactuator_protocol_core::{Channel, Data, MotorId, Packet, Target};

use super::calls::{Insistence, Untyped};
use super::desk::Desk;
use super::{Guard, Guards, SharedBus, SharedBusError};
use crate::sim::bus::SimClock;
use crate::sim::bus::can::{CanBus, CanError, CanPort};
use crate::sim::bus::rs485::SerialError;
use crate::sim::bus::trace::{self, Log};
use crate::sim::{CanFleet, Fleet, LineFleet};

type SimMaster = CanMaster<CanPort, SimClock<CanBus>, 8>;

pub(super) fn id(number: u8) -> MotorId {
    MotorId::new(number).unwrap()
}

fn turn(dps: f32) -> Speed {
    let speed = SpeedTarget::from_dps(dps).unwrap();
    Speed { max_torque: MaxTorque::NO_LIMIT, speed }
}

/// Drives in real time, and the bus that they are on.
pub(super) fn shared(motors: u8) -> (CanFleet, SharedBus<CanError>) {
    shared_fleet(&Fleet::new(motors))
}

pub(super) fn shared_fleet(fleet: &Fleet) -> (CanFleet, SharedBus<CanError>) {
    let fleet = fleet.on_can(1_000_000).unwrap();
    let world = fleet.world.clone().in_real_time();
    let bus = SharedBus::with_wake(fleet.master::<8>(), move || world.wake(), StopKind::Hold);
    held_after(&bus, NOT_HELD);
    (fleet, bus)
}

/// The same on a line of this bit rate.
fn shared_line(motors: u8, bit_rate: u32) -> (LineFleet, SharedBus<SerialError>) {
    let fleet = Fleet::new(motors).on_rs485(bit_rate).unwrap();
    let (port, clock) = (fleet.world.port(), fleet.world.clock());
    let master = SerialMaster::<_, _, 8>::new(port, clock, Config::rs485(bit_rate, false));
    let world = fleet.world.clone().in_real_time();
    (fleet, SharedBus::with_wake(master, move || world.wake(), StopKind::Hold))
}

/// Longer than a busy machine keeps a thread from its work.
const NOT_HELD: time::Duration = time::Duration::from_secs(60);
/// Whoever is held for so long on purpose is noticed.
const HELD: time::Duration = time::Duration::from_secs(1);

/// How long the thread of a bus has to be away until its driver counts as one that holds it.
fn held_after(bus: &SharedBus<CanError>, longest_round: time::Duration) {
    bus.desk().lock().longest_round = longest_round;
}

/// Turns each shaft by ten degrees times its motor's id.
fn turn_by_id(fleet: &CanFleet) {
    for drive in &fleet.drives {
        let angle = 10.0 * f64::from(drive.motor().get());
        drive.with(|drive| drive.plant_mut().set_output_angle_deg(angle)).unwrap();
    }
    // The control loops measure it.
    fleet.world.run_for(Duration::from_millis(10));
}

/// Checks that a call was told of this motor, and this.
#[track_caller]
fn tells<E: Debug>(returned: &SharedBusError<E>, motor: u8, why: impl Display) {
    assert_eq!(returned.to_string(), format!("motor {motor}: {why}"));
}

/// The packets that were on the wire since this was last asked.
pub(super) fn packets(log: &Log<SimpleFrame>) -> Vec<Packet> {
    let carried = log.take().into_iter().filter_map(|record| match record.event {
        trace::Event::Carried { frame, .. } => Some(frame),
        _ => None,
    });
    let packets = carried.filter_map(|frame| match can::decode(&frame) {
        Received::Packet(packet) => Some(packet),
        _ => None,
    });
    packets.collect()
}

#[test]
fn eight_threads_ask_eight_motors_at_once_and_get_their_own_replies() {
    let (fleet, bus) = shared(8);
    turn_by_id(&fleet);
    let log = fleet.world.log();
    let start = Arc::new(Barrier::new(8));
    let threads = MotorId::all().take(8).map(|motor| {
        let (bus, start) = (bus.clone(), Arc::clone(&start));
        thread::spawn(move || {
            start.wait();
            for _ in 0..25 {
                let angle = bus.ask(motor, ReadMultiTurnAngle).unwrap().angle.degrees();
                assert!((angle - 10.0 * f32::from(motor.get())).abs() < 0.1, "{motor}: {angle}");
            }
        })
    });
    threads.collect::<Vec<_>>().into_iter().for_each(|thread| thread.join().unwrap());
    // They are under way together.
    let (mut in_flight, mut most) = (MotorSet::EMPTY, 0);
    for packet in packets(&log) {
        match packet.channel {
            Channel::Command(Target::Motor(motor)) => in_flight.insert(motor),
            Channel::Reply(motor) => in_flight.remove(motor),
            other => panic!("{other}"),
        }
        most = most.max(in_flight.len());
    }
    assert!(most > 1, "one at a time");
}

/// The third motor is not there; the two commands of the first go one after the other.
#[test]
fn joint_ask_is_sent_to_all_at_once_and_returns_an_outcome_for_each() {
    let (fleet, bus) = shared(3);
    turn_by_id(&fleet);
    fleet.world.cut(fleet.drives[2].station());
    let log = fleet.world.log();
    let outcomes = bus.ask_together([1, 2, 3, 1].map(|motor| (id(motor), ReadMultiTurnAngle)));
    let degrees = |at: usize| outcomes[at].as_ref().unwrap().angle.degrees();
    for (at, expected) in [(0, 10.0), (1, 20.0), (3, 10.0)] {
        assert!((degrees(at) - expected).abs() < 0.1, "{at}: {}", degrees(at));
    }
    tells(outcomes[2].as_ref().unwrap_err(), 3, Failure::NoReply);
    let channels: Vec<Channel> = packets(&log).iter().map(|packet| packet.channel).collect();
    let to = |motor| Channel::Command(id(motor).into());
    assert_eq!(channels[..3], [to(1), to(2), to(3)], "no answer is waited for");
}

#[test]
fn stop_by_one_thread_ends_the_moves_of_others_with_an_error() {
    let (fleet, bus) = shared(2);
    let log = fleet.world.log();
    let moving = thread::spawn({
        let bus = bus.clone();
        move || loop {
            if let Err(error) = bus.set_point(id(1), turn(90.0)) {
                return error;
            }
            thread::sleep(std::time::Duration::from_micros(500));
        }
    });
    // This one does not hear its command.
    fleet.world.cut(fleet.drives[1].station());
    let asking = thread::spawn({
        let bus = bus.clone();
        let for_ever = Patience { reply_timeout: Duration::from_secs(3_600), attempts: 1 };
        let goal =
            AbsolutePosition { max_speed: MaxSpeed::from_raw(10), angle: Angle::from_raw(0) };
        move || bus.ask_with(id(2), goal, for_ever)
    });
    let is_asked = |packet: &Packet| packet.channel == Channel::Command(id(2).into());
    while bus.latest(id(1)).is_none() || !packets(&log).iter().any(is_asked) {
        thread::yield_now();
    }
    fleet.world.mend(fleet.drives[1].station());

    assert_eq!(bus.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
    let refused = moving.join().unwrap();
    tells(&refused, 1, RequestError::Stopped);
    let returned = asking.join().unwrap().unwrap_err();
    tells(&returned, 2, Failure::Stopped);

    // Nothing that moves follows it, until it is lifted.
    packets(&log);
    assert!(bus.set_point(id(1), turn(90.0)).is_err());
    assert!(bus.ask(id(1), turn(90.0)).is_err());
    bus.ask(id(1), ReadStatus1).unwrap();
    // On a busy machine the stop takes long enough for the bus to ask motors that rest.
    let sent = packets(&log);
    assert!(sent.iter().all(|packet| [0x9A, 0xB1].contains(&packet.data[0])), "{sent:?}");
    bus.lift_stop().unwrap();
    bus.ask(id(1), turn(90.0)).unwrap();
    // One of them alone.
    assert_eq!(bus.stop(id(1), StopKind::Hold).unwrap(), MotorSet::EMPTY);
    assert!(bus.ask(id(1), turn(90.0)).is_err());
    bus.ask(id(2), turn(90.0)).unwrap();
    bus.lift_stop_of(id(1)).unwrap();
    bus.ask(id(1), turn(90.0)).unwrap();
}

#[test]
fn the_last_handle_stops_the_motors_and_ends_the_thread() {
    let (fleet, bus) = shared(1);
    let log = fleet.world.log();
    let (clone, mut events) = (bus.clone(), bus.subscribe(1_000));
    bus.ask(id(1), turn(90.0)).unwrap();
    drop(bus);
    clone.ask(id(1), ReadStatus1).unwrap();
    assert!(packets(&log).iter().all(|packet| packet.data[0] != 0x81));
    drop(clone);
    let sent: Vec<_> = packets(&log).iter().map(|packet| packet.data[0]).collect();
    assert_eq!(sent, [0x81, 0x81], "the stop and its confirmation");
    // The two answers, and the end.
    assert_eq!(events.by_ref().count(), 2);
    assert_eq!(events.next(), None);
}

/// Whoever waits for a stop needs no handle.
#[test]
fn stop_that_is_waited_for_is_confirmed_although_the_last_handle_has_gone() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), turn(90.0)).unwrap();
    hold_up(&order);
    let stop = bus.begin_stop_all(StopKind::Off, id(2).into());
    let dropping = thread::spawn(move || drop(bus));
    order.store(WORK, Ordering::SeqCst);
    assert_eq!(stop.wait().unwrap(), id(2).into(), "there is no such motor");
    dropping.join().unwrap();
    // It would be held if the end of the bus had undone the stop.
    let state = fleet.drives[0].with(|drive| drive.state());
    assert!(!state.output_on, "{state:?}");
}

/// It hears nothing else meanwhile.
#[test]
fn motor_that_has_confirmed_a_stop_holds_while_a_dead_one_is_waited_for() {
    let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
    let patient = Config { reply_timeout: Duration::from_millis(50), ..Config::CAN };
    let (port, clock) = (fleet.world.port(), fleet.world.clock());
    let master = CanMaster::<_, _, 8>::new(port, clock, patient);
    let world = fleet.world.clone().in_real_time();
    let bus = SharedBus::with_wake(master, move || world.wake(), StopKind::Hold);
    bus.protect(id(1), Milliseconds::from_raw(300)).unwrap();
    bus.ask(id(2), ReadStatus1).unwrap();
    fleet.world.cut(fleet.drives[1].station());
    let mut events = bus.subscribe(1_000);
    // 15 attempts take 750 ms.
    assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(), id(2).into());
    assert!(fleet.drives[0].with(|drive| drive.state()).output_on);
    drop(bus);
    // What it was asked is nobody's business.
    assert!(events.all(|event| !matches!(event, Event::Reply { .. })));
}

/// Another thread restarts a motor meanwhile, which takes more than a second.
#[test]
fn motor_whose_thread_hangs_is_let_go_by_its_protection_though_a_function_keeps_others_alive() {
    let (fleet, bus) = shared(3);
    let has_output = |place: usize| fleet.drives[place].with(|drive| drive.state()).output_on;
    for motor in [2, 3] {
        bus.protect(id(motor), Milliseconds::from_raw(300)).unwrap();
    }
    bus.ask(id(2), Stop).unwrap();
    bus.ask(id(1), ReadStatus1).unwrap();
    bus.set_point(id(3), turn(90.0)).unwrap();
    // It hangs from here on.
    bus.restart(id(1)).unwrap();
    assert!(has_output(1) && !has_output(2));
}

/// Its thread goes on before the stop is confirmed: the confirmation says nothing of what came after the stop.
#[test]
fn motor_moved_again_before_its_stop_is_confirmed_is_let_go_by_its_protection() {
    type BeginStop = fn(&Desk<CanError>) -> Box<dyn Any>;
    let stops: [BeginStop; 3] = [
        |desk| Box::new(desk.stop_all(StopKind::Hold, MotorSet::EMPTY)),
        |desk| Box::new(desk.stop(id(3), StopKind::Hold, None)),
        |desk| Box::new(desk.ask(id(3), Untyped::of(&Stop), Insistence::Attempts(15), None)),
    ];
    for (number, stop) in stops.into_iter().enumerate() {
        let (fleet, bus) = shared(3);
        bus.protect(id(3), Milliseconds::from_raw(300)).unwrap();
        bus.ask(id(1), ReadStatus1).unwrap();
        bus.set_point(id(3), turn(90.0)).unwrap();
        bus.ask(id(3), ReadStatus1).unwrap();
        let station = fleet.drives[2].station();
        fleet.world.cut(station);
        let waiting = stop(bus.desk());
        bus.lift_stop().unwrap();
        // The thread takes the stop up before the set-point, and both before the stop is confirmed.
        bus.ask(id(1), ReadStatus1).unwrap();
        bus.set_point(id(3), turn(90.0)).unwrap();
        bus.ask(id(1), ReadStatus1).unwrap();
        let mut events = bus.subscribe(10_000);
        fleet.world.mend(station);
        assert!(
            events.any(|event| matches!(event, Event::Feedback { motor, .. } if motor == id(3)))
        );
        drop(waiting);
        // It hangs from here on.
        bus.restart(id(1)).unwrap();
        assert!(!fleet.drives[2].with(|drive| drive.state()).output_on, "{number}");
    }
}

#[test]
fn guard_stops_the_motors_at_its_end_though_another_handle_exists() {
    let (fleet, bus) = shared(1);
    let log = fleet.world.log();
    // From then on one answer confirms a stop.
    for _ in 0..3 {
        bus.ask(id(1), ReadStatus1).unwrap();
    }
    let run = |work: fn(Guard<CanError>)| {
        packets(&log);
        let handle = bus.clone();
        let ended = thread::spawn(move || {
            let guard = Guard::new(handle, StopKind::Hold);
            guard.ask(id(1), turn(90.0)).unwrap();
            work(guard);
        });
        let is_panic = ended.join().is_err();
        let refused = bus.ask(id(1), turn(90.0)).unwrap_err();
        tells(&refused, 1, RequestError::Stopped);
        bus.lift_stop().unwrap();
        let sent: Vec<_> = packets(&log).iter().map(|packet| packet.data[0]).collect();
        (is_panic, sent)
    };
    // Each command, and its answer: the motor has heard the stop when the thread has ended.
    let moved_and_stopped = vec![0xA2, 0xA2, 0x81, 0x81];
    assert_eq!(run(|_bus| panic!("made up")), (true, moved_and_stopped.clone()));
    assert_eq!(run(drop), (false, moved_and_stopped.clone()));
    let finish = |bus: Guard<_>| assert_eq!(bus.finish().unwrap(), MotorSet::EMPTY);
    assert_eq!(run(finish), (false, moved_and_stopped));
}

#[test]
fn stop_without_named_motors_returns_once_it_was_sent() {
    let fleet = Fleet::new(2).on_rs485(1_000_000).unwrap();
    // The line is not free at once.
    let turnaround = Duration::from_millis(50);
    let config =
        Config { bus: Bus::Rs485 { turnaround, echo: false }, ..Config::rs485(1_000_000, false) };
    let mut master = SerialMaster::<_, _, 8>::new(fleet.world.port(), fleet.world.clock(), config);
    master.ask(id(1), ReadStatus1).unwrap();
    assert!(master.master().forget(id(1)));
    let world = fleet.world.clone().in_real_time();
    let bus = SharedBus::with_wake(master, move || world.wake(), StopKind::Hold);
    let log = fleet.world.log();
    assert_eq!(bus.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
    let mut sent = log.take().into_iter().filter_map(|record| match record.event {
        trace::Event::Carried { frame, .. } => Some(frame),
        _ => None,
    });
    // 3.2: all motors are at 0xCD; 2.17: 0x80.
    let stops_all = |frame: Vec<u8>| frame[1] == 0xCD && frame[3] == 0x80;
    assert!(sent.any(stops_all), "a stop that is over has left");
}

#[test]
fn forgotten_id_is_not_awaited_by_a_stop() {
    let (_fleet, bus) = shared(1);
    assert!(bus.ask(id(7), ReadStatus1).is_err());
    assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(), id(7).into());
    bus.lift_stop().unwrap();
    bus.forget(id(7)).unwrap();
    assert_eq!(bus.stop_all(StopKind::Hold, id(1).into()).unwrap(), MotorSet::EMPTY);
}

#[test]
fn subscribers_get_the_motors_that_did_not_confirm_the_last_stop() {
    let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
    let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
    for motor in [1, 2] {
        bus.ask(id(motor), turn(90.0)).unwrap();
    }
    fleet.world.cut(fleet.drives[1].station());
    let events = bus.subscribe(1_000);
    drop(bus);
    let reported: Vec<_> = events.collect();
    assert_eq!(reported, [Event::StopUnconfirmed { motor: id(2) }]);
}

#[test]
fn slow_subscriber_loses_its_own_events_and_no_others() {
    let (_fleet, bus) = shared(1);
    let (mut slow, quick) = (bus.subscribe(3), bus.subscribe(1_000));
    drop(bus.subscribe(1));
    for _ in 0..20 {
        bus.ask(id(1), ReadMultiTurnAngle).unwrap();
    }
    // The last answer may be on its way to the subscribers.
    drop(bus);
    assert_eq!((slow.by_ref().count(), slow.lost()), (3, 17));
    assert_eq!((quick.lost(), std::iter::from_fn(|| quick.try_next()).count()), (0, 20));
}

/// What a bus is to do next.
const WORK: u32 = 0;
const FAIL_ONCE: u32 = 1;
const FAIL: u32 = 2;
const PANIC_ONCE: u32 = 3;
const REFUSE: u32 = 4;
const BLOCK: u32 = 5;
const BLOCKED: u32 = 6;
/// Blocks when something waits to be sent, and sends nothing of it in that look at the bus.
const BLOCK_AT_WORK: u32 = 7;
/// Is suspended for longer than a stop is tried when something waits to be sent.
const SUSPEND_AT_WORK: u32 = 8;
pub(super) const PANIC: u32 = 9;
/// Is suspended for 100 ms while it idles, once it gets another order.
const SUSPEND_IDLE: u32 = 10;
/// Fails until something waits to be sent, and once more then.
const FAIL_AT_WORK: u32 = 11;
/// Is suspended for longer than a question waits for its turn, once it has received a reply.
const SUSPEND_AFTER_REPLY: u32 = 12;

/// A bus that fails when it is told to.
struct Fragile(SimMaster, Arc<AtomicU32>);

impl Fragile {
    /// Holds the thread until it gets another order than this, and for 100 ms of its own time.
    fn hold_for_100_ms(&mut self, order: u32) {
        // Unless there is another order already.
        let _ = self.1.compare_exchange(order, BLOCKED, Ordering::SeqCst, Ordering::SeqCst);
        while self.1.load(Ordering::SeqCst) == BLOCKED {
            thread::sleep(std::time::Duration::from_millis(1));
        }
        self.idle_until(self.0.now() + Duration::from_millis(100));
    }

    fn idle_until(&mut self, end: Instant) {
        while self.0.now() < end {
            self.0.idle(end);
        }
    }
}

impl Runner<8> for Fragile {
    type Error = CanError;

    fn master(&mut self) -> &mut Master<8> {
        self.0.master()
    }

    fn now(&self) -> Instant {
        self.0.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, CanError> {
        let mut order = self.1.load(Ordering::SeqCst);
        let now = self.0.now();
        let has_work = self.0.master().clone().poll_transmit(now).is_some();
        let at_work = order == BLOCK_AT_WORK && has_work;
        if order == BLOCK || at_work {
            // A write that takes 100 ms, in which somebody gives another order.
            self.hold_for_100_ms(order);
            order = self.1.load(Ordering::SeqCst);
            if at_work && order == WORK {
                return Ok(None);
            }
        }
        if order == SUSPEND_AT_WORK && has_work {
            let _ = self.1.compare_exchange(order, WORK, Ordering::SeqCst, Ordering::SeqCst);
            self.idle_until(now + Duration::from_millis(1_500));
            return Ok(None);
        }
        if [FAIL_ONCE, PANIC_ONCE].contains(&order) || order == FAIL_AT_WORK && has_work {
            // Unless there is another order already.
            let _ = self.1.compare_exchange(order, WORK, Ordering::SeqCst, Ordering::SeqCst);
        }
        match order {
            SUSPEND_AFTER_REPLY => {
                let event = self.0.poll()?;
                if matches!(event, Some(Event::Reply { .. })) {
                    self.1.store(WORK, Ordering::SeqCst);
                    self.idle_until(self.0.now() + LONGEST_TURN);
                }
                Ok(event)
            }
            WORK | BLOCK_AT_WORK | SUSPEND_AT_WORK | SUSPEND_IDLE => self.0.poll(),
            REFUSE => {
                let now = self.0.now();
                self.0.master().handle_bus_down(now);
                Ok(self.0.master().poll_event())
            }
            PANIC_ONCE | PANIC => panic!("the adapter is on fire"),
            // As loops do.
            _ => {
                let now = self.0.now();
                self.0.master().handle_bus_down(now);
                Err(CanError::BusOff)
            }
        }
    }

    fn idle(&mut self, until: Instant) {
        if self.1.load(Ordering::SeqCst) == SUSPEND_IDLE {
            return self.hold_for_100_ms(SUSPEND_IDLE);
        }
        self.0.idle(until.min(self.now() + Duration::from_millis(1)));
    }
}

/// One in virtual time, which nothing wakes.
pub(super) fn fragile() -> (CanFleet, Arc<AtomicU32>, SharedBus<CanError>) {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let order = Arc::new(AtomicU32::new(WORK));
    let bus = SharedBus::new(Fragile(fleet.master(), Arc::clone(&order)), StopKind::Hold);
    held_after(&bus, NOT_HELD);
    (fleet, order, bus)
}

/// Has the driver not come back until it gets another order.
fn hold_up(order: &AtomicU32) {
    order.store(BLOCK, Ordering::SeqCst);
    while order.load(Ordering::SeqCst) != BLOCKED {
        thread::yield_now();
    }
}

#[test]
fn stop_during_which_the_program_is_suspended_is_confirmed() {
    let (_fleet, order, bus) = fragile();
    bus.ask(id(1), turn(90.0)).unwrap();
    order.store(SUSPEND_AT_WORK, Ordering::SeqCst);
    assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
}

#[test]
fn subscribers_get_the_motors_unconfirmed_after_a_panic() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), turn(90.0)).unwrap();
    let events = bus.subscribe(100);
    fleet.world.cut(fleet.drives[0].station());
    order.store(PANIC_ONCE, Ordering::SeqCst);
    let reported: Vec<_> = events.collect();
    assert_eq!(reported, [Event::StopUnconfirmed { motor: id(1) }]);
}

#[test]
fn a_panic_in_the_last_stop_is_no_confirmation() {
    let (_fleet, order, bus) = fragile();
    bus.ask(id(1), turn(90.0)).unwrap();
    let events = bus.subscribe(100);
    // Once in a round, and again in the stop that follows.
    order.store(PANIC, Ordering::SeqCst);
    let reported: Vec<_> = events.collect();
    assert_eq!(reported, [Event::StopUnconfirmed { motor: id(1) }]);
}

#[test]
fn bus_error_is_returned_to_the_next_caller() {
    let (_fleet, order, bus) = fragile();
    let is_bus_off =
        |error| matches!(error, SharedBusError::Bus(error) if *error == CanError::BusOff);
    bus.ask(id(1), ReadStatus1).unwrap();
    order.store(FAIL_ONCE, Ordering::SeqCst);
    while order.load(Ordering::SeqCst) != WORK {
        thread::yield_now();
    }
    // The thread may be about to lay the error down.
    let returned = (0..).find_map(|_| bus.ask(id(1), ReadStatus1).err()).unwrap();
    assert!(is_bus_off(returned));
    // Until it works again.
    while bus.ask(id(1), ReadStatus1).is_err() {}

    order.store(FAIL, Ordering::SeqCst);
    for _ in 0..3 {
        let returned = (0..).find_map(|_| bus.ask(id(1), ReadStatus1).err()).unwrap();
        assert!(is_bus_off(returned));
    }
    // A stop goes on trying.
    order.store(FAIL_AT_WORK, Ordering::SeqCst);
    assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
    assert_eq!(order.load(Ordering::SeqCst), WORK, "it has failed");
}

/// Each caller gets the error, also one that sets points; the events still show what became of the motors.
#[test]
fn failing_bus_returns_errors_to_callers_and_events_to_subscribers() {
    let (_fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    let mut events = bus.subscribe(100);
    order.store(FAIL, Ordering::SeqCst);
    // The one that is put before the thread has failed.
    while bus.set_point(id(1), turn(90.0)).is_ok() {
        thread::yield_now();
    }
    for _ in 0..1_000 {
        let returned = bus.set_point(id(1), turn(90.0)).unwrap_err();
        assert!(matches!(returned, SharedBusError::Bus(_)), "{returned}");
    }
    assert_eq!(events.next(), Some(Event::SetPointDropped { motor: id(1) }));
    order.store(WORK, Ordering::SeqCst);
    while bus.set_point(id(1), turn(90.0)).is_err() {
        thread::yield_now();
    }
    assert!(events.any(|event| matches!(event, Event::Feedback { .. })));
}

#[test]
fn subscriber_with_a_weak_handle_sees_the_end_of_the_bus() {
    let (_fleet, bus) = shared(1);
    let (events, weak) = (bus.subscribe(100), bus.downgrade());
    let watching = thread::spawn(move || {
        let upgraded = events.map(|_| weak.upgrade().is_some()).collect::<Vec<_>>();
        (upgraded, weak.upgrade().is_none())
    });
    bus.ask(id(1), ReadStatus1).unwrap();
    drop(bus);
    let (upgraded, is_over) = watching.join().unwrap();
    assert!(!upgraded.is_empty() && is_over);
}

#[test]
fn stops_of_two_buses_are_under_way_together() {
    let buses = [shared(1), shared(1)];
    for (_, bus) in &buses {
        bus.ask(id(1), turn(90.0)).unwrap();
    }
    // Nobody confirms on the first, for a second.
    let (fleet, _) = &buses[0];
    fleet.world.cut(fleet.drives[0].station());
    let log = buses[1].0.world.log();
    let [first, second] =
        [0, 1].map(|at| buses[at].1.begin_stop_all(StopKind::Hold, MotorSet::EMPTY));
    assert_eq!(first.wait().unwrap(), id(1).into());
    let stops = packets(&log).iter().filter(|packet| packet.data[0] == 0x81).count();
    // The motor has answered one command before. The log shows answers, too.
    assert_eq!(stops, 2 * 2, "it was confirmed before it was waited for");
    assert_eq!(second.wait().unwrap(), MotorSet::EMPTY);
}

#[test]
fn set_point_that_waited_for_a_blocked_bus_is_dropped() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    let (log, mut events) = (fleet.world.log(), bus.subscribe(100));
    for outcome in [WORK, FAIL_ONCE] {
        hold_up(&order);
        bus.set_point(id(1), turn(90.0)).unwrap();
        order.store(outcome, Ordering::SeqCst);
        assert_eq!(events.next(), Some(Event::SetPointDropped { motor: id(1) }));
    }
    // The error of the bus is told to somebody.
    while bus.ask(id(1), ReadStatus1).is_err() {}
    assert!(packets(&log).iter().all(|packet| packet.data[0] == 0x9A), "it would move a bus late");
    // A bus that idles takes one at once.
    bus.set_point(id(1), turn(90.0)).unwrap();
    assert!(matches!(
        events.find(|it| !matches!(it, Event::Reply { .. })),
        Some(Event::Feedback { .. })
    ));
}

/// The set-point was set before the program was suspended, and the thread of the bus had not looked at it.
#[test]
fn set_point_that_waited_through_a_suspension_is_dropped() {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let order = Arc::new(AtomicU32::new(WORK));
    let fragile = Fragile(fleet.master(), Arc::clone(&order));
    let bus = SharedBus::with_wake(fragile, || {}, StopKind::Hold);
    held_after(&bus, NOT_HELD);
    bus.ask(id(1), ReadStatus1).unwrap();
    let (log, mut events) = (fleet.world.log(), bus.subscribe(100));
    order.store(SUSPEND_IDLE, Ordering::SeqCst);
    while order.load(Ordering::SeqCst) != BLOCKED {
        thread::yield_now();
    }
    bus.set_point(id(1), turn(90.0)).unwrap();
    thread::sleep(std::time::Duration::from_millis(100));
    order.store(WORK, Ordering::SeqCst);
    assert_eq!(events.next(), Some(Event::SetPointDropped { motor: id(1) }));
    assert!(packets(&log).iter().all(|packet| packet.data[0] != 0xA2), "it moves the motor late");
}

#[test]
fn a_stop_on_a_dead_bus_is_given_up() {
    let (_fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    let mut events = bus.subscribe(100);
    order.store(FAIL, Ordering::SeqCst);
    let unconfirmed = bus.stop_all(StopKind::Hold, id(2).into()).unwrap();
    assert_eq!(unconfirmed, [id(1), id(2)].into_iter().collect());
    // Who watches hears it as soon as who has called for it.
    let unconfirmed = [1, 2].map(|motor| Event::StopUnconfirmed { motor: id(motor) });
    assert_eq!([events.next(), events.next()], unconfirmed.map(Some));
    order.store(WORK, Ordering::SeqCst);
}

#[test]
fn no_call_waits_for_ever_for_a_driver_that_does_not_return() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    let log = fleet.world.log();
    hold_up(&order);
    held_after(&bus, HELD);
    let (sender, returned) = mpsc::channel();
    // Threads that wait for ever do not end with this one.
    let asking = |call: fn(&SharedBus<CanError>) -> Option<SharedBusError<CanError>>| {
        let (bus, sender) = (bus.clone(), sender.clone());
        thread::spawn(move || sender.send(call(&bus)));
    };
    asking(|bus| bus.ask(id(1), ReadMultiTurnAngle).err());
    asking(|bus| {
        let for_ever = Patience { reply_timeout: Duration::from_secs(3_600), attempts: 1 };
        bus.ask_with(id(2), ReadMultiTurnAngle, for_ever).err()
    });
    asking(|bus| {
        // It is not told at once: the driver may come back.
        bus.set_point(id(2), turn(1.0)).unwrap();
        let again = || bus.set_point(id(2), turn(1.0)).err();
        let pause = |_: &_| thread::sleep(std::time::Duration::from_millis(10));
        (0..1_000).map(|_| again()).inspect(pause).find_map(|returned| returned)
    });
    asking(|bus| {
        let begun = std::time::Instant::now();
        let returned = bus.ask_together([1; 8].map(|motor| (id(motor), ReadMultiTurnAngle)));
        // As one: each by itself would take a second.
        assert!(begun.elapsed() < 8 * HELD);
        returned.into_iter().map(|outcome| outcome.err()).reduce(|one, other| one.and(other))?
    });
    assert_eq!(bus.stop(id(1), StopKind::Hold).unwrap(), id(1).into());
    for _ in 0..4 {
        let returned = returned.recv_timeout(NOT_HELD).expect("an answer");
        assert!(matches!(returned, Some(SharedBusError::Held)), "{returned:?}");
    }
    held_after(&bus, NOT_HELD);
    order.store(WORK, Ordering::SeqCst);
    assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
    // What nobody waits for any more is not sent then.
    assert!(packets(&log).iter().all(|packet| packet.data[0] != 0x92));
}

/// Ten degrees on.
const STEP: IncrementalPosition =
    IncrementalPosition { max_speed: MaxSpeed::from_raw(90), angle: Angle::from_raw(1_000) };

#[test]
fn move_given_up_by_its_caller_is_not_sent_when_the_driver_returns() {
    for outcome in [WORK, FAIL_ONCE] {
        let (fleet, order, bus) = fragile();
        bus.ask(id(1), ReadStatus1).unwrap();
        let (log, events) = (fleet.world.log(), bus.subscribe(100));
        // The master has it by then, and has not sent it.
        order.store(BLOCK_AT_WORK, Ordering::SeqCst);
        held_after(&bus, HELD);
        let returned = bus.ask(id(1), STEP).unwrap_err();
        assert!(matches!(returned, SharedBusError::Held), "{returned}");
        held_after(&bus, NOT_HELD);
        order.store(outcome, Ordering::SeqCst);
        while bus.ask(id(1), ReadStatus1).is_err() {}
        assert!(packets(&log).iter().all(|packet| packet.data[0] == 0x9A));
        let dropped = if outcome == WORK { Failure::Dropped } else { Failure::BusDown };
        let is_dropped =
            |event| matches!(event, Event::Failed { failure, .. } if failure == dropped);
        assert!(std::iter::from_fn(|| events.try_next()).any(is_dropped), "it was the master's");
    }
}

/// Asks the motor the same twice: it is busy with the first until the program is suspended. Returns the outcome of the
/// second, and the command bytes on the wire.
fn second_after_a_suspension<C>(command: C) -> (Result<C::Reply, SharedBusError<CanError>>, Vec<u8>)
where
    C: Command<Reply: Debug + Send> + Copy + Send + 'static,
{
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    let log = fleet.world.log();
    hold_up(&order);
    let asking = thread::spawn({
        let bus = bus.clone();
        move || bus.ask_together([(id(1), command); 2])
    });
    while bus.desk().lock().questions.len() < 2 {
        thread::yield_now();
    }
    order.store(SUSPEND_AFTER_REPLY, Ordering::SeqCst);
    let [first, second] = asking.join().unwrap();
    assert!(first.is_ok(), "{first:?}");
    (second, packets(&log).iter().map(|packet| packet.data[0]).collect())
}

#[test]
fn move_whose_turn_comes_after_a_suspension_is_not_sent() {
    let (second, sent) = second_after_a_suspension(STEP);
    tells(&second.unwrap_err(), 1, RequestError::Busy);
    assert_eq!(sent, [0xA8; 2], "one move and its answer");
}

/// The motor is to be off, however late it hears that.
#[test]
fn shutdown_whose_turn_comes_after_a_suspension_is_sent() {
    let (second, sent) = second_after_a_suspension(Shutdown);
    assert!(second.is_ok(), "{second:?}");
    assert_eq!(sent, [0x80; 4], "two commands and their answers");
}

#[test]
fn move_that_returned_a_bus_error_is_not_sent_later() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    let log = fleet.world.log();
    order.store(BLOCK_AT_WORK, Ordering::SeqCst);
    let asking = thread::spawn({
        let bus = bus.clone();
        move || bus.ask(id(1), STEP)
    });
    while order.load(Ordering::SeqCst) != BLOCKED {
        thread::yield_now();
    }
    order.store(FAIL_ONCE, Ordering::SeqCst);
    let returned = asking.join().unwrap().unwrap_err();
    assert!(matches!(returned, SharedBusError::Bus(_)), "{returned}");
    while bus.ask(id(1), ReadStatus1).is_err() {}
    assert!(packets(&log).iter().all(|packet| packet.data[0] == 0x9A));
}

#[test]
fn driver_error_is_introduced_once_in_its_text() {
    let returned = || SharedBusError::Bus(Arc::new(CanError::BusOff));
    assert_eq!(returned().to_string(), "the bus reports an error: BusOff");
    assert_eq!(CallError::Bus(returned()).to_string(), "the bus reports an error: BusOff");
}

#[test]
fn long_reply_timeout_is_not_reported_as_a_held_driver() {
    // It idles until the time is up, which is longer than a round may take, unless it is woken.
    let (fleet, bus) = shared(1);
    held_after(&bus, HELD);
    fleet.world.cut(fleet.drives[0].station());
    let patience = Patience { reply_timeout: Duration::from_millis(1_200), attempts: 1 };
    let returned = bus.ask_with(id(1), ReadMultiTurnAngle, patience).unwrap_err();
    tells(&returned, 1, Failure::NoReply);
    fleet.world.mend(fleet.drives[0].station());
}

#[test]
fn guarded_buses_are_stopped_without_waiting_for_one_another() {
    let (_first, order, held) = fragile();
    let (second, _, bus) = fragile();
    for bus in [&held, &bus] {
        bus.ask(id(1), turn(90.0)).unwrap();
    }
    let log = second.world.log();
    hold_up(&order);
    let leaving = thread::spawn(move || drop(Guards::new([held, bus], [StopKind::Hold; 2])));
    let begun = std::time::Instant::now();
    while !packets(&log).iter().any(|packet| packet.data[0] == 0x81) {
        // Whoever waits for the first does so for all that time.
        assert!(begun.elapsed() < NOT_HELD, "the second is not stopped");
        thread::yield_now();
    }
    order.store(WORK, Ordering::SeqCst);
    leaving.join().unwrap();
}

#[test]
fn guards_stop_each_bus_in_its_own_way() {
    let (fleets, buses): (Vec<_>, Vec<_>) = [shared(1), shared(1)].into_iter().unzip();
    for bus in &buses {
        bus.ask(id(1), turn(90.0)).unwrap();
    }
    let [arm, hand] = [0, 1].map(|at: usize| buses[at].clone());
    for stopped in Guards::new([arm, hand], [StopKind::Hold, StopKind::Off]).finish() {
        assert!(stopped.unwrap().is_empty());
    }
    let is_on = |fleet: &CanFleet| fleet.drives[0].with(|drive| drive.state().output_on);
    assert!(is_on(&fleets[0]) && !is_on(&fleets[1]));
}

#[test]
fn motors_of_one_bus_are_asked_while_guards_wait_for_another() {
    let (first, second) = (shared(1), shared(1));
    for (_, bus) in [&first, &second] {
        bus.protect(id(1), Milliseconds::from_raw(300)).unwrap();
        bus.ask(id(1), turn(0.0)).unwrap();
    }
    let [(cut, cut_bus), (whole, bus)] = [first, second];
    cut.world.cut(cut.drives[0].station());
    let begun = std::time::Instant::now();
    let unconfirmed = Guards::new([cut_bus, bus.clone()], [StopKind::Hold; 2]).finish();
    assert_eq!(unconfirmed.map(Result::unwrap), [id(1).into(), MotorSet::EMPTY]);
    // As long as a stop that is not confirmed is tried.
    assert!(begun.elapsed() > std::time::Duration::from_millis(400), "too soon to show anything");
    let state = whole.drives[0].with(|drive| drive.state());
    assert!(state.output_on && !state.communication_lost, "{state:?}");
}

#[test]
fn guard_with_the_last_handle_reports_a_driver_that_does_not_return() {
    let (_fleet, order, bus) = fragile();
    hold_up(&order);
    held_after(&bus, HELD);
    assert_eq!(Guard::new(bus, StopKind::Hold).finish().unwrap(), MotorSet::ALL);
    // It was held all the while.
    assert_eq!(order.swap(WORK, Ordering::SeqCst), BLOCKED);
}

#[test]
fn guard_with_the_last_handle_stops_a_dead_motor_once() {
    let (fleet, bus) = shared(2);
    bus.ask(id(1), turn(90.0)).unwrap();
    // The other one goes on acknowledging frames.
    fleet.world.cut(fleet.drives[0].station());
    let log = fleet.world.log();
    assert_eq!(Guard::new(bus, StopKind::Hold).finish().unwrap(), id(1).into());
    let stops = packets(&log).into_iter().filter(|packet| packet.data[0] == 0x81).count();
    // As often as one stop is sent.
    assert_eq!(stops, 15);
}

/// Nobody knows that the motor may turn: the stop was begun, and dropped before or after it was over.
#[test]
fn last_handle_stops_all_again_if_nobody_has_waited_for_the_stop() {
    for is_kept in [false, true] {
        let (fleet, bus) = shared(2);
        bus.ask(id(1), turn(90.0)).unwrap();
        let mut events = bus.subscribe(10_000);
        // The other one goes on acknowledging frames.
        fleet.world.cut(fleet.drives[0].station());
        let stop = Some(bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY)).filter(|_| is_kept);
        assert!(events.any(|event| matches!(event, Event::StopUnconfirmed { .. })));
        // In the round after that event the thread of the bus has answered.
        thread::sleep(time::Duration::from_millis(20));
        drop(stop);
        fleet.world.mend(fleet.drives[0].station());
        drop(bus);
        fleet.world.run_for(Duration::from_millis(100));
        let angle = || fleet.drives[0].with(|drive| drive.state()).angle_deg;
        let stopped_at = angle();
        fleet.world.run_for(Duration::from_millis(100));
        assert!((angle() - stopped_at).abs() < 0.01, "it turns; kept: {is_kept}");
    }
}

#[test]
fn last_handle_stops_all_after_a_stop_of_one() {
    let (fleet, bus) = shared(2);
    for motor in [1, 2] {
        bus.ask(id(motor), turn(90.0)).unwrap();
    }
    assert!(bus.stop(id(1), StopKind::Hold).unwrap().is_empty());
    let log = fleet.world.log();
    drop(bus);
    let stopped = Channel::Reply(id(2));
    assert!(packets(&log).iter().any(|it| it.channel == stopped && it.data[0] == 0x81));
}

/// The thread of the bus takes up the stop, its end and a set-point at the same time.
#[test]
fn last_handle_stops_what_was_moved_before_the_stop_was_over() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), turn(90.0)).unwrap();
    hold_up(&order);
    let stop = bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY);
    bus.lift_stop().unwrap();
    bus.set_point(id(1), turn(90.0)).unwrap();
    order.store(WORK, Ordering::SeqCst);
    assert_eq!(stop.wait().unwrap(), MotorSet::EMPTY);
    let log = fleet.world.log();
    drop(bus);
    assert_eq!(packets(&log).last().map(|packet| packet.data[0]), Some(0x81));
}

/// The motor was not among those that were stopped, or may have restarted since.
#[test]
fn last_handle_stops_all_again_if_anything_was_asked_since() {
    let (fleet, bus) = shared(2);
    bus.ask(id(1), ReadStatus1).unwrap();
    assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty());
    bus.ask(id(2), ReadStatus1).unwrap();
    let log = fleet.world.log();
    drop(bus);
    let stops = packets(&log).into_iter().filter(|packet| packet.data[0] == 0x81);
    let stopped = stops.filter(|packet| matches!(packet.channel, Channel::Reply(_))).count();
    assert_eq!(stopped, 1 + 2, "motor 2 has answered one command before");
}

/// Its caller has told them to hold. The bus is to switch them off at its end.
#[test]
fn last_handle_stops_all_in_its_own_way_after_another_stop() {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let bus = SharedBus::new(fleet.master::<8>(), StopKind::Off);
    bus.ask(id(1), turn(90.0)).unwrap();
    assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty());
    drop(bus);
    assert!(!fleet.drives[0].with(|drive| drive.state()).output_on);
}

/// A motor may have restarted since, or another program may have moved it.
#[test]
fn last_handle_stops_all_again_if_the_last_stop_is_a_second_ago() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty());
    let log = fleet.world.log();
    // Each takes 100 ms of the bus's time.
    for _ in 0..10 {
        hold_up(&order);
        order.store(WORK, Ordering::SeqCst);
    }
    drop(bus);
    let stops = packets(&log).iter().filter(|packet| packet.data[0] == 0x81).count();
    assert_eq!(stops, 6, "after the silence it has to confirm the stop three times");
}

/// The thread of the bus sees the stop and the end at the same time.
#[test]
fn stop_that_was_only_begun_is_sent_although_the_last_handle_has_gone() {
    let (fleet, order, bus) = fragile();
    bus.ask(id(1), turn(90.0)).unwrap();
    let log = fleet.world.log();
    hold_up(&order);
    let stop = bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY);
    let weak = bus.downgrade();
    let dropping = thread::spawn(move || drop(bus));
    while weak.upgrade().is_some() {
        thread::yield_now();
    }
    order.store(WORK, Ordering::SeqCst);
    assert_eq!(stop.wait().unwrap(), MotorSet::EMPTY);
    dropping.join().unwrap();
    assert!(packets(&log).iter().any(|packet| packet.data[0] == 0x81));
}

/// The motor does not hear them; the other one acknowledges the frames.
#[test]
fn question_is_sent_as_often_as_its_patience_says() {
    let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
    let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
    fleet.world.cut(fleet.drives[0].station());
    let log = fleet.world.log();
    for attempts in [1, 2, 5] {
        let patience = Patience { reply_timeout: Duration::from_millis(5), attempts };
        let returned = bus.ask_with(id(1), ReadStatus1, patience).unwrap_err();
        tells(&returned, 1, Failure::NoReply);
        assert_eq!(packets(&log).len(), usize::from(attempts));
    }
}

#[test]
fn question_after_a_stop_on_a_dead_bus_is_refused_in_time() {
    let (_fleet, order, bus) = fragile();
    bus.ask(id(1), ReadStatus1).unwrap();
    order.store(REFUSE, Ordering::SeqCst);
    let unconfirmed = bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
    assert_eq!(unconfirmed, id(1).into());
    let returned = bus.ask(id(1), ReadStatus1).unwrap_err();
    tells(&returned, 1, RequestError::Busy);
    order.store(WORK, Ordering::SeqCst);
}

#[test]
fn panic_of_the_bus_stops_the_motors_and_is_returned() {
    let (fleet, order, bus) = fragile();
    let log = fleet.world.log();
    bus.ask(id(1), turn(90.0)).unwrap();
    let mut events = bus.subscribe(100);
    order.store(PANIC_ONCE, Ordering::SeqCst);
    let returned = (0..).find_map(|_| bus.ask(id(1), ReadStatus1).err()).unwrap();
    assert!(
        matches!(returned, SharedBusError::Panicked(words) if &*words == "the adapter is on fire")
    );
    assert!(matches!(bus.set_point(id(1), turn(1.0)), Err(SharedBusError::Panicked(_))));
    assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).is_err());
    assert_eq!(events.by_ref().filter(|event| !matches!(event, Event::Reply { .. })).count(), 0);
    drop(bus);
    assert_eq!(packets(&log).last().map(|packet| packet.data[0]), Some(0x81));
}

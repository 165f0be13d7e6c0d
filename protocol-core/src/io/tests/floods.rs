//! Buses that always have something to say, and controllers that take nothing for a while.

use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::iter::Cycle;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::Wake;
use std::vec::{IntoIter, Vec};

use embedded_can::nb;

use super::world::{Broken, TestClock, block_on, on_can, on_rs485, polls};
use super::{id, step};
use crate::command::ReadMultiTurnAngle;
use crate::io::{
    AsyncCan, AsyncCanMaster, AsyncRunner, AsyncSerialMaster, CanMaster, Runner, SerialMaster,
};
use crate::master::{Config, Event, StopKind};
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::wire::can::{self, SimpleFrame};
use crate::wire::rs485::Frame;

/// A frame that nobody asked for: a motor's status, or something that is no motor's.
fn babble(is_event: bool) -> Packet {
    let data = [if is_event { 0x9A } else { 0x33 }, 30, 30, 0, 0xE5, 0x01, 0, 0];
    let channel = if is_event { Channel::Reply(id(1)) } else { Channel::Command(id(9).into()) };
    Packet { channel, data }
}

/// A controller that always holds a frame.
#[derive(Clone, Default)]
struct Babbling {
    says: Vec<SimpleFrame>,
    sent: Rc<RefCell<Vec<SimpleFrame>>>,
    looks: Rc<Cell<usize>>,
}

impl Babbling {
    fn new(is_event: bool) -> Self {
        Self { says: can::encode(&babble(is_event)).into_iter().collect(), ..Self::default() }
    }
}

impl nb::Can for Babbling {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        self.sent.borrow_mut().push(*frame);
        Ok(None)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        self.looks.set(self.looks.get() + 1);
        assert!(self.looks.get() < 10_000, "it leaves nobody else a turn");
        self.says.first().copied().ok_or(::nb::Error::WouldBlock)
    }
}

impl AsyncCan for Babbling {
    type Frame = SimpleFrame;
    type Error = Broken;

    async fn transmit(&mut self, frame: &SimpleFrame) -> Result<Option<SimpleFrame>, Broken> {
        Ok(nb::Can::transmit(self, frame).unwrap_or_default())
    }

    async fn receive(&mut self) -> Result<SimpleFrame, Broken> {
        nb::Can::receive(self).map_err(|_| Broken)
    }
}

/// A line on which the same bytes come again and again, and never wait.
struct BabblingLine {
    says: Cycle<IntoIter<u8>>,
    looks: Rc<Cell<usize>>,
}

impl BabblingLine {
    fn new(says: Vec<u8>) -> Self {
        Self { says: says.into_iter().cycle(), looks: Rc::default() }
    }
}

impl embedded_io::ErrorType for BabblingLine {
    type Error = Broken;
}

impl embedded_io_async::Read for BabblingLine {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Broken> {
        self.looks.set(self.looks.get() + 1);
        assert!(self.looks.get() < 10_000, "it leaves nobody else a turn");
        buf.iter_mut().zip(&mut self.says).for_each(|(place, byte)| *place = byte);
        Ok(buf.len())
    }
}

impl embedded_io_async::Write for BabblingLine {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Broken> {
        Ok(buf.len())
    }

    async fn flush(&mut self) -> Result<(), Broken> {
        Ok(())
    }
}

/// How many rounds it takes until the stop has left.
const ROUNDS: usize = 65;

#[test]
fn polled_loop_sends_a_stop_though_a_frame_waits_at_every_look() {
    let bus = Babbling::new(true);
    let mut arm = CanMaster::<_, _, 4>::new(bus.clone(), TestClock::default(), Config::CAN);
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    for _ in 0..ROUNDS {
        assert!(bus.sent.borrow().is_empty());
        assert!(arm.poll().is_ok());
    }
    assert_eq!(bus.sent.borrow().len(), 1);

    let (port, clock, mut arm) = on_rs485(SerialMaster::<_, _, 4>::new);
    let line = Frame::from_packet(&babble(true)).unwrap().encode();
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    (0..3 * ROUNDS).for_each(|_| port.hear(&line));
    for _ in 0..3 * ROUNDS {
        assert!(arm.poll().is_ok());
        clock.advance(1_000);
    }
    assert!(!port.written().is_empty(), "it need not hear all of it first");
}

#[test]
fn async_loop_sends_a_stop_though_a_frame_waits_at_every_look() {
    let bus = Babbling::new(true);
    let mut arm = AsyncCanMaster::<_, _, 4>::new(bus.clone(), TestClock::default(), Config::CAN);
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    for _ in 0..ROUNDS {
        assert!(bus.sent.borrow().is_empty());
        // The last of them leaves other tasks a turn.
        let _ = polls(arm.next_event(), 1);
    }
    assert_eq!(bus.sent.borrow().len(), 1);

    let (port, clock, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    let line = Frame::from_packet(&babble(true)).unwrap().encode();
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    (0..3 * ROUNDS).for_each(|_| port.hear(&line));
    for _ in 0..3 * ROUNDS {
        assert!(block_on(arm.run(Some(Instant::ZERO))).is_ok());
        clock.advance(1_000);
    }
    assert!(!port.written().is_empty(), "it need not hear all of it first");
}

#[test]
fn a_bus_that_babbles_leaves_other_tasks_their_turns() {
    for is_event in [true, false] {
        let bus = Babbling::new(is_event);
        let mut arm =
            AsyncCanMaster::<_, _, 4>::new(bus.clone(), TestClock::default(), Config::CAN);
        // Motor 2 never answers.
        let asked = polls(arm.ask(id(2), ReadMultiTurnAngle), 100);
        assert!(asked.is_none(), "{asked:?}");
        assert!(bus.looks.get() >= 100, "and it is looked at all the time");
    }
    // Reports of motor 1, and noise.
    let report = Frame::from_packet(&babble(true)).unwrap().encode();
    for says in [report.to_vec(), std::vec![0x55]] {
        let (line, config) = (BabblingLine::new(says), Config::rs485(115_200, false));
        let looks = line.looks.clone();
        let mut arm = AsyncSerialMaster::<_, _, 4>::new(line, TestClock::default(), config);
        let asked = polls(arm.ask(id(2), ReadMultiTurnAngle), 100);
        assert!(asked.is_none(), "{asked:?}");
        assert!(looks.get() >= 100, "and it is looked at all the time");
    }
}

#[test]
fn call_out_of_time_hears_only_what_has_come() {
    let bus = Babbling::new(true);
    let mut arm = CanMaster::<_, _, 4>::new(bus.clone(), TestClock::default(), Config::CAN);
    let mut reported = 0;
    arm.run_until(Instant::ZERO, |_| reported += 1).unwrap();
    assert_eq!(reported, ROUNDS - 1, "after as many looks it is sent to");

    // Nothing has come.
    let bus = Babbling::default();
    let mut arm = CanMaster::<_, _, 4>::new(bus.clone(), TestClock::default(), Config::CAN);
    arm.run_until(Instant::ZERO, |_| {}).unwrap();
    assert_eq!(bus.looks.get(), 1);
}

#[test]
fn frames_at_every_look_do_not_hide_that_an_answer_is_missing() {
    let (bus, clock) = (Babbling::new(true), TestClock::default());
    let mut arm = CanMaster::<_, _, 4>::new(bus, clock.clone(), Config::CAN);
    let read = arm.master().request(id(2), ReadMultiTurnAngle).unwrap();
    for _ in 0..1_000 {
        let event = arm.poll().unwrap();
        if event.and_then(|event| read.outcome(&event)).is_some() {
            return;
        }
        clock.advance(1_000);
    }
    panic!("it waits for ever");
}

#[test]
fn a_run_ends_in_time_on_a_bus_that_takes_nothing() {
    let (bus, clock, mut arm) = on_can(AsyncCanMaster::<_, _, 4>::new);
    bus.state().full_until = 100_000;
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    for end in [5_000, 40_000, 40_150] {
        assert_eq!(block_on(arm.run(Some(Instant::from_micros(end)))), Ok(None));
        assert_eq!(clock.micros(), end);
    }
}

#[test]
fn stop_is_sent_once_a_blocked_port_takes_bytes_again() {
    let (port, clock, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    for is_stalled in [false, true] {
        let stop = |arm: &mut AsyncSerialMaster<_, _, 4>| {
            arm.master().lift_stop();
            arm.master().stop(id(1), StopKind::Hold).unwrap();
        };
        stop(&mut arm);
        (port.state().stalls, port.state().takes_nothing) = (is_stalled, !is_stalled);
        let mut confirmed = pin!(arm.next_event());
        assert!(polls(confirmed.as_mut(), 2_000).is_none());
        (port.state().stalls, port.state().takes_nothing) = (false, false);
        let start = clock.micros();
        let event = block_on(confirmed);
        assert_eq!(event, Ok(Event::StopConfirmed { motor: id(1) }), "{is_stalled}");
        assert!(clock.micros() < start + 30_000, "{}", clock.micros() - start);
    }
}

/// Counts how often a task is woken.
#[derive(Default)]
struct Woken(AtomicUsize);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// A controller that is full, and wakes who has offered it something when it is not.
#[derive(Clone, Default)]
struct Full {
    waker: Rc<RefCell<Option<Waker>>>,
    sent: Rc<Cell<usize>>,
    is_full: Rc<Cell<bool>>,
}

impl AsyncCan for Full {
    type Frame = SimpleFrame;
    type Error = Broken;

    async fn transmit(&mut self, _: &SimpleFrame) -> Result<Option<SimpleFrame>, Broken> {
        poll_fn(|context| {
            if self.is_full.get() {
                *self.waker.borrow_mut() = Some(context.waker().clone());
                return Poll::Pending;
            }
            self.sent.set(self.sent.get() + 1);
            Poll::Ready(Ok(None))
        })
        .await
    }

    async fn receive(&mut self) -> Result<SimpleFrame, Broken> {
        core::future::pending().await
    }
}

/// A clock that stands still.
struct Still;

impl crate::io::Clock for Still {
    fn now(&self) -> Instant {
        Instant::ZERO
    }
}

impl crate::io::AsyncClock for Still {
    async fn wait_until(&mut self, until: Instant) {
        if until > Instant::ZERO {
            core::future::pending().await
        }
    }
}

#[test]
fn a_controller_that_takes_frames_again_wakes_the_task() {
    let bus = Full::default();
    bus.is_full.set(true);
    let mut arm = AsyncCanMaster::<_, _, 4>::new(bus.clone(), Still, Config::CAN);
    let _ticket = arm.master().request(id(1), step()).unwrap();
    let woken = Arc::new(Woken::default());
    let waker = Waker::from(woken.clone());
    let mut context = Context::from_waker(&waker);
    let mut run = pin!(arm.run(None));
    assert!(run.as_mut().poll(&mut context).is_pending());
    assert_eq!(woken.0.load(Ordering::Relaxed), 0, "nothing is polled for nothing");
    bus.is_full.set(false);
    bus.waker.borrow_mut().take().expect("it knows whom to wake").wake();
    assert_eq!(woken.0.load(Ordering::Relaxed), 1);
    assert!(run.as_mut().poll(&mut context).is_pending());
    assert_eq!(bus.sent.get(), 1);
}

/// Polls it once, and gives how often that wakes the task; nothing when it is done.
fn wakes<F: Future>(future: F) -> Option<usize> {
    let woken = Arc::new(Woken::default());
    let waker = Waker::from(woken.clone());
    let is_pending = pin!(future).poll(&mut Context::from_waker(&waker)).is_pending();
    is_pending.then(|| woken.0.load(Ordering::Relaxed))
}

#[test]
fn task_wakes_itself_only_for_received_frames() {
    let mut arm = AsyncCanMaster::<_, _, 4>::new(Babbling::new(false), Still, Config::CAN);
    assert_eq!(wakes(arm.run(None)), Some(1), "it holds a frame already");
    let mut arm = AsyncCanMaster::<_, _, 4>::new(Full::default(), Still, Config::CAN);
    assert_eq!(wakes(arm.run(None)), Some(0), "there is nothing to do");
    let (_, _, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    assert_eq!(wakes(arm.run(None)), Some(0));
}

#[test]
fn a_port_that_was_closed_is_heard_when_it_is_open_again() {
    let (port, _, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    port.state().closed = true;
    let mut event = pin!(arm.run(None));
    assert!(polls(event.as_mut(), 100).is_none());
    port.state().closed = false;
    port.hear(&Frame::from_packet(&babble(true)).unwrap().encode());
    assert!(matches!(block_on(event), Ok(Some(_))));
}

#[test]
fn noise_on_the_line_of_a_task_is_counted() {
    let (port, clock, mut arm) = on_rs485(AsyncSerialMaster::<_, _, 4>::new);
    for count in 1..=2 {
        port.hear(&[0x55]);
        let until = Instant::from_micros(clock.micros()) + Duration::from_millis(1);
        assert_eq!(block_on(arm.run(Some(until))), Ok(None::<Event>));
        assert_eq!(arm.garbled(), count);
    }
}

/// A controller with one place, for the newest frame: it hands the one before back, whichever is more urgent.
#[derive(Default)]
struct Swapping {
    held: Option<SimpleFrame>,
    taken: usize,
}

impl nb::Can for Swapping {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        self.taken += 1;
        assert!(self.taken < 10_000, "one look at it never ends");
        Ok(self.held.replace(*frame))
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        Err(::nb::Error::WouldBlock)
    }
}

impl AsyncCan for Swapping {
    type Frame = SimpleFrame;
    type Error = Broken;

    async fn transmit(&mut self, frame: &SimpleFrame) -> Result<Option<SimpleFrame>, Broken> {
        Ok(nb::Can::transmit(self, frame).unwrap_or_default())
    }

    async fn receive(&mut self) -> Result<SimpleFrame, Broken> {
        core::future::pending().await
    }
}

#[test]
fn loop_leaves_a_controller_that_hands_back_a_frame_for_each_it_takes() {
    let clock = TestClock::default();
    let mut arm = CanMaster::<_, _, 4>::new(Swapping::default(), clock.clone(), Config::CAN);
    [1, 2].into_iter().for_each(|motor| arm.master().stop(id(motor), StopKind::Hold).unwrap());
    assert_eq!(arm.poll(), Ok(None));
    let mut arm = AsyncCanMaster::<_, _, 4>::new(Swapping::default(), clock, Config::CAN);
    [1, 2].into_iter().for_each(|motor| arm.master().stop(id(motor), StopKind::Hold).unwrap());
    assert_eq!(block_on(arm.run(Some(Instant::ZERO))), Ok(None));
}

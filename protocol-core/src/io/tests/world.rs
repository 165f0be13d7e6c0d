//! A clock, a CAN controller and a serial port of memory, with drives that answer.

use core::cell::{Cell, RefCell, RefMut};
use core::future::{Future, poll_fn};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::collections::VecDeque;
use std::rc::Rc;
use std::vec::Vec;

use embedded_can::{Frame as _, nb};

use crate::Data;
use crate::command::ReadRunTime;
use crate::id::Target;
use crate::io::{AsyncClock, Clock};
use crate::master::Config;
use crate::packet::{Channel, Packet};
use crate::time::Instant;
use crate::wire::can::{self, Received, SimpleFrame};
use crate::wire::rs485::{Fed, Frame, Receiver};

/// How far a wait moves the clock at once.
const STEP: u64 = 50;
/// How long a drive takes to answer.
const RESPONSE: u64 = 800;

/// A loop that idles this often in a row without letting the time go on spins.
const MOST_IDLES: u32 = 1_000;

#[derive(Clone, Debug, Default)]
pub(super) struct TestClock {
    micros: Rc<Cell<u64>>,
    idles: Rc<Cell<u32>>,
}

impl TestClock {
    pub(super) fn micros(&self) -> u64 {
        self.micros.get()
    }

    pub(super) fn advance(&self, micros: u64) {
        self.micros.set(self.micros() + micros);
    }

    fn step_towards(&self, until: Instant) {
        self.advance(STEP.min(until.as_micros().saturating_sub(self.micros())));
    }
}

impl Clock for TestClock {
    fn now(&self) -> Instant {
        Instant::from_micros(self.micros())
    }

    fn idle(&self, until: Instant) {
        self.idles.set(if until > self.now() { 0 } else { self.idles.get() + 1 });
        assert!(self.idles.get() < MOST_IDLES, "the loop spins");
        self.step_towards(until);
    }
}

impl AsyncClock for TestClock {
    async fn wait_until(&mut self, until: Instant) {
        poll_fn(|_| {
            if self.now() >= until {
                return Poll::Ready(());
            }
            self.step_towards(until);
            Poll::Pending
        })
        .await;
    }
}

/// A CAN bus, its clock and a loop on it.
pub(super) fn on_can<L>(
    new: impl FnOnce(TestCan, TestClock, Config) -> L,
) -> (TestCan, TestClock, L) {
    let clock = TestClock::default();
    let bus = TestCan::new(&clock);
    (bus.clone(), clock.clone(), new(bus, clock, Config::CAN))
}

/// A serial port, its clock and a loop on it.
pub(super) fn on_rs485<L>(
    new: impl FnOnce(TestSerial, TestClock, Config) -> L,
) -> (TestSerial, TestClock, L) {
    let clock = TestClock::default();
    let port = TestSerial::new(&clock);
    (port.clone(), clock.clone(), new(port, clock, Config::rs485(115_200, false)))
}

/// Polls a future until it is done.
pub(super) fn block_on<F: Future>(future: F) -> F::Output {
    polls(future, 1_000_000).expect("done some time")
}

/// Polls a future so many times and drops it.
pub(super) fn polls<F: Future>(future: F, most: usize) -> Option<F::Output> {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    for _ in 0..most {
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return Some(output);
        }
    }
    None
}

/// What motors 1 to 3 answer; motor 3 turns, and motor 9 is not there.
pub(super) fn answer(command: &Packet) -> Option<Packet> {
    let d = command.data;
    let motor = match command.channel {
        Channel::Command(Target::Motor(motor)) if motor.get() <= 3 => motor,
        _ => return None,
    };
    let data = match d[0] {
        0x92 => [0x92, 0, 0, 0, 0xA0, 0x8C, 0, 0], // 360 degrees
        0x30 => [0x30, d[1], 0, 0, 0, 0, 0x80, 0x3F], // 1.0
        0x76 => return None,                       // reset
        0x80 | 0x81 => d,                          // echoes
        0xB1 => [0xB1, 0, 0, 0, 1, 0, 0, 0],       // it has just started
        0x9A => [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0], // 48.5 V, no errors
        0x9C if motor.get() < 3 => [0x9C, 0x32, 0x64, 0, 0, 0, 0x2D, 0x00], // it stands
        byte => [byte, 0x32, 0x64, 0, 0xF4, 0x01, 0x2D, 0x00], // 50 °C, 1 A, 500 dps, 45 degrees
    };
    Some(Packet { channel: Channel::Reply(motor), data })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Broken;

#[derive(Debug, Default)]
pub(super) struct CanState {
    /// When, in microseconds, and what.
    sent: Vec<(u64, SimpleFrame)>,
    replies: VecDeque<(u64, SimpleFrame)>,
    /// Up to when the controller takes nothing.
    pub(super) full_until: u64,
    pub(super) transmit_fails: bool,
    pub(super) receive_fails: bool,
}

/// A CAN bus; its clones are the same bus.
#[derive(Clone, Debug, Default)]
pub(super) struct TestCan {
    state: Rc<RefCell<CanState>>,
    clock: TestClock,
}

impl TestCan {
    pub(super) fn new(clock: &TestClock) -> Self {
        Self { clock: clock.clone(), ..Self::default() }
    }

    pub(super) fn state(&self) -> RefMut<'_, CanState> {
        self.state.borrow_mut()
    }

    /// Somebody says this.
    pub(super) fn hear(&self, packet: &Packet) {
        self.hear_at(self.clock.micros(), packet);
    }

    /// Somebody says this then.
    pub(super) fn hear_at(&self, micros: u64, packet: &Packet) {
        self.state().replies.push_back((micros, can::encode(packet).unwrap()));
    }

    pub(super) fn sent(&self) -> Vec<Data> {
        let state = self.state.borrow();
        state.sent.iter().map(|(_, frame)| frame.data().try_into().unwrap()).collect()
    }

    /// When this was first sent.
    pub(super) fn sent_at(&self, data: Data) -> Instant {
        let state = self.state.borrow();
        let (at, _) = state.sent.iter().find(|(_, frame)| frame.data() == data).unwrap();
        Instant::from_micros(*at)
    }

    /// The same without the questions that keep motors holding.
    pub(super) fn commands(&self) -> Vec<Data> {
        self.sent().into_iter().filter(is_command).collect()
    }
}

/// Whether this is not one of the questions that keep motors from letting go while another is waited for.
fn is_command(data: &Data) -> bool {
    *data != ReadRunTime.encode()
}

impl embedded_can::Error for Broken {
    fn kind(&self) -> embedded_can::ErrorKind {
        embedded_can::ErrorKind::Other
    }
}

impl nb::Can for TestCan {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        let mut state = self.state.borrow_mut();
        if state.transmit_fails {
            return Err(::nb::Error::Other(Broken));
        }
        if self.clock.micros() < state.full_until {
            return Err(::nb::Error::WouldBlock);
        }
        state.sent.push((self.clock.micros(), *frame));
        if let Received::Packet(command) = can::decode(frame)
            && let Some(reply) = answer(&command)
        {
            state.replies.push_back((self.clock.micros() + RESPONSE, can::encode(&reply).unwrap()));
        }
        Ok(None)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        let mut state = self.state.borrow_mut();
        if state.receive_fails {
            return Err(::nb::Error::Other(Broken));
        }
        let now = self.clock.micros();
        let reply = state.replies.pop_front_if(|&mut (at, _)| at <= now);
        reply.map(|(_, frame)| frame).ok_or(::nb::Error::WouldBlock)
    }
}

/// What a driver that polls says, for one that waits.
pub(super) fn pending<T, E>(result: ::nb::Result<T, E>) -> Poll<Result<T, E>> {
    match result {
        Ok(value) => Poll::Ready(Ok(value)),
        Err(::nb::Error::WouldBlock) => Poll::Pending,
        Err(::nb::Error::Other(error)) => Poll::Ready(Err(error)),
    }
}

/// Has a controller that is polled be awaited, too.
macro_rules! awaited {
    ([$($generics:tt)*] $can:ty) => {
        impl<$($generics)*> $crate::io::AsyncCan for $can {
            type Frame = SimpleFrame;
            type Error = <Self as embedded_can::nb::Can>::Error;

            async fn transmit(
                &mut self,
                frame: &SimpleFrame,
            ) -> Result<Option<SimpleFrame>, Self::Error> {
                core::future::poll_fn(|_| pending(embedded_can::nb::Can::transmit(self, frame))).await
            }

            async fn receive(&mut self) -> Result<SimpleFrame, Self::Error> {
                core::future::poll_fn(|_| pending(embedded_can::nb::Can::receive(self))).await
            }
        }
    };
}

pub(super) use awaited;

awaited! { [] TestCan }

#[derive(Debug, Default)]
pub(super) struct SerialState {
    /// What was written, and how much of it `flush` has seen out.
    written: Vec<u8>,
    flushed: usize,
    to_read: VecDeque<(u64, u8)>,
    receiver: Receiver,
    /// The most bytes that one call of `read` or `write` moves; 0 for no limit.
    pub(super) at_most: usize,
    pub(super) write_fails: bool,
    /// It fails once it has taken so many bytes.
    pub(super) fails_after: Option<usize>,
    pub(super) takes_nothing: bool,
    pub(super) flush_fails: bool,
    pub(super) read_fails: bool,
    /// It reports an error at each look that finds nothing.
    pub(super) complains: bool,
    /// Whether the adapter hands back what is written.
    pub(super) echoes: bool,
    /// It hands over what it received at multiples of so many microseconds; 0 for at once.
    pub(super) hands_over_every: u64,
    /// Nothing that is written reaches anybody, not even the adapter.
    pub(super) is_cut: bool,
    pub(super) closed: bool,
    /// Whether `write` waits for ever.
    pub(super) stalls: bool,
    /// Whether `flush` does.
    pub(super) flush_stalls: bool,
    /// How long `flush` takes until the last byte has left, in microseconds.
    pub(super) flush_takes: u64,
}

impl SerialState {
    /// The adapter has received this then.
    fn hand_over(&mut self, micros: u64, bytes: &[u8]) {
        let at = match self.hands_over_every {
            0 => micros,
            every => (micros / every + 1) * every,
        };
        self.to_read.extend(bytes.iter().map(|&byte| (at, byte)));
    }
}

/// A serial port; its clones are the same port.
#[derive(Clone, Debug, Default)]
pub(super) struct TestSerial {
    state: Rc<RefCell<SerialState>>,
    clock: TestClock,
}

impl TestSerial {
    pub(super) fn new(clock: &TestClock) -> Self {
        Self { clock: clock.clone(), ..Self::default() }
    }

    pub(super) fn state(&self) -> RefMut<'_, SerialState> {
        self.state.borrow_mut()
    }

    pub(super) fn hear(&self, bytes: &[u8]) {
        let now = self.clock.micros();
        self.state.borrow_mut().to_read.extend(bytes.iter().map(|&byte| (now, byte)));
    }

    pub(super) fn written(&self) -> Vec<u8> {
        self.state.borrow().written.clone()
    }

    /// What was written, in frames of 3E, id, 08, eight bytes and a checksum of two, without the questions that keep
    /// motors holding.
    pub(super) fn commands(&self) -> Vec<Data> {
        let written = self.written();
        assert_eq!(written.len() % 13, 0, "no half of a frame");
        let commands = written.chunks(13).map(|frame| frame[3..11].try_into().unwrap());
        commands.filter(is_command).collect()
    }

    /// Nothing was written yet.
    pub(super) fn forget(&self) {
        let mut state = self.state.borrow_mut();
        state.written.clear();
        state.flushed = 0;
    }

    /// What has come and was not read is lost.
    pub(super) fn lose(&self) {
        let now = self.clock.micros();
        self.state().to_read.retain(|&(at, _)| at > now);
    }

    pub(super) fn is_flushed(&self) -> bool {
        let state = self.state.borrow();
        state.flushed == state.written.len()
    }

    pub(super) fn is_ready(&self) -> bool {
        let state = self.state.borrow();
        state.closed
            || state.read_fails
            || state.complains
            || state.to_read.front().is_some_and(|&(at, _)| at <= self.clock.micros())
    }
}

impl core::fmt::Display for Broken {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("broken")
    }
}

impl core::error::Error for Broken {}

impl embedded_io::Error for Broken {
    fn kind(&self) -> embedded_io::ErrorKind {
        embedded_io::ErrorKind::Other
    }
}

impl embedded_io::ErrorType for TestSerial {
    type Error = Broken;
}

impl embedded_io::ReadReady for TestSerial {
    fn read_ready(&mut self) -> Result<bool, Broken> {
        Ok(self.is_ready())
    }
}

impl embedded_io::Read for TestSerial {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, Broken> {
        assert!(self.is_ready(), "a blocking read would wait");
        let mut state = self.state.borrow_mut();
        if state.read_fails {
            return Err(Broken);
        }
        let limit = if state.at_most == 0 { buf.len() } else { buf.len().min(state.at_most) };
        let mut length = 0;
        while length < limit
            && let Some(&(at, byte)) = state.to_read.front()
            && at <= self.clock.micros()
        {
            buf[length] = byte;
            length += 1;
            state.to_read.pop_front();
        }
        if length == 0 && state.complains {
            return Err(Broken);
        }
        Ok(length)
    }
}

impl embedded_io::Write for TestSerial {
    fn write(&mut self, buf: &[u8]) -> Result<usize, Broken> {
        let mut state = self.state.borrow_mut();
        let has_failed = state.fails_after.is_some_and(|bytes| state.written.len() >= bytes);
        if state.write_fails || has_failed {
            return Err(Broken);
        }
        if state.takes_nothing {
            return Ok(0);
        }
        let length = if state.at_most == 0 { buf.len() } else { buf.len().min(state.at_most) };
        for &byte in &buf[..length] {
            state.written.push(byte);
            if state.is_cut {
                continue;
            }
            if state.echoes {
                state.hand_over(self.clock.micros(), &[byte]);
            }
            if let Fed::Frame(frame) = state.receiver.feed(byte)
                && let Some(reply) = answer(&frame.as_command())
            {
                let line = Frame::from_packet(&reply).unwrap().encode();
                let left_at = self.clock.micros() + state.flush_takes;
                state.hand_over(left_at + RESPONSE, &line);
            }
        }
        Ok(length)
    }

    fn flush(&mut self) -> Result<(), Broken> {
        let mut state = self.state.borrow_mut();
        if state.flush_fails {
            return Err(Broken);
        }
        self.clock.advance(state.flush_takes);
        state.flushed = state.written.len();
        Ok(())
    }
}

impl embedded_io_async::Read for TestSerial {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Broken> {
        poll_fn(|_| if self.is_ready() { Poll::Ready(()) } else { Poll::Pending }).await;
        embedded_io::Read::read(self, buf)
    }
}

/// Each call takes one poll more than it would have to, as on a bus where bytes take time.
async fn a_moment() {
    let mut first = true;
    poll_fn(|_| if core::mem::take(&mut first) { Poll::Pending } else { Poll::Ready(()) }).await;
}

impl embedded_io_async::Write for TestSerial {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Broken> {
        a_moment().await;
        poll_fn(|_| if self.state.borrow().stalls { Poll::Pending } else { Poll::Ready(()) }).await;
        embedded_io::Write::write(self, buf)
    }

    async fn flush(&mut self) -> Result<(), Broken> {
        a_moment().await;
        let stalls = || self.state.borrow().flush_stalls;
        poll_fn(|_| if stalls() { Poll::Pending } else { Poll::Ready(()) }).await;
        embedded_io::Write::flush(self)
    }
}

//! Stations of a simulated bus that send by a timetable and note what they hear.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use myactuator_host_std::sim::bus::faults::FaultPlan;
use myactuator_host_std::sim::bus::rs485::{Rs485Line, SerialPort, SerialWorld};
use myactuator_host_std::sim::bus::trace::{Event, Record};
use myactuator_host_std::sim::bus::{Node, StationId, World};
use myactuator_protocol_core::time::{Duration, Instant};

use crate::wire::Wire;

/// This many microseconds after the world began.
pub const fn micros(at: u64) -> Instant {
    Instant::from_micros(at)
}

/// The frames that a station will send, and those that it has heard.
#[derive(Debug)]
pub struct Script<F> {
    to_send: VecDeque<(u64, F)>,
    heard: Vec<(u64, F)>,
    resets: Vec<u64>,
    /// Whether it sends back the frames that it hears.
    mirrors: bool,
}

/// A handle of a script.
#[derive(Clone, Debug)]
pub struct Hand<F>(Arc<Mutex<Script<F>>>);

impl<F: Clone> Hand<F> {
    /// A script that sends each frame at its time.
    pub fn sending(timetable: impl IntoIterator<Item = (u64, F)>) -> Self {
        let to_send = timetable.into_iter().collect();
        let script = Script { to_send, heard: Vec::new(), resets: Vec::new(), mirrors: false };
        Self(Arc::new(Mutex::new(script)))
    }

    /// A script that sends nothing.
    pub fn listening() -> Self {
        Self::sending([])
    }

    /// A script that sends back the frames that it hears.
    pub fn mirroring() -> Self {
        let hand = Self::listening();
        hand.0.lock().unwrap().mirrors = true;
        hand
    }

    /// The node to attach.
    pub fn node(&self) -> Arc<Mutex<Script<F>>> {
        Arc::clone(&self.0)
    }

    /// The frames that it has heard, and when, in microseconds.
    pub fn heard(&self) -> Vec<(u64, F)> {
        self.0.lock().unwrap().heard.clone()
    }

    /// When it was reset, in microseconds.
    pub fn resets(&self) -> Vec<u64> {
        self.0.lock().unwrap().resets.clone()
    }

    /// The frames that it has heard.
    pub fn frames(&self) -> Vec<F> {
        self.heard().into_iter().map(|(_, frame)| frame).collect()
    }
}

/// A bus for scripts.
pub trait Stage {
    /// The frames of the bus.
    type Frame: Clone;

    /// Puts a script on the bus.
    fn put(&self, hand: &Hand<Self::Frame>) -> StationId;

    /// Puts a script on the bus that sends each frame at its time.
    fn sender(&self, timetable: impl IntoIterator<Item = (u64, Self::Frame)>) -> StationId {
        self.put(&Hand::sending(timetable))
    }

    /// Puts a script on the bus that only listens, and returns its handle.
    fn listener(&self) -> Hand<Self::Frame> {
        let hand = Hand::listening();
        self.put(&hand);
        hand
    }

    /// Puts a script on the bus that sends nothing, and returns its place.
    fn silent(&self) -> StationId {
        self.put(&Hand::listening())
    }

    /// Puts a script on the bus that sends back the frames that it hears.
    fn mirror(&self) -> StationId {
        self.put(&Hand::mirroring())
    }
}

impl<W: Wire> Stage for World<W> {
    type Frame = W::Frame;

    fn put(&self, hand: &Hand<W::Frame>) -> StationId {
        W::seat(self, hand.node())
    }
}

/// A line at 1 Mbit/s, on which a byte lasts 10 µs, with a master's port and a listener.
pub fn line(seed: u64) -> (SerialWorld, SerialPort, Hand<Vec<u8>>) {
    let world = Rs485Line::world(seed);
    let listener = world.listener();
    (world.clone(), world.port(), listener)
}

/// The manual's example of reading a PID gain (2.1.5).
pub const READ_PID: [u8; 13] = [0x3E, 0x01, 0x08, 0x30, 0x01, 0, 0, 0, 0, 0, 0, 0xE8, 0xDD];

/// A plan that makes every frame this much late.
pub fn late_by(delay: Duration) -> FaultPlan {
    FaultPlan { delay: 1.0, delay_min: delay, delay_max: delay, ..FaultPlan::NONE }
}

/// The records of frames that were broken on the wire.
pub fn broken<F>(records: &[Record<F>]) -> impl Iterator<Item = &Record<F>> {
    records.iter().filter(|record| matches!(record.event, Event::Broken { .. }))
}

impl<F: Clone + Send> Node<F> for Script<F> {
    fn handle_frame(&mut self, frame: &F, now: Instant) {
        self.heard.push((now.as_micros(), frame.clone()));
        if self.mirrors {
            self.to_send.push_back((now.as_micros(), frame.clone()));
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<F> {
        self.to_send.pop_front_if(|(at, _)| *at <= now.as_micros()).map(|(_, frame)| frame)
    }

    fn poll_at(&self) -> Option<Instant> {
        self.to_send.front().map(|(at, _)| Instant::from_micros(*at))
    }

    fn reset(&mut self, now: Instant) {
        self.resets.push(now.as_micros());
    }
}

//! A participant that sends by a timetable and notes what it hears.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use myactuator_host_std::bus::Node;
use myactuator_protocol_core::time::Instant;

/// What a bus carries and when, in microseconds.
pub type Timetable<F> = Vec<(u64, F)>;

/// What it will send and what it heard.
#[derive(Debug)]
pub struct Script<F> {
    to_send: VecDeque<(u64, F)>,
    heard: Timetable<F>,
    /// Whether it sends back what it hears.
    mirrors: bool,
}

/// A hand on a script that is on a bus.
#[derive(Clone, Debug)]
pub struct Hand<F>(Arc<Mutex<Script<F>>>);

impl<F: Clone> Hand<F> {
    /// One that sends each frame at its time.
    pub fn sending(timetable: impl IntoIterator<Item = (u64, F)>) -> Self {
        let to_send = timetable.into_iter().collect();
        let script = Script { to_send, heard: Vec::new(), mirrors: false };
        Self(Arc::new(Mutex::new(script)))
    }

    /// One that sends nothing.
    pub fn listening() -> Self {
        Self::sending([])
    }

    /// One that sends back what it hears.
    pub fn mirroring() -> Self {
        let hand = Self::listening();
        hand.0.lock().unwrap().mirrors = true;
        hand
    }

    /// The node to attach.
    pub fn node(&self) -> Arc<Mutex<Script<F>>> {
        Arc::clone(&self.0)
    }

    /// What it heard so far.
    pub fn heard(&self) -> Timetable<F> {
        self.0.lock().unwrap().heard.clone()
    }
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
}

//! Runs a master for a while and notes its events.

use std::fmt::Debug;

use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::Event;
use myactuator_protocol_core::time::{Duration, Instant};

/// Runs the master until `until`, and returns its events.
pub fn listen_until<R: Runner<N, Error: Debug>, const N: usize>(
    master: &mut R,
    until: Instant,
) -> Vec<Event> {
    let mut events = Vec::new();
    loop {
        match master.poll().expect("a bus without faults") {
            Some(event) => events.push(event),
            None if master.now() >= until => return events,
            None => master.idle(until),
        }
    }
}

/// As [`listen_until`], for a span from now on.
pub fn listen<R: Runner<N, Error: Debug>, const N: usize>(
    master: &mut R,
    span: Duration,
) -> Vec<Event> {
    let until = master.now() + span;
    listen_until(master, until)
}

//! What really happened on a bus.

use std::sync::{Arc, Mutex};

use super::nanos::to_instant;
use super::node::{StationId, lock};
use myactuator_protocol_core::time::Instant;

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Record<F> {
    /// When, in nanoseconds since the world's start.
    pub at_ns: u64,
    /// The station that it concerns: the sender for what is on the wire, the receiver for what reaches one.
    pub station: StationId,
    /// What happened.
    pub event: Event<F>,
}

impl<F> Record<F> {
    /// When, as the participants see it: rounded up to microseconds.
    pub const fn at(&self) -> Instant {
        to_instant(self.at_ns)
    }
}

/// What can happen on a bus.
#[derive(Clone, Debug, PartialEq)]
pub enum Event<F> {
    /// A whole frame (on RS485: a message) has been on the wire.
    Carried {
        /// The frame as it was sent.
        frame: F,
        /// When its first bit began, in nanoseconds.
        started_ns: u64,
    },
    /// A frame (on RS485: a message) went wrong on the wire: a CAN error frame ended it, or it
    /// collided on the line.
    Broken {
        /// The frame as it was meant.
        frame: F,
        /// When its first bit began, in nanoseconds.
        started_ns: u64,
    },
    /// No station acknowledged a CAN frame.
    Unacknowledged {
        /// The frame.
        frame: F,
        /// When its first bit began, in nanoseconds.
        started_ns: u64,
    },
    /// A fault struck what this station was to receive.
    Faulted {
        /// The sender.
        from: StationId,
        /// The fault.
        fault: Fault,
    },
    /// The station's receive queue was full, so the frame was lost.
    Overflowed {
        /// The frame that was lost.
        frame: F,
    },
    /// The CAN controller counted too many errors and left the bus.
    BusOff,
    /// The CAN controller is back on the bus.
    Recovered,
    /// The station's wire was cut.
    Cut,
    /// The station's wire was mended.
    Mended,
    /// The station was reset.
    Reset,
    /// From now on what the station sends reaches its controller so many nanoseconds later.
    Slowed(u64),
    /// The station begins to babble, or ends that.
    Babbles(bool),
}

/// What a fault does to a frame on its way to one receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It does not arrive.
    Lost,
    /// One of its bits arrives flipped.
    Corrupted,
    /// It arrives twice.
    Duplicated,
    /// It arrives late by so many nanoseconds.
    Delayed(u64),
    /// It arrives after the next one.
    Reordered,
}

pub(crate) type Observer<F> = Box<dyn FnMut(&Record<F>) + Send>;

/// A list of all that happens from when it is made. Clones share the list.
#[derive(Clone, Debug)]
pub struct Log<F>(pub(super) Arc<Mutex<Vec<Record<F>>>>);

impl<F> Log<F> {
    /// Returns what was noted so far, and starts anew.
    pub fn take(&self) -> Vec<Record<F>> {
        std::mem::take(&mut *lock(&self.0))
    }
}

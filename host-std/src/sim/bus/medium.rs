//! What both buses share.

use super::StationId;
use super::faults::Injector;
use super::nanos::Nanos;
use super::random::Random;
use super::trace::{Event, Observer, Record};

/// A kind of bus: [`CanBus`](super::can::CanBus) or [`Rs485Line`](super::rs485::Rs485Line). Only
/// this library can implement it.
pub trait Medium: sealed::Bus {}

/// Something complete on the wire: a CAN frame, or a byte of a message on the line.
#[derive(Debug)]
pub(crate) struct Arrival<F> {
    /// The sender, for which faults are drawn.
    pub(crate) sender: usize,
    /// The receivers, in the order of attaching.
    pub(crate) hearers: Vec<usize>,
    pub(crate) unit: F,
    /// Which message it is part of; `None` if a collision left no message.
    pub(crate) part: Option<Part<F>>,
}

/// Which part of which message.
#[derive(Debug)]
pub(crate) struct Part<F> {
    pub(crate) message: u64,
    pub(crate) index: usize,
    pub(crate) of: usize,
    /// The whole message; comes with its last part.
    pub(crate) whole: Option<F>,
}

/// What a bus uses besides itself.
#[expect(missing_debug_implementations, reason = "nobody outside can reach it")]
pub struct Surroundings<F> {
    pub(crate) now: Nanos,
    pub(crate) injector: Injector,
    /// The observers.
    pub(crate) observers: Vec<Observer<F>>,
    /// What has become complete, for the receivers.
    pub(crate) arrivals: Vec<Arrival<F>>,
    /// Stations whose queue has room again.
    pub(crate) freed: Vec<usize>,
}

impl<F> Surroundings<F> {
    /// Reports to observers what happens now. The event is made only if there are any.
    pub(crate) fn record(&mut self, station: usize, event: impl FnOnce() -> Event<F>) {
        if self.observers.is_empty() {
            return;
        }
        let record = Record { at_ns: self.now, station: StationId(station), event: event() };
        for observer in &mut self.observers {
            observer(&record);
        }
    }
}

/// Flips one bit of these bytes, if there are any. An index beyond the last wraps around.
pub(crate) fn flip_bit_of(bytes: &mut [u8], bit: u64) {
    if let Some(place) = (bit as usize).checked_rem(bytes.len() * 8) {
        bytes[place / 8] ^= 1 << (place % 8);
    }
}

pub(crate) mod sealed {
    use std::fmt;

    use super::{Nanos, Random, Surroundings};

    /// The events of a bus. Stations are counted from 0 in the order of attaching.
    pub trait Bus: fmt::Debug + Send + 'static {
        /// What it carries.
        type Frame: Clone + fmt::Debug + PartialEq + Send + 'static;
        /// How a station is attached to it.
        type Attachment: Copy;

        /// Whether corrupted bytes arrive as they are, and not as an error on the wire.
        const DELIVERS_CORRUPTED: bool;

        fn attach(&mut self, how: Self::Attachment);
        /// When something happens next on its own; `NEVER` if nothing does.
        fn next_event(&self) -> Nanos;
        /// Does what ends now.
        fn finish(&mut self, around: &mut Surroundings<Self::Frame>);
        /// Does what begins now, after every station had its turn.
        fn start(&mut self, around: &mut Surroundings<Self::Frame>);
        /// How many more frames a station can queue.
        fn room(&self, station: usize) -> usize;
        /// Takes a frame if there is room.
        fn submit(&mut self, station: usize, frame: Self::Frame, now: Nanos) -> bool;
        /// Cuts a wire that is whole, or mends one that is cut.
        fn cut(&mut self, station: usize, is_cut: bool, around: &mut Surroundings<Self::Frame>);
        /// Empties a station's controller.
        fn reset(&mut self, station: usize, around: &mut Surroundings<Self::Frame>);
        /// A station's bit rate.
        fn bit_rate(&mut self, station: usize) -> &mut u32;
        /// At another bit rate a controller starts anew.
        fn set_bit_rate(
            &mut self,
            station: usize,
            to: u32,
            around: &mut Surroundings<Self::Frame>,
        ) {
            if *self.bit_rate(station) != to {
                self.reset(station, around);
                *self.bit_rate(station) = to;
            }
        }

        fn flip_bit(frame: &mut Self::Frame, bit: u64);
        fn garbage(random: &mut Random) -> Self::Frame;
        /// The units that arrive one by one.
        fn units(frame: &Self::Frame) -> Vec<Self::Frame>;
    }
}

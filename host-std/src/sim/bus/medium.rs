//! What the two buses have in common.

use std::fmt;

use super::faults::Injector;
use super::nanos::Nanos;
use super::random::Random;
use super::trace::Trace;

/// A kind of bus: [`CanBus`](super::can::CanBus) or [`Rs485Line`](super::rs485::Rs485Line). Only
/// this library can define one.
pub trait Medium:
    sealed::Bus<Carries = <Self as Medium>::Frame, How = <Self as Medium>::Attachment>
{
    /// What it carries.
    type Frame: Clone + fmt::Debug + PartialEq + Send + 'static;
    /// How a station is attached to it.
    type Attachment;
}

/// Something complete on the wire: a CAN frame, or a byte of a message on the line.
#[derive(Debug)]
pub struct Arrival<F> {
    /// Who sent it; faults are drawn for this one.
    pub(crate) sender: usize,
    /// Who does not hear it.
    pub(crate) deaf: Vec<usize>,
    /// When it began: who joined the wire later does not hear it.
    pub(crate) started: Nanos,
    /// Where it is: on the common wire, or on a cut-off station's own.
    pub(crate) on: Wire,
    pub(crate) unit: F,
    /// Which message it is part of; `None` where collisions left nothing to tell.
    pub(crate) part: Option<Part<F>>,
}

/// Which part of which message.
#[derive(Debug)]
pub(crate) struct Part<F> {
    pub(crate) message: u64,
    pub(crate) index: usize,
    pub(crate) of: usize,
    /// The whole message, with its last part.
    pub(crate) whole: Option<F>,
}

/// Where a station is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wire {
    /// On the common wire.
    Common,
    /// Cut off, alone on its stub.
    Stub(usize),
}

/// What a bus acts on besides itself.
#[derive(Debug)]
pub struct Surroundings<F> {
    pub(crate) now: Nanos,
    pub(crate) injector: Injector,
    pub(crate) trace: Trace<F>,
    /// What has become complete, for the receivers.
    pub(crate) arrivals: Vec<Arrival<F>>,
    /// Whose queue has got room.
    pub(crate) freed: Vec<usize>,
}

pub(crate) mod sealed {
    use std::fmt;

    use super::{Arrival, Nanos, Random, Surroundings};

    /// The events of a bus. Stations are counted from 0 in the order of attaching.
    pub trait Bus: fmt::Debug + Send + 'static {
        type Carries;
        type How;

        /// Whether corrupted bytes arrive as they are, and not as an error on the wire.
        const DELIVERS_CORRUPTED: bool;

        fn attach(&mut self, how: Self::How);
        /// When something happens next by itself, `NEVER` for not at all.
        fn next_event(&self) -> Nanos;
        /// Does what ends now.
        fn finish(&mut self, around: &mut Surroundings<Self::Carries>);
        /// Does what begins now, after everyone has had their say.
        fn start(&mut self, around: &mut Surroundings<Self::Carries>);
        /// How many more frames a station can queue.
        fn room(&self, station: usize) -> usize;
        /// Takes a frame if there is room.
        fn submit(&mut self, station: usize, frame: Self::Carries, now: Nanos) -> bool;
        fn hears(&self, station: usize, arrival: &Arrival<Self::Carries>) -> bool;
        /// Cuts or mends a wire.
        fn cut(&mut self, station: usize, is_cut: bool, around: &mut Surroundings<Self::Carries>);
        /// Empties a station's controller.
        fn reset(&mut self, station: usize, around: &mut Surroundings<Self::Carries>);

        fn flip_bit(frame: &mut Self::Carries, bit: u64);
        fn garbage(random: &mut Random) -> Self::Carries;
        /// The units that arrive one by one.
        fn units(frame: &Self::Carries) -> Vec<Self::Carries>;
    }
}

//! The participants of a bus.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use myactuator_protocol_core::time::Instant;

/// One participant of a bus, with a controller of its own that queues what it sends.
///
/// `F` is what the bus carries: [`SimpleFrame`](myactuator_protocol_core::wire::can::SimpleFrame) on
/// CAN, bytes on RS485 (`Vec<u8>`: received one byte at a time, each when it is complete on the
/// line; sent in any lengths, each piece one message, because faults strike messages).
///
/// After [`handle_frame`](Self::handle_frame), at [`poll_at`](Self::poll_at) and whenever its
/// controller has room again, a node is asked with [`advance`](Self::advance) and then
/// [`poll_transmit`](Self::poll_transmit) until that returns `None` or the controller is full.
///
/// To keep access to a node, attach an `Arc<Mutex<N>>` of it. Its lock must not be held while the
/// world runs.
pub trait Node<F>: Send {
    /// Whether it takes this frame from the bus, like the acceptance filter of a controller. A frame that it does not
    /// take is not handed to it, and it is not asked after that frame. By default it takes all.
    fn accepts(&self, frame: &F) -> bool {
        let _ = frame;
        true
    }

    /// A frame received from the bus.
    fn handle_frame(&mut self, frame: &F, now: Instant);

    /// What it wants to send now.
    fn poll_transmit(&mut self, now: Instant) -> Option<F>;

    /// When to ask again; `None` for not before the next frame. A time that has passed counts as
    /// the next microsecond.
    fn poll_at(&self) -> Option<Instant>;

    /// Advances its own time to `now`. This is called before each round of
    /// [`poll_transmit`](Self::poll_transmit), also while the controller takes no more frames.
    fn advance(&mut self, now: Instant) {
        let _ = now;
    }

    /// The bit rate at which it speaks from now on, bit/s. Called after each [`advance`](Self::advance); a
    /// change [starts its controller anew](super::World::set_bit_rate). `None`, which is the default, for the
    /// rate of its station.
    fn bit_rate(&self) -> Option<u32> {
        None
    }

    /// Whether it has power; without power its controller is off the bus. Called after each [`advance`](Self::advance),
    /// for simulated drives at least every 10 ms. `true` by default.
    fn is_powered(&self) -> bool {
        true
    }

    /// Its power was cycled. By default this does nothing; the controller is emptied in any case.
    fn reset(&mut self, now: Instant) {
        let _ = now;
    }
}

/// Locks it, even if a holder of the lock has panicked.
pub(in crate::sim) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<F, N: Node<F>> Node<F> for Arc<Mutex<N>> {
    fn accepts(&self, frame: &F) -> bool {
        lock(self).accepts(frame)
    }

    fn handle_frame(&mut self, frame: &F, now: Instant) {
        lock(self).handle_frame(frame, now);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<F> {
        lock(self).poll_transmit(now)
    }

    fn poll_at(&self) -> Option<Instant> {
        lock(self).poll_at()
    }

    fn advance(&mut self, now: Instant) {
        lock(self).advance(now);
    }

    fn bit_rate(&self) -> Option<u32> {
        lock(self).bit_rate()
    }

    fn is_powered(&self) -> bool {
        lock(self).is_powered()
    }

    fn reset(&mut self, now: Instant) {
        lock(self).reset(now);
    }
}

/// A participant's place on the bus of its world, counted from 0 in the order of attaching.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StationId(pub(crate) usize);

impl StationId {
    /// The place as a number.
    pub const fn index(self) -> usize {
        self.0
    }
}

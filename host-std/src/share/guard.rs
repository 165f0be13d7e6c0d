//! A thread that leaves its control loop leaves it through the stop, also while other threads have handles.

use std::ops::Deref;
use std::{array, fmt};

use myactuator_protocol_core::master::{MotorSet, StopKind};

use super::{SharedBus, SharedBusError, Stopping};
use crate::open::BusError;

/// A handle that stops all motors of the bus when its thread leaves it: by `?`, `break`, `return`, a panic that
/// unwinds, or at its end. It is to threads what [`io::Guard`](myactuator_protocol_core::io::Guard) is to a loop, and
/// is used like the handle itself. A plain handle does not stop them: while any other thread has one, the motors go on.
///
/// It waits for the motors as long as [a stop](myactuator_protocol_core::io::longest_stop) is tried. Meanwhile the bus
/// asks those that have confirmed, so that their protection (0xB3) does not let them go. With a guard for each of two
/// buses in one thread, the second bus is stopped only after that if the first is cut. [`Guards`] stop several buses at
/// the same time.
///
/// It cannot stop the motors if its scope is never left, for example when `main` returns while it lives in another
/// thread. [What ends a shared bus](super#what-ends-it) lists the other cases.
///
/// ```
/// use myactuator_host_std::open::BusAddress;
/// use myactuator_host_std::protocol::MotorId;
/// use myactuator_host_std::protocol::master::StopKind;
/// use myactuator_host_std::share::{Guard, SharedBus};
///
/// let address: BusAddress = "sim:4".parse()?;
/// let bus = SharedBus::open(&address, StopKind::Hold)?;
/// let guard = Guard::new(bus.clone(), StopKind::Hold);
/// guard.release_brake(MotorId::MIN)?;
/// let unconfirmed = guard.finish()?;
/// assert!(unconfirmed.is_empty(), "cut the power of motors {unconfirmed}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
#[must_use = "the motors are stopped when it is dropped"]
pub struct Guard<E: fmt::Debug + Send + Sync + 'static = BusError>(Guards<1, E>);

impl<E: fmt::Debug + Send + Sync + 'static> Guard<E> {
    /// Guards what is done with this handle.
    pub const fn new(bus: SharedBus<E>, kind: StopKind) -> Self {
        Self(Guards::new([bus], [kind]))
    }

    /// Stops all motors now, as [`SharedBus::stop_all`] does, and returns those that have not confirmed it: **cut
    /// their power**.
    ///
    /// # Errors
    /// As there.
    pub fn finish(self) -> Result<MotorSet, SharedBusError<E>> {
        let [unconfirmed] = self.0.finish();
        unconfirmed
    }
}

/// Handles of several buses. When their thread leaves them, the motors of all buses are stopped, as by a [`Guard`] of
/// each bus, but at the same time: a bus that is cut holds up no other. It is used like the array of the handles.
///
/// ```
/// use myactuator_host_std::open::BusAddress;
/// use myactuator_host_std::protocol::MotorId;
/// use myactuator_host_std::protocol::master::StopKind;
/// use myactuator_host_std::share::{Guards, SharedBus};
///
/// let address: BusAddress = "sim:4".parse()?;
/// let arms = [SharedBus::open(&address, StopKind::Hold)?, SharedBus::open(&address, StopKind::Hold)?];
/// let arms = Guards::new(arms, [StopKind::Hold; 2]);
/// for arm in arms.iter() {
///     arm.release_brake(MotorId::MIN)?;
/// }
/// for unconfirmed in arms.finish() {
///     let unconfirmed = unconfirmed?;
///     assert!(unconfirmed.is_empty(), "cut the power of motors {unconfirmed}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
#[must_use = "the motors are stopped when it is dropped"]
pub struct Guards<const M: usize, E: fmt::Debug + Send + Sync + 'static = BusError> {
    buses: [SharedBus<E>; M],
    kinds: [StopKind; M],
    is_finished: bool,
}

impl<const M: usize, E: fmt::Debug + Send + Sync + 'static> Guards<M, E> {
    /// Guards what is done with these handles. Each bus has its own kind of stop: an arm is held, and its gripper let
    /// go, for example.
    pub const fn new(buses: [SharedBus<E>; M], kinds: [StopKind; M]) -> Self {
        Self { buses, kinds, is_finished: false }
    }

    /// Stops all motors of all buses now, and returns those of each bus that have not confirmed it: **cut their
    /// power**.
    ///
    /// # Errors
    /// For each bus, as [`SharedBus::stop_all`].
    pub fn finish(mut self) -> [Result<MotorSet, SharedBusError<E>>; M] {
        self.is_finished = true;
        self.stop()
    }

    fn stop(&self) -> [Result<MotorSet, SharedBusError<E>>; M] {
        let begin = |at: usize| self.buses[at].begin_stop_all(self.kinds[at], MotorSet::EMPTY);
        array::from_fn::<_, M, _>(begin).map(Stopping::wait)
    }
}

impl<const M: usize, E: fmt::Debug + Send + Sync + 'static> Drop for Guards<M, E> {
    /// To know which motors have not confirmed the stop, call [`finish`](Self::finish).
    fn drop(&mut self) {
        if !self.is_finished {
            let _unconfirmed = self.stop();
        }
    }
}

impl<const M: usize, E: fmt::Debug + Send + Sync + 'static> Deref for Guards<M, E> {
    type Target = [SharedBus<E>; M];

    fn deref(&self) -> &[SharedBus<E>; M] {
        &self.buses
    }
}

impl<E: fmt::Debug + Send + Sync + 'static> Deref for Guard<E> {
    type Target = SharedBus<E>;

    fn deref(&self) -> &SharedBus<E> {
        let [bus] = &*self.0;
        bus
    }
}

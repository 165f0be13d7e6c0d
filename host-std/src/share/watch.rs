//! A control loop in a thread of its own is watched, and its motors are stopped if it hangs.

use std::fmt;
use std::sync::Arc;

use myactuator_protocol_core::io::{self, Trouble};
use myactuator_protocol_core::master::{Event, Master, MotorSet};
use myactuator_protocol_core::time::{Duration, Instant};

use super::LoopError;
use super::desk::Desk;
use crate::open::BusError;

/// Watches motors that a control loop moves by set-points, and the loop. It finds what
/// [`io::Watch`](myactuator_protocol_core::io::Watch) finds, and asks the motors as that does; see there for what the
/// times have to be.
///
/// **If the loop does not look for longer than [`longest_silence`](Self::longest_silence), the thread of the bus stops
/// all motors**, as at the end of the bus: a loop that hangs cannot. The stop latches. In all other cases the watch
/// stops nothing: leave the loop through a [`Guard`](super::Guard).
///
/// ```
/// use myactuator_host_std::protocol::command::Speed;
/// use myactuator_host_std::protocol::master::{MotorSet, StopKind};
/// use myactuator_host_std::protocol::units::{MaxTorque, SpeedTarget};
/// use myactuator_host_std::protocol::MotorId;
/// use myactuator_host_std::share::{Guard, LoopError, SharedBus};
///
/// /// Turns an arm's motors for a second.
/// fn turn(bus: SharedBus, arm: MotorSet, turn: Speed) -> Result<MotorSet, LoopError> {
///     let bus = Guard::new(bus, StopKind::Hold);
///     let mut watch = bus.watch(arm);
///     for _ in 0..200 {
///         watch.look()?;
///         for motor in arm.iter() {
///             bus.set_point(motor, turn)?;
///         }
///         std::thread::sleep(std::time::Duration::from_millis(5));
///     }
///     Ok(bus.finish()?)
/// }
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let bus = SharedBus::open(&"sim:4".parse()?, StopKind::Hold)?;
/// let slowly = Speed { max_torque: MaxTorque::from_raw(50), speed: SpeedTarget::from_dps(30.0)? };
/// let unconfirmed = turn(bus, MotorId::all().take(4).collect(), slowly);
/// # // A busy machine may hold the loop up.
/// # let _ = unconfirmed;
/// # Ok(()) }
/// ```
///
/// It begins with the first look. End it before the loop's thread does something else, such as a
/// [`move_to`](super::SharedBus::move_to): drop it. Make a new one when the set of motors changes, and when the loop goes
/// on after a stop. It is no handle: it does not keep the bus running.
#[must_use = "it watches nothing before its first look"]
pub struct Watch<E = BusError> {
    desk: Arc<Desk<E>>,
    /// As it begins.
    watch: io::Watch,
    /// Its place on the desk, from the first look on.
    key: Option<u64>,
}

impl<E: fmt::Debug + 'static> Watch<E> {
    pub(super) const fn new(desk: Arc<Desk<E>>, motors: MotorSet) -> Self {
        Self { desk, watch: io::Watch::new(motors, Instant::ZERO), key: None }
    }

    /// How long a motor may give no feedback, and how long the loop may not look; 100 ms unless said otherwise. See
    /// [there](myactuator_protocol_core::io::Watch::longest_silence).
    pub fn longest_silence(mut self, time: Duration) -> Self {
        self.watch = self.watch.clone().longest_silence(time);
        self
    }

    /// The shortest time between two questions; 10 ms unless said otherwise. See
    /// [there](myactuator_protocol_core::io::Watch::ask_every).
    pub fn ask_every(mut self, time: Duration) -> Self {
        self.watch = self.watch.clone().ask_every(time);
        self
    }

    /// Reports what is wrong. Call it once a cycle, before the set-points. Does not wait: what this look finds is
    /// reported by the next.
    ///
    /// # Errors
    /// - [`Trouble`]: what was found first, at each look from then on.
    /// - [`SharedBusError::Held`](super::SharedBusError::Held): the thread of the bus has taken up nothing for 2 s.
    /// - [`SharedBusError::Panicked`](super::SharedBusError::Panicked): it has ended.
    pub fn look(&mut self) -> Result<(), LoopError<E>> {
        let Self { desk, watch, key } = self;
        Ok(desk.look(key, watch)??)
    }
}

impl<E> Drop for Watch<E> {
    fn drop(&mut self) {
        if let Some(key) = self.key {
            self.desk.end_watch(key);
        }
    }
}

impl<E> fmt::Debug for Watch<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Watch").finish_non_exhaustive()
    }
}

/// What the thread of the bus has of a watch.
#[derive(Debug)]
pub(super) struct Watched {
    pub(super) key: u64,
    watch: io::Watch,
    has_begun: bool,
    /// The loop has looked, and the thread has not.
    is_due: bool,
    trouble: Option<Trouble>,
}

impl Watched {
    pub(super) fn new(key: u64, watch: &io::Watch) -> Self {
        Self { key, watch: watch.clone(), has_begun: false, is_due: false, trouble: None }
    }

    /// The loop looks. Returns what was found before.
    pub(super) const fn is_looked_at(&mut self) -> Result<(), Trouble> {
        self.is_due = true;
        match self.trouble {
            Some(trouble) => Err(trouble),
            None => Ok(()),
        }
    }

    pub(super) fn note(&mut self, event: &Event) {
        self.watch.note(event);
    }

    /// The thread looks if the loop has looked, or is late. Returns whether it is late: that is found once.
    pub(super) fn look<const N: usize>(&mut self, master: &mut Master<N>, now: Instant) -> bool {
        if !std::mem::replace(&mut self.has_begun, true) {
            self.watch = self.watch.anew(now);
        }
        let is_late = self.late_after().is_some_and(|time| now > time);
        if is_late || std::mem::take(&mut self.is_due) && self.trouble.is_none() {
            self.trouble = self.watch.look(master, now).err();
        }
        is_late
    }

    /// Until when the loop has to look; `None` if it is to leave.
    pub(super) fn late_after(&self) -> Option<Instant> {
        self.trouble.is_none().then(|| self.watch.late_after())
    }
}

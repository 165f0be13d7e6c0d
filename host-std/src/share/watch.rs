//! A control loop in a thread of its own is watched, and its motors are stopped if it hangs.

use std::fmt;
use std::sync::Arc;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::io::{self, Trouble};
use myactuator_protocol_core::master::{Event, Master, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};

use super::LoopError;
use super::desk::Desk;
use crate::open::BusError;

/// Watches motors that a control loop moves by set-points, and the loop. It finds what
/// [`io::Watch`](myactuator_protocol_core::io::Watch) finds, and asks the motors as that does; see there for what the
/// times have to be.
///
/// **If the loop does not look for longer than [`longest_silence`](Self::longest_silence), the thread of the bus stops
/// all motors**, unless all are stopped already: a loop that hangs cannot. They are held if any watch that has looked
/// is to hold its motors, or if a motor [holds](super#motors-that-hold), is to, or moves to an angle alone; else they
/// are switched off. The stop latches. The same happens if the driver of the bus holds its thread for as long: no
/// set-point was sent meanwhile. In all other cases the watch stops nothing: leave the loop through a
/// [`Guard`](super::Guard).
///
/// **A stop of all, or of one of its motors, by whoever, ends the loop:** from then on each look says so, even if the
/// stop was lifted meanwhile. So a loop that has not seen the stop does not go on behind it.
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
///     let mut watch = bus.watch(arm, StopKind::Hold);
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
/// It begins with the first look: open brakes before that. End it before the loop's thread does something else, such as
/// a [`move_to`](super::SharedBus::move_to): drop it. If a panic drops it after its first look, all motors are stopped
/// as by a loop that hangs. Make a new one when the set of motors changes, after trouble and after a stop. It is no
/// handle: it does not keep the bus running.
///
/// A watch of no motors watches only its thread, whatever that does.
///
/// On a bus in virtual time a loop is late only by the time in which calls wait.
#[must_use = "it watches nothing before its first look"]
pub struct Watch<E = BusError> {
    desk: Arc<Desk<E>>,
    kind: StopKind,
    /// As it begins.
    watch: io::Watch,
    /// Its place on the desk, from the first look on.
    key: Option<u64>,
}

impl<E: fmt::Debug + 'static> Watch<E> {
    pub(super) const fn new(desk: Arc<Desk<E>>, motors: MotorSet, kind: StopKind) -> Self {
        Self { desk, kind, watch: io::Watch::new(motors, Instant::ZERO), key: None }
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

    /// These brakes have to be open. See [there](myactuator_protocol_core::io::Watch::open_brakes).
    pub fn open_brakes(mut self, motors: MotorSet) -> Self {
        self.watch = self.watch.clone().open_brakes(motors);
        self
    }

    /// Reports what is wrong. Call it once a cycle, before the set-points. Does not wait: what this look finds is
    /// reported by the next.
    ///
    /// # Errors
    /// - [`Trouble`]: what was found first, at each look from then on.
    /// - [`LoopError::Stopped`]: all motors are stopped, or all or one of these were since the first look.
    /// - [`SharedBusError::Held`](super::SharedBusError::Held): the thread of the bus has taken up nothing for the
    ///   [longest silence](Self::longest_silence), or for 2 s if that is shorter or nothing
    ///   [wakes](super::SharedBus::with_wake) the thread. Until it comes back nothing is sent.
    /// - [`SharedBusError::Panicked`](super::SharedBusError::Panicked): it has ended.
    pub fn look(&mut self) -> Result<(), LoopError<E>> {
        let Self { desk, kind, watch, key } = self;
        desk.look(key, watch, *kind)
    }
}

impl<E> Drop for Watch<E> {
    fn drop(&mut self) {
        match self.key {
            Some(key) if std::thread::panicking() => self.desk.loop_panics(key),
            Some(key) => self.desk.end_watch(key),
            None => {}
        }
    }
}

impl<E> fmt::Debug for Watch<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Watch").finish_non_exhaustive()
    }
}

/// Where a watch is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Course {
    /// The loop has not looked yet, or the thread has not seen that it has.
    NotBegun,
    Watches,
    /// All motors were stopped: the loop moves nothing, and need not look.
    Over,
    /// The loop has panicked, and its handle is gone.
    Panicked,
}

/// What the loop has to know.
#[derive(Clone, Copy, Debug)]
enum Found {
    Trouble(Trouble),
    /// All motors were stopped, or one of those that are watched.
    Stopped,
}

/// What the thread of the bus has of a watch.
#[derive(Clone, Debug)]
pub(super) struct Watched {
    pub(super) key: u64,
    /// How its motors are to be stopped if a loop is late.
    pub(super) kind: StopKind,
    watch: io::Watch,
    course: Course,
    /// The loop has looked, and the thread has not.
    is_due: bool,
    found: Option<Found>,
}

impl Watched {
    pub(super) fn new(key: u64, watch: &io::Watch, kind: StopKind) -> Self {
        let watch = watch.clone();
        Self { key, kind, watch, course: Course::NotBegun, is_due: false, found: None }
    }

    /// The loop looks. Returns what was found before.
    pub(super) fn is_looked_at<E: fmt::Debug>(&mut self) -> Result<(), LoopError<E>> {
        self.is_due = self.course != Course::Over;
        match self.found {
            Some(Found::Trouble(trouble)) => Err(trouble.into()),
            Some(Found::Stopped) => Err(LoopError::Stopped),
            None => Ok(()),
        }
    }

    pub(super) fn note(&mut self, event: &Event) {
        self.watch.note(event);
    }

    /// All motors are stopped.
    pub(super) fn end(&mut self) {
        if !self.has_panicked() {
            self.course = Course::Over;
        }
        self.is_due = false;
        self.found.get_or_insert(Found::Stopped);
    }

    /// A motor is stopped. The loop has to know, and to leave: until then the others may move.
    pub(super) fn is_stopped(&mut self, motor: MotorId) {
        if self.watch.motors().contains(motor) {
            self.found.get_or_insert(Found::Stopped);
        }
    }

    /// The loop has panicked.
    pub(super) fn panics(&mut self) {
        self.course = Course::Panicked;
    }

    pub(super) fn has_panicked(&self) -> bool {
        self.course == Course::Panicked
    }

    /// The thread looks if the loop has looked, or is late. True once when it is late or has panicked: then all motors
    /// are to be stopped.
    pub(super) fn look<const N: usize>(&mut self, master: &mut Master<N>, now: Instant) -> bool {
        if self.has_panicked() {
            return true;
        }
        let has_looked = std::mem::take(&mut self.is_due);
        // It begins. Or it was told of trouble, and may hang before it has left.
        if has_looked && (self.course == Course::NotBegun || self.found.is_some()) {
            (self.watch, self.course) = (self.watch.anew(now), Course::Watches);
            return false;
        }
        let is_late = self.late_after().is_some_and(|time| now > time);
        if self.found.is_none() && (has_looked || is_late) {
            self.found = self.watch.look(master, now).err().map(Found::Trouble);
        }
        if is_late {
            self.end();
        }
        is_late
    }

    /// Until when the loop has to look, if it has to.
    pub(super) fn late_after(&self) -> Option<Instant> {
        (self.course == Course::Watches).then(|| self.watch.late_after())
    }
}

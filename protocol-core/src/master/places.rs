//! Which motor has which place, and sets of places by their state, so that no search has to look at all motors.

use crate::error::RequestError;
use crate::id::MotorId;
use crate::master::motor::Motor;
use crate::master::{Config, Master, MotorSet, Presence};
use crate::time::{Duration, Instant};

/// A set of places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PlaceSet(u32);

impl PlaceSet {
    pub(super) const fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(super) const fn count(self) -> u32 {
        self.0.count_ones()
    }

    fn set(&mut self, place: usize, is_in: bool) {
        let bit = 1 << place;
        if is_in { self.0 |= bit } else { self.0 &= !bit }
    }

    pub(super) fn iter(self) -> impl Iterator<Item = usize> {
        let mut left = self.0;
        core::iter::from_fn(move || {
            let place = left.trailing_zeros() as usize;
            (left != 0).then(|| {
                left &= left - 1;
                place
            })
        })
    }

    pub(super) fn contains(self, place: usize) -> bool {
        self.0 & 1 << place != 0
    }

    pub(super) fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub(super) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Places {
    /// Each motor's place, counted from 1; 0 if it has none.
    of: [u8; MotorId::COUNT],
    /// Those that belong to a motor.
    pub(super) taken: PlaceSet,
    /// Those with something to send.
    pub(super) waiting: PlaceSet,
    /// Those of them with a stop to send.
    pub(super) stops: PlaceSet,
    /// Those with something in flight.
    pub(super) in_flight: PlaceSet,
    /// Those with something to report.
    pub(super) news: PlaceSet,
}

impl Places {
    pub(super) fn of(&self, motor: MotorId) -> Option<usize> {
        usize::from(*self.of.get(motor.index())?).checked_sub(1)
    }

    /// From now on the place belongs to this motor, or no longer does.
    fn set(&mut self, place: usize, motor: MotorId, is_taken: bool) {
        if let Some(of) = self.of.get_mut(motor.index()) {
            *of = if is_taken { place as u8 + 1 } else { 0 };
        }
        self.taken.set(place, is_taken);
    }

    /// Changes the motor at this place. A motor that has a place is changed in no other way.
    #[inline]
    pub(super) fn change<R>(
        &mut self,
        motors: &mut [Motor],
        place: usize,
        change: impl FnOnce(&mut Motor) -> R,
    ) -> Option<R> {
        let motor = motors.get_mut(place)?;
        let result = change(motor);
        self.note(place, motor);
        Some(result)
    }

    /// Updates the sets after the motor at this place has changed.
    #[inline(never)]
    fn note(&mut self, place: usize, motor: &Motor) {
        self.waiting.set(place, motor.is_waiting());
        self.stops.set(place, motor.is_stop_waiting());
        self.in_flight.set(place, motor.is_in_flight());
        self.news.set(place, motor.has_news());
    }
}

impl<const N: usize> Master<N> {
    /// The motors that have a place.
    pub fn motors(&self) -> MotorSet {
        self.at(self.places.taken).filter_map(|(_, motor)| motor.id).collect()
    }

    /// Of these motors, the one that has been sent nothing for longest beyond `rest`, or `silent_rest` if it is silent,
    /// and has nothing under way.
    pub(crate) fn longest_resting(
        &self,
        motors: MotorSet,
        now: Instant,
        rest: Duration,
        silent_rest: Duration,
    ) -> Option<MotorId> {
        let rests_until = |motor: &Motor| {
            let is_silent = motor.health().presence == Presence::Silent;
            motor.sent + if is_silent { silent_rest } else { rest }
        };
        let all = motors.iter().filter_map(|id| Some((id, self.motor(id)?)));
        let resting = all.filter(|(_, motor)| {
            motor.request.is_none() && motor.is_idle(now) && rests_until(motor) <= now
        });
        resting.min_by_key(|(_, motor)| rests_until(motor)).map(|(id, _)| id)
    }

    /// Gives up a motor's place and counters, so that another motor can have the place. Returns `false`, and changes
    /// nothing, in these cases:
    ///
    /// - It has a request or a set-point under way, or an event that was not polled.
    /// - Something that was sent to it or to all, and not answered, may still move it, for example from a mailbox.
    ///
    /// From then on no stop of all and no guard reaches it, so see it stopped first. Its late replies are no longer
    /// recognized: after a request that was not answered, send it nothing for [`Config::late_window`].
    pub fn forget(&mut self, motor: MotorId) -> bool {
        let now = self.now;
        let Some(place) = self.places.of(motor) else { return false };
        let is_idle = self.motors.get(place).is_some_and(|motor| motor.is_idle(now))
            && !self.broadcast.may_yet_move(motor);
        if is_idle {
            self.let_line_answer();
            // A stop to all is also for this motor, and must not be left out because it was called before.
            self.stop_to_all_was = None;
            self.change_at(place, |motor, _| *motor = Motor::default());
            self.places.set(place, motor, false);
        }
        is_idle
    }

    /// The place of a motor, or a free one if it has none.
    #[inline]
    pub(super) fn place_for(&mut self, motor: MotorId) -> Result<usize, RequestError> {
        let place = self.places.of(motor).or_else(|| self.give_place(motor));
        place.ok_or(RequestError::TooManyMotors { capacity: N })
    }

    /// These motors were found: a stop of all is also for them. If there is no place for all of them, one stop goes to
    /// all.
    pub(crate) fn note_found(&mut self, motors: MotorSet) {
        if self.give_places(motors).is_err() {
            self.broadcast.may_be_unnamed = true;
            // As in `forget`.
            self.stop_to_all_was = None;
        }
    }

    /// Gives each of these motors a place, or none of them if there is no place for all.
    #[inline(never)]
    pub(super) fn give_places(&mut self, motors: MotorSet) -> Result<(), RequestError> {
        self.has_places_for(motors)?;
        motors.iter().try_for_each(|motor| self.place_for(motor).map(|_| ()))
    }

    /// Whether there is a place for each of these motors.
    pub(crate) fn has_places_for(&self, motors: MotorSet) -> Result<(), RequestError> {
        if self.motors().with(motors).len() > N {
            return Err(RequestError::TooManyMotors { capacity: N });
        }
        Ok(())
    }

    #[inline(never)]
    fn give_place(&mut self, motor: MotorId) -> Option<usize> {
        let mut motors = self.motors.iter_mut().enumerate();
        let (place, of) = motors.find(|(_, motor)| motor.id.is_none())?;
        of.id = Some(motor);
        self.places.set(place, motor, true);
        Some(place)
    }

    pub(super) fn motor(&self, motor: MotorId) -> Option<&Motor> {
        self.motors.get(self.places.of(motor)?)
    }

    /// The motors at these places.
    pub(super) fn at(&self, places: PlaceSet) -> impl Iterator<Item = (usize, &Motor)> {
        places.iter().filter_map(|place| Some((place, self.motors.get(place)?)))
    }

    /// Changes a motor that has a place; see [`Places::change`]. From then on time may have something to do with it.
    pub(super) fn change<R>(
        &mut self,
        motor: MotorId,
        change: impl FnOnce(&mut Motor, &Config) -> R,
    ) -> Option<R> {
        self.due = self.now;
        self.change_at(self.places.of(motor)?, change)
    }

    /// As [`change`](Self::change), all motors that have one.
    pub(super) fn change_all<R>(&mut self, mut change: impl FnMut(&mut Motor, &Config) -> R) {
        self.due = self.now;
        for place in self.places.taken.iter() {
            self.change_at(place, &mut change);
        }
    }

    /// Changes the motor at a place, for a caller that itself sees to it that [`due`](Master::due) is right.
    #[inline]
    pub(super) fn change_at<R>(
        &mut self,
        place: usize,
        change: impl FnOnce(&mut Motor, &Config) -> R,
    ) -> Option<R> {
        self.places.change(&mut self.motors, place, |motor| change(motor, &self.config))
    }
}

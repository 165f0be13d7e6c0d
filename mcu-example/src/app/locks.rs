//! The brakes: which are locked, and which are to be since their motors have reported an error.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{BrakeCommand, Command, ReadStatus1, ReleaseBrake};
use myactuator_protocol_core::io::bring_up::BRAKE_MOVES;
use myactuator_protocol_core::master::{Event, Failure, Master, MotorSet, TicketId};
use myactuator_protocol_core::time::{Duration, Instant};

use super::Setup;
use super::script::Question;

/// A motor is asked within this time, in its turn, whether its brake has locked.
const SAYS_SO: Duration = Duration::from_secs(1);

/// Knows which brakes are locked, and locks those of some motors.
#[derive(Debug)]
pub(super) struct Locks {
    /// Brakes that were told to lock, or have said that they are locked, and were not told to open since. Nothing else
    /// opens one, whatever it says: some firmware does not report what its brake does.
    locked: MotorSet,
    /// Brakes that may be moving until then.
    moving: (MotorSet, Instant),
    wanted: MotorSet,
    /// Motors that have reported an error since the button was pressed.
    failed: MotorSet,
    /// The command in flight.
    told: Option<TicketId>,
}

impl Locks {
    pub(super) const fn new() -> Self {
        let [locked, wanted, failed] = [MotorSet::EMPTY; 3];
        Self { locked, moving: (MotorSet::EMPTY, Instant::ZERO), wanted, failed, told: None }
    }

    /// A motor reports an error. It confirms a stop and holds nothing, and its brake may have been told to open. So its
    /// brake is told to lock, each time. Returns whether this is new since the button was pressed.
    pub(super) fn fails(&mut self, motor: MotorId) -> bool {
        self.wanted.insert(motor);
        let is_new = !self.failed.contains(motor);
        self.failed.insert(motor);
        is_new
    }

    /// The button was pressed.
    pub(super) fn forget_errors(&mut self) {
        self.failed = MotorSet::EMPTY;
    }

    /// Sends the commands to lock, one at a time. A motor that is being stopped gets its own after the stop.
    pub(super) fn ask<const N: usize>(
        &mut self,
        setup: &Setup,
        master: &mut Master<N>,
        now: Instant,
    ) {
        // Looking through all ids would take some 200 instructions a cycle.
        if self.wanted.is_empty() || self.told.is_some() {
            return;
        }
        let ask = |motor| Question::LockBrake.ask(motor, setup, master).ok();
        self.told = self.wanted.iter().find_map(ask);
        if let Some(told) = self.told {
            self.wanted.remove(told.motor());
            self.lock(told.motor(), now);
        }
    }

    /// This brake is told to lock, or says that it is locked. It may have just begun to, unless it is the one that was
    /// known to move.
    fn lock(&mut self, motor: MotorId, now: Instant) {
        let is_known = self.moving.0.contains(motor) && now < self.moving.1 + SAYS_SO;
        if !self.locked.contains(motor) && !is_known {
            self.move_now(motor.into(), now);
        }
        self.locked.insert(motor);
    }

    /// The button was pressed to shut down. These brakes are told to lock; the answers may be lost.
    pub(super) fn shut_down(&mut self, motors: MotorSet) {
        self.forget_errors();
        self.locked = self.locked.with(motors);
    }

    /// These brakes may begin to move now: where a load sinks meanwhile, that is no slip.
    pub(super) fn move_now(&mut self, motors: MotorSet, now: Instant) {
        let others = if now < self.moving.1 { self.moving.0 } else { MotorSet::EMPTY };
        self.moving = (others.with(motors), now + BRAKE_MOVES);
    }

    /// Those of these motors whose brakes have locked.
    pub(super) fn among(&self, motors: MotorSet, now: Instant) -> MotorSet {
        let locked = motors.without(motors.without(self.locked));
        if now < self.moving.1 { locked.without(self.moving.0) } else { locked }
    }

    /// Takes note of an outcome. If a stop has dropped the command, it is sent again after the stop.
    pub(super) fn note(&mut self, event: &Event, now: Instant) {
        if let Event::Reply { ticket, data, .. } = event {
            let is_locked = ReadStatus1::decode_reply(data)
                .is_ok_and(|status| status.brake == BrakeCommand::LOCK);
            if is_locked {
                self.lock(ticket.motor(), now);
            } else if ReleaseBrake::decode_reply(data).is_ok() {
                self.locked.remove(ticket.motor());
            }
        }
        let Some(told) = self.told else { return };
        let failure = match event {
            Event::Reply { ticket, .. } if *ticket == told => None,
            Event::Failed { ticket, failure } if *ticket == told => Some(failure),
            _ => return,
        };
        self.told = None;
        if failure == Some(&Failure::Stopped) {
            self.wanted.insert(told.motor());
        }
    }
}

#[cfg(test)]
mod tests {
    use myactuator_protocol_core::command::{MotionRanges, ReadModel};
    use myactuator_protocol_core::master::{Config, StopKind};

    use super::*;
    use crate::Movement;

    #[test]
    fn an_error_is_new_after_a_press_of_either_kind() {
        let mut locks = Locks::new();
        let is_new = |locks: &mut Locks| [(); 2].map(|()| locks.fails(MotorId::MIN));
        assert_eq!(is_new(&mut locks), [true, false]);
        locks.shut_down(MotorSet::EMPTY);
        assert_eq!(is_new(&mut locks), [true, false]);
        locks.forget_errors();
        assert_eq!(is_new(&mut locks), [true, false]);
    }

    #[test]
    fn what_came_of_another_question_is_not_what_came_of_the_lock() {
        let ranges = MotionRanges::V4_3;
        let setup = Setup::new(Movement::Motion { ranges, kp: 0.0, kd: 0.0 });
        let [mut earlier, mut master] = [(); 2].map(|()| Master::<2>::new(Config::can(1_000_000)));
        let motor = MotorId::MIN;
        assert!(earlier.request(motor, ReadModel).is_ok());
        // This makes its next ticket a different one.
        assert!(master.request(MotorId::all().last().expect("32"), ReadModel).is_ok());

        let mut locks = Locks::new();
        assert!(locks.fails(motor));
        locks.ask(&setup, &mut master, Instant::ZERO);
        let mut is_stopped = |master: &mut Master<2>| {
            master.stop_all(StopKind::Hold, MotorSet::EMPTY).expect("it has a place");
            while let Some(event) = master.poll_event() {
                locks.note(&event, Instant::ZERO);
            }
            locks.wanted.contains(motor)
        };
        assert!(!is_stopped(&mut earlier));
        assert!(is_stopped(&mut master));
    }
}

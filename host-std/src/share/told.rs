//! Which motors hold still, and which may be moving.

use myactuator_protocol_core::command::{AnyReply, Command, ReadStatus1, Status1};
use myactuator_protocol_core::master::{Event, MotorSet, StopKind};
use myactuator_protocol_core::{Kind, MotorId, Opcode};

/// What a motor was told last of its motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Last {
    /// Nothing, or its drive has let go since.
    #[default]
    Nothing,
    /// Whatever it was, it reports an error, and may hold nothing.
    InError,
    /// By set-points, which only whoever puts them ends.
    ToFollow,
    /// By a command that it carries out alone.
    ToMove,
    /// To be off, or to hold, which it has not confirmed yet: it may go on moving.
    ToStop(StopKind),
    /// It has confirmed that it holds still, or has arrived.
    ToHold,
}

/// What each motor was told last of its motion.
#[derive(Debug, Default)]
pub(super) struct Told([Last; MotorId::COUNT]);

impl Told {
    pub(super) fn follows(&mut self, motor: MotorId) {
        self.0[motor.index()] = Last::ToFollow;
    }

    pub(super) fn moves(&mut self, motor: MotorId) {
        self.0[motor.index()] = Last::ToMove;
    }

    /// It has arrived where it was told to move, unless it was told something else since.
    pub(super) fn has_arrived(&mut self, motor: MotorId) {
        self.change(motor, Last::ToMove, Last::ToHold);
    }

    /// A motor that holds already goes on, whether or not it confirms that again.
    pub(super) fn stops(&mut self, motor: MotorId, kind: StopKind) {
        let last = &mut self.0[motor.index()];
        if (*last, kind) != (Last::ToHold, StopKind::Hold) {
            *last = Last::ToStop(kind);
        }
    }

    /// Told by a command that ends motion. One that locks its brake ends a motion, and switches nothing on.
    pub(super) fn ends_motion(&mut self, motor: MotorId, by: Kind) {
        match (StopKind::by(by), self.0[motor.index()]) {
            (Some(kind), _) => self.stops(motor, kind),
            (None, Last::ToFollow | Last::ToMove) => self.stops(motor, StopKind::Hold),
            (None, Last::ToHold) if by == Opcode::Reset.into() => self.lets_go(motor),
            (None, _) => {}
        }
    }

    /// Takes note of what an event says of a motor. Returns the status of one that is in error.
    pub(super) fn note(&mut self, event: &Event) -> Option<(MotorId, Status1)> {
        match *event {
            Event::StopConfirmed { motor } => self.confirmed(motor),
            Event::Reply { ticket, kind, .. } if kind.ends_motion() => {
                self.confirmed(ticket.motor());
            }
            // One that has restarted or has lost its master is told again if a stop is to hold it. If not, it is off
            // behind its locked brake, and asking it does no harm.
            _ => {}
        }
        let (motor, status) = status_in(event)?;
        let is_in_error = !status.errors.is_empty();
        self.reports(motor, is_in_error);
        is_in_error.then_some((motor, status))
    }

    /// It has confirmed what ends its motion. That says nothing of what it was told since.
    fn confirmed(&mut self, motor: MotorId) {
        self.change(motor, Last::ToStop(StopKind::Hold), Last::ToHold);
    }

    /// Its drive was told to restart.
    fn lets_go(&mut self, motor: MotorId) {
        self.change(motor, Last::ToHold, Last::Nothing);
    }

    /// Its drive says whether it is in error.
    fn reports(&mut self, motor: MotorId, is_in_error: bool) {
        // One that was switched off is off in any case. When the error has gone, it may go on as it was told before.
        if is_in_error && self.0[motor.index()] != Last::ToStop(StopKind::Off) {
            self.0[motor.index()] = Last::InError;
        }
    }

    pub(super) fn is_forgotten(&mut self, motor: MotorId) {
        self.0[motor.index()] = Last::Nothing;
    }

    fn change(&mut self, motor: MotorId, from: Last, to: Last) {
        let last = &mut self.0[motor.index()];
        if *last == from {
            *last = to;
        }
    }

    /// Those that hold still until they are told otherwise.
    pub(super) fn holding(&self) -> MotorSet {
        self.with(|last| last == Last::ToHold)
    }

    /// Whether any motor would let a load fall if it were switched off, that nobody leads by set-points.
    pub(super) fn is_any_held(&self) -> bool {
        let is_held =
            |last| matches!(last, Last::ToHold | Last::ToMove | Last::ToStop(StopKind::Hold));
        !self.with(is_held).is_empty()
    }

    /// Those that were told nothing of their motion. All others but those that hold are left alone: they may be moving,
    /// are off or are in error. Their protection ends what a thread that hangs has begun, or locks a brake behind which
    /// nothing holds.
    pub(super) fn untold(&self) -> MotorSet {
        self.with(|last| last == Last::Nothing)
    }

    fn with(&self, is_it: impl Fn(Last) -> bool) -> MotorSet {
        MotorId::all().filter(|motor| is_it(self.0[motor.index()])).collect()
    }
}

/// The status (0x9A) that a motor has sent.
fn status_in(event: &Event) -> Option<(MotorId, Status1)> {
    match event {
        Event::Report { motor, reply: AnyReply::ReadStatus1(status) } => Some((*motor, *status)),
        Event::Reply { ticket, data, .. } => {
            Some((ticket.motor(), ReadStatus1::decode_reply(data).ok()?))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOTOR: MotorId = MotorId::MIN;

    #[test]
    fn a_motor_holds_until_it_is_told_otherwise_or_lets_go() {
        type Step = fn(&mut Told);
        let follows: Step = |told| told.follows(MOTOR);
        let moves: Step = |told| told.moves(MOTOR);
        let arrives: Step = |told| told.has_arrived(MOTOR);
        let is_to_hold: Step = |told| told.stops(MOTOR, StopKind::Hold);
        let is_to_be_off: Step = |told| told.stops(MOTOR, StopKind::Off);
        let locks: Step = |told| told.ends_motion(MOTOR, Opcode::LockBrake.into());
        let stops: Step = |told| told.ends_motion(MOTOR, Opcode::Stop.into());
        let shuts_down: Step = |told| told.ends_motion(MOTOR, Opcode::Shutdown.into());
        let restarts: Step = |told| told.ends_motion(MOTOR, Opcode::Reset.into());
        let confirms: Step = |told| told.confirmed(MOTOR);
        let lets_go: Step = |told| told.lets_go(MOTOR);
        let fails: Step = |told| told.reports(MOTOR, true);
        let is_well: Step = |told| told.reports(MOTOR, false);
        let is_forgotten: Step = |told| told.is_forgotten(MOTOR);
        // Whether it then holds, and whether it is left alone.
        let (holds, is_left_alone, neither) = ((true, false), (false, true), (false, false));
        let cases: &[(&[Step], (bool, bool))] = &[
            (&[], neither),
            (&[confirms], neither),
            (&[follows], is_left_alone),
            (&[moves], is_left_alone),
            (&[moves, arrives], holds),
            (&[moves, follows, arrives], is_left_alone),
            (&[moves, lets_go], is_left_alone),
            (&[is_to_hold], is_left_alone),
            (&[is_to_hold, arrives], is_left_alone),
            (&[is_to_hold, confirms], holds),
            (&[is_to_hold, follows, confirms], is_left_alone),
            (&[is_to_hold, confirms, is_to_hold], holds),
            (&[is_to_hold, confirms, stops], holds),
            (&[is_to_hold, confirms, moves], is_left_alone),
            (&[is_to_hold, confirms, is_to_be_off], is_left_alone),
            (&[is_to_hold, confirms, shuts_down], is_left_alone),
            (&[is_to_hold, confirms, lets_go], neither),
            (&[is_to_hold, confirms, lets_go, confirms], neither),
            (&[is_to_be_off, confirms], is_left_alone),
            (&[is_to_be_off, confirms, is_to_hold, confirms], holds),
            (&[locks, confirms], neither),
            (&[moves, locks, confirms], holds),
            (&[is_to_hold, confirms, locks, confirms], holds),
            (&[shuts_down, locks, confirms], is_left_alone),
            (&[is_to_hold, confirms, restarts], neither),
            (&[moves, restarts], is_left_alone),
            (&[is_to_hold, confirms, fails], is_left_alone),
            (&[is_to_hold, fails, confirms], is_left_alone),
            (&[is_to_hold, confirms, fails, is_well], is_left_alone),
            (&[moves, fails, is_well], is_left_alone),
            (&[fails, is_well], is_left_alone),
            (&[is_to_hold, confirms, is_well], holds),
            (&[shuts_down, fails, is_well], is_left_alone),
            (&[moves, is_forgotten], neither),
            (&[stops, confirms], holds),
            (&[shuts_down, confirms], is_left_alone),
        ];
        for (number, (steps, expected)) in cases.iter().enumerate() {
            let mut told = Told::default();
            steps.iter().for_each(|step| step(&mut told));
            let is_in = |motors: MotorSet| motors.contains(MOTOR);
            let is_left_alone = !is_in(told.holding().with(told.untold()));
            assert_eq!((is_in(told.holding()), is_left_alone), *expected, "{number}");
        }
        // Who would fall.
        let cases: [(&[Step], bool); 6] = [
            (&[], false),
            (&[follows], false),
            (&[moves], true),
            (&[is_to_hold], true),
            (&[is_to_hold, confirms], true),
            (&[is_to_be_off, confirms], false),
        ];
        for (number, (steps, expected)) in cases.into_iter().enumerate() {
            let mut told = Told::default();
            steps.iter().for_each(|step| step(&mut told));
            assert_eq!(told.is_any_held(), expected, "{number}");
        }
    }

    #[test]
    fn events_say_whether_a_motor_holds() {
        use myactuator_protocol_core::command::{ReadMultiTurnAngle, Stop};
        use myactuator_protocol_core::master::{Config, Master};

        // Tickets are the master's own.
        let mut master = Master::<1>::new(Config::CAN);
        let ticket = master.request(MOTOR, ReadMultiTurnAngle).unwrap().id();
        let reply = |kind: Kind, data| Event::Reply { ticket, kind, data };
        // Status 1 (2.14.4), without an error and with one (0x0002, stall).
        let status = [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0];
        let in_error = [0x9A, 50, 30, 1, 0xE5, 0x01, 2, 0];
        let report = |data| {
            let reply = AnyReply::ReadStatus1(ReadStatus1::decode_reply(data).unwrap());
            Event::Report { motor: MOTOR, reply }
        };
        let to_hold = Last::ToStop(StopKind::Hold);
        for (before, event, after, is_error) in [
            (to_hold, Event::StopConfirmed { motor: MOTOR }, Last::ToHold, false),
            (to_hold, reply(Opcode::Stop.into(), Stop.encode()), Last::ToHold, false),
            (to_hold, reply(Opcode::ReadMultiTurnAngle.into(), [0x92; 8]), to_hold, false),
            (to_hold, reply(Opcode::ReadStatus1.into(), status), to_hold, false),
            (Last::ToHold, Event::StopUnconfirmed { motor: MOTOR }, Last::ToHold, false),
            (Last::ToHold, Event::Restarted { motor: MOTOR }, Last::ToHold, false),
            (Last::ToHold, Event::LostMaster { motor: MOTOR }, Last::ToHold, false),
            (Last::ToHold, reply(Opcode::ReadStatus1.into(), in_error), Last::InError, true),
            (Last::ToHold, report(&in_error), Last::InError, true),
            (Last::ToHold, report(&status), Last::ToHold, false),
        ] {
            let mut told = Told::default();
            told.0[MOTOR.index()] = before;
            assert_eq!(told.note(&event).is_some(), is_error, "{event:?}");
            assert_eq!(told.0[MOTOR.index()], after, "{event:?}");
        }
    }
}

//! What other programs on the same bus do to motors. Replies that this program has not asked for show it.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use myactuator_host_std::open::{AnyMaster, BusError};
use myactuator_protocol_core::io::{Elapsed, Runner};
use myactuator_protocol_core::master::{Event, Master, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Kind, MotorId, Opcode};

use crate::cli::report;

/// A bus in use. If another program stops a motor that this program moves, this program stops it, too, and sends
/// nothing more that may move it.
#[derive(Debug)]
pub(super) struct Watched {
    pub(super) bus: AnyMaster<{ MotorId::COUNT }>,
    /// The motors that this program moves, until it stops them.
    pub(super) moved: MotorSet,
    /// Those of them that another program has stopped.
    pub(super) stopped: Rc<Cell<MotorSet>>,
    /// The motors that this program or another one has switched off.
    pub(super) off: MotorSet,
    /// The motors that another program has moved since they confirmed their last stop, if there was one. If that stop
    /// was to switch them off, also those that it has switched on.
    pub(super) moved_on: MotorSet,
    /// The motors that another program has switched off since then.
    let_go: MotorSet,
    /// The motors that have confirmed a stop of this program.
    pub(super) confirmed: MotorSet,
    /// The motors that have not, after all retries.
    pub(super) silent: MotorSet,
    /// Set by Ctrl-C and the like. Kept here while they do not end what goes on, until the user is told so.
    pub(super) finished_first: Option<Arc<AtomicBool>>,
    awake: Elapsed,
}

impl Watched {
    pub(super) fn new(bus: AnyMaster<{ MotorId::COUNT }>) -> Self {
        let [moved, off, moved_on, let_go, confirmed, silent] = [MotorSet::EMPTY; 6];
        let (stopped, awake) = (Rc::default(), Elapsed::default());
        let finished_first = None;
        Self {
            bus,
            moved,
            stopped,
            off,
            moved_on,
            let_go,
            confirmed,
            silent,
            finished_first,
            awake,
        }
    }

    /// Tells a user who has pressed Ctrl-C why the program goes on.
    fn tell_of_interruption(&mut self) {
        if self.finished_first.take_if(|flag| flag.load(Ordering::Relaxed)).is_some() {
            report(
                "note",
                "interrupted: this command is finished first, so that nothing is left half written",
            );
        }
    }

    /// How long the bus was looked at. Time in which this program was suspended does not count for a time-out.
    pub(super) fn awake(&mut self) -> Duration {
        self.awake.at(self.bus.now())
    }

    /// Whether a motor was switched off, here or elsewhere, as far as was seen.
    pub(super) const fn is_off(&self, motor: MotorId) -> bool {
        self.off.contains(motor) || self.let_go.contains(motor)
    }

    fn has_confirmed(&mut self, motor: MotorId) {
        self.moved_on.remove(motor);
        self.let_go.remove(motor);
    }

    fn note(&mut self, event: &Event) {
        match (*event, deed(event)) {
            (Event::StopConfirmed { motor }, _) => {
                self.has_confirmed(motor);
                self.confirmed.insert(motor);
                // A second confirmation of this program's stop must not look like another program's stop.
                self.moved.remove(motor);
            }
            (Event::Reply { ticket, kind, .. }, _) if StopKind::by(kind).is_some() => {
                self.has_confirmed(ticket.motor());
            }
            (Event::StopUnconfirmed { motor }, _) => self.silent.insert(motor),
            (_, Some((motor, Deed::Moved))) => self.moved_on.insert(motor),
            (_, Some((motor, Deed::Stopped(kind)))) if self.moved.contains(motor) => {
                self.give_way(motor, kind);
            }
            // A stop switches the output on, to hold still (2.18).
            (_, Some((motor, Deed::Stopped(StopKind::Hold)))) => {
                self.let_go.remove(motor);
                if self.off.contains(motor) {
                    self.moved_on.insert(motor);
                }
            }
            (_, Some((motor, Deed::Stopped(StopKind::Off)))) => self.let_go.insert(motor),
            _ => {}
        }
    }

    fn give_way(&mut self, motor: MotorId, kind: StopKind) {
        // There is a place for every motor.
        let _ = self.bus.master().stop(motor, kind);
        self.stopped.set(self.stopped.get().with(motor.into()));
        if kind == StopKind::Off {
            self.off.insert(motor);
        }
    }
}

impl Runner<{ MotorId::COUNT }> for Watched {
    type Error = BusError;

    fn master(&mut self) -> &mut Master<{ MotorId::COUNT }> {
        self.bus.master()
    }

    fn now(&self) -> Instant {
        self.bus.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, BusError> {
        self.awake();
        self.tell_of_interruption();
        let event = self.bus.poll()?;
        event.iter().for_each(|event| self.note(event));
        Ok(event)
    }

    fn idle(&mut self, until: Instant) {
        self.bus.idle(until);
    }
}

/// Commands of V4.4 that move and are not in the table: to a position, with feed-forward of speed or torque.
const MOVES_OF_V4_4: [u8; 2] = [0x72, 0x73];

/// What another program has commanded a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Deed {
    Moved,
    Stopped(StopKind),
}

/// The motor that another program has stopped, if this event shows that.
pub(super) fn stopped_elsewhere(event: &Event) -> Option<MotorId> {
    match deed(event)? {
        (motor, Deed::Stopped(_)) => Some(motor),
        (_, Deed::Moved) => None,
    }
}

/// What the event shows of another program.
fn deed(event: &Event) -> Option<(MotorId, Deed)> {
    let Event::Stray { motor, data } = *event else { return None };
    // A reply of motion mode begins with the motor's id (5). That of motor 32 looks like one to 0x20, which counts as
    // one, too.
    if data[0] == motor.get() || MOVES_OF_V4_4.contains(&data[0]) {
        return Some((motor, Deed::Moved));
    }
    let kind = Kind::Known(Opcode::from_byte(data[0])?);
    let stopped = StopKind::by(kind).map(Deed::Stopped);
    let deed = stopped.or_else(|| kind.moves().then_some(Deed::Moved))?;
    Some((motor, deed))
}

#[cfg(test)]
mod tests {
    use myactuator_host_std::sim::Fleet;
    use myactuator_protocol_core::command::{Shutdown, Stop};

    use super::super::session::Session;
    use super::super::simulated::{OtherMaster, Sends, sent, to_first};
    use super::*;
    use crate::cli::{Outcome, Unfinished};

    #[test]
    fn program_that_moves_nothing_ignores_a_stop_by_another_master() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let stop = to_first([0x80, 0, 0, 0, 0, 0, 0, 0]);
        OtherMaster::attach(&fleet, stop, Sends::Once(Duration::from_millis(10)));
        let log = fleet.world.log();
        let mut session = Session::on(&fleet);
        let later = Instant::from_millis(50);
        session.wait_until(later).unwrap();
        assert_eq!(sent(&log), [stop]);
    }

    #[test]
    fn own_stop_confirmed_twice_is_not_taken_for_that_of_another_master() {
        let twice = "duplicate=1@from-drives".parse().unwrap();
        let fleet = Fleet::new(1).faults([twice]).on_can(1_000_000).unwrap();
        let outcome: Outcome = Session::on(&fleet).moving(MotorId::MIN, |session| {
            session.stop(StopKind::Hold, MotorId::MIN.into())?;
            Err(Unfinished::Failed("made up".to_owned()))
        });
        let message = "made up; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that";
        assert_eq!(outcome, Err(Unfinished::Failed(message.to_owned())));
    }

    /// In either way in which this program stops it. Otherwise it would be reported as commanded, or off, from then on.
    #[test]
    fn own_stop_ends_what_another_master_has_commanded_before() {
        let is_noted = |session: &Session| {
            let master = &session.master;
            master.moved_on.contains(MotorId::MIN) || master.is_off(MotorId::MIN)
        };
        for data in [[0xA1, 0, 0, 0, 1, 0, 0, 0], Shutdown.encode()] {
            for is_request in [true, false] {
                let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
                let once = Sends::Once(Duration::from_millis(10));
                OtherMaster::attach(&fleet, to_first(data), once);
                let mut session = Session::on(&fleet);
                session.wait_until(Instant::from_millis(50)).unwrap();
                assert!(is_noted(&session));
                match is_request {
                    true => _ = session.ask(MotorId::MIN, Stop).unwrap(),
                    false => session.confirm_stop(StopKind::Hold, MotorId::MIN.into()).unwrap(),
                }
                assert!(!is_noted(&session), "{data:02X?} {is_request}");
            }
        }
    }

    #[test]
    fn stray_replies_show_what_another_master_commands() {
        let motor = MotorId::new(3).unwrap();
        let deed_of = |first| deed(&Event::Stray { motor, data: [first, 0, 0, 0, 0, 0, 0, 0] });
        // 3: the reply of motion mode. 0x72 and 0x73: V4.4 moves by them.
        for first in [0xA1, 0xA2, 0xA4, 0xA6, 0xA8, 0xA9, 3, 0x72, 0x73] {
            assert_eq!(deed_of(first), Some((motor, Deed::Moved)), "{first:02X}");
        }
        assert_eq!(deed_of(0x80), Some((motor, Deed::Stopped(StopKind::Off))));
        assert_eq!(deed_of(0x81), Some((motor, Deed::Stopped(StopKind::Hold))));
        for first in [0x9A, 0x9C, 0x92, 0x77, 0x78, 4, 0xC0, 0x20] {
            assert_eq!(deed_of(first), None, "{first:02X}");
        }
        let last = MotorId::new(32).unwrap();
        let motion = Event::Stray { motor: last, data: [32, 0, 0, 0, 0, 0, 0, 0] };
        assert_eq!(deed(&motion), Some((last, Deed::Moved)));
    }
}

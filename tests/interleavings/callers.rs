//! What callers do, and what the oracle concludes from it.

use myactuator_protocol_core::command::{
    IncrementalPosition, RawMotion, ReadMultiTurnAngle, Shutdown, Stop, Torque,
};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::master::{MotorSet, StopKind, Ticket};
use myactuator_protocol_core::units::{Angle, Current, MaxSpeed};
use myactuator_protocol_core::{Command, MotorId};
use myactuator_tests::rig::with_token;

use super::state::State;
use super::world::{Open, motor_at};

/// A call, for the motor with this index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Call {
    Read(u8),
    Move(u8),
    Shutdown(u8),
    /// The command Stop (0x81), not a stop of the master's.
    Hold(u8),
    Torque(u8),
    Motion(u8),
    StopOne(u8, StopKind),
    StopAll(StopKind),
    Lift,
    LiftOf(u8),
    /// A read to all.
    Broadcast,
    TorqueAll,
    ShutdownAll,
    /// A Shutdown to all that expects no answers.
    ShutdownAllUnheard,
    HoldAll,
    /// The loop reports that the bus is down while it is cut.
    BusDown,
}

impl<const N: usize> State<N> {
    /// Makes this call. Returns `false` if it had no effect.
    pub(super) fn call(&mut self, call: Call) -> bool {
        if self.calls_left == 0 {
            return false;
        }
        self.calls_left -= 1;
        self.world.calls += 1;
        let number = self.world.calls;
        let token = u32::from(number);
        match call {
            Call::Read(at) => self.request(at, with_token(ReadMultiTurnAngle, token)),
            Call::Move(at) => {
                let (max_speed, angle) = (MaxSpeed::NO_LIMIT, Angle::from_raw(number.into()));
                self.request(at, IncrementalPosition { max_speed, angle })
            }
            Call::Shutdown(at) => {
                let is_put = self.request(at, with_token(Shutdown, token));
                is_put && self.ends_motion(at.into(), StopKind::Off)
            }
            Call::Hold(at) => {
                let is_put = self.request(at, with_token(Stop, token));
                is_put && self.ends_motion(at.into(), StopKind::Hold)
            }
            Call::Torque(at) => {
                let command = Torque { current: Current::from_raw(number.into()) };
                self.master.set_point(motor_at(at.into()), command, self.world.now).is_ok()
            }
            Call::Motion(at) => {
                let command = RawMotion::decode(&[0, 0, 0, 0, 0, 0, 0, number]);
                self.master.set_point(motor_at(at.into()), command, self.world.now).is_ok()
            }
            Call::StopOne(at, kind) => {
                let is_put = self.master.stop(motor_at(at.into()), kind).is_ok();
                self.stops(at.into(), kind);
                self.world.truth[usize::from(at)].is_stopped = true;
                is_put
            }
            Call::StopAll(kind) => {
                let known = self.master.motors();
                let is_put = self.master.stop_all(kind, known).is_ok();
                known.iter().for_each(|motor: MotorId| self.stops(motor.index(), kind));
                if kind == StopKind::Off {
                    // It also reaches motors without a place.
                    self.world.truth.iter_mut().for_each(|truth| truth.is_off = true);
                }
                (self.world.stops_all, self.world.stop_all_call) = (true, number);
                is_put && !known.is_empty()
            }
            Call::Lift => {
                self.master.lift_stop();
                let were = self.is_any_stopped();
                self.world.stops_all = false;
                for truth in &mut self.world.truth {
                    (truth.is_stopped, truth.is_off) = (false, false);
                }
                were
            }
            Call::LiftOf(at) => {
                self.master.lift_stop_of(motor_at(at.into()));
                let stops_all = self.world.stops_all;
                let truth = &mut self.world.truth[usize::from(at)];
                let was = std::mem::take(&mut truth.is_stopped);
                truth.is_off &= stops_all;
                was
            }
            Call::Broadcast => self.broadcast(with_token(ReadMultiTurnAngle, token), Self::all()),
            Call::TorqueAll => {
                let command = Torque { current: Current::from_raw(number.into()) };
                self.broadcast(command, Self::all())
            }
            Call::ShutdownAll => self.end_all(with_token(Shutdown, token), Self::all()),
            Call::ShutdownAllUnheard => {
                // The next command to all does not wait for the answers of motors without a place.
                let is_known = self.master.motors() == Self::all();
                is_known && self.end_all(with_token(Shutdown, token), MotorSet::EMPTY)
            }
            Call::HoldAll => self.end_all(with_token(Stop, token), Self::all()),
            Call::BusDown => {
                self.master.handle_bus_down(self.world.now);
                self.world.is_cut()
            }
        }
    }

    fn all() -> MotorSet {
        (0..N).map(motor_at).collect()
    }

    fn is_any_stopped(&self) -> bool {
        self.world.stops_all || self.world.truth.iter().any(|truth| truth.is_stopped)
    }

    fn request<C: Command>(&mut self, at: u8, command: C) -> bool {
        let data = command.encode();
        let asked: Result<Ticket<C>, RequestError> =
            self.master.request(motor_at(at.into()), command);
        let Ok(ticket) = asked else { return false };
        let open = Open { ticket: ticket.id(), data };
        self.world.truth[usize::from(at)].open = Some(open);
        true
    }

    fn broadcast<C: Command>(&mut self, command: C, expected: MotorSet) -> bool {
        let is_put = self.master.broadcast(command, expected) == Ok(());
        if is_put {
            self.world.broadcast = Some(self.world.calls);
        }
        is_put
    }

    fn end_all<C: Command>(&mut self, command: C, expected: MotorSet) -> bool {
        let kind = StopKind::by(command.kind()).expect("it ends motion");
        let is_put = self.broadcast(command, expected);
        let number = self.world.calls;
        for motor in 0..N {
            let truth = &mut self.world.truth[motor];
            truth.all_call = number;
            if is_put && kind == StopKind::Off {
                // A hold in flight becomes an off, too.
                truth.stop_kind = Some(kind);
            }
            self.ends_motion(motor, kind);
        }
        is_put
    }

    /// Notes that a command ends the motion of a motor.
    fn ends_motion(&mut self, motor: usize, kind: StopKind) -> bool {
        let truth = &mut self.world.truth[motor];
        truth.last_stop = self.world.calls;
        truth.is_wanted_sent = false;
        // If a stop in force has switched the motor off and a newer command holds it, the caller wants both, and the
        // manual does not say which counts.
        truth.wants = Some(kind).filter(|_| !truth.is_off || kind == StopKind::Off);
        true
    }

    /// Notes a stop. If one of the same kind is in flight, nothing changes: until that is over nothing moves, even if
    /// it was lifted. A motor that was switched off stays off.
    fn stops(&mut self, motor: usize, kind: StopKind) {
        let number = self.world.calls;
        let truth = &mut self.world.truth[motor];
        let is_off = kind == StopKind::Off || truth.is_off;
        let kind = if is_off { StopKind::Off } else { StopKind::Hold };
        if !truth.is_stopping && truth.is_told_for_all(kind) {
            (truth.is_stopping, truth.stop_kind, truth.stop_call) =
                (true, Some(kind), truth.all_call);
        }
        let goes_on = truth.is_stopping && truth.stop_kind == Some(kind);
        (truth.is_off, truth.wants, truth.stop_kind) = (is_off, Some(kind), Some(kind));
        truth.last_stop = number;
        if !goes_on {
            (truth.is_stopping, truth.is_wanted_sent) = (true, false);
            truth.stop_call = number;
        }
    }
}

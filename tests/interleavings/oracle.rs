//! What must hold for each offered packet, for each event, and at the end.

use myactuator_protocol_core::master::{Event, Master, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Data, MotorId, Packet};

use super::search::Broken;
use super::state::State;
use super::world::{self, Open, World, call_of, motor_at, motor_of, moves};

/// The longest that anything may take in a world without faults: requests that wait for late replies, and after them a
/// stop that was overtaken.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

impl<const N: usize> State<N> {
    /// An offered packet must not be older than a stop or than a newer set-point, and must not move a stopped motor.
    /// Returns the call to which it belongs.
    pub(super) fn check_offered(&mut self, packet: &Packet) -> Result<u8, Broken> {
        let call = call_of(packet);
        self.check_kind_of_stop(packet)?;
        let stops_all = self.world.stops_all;
        let Some(truth) = motor_of(packet).and_then(|motor| self.world.truth_of(motor)) else {
            let is_wrong = |truth: &world::Truth| truth.is_stopped || call < truth.last_stop;
            let is_stopped = stops_all || self.world.truth.iter().any(is_wrong);
            if moves(packet) && is_stopped {
                return Err("all are moved, and one is stopped".into());
            }
            let is_of_stop_all = world::stops(packet) && call == 0;
            return Ok(if is_of_stop_all { self.world.stop_all_call } else { call });
        };
        if moves(packet) {
            if stops_all || truth.is_stopped {
                return Err("a stopped motor is moved".into());
            }
            if call < truth.last_stop {
                return Err("motion is sent that is older than a stop".into());
            }
            let bit = 1 << call;
            if packet.data[0] == 0xA8 && truth.moves_sent & bit != 0 {
                return Err("a relative move is sent twice".into());
            }
            if truth.set_points_sent >= bit && packet.data[0] != 0xA8 {
                return Err("a set-point is sent after itself or a newer one".into());
            }
        }
        Ok(if world::stops(packet) && call == 0 { truth.call_of_stop() } else { call })
    }

    /// An older hold must not switch on a motor that something newer has switched off. An older Shutdown must not let
    /// go of a motor that something newer holds.
    fn check_kind_of_stop(&self, packet: &Packet) -> Result<(), Broken> {
        let Some(kind) = world::kind_of_stop(packet) else { return Ok(()) };
        let mut of = self.world.truth.iter().enumerate();
        let is_undone = of.any(|(index, truth)| {
            let is_to_it = motor_of(packet).is_none_or(|motor| motor == motor_at(index));
            is_to_it && truth.is_wanted_sent && truth.wants.is_some_and(|wanted| wanted != kind)
        });
        if is_undone { Err(format!("an older {kind:?} undoes a newer one")) } else { Ok(()) }
    }

    /// Each event must be true.
    pub(super) fn told(&mut self, event: &Event) -> Result<(), Broken> {
        match *event {
            Event::Reply { ticket, data, .. } => {
                let motor = ticket.motor();
                let open = self.close(motor, |open| open.ticket == ticket)?;
                self.check_answer(&open.data, &data)?;
                match data[0] {
                    0x80 | 0x81 => self.check_heard(motor, call_of_data(&open.data)),
                    _ => Ok(()),
                }
            }
            Event::Sent { ticket, .. } | Event::Failed { ticket, .. } => {
                self.close(ticket.motor(), |open| open.ticket == ticket).map(|_| ())
            }
            Event::BroadcastReply { reply, .. } => {
                let Some(call) = self.world.broadcast else {
                    return Err("a broadcast that is over is answered".into());
                };
                let data = reply.encode();
                // The answer to a stop has no values. Feedback may also belong to a stream.
                let is_any =
                    matches!(data[0], 0x80 | 0x81 | 0xA1) || self.world.is_doubled(data[0]);
                let is_its = is_any || self.world.was_cut || call_of_data(&data) == call;
                if is_its { Ok(()) } else { Err("a broadcast is given another's answer".into()) }
            }
            Event::BroadcastDone { .. } => match self.world.broadcast.take() {
                Some(_) => Ok(()),
                None => Err("a broadcast is over twice".into()),
            },
            Event::StopConfirmed { motor } => self.check_confirmed(motor),
            Event::StopUnconfirmed { .. } => Err("a stop is not confirmed".into()),
            _ => Ok(()),
        }
    }

    fn close(&mut self, motor: MotorId, is_it: impl Fn(&Open) -> bool) -> Result<Open, Broken> {
        let open = self.world.truth_of(motor).and_then(|truth| truth.open.take());
        open.filter(is_it).ok_or_else(|| "an outcome of a request that is not open".into())
    }

    fn check_answer(&self, asked: &Data, answer: &Data) -> Result<(), Broken> {
        let byte = answer[0];
        let may_be_older = self.world.is_doubled(byte) || self.world.was_cut;
        if call_of_data(asked) != call_of_data(answer) && !may_be_older {
            return Err("a request is given another's answer".into());
        }
        let may_be_untold = self.world.lost_master_untold || self.world.is_doubled(byte);
        if !World::says_done(answer) && !may_be_untold {
            return Err("the echo of an ignored command is given as its answer".into());
        }
        Ok(())
    }

    fn check_confirmed(&mut self, motor: MotorId) -> Result<(), Broken> {
        let Some(truth) = self.world.truth_of(motor) else { return Ok(()) };
        let stop = truth.call_of_stop();
        let taken = truth.stop_taken.take();
        if !std::mem::take(&mut truth.is_stopping) && std::mem::take(&mut truth.all_call) == 0 {
            return Err("a stop is confirmed that nobody waits for".into());
        }
        self.check_heard(motor, stop)?;
        match taken {
            // An off is confirmed, not a pending hold of all.
            Some((_, StopKind::Off)) => Ok(()),
            _ => self.check_held(motor),
        }
    }

    /// The drive must have heard this stop after the last motion that is older.
    fn check_heard(&self, motor: MotorId, stop: u8) -> Result<(), Broken> {
        let Some(truth) = self.world.truth.get(motor.index()) else { return Ok(()) };
        let heard = truth.stop_heard;
        let is_older = |frame: &world::Frame| {
            let is_to_it = motor_of(&frame.packet).is_none_or(|to| to == motor);
            moves(&frame.packet) && is_to_it && frame.call < stop
        };
        let is_stop_doubled = self.world.is_stop_doubled();
        if heard < stop && !is_stop_doubled && !self.world.was_cut {
            return Err("a stop is confirmed, and not heard".into());
        }
        if !is_stop_doubled && self.world.commands.iter().any(is_older) {
            return Err("a stop is confirmed, and older motion is still to come".into());
        }
        Ok(())
    }

    /// If a motor has confirmed a hold, nothing older may let it go.
    fn check_held(&self, motor: MotorId) -> Result<(), Broken> {
        let Some(truth) = self.world.truth.get(motor.index()) else { return Ok(()) };
        let lets_go = |frame: &world::Frame| {
            let is_to_it = motor_of(&frame.packet).is_none_or(|to| to == motor);
            is_to_it && world::kind_of_stop(&frame.packet) == Some(StopKind::Off)
        };
        if truth.wants == Some(StopKind::Hold) && self.world.commands.iter().any(lets_go) {
            return Err("a hold is confirmed, and a Shutdown is still to come".into());
        }
        Ok(())
    }

    pub(super) fn check_over(&self, since: Instant) -> Result<(), Broken> {
        if self.world.now - since > LONGEST_WAIT {
            return Err("it takes too long".into());
        }
        if self.world.broadcast.is_some() {
            return Err("a broadcast hangs".into());
        }
        if self.master.is_anything_in_flight() {
            return Err("something is in flight for ever".into());
        }
        for truth in &self.world.truth {
            if truth.open.is_some() {
                return Err("a request hangs".into());
            }
            if truth.is_stopping {
                return Err("a stop hangs".into());
            }
            let is_heard = truth.stop_heard >= truth.stop_call || self.world.is_stop_doubled();
            if truth.is_stopped && !is_heard {
                return Err("a stopped motor moves".into());
            }
            let is_other =
                truth.heard.is_some_and(|heard| truth.wants.is_some_and(|it| it != heard));
            if truth.is_stopped && truth.last_stop == truth.stop_call && is_other {
                return Err("a motor is off and was to be held, or the other way round".into());
            }
        }
        Ok(())
    }
}

fn call_of_data(data: &Data) -> u8 {
    data[4]
}

/// Checks `poll_at`: if there is nothing to do now, it is later, and there is nothing to do before it.
pub(crate) fn check_poll_at<const N: usize>(
    master: &Master<N>,
    now: Instant,
) -> Result<(), Broken> {
    let mut master = master.clone();
    master.handle_timeout(now);
    while master.poll_event().is_some() {}
    if master.poll_transmit(now).is_some() {
        return Ok(());
    }
    let at = master.poll_at();
    if at.is_some_and(|at| at <= now) {
        return Err("poll_at is not after now, and there is nothing to do".into());
    }
    let soon = now + Duration::from_millis(20);
    let before = at.unwrap_or(soon).min(soon).as_micros() - 1;
    let before = Instant::from_micros(before);
    master.handle_timeout(before);
    if master.poll_transmit(before).is_some() {
        return Err("something is sent before poll_at".into());
    }
    if master.poll_event().is_some() {
        return Err("something is reported before poll_at".into());
    }
    Ok(())
}

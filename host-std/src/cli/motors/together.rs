//! One command to several motors at the same time. It takes as long as the slowest motor.

use myactuator_host_std::open::BusError;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::Command;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::{LONGEST_TURN, Runner};
use myactuator_protocol_core::master::{Failure, MotorSet, Patience, Ticket};

use super::moving::{LONGEST_OUTAGE, LONGEST_WAIT};
use super::session::Session;

/// The results.
pub(super) struct Together<R> {
    /// For each motor, in order: its reply, or why there is none.
    pub(super) outcomes: Vec<(MotorId, Result<R, String>)>,
    /// The last error of the bus. The other motors are still asked.
    pub(super) failure: Option<BusError>,
}

struct Asked<C: Command> {
    motor: MotorId,
    /// `None` until the request was accepted.
    ticket: Option<Ticket<C>>,
    outcome: Option<Result<C::Reply, String>>,
}

impl Session {
    /// Sends this to each of these motors. Retries on a bus that fails, for [`LONGEST_OUTAGE`].
    pub(super) fn ask_each<C: Command + Copy>(
        &mut self,
        motors: MotorSet,
        command: C,
        patience: Option<Patience>,
    ) -> Together<C::Reply> {
        let begun = self.master.awake();
        let asked = motors.iter().map(|motor| Asked { motor, ticket: None, outcome: None });
        let mut asked: Vec<Asked<C>> = asked.collect();
        let mut failure = None;
        while asked.iter().any(|asked| asked.outcome.is_none()) {
            let waited = self.master.awake() - begun;
            let is_open = |asked: &&mut Asked<C>| asked.outcome.is_none();
            for asked in asked.iter_mut().filter(is_open).filter(|asked| asked.ticket.is_none()) {
                match self.put(asked.motor, command, patience) {
                    Ok(ticket) => asked.ticket = Some(ticket),
                    // An earlier request to it is in flight.
                    Err(RequestError::Busy) if waited < LONGEST_TURN => {}
                    Err(error) => asked.outcome = Some(Err(error.to_string())),
                }
            }
            let open = asked.iter_mut().filter(is_open);
            match self.master.poll() {
                Ok(Some(event)) => open.for_each(|asked| {
                    let outcome = asked.ticket.and_then(|ticket| ticket.outcome(&event));
                    asked.outcome = outcome.map(|it| it.map_err(|failure| failure.to_string()));
                }),
                Err(error) if waited > LONGEST_OUTAGE => {
                    failure = Some(error);
                    open.for_each(|asked| {
                        asked.outcome = Some(Err(Failure::BusDown.to_string()));
                    });
                }
                // One refused frame must not hold up those of the others.
                idle => {
                    failure = idle.err().or(failure);
                    let soon = self.master.now() + LONGEST_WAIT;
                    self.master.idle(soon);
                }
            }
        }
        let outcomes = asked.into_iter().filter_map(|asked| Some((asked.motor, asked.outcome?)));
        Together { outcomes: outcomes.collect(), failure }
    }

    fn put<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
    ) -> Result<Ticket<C>, RequestError> {
        let master = self.master.master();
        match patience {
            Some(patience) => master.request_with(motor, command, patience),
            None => master.request(motor, command),
        }
    }
}

//! The loop over CAN.

use embedded_can::{ErrorKind, Frame, blocking, nb};

use crate::io::clock::Clock;
use crate::io::runner::{RETRY_AFTER, Runner, STUCK_AFTER};
use crate::master::{Config, Event, Master};
use crate::time::Instant;
use crate::wire::can;

/// Frames that one round takes at the most, so that a babbling bus cannot keep it.
pub(super) const FRAMES_A_ROUND: usize = 64;

/// Runs a [`Master`] on a CAN controller.
///
/// ```no_run
/// # use myactuator_protocol_core::io::{CanMaster, Clock, Runner};
/// # use myactuator_protocol_core::command::ReadMultiTurnAngle;
/// # use myactuator_protocol_core::{MotorId, master::Config};
/// # fn firmware(can: impl embedded_can::nb::Can<Error = core::convert::Infallible>, clock: impl Clock)
/// # -> Result<(), Box<dyn std::error::Error>> {
/// let mut arm = CanMaster::<_, _, 8>::new(can, clock, Config::CAN);
/// let elbow = MotorId::new(3)?;
/// let reading = arm.ask(elbow, ReadMultiTurnAngle)?;
/// let degrees = reading.angle.degrees();
/// # let _ = degrees; Ok(()) }
/// ```
#[derive(Debug)]
pub struct CanMaster<C, K, const N: usize> {
    can: C,
    clock: K,
    master: Master<N>,
    /// Since when the bus has not taken what is offered to it.
    stuck_since: Option<Instant>,
}

impl<C: nb::Can, K: Clock, const N: usize> CanMaster<C, K, N> {
    /// A loop on this controller, timed by this clock.
    pub fn new(can: C, clock: K, config: Config) -> Self {
        Self { can, clock, master: Master::new(config), stuck_since: None }
    }

    /// The controller and the clock back.
    pub fn release(self) -> (C, K) {
        (self.can, self.clock)
    }

    fn receive(&mut self, now: Instant) -> Result<Option<Event>, C::Error> {
        for _ in 0..FRAMES_A_ROUND {
            match self.can.receive() {
                Ok(frame) => {
                    let event = self.master.handle_frame(&can::decode(&frame), now);
                    if event.is_some() {
                        return Ok(event);
                    }
                }
                Err(::nb::Error::WouldBlock) => break,
                Err(::nb::Error::Other(error)) => {
                    note_failed_receive(&mut self.master, &error, now);
                    return Err(error);
                }
            }
        }
        Ok(None)
    }

    fn transmit(&mut self, now: Instant) -> Result<(), C::Error> {
        while let Some(packet) = self.master.poll_transmit(now) {
            // A HAL that refuses eight bytes is no CAN HAL; nothing can be sent on it.
            let Some(frame) = can::encode::<C::Frame>(&packet) else { return Ok(()) };
            match self.can.transmit(&frame) {
                Ok(pushed_out) => {
                    self.stuck_since = None;
                    self.master.handle_transmitted(now);
                    take_back(&mut self.master, pushed_out.as_ref());
                }
                Err(::nb::Error::WouldBlock) => {
                    if now - *self.stuck_since.get_or_insert(now) > STUCK_AFTER {
                        self.master.handle_bus_down(now);
                    }
                    return Ok(());
                }
                Err(::nb::Error::Other(error)) => {
                    self.stuck_since = None;
                    self.master.handle_bus_down(now);
                    return Err(error);
                }
            }
        }
        Ok(())
    }
}

impl<C: nb::Can, K: Clock, const N: usize> Runner<N> for CanMaster<C, K, N> {
    type Error = C::Error;

    fn master(&mut self) -> &mut Master<N> {
        &mut self.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, C::Error> {
        let now = self.clock.now();
        // What was received comes first, so that the caller's answer to it is there when the next
        // command is chosen.
        match self.receive(now) {
            Ok(None) => {}
            Ok(event) => return Ok(event),
            Err(error) => {
                // Some controllers report a bad state with each look: no stop waits for its end.
                let _ = self.transmit(now);
                return Err(error);
            }
        }
        self.master.handle_timeout(now);
        self.transmit(now)?;
        Ok(self.master.poll_event())
    }

    fn idle(&mut self, until: Instant) {
        let deadline = self.master.poll_at().map_or(until, |at| at.min(until));
        // Nothing else tells when a controller takes again what it has refused.
        let now = self.clock.now();
        let is_refused = self.stuck_since.is_some() && self.master.poll_transmit(now).is_some();
        let deadline = if is_refused { deadline.min(now + RETRY_AFTER) } else { deadline };
        self.clock.idle(deadline);
    }
}

/// The controller reports an error in place of a frame.
pub(super) fn note_failed_receive<const N: usize>(
    master: &mut Master<N>,
    error: &impl embedded_can::Error,
    now: Instant,
) {
    master.handle_timeout(now);
    // A frame that was overwritten says nothing about the bus; anything else may.
    if error.kind() != ErrorKind::Overrun {
        master.handle_bus_down(now);
    }
}

/// A frame had to make way for another in the controller: it is the master's again.
pub(super) fn take_back<const N: usize>(master: &mut Master<N>, pushed_out: Option<&impl Frame>) {
    if let Some(can::Received::Packet(packet)) = pushed_out.map(can::decode) {
        master.handle_pushed_out(&packet);
    }
}

/// Makes a blocking CAN driver fit [`CanMaster`].
///
/// `receive` of such a driver waits for a frame; one that waits for ever stalls the loop when a
/// drive is silent. Give it a time-out, and have `is_timeout` say which of its errors is that.
#[derive(Debug)]
pub struct BlockingCan<C, F> {
    can: C,
    is_timeout: F,
}

impl<C: blocking::Can, F: Fn(&C::Error) -> bool> BlockingCan<C, F> {
    /// The driver, and which of its errors is a time-out.
    pub const fn new(can: C, is_timeout: F) -> Self {
        Self { can, is_timeout }
    }
}

impl<C: blocking::Can, F: Fn(&C::Error) -> bool> BlockingCan<C, F> {
    fn error(&self, error: C::Error) -> ::nb::Error<C::Error> {
        if (self.is_timeout)(&error) { ::nb::Error::WouldBlock } else { ::nb::Error::Other(error) }
    }
}

impl<C: blocking::Can, F: Fn(&C::Error) -> bool> nb::Can for BlockingCan<C, F> {
    type Frame = C::Frame;
    type Error = C::Error;

    fn transmit(&mut self, frame: &C::Frame) -> ::nb::Result<Option<C::Frame>, C::Error> {
        self.can.transmit(frame).map(|()| None).map_err(|error| self.error(error))
    }

    fn receive(&mut self) -> ::nb::Result<C::Frame, C::Error> {
        self.can.receive().map_err(|error| self.error(error))
    }
}

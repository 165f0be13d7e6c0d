//! The loop over CAN.

use embedded_can::{Error as _, ErrorKind, blocking, nb};

use crate::io::clock::Clock;
use crate::io::pump::{Port, Pump};
use crate::io::runner::Runner;
use crate::master::{Config, Event, Master};
use crate::time::Instant;
use crate::wire::can;

/// Runs a [`Master`] on a CAN controller. What its driver should report, and what not, is told
/// [there](crate::io#what-a-driver-reports).
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
    pump: Pump<N>,
}

impl<C: nb::Can, K: Clock, const N: usize> CanMaster<C, K, N> {
    /// A loop on this controller, timed by this clock. The configuration has to say if the clock is
    /// [coarse](Config::for_clock_step).
    pub fn new(can: C, clock: K, config: Config) -> Self {
        Self { can, clock, pump: Pump::new(config.on_can()) }
    }

    /// Returns the controller and the clock.
    pub fn release(self) -> (C, K) {
        (self.can, self.clock)
    }
}

impl<C: nb::Can, K: Clock, const N: usize> Runner<N> for CanMaster<C, K, N> {
    type Error = C::Error;

    fn master(&mut self) -> &mut Master<N> {
        &mut self.pump.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, C::Error> {
        if let Some(event) = self.pump.left_event() {
            return Ok(Some(event));
        }
        let event = self.pump.round(&mut CanPort(&mut self.can), self.clock.now())?;
        Ok(event.or_else(|| self.pump.master.poll_event()))
    }

    fn idle(&mut self, until: Instant) {
        self.pump.idle(&self.clock, until);
    }
}

/// How many frames a controller is given in a row: more than a master has to send at once. Without this bound a
/// controller that hands a frame back for each that it takes would keep the loop for ever.
const FRAMES_IN_A_ROW: u8 = 64;

/// How many disturbed frames are passed over in a round. A controller that reports more may do so at each look.
const MOST_DISTURBED: u8 = 8;

/// A controller, as the pump sees it.
pub(super) struct CanPort<'a, C>(pub(super) &'a mut C);

impl<C: nb::Can, const N: usize> Port<N> for CanPort<'_, C> {
    type Error = C::Error;

    fn receive(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<Option<Event>, C::Error> {
        let mut disturbed = 0;
        while pump.looks_again() {
            match self.0.receive() {
                Ok(frame) => {
                    let event = pump.master.handle_frame(&can::decode(&frame), now);
                    if event.is_some() {
                        return Ok(event);
                    }
                }
                Err(::nb::Error::WouldBlock) => break,
                Err(::nb::Error::Other(error))
                    if is_of_one_frame(error.kind()) && disturbed < MOST_DISTURBED =>
                {
                    disturbed += 1;
                }
                Err(::nb::Error::Other(error)) => return Err(error),
            }
        }
        Ok(None)
    }

    fn transmit(&mut self, pump: &mut Pump<N>, now: Instant) -> Result<(), C::Error> {
        let Pump { master, refusals, .. } = pump;
        for _ in 0..FRAMES_IN_A_ROW {
            let Some(packet) = master.poll_transmit(now) else { break };
            // A HAL that refuses eight bytes is no CAN HAL; nothing can be sent on it.
            let Some(frame) = can::encode::<C::Frame>(&packet) else { break };
            match self.0.transmit(&frame) {
                Ok(pushed_out) => {
                    refusals.end();
                    master.handle_transmitted(now);
                    // A frame that had to make way is the master's again.
                    if let Some(can::Received::Packet(packet)) =
                        pushed_out.as_ref().map(can::decode)
                    {
                        master.handle_pushed_out(&packet);
                    }
                }
                Err(::nb::Error::WouldBlock) => {
                    if refusals.note(now) {
                        master.handle_bus_down(now);
                    }
                    return Ok(());
                }
                Err(::nb::Error::Other(error)) => return Err(error),
            }
        }
        refusals.pause();
        Ok(())
    }

    fn is_overrun(error: &C::Error) -> bool {
        error.kind() == ErrorKind::Overrun
    }
}

/// Whether an error says only that one frame was disturbed. Whoever has sent that frame sends it again.
const fn is_of_one_frame(error: ErrorKind) -> bool {
    use ErrorKind::{Acknowledge, Bit, Crc, Form, Stuff};
    matches!(error, Bit | Stuff | Crc | Form | Acknowledge)
}

/// Adapts a blocking CAN driver to [`CanMaster`].
///
/// The `receive` of such a driver waits for a frame. If it waits for ever, the loop stalls when a drive is silent. Give
/// it a time-out, and let `is_timeout` say which of its errors is that.
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

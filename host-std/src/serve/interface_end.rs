//! The CAN bus on a CAN interface of Linux.

use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use embedded_can::Frame;
use embedded_can::nb::Can as _;
use myactuator_protocol_core::wire::can::SimpleFrame;
use socketcan::CanFrame;

use super::{End, Notice, ServeError};
use crate::port::{PortError, SocketCan};
use crate::sim::bus::can::CanPort;

/// The most frames that wait for the interface; then the oldest is dropped.
const MOST_WAITING: usize = 256;
/// So many frames are taken in while time stands; more wait in the socket, as far as it has room.
const MOST_HELD: usize = 1 << 16;
/// After how long to try a frame again for which the interface had no room: its queue does not say when it has.
const TRY_AGAIN: Duration = Duration::from_millis(1);

/// A bridge: whatever is on one bus is sent on the other.
#[derive(Debug)]
pub(super) struct InterfaceEnd {
    socket: SocketCan,
    port: CanPort,
    /// From outside, for the simulated bus.
    inward: Option<SimpleFrame>,
    /// From the simulated bus, for outside.
    outward: VecDeque<CanFrame>,
    /// In lock-step, what was taken in.
    held: Option<VecDeque<CanFrame>>,
    /// It was reported that the real bus carries nothing.
    is_outage_told: bool,
}

impl InterfaceEnd {
    pub(super) fn new(socket: SocketCan, port: CanPort) -> Self {
        let (inward, outward, held) = (None, VecDeque::new(), None);
        Self { socket, port, inward, outward, held, is_outage_told: false }
    }

    /// The next frame from outside.
    fn receive(&mut self) -> nb::Result<CanFrame, PortError> {
        match &mut self.held {
            Some(held) => held.pop_front().ok_or(nb::Error::WouldBlock),
            None => self.socket.receive(),
        }
    }

    /// How many frames the port has for outside.
    fn received(&self) -> usize {
        self.port.world().controller(self.port.station()).received
    }

    fn pump_inward(&mut self) -> Result<(), ServeError> {
        loop {
            if let Some(frame) = self.inward {
                match self.port.transmit(&frame) {
                    Err(nb::Error::WouldBlock) => return Ok(()),
                    // A controller that is bus-off loses it, as a real one would.
                    Ok(_) | Err(nb::Error::Other(_)) => self.inward = None,
                }
            }
            match self.receive() {
                Ok(frame) => self.inward = convert(&frame),
                Err(nb::Error::WouldBlock) => return Ok(()),
                Err(nb::Error::Other(error)) => return Err(error.into()),
            }
        }
    }

    fn pump_outward(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        // What comes meanwhile waits for the next call: on a slow computer there would be no end of it.
        for _ in 0..self.received() {
            let Ok(frame) = self.port.receive() else { break };
            if self.outward.len() >= MOST_WAITING {
                self.outward.pop_front();
            }
            self.outward.extend(convert::<CanFrame>(&frame));
        }
        while let Some(frame) = self.outward.front() {
            match self.socket.transmit(frame) {
                Ok(_) => self.is_outage_told = false,
                Err(nb::Error::WouldBlock) => break,
                Err(nb::Error::Other(error)) if error.is_outage() => {
                    if !std::mem::replace(&mut self.is_outage_told, true) {
                        notify(Notice::Outage(error));
                    }
                }
                Err(nb::Error::Other(error)) => return Err(error.into()),
            }
            self.outward.pop_front();
        }
        Ok(())
    }
}

impl End for InterfaceEnd {
    fn source(&self) -> Option<BorrowedFd<'_>> {
        self.inward.is_none().then(|| self.socket.as_fd())
    }

    fn hold(&mut self) {
        self.held = Some(VecDeque::new());
    }

    fn take_in(&mut self) -> Result<(), ServeError> {
        let Some(held) = &mut self.held else { return Ok(()) };
        Ok(fill(held, || self.socket.receive())?)
    }

    fn pump(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        self.pump_inward()?;
        self.pump_outward(notify)
    }

    fn patience(&mut self) -> Option<Duration> {
        if self.received() > 0 {
            Some(Duration::ZERO)
        } else {
            (!self.outward.is_empty()).then_some(TRY_AGAIN)
        }
    }
}

/// Keeps what is received, up to a limit.
fn fill<F, E>(
    held: &mut VecDeque<F>,
    mut receive: impl FnMut() -> nb::Result<F, E>,
) -> Result<(), E> {
    while held.len() < MOST_HELD {
        match receive() {
            Ok(frame) => held.push_back(frame),
            Err(nb::Error::WouldBlock) => break,
            Err(nb::Error::Other(error)) => return Err(error),
        }
    }
    Ok(())
}

/// The same frame in another type; `None` if that type does not have its kind.
fn convert<F: Frame>(frame: &impl Frame) -> Option<F> {
    if frame.is_remote_frame() {
        F::new_remote(frame.id(), frame.dlc())
    } else {
        F::new(frame.id(), frame.data())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::can;

    #[test]
    fn interface_holds_65536_frames_while_time_stands() {
        let (mut held, mut sent) = (VecDeque::new(), 0..70_000);
        let mut next = || sent.next().ok_or(nb::Error::<()>::WouldBlock);
        for _ in 0..2 {
            fill(&mut held, &mut next).unwrap();
            assert_eq!((held.len(), held.back()), (65_536, Some(&65_535)));
        }
        held.clear();
        fill(&mut held, next).unwrap();
        assert_eq!((held.len(), held.front()), (70_000 - 65_536, Some(&65_536)));
        assert_eq!(fill(&mut held, || Err::<i32, _>(nb::Error::Other(()))), Err(()));
    }

    #[test]
    fn frames_go_through_as_they_are() {
        for text in ["141#9C00000000000000", "7FF#", "1FFFFFFF#A55A", "141#R8", "00000141#R"] {
            let frame = can::parse_line(text).unwrap();
            let outside: CanFrame = convert(&frame).unwrap();
            let back: SimpleFrame = convert(&outside).unwrap();
            assert_eq!(can::frame(&back), text);
        }
    }
}

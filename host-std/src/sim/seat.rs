//! A drive's seat on a simulated bus.

use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::{self, SimpleFrame};
use myactuator_protocol_core::wire::rs485::{Fed, Frame, Receiver};

use super::SimulatedDrive;
use super::bus::Node;
use super::shaft::ShaftFile;

/// How long a drive is without power when its node is reset.
const POWER_CYCLE: Duration = Duration::from_millis(1);

/// A drive and, on RS485, what it has received of a frame so far.
#[derive(Debug)]
pub(super) struct Seat {
    pub(super) drive: SimulatedDrive,
    pub(super) receiver: Receiver,
    /// Where its shaft is kept, if that is to outlive the process.
    pub(super) shaft: Option<ShaftFile>,
    /// Whether mechanics lead its shaft.
    pub(super) is_led: bool,
}

impl Drop for Seat {
    /// The supply goes with the simulation: a drive keeps its turns then, and the shaft is where it is.
    fn drop(&mut self) {
        if let Some(shaft) = &mut self.shaft {
            self.drive.power_off(self.drive.clock());
            shaft.keep(self.drive.plant().place());
        }
    }
}

impl Seat {
    /// Lets the drive's own time go on to `now`, however far that is.
    pub(super) fn catch_up(&mut self, now: Instant) {
        loop {
            let before = self.drive.clock();
            self.drive.advance(now);
            if self.drive.clock() == before {
                break;
            }
        }
        if let Some(shaft) = &mut self.shaft {
            shaft.follow(self.drive.plant().place(), now);
        }
    }

    fn power_cycle(&mut self, now: Instant) {
        self.receiver.reset();
        self.drive.power_off(now);
        self.drive.power_on(now + POWER_CYCLE);
    }
}

impl Node<SimpleFrame> for Seat {
    fn accepts(&self, frame: &SimpleFrame) -> bool {
        // Real drives ignore short, remote and foreign frames.
        matches!(can::decode(frame), can::Received::Packet(packet) if self.drive.is_addressed(packet.channel))
    }

    fn handle_frame(&mut self, frame: &SimpleFrame, now: Instant) {
        if let can::Received::Packet(packet) = can::decode(frame) {
            self.catch_up(now);
            self.drive.handle_packet(&packet, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<SimpleFrame> {
        can::encode(&self.drive.poll_transmit(now)?)
    }

    fn poll_at(&self) -> Option<Instant> {
        self.drive.poll_at()
    }

    fn advance(&mut self, now: Instant) {
        self.catch_up(now);
    }

    fn bit_rate(&self) -> Option<u32> {
        self.drive.bit_rate()
    }

    fn reset(&mut self, now: Instant) {
        self.power_cycle(now);
    }
}

impl Node<Vec<u8>> for Seat {
    fn handle_frame(&mut self, bytes: &Vec<u8>, now: Instant) {
        for &byte in bytes {
            if let Fed::Frame(frame) = self.receiver.feed(byte) {
                self.catch_up(now);
                self.drive.handle_packet(&frame.as_command(), now);
            }
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<Vec<u8>> {
        let packet = self.drive.poll_transmit(now)?;
        Some(Frame::from_packet(&packet)?.encode().to_vec())
    }

    fn poll_at(&self) -> Option<Instant> {
        self.drive.poll_at()
    }

    fn advance(&mut self, now: Instant) {
        self.catch_up(now);
    }

    fn bit_rate(&self) -> Option<u32> {
        self.drive.bit_rate()
    }

    fn reset(&mut self, now: Instant) {
        self.power_cycle(now);
    }
}

//! CAN interfaces of Linux.

use std::fs;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use embedded_can::nb::Can;
use rustix::io::Errno;
use socketcan::errors::{ControllerProblems, ErrorCause};
use socketcan::{CanAddr, CanFrame, CanSocket, Socket as _, SocketOptions as _};

use crate::port::clock::Backlog;
use crate::port::outage::Outage;
use crate::port::{HostClock, PortError};

/// The kernel's error reports that say whether the bus carries frames: time-out, controller state,
/// missing acknowledgement, bus-off, restarted (`linux/can/error.h`).
const REPORTS: u32 = 0x001 | 0x004 | 0x020 | 0x040 | 0x100;
/// The most reports and frames that one call reads.
const READS_A_CALL: usize = 64;

/// A CAN interface of Linux, such as `can0`: a raw socket that never blocks.
///
/// Error reports of the controller are not returned as frames. From a report that the bus carries
/// nothing (bus-off, no acknowledgement, error-passive while sending, transmit time-out), or an error of the interface
/// (down, gone), until a frame comes or the controller recovers, [`transmit`](Can::transmit) returns an error for all
/// that could move a motor. Reads and stops are still sent.
///
/// A master that streams set-points sends no read then either: it takes each refused set-point for a bus that is down.
/// So after such an error stop the motors: their answers are frames.
///
/// # What the kernel may send late
/// Such a report comes some two milliseconds after the bus has failed. Frames that were handed over before it wait in
/// the kernel and in the controller, and are sent when the bus is back. Only `ip link set can0 down` takes them back;
/// closing the socket does not. This socket keeps its own share small (the smallest send buffer that the kernel allows,
/// about six frames) and never waits for room. To leave fewer:
/// - make the interface's queue short: `ip link set can0 txqueuelen 3`;
/// - or let the controller try each frame only once: `ip link set can0 type can one-shot on`. Then a frame that
///   is not acknowledged, or that loses arbitration, is gone, and the master asks again.
///
/// Protect the drives on their own side as well, with communication-loss protection (0xB3).
#[derive(Debug)]
pub struct SocketCan {
    socket: CanSocket,
    interface: String,
    outage: Outage,
    backlog: Backlog,
}

impl SocketCan {
    /// Opens an interface that is up. The socket does not receive the frames that it sends.
    ///
    /// # Errors
    /// [`PortError`]: Linux has no CAN sockets; there is no such interface; it is not for CAN, or it is down;
    /// or the user may not open it.
    pub fn open(interface: &str) -> Result<Self, PortError> {
        let address = CanAddr::from_iface(interface).map_err(|error| match errno(&error) {
            Some(Errno::NODEV) => {
                PortError::NoSuchInterface { name: interface.to_owned(), there: interfaces() }
            }
            _ => PortError::os(interface, error),
        })?;
        let socket = CanSocket::open_addr(&address).map_err(|error| match errno(&error) {
            Some(Errno::NODEV) => PortError::NotCan(interface.to_owned()),
            _ => explain(interface, error),
        })?;
        let configured = socket
            .set_nonblocking(true)
            .and_then(|()| socket.set_recv_own_msgs(false))
            .and_then(|()| socket.set_error_filter(REPORTS))
            // The kernel raises this to the least that it allows.
            .and_then(|()| socket.as_raw_socket().set_send_buffer_size(1));
        configured.map_err(|error| PortError::os(interface, error))?;
        // A socket on an interface that is down opens, with a pending error.
        match socket.as_raw_socket().take_error() {
            Ok(None) => {}
            Ok(Some(error)) | Err(error) => return Err(explain(interface, error)),
        }
        Ok(Self {
            socket,
            interface: interface.to_owned(),
            outage: Outage::default(),
            backlog: Backlog::default(),
        })
    }

    /// A clock that waits for this interface.
    ///
    /// # Errors
    /// [`PortError::Os`] if the operating system has no file descriptor left.
    pub fn clock(&self) -> Result<HostClock, PortError> {
        HostClock::with_backlog(self, self.backlog.clone())
            .map_err(|error| PortError::os(&self.interface, error))
    }

    /// Returns why the interface fails, and notes that it may carry nothing now.
    fn failed(&mut self, error: io::Error) -> PortError {
        let why = explain(&self.interface, error);
        self.outage.begin(why.clone());
        why
    }

    /// Returns what an error of the kernel means for a frame that was to be sent.
    fn not_sent(&mut self, error: io::Error) -> nb::Error<PortError> {
        let errno = errno(&error);
        self.backlog.set(errno == Some(Errno::AGAIN));
        match errno {
            // The socket's own buffer is full, or the interface's queue, which other programs fill as well.
            Some(Errno::AGAIN | Errno::NOBUFS) => nb::Error::WouldBlock,
            _ => self.failed(error).into(),
        }
    }

    fn note(&mut self, report: ErrorCause) {
        match verdict(report, &self.interface) {
            Some(Err(why)) => self.outage.begin(why),
            Some(Ok(())) => self.outage.end(),
            None => {}
        }
    }
}

impl AsFd for SocketCan {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl Can for SocketCan {
    type Frame = CanFrame;
    type Error = PortError;

    fn transmit(&mut self, frame: &CanFrame) -> nb::Result<Option<CanFrame>, PortError> {
        self.outage.admit(frame)?;
        self.backlog.set(false);
        match self.socket.write_frame(frame) {
            Ok(()) => Ok(None),
            Err(error) => Err(self.not_sent(error)),
        }
    }

    fn receive(&mut self) -> nb::Result<CanFrame, PortError> {
        // A frame that found no room is offered again after this, if it is still wanted.
        self.backlog.set(false);
        for _ in 0..READS_A_CALL {
            match self.socket.read_frame() {
                Ok(CanFrame::Error(reports)) => {
                    reports.into_error().into_iter().for_each(|report| self.note(report));
                }
                Ok(frame) => {
                    self.outage.end();
                    return Ok(frame);
                }
                Err(error) => match errno(&error) {
                    Some(Errno::AGAIN) => break,
                    Some(Errno::INTR) => {}
                    _ => return Err(self.failed(error).into()),
                },
            }
        }
        Err(nb::Error::WouldBlock)
    }
}

/// The kernel's number of a CAN interface among the kinds of link (`linux/if_arp.h`).
const LINK_IS_CAN: &str = "280";

/// The CAN interfaces of this machine.
fn interfaces() -> Vec<String> {
    let is_can = |name: &String| {
        let kind = fs::read_to_string(format!("/sys/class/net/{name}/type"));
        kind.is_ok_and(|kind| kind.trim() == LINK_IS_CAN)
    };
    let links = fs::read_to_string("/proc/net/dev").unwrap_or_default();
    let names = links.lines().filter_map(|line| line.split_once(':'));
    names.map(|(name, _)| name.trim().to_owned()).filter(is_can).collect()
}

/// What a report says of the bus: that it carries frames again, or why it carries none.
fn verdict(report: ErrorCause, interface: &str) -> Option<Result<(), PortError>> {
    match report {
        ErrorCause::BusOff => Some(Err(PortError::BusOff(interface.to_owned()))),
        ErrorCause::NoAck | ErrorCause::TransmitTimeout => {
            Some(Err(PortError::NotAcknowledged(interface.to_owned())))
        }
        // Missing acknowledgements alone bring a controller to this state, and no further.
        ErrorCause::Controller(state) if state.contains(ControllerProblems::TX_PASSIVE) => {
            Some(Err(PortError::NotAcknowledged(interface.to_owned())))
        }
        ErrorCause::Controller(state) if state.contains(ControllerProblems::ACTIVE) => Some(Ok(())),
        ErrorCause::Restarted => Some(Ok(())),
        _ => None,
    }
}

fn errno(error: &io::Error) -> Option<Errno> {
    Errno::from_io_error(error)
}

fn explain(interface: &str, error: io::Error) -> PortError {
    let name = || interface.to_owned();
    match errno(&error) {
        Some(Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT) => PortError::NoCanSupport,
        Some(Errno::NETDOWN) => PortError::InterfaceDown(name()),
        Some(Errno::NODEV | Errno::NXIO) => PortError::InterfaceGone(name()),
        Some(Errno::PERM | Errno::ACCESS) => PortError::NotPermitted(name()),
        _ => PortError::os(interface, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::fd::OwnedFd;
    use std::os::unix::net::UnixDatagram;

    use embedded_can::{Frame as _, StandardId};
    use myactuator_protocol_core::io::Clock as _;
    use myactuator_protocol_core::time::Duration;

    const MOMENT: Duration = Duration::from_millis(20);

    #[test]
    fn error_reports_distinguish_a_dead_bus_from_a_disturbed_one() {
        let state = |bits| ErrorCause::Controller(ControllerProblems::from_bits_truncate(bits));
        for (report, text) in [
            (ErrorCause::BusOff, "bus off"),
            (ErrorCause::NoAck, "not acknowledged"),
            (ErrorCause::TransmitTimeout, "not acknowledged"),
            // linux/can/error.h: 0x01 receive overflow, 0x08 warning, 0x10 and 0x20 passive while
            // receiving and sending, 0x40 active again.
            (state(0x20), "not acknowledged"),
            (state(0x30), "not acknowledged"),
            (state(0x10), "nothing"),
            (state(0x08), "nothing"),
            (state(0x01), "nothing"),
            (state(0x40), "recovered"),
            (ErrorCause::Restarted, "recovered"),
            (ErrorCause::LostArbitration(3), "nothing"),
        ] {
            let verdict = match verdict(report, "can7") {
                Some(Err(PortError::BusOff(_))) => "bus off",
                Some(Err(PortError::NotAcknowledged(_))) => "not acknowledged",
                Some(Err(other)) => panic!("{report}: {other}"),
                Some(Ok(())) => "recovered",
                None => "nothing",
            };
            assert_eq!(verdict, text, "{report}");
        }
    }

    /// A socket that takes frames as an interface does, and its other end.
    fn made() -> (SocketCan, UnixDatagram) {
        let (end, other) = UnixDatagram::pair().unwrap();
        (can_on(end), other)
    }

    fn can_on(end: UnixDatagram) -> SocketCan {
        let socket = CanSocket::from(OwnedFd::from(end));
        socket.set_nonblocking(true).unwrap();
        let (outage, backlog) = (Outage::default(), Backlog::default());
        SocketCan { socket, interface: "can7".to_owned(), outage, backlog }
    }

    /// Commands to motor 1 without values.
    fn frames<const M: usize>(bytes: [u8; M]) -> [CanFrame; M] {
        let to = StandardId::new(0x141).unwrap();
        bytes.map(|byte| CanFrame::new(to, &[byte, 0, 0, 0, 0, 0, 0, 0]).unwrap())
    }

    /// The socket refused a frame, which has become too old since, and has room again.
    #[test]
    fn idle_clock_does_not_spin_when_a_refused_frame_was_dropped() {
        let (mut can, other) = made();
        let clock = can.clock().unwrap();
        let read = CanFrame::new(StandardId::new(0x141).unwrap(), &[0x92; 8]).unwrap();
        while can.transmit(&read).is_ok() {}
        other.set_nonblocking(true).unwrap();
        while other.recv(&mut [0; 16]).is_ok() {}
        // The rounds of a master that has nothing to send.
        let (begun, mut rounds) = (clock.now(), 0);
        while clock.now() - begun < MOMENT {
            assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
            clock.idle(begun + MOMENT);
            rounds += 1;
        }
        assert!(rounds < 10, "{rounds}");
    }

    /// Nobody has received since.
    #[test]
    fn idle_clock_does_not_spin_when_a_refused_frame_was_sent() {
        let (mut can, other) = made();
        let clock = can.clock().unwrap();
        let [read] = frames([0x92]);
        while can.transmit(&read).is_ok() {}
        other.set_nonblocking(true).unwrap();
        while other.recv(&mut [0; 16]).is_ok() {}
        can.transmit(&read).unwrap();
        let begun = clock.now();
        clock.idle(begun + MOMENT);
        assert!(clock.now() - begun >= MOMENT);
    }

    /// As `linux/can.h` lays it out; bit 29 of the identifier marks a report.
    fn from_kernel(id: u32) -> Vec<u8> {
        [&id.to_ne_bytes()[..], &[8, 0, 0, 0], &[0; 8]].concat()
    }

    #[test]
    fn moves_are_refused_after_an_error_report_until_a_frame_arrives() {
        let (mut can, other) = made();
        let [torque, stop] = frames([0xA1, 0x81]);
        can.transmit(&torque).unwrap();
        // No acknowledgement, which the receiver hears of in its turn.
        other.send(&from_kernel(0x2000_0020)).unwrap();
        assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
        let Err(nb::Error::Other(PortError::NotAcknowledged(_))) = can.transmit(&torque) else {
            panic!("a dead bus gets what moves")
        };
        can.transmit(&stop).unwrap();
        other.send(&from_kernel(0x241)).unwrap();
        assert_eq!(can.receive().unwrap().id(), StandardId::new(0x241).unwrap().into());
        can.transmit(&torque).unwrap();
    }

    #[test]
    fn moves_are_refused_after_an_error_report_until_the_controller_recovers() {
        let (mut can, other) = made();
        let [torque] = frames([0xA1]);
        // No acknowledgement; restarted.
        for (report, is_refused) in [(0x2000_0020, true), (0x2000_0100, false)] {
            other.send(&from_kernel(report)).unwrap();
            assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
            assert_eq!(can.transmit(&torque).is_err(), is_refused);
        }
    }

    /// The socket itself has room, so waiting for that would end at once.
    #[test]
    fn full_queue_of_the_interface_is_no_outage_and_is_not_waited_for() {
        let (mut can, _other) = made();
        assert!(matches!(can.not_sent(Errno::NOBUFS.into()), nb::Error::WouldBlock));
        let clock = can.clock().unwrap();
        let begun = clock.now();
        clock.idle(begun + MOMENT);
        assert!(clock.now() - begun >= MOMENT);
        let [torque] = frames([0xA1]);
        can.transmit(&torque).unwrap();
    }

    #[test]
    fn receive_returns_during_a_flood_of_error_reports() {
        let (mut can, other) = made();
        for _ in 0..READS_A_CALL {
            // Lost arbitration.
            other.send(&from_kernel(0x2000_0002)).unwrap();
        }
        other.send(&from_kernel(0x241)).unwrap();
        assert!(matches!(can.receive(), Err(nb::Error::WouldBlock)));
        can.receive().unwrap();
    }

    /// The kernel reports once that an interface was taken down, to the first call that sends or receives. Here the
    /// other end goes, and comes back.
    #[test]
    fn moves_are_refused_after_a_send_error_until_a_frame_arrives() {
        let folder = tempfile::tempdir().unwrap();
        let [port, gone, back] = ["port", "gone", "back"].map(|name| folder.path().join(name));
        let end = UnixDatagram::bind(&port).unwrap();
        let reconnect = end.try_clone().unwrap();
        let mut can = can_on(end);
        let other = UnixDatagram::bind(&gone).unwrap();
        reconnect.connect(&gone).unwrap();
        drop(other);
        let [torque, stop] = frames([0xA1, 0x81]);
        assert!(matches!(can.transmit(&torque), Err(nb::Error::Other(_))));
        let other = UnixDatagram::bind(&back).unwrap();
        reconnect.connect(&back).unwrap();
        assert!(matches!(can.transmit(&torque), Err(nb::Error::Other(_))), "stale");
        can.transmit(&stop).unwrap();
        other.send_to(&from_kernel(0x241), &port).unwrap();
        can.receive().unwrap();
        can.transmit(&torque).unwrap();
    }

    /// A receive gets the kernel's one error here, and the interface is up again before anything is sent. The socket
    /// gets it because its other end connects elsewhere with unread data.
    #[test]
    fn moves_are_refused_after_a_receive_error_until_a_frame_arrives() {
        let folder = tempfile::tempdir().unwrap();
        let [port, end, away] = ["port", "end", "away"].map(|name| folder.path().join(name));
        let [socket, other, _away] = [&port, &end, &away].map(|it| UnixDatagram::bind(it).unwrap());
        socket.connect(&end).unwrap();
        other.connect(&port).unwrap();
        let mut can = can_on(socket);
        let [torque, stop] = frames([0xA1, 0x81]);
        can.transmit(&stop).unwrap();
        other.connect(&away).unwrap();
        other.connect(&port).unwrap();
        assert!(matches!(can.receive(), Err(nb::Error::Other(_))));
        assert!(matches!(can.transmit(&torque), Err(nb::Error::Other(_))), "stale");
        can.transmit(&stop).unwrap();
        other.send(&from_kernel(0x241)).unwrap();
        can.receive().unwrap();
        can.transmit(&torque).unwrap();
    }

    #[test]
    fn a_clock_wakes_up_when_a_socket_that_took_nothing_has_room() {
        let (mut can, other) = made();
        let clock = can.clock().unwrap();
        let read = CanFrame::new(StandardId::new(0x141).unwrap(), &[0x92; 8]).unwrap();
        while can.transmit(&read).is_ok() {}
        other.set_nonblocking(true).unwrap();
        while other.recv(&mut [0; 16]).is_ok() {}
        let begun = clock.now();
        clock.idle(begun + Duration::from_secs(10));
        assert!(clock.now() - begun < Duration::from_secs(5));
    }

    #[test]
    fn kernel_errors_become_sentences() {
        let text = |errno: Errno| explain("can7", errno.into()).to_string();
        assert!(text(Errno::AFNOSUPPORT).contains("no CAN sockets"));
        assert!(text(Errno::NETDOWN).contains("\"can7\" is down"));
        assert!(text(Errno::NODEV).contains("\"can7\" has gone"));
        assert!(text(Errno::PERM).contains("may not open \"can7\""));
    }
}

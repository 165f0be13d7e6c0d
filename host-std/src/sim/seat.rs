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
    /// The file with the place of its shaft, if that is to outlive the process.
    pub(super) shaft: Option<ShaftFile>,
    /// Whether mechanics lead its shaft.
    pub(super) is_led: bool,
    /// When its supply comes back, while its power is cycled.
    pub(super) off_until: Option<Instant>,
}

impl Drop for Seat {
    /// The supply goes off with the simulation: then a drive stores its turns, and the place of the shaft is noted.
    fn drop(&mut self) {
        if let Some(shaft) = &mut self.shaft {
            self.drive.power_off(self.drive.clock());
            shaft.keep(self.drive.plant().place());
        }
    }
}

impl Seat {
    /// Advances the drive's own time to `now`, however far that is.
    pub(super) fn catch_up(&mut self, now: Instant) {
        if let Some(on) = self.off_until.take_if(|on| *on <= now) {
            self.advance_to(on);
            self.drive.power_on(on);
        }
        self.advance_to(now);
        if !self.drive.is_powered() {
            self.receiver.reset();
        }
        if let Some(shaft) = &mut self.shaft {
            shaft.follow(self.drive.plant().place(), now);
        }
    }

    fn advance_to(&mut self, now: Instant) {
        loop {
            let before = self.drive.clock();
            self.drive.advance(now);
            if self.drive.clock() == before {
                break;
            }
        }
    }

    fn power_cycle(&mut self, now: Instant) {
        self.catch_up(now);
        self.drive.power_off(now);
        self.receiver.reset();
        self.off_until = Some(now + POWER_CYCLE);
    }

    fn asks_at(&self) -> Option<Instant> {
        [self.drive.poll_at(), self.off_until].into_iter().flatten().min()
    }
}

impl Node<SimpleFrame> for Seat {
    fn accepts(&self, frame: &SimpleFrame) -> bool {
        // A new id may take effect at this instant, which the drive does not know before it has the frame.
        let may_change = self.drive.stored_settings().id != self.drive.id();
        // Real drives ignore short, remote and foreign frames.
        matches!(can::decode(frame), can::Received::Packet(packet)
            if may_change || self.drive.is_addressed(packet.channel))
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
        self.asks_at()
    }

    fn advance(&mut self, now: Instant) {
        self.catch_up(now);
    }

    fn bit_rate(&self) -> Option<u32> {
        self.drive.bit_rate()
    }

    fn is_powered(&self) -> bool {
        self.drive.is_powered()
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
        self.asks_at()
    }

    fn advance(&mut self, now: Instant) {
        self.catch_up(now);
    }

    fn bit_rate(&self) -> Option<u32> {
        self.drive.bit_rate()
    }

    fn is_powered(&self) -> bool {
        self.drive.is_powered()
    }

    fn reset(&mut self, now: Instant) {
        self.power_cycle(now);
    }
}

#[cfg(test)]
mod tests {
    use embedded_can::nb::Can as _;
    use myactuator_protocol_core::command::{FunctionControl, ReadStatus1, Reset};
    use myactuator_protocol_core::drive::{Event, Quirks};
    use myactuator_protocol_core::io::Runner as _;
    use myactuator_protocol_core::{MotorId, Packet};

    use super::*;
    use crate::sim::bus::faults::Babble;
    use crate::sim::bus::trace;
    use crate::sim::{CanFleet, DriveLog, Fleet, LogEvent, LogRecord};

    /// A drive that is to have id 2 after its start, which has begun, and its log.
    fn starting() -> (CanFleet, DriveLog) {
        let quirks = Quirks { slow_boot: true, ..Quirks::default() };
        let fleet = Fleet::new(1).quirks(quirks).on_can(1_000_000).unwrap();
        fleet.world.run_for(Duration::from_secs(10));
        let mut master = fleet.master::<1>();
        master.ask(MotorId::MIN, FunctionControl::SetCanId(id(2))).unwrap();
        let log = DriveLog::of(&fleet);
        master.ask(MotorId::MIN, Reset).unwrap();
        fleet.world.run_for(Duration::from_millis(1));
        (fleet, log)
    }

    fn id(number: u8) -> MotorId {
        MotorId::new(number).unwrap()
    }

    /// When frames end if a question to the new id is sent now, as long as a start takes.
    fn ends(fleet: &CanFleet) -> Vec<u64> {
        let question: Packet = ReadStatus1.packet(id(2));
        let log = fleet.world.log();
        fleet.world.port().transmit(&can::encode(&question).unwrap()).unwrap();
        fleet.world.run_for(Duration::from_millis(10));
        let whole = |it: &trace::Record<_>| matches!(it.event, trace::Event::Carried { .. });
        log.take().iter().filter(|it| whole(it)).map(|it| it.at_ns).collect()
    }

    #[test]
    fn a_drive_hears_its_new_id_in_the_instant_in_which_its_start_ends() {
        let (fleet, mut log) = starting();
        fleet.world.run_for(Duration::from_secs(10));
        let is_start = |it: &LogRecord| it.event == LogEvent::Drive(Event::Started);
        let started = log.poll(fleet.world.now()).into_iter().find(is_start).unwrap().at;
        let asked = fleet.world.now();
        let lasts = Duration::from_micros(ends(&fleet)[0] / 1_000 - asked.as_micros());
        for (late_us, answers) in [(0, 0), (1, 1), (2, 1)] {
            let (fleet, _log) = starting();
            let ended = Instant::from_micros(started.as_micros() - 1 + late_us);
            fleet.world.run_until(ended - lasts);
            let ends = ends(&fleet);
            assert_eq!(ends[0], ended.as_micros() * 1_000);
            assert_eq!(ends.len(), 1 + answers, "{late_us} us after the last deaf one");
        }
    }

    #[test]
    fn power_cycle_takes_a_drives_power_for_a_millisecond() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        fleet.world.run_for(Duration::from_micros(12_345));
        fleet.world.reset(fleet.drives[0].station());
        let is_powered = || fleet.drives[0].with(|it| it.state().powered);
        let is_ahead = || fleet.drives[0].with(|it| it.clock()) > fleet.world.now();
        assert_eq!((is_powered(), is_ahead()), (false, false));
        fleet.world.run_for(Duration::from_micros(999));
        assert_eq!((is_powered(), is_ahead()), (false, false));
        fleet.world.run_for(Duration::from_micros(1));
        assert_eq!((is_powered(), is_ahead()), (true, false));
        // Nobody needs to look at it for that.
        let back = fleet.world.now() + POWER_CYCLE;
        fleet.world.reset(fleet.drives[0].station());
        fleet.world.run_for(Duration::from_micros(1));
        assert_eq!(fleet.world.next_event(), Some(back));
        fleet.world.run_for(Duration::from_secs(3));
        assert!(fleet.master::<1>().ask(MotorId::MIN, ReadStatus1).is_ok());
    }

    #[test]
    fn frames_waiting_to_be_read_or_sent_are_lost_with_the_power() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let ask = can::encode(&ReadStatus1.packet(MotorId::MIN)).unwrap();
        let answers = |cycled: Option<u64>| {
            let (mut port, drive) = (fleet.world.port(), fleet.drives[0].station());
            // It answers within 1 ms, and the answer gets to its controller 20 ms later.
            fleet.world.slow_down(drive, Duration::from_millis(20));
            port.transmit(&ask).unwrap();
            for ms in [10, 30] {
                fleet.world.run_for(Duration::from_millis(ms));
                if cycled == Some(ms) {
                    fleet.world.reset(if ms == 10 { drive } else { port.station() });
                }
            }
            port.receive().is_ok()
        };
        assert_eq!([None, Some(10), Some(30)].map(answers), [true, false, false]);
    }

    enum Loss {
        None,
        Cycle,
        ByHand,
    }

    #[test]
    fn partly_received_frame_is_lost_with_the_drives_power() {
        let line = Fleet::new(1).on_rs485(1_000_000).unwrap();
        let whole = Frame::from_packet(&ReadStatus1.packet(MotorId::MIN)).unwrap().encode();
        let power = |is_on: bool| {
            line.drives[0].with(|it| {
                let now = it.clock();
                if is_on { it.power_on(now) } else { it.power_off(now) }
            });
        };
        let answers = |loss: Loss| {
            let mut port = line.world.port();
            let (first, rest) = whole.split_at(5);
            embedded_io::Write::write_all(&mut port, first).unwrap();
            line.world.run_for(Duration::from_micros(100));
            match loss {
                Loss::None => {}
                Loss::Cycle => line.world.reset(line.drives[0].station()),
                Loss::ByHand => power(false),
            }
            line.world.run_for(Duration::from_micros(1_000));
            power(true);
            line.world.run_for(Duration::from_micros(1_000));
            embedded_io::Write::write_all(&mut port, rest).unwrap();
            line.world.run_for(Duration::from_millis(10));
            embedded_io::ReadReady::read_ready(&mut port).unwrap()
        };
        assert_eq!([Loss::None, Loss::Cycle, Loss::ByHand].map(answers), [true, false, false]);
    }

    /// An emergency stop that takes the motors' supply leaves a bus like this.
    #[test]
    fn unpowered_drives_acknowledge_nothing_so_frames_wait_for_the_power() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let (log, port) = (fleet.world.log(), fleet.world.port());
        let power = |is_on: bool| {
            for drive in &fleet.drives {
                drive.with(|it| {
                    let now = it.clock();
                    if is_on { it.power_on(now) } else { it.power_off(now) }
                });
            }
        };
        let carried = || {
            fleet.world.run_for(Duration::from_millis(20));
            let whole = |it: &&trace::Record<_>| matches!(it.event, trace::Event::Carried { .. });
            log.take().iter().filter(whole).count()
        };
        power(false);
        let ask = can::encode(&ReadStatus1.packet(MotorId::MIN)).unwrap();
        port.clone().transmit(&ask).unwrap();
        assert_eq!((carried(), fleet.world.controller(port.station()).queued), (0, 1));
        // A cable that is mended does not bring the power back.
        fleet.world.cut(fleet.drives[0].station());
        fleet.world.mend(fleet.drives[0].station());
        assert_eq!(carried(), 0);
        power(true);
        assert_eq!(
            (carried(), fleet.world.controller(port.station()).queued),
            (2, 0),
            "the stale frame, and its answer"
        );
        // Nor does the power mend a cable.
        fleet.world.cut(fleet.drives[0].station());
        power(false);
        power(true);
        port.clone().transmit(&ask).unwrap();
        assert_eq!(carried(), 1, "the other drive acknowledges it");
    }

    #[test]
    fn power_cycle_without_supply_starts_no_drive_and_no_babble() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let (station, mut log) = (fleet.drives[0].station(), DriveLog::of(&fleet));
        fleet.drives[0].with(|it| it.plant_mut().force_supply_voltage_v(Some(0.0))).unwrap();
        fleet.world.run_for(Duration::from_millis(30));
        log.poll(fleet.world.now());
        let trace = fleet.world.log();
        let babble = Babble { interval: Duration::from_millis(1), frame: None };
        fleet.world.babble(station, Some(babble));
        fleet.world.reset(station);
        fleet.world.run_for(Duration::from_millis(30));
        let logged = log.poll(fleet.world.now());
        assert!(logged.iter().all(|it| it.event != LogEvent::Drive(Event::Started)), "{logged:?}");
        let sent = |it: &trace::Record<_>| matches!(it.event, trace::Event::Unacknowledged { .. });
        assert!(!trace.take().iter().any(sent));
    }
}

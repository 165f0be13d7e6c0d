//! The simulated CAN bus under the virtual clock. Times are counted by hand, in bits. At 1 Mbit/s a bit takes a
//! microsecond.

use embedded_can::{ExtendedId, Frame, Id, StandardId, nb::Can as _};
use myactuator_host_std::sim::bus::Node;
use myactuator_host_std::sim::bus::can::{
    CanError, CanPort, CanWorld, ControllerConfig, ErrorState, frame_bits,
};
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::trace::{Event, Record};
use myactuator_protocol_core::io::Clock;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::SimpleFrame;
use myactuator_tests::script::{Hand, Stage as _, broken, micros};
use proptest::prelude::*;

/// 112 bits for identifier 0x141. Other identifiers may have other stuff bits.
fn frame(id: u16) -> SimpleFrame {
    data_frame(id, &[0x55; 8])
}

fn data_frame(id: u16, data: &[u8]) -> SimpleFrame {
    SimpleFrame::new(StandardId::new(id).unwrap(), data).unwrap()
}

/// 111 bits, of which the last three are the intermission: no stuff bits.
pub(super) fn smooth() -> SimpleFrame {
    data_frame(0x61E, &[0x87, 0x87, 0x87, 0x87, 0x87, 0x66, 0x13, 0x87])
}

fn world() -> CanWorld {
    CanWorld::new(1_000_000, 1)
}

/// A bus with a master's port and a listener.
fn scene() -> (CanWorld, CanPort, Hand<SimpleFrame>) {
    let world = world();
    let listener = world.listener();
    (world.clone(), world.port(), listener)
}

fn ids(listener: &Hand<SimpleFrame>) -> Vec<u16> {
    let id = |frame: SimpleFrame| match frame.id() {
        Id::Standard(id) => id.as_raw(),
        Id::Extended(id) => panic!("{id:?}"),
    };
    listener.frames().into_iter().map(id).collect()
}

fn send(port: &mut CanPort, frame: SimpleFrame) {
    assert_eq!(port.transmit(&frame), Ok(None));
}

/// The length of a frame, counted bit by bit: slow, but plain.
fn counted_bits(frame: &SimpleFrame) -> u32 {
    let remote = u8::from(frame.is_remote_frame());
    let mut text = match frame.id() {
        Id::Standard(id) => format!("0{:011b}{remote}00", id.as_raw()),
        Id::Extended(id) => {
            let (high, low) = (id.as_raw() >> 18, id.as_raw() & 0x3_FFFF);
            format!("0{high:011b}11{low:018b}{remote}00")
        }
    };
    text += &format!("{:04b}", frame.dlc());
    for byte in frame.data() {
        text += &format!("{byte:08b}");
    }
    // ISO 11898-1: x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1.
    let mut crc = 0u16;
    for bit in text.chars() {
        let next = (bit == '1') != (crc & 0x4000 != 0);
        crc = crc << 1 & 0x7FFF;
        if next {
            crc ^= 0x4599;
        }
    }
    text += &format!("{crc:015b}");
    let mut line = String::new();
    for bit in text.chars() {
        line.push(bit);
        if line.ends_with("00000") {
            line.push('1');
        } else if line.ends_with("11111") {
            line.push('0');
        }
    }
    // Delimiter, acknowledge and its delimiter, end of frame, intermission.
    line.len() as u32 + 1 + 2 + 7 + 3
}

proptest! {
    #[test]
    fn every_frame_is_as_long_as_counted_bit_by_bit(
        raw in 0u32..0x2000_0000,
        extended: bool,
        remote: bool,
        data in proptest::collection::vec(prop_oneof![Just(0u8), Just(0xFF), any::<u8>()], 0..=8),
    ) {
        let id = if extended {
            Id::Extended(ExtendedId::new(raw).unwrap())
        } else {
            Id::Standard(StandardId::new(raw as u16 & 0x7FF).unwrap())
        };
        let frame = if remote {
            SimpleFrame::new_remote(id, data.len())
        } else {
            SimpleFrame::new(id, &data)
        };
        let frame = frame.unwrap();
        let bits = frame_bits(&frame);
        prop_assert_eq!(bits, counted_bits(&frame));
        if !extended && !remote && data.len() == 8 {
            prop_assert!((111..=135).contains(&bits), "{}", bits);
        }
    }
}

#[test]
fn a_frame_arrives_with_its_last_bit() {
    for (bit_rate, bit_us) in [(1_000_000, 1), (500_000, 2), (250_000, 4)] {
        let world = CanWorld::new(bit_rate, 1);
        let listener = world.listener();
        let mut port = world.port();
        send(&mut port, frame(0x141));
        send(&mut port, smooth());
        world.run_until(micros(1_000));
        // Three bits of intermission follow the arrival, before the next frame.
        let expected = [(109 * bit_us, frame(0x141)), ((112 + 108) * bit_us, smooth())];
        assert_eq!(listener.heard(), expected);
        // A port does not hear its own frames.
        assert_eq!(port.receive(), Err(nb::Error::WouldBlock));
        assert_eq!(world.controller(port.station()).queued, 0);
    }
}

#[test]
fn the_lowest_identifier_goes_first() {
    let extended = SimpleFrame::new(ExtendedId::new(0x141 << 18).unwrap(), &[1]).unwrap();
    let remote = SimpleFrame::new_remote(StandardId::new(0x141).unwrap(), 1).unwrap();
    for (sent, heard) in [
        ([frame(0x300), frame(0x141), frame(0x2FF)], [frame(0x141), frame(0x2FF), frame(0x300)]),
        // If identifiers begin alike, the standard data frame wins.
        ([extended, remote, frame(0x141)], [frame(0x141), remote, extended]),
    ] {
        let world = world();
        for frame in sent {
            world.sender([(10, frame)]);
        }
        let listener = world.listener();
        world.run_until(micros(1_000));
        assert_eq!(listener.frames(), heard);
    }
}

#[test]
fn a_frame_on_the_wire_is_not_interrupted() {
    let world = world();
    world.sender([(0, frame(0x7FF)), (0, frame(0x7FE))]);
    world.sender([(50, frame(0x001))]);
    let listener = world.listener();
    world.run_until(micros(1_000));
    // 0x7FE wins against 0x7FF, since both were in the mailboxes before the first bit.
    assert_eq!(ids(&listener), [0x7FE, 0x001, 0x7FF]);
}

#[test]
fn a_full_queue_would_block_until_a_frame_has_left() {
    let (world, mut port, _) = scene();
    for _ in 0..10 {
        send(&mut port, frame(0x141));
    }
    assert_eq!(port.transmit(&frame(0x141)), Err(nb::Error::WouldBlock));
    world.run_until(micros(108));
    assert_eq!(port.transmit(&frame(0x141)), Err(nb::Error::WouldBlock));
    // A clock idles until there is room.
    world.clock().idle(micros(5_000));
    assert_eq!(world.now(), micros(109));
    send(&mut port, frame(0x141));
    assert_eq!(port.transmit(&frame(0x141)), Err(nb::Error::WouldBlock));
}

#[test]
fn a_fifo_keeps_its_order_and_mailboxes_that_of_equal_identifiers() {
    for (config, sent) in [
        (ControllerConfig::SOCKETCAN, [0x300, 0x200, 0x100].map(frame)),
        (ControllerConfig::MAILBOXES, [3, 2, 1].map(|n| data_frame(0x141, &[n]))),
    ] {
        let world = world();
        let listener = world.listener();
        let mut port = world.port_with(config);
        sent.into_iter().for_each(|frame| send(&mut port, frame));
        world.run_until(micros(1_000));
        assert_eq!(listener.frames(), sent);
    }
}

#[test]
fn mailboxes_go_by_priority_and_give_way() {
    let world = world();
    let listener = world.listener();
    let mut port = world.port_with(ControllerConfig::MAILBOXES);
    send(&mut port, frame(0x300));
    world.run_until(micros(5));
    send(&mut port, frame(0x200));
    send(&mut port, frame(0x250));
    assert_eq!(port.transmit(&frame(0x260)), Err(nb::Error::WouldBlock));
    // 0x300 has an even lower priority, but is on the wire.
    assert_eq!(port.transmit(&frame(0x100)), Ok(Some(frame(0x250))));
    // Frames of equal priority keep their order, so none gives way to another.
    assert_eq!(port.transmit(&data_frame(0x200, &[])), Err(nb::Error::WouldBlock));
    world.run_until(micros(1_000));
    assert_eq!(ids(&listener), [0x300, 0x100, 0x200]);
}

#[test]
fn silence_makes_error_passive_and_nothing_worse() {
    let world = world();
    let log = world.log();
    let mut port = world.port();
    send(&mut port, smooth());
    let status = || world.controller(port.station());
    // An attempt takes 117 bits: 100 up to the acknowledge slot, then an error frame of 6 + 8 and an intermission of 3.
    // The last eleven bits of the frame do not come.
    for attempt in 0..16 {
        world.run_until(micros(attempt * 117 + 99));
        assert_eq!(u64::from(status().transmit_errors), attempt * 8);
        assert_eq!(status().state, ErrorState::Active);
        world.run_until(micros(attempt * 117 + 100));
        assert_eq!(u64::from(status().transmit_errors), attempt * 8 + 8);
    }
    assert_eq!(status().state, ErrorState::Passive);
    world.run_until(Instant::ZERO + Duration::from_secs(10));
    let starts = log.take().into_iter().map(|record| match record.event {
        Event::Unacknowledged { started_ns, .. } => started_ns / 1_000,
        other => panic!("{other:?}"),
    });
    // An error-passive sender waits for eight bits more.
    let starts: Vec<u64> = starts.skip(14).take(4).collect();
    assert_eq!(starts, [14 * 117, 15 * 117, 16 * 117 + 8, 17 * 117 + 16]);
    assert_eq!((status().transmit_errors, status().queued), (128, 1));
    // A listener joins: the next attempt succeeds.
    let listener = world.listener();
    world.run_for(Duration::from_millis(1));
    assert_eq!(listener.heard().len(), 1);
    assert_eq!((status().transmit_errors, status().queued), (127, 0));
    assert_eq!(status().state, ErrorState::Active);
}

fn times(records: &[Record<SimpleFrame>], event: &Event<SimpleFrame>) -> Vec<u64> {
    records.iter().filter(|record| record.event == *event).map(|record| record.at_ns).collect()
}

/// Sends a frame that breaks each time, until the controller leaves the bus.
fn break_until_bus_off(world: &CanWorld, port: &mut CanPort) {
    world.set_faults(Direction::ToNodes, FaultPlan { corrupt: 1.0, ..FaultPlan::NONE });
    send(port, frame(0x141));
    while world.controller(port.station()).state != ErrorState::BusOff {
        assert!(world.step());
    }
}

#[test]
fn errors_lead_to_bus_off_and_a_silent_bus_ends_it() {
    let (world, mut port, listener) = scene();
    let log = world.log();
    break_until_bus_off(&world, &mut port);
    // 32 times 8 is the first count above 255.
    assert_eq!(world.controller(port.station()).transmit_errors, 256);
    let records = log.take();
    assert_eq!(broken(&records).count(), 32);
    let [left] = times(&records, &Event::BusOff)[..] else { panic!("{records:?}") };
    assert_eq!(port.transmit(&frame(0x141)), Err(nb::Error::Other(CanError::BusOff)));

    world.set_faults(Direction::ToNodes, FaultPlan::NONE);
    world.run_for(Duration::from_millis(2));
    // The last error frame, 20 bits, and the intermission, 3, then 128 times 11 recessive bits.
    assert_eq!(times(&log.take(), &Event::Recovered), [left + (20 + 3 + 128 * 11) * 1_000]);
    let status = world.controller(port.station());
    assert_eq!((status.state, status.transmit_errors, status.queued), (ErrorState::Active, 0, 0));
    // What was queued is still sent.
    assert_eq!(ids(&listener), [0x141]);
}

#[test]
fn a_controller_that_is_bus_off_takes_no_part() {
    let world = CanWorld::new(1_000_000, 1);
    let (mut port, mut other) = (world.port(), world.port());
    break_until_bus_off(&world, &mut port);
    let counts = |port: &CanPort| {
        let status = world.controller(port.station());
        (status.transmit_errors, status.receive_errors)
    };
    assert_eq!((counts(&port), counts(&other)), ((256, 0), (0, 32)));
    // While bus-off it counts no errors of others and acknowledges nothing.
    send(&mut other, frame(0x142));
    while counts(&other).0 == 0 {
        assert!(world.step());
    }
    world.set_faults(Direction::ToNodes, FaultPlan::NONE);
    while counts(&other).0 == 8 {
        assert!(world.step());
    }
    assert_eq!((counts(&port), counts(&other)), ((256, 0), (16, 32)));
}

#[test]
fn a_busy_bus_ends_bus_off_later() {
    let (world, mut port, _listener) = scene();
    let log = world.log();
    break_until_bus_off(&world, &mut port);
    let left = times(&log.take(), &Event::BusOff)[0];
    // Frames without a gap. Each has one sequence of eleven recessive bits.
    let begin = left / 1_000 + 23;
    world.sender((0..300).map(|_| (begin, data_frame(0, &[]))));
    world.run_for(Duration::from_millis(20));
    // The 128th sequence ends with the 128th frame's intermission; 53 bits a frame.
    assert_eq!(times(&log.take(), &Event::Recovered), [(begin + 128 * 53) * 1_000]);
}

#[test]
fn the_same_frame_from_two_is_one_on_the_wire() {
    let world = world();
    let twins = [(); 2].map(|()| Hand::sending([(0, frame(0x300))]));
    let stations = twins.each_ref().map(|twin| world.attach(twin.node()));
    let listener = world.listener();
    world.run_until(micros(1_000));
    assert_eq!(listener.heard().len(), 1);
    for (twin, station) in twins.iter().zip(stations) {
        assert_eq!(world.controller(station).queued, 0);
        assert_eq!(twin.heard(), []);
    }
}

#[test]
fn one_identifier_with_different_data_goes_one_after_the_other() {
    let world = world();
    let sent = [data_frame(0x300, &[0x01; 8]), data_frame(0x300, &[0x00; 8])];
    for frame in sent {
        world.sender([(0, frame)]);
    }
    let listener = world.listener();
    world.run_until(micros(1_000));
    assert_eq!(listener.frames(), sent);
}

#[test]
fn a_receive_queue_overflows_and_counts() {
    let world = world();
    let config = ControllerConfig { receive_queue: 2, ..ControllerConfig::SOCKETCAN };
    let mut port = world.port_with(config);
    let sent = [1, 2, 3].map(|n| (0, data_frame(0x241, &[n])));
    world.sender(sent);
    world.run_until(micros(1_000));
    let status = world.controller(port.station());
    assert_eq!((status.received, status.overflows), (2, 1));
    assert_eq!(port.receive(), Ok(sent[0].1));
    assert_eq!(port.receive(), Ok(sent[1].1));
    assert_eq!(port.receive(), Err(nb::Error::WouldBlock));
}

#[test]
fn a_clock_idles_until_something_arrives() {
    let world = world();
    let mut port = world.port();
    world.sender([(1_000, frame(0x141))]);
    let clock = world.clock();
    clock.idle(micros(500));
    assert_eq!(clock.now(), micros(500));
    clock.idle(micros(5_000));
    assert_eq!(clock.now(), micros(1_109));
    assert!(port.receive().is_ok());
    clock.idle(micros(5_000));
    assert_eq!(clock.now(), micros(5_000));
    // A time that has passed changes nothing.
    clock.idle(micros(1));
    assert_eq!(clock.now(), micros(5_000));
}

#[test]
fn polling_costs_no_time() {
    let world = world();
    world.sender([(100, frame(0x141))]);
    let mut port = world.port();
    for _ in 0..1_000 {
        assert_eq!(port.receive(), Err(nb::Error::WouldBlock));
    }
    assert_eq!(world.now(), micros(0));
}

/// Has all its frames from the start. `poll_at` is the next time that it asks for.
struct Burst {
    frames: Vec<SimpleFrame>,
    poll_at: Option<Instant>,
}

impl Node<SimpleFrame> for Burst {
    fn handle_frame(&mut self, _: &SimpleFrame, _: Instant) {}

    fn poll_transmit(&mut self, _: Instant) -> Option<SimpleFrame> {
        self.frames.pop()
    }

    fn poll_at(&self) -> Option<Instant> {
        self.poll_at
    }
}

#[test]
fn a_node_is_asked_again_when_its_mailboxes_have_room() {
    let world = world();
    let listener = world.listener();
    let sent = [0, 1, 2, 3, 4, 5, 6, 7].map(|n| data_frame(0x241, &[n; 8]));
    world.attach(Burst { frames: sent.into_iter().rev().collect(), poll_at: None });
    world.run_until(micros(2_000));
    assert_eq!(listener.frames(), sent);
}

/// Accepts 0x142 only. Sends 0x242 after that frame, and 0x7FF after any other.
struct Filtered(Option<SimpleFrame>);

impl Node<SimpleFrame> for Filtered {
    fn accepts(&self, received: &SimpleFrame) -> bool {
        *received == frame(0x142)
    }

    fn handle_frame(&mut self, received: &SimpleFrame, _: Instant) {
        self.0 = Some(if *received == frame(0x142) { frame(0x242) } else { frame(0x7FF) });
    }

    fn poll_transmit(&mut self, _: Instant) -> Option<SimpleFrame> {
        self.0.take()
    }

    fn poll_at(&self) -> Option<Instant> {
        None
    }
}

#[test]
fn node_receives_only_frames_that_it_accepts() {
    let world = world();
    let listener = world.listener();
    world.attach(Filtered(None));
    let sent = [0x141, 0x142, 0x143].map(frame);
    world.sender([(100, sent[0]), (1_000, sent[1]), (2_000, sent[2])]);
    world.run_until(micros(5_000));
    let [first, second, third] = sent;
    assert_eq!(listener.frames(), [first, second, frame(0x242), third]);
}

#[test]
fn a_node_that_is_never_satisfied_does_not_stop_time() {
    let world = world();
    world.attach(Burst { frames: vec![], poll_at: Some(Instant::ZERO) });
    world.run_until(micros(1_000));
    assert_eq!(world.now(), micros(1_000));
}

#[test]
fn steps_go_from_event_to_event() {
    let world = world();
    assert!(!world.step());
    assert_eq!(world.next_event(), None);
    world.silent();
    let mut port = world.port();
    send(&mut port, frame(0x141));
    let mut times = Vec::new();
    while world.step() {
        times.push(world.now().as_micros());
    }
    times.dedup();
    // Start, end of frame, end of intermission.
    assert_eq!(times, [0, 109, 112]);
}

#[test]
fn a_world_too_slow_for_real_time_goes_on_slowly() {
    let world = world().in_real_time();
    let begun = std::time::Instant::now();
    world.every(Duration::from_micros(1), move |_| {
        std::thread::sleep(std::time::Duration::from_micros(20));
        // Each call makes up for at most half a second. Without that limit each would take twenty times as long as the
        // one before, and the last one minutes.
        assert!(begun.elapsed().as_secs() < 60, "it is held up");
    });
    let times = [(); 6].map(|()| world.now());
    assert!(times.is_sorted() && times[0] < times[5], "{times:?}");
}

#[test]
fn the_same_world_runs_in_real_time() {
    let world = world().in_real_time();
    world.mirror();
    let mut port = world.port();
    let before = world.now();
    let clock = world.clock();
    send(&mut port, frame(0x141));
    let mut elsewhere = port.clone();
    let answer = std::thread::spawn(move || {
        clock.idle(before + Duration::from_secs(60));
        elsewhere.receive()
    });
    // However slow this machine is, the answer cannot come before its bits.
    assert_eq!(answer.join().unwrap(), Ok(frame(0x141)));
    assert!(world.now() - before >= Duration::from_micros(220));
}

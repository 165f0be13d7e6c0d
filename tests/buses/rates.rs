//! Stations at different bit rates on one bus. Expected values are worked out by hand: on CAN in bits, of one
//! microsecond at 1 Mbit/s and two at 500 kbit/s; on RS485 from the samples that a receiver takes.

use embedded_can::{Frame as _, StandardId, nb::Can as _};
use embedded_io::{Read as _, ReadReady as _, Write as _};
use myactuator_host_std::sim::bus::StationId;
use myactuator_host_std::sim::bus::can::{CanPort, CanWorld, ErrorState};
use myactuator_host_std::sim::bus::rs485::{SerialPort, SerialWorld, TransceiverConfig};
use myactuator_host_std::sim::bus::trace::{Event, Record};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::SimpleFrame;
use myactuator_protocol_core::wire::rs485::{Fed, Receiver};
use myactuator_tests::script::{Hand, READ_PID, Stage as _, broken, micros};

use super::can::smooth;

const SLOW: u32 = 500_000;
const FAST: u32 = 1_000_000;

/// Transmit errors, receive errors, state.
fn counts(world: &CanWorld, station: StationId) -> (u16, u16, ErrorState) {
    let status = world.controller(station);
    (status.transmit_errors, status.receive_errors, status.state)
}

/// A bus at this rate with a master's port, a listener, and a stranger that listens at another rate.
fn can(bit_rate: u32, strange: u32) -> (CanWorld, CanPort, [StationId; 2], [Hand<SimpleFrame>; 2]) {
    let world = CanWorld::new(bit_rate, 1);
    let port = world.port();
    let hands = [(); 2].map(|()| Hand::listening());
    let stations = hands.each_ref().map(|hand| world.put(hand));
    world.set_bit_rate(stations[1], strange);
    (world, port, stations, hands)
}

fn starts_us(records: &[Record<SimpleFrame>]) -> Vec<u64> {
    let started = |record: &Record<_>| match record.event {
        Event::Broken { started_ns, .. } => Some(started_ns / 1_000),
        _ => None,
    };
    records.iter().filter_map(started).collect()
}

/// For each frame the stranger counts 1, because it cannot read it, and 8, because the others' error flags follow its
/// own. After 15 frames it has 128 and disturbs no more. The sender counts 8 for each frame: 120.
#[test]
fn a_stranger_breaks_fifteen_frames_and_is_error_passive_then() {
    for (bit_rate, strange, broken_after_us, attempt_us, last_us) in [
        // Six bits of the stranger. Then error frame and intermission: 23 bits of the slower.
        (FAST, SLOW, 12, 12 + 46, 108),
        (SLOW, FAST, 6, 6 + 46, 216),
    ] {
        let (world, mut port, [listener, stranger], [heard, misheard]) = can(bit_rate, strange);
        let log = world.log();
        port.transmit(&smooth()).unwrap();
        for attempt in 0..15 {
            world.run_until(micros(attempt * attempt_us + broken_after_us - 1));
            let state = counts(&world, stranger).2;
            assert_eq!(state, ErrorState::Active, "{attempt}");
            assert_eq!(u64::from(counts(&world, port.station()).0), attempt * 8);
            world.run_until(micros(attempt * attempt_us + broken_after_us));
            assert_eq!(u64::from(counts(&world, port.station()).0), attempt * 8 + 8);
        }
        assert_eq!(counts(&world, port.station()), (120, 0, ErrorState::Active));
        assert_eq!(counts(&world, listener), (0, 15, ErrorState::Active));
        assert_eq!(counts(&world, stranger), (0, 128, ErrorState::Passive));
        world.run_for(Duration::from_millis(2));
        assert_eq!(heard.heard(), [(15 * attempt_us + last_us, smooth())]);
        let expected: Vec<u64> = (0..15).map(|attempt| attempt * attempt_us).collect();
        assert_eq!(starts_us(&log.take()), expected);
        assert_eq!(counts(&world, port.station()), (119, 0, ErrorState::Active));
        assert_eq!(counts(&world, listener), (0, 14, ErrorState::Active));

        // From now on the stranger disturbs nobody.
        for _ in 0..5 {
            port.transmit(&smooth()).unwrap();
        }
        world.run_for(Duration::from_millis(2));
        assert_eq!((heard.heard().len(), misheard.heard()), (6, vec![]));
        assert_eq!(broken(&log.take()).count(), 0);
        assert_eq!(counts(&world, stranger), (0, 128, ErrorState::Passive));
    }
}

/// The fastest finds the error first, and the slowest signals it for longest, whatever their order.
#[test]
fn fastest_of_several_strangers_breaks_a_frame_and_slowest_ends_it() {
    for strangers in [[FAST, SLOW / 2], [SLOW / 2, FAST]] {
        let (world, mut port, ..) = can(SLOW, strangers[0]);
        let second = world.silent();
        world.set_bit_rate(second, strangers[1]);
        let log = world.log();
        port.transmit(&smooth()).unwrap();
        // Six bits of a microsecond; then 23 of four.
        world.run_until(micros(6 + 92));
        assert_eq!(counts(&world, port.station()).0, 8);
        world.run_until(micros(6 + 92 + 6));
        assert_eq!(starts_us(&log.take()), [0, 6 + 92]);
    }
}

/// All other stations run at another rate. They break 15 of its frames. After that nobody signals an error and nobody
/// acknowledges, so the sender becomes error-passive but not bus-off.
#[test]
fn sender_at_a_rate_of_its_own_is_not_heard_and_turns_error_passive() {
    let world = CanWorld::new(FAST, 1);
    let hands = [(); 2].map(|()| Hand::listening());
    let others = hands.each_ref().map(|hand| world.put(hand));
    let mut port = world.port();
    world.set_bit_rate(port.station(), SLOW);
    let log = world.log();
    port.transmit(&smooth()).unwrap();
    // 15 times 6 bits of the others and 23 of its own. Then 100 bits up to the acknowledge slot.
    world.run_until(micros(15 * (6 + 46) + 199));
    assert_eq!(counts(&world, port.station()), (120, 0, ErrorState::Active));
    world.run_until(micros(15 * (6 + 46) + 200));
    assert_eq!(counts(&world, port.station()), (128, 0, ErrorState::Passive));
    world.run_until(Instant::ZERO + Duration::from_secs(1));
    assert_eq!(counts(&world, port.station()), (128, 0, ErrorState::Passive));
    for (other, hand) in others.into_iter().zip(&hands) {
        assert_eq!(counts(&world, other), (0, 128, ErrorState::Passive));
        assert_eq!(hand.heard(), []);
    }
    let records = log.take();
    assert_eq!(broken(&records).count(), 15);
    assert!(records.iter().any(|record| matches!(record.event, Event::Unacknowledged { .. })));

    // No other station signals errors together with it any more, so a frame that it cannot read counts 1.
    let short = SimpleFrame::new(StandardId::new(1).unwrap(), &[]).unwrap();
    world.port().transmit(&short).unwrap();
    while hands[0].heard().is_empty() {
        assert!(world.step());
    }
    assert_eq!(counts(&world, port.station()), (128, 1, ErrorState::Passive));

    // A new rate restarts its controller and empties its queue.
    world.set_bit_rate(port.station(), FAST);
    assert_eq!(counts(&world, port.station()), (0, 0, ErrorState::Active));
    assert_eq!(world.controller(port.station()).queued, 0);
    port.transmit(&smooth()).unwrap();
    world.run_for(Duration::from_millis(1));
    for (other, hand) in others.into_iter().zip(&hands) {
        assert_eq!(hand.frames(), [short, smooth()]);
        assert_eq!(counts(&world, other), (0, 126, ErrorState::Active));
    }
}

/// The others hear good frames meanwhile, so they become error-active again and again and drive it to bus-off.
#[test]
fn a_sender_at_another_rate_goes_bus_off_where_others_talk() {
    let world = CanWorld::new(FAST, 1);
    world.listener();
    // Many frames that win arbitration. Each takes at least 47 bits and 3 of intermission.
    let short = SimpleFrame::new(StandardId::new(1).unwrap(), &[]).unwrap();
    world.sender((0..20_000).map(|at| (at * 60, short)));
    let mut port = world.port();
    world.set_bit_rate(port.station(), SLOW);
    let log = world.log();
    world.run_until(micros(1));
    port.transmit(&smooth()).unwrap();
    world.run_until(micros(1_000_000));
    let left = log.take().into_iter().find(|record| record.event == Event::BusOff);
    assert_eq!(left.map(|record| record.station), Some(port.station()));
}

/// At one rate they would be one frame on the wire. Here the second sender runs at another rate than the first sender
/// and the listener.
#[test]
fn the_same_frame_at_two_rates_is_two_frames() {
    let world = CanWorld::new(FAST, 1);
    let [first, second] = [(); 2].map(|()| world.sender([(10, smooth())]));
    world.set_bit_rate(second, SLOW);
    let listener = world.listener();
    world.run_until(micros(100_000));
    assert_eq!(listener.frames(), [smooth()]);
    assert_eq!([first, second].map(|it| world.controller(it).queued), [0, 1]);
}

/// The bytes that a receiver at one rate reads when others are sent at another.
fn misread(sent: &[u8], sent_at: u32, read_at: u32) -> Vec<u8> {
    let world = SerialWorld::new(sent_at, 1);
    let fellow = world.listener();
    let mut stranger = world.port();
    world.set_bit_rate(stranger.station(), read_at);
    let log = world.log();
    world.sender([(0, sent.to_vec())]);
    world.run_until(micros(10_000));
    // Others hear what is sent, and nothing collides.
    assert_eq!(fellow.frames().concat(), sent);
    assert_eq!(broken(&log.take()).count(), 0);
    let mut bytes = Vec::new();
    while stranger.read_ready().unwrap() {
        let mut byte = [0];
        stranger.read_exact(&mut byte).unwrap();
        bytes.extend(byte);
    }
    bytes
}

#[test]
fn a_receiver_at_another_rate_reads_what_it_samples() {
    // 0x0F is 0 11110000 1 on the line, and sampled at twice the rate 00 11111111 00000000 11: 0 01111111 1, then 0
    // 00000001 1, lowest bit first.
    assert_eq!(misread(&[0x0F], SLOW, FAST), [0xFE, 0x80]);
    // 0 00000000 1, twice. At half the rate every second bit of it is sampled: 0 00010000 1.
    assert_eq!(misread(&[0, 0], FAST, SLOW), [0x08]);
    // After the second bit, sampled high, nothing comes any more: the line is idle, high.
    assert_eq!(misread(&[0], FAST, SLOW), [0xF8]);
    // Low for so long that there is no stop bit. It is a byte nevertheless, and the next edge begins the next byte.
    assert_eq!(misread(&[0, 0], 115_200, FAST), [0, 0]);
    // In the middle of its start bit the line is high again: no byte.
    assert_eq!(misread(&[0x55, 0x55], FAST, SLOW), [0; 0]);
}

#[test]
fn a_receiver_at_another_rate_reads_nothing_while_it_sends_or_a_wire_is_cut() {
    // From 0 to 20, sent at 1 Mbit/s.
    let count = |prepare: fn(&SerialWorld, StationId, &mut SerialPort)| {
        let world = SerialWorld::new(FAST, 1);
        let sender = world.sender([(0, vec![0, 0])]);
        let mut stranger = world.port();
        world.set_bit_rate(stranger.station(), SLOW);
        prepare(&world, sender, &mut stranger);
        world.run_until(micros(1_000));
        let mut bytes = [0; 9];
        if stranger.read_ready().unwrap() { stranger.read(&mut bytes).unwrap() } else { 0 }
    };
    assert_eq!(count(|_, _, _| {}), 1);
    assert_eq!(count(|world, sender, _| world.cut(sender)), 0);
    assert_eq!(count(|world, _, stranger| world.cut(stranger.station())), 0);
    // A byte of its own, from 0 to 20 as well.
    assert_eq!(count(|_, _, stranger| stranger.write_all(&[1]).unwrap()), 0);
    assert_eq!(count(|_, _, stranger| stranger.write_all(&[1, 2]).unwrap()), 0);
}

#[test]
fn no_frame_is_read_at_another_rate() {
    let rates = [115_200, 500_000, 1_000_000, 1_500_000, 2_500_000];
    for (sent_at, read_at) in rates.into_iter().flat_map(|a| rates.map(|b| (a, b))) {
        let mut receiver = Receiver::new();
        let bytes = misread(&READ_PID, sent_at, read_at);
        let is_frame = bytes.iter().any(|&byte| matches!(receiver.feed(byte), Fed::Frame(_)));
        assert_eq!(is_frame, sent_at == read_at, "{sent_at} {read_at} {bytes:02X?}");
    }
}

#[test]
fn a_byte_and_its_echo_last_ten_bits_of_the_senders_rate() {
    let world = SerialWorld::new(FAST, 1);
    let mut port = world.port_with(TransceiverConfig { echo: true, ..Default::default() });
    world.set_bit_rate(port.station(), 115_200);
    port.write_all(&[0xA5; 1152]).unwrap();
    port.flush().unwrap();
    assert_eq!(world.now_ns(), 100_000_000);
    let mut heard = [0; 1152];
    port.read_exact(&mut heard).unwrap();
    assert_eq!(heard, [0xA5; 1152]);
}

/// The acknowledge slot comes after 100 bits. A station that leaves before it does not acknowledge. A station that
/// changes in mid-frame waits for the end of the frame and counts no error, whatever its rate.
#[test]
fn a_station_that_changes_in_mid_frame_has_no_part_in_it() {
    type Change = fn(&CanWorld, StationId);
    let changes: [Change; 3] = [
        |world, station| world.reset(station),
        |world, station| world.cut(station),
        |world, station| world.set_bit_rate(station, SLOW),
    ];
    for (change, at_us) in changes.into_iter().flat_map(|it| [(it, 99), (it, 101)]) {
        let world = CanWorld::new(FAST, 1);
        let mut port = world.port();
        let receiver = world.silent();
        port.transmit(&smooth()).unwrap();
        world.run_until(micros(at_us));
        change(&world, receiver);
        world.run_until(micros(100));
        let errors = if at_us < 100 { 8 } else { 0 };
        assert_eq!(counts(&world, port.station()).0, errors, "{at_us}");
        world.run_until(micros(108));
        assert_eq!(counts(&world, port.station()), (errors, 0, ErrorState::Active));
        assert_eq!(world.controller(port.station()).queued, usize::from(at_us < 100));
        assert_eq!(counts(&world, receiver), (0, 0, ErrorState::Active));
    }
    // Another station acknowledges the frame.
    for change in changes {
        let (world, mut port, [_, other], [heard, _]) = can(FAST, FAST);
        port.transmit(&smooth()).unwrap();
        world.run_until(micros(50));
        change(&world, other);
        world.run_until(micros(108));
        assert_eq!(heard.heard(), [(108, smooth())]);
        assert_eq!(counts(&world, other), (0, 0, ErrorState::Active));
    }
}

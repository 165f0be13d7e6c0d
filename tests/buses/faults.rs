//! Random faults and faults by hand, on both simulated buses, under the virtual clock.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use embedded_can::{Frame, StandardId, nb::Can as _};
use embedded_io::Write as _;
use myactuator_host_std::sim::bus::can::{
    CanPort, CanWorld, ControllerConfig, ErrorState, frame_bits,
};
use myactuator_host_std::sim::bus::faults::{Babble, Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::TransceiverConfig;
use myactuator_host_std::sim::bus::trace::{Event, Fault, Log, Record};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::SimpleFrame;
use myactuator_tests::script::{Hand, READ_PID, Stage as _, broken, late_by, line, micros};

const BOTH: [Direction; 2] = [Direction::ToNodes, Direction::ToPorts];

fn seconds(count: u64) -> Instant {
    Instant::ZERO + Duration::from_secs(count)
}

/// A frame with a number. Only corruption can turn one into another.
fn frame(number: u16) -> SimpleFrame {
    let [low, high] = number.to_le_bytes();
    SimpleFrame::new(StandardId::new(0x241).unwrap(), &[low, high, 1, 2, 3, 4, 5, 6]).unwrap()
}

fn number(frame: &SimpleFrame) -> u16 {
    u16::from_le_bytes([frame.data()[0], frame.data()[1]])
}

fn numbers(frames: &[SimpleFrame]) -> Vec<u16> {
    frames.iter().map(number).collect()
}

fn flipped_bits(found: &[u8], sent: &[u8]) -> u32 {
    found.iter().zip(sent).map(|(a, b)| (a ^ b).count_ones()).sum()
}

fn can() -> (CanWorld, CanPort) {
    let world = CanWorld::new(1_000_000, 1);
    (world.clone(), world.port())
}

fn receive_all(port: &mut CanPort) -> Vec<SimpleFrame> {
    std::iter::from_fn(|| port.receive().ok()).collect()
}

/// A node sends 1000 frames, one each millisecond, to two others and to a port.
struct Broadcast {
    world: CanWorld,
    listeners: [Hand<SimpleFrame>; 2],
    port: CanPort,
    log: Log<SimpleFrame>,
}

const SENT: u16 = 1_000;

fn broadcast(seed: u64, direction: Direction, plan: FaultPlan) -> Broadcast {
    let world = CanWorld::new(1_000_000, seed);
    let mut port = world.port_with(ControllerConfig {
        receive_queue: 4_096,
        transmit_queue: 2_000,
        ..ControllerConfig::SOCKETCAN
    });
    let listeners = [(); 2].map(|()| world.listener());
    let log = world.log();
    world.set_faults(direction, plan);
    match direction {
        Direction::ToPorts => {
            world.sender((0..SENT).map(|n| (u64::from(n) * 1_000, frame(n))));
        }
        Direction::ToNodes | Direction::Echo => {
            for n in 0..SENT {
                world.run_until(micros(u64::from(n) * 1_000));
                assert_eq!(port.transmit(&frame(n)), Ok(None));
            }
        }
    }
    world.run_until(seconds(2));
    Broadcast { world, listeners, port, log }
}

fn in_order() -> Vec<u16> {
    (0..SENT).collect()
}

const LOST: FaultPlan = FaultPlan { lose: 1.0, ..FaultPlan::NONE };

#[test]
fn certain_fault_strikes_every_frame_in_its_direction_only() {
    for (plan, expected) in [
        (FaultPlan::NONE, in_order()),
        (LOST, vec![]),
        (FaultPlan { duplicate: 1.0, ..FaultPlan::NONE }, (0..SENT).flat_map(|n| [n, n]).collect()),
        (FaultPlan { reorder: 1.0, ..FaultPlan::NONE }, (0..SENT).map(|n| n ^ 1).collect()),
    ] {
        let mut run = broadcast(1, Direction::ToPorts, plan);
        assert_eq!(numbers(&receive_all(&mut run.port)), expected, "{plan:?}");
        let mut run = broadcast(1, Direction::ToNodes, plan);
        assert_eq!(numbers(&run.listeners[0].frames()), expected, "{plan:?}");
        // The wire is not affected.
        let status = run.world.controller(run.port.station());
        assert_eq!((status.state, status.transmit_errors), (ErrorState::Active, 0), "{plan:?}");
        let records = run.log.take();
        let carried = records.iter().filter(|record| matches!(record.event, Event::Carried { .. }));
        assert_eq!(carried.count(), 1_000, "{plan:?}");
        // The other direction is not struck.
        run.world.sender([(0, frame(7))]);
        run.world.run_for(Duration::from_millis(1));
        assert_eq!(receive_all(&mut run.port), [frame(7)], "{plan:?}");
    }
}

/// Whether the count fits 1000 trials with a probability of 0.1: within six standard deviations.
fn is_a_tenth(count: usize) -> bool {
    (43..=157).contains(&count)
}

#[test]
fn some_loss_strikes_each_receiver_on_its_own() {
    let lossy = FaultPlan { lose: 0.1, ..FaultPlan::NONE };
    let run = broadcast(1, Direction::ToNodes, lossy);
    let heard = run.listeners.each_ref().map(|listener| numbers(&listener.frames()));
    for heard in &heard {
        assert!(is_a_tenth(1_000 - heard.len()), "{}", heard.len());
        assert!(heard.is_sorted());
    }
    assert_ne!(heard[0], heard[1]);
}

#[test]
fn corruption_on_can_is_noticed_and_repeated() {
    let noisy = FaultPlan { corrupt: 0.1, ..FaultPlan::NONE };
    let run = broadcast(1, Direction::ToNodes, noisy);
    assert_eq!(numbers(&run.listeners[0].frames()), in_order());
    let records = run.log.take();
    assert!(is_a_tenth(broken(&records).count() * 9 / 10));
    // An error frame of 20 bits and an intermission of 3 precede the repetition.
    for record in broken(&records) {
        let again = record.at_ns + 23_000;
        let started = |record: &&Record<SimpleFrame>| match record.event {
            Event::Carried { started_ns, .. } | Event::Broken { started_ns, .. } => {
                started_ns == again
            }
            _ => false,
        };
        assert!(records.iter().any(|record| started(&record)));
    }
}

#[test]
fn corruption_is_counted_at_both_ends() {
    let (world, mut port) = can();
    let listener = world.silent();
    world.set_faults(Direction::ToNodes, FaultPlan { corrupt: 1.0, ..FaultPlan::NONE });
    assert_eq!(port.transmit(&frame(1)), Ok(None));
    let log = world.log();
    while log.take().is_empty() {
        assert!(world.step());
    }
    assert_eq!(world.controller(port.station()).transmit_errors, 8);
    assert_eq!(world.controller(listener).receive_errors, 1);
    world.set_faults(Direction::ToNodes, FaultPlan::NONE);
    world.run_for(Duration::from_millis(1));
    assert_eq!(world.controller(port.station()).transmit_errors, 7);
    assert_eq!(world.controller(listener).receive_errors, 0);
}

#[test]
fn undetected_corruption_flips_one_data_bit() {
    let plan = FaultPlan { corrupt: 1.0, undetected: 1.0, ..FaultPlan::NONE };
    let run = broadcast(1, Direction::ToNodes, plan);
    let heard = run.listeners[0].frames();
    assert_eq!(heard.len(), 1_000);
    for (heard, n) in heard.iter().zip(0..) {
        assert_eq!(flipped_bits(heard.data(), frame(n).data()), 1);
        assert_eq!(heard.id(), frame(n).id());
    }
}

#[test]
fn some_frames_arrive_twice() {
    let some = FaultPlan { duplicate: 0.1, ..FaultPlan::NONE };
    let mut run = broadcast(1, Direction::ToPorts, some);
    let mut heard = numbers(&receive_all(&mut run.port));
    assert!(is_a_tenth(heard.len() - 1_000));
    heard.dedup();
    assert_eq!(heard, in_order());
}

#[test]
fn delayed_frames_are_late_and_stay_in_order() {
    let run = broadcast(1, Direction::ToNodes, late_by(Duration::from_micros(500)));
    for ((at, heard), n) in run.listeners[0].heard().iter().zip(0..) {
        assert_eq!(number(heard), n);
        let arrives = u64::from(n) * 1_000 + u64::from(frame_bits(&frame(n))) - 3;
        assert_eq!(*at, arrives + 500);
    }
    // If a frame is late by more than the distance to the next one, the next one waits.
    let late = FaultPlan { delay: 0.1, ..FaultPlan::NONE };
    let run = broadcast(1, Direction::ToNodes, late);
    assert_eq!(numbers(&run.listeners[0].frames()), in_order());
    let heard = run.listeners[0].heard();
    let on_time = heard.iter().zip(0u64..).filter(|((at, _), n)| *at < n * 1_000 + 150).count();
    assert!((400..900).contains(&on_time), "{on_time}");
}

#[test]
fn some_frames_arrive_after_the_next_one() {
    let some = FaultPlan { reorder: 0.1, ..FaultPlan::NONE };
    let run = broadcast(1, Direction::ToNodes, some);
    let mut heard = numbers(&run.listeners[0].frames());
    let steps_back = heard.windows(2).filter(|pair| pair[1] < pair[0]).count();
    assert!(is_a_tenth(steps_back), "{steps_back}");
    heard.sort_unstable();
    assert_eq!(heard, in_order());
}

#[test]
fn a_reordered_frame_that_nothing_follows_arrives_in_the_end() {
    let (world, mut port) = can();
    let listener = world.listener();
    let hold = Duration::from_millis(3);
    let plan = FaultPlan { reorder: 1.0, reorder_hold: hold, ..FaultPlan::NONE };
    world.set_faults(Direction::ToNodes, plan);
    assert_eq!(port.transmit(&frame(0)), Ok(None));
    world.run_until(seconds(1));
    let arrives = u64::from(frame_bits(&frame(0))) - 3 + 3_000;
    assert_eq!(listener.heard(), [(arrives, frame(0))]);
}

#[test]
fn a_nodes_own_plan_strikes_it_alone() {
    let (world, mut port) = can();
    let [bad, good] = [[2, 4], [3, 5]].map(|numbers| {
        let at_us = |number| (1_000 * u64::from(number), frame(number));
        Hand::sending(numbers.map(at_us))
    });
    let bad_station = world.put(&bad);
    world.put(&good);
    // The port's frames to it are lost. What it hears from another node and what it sends is the other direction.
    world.set_node_faults(bad_station, Direction::ToNodes, Some(LOST));
    assert_eq!(port.transmit(&frame(1)), Ok(None));
    world.run_until(micros(3_500));
    assert_eq!((numbers(&bad.frames()), numbers(&good.frames())), (vec![3], vec![1, 2]));
    assert_eq!(numbers(&receive_all(&mut port)), [2, 3]);
    // The other way round.
    world.set_node_faults(bad_station, Direction::ToNodes, None);
    world.set_node_faults(bad_station, Direction::ToPorts, Some(LOST));
    assert_eq!(port.transmit(&frame(6)), Ok(None));
    world.run_until(seconds(1));
    assert_eq!((numbers(&bad.frames()), numbers(&good.frames())), (vec![3, 6, 5], vec![1, 2, 6]));
    assert_eq!(numbers(&receive_all(&mut port)), [5]);
}

/// Everything that happens in a world with many faults.
fn chaos(seed: u64) -> Vec<Record<SimpleFrame>> {
    let world = CanWorld::new(1_000_000, seed);
    let log = world.log();
    let mut port = world.port();
    let nodes: Vec<_> = (0..4).map(|_| world.mirror()).collect();
    let plan = FaultPlan {
        lose: 0.05,
        corrupt: 0.05,
        undetected: 0.1,
        duplicate: 0.05,
        delay: 0.05,
        reorder: 0.05,
        ..FaultPlan::NONE
    };
    for direction in BOTH {
        world.set_faults(direction, plan);
    }
    let interval = Duration::from_micros(1_700);
    world.babble(nodes[3], Some(Babble { interval, frame: None }));
    for n in 0..100 {
        let _ = port.transmit(&frame(n));
        world.run_for(Duration::from_micros(900));
        receive_all(&mut port);
        match n {
            20 => world.cut(nodes[0]),
            40 => world.mend(nodes[0]),
            50 => world.slow_down(nodes[1], Duration::from_millis(2)),
            60 => world.reset(nodes[2]),
            _ => {}
        }
    }
    log.take()
}

#[test]
fn a_seed_determines_the_whole_run() {
    let first = chaos(1);
    assert_eq!(first, chaos(1));
    assert_ne!(first, chaos(2));
    for fault in [Fault::Lost, Fault::Duplicated, Fault::Reordered] {
        let struck = |record: &Record<SimpleFrame>| matches!(record.event, Event::Faulted { fault: found, .. } if found == fault);
        assert!(first.iter().any(struck), "{fault:?}");
    }
}

#[test]
fn a_cut_wire_isolates_both_ways_and_mending_restores() {
    let (world, mut port) = can();
    let cut_off = Hand::sending([(1_000, frame(1))]);
    let station = world.attach(cut_off.node());
    let other = world.listener();
    world.run_until(micros(500));
    world.cut(station);
    world.cut(station);
    assert_eq!(port.transmit(&frame(2)), Ok(None));
    world.run_until(seconds(1));
    assert_eq!(cut_off.heard(), []);
    assert_eq!(numbers(&other.frames()), [2]);
    // On the cut stub nobody acknowledges. The rest of the bus goes on.
    let status = world.controller(station);
    assert_eq!((status.state, status.transmit_errors), (ErrorState::Passive, 128));
    assert_eq!(world.controller(port.station()).transmit_errors, 0);

    world.mend(station);
    assert_eq!(port.transmit(&frame(3)), Ok(None));
    world.run_for(Duration::from_millis(1));
    assert_eq!(receive_all(&mut port), [frame(1)]);
    assert_eq!(numbers(&cut_off.frames()), [3]);
    assert_eq!(world.controller(station).queued, 0);
}

#[test]
fn cutting_the_sender_breaks_its_frame_off() {
    let (world, _) = can();
    let station = world.sender([(0, frame(1))]);
    let listener = Hand::listening();
    let ear = world.put(&listener);
    let log = world.log();
    world.run_until(micros(50));
    world.cut(station);
    let broken = Event::Broken { frame: frame(1), started_ns: 0 };
    assert_eq!(log.take()[0], Record { at_ns: 50_000, station, event: broken });
    assert_eq!(world.controller(ear).receive_errors, 1);
    world.run_until(micros(500));
    assert_eq!(listener.heard(), []);
}

#[test]
fn a_node_that_joins_in_mid_frame_does_not_hear_it() {
    let (world, _) = can();
    world.sender([(0, frame(1)), (0, frame(2))]);
    let late = Hand::listening();
    let station = world.put(&late);
    world.cut(station);
    world.run_until(micros(50));
    world.mend(station);
    world.run_until(seconds(1));
    assert_eq!(numbers(&late.frames()), [2]);
}

#[test]
fn reset_notifies_the_node_and_empties_its_controller() {
    let (world, _) = can();
    let node = Hand::listening();
    let station = world.put(&node);
    world.run_until(micros(77));
    world.reset(station);
    assert_eq!(node.resets(), [77]);

    // Nobody acknowledges, so both frames stay in the queue.
    let alone = CanWorld::new(1_000_000, 1);
    let station = alone.sender([(0, frame(1)), (0, frame(2))]);
    alone.run_until(seconds(1));
    let status = alone.controller(station);
    assert_eq!((status.queued, status.transmit_errors), (2, 128));
    alone.reset(station);
    let status = alone.controller(station);
    assert_eq!((status.queued, status.transmit_errors), (0, 0));
    assert_eq!(status.state, ErrorState::Active);
}

#[test]
fn a_slow_node_answers_late_and_in_order() {
    let (world, mut port) = can();
    let station = world.mirror();
    let log = world.log();
    world.slow_down(station, Duration::from_millis(5));
    assert_eq!(port.transmit(&frame(1)), Ok(None));
    world.run_until(micros(1_000));
    // Fast again, but its first answer is still pending.
    world.slow_down(station, Duration::ZERO);
    assert_eq!(port.transmit(&frame(2)), Ok(None));
    world.run_until(seconds(1));
    assert_eq!(receive_all(&mut port), [frame(1), frame(2)]);
    let started = log.take().into_iter().find_map(|record| match record.event {
        Event::Carried { started_ns, .. } if record.station == station => Some(started_ns),
        _ => None,
    });
    let heard = u64::from(frame_bits(&frame(1))) - 3;
    assert_eq!(started, Some((heard + 5_000) * 1_000));
}

#[test]
fn a_reset_loses_the_pending_frames_of_a_slow_node() {
    let (world, mut port) = can();
    let station = world.mirror();
    world.slow_down(station, Duration::from_millis(5));
    assert_eq!(port.transmit(&frame(1)), Ok(None));
    world.run_until(micros(1_000));
    world.reset(station);
    world.run_until(seconds(1));
    assert_eq!(receive_all(&mut port), []);
}

#[test]
fn a_slow_nodes_frames_wait_for_room_after_its_babble() {
    let world = CanWorld::new(1_000_000, 1);
    let station = world.sender([(0, frame(1))]);
    world.slow_down(station, Duration::from_millis(1));
    let interval = Duration::from_micros(10);
    // Nobody acknowledges, so the babble fills the mailboxes before the frame gets there.
    world.babble(station, Some(Babble { interval, frame: Some(frame(5)) }));
    world.run_until(micros(10_000));
    world.babble(station, None);
    let mut port = world.port();
    world.run_until(micros(20_000));
    assert_eq!(receive_all(&mut port), [frame(5), frame(5), frame(5), frame(1)]);
}

/// A call with an endless period is never made. A babble with an endless interval sends one frame.
#[test]
fn events_due_after_the_end_of_time_never_happen() {
    let (world, _) = can();
    let station = world.silent();
    let forever = Duration::from_micros(u64::MAX);
    let calls = Arc::new(AtomicU32::new(0));
    world.run_for(Duration::from_millis(1));
    for period in [forever, Duration::from_millis(1), Duration::from_millis(1)] {
        let calls = Arc::clone(&calls);
        world.every(period, move |_| {
            calls.fetch_add(1, Ordering::Relaxed);
        });
    }
    let log = world.log();
    world.babble(station, Some(Babble { interval: forever, frame: Some(frame(1)) }));
    world.run_for(Duration::from_millis(10));
    assert_eq!(calls.load(Ordering::Relaxed), 2 * 10);
    let is_carried = |record: &&Record<_>| matches!(record.event, Event::Carried { .. });
    assert_eq!(log.take().iter().filter(is_carried).count(), 1);
}

#[test]
fn a_babbling_station_sends_until_it_is_silenced() {
    let (world, mut port) = can();
    let station = world.silent();
    let interval = Duration::from_millis(1);
    world.babble(station, Some(Babble { interval, frame: Some(frame(5)) }));
    world.run_until(micros(9_900));
    assert_eq!(receive_all(&mut port), [frame(5); 10]);
    world.babble(station, Some(Babble { interval, frame: None }));
    world.run_until(micros(19_800));
    let garbage = receive_all(&mut port);
    assert_eq!(garbage.len(), 10);
    assert!(garbage.windows(2).any(|pair| pair[0] != pair[1]));
    world.babble(station, None);
    world.run_until(micros(40_000));
    assert_eq!(receive_all(&mut port), []);
}

#[test]
fn a_babbler_of_high_priority_starves_the_others() {
    let (world, mut port) = can();
    let station = world.silent();
    let first = SimpleFrame::new(StandardId::new(0).unwrap(), &[]).unwrap();
    world.babble(station, Some(Babble { interval: Duration::from_micros(10), frame: Some(first) }));
    world.run_until(micros(100));
    assert_eq!(port.transmit(&frame(1)), Ok(None));
    world.run_until(micros(100_000));
    assert_eq!(world.controller(port.station()).queued, 1);
    world.babble(station, None);
    world.run_for(Duration::from_millis(1));
    assert_eq!(world.controller(port.station()).queued, 0);
}

/// What a node hears when a master writes 100 messages.
fn messages(seed: u64, plan: FaultPlan) -> Vec<(u64, Vec<u8>)> {
    let (world, mut port, listener) = line(seed);
    world.set_faults(Direction::ToNodes, plan);
    for n in 0..100 {
        world.run_until(micros(n * 1_000));
        let mut message = READ_PID;
        message[4] = n as u8;
        port.write_all(&message).unwrap();
    }
    world.run_until(seconds(1));
    listener.heard()
}

fn bytes(heard: &[(u64, Vec<u8>)]) -> Vec<u8> {
    heard.iter().flat_map(|(_, bytes)| bytes.clone()).collect()
}

/// The numbers of the messages. Each message must be whole.
fn message_numbers(heard: &[(u64, Vec<u8>)]) -> Vec<u8> {
    bytes(heard)
        .chunks(13)
        .map(|message| {
            assert_eq!((message.len(), message[0], message[12]), (13, 0x3E, 0xDD));
            message[4]
        })
        .collect()
}

#[test]
fn messages_on_rs485_are_lost_doubled_delayed_and_reordered_as_a_whole() {
    for (plan, expected) in [
        (LOST, vec![]),
        (FaultPlan { duplicate: 1.0, ..FaultPlan::NONE }, (0..100).flat_map(|n| [n, n]).collect()),
        (FaultPlan { reorder: 1.0, ..FaultPlan::NONE }, (0..100).map(|n| n ^ 1).collect()),
        (late_by(Duration::from_micros(300)), (0..100).collect()),
    ] {
        let heard = messages(1, plan);
        assert_eq!(message_numbers(&heard), expected, "{plan:?}");
        if plan.delay > 0.0 {
            // Byte by byte, 10 us each.
            assert_eq!((heard[0].0, heard[1].0, heard[13].0), (310, 320, 1_310));
        }
    }
    let half = FaultPlan { lose: 0.5, ..FaultPlan::NONE };
    let numbers = message_numbers(&messages(1, half));
    // Within five standard deviations.
    assert!((25..=75).contains(&numbers.len()), "{}", numbers.len());
    assert!(numbers.is_sorted());
    assert_eq!(messages(1, half), messages(1, half));
    assert_ne!(messages(1, half), messages(2, half));
}

#[test]
fn a_corrupted_message_on_rs485_has_one_flipped_bit() {
    let all = bytes(&messages(1, FaultPlan { corrupt: 1.0, ..FaultPlan::NONE }));
    let clean = bytes(&messages(1, FaultPlan::NONE));
    assert_eq!((all.len(), clean.len()), (1_300, 1_300));
    for (corrupted, clean) in all.chunks(13).zip(clean.chunks(13)) {
        assert_eq!(flipped_bits(corrupted, clean), 1);
    }
}

#[test]
fn a_cut_wire_on_rs485_leaves_only_the_echo() {
    let (world, mut port, listener) = line(1);
    let echoing = TransceiverConfig { echo: true, ..Default::default() };
    let node = Hand::sending([(50, vec![1]), (250, vec![2])]);
    let station = world.attach_with(node.node(), echoing);
    world.cut(station);
    world.run_until(micros(100));
    port.write_all(&[0x77]).unwrap();
    world.run_until(micros(200));
    assert_eq!(node.heard(), [(60, vec![1])]);
    assert_eq!(listener.heard(), [(110, vec![0x77])]);
    world.mend(station);
    world.run_until(micros(300));
    port.write_all(&[0x78]).unwrap();
    world.run_until(micros(400));
    assert_eq!(node.heard()[1..], [(260, vec![2]), (310, vec![0x78])]);
    assert_eq!(listener.heard()[1..], [(260, vec![2]), (310, vec![0x78])]);
}

#[test]
fn a_reset_on_rs485_stops_what_is_being_sent() {
    let (world, _, listener) = line(1);
    let station = world.sender([(0, READ_PID.to_vec())]);
    world.run_until(micros(35));
    world.reset(station);
    world.run_until(seconds(1));
    let heard = listener.heard();
    // Three whole bytes, and the rest of the fourth.
    assert_eq!(heard.len(), 4);
    assert_eq!(bytes(&heard)[..3], READ_PID[..3]);
    assert_ne!(bytes(&heard)[3], READ_PID[3]);
}

#[test]
fn a_babbler_on_rs485_garbles_others() {
    let (world, mut port, listener) = line(1);
    let babbler = world.silent();
    world.babble(babbler, Some(Babble { interval: Duration::from_micros(20), frame: None }));
    let log = world.log();
    world.run_until(micros(1_000));
    port.write_all(&READ_PID).unwrap();
    world.run_until(micros(2_000));
    assert!(broken(&log.take()).any(|record| record.station == port.station()));
    assert!(!bytes(&listener.heard()).windows(13).any(|window| window == READ_PID));
}

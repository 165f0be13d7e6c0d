//! The simulated RS485 line under the virtual clock. Times are counted by hand. A byte lasts ten bits.

use embedded_io::{Read as _, ReadReady as _, Write as _, WriteReady as _};
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::{
    SerialError, SerialPort, SerialWorld, TransceiverConfig,
};
use myactuator_host_std::sim::bus::trace::Event;
use myactuator_protocol_core::time::Duration;
use myactuator_tests::script::{Hand, READ_PID, Stage as _, broken, late_by, line, micros};

fn times(heard: &[(u64, Vec<u8>)]) -> Vec<u64> {
    heard.iter().map(|(at, _)| *at).collect()
}

fn received(port: &mut SerialPort) -> Vec<u8> {
    let mut all = Vec::new();
    while port.read_ready().unwrap() {
        let mut buf = [0; 5];
        let count = port.read(&mut buf).unwrap();
        all.extend_from_slice(&buf[..count]);
    }
    all
}

#[test]
fn a_byte_arrives_with_its_stop_bit() {
    let (world, _, listener) = line(1);
    world.sender([(7, vec![0xA5, 0x5A])]);
    world.run_until(micros(100));
    assert_eq!(listener.heard(), [(17, vec![0xA5]), (27, vec![0x5A])]);
}

#[test]
fn frame_lasts_130_bits_at_each_bit_rate_of_the_manual() {
    // 130 bits; the time in whole microseconds, rounded up: 1128.47, 260, 130, 86.67, 52.
    for (bit_rate, last_us) in
        [(115_200, 1129), (500_000, 260), (1_000_000, 130), (1_500_000, 87), (2_500_000, 52)]
    {
        let world = SerialWorld::new(bit_rate, 1);
        let listener = world.listener();
        let mut port = world.port();
        port.write_all(&READ_PID).unwrap();
        world.run_until(micros(2_000));
        assert_eq!(listener.frames().concat(), READ_PID);
        assert_eq!(listener.heard()[12].0, last_us, "{bit_rate}");
    }
}

#[test]
fn the_roundings_of_many_bytes_do_not_add_up() {
    let world = SerialWorld::new(115_200, 1);
    world.silent();
    let mut port = world.port();
    // 1152 bytes of ten bits at 115200 bit/s are 100 ms.
    port.write_all(&[0x55; 1152]).unwrap();
    port.flush().unwrap();
    assert_eq!(world.now_ns(), 100_000_000);
}

#[test]
fn a_port_hears_its_own_bytes_only_with_an_echo() {
    for echo in [false, true] {
        let (world, ..) = line(1);
        world.mirror();
        let mut port = world.port_with(TransceiverConfig { echo, ..Default::default() });
        port.write_all(&[1]).unwrap();
        world.run_until(micros(15));
        assert_eq!(received(&mut port), if echo { vec![1] } else { vec![] });
        world.run_until(micros(100));
        // The mirror's answer.
        assert_eq!(received(&mut port), [1]);
    }
}

#[test]
fn fault_of_an_echo_strikes_nothing_else() {
    let lost = FaultPlan { lose: 1.0, ..FaultPlan::NONE };
    let flipped = FaultPlan { corrupt: 1.0, ..FaultPlan::NONE };
    let late = late_by(Duration::from_micros(1_000));
    for plan in [lost, flipped, late] {
        let (world, _, listener) = line(1);
        let answer = world.sender([(400, vec![7])]);
        let echoing = TransceiverConfig { echo: true, ..Default::default() };
        let mut port = world.port_with(echoing);
        world.set_faults(Direction::Echo, plan);
        port.write_all(&READ_PID).unwrap();
        world.run_until(micros(600));
        assert_eq!(listener.frames().concat(), [&READ_PID[..], &[7]].concat(), "{plan:?}");
        let in_time = received(&mut port);
        world.run_until(micros(2_000));
        let later = received(&mut port);
        if plan == lost {
            assert_eq!((&in_time[..], &later[..]), (&[7][..], &[][..]));
        } else if plan == late {
            assert_eq!((&in_time[..], &later[..]), (&[][..], &listener.frames().concat()[..]));
        } else {
            let flips = in_time.iter().zip(READ_PID).map(|(a, b)| (a ^ b).count_ones());
            assert_eq!((flips.sum::<u32>(), in_time.last(), &later[..]), (1, Some(&7), &[][..]));
        }
        // A station's own plan comes before the common one. Another station's plan has no effect.
        world.set_node_faults(answer, Direction::Echo, Some(lost));
        world.set_node_faults(port.station(), Direction::Echo, Some(FaultPlan::NONE));
        port.write_all(&READ_PID).unwrap();
        world.run_until(micros(4_000));
        assert_eq!(received(&mut port), READ_PID, "{plan:?}");
    }
}

#[test]
fn a_noisy_adapter_adds_a_byte_at_each_switch() {
    let noisy = TransceiverConfig { echo: true, switch_noise: 1.0, ..Default::default() };
    let (world, ..) = line(1);
    let mut port = world.port_with(noisy);
    port.write_all(&READ_PID).unwrap();
    world.run_until(micros(1_000));
    let all = received(&mut port);
    assert_eq!(all.len(), 15);
    assert_eq!(all[1..14], READ_PID);
}

#[test]
fn switching_direction_takes_its_time() {
    let slow = TransceiverConfig {
        switch_to_send: Duration::from_micros(100),
        switch_to_receive: Duration::from_micros(50),
        ..Default::default()
    };
    let (world, _, listener) = line(1);
    let mut port = world.port_with(slow);
    port.write_all(&[1, 2]).unwrap();
    port.flush().unwrap();
    assert_eq!(listener.heard(), [(110, vec![1]), (120, vec![2])]);
    assert_eq!(world.now(), micros(170));
}

#[test]
fn a_line_that_is_still_held_garbles_the_answer() {
    let hold = |us| TransceiverConfig {
        switch_to_receive: Duration::from_micros(us),
        ..Default::default()
    };
    for (held_us, arrives) in [(0, true), (19, false)] {
        let (world, _, listener) = line(1);
        world.sender([(20, vec![0x42])]);
        let mut port = world.port_with(hold(held_us));
        // Its byte ends at 10. It holds the line up to 29. The other byte lasts from 20 to 30.
        port.write_all(&[0x11]).unwrap();
        let log = world.log();
        world.run_until(micros(100));
        assert_eq!(received(&mut port) == [0x42], arrives);
        assert_eq!(listener.heard().len(), 2);
        assert_eq!(broken(&log.take()).next().is_some(), !arrives);
    }
}

#[test]
fn a_station_that_switches_is_deaf() {
    let (world, ..) = line(1);
    world.sender([(0, vec![1, 2, 3])]);
    let slow =
        TransceiverConfig { switch_to_send: Duration::from_micros(100), ..Default::default() };
    let deaf = Hand::sending([(15, vec![0xEE])]);
    world.attach_with(deaf.node(), slow);
    world.run_until(micros(1_000));
    assert_eq!(deaf.heard(), [(10, vec![1])]);
}

#[test]
fn bytes_written_while_sending_follow_without_a_gap() {
    let (world, mut port, listener) = line(1);
    port.write_all(&[1]).unwrap();
    world.run_until(micros(5));
    port.write_all(&[2]).unwrap();
    world.run_until(micros(100));
    assert_eq!(listener.heard(), [(10, vec![1]), (20, vec![2])]);
}

#[test]
fn a_station_with_a_cut_cable_collides_with_nobody() {
    let (world, ..) = line(1);
    let stations = [(0, 0x11), (5, 0x22)].map(|(at, byte)| world.sender([(at, vec![byte])]));
    world.cut(stations[1]);
    let log = world.log();
    world.run_until(micros(1_000));
    let is_broken = |event: &Event<_>| matches!(event, Event::Broken { .. });
    assert!(!log.take().iter().any(|record| is_broken(&record.event)));
}

#[test]
fn overlapping_bytes_are_broken_for_both_senders() {
    let (world, _, listener) = line(1);
    let stations = [(0, 0x11), (5, 0x22)].map(|(at, byte)| world.sender([(at, vec![byte])]));
    let log = world.log();
    world.run_until(micros(1_000));
    let records = log.take();
    for (station, started_ns, byte) in [(stations[0], 0, 0x11), (stations[1], 5_000, 0x22)] {
        let broken = Event::Broken { frame: vec![byte], started_ns };
        assert!(records.iter().any(|r| r.station == station && r.event == broken), "{records:?}");
    }
    // From the first start bit, and again from the middle of the second one's byte.
    assert_eq!(times(&listener.heard()), [10, 20]);
}

fn collide(seed: u64, second_at: u64) -> Vec<(u64, Vec<u8>)> {
    let (world, _, listener) = line(seed);
    world.sender([(0, vec![0x11; 4])]);
    world.sender([(second_at, vec![0x22; 4])]);
    let log = world.log();
    world.run_until(micros(1_000));
    assert_eq!(broken(&log.take()).count(), if second_at < 40 { 2 } else { 0 });
    listener.heard()
}

#[test]
fn a_collision_garbles_both() {
    // Both from 0 to 40: four bytes are heard.
    let heard = collide(1, 0);
    assert_eq!(times(&heard), [10, 20, 30, 40]);
    assert_ne!(heard, collide(2, 0), "another seed garbles otherwise");
    assert_eq!(heard, collide(1, 0), "the same seed garbles alike");
}

#[test]
fn only_what_overlaps_is_garbled() {
    // The second sender begins at 25, in the third byte of the first, and ends at 65. The receivers stay in step with
    // the first sender until 40. Then they start in the middle of a byte of the second.
    let heard = collide(1, 25);
    assert_eq!(times(&heard), [10, 20, 30, 40, 50, 60, 70]);
    assert_eq!(heard[..2], [(10, vec![0x11]), (20, vec![0x11])]);
    // One after the other is no collision.
    let heard = collide(1, 40);
    assert_eq!(heard.len(), 8);
    assert_eq!(heard[4..], [50, 60, 70, 80].map(|at| (at, vec![0x22])));
}

#[test]
fn reading_waits_for_a_byte_and_no_longer() {
    let (world, mut port, _) = line(1);
    world.sender([(100, vec![1, 2, 3])]);
    let mut buf = [0; 8];
    assert_eq!(port.read(&mut buf), Ok(1));
    assert_eq!((buf[0], world.now()), (1, micros(110)));
    world.run_until(micros(200));
    assert_eq!(port.read(&mut buf[..1]), Ok(1));
    assert_eq!(port.read(&mut buf[1..]), Ok(1));
    assert_eq!(buf[..2], [2, 3]);
    assert_eq!(world.now(), micros(200));
    assert_eq!(port.read(&mut buf), Err(SerialError::TimedOut));
    assert_eq!(world.now(), micros(1_000_200));
}

#[test]
fn nothing_to_read_or_write_takes_no_time() {
    let (world, mut port, _) = line(1);
    assert_eq!(port.read(&mut []), Ok(0));
    assert_eq!(port.write(&[]), Ok(0));
    assert_eq!(port.flush(), Ok(()));
    assert_eq!(world.now(), micros(0));
}

#[test]
fn a_full_transmit_buffer_takes_what_fits_and_waits_for_room() {
    let (world, _, listener) = line(1);
    let small = TransceiverConfig { transmit_buffer: 4, ..Default::default() };
    let mut port = world.port_with(small);
    assert_eq!(port.write(&[1, 2, 3, 4, 5, 6]), Ok(4));
    assert_eq!(port.write_ready(), Ok(false));
    assert_eq!(world.now(), micros(0));
    // A byte has left after 10 us.
    assert_eq!(port.write(&[5, 6]), Ok(1));
    assert_eq!(world.now(), micros(10));
    assert_eq!(port.write(&[6]), Ok(1));
    port.flush().unwrap();
    assert_eq!(port.write_ready(), Ok(true));
    assert_eq!(listener.frames().concat(), [1, 2, 3, 4, 5, 6]);
    assert_eq!(world.now(), micros(60));
}

#[test]
fn a_receive_buffer_overflows_and_counts() {
    let (world, ..) = line(1);
    let mut port = world.port_with(TransceiverConfig { receive_buffer: 2, ..Default::default() });
    world.sender([(0, vec![1, 2, 3, 4, 5])]);
    world.run_until(micros(100));
    assert_eq!(port.overflows(), 3);
    assert_eq!(received(&mut port), [1, 2]);
}

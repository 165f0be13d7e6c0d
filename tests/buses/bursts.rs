//! Ports that receive frames and bytes in bursts, under the virtual clock.

use embedded_can::nb::Can as _;
use embedded_io::{Read as _, ReadReady as _};
use myactuator_host_std::sim::bus::can::CanPort;
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::{SerialPort, SerialWorld};
use myactuator_host_std::sim::{CanFleet, Fleet, LineFleet};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::{can, rs485::Frame};
use myactuator_tests::script::late_by;

const PERIOD: Duration = Duration::from_millis(16);
const MOTOR: MotorId = MotorId::MIN;

fn on_can() -> (CanFleet, CanPort) {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let port = fleet.world.port();
    fleet.world.hand_over_every(port.station(), PERIOD);
    (fleet, port)
}

fn on_line() -> (LineFleet, SerialPort) {
    let fleet = Fleet::new(1).on_rs485(115_200).unwrap();
    let port = fleet.world.port();
    fleet.world.hand_over_every(port.station(), PERIOD);
    (fleet, port)
}

#[test]
fn a_burst_at_each_multiple_of_the_period_has_all_frames_until_then() {
    let (fleet, mut port) = on_can();
    let ask = can::encode(&ReadMultiTurnAngle.packet(MOTOR)).unwrap();
    let mut come = Vec::new();
    for step in 0..500_u64 {
        // Commands at 0, 3 and 20 ms. The drive replies within 1.2 ms.
        if [0, 30, 200].contains(&step) {
            port.transmit(&ask).unwrap();
        }
        fleet.world.run_until(Instant::from_micros(100 * (step + 1)));
        while port.receive().is_ok() {
            come.push(fleet.world.now().as_micros());
        }
    }
    assert_eq!(come, [16_000, 16_000, 32_000]);
    // Without a period frames arrive at once again.
    fleet.world.hand_over_every(port.station(), Duration::ZERO);
    port.transmit(&ask).unwrap();
    fleet.world.run_for(Duration::from_micros(1_300));
    assert!(port.receive().is_ok());
}

/// Delayed and reordered frames also arrive at multiples of the period only.
#[test]
fn faults_change_nothing_about_bursts() {
    for plan in [late_by(Duration::from_millis(3)), FaultPlan { reorder: 1.0, ..FaultPlan::NONE }] {
        let (fleet, mut port) = on_can();
        fleet.world.set_faults(Direction::ToPorts, plan);
        let ask = can::encode(&ReadMultiTurnAngle.packet(MOTOR)).unwrap();
        let mut come = 0;
        for step in 1..=1_000_u64 {
            if step % 100 == 0 {
                port.transmit(&ask).unwrap();
            }
            fleet.world.run_until(Instant::from_micros(100 * step));
            while port.receive().is_ok() {
                come += 1;
                assert_eq!(fleet.world.now().as_micros() % PERIOD.as_micros(), 0);
            }
        }
        assert!((6..=9).contains(&come), "{come}");
    }
}

#[test]
fn bytes_of_a_frame_come_together() {
    let (fleet, mut port) = on_line();
    let ask = Frame::from_packet(&ReadMultiTurnAngle.packet(MOTOR)).unwrap().encode();
    embedded_io::Write::write_all(&mut port, &ask).unwrap();
    // Two frames of 1.13 ms and the drive's delay end long before.
    fleet.world.run_until(Instant::from_micros(15_999));
    assert!(!port.read_ready().unwrap());
    fleet.world.run_until(Instant::from_micros(16_000));
    let mut bytes = [0; 32];
    assert_eq!(port.read(&mut bytes).unwrap(), 13);
}

/// A byte takes 10 us and a burst comes every 20 us. So every second byte ends exactly when the byte before it is
/// handed over.
#[test]
fn a_byte_that_ends_with_a_burst_stays_in_order() {
    let world = SerialWorld::new(1_000_000, 1);
    let (mut sender, mut listener) = (world.port(), world.port());
    world.hand_over_every(listener.station(), Duration::from_micros(20));
    let sent: Vec<u8> = (1..=13).collect();
    embedded_io::Write::write_all(&mut sender, &sent).unwrap();
    world.run_for(Duration::from_millis(1));
    let mut heard = [0; 13];
    assert_eq!(listener.read(&mut heard).unwrap(), 13);
    assert_eq!(heard, *sent);
}

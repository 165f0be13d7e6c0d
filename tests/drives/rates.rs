//! The drives' bit rate (2.32): a change acts after the next start. Then a drive is heard at its new rate only.

use myactuator_host_std::sim::bus::can::{CanBus, ErrorState};
use myactuator_host_std::sim::{BusFleet, Fleet};
use myactuator_protocol_core::command::{
    BaudCode, ReadModel, ReadMultiTurnAngle, Reset, SetBaudRate,
};
use myactuator_protocol_core::drive::Event;
use myactuator_protocol_core::io::{Runner, bring_up};
use myactuator_protocol_core::master::{Config, MotorSet};
use myactuator_protocol_core::time::Duration;
use myactuator_tests::fleet::happened;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};
use myactuator_tests::wire::Wire;

on_both_buses! {
    a_new_rate_acts_after_the_restart
    a_new_rate_acts_after_the_supply_was_gone
    drives_are_found_at_their_rates
}

/// 500 kbit/s on CAN, 115200 bit/s on RS485 (2.32.4).
const SLOWER: BaudCode = BaudCode::CAN_500K_RS485_115200;

fn slower<W: Wire>() -> u32 {
    if W::NAME == CanBus::NAME { 500_000 } else { 115_200 }
}

/// A master at this bit rate, patient enough for the slowest line.
fn master_at<W: Wire>(bus: &BusFleet<W>, bit_rate: u32) -> W::Runner<8> {
    let config = Config { reply_timeout: millis(20), ..W::CONFIG };
    let (master, station) = W::runner(&bus.world, config);
    bus.world.set_bit_rate(station, bit_rate);
    master
}

fn found<W: Wire>(bus: &BusFleet<W>, bit_rate: u32) -> Vec<u8> {
    let mut master = master_at(bus, bit_rate);
    let found = bring_up::scan(&mut master, MotorSet::ALL, |_, _| {}).unwrap();
    found.iter().map(|motor| motor.get()).collect()
}

fn a_new_rate_acts_after_the_restart<W: Wire>() {
    let bus: BusFleet<W> = W::drives(&Fleet::new(1)).unwrap();
    let mut fast = master_at(&bus, 1_000_000);
    let mut slow = master_at(&bus, slower::<W>());
    let reads = |master: &mut W::Runner<8>| master.ask(id(1), ReadMultiTurnAngle).is_ok();
    fast.ask(id(1), SetBaudRate { baud_rate: SLOWER }).unwrap();
    bus.world.run_for(millis(100));
    assert_eq!([reads(&mut fast), reads(&mut slow)], [true, false]);
    fast.ask(id(1), Reset).unwrap();
    bus.world.run_for(Duration::from_secs(2));
    assert!(happened(&bus.drives[0]).contains(&Event::BitRateChanged(SLOWER)));
    assert_eq!([reads(&mut fast), reads(&mut slow)], [false, true]);

    // And back.
    slow.ask(id(1), SetBaudRate { baud_rate: bus.drives[0].with(|it| it.parameters().baud_rate) })
        .unwrap();
    slow.ask(id(1), Reset).unwrap();
    bus.world.run_for(Duration::from_secs(2));
    assert_eq!([reads(&mut fast), reads(&mut slow)], [true, false]);
}

fn a_new_rate_acts_after_the_supply_was_gone<W: Wire>() {
    let bus: BusFleet<W> = W::drives(&Fleet::new(1)).unwrap();
    let mut fast = master_at(&bus, 1_000_000);
    fast.ask(id(1), SetBaudRate { baud_rate: SLOWER }).unwrap();
    bus.world.run_for(millis(10));
    bus.world.reset(bus.drives[0].station());
    bus.world.run_for(Duration::from_secs(2));
    assert!(fast.ask(id(1), ReadModel).is_err());
    assert!(master_at(&bus, slower::<W>()).ask(id(1), ReadModel).is_ok());
}

/// Two of three drives are set to another rate. A scan at both rates finds all.
fn drives_are_found_at_their_rates<W: Wire>() {
    let bus: BusFleet<W> = W::drives(&Fleet::new(3)).unwrap();
    let mut master = master_at(&bus, 1_000_000);
    for motor in [id(1), id(3)] {
        master.ask(motor, SetBaudRate { baud_rate: SLOWER }).unwrap();
        bus.world.run_for(millis(10));
        master.ask(motor, Reset).unwrap();
    }
    bus.world.run_for(Duration::from_secs(2));
    drop(master);
    assert_eq!(found(&bus, 1_000_000), [2]);
    assert_eq!(found(&bus, slower::<W>()), [1, 3]);
    assert_eq!(found(&bus, 1_000_000), [2]);
}

/// The bus has a rate without a code in the manual. Its drives have that rate nevertheless.
#[test]
fn drives_keep_to_a_bus_whose_rate_has_no_code() {
    let bus = Fleet::new(1).on_can(250_000).unwrap();
    assert_eq!(bus.drives[0].with(|drive| drive.bit_rate()), None);
    let mut master = bus.master::<1>();
    assert!(master.ask(id(1), ReadModel).is_ok());
    let drive = bus.world.controller(bus.drives[0].station());
    assert_eq!((drive.receive_errors, drive.state), (0, ErrorState::Active));
}

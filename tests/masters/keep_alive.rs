//! Motors that stop when they hear nothing for a while go on holding their loads while a function works with another.

use core::ops::ControlFlow;

use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_host_std::sim::bus::trace::{self, Record};
use myactuator_host_std::sim::plant::Load;
use myactuator_host_std::sim::{BusFleet, Fleet, LineFleet, MotorSetup};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{ReadStatus1, Stop};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::io::bring_up::{self, BringUpError, Protection};
use myactuator_protocol_core::io::{CallError, Guards, KeepAlive, Runner};
use myactuator_protocol_core::master::{Config, Event, Master, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::Milliseconds;
use myactuator_tests::fleet::{happened, lost_their_master, master, state};
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{go_to, id, millis, turn};
use myactuator_tests::wire::Wire;

on_both_buses! {
    others_hold_while_a_brake_is_released_and_locked
    others_hold_while_one_is_restarted
    others_hold_while_one_gets_a_zero
    others_hold_while_one_gets_another_id
    others_hold_while_one_is_moved
    others_hold_during_a_scan_of_all_ids
    others_hold_while_an_absent_one_is_awaited
    others_hold_during_a_check_for_a_shared_id
    others_hold_while_two_of_them_are_dead
    a_bus_that_is_out_for_a_while
    motors_found_by_a_scan_hold_on
    others_hold_while_one_does_not_confirm_a_stop
    others_hold_until_a_stop_of_all_gives_a_dead_one_up
    motors_hold_after_an_outage
    motors_that_are_stopped_hold_after_an_outage_in_which_a_function_waits
    motors_hold_after_the_host_was_held_up
    others_hold_while_a_button_ends_a_question_to_an_absent_one
    others_hold_while_there_is_no_place_for_one_more
}

/// A restart takes ten times as long, and twice as long without an answer.
const LIMIT: Milliseconds = Milliseconds::from_raw(100);
/// Of these one is worked with.
const MOTORS: u8 = 6;

fn others() -> impl Iterator<Item = MotorId> {
    (2..=MOTORS).map(id)
}

/// Motors with slow brakes.
fn slow_to_brake(motors: u8) -> Fleet {
    let quirks = Quirks { slow_brake: true, ..Quirks::default() };
    Fleet::new(motors).brakes(true).quirks(quirks)
}

/// The same, with loads that pull at them.
fn loaded(motors: u8) -> Fleet {
    slow_to_brake(motors).load(Load { torque_nm: 5.0, ..Load::NONE })
}

/// Loaded motors. All but the first are held.
fn held<W: Wire>() -> (BusFleet<W>, W::Runner<8>) {
    let bus = W::drives(&loaded(MOTORS)).unwrap();
    let mut runner = master(&bus);
    // The first place is free: ids that come and go get it.
    runner.ask(id(32), ReadStatus1).unwrap_err();
    for motor in others().chain([id(1)]) {
        assert_eq!(bring_up::protect(&mut runner, motor, LIMIT), Ok(Protection::Confirmed));
    }
    for motor in others() {
        assert_eq!(bring_up::release_brake(&mut runner, motor), Ok(()));
    }
    assert!(runner.master().forget(id(32)));
    (bus, runner)
}

#[track_caller]
fn check_others_hold<W: Wire>(bus: &BusFleet<W>) {
    assert_eq!(lost_their_master(&bus.drives[1..]), []);
    for drive in &bus.drives[1..] {
        assert!(state(drive).output_on, "{}", drive.motor());
    }
}

/// No motor is left with a question under way.
#[track_caller]
fn check_others_are_free<R: Runner<8>>(runner: &mut R) {
    for motor in others() {
        let _ticket = runner.master().request(motor, Stop).unwrap();
    }
}

fn others_hold_while_a_brake_is_released_and_locked<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    check_others_hold(&bus);
    assert_eq!(bring_up::release_brake(&mut runner, id(1)), Ok(()));
    check_others_hold(&bus);
    assert_eq!(bring_up::lock_brake(&mut runner, id(1)), Ok(()));
    check_others_hold(&bus);
}

fn others_hold_while_one_is_restarted<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::restart(&mut runner, id(1), id(1)), Ok(()));
    check_others_hold(&bus);
}

fn others_hold_while_one_gets_a_zero<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    bring_up::zero_here(&mut runner, id(1)).unwrap();
    check_others_hold(&bus);
}

fn others_hold_while_one_gets_another_id<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::change_id(&mut runner, id(1), id(9)), Ok(()));
    check_others_hold(&bus);
}

fn others_hold_while_one_is_moved<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::release_brake(&mut runner, id(1)), Ok(()));
    let go_on = |_: &_| ControlFlow::Continue(());
    bring_up::move_to(&mut runner, id(1), go_to(30.0, 90), &Default::default(), go_on).unwrap();
    check_others_hold(&bus);
}

fn others_hold_during_a_scan_of_all_ids<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    let expected = others().chain([id(1)]).collect();
    assert_eq!(bring_up::scan(&mut runner, MotorSet::ALL, |_, _| {}), Ok(expected));
    check_others_hold(&bus);
    let nobody = MotorSet::ALL.without(expected);
    assert_eq!(bring_up::scan(&mut runner, nobody, |_, _| {}), Ok(MotorSet::EMPTY));
    check_others_hold(&bus);
    check_others_are_free(&mut runner);
}

fn others_hold_while_an_absent_one_is_awaited<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    let waited = bring_up::wait_until_there(&mut runner, id(20), millis(500));
    assert_eq!(waited, Err(BringUpError::NotThere(id(20))));
    check_others_hold(&bus);
    check_others_are_free(&mut runner);
}

fn others_hold_during_a_check_for_a_shared_id<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    assert_eq!(bring_up::is_shared(&mut runner, id(1)), Ok::<_, CallError<_>>(false));
    check_others_hold(&bus);
}

/// The second of them dies right before motor 1 is restarted.
fn others_hold_while_two_of_them_are_dead<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    bus.world.cut(bus.drives[4].station());
    bring_up::wait_until_there(&mut runner, id(20), millis(200)).unwrap_err();
    bus.world.cut(bus.drives[5].station());
    assert_eq!(bring_up::restart(&mut runner, id(1), id(1)), Ok(()));
    assert_eq!(lost_their_master(&bus.drives[1..4]), []);
}

/// A USB adapter hands over what it hears every 16 ms.
#[test]
fn all_motors_hold_behind_a_can_adapter_that_delivers_in_bursts() {
    let bus = slow_to_brake(8).on_can(1_000_000).unwrap();
    let (mut runner, station) = CanBus::runner::<8>(&bus.world, CanBus::CONFIG);
    bus.world.hand_over_every(station, millis(16));
    for motor in MotorId::all().take(8) {
        assert_eq!(bring_up::protect(&mut runner, motor, LIMIT), Ok(Protection::Confirmed));
    }
    for motor in MotorId::all().take(8).skip(1) {
        assert_eq!(bring_up::release_brake(&mut runner, motor), Ok(()));
    }
    bus.drives.iter().for_each(|drive| drop(happened(drive)));
    assert_eq!(bring_up::restart(&mut runner, id(1), id(1)), Ok(()));
    check_others_hold(&bus);
}

/// The bus is back long before their protection stops them.
fn a_bus_that_is_out_for_a_while<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    for motor in others() {
        let limit = Milliseconds::from_raw(600);
        assert_eq!(bring_up::protect(&mut runner, motor, limit), Ok(Protection::Confirmed));
    }
    let wires = bus.drives.iter().map(|drive| drive.station());
    wires.clone().for_each(|wire| bus.world.cut(wire));
    let _ = bring_up::wait_until_there(&mut runner, id(20), millis(200));
    wires.for_each(|wire| bus.world.mend(wire));
    let _ = bring_up::wait_until_there(&mut runner, id(20), millis(1_000));
    check_others_hold(&bus);
}

/// Another master has had them hold.
fn motors_found_by_a_scan_hold_on<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    let (all, mut runner) = (runner.master().motors(), master(&bus));
    assert_eq!(bring_up::scan(&mut runner, all, |_, _| {}), Ok(all));
    bring_up::wait_until_there(&mut runner, id(20), millis(500)).unwrap_err();
    check_others_hold(&bus);
}

/// The stop is sent to it again and again.
fn others_hold_while_one_does_not_confirm_a_stop<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    bus.world.cut(bus.drives[5].station());
    assert!(!runner.stop(id(MOTORS), StopKind::Hold));
    for motor in others().filter(|motor| *motor != id(MOTORS)) {
        runner.ask(motor, ReadStatus1).unwrap();
    }
    bus.drives.iter().for_each(|drive| drop(happened(drive)));
    bring_up::wait_until_there(&mut runner, id(20), millis(500)).unwrap_err();
    assert_eq!(lost_their_master(&bus.drives[1..5]), []);
}

fn others_hold_until_a_stop_of_all_gives_a_dead_one_up<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    bus.world.cut(bus.drives[0].station());
    let begun = runner.now();
    assert_eq!(runner.stop_all(StopKind::Hold, MotorSet::EMPTY), id(1).into());
    let (taken, time_out) = (runner.now() - begun, W::CONFIG.reply_timeout);
    // On RS485 another motor is asked between any two of its stops.
    assert!((time_out.times(14)..=time_out.times(25)).contains(&taken), "{taken}");
    check_others_hold(&bus);
}

/// Motors whose protection acts after 300 ms.
fn protected<W: Wire>(fleet: &Fleet) -> (BusFleet<W>, W::Runner<8>, MotorSet) {
    let bus = W::drives(fleet).unwrap();
    let mut runner = master::<W>(&bus);
    let all: MotorSet = bus.drives.iter().map(|drive| drive.motor()).collect();
    for motor in all.iter() {
        let limit = Milliseconds::from_raw(300);
        assert_eq!(bring_up::protect(&mut runner, motor, limit), Ok(Protection::Confirmed));
    }
    (bus, runner, all)
}

/// When the stop was called that is to hold motors after an outage.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Called {
    /// After the outage.
    After,
    /// Before it, and it is in force.
    Before,
    /// Before it, and it was lifted.
    BeforeAndLifted,
}

/// They have no brakes. In the outage their protection cuts their outputs, and their first answers after it do not say
/// that.
fn motors_hold_after_an_outage<W: Wire>() {
    use Called::{After, Before, BeforeAndLifted};
    // Behind a second of silence they may have restarted. Then they are to be resumed once the stop is lifted.
    let shorter =
        [400, 800].map(|outage| [(outage, After), (outage, Before), (outage, BeforeAndLifted)]);
    let cases = shorter.into_iter().flatten().chain([(1_500, After), (1_500, Before)]);
    let cases =
        cases.flat_map(|(outage, called)| [(outage, called, false), (outage, called, true)]);
    for (outage, called, lost_master_heartbeat) in cases {
        let quirks = Quirks { lost_master_heartbeat, ..Quirks::default() };
        let (bus, mut runner, all) = protected::<W>(&Fleet::new(4).quirks(quirks));
        assert_eq!(runner.stop_all(StopKind::Hold, all), MotorSet::EMPTY);
        if called == BeforeAndLifted {
            runner.master().lift_stop();
        }
        for drive in &bus.drives {
            let pulls = Load { torque_nm: 3.0, ..Load::NONE };
            drive.with(|drive| drive.plant_mut().set_load(pulls).unwrap());
        }
        let mut keep_alive = KeepAlive::new();
        let mut held_again = MotorSet::EMPTY;
        for now in 0..outage + 1_100 {
            if now == 100 {
                bus.drives.iter().for_each(|drive| bus.world.cut(drive.station()));
            } else if now == 100 + outage {
                bus.drives.iter().for_each(|drive| bus.world.mend(drive.station()));
            }
            let now = runner.now();
            keep_alive.ask(
                if called == After { MotorSet::EMPTY } else { all },
                runner.master(),
                now,
            );
            let _ = runner.run_until(now + millis(1), |event| {
                keep_alive.takes(&event, now);
                if let Event::StopConfirmed { motor } = event {
                    held_again.insert(motor);
                }
            });
        }
        assert_eq!(lost_their_master(&bus.drives).len(), 4, "and so their hold");
        if called == After {
            assert_eq!(runner.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
            held_again = all;
        }
        assert_eq!(held_again, all);
        for drive in &bus.drives {
            let state = state(drive);
            assert!(state.output_on && !state.communication_lost, "{}", drive.motor());
        }
    }
}

/// They are out while others are worked with. Nobody falls for long.
fn motors_that_are_stopped_hold_after_an_outage_in_which_a_function_waits<W: Wire>() {
    let (bus, mut runner, all) = protected::<W>(&Fleet::new(4));
    assert_eq!(runner.stop_all(StopKind::Hold, all), MotorSet::EMPTY);
    bus.drives.iter().for_each(|drive| bus.world.cut(drive.station()));
    let _ = bring_up::wait_until_there(&mut runner, id(20), millis(600));
    bus.drives.iter().for_each(|drive| bus.world.mend(drive.station()));
    let _ = bring_up::wait_until_there(&mut runner, id(20), millis(500));
    assert_eq!(lost_their_master(&bus.drives).len(), 4);
    for drive in &bus.drives {
        assert!(state(drive).output_on, "{}", drive.motor());
    }
}

/// Longer than their protection allows. A read or set-points are under way, and their answers come after that.
fn motors_hold_after_the_host_was_held_up<W: Wire>() {
    for streams in [false, true] {
        let (bus, mut runner, all) = protected::<W>(&Fleet::new(2));
        let turn_on = |runner: &mut W::Runner<8>| {
            for motor in all.iter() {
                let now = runner.now();
                if streams {
                    runner.master().set_point(motor, turn(5.0), now).unwrap();
                } else {
                    let _ = runner.master().request(motor, ReadStatus1).unwrap();
                }
            }
        };
        for _ in 0..20 {
            turn_on(&mut runner);
            let next = runner.now() + millis(10);
            runner.run_until(next, |_| {}).unwrap();
        }
        turn_on(&mut runner);
        let _ = runner.poll();
        bus.world.run_for(millis(500));
        assert_eq!(runner.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
        for drive in &bus.drives {
            assert!(state(drive).output_on, "{streams} {}", drive.motor());
        }
    }
}

/// A loop whose button is pressed at this time.
struct Pressed<R>(R, Option<Instant>);

impl<R: Runner<8>> Runner<8> for Pressed<R> {
    type Error = R::Error;

    fn master(&mut self) -> &mut Master<8> {
        self.0.master()
    }

    fn now(&self) -> Instant {
        self.0.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, R::Error> {
        let now = self.now();
        if self.1.take_if(|at| *at <= now).is_some() {
            self.0.master().stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
        }
        self.0.poll()
    }

    fn idle(&mut self, until: Instant) {
        let pressed_at = self.1.map_or(until, |at| at.min(until));
        self.0.idle(pressed_at);
    }
}

/// Its id gets the stop, too, fifteen times.
fn others_hold_while_a_button_ends_a_question_to_an_absent_one<W: Wire>() {
    for pressed_after in [1, 3, 6] {
        let (bus, mut runner) = held::<W>();
        runner.master().lift_stop();
        let pressed_at = runner.now() + millis(pressed_after);
        let mut runner = Pressed(runner, Some(pressed_at));
        let _ = bring_up::is_there(&mut runner, id(20));
        assert!(!runner.master().motors().contains(id(20)));
        check_others_hold(&bus);
    }
}

fn others_hold_while_there_is_no_place_for_one_more<W: Wire>() {
    let (bus, mut runner) = held::<W>();
    for motor in [id(30), id(31)] {
        let _ = runner.master().request(motor, ReadStatus1).unwrap();
    }
    let begun = runner.now();
    assert!(bring_up::is_there(&mut runner, id(20)).is_err());
    assert!(runner.now() - begun < millis(200), "{}", runner.now() - begun);
    check_others_hold(&bus);
}

/// Behind an adapter that delivers in bursts, twelve of them are each asked every 400 ms.
#[test]
fn motors_of_a_slow_line_are_not_told_again_and_again() {
    let bus = Fleet::new(12).on_rs485(115_200).unwrap();
    let config = Config::rs485(115_200, false).adapting_up_to(millis(40));
    let (mut runner, station) = Rs485Line::runner::<16>(&bus.world, config);
    let all: MotorSet = (1..=12).map(id).collect();
    assert_eq!(runner.stop_all(StopKind::Hold, all), MotorSet::EMPTY);
    bus.world.hand_over_every(station, millis(16));
    let (mut keep_alive, mut told) = (KeepAlive::new(), Vec::new());
    for now in 0..2_000 {
        // One is out for a moment.
        match now {
            600 => bus.world.cut(bus.drives[3].station()),
            650 => bus.world.mend(bus.drives[3].station()),
            _ => {}
        }
        let now = runner.now();
        keep_alive.ask(all, runner.master(), now);
        let notes = |event| {
            keep_alive.takes(&event, now);
            if let Event::StopConfirmed { motor } | Event::StopUnconfirmed { motor } = event {
                told.push(motor);
            }
        };
        runner.run_until(now + millis(5), notes).unwrap();
    }
    assert!(told.len() <= 1, "{told:?}");
}

/// Behind such an adapter each of twelve is sent something every 400 ms while others are, too.
#[test]
fn holds_count_and_brakes_open_on_a_slow_line() {
    let bus = Fleet::new(12).on_rs485(115_200).unwrap();
    let config = Config::rs485(115_200, false).adapting_up_to(millis(40));
    let (mut runner, station) = Rs485Line::runner::<16>(&bus.world, config);
    bus.world.hand_over_every(station, millis(16));
    let all: MotorSet = (1..=12).map(id).collect();
    for _ in 0..3 {
        assert_eq!(runner.stop_all(StopKind::Hold, all), MotorSet::EMPTY);
    }
    runner.master().lift_stop();
    let begun = runner.now();
    assert_eq!(bring_up::release_brake(&mut runner, id(1)), Ok(()));
    assert!(runner.now() - begun < millis(4_000), "{}", runner.now() - begun);
}

/// Both show what a motor that holds may have met: an error, or a restart.
#[test]
fn motors_that_hold_are_asked_for_errors_and_run_time_in_turn() {
    let bus = Fleet::new(2).on_rs485(1_000_000).unwrap();
    let mut runner = bus.master::<8>();
    let (all, log) = (MotorSet::from([id(1), id(2)]), bus.world.log());
    assert_eq!(runner.stop_all(StopKind::Hold, all), MotorSet::EMPTY);
    log.take();
    let mut keep_alive = KeepAlive::new();
    for _ in 0..900 {
        let now = runner.now();
        keep_alive.ask(all, runner.master(), now);
        let takes = |event| assert!(keep_alive.takes(&event, now), "{event:?}");
        runner.run_until(now + millis(1), takes).unwrap();
    }
    let records = log.take();
    for motor in all.iter() {
        let times = [0x9A, 0xB1].map(|byte| times_sent(&records, &bus, motor, Some(byte)).len());
        assert!(times.iter().all(|times| (3..=5).contains(times)), "{motor}: {times:?}");
    }
}

/// Two loops on one bus, so that both have its time. The first waits for a dead motor.
#[test]
fn motors_of_one_loop_hold_while_guards_wait_for_another() {
    let (bus, mut runner) = held::<CanBus>();
    let mut other = master(&bus);
    other.ask(id(1), ReadStatus1).unwrap();
    bus.world.cut(bus.drives[0].station());
    runner.master().forget(id(1));
    let begun = runner.now();
    let unconfirmed = Guards::new([&mut other, &mut runner], [StopKind::Hold; 2]).finish();
    assert_eq!(unconfirmed, [id(1).into(), MotorSet::EMPTY]);
    assert!(runner.now() - begun >= millis(300), "{}", runner.now() - begun);
    check_others_hold(&bus);
    check_others_are_free(&mut runner);
}

/// It is over before anybody is asked: a motor that rests for long, and loses one answer, would count as restarted.
#[test]
fn short_stop_of_one_motor_asks_no_other() {
    let bus = Fleet::new(2).on_can(1_000_000).unwrap();
    let mut runner = bus.master::<8>();
    for motor in MotorId::all().take(2) {
        runner.ask(motor, ReadStatus1).unwrap();
    }
    let later = runner.now() + millis(1_500);
    runner.run_until(later, |_| {}).unwrap();
    bus.world.cut(bus.drives[1].station());
    assert!(runner.stop(id(1), StopKind::Hold));
    bus.world.mend(bus.drives[1].station());
    assert_eq!(runner.set_point(id(2), turn(10.0)), Ok(()));
}

/// With a reply time-out of a second. The stop of a dead motor takes 15 time-outs of 50 ms, and one more if another
/// motor has died unnoticed and is asked meanwhile.
#[test]
fn stop_is_reported_in_time_though_another_motor_has_died() {
    let bus = Fleet::new(3).on_can(1_000_000).unwrap();
    let config = Config { reply_timeout: millis(1_000), ..CanBus::CONFIG };
    let (mut runner, _) = CanBus::runner::<8>(&bus.world, config);
    for motor in MotorId::all().take(3) {
        runner.ask(motor, ReadStatus1).unwrap();
    }
    for dead in &bus.drives[..2] {
        bus.world.cut(dead.station());
    }
    let begun = runner.now();
    assert!(!runner.stop(id(1), StopKind::Hold));
    assert!(runner.now() - begun <= millis(16 * 50 + 5), "{}", runner.now() - begun);
}

/// Loaded motors on a slow line. All hold.
fn on_a_slow_line(motors: u8) -> (LineFleet, impl Runner<8, Error: PartialEq>) {
    let bus = loaded(motors).on_rs485(115_200).unwrap();
    let mut runner = bus.master::<8>();
    for motor in MotorId::all().take(motors.into()) {
        assert_eq!(bring_up::release_brake(&mut runner, motor), Ok(()));
    }
    (bus, runner)
}

/// When a motor was sent this, or anything.
fn times_sent(
    log: &[Record<Vec<u8>>],
    bus: &LineFleet,
    motor: MotorId,
    byte: Option<u8>,
) -> Vec<Instant> {
    let sent = log.iter().filter(|record| {
        let is_of_master = bus.drives.iter().all(|drive| drive.station() != record.station);
        matches!(&record.event, trace::Event::Carried { frame, .. }
            if is_of_master && frame[1] == motor.get() && byte.is_none_or(|byte| frame[3] == byte))
    });
    sent.map(Record::at).collect()
}

fn longest_pause(times: &[Instant]) -> Duration {
    times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap()
}

/// Two frames of 13 bytes of 10 bits, 0.9 ms of response, and 0.1 ms to turn around.
const SLOW_EXCHANGE: Duration = Duration::from_micros(2 * 1_129 + 900 + 100);

#[test]
fn falling_load_is_read_first_on_a_slow_line_with_many_motors() {
    let (bus, mut runner) = on_a_slow_line(8);
    bus.drives[0].with(|drive| drive.plant_mut().force_brake(Some(true)));
    let log = bus.world.log();
    let slips = bring_up::lock_brake(&mut runner, id(1));
    assert!(matches!(slips, Err(BringUpError::BrakeSlips { holds: Some(true), .. })), "{slips:?}");
    let log = log.take();
    let pause = longest_pause(&times_sent(&log, &bus, id(1), None));
    // It is spoken to every 10 ms. One more exchange may be under way before it is asked, and one behind its answer.
    assert!(pause <= millis(10) + SLOW_EXCHANGE.times(3), "{pause}");
    // The motor holds right after its brake was told to open.
    let opened = times_sent(&log, &bus, id(1), Some(0x77))[0];
    let held =
        times_sent(&log, &bus, id(1), Some(0x81)).into_iter().find(|at| *at > opened).unwrap();
    assert!(held - opened <= SLOW_EXCHANGE.times(2), "{}", held - opened);
}

#[test]
fn moving_motor_is_read_as_often_on_a_slow_line_with_many_motors() {
    let (bus, mut runner) = on_a_slow_line(8);
    let log = bus.world.log();
    let go_on = |_: &_| ControlFlow::Continue(());
    bring_up::move_to(&mut runner, id(1), go_to(30.0, 90), &Default::default(), go_on).unwrap();
    let pause = longest_pause(&times_sent(&log.take(), &bus, id(1), Some(0x92)));
    assert!(pause <= millis(20) + SLOW_EXCHANGE.times(2), "{pause}");
}

#[test]
fn eight_motors_on_a_slow_line_hold_while_one_is_worked_with() {
    let (bus, mut runner) = on_a_slow_line(8);
    for motor in MotorId::all().take(8) {
        assert_eq!(bring_up::protect(&mut runner, motor, LIMIT), Ok(Protection::Confirmed));
    }
    check_others_hold(&bus);
    let go_on = |_: &_| ControlFlow::Continue(());
    bring_up::move_to(&mut runner, id(1), go_to(30.0, 90), &Default::default(), go_on).unwrap();
    check_others_hold(&bus);
    for dead in &bus.drives[6..] {
        bus.world.cut(dead.station());
    }
    assert_eq!(bring_up::restart(&mut runner, id(1), id(1)), Ok(()));
    assert_eq!(lost_their_master(&bus.drives[1..6]), []);
}

/// Each stop of a dead one occupies the line for a time-out, and leaves the next turn to another motor.
#[test]
fn motors_on_a_slow_line_hold_until_a_stop_of_all_gives_two_dead_ones_up() {
    let (bus, mut runner) = on_a_slow_line(8);
    let limit = Milliseconds::from_raw(200);
    for motor in MotorId::all().take(8) {
        assert_eq!(bring_up::protect(&mut runner, motor, limit), Ok(Protection::Confirmed));
    }
    for dead in &bus.drives[6..] {
        bus.world.cut(dead.station());
    }
    let begun = runner.now();
    let dead = MotorId::all().skip(6).take(2).collect();
    assert_eq!(runner.stop_all(StopKind::Hold, MotorSet::EMPTY), dead);
    let taken = runner.now() - begun;
    assert!(taken > limit.into(), "{taken}");
    assert_eq!(lost_their_master(&bus.drives[..6]), []);
}

/// It may answer again. But each question to it keeps the line busy for a time-out.
#[test]
fn silent_motor_is_asked_once_in_100_ms() {
    let (bus, mut runner) = on_a_slow_line(7);
    bus.world.cut(bus.drives[6].station());
    runner.ask(id(7), ReadStatus1).unwrap_err();
    let log = bus.world.log();
    bring_up::wait_until_there(&mut runner, id(20), millis(1_000)).unwrap_err();
    let times = times_sent(&log.take(), &bus, id(7), None);
    let pauses = || times.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(pauses().min().unwrap() >= millis(100), "{times:?}");
    assert!(pauses().max().unwrap() <= millis(130), "{times:?}");
}

/// Its stop is sent again and again meanwhile.
#[test]
fn motors_hold_while_a_move_of_one_that_died_ends_with_its_stop() {
    let bus = slow_to_brake(4).on_can(1_000_000).unwrap();
    let mut runner = bus.master::<8>();
    let limit = Milliseconds::from_raw(30);
    for motor in MotorId::all().take(4) {
        assert_eq!(bring_up::release_brake(&mut runner, motor), Ok(()));
    }
    let dies = |_: &_| {
        bus.world.cut(bus.drives[0].station());
        ControlFlow::Continue(())
    };
    for motor in MotorId::all().take(4).skip(1) {
        assert_eq!(bring_up::protect(&mut runner, motor, limit), Ok(Protection::Confirmed));
    }
    bring_up::move_to(&mut runner, id(1), go_to(30.0, 90), &Default::default(), dies).unwrap_err();
    assert_eq!(lost_their_master(&bus.drives[1..]), []);
}

/// No question to the two is answered, and each is awaited.
#[test]
fn motors_on_a_slow_line_hold_while_two_with_one_id_answer_at_once() {
    let setups = [1, 1, 2, 3, 4, 5, 6, 7].map(|number| MotorSetup::new(id(number)));
    let bus = Fleet::of(setups).on_rs485(115_200).unwrap();
    let mut runner = bus.master::<8>();
    let limit = Milliseconds::from_raw(200);
    for motor in (2..=7).map(id) {
        assert_eq!(bring_up::protect(&mut runner, motor, limit), Ok(Protection::Confirmed));
        runner.ask(motor, Stop).unwrap();
    }
    assert_eq!(bring_up::is_shared(&mut runner, id(1)), Ok::<_, CallError<_>>(true));
    assert_eq!(lost_their_master(&bus.drives[2..]), []);
}

/// Each motor has to confirm three times, and the adapter hands over once in 16 ms. Later, when nobody has spoken to them
/// for two seconds, they have to do so again, and others of them are heard while the last wait for their turn.
#[test]
fn stops_of_a_long_line_behind_a_slow_adapter_are_confirmed_by_all() {
    let behind_bursts = Config::rs485(115_200, false).adapting_up_to(millis(40));
    let slow = Config::rs485(9_600, false);
    for (motors, rate, config, burst) in [
        (16, 115_200, behind_bursts, millis(16)),
        (20, 115_200, behind_bursts, millis(16)),
        (32, 115_200, behind_bursts, millis(16)),
        (32, 9_600, slow, Duration::ZERO),
    ] {
        let bus = Fleet::new(motors).on_rs485(rate).unwrap();
        let (mut runner, station) = Rs485Line::runner::<32>(&bus.world, config);
        bus.world.hand_over_every(station, burst);
        let all: MotorSet = (1..=motors).map(id).collect();
        assert_eq!(runner.stop_all(StopKind::Hold, all), MotorSet::EMPTY, "{motors}");
        let later = runner.now() + millis(2_000);
        runner.run_until(later, |_| {}).unwrap();
        assert_eq!(runner.stop_all(StopKind::Hold, all), MotorSet::EMPTY, "{motors}, later");
    }
}

/// Each look at a dead motor takes a time-out, many in a row. The living ones are confirmed all the same.
#[test]
fn first_stop_of_a_slow_line_with_dead_motors_is_confirmed_by_the_others() {
    for dead in [8, 16, 24, 28, 31] {
        let bus = Fleet::new(32).on_rs485(9_600).unwrap();
        let (mut runner, _) = Rs485Line::runner::<32>(&bus.world, Config::rs485(9_600, false));
        for drive in &bus.drives[32 - dead..] {
            bus.world.cut(drive.station());
        }
        let unconfirmed = runner.stop_all(StopKind::Hold, MotorSet::ALL);
        assert_eq!(unconfirmed, (1..=32).skip(32 - dead).map(id).collect(), "{dead}");
    }
}

/// A program that stops all again and again, as a pressed button does. Nobody spoke to the motors before for a while.
#[test]
fn a_stop_that_is_called_again_and_again_is_confirmed_by_all_of_a_line() {
    for (motors, rate, every_ms, pause_ms) in
        [(24, 115_200, 20, 300), (32, 115_200, 1, 300), (32, 115_200, 1, 0)]
    {
        let bus = Fleet::new(motors).on_rs485(rate).unwrap();
        let config = Config::rs485(rate, false).adapting_up_to(millis(40));
        let (mut runner, _) = Rs485Line::runner::<32>(&bus.world, config);
        let all: MotorSet = (1..=motors).map(id).collect();
        for motor in (0..3).flat_map(|_| all.iter()) {
            runner.ask(motor, ReadStatus1).unwrap();
        }
        bus.world.run_for(millis(pause_ms));
        let mut waiting = all;
        for now_ms in 0..1_000 {
            if now_ms % every_ms == 0 {
                runner.master().stop_all(StopKind::Hold, all).unwrap();
            }
            while let Some(event) = runner.poll().unwrap() {
                if let Event::StopConfirmed { motor } = event {
                    waiting.remove(motor);
                }
            }
            bus.world.run_for(millis(1));
        }
        assert_eq!(waiting, MotorSet::EMPTY, "{motors} {rate} {every_ms} {pause_ms}");
    }
}

/// Dead motors take most of the time, and every tenth answer of the others is lost.
#[test]
fn living_motors_of_a_slow_line_that_loses_answers_confirm_their_stop() {
    for (rate, dead, lose) in [(9_600, 1, 0.1), (9_600, 4, 0.1), (19_200, 4, 0.1)] {
        for seed in 0..20 {
            let bus = Fleet::new(16).seed(seed).on_rs485(rate).unwrap();
            let (mut runner, _) = Rs485Line::runner::<32>(&bus.world, Config::rs485(rate, false));
            for motor in (1..=16).map(id) {
                runner.ask(motor, ReadStatus1).unwrap();
            }
            for drive in &bus.drives[..dead] {
                bus.world.cut(drive.station());
            }
            let lossy = FaultPlan { lose, ..FaultPlan::NONE };
            bus.world.set_faults(Direction::ToPorts, lossy);
            let unconfirmed = runner.stop_all(StopKind::Hold, MotorSet::EMPTY);
            assert_eq!(unconfirmed, (1..=16).take(dead).map(id).collect(), "{rate} {dead} {seed}");
        }
    }
}

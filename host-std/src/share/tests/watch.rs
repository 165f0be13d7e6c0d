//! A loop over handles that is watched.

use myactuator_protocol_core::command::ErrorFlags;
use myactuator_protocol_core::io::{self, Trouble};

use super::*;
use crate::share::calls::Order;
use crate::share::watch::Watched;
use crate::share::{LoopError, Watch};

/// Longer than a busy machine keeps a thread from its work.
const NEVER_LATE: Duration = Duration::from_secs(60);

/// Turns a motor until the watch finds something, and returns that.
fn loop_until_trouble(
    bus: &SharedBus<CanError>,
    longest_silence: Duration,
    mut in_each_cycle: impl FnMut(u32),
) -> LoopError<CanError> {
    let mut watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(longest_silence);
    for cycle in 0..20_000 {
        if let Err(found) = watch.look() {
            return found;
        }
        // A set-point may be refused a moment before the watch says why.
        let _ = bus.set_point(id(1), turn(90.0));
        in_each_cycle(cycle);
        thread::sleep(time::Duration::from_millis(1));
    }
    panic!("nothing was found")
}

#[test]
fn a_loop_is_late_once_and_not_before_it_has_looked() {
    let master = &mut Master::<1>::new(Config::CAN);
    let watch = io::Watch::new(MotorSet::EMPTY, Instant::ZERO);
    let watch = watch.longest_silence(Duration::from_millis(30));
    let mut watched = Watched::new(1, &watch, StopKind::Off);
    let ms = Instant::from_millis;
    watched.is_looked_at::<()>().unwrap();
    assert!(!watched.look(master, ms(1_000)), "it begins here");
    watched.is_looked_at::<()>().unwrap();
    assert!(!watched.look(master, ms(1_010)));
    assert_eq!(watched.late_after(), Some(ms(1_040)));
    assert!(!watched.look(master, ms(1_040)));
    assert!(watched.look(master, ms(1_041)));
    assert!(!watched.look(master, ms(1_042)), "it is stopped once");
    assert_eq!(watched.late_after(), None);
    // It looks again, and hangs again.
    for now in [2_000, 3_000].map(ms) {
        is_told(&mut watched, Trouble::Late(Duration::from_millis(31)));
        assert!(!watched.look(master, now));
        assert_eq!(watched.late_after(), None);
    }
}

#[track_caller]
fn is_told(watched: &mut Watched, trouble: Trouble) {
    let LoopError::Trouble(found) = watched.is_looked_at::<()>().unwrap_err() else { panic!() };
    assert_eq!(found, trouble);
}

#[test]
fn the_motors_of_a_loop_that_hangs_are_stopped() {
    let (fleet, bus) = shared(2);
    bus.ask(id(2), turn(90.0)).unwrap();
    let events = bus.subscribe(10_000);
    let limit = Duration::from_millis(200);
    let found = loop_until_trouble(&bus, limit, |cycle| {
        if cycle == 20 {
            // Until the stop is confirmed by both, this loop does nothing.
            let hung = time::Instant::now();
            let mut running = MotorSet::from([id(1), id(2)]);
            while !running.is_empty() {
                match events.try_next() {
                    Some(Event::StopConfirmed { motor }) => running.remove(motor),
                    Some(_) => {}
                    None => thread::sleep(time::Duration::from_millis(1)),
                }
                assert!(hung.elapsed() < NOT_HELD, "nothing stops motors {running}");
            }
        }
    });
    let LoopError::Trouble(Trouble::Late(time)) = found else { panic!("{found}") };
    assert!(time > limit, "{time}");
    // It latches.
    tells(&bus.set_point(id(1), turn(90.0)).unwrap_err(), 1, RequestError::Stopped);
    assert!(fleet.drives.iter().all(|drive| drive.with(|drive| drive.state().output_on)), "held");
    // The loop goes on with a new watch.
    bus.lift_stop().unwrap();
    let mut watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(NEVER_LATE);
    for _ in 0..10 {
        watch.look().unwrap();
        bus.set_point(id(1), turn(90.0)).unwrap();
        thread::sleep(time::Duration::from_millis(1));
    }
}

/// Nothing else wakes the thread of the bus.
#[test]
fn of_two_loops_the_one_that_is_late_first_is_noticed() {
    let soon = Duration::from_millis(50);
    for limits in [[soon, NEVER_LATE], [NEVER_LATE, soon]] {
        let (_fleet, bus) = shared(2);
        bus.ask(id(1), turn(90.0)).unwrap();
        let mut events = bus.subscribe(10_000);
        let begun = time::Instant::now();
        let mut watches =
            limits.map(|limit| bus.watch(id(1).into(), StopKind::Hold).longest_silence(limit));
        watches.iter_mut().for_each(|watch| watch.look().unwrap());
        assert!(events.any(|event| event == Event::StopConfirmed { motor: id(1) }));
        assert!(begun.elapsed() < NOT_HELD / 2, "only the other was noticed");
    }
}

#[test]
fn an_error_of_a_motor_that_goes_on_answering_ends_its_loop() {
    let (fleet, bus) = shared(2);
    let found = loop_until_trouble(&bus, NEVER_LATE, |cycle| {
        if cycle == 50 {
            fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
        }
    });
    is_trouble(&found, Trouble::Errors { motor: id(1), errors: ErrorFlags::STALL });
    // The watch itself stops nothing.
    bus.set_point(id(2), turn(10.0)).unwrap();
}

#[test]
fn a_restart_of_a_motor_that_goes_on_answering_ends_its_loop() {
    let (fleet, bus) = shared(1);
    // Its run time shows it, if it has run for longer than 250 ms before.
    let found = loop_until_trouble(&bus, NEVER_LATE, |cycle| {
        if cycle == 400 {
            fleet.world.reset(fleet.drives[0].station());
        }
    });
    is_trouble(&found, Trouble::Restarted(id(1)));
    assert!(bus.has_restarted(id(1)));
    bus.resume(id(1)).unwrap();
    assert!(!bus.has_restarted(id(1)));
}

#[test]
fn a_motor_that_falls_silent_ends_its_loop() {
    let (fleet, bus) = shared(1);
    let found = loop_until_trouble(&bus, Duration::from_millis(500), |cycle| {
        if cycle == 50 {
            fleet.world.cut(fleet.drives[0].station());
        }
    });
    is_trouble(&found, Trouble::Silent(id(1)));
}

#[track_caller]
fn is_trouble(found: &LoopError<CanError>, expected: Trouble) {
    assert!(matches!(found, LoopError::Trouble(found) if *found == expected), "{found}");
}

#[test]
fn a_watch_ends_when_it_is_dropped_and_before_its_first_look_it_has_not_begun() {
    let (_fleet, bus) = shared(1);
    let limit = Duration::from_millis(50);
    let not_begun = bus.watch(id(1).into(), StopKind::Hold).longest_silence(limit);
    let mut dropped = bus.watch(id(1).into(), StopKind::Hold).longest_silence(limit);
    dropped.look().unwrap();
    drop(dropped);
    thread::sleep(time::Duration::from_millis(150));
    bus.ask(id(1), turn(10.0)).unwrap();
    assert!(bus.desk().lock().watches.is_empty());
    drop(not_begun);
}

#[test]
fn a_watch_says_that_its_bus_has_ended() {
    let (_fleet, bus) = shared(1);
    let mut watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(NEVER_LATE);
    watch.look().unwrap();
    drop(bus);
    let ended = watch.look().unwrap_err();
    assert!(matches!(ended, LoopError::Call(SharedBusError::Panicked(_))), "{ended}");
}

#[test]
fn a_watch_says_that_its_bus_is_held() {
    let (_fleet, bus) = shared(1);
    let mut watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(NEVER_LATE);
    bus.desk().lock().longest_round = time::Duration::ZERO;
    bus.desk().lock().news_since = Some(time::Instant::now());
    let held = watch.look().unwrap_err();
    assert!(matches!(held, LoopError::Call(SharedBusError::Held)), "{held}");
}

/// The thread of the bus has not taken it up before the stop.
#[test]
fn a_look_from_before_a_stop_watches_nobody_after_it() {
    let watch = io::Watch::new(MotorSet::EMPTY, Instant::ZERO);
    let mut watched = Watched::new(1, &watch, StopKind::Hold);
    watched.is_looked_at::<()>().unwrap();
    watched.end();
    assert!(!watched.look(&mut Master::<1>::new(Config::CAN), Instant::from_millis(1)));
    assert_eq!(watched.late_after(), None);
}

/// Before it knows what was found, and before it has left because of that.
#[test]
fn a_loop_that_hangs_after_trouble_is_late_too() {
    let master = &mut Master::<1>::new(Config::CAN);
    let watch = io::Watch::new(id(1).into(), Instant::ZERO);
    let mut watched = Watched::new(1, &watch, StopKind::Hold);
    let ms = Instant::from_millis;
    watched.is_looked_at::<()>().unwrap();
    assert!(!watched.look(master, ms(0)));
    watched.note(&Event::LostMaster { motor: id(1) });
    watched.is_looked_at::<()>().unwrap();
    assert!(!watched.look(master, ms(50)));
    let mut told = watched.clone();
    // 100 ms after the last look that found nothing.
    assert_eq!(watched.late_after(), Some(ms(100)));
    assert!(watched.look(master, ms(101)));
    assert!(!watched.look(master, ms(102)));
    is_told(&mut watched, Trouble::LostMaster(id(1)));
    is_told(&mut told, Trouble::LostMaster(id(1)));
    // 100 ms after it was told.
    assert!(!told.look(master, ms(60)));
    assert_eq!(told.late_after(), Some(ms(160)));
    assert!(!told.look(master, ms(160)));
    assert!(told.look(master, ms(161)));
    assert!(!told.look(master, ms(162)));
    is_told(&mut told, Trouble::LostMaster(id(1)));
}

/// A watch of a motor, whose loop was just told of trouble.
fn told(bus: &SharedBus<CanError>) -> Watch<CanError> {
    bus.ask(id(1), Stop).unwrap();
    let limit = Duration::from_millis(100);
    let mut watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(limit);
    watch.look().unwrap();
    bus.desk().lock().watches[0].note(&Event::LostMaster { motor: id(1) });
    while watch.look().is_ok() {
        thread::yield_now();
    }
    watch
}

/// The old watch is still there when its loop has left and something else is done.
#[test]
fn a_watch_ends_when_all_are_stopped_after_its_trouble() {
    for is_waited_for in [false, true] {
        let (_fleet, bus) = shared(1);
        let watch = told(&bus);
        let stop = bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY);
        if is_waited_for {
            assert!(stop.wait().unwrap().is_empty());
        } else {
            drop(stop);
        }
        bus.lift_stop().unwrap();
        thread::sleep(time::Duration::from_millis(200));
        bus.ask(id(1), turn(10.0)).unwrap();
        drop(watch);
    }
}

/// It was held up while all were stopped and the stop was lifted. Behind that it does not go on, nor is it late.
#[test]
fn a_stop_of_all_ends_the_watch_of_a_loop_that_has_not_seen_it() {
    for is_lifted in [true, false] {
        let (_fleet, bus) = shared(1);
        let limit = Duration::from_millis(100);
        let mut watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(limit);
        watch.look().unwrap();
        bus.set_point(id(1), turn(90.0)).unwrap();
        assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty());
        if is_lifted {
            bus.lift_stop().unwrap();
        }
        for _ in 0..2 {
            assert!(matches!(watch.look(), Err(LoopError::Stopped)));
            thread::sleep(time::Duration::from_millis(150));
        }
        bus.lift_stop().unwrap();
        bus.ask(id(1), turn(10.0)).unwrap();
        // It goes on with another.
        let mut watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(NEVER_LATE);
        for _ in 0..10 {
            watch.look().unwrap();
            thread::sleep(time::Duration::from_millis(1));
        }
    }
}

/// Nobody else would: the motors of other threads go on.
#[test]
fn a_panic_that_drops_a_watch_stops_all() {
    let (fleet, bus) = shared(2);
    bus.ask(id(2), turn(90.0)).unwrap();
    let mut events = bus.subscribe(10_000);
    let mut watch = bus.watch(MotorSet::EMPTY, StopKind::Hold).longest_silence(NEVER_LATE);
    let supervisor = thread::spawn(move || {
        watch.look().unwrap();
        // The thread of the bus sleeps.
        thread::sleep(time::Duration::from_millis(50));
        panic!("of the test");
    });
    assert!(supervisor.join().is_err());
    assert!(events.any(|event| event == Event::StopConfirmed { motor: id(2) }));
    assert!(fleet.drives[1].with(|drive| drive.state()).output_on, "it holds");
}

/// Its loop does not know, and would move it when that stop is lifted. It is watched until it has left: others move.
#[test]
fn a_stop_of_a_watched_motor_ends_its_loop() {
    let (_fleet, bus) = shared(3);
    let mut events = bus.subscribe(10_000);
    let limit = Duration::from_millis(200);
    let watched = MotorSet::from([id(1), id(2)]);
    let mut watch = bus.watch(watched, StopKind::Hold).longest_silence(limit);
    let mut other = bus.watch(id(3).into(), StopKind::Hold).longest_silence(NEVER_LATE);
    watch.look().unwrap();
    other.look().unwrap();
    bus.ask(id(2), turn(90.0)).unwrap();
    assert!(bus.stop(id(1), StopKind::Hold).unwrap().is_empty());
    bus.lift_stop_of(id(1)).unwrap();
    assert!(matches!(watch.look(), Err(LoopError::Stopped)));
    other.look().unwrap();
    // It hangs before it has left.
    assert!(events.any(|event| event == Event::StopConfirmed { motor: id(2) }));
}

#[test]
fn a_locked_brake_that_has_to_be_open_ends_its_loop() {
    let (_fleet, bus) = shared_fleet(&Fleet::new(1).brakes(true));
    let watch = bus.watch(id(1).into(), StopKind::Hold).longest_silence(NEVER_LATE);
    let mut watch = watch.open_brakes(id(1).into());
    let found = loop {
        match watch.look() {
            Ok(()) => thread::sleep(time::Duration::from_millis(1)),
            Err(found) => break found,
        }
    };
    is_trouble(&found, Trouble::BrakeLocked(id(1)));
}

/// A loop that hangs speaks to nobody, nor does one that has left. Their motors hold all the same.
#[test]
fn motors_of_a_loop_that_hangs_hold() {
    let (fleet, bus) = shared(1);
    bus.protect(id(1), Milliseconds::from_raw(300)).unwrap();
    let state = || fleet.drives[0].with(|drive| drive.state());
    let _found = loop_until_trouble(&bus, Duration::from_millis(100), |cycle| {
        if cycle == 20 {
            thread::sleep(time::Duration::from_millis(1_000));
            assert!(state().output_on && !state().communication_lost);
        }
    });
    // It has left, and its watch with it.
    thread::sleep(time::Duration::from_millis(700));
    assert!(state().output_on && !state().communication_lost);
}

/// The watch outlives the guard's stop. What that holds must not be let go, nor switched on what that lets go. A loop
/// that looks once more under the stop, and not again, changes nothing either.
#[test]
fn a_loop_that_does_not_look_changes_no_stop_of_all_that_is_in_force() {
    use StopKind::{Hold, Off};
    for (in_force, of_watch, looks_again) in
        [(Hold, Off, false), (Off, Hold, false), (Hold, Off, true), (Off, Hold, true)]
    {
        let (fleet, bus) = shared(1);
        let mut watch =
            bus.watch(id(1).into(), of_watch).longest_silence(Duration::from_millis(20));
        watch.look().unwrap();
        bus.set_point(id(1), turn(90.0)).unwrap();
        assert_eq!(bus.stop_all(in_force, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
        if looks_again {
            let _ = watch.look();
        }
        thread::sleep(time::Duration::from_millis(100));
        bus.ask(id(1), ReadStatus1).unwrap();
        let is_on = fleet.drives[0].with(|drive| drive.state()).output_on;
        assert_eq!(is_on, in_force == Hold, "{in_force:?} {looks_again}");
    }
}

#[test]
fn virtual_time_stands_still_while_a_loop_that_is_watched_does_nothing() {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
    held_after(&bus, NOT_HELD);
    bus.ask(id(1), ReadStatus1).unwrap();
    let mut watch = bus.watch(id(1).into(), StopKind::Hold);
    watch.look().unwrap();
    // The question of the watch, and its answer.
    thread::sleep(time::Duration::from_millis(30));
    let stands_still = || {
        let now = fleet.world.now();
        thread::sleep(time::Duration::from_millis(30));
        assert_eq!(fleet.world.now(), now);
    };
    stands_still();
    watch.look().unwrap();
    // Also while the bus asks motors that its loop leaves alone.
    assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty());
    thread::sleep(time::Duration::from_millis(30));
    stands_still();
    drop(watch);
}

/// The stop is lifted before the thread has seen either. The loop has left because of it.
#[test]
fn a_look_under_a_stop_does_not_count_after_it() {
    let desk: Desk<CanError> = Desk::new(None);
    let watch = io::Watch::new(MotorSet::EMPTY, Instant::ZERO);
    let master = &mut Master::<1>::new(Config::CAN);
    let mut key = None;
    desk.look(&mut key, &watch, StopKind::Hold).unwrap();
    let looks = |desk: &Desk<CanError>, at: u64, master: &mut Master<1>| {
        desk.lock().watches[0].look(master, Instant::from_millis(at))
    };
    assert!(!looks(&desk, 0, master));
    let _stop = desk.stop_all(StopKind::Hold, MotorSet::EMPTY);
    for _ in 0..2 {
        let stopped = desk.look(&mut key, &watch, StopKind::Hold);
        assert!(matches!(stopped, Err(LoopError::Stopped)));
        desk.order(Order::LiftStop).unwrap();
        assert!(!looks(&desk, 10, master));
        assert_eq!(desk.lock().watches[0].late_after(), None);
    }
}

/// Long before 2 s: its motors run on with the set-points that they have.
#[test]
fn a_watch_says_soon_that_its_bus_is_held() {
    let desk: Desk<CanError> = Desk::new(None);
    let limit = Duration::from_millis(30);
    let watch = io::Watch::new(MotorSet::EMPTY, Instant::ZERO).longest_silence(limit);
    let mut key = None;
    desk.look(&mut key, &watch, StopKind::Hold).unwrap();
    // Nobody takes that up. In virtual time that may be because its world takes long.
    thread::sleep(time::Duration::from_millis(31));
    let mut look = |in_real_time| desk.lock().look(&mut key, &watch, StopKind::Hold, in_real_time);
    assert!(matches!(look(true), Err(LoopError::Call(SharedBusError::Held))));
    look(false).unwrap();
}

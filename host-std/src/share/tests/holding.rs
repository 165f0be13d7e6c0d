//! Motors that hold, and are spoken to by the thread of the bus so that their protection (0xB3) does not let them go.

use super::*;

/// What was commanded to this motor on the wire since this was last asked.
fn commands_to(log: &Log<SimpleFrame>, motor: u8) -> Vec<u8> {
    let to = Channel::Command(id(motor).into());
    packets(log).iter().filter(|packet| packet.channel == to).map(|packet| packet.data[0]).collect()
}

/// Whoever moved them has stopped them, and need not keep them alive any more. A restart takes more than a second.
#[test]
fn motors_that_were_moved_and_stopped_hold_while_another_is_restarted() {
    let fleet = Fleet::new(3).on_can(1_000_000).unwrap();
    let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
    for motor in [2, 3] {
        bus.protect(id(motor), Milliseconds::from_raw(300)).unwrap();
    }
    // Behind that: virtual time goes on while a function is at work, and what its thread moves is not asked.
    for motor in [2, 3] {
        bus.ask(id(motor), turn(90.0)).unwrap();
    }
    bus.ask(id(2), Stop).unwrap();
    assert_eq!(bus.stop(id(3), StopKind::Hold).unwrap(), MotorSet::EMPTY);
    bus.restart(id(1)).unwrap();
    for drive in &fleet.drives[1..] {
        assert!(drive.with(|drive| drive.state()).output_on, "motor {}", drive.motor());
    }
}

type Tell = fn(&SharedBus<CanError>);

/// Half a second after each of these a motor with a shorter protection has lost its master, or has not.
fn has_let_go_after<const M: usize>(tell: [Tell; M]) -> [bool; M] {
    let (fleet, bus) = shared(1);
    bus.protect(id(1), Milliseconds::from_raw(300)).unwrap();
    tell.map(|tell| {
        tell(&bus);
        thread::sleep(time::Duration::from_millis(500));
        fleet.drives[0].with(|drive| drive.state().communication_lost)
    })
}

/// Whoever waits for a person, or for another bus to be ready, speaks to nobody.
#[test]
fn motors_that_hold_are_asked_until_they_are_told_otherwise() {
    let holds: [Tell; 5] = [
        |bus| {
            let there = AbsolutePosition {
                max_speed: MaxSpeed::from_dps(90.0).unwrap(),
                angle: Angle::from_degrees(5.0).unwrap(),
            };
            let go_on = |_: &_| ControlFlow::Continue(());
            bus.move_to(id(1), there, &MoveLimits::default(), go_on).unwrap();
        },
        |bus| assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty()),
        |bus| assert!(bus.stop(id(1), StopKind::Hold).unwrap().is_empty()),
        |bus| bus.release_brake(id(1)).unwrap(),
        |bus| assert!(bus.ask(id(1), Stop).is_ok()),
    ];
    let turns: [Tell; 2] = [
        |bus| bus.set_point(id(1), turn(30.0)).unwrap(),
        |bus| assert!(bus.ask(id(1), turn(30.0)).is_ok()),
    ];
    for (hold, turn) in holds.into_iter().zip(turns.into_iter().cycle()) {
        let lift: Tell = |bus| bus.lift_stop().unwrap();
        assert_eq!(has_let_go_after([hold, lift, turn]), [false, false, true]);
    }
}

/// Its protection may lock a brake behind which nothing holds. Whoever waits meanwhile learns of it.
#[test]
fn a_motor_in_error_is_not_asked() {
    let (fleet, bus) = shared(1);
    let mut events = bus.subscribe(1_000);
    assert!(bus.stop_all(StopKind::Hold, id(1).into()).unwrap().is_empty());
    let log = fleet.world.log();
    thread::sleep(time::Duration::from_millis(500));
    assert!(!packets(&log).is_empty());
    fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
    thread::sleep(time::Duration::from_millis(500));
    log.take();
    thread::sleep(time::Duration::from_millis(300));
    assert_eq!(packets(&log), []);
    assert!(events.any(|event| matches!(event, Event::Report { motor, .. } if motor == id(1))));
}

/// Its protection is longer than that, so it holds all the time. Another motor acknowledges the frames to it, so that
/// the first that is heard of it is an answer in time.
#[test]
fn a_motor_that_was_silent_for_a_second_goes_on_being_held() {
    let (fleet, bus) = shared(2);
    for motor in [1, 2] {
        bus.ask(id(motor), Stop).unwrap();
    }
    fleet.world.cut(fleet.drives[0].station());
    thread::sleep(time::Duration::from_millis(1_300));
    fleet.world.mend(fleet.drives[0].station());
    thread::sleep(time::Duration::from_millis(300));
    assert!(bus.has_restarted(id(1)), "it may have");
    let log = fleet.world.log();
    thread::sleep(time::Duration::from_millis(500));
    let asked = commands_to(&log, 1).len();
    assert!(asked > 3, "{asked}");
    // Nor does a loop that hangs switch it off.
    let mut watch =
        bus.watch(id(2).into(), StopKind::Off).longest_silence(Duration::from_millis(50));
    watch.look().unwrap();
    thread::sleep(time::Duration::from_millis(200));
    assert!(fleet.drives[0].with(|drive| drive.state()).output_on);
}

/// Its protection may lock a brake behind which nothing holds. Whoever waits meanwhile learns of it.
#[test]
fn the_error_of_a_motor_that_holds_is_found_while_a_function_waits() {
    let (fleet, bus) = shared(1);
    assert!(bus.stop_all(StopKind::Hold, id(1).into()).unwrap().is_empty());
    let (mut events, log) = (bus.subscribe(10_000), fleet.world.log());
    let waiting = thread::spawn({
        let bus = bus.clone();
        move || bus.wait_until_there(id(9), Duration::from_millis(1_200)).is_err()
    });
    thread::sleep(time::Duration::from_millis(300));
    assert!(!commands_to(&log, 1).is_empty());
    fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
    thread::sleep(time::Duration::from_millis(500));
    log.take();
    assert!(waiting.join().unwrap());
    assert!(commands_to(&log, 1).is_empty());
    assert!(events.any(|event| matches!(event, Event::Report { motor, .. } if motor == id(1))));
}

/// It is asked while it is to be forgotten, or told to stop: then it keeps its place, and goes on holding.
#[test]
fn a_motor_that_answers_after_all_is_not_forgotten() {
    let questions: [fn(&SharedBus<CanError>) -> bool; 2] = [
        |bus| {
            let patient = Patience { reply_timeout: Duration::from_millis(20), attempts: 15 };
            bus.ask_with(id(1), ReadStatus1, patient).is_ok()
        },
        |bus| bus.stop(id(1), StopKind::Hold).unwrap().is_empty(),
    ];
    for question in questions {
        let (fleet, bus) = shared(2);
        bus.protect(id(1), Milliseconds::from_raw(300)).unwrap();
        bus.ask(id(1), Stop).unwrap();
        fleet.world.cut(fleet.drives[0].station());
        let asking = thread::spawn({
            let bus = bus.clone();
            move || question(&bus)
        });
        thread::sleep(time::Duration::from_millis(30));
        bus.forget(id(1)).unwrap();
        thread::sleep(time::Duration::from_millis(10));
        fleet.world.mend(fleet.drives[0].station());
        assert!(asking.join().unwrap());
        thread::sleep(time::Duration::from_millis(500));
        assert!(!fleet.drives[0].with(|drive| drive.state()).communication_lost);
        let log = fleet.world.log();
        assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty());
        assert!(commands_to(&log, 1).contains(&0x81), "it has its place");
    }
}

/// Others are spoken to all the time.
#[test]
fn dead_ids_are_forgotten_though_they_were_just_asked() {
    let (fleet, bus) = shared(3);
    for motor in 1..=3 {
        bus.ask(id(motor), Stop).unwrap();
    }
    for drive in &fleet.drives[..2] {
        fleet.world.cut(drive.station());
    }
    thread::sleep(time::Duration::from_millis(300));
    for motor in [1, 2] {
        bus.forget(id(motor)).unwrap();
    }
    let begun = time::Instant::now();
    while begun.elapsed() < time::Duration::from_millis(200) {
        bus.set_point(id(3), turn(10.0)).unwrap();
        thread::sleep(time::Duration::from_millis(1));
    }
    assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
}

/// They may hold a load: nobody knows.
#[test]
fn motors_that_were_told_nothing_are_asked_while_a_function_waits() {
    let (fleet, bus) = shared(2);
    bus.protect(id(2), Milliseconds::from_raw(300)).unwrap();
    bus.ask(id(1), ReadStatus1).unwrap();
    bus.restart(id(1)).unwrap();
    assert!(!fleet.drives[1].with(|drive| drive.state()).communication_lost);
}

/// It is not told, and does not move: its bus has no such command.
#[test]
fn a_set_point_that_is_refused_ends_no_holding() {
    let (fleet, bus) = shared_line(1, 1_000_000);
    bus.protect(id(1), Milliseconds::from_raw(300)).unwrap();
    bus.ask(id(1), Stop).unwrap();
    let motion = MotionRanges::V4_3.quantise(&MotionSetPoint::default()).unwrap();
    let _ = bus.set_point(id(1), motion);
    thread::sleep(time::Duration::from_millis(500));
    assert!(!fleet.drives[0].with(|drive| drive.state()).communication_lost);
}

/// It would keep a brake open behind which nothing holds.
#[test]
fn motors_that_are_off_are_not_asked() {
    let off: [Tell; 4] = [
        |bus| {
            // It stays off, also when both are lifted.
            assert!(bus.stop(id(1), StopKind::Off).unwrap().is_empty());
            assert!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap().is_empty());
            bus.lift_stop().unwrap();
        },
        |bus| assert!(bus.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap().is_empty()),
        |bus| {
            // It stays off.
            for kind in [StopKind::Off, StopKind::Hold] {
                assert!(bus.stop(id(1), kind).unwrap().is_empty());
            }
        },
        |bus| assert!(bus.ask(id(1), Shutdown).is_ok()),
    ];
    for off in off {
        let hold: Tell = |bus| assert!(bus.ask(id(1), Stop).is_ok());
        assert_eq!(has_let_go_after([hold, off]), [false, true]);
    }
}

/// They come when the function that asked is over.
#[test]
fn nobody_hears_how_questions_that_keep_motors_alive_have_ended() {
    let (fleet, bus) = shared(2);
    bus.ask(id(1), ReadStatus1).unwrap();
    bus.ask(id(2), ReadStatus1).unwrap();
    fleet.world.cut(fleet.drives[1].station());
    let mut events = bus.subscribe(10_000);
    // A question to it is under way for 20 ms of each 100.
    for pause in 0..20 {
        bus.wait_until_stands(id(1), Duration::from_secs(60)).unwrap();
        thread::sleep(time::Duration::from_millis(30 + pause));
    }
    drop(bus);
    let of_second =
        |event| matches!(event, Event::Failed { ticket, .. } if ticket.motor() == id(2));
    assert!(!events.any(of_second));
}

/// On a line that two streams fill.
#[test]
fn a_motor_that_holds_is_asked_on_a_full_line() {
    let (fleet, bus) = shared_line(3, 115_200);
    for motor in 1..=3 {
        bus.ask(id(motor), ReadStatus1).unwrap();
    }
    bus.protect(id(3), Milliseconds::from_raw(300)).unwrap();
    assert!(bus.stop(id(3), StopKind::Hold).unwrap().is_empty());
    let begun = time::Instant::now();
    while begun.elapsed() < time::Duration::from_millis(1_000) {
        for motor in [1, 2] {
            bus.set_point(id(motor), turn(30.0)).unwrap();
        }
        thread::sleep(time::Duration::from_millis(1));
        let state = fleet.drives[2].with(|drive| drive.state());
        assert!(!state.communication_lost, "after {:?}", begun.elapsed());
    }
}

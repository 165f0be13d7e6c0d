//! Calls that wait for more than one answer: joint requests, set-points with their feedback, watched moves.

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};

use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::plant::{EndStop, Load};
use myactuator_protocol_core::RequestError;
use myactuator_protocol_core::command::{
    AnyReply, IncrementalPosition, ReadModel, ReadMultiTurnAngle, ReadStatus2, Stop,
};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::io::bring_up::{
    self, MoveFailure, MoveLimits, MoveProgress, Protection, WhenStalled,
};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Failure, MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, Milliseconds};
use myactuator_tests::fleet::{master, state, turn_to};
use myactuator_tests::listen::listen;
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{degrees, go_to, grip_at, id, millis, push, turn, up_to};
use myactuator_tests::wire::Wire;

on_both_buses! {
    ask_together_returns_each_motors_own_reply
    run_until_runs_up_to_the_given_time
    set_point_and_wait_returns_its_own_feedback
    a_set_point_that_cannot_be_sent_or_is_not_answered_is_reported
    the_newest_feedback_is_kept
    a_motor_arrives_and_holds
    relative_move_counts_from_where_the_shaft_is
    motor_that_is_held_is_reported_stalled_and_stopped
    a_move_ends_when_its_time_is_up
    a_move_is_given_up
    restart_during_a_move_is_reported_as_a_restart
    a_pause_between_two_looks_is_not_reported_as_a_restart
    panic_during_a_move_stops_the_motor
    a_protected_motor_is_moved_after_a_pause
    fault_during_a_move_ends_it
    stop_of_all_reaches_motors_unknown_to_the_master
    a_motor_that_falls_silent_has_not_confirmed_its_stop
    a_motor_that_comes_back_under_a_stop_is_stopped
    restart_during_a_move_ends_it_and_forbids_another
    motor_whose_cable_was_cut_may_have_restarted
    gripper_goes_on_pressing_with_the_given_torque
    force_that_drives_a_gripper_away_is_no_grip
    a_gripper_that_never_moved_has_gripped_nothing
    motor_that_cut_its_output_neither_presses_nor_stalls
    gripper_that_let_go_during_the_last_look_does_not_press
}

fn ask_together_returns_each_motors_own_reply<W: Wire>() {
    let bus = W::drives(&Fleet::new(4)).unwrap();
    let runner = &mut master(&bus);
    for (drive, angle) in bus.drives.iter().zip([10.0, 20.0, 30.0, 40.0]) {
        turn_to(drive, angle);
    }
    listen(runner, millis(20));
    // One of them is not answered. Another waits for an earlier one to the same motor.
    let asked = [1, 2, 9, 4, 3, 4].map(|motor| (id(motor), ReadMultiTurnAngle));
    let answers = runner.ask_together(asked);
    let returned = answers.map(|answer| answer.map(|reply| reply.angle.degrees().round()));
    let silent = Err(CallError::Failed { motor: id(9), failure: Failure::NoReply });
    assert_eq!(returned, [Ok(10.0), Ok(20.0), silent, Ok(40.0), Ok(30.0), Ok(40.0)]);

    runner.master().stop(id(2), StopKind::Hold).unwrap();
    listen(runner, millis(50));
    let moved = runner.ask_together([1, 2].map(|motor| (id(motor), turn(5.0))));
    assert!(moved[0].is_ok());
    assert_eq!(moved[1], Err(CallError::refused(id(2))(RequestError::Stopped)));
    let none: [_; 0] = runner.ask_together::<ReadModel, 0>([]);
    assert!(none.is_empty());
}

#[test]
fn after_a_stop_on_a_dead_bus_no_call_waits_for_ever() {
    let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
    let mut bus = fleet.master::<8>();
    fleet.world.cut(fleet.drives[0].station());
    assert_eq!(bus.stop_all(StopKind::Hold, id(1).into()), id(1).into());
    let busy = CallError::refused(id(1))(RequestError::Busy);
    assert_eq!(bus.ask(id(1), ReadMultiTurnAngle), Err(busy));
    let returned = bus.ask_together([1, 2].map(|motor| (id(motor), ReadMultiTurnAngle)));
    assert_eq!(
        returned,
        [Err(busy), Err(CallError::Failed { motor: id(2), failure: Failure::BusDown })]
    );
}

#[test]
fn four_motors_on_can_are_asked_in_less_than_the_time_of_two() {
    let fleet = Fleet::new(4).on_can(1_000_000).unwrap();
    let mut bus = fleet.master::<8>();
    let begun = bus.now();
    bus.ask(id(1), ReadMultiTurnAngle).unwrap();
    let one = bus.now() - begun;
    let begun = bus.now();
    let asked = [1, 2, 3, 4].map(|motor| (id(motor), ReadMultiTurnAngle));
    assert!(bus.ask_together(asked).iter().all(Result::is_ok));
    assert!(bus.now() - begun < one.times(2), "{} for four, {one} for one", bus.now() - begun);
}

fn stop_of_all_reaches_motors_unknown_to_the_master<W: Wire>() {
    let bus = W::drives(&Fleet::new(3)).unwrap();
    let runner = &mut master(&bus);
    runner.master().broadcast(turn(90.0), id(1).into()).unwrap();
    listen(runner, millis(500));
    let speeds = || bus.drives.iter().map(|drive| state(drive).measurement.speed_dps.abs());
    assert!(
        speeds().all(|speed| speed > 80.0),
        "all have heard it: {:?}",
        speeds().collect::<Vec<_>>()
    );
    assert_eq!(runner.stop_all(StopKind::Hold, MotorSet::EMPTY), MotorSet::EMPTY);
    assert_eq!(runner.master().motors(), id(1).into());
    listen(runner, millis(500));
    assert!(speeds().all(|speed| speed < 1.0), "{:?}", speeds().collect::<Vec<_>>());
}

fn run_until_runs_up_to_the_given_time<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    let ticket = runner.master().request(id(1), ReadMultiTurnAngle).unwrap();
    let mut returned = Vec::new();
    let begun = runner.now();
    runner.run_until(begun + millis(30), |event| returned.push(event)).unwrap();
    assert_eq!(runner.now() - begun, millis(30));
    assert!(matches!(returned[..], [event] if ticket.outcome(&event).is_some_and(|it| it.is_ok())));
    // Even if the time has passed already, each call sends and receives.
    let ticket = runner.master().request(id(1), ReadMultiTurnAngle).unwrap();
    let mut outcome = None;
    let mut rounds = 0;
    while outcome.is_none() {
        runner.run_until(begun, |event| outcome = ticket.outcome(&event)).unwrap();
        let soon = runner.now() + millis(1);
        runner.idle(soon);
        rounds += 1;
        assert!(rounds < 100);
    }
    assert!(matches!(outcome, Some(Ok(_))));
}

fn set_point_and_wait_returns_its_own_feedback<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    // One of the same kind is in flight. Its feedback must not pass for that of the next.
    runner.set_point(id(1), push(0.1)).unwrap();
    // On RS485 it is sent after the reads that show whether there is an echo.
    while !runner.master().is_anything_in_flight() {
        assert_eq!(runner.poll().unwrap(), None);
        let soon = runner.now() + myactuator_protocol_core::time::Duration::from_micros(50);
        runner.idle(soon);
    }
    let sent = runner.now();
    let feedback = runner.set_point_and_wait(id(1), push(0.2)).unwrap();
    assert!(runner.now() - sent >= millis(1), "two exchanges take longer");
    assert_eq!(runner.master().health(id(1)).answered, 2);
    assert!(feedback.temperature.celsius() > 0.0);
}

fn a_set_point_that_cannot_be_sent_or_is_not_answered_is_reported<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    bus.world.cut(bus.drives[0].station());
    let silent = runner.set_point_and_wait(id(1), push(0.1));
    // On CAN nothing acknowledges the frame, so the bus takes no other frame.
    assert!(
        matches!(
            silent,
            Err(CallError::Failed { failure: Failure::NoReply | Failure::Dropped, .. })
        ),
        "{silent:?}"
    );
    bus.world.mend(bus.drives[0].station());
    assert!(runner.stop(id(1), StopKind::Hold));
    let refused = runner.set_point_and_wait(id(1), push(0.1));
    assert_eq!(refused, Err(CallError::refused(id(1))(RequestError::Stopped)));
}

fn the_newest_feedback_is_kept<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    assert_eq!(runner.master().latest_feedback(id(1)), None);
    runner.ask(id(1), Stop).unwrap();
    assert_eq!(runner.master().latest_feedback(id(1)), None, "the motor follows no stream");
    for angle in [5.0, 50.0] {
        turn_to(&bus.drives[0], angle);
        let feedback = runner.set_point_and_wait(id(1), push(0.0)).unwrap();
        assert_eq!(f64::from(feedback.angle.degrees()), angle);
        let now = runner.now();
        let kept = runner.master().latest_feedback(id(1));
        assert_eq!(kept, Some((AnyReply::Torque(feedback), now)));
    }
}

const TO_90_DEG: fn() -> myactuator_protocol_core::command::AbsolutePosition = || go_to(90.0, 180);

fn a_motor_arrives_and_holds<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    let mut angles = Vec::new();
    let arrival = bring_up::move_to(runner, id(1), TO_90_DEG(), &MoveLimits::default(), |look| {
        angles.push(look.angle.degrees());
        ControlFlow::Continue(())
    });
    let arrival = arrival.expect("nothing is in its way");
    assert!((arrival.angle.degrees() - 90.0).abs() <= 0.2, "{arrival:?}");
    assert!(arrival.time >= millis(500), "it is no faster than 180 dps: {}", arrival.time);
    assert!(angles.len() > 20 && angles[0] < 1.0, "it was looked at all the way: {angles:?}");
    listen(runner, millis(500));
    assert!((state(&bus.drives[0]).angle_deg - 90.0).abs() < 0.3, "it holds");
    assert!(runner.ask(id(1), TO_90_DEG()).is_ok(), "nothing has stopped it");
}

fn relative_move_counts_from_where_the_shaft_is<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    turn_to(&bus.drives[0], -30.0);
    listen(runner, millis(20));
    let by = IncrementalPosition { max_speed: up_to(180), angle: degrees(40.0) };
    let go_on = |_: &_| ControlFlow::Continue(());
    let arrival = bring_up::move_to(runner, id(1), by, &MoveLimits::default(), go_on).unwrap();
    assert_eq!(arrival.target.degrees().round(), 10.0);
    assert!((arrival.angle.degrees() - 10.0).abs() <= 0.3);
}

/// Moves a motor with so little torque that friction holds its shaft. Returns why it did not arrive, and whether it is
/// stopped.
fn held<W: Wire>(limits: &MoveLimits) -> (MoveFailure<()>, bool) {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    let go_on = |_: &_| ControlFlow::Continue(());
    let not_arrived =
        bring_up::move_to(runner, id(1), grip_at(90.0, 1), limits, go_on).expect_err("it is held");
    let why = match not_arrived.why {
        MoveFailure::Stalled { at, target } => MoveFailure::Stalled { at, target },
        MoveFailure::TimedOut { at, target } => MoveFailure::TimedOut { at, target },
        other => panic!("{other}"),
    };
    let refused = runner.set_point(id(1), push(0.1));
    assert_eq!(refused, Err(CallError::refused(id(1))(RequestError::Stopped)), "the stop holds");
    (why, not_arrived.is_stopped)
}

fn motor_that_is_held_is_reported_stalled_and_stopped<W: Wire>() {
    let (why, is_stopped) = held::<W>(&MoveLimits::default());
    assert!(
        matches!(why, MoveFailure::Stalled { target, .. } if target == degrees(90.0)),
        "{why:?}"
    );
    assert!(is_stopped);
}

fn a_move_ends_when_its_time_is_up<W: Wire>() {
    let limits = MoveLimits { time: Some(millis(300)), ..MoveLimits::default() };
    let (why, is_stopped) = held::<W>(&limits);
    assert!(matches!(why, MoveFailure::TimedOut { .. }), "{why:?}");
    assert!(is_stopped);
}

fn a_move_is_given_up<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    let not_arrived =
        bring_up::move_to(runner, id(1), TO_90_DEG(), &MoveLimits::default(), |look| {
            if look.angle.degrees() < 30.0 {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        })
        .expect_err("it was given up");
    assert_eq!((not_arrived.why, not_arrived.is_stopped), (MoveFailure::GivenUp, true));
    listen(runner, millis(500));
    let at = state(&bus.drives[0]).angle_deg;
    assert!((29.0..60.0).contains(&at), "{at}");
}

fn panic_during_a_move_stops_the_motor<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let mut runner = master(&bus);
    let moving = AssertUnwindSafe(|| {
        let _ =
            bring_up::move_to(&mut runner, id(1), TO_90_DEG(), &MoveLimits::default(), |look| {
                assert!(look.angle.degrees() < 30.0, "on purpose");
                ControlFlow::Continue(())
            });
    });
    assert!(catch_unwind(moving).is_err());
    // Nobody runs the loop any more.
    bus.world.run_for(millis(500));
    let at = state(&bus.drives[0]).angle_deg;
    assert!((29.0..60.0).contains(&at), "{at}");
}

fn a_protected_motor_is_moved_after_a_pause<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    let limit = Milliseconds::from_raw(100);
    assert_eq!(bring_up::protect(runner, id(1), limit), Ok(Protection::Confirmed));
    listen(runner, millis(300));
    assert!(state(&bus.drives[0]).communication_lost);
    let go_on = |_: &_| ControlFlow::Continue(());
    let arrival = bring_up::move_to(runner, id(1), TO_90_DEG(), &MoveLimits::default(), go_on);
    assert!(arrival.is_ok(), "{arrival:?}");
}

fn fault_during_a_move_ends_it<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    let drive = &bus.drives[0];
    let not_arrived = bring_up::move_to(runner, id(1), TO_90_DEG(), &MoveLimits::default(), |_| {
        drive.with(|drive| drive.plant_mut().force_supply_voltage_v(Some(5.0)).unwrap());
        ControlFlow::Continue(())
    })
    .expect_err("there is an error");
    assert!(matches!(not_arrived.why, MoveFailure::Fault(_)), "{not_arrived}");
}

fn a_motor_that_falls_silent_has_not_confirmed_its_stop<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    let not_arrived = bring_up::move_to(runner, id(1), TO_90_DEG(), &MoveLimits::default(), |_| {
        bus.world.cut(bus.drives[0].station());
        ControlFlow::Continue(())
    })
    .expect_err("it is silent");
    assert!(matches!(not_arrived.why, MoveFailure::Silent { .. }), "{not_arrived}");
    assert!(!not_arrived.is_stopped);
    assert!(not_arrived.to_string().ends_with("cut its power"), "{not_arrived}");
}

fn a_motor_that_comes_back_under_a_stop_is_stopped<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    runner.ask(id(1), turn(180.0)).unwrap();
    bus.world.cut(bus.drives[0].station());
    assert_eq!(runner.stop_all(StopKind::Hold, MotorSet::EMPTY), id(1).into());
    bus.world.mend(bus.drives[0].station());
    let speed_dps = || bus.drives[0].with(|drive| drive.plant().output_speed_dps());
    assert!(speed_dps() > 170.0, "it has heard no stop");
    runner.ask(id(1), ReadStatus2).unwrap();
    listen(runner, millis(500));
    assert!(speed_dps().abs() < 1.0, "{}", speed_dps());
}

/// The motor has lost its turns, so it would go on to a wrong one.
fn restart_during_a_move_ends_it_and_forbids_another<W: Wire>() {
    let fleet = Fleet::new(1).faults(["reset@1+1.5s".parse().unwrap()]);
    let bus = W::drives(&fleet).unwrap();
    let runner = &mut master(&bus);
    for attempt in 0..2 {
        let limits = MoveLimits::default();
        let go_on = |_: &_| ControlFlow::Continue(());
        let moved = bring_up::move_to(runner, id(1), go_to(900.0, 360), &limits, go_on);
        let restarted = MoveFailure::Call(CallError::Refused {
            motor: id(1),
            refusal: RequestError::Restarted,
        });
        assert_eq!(moved.map_err(|it| it.why), Err(restarted), "attempt {attempt}");
        runner.master().lift_stop();
    }
    listen(runner, millis(500));
    let at = state(&bus.drives[0]).angle_deg;
    assert!(at < 250.0, "two turns were 720 degrees, and it was stopped: {at}");
    runner.master().resume(id(1));
    assert!(runner.ask(id(1), go_to(0.0, 360)).is_ok());
}

fn motor_whose_cable_was_cut_may_have_restarted<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    let runner = &mut master(&bus);
    runner.ask(id(1), turn(90.0)).unwrap();
    bus.world.cut(bus.drives[0].station());
    listen(runner, millis(1_100));
    assert!(runner.ask(id(1), ReadMultiTurnAngle).is_err());
    bus.world.mend(bus.drives[0].station());
    assert!(runner.ask(id(1), ReadMultiTurnAngle).is_ok());
    let returned = runner.ask(id(1), turn(90.0)).unwrap_err();
    assert_eq!(returned, CallError::Refused { motor: id(1), refusal: RequestError::Restarted });
    // It has not restarted, and still turns.
    assert!(state(&bus.drives[0]).measurement.speed_dps > 80.0);
    let returned = returned.to_string();
    for words in [
        "may have restarted",
        "silent for a second",
        "stop it, see",
        "then lift the stop and resume",
    ] {
        assert!(returned.contains(words), "{returned}");
    }
}

fn gripper_goes_on_pressing_with_the_given_torque<W: Wire>() {
    let jaw = EndStop { at_deg: 20.0, stiffness_nm_per_rad: 500.0, restitution: 0.0 };
    let fleet = Fleet::new(1).load(Load { upper_stop: Some(jaw), ..Load::NONE });
    for when_stalled in [WhenStalled::Press, WhenStalled::Stop] {
        let bus = W::drives(&fleet).unwrap();
        let runner = &mut master(&bus);
        let grip = grip_at(90.0, 10);
        let limits = MoveLimits { when_stalled, ..MoveLimits::default() };
        let go_on = |_: &_| ControlFlow::Continue(());
        let met = bring_up::move_to(runner, id(1), grip, &limits, go_on);
        assert_eq!(met.is_ok(), when_stalled == WhenStalled::Press, "{met:?}");
        listen(runner, millis(500));
        let pressing = runner.ask(id(1), ReadStatus2).unwrap().current.amperes();
        if let Ok(met) = met {
            assert!((19.0..23.0).contains(&met.angle.degrees()), "{met:?}");
            assert!((0.5..1.5).contains(&pressing), "as limited, not more: {pressing} A");
            assert!(runner.set_point(id(1), push(0.1)).is_ok(), "nothing has stopped it");
        } else {
            assert_eq!(
                runner.set_point(id(1), push(0.1)),
                Err(CallError::refused(id(1))(RequestError::Stopped))
            );
        }
    }
}

/// The motor's protection is shorter than the time between two looks.
fn motor_that_cut_its_output_neither_presses_nor_stalls<W: Wire>() {
    for when_stalled in [WhenStalled::Press, WhenStalled::Stop] {
        let bus = W::drives(&Fleet::new(1)).unwrap();
        let runner = &mut master(&bus);
        bring_up::protect(runner, id(1), Milliseconds::from_raw(10)).unwrap();
        let grip = grip_at(90.0, 10);
        let limits = MoveLimits { when_stalled, ..MoveLimits::default() };
        let go_on = |_: &_| ControlFlow::Continue(());
        let met = bring_up::move_to(runner, id(1), grip, &limits, go_on);
        let why = met.expect_err("it has no output").why;
        assert!(matches!(why, MoveFailure::LetGo { .. }), "{why}");
    }
}

/// At the look that finds it pressing, the caller takes too long, or it dies.
fn gripper_that_let_go_during_the_last_look_does_not_press<W: Wire>() {
    let jaw = EndStop { at_deg: 20.0, stiffness_nm_per_rad: 500.0, restitution: 0.0 };
    let quirks = Quirks { lost_master_heartbeat: true, ..Quirks::default() };
    let fleet = Fleet::new(2).quirks(quirks).load(Load { upper_stop: Some(jaw), ..Load::NONE });
    for dies in [false, true] {
        let bus = W::drives(&fleet).unwrap();
        let runner = &mut master(&bus);
        bring_up::protect(runner, id(1), Milliseconds::from_raw(200)).unwrap();
        let limits = MoveLimits { when_stalled: WhenStalled::Press, ..MoveLimits::default() };
        let mut nearest = (Angle::from_raw(0), Duration::ZERO);
        let on_look = |look: &MoveProgress| {
            if look.angle.raw() > nearest.0.raw() + 20 {
                nearest = (look.angle, look.time);
            }
            if look.time - nearest.1 > limits.stalled_after {
                bus.world.run_for(millis(300));
                if dies {
                    bus.world.cut(bus.drives[0].station());
                }
            }
            ControlFlow::Continue(())
        };
        let why = bring_up::move_to(runner, id(1), grip_at(90.0, 10), &limits, on_look)
            .expect_err("it has no output")
            .why;
        match why {
            MoveFailure::LetGo { .. } if !dies => {}
            MoveFailure::Silent { .. } if dies => {}
            why => panic!("dies: {dies}: {why}"),
        }
    }
}

/// Why a move to 40 degrees with this torque and this load is no grip.
fn gripped<W: Wire>(percent_of_rated: u8, torque_nm: f64) -> MoveFailure<()> {
    let bus = W::drives(&Fleet::new(1).load(Load { torque_nm, ..Load::NONE })).unwrap();
    let runner = &mut master(&bus);
    let grip = grip_at(40.0, percent_of_rated);
    let limits = MoveLimits { when_stalled: WhenStalled::Press, ..MoveLimits::default() };
    let go_on = |_: &_| ControlFlow::Continue(());
    let gripped = bring_up::move_to(runner, id(1), grip, &limits, go_on);
    let not_arrived = gripped.expect_err("it has gripped nothing");
    assert!(not_arrived.is_stopped, "{not_arrived}");
    let why = match not_arrived.why {
        MoveFailure::Stalled { at, target } => MoveFailure::Stalled { at, target },
        MoveFailure::Turning { at, target, speed } => MoveFailure::Turning { at, target, speed },
        other => panic!("{other}"),
    };
    assert_eq!(
        runner.set_point(id(1), push(0.1)),
        Err(CallError::refused(id(1))(RequestError::Stopped))
    );
    why
}

fn force_that_drives_a_gripper_away_is_no_grip<W: Wire>() {
    let why = gripped::<W>(5, -20.0);
    let MoveFailure::Turning { at, target, speed } = why else { panic!("{why}") };
    assert_eq!(target, degrees(40.0));
    assert!(at.degrees() < -100.0 && speed.dps() < -100.0, "{why}");
    assert!(why.to_string().contains(&format!("turns at {speed}")), "{why}");
}

fn a_gripper_that_never_moved_has_gripped_nothing<W: Wire>() {
    let why = gripped::<W>(1, 0.0);
    assert!(matches!(why, MoveFailure::Stalled { at, .. } if at.degrees().abs() < 0.2), "{why}");
}

/// The motor's supply fails for a moment. It had no command to switch off, and it heard everything.
fn restart_during_a_move_is_reported_as_a_restart<W: Wire>() {
    let restart = "reset@1+300ms".parse().unwrap();
    let bus = W::drives(&Fleet::new(1).faults([restart])).unwrap();
    let go_on = |_: &_| ControlFlow::Continue(());
    let limits = MoveLimits::default();
    let not_arrived =
        bring_up::move_to(&mut master(&bus), id(1), TO_90_DEG(), &limits, go_on).unwrap_err();
    let returned = not_arrived.to_string();
    assert!(returned.contains("restarted"), "{returned}");
}

fn a_pause_between_two_looks_is_not_reported_as_a_restart<W: Wire>() {
    let bus = W::drives(&Fleet::new(1)).unwrap();
    bus.world.run_for(millis(5_000));
    let runner = &mut master(&bus);
    let mut has_rested = false;
    let moved = bring_up::move_to(runner, id(1), go_to(300.0, 600), &MoveLimits::default(), |_| {
        if !std::mem::replace(&mut has_rested, true) {
            bus.world.run_for(millis(1_500));
        }
        ControlFlow::Continue(())
    });
    assert!(moved.is_ok(), "{moved:?}");
    // A motor that has restarted meanwhile is still detected.
    let restart = "reset@1+3s".parse().unwrap();
    let bus = W::drives(&Fleet::new(1).faults([restart])).unwrap();
    let runner = &mut master(&bus);
    turn_to(&bus.drives[0], 720.0);
    bus.world.run_for(millis(100));
    let mut looks = 0;
    let moved = bring_up::move_to(runner, id(1), go_to(730.0, 600), &MoveLimits::default(), |_| {
        looks += 1;
        bus.world.run_for(millis(5_000));
        ControlFlow::Continue(())
    });
    let why = moved.map_err(|it| it.to_string());
    assert!(why.as_ref().is_err_and(|why| why.contains("restarted")), "{why:?}");
    assert_eq!(looks, 1);
}

/// A drive that has lost its master ignores a read during the move, not the move. If the error advised the caller to
/// repeat a relative move, the motor would move twice.
#[test]
fn ignored_read_during_a_move_gives_no_advice_to_repeat_it() {
    let step = IncrementalPosition { max_speed: up_to(360), angle: degrees(200.0) };
    let mut let_go = 0;
    for seed in 1..20 {
        let quirks = Quirks { lost_master_heartbeat: true, ..Quirks::default() };
        let fleet = Fleet::new(1).seed(seed).quirks(quirks).faults(["lose=0.05".parse().unwrap()]);
        let bus = fleet.on_can(1_000_000).unwrap();
        let runner = &mut bus.master::<8>();
        while bring_up::protect(runner, id(1), Milliseconds::from_raw(30)).is_err() {}
        let mut looks = 0;
        let moved = bring_up::move_to(runner, id(1), step, &MoveLimits::default(), |_| {
            looks += 1;
            ControlFlow::Continue(())
        });
        match moved.map_err(|it| it.why) {
            Err(MoveFailure::LetGo { .. }) => let_go += 1,
            Err(why) => assert!(looks == 0 || !why.to_string().contains("send it again"), "{why}"),
            Ok(_) => {}
        }
    }
    assert!(let_go > 0, "none was");
}

//! What lies on the desk, in which order it is taken up, and what a stop or a restart takes away.

use myactuator_protocol_core::command::{LockBrake, Reset};
use myactuator_protocol_core::io::Watch;

use super::*;
use crate::share::calls::{Awaited, Insistence, Order, Question, Untyped};
use crate::share::desk::Desk;
use crate::share::state::{Clerk, Put};
use crate::share::watch::Watched;

/// Notes what it gets; is busy with questions, or answers them at once. Refuses what moves motor 3.
#[derive(Default)]
struct Notes {
    noted: Vec<String>,
    /// Whom the questions were for, and their first bytes.
    bytes: Vec<(u8, u8)>,
    takes_questions: bool,
    looked_at: Instant,
    /// Whether the watched loops are late, from the last to the first.
    late: Vec<bool>,
    is_any_held: bool,
    /// Of the last set-point.
    found_at: Option<Instant>,
}

impl Clerk<CanError> for Notes {
    fn obey(&mut self, order: Order<CanError>) {
        self.noted.push(match order {
            Order::StopAll { kind, .. } => format!("stop all: {kind:?}"),
            Order::Stop { motor, kind, .. } => format!("stop {motor}: {kind:?}"),
            Order::LiftStop => "lift".to_owned(),
            Order::LiftStopOf(motor) => format!("lift {motor}"),
            Order::Resume(motor) => format!("resume {motor}"),
            Order::Forget(motor) => format!("forget {motor}"),
            Order::NoteRestart(motor) => format!("restart {motor}"),
            Order::NoteArrival(motor) => format!("arrived {motor}"),
            other => panic!("{other:?}"),
        });
    }

    fn set_point(
        &mut self,
        motor: MotorId,
        set_point: Untyped,
        found_at: Instant,
    ) -> Result<(), RequestError> {
        self.noted.push(format!("{motor}: {set_point:?}"));
        self.found_at = Some(found_at);
        if motor == id(3) { Err(RequestError::Restarted) } else { Ok(()) }
    }

    fn found_at(&self, _: std::time::Duration) -> Instant {
        self.looked_at
    }

    fn keep_alive(&mut self, _: bool) {}

    fn is_any_held(&self) -> bool {
        self.is_any_held
    }

    fn watch(&mut self, _: &mut Watched) -> bool {
        self.late.pop().unwrap()
    }

    fn put(&mut self, question: Question<CanError>) -> Put<CanError> {
        self.noted.push(format!("{}?", question.motor));
        self.bytes.push((question.motor.get(), question.command.encode()[0]));
        let Question { motor, command, ref answer, .. } = question;
        if motor == id(3) && command.kind.moves() {
            let refusal = RequestError::Restarted;
            let _ = answer.send(Err(SharedBusError::Refused { motor, refusal }));
            return Put::Refused;
        }
        if self.takes_questions {
            let failure = Failure::NoReply;
            let _ = answer.send(Err(SharedBusError::Failed { motor, failure }));
            return Put::Accepted;
        }
        Put::Waits(question)
    }
}

/// One that nobody takes anything from but the test, when it comes to that.
fn new_desk() -> Desk<CanError> {
    let desk = Desk::new(None);
    desk.lock().longest_round = NOT_HELD;
    desk
}

fn taken(desk: &Desk<CanError>) -> Vec<String> {
    let mut notes = Notes::default();
    assert!(desk.take(&mut notes));
    notes.noted
}

fn set(motor: u8, dps: f32) -> String {
    format!("{motor}: {:?}", Untyped::of(&turn(dps)))
}

#[test]
fn only_the_newest_set_point_is_taken_and_only_once() {
    let desk = new_desk();
    for (motor, dps) in [(1, 10.0), (2, 20.0), (1, 30.0)] {
        desk.set_point(id(motor), Untyped::of(&turn(dps))).unwrap();
    }
    assert_eq!(taken(&desk), [set(1, 30.0), set(2, 20.0)]);
    assert!(taken(&desk).is_empty());
    // What was refused is told once, in place of the next.
    desk.set_point(id(3), Untyped::of(&turn(1.0))).unwrap();
    assert_eq!(taken(&desk), [set(3, 1.0)]);
    let returned = desk.set_point(id(3), Untyped::of(&turn(2.0))).unwrap_err();
    tells(&returned, 3, RequestError::Restarted);
    assert!(taken(&desk).is_empty());
    desk.set_point(id(3), Untyped::of(&turn(3.0))).unwrap();
    assert_eq!(taken(&desk), [set(3, 3.0)]);
}

#[test]
fn set_points_and_moves_older_than_a_stop_are_dropped() {
    let desk = new_desk();
    desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap();
    let moving = ask(&desk, 1, turn(2.0));
    let _answered = ask(&desk, 2, ReadStatus1);
    // The motors are busy: the questions stay.
    assert_eq!(taken(&desk), [set(1, 1.0), "1?".to_owned(), "2?".to_owned()]);
    desk.set_point(id(2), Untyped::of(&turn(3.0))).unwrap();
    let stopping = desk.stop_all(StopKind::Hold, MotorSet::EMPTY);
    let returned = desk.wait(moving).unwrap_err();
    tells(&returned, 1, Failure::Stopped);
    let refused = desk.set_point(id(1), Untyped::of(&turn(4.0))).unwrap_err();
    tells(&refused, 1, RequestError::Stopped);
    // Not even when it is lifted before the thread has seen it.
    desk.order(Order::LiftStop).unwrap();
    desk.set_point(id(1), Untyped::of(&turn(5.0))).unwrap();
    let stop_and_lift = ["stop all: Hold".to_owned(), "lift".to_owned()];
    assert_eq!(taken(&desk), [&stop_and_lift[..], &[set(1, 5.0), "2?".to_owned()]].concat());

    // A command that ends motion drops the set-point that is older, and goes before the one that is newer.
    desk.set_point(id(1), Untyped::of(&turn(6.0))).unwrap();
    let ending = ask(&desk, 1, Shutdown);
    desk.set_point(id(1), Untyped::of(&turn(7.0))).unwrap();
    desk.set_point(id(2), Untyped::of(&turn(8.0))).unwrap();
    assert_eq!(taken(&desk), [set(2, 8.0), "2?".to_owned(), "1?".to_owned()]);
    let mut free = Notes { takes_questions: true, ..Notes::default() };
    assert!(desk.take(&mut free));
    assert_eq!(free.noted, ["2?".to_owned(), "1?".to_owned(), set(1, 7.0)]);
    let ending = desk.wait(ending).unwrap_err();
    tells(&ending, 1, Failure::NoReply);
    let reading = ask(&desk, 2, ReadStatus1);

    // Whoever still waits is told by the end.
    desk.has_panicked(Arc::from("the test is over"));
    let is_over = |returned| matches!(returned, SharedBusError::Panicked(words) if &*words == "the test is over");
    assert!(is_over(desk.wait(reading).unwrap_err()));
    assert!(is_over(desk.wait(stopping).unwrap_err()));
}

/// The thread ends before it takes up what they have laid down.
#[test]
fn callers_learn_of_a_panic_whatever_they_wait_for() {
    let desk = new_desk();
    desk.lock().longest_round = HELD;
    let (stopping, reading) =
        (desk.stop_all(StopKind::Hold, MotorSet::EMPTY), ask(&desk, 1, ReadStatus1));
    let waiting = desk.wait_until(Instant::from_millis(1));
    desk.has_panicked(Arc::from("the test is over"));
    let stopped = desk.wait_for_stop(stopping, MotorSet::ALL);
    assert!(matches!(stopped, Err(SharedBusError::Panicked(_))), "{stopped:?}");
    assert!(matches!(desk.wait(reading), Err(SharedBusError::Panicked(_))));
    assert!(matches!(desk.wait(waiting), Err(SharedBusError::Panicked(_))));
}

/// A question that nobody waits for.
fn ask(desk: &Desk<CanError>, motor: u8, command: impl Command) -> Awaited<Data, CanError> {
    desk.ask(id(motor), Untyped::of(&command), Insistence::Usual, None)
}

#[test]
fn commands_that_end_motion_go_first_and_drop_waiting_moves() {
    let goal = AbsolutePosition { max_speed: MaxSpeed::from_raw(10), angle: Angle::from_raw(0) };
    let desk = new_desk();
    let _other = ask(&desk, 2, ReadStatus1);
    let _read = ask(&desk, 1, ReadStatus1);
    let _others = ask(&desk, 2, goal);
    let moving = ask(&desk, 1, goal);
    let opening = ask(&desk, 1, ReleaseBrake);
    desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap();
    let _off = ask(&desk, 1, Shutdown);
    for dropped in [moving, opening] {
        tells(&desk.wait(dropped).unwrap_err(), 1, Failure::Stopped);
    }
    // Who ends its motion after that has the last word.
    let _held = ask(&desk, 1, Stop);
    let newer = ask(&desk, 1, goal);
    let mut notes = Notes { takes_questions: true, ..Notes::default() };
    assert!(desk.take(&mut notes));
    assert_eq!(notes.bytes, [(2, 0x9A), (1, 0x80), (1, 0x81), (1, 0x9A), (2, 0xA4), (1, 0xA4)]);
    assert!(newer.is_ok());
}

/// Two calls open the brake of motor 1.
#[test]
fn questions_wait_while_a_brake_opens_except_those_that_open_it_or_end_motion() {
    let desk = new_desk();
    let put = || {
        let mut notes = Notes { takes_questions: true, ..Notes::default() };
        assert!(desk.take(&mut notes));
        notes.bytes
    };
    let _reading = [1, 2].map(|motor| ask(&desk, motor, ReadStatus1));
    let opening = [id(1); 2].map(|motor| desk.begin_opening(motor));
    let _opened = ask(&desk, 1, ReleaseBrake);
    assert_eq!(put(), [(2, 0x9A), (1, 0x77)]);
    let _held = ask(&desk, 1, Stop);
    assert_eq!(put(), [(1, 0x81)]);
    let [first, last] = opening;
    drop(first);
    assert_eq!(put(), []);
    assert!(desk.may_idle());
    drop(last);
    assert!(!desk.may_idle(), "there is news");
    assert_eq!(put(), [(1, 0x9A)]);
}

#[test]
fn older_command_that_ends_motion_otherwise_does_not_follow_a_stop() {
    // A motor that was switched off would be switched on, and one that is held let go.
    for kind in [StopKind::Off, StopKind::Hold] {
        for is_of_all in [true, false] {
            let desk = new_desk();
            let _reading = ask(&desk, 1, ReadStatus1);
            let ending = match kind {
                StopKind::Off => ask(&desk, 1, Stop),
                StopKind::Hold => ask(&desk, 1, Shutdown),
            };
            let _stopping = match is_of_all {
                true => desk.stop_all(kind, MotorSet::EMPTY),
                false => desk.stop(id(1), kind, None),
            };
            tells(&desk.wait(ending).unwrap_err(), 1, Failure::Stopped);
        }
    }
}

#[test]
fn caller_that_began_before_a_stop_may_not_move_the_motor() {
    let ends: [fn(&Desk<CanError>); 4] = [
        |desk| drop(desk.stop_all(StopKind::Hold, MotorSet::EMPTY)),
        |desk| drop(desk.stop(id(1), StopKind::Off, None)),
        |desk| drop(ask(desk, 1, Shutdown)),
        |_| {},
    ];
    for (at, end) in ends.into_iter().enumerate() {
        let desk = new_desk();
        let (since, of_other) = (desk.past(id(1)), desk.past(id(2)));
        end(&desk);
        desk.order(Order::LiftStop).unwrap();
        let was_ended = at < 3;
        let refused = desk.ask(id(1), Untyped::of(&STEP), Insistence::Usual, Some(since)).err();
        assert_eq!(refused.is_some(), was_ended, "{at}");
        assert_eq!(desk.may_move(id(1), since).is_err(), was_ended, "{at}");
        assert_eq!(desk.may_move(id(2), of_other).is_err(), at == 0, "{at}");
        assert!(ask(&desk, 1, STEP).is_ok(), "one that begins now");
    }
}

#[test]
fn bus_error_meant_for_another_caller_does_not_hold_back_a_stop() {
    let desk = new_desk();
    for command in [Untyped::of(&Stop), Untyped::of(&Shutdown)] {
        desk.set_point(id(1), Untyped::of(&turn(90.0))).unwrap();
        desk.fail(&Arc::new(CanError::BusOff), []);
        let stopping = desk.ask(id(1), command, Insistence::Usual, None);
        let mut free = Notes { takes_questions: true, ..Notes::default() };
        assert!(desk.take(&mut free));
        assert_eq!(free.noted, ["1?"], "the set-point is older");
        assert!(matches!(desk.wait(stopping), Err(SharedBusError::Failed { .. })));
        // Whoever moves a motor is told.
        for _ in 0..2 {
            let returned = desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap_err();
            assert!(matches!(returned, SharedBusError::Bus(_)), "{returned}");
        }
        desk.works();
    }
}

#[test]
fn bus_error_returned_only_to_gone_callers_is_returned_to_the_next() {
    let desk = new_desk();
    let reading = Untyped::of(&ReadStatus1);
    let is_told = |outcome| matches!(outcome, Err(SharedBusError::Bus(_)));
    let error = Arc::new(CanError::BusOff);
    // One at the desk, and one whose question was put.
    drop(desk.ask(id(1), reading, Insistence::Usual, None).unwrap());
    let (put, gone) = sync_channel(1);
    drop(gone);
    desk.fail(&error, [put]);
    desk.works();
    assert!(is_told(desk.wait(desk.ask(id(1), reading, Insistence::Usual, None))));
    // Who still waits is told, and nobody else.
    let waiting = desk.ask(id(1), reading, Insistence::Usual, None);
    drop(desk.ask(id(2), reading, Insistence::Usual, None).unwrap());
    desk.fail(&error, []);
    assert!(is_told(desk.wait(waiting)));
    desk.works();
    assert!(desk.ask(id(1), reading, Insistence::Usual, None).is_ok());
}

/// The bus fails in two rounds, and a caller gets the error between them.
#[test]
fn outage_already_returned_is_not_returned_again_once_it_is_over() {
    let desk = new_desk();
    let error = Arc::new(CanError::BusOff);
    desk.fail(&error, []);
    assert!(ask(&desk, 1, ReadStatus1).is_err());
    desk.fail(&error, []);
    desk.works();
    assert!(ask(&desk, 1, ReadStatus1).is_ok());
}

#[test]
fn command_that_ends_motion_survives_an_error_without_its_caller() {
    let desk = new_desk();
    drop(ask(&desk, 1, Shutdown).unwrap());
    drop(ask(&desk, 2, ReadStatus1).unwrap());
    desk.fail(&Arc::new(CanError::BusOff), []);
    assert_eq!(taken(&desk), ["1?"]);
}

/// It switches the motor off, and its caller may have left long ago.
#[test]
fn restart_is_not_sent_without_its_caller() {
    let desk = new_desk();
    drop(ask(&desk, 1, Reset).unwrap());
    assert!(taken(&desk).is_empty());
    drop(ask(&desk, 1, Reset).unwrap());
    desk.fail(&Arc::new(CanError::BusOff), []);
    assert!(taken(&desk).is_empty());
}

#[test]
fn moves_older_than_a_resumption_do_not_follow_a_restart() {
    let is_refused = |returned| {
        matches!(returned, SharedBusError::Refused { refusal: RequestError::Restarted, .. })
    };
    let desk = new_desk();
    let reading = ask(&desk, 1, ReadStatus1);
    let goal = AbsolutePosition { max_speed: MaxSpeed::from_raw(10), angle: Angle::from_raw(0) };
    let moving = ask(&desk, 1, goal);
    // The move waits behind the question, which the motor is busy with.
    assert_eq!(taken(&desk), ["1?"]);
    desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap();
    desk.set_point(id(2), Untyped::of(&turn(2.0))).unwrap();
    let _other = ask(&desk, 2, goal);
    desk.has_restarted(id(1));
    assert!(is_refused(desk.wait(moving).unwrap_err()));
    assert!(is_refused(desk.set_point(id(1), Untyped::of(&turn(3.0))).unwrap_err()));
    assert!(is_refused(desk.wait(ask(&desk, 1, goal)).unwrap_err()));
    desk.order(Order::Resume(id(1))).unwrap();
    desk.set_point(id(1), Untyped::of(&turn(4.0))).unwrap();
    assert_eq!(
        taken(&desk),
        ["resume 1".to_owned(), set(1, 4.0), set(2, 2.0), "1?".to_owned(), "2?".to_owned()]
    );
    // One that is forgotten may be another when it is asked again.
    desk.has_restarted(id(2));
    desk.order(Order::Forget(id(2))).unwrap();
    desk.set_point(id(2), Untyped::of(&turn(6.0))).unwrap();
    assert_eq!(taken(&desk), ["forget 2".to_owned(), set(2, 6.0), "1?".to_owned()]);
    // Who has found a restart out need not wait until the bus says so.
    desk.set_point(id(2), Untyped::of(&turn(7.0))).unwrap();
    desk.order(Order::NoteRestart(id(2))).unwrap();
    assert_eq!(desk.may_move(id(2), desk.past(id(2))), Err(RequestError::Restarted));
    assert_eq!(taken(&desk), ["restart 2", "1?"]);
    drop(reading);
}

#[test]
fn set_point_waiting_for_a_shutdown_keeps_its_age() {
    let desk = new_desk();
    let ending = ask(&desk, 1, Shutdown);
    desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap();
    let mut notes = Notes { looked_at: Instant::from_millis(10), ..Notes::default() };
    assert!(desk.take(&mut notes));
    assert_eq!(notes.noted, ["1?"], "the motor is busy");
    let mut notes = Notes { looked_at: Instant::from_millis(900), ..Notes::default() };
    notes.takes_questions = true;
    assert!(desk.take(&mut notes));
    assert_eq!(
        (notes.noted, notes.found_at),
        (vec!["1?".to_owned(), set(1, 1.0)], Some(Instant::from_millis(10)))
    );
    drop(ending);
}

#[test]
fn stop_by_a_caller_from_before_a_shutdown_leaves_the_motor_off() {
    type End = fn(&Desk<CanError>);
    let ends: [(End, &str); 15] = [
        (|desk| drop(ask(desk, 1, Shutdown)), "Off"),
        (|desk| drop(ask(desk, 1, Reset)), "Off"),
        (|desk| drop(desk.stop_all(StopKind::Off, MotorSet::EMPTY)), "Off"),
        (|desk| drop(ask(desk, 1, Stop)), "Hold"),
        // A brake that was told to lock may slip.
        (|desk| drop(ask(desk, 1, LockBrake)), "Hold"),
        (|desk| drop(ask(desk, 2, Shutdown)), "Hold"),
        (|desk| drop((ask(desk, 1, Shutdown), ask(desk, 1, Stop))), "Hold"),
        (|desk| drop((ask(desk, 1, Shutdown), ask(desk, 1, LockBrake))), "Off"),
        // A stop that is in force keeps it off.
        (|desk| drop((desk.stop(id(1), StopKind::Off, None), ask(desk, 1, Stop))), "Off"),
        (
            |desk| {
                drop((
                    desk.stop_all(StopKind::Off, MotorSet::EMPTY),
                    desk.stop(id(1), StopKind::Hold, None),
                ))
            },
            "Off",
        ),
        (
            |desk| {
                drop((
                    desk.stop(id(1), StopKind::Off, None),
                    desk.order(Order::LiftStop),
                    ask(desk, 1, Stop),
                ))
            },
            "Hold",
        ),
        // That of one motor is lifted alone, and not that of all.
        (
            |desk| {
                drop((
                    desk.stop(id(1), StopKind::Off, None),
                    desk.order(Order::LiftStopOf(id(1))),
                    ask(desk, 1, Stop),
                ))
            },
            "Hold",
        ),
        (
            |desk| {
                drop((
                    desk.stop_all(StopKind::Off, MotorSet::EMPTY),
                    desk.order(Order::LiftStopOf(id(1))),
                    ask(desk, 1, Stop),
                ))
            },
            "Off",
        ),
        // Whoever moves it by then does not have it fall.
        (
            |desk| {
                drop(ask(desk, 1, Shutdown));
                let _moving = ask(desk, 1, STEP);
                assert!(desk.take(&mut Notes { takes_questions: true, ..Notes::default() }));
            },
            "Hold",
        ),
        (
            |desk| {
                drop(ask(desk, 1, Shutdown));
                assert!(desk.take(&mut Notes { takes_questions: true, ..Notes::default() }));
                desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap();
                assert_eq!(taken(desk), [set(1, 1.0)]);
            },
            "Hold",
        ),
    ];
    for (at, (end, kind)) in ends.into_iter().enumerate() {
        let desk = new_desk();
        let since = desk.past(id(1));
        end(&desk);
        drop(desk.stop(id(1), StopKind::Hold, Some(since)));
        let mut stops = taken(&desk).into_iter().filter(|returned| returned.starts_with("stop 1"));
        assert_eq!(stops.next_back(), Some(format!("stop 1: {kind}")), "{at}");
    }
    // Who begins now, or is nobody's, does as it says.
    let desk = new_desk();
    drop(ask(&desk, 1, Shutdown));
    drop(desk.stop(id(1), StopKind::Hold, Some(desk.past(id(1)))));
    drop(desk.stop(id(1), StopKind::Hold, None));
    assert_eq!(taken(&desk), ["stop 1: Hold", "stop 1: Hold"]);
}

/// A set-point that is refused runs nothing, so the motor is off as before.
#[test]
fn a_stop_does_not_switch_on_a_motor_whose_set_point_was_refused() {
    let desk = new_desk();
    let since = desk.past(id(3));
    desk.set_point(id(3), Untyped::of(&turn(1.0))).unwrap();
    taken(&desk);
    drop(ask(&desk, 3, Shutdown));
    let returned = desk.set_point(id(3), Untyped::of(&turn(2.0))).unwrap_err();
    tells(&returned, 3, RequestError::Restarted);
    drop(desk.stop(id(3), StopKind::Hold, Some(since)));
    assert_eq!(taken(&desk), ["stop 3: Off"]);
}

#[test]
fn a_stop_does_not_switch_on_a_motor_whose_set_point_the_master_refused() {
    let desk = new_desk();
    let since = desk.past(id(3));
    drop(ask(&desk, 3, Shutdown));
    taken(&desk);
    desk.set_point(id(3), Untyped::of(&turn(1.0))).unwrap();
    taken(&desk);
    drop(desk.stop(id(3), StopKind::Hold, Some(since)));
    assert_eq!(taken(&desk), ["stop 3: Off"]);
}

/// The master refuses it, the bus fails, the caller gives up, or a lock drops it.
#[test]
fn a_stop_does_not_switch_on_a_motor_whose_move_was_never_sent() {
    type Drops = fn(&Desk<CanError>, Awaited<Data, CanError>);
    let drops: [Drops; 4] = [
        |desk, moving| {
            taken(desk);
            tells(&desk.wait(moving).unwrap_err(), 3, RequestError::Restarted);
        },
        |desk, _moving| desk.fail(&Arc::new(CanError::BusOff), []),
        |desk, moving| {
            drop(moving);
            taken(desk);
        },
        |desk, _moving| drop(ask(desk, 3, LockBrake)),
    ];
    for (at, drops) in drops.into_iter().enumerate() {
        let desk = new_desk();
        let since = desk.past(id(3));
        drop(ask(&desk, 3, Shutdown));
        assert!(desk.take(&mut Notes { takes_questions: true, ..Notes::default() }));
        drops(&desk, ask(&desk, 3, STEP));
        drop(desk.stop(id(3), StopKind::Hold, Some(since)));
        assert_eq!(taken(&desk), ["stop 3: Off"], "{at}");
    }
}

#[test]
fn hold_by_a_caller_from_before_a_shutdown_is_refused() {
    let desk = new_desk();
    let (since, hold) = (desk.past(id(1)), Untyped::of(&Stop));
    drop(ask(&desk, 1, Shutdown));
    let refused = desk.ask(id(1), hold, Insistence::Usual, Some(since)).err().unwrap();
    tells(&refused, 1, RequestError::Stopped);
    // Who lets it go, too, or begins now, does as it says.
    assert!(desk.ask(id(1), Untyped::of(&Shutdown), Insistence::Usual, Some(since)).is_ok());
    let now = Some(desk.past(id(1)));
    assert!(desk.ask(id(1), hold, Insistence::Usual, now).is_ok());
}

/// Opening a brake does so: it holds the motor first, and again where that is not answered.
#[test]
fn caller_goes_on_after_its_own_stop_but_not_after_anothers() {
    let desk = new_desk();
    let release =
        |since| desk.ask(id(1), Untyped::of(&ReleaseBrake), Insistence::Usual, Some(since));
    let mut since = desk.past(id(1));
    drop(desk.ask(id(1), Untyped::of(&Stop), Insistence::Usual, Some(since)).unwrap());
    assert!(release(since).is_err());
    since.note_own(Untyped::of(&Stop).kind);
    assert!(release(since).is_ok());
    drop(ask(&desk, 1, Stop));
    assert!(release(since).is_err());
}

#[test]
fn restart_reported_while_its_resumption_waits_blocks_nothing() {
    let desk = new_desk();
    desk.order(Order::Resume(id(1))).unwrap();
    desk.has_restarted(id(1));
    assert_eq!(taken(&desk), ["resume 1"]);
    assert!(desk.set_point(id(1), Untyped::of(&turn(1.0))).is_ok());
}

/// Of two threads that move it one has arrived.
#[test]
fn an_arrival_says_nothing_of_what_others_have_told_the_motor() {
    for (others_move, expected) in [(false, vec!["arrived 1".to_owned()]), (true, vec![])] {
        let desk = new_desk();
        let mut since = desk.past(id(1));
        for is_own in [true, false] {
            if is_own || others_move {
                desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap();
                taken(&desk);
            }
        }
        since.note_own(Untyped::of(&turn(1.0)).kind);
        desk.note_arrival(id(1), since);
        assert_eq!(taken(&desk), expected);
    }
}

/// Somebody presses a button just before.
#[test]
fn a_stop_is_not_lifted_by_whoever_knows_only_of_those_before() {
    let stops: [fn(&Desk<CanError>); 2] = [
        |desk| drop(desk.stop_all(StopKind::Hold, MotorSet::EMPTY)),
        |desk| drop(desk.stop(id(2), StopKind::Hold, None)),
    ];
    for stop in stops {
        let desk = new_desk();
        stop(&desk);
        let known = desk.lock().stops;
        stop(&desk);
        assert!(!desk.lift_stop_if(known).unwrap());
        assert!(desk.lock().is_stopped(id(2), None));
        let set_point = || desk.set_point(id(2), Untyped::of(&turn(1.0)));
        tells(&set_point().unwrap_err(), 2, RequestError::Stopped);
        let known = desk.lock().stops;
        assert!(desk.lift_stop_if(known).unwrap());
        assert!(set_point().is_ok());
        assert_eq!(taken(&desk).last(), Some(&set(2, 1.0)));
    }
}

#[test]
fn a_loop_that_is_late_drops_what_it_has_laid_down() {
    let desk = new_desk();
    let watch = Watch::new(id(1).into(), Instant::ZERO);
    desk.look(&mut None, &watch, StopKind::Hold).unwrap();
    desk.set_point(id(1), Untyped::of(&turn(1.0))).unwrap();
    let mut notes = Notes { late: vec![true], ..Notes::default() };
    desk.take(&mut notes);
    assert_eq!(notes.noted, ["stop all: Hold"]);
    let refused = desk.set_point(id(1), Untyped::of(&turn(2.0))).unwrap_err();
    tells(&refused, 1, RequestError::Stopped);
}

/// A load may fall if what is to hold is let go, also if its loop is late only a moment after the other.
#[test]
fn a_loop_that_is_late_lets_go_nothing_that_another_loop_is_to_hold() {
    use StopKind::{Hold, Off};
    for (kinds, expected) in
        [([Hold, Off], "Hold"), ([Off, Hold], "Hold"), ([Hold, Hold], "Hold"), ([Off, Off], "Off")]
    {
        for late in [[true, false], [false, true], [true, true]] {
            let desk = new_desk();
            let watch = Watch::new(id(1).into(), Instant::ZERO);
            for kind in kinds {
                desk.look(&mut None, &watch, kind).unwrap();
            }
            let mut notes = Notes { late: late.to_vec(), ..Notes::default() };
            desk.take(&mut notes);
            assert_eq!(notes.noted, [format!("stop all: {expected}")]);
            assert!(notes.late.is_empty(), "each was looked at");
        }
    }
}

/// Nobody moves it, for example since its brake was opened.
#[test]
fn a_loop_that_is_late_lets_go_no_motor_that_holds() {
    for (is_any_held, expected) in [(true, "Hold"), (false, "Off")] {
        let desk = new_desk();
        desk.look(&mut None, &Watch::new(id(1).into(), Instant::ZERO), StopKind::Off).unwrap();
        let mut notes = Notes { late: vec![true], is_any_held, ..Notes::default() };
        desk.take(&mut notes);
        assert_eq!(notes.noted, [format!("stop all: {expected}")]);
    }
}

/// It is stopped as by a loop that hangs, unless all are stopped already.
#[test]
fn a_loop_that_panics_lets_go_nothing_that_another_is_to_hold() {
    use StopKind::{Hold, Off};
    for (other, expected) in [(Some(Hold), "Hold"), (Some(Off), "Off"), (None, "Off")] {
        for is_stopped in [false, true] {
            let desk = new_desk();
            let watch = Watch::new(id(1).into(), Instant::ZERO);
            let mut key = None;
            desk.look(&mut key, &watch, Off).unwrap();
            other.into_iter().for_each(|kind| desk.look(&mut None, &watch, kind).unwrap());
            if is_stopped {
                drop(desk.stop_all(Hold, MotorSet::EMPTY).unwrap());
            }
            desk.loop_panics(key.unwrap());
            let late = vec![false, true][usize::from(other.is_none())..].to_vec();
            let mut notes = Notes { late, ..Notes::default() };
            desk.take(&mut notes);
            let expected = if is_stopped { "Hold" } else { expected };
            assert_eq!(notes.noted, [format!("stop all: {expected}")]);
            assert_eq!(desk.lock().watches.len(), usize::from(other.is_some()), "it is gone");
        }
    }
}

/// Whoever has stopped it wants it held: another motor's loop does not let it go.
#[test]
fn a_loop_that_is_late_lets_go_nothing_that_a_stop_of_its_own_holds() {
    for (kind, expected) in [(StopKind::Hold, "Hold"), (StopKind::Off, "Off")] {
        let desk = new_desk();
        desk.look(&mut None, &Watch::new(id(1).into(), Instant::ZERO), StopKind::Off).unwrap();
        drop(desk.stop(id(2), kind, None).unwrap());
        let mut notes = Notes { late: vec![true], ..Notes::default() };
        desk.take(&mut notes);
        assert_eq!(notes.noted.last().unwrap(), &format!("stop all: {expected}"));
    }
}

//! No echo passes for the confirmation of a stop, whatever the port, the adapter and the line do meanwhile.

use std::vec::Vec;

use super::world::{TestClock, TestSerial};
use super::{id, torque};
use crate::command::{ReadMultiTurnAngle, ReadStatus1, Reset, Stop};
use crate::io::{Runner, SerialMaster, bring_up};
use crate::master::{Config, Event, MotorSet, Patience, StopKind};
use crate::time::{Duration, Instant};
use crate::wire::rs485::Frame;

type Arm = SerialMaster<TestSerial, TestClock, 8>;

/// A line on which motors 1 to 3 answer, by an adapter that does not echo.
fn quiet(config: Config) -> (TestSerial, Arm) {
    let clock = TestClock::default();
    let port = TestSerial::new(&clock);
    (port.clone(), SerialMaster::new(port, clock, config))
}

/// As that, by one that echoes, which is configured or not.
fn echoing(is_configured: bool) -> (TestSerial, Arm) {
    let (port, arm) = quiet(Config::rs485(115_200, is_configured));
    port.state().echoes = true;
    (port, arm)
}

/// No echo is configured.
const UNCONFIGURED: Config = Config::rs485(115_200, false);

/// Runs for so long, whatever fails, and gives what happened.
fn run(arm: &mut Arm, micros: u64) -> Vec<Event> {
    let (end, mut events) = (arm.now() + Duration::from_micros(micros), Vec::new());
    while arm.now() < end {
        let _ = arm.run_until(end, |event| events.push(event));
    }
    events
}

/// As that, and gives how many stops were confirmed.
fn confirmations(arm: &mut Arm, micros: u64) -> usize {
    let is_it = |event: &&Event| matches!(event, Event::StopConfirmed { .. });
    run(arm, micros).iter().filter(is_it).count()
}

#[test]
fn earlier_echo_does_not_confirm_a_stop_while_the_port_refuses_frames() {
    for fails in [false, true] {
        let (port, mut arm) = echoing(true);
        port.state().hands_over_every = 16_000;
        // Nobody is there.
        arm.master().stop(id(8), StopKind::Hold).unwrap();
        arm.master().stop(id(9), StopKind::Hold).unwrap();
        // A stop is taken; then the port takes nothing until shortly before its echo comes.
        let mut confirmed = confirmations(&mut arm, 5_000);
        (port.state().takes_nothing, port.state().write_fails) = (!fails, fails);
        confirmed += confirmations(&mut arm, 10_900);
        (port.state().takes_nothing, port.state().write_fails) = (false, false);
        assert_eq!(confirmed + confirmations(&mut arm, 500_000), 0, "fails: {fails}");
    }
}

#[test]
fn confirmation_is_not_taken_for_the_echo_of_a_refused_frame() {
    let (port, mut arm) = echoing(true);
    port.state().takes_nothing = true;
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    confirmations(&mut arm, 8_000);
    port.state().takes_nothing = false;
    assert_eq!(confirmations(&mut arm, 5_000), 1, "by the first that it takes");
}

#[test]
fn echoes_lost_in_a_cut_do_not_show_an_adapter_without_echo() {
    let (port, mut arm) = echoing(false);
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    port.state().is_cut = true;
    for _ in 0..5 {
        assert!(arm.ask(id(1), ReadStatus1).is_err());
        confirmations(&mut arm, 150_000);
    }
    assert!(arm.ask(id(1), ReadMultiTurnAngle).is_err());
    port.state().is_cut = false;
    assert!(!arm.stop(id(9), StopKind::Hold), "nobody is there");
}

#[test]
fn no_echo_confirms_a_stop_on_a_line_that_was_dead_when_opened() {
    for cut_for in (0..60_000).step_by(700) {
        let (port, mut arm) = echoing(false);
        port.state().is_cut = true;
        assert!(arm.ask(id(9), ReadMultiTurnAngle).is_err());
        arm.master().stop(id(9), StopKind::Hold).unwrap();
        confirmations(&mut arm, cut_for);
        port.state().is_cut = false;
        assert_eq!(confirmations(&mut arm, 500_000), 0, "cut for {cut_for} us");
    }
}

#[test]
fn echoes_lost_while_reading_fails_let_no_echo_confirm_a_stop() {
    for fails_at in [0, 1, 25, 30] {
        for fails_for in 1..100 {
            let (port, mut arm) = echoing(false);
            arm.master().stop(id(9), StopKind::Hold).unwrap();
            let mut confirmed = 0;
            for tenth in 0..300 {
                port.state().read_fails = (fails_at..fails_at + fails_for).contains(&tenth);
                if port.state().read_fails {
                    port.lose();
                }
                confirmed += confirmations(&mut arm, 100);
            }
            assert_eq!(confirmed, 0, "{fails_for} from {fails_at} on: nobody is there");
        }
    }
}

/// What was sent: the motors, and the command bytes.
fn sent(port: &TestSerial) -> Vec<(u8, u8)> {
    port.written().chunks(13).map(|frame| (frame[1], frame[3])).collect()
}

#[test]
fn first_attempt_of_a_stop_is_sent_at_once_and_the_others_after_a_read() {
    let (port, mut arm) = echoing(false);
    port.state().read_fails = true;
    arm.master().stop(id(8), StopKind::Hold).unwrap();
    arm.master().stop(id(9), StopKind::Off).unwrap();
    confirmations(&mut arm, 200_000);
    let sent = sent(&port);
    assert!(sent.len() > 10);
    assert_eq!(sent[..2], [(8, 0x81), (9, 0x80)]);
    let (mut stops, mut reads): (Vec<_>, Vec<_>) = (Vec::new(), Vec::new());
    sent[2..].chunks_exact(2).for_each(|pair| (reads.push(pair[0]), stops.push(pair[1])).1);
    assert!(reads.iter().all(|&(_, byte)| byte == 0x9A), "{sent:?}");
    assert!(stops.iter().all(|&(_, byte)| byte != 0x9A), "{sent:?}");
    assert!(reads.iter().zip(&stops).all(|(read, stop)| read.0 == stop.0), "{sent:?}");
}

/// The feedback of the set-point may be the same bytes as its echo. Four answers show that there is no echo.
#[test]
fn first_set_point_is_sent_after_four_status_reads() {
    let (port, mut arm) = quiet(UNCONFIGURED);
    arm.set_point(id(1), torque()).unwrap();
    run(&mut arm, 50_000);
    assert_eq!(sent(&port), [(1, 0x9A), (1, 0x9A), (1, 0x9A), (1, 0x9A), (1, 0xA1)]);
}

#[test]
fn adapter_without_echo_gets_four_status_reads_only() {
    let (port, mut arm) = quiet(UNCONFIGURED);
    for _ in 0..5 {
        arm.ask(id(1), ReadMultiTurnAngle).unwrap();
        assert!(arm.stop(id(1), StopKind::Hold));
        arm.master().lift_stop();
    }
    port.state().read_fails = true;
    confirmations(&mut arm, 1_000);
    port.state().read_fails = false;
    arm.ask(id(1), ReadMultiTurnAngle).unwrap();
    let reads = sent(&port).iter().take_while(|&&(_, byte)| byte == 0x9A).count();
    assert_eq!(reads, 4);
    assert_eq!(sent(&port).iter().filter(|&&(_, byte)| byte == 0x9A).count(), 4);
}

#[test]
fn single_attempt_is_acknowledged_on_a_line_not_heard_before() {
    let (_, mut arm) = quiet(Config { attempts: 1, ..UNCONFIGURED });
    let ticket = arm.master().request(id(1), Stop).unwrap();
    let (end, mut events) = (arm.now() + Duration::from_millis(100), Vec::new());
    arm.run_until(end, |event| events.push(event)).unwrap();
    assert_eq!(events.len(), 1, "what shows an echo is answered to nobody: {events:?}");
    assert_eq!(ticket.outcome(&events[0]), Some(Ok(Stop)));
}

#[test]
fn no_echo_confirms_a_stop_on_a_line_cut_again_and_again() {
    // Nobody is there. The line is dead until so many bytes were sent, and whole for so many more, again and again.
    for dead in [13, 26, 39, 52, 65] {
        for whole in [13, 26, 39, 52] {
            let (port, mut arm) = echoing(false);
            arm.master().stop(id(9), StopKind::Hold).unwrap();
            let mut confirmed = 0;
            for _ in 0..4_000 {
                let sent = port.written().len() % (dead + whole);
                port.state().is_cut = sent < dead;
                confirmed += confirmations(&mut arm, 100);
            }
            arm.master().lift_stop();
            assert_eq!(confirmed, 0, "dead for {dead} bytes, whole for {whole}");
            assert!(!arm.stop(id(8), StopKind::Hold), "dead for {dead} bytes, whole for {whole}");
        }
    }
}

#[test]
fn stops_are_confirmed_on_a_line_on_which_nothing_else_was_heard() {
    let (port, mut arm) = quiet(UNCONFIGURED);
    // Motors 1 to 3 get their power late.
    port.state().is_cut = true;
    (1..=3).for_each(|motor| arm.master().stop(id(motor), StopKind::Hold).unwrap());
    assert_eq!(confirmations(&mut arm, 60_000), 0);
    port.state().is_cut = false;
    assert_eq!(confirmations(&mut arm, 60_000), 3);
}

#[test]
fn echoes_that_pile_up_while_reading_fails_confirm_nothing() {
    for is_configured in [false, true] {
        for motors in 1..=4 {
            for fails_for in [20, 50, 100, 150, 200, 300, 400] {
                let (port, mut arm) = echoing(is_configured);
                // Nobody is there.
                (6..6 + motors).for_each(|it| arm.master().stop(id(it), StopKind::Hold).unwrap());
                port.state().read_fails = true;
                let mut confirmed = confirmations(&mut arm, fails_for * 1_000);
                port.state().read_fails = false;
                confirmed += confirmations(&mut arm, 500_000);
                assert_eq!(confirmed, 0, "{is_configured}, {motors} motors, {fails_for} ms");
            }
        }
    }
}

#[test]
fn command_to_a_second_motor_is_not_held_back_by_an_echo() {
    let (port, mut arm) = echoing(false);
    arm.ask(id(1), ReadStatus1).unwrap();
    let ticket = arm.master().request(id(2), ReadMultiTurnAngle).unwrap();
    let events = run(&mut arm, 1_000_000);
    let outcome = events.iter().find_map(|event| ticket.outcome(event));
    assert!(matches!(outcome, Some(Ok(_))), "{outcome:?} behind {} frames", sent(&port).len());
    // Nor is a stop kept back whose first attempt was lost.
    let (port, mut arm) = echoing(false);
    arm.ask(id(1), ReadStatus1).unwrap();
    port.state().is_cut = true;
    arm.master().stop(id(2), StopKind::Hold).unwrap();
    run(&mut arm, 2_000);
    port.state().is_cut = false;
    assert!(arm.stop(id(2), StopKind::Hold), "{} frames", sent(&port).len());
}

#[test]
fn request_is_answered_though_every_other_echo_is_lost() {
    let (port, mut arm) = echoing(false);
    let ticket = arm.master().request(id(2), ReadMultiTurnAngle).unwrap();
    let mut outcome = None;
    while outcome.is_none() && arm.now() < Instant::from_millis(500) {
        port.state().echoes = sent(&port).len().is_multiple_of(2);
        let events = run(&mut arm, 100);
        outcome = events.iter().find_map(|event| ticket.outcome(event));
    }
    assert!(matches!(outcome, Some(Ok(_))), "{outcome:?} behind {:?}", sent(&port));
}

#[test]
fn one_lost_echo_after_a_cut_lets_no_echo_confirm_a_stop() {
    for cut in 1..20 {
        for noise in cut..cut + 6 {
            let (port, mut arm) = echoing(false);
            arm.master().stop(id(1), StopKind::Hold).unwrap();
            // Nobody is there.
            arm.master().stop(id(9), StopKind::Hold).unwrap();
            let mut events = Vec::new();
            for _ in 0..5_000 {
                let frames = sent(&port).len();
                (port.state().is_cut, port.state().echoes) = (frames < cut, frames != noise);
                events.extend(run(&mut arm, 100));
            }
            let nobody = Event::StopConfirmed { motor: id(9) };
            assert!(!events.contains(&nobody), "cut for {cut} frames, the echo of {noise} lost");
        }
    }
}

#[test]
fn half_taken_reads_do_not_show_an_adapter_without_echo() {
    let (port, mut arm) = echoing(false);
    port.state().is_cut = true;
    arm.master().stop(id(1), StopKind::Hold).unwrap();
    run(&mut arm, 8_000);
    let answer = Frame { address: id(1).into(), data: [0x9A, 50, 30, 1, 0xE5, 1, 0, 0] }.encode();
    // Four reads, and a stop behind each.
    for _ in 0..8 {
        let length = port.written().len();
        (port.state().at_most, port.state().fails_after) = (5, Some(length + 5));
        while port.written().len() == length {
            run(&mut arm, 100);
        }
        port.hear(&answer);
        run(&mut arm, 50);
    }
    (port.state().at_most, port.state().fails_after) = (0, None);
    port.state().is_cut = false;
    assert!(!arm.stop(id(9), StopKind::Hold), "nobody is there");
}

#[test]
fn scan_finds_no_motor_in_its_own_echo() {
    let config = UNCONFIGURED.adapting_up_to(Duration::from_millis(40));
    // Of these motors only motor 1 is there.
    for there in [MotorSet::EMPTY, id(1).into()] {
        for hands_over_every in [0, 1_000, 16_000] {
            let (port, mut arm) = quiet(config);
            (port.state().echoes, port.state().hands_over_every) = (true, hands_over_every);
            let candidates = (9..=32).map(id).collect::<MotorSet>().with(there);
            let found = bring_up::scan(&mut arm, candidates, |_, _| {});
            assert_eq!(found, Ok(there), "in bursts of {hands_over_every} us");
        }
    }
}

#[test]
fn first_stops_of_three_live_motors_are_sent_within_70_ms() {
    for to_all in [true, false] {
        let (port, mut arm) = quiet(UNCONFIGURED.adapting_up_to(Duration::from_millis(40)));
        let motors: MotorSet = (1..=3).map(id).collect();
        match to_all {
            true => arm.master().stop_all(StopKind::Hold, motors).unwrap(),
            false => {
                motors.iter().for_each(|it| arm.master().stop(it, StopKind::Hold).unwrap());
            }
        }
        run(&mut arm, 70_000);
        assert!(sent(&port).contains(&(3, 0x81)), "{:?}", sent(&port));
    }
}

#[test]
fn request_ends_within_2_s_though_set_points_ask_for_an_echo() {
    let (_, mut arm) = quiet(UNCONFIGURED);
    let ticket = arm.master().request(id(9), ReadStatus1).unwrap();
    let mut outcome = None;
    for _ in 0..200 {
        let _ = arm.set_point(id(9), torque());
        let events = run(&mut arm, 10_000);
        outcome = outcome.or(events.iter().find_map(|event| ticket.outcome(event)));
    }
    assert!(outcome.is_some(), "2 s");
}

#[test]
fn reset_without_reply_does_not_count_as_a_question_for_an_echo() {
    let (_, mut arm) = quiet(Config { attempts: 1, ..UNCONFIGURED });
    arm.ask(id(1), Reset).unwrap();
    run(&mut arm, 2_500_000);
    assert_eq!(arm.ask(id(1), Stop), Ok(Stop));
}

#[test]
fn echo_lost_with_a_read_error_does_not_show_an_adapter_without_echo() {
    let (port, mut arm) = echoing(false);
    // Each echo is lost with the error that tells of it, but not the answer.
    for asked in 1..=5 {
        let ticket = arm.master().request(id(1), ReadStatus1).unwrap();
        while sent(&port).len() < asked {
            assert_eq!(arm.poll(), Ok(None));
            arm.idle(Instant::from_millis(1_000));
        }
        port.lose();
        port.state().read_fails = true;
        assert!(arm.poll().is_err());
        port.state().read_fails = false;
        let events = run(&mut arm, 5_000);
        let outcome = events.iter().find_map(|event| ticket.outcome(event));
        assert!(matches!(outcome, Some(Ok(_))), "{outcome:?}");
    }
    assert!(!arm.stop(id(9), StopKind::Hold), "nobody is there");
}

#[test]
fn reads_sent_back_by_a_drive_that_lost_its_master_show_no_echo() {
    let (port, mut arm) = quiet(UNCONFIGURED);
    let line = |data| Frame { address: id(1).into(), data }.encode();
    for _ in 0..3 {
        // It says so, hands the next command back and ignores it, and answers the second attempt.
        port.hear(&line([0xF1, 0, 0, 0, 0, 0, 0, 0]));
        run(&mut arm, 100);
        port.state().is_cut = true;
        let _ = arm.master().request(id(1), ReadStatus1).unwrap();
        run(&mut arm, 1_000);
        port.hear(&line([0x9A, 0, 0, 0, 0, 0, 0, 0]));
        run(&mut arm, 1_000);
        port.state().is_cut = false;
        run(&mut arm, 1_000_000);
    }
    assert!(arm.stop(id(1), StopKind::Hold), "{:?}", sent(&port));
}

#[test]
fn echo_lost_in_a_cut_long_ago_is_no_longer_expected() {
    let (port, mut arm) = echoing(true);
    port.state().is_cut = true;
    let once = Patience { reply_timeout: Duration::from_millis(5), attempts: 1 };
    assert!(arm.ask_with(id(1), Stop, Some(once), |_| {}).is_err());
    run(&mut arm, 200_000);
    port.state().is_cut = false;
    assert_eq!(
        arm.ask_with(id(1), Stop, Some(once), |_| {}),
        Ok(Stop),
        "its answer is no second echo"
    );
}

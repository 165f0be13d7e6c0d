//! Drives that were not spoken to for a while answer the first two commands and do not obey (2.31.1).

use super::*;
use crate::id::Target;
use crate::master::Presence;

/// How often the motor has to answer this, which was put, until that counts. It is sent every millisecond.
fn answers_until<const N: usize>(
    master: &mut Master<N>,
    data: Data,
    from: u64,
    counts: impl Fn(&Event) -> bool,
) -> usize {
    for now in from..from + 10 {
        assert_eq!(sent(master, ms(now)), [packet_to(1, data)]);
        if reply(master, 1, data, half_past(now)).is_some_and(|event| counts(&event)) {
            assert_eq!(sent(master, ms(now + 1)), [], "it goes on");
            return (now - from + 1) as usize;
        }
    }
    panic!("it never counts")
}

fn is_confirmed(event: &Event) -> bool {
    Some(*event) == confirmed(1)
}

/// It was spoken to, and then this has happened. Returns when it can be stopped.
type Story = fn(&mut Master<2>) -> u64;

/// It does not answer a command for so many milliseconds. Returns when that is known.
fn unanswered<const N: usize>(master: &mut Master<N>, from: u64, millis: u64) -> u64 {
    let _ = master.request_with(id(1), ReadModel, once(millis)).unwrap();
    assert_eq!(sent(master, ms(from)).len(), 1);
    assert!(!events(master, ms(from + millis)).is_empty(), "it has failed");
    from + millis
}

#[test]
fn hold_counts_when_it_was_answered_often_enough_after_a_silence() {
    let stories: [(Story, usize); 10] = [
        (|_| 6, 1),
        // The last command was answered at 4.5 ms, and the next answer comes after half a millisecond, too.
        (|_| 154, 1),
        (|_| 155, 3),
        (
            |master| {
                answers(master, [155]);
                156
            },
            2,
        ),
        (
            |master| {
                answers(master, [155, 156]);
                157
            },
            1,
        ),
        // A pause between two that were answered.
        (
            |master| {
                answers(master, [155, 310]);
                311
            },
            2,
        ),
        (|master| unanswered(master, 5, 149), 1),
        (|master| unanswered(master, 5, 150), 3),
        (
            |master| {
                let now = unanswered(master, 5, 150);
                answers(master, [now]);
                now + 1
            },
            2,
        ),
        (
            |master| {
                reply(master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(5)).unwrap();
                6
            },
            // The first is the one that it sends back.
            4,
        ),
    ];
    for (number, (story, expected)) in stories.into_iter().enumerate() {
        let spoken_to = || {
            let mut master = Master::<2>::new(Config::CAN);
            answers(&mut master, 1..5);
            let now = story(&mut master);
            (master, now)
        };
        let (mut master, now) = spoken_to();
        master.stop(id(1), StopKind::Hold).unwrap();
        let answers = answers_until(&mut master, Stop.encode(), now, is_confirmed);
        assert_eq!(answers, expected, "{number}");
        // However it is told to hold, also with a single attempt.
        let (mut master, now) = spoken_to();
        let hold = master.request_with(id(1), Stop, once(20)).unwrap();
        let is_outcome = |event: &Event| matches!(hold.outcome(event), Some(Ok(_)));
        if expected < 4 {
            assert_eq!(
                answers_until(&mut master, Stop.encode(), now, is_outcome),
                expected,
                "{number}"
            );
        }
        // It is switched off all the same.
        let (mut master, now) = spoken_to();
        master.stop(id(1), StopKind::Off).unwrap();
        let answers = answers_until(&mut master, Shutdown.encode(), now, is_confirmed);
        assert_eq!(answers, if expected == 4 { 2 } else { 1 }, "{number}");
    }
}

/// Somebody else may have left it without a word for long.
#[test]
fn first_hold_of_a_motor_counts_after_three_answers() {
    for (asked_before, expected) in [(0, 3), (1, 2), (2, 1), (3, 1)] {
        let mut master = Master::<2>::new(Config::CAN);
        answers(&mut master, 1..1 + asked_before);
        master.stop_all(StopKind::Hold, id(1).into()).unwrap();
        let from = 1 + asked_before;
        assert_eq!(answers_until(&mut master, Stop.encode(), from, is_confirmed), expected);
        // The same again once its place was given to another.
        assert!(master.forget(id(1)));
        master.stop_all(StopKind::Hold, id(1).into()).unwrap();
        assert_eq!(answers_until(&mut master, Stop.encode(), from + 10, is_confirmed), 3);
    }
}

/// Each frame comes twice.
#[test]
fn doubled_answer_to_a_hold_that_is_sent_again_is_no_stray() {
    let tells: [fn(&mut Master<2>); 2] = [
        |master| master.stop(id(1), StopKind::Hold).unwrap(),
        |master| _ = master.request_with(id(1), Stop, once(20)).unwrap(),
    ];
    for (tell, is_sent_soon) in tells.into_iter().flat_map(|tell| [(tell, true), (tell, false)]) {
        let mut master = Master::<2>::new(Config::CAN);
        tell(&mut master);
        assert_eq!(sent(&mut master, ms(0)).len(), 1);
        for at in [1, 2].map(ms) {
            assert_eq!(reply(&mut master, 1, Stop.encode(), at), None);
            let again = at + Duration::from_micros(100);
            // Before it goes again, or after that.
            if is_sent_soon {
                assert_eq!(sent(&mut master, at), [packet_to(1, Stop.encode())]);
            }
            assert_eq!(reply(&mut master, 1, Stop.encode(), again), None);
            assert_eq!(sent(&mut master, again).len(), usize::from(!is_sent_soon));
        }
    }
}

/// Its drive lets go in the silence, and holds nothing from then on, whatever it has confirmed before.
#[test]
fn motor_is_told_again_to_hold_when_it_is_heard_after_a_silence() {
    type End = fn(&mut Master<2>) -> Option<Data>;
    let command = |master: &mut Master<2>, command: Data| {
        assert_eq!(sent(master, ms(12)), [packet_to(1, command)]);
        reply(master, 1, command, half_past(12)).unwrap();
    };
    // And up to which silence it is told again.
    let ends: [(StopKind, End, u64); 5] = [
        (StopKind::Hold, |_| None, u64::MAX),
        // Nobody has asked it for anything since. A restart is reported, and the caller has to know.
        (
            StopKind::Hold,
            |master| {
                master.lift_stop();
                None
            },
            1_000,
        ),
        (StopKind::Off, |_| None, 0),
        (
            StopKind::Hold,
            |master| {
                let _ = master.request(id(1), Shutdown).unwrap();
                Some(Shutdown.encode())
            },
            0,
        ),
        (
            StopKind::Hold,
            |master| {
                let _ = master.request(id(1), LockBrake).unwrap();
                Some(LockBrake.encode())
            },
            u64::MAX,
        ),
    ];
    // The last answer came at 10.5 or 12.5 ms. Behind the last of these it may have restarted.
    let silences: [(Story, u64); 5] = [
        (|_| 400, 0),
        (|master| unanswered(master, 20, 240), 250),
        (|master| unanswered(master, 20, 250), 260),
        (|master| unanswered(master, 20, 900), 910),
        (|master| unanswered(master, 20, 1_100), 1_110),
    ];
    for (number, (kind, end, longest)) in ends.into_iter().enumerate() {
        for (silence, millis) in silences {
            let mut master = Master::<2>::new(Config::CAN);
            answers(&mut master, 1..5);
            master.stop(id(1), kind).unwrap();
            let (_, stop) = kind.command();
            assert_eq!(answers_until(&mut master, stop, 10, is_confirmed), 1);
            if let Some(data) = end(&mut master) {
                command(&mut master, data);
            }
            let now = silence(&mut master);
            master.hold_again(MotorSet::ALL);
            assert_eq!(sent(&mut master, ms(now)), [], "nothing shows that it is there");
            answers(&mut master, [now]);
            master.hold_again(id(2).into());
            assert_eq!(sent(&mut master, ms(now + 1)), [], "another is meant");
            master.hold_again(MotorSet::ALL);
            if millis > 250 && millis < longest {
                let answers = answers_until(&mut master, stop, now + 1, is_confirmed);
                assert_eq!(answers, 2, "{number}");
                master.hold_again(MotorSet::ALL);
            }
            assert_eq!(sent(&mut master, ms(now + 5)), [], "{number}");
        }
    }
}

/// It is there, and need not be asked first. The first answer is the command that it sends back.
#[test]
fn motor_that_says_that_it_has_let_go_is_told_again_at_once() {
    let mut master = Master::<2>::new(Config::CAN);
    answers(&mut master, 1..5);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(answers_until(&mut master, Stop.encode(), 10, is_confirmed), 1);
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(20)).unwrap();
    master.hold_again(MotorSet::ALL);
    assert_eq!(answers_until(&mut master, Stop.encode(), 21, is_confirmed), 4);
}

/// The drive sends this back, which is no feedback.
#[track_caller]
fn comes_back(master: &mut Master<2>, set_point: RawMotion, at: Instant) {
    let packet = Packet { channel: Channel::MotionReply(id(1)), data: set_point.encode() };
    let event = master.handle_frame(&Received::Packet(packet), at);
    assert!(!matches!(event, Some(Event::Feedback { .. })), "{event:?}");
}

/// Its message was not heard: the first set-point after the silence, or one from the silence, comes back.
#[test]
fn set_point_that_is_sent_back_after_a_silence_is_no_feedback() {
    for is_late in [false, true] {
        let mut master = Master::<2>::new(Config::CAN);
        master.set_point(id(1), motion(), ms(0)).unwrap();
        sent(&mut master, ms(0));
        assert!(matches!(motion_feedback(&mut master, ms(1)), Some(Event::Feedback { .. })));
        let known = master.latest_feedback(id(1));
        let _ = unanswered(&mut master, 2, 200);
        // Half a turn on, so that its bytes differ.
        let other = RawMotion { position: 0x9999, ..motion() };
        master.set_point(id(1), if is_late { other } else { motion() }, ms(202)).unwrap();
        assert_eq!(sent(&mut master, ms(202)).len(), 1);
        let mut at = 203;
        if is_late {
            events(&mut master, ms(230));
            master.set_point(id(1), motion(), ms(230)).unwrap();
            assert_eq!(sent(&mut master, ms(230)).len(), 1);
            at = 231;
        }
        comes_back(&mut master, if is_late { other } else { motion() }, ms(at));
        assert_eq!(master.latest_feedback(id(1)), known);
    }
}

/// It lay in the controller while the bus was out, and comes back before anything else was sent.
#[test]
fn set_point_that_is_sent_back_after_an_outage_is_no_feedback() {
    let mut master = Master::<2>::new(Config::CAN);
    master.set_point(id(1), motion(), ms(0)).unwrap();
    sent(&mut master, ms(0));
    assert!(matches!(motion_feedback(&mut master, ms(1)), Some(Event::Feedback { .. })));
    let known = master.latest_feedback(id(1));
    master.set_point(id(1), motion(), ms(2)).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    events(&mut master, ms(30));
    comes_back(&mut master, motion(), ms(520));
    assert_eq!(master.latest_feedback(id(1)), known);
}

/// Its identifier is less urgent than those of the answers to the stops, which come first.
#[test]
fn set_point_that_is_sent_back_behind_other_answers_is_no_feedback() {
    let mut master = Master::<2>::new(Config::CAN);
    answers(&mut master, 1..5);
    master.set_point(id(1), motion(), ms(5)).unwrap();
    assert_eq!(sent(&mut master, ms(5)).len(), 1);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(6)).len(), 1);
    reply(&mut master, 1, [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ms(20)).unwrap();
    for now in 21..25 {
        reply(&mut master, 1, Stop.encode(), ms(now));
        sent(&mut master, ms(now));
    }
    comes_back(&mut master, motion(), ms(26));
    assert_eq!(master.latest_feedback(id(1)), None);
}

/// Each of its feedbacks looks as if a command was sent back: it names another motor, or none.
#[test]
fn feedback_of_odd_drives_counts_after_three_answers() {
    for odd in [33, 0].map(|names| [names, 0xE6, 0x66, 0x82, 0xEB, 0x55, 0, 0]) {
        let mut master = Master::<2>::new(Config::CAN);
        let packet = Packet { channel: Channel::MotionReply(id(1)), data: odd };
        let mut feedbacks_of = |times: core::ops::Range<u64>| -> Vec<bool> {
            let exchange = |now| {
                master.set_point(id(1), motion(), ms(now)).unwrap();
                assert_eq!(sent(&mut master, ms(now)).len(), 1);
                let event = master.handle_frame(&Received::Packet(packet), half_past(now)).unwrap();
                assert!(matches!(event, Event::Feedback { .. } | Event::SetPointUnanswered { .. }));
                matches!(event, Event::Feedback { .. })
            };
            times.map(exchange).collect()
        };
        assert_eq!(feedbacks_of(0..5), [false, false, false, true, true]);
        assert_eq!(feedbacks_of(300..305), [false, false, false, true, true]);
        // It is there all the same.
        let _ = unanswered(&mut master, 310, 160);
        assert_eq!(master.health(id(1)).presence, Presence::Late);
        master.set_point(id(1), motion(), ms(471)).unwrap();
        assert_eq!(sent(&mut master, ms(471)).len(), 1);
        master.handle_frame(&Received::Packet(packet), ms(472)).unwrap();
        assert_eq!(master.health(id(1)).presence, Presence::Present);
    }
}

/// Its program has hung. Nothing was lost, and nothing shows that it has let go.
#[test]
fn motor_that_was_sent_nothing_for_long_is_told_again() {
    for (pause, is_told) in [(400, false), (401, true)] {
        let mut master = held();
        answers(&mut master, [20]);
        let _ = ask(&mut master, 1, ReadStatus1, ms(20 + pause));
        master.hold_again(MotorSet::ALL);
        assert_eq!(sent(&mut master, ms(20 + pause)), [], "nothing shows that it is there");
        reply(&mut master, 1, STATUS_REPLY, half_past(20 + pause)).unwrap();
        master.hold_again(MotorSet::ALL);
        assert_eq!(sent(&mut master, ms(21 + pause)).len(), usize::from(is_told), "{pause}");
    }
}

/// Whoever asks it all the time leaves it no rest.
#[test]
fn motor_is_told_again_although_it_is_busy() {
    let mut master = held();
    answers(&mut master, [20, 520]);
    let _ = master.request(id(1), ReadModel).unwrap();
    master.hold_again(MotorSet::ALL);
    assert_eq!(sent(&mut master, ms(521)), [packet_to(1, Stop.encode())]);
}

/// It was asked for its errors. 0 V: it has measured nothing.
#[test]
fn status_that_is_sent_back_late_is_no_report() {
    let mut master = Master::<2>::new(Config::CAN);
    answers(&mut master, 1..5);
    let empty = reply(&mut master, 1, ReadStatus1.encode(), ms(100)).unwrap();
    assert!(matches!(empty, Event::Stray { .. }), "{empty:?}");
    let report = reply(&mut master, 1, STATUS_REPLY, ms(110)).unwrap();
    assert!(matches!(report, Event::Report { .. }), "{report:?}");
}

/// It holds, under a stop in force.
fn held() -> Master<2> {
    let mut master = Master::<2>::new(Config::CAN);
    answers(&mut master, 1..5);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(answers_until(&mut master, Stop.encode(), 10, is_confirmed), 1);
    master
}

/// The host was held up, and finds what the motor has answered before.
#[test]
fn answer_from_before_a_pause_is_none_behind_it() {
    let stories: [fn(&mut Master<2>); 2] = [
        |master| {
            let _ = ask(master, 1, ReadStatus1, ms(5));
            reply(master, 1, STATUS_REPLY, ms(505)).unwrap();
        },
        |master| {
            master.set_point(id(1), torque(1.0), ms(5)).unwrap();
            sent(master, ms(5));
            reply(master, 1, TORQUE_REPLY, ms(505)).unwrap();
        },
    ];
    for story in stories {
        let mut master = Master::<2>::new(Config::CAN);
        answers(&mut master, 1..5);
        story(&mut master);
        master.stop(id(1), StopKind::Hold).unwrap();
        assert_eq!(answers_until(&mut master, Stop.encode(), 506, is_confirmed), 3);
    }
}

/// It reports its angle (0xB6), and hears nothing.
#[test]
fn reports_do_not_show_that_a_motor_hears() {
    let mut master = Master::<2>::new(Config::CAN);
    answers(&mut master, 1..5);
    for now in (10..600).step_by(10) {
        if now % 50 == 0 {
            let _ = master.request_with(id(1), ReadModel, once(5));
        }
        sent(&mut master, ms(now));
        events(&mut master, ms(now + 6));
        reply(&mut master, 1, ANGLE_REPLY, ms(now + 7));
    }
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(answers_until(&mut master, Stop.encode(), 610, is_confirmed), 3);
}

/// Somebody tells it to hold, and that is lost, or may not be obeyed.
#[test]
fn motor_that_was_told_to_hold_in_vain_is_told_again() {
    let stories: [fn(&mut Master<2>); 2] = [
        |master| {
            let _ = master.request_with(id(1), Stop, once(5)).unwrap();
            sent(master, ms(301));
            events(master, ms(310));
        },
        |master| {
            master.broadcast(Stop, id(1).into()).unwrap();
            sent(master, ms(301));
            reply(master, 1, Stop.encode(), ms(302));
            events(master, ms(310));
        },
    ];
    for story in stories {
        let mut master = held();
        let now = unanswered(&mut master, 20, 260);
        answers(&mut master, [now]);
        story(&mut master);
        answers(&mut master, [400, 401]);
        master.hold_again(MotorSet::ALL);
        assert_eq!(sent(&mut master, ms(402)), [packet_to(1, Stop.encode())]);
    }
}

/// It holds, and may have let go: it was silent. Returns the time.
fn loose() -> (Master<2>, u64) {
    let mut master = held();
    let now = unanswered(&mut master, 20, 260);
    answers(&mut master, [now]);
    (master, now + 1)
}

/// Nobody has heard whether it was switched off.
#[test]
fn motor_that_was_told_to_let_go_is_not_told_again_to_hold() {
    let (mut master, now) = loose();
    let _ = master.request_with(id(1), Shutdown, once(5)).unwrap();
    assert_eq!(sent(&mut master, ms(now)), [packet_to(1, Shutdown.encode())]);
    assert_eq!(events(&mut master, ms(now + 10)).len(), 1, "it has failed");
    answers(&mut master, now + 11..now + 14);
    master.hold_again(MotorSet::ALL);
    assert_eq!(sent(&mut master, ms(now + 15)), []);
}

/// Its controller has handed each frame back: nothing was sent.
#[test]
fn frames_that_are_handed_back_do_not_speak_to_a_motor() {
    let tells: [fn(&mut Master<2>, u64); 2] = [
        |master, at| master.set_point(id(1), torque(1.0), ms(at)).unwrap(),
        |master, _| _ = master.request_with(id(1), ReadModel, once(5)),
    ];
    for (tell, pause) in tells.into_iter().flat_map(|tell| [(tell, 160), (tell, 420)]) {
        let mut master = held();
        master.lift_stop();
        for at in (20..20 + pause).step_by(10) {
            tell(&mut master, at);
            for packet in sent(&mut master, ms(at)) {
                master.handle_pushed_out(&packet);
            }
            events(&mut master, ms(at));
        }
        let now = 20 + pause;
        master.stop(id(1), StopKind::Hold).unwrap();
        assert_eq!(answers_until(&mut master, Stop.encode(), now, is_confirmed), 3, "{pause}");
    }
}

/// Its caller has time, and it answers at last.
#[test]
fn a_silence_within_one_long_time_out_counts() {
    let mut master = held();
    master.lift_stop();
    let hold = master.request_with(id(1), Stop, once(2_000)).unwrap();
    assert_eq!(sent(&mut master, ms(20)).len(), 1);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(600)), None);
    let is_outcome = |event: &Event| matches!(hold.outcome(event), Some(Ok(_)));
    // When it has heard the first one is not known.
    assert_eq!(answers_until(&mut master, Stop.encode(), 601, is_outcome), 3);

    let mut master = held();
    let read = master.request_with(id(1), ReadModel, once(500)).unwrap();
    assert_eq!(sent(&mut master, ms(20)).len(), 1);
    let event = reply(&mut master, 1, *b"\xB5X8S2V10", ms(390)).unwrap();
    assert!(read.outcome(&event).is_some_and(|outcome| outcome.is_ok()));
    master.hold_again(MotorSet::ALL);
    assert_eq!(sent(&mut master, ms(391)), [packet_to(1, Stop.encode())]);
}

/// A caller lets it go, or locks its brake, under a stop in force that is to hold it.
#[test]
fn command_that_ends_motion_goes_before_a_hold_that_goes_again() {
    fn goes_first<C: Command + Copy>(command: C, is_held_after: bool) {
        let (mut master, now) = loose();
        let asked = master.request(id(1), command).unwrap();
        master.hold_again(MotorSet::ALL);
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, command.encode())]);
        master.hold_again(MotorSet::ALL);
        let event = reply(&mut master, 1, command.encode(), half_past(now)).unwrap();
        assert!(asked.outcome(&event).is_some_and(|outcome| outcome.is_ok()));
        master.hold_again(MotorSet::ALL);
        assert_eq!(sent(&mut master, ms(now + 1)).len(), usize::from(is_held_after));
    }
    goes_first(Shutdown, false);
    // Its brake may slip, and the stop is to hold it.
    goes_first(LockBrake, true);
}

/// Its drive says after each that it has lost its master, and sends it back.
#[test]
fn stop_that_is_sent_back_again_and_again_is_given_up() {
    for kind in [StopKind::Hold, StopKind::Off] {
        let mut master = Master::<2>::new(Config::CAN);
        answers(&mut master, 1..5);
        master.stop(id(1), kind).unwrap();
        let (_, stop) = kind.command();
        let mut times = 0;
        let lost_master = [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0];
        let is_given_up = (5..50).any(|now| {
            times += sent(&mut master, ms(now)).len();
            reply(&mut master, 1, lost_master, half_past(now));
            reply(&mut master, 1, stop, half_past(now) + Duration::from_micros(400));
            events(&mut master, ms(now + 1)) == [Event::StopUnconfirmed { motor: id(1) }]
        });
        assert!(is_given_up && times == 15, "{kind:?}: {times}");
    }
}

/// The stop is lifted, and its caller wants something else, or has asked it for something since.
#[test]
fn motor_is_not_held_again_against_its_caller() {
    let stories: [fn(&mut Master<2>, u64); 12] = [
        |master, now| master.set_point(id(1), torque(1.0), ms(now)).unwrap(),
        |master, _| _ = master.request(id(1), step()).unwrap(),
        |master, now| {
            master.set_point(id(1), torque(1.0), ms(now)).unwrap();
            sent(master, ms(now));
            reply(master, 1, TORQUE_REPLY, half_past(now)).unwrap();
        },
        |master, now| {
            let _ = ask(master, 1, ReleaseBrake, ms(now));
            reply(master, 1, ReleaseBrake.encode(), half_past(now)).unwrap();
        },
        |master, now| {
            let _ = ask(master, 1, Reset, ms(now));
            events(master, ms(now + 3_000));
            master.resume(id(1));
        },
        // It restarts on its own.
        |master, _| {
            master.note_restart(id(1));
            master.resume(id(1));
        },
        |master, now| {
            let _ = ask(master, 1, LockBrake, ms(now));
            reply(master, 1, LockBrake.encode(), half_past(now)).unwrap();
        },
        // Another master lets it go.
        |master, now| {
            let stray = reply(master, 1, Shutdown.encode(), ms(now)).unwrap();
            assert!(matches!(stray, Event::Stray { .. }), "{stray:?}");
        },
        // Another master moves it.
        |master, now| {
            let stray = motion_feedback(master, ms(now)).unwrap();
            assert!(matches!(stray, Event::Stray { .. }), "{stray:?}");
        },
        // The same by a command that is not known here, such as 0x72 of V4.4.
        |master, now| {
            let stray = reply(master, 1, [0x72, 30, 0, 0, 0x10, 0, 7, 0], ms(now)).unwrap();
            assert!(matches!(stray, Event::Stray { .. }), "{stray:?}");
        },
        // All are to move.
        |master, _| master.broadcast(torque(1.0), id(1).into()).unwrap(),
        // Nobody speaks to it for as long as a restart takes.
        |master, now| {
            let _ = ask(master, 1, ReadStatus1, ms(now + 1_000));
            reply(master, 1, STATUS_REPLY, half_past(now + 1_000)).unwrap();
        },
    ];
    for (number, story) in stories.into_iter().enumerate() {
        let (mut master, now) = loose();
        master.lift_stop();
        story(&mut master, now);
        master.hold_again(MotorSet::ALL);
        let stop = packet_to(1, Stop.encode());
        assert!(!sent(&mut master, ms(now + 4_000)).contains(&stop), "{number}");
    }
}

/// Each exchange of eight motors takes 40 ms, so that 640 ms between two of one motor are no pause.
#[test]
fn pauses_of_a_slow_line_are_longer() {
    let held = || {
        let mut master = Master::<8>::new(
            Config::rs485(115_200, false).adapting_up_to(Duration::from_millis(60)),
        );
        (1..=8).for_each(|motor| obeys(&mut master, motor));
        let mut now = 0;
        for _ in 0..40 {
            let _ = ask(&mut master, 1, ReadModel, ms(now));
            says(&mut master, 1, *b"\xB5X8S2V10", ms(now + 40)).unwrap();
            now += 41;
        }
        master.stop(id(1), StopKind::Hold).unwrap();
        assert_eq!(sent(&mut master, ms(now)), [packet_to(1, Stop.encode())]);
        assert_eq!(says(&mut master, 1, Stop.encode(), ms(now + 40)), confirmed(1));
        (master, now + 40)
    };
    for (pause, confirms, is_told) in
        [(600, 1, false), (700, 3, false), (1_200, 3, false), (1_350, 3, true)]
    {
        let (mut master, now) = held();
        master.lift_stop();
        master.stop(id(1), StopKind::Hold).unwrap();
        let at = now + pause;
        let answers = (at..).position(|at| {
            assert_eq!(sent(&mut master, ms(at)).len(), 1);
            says(&mut master, 1, Stop.encode(), half_past(at)) == confirmed(1)
        });
        assert_eq!(answers, Some(confirms - 1), "{pause}");
        let (mut master, now) = held();
        let at = now + pause;
        let _ = ask(&mut master, 1, ReadModel, ms(at));
        says(&mut master, 1, *b"\xB5X8S2V10", ms(at + 1)).unwrap();
        master.hold_again(MotorSet::ALL);
        assert_eq!(sent(&mut master, ms(at + 20)).len(), usize::from(is_told), "{pause}");
    }
}

/// It came behind its time-out.
#[test]
fn late_answer_to_a_hold_counts_as_one() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    assert_eq!(events(&mut master, ms(21)), []);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(21)), None);
    assert_eq!(answers_until(&mut master, Stop.encode(), 22, is_confirmed), 2);
}

/// Nobody has called for it, and a caller that has counted them may go on.
#[test]
fn hold_that_goes_again_is_no_call_for_a_stop() {
    let (mut master, _) = loose();
    let known = master.stop_count();
    master.hold_again(MotorSet::ALL);
    assert!(master.lift_stop_if(known));
}

#[test]
fn hold_that_goes_again_and_is_not_confirmed_is_reported() {
    let (mut master, now) = loose();
    master.hold_again(MotorSet::ALL);
    let _given_up = is_given_up(&mut master, 1, now);
}

/// On a line it would collide with that.
#[test]
fn hold_that_goes_again_leaves_time_for_the_answer_under_way() {
    let mut master = Master::<2>::new(Config::rs485(115_200, false));
    obeys(&mut master, 1);
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(sent(&mut master, ms(0)), [packet_to(1, Stop.encode())]);
    assert_eq!(says(&mut master, 1, Stop.encode(), ms(2)), confirmed(1));
    // It is not spoken to for long, and then is.
    let _ = ask(&mut master, 1, ReadModel, ms(600));
    says(&mut master, 1, *b"\xB5X8S2V10", ms(602)).unwrap();
    let _ = ask(&mut master, 1, ReadModel, ms(610));
    master.hold_again(MotorSet::ALL);
    assert_eq!(sent(&mut master, ms(614)), [], "the answer may come yet");
    assert_eq!(sent(&mut master, ms(615)), [packet_to(1, Stop.encode())]);
}

/// Its program has hung, and goes on with its stream.
#[test]
fn set_points_behind_a_pause_count_as_commands_that_may_not_be_obeyed() {
    let mut master = Master::<2>::new(Config::CAN);
    answers(&mut master, 1..5);
    master.set_point(id(1), torque(1.0), ms(500)).unwrap();
    assert_eq!(sent(&mut master, ms(500)).len(), 1);
    reply(&mut master, 1, TORQUE_REPLY, ms(501)).unwrap();
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(answers_until(&mut master, Stop.encode(), 502, is_confirmed), 2);
}

/// It may be behind that in a mailbox.
#[test]
fn no_hold_goes_again_while_all_are_about_to_be_told_to_lock_their_brakes() {
    let (mut master, now) = loose();
    let _ = ask(&mut master, 2, ReadStatus1, ms(now));
    master.broadcast(LockBrake, MotorSet::from([id(1), id(2)])).unwrap();
    master.hold_again(MotorSet::ALL);
    let held = |packet: &Packet| packet.data == Stop.encode();
    assert!(!sent(&mut master, ms(now)).iter().any(held));
}

#[test]
fn command_to_all_to_let_go_is_not_undone_by_holding_again() {
    let mut master = held();
    let now = unanswered(&mut master, 20, 260);
    answers(&mut master, [now]);
    // It waits for an answer of the other.
    let _ = ask(&mut master, 2, ReadStatus1, ms(301));
    master.broadcast(Shutdown, MotorSet::from([id(1), id(2)])).unwrap();
    master.hold_again(MotorSet::ALL);
    let mut packets = sent(&mut master, ms(302));
    reply(&mut master, 2, STATUS_REPLY, ms(303));
    for now in 304..320 {
        packets.extend(sent(&mut master, ms(now)));
    }
    assert!(packets.contains(&packet_to_all(Shutdown.encode())), "{packets:?}");
    assert!(!packets.contains(&packet_to(1, Stop.encode())), "{packets:?}");
}

/// However short its protection is.
#[test]
fn a_command_that_is_sent_back_shows_that_the_motor_has_let_go() {
    let mut master = held();
    let _ = ask(&mut master, 1, ReadRunTime, ms(130));
    assert_eq!(reply(&mut master, 1, ReadRunTime.encode(), ms(131)), None);
    sent(&mut master, ms(131));
    reply(&mut master, 1, [0xB1, 0, 0, 0, 0x60, 0xEA, 0, 0], ms(132)).unwrap();
    master.hold_again(MotorSet::ALL);
    assert_eq!(sent(&mut master, ms(133)), [packet_to(1, Stop.encode())]);

    let mut master = Master::<2>::new(Config::CAN);
    answers(&mut master, 1..5);
    master.set_point(id(1), torque(1.0), ms(100)).unwrap();
    sent(&mut master, ms(100));
    let ignored = reply(&mut master, 1, torque(1.0).encode(), ms(101));
    assert_eq!(ignored, Some(Event::SetPointUnanswered { motor: id(1) }));
    master.stop(id(1), StopKind::Hold).unwrap();
    assert_eq!(answers_until(&mut master, Stop.encode(), 110, is_confirmed), 3);
}

/// A round of all that are silent may take longer than its protection allows. It is told three times in a row.
#[test]
fn motor_that_may_not_obey_yet_does_not_wait_for_silent_ones_on_a_line() {
    let config =
        Config { reply_timeout: Duration::from_millis(20), ..Config::rs485(115_200, false) };
    let mut master = Master::<32>::new(config);
    let line = |master: &mut Master<32>, data, now| {
        master.handle_line(&Frame { address: Target::Motor(id(1)), data }, ms(now))
    };
    let _ = ask(&mut master, 1, ReadStatus1, ms(1));
    line(&mut master, STATUS_REPLY, 4).unwrap();
    master.stop_all(StopKind::Hold, (1..=20).map(id).collect()).unwrap();
    let (mut told, mut confirmed_at) = (Vec::new(), None);
    for now in 500..1_500 {
        for packet in sent(&mut master, ms(now)) {
            told.push(packet);
            if packet == packet_to(1, Stop.encode())
                && line(&mut master, Stop.encode(), now + 2).is_some_and(|it| is_confirmed(&it))
            {
                confirmed_at = Some(now);
            }
        }
        events(&mut master, ms(now));
    }
    let of_first = |packet: &Packet| *packet == packet_to(1, Stop.encode());
    let (first, last) = (told.iter().position(of_first), told.iter().rposition(of_first));
    // First all that were not known to be silent.
    assert!(first.unwrap() <= 20 && last.unwrap() <= 23, "{first:?} {last:?}");
    assert!(confirmed_at.is_some());
}

/// A full controller or a slow host takes the motor's own stop later than that to all.
#[test]
fn answer_to_a_stop_of_all_behind_a_pause_confirms_nothing() {
    let mut master = Master::<1>::new(Config::CAN);
    answers(&mut master, 1..5);
    master.handle_timeout(ms(200));
    // Without a place for both, one stop goes to all.
    assert!(master.stop_all(StopKind::Hold, [id(1), id(2)].into()).is_err());
    assert_eq!(master.poll_transmit(ms(200)), Some(packet_to_all(Stop.encode())));
    master.handle_transmitted(ms(200));
    assert_eq!(reply(&mut master, 1, Stop.encode(), half_past(200)), None);
    assert_eq!(answers_until(&mut master, Stop.encode(), 201, is_confirmed), 3);
}

/// A drive answers a read of the caller's own twice. No other master has moved anything.
#[test]
fn answer_to_a_raw_read_that_comes_again_does_not_end_the_hold() {
    for again_us in [100, 2_000, 200_000] {
        let mut master = held();
        master.lift_stop();
        let bytes = [0x71, 0, 0, 0, 0, 0, 0, 0];
        let _ = ask(&mut master, 1, RawCommand::new(bytes, ReplyRule::Values, false), ms(12));
        reply(&mut master, 1, [0x71, 7, 0, 0, 0, 0, 0, 0], half_past(12)).unwrap();
        let again = half_past(12) + Duration::from_micros(again_us);
        reply(&mut master, 1, [0x71, 7, 0, 0, 0, 0, 0, 0], again);
        let now = unanswered(&mut master, 250, 260);
        answers(&mut master, [now]);
        master.hold_again(MotorSet::ALL);
        assert_eq!(sent(&mut master, ms(now + 1)), [packet_to(1, Stop.encode())], "{again_us}");
    }
}

#[test]
fn reads_to_all_do_not_keep_a_hold_back() {
    let (mut master, now) = loose();
    master.lift_stop();
    master.broadcast(ReadStatus1, id(1).into()).unwrap();
    master.hold_again(MotorSet::ALL);
    assert!(sent(&mut master, ms(now)).contains(&packet_to(1, Stop.encode())));
}

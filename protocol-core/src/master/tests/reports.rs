//! What motors report unasked.

use super::*;
use crate::command::ReadStatus2;

#[test]
fn active_report_cannot_be_requested_and_answers_no_request() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(0));
    events(&mut master, ms(7));
    let refused = master.request(id(1), ReadMultiTurnAngle).unwrap_err();
    assert_eq!(refused, RequestError::Reported(Opcode::ReadMultiTurnAngle));
    let event = reply(&mut master, 1, ANGLE_REPLY, ms(10)).unwrap();
    assert!(matches!(event, Event::Report { reply: AnyReply::ReadMultiTurnAngle(_), .. }));
    let _off = ask(&mut master, 1, report_angle(Switch::Off), ms(20));
    events(&mut master, ms(27));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn switching_one_report_off_leaves_another_on() {
    let mut master = Master::<2>::new(Config::CAN);
    let command = ReportedCommand::of(Opcode::ReadStatus1).unwrap();
    let status = ActiveReply { command, ..report_angle(Switch::On) };
    for (at, report) in
        [(0, status), (10, report_angle(Switch::On)), (20, report_angle(Switch::Off))]
    {
        let _ = ask(&mut master, 1, report, ms(at));
        events(&mut master, ms(at + 7));
    }
    let refused = master.request(id(1), ReadStatus1).unwrap_err();
    assert_eq!(refused, RequestError::Reported(Opcode::ReadStatus1));
    assert!(master.request(id(1), ReadStatus2).is_ok());
}

#[test]
fn reported_value_can_be_requested_again_after_a_reset() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(0));
    events(&mut master, ms(7));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_err());
    let _ = ask(&mut master, 1, Reset, ms(10));
    events(&mut master, ms(20));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn report_switched_on_for_all_is_known_of_each_motor() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(report_angle(Switch::On), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(100)).len(), 1);
    events(&mut master, ms(150));
    let refused = master.request(id(1), ReadMultiTurnAngle).unwrap_err();
    assert_eq!(refused, RequestError::Reported(Opcode::ReadMultiTurnAngle));
    master.broadcast(Reset, MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(200)).len(), 1);
    events(&mut master, ms(250));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

/// Motor 1 does not answer a read of its status. Returns the event for what it says afterwards, with these flags.
fn late_status(flags: u8) -> Option<Event> {
    let mut master = Master::<2>::new(Config::CAN);
    let read = ask(&mut master, 1, ReadStatus1, ms(0));
    let at = (1..100).map(ms).find(|&at| {
        let _repeats = sent(&mut master, at);
        events(&mut master, at).iter().any(|event| read.outcome(event).is_some())
    });
    reply(&mut master, 1, [0x9A, 50, 40, 0, 0xE0, 1, flags, 0], at.expect("it is given up"))
}

#[test]
fn a_late_reply_with_the_status_is_a_report_if_it_has_errors() {
    assert!(matches!(late_status(0), Some(Event::Stray { .. })));
    let errors = late_status(2);
    assert!(
        matches!(errors, Some(Event::Report { reply: AnyReply::ReadStatus1(_), .. })),
        "{errors:?}"
    );
}

#[test]
fn errors_are_a_report_though_the_status_was_asked_of_other_motors() {
    let errors = [0x9A, 50, 40, 0, 0xE0, 1, 2, 0];
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(ReadStatus1, id(2).into()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    let reported = reply(&mut master, 1, errors, ms(3));
    assert!(matches!(reported, Some(Event::Report { .. })), "{reported:?}");
}

/// No drive answers within 200 us.
#[test]
fn errors_sooner_than_a_motor_can_answer_a_broadcast_are_a_report() {
    let errors = [0x9A, 50, 40, 0, 0xE0, 1, 2, 0];
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.broadcast(ReadStatus1, id(1).into()).unwrap();
    assert_eq!(sent(&mut master, ms(2)).len(), 1);
    let reported = reply(&mut master, 1, errors, ms(2) + Duration::from_micros(200));
    assert!(matches!(reported, Some(Event::Report { .. })), "{reported:?}");
    let answer = reply(&mut master, 1, errors, ms(3));
    assert!(matches!(answer, Some(Event::BroadcastReply { .. })), "{answer:?}");
}

#[test]
fn unrequested_error_status_is_a_report() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    let event = reply(&mut master, 1, [0x9A, 50, 40, 0, 0xE0, 1, 2, 0], ms(1)).unwrap();
    assert!(matches!(event, Event::Report { reply: AnyReply::ReadStatus1(_), .. }));
}

#[test]
fn unrequested_error_status_is_a_report_while_a_late_reply_is_due() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, step(), ms(0));
    events(&mut master, ms(21));
    let event = reply(&mut master, 1, [0x9A, 50, 40, 0, 0xE0, 1, 2, 0], ms(25)).unwrap();
    assert!(matches!(event, Event::Report { reply: AnyReply::ReadStatus1(_), .. }), "{event:?}");
}

#[test]
fn value_can_be_requested_again_once_its_reports_stay_away() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, report_angle(Switch::On), ms(0));
    events(&mut master, ms(7));
    for now in (10..2_000).step_by(10) {
        reply(&mut master, 1, ANGLE_REPLY, ms(now)).unwrap();
        master.handle_timeout(ms(now));
    }
    assert!(master.request(id(1), ReadMultiTurnAngle).is_err());
    master.handle_timeout(ms(3_100));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn seldom_reports_are_missed_after_three_intervals_and_a_second() {
    let mut master = Master::<2>::new(Config::CAN);
    let interval = ReportInterval::from_raw(100); // 1 s
    let _ = ask(&mut master, 1, ActiveReply { interval, ..report_angle(Switch::On) }, ms(0));
    events(&mut master, ms(7));
    reply(&mut master, 1, ANGLE_REPLY, ms(1_000)).unwrap();
    // Three intervals, and the second that a restart takes.
    master.handle_timeout(ms(4_999));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_err());
    master.handle_timeout(ms(5_000));
    assert!(master.request(id(1), ReadMultiTurnAngle).is_ok());
}

#[test]
fn frame_of_an_unknown_motor_is_a_report_if_it_can_be_one() {
    let mut master = Master::<2>::new(Config::CAN);
    let angle = reply(&mut master, 1, ANGLE_REPLY, ms(0)).unwrap();
    assert!(matches!(angle, Event::Report { .. }), "{angle:?}");
    let gain = reply(&mut master, 1, [0x30, 4, 0, 0, 0, 0, 0x80, 0x3F], ms(1)).unwrap();
    assert!(matches!(gain, Event::Stray { .. }), "{gain:?}");
}

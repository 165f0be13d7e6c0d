//! Motors that are spoken to seldom: a slow loop, a slow adapter, a program that hangs.

use super::*;

/// A loop looks every 160 ms, and sends one frame then. The motor answers each of these sendings this long after it, or
/// its answer is lost. Returns how often it was sent something until the first event, and that event.
fn until_reported(
    master: &mut Master<2>,
    from: u64,
    answers_after: impl Fn(usize) -> Option<Duration>,
) -> (usize, Event) {
    for (sendings, now) in (from..from + 60_000).step_by(160).map(ms).enumerate() {
        if let [event] = events(master, now)[..] {
            return (sendings, event);
        }
        let packet = master.poll_transmit(now).expect("it is to be sent");
        master.handle_transmitted(now);
        let answer = answers_after(sendings + 1);
        if let Some(event) = answer.and_then(|it| reply(master, 1, packet.data, now + it)) {
            return (sendings + 1, event);
        }
    }
    panic!("it is sent for ever")
}

const SOON: Option<Duration> = Some(Duration::from_micros(700));

/// After each such pause its drive may have lost its master.
#[test]
fn hold_with_a_pause_before_each_sending_is_given_up() {
    let mut master = Master::new(Config::CAN);
    answers(&mut master, [1, 3, 5]);
    master.stop(id(1), StopKind::Hold).unwrap();
    let reported = until_reported(&mut master, 200, |_| SOON);
    assert_eq!(reported, (15, Event::StopUnconfirmed { motor: id(1) }));
}

/// It was silent until its stop was given up. It is told three times in a row, and not once every 100 ms.
#[test]
fn motor_that_is_back_is_told_to_hold_until_it_obeys_for_sure() {
    let mut master = Master::<2>::new(Config::CAN);
    master.stop(id(1), StopKind::Hold).unwrap();
    let mut now = is_given_up(&mut master, 1, 0);
    while sent(&mut master, ms(now)).is_empty() {
        now += 1;
    }
    for answer in 1..=3 {
        let event = reply(&mut master, 1, Stop.encode(), ms(now + answer));
        assert_eq!(event, confirmed(1).filter(|_| answer == 3), "{answer}");
        assert_eq!(sent(&mut master, ms(now + answer)).len(), usize::from(answer < 3));
    }
}

/// An adapter that keeps each answer for 160 ms.
#[test]
fn request_to_hold_behind_a_slow_adapter_fails_in_the_end() {
    let slow = Config { reply_timeout: Duration::from_millis(300), ..Config::CAN };
    let mut master = Master::new(slow);
    let hold = master.request_with(id(1), Stop, Patience { attempts: 1, ..once(300) }).unwrap();
    let (sendings, failed) = until_reported(&mut master, 0, |_| Some(Duration::from_millis(160)));
    assert_eq!(sendings, 15, "as often as a stop");
    assert_eq!(hold.outcome(&failed), Some(Err(Failure::NotExecuted)));
}

/// Each second, third, fourth or seventh answer is lost.
#[test]
fn request_to_hold_ends_though_answers_are_lost_between() {
    for lost in [2, 3, 4, 7] {
        let mut master = Master::<2>::new(Config::CAN);
        let hold = master.request_with(id(1), Stop, Patience { attempts: 5, ..once(20) }).unwrap();
        let answers = |sending: usize| SOON.filter(|_| sending % lost > 0);
        let (sendings, ended) = until_reported(&mut master, 0, answers);
        assert!(sendings <= 16, "{lost}: {sendings}");
        let ended = hold.outcome(&ended);
        assert!(matches!(ended, Some(Err(_))), "{lost}: {ended:?}");
    }
}

/// The first answer came after 20 ms, all others come after 200 ms.
#[test]
fn mean_round_trip_follows_a_link_that_has_become_slow() {
    let slow =
        Config { reply_timeout: Duration::from_millis(400), ..Config::rs485(115_200, false) };
    let mut master = Master::<2>::new(slow);
    let mut now = 0;
    for takes in core::iter::once(20).chain([200; 30]) {
        let _ = ask(&mut master, 1, ReadStatus1, ms(now));
        now += takes;
        says(&mut master, 1, STATUS_REPLY, ms(now)).unwrap();
        now += 2;
    }
    assert_eq!(master.health(id(1)).round_trip, Duration::from_millis(150));
}

/// Its drive may have lost its master in the pause. A read of all ends the pause, and shows no more than any other.
#[test]
fn read_of_all_does_not_hide_the_pause_before_it() {
    for pause in [200, 450, 1_000, 3_600_000] {
        let mut master = Master::<2>::new(Config::CAN);
        answers(&mut master, [1, 3, 5]);
        let now = 5 + pause;
        master.broadcast(ReadStatus1, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        reply(&mut master, 1, STATUS_REPLY, ms(now + 1)).unwrap();
        assert_eq!(events(&mut master, ms(now + 2)).len(), 1, "it is over");
        master.stop(id(1), StopKind::Hold).unwrap();
        assert_eq!(sent(&mut master, ms(now + 4)).len(), 1);
        assert_eq!(reply(&mut master, 1, Stop.encode(), ms(now + 5)), None, "{pause}");
    }
}

/// The answer to a read lies in the adapter while the program hangs. How long it lay there says nothing about how long
/// the turns of the line take.
#[test]
fn program_that_has_hung_is_a_pause_on_a_line() {
    for (motors, hung_for) in [(6, 300), (8, 450)] {
        let mut master = Master::<8>::new(Config::rs485(1_000_000, false));
        let mut now = 0;
        for motor in (1..=motors).cycle().take(50) {
            let _ = ask(&mut master, motor, ReadStatus1, ms(now));
            says(&mut master, motor, STATUS_REPLY, ms(now + 1)).unwrap();
            now += 2;
        }
        let _ = master.request_with(id(1), ReadStatus1, once(3_000)).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        now += hung_for;
        says(&mut master, 1, STATUS_REPLY, ms(now)).unwrap();
        master.stop(id(1), StopKind::Hold).unwrap();
        for answer in 1..=3 {
            assert_eq!(sent(&mut master, ms(now + 2 * answer)).len(), 1);
            let event = says(&mut master, 1, Stop.encode(), ms(now + 2 * answer + 1));
            assert_eq!(event, confirmed(1).filter(|_| answer == 3), "{motors} {answer}");
        }
    }
}

//! Motors that are spoken to seldom: a slow loop, a slow adapter, a program that hangs.

use super::*;

const STATUS_REPLY: Data = [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0];

/// A loop sends one frame at each of its looks, and the motor answers each this long after it. Returns how often it was
/// sent something until the first event, and that event.
fn until_reported(
    master: &mut Master<2>,
    from: u64,
    look_every: usize,
    answers_after: Duration,
) -> (usize, Event) {
    for (sendings, now) in (from..from + 60_000).step_by(look_every).map(ms).enumerate() {
        if let [event] = events(master, now)[..] {
            return (sendings, event);
        }
        let packet = master.poll_transmit(now).expect("it is to be sent");
        master.handle_transmitted(now);
        if let Some(event) = reply(master, 1, packet.data, now + answers_after) {
            return (sendings + 1, event);
        }
    }
    panic!("it is sent for ever")
}

/// Motor 1 is asked at these times, and answers a millisecond later.
fn answers<const N: usize>(master: &mut Master<N>, times: impl IntoIterator<Item = u64>) {
    for now in times {
        let _ = ask(master, 1, ReadStatus1, ms(now));
        reply(master, 1, STATUS_REPLY, ms(now + 1)).unwrap();
    }
}

/// A loop that gets to each motor every 160 ms. After each such pause its drive may have lost its master.
#[test]
fn hold_with_a_pause_before_each_sending_is_given_up() {
    let mut master = Master::new(Config::CAN);
    answers(&mut master, [1, 3, 5]);
    master.stop(id(1), StopKind::Hold).unwrap();
    let reported = until_reported(&mut master, 200, 160, Duration::from_micros(700));
    assert_eq!(reported, (15, Event::StopUnconfirmed { motor: id(1) }));
}

/// An adapter that keeps each answer for 160 ms.
#[test]
fn request_to_hold_behind_a_slow_adapter_fails_in_the_end() {
    let slow = Config { reply_timeout: Duration::from_millis(300), ..Config::CAN };
    let mut master = Master::new(slow);
    let hold = master.request_with(id(1), Stop, Patience { attempts: 1, ..once(300) }).unwrap();
    let (sendings, failed) = until_reported(&mut master, 0, 160, Duration::from_millis(160));
    assert_eq!(sendings, 15, "as often as a stop");
    assert_eq!(hold.outcome(&failed), Some(Err(Failure::NotExecuted)));
}

#[test]
fn motor_that_answers_commands_to_all_is_spoken_to_steadily() {
    let mut master = Master::<1>::new(Config::CAN);
    answers(&mut master, [1, 3, 5]);
    for now in (10..400).step_by(10) {
        master.broadcast(ReadStatus1, id(1).into()).unwrap();
        assert_eq!(sent(&mut master, ms(now)).len(), 1);
        let answer = reply(&mut master, 1, STATUS_REPLY, ms(now + 1));
        assert!(matches!(answer, Some(Event::BroadcastReply { .. })), "{answer:?}");
        assert_eq!(events(&mut master, ms(now + 2)).len(), 1, "it is over");
    }
    // There is no place for the second: so one stop goes to all, too.
    assert!(master.stop_all(StopKind::Hold, [id(1), id(2)].into()).is_err());
    assert_eq!(sent(&mut master, ms(400)).len(), 2);
    assert_eq!(reply(&mut master, 1, Stop.encode(), ms(401)), confirmed(1));
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

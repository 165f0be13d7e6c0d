//! Drives that were not spoken to for a while answer the first two commands and do not obey (2.31.1).

use super::*;
use crate::id::Target;

const STATUS_REPLY: Data = [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0];

/// Motor 1 is asked at these times, and answers half a millisecond later.
fn answers<const N: usize>(master: &mut Master<N>, times: impl IntoIterator<Item = u64>) {
    for now in times {
        let read = ask(master, 1, ReadStatus1, ms(now));
        let event = reply(master, 1, STATUS_REPLY, half_past(now)).unwrap();
        assert!(read.outcome(&event).is_some_and(|outcome| outcome.is_ok()));
    }
}

fn half_past(now: u64) -> Instant {
    ms(now) + Duration::from_micros(500)
}

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
    assert_eq!(events(master, ms(from + millis)).len(), 1, "it has failed");
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

/// Its drive lets go in the silence, and holds nothing from then on, whatever it has confirmed before.
#[test]
fn motor_is_told_again_to_hold_when_it_is_heard_after_a_silence() {
    type End = fn(&mut Master<2>) -> Option<Data>;
    let command = |master: &mut Master<2>, command: Data| {
        assert_eq!(sent(master, ms(12)), [packet_to(1, command)]);
        reply(master, 1, command, half_past(12)).unwrap();
    };
    let ends: [(StopKind, End, bool); 5] = [
        (StopKind::Hold, |_| None, true),
        (
            StopKind::Hold,
            |master| {
                master.lift_stop();
                None
            },
            false,
        ),
        (StopKind::Off, |_| None, false),
        (
            StopKind::Hold,
            |master| {
                let _ = master.request(id(1), Shutdown).unwrap();
                Some(Shutdown.encode())
            },
            false,
        ),
        (
            StopKind::Hold,
            |master| {
                let _ = master.request(id(1), LockBrake).unwrap();
                Some(LockBrake.encode())
            },
            true,
        ),
    ];
    let silences: [Story; 3] = [|_| 154, |_| 200, |master| unanswered(master, 20, 150)];
    for (number, (kind, end, goes_again)) in ends.into_iter().enumerate() {
        for (silence, is_one) in silences.into_iter().zip([false, true, true]) {
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
            if goes_again && is_one {
                let answers = answers_until(&mut master, stop, now + 1, is_confirmed);
                assert_eq!(answers, 2, "{number}");
                master.hold_again(MotorSet::ALL);
            }
            assert_eq!(sent(&mut master, ms(now + 5)), [], "{number}");
        }
    }
}

/// On a line each motor waits for all others, each of which may take 30 ms.
#[test]
fn pause_is_longer_on_a_line_with_many_motors() {
    let answer = |master: &mut Master<8>, motor, command, data, now| {
        assert_eq!(sent(master, ms(now)), [packet_to(motor, command)]);
        master.handle_line(&Frame { address: Target::Motor(id(motor)), data }, ms(now + 3))
    };
    let config =
        Config { reply_timeout: Duration::from_millis(30), ..Config::rs485(115_200, false) };
    for (motors, pause, expected) in [(1, 150, 1), (1, 151, 3), (6, 180, 1), (6, 181, 3)] {
        let mut master = Master::<8>::new(config);
        for motor in (1..=motors).rev() {
            let now = 10 * u64::from(motors + 1 - motor);
            let _ = master.request(id(motor), ReadStatus1).unwrap();
            let read = answer(&mut master, motor, ReadStatus1.encode(), STATUS_REPLY, now);
            assert!(read.is_some());
        }
        let asked_at = 10 * u64::from(motors);
        let _ = master.request(id(1), Stop).unwrap();
        let held = (1..10).find(|answers| {
            let now = asked_at + pause + 10 * (answers - 1);
            answer(&mut master, 1, Stop.encode(), Stop.encode(), now).is_some()
        });
        assert_eq!(held, Some(expected), "{motors} motors, {pause} ms");
    }
}

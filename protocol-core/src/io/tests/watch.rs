//! A watch over motors that a control loop moves.

use std::vec::Vec;

use super::*;
use crate::command::{ErrorFlags, ReadModel, ReadStatus1};
use crate::data::Data;
use crate::io::{Trouble, Watch};
use crate::master::{Config, Event, Master, MotorSet, Patience};
use crate::opcode::LOST_MASTER_BYTE;
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::wire::can::Received;

/// 25 °C, 48.5 V; the second has stalled.
const HEALTHY: Data = [0x9A, 25, 25, 0, 0xE5, 0x01, 0, 0];
const STALLED: Data = [0x9A, 25, 25, 0, 0xE5, 0x01, 0x02, 0];
const RUN_FOR_70_S: Data = [0xB1, 0, 0, 0, 0x70, 0x11, 0x01, 0];

/// A watch over motors 1 and 2, of which nothing is heard unless it is said here.
struct Bench {
    master: Master<3>,
    watch: Watch,
}

impl Bench {
    fn new() -> Self {
        let watch = Watch::new(MotorSet::from(id(1)).with(id(2).into()), ms(0));
        Self { master: Master::new(Config::CAN), watch }
    }

    fn look(&mut self, now: Instant) -> Result<(), Trouble> {
        self.watch.look(&mut self.master, now)
    }

    /// All that is to be sent: to which motor, and the command byte.
    fn sent(&mut self, now: Instant) -> Vec<(u8, u8)> {
        self.master.handle_timeout(now);
        let mut sent = Vec::new();
        while let Some(packet) = self.master.poll_transmit(now) {
            self.master.handle_transmitted(now);
            let Channel::Command(crate::Target::Motor(motor)) = packet.channel else { continue };
            sent.push((motor.get(), packet.data[0]));
        }
        sent
    }

    /// A motor says this, and what comes of it is noted.
    fn hear(&mut self, motor: u8, data: Data, now: Instant) {
        let packet = Packet { channel: Channel::Reply(id(motor)), data };
        let event = self.master.handle_frame(&Received::Packet(packet), now);
        let more = core::iter::from_fn(|| self.master.poll_event());
        let events: Vec<Event> = event.into_iter().chain(more).collect();
        events.iter().for_each(|event| self.watch.note(event));
    }

    /// A look, then a set-point to each motor, with feedback. So many questions are answered.
    fn cycle(&mut self, now: u64, answers: &mut u8) -> Result<(), Trouble> {
        let looked = self.look(ms(now));
        for motor in [1, 2] {
            self.master.set_point(id(motor), torque(), ms(now)).unwrap();
        }
        for at in [now, now + 2] {
            for (motor, byte) in self.sent(ms(at)) {
                let reply = match (byte, *answers) {
                    (0xA1, _) => [0xA1, 25, 0, 0, 0, 0, 0, 0],
                    (_, 0) => continue,
                    (0x9A, _) => HEALTHY,
                    _ => RUN_FOR_70_S,
                };
                *answers -= u8::from(byte != 0xA1);
                self.hear(motor, reply, ms(at + 1));
            }
        }
        looked
    }

    /// A motor gets a set-point, and gives feedback a millisecond later.
    fn moves(&mut self, motor: u8, now: Instant) {
        self.master.set_point(id(motor), torque(), now).unwrap();
        self.sent(now);
        self.hear(motor, [0xA1, 25, 0, 0, 0, 0, 0, 0], now + Duration::from_millis(1));
    }
}

fn ms(millis: u64) -> Instant {
    Instant::from_millis(millis)
}

#[test]
fn watch_asks_each_motor_for_errors_and_then_for_run_time() {
    let mut bench = Bench::new();
    let mut sent = Vec::new();
    for now in 0..50 {
        bench.look(ms(now)).unwrap();
        for (motor, byte) in bench.sent(ms(now)) {
            sent.push((now, motor, byte));
            bench.hear(motor, if byte == 0x9A { HEALTHY } else { RUN_FOR_70_S }, ms(now + 1));
        }
    }
    let expected = [(0, 1, 0x9A), (10, 2, 0x9A), (20, 1, 0xB1), (30, 2, 0xB1), (40, 1, 0x9A)];
    assert_eq!(sent, expected);
}

/// However many they are.
#[test]
fn watch_asks_each_of_three_motors_both_questions_before_any_again() {
    let watch = Watch::new([id(1), id(2), id(3)].into(), ms(0));
    let mut bench = Bench { watch, ..Bench::new() };
    let mut asked = Vec::new();
    for now in 0..70 {
        bench.look(ms(now)).unwrap();
        for (motor, byte) in bench.sent(ms(now)) {
            asked.push((motor, byte));
            bench.hear(motor, if byte == 0x9A { HEALTHY } else { RUN_FOR_70_S }, ms(now + 1));
        }
    }
    let expected = [(1, 0x9A), (2, 0x9A), (3, 0x9A), (1, 0xB1), (2, 0xB1), (3, 0xB1), (1, 0x9A)];
    assert_eq!(asked, expected);
}

/// An adapter may keep each answer for longer than the time between two questions.
#[test]
fn watch_asks_one_question_at_a_time_and_leaves_none_out() {
    let mut bench = Bench::new();
    let mut sent = Vec::new();
    let mut answer = None;
    for now in 0..80 {
        if let Some((motor, data, 0)) = answer {
            bench.hear(motor, data, ms(now));
        }
        answer = answer.map(|(motor, data, wait)| (motor, data, wait - 1)).filter(|it| it.2 >= 0);
        bench.look(ms(now)).unwrap();
        for (motor, byte) in bench.sent(ms(now)) {
            sent.push((now, motor, byte));
            answer = Some((motor, if byte == 0x9A { HEALTHY } else { RUN_FOR_70_S }, 15));
        }
    }
    let expected = [(0, 1, 0x9A), (16, 2, 0x9A), (32, 1, 0xB1), (48, 2, 0xB1), (64, 1, 0x9A)];
    assert_eq!(sent, expected);
}

#[test]
fn busy_motor_is_asked_as_soon_as_it_is_free() {
    let mut bench = Bench::new();
    let model = bench.master.request(id(1), ReadModel).unwrap();
    bench.look(ms(0)).unwrap();
    bench.look(ms(10)).unwrap();
    assert_eq!(bench.sent(ms(10)), [(1, 0xB5)]);
    // What another says is no answer of this one.
    bench.hear(2, HEALTHY, ms(10));
    bench.hear(1, [0xB5, b'X', b'8', b'S', b'2', b'V', b'1', b'0'], ms(11));
    bench.look(ms(11)).unwrap();
    assert_eq!(bench.sent(ms(11)), [(1, 0x9A)]);
    bench.hear(1, HEALTHY, ms(12));
    bench.look(ms(20)).unwrap();
    assert_eq!(bench.sent(ms(20)), []);
    bench.look(ms(21)).unwrap();
    assert_eq!(bench.sent(ms(21)), [(2, 0x9A)], "{model:?}");
}

/// A question is put every 10 ms from 0 on; the fourth is that for the run time of motor 2.
#[test]
fn missing_answer_is_reported_after_1_s() {
    for (answered, motor, until) in [(0, 1, 1_000), (3, 2, 1_030), (4, 1, 1_040)] {
        let (mut bench, mut answers) = (Bench::new(), answered);
        (0..=until).step_by(10).for_each(|now| bench.cycle(now, &mut answers).unwrap());
        let unanswered = Err(Trouble::Unanswered(id(motor)));
        assert_eq!(bench.cycle(until + 10, &mut answers), unanswered, "{answered}");
    }
}

#[test]
fn late_answer_leaves_a_whole_second_for_the_next() {
    let (mut bench, mut answers) = (Bench::new(), 0);
    (0..900).step_by(10).for_each(|now| bench.cycle(now, &mut answers).unwrap());
    answers = 1;
    (900..=1_900).step_by(10).for_each(|now| bench.cycle(now, &mut answers).unwrap());
    let outcome = (1_910..=2_000).step_by(10).try_for_each(|now| bench.cycle(now, &mut answers));
    assert_eq!((outcome, answers), (Err(Trouble::Unanswered(id(2))), 0));
}

#[test]
fn error_is_reported_whether_or_not_the_watch_asked() {
    let stalled = Err(Trouble::Errors { motor: id(1), errors: ErrorFlags::STALL });
    for (asks_by_itself, is_asked) in [(true, true), (false, true), (false, false)] {
        let mut bench = Bench::new();
        if asks_by_itself {
            bench.look(ms(0)).unwrap();
        } else if is_asked {
            let _ = bench.master.request(id(1), ReadStatus1).unwrap();
        }
        bench.sent(ms(0));
        bench.hear(1, STALLED, ms(1));
        assert_eq!(bench.look(ms(2)), stalled, "{asks_by_itself} {is_asked}");
        assert_eq!(bench.look(ms(2)), Ok(()), "once");
    }
}

#[test]
fn a_status_without_an_error_and_errors_of_others_are_no_trouble() {
    let mut bench = Bench::new();
    bench.hear(1, HEALTHY, ms(1));
    bench.hear(3, STALLED, ms(1));
    bench.hear(3, lost_master(), ms(1));
    assert_eq!(bench.look(ms(2)), Ok(()));
}

/// HEALTHY says that the brake is locked.
#[test]
fn locked_brake_is_reported_where_it_has_to_be_open() {
    let (mut released, mut stalled) = (HEALTHY, STALLED);
    (released[3], stalled[3]) = (1, 0);
    let locked = Err(Trouble::BrakeLocked(id(1)));
    let error = Err(Trouble::Errors { motor: id(1), errors: ErrorFlags::STALL });
    for (motor, data, expected) in
        [(1, HEALTHY, locked), (1, released, Ok(())), (1, stalled, error), (2, HEALTHY, Ok(()))]
    {
        let mut bench = Bench::new();
        bench.watch = bench.watch.open_brakes(id(1).into()).anew(ms(0));
        bench.hear(motor, data, ms(1));
        assert_eq!(bench.look(ms(2)), expected, "{motor} {data:?}");
    }
    // That it has restarted is worse: its turns may be lost.
    let mut bench = Bench::new();
    bench.watch = bench.watch.open_brakes(id(1).into());
    bench.hear(1, HEALTHY, ms(1));
    bench.master.note_restart(id(1));
    assert_eq!(bench.look(ms(2)), Err(Trouble::Restarted(id(1))));
}

#[test]
fn error_in_the_answer_to_a_broadcast_is_reported() {
    let mut bench = Bench::new();
    bench.master.broadcast(ReadStatus1, id(1).into()).unwrap();
    bench.sent(ms(0));
    bench.hear(1, STALLED, ms(1));
    let stalled = Trouble::Errors { motor: id(1), errors: ErrorFlags::STALL };
    assert_eq!(bench.look(ms(2)), Err(stalled));
}

/// 0xF1 and zeros, as a drive says it by itself.
fn lost_master() -> Data {
    [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0]
}

/// The motor's output is cut, and its brake locked.
#[test]
fn master_lost_before_the_watch_is_reported_until_the_motor_obeys() {
    let mut bench = Bench::new();
    bench.hear(2, HEALTHY, ms(0));
    bench.hear(2, lost_master(), ms(1));
    bench.watch = Watch::new(id(2).into(), ms(2));
    for _ in 0..2 {
        assert_eq!(bench.look(ms(2)), Err(Trouble::LostMaster(id(2))));
    }
    bench.moves(2, ms(3));
    assert_eq!(bench.look(ms(5)), Ok(()));
}

#[test]
fn first_noted_trouble_is_reported() {
    let mut bench = Bench::new();
    bench.hear(2, lost_master(), ms(1));
    bench.hear(1, STALLED, ms(1));
    assert_eq!(bench.look(ms(2)), Err(Trouble::LostMaster(id(2))));
}

#[test]
fn motor_without_feedback_for_over_100_ms_is_silent() {
    let mut bench = Bench::new();
    for now in (0..=100).step_by(20) {
        bench.moves(1, ms(now));
        bench.look(ms(now)).unwrap();
    }
    // Motor 2 has never given any. Answers to questions are none.
    bench.hear(2, HEALTHY, ms(100));
    assert_eq!(bench.look(ms(101)), Err(Trouble::Silent(id(2))));

    let mut bench = Bench::new();
    bench.moves(1, ms(10));
    bench.moves(2, ms(50));
    bench.look(ms(60)).unwrap();
    bench.look(ms(111)).unwrap();
    assert_eq!(bench.look(ms(112)), Err(Trouble::Silent(id(1))), "100 ms after 11 ms");
}

/// The motor may have been in another loop.
#[test]
fn old_feedback_from_before_the_watch_is_no_silence() {
    let mut bench = Bench::new();
    bench.moves(1, ms(0));
    bench.watch = Watch::new(id(1).into(), ms(500));
    bench.look(ms(600)).unwrap();
    assert_eq!(bench.look(ms(601)), Err(Trouble::Silent(id(1))));
}

/// Its cable is off. It has not restarted, as far as is known.
#[test]
fn motor_that_is_cut_off_is_silent_from_the_first_look_on() {
    let mut bench = Bench::new();
    bench.moves(1, ms(0));
    for now in [2_000, 2_100, 2_200, 2_300].map(ms) {
        let once = Patience { attempts: 1, reply_timeout: Duration::from_millis(20) };
        let _ = bench.master.request_with(id(1), ReadModel, once);
        bench.sent(now);
        bench.master.handle_timeout(now + once.reply_timeout);
        while bench.master.poll_event().is_some() {}
    }
    assert!(bench.master.has_restarted(id(1)), "it may have");
    bench.watch = bench.watch.anew(ms(2_400));
    assert_eq!(bench.look(ms(2_400)), Err(Trouble::Silent(id(1))));
}

#[test]
fn restart_is_reported_until_the_motor_is_resumed() {
    let mut bench = Bench::new();
    bench.moves(1, ms(0));
    bench.master.note_restart(id(1));
    for _ in 0..2 {
        assert_eq!(bench.look(ms(2)), Err(Trouble::Restarted(id(1))));
    }
    bench.master.resume(id(1));
    assert_eq!(bench.look(ms(2)), Ok(()));
}

#[test]
fn a_loop_that_was_held_up_for_longer_than_100_ms_is_late() {
    let mut bench = Bench::new();
    assert_eq!(bench.look(ms(100)), Ok(()));
    bench.moves(1, ms(200));
    bench.moves(2, ms(200));
    assert_eq!(bench.look(ms(201)), Err(Trouble::Late(Duration::from_millis(101))));
    assert_eq!(bench.look(ms(202)), Ok(()), "once");
}

#[test]
fn watch_keeps_the_silence_and_the_interval_of_its_caller() {
    let mut bench = Bench::new();
    let time = Duration::from_millis;
    bench.watch = bench.watch.clone().longest_silence(time(300)).ask_every(time(25));
    assert_eq!(bench.look(ms(0)), Ok(()));
    assert_eq!(bench.sent(ms(0)), [(1, 0x9A)]);
    bench.hear(1, HEALTHY, ms(1));
    bench.look(ms(24)).unwrap();
    assert_eq!(bench.sent(ms(24)), []);
    bench.look(ms(25)).unwrap();
    assert_eq!(bench.sent(ms(25)), [(2, 0x9A)]);
    assert_eq!(bench.look(ms(300)), Ok(()));
    assert_eq!(bench.look(ms(301)), Err(Trouble::Silent(id(1))));
}

#[test]
fn watch_over_no_motor_asks_nothing() {
    let mut bench = Bench::new();
    bench.watch = Watch::new(MotorSet::EMPTY, ms(0));
    assert_eq!(bench.look(ms(50)), Ok(()));
    assert_eq!(bench.sent(ms(50)), []);
}

#[test]
fn a_watch_says_until_when_its_loop_has_to_look_and_begins_anew_as_it_was() {
    let limits = (Duration::from_millis(30), Duration::from_millis(7));
    let mut bench = Bench::new();
    bench.watch = bench.watch.longest_silence(limits.0).ask_every(limits.1);
    assert_eq!(bench.watch.late_after(), ms(30));
    assert_eq!(bench.look(ms(20)), Ok(()));
    assert_eq!(bench.watch.late_after(), ms(50));
    assert_eq!(bench.look(ms(51)), Err(Trouble::Late(Duration::from_millis(31))));
    // Both motors were silent for too long then, if it had not begun anew.
    bench = Bench { master: Master::new(Config::CAN), watch: bench.watch.anew(ms(205)) };
    assert_eq!(bench.watch.late_after(), ms(235));
    // The next question is due 7 ms after the last.
    assert_eq!(bench.look(ms(210)), Ok(()));
    assert_eq!(bench.sent(ms(210)), [(1, 0x9A)]);
    bench.hear(1, HEALTHY, ms(211));
    assert_eq!(bench.look(ms(216)), Ok(()));
    assert_eq!(bench.sent(ms(216)), []);
    assert_eq!(bench.look(ms(217)), Ok(()));
    assert_eq!(bench.sent(ms(217)), [(2, 0x9A)]);
}

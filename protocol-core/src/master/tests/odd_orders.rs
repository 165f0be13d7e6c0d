//! What callers and controllers do seldom: calls that meet something on its way, frames handed back late,
//! a bus that was cut, patience of a caller's own.

use super::*;
use crate::command::ReadStatus2;

#[test]
fn another_command_to_all_that_was_pushed_out_is_not_the_one_in_flight() {
    let mut master = Master::<2>::new(Config::CAN);
    master.broadcast(ReadMultiTurnAngle, MotorSet::EMPTY).unwrap();
    let earlier = sent(&mut master, ms(0))[0];
    events(&mut master, ms(0));
    master.broadcast(step(), MotorSet::EMPTY).unwrap();
    assert_eq!(sent(&mut master, ms(1)), [packet_to_all(step().encode())]);
    master.handle_pushed_out(&earlier);
    assert_eq!(sent(&mut master, ms(2)), [], "the move would be made twice");
}

#[test]
fn a_command_to_all_that_was_pushed_out_says_nothing_of_the_one_before() {
    let mut master = Master::<2>::new(Config::CAN);
    // Nobody answers it, so that the next one need not wait for answers.
    let raw = RawCommand::new([0x55; 8], ReplyRule::Silent, true);
    master.broadcast(raw, MotorSet::EMPTY).unwrap();
    sent(&mut master, ms(0));
    events(&mut master, ms(0));
    master.broadcast(ReadStatus2, MotorSet::EMPTY).unwrap();
    let second = sent(&mut master, ms(0))[0];
    events(&mut master, ms(0));
    master.handle_pushed_out(&second);
    master.stop(id(1), StopKind::Off).unwrap();
    sent(&mut master, ms(1));
    assert_eq!(reply(&mut master, 1, Shutdown.encode(), ms(2)), None);
}

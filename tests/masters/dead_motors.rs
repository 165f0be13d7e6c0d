//! A line with motors that are gone: each command to one occupies it for a whole time-out, and a stop still has to
//! reach the others.

use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_tests::rig::Rig;
use myactuator_tests::values::id;

const MOTORS: u8 = 16;

/// What goes wrong on a line that streams to 16 motors, before all of them are told to hold.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// This many, those with the lowest ids, are cut off.
    dead: u8,
    /// They are cut off for half a second, so that they were missed; otherwise the stop comes at once.
    are_known: bool,
    /// The last motor was switched off by a stop, so that none may go to all: that would switch it on.
    is_one_off: bool,
}

/// The time from the stop to the last first stop that one of the others hears.
fn last_first_stop(case: Case) -> Duration {
    let mut rig = Rig::<Rs485Line>::new(MOTORS, 7);
    let streamed = MOTORS - u8::from(case.is_one_off);
    if case.is_one_off {
        assert!(rig.runner.stop(id(MOTORS), StopKind::Off));
    }
    let stream = |rig: &mut Rig<Rs485Line>, rounds| {
        for number in 0..rounds {
            (1..=streamed).for_each(|motor| rig.put(id(motor), number).expect("there is a place"));
            rig.run_for(Duration::from_millis(50));
        }
    };
    stream(&mut rig, 6);
    for node in rig.nodes.iter().take(case.dead.into()) {
        rig.world.cut(*node);
    }
    let dead: MotorSet = MotorId::all().take(case.dead.into()).collect();
    if case.are_known {
        stream(&mut rig, 10);
        assert!(dead.iter().all(|motor| rig.runner.master().health(motor).lost > 0), "{case:?}");
    } else {
        (1..=streamed).for_each(|motor| rig.put(id(motor), 9).expect("there is a place"));
    }
    rig.ledger.pages().iter_mut().for_each(|page| page.heard.first_stop = None);
    let start = rig.world.now();
    assert_eq!(rig.runner.stop_all(StopKind::Hold, MotorSet::EMPTY), dead, "{case:?}");
    // A motor that was switched off was told long ago, and is last.
    let is_told = |motor| case.is_one_off && motor == id(MOTORS);
    let living = rig.motors().filter(|&motor| !dead.contains(motor) && !is_told(motor));
    let heard = living.map(|motor| rig.ledger.page(motor).heard.first_stop.expect("it was told"));
    heard.max().expect("some live") - start
}

/// 13 bytes of 10 bits at 1 Mbit/s.
const FRAME: Duration = Duration::from_micros(131);
/// Command and reply, 0.9 ms for the drive and 0.1 ms for it to turn around.
const EXCHANGE: Duration = Duration::from_micros(2 * 131 + 900 + 100);
/// Command and no reply: 5 ms and two frames.
const SILENCE: Duration = Duration::from_micros(131 + 5_262 + 100);

#[test]
fn a_stop_of_all_reaches_every_living_motor_before_any_dead_one_is_waited_for() {
    // The exchange in flight ends, and then one stop goes to all.
    let bound = SILENCE + FRAME;
    for dead in [0, 8, 12] {
        for are_known in [true, false] {
            let case = Case { dead, are_known, is_one_off: false };
            let took = last_first_stop(case);
            assert!(took <= bound, "{case:?}: {took}");
        }
    }
}

#[test]
fn where_no_stop_may_go_to_all_the_living_that_are_known_to_be_come_first() {
    for dead in [0, 8, 12] {
        let living = SILENCE + EXCHANGE.times(u32::from(MOTORS - dead));
        let case = Case { dead, are_known: true, is_one_off: true };
        let took = last_first_stop(case);
        assert!(took <= living, "{case:?}: {took}");
        // It is not known yet which motors have just died: each is waited for once.
        let case = Case { dead, are_known: false, is_one_off: true };
        let took = last_first_stop(case);
        assert!(took <= living + SILENCE.times(u32::from(dead)), "{case:?}: {took}");
    }
}

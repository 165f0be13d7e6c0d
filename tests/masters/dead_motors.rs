//! A line with dead motors. Each command to one occupies the line for a whole time-out. A stop must reach the other
//! motors nevertheless.

use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::Duration;
use myactuator_tests::rig::Rig;
use myactuator_tests::values::id;

const MOTORS: u8 = 16;

/// What goes wrong on a line with streams to 16 motors, before a stop holds all of them.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// This many motors, those with the lowest ids, are cut off.
    dead: u8,
    /// The stop comes half a second after the cut, when the master has noticed it. Otherwise the stop comes at once.
    are_known: bool,
    /// A stop has switched the last motor off. So no hold may go to all: it would switch that motor on.
    is_one_off: bool,
}

/// The time from the stop until the last of the living motors hears its first stop.
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
    // The motor that was switched off had its stop long ago, and comes last.
    let is_told = |motor| case.is_one_off && motor == id(MOTORS);
    let living = rig.motors().filter(|&motor| !dead.contains(motor) && !is_told(motor));
    let heard = living.map(|motor| rig.ledger.page(motor).heard.first_stop.expect("it was told"));
    heard.max().expect("some live") - start
}

/// 13 bytes of 10 bits at 1 Mbit/s.
const FRAME: Duration = Duration::from_micros(131);
/// Command and reply, 0.9 ms of response, and 0.1 ms to turn around.
const EXCHANGE: Duration = Duration::from_micros(2 * 131 + 900 + 100);
/// A command without a reply: a time-out of 5 ms and two frames.
const SILENCE: Duration = Duration::from_micros(131 + 5_262 + 100);

#[test]
fn stop_of_all_reaches_living_motors_before_any_dead_one_is_awaited() {
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
fn without_a_stop_to_all_motors_known_to_be_alive_come_first() {
    for dead in [0, 8, 12] {
        let living = SILENCE + EXCHANGE.times(u32::from(MOTORS - dead));
        let case = Case { dead, are_known: true, is_one_off: true };
        let took = last_first_stop(case);
        assert!(took <= living, "{case:?}: {took}");
        // The master does not know yet which motors have just died, so it waits once for each.
        let case = Case { dead, are_known: false, is_one_off: true };
        let took = last_first_stop(case);
        assert!(took <= living + SILENCE.times(u32::from(dead)), "{case:?}: {took}");
    }
}

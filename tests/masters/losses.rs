//! Every loss is counted: the master's health and events agree with what the wire and the drives know, frame by frame.

use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::faults::FaultPlan;
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::ReadStatus1;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Event, Failure, MotorSet, Patience, Presence};
use myactuator_protocol_core::time::Duration;
use myactuator_tests::rig::{Rig, angle};
use myactuator_tests::values::id;
use myactuator_tests::wire::Wire;

#[derive(Clone, Copy, Debug)]
struct Case {
    percent: u32,
    motors: u8,
    attempts: u8,
    /// Whether wires are cut, one drive after another, instead of random losses.
    cuts: bool,
}

/// What the events reported of one motor.
#[derive(Clone, Copy, Debug, Default)]
struct Told {
    replies: u64,
    no_reply: u64,
    feedback: u64,
    unanswered: u64,
    broadcast_replies: u64,
    silent: u64,
}

const ROUNDS: u32 = 300;

fn run<W: Wire>(case: Case) -> Vec<Told> {
    let mut rig = Rig::<W>::new(case.motors, u64::from(case.percent) + u64::from(case.motors));
    rig.shows_no_echo();
    // A first answer that equals its command is asked for again, and not told.
    for motor in rig.motors().skip(1).collect::<Vec<_>>() {
        rig.runner.ask(motor, ReadStatus1).expect("the bus is whole");
    }
    if !case.cuts {
        rig.strike(FaultPlan { lose: case.percent as f32 / 100.0, ..FaultPlan::NONE });
    }
    let mut told = vec![Told::default(); case.motors.into()];
    let patience = Patience { reply_timeout: W::CONFIG.reply_timeout, attempts: case.attempts };
    for round in 0..ROUNDS {
        if case.cuts {
            // `percent` of a hundred rounds without a wire.
            let node = rig.nodes[(round / 100) as usize % rig.nodes.len()];
            if round % 100 == 0 {
                rig.world.cut(node);
            } else if round % 100 == case.percent {
                rig.world.mend(node);
            }
        }
        let now = rig.runner.now();
        let motors: Vec<MotorId> = rig.motors().collect();
        let mut open = motors.len();
        for &motor in &motors {
            let asked = rig.runner.master().request_with(motor, angle(round), patience);
            let _ticket = asked.expect("nothing is under way");
            // A motor that was cut off for a second may have restarted.
            let mut put = rig.put(motor, round + 1);
            if put == Err(RequestError::Restarted) {
                rig.runner.master().resume(motor);
                put = rig.put(motor, round + 1);
            }
            put.expect("there is a place");
        }
        let mut broadcast = W::NAME == "CAN" && round % 4 == 0;
        if broadcast {
            let all: MotorSet = motors.iter().copied().collect();
            rig.runner.master().broadcast(angle(round), all).expect("no other is under way");
        }
        loop {
            let event = rig.runner.poll().expect("the bus works");
            match event {
                Some(Event::Reply { ticket, .. }) => {
                    told[ticket.motor().index()].replies += 1;
                    open -= 1;
                }
                Some(Event::Failed { ticket, failure: Failure::NoReply }) => {
                    told[ticket.motor().index()].no_reply += 1;
                    open -= 1;
                }
                Some(Event::Feedback { motor, .. }) => told[motor.index()].feedback += 1,
                Some(Event::SetPointUnanswered { motor }) => told[motor.index()].unanswered += 1,
                Some(Event::SetPointDropped { .. }) => {}
                Some(Event::BroadcastReply { motor, .. }) => {
                    told[motor.index()].broadcast_replies += 1;
                }
                Some(Event::BroadcastDone { silent, .. }) => {
                    broadcast = false;
                    silent.iter().for_each(|motor| told[motor.index()].silent += 1);
                }
                // A motor that was cut off for a second may have restarted.
                Some(Event::Restarted { motor }) => rig.runner.master().resume(motor),
                Some(other) => panic!("{other:?} in {case:?}"),
                None if open > 0 || broadcast || rig.runner.master().is_anything_in_flight() => {
                    rig.runner.idle(rig.world.now() + Duration::from_secs(1));
                    assert!(rig.world.now() - now < Duration::from_secs(2), "hangs in {case:?}");
                }
                None => break,
            }
        }
    }
    for motor in rig.motors() {
        let (page, told) = (rig.ledger.page(motor), told[motor.index()]);
        let mut health = rig.runner.master().health(motor);
        health.answered -= if motor == MotorId::MIN { Rig::<W>::SHOWN } else { 1 };
        let what = format!("{}: motor {motor} of {case:?}, {told:?}, {health:?}", W::NAME);
        // What really happened: commands on the wire, and replies that reached the master.
        let got_through = page.replied - page.replies_lost;
        let lost_on_the_way = (page.sent.asking - page.heard.asking) + page.replies_lost;
        // If several frames in a row are lost, the bus looks quiet, and feedback that is still pending seems late.
        let late = got_through - u64::from(health.answered);
        let most_late = if case.percent > 0 { got_through / 100 } else { 0 };
        assert!(late <= most_late, "{what}");
        assert_eq!(u64::from(health.lost), page.sent.asking - got_through + late, "{what}");
        if !case.cuts {
            let counted = lost_on_the_way + late;
            assert_eq!(u64::from(health.lost), counted, "{what}");
        }
        let told_answered = told.replies + told.feedback + told.broadcast_replies;
        // An answer that equals its read, as all do here, is asked for again after a pause.
        let asked_again = u64::from(health.answered) + late - told_answered;
        let most_again = got_through * u64::from(case.percent) / 100;
        assert!(asked_again <= most_again, "{asked_again} {what}");
        assert_eq!(health.stray, 0, "{what}");
        let told_lost = told.no_reply + told.unanswered + told.silent;
        if case.attempts == 1 {
            assert_eq!(u64::from(health.lost), told_lost, "{what}");
        } else {
            assert!(u64::from(health.lost) >= told_lost + 2 * told.no_reply, "{what}");
        }
        let replaced = u64::from(ROUNDS) - page.sent.set_points;
        assert_eq!(u64::from(health.superseded), replaced, "{what}");
    }
    told
}

fn run_on_both(case: Case) -> u64 {
    let losses = |told: Vec<Told>| {
        told.iter().map(|told| told.no_reply + told.unanswered + told.silent).sum::<u64>()
    };
    losses(run::<CanBus>(case)) + losses(run::<Rs485Line>(case))
}

#[test]
fn every_lost_frame_is_a_loss_of_its_motor() {
    for attempts in [1, 3] {
        for percent in [0, 1, 10, 50] {
            for motors in [1, 4, 8] {
                let case = Case { percent, motors, attempts, cuts: false };
                let losses = run_on_both(case);
                assert_eq!(losses == 0, percent == 0, "{case:?}");
            }
        }
    }
}

#[test]
fn every_frame_that_a_cut_wire_swallows_is_a_loss() {
    for percent in [0, 1, 10, 50] {
        let case = Case { percent, motors: 4, attempts: 1, cuts: true };
        // At 0 % each wire is cut and never mended.
        assert!(run_on_both(case) > 0, "{case:?}");
    }
}

#[test]
fn a_motor_that_is_not_there_is_late_and_then_silent() {
    let mut rig = Rig::<CanBus>::new(2, 1);
    rig.world.cut(rig.nodes[0]);
    let once = Patience { reply_timeout: Duration::from_millis(5), attempts: 1 };
    let mut presence = Vec::new();
    for token in 0..4 {
        let read = angle(token);
        assert!(rig.runner.ask_with(id(1), read, Some(once), |_| {}).is_err());
        presence.push(rig.runner.master().health(id(1)).presence);
    }
    assert_eq!(presence, [Presence::Late, Presence::Late, Presence::Silent, Presence::Silent]);
    rig.world.mend(rig.nodes[0]);
    assert!(rig.runner.ask(id(1), angle(9)).is_ok());
    assert_eq!(rig.runner.master().health(id(1)).presence, Presence::Present);
}

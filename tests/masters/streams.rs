//! Streams of set-points and the safe stop. An old frame would be dangerous there.

use myactuator_host_std::sim::bus::can::{CanBus, ControllerConfig};
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_host_std::sim::bus::{StationId, World};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::{CanMaster, Clock, Runner};
use myactuator_protocol_core::master::{Config, Event, Failure, MotorSet, Presence, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_tests::rig::{Ledger, Rig, angle, put, step};
use myactuator_tests::values::{id, millis};
use myactuator_tests::wire::Wire;

/// For a second set-points come faster than the bus takes them, over a wire that may be cut now and then.
fn flood<W: Wire>(cuts: bool) {
    let mut rig = Rig::<W>::new(4, 5);
    let (mut number, mut dropped) = (0, 0);
    for step in 0..5_000 {
        number += 1;
        rig.put_all(number);
        if cuts && step % 1_000 == 0 {
            rig.world.cut(rig.port);
        } else if cuts && step % 1_000 == 400 {
            rig.world.mend(rig.port);
        }
        let events = rig.run_for(Duration::from_micros(200));
        dropped +=
            events.iter().filter(|event| matches!(event, Event::SetPointDropped { .. })).count();
    }
    rig.run_for(millis(200));
    assert!(!cuts || W::NAME != "CAN" || dropped > 0, "a dead bus drops set-points");
    for motor in rig.motors() {
        let (page, health) = (rig.ledger.page(motor), rig.runner.master().health(motor));
        let case = format!("{}: motor {motor}, cuts {cuts}, {health:?}", W::NAME);
        assert_eq!((page.sent.stale, page.heard.stale), (0, 0), "{case}");
        assert!(page.sent.set_points > 20, "{case}");
        if !cuts {
            // Each was sent or counted as superseded.
            let superseded = u64::from(health.superseded);
            assert_eq!(page.sent.set_points + superseded, u64::from(number), "{case}");
        }
    }
}

/// `master_truth` checks this under other faults.
#[test]
fn no_set_point_is_sent_after_a_newer_one_however_many_come() {
    for cuts in [false, true] {
        flood::<CanBus>(cuts);
        flood::<Rs485Line>(cuts);
    }
}

/// The controller takes so many frames that the motors would miss too few replies. Frames that it refuses must count,
/// too.
#[test]
fn a_stream_of_any_number_of_motors_sees_that_the_bus_is_cut() {
    for motors in [1, 2, 4, 8, 16] {
        let mut rig = Rig::<CanBus>::new(motors, 3);
        for number in 1..20 {
            rig.put_all(number);
            rig.run_for(millis(5));
        }
        rig.world.cut(rig.port);
        for number in 20..40 {
            rig.put_all(number);
            rig.run_for(millis(5));
        }
        for motor in rig.motors() {
            let presence = rig.runner.master().health(motor).presence;
            assert_eq!(presence, Presence::Silent, "motor {motor} of {motors} after 100 ms");
        }
    }
}

#[test]
fn commands_waiting_on_a_dead_bus_are_dropped_and_never_replayed() {
    let mut rig = Rig::<CanBus>::new(8, 3);
    rig.put_all(1);
    rig.run_for(millis(20));
    // Nothing acknowledges. The stream goes on, and a move and a read are requested.
    rig.world.cut(rig.port);
    let mut events = Vec::new();
    for number in 2..200 {
        rig.put_all(number);
        events.extend(rig.run_for(millis(1)));
    }
    let step = step(77);
    let step = rig.runner.master().request(id(1), step).expect("nothing is under way");
    let read = angle(78);
    let read = rig.runner.master().request(id(2), read).expect("nothing is under way");
    events.extend(rig.run_for(millis(100)));
    let returned = events.iter().find_map(|event| step.outcome(event));
    assert_eq!(returned, Some(Err(Failure::BusDown)), "the move is dropped");
    let returned = events.iter().find_map(|event| read.outcome(event));
    assert_eq!(returned, Some(Err(Failure::BusDown)), "nobody waits for ever");
    for motor in 1..=8 {
        assert!(events.contains(&Event::SetPointDropped { motor: id(motor) }), "motor {motor}");
    }
    let sent = |ledger: &Ledger| -> u64 { ledger.pages().iter().map(|p| p.sent.set_points).sum() };
    let before = sent(&rig.ledger);
    rig.world.mend(rig.port);
    rig.run_for(millis(200));
    let after = sent(&rig.ledger);
    // The controller sends the frames that it had taken, which only its driver could take back. The master adds
    // nothing.
    let queue = ControllerConfig::SOCKETCAN.transmit_queue as u64;
    assert!(after - before <= queue, "{} set-points came after the bus was mended", after - before);
    for motor in rig.motors() {
        let page = rig.ledger.page(motor);
        assert!(page.sent.moves.is_empty(), "the move was sent after all");
        assert!(page.sent.newest < Some(150), "one of the last was kept: {:?}", page.sent.newest);
        assert_eq!(page.sent.stale, 0);
    }
}

/// How often each of eight motors sends feedback in a second of streams at 500 Hz.
fn rates(silent: bool) -> Vec<u64> {
    let mut rig = Rig::<CanBus>::new(8, 9);
    if silent {
        rig.world.cut(rig.nodes[2]);
    }
    let mut feedback = vec![0; 8];
    for number in 1..=500 {
        rig.put_all(number);
        for event in rig.run_for(millis(2)) {
            if let Event::Feedback { motor, .. } = event {
                feedback[motor.index()] += 1;
            }
        }
    }
    feedback
}

#[test]
fn a_silent_motor_among_eight_costs_the_other_seven_hardly_anything() {
    let (all, seven) = (rates(false), rates(true));
    assert_eq!(all, [500; 8]);
    for motor in [0, 1, 3, 4, 5, 6, 7] {
        // On a bus that is full but for a twentieth, the others wait for its answer at every eighth command. One of 160
        // set-points may come too late to be sent.
        assert!(seven[motor] >= 497, "{seven:?}");
    }
    assert_eq!(seven[2], 0);
}

/// After how long the last motor of a full bus of so many sends feedback again, when it was cut off for a while.
fn is_heard_again_at(motors: u8) -> Option<Duration> {
    let mut rig = Rig::<CanBus>::new(motors, 9);
    let last = MotorId::new(motors).expect("an id");
    rig.put_all(1);
    let mended = millis(500);
    let mut number = 1;
    while rig.world.now() - Instant::ZERO < millis(950) {
        let since_start = rig.world.now() - Instant::ZERO;
        if since_start < millis(100) || since_start >= mended {
            rig.world.mend(rig.nodes[last.index()]);
        } else {
            rig.world.cut(rig.nodes[last.index()]);
        }
        let motor = match rig.runner.poll().expect("the bus works") {
            Some(Event::Feedback { motor, .. }) if motor == last && since_start > mended => {
                return Some(rig.world.now() - Instant::ZERO - mended);
            }
            Some(Event::Feedback { motor, .. } | Event::SetPointUnanswered { motor }) => motor,
            Some(other) => panic!("{other:?}"),
            None => {
                rig.runner.idle(rig.world.now() + millis(1));
                continue;
            }
        };
        number += 1;
        rig.put(motor, number).expect("there is a place");
    }
    None
}

/// Its replies lose arbitration to all others, which never leave the bus quiet by themselves.
#[test]
fn the_least_urgent_motor_is_heard_again_on_a_full_bus() {
    for motors in [8, 11, 16, 32] {
        let after = is_heard_again_at(motors).unwrap_or_else(|| panic!("{motors} motors: never"));
        // Eight commands, each of which counts as lost after 20 ms and the turns of the others.
        assert!(after < millis(250), "{motors} motors: after {after}");
    }
}

/// A clock of coarse steps.
struct Stepped<K> {
    clock: K,
    step: Duration,
}

impl<K: Clock> Clock for Stepped<K> {
    fn now(&self) -> Instant {
        let steps = (self.clock.now() - Instant::ZERO).as_micros() / self.step.as_micros();
        Instant::from_micros(steps * self.step.as_micros())
    }

    fn idle(&self, until: Instant) {
        // What it shows becomes `until` with a step.
        let steps = (until - Instant::ZERO).as_micros().div_ceil(self.step.as_micros());
        self.clock.idle(Instant::from_micros(steps * self.step.as_micros()));
    }
}

const FINE: Duration = Duration::from_micros(1);

/// The sum of these rates, if none of them is less than four fifths of their mean.
fn equal(rates: &[f64]) -> Option<f64> {
    let sum = rates.iter().sum::<f64>();
    let least = 0.8 * sum / rates.len() as f64;
    rates.iter().all(|rate| *rate >= least).then_some(sum)
}

/// How often each motor sends feedback in a second on a full bus of this kind, and how much was lost in all: a motor
/// gets its next set-point when it has answered the last, or when that counts as unanswered. The master's clock has
/// such steps.
fn full_bus(
    motors: u8,
    config: Config,
    step: Duration,
    make: impl FnOnce(&World<CanBus>, StationId),
) -> (Vec<f64>, f64) {
    const SECONDS: f64 = 4.0;
    let Rig { world, runner, port, ledger, .. } = Rig::<CanBus>::new(motors, 9);
    let (can, clock) = runner.release();
    let mut runner = CanMaster::<_, _, 32>::new(can, Stepped { clock, step }, config);
    make(&world, port);
    for motor in MotorId::all().take(motors.into()) {
        put(&mut runner, motor, 1).expect("there is a place");
    }
    let end = world.now() + Duration::from_micros((SECONDS * 1e6) as u64);
    let mut feedback = vec![0.0; motors.into()];
    let mut number = 1;
    while world.now() < end {
        let motor = match runner.poll().expect("the bus works") {
            Some(Event::Feedback { motor, .. }) => {
                feedback[motor.index()] += 1.0 / SECONDS;
                motor
            }
            Some(Event::SetPointUnanswered { motor }) => motor,
            Some(other) => panic!("{other:?}"),
            None => {
                runner.idle(end);
                continue;
            }
        };
        number += 1;
        put(&mut runner, motor, number).expect("there is a place");
    }
    let lost: u64 = ledger.pages().iter().map(|page| page.replies_lost).sum();
    (feedback, lost as f64 / SECONDS)
}

/// The others wait for lost feedback no longer once the bus has carried a reply that loses arbitration to it, and go on.
/// Its motor waits for three usual round trips. For the motor of the highest id no reply shows this: the others get two
/// turns ahead of it, and wait until the bus was quiet.
#[test]
fn eight_streams_that_lose_5_percent_get_19_of_21_turns_of_a_full_bus() {
    let loses = |lose| {
        let faults = FaultPlan { lose, ..FaultPlan::NONE };
        full_bus(8, Config::CAN, FINE, |world, _| world.set_faults(Direction::ToPorts, faults))
    };
    let (whole, lost) = loses(0.0);
    assert!(whole.iter().all(|rate| *rate >= 520.0) && lost == 0.0, "{whole:?}");
    let (feedback, lost) = loses(0.05);
    let sum: f64 = feedback.iter().sum();
    assert!(lost >= 0.045 * (sum + lost), "{lost} lost");
    // Of 20 exchanges one is lost. It costs its own time and that of one more at most.
    assert!(sum >= 8.0 * 520.0 * 19.0 / 21.0, "{feedback:?}");
    assert!(feedback.iter().all(|rate| *rate >= 520.0 * 19.0 / 22.0), "{feedback:?}");
}

/// Between two bursts the bus seems quiet, but replies of high ids are waiting to be sent. Nobody tells the master of
/// the bursts.
#[test]
fn motors_behind_an_adapter_that_delivers_in_bursts_have_equal_turns() {
    let adapting = Config::CAN.adapting_up_to(millis(60));
    for (config, burst) in [(Config::CAN, 1), (adapting, 1), (adapting, 4), (adapting, 16)] {
        for motors in [10, 12, 14, 16, 24, 32] {
            let make = |world: &World<_>, port| world.hand_over_every(port, millis(burst));
            let (feedback, _) = full_bus(motors, config, FINE, make);
            // The bus carries 4,180 exchanges a second. Each motor is due a set-point at every other burst at least.
            let least = f64::from(motors) * 500.0 / burst as f64;
            let sum = equal(&feedback);
            assert!(
                sum.is_some_and(|sum| sum >= least.min(3_300.0)),
                "{burst} ms, {motors}: {feedback:?}"
            );
        }
    }
}

/// At each step of its clock a full bus seems to have been quiet.
#[test]
fn motors_of_a_master_with_a_coarse_clock_have_equal_turns() {
    for step in [100, 1_000, 2_000, 4_000].map(Duration::from_micros) {
        let config = Config::CAN.for_clock_step(step);
        for motors in [10, 12, 16, 32] {
            let (feedback, _) = full_bus(motors, config, step, |_, _| {});
            let sum = equal(&feedback);
            assert!(sum.is_some_and(|sum| sum >= 4_100.0), "{step}, {motors}: {feedback:?}");
            // Both at once.
            let (feedback, _) = full_bus(motors, config, step, |world, port| {
                world.hand_over_every(port, millis(1))
            });
            let sum = equal(&feedback);
            assert!(sum.is_some_and(|sum| sum >= 3_300.0), "{step}, {motors}: {feedback:?}");
        }
    }
}

/// How many of eight motors do not confirm a stop on a bus that loses every other frame.
fn stop_under_loss<W: Wire>(kind: StopKind, seed: u64) -> usize {
    let mut rig = Rig::<W>::new(8, seed);
    rig.shows_no_echo();
    let lossy = FaultPlan { lose: 0.5, ..FaultPlan::NONE };
    rig.strike(lossy);
    // Everything is in flight: streams, moves and reads.
    for number in 1..20 {
        for motor in rig.motors() {
            rig.put(motor, number).expect("there is a place");
            let step = step(number);
            let _ = rig.runner.master().request(motor, step);
        }
        rig.run_for(millis(1));
    }
    let begun = rig.runner.now();
    rig.ledger.pages().iter_mut().for_each(|page| page.sent.first_stop = None);
    rig.runner.master().stop_all(kind, MotorSet::EMPTY).unwrap();
    let mut open: MotorSet = rig.motors().collect();
    let mut unconfirmed = MotorSet::EMPTY;
    while !open.is_empty() {
        let soon = rig.runner.now() + millis(1);
        let note = |event| match event {
            Event::StopConfirmed { motor } => open.remove(motor),
            Event::StopUnconfirmed { motor } => {
                open.remove(motor);
                unconfirmed.insert(motor);
            }
            _ => {}
        };
        rig.runner.run_until(soon, note).unwrap();
    }
    let took = rig.runner.now() - begun;
    // 15 attempts of 21 ms. A set-point may still be in flight. So after an unanswered attempt, at most every second
    // one, the stop is sent once more. On RS485 one motor comes after another.
    let longest = if W::NAME == "CAN" { 330 + 8 * 62 } else { 8 * 15 * 7 + 10 };
    assert!(took <= millis(longest), "{}: {took} for all to stop", W::NAME);
    for motor in rig.motors() {
        let page = rig.ledger.page(motor);
        let case = format!("{}: motor {motor}, seed {seed}", W::NAME);
        let heard = page.heard.last_stop.is_some_and(|at| at >= begun);
        assert!(heard || unconfirmed.contains(motor), "{case} is said to have stopped");
        let first = page.sent.first_stop.expect("each is told at least once");
        assert!(page.sent.last_motion < Some(first), "{case} was moved after its stop");
        if W::NAME == "CAN" {
            // At most ten frames of the controller's queue and eight stops come first.
            assert!(first - begun < Duration::from_micros(18 * 135), "{case} waited");
        }
        // Nothing moves it until the stop is lifted.
        assert_eq!(rig.put(motor, 1_000), Err(RequestError::Stopped));
    }
    rig.runner.master().lift_stop();
    rig.put(id(1), 1_000).expect("the stop is lifted");
    unconfirmed.len()
}

#[test]
fn a_safe_stop_under_50_percent_loss_reaches_all_or_reports_who_was_missed() {
    let not_reached = [StopKind::Off, StopKind::Hold].map(|kind| {
        let on_can: usize = (0..800).map(|seed| stop_under_loss::<CanBus>(kind, seed)).sum();
        let on_rs485: usize = (0..800).map(|seed| stop_under_loss::<Rs485Line>(kind, seed)).sum();
        (on_can, on_rs485)
    });
    let [(off_on_can, off_on_rs485), (hold_on_can, hold_on_rs485)] = not_reached;
    // An attempt succeeds with a probability of 0.25, so all 15 fail with 0.75^15 = 1.3 %: 86 of the 6,400 stops of a
    // kind on a bus, give or take three times 9. A motor that an earlier frame may still move needs two successful
    // attempts. Fewer than two of 15 succeed with 1.3 % + 15 * 0.25 * 0.75^14 = 8.0 %: 513 of 6,400. On CAN at least
    // three in four have such a frame, since the last command was answered with a probability of 0.25: more than
    // 3/4 * 513 + 1/4 * 86 = 406, give or take three times 20. On a line at most one in eight has it: fewer than
    // 7/8 * 86 + 1/8 * 513 = 139.
    assert!((346..=513).contains(&off_on_can), "{not_reached:?}");
    assert!((58..139).contains(&off_on_rs485), "{not_reached:?}");
    // A hold of a motor that is new needs three answers, or two after a command that was answered, which at most one in
    // four was. Fewer than three of 15 attempts succeed with 8.0 % + 105 * 0.25^2 * 0.75^13 = 23.6 %: more than
    // 3/4 * 1,511 + 1/4 * 513 = 1,261 of 6,400, give or take three times 32. An answer that may be to an earlier frame
    // may not count. Fewer than four succeed with 23.6 % + 455 * 0.25^3 * 0.75^12 = 46.1 %: 2,953, give or take three
    // times 40.
    assert!((1_165..=3_073).contains(&hold_on_can), "{not_reached:?}");
    assert!((1_165..=3_073).contains(&hold_on_rs485), "{not_reached:?}");
}

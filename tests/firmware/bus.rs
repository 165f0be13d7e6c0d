//! The bus is not as it should be.

use std::thread;
use std::time::Duration;

use myactuator_host_std::sim::bus::faults::FaultPlan;
use myactuator_tests::emulator::board::Wire;
use myactuator_tests::emulator::log::Second;
use myactuator_tests::emulator::truth::Look;

use super::running::{
    BACK, PATIENCE, Program, UNDER_WAY_DPS, WATCHED, go, millis, moving, on, stops_for,
};

on! {
    every program:
    noise_moves_nothing_wrongly
    lost_frames_move_nothing_wrongly
    doubled_frames_move_nothing_wrongly
    a_bus_that_is_cut_for_a_second_stops_all_until_the_button
}

/// How long a bus is disturbed.
const DISTURBED: Duration = Duration::from_secs(2);
/// How far from the way to and fro a shaft may be, degrees, with what it takes to come to rest.
const OFF_THE_WAY_DEG: f32 = 3.0;
/// How far the way is, degrees.
const WAY_DEG: f32 = 20.0;
/// Nothing turns faster, degrees a second: 30 is what the movement needs. A set-point that was missed
/// is made up for.
const FASTEST_DPS: f32 = 120.0;
/// Motors that hear nothing stop by themselves after 500 ms, which the application has told them.
const PROTECTION_STOPS: Duration = Duration::from_millis(700);

fn noise_moves_nothing_wrongly(program: Program) {
    let goes_on = moves_nothing_wrongly(program, FaultPlan { corrupt: 0.03, ..FaultPlan::NONE });
    // CAN repeats by itself what was disturbed.
    let is_can = Wire::of_program(program.1) == Ok(Wire::Slcan);
    assert!(goes_on.is_none_or(|second| is_can || second.lost > 0), "{goes_on:?}");
}

fn lost_frames_move_nothing_wrongly(program: Program) {
    let goes_on = moves_nothing_wrongly(program, FaultPlan { lose: 0.03, ..FaultPlan::NONE });
    assert!(goes_on.is_none_or(|second| second.lost > 0), "{goes_on:?}");
}

fn doubled_frames_move_nothing_wrongly(program: Program) {
    moves_nothing_wrongly(program, FaultPlan { duplicate: 0.03, ..FaultPlan::NONE });
}

/// It goes on, or it stops and says why; the shafts stay on their way. Gives what it tells of the second
/// behind that if it goes on.
fn moves_nothing_wrongly(program: Program, plan: FaultPlan) -> Option<Second> {
    let mut firmware = moving(program);
    firmware.skip();
    let disturbed = firmware.drives().now();
    firmware.drives().disturb(plan);
    thread::sleep(DISTURBED);
    firmware.drives().disturb(FaultPlan::NONE);
    thread::sleep(millis(1_200));

    let now = firmware.drives().now();
    let all = firmware.truth.between(disturbed, now);
    let is_wrong = |look: &Look| {
        look.angle_deg < -OFF_THE_WAY_DEG
            || look.angle_deg > WAY_DEG + OFF_THE_WAY_DEG
            || look.motor_side_speed_dps.abs() > FASTEST_DPS
    };
    if let Some(look) = all.iter().flatten().find(|look| is_wrong(look)) {
        firmware.fail(&format!("disturbed since {disturbed:?}, a shaft goes wrong: {look:?}"));
    }
    let has_stopped = firmware.unread().iter().any(|line| line.text.starts_with("Trouble("));
    if has_stopped {
        firmware.check_stays_stopped(WATCHED);
        go(&mut firmware);
        None
    } else {
        firmware.skip();
        let second = firmware.wait_for_second();
        firmware.wait_until_moving(UNDER_WAY_DPS);
        Some(second)
    }
}

fn a_bus_that_is_cut_for_a_second_stops_all_until_the_button(program: Program) {
    let mut firmware = moving(program);
    let cut = firmware.drives().now();
    firmware.drives().cut(firmware.drives().handles());
    stops_for(&mut firmware, "");
    thread::sleep(millis(1_000));
    firmware.drives().mend(firmware.drives().handles());
    firmware.wait_for("State(Stopped)", PATIENCE);
    firmware.check_stays_stopped(BACK + WATCHED);
    firmware.check_still(cut, PROTECTION_STOPS);
    go(&mut firmware);
}

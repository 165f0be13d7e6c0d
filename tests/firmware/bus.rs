//! Faults of the bus.

use std::thread;
use std::time::Duration;

use myactuator_host_std::sim::bus::faults::FaultPlan;
use myactuator_tests::emulator::board::Wire;
use myactuator_tests::emulator::log::Second;
use myactuator_tests::emulator::truth::Sample;

use super::running::{
    Program, RECOVERY, TIMEOUT, UNDER_WAY_DPS, WATCH, millis, moving, start_moving, tests_on,
    wait_for_trouble,
};

tests_on! {
    every program:
    noise_causes_no_wrong_motion
    lost_frames_cause_no_wrong_motion
    doubled_frames_cause_no_wrong_motion
    a_bus_that_is_cut_for_a_second_stops_all_until_the_button
}

/// How long a bus is disturbed.
const DISTURBED: Duration = Duration::from_secs(2);
/// How far a shaft may leave the range of the movement, degrees. This includes what it needs to come to rest.
const OUT_OF_RANGE_DEG: f32 = 3.0;
/// The range of the movement, from 0 degrees.
const RANGE_DEG: f32 = 20.0;
/// No shaft may turn faster, degrees per second. The movement needs 30; a shaft that missed a set-point catches up.
const FASTEST_DPS: f32 = 120.0;
/// Motors that receive nothing stop on their own after 500 ms, which the application has set.
const PROTECTION_STOPS: Duration = Duration::from_millis(700);

fn noise_causes_no_wrong_motion(program: Program) {
    let continues = run_with_faults(program, FaultPlan { corrupt: 0.03, ..FaultPlan::NONE });
    // A CAN controller repeats a disturbed frame on its own.
    let is_can = Wire::of_program(program.1) == Ok(Wire::Slcan);
    assert!(
        continues.is_none_or(|second| is_can || second.lost > 0),
        "expected lost replies, found {continues:?}"
    );
}

fn lost_frames_cause_no_wrong_motion(program: Program) {
    let continues = run_with_faults(program, FaultPlan { lose: 0.03, ..FaultPlan::NONE });
    assert!(
        continues.is_none_or(|second| second.lost > 0),
        "expected lost replies, found {continues:?}"
    );
}

fn doubled_frames_cause_no_wrong_motion(program: Program) {
    run_with_faults(program, FaultPlan { duplicate: 0.03, ..FaultPlan::NONE });
}

/// The firmware continues, or it stops and reports why. In both cases the shafts stay in range. If it continues, returns
/// its report of the next second.
fn run_with_faults(program: Program, plan: FaultPlan) -> Option<Second> {
    let mut firmware = moving(program);
    firmware.skip();
    let disturbed = firmware.drives().now();
    firmware.drives().disturb(plan);
    thread::sleep(DISTURBED);
    firmware.drives().disturb(FaultPlan::NONE);
    thread::sleep(millis(1_200));

    let now = firmware.drives().now();
    let samples = firmware.truth.between(disturbed, now);
    let is_out_of_range = |sample: &Sample| {
        sample.angle_deg < -OUT_OF_RANGE_DEG
            || sample.angle_deg > RANGE_DEG + OUT_OF_RANGE_DEG
            || sample.motor_side_speed_dps.abs() > FASTEST_DPS
    };
    if let Some(sample) = samples.iter().flatten().find(|sample| is_out_of_range(sample)) {
        firmware.fail(&format!(
            "with faults since {disturbed:?}, expected a shaft in range, found {sample:?}"
        ));
    }
    let has_stopped = firmware.unread().iter().any(|line| line.text.starts_with("Trouble("));
    if has_stopped {
        firmware.check_stays_stopped(WATCH);
        start_moving(&mut firmware);
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
    wait_for_trouble(&mut firmware, "");
    thread::sleep(millis(1_000));
    firmware.drives().mend(firmware.drives().handles());
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(RECOVERY + WATCH);
    firmware.check_still(cut, PROTECTION_STOPS);
    start_moving(&mut firmware);
}

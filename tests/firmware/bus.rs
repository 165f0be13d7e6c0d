//! Faults of the bus.

use std::thread;
use std::time::Duration;

use myactuator_host_std::sim::bus::faults::FaultPlan;
use myactuator_tests::emulator::board::Wire;
use myactuator_tests::emulator::firmware::Firmware;
use myactuator_tests::emulator::log::Line;
use myactuator_tests::emulator::truth::Sample;

use super::running::{
    DRIVES, Program, RECOVERY, TIMEOUT, UNDER_WAY_DPS, WATCH, millis, moving, start_moving,
    tests_on, wait_for_trouble,
};

tests_on! {
    every program:
    faults_of_the_bus_cause_no_wrong_motion
}

/// How long a bus is disturbed.
const DISTURBED: Duration = Duration::from_secs(2);
/// How far a shaft may leave the range of the movement, degrees. This includes what it needs to come to rest.
const OUT_OF_RANGE_DEG: f32 = 3.0;
/// The range of the movement, degrees.
const RANGE_DEG: f32 = 20.0;
/// No shaft may turn faster, degrees per second. The movement needs 30; a shaft that missed a set-point catches up.
const FASTEST_DPS: f32 = 120.0;
/// Motors that receive nothing stop on their own after 500 ms, which the application has set.
const PROTECTION_STOPS: Duration = Duration::from_millis(700);

/// One fault after another; after each the motors move again.
fn faults_of_the_bus_cause_no_wrong_motion(program: Program) {
    let mut firmware = moving(program);
    let origins = &mut [0.0; DRIVES as usize];
    let noise = FaultPlan { corrupt: 0.03, ..FaultPlan::NONE };
    let lost = run_with_faults(&mut firmware, noise, origins);
    // A CAN controller repeats a disturbed frame on its own.
    let is_can = Wire::of_program(program.1) == Ok(Wire::Slcan);
    assert!(is_can || lost != Some(0), "noise: expected lost replies, found none");
    let losses = FaultPlan { lose: 0.03, ..FaultPlan::NONE };
    let lost = run_with_faults(&mut firmware, losses, origins);
    assert!(lost != Some(0), "lost frames: expected lost replies, found none");
    let doubles = FaultPlan { duplicate: 0.03, ..FaultPlan::NONE };
    run_with_faults(&mut firmware, doubles, origins);
    a_bus_that_is_cut_for_a_second_stops_all_until_the_button(&mut firmware);
}

/// The firmware continues, or it stops and reports why. In both cases the shafts stay in range. If it continues,
/// returns how many replies it lost. `origins` is where the movement of each motor began, degrees: where it stood at
/// the press.
fn run_with_faults(
    firmware: &mut Firmware,
    plan: FaultPlan,
    origins: &mut [f32; DRIVES as usize],
) -> Option<u32> {
    // The count starts again with each motion.
    let reports = firmware.reports();
    let of_motion = reports.iter().rev().take_while(|line| line.text != "State(Running)");
    let lost_before = of_motion.filter_map(Line::second).next().map_or(0, |second| second.lost);
    firmware.skip();
    let disturbed = firmware.drives().now();
    firmware.drives().disturb(plan);
    thread::sleep(DISTURBED);
    firmware.drives().disturb(FaultPlan::NONE);
    thread::sleep(millis(1_200));

    let now = firmware.drives().now();
    let samples = firmware.truth.between(disturbed, now);
    for (samples, origin) in samples.iter().zip(&*origins) {
        let is_out_of_range = |sample: &&Sample| {
            let angle_deg = sample.angle_deg - origin;
            !(-OUT_OF_RANGE_DEG..=RANGE_DEG + OUT_OF_RANGE_DEG).contains(&angle_deg)
                || sample.motor_side_speed_dps.abs() > FASTEST_DPS
        };
        if let Some(sample) = samples.iter().find(is_out_of_range) {
            firmware.fail(&format!(
                "with {plan:?} since {disturbed:?}, expected a shaft in range from {origin} degrees, \
                 found {sample:?}"
            ));
        }
    }
    let has_stopped = firmware.unread().iter().any(|line| line.text.starts_with("Trouble("));
    if has_stopped {
        firmware.check_stays_stopped(WATCH);
        for (origin, sample) in origins.iter_mut().zip(firmware.samples()) {
            *origin = sample.angle_deg;
        }
        start_moving(firmware);
        None
    } else {
        firmware.skip();
        let second = firmware.wait_for_second();
        firmware.wait_until_moving(UNDER_WAY_DPS);
        Some(second.lost - lost_before)
    }
}

fn a_bus_that_is_cut_for_a_second_stops_all_until_the_button(firmware: &mut Firmware) {
    let cut = firmware.drives().now();
    firmware.drives().cut(firmware.drives().handles());
    wait_for_trouble(firmware, "");
    thread::sleep(millis(1_000));
    firmware.drives().mend(firmware.drives().handles());
    firmware.wait_for("State(Stopped)", TIMEOUT);
    firmware.check_stays_stopped(RECOVERY + WATCH);
    firmware.check_still(cut, PROTECTION_STOPS);
    start_moving(firmware);
}

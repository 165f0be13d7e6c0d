//! The demonstration runs to its end on both buses and tells what it promises.

use crate::run::{run, text};

fn demo(bus: &str) -> String {
    let output = run(&["demo", "--bus", bus]);
    assert_eq!(text(&output.stderr), "");
    assert!(output.status.success());
    text(&output.stdout).to_owned()
}

#[test]
fn four_drives_are_found_moved_and_shut_down_on_either_bus() {
    for bus in ["can", "rs485"] {
        let told = demo(bus);
        for sentence in [
            "4 answer (1 2 3 4)",
            "motor 4: X8-PRO",
            "It has arrived.",
            "Shut down: all 4 have confirmed",
        ] {
            assert!(told.contains(sentence), "{bus}: {sentence:?} is missing in:\n{told}");
        }
    }
}

#[test]
fn motion_mode_runs_on_can_and_keeps_the_bus_full() {
    let told = demo("can");
    let share = told.lines().find_map(|line| line.trim().strip_prefix("The wire and")).unwrap();
    let percent: f64 =
        share.split("that is ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    // Four motors are too few to fill the bus; their drives' response times decide.
    assert!((90.0..=100.0).contains(&percent), "{told}");
    assert!(demo("rs485").contains("Motion mode exists on CAN only"));
}

#[test]
fn every_run_is_the_same() {
    assert_eq!(demo("can"), demo("can"));
}

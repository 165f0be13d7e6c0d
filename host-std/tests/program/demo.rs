//! The demonstration runs to its end on both buses and prints what it promises.

use crate::run::{run_words, text};

/// Its output, the same in every run.
fn demo(bus: &str) -> String {
    let demo = || run_words(&format!("demo --bus {bus}"));
    let output = demo();
    assert_eq!(text(&output.stderr), "");
    assert!(output.status.success());
    assert_eq!(demo(), output);
    text(&output.stdout).to_owned()
}

#[test]
fn four_drives_are_found_moved_and_shut_down_on_either_bus() {
    for (bus, way) in [("can", "Motion mode: all 4"), ("rs485", "Motion mode exists on CAN only")] {
        let printed = demo(bus);
        for sentence in [
            "4 answer (1 2 3 4)",
            "motor 4: X6-60",
            "It has arrived at ",
            way,
            "Shut down: all 4 have confirmed",
        ] {
            assert!(printed.contains(sentence), "{bus}: {sentence:?} is missing in:\n{printed}");
        }
    }
}

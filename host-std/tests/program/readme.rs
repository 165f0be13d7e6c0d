//! What the README shows of the examples and of the output of the program is true.

use crate::run::{lines, run_words};

#[path = "../../examples/ask_move_stop.rs"]
mod ask_move_stop;
#[path = "../../examples/control_loop.rs"]
#[expect(dead_code, reason = "its tests are run here")]
mod control_loop;
#[path = "../../examples/going_on.rs"]
mod going_on;
#[path = "../../examples/threads.rs"]
#[expect(dead_code, reason = "its test is run here")]
mod threads;

const README: &str = include_str!("../../../README.md");
const CONTROL_LOOP: &str = include_str!("../../examples/control_loop.rs");
const TWO_ARMS: &str = include_str!("../../examples/two_arms.rs");
const TWO_ARMS_FILE: &str = include_str!("../../examples/two_arms.toml");
const ASK_MOVE_STOP: &str = include_str!("../../examples/ask_move_stop.rs");

#[test]
fn code_shown_in_the_readme_is_that_of_the_examples() {
    for (heading, example) in
        [("## A control loop", CONTROL_LOOP), ("## Asking, moving, stopping", ASK_MOVE_STOP)]
    {
        let (_, section) = README.split_once(heading).unwrap();
        let (_, code) = section.split_once("```rust\n").unwrap();
        let (code, _) = code.split_once("```").unwrap();
        // Its imports have lines of their own there.
        let (imports, function) = code.split_once("\n\n").unwrap();
        assert!(imports.lines().all(|line| line.starts_with("use ")), "{imports}");
        assert!(function.contains("\nfn "), "{function}");
        assert!(example.contains(function), "not in the example:\n{function}");
    }
}

/// The rest of that section is run by `.ci/robot`.
#[test]
fn robot_shown_in_the_readme_is_that_of_the_example() {
    let (_, section) = README.split_once("## A robot from one file").unwrap();
    let block = |language: &str| {
        let (_, block) = section.split_once(&format!("```{language}\n")).unwrap();
        block.split_once("```").unwrap().0
    };
    assert!(TWO_ARMS_FILE.contains(block("toml")));
    let lines: Vec<&str> = TWO_ARMS.lines().collect();
    for line in block("rust,ignore").lines() {
        assert!(lines.contains(&line), "not in the example: {line}");
    }
}

#[test]
fn commands_print_what_the_readme_shows() {
    let blocks = README.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
    let mut compared = 0;
    for run in blocks.flat_map(|block| block.split("$ myactuator ").skip(1)) {
        let mut shown = run.lines();
        let arguments = shown.next().unwrap();
        let shown: Vec<&str> = shown.take_while(|line| !line.starts_with('$')).collect();
        if shown.is_empty() {
            continue;
        }
        let output = run_words(arguments);
        match shown.split_last() {
            Some((&"...", first)) => assert_eq!(lines(&output)[..first.len()], *first, "{run}"),
            _ => assert_eq!(lines(&output), shown, "{run}"),
        }
        compared += 1;
    }
    assert_eq!(compared, 4); // scan, move, encode, send
}

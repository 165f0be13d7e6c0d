//! The question before a motor moves, answered on a terminal.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::process::{Child, Stdio};

use rustix::pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, unlockpt};

use crate::run::{myactuator, tells_of_silence, text, unless_late};
use crate::sim_control::{control, controlled};

/// A terminal: the end to type on, and the end that is read.
pub(crate) fn terminal() -> (File, OwnedFd) {
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let keys = openpt(flags).unwrap();
    grantpt(&keys).unwrap();
    unlockpt(&keys).unwrap();
    let program = ioctl_tiocgptpeer(&keys, flags).unwrap();
    (keys.into(), program)
}

/// Runs the program until it asks. Returns it, the end to type the answer on, and the question.
fn asked(arguments: &str) -> (Child, File, String) {
    asked_after("", arguments)
}

/// The same, after this was typed.
fn asked_after(typed: &str, arguments: &str) -> (Child, File, String) {
    let (mut keys, stdin) = terminal();
    keys.write_all(typed.as_bytes()).unwrap();
    let mut program = myactuator();
    program.args(arguments.split_whitespace());
    program.stdin(stdin).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut process = program.spawn().unwrap();
    let (mut message, mut byte) = (Vec::new(), [0]);
    let errors = process.stderr.as_mut().unwrap();
    while !message.ends_with(b"[y/N] ") && errors.read(&mut byte).unwrap() > 0 {
        message.push(byte[0]);
    }
    (process, keys, text(&message).to_owned())
}

/// The exit status, the question, and what was reported after the answer.
type Ended = (Option<i32>, String, String);

/// Answers the question, and waits until the program ends.
fn answered(process: Child, keys: &mut File, question: String, answer: &str) -> Ended {
    // It may have given up before it asks.
    let _ = writeln!(keys, "{answer}");
    let ended = process.wait_with_output().unwrap();
    (ended.status.code(), question, text(&ended.stderr).to_owned())
}

fn is_silent((_, question, errors): &Ended) -> bool {
    tells_of_silence(question) || tells_of_silence(errors)
}

#[test]
fn a_shaft_that_is_turned_beyond_the_scale_before_the_answer_is_not_moved() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let bus = simulation.bus("slcan");
    let motion = "motion --id 1 --position-rad 0 --kp 40 --kd 2 --firmware v4.3 --for-s 0.2";
    let beyond =
        "error: motor 1 is at 1800 deg (31.42 rad), and motion mode reaches from -12.5 to 12.5 rad";
    // The user is not asked about a move that would be refused.
    control(socket, &["angle", "--id", "1", "1800"]);
    let (process, _keys, message) = asked(&format!("{motion} --bus {bus}"));
    assert!(message.starts_with(beyond), "{message}");
    assert_eq!(process.wait_with_output().unwrap().status.code(), Some(1));
    for (answer, degrees, message, status) in [
        ("n", "1800", "error: not confirmed, so nothing was done\n", 1),
        ("y", "1800", beyond, 1),
        ("y", "300", "", 0),
    ] {
        let attempt = || {
            control(socket, &["angle", "--id", "1", "0"]);
            let (process, mut keys, question) = asked(&format!("{motion} --bus {bus}"));
            if !tells_of_silence(&question) {
                let expected = "Motor 1 will run in motion mode to 0 rad";
                assert!(question.starts_with(expected), "{question}");
            }
            control(socket, &["angle", "--id", "1", degrees]);
            answered(process, &mut keys, question, answer)
        };
        let (ended, _, errors) = unless_late(attempt, is_silent);
        assert_eq!(ended, Some(status), "{degrees}: {errors}");
        assert!(errors.starts_with(message), "{degrees}: {errors}");
        let stays = control(socket, &["state"]).contains(&format!("motor 1: {degrees}.00 deg"));
        assert_eq!(stays, status == 1, "{answer} {degrees}");
    }
}

#[test]
fn what_was_typed_before_the_question_does_not_answer_it() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let speed =
        format!("speed --id 1 --speed-dps 30 --for-s 0.2 --bus {}", simulation.bus("slcan"));
    let attempt = || {
        let (process, mut keys, question) = asked_after("y\n", &speed);
        answered(process, &mut keys, question, "n")
    };
    let (status, question, errors) = unless_late(attempt, is_silent);
    assert!(question.contains("turn at 30 dps with no limit of torque"), "{question}");
    assert!(errors.ends_with("error: not confirmed, so nothing was done\n"), "{errors}");
    assert_eq!(status, Some(1));
    assert!(control(socket, &["state"]).contains("motor 1: 0.00 deg"));
}

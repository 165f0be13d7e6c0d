//! `myactuator sim --control` and `sim-control`, as people and scripts use them.

use std::path::PathBuf;
use std::process::Stdio;

use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;

use crate::run::{myactuator, run, text};
use crate::sim_serve::{Simulation, run_at};

/// A simulation of this many motors, its control socket, and the folder of the socket.
pub(crate) fn controlled(motors: u8) -> (TempDir, PathBuf, Simulation) {
    controlled_on("slcan", motors)
}

/// The same on this kind of bus.
pub(crate) fn controlled_on(kind: &str, motors: u8) -> (TempDir, PathBuf, Simulation) {
    controlled_with(kind, motors, &[])
}

/// The same with more options.
pub(crate) fn controlled_with(
    kind: &str,
    motors: u8,
    more: &[&str],
) -> (TempDir, PathBuf, Simulation) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control");
    let (count, socket) = (motors.to_string(), path.to_str().unwrap());
    let options = ["--only", kind, "--count", &count, "--control", socket];
    let simulation = Simulation::start(2, &[&options, more].concat());
    (folder, path, simulation)
}

/// The output of `sim-control`, which must succeed.
pub(crate) fn control(socket: &str, arguments: &[&str]) -> String {
    let output = run(&[&["sim-control", socket], arguments].concat());
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout).to_owned()
}

fn refused(arguments: &[&str]) -> (Option<i32>, String) {
    let output = run(&[&["sim-control"], arguments].concat());
    (output.status.code(), text(&output.stderr).to_owned())
}

#[test]
fn drives_are_looked_at_and_changed_while_they_run() {
    let (_folder, path, simulation) = controlled(2);
    let socket = path.to_str().unwrap();
    assert_eq!(simulation.place("control")["path"], socket);
    let bus = simulation.bus("slcan");

    control(socket, &["angle", "--id", "2", "123"]);
    let state = control(socket, &["--json", "state", "--id", "2"]);
    let state: Value = serde_json::from_str(&state).unwrap();
    let angle_deg = state["ok"]["buses"][0]["motors"][0]["angle_deg"].as_f64().unwrap();
    assert!((angle_deg - 123.0).abs() < 1e-9, "{angle_deg}");
    assert!(control(socket, &["state"]).contains("  motor 2: 123.00 deg, 0.0 dps"));
    // A drive with a cut cable does not answer.
    control(socket, &["fault", "cut@1"]);
    let (_, scan) = run_at(bus, &["scan"]);
    assert!(scan.contains("motor 2:") && !scan.contains("motor 1:"), "{scan}");
    control(socket, &["fault", "mend"]);

    // No other simulation can have the same socket.
    let second = run(&["sim", "--control", socket]);
    assert_eq!(second.status.code(), Some(1));
    assert!(text(&second.stderr).contains("another simulation has the control socket"));

    let (status, told) = refused(&[socket, "push", "--id", "9", "1"]);
    assert_eq!((status, told.as_str()), (Some(1), "error: there is no motor 9 on can\n"));
    assert!(simulation.end(Signal::INT).0.success());
    assert!(!path.exists());
    let (status, told) = refused(&[socket, "state"]);
    assert_eq!(status, Some(1));
    assert!(told.contains("start one with sim --control"), "{told}");
}

#[test]
fn log_is_printed_to_the_client_that_asks_for_it() {
    use std::io::{BufRead as _, BufReader};

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control");
    let socket = path.to_str().unwrap();
    let options = ["--only", "slcan", "--count", "1", "--control", socket, "--lock-step"];
    let _simulation = Simulation::start(2, &options);
    let mut log = myactuator()
        .args(["sim-control", socket, "log"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(log.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert_eq!(lines.next().unwrap(), "at 0.000000 s");
    control(socket, &["fault", "over-speed+1s"]);
    assert_eq!(control(socket, &["advance", "2s"]), "at 2.000000 s\n");
    assert_eq!(
        lines.next().unwrap(),
        "1.000000 s  can motor 1 cuts its output for an error: speed too high"
    );
    log.kill().unwrap();
    log.wait().unwrap();
}

#[test]
fn lock_step_needs_a_control_socket() {
    let output = run(&["sim", "--lock-step"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("--control"), "{}", text(&output.stderr));
}

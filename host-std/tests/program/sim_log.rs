//! The log of `myactuator sim`: it has what drives refuse, and holds nothing up if it is not read.

use std::io::{BufRead as _, BufReader, Read as _};
use std::process::{Child, Stdio};
use std::sync::MutexGuard;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::held_up::full_pipe;
use crate::run::myactuator;
use crate::sim_serve::{alone, done_at, prefer};

/// Ends with its owner, even if a test fails.
struct Ended(Child, #[expect(dead_code, reason = "kept until then")] MutexGuard<'static, ()>);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn sim(arguments: &[&str], logged: Stdio) -> Ended {
    let mut command = myactuator();
    command.args(["sim", "--only", "rs485", "--count", "1", "--brakes"]).args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(logged);
    let alone = alone();
    let process = command.spawn().unwrap();
    prefer(&process);
    Ended(process, alone)
}

/// Its brake keeps it from running.
fn push(bus: &str) {
    done_at(bus, &["send", "--id", "1", "torque", "--current-a", "1", "--yes"]);
}

#[test]
fn log_reports_a_command_that_was_not_run_with_its_reason_as_json() {
    let mut simulation = sim(&["--json"], Stdio::null());
    let mut lines = BufReader::new(simulation.0.stdout.take().unwrap()).lines();
    let mut next = || serde_json::from_str::<Value>(&lines.next().unwrap().unwrap()).unwrap();
    let bus = next()["bus"].as_str().unwrap().to_owned();
    push(&bus);
    let logged = next();
    assert_eq!(logged["kind"], "log");
    assert_eq!((&logged["bus"], &logged["motor"]), (&"rs485".into(), &1.into()));
    let event = serde_json::json!({ "not-run": { "opcode": "torque", "reason": "brake-locked" } });
    assert_eq!(logged["event"], event);
    assert!(logged["text"].as_str().unwrap().contains("its brake is locked"), "{logged}");
}

/// The bus that it prints for people.
fn printed_bus(simulation: &mut Ended) -> String {
    let lines = BufReader::new(simulation.0.stdout.take().unwrap()).lines();
    let mut buses = lines.filter_map(|line| Some(line.unwrap().split_once("--bus ")?.1.to_owned()));
    buses.next().unwrap()
}

#[test]
fn log_is_printed_as_text_to_stderr() {
    let mut simulation = sim(&[], Stdio::piped());
    let bus = printed_bus(&mut simulation);
    push(&bus);
    kill_process(Pid::from_child(&simulation.0), Signal::INT).unwrap();
    let mut logged = String::new();
    simulation.0.stderr.take().unwrap().read_to_string(&mut logged).unwrap();
    assert!(simulation.0.wait().unwrap().success());
    let logged = logged.lines().find(|line| line.contains("torque (0xA1)")).unwrap();
    assert!(
        logged.contains(" s  rs485 motor 1 answers torque (0xA1) and does not run it: "),
        "{logged}"
    );
}

#[test]
fn unread_log_holds_nothing_up() {
    let (reader, writer) = full_pipe();
    let mut simulation = sim(&[], Stdio::from(writer));
    let bus = printed_bus(&mut simulation);
    push(&bus);
    push(&bus);
    kill_process(Pid::from_child(&simulation.0), Signal::INT).unwrap();
    assert!(simulation.0.wait().unwrap().success());
    drop(reader);
}

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

fn sim(arguments: &[&str], told: Stdio) -> Ended {
    let mut command = myactuator();
    command.args(["sim", "--only", "rs485", "--count", "1", "--brakes"]).args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(told);
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
fn the_log_says_what_a_drive_did_not_do_and_why_as_json() {
    let mut simulation = sim(&["--json"], Stdio::null());
    let mut lines = BufReader::new(simulation.0.stdout.take().unwrap()).lines();
    let mut next = || serde_json::from_str::<Value>(&lines.next().unwrap().unwrap()).unwrap();
    let bus = next()["bus"].as_str().unwrap().to_owned();
    push(&bus);
    let told = next();
    assert_eq!(told["kind"], "log");
    assert_eq!((&told["bus"], &told["motor"]), (&"rs485".into(), &1.into()));
    let event = serde_json::json!({ "not-run": { "opcode": "torque", "reason": "brake-locked" } });
    assert_eq!(told["event"], event);
    assert!(told["text"].as_str().unwrap().contains("its brake is locked"), "{told}");
}

/// The bus that it prints for people.
fn told_bus(simulation: &mut Ended) -> String {
    let lines = BufReader::new(simulation.0.stdout.take().unwrap()).lines();
    let mut buses = lines.filter_map(|line| Some(line.unwrap().split_once("--bus ")?.1.to_owned()));
    buses.next().unwrap()
}

#[test]
fn people_read_the_log_beside_the_output() {
    let mut simulation = sim(&[], Stdio::piped());
    let bus = told_bus(&mut simulation);
    push(&bus);
    kill_process(Pid::from_child(&simulation.0), Signal::INT).unwrap();
    let mut told = String::new();
    simulation.0.stderr.take().unwrap().read_to_string(&mut told).unwrap();
    assert!(simulation.0.wait().unwrap().success());
    let told = told.lines().find(|line| line.contains("torque (0xA1)")).unwrap();
    assert!(
        told.contains(" s  rs485 motor 1 answers torque (0xA1) and does not run it: "),
        "{told}"
    );
}

#[test]
fn who_does_not_read_the_log_holds_nothing_up() {
    let (reader, writer) = full_pipe();
    let mut simulation = sim(&[], Stdio::from(writer));
    let bus = told_bus(&mut simulation);
    push(&bus);
    push(&bus);
    kill_process(Pid::from_child(&simulation.0), Signal::INT).unwrap();
    simulation.0.wait().unwrap();
    drop(reader);
}

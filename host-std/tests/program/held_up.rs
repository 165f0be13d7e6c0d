//! A motor is stopped in time although nobody reads what is printed, and whatever signal comes.

use std::io::{self, Read as _, Write as _};
use std::os::fd::AsFd as _;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::run::{myactuator, run, text};
use crate::sim_control::{control, controlled};
use crate::sim_serve::Simulation;

/// How long the program may take to end after a signal: the stop, and its last words.
const SOON: Duration = Duration::from_secs(10);
/// How fast the motor turns.
const DPS: f64 = 90.0;

/// `speed` on this bus, for so long.
fn speed(bus: &str, for_s: &str) -> Command {
    let mut command = myactuator();
    command.args(["speed", "--yes", "--bus", bus, "--id", "1", "--speed-dps", &DPS.to_string()]);
    command.args(["--for-s", for_s]).stdin(Stdio::null());
    command
}

/// A pipe that takes nothing more, and the end from which nobody reads.
pub(crate) fn full_pipe() -> (io::PipeReader, io::PipeWriter) {
    let (reader, mut writer) = io::pipe().unwrap();
    rustix::io::ioctl_fionbio(writer.as_fd(), true).unwrap();
    for size in [4096, 1] {
        while writer.write(&vec![b' '; size]).is_ok() {}
    }
    rustix::io::ioctl_fionbio(writer.as_fd(), false).unwrap();
    (reader, writer)
}

/// It takes longer on a busy machine until it does something about that.
fn wait_until_it_catches(process: &Child, signal: Signal) {
    let caught = || {
        let status = std::fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
        u64::from_str_radix(caught.trim(), 16).unwrap()
    };
    let start = Instant::now();
    while caught() >> (signal.as_raw() - 1) & 1 == 0 && start.elapsed() < SOON {
        sleep(Duration::from_millis(10));
    }
}

fn signal(process: &Child, signal: Signal) {
    wait_until_it_catches(process, signal);
    kill_process(Pid::from_child(process), signal).unwrap();
}

/// How it ends, if it does so soon.
fn ends_soon(process: &mut Child) -> Option<ExitStatus> {
    let start = Instant::now();
    while start.elapsed() < SOON {
        if let Some(status) = process.try_wait().unwrap() {
            return Some(status);
        }
        sleep(Duration::from_millis(10));
    }
    process.kill().unwrap();
    process.wait().unwrap();
    None
}

/// The motor's angle and speed.
fn angle_and_speed(bus: &str) -> (f64, f64) {
    let output = run(&["status", "--json", "--id", "1", "--bus", bus]);
    let motor: Value = serde_json::from_str(text(&output.stdout))
        .unwrap_or_else(|error| panic!("{error}: {}", text(&output.stderr)));
    (motor["angle_deg"].as_f64().unwrap(), motor["speed_dps"].as_f64().unwrap())
}

#[test]
fn a_full_pipe_lets_the_motor_stop_in_time() {
    let simulation = Simulation::start(1, &["--only", "slcan"]);
    let bus = simulation.bus("slcan");
    let (reader, writer) = full_pipe();
    let mut process = speed(bus, "1").stdout(writer).stderr(Stdio::null()).spawn().unwrap();
    // It waits with its result until somebody reads, or it is told to end.
    sleep(Duration::from_secs(4));
    assert!(process.try_wait().unwrap().is_none());
    signal(&process, Signal::TERM);
    assert_eq!(ends_soon(&mut process).expect("an end").code(), Some(130));
    let (angle, speed) = angle_and_speed(bus);
    assert!((0.5 * DPS..1.5 * DPS).contains(&angle) && speed == 0.0, "{angle} deg {speed} dps");
    drop(reader);
}

#[test]
fn a_motor_that_was_sent_off_stops_when_it_is_told_to_end_before_the_reply_is_printed() {
    let simulation = Simulation::start(1, &["--only", "slcan"]);
    let bus = simulation.bus("slcan");
    let (_reader, writer) = full_pipe();
    let mut send = myactuator();
    send.args(["send", "--yes", "--bus", bus, "--id", "1", "speed", "--max-torque-pct", "0"]);
    send.args(["--speed-dps", &DPS.to_string()]).stdin(Stdio::null());
    let mut process = send.stdout(writer).stderr(Stdio::null()).spawn().unwrap();
    sleep(Duration::from_millis(500));
    assert!(process.try_wait().unwrap().is_none());
    signal(&process, Signal::INT);
    assert_eq!(ends_soon(&mut process).expect("an end").code(), Some(130));
    let (angle, speed) = angle_and_speed(bus);
    assert!(angle > 0.0 && speed == 0.0, "{angle} deg {speed} dps");
}

#[test]
fn a_reader_that_was_killed_stops_the_motor() {
    let simulation = Simulation::start(1, &["--only", "slcan"]);
    let bus = simulation.bus("slcan");
    let mut process =
        speed(bus, "60").stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    sleep(Duration::from_millis(500));
    drop(process.stdout.take());
    assert_eq!(ends_soon(&mut process).expect("an end").code(), Some(1));
    assert_eq!(angle_and_speed(bus).1, 0.0);
}

#[test]
fn a_slow_reader_gets_the_result_all_the_same() {
    let (mut reader, writer) = full_pipe();
    let mut process = speed("sim:1", "20").stdout(writer).stderr(Stdio::null()).spawn().unwrap();
    sleep(Duration::from_millis(500));
    let reading = std::thread::spawn(move || {
        let mut told = String::new();
        reader.read_to_string(&mut told).unwrap();
        told
    });
    assert_eq!(process.wait().unwrap().code(), Some(0));
    let told = reading.join().unwrap();
    assert!(
        told.ends_with("motor 1 has run for 20 s; motor 1 is stopped and holds still (0x81)\n")
    );
}

#[test]
fn signals_stop_the_motor_first_although_nobody_reads() {
    let simulation = Simulation::start(1, &["--only", "slcan"]);
    let bus = simulation.bus("slcan");
    for kind in [Signal::TERM, Signal::QUIT, Signal::TSTP, Signal::TTOU, Signal::HUP] {
        let (out, err) = (full_pipe(), full_pipe());
        let mut process = speed(bus, "60").stdout(out.1).stderr(err.1).spawn().unwrap();
        sleep(Duration::from_millis(500));
        signal(&process, kind);
        let status = ends_soon(&mut process).unwrap_or_else(|| panic!("{kind:?}: still there"));
        assert_eq!(status.code(), Some(130), "{kind:?}");
        assert_eq!(angle_and_speed(bus).1, 0.0, "{kind:?}");
    }
}

#[test]
fn ctrl_c_while_the_motor_comes_to_rest_waits_for_it_and_is_no_failure() {
    let simulation = Simulation::start(1, &["--only", "slcan"]);
    let bus = simulation.bus("slcan");
    // From 540 dps it takes 5.4 s.
    let slowly = "write-acceleration --index speed-deceleration --acceleration-dps2 100";
    let mut send = myactuator();
    send.args(["send", "--yes", "--bus", bus, "--id", "1"]).args(slowly.split(' '));
    let sent = send.stdin(Stdio::null()).output().unwrap();
    assert!(sent.status.success(), "{}", text(&sent.stderr));
    let mut turn = myactuator();
    turn.args(["speed", "--yes", "--bus", bus, "--id", "1", "--speed-dps", "540", "--for-s", "1"]);
    turn.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let process = turn.spawn().unwrap();
    sleep(Duration::from_secs(3));
    signal(&process, Signal::INT);
    let ended = process.wait_with_output().unwrap();
    let told = "error: interrupted; motor 1 is stopped and holds still (0x81)\n";
    assert_eq!((text(&ended.stderr), ended.status.code()), (told, Some(130)));
    assert_eq!(angle_and_speed(bus).1, 0.0);
}

/// How it ends where Ctrl-C is pressed half a second after its start.
fn interrupted(command: &mut Command) -> Output {
    let command = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let process = command.spawn().unwrap();
    sleep(Duration::from_millis(500));
    signal(&process, Signal::INT);
    process.wait_with_output().unwrap()
}

#[test]
fn a_stop_goes_on_although_ctrl_c_is_pressed() {
    let simulation = Simulation::start(1, &["--only", "rs485"]);
    let mut stop = myactuator();
    // It goes on trying for a second: nobody has this id.
    stop.args(["stop", "--id", "7", "--bus", simulation.bus("rs485")]);
    let ended = interrupted(&mut stop);
    let told = text(&ended.stderr);
    assert!(told.contains("no confirmation of the stop from motor 7"), "{}: {told}", ended.status);
}

#[test]
fn what_is_written_is_not_left_halfway_although_ctrl_c_is_pressed() {
    let simulation = Simulation::start(1, &["--only", "rs485"]);
    let mut zero = myactuator();
    zero.args(["zero", "--yes", "--id", "1", "--bus", simulation.bus("rs485")]);
    // A zero that is stored counts from the next start on: the motor restarts for that, for a second and more.
    let ended = interrupted(&mut zero);
    let told = text(&ended.stdout);
    assert!(told.contains("is the zero"), "{}: {told}", ended.status);
}

/// It once gave up then, for the bus had carried nothing for so long.
#[test]
fn a_stop_that_was_suspended_goes_on_with_it() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let bus = simulation.bus("slcan");
    for what in ["stop", "shutdown"] {
        control(socket, &["fault", "cut"]);
        let mut stop = myactuator();
        stop.args([what, "--bus", bus]).stdin(Stdio::null());
        let process = stop.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        wait_until_it_catches(&process, Signal::INT);
        // It has found that nobody answers, and waits for that.
        sleep(Duration::from_millis(300));
        kill_process(Pid::from_child(&process), Signal::STOP).unwrap();
        sleep(Duration::from_secs(2));
        control(socket, &["fault", "mend"]);
        kill_process(Pid::from_child(&process), Signal::CONT).unwrap();
        let ended = process.wait_with_output().unwrap();
        let (told, errors) = (text(&ended.stdout), text(&ended.stderr));
        assert!(told.starts_with("motor 1 is "), "{what}: {told}{errors}");
    }
}

//! A motor is stopped in time even if nobody reads the output, and whatever signal comes.

use std::fs::File;
use std::io::{self, Read as _, Write as _};
use std::os::fd::AsFd as _;
use std::os::unix::process::ExitStatusExt as _;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use myactuator_protocol_core::wire::rs485::{Fed, Frame, Receiver};
use myactuator_protocol_core::{MotorId, Target};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::Value;

use crate::question::terminal;
use crate::run::{myactuator, tells_of_silence, text, unless_late};
use crate::sim_control::{control, controlled, controlled_on, controlled_with};
use crate::sim_serve::{PATIENCE, done_at};

/// How fast the motor turns.
const DPS: f64 = 90.0;

/// `speed` on this bus, for this time.
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

/// Whether the process catches this signal.
fn catches(process: &Child, signal: Signal) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
    u64::from_str_radix(caught.trim(), 16).unwrap() >> (signal.as_raw() - 1) & 1 != 0
}

/// Waits until the process catches this signal, or has ended. That takes longer on a busy machine.
fn wait_until_it_catches(process: &mut Child, signal: Signal) {
    assert!(comes(|| process.try_wait().unwrap().is_some() || catches(process, signal)));
}

/// Sends the signal, unless the process has ended.
fn signal(process: &mut Child, signal: Signal) {
    wait_until_it_catches(process, signal);
    if process.try_wait().unwrap().is_none() {
        kill_process(Pid::from_child(process), signal).unwrap();
    }
}

/// Waits until this is so, and returns whether it came to that. A busy machine may take long.
fn comes(mut is_so: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    while !is_so() {
        if start.elapsed() > PATIENCE {
            return false;
        }
        sleep(Duration::from_millis(10));
    }
    true
}

/// How the process ends; it must end soon.
fn ends_soon(process: &mut Child) -> ExitStatus {
    let is_over = comes(|| process.try_wait().unwrap().is_some());
    if !is_over {
        process.kill().unwrap();
    }
    let ended = process.wait().unwrap();
    assert!(is_over, "it goes on");
    ended
}

/// The same, with its standard error, which must fit in a pipe.
fn ends_saying(process: &mut Child) -> (ExitStatus, String) {
    let ended = ends_soon(process);
    let mut message = String::new();
    process.stderr.take().unwrap().read_to_string(&mut message).unwrap();
    (ended, message)
}

/// Whether this signal ended it, so that a shell ends its loop, too.
fn died_of(signal: Signal, ended: ExitStatus) -> bool {
    ended.signal() == Some(signal.as_raw())
}

/// Whether it has failed: perhaps a motor did not answer. The error cannot be read here.
fn has_failed(ended: &ExitStatus) -> bool {
    ended.code() == Some(1)
}

/// The state of the one bus and its motor, from the simulation itself, which costs no time on the bus.
fn state(socket: &str) -> Value {
    let message = control(socket, &["--json", "state"]);
    let mut state: Value = serde_json::from_str(&message).unwrap();
    state["ok"]["buses"][0].take()
}

fn angle(socket: &str) -> f64 {
    state(socket)["motors"][0]["angle_deg"].as_f64().unwrap()
}

fn stands(socket: &str) -> bool {
    state(socket)["motors"][0]["speed_dps"].as_f64().unwrap().abs() < 0.5
}

/// Waits until the motor turns, or the process has ended.
fn wait_until_it_turns(socket: &str, process: &mut Child) {
    let turns = || state(socket)["motors"][0]["speed_dps"].as_f64().unwrap() > 0.5 * DPS;
    comes(|| turns() || process.try_wait().unwrap().is_some());
}

#[test]
fn a_full_pipe_lets_the_motor_stop_in_time() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let attempt = || {
        control(socket, &["angle", "--id", "1", "0"]);
        let (_reader, writer) = full_pipe();
        let mut process = speed(simulation.bus("slcan"), "1");
        let mut process = process.stdout(writer).stderr(Stdio::piped()).spawn().unwrap();
        comes(|| angle(socket) > 0.2 * DPS || process.try_wait().unwrap().is_some());
        assert!(comes(|| stands(socket)));
        // The process keeps its result until it is read, or until a signal comes.
        assert!(process.try_wait().unwrap().is_none());
        signal(&mut process, Signal::TERM);
        ends_saying(&mut process)
    };
    let (ended, message) = unless_late(attempt, |(_, message)| tells_of_silence(message));
    assert!(died_of(Signal::TERM, ended), "{ended}: {message}");
    // Tests in virtual time check the second itself; a busy machine takes longer.
    let angle = angle(socket);
    assert!((0.5 * DPS..3.0 * DPS).contains(&angle) && stands(socket), "{angle} deg");
}

#[test]
fn ctrl_c_before_the_reply_is_printed_stops_the_motor_of_send() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let bus = simulation.bus("slcan");
    let attempt = || {
        let (_reader, writer) = full_pipe();
        let mut send = myactuator();
        send.args(["send", "--yes", "--bus", bus, "--id", "1", "speed", "--max-torque-pct", "0"]);
        send.args(["--speed-dps", &DPS.to_string()]).stdin(Stdio::null());
        let mut process = send.stdout(writer).stderr(Stdio::piped()).spawn().unwrap();
        wait_until_it_turns(socket, &mut process);
        // The process has the reply, and waits to print it.
        sleep(Duration::from_millis(300));
        signal(&mut process, Signal::INT);
        ends_saying(&mut process)
    };
    let (ended, message) = unless_late(attempt, |(_, message)| tells_of_silence(message));
    assert!(died_of(Signal::INT, ended), "{ended}: {message}");
    assert!(stands(socket));
}

#[test]
fn a_reader_that_was_killed_stops_the_motor() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let attempt = || {
        let mut speed = speed(simulation.bus("slcan"), "60");
        let mut process = speed.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        wait_until_it_turns(socket, &mut process);
        drop(process.stdout.take());
        ends_saying(&mut process)
    };
    let (ended, message) = unless_late(attempt, |(_, message)| tells_of_silence(message));
    assert_eq!(ended.code(), Some(1), "{message}");
    assert!(stands(socket));
}

#[test]
fn slow_reader_gets_the_result_late() {
    let (mut reader, writer) = full_pipe();
    let mut process = speed("sim:1", "20").stdout(writer).stderr(Stdio::null()).spawn().unwrap();
    sleep(Duration::from_millis(500));
    let reading = std::thread::spawn(move || {
        let mut message = String::new();
        reader.read_to_string(&mut message).unwrap();
        message
    });
    assert_eq!(process.wait().unwrap().code(), Some(0));
    let message = reading.join().unwrap();
    assert!(
        message.ends_with("motor 1 has run for 20 s; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that\n")
    );
}

/// A script must not go on as if the answer had been read.
#[test]
fn command_whose_output_cannot_be_written_fails() {
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut read = myactuator();
    read.args(["send", "--bus", "sim:1", "--id", "1", "read-multi-turn-angle"]);
    let output = read.stdin(Stdio::null()).stdout(full).stderr(Stdio::piped()).output().unwrap();
    let errors = text(&output.stderr);
    assert!(errors.contains("error: cannot write: "), "{errors}");
    assert!(errors.ends_with("; the command itself is done\n"), "{errors}");
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn signals_stop_the_motor_first_though_both_output_pipes_are_full() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let bus = simulation.bus("slcan");
    let (int, none) = (Signal::INT, None);
    for (kind, dies_of, code) in [
        (Signal::TERM, Some(Signal::TERM), none),
        (Signal::HUP, Some(Signal::HUP), none),
        // The other keys end a shell's loop, too. The process is not halted, since it keeps the bus.
        (Signal::QUIT, Some(int), none),
        (Signal::TSTP, Some(int), none),
        (Signal::TTOU, Some(int), none),
        // A signal that may be ignored elsewhere.
        (Signal::IO, None, Some(128 + 29)),
    ] {
        let attempt = || {
            let (out, err) = (full_pipe(), full_pipe());
            let mut process = speed(bus, "60").stdout(out.1).stderr(err.1).spawn().unwrap();
            wait_until_it_turns(socket, &mut process);
            signal(&mut process, kind);
            ends_soon(&mut process)
        };
        let ended = unless_late(attempt, has_failed);
        let expected = (dies_of.map(Signal::as_raw), code);
        assert_eq!((ended.signal(), ended.code()), expected, "{kind:?}");
        assert!(stands(socket), "{kind:?}");
    }
}

/// The signals of these keys reach the script, too, which goes on after all but that of Ctrl-C.
#[test]
fn every_key_that_stops_a_motor_ends_the_loop_of_a_script() {
    let (_folder, path, simulation) = controlled(2);
    let socket = path.to_str().unwrap();
    let move_both = format!(
        "for id in 1 2; do {} speed --yes --bus {} --id $id --speed-dps {DPS} --for-s 60; done",
        env!("CARGO_BIN_EXE_myactuator"),
        simulation.bus("slcan"),
    );
    for (name, key) in [("Ctrl-C", 3), ("Ctrl-\\", 0x1C), ("Ctrl-Z", 0x1A)] {
        let attempt = || {
            let (mut keys, terminal) = terminal();
            // In a session of its own, whose terminal this is.
            let mut script = Command::new("setsid");
            script.args(["--ctty", "--wait", "bash", "-c", &move_both]).stdin(terminal);
            let mut script = script.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
            wait_until_it_turns(socket, &mut script);
            keys.write_all(&[key]).unwrap();
            ends_saying(&mut script)
        };
        let (ended, message) = unless_late(attempt, |(_, message)| tells_of_silence(message));
        assert!(died_of(Signal::INT, ended), "{name}: {ended} {message}");
        assert_eq!(state(socket)["motors"][1]["angle_deg"], 0.0, "{name}: the next motor moved");
    }
}

#[test]
fn ctrl_c_while_the_motor_comes_to_rest_waits_for_the_hold() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let bus = simulation.bus("slcan");
    // From 540 dps it takes 5.4 s, and 1458 degrees.
    let slowly = "write-acceleration --index speed-deceleration --acceleration-dps2 100";
    let send: Vec<_> =
        ["send", "--yes", "--id", "1"].into_iter().chain(slowly.split(' ')).collect();
    done_at(bus, &send);
    let attempt = || {
        control(socket, &["angle", "--id", "1", "0"]);
        let mut turn = myactuator();
        turn.args(["speed", "--yes", "--bus", bus, "--id", "1", "--speed-dps", "540"]);
        turn.args(["--for-s", "1"]).stdin(Stdio::null()).stdout(Stdio::null());
        let mut process = turn.stderr(Stdio::piped()).spawn().unwrap();
        // A second at full speed is the smaller part of that.
        comes(|| angle(socket) > 900.0 || process.try_wait().unwrap().is_some());
        signal(&mut process, Signal::INT);
        let ended = process.wait_with_output().unwrap();
        (text(&ended.stderr).to_owned(), ended.status)
    };
    let (message, ended) = unless_late(attempt, |(message, _)| tells_of_silence(message));
    assert_eq!(
        message,
        "error: interrupted; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that\n"
    );
    assert!(died_of(Signal::INT, ended), "{ended}");
    assert!(stands(socket));
}

/// Presses Ctrl-C once this is so, unless the process has ended. Returns how it ended.
fn interrupted(command: &mut Command, mut is_so: impl FnMut() -> bool) -> Output {
    let command = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut process = command.spawn().unwrap();
    comes(|| is_so() || process.try_wait().unwrap().is_some());
    signal(&mut process, Signal::INT);
    process.wait_with_output().unwrap()
}

#[test]
fn stop_goes_on_though_ctrl_c_is_pressed() {
    let (_folder, path, simulation) = controlled_on("rs485", 1);
    let socket = path.to_str().unwrap();
    let mut stop = myactuator();
    // It retries for a second: no motor has this id.
    stop.args(["stop", "--id", "7", "--bus", simulation.bus("rs485")]);
    let ended = interrupted(&mut stop, || state(socket)["traffic"]["frames"] != 0);
    let message = text(&ended.stderr);
    assert!(
        message.contains("no confirmation of the stop from motor 7"),
        "{}: {message}",
        ended.status
    );
    assert!(died_of(Signal::INT, ended.status), "{}", ended.status);
}

#[test]
fn writes_are_finished_though_ctrl_c_is_pressed() {
    let (_folder, path, simulation) = controlled_with("rs485", 1, &["--quirk", "slow-boot"]);
    let socket = path.to_str().unwrap();
    let bus = simulation.bus("rs485");
    // A stored zero, like an id, takes effect at the next start: the motor restarts for that, which takes a second.
    let restarts = || state(socket)["motors"][0]["running"] == false;
    assert!(comes(|| !restarts()));
    let attempt = |what: &[&str]| {
        interrupted(myactuator().args(what).args(["--yes", "--id", "1", "--bus", bus]), restarts)
    };
    for (what, done) in [
        (&["zero"][..], "is the zero"),
        (&["reset"], "has restarted"),
        (&["id", "--new-id", "7"], "motor 1 is motor 7 now"),
    ] {
        let ended = unless_late(|| attempt(what), |it| tells_of_silence(text(&it.stderr)));
        let (message, errors) = (text(&ended.stdout), text(&ended.stderr));
        assert!(message.contains(done), "{}: {message}{errors}", ended.status);
        // The user is told why it goes on, and a shell's loop does not go on to the next motor.
        let why = "note: interrupted: this command is finished first, so that nothing is left half written\n";
        assert_eq!(errors, why, "{what:?}: {} {message}", ended.status);
        assert!(died_of(Signal::INT, ended.status), "{what:?}: {}", ended.status);
    }
}

/// What motor 1 answers on a line, until it hears this command.
fn hear_on_line(line: &mut File, command: u8) {
    let mut receiver = Receiver::new();
    loop {
        let mut byte = [0];
        line.read_exact(&mut byte).unwrap();
        let Fed::Frame(Frame { address, data }) = receiver.feed(byte[0]) else { continue };
        let answer = match data[0] {
            first if first == command => return,
            // 48 V, and no error.
            0x9A => [0x9A, 30, 30, 0, 0xE0, 0x01, 0, 0],
            // A temperature, and a run time or an angle.
            first @ (0x9C | 0x9D) => [first, 30, 0, 0, 0, 0, 0, 0],
            first => [first, 0, 0, 0, 0, 0, 1, 0],
        };
        line.write_all(&Frame { address, data: answer }.encode()).unwrap();
    }
}

/// The motor answers only after the signal. Without that answer nobody knows whether it has stored its protection.
#[test]
fn protection_that_is_being_written_is_finished_though_ctrl_c_is_pressed() {
    let attempt = || {
        let line = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&line).unwrap();
        unlockpt(&line).unwrap();
        let path = ptsname(&line, Vec::new()).unwrap().into_string().unwrap();
        let mut line = File::from(line);
        let mut timeout = myactuator();
        timeout.args(["timeout", "--yes", "--id", "1", "--time-ms", "500"]);
        timeout.args(["--bus", &format!("rs485:{path}@115200")]).stdin(Stdio::null());
        let mut process = timeout.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        hear_on_line(&mut line, 0xB3);
        assert!(catches(&process, Signal::INT), "it would end here");
        kill_process(Pid::from_child(&process), Signal::INT).unwrap();
        // 2.31: the motor sends the command back.
        let data = [0xB3, 0, 0, 0, 0xF4, 0x01, 0, 0];
        let address = Target::Motor(MotorId::MIN);
        line.write_all(&Frame { address, data }.encode()).unwrap();
        let ended = ends_soon(&mut process);
        let output = process.wait_with_output().unwrap();
        (ended, text(&output.stdout).to_owned(), text(&output.stderr).to_owned())
    };
    let (ended, message, errors) = unless_late(attempt, |(.., errors)| tells_of_silence(errors));
    assert_eq!(
        message,
        "motor 1 cuts its output when it hears nothing for 500 ms: try it before you rely on it\n",
        "{errors}"
    );
    let why =
        "note: interrupted: this command is finished first, so that nothing is left half written\n";
    assert_eq!(errors, why);
    assert!(died_of(Signal::INT, ended), "{ended}");
}

/// The stop once gave up, because the bus had carried nothing during the suspension.
#[test]
fn stop_of_a_suspended_program_goes_on_when_it_continues() {
    let (_folder, path, simulation) = controlled(1);
    let socket = path.to_str().unwrap();
    let bus = simulation.bus("slcan");
    for what in ["stop", "shutdown"] {
        control(socket, &["fault", "cut"]);
        let suspended = || {
            let mut stop = myactuator();
            stop.args([what, "--bus", bus]).stdin(Stdio::null());
            let begun = Instant::now();
            let mut process = stop.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
            wait_until_it_catches(&mut process, Signal::INT);
            // It has found that no motor answers, and retries.
            sleep(Duration::from_millis(300));
            kill_process(Pid::from_child(&process), Signal::STOP).unwrap();
            if begun.elapsed() < Duration::from_secs(1) {
                return Some(process);
            }
            // It may have given up before: it may after a second.
            process.kill().unwrap();
            process.wait().unwrap();
            None
        };
        let process = (0..20).find_map(|_| suspended()).expect("one that has not given up");
        sleep(Duration::from_secs(2));
        control(socket, &["fault", "mend"]);
        kill_process(Pid::from_child(&process), Signal::CONT).unwrap();
        let ended = process.wait_with_output().unwrap();
        let (message, errors) = (text(&ended.stdout), text(&ended.stderr));
        assert!(message.starts_with("motor 1 is "), "{what}: {message}{errors}");
    }
}

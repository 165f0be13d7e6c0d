//! `myactuator sim`, used as other programs use it: through its pseudo-terminals.

use std::cell::Cell;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Child, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use myactuator_host_std::open::{AnyMaster, BusAddress};
use myactuator_protocol_core::command::{
    AnyReply, ErrorFlags, MultiTurnAngle, ReadSingleTurnAngle, ReadVersionDate,
};
use myactuator_protocol_core::io::Runner as _;
use myactuator_protocol_core::master::{Config, MotorSet};
use myactuator_protocol_core::time::Duration as BusTime;
use myactuator_protocol_core::wire::rs485::Frame;
use myactuator_protocol_core::{AnyCommand, Firmware, MotorId, Target};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, kill_process, setpriority_process};
use serde_json::Value;
use serial2::SerialPort;

use crate::run::{myactuator, run, tells_of_silence, text, unless_late};

/// Longer than anything takes on a busy machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);

/// Simulations keep real time. Several at once on a busy machine would fall behind.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Waits until no other simulation runs. None starts while the guard is kept.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Gives a simulation priority over other processes if that is allowed. Programs give up on a motor that does not
/// answer within a tenth of a second, and a busy machine may take longer.
pub(crate) fn prefer(simulation: &Child) {
    let _ = setpriority_process(Some(Pid::from_child(simulation)), -15);
}

/// A simulation in a process of its own.
pub(crate) struct Simulation {
    process: Child,
    /// What it printed, by kind.
    places: Vec<Value>,
    _alone: MutexGuard<'static, ()>,
}

impl Simulation {
    /// Starts one that serves in this many ways.
    pub(crate) fn start(ways: usize, arguments: &[&str]) -> Self {
        let alone = alone();
        let process = myactuator()
            .args(["sim", "--json"])
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        prefer(&process);
        // From here on it ends with its owner.
        let mut simulation = Self { process, places: Vec::new(), _alone: alone };
        let lines = BufReader::new(simulation.process.stdout.take().unwrap()).lines();
        simulation.places =
            lines.take(ways).map(|line| serde_json::from_str(&line.unwrap()).unwrap()).collect();
        assert_eq!(simulation.places.len(), ways);
        simulation
    }

    /// What it printed about the bus of this name.
    pub(crate) fn named(&self, name: &str) -> &Value {
        self.places.iter().find(|place| place["name"] == name).unwrap()
    }

    pub(crate) fn place(&self, kind: &str) -> &Value {
        self.places.iter().find(|place| place["kind"] == kind).unwrap()
    }

    /// Its address.
    pub(crate) fn bus(&self, kind: &str) -> &str {
        self.place(kind)["bus"].as_str().unwrap()
    }

    /// A serial port to what it serves.
    fn open(&self, kind: &str) -> SerialPort {
        let path = self.place(kind)["path"].as_str().unwrap();
        let rate: u32 = self.place(kind)["bit_rate"].as_u64().unwrap().try_into().unwrap();
        let mut port = SerialPort::open(path, rate).unwrap();
        port.set_read_timeout(PATIENCE).unwrap();
        port
    }

    /// Sends a signal. Returns how it ended and its errors.
    pub(crate) fn end(mut self, signal: Signal) -> (ExitStatus, String) {
        kill_process(Pid::from_child(&self.process), signal).unwrap();
        let mut message = String::new();
        self.process.stderr.take().unwrap().read_to_string(&mut message).unwrap();
        // A busy machine is not an error.
        let message = message.lines().filter(|line| !line.contains("time stood still"));
        let message = message.map(|line| format!("{line}\n")).collect();
        (self.process.wait().unwrap(), message)
    }
}

impl Drop for Simulation {
    fn drop(&mut self) {
        // It has ended already, unless a test has failed.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn read_exactly<const N: usize>(port: &SerialPort) -> [u8; N] {
    let (mut bytes, mut length) = ([0; N], 0);
    while length < N {
        length += port.read(&mut bytes[length..]).expect("an answer");
    }
    bytes
}

/// A command to motor 1.
fn frame(command: impl Into<AnyCommand>) -> [u8; 13] {
    let packet = command.into().packet(Target::Motor(MotorId::MIN)).unwrap();
    Frame::from_packet(&packet).unwrap().encode()
}

/// The next reply, from a drive with this firmware.
fn answer(port: &SerialPort, firmware: Firmware) -> AnyReply {
    let bytes: [u8; 13] = read_exactly(port);
    let frame = Frame::decode(&bytes).unwrap_or_else(|fault| panic!("{bytes:02X?}: {fault}"));
    AnyReply::decode(&frame.as_reply().unwrap(), firmware).unwrap()
}

fn ask(port: &SerialPort, command: impl Into<AnyCommand>) -> AnyReply {
    port.write_all(&frame(command)).unwrap();
    answer(port, Firmware::V4_3)
}

/// The output of a search at all bit rates; of each motor only the beginning.
fn scan_once_at_all_rates(bus: &str) -> Vec<String> {
    let output = run(&["scan", "--all-rates", "--bus", bus]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let lines = text(&output.stdout).lines().map(|line| line.split(" model").next().unwrap());
    lines.map(str::to_owned).collect()
}

/// Whether the line of a motor is incomplete, because the motor did not answer everything.
fn is_short(lines: &[String]) -> bool {
    lines.iter().any(|line| line.starts_with("motor") && !line.ends_with(':'))
}

/// The same, where it may be done again.
fn scan_at_all_rates(bus: &str) -> Vec<String> {
    unless_late(|| scan_once_at_all_rates(bus), |lines| is_short(lines))
}

/// 2.32: motor 2 is set to another rate, which takes effect with the next run.
#[test]
fn motor_set_to_another_rate_is_found_at_that_rate() {
    let folder = tempfile::tempdir().unwrap();
    let memory = folder.path().join("memory");
    let arguments = ["--count", "2", "--memory", memory.to_str().unwrap()];
    let answers =
        |bus: &str, id| run_at(bus, &["send", "--id", id, "read-multi-turn-angle"]).0 == Some(0);
    let first = Simulation::start(2, &arguments);
    for (kind, rate) in [("slcan", "can-500k-rs485-115200"), ("rs485", "can-1m-rs485-500k")] {
        let set = ["send", "--yes", "--id", "2", "set-baud-rate", "--baud-rate", rate];
        done_at(first.bus(kind), &set);
        assert!(answers(first.bus(kind), "2"));
    }
    assert_eq!(first.end(Signal::INT), ended_well());

    let second = Simulation::start(2, &arguments);
    let scans = Cell::new(0);
    let scan = || {
        scans.set(scans.get() + 1);
        scan_once_at_all_rates(second.bus("slcan"))
    };
    assert_eq!(
        unless_late(scan, |lines| is_short(lines)),
        ["1000000 bit/s: 1 motor", "motor 1:", "500000 bit/s: 1 motor", "motor 2:"]
    );
    let fast = second.bus("rs485");
    let slow = fast.replace("@1000000", "@500000");
    let both = [fast, &slow];
    assert_eq!(both.map(|bus| answers(bus, "1")), [true, false]);
    assert_eq!(both.map(|bus| answers(bus, "2")), [false, true]);
    let (status, message) = second.end(Signal::INT);
    assert!(status.success());
    let beginnings: Vec<&str> =
        message.lines().map(|line| line.split(',').next().unwrap()).collect();
    let (drives, programs) = beginnings.split_at(2);
    let of =
        |bus: &str| format!("note: motor 2 of the bus \"{bus}\" was set to 500000 bit/s (0xB4)");
    assert_eq!(drives, ["rs485", "can"].map(of));
    // In each search, and twice on the line: not where the one before had the same rate.
    assert_eq!(programs, vec!["note: a program speaks at 500000 bit/s"; scans.get() + 2]);
}

#[test]
fn search_goes_on_where_no_motor_has_the_adapters_rate() {
    let arguments = ["--only", "slcan", "--count", "1", "--bit-rate", "500000"];
    let simulation = Simulation::start(1, &arguments);
    assert_eq!(
        scan_at_all_rates(simulation.bus("slcan")),
        ["1000000 bit/s: no motor", "500000 bit/s: 1 motor", "motor 1:"]
    );
}

#[test]
fn a_line_is_searched_at_all_its_rates() {
    let arguments = ["--only", "rs485", "--count", "1", "--rs485-rate", "2500000"];
    let simulation = Simulation::start(1, &arguments);
    let nobody =
        ["115200", "500000", "1000000", "1500000"].map(|it| format!("{it} bit/s: no motor"));
    let found = scan_at_all_rates(simulation.bus("rs485"));
    assert_eq!(found[..4], nobody);
    assert_eq!(found[4..], ["2500000 bit/s: 1 motor", "motor 1:"]);
}

#[test]
fn motor_with_its_output_cut_is_not_reported_holding() {
    let simulation =
        Simulation::start(1, &["--only", "slcan", "--count", "2", "--fault", "stall@2"]);
    let (status, message) = run_at(simulation.bus("slcan"), &["stop"]);
    assert_eq!(
        message,
        "error: motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that; motor 2 has confirmed the stop (0x81) but reports an error \
         (motor stalled), for which a drive cuts its output: only a locked brake holds its shaft; no other id has \
         confirmed: a motor that is not named here may go on\n"
    );
    assert_eq!(status, Some(1));
}

#[test]
fn programs_need_not_set_anything_on_the_port() {
    let simulation = Simulation::start(1, &["--only", "rs485"]);
    let path = simulation.place("rs485")["path"].as_str().unwrap();
    let mut port = File::options().read(true).write(true).open(path).unwrap();
    // 2.33.4. A terminal that is not raw would echo it and wait for the end of a line.
    port.write_all(b"\x3E\x01\x08\xB5\0\0\0\0\0\0\0\x30\x42").unwrap();
    let limit = Timespec::try_from(PATIENCE).unwrap();
    let answered = poll(&mut [PollFd::new(&port, PollFlags::IN)], Some(&limit)).unwrap();
    assert_eq!(answered, 1, "no answer");
    let mut reply = [0; 13];
    port.read_exact(&mut reply).unwrap();
    assert_eq!(&reply[..11], b"\x3E\x01\x08\xB5X6-60\0\0");
    // Nothing was echoed before it.
    let at_once = Timespec::default();
    assert_eq!(poll(&mut [PollFd::new(&port, PollFlags::IN)], Some(&at_once)).unwrap(), 0);
    drop(port);
    assert_eq!(simulation.end(Signal::INT), ended_well());
}

pub(crate) fn ended_well() -> (ExitStatus, String) {
    (ExitStatus::default(), String::new())
}

/// The answer of the adapter up to the next CR or BEL.
fn line(port: &SerialPort) -> String {
    let mut line = String::new();
    loop {
        let [byte] = read_exactly(port);
        line.push(char::from(byte));
        if byte == b'\r' || byte == 0x07 {
            return line;
        }
    }
}

#[test]
fn the_slcan_adapter_answers_and_carries_frames() {
    let simulation = Simulation::start(1, &["--only", "slcan", "--bit-rate", "500000"]);
    let port = simulation.open("slcan");
    let say = |text: &str| {
        port.write_all(text.as_bytes()).unwrap();
        line(&port)
    };
    assert_eq!(say("V\r"), "V1013\r");
    for message in ["S8\r", "O\r", "C\r", "S6\r", "O\r"] {
        assert_eq!(say(message), "\r");
    }
    // 2.30.4: 0xB2 asks for the version; the reply repeats the command byte.
    assert_eq!(say("t1418B200000000000000\r"), "z\r");
    let reply = line(&port);
    assert!(reply.starts_with("t2418B2000000") && reply.len() == 22, "{reply:?}");
    // 5: motion mode is answered on 0x501 with the motor's id first.
    assert_eq!(say("t40187FFF7FF0000007FF\r"), "z\r");
    let reply = line(&port);
    assert!(reply.starts_with("t501801") && reply.len() == 22, "{reply:?}");
    let (status, message) = simulation.end(Signal::TERM);
    assert!(status.success());
    assert_eq!(
        message,
        "note: a program speaks at 1000000 bit/s, but the simulated bus \"can\" runs at 500000: only drives that \
         were set to its rate (0xB4) understand it; for the others set it to 500000, or start with --bit-rate \
         1000000\n"
    );
}

/// For a machine that is busy with other things.
fn forgiving(config: Config) -> Config {
    Config { reply_timeout: BusTime::from_millis(250), attempts: 15, ..config }
}

#[test]
fn masters_reach_all_motors_by_the_printed_addresses_on_both_buses() {
    let folder = tempfile::tempdir().unwrap();
    let links = folder.path().join("buses");
    let options = ["--quirk", "echo-noise", "--count", "3", "--link", links.to_str().unwrap()];
    let simulation = Simulation::start(2, &options);
    let motors: MotorSet = MotorId::all().take(3).collect();
    // Programs come and go. The last answers to one may reach the next if it comes at once. So a single program asks
    // here, as on real adapters.
    for kind in ["rs485", "rs485", "slcan"] {
        let place = simulation.place(kind);
        assert_eq!(place["motors"], serde_json::json!([1, 2, 3]));
        // The address is that of a link to the pseudo-terminal.
        let link = links.join(kind);
        assert_eq!(place["link"], link.to_str().unwrap());
        assert_eq!(std::fs::read_link(&link).unwrap(), Path::new(place["path"].as_str().unwrap()));
        let address: BusAddress = simulation.bus(kind).parse().unwrap();
        assert!(address.to_string().contains(link.to_str().unwrap()), "{address}");
        let config = forgiving(address.config());
        let attempt = || {
            let mut master = AnyMaster::<4>::open_with(&address, config).unwrap();
            let asked = motors.iter().cycle().take(30);
            let message = asked.map(|motor| master.ask(motor, ReadVersionDate).ok());
            let message = message.map(|date| Firmware::of_version_date(date?.version_date));
            message.collect::<Vec<_>>()
        };
        // An echo that comes a tenth of a second late counts as an answer.
        let message = unless_late(attempt, |message| message.contains(&None));
        assert_eq!(message, [Some(Firmware::V4_3); 30]);
    }
    assert_eq!(simulation.end(Signal::INT), ended_well());
    assert_eq!(std::fs::read_dir(links).unwrap().count(), 0);
}

/// Runs the program on a bus. Returns its exit status and its output.
pub(crate) fn run_at(bus: &str, arguments: &[&str]) -> (Option<i32>, String) {
    let attempt = || {
        let output = run(&[arguments, &["--bus", bus]].concat());
        let message = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8(message).unwrap())
    };
    unless_late(attempt, |(_, message)| tells_of_silence(message))
}

/// The output of the program, which must succeed.
pub(crate) fn done_at(bus: &str, arguments: &[&str]) -> String {
    let (status, message) = run_at(bus, arguments);
    assert_eq!(status, Some(0), "{message}");
    message
}

/// A value that `status` reports of motor 1.
fn state(bus: &str, key: &str) -> f64 {
    let message = done_at(bus, &["status", "--json", "--id", "1"]);
    let status: Value = serde_json::from_str(message.lines().next().unwrap()).unwrap();
    status[key].as_f64().unwrap_or_else(|| panic!("{message}"))
}

#[test]
fn drives_remember_their_turns_over_runs() {
    use myactuator_protocol_core::command::{
        AbsolutePosition, FunctionControl, ReadMultiTurnAngle, Switch,
    };
    use myactuator_protocol_core::units::{Angle, MaxSpeed};

    let folder = tempfile::tempdir().unwrap();
    let memory = folder.path().join("memory");
    let arguments = ["--only", "rs485", "--count", "1", "--memory", memory.to_str().unwrap()];
    let degrees = |port: &SerialPort| match ask(port, ReadMultiTurnAngle) {
        AnyReply::ReadMultiTurnAngle(MultiTurnAngle { angle }) => angle.degrees(),
        other => panic!("{other:?}"),
    };

    let first = Simulation::start(1, &arguments);
    ask(&first.open("rs485"), FunctionControl::SaveMultiTurn(Switch::On));
    assert_eq!(first.end(Signal::INT), ended_well());

    let second = Simulation::start(1, &arguments);
    let port = second.open("rs485");
    let target = Angle::from_degrees(720.0).unwrap();
    let max_speed = MaxSpeed::from_dps(720.0).unwrap();
    ask(&port, AbsolutePosition { max_speed, angle: target });
    let limit = Instant::now() + PATIENCE;
    while (degrees(&port) - 720.0).abs() > 1.0 {
        assert!(Instant::now() < limit, "{} deg", degrees(&port));
    }
    assert_eq!(second.end(Signal::TERM), ended_well());

    let third = Simulation::start(1, &arguments);
    let found = degrees(&third.open("rs485"));
    // Nothing held the shaft for a moment.
    assert!((found - 720.0).abs() < 90.0, "{found} deg");
    assert_eq!(third.end(Signal::INT), ended_well());
}

#[test]
fn faults_and_quirks_are_those_of_the_options() {
    use myactuator_protocol_core::command::ReadStatus1;

    let faults = ["--fault", "encoder-data@1", "--quirk", "echo", "--brakes", "--seed", "7"];
    let simulation = Simulation::start(1, &[&["--only", "rs485"], &faults[..]].concat());
    assert!(simulation.bus("rs485").ends_with("@1000000,echo"));
    let port = simulation.open("rs485");
    let command = frame(ReadVersionDate);
    port.write_all(&command).unwrap();
    assert_eq!(read_exactly::<13>(&port), command);
    assert_eq!(read_exactly::<13>(&port)[..4], [0x3E, 1, 8, 0xB2]);
    port.write_all(&frame(ReadStatus1)).unwrap();
    read_exactly::<13>(&port);
    let AnyReply::ReadStatus1(status) = answer(&port, Firmware::V4_3) else { panic!() };
    assert_eq!(status.errors, ErrorFlags::ENCODER_DATA);
    drop(port);
    assert_eq!(simulation.end(Signal::INT), ended_well());
}

#[test]
fn two_motors_of_one_id_are_refused_by_all_commands_that_write() {
    let simulation = Simulation::start(1, &["--only", "slcan", "--count", "2", "--same-id", "1"]);
    let bus = simulation.bus("slcan");
    let (status, message) = run_at(bus, &["id", "--id", "1", "--new-id", "7", "--yes"]);
    assert_eq!(status, Some(1), "{message}");
    assert!(message.contains("two motors seem to have id 1"), "{message}");
    // Sometimes two equal answers become one frame.
    let is_told = |_| run_at(bus, &["scan"]).1.contains("note: two motors seem to have id 1");
    assert!((0..3).any(is_told));
    // Nothing else is written to them either, and their shafts are not let go.
    let changes = [
        "zero",
        "timeout --time-ms 1000",
        "reset",
        "brake release",
        "send reset",
        "send release-brake",
    ];
    for change in changes {
        let words: Vec<&str> = change.split(' ').chain(["--id", "1", "--yes"]).collect();
        let (status, message) = run_at(bus, &words);
        assert_eq!(status, Some(1), "{change}: {message}");
        assert!(message.contains("error: two motors seem to have id 1"), "{change}: {message}");
    }
    // Commands that move are not refused, and get only a check that costs no time.
    let turn = ["speed", "--id", "1", "--speed-dps", "5", "--for-s", "0.1", "--yes"];
    let both = "note: two motors seem to have id 1: connect only one of them. Both will do this";
    assert!((0..3).any(|_| run_at(bus, &turn).1.contains(both)));
    let turn = ["send", "speed", "--speed-dps", "5", "--max-torque-pct", "0", "--id", "1", "--yes"];
    assert!((0..3).any(|_| run_at(bus, &turn).1.contains(both)));
    let read = run_at(bus, &["send", "read-version-date", "--id", "1"]).1;
    assert!(!read.contains("two motors"), "{read}");
    drop(simulation);
    let simulation = Simulation::start(1, &["--only", "slcan", "--count", "2"]);
    let message = done_at(simulation.bus("slcan"), &["scan"]);
    assert!(message.contains("motor 2:") && !message.contains("note"), "{message}");
}

/// The echo of a stop is the same bytes as its confirmation.
#[test]
fn an_echo_that_the_address_does_not_name_is_known_before_the_first_command() {
    let options = ["--only", "rs485", "--count", "1", "--quirk", "echo-noise", "--seed", "7"];
    let simulation = Simulation::start(1, &options);
    let bus = simulation.bus("rs485").strip_suffix(",echo").unwrap();
    let (status, message) = run_at(bus, &["stop", "--id", "2"]);
    assert_eq!(status, Some(1), "{message}");
    done_at(bus, &["stop", "--id", "1"]);
}

#[test]
fn firmware_is_that_of_the_option() {
    let v4_4 = ["--firmware", "v4.4", "--ranges", "12.566,45,500,5,60", "--count", "1"];
    let simulation = Simulation::start(1, &[&["--only", "rs485"], &v4_4[..]].concat());
    let port = simulation.open("rs485");
    // The command is the same in both; V4.4 answers it with another layout.
    port.write_all(&frame(ReadSingleTurnAngle)).unwrap();
    let message = answer(&port, Firmware::V4_4);
    assert!(matches!(message, AnyReply::ReadSingleTurnAngleV4_4(_)), "{message:?}");
    let AnyReply::ReadVersionDate(message) = ask(&port, ReadVersionDate) else { panic!() };
    assert_eq!(Firmware::of_version_date(message.version_date), Some(Firmware::V4_4));
}

/// The exit status and the standard error.
fn refused(arguments: &[&str]) -> (Option<i32>, String) {
    let output = run(&[&["sim"], arguments].concat());
    assert_eq!(output.stdout, b"");
    (output.status.code(), text(&output.stderr).to_owned())
}

#[test]
fn wrong_options_are_refused_in_one_sentence() {
    for (arguments, sentence) in [
        (&["--count", "33"][..], "33 is not in 1..=32"),
        (&["--model", "RMD-Z9"], "--model: no motor model is called \"RMD-Z9\"; there are RMD-"),
        (&["--model", "no/such.toml"], "--model: the model's file \"no/such.toml\" cannot be read"),
        (&["--firmware", "v4.4"], "--ranges is missing: "),
        (
            &["--firmware", "v5"],
            "--firmware: firmware must be one of v4.3 v4.4, but \"v5\" was given",
        ),
        (&["--quirk", "slow"], "--quirk: expected one of slow-boot, slow-brake"),
        (&["--fault", "loose"], "--fault: expected lose, corrupt"),
        (&["--fault", "lose=2"], "--fault: expected a chance from 0 to 1"),
        (&["--fault", "cut@5"], "--fault names motor 5, but the motors are 1 2 3 4"),
        (&["--fault", "cut@2", "--same-id", "1"], "--fault names motor 2, but the motors are 1"),
        (&["--bit-rate", "123456"], "--bit-rate: expected a bit rate that SLCAN adapters know"),
        (&["--rs485-rate", "0"], "--rs485-rate: expected a bit rate from 1200"),
        (&["--only", "can"], "--only can needs --can"),
        (&["--only", "slcan", "--can", "vcan0"], "drop one of them"),
    ] {
        let (status, message) = refused(arguments);
        assert_eq!(status, Some(2), "{arguments:?}: {message}");
        assert!(
            message.starts_with("error: ") && message.contains(sentence),
            "{arguments:?}: {message}"
        );
        assert_eq!(message.lines().count(), 1, "{arguments:?}: {message}");
    }
}

#[test]
fn interface_that_cannot_be_served_is_reported() {
    let (status, message) = refused(&["--can", "no-such-can"]);
    assert_eq!(status, Some(1));
    assert!(message.starts_with("error: ") && message.contains("CAN"), "{message}");
}

#[test]
fn the_programs_own_subcommands_work_on_both_pseudo_terminals() {
    let simulation = Simulation::start(2, &["--count", "2"]);
    for kind in ["rs485", "slcan"] {
        let bus = simulation.bus(kind);
        let message = done_at(bus, &["scan"]);
        assert!(message.contains("motor 1:") && message.contains("motor 2:"), "{message}");

        // There is no terminal to ask on, so motion needs --yes.
        let to_20 = ["move", "--id", "1", "--angle-deg", "20", "--max-speed-dps", "360"];
        assert_eq!(run_at(bus, &to_20).0, Some(2));
        done_at(bus, &[&to_20[..], &["--yes"]].concat());
        let angle = state(bus, "angle_deg");
        assert!((angle - 20.0).abs() < 0.5, "{angle}");
    }
}

#[test]
fn ctrl_c_stops_the_motor_that_runs() {
    let simulation = Simulation::start(2, &["--count", "1"]);
    let bus = simulation.bus("rs485");
    let attempt = || {
        let mut speed = myactuator();
        speed.args(["speed", "--yes", "--id", "1", "--speed-dps", "90", "--for-s", "1000"]);
        speed.args(["--bus", bus]).stdin(Stdio::null());
        let mut process = speed.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // Its first line comes when the motor runs.
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let first = lines.next();
        kill_process(Pid::from_child(&process), Signal::INT).unwrap();
        let output = process.wait_with_output().unwrap();
        (first, output.status, String::from_utf8(output.stderr).unwrap())
    };
    let (first, status, message) = unless_late(attempt, |(.., message)| tells_of_silence(message));
    assert!(first.is_some_and(|line| line.is_ok()));
    assert_eq!(status.signal(), Some(Signal::INT.as_raw()), "{message}");
    assert_eq!(
        message,
        "error: interrupted; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that\n"
    );
    // It slows down first.
    assert!((0..100).any(|_| state(bus, "speed_dps") == 0.0), "the motor still turns");
}

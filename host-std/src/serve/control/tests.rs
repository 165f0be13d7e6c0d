use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread::JoinHandle;

use serde_json::Value;

use super::*;
use crate::serve::{ServeError, Server};
use crate::sim::Fleet;
use crate::sim::mechanics::{Failure, Mechanics, Shaft};
use crate::sim::plant::Supply;

/// Longer than anything takes on a busy machine that ends at all.
const LONG: std::time::Duration = std::time::Duration::from_secs(60);

/// A server in a thread, which ends with this.
struct Served {
    stop: Option<UnixStream>,
    thread: Option<JoinHandle<Result<(), ServeError>>>,
    folder: tempfile::TempDir,
}

impl Served {
    fn start(prepare: impl FnOnce(&mut Server) + Send + 'static) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let (stop, reported) = UnixStream::pair().unwrap();
        let (ready, is_ready) = std::sync::mpsc::channel();
        let thread = std::thread::spawn(move || {
            let mut server = Server::new();
            prepare(&mut server);
            server.control_at(&path).unwrap();
            ready.send(()).unwrap();
            server.run(reported, |_| {})
        });
        is_ready.recv().unwrap();
        Self { stop: Some(stop), thread: Some(thread), folder }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("control")
    }

    fn client(&self) -> Client {
        let stream = UnixStream::connect(self.path()).unwrap();
        Client { lines: BufReader::new(stream.try_clone().unwrap()).lines(), stream }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        drop(self.stop.take());
        self.thread.take().unwrap().join().unwrap().unwrap();
        assert!(!self.path().exists(), "the socket goes with its server");
    }
}

struct Client {
    stream: UnixStream,
    lines: std::io::Lines<BufReader<UnixStream>>,
}

impl Client {
    fn send(&mut self, line: &str) {
        writeln!(self.stream, "{line}").unwrap();
    }

    fn next(&mut self) -> Value {
        serde_json::from_str(&self.lines.next().unwrap().unwrap()).unwrap()
    }

    fn ask(&mut self, line: &str) -> Value {
        self.send(line);
        self.next()
    }
}

fn one_in_lock_step(server: &mut Server) {
    server.host_can(&Fleet::new(1).on_can(1_000_000).unwrap());
    server.in_lock_step();
}

/// Whether all that is expected is there; more may be.
fn assert_has(found: &Value, expected: &Value, line: &str) {
    match (found, expected) {
        (Value::Object(found), Value::Object(expected)) => {
            for (key, expected) in expected {
                assert_has(found.get(key).unwrap_or(&Value::Null), expected, line);
            }
        }
        (Value::Array(found), Value::Array(expected)) => {
            assert_eq!(found.len(), expected.len(), "{line}");
            found.iter().zip(expected).for_each(|(found, it)| assert_has(found, it, line));
        }
        _ => assert_eq!(found, expected, "{line}"),
    }
}

#[test]
fn dialogue_in_the_documentation_is_what_the_server_answers() {
    let served = Served::start(one_in_lock_step);
    let mut client = served.client();
    let mut shown = 0;
    for line in include_str!("protocol.md").lines() {
        if let Some(request) = line.strip_prefix("> ") {
            client.send(request);
        } else if let Some(answer) = line.strip_prefix("< ") {
            assert_has(&client.next(), &serde_json::from_str(answer).unwrap(), line);
            shown += 1;
        }
    }
    assert_eq!(shown, 19);
}

#[test]
fn every_field_of_a_motor_is_documented() {
    let served = Served::start(one_in_lock_step);
    let state = served.client().ask(r#"{"state":{}}"#);
    let motor = state["ok"]["buses"][0]["motors"][0].as_object().unwrap().clone();
    let rows = include_str!("protocol.md").lines().filter_map(|line| line.strip_prefix("| "));
    let named: Vec<&str> = rows.filter_map(|row| row.split(" |").next()).collect();
    for field in motor.keys() {
        let field = format!("`{field}`");
        assert!(named.iter().any(|names| names.split(", ").any(|it| it == field)), "{field}");
    }
}

#[test]
fn one_of_several_simulations_that_start_at_once_gets_a_stale_socket() {
    for _ in 0..200 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        // What a killed one leaves.
        drop(UnixListener::bind(&path).unwrap());
        let together = std::sync::Barrier::new(3);
        let open = || {
            together.wait();
            Control::open(&path)
        };
        let opened = std::thread::scope(|scope| {
            [(); 3].map(|()| scope.spawn(open)).map(|thread| thread.join().unwrap())
        });
        assert_eq!(opened.iter().filter(|it| it.is_ok()).count(), 1, "{opened:?}");
        assert!(UnixStream::connect(&path).is_ok());
    }
}

#[test]
fn socket_belongs_to_one_simulation_and_a_stale_one_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control");
    let open = |path: &Path| Control::open(path);
    let first = open(&path).unwrap();
    assert!(open(&path).unwrap_err().starts_with("another simulation has the control socket "));
    drop(first);
    assert!(!path.exists());
    // The file stays, and nobody listens.
    drop(UnixListener::bind(&path).unwrap());
    assert!(path.exists());
    let second = open(&path).unwrap();
    // Somebody puts another in its place.
    fs::remove_file(&path).unwrap();
    drop(UnixListener::bind(&path).unwrap());
    drop(second);
    assert!(path.exists());
    drop(open(&path).unwrap());
    fs::write(&path, "mine").unwrap();
    assert!(open(&path).unwrap_err().ends_with("something that is no socket has this name"));
    // Somebody's socket of another kind, such as a log's.
    fs::remove_file(&path).unwrap();
    let _others = std::os::unix::net::UnixDatagram::bind(&path).unwrap();
    assert!(open(&path).unwrap_err().starts_with("the control socket "));
    assert!(path.exists());
}

#[test]
fn stuck_client_does_not_block_other_clients() {
    let served = Served::start(|server| {
        server.host_can(&Fleet::new(2).on_can(1_000_000).unwrap());
        server.host_can(&Fleet::new(2).name("arm").on_can(1_000_000).unwrap());
    });
    let (mut stuck, mut half) = (served.client(), served.client());
    stuck.stream.set_nonblocking(true).unwrap();
    // It reads none of its answers.
    while stuck.stream.write(b"{\"state\":{}}\n").is_ok() {}
    half.stream.write_all(b"{\"ti").unwrap();
    let mut others = [served.client(), served.client()];
    for other in &mut others {
        for _ in 0..10 {
            assert!(other.ask(r#"{"time":{}}"#)["ok"]["at_us"].is_u64());
        }
    }
    let [other, _] = &mut others;
    let arm = other.ask(r#"{"angle":{"bus":"arm","motor":2,"angle_deg":10}}"#);
    assert!(arm["ok"].is_object(), "{arm}");
    let state = other.ask(r#"{"state":{"motor":2}}"#);
    let angles = [0, 1].map(|bus| state["ok"]["buses"][bus]["motors"][0]["angle_deg"].as_f64());
    assert_eq!(angles, [Some(0.0), Some(10.0)]);
    // In real time nobody says how far time goes.
    let refused = other.ask(r#"{"advance":{"us":1}}"#);
    assert!(refused["error"].as_str().unwrap().contains("--lock-step"), "{refused}");
    half.stream.write_all(b"me\":{}}\n").unwrap();
    assert!(half.next()["ok"].is_object());
}

#[test]
fn request_that_one_motor_must_refuse_changes_no_motor() {
    use crate::sim::plant::{MotorParameters, SimulatedMotor};

    let mut models = ["RMD-X8-PRO", "RMD-X6-P20-60"].map(|name| {
        let model = MotorParameters::named(name).unwrap();
        (SimulatedMotor::new(model.clone()).unwrap().inertia_kg_m2(), model)
    });
    models.sort_by(|a, b| b.0.total_cmp(&a.0));
    // The largest stiffness is in proportion to the inertia: too much for the second, not for the first.
    let stiffness = 4e6 * (models[0].0 * models[1].0).sqrt();
    let served = Served::start(|server| {
        for (_, model) in models {
            server.host_can(&Fleet::new(1).model(model).on_can(1_000_000).unwrap());
        }
        server.in_lock_step();
    });
    let mut client = served.client();
    let stiff = format!(
        r#"{{"load":{{"load":{{"spring":{{"rest_deg":0,"stiffness_nm_per_rad":{stiffness}}}}}}}}}"#
    );
    assert!(client.ask(&stiff)["error"].as_str().unwrap().contains("spring"));
    let buses = client.ask(r#"{"state":{}}"#)["ok"]["buses"].take();
    for bus in buses.as_array().unwrap() {
        assert_eq!(bus["motors"][0]["load"]["spring"], Value::Null);
    }
}

/// A program that asks four motors by an SLCAN adapter and an RS485 line for 0.2 s, and takes its time for that or
/// does not: what it gets by each, and how the motors are then.
fn run_in_lock_step(seed: u64, is_slow: bool) -> (Vec<u8>, Vec<u8>, String) {
    use std::fs::File;
    use std::io::Read as _;

    let (places, where_) = std::sync::mpsc::channel();
    let served = Served::start(move |server| {
        // Chance belongs to it.
        let faults = ["lose=0.1", "stall@2+100ms"].map(|fault| fault.parse().unwrap());
        let fleet = Fleet::new(4).seed(seed).faults(faults);
        let can = fleet.on_can(1_000_000).unwrap();
        server.host_can(&can);
        places.send(server.serve_adapter(&can).unwrap()).unwrap();
        let line = fleet.on_rs485(1_000_000).unwrap();
        places.send(server.serve_line(&line, Default::default()).unwrap()).unwrap();
        server.in_lock_step();
    });
    let [mut slcan, mut rs485] = [(); 2].map(|()| {
        let file = File::options().read(true).write(true).open(where_.recv().unwrap()).unwrap();
        rustix::io::ioctl_fionbio(&file, true).unwrap();
        file
    });
    let mut client = served.client();
    let mut got = (Vec::new(), Vec::new());
    slcan.write_all(b"O\r").unwrap();
    for tick in 0..100_u32 {
        for motor in 1..=4_u8 {
            // 0xA2 at 100 to 1090 dps, and 0x92.
            let speed = (10_000 + tick * 1_000).to_le_bytes().map(|byte| format!("{byte:02X}"));
            write!(slcan, "t14{motor}8A2000000{}\r", speed.concat()).unwrap();
        }
        let asked = 1 + (tick % 4) as u8;
        let motor = myactuator_protocol_core::MotorId::new(asked).unwrap();
        let ask = myactuator_protocol_core::command::ReadMultiTurnAngle.packet(motor);
        let frame = myactuator_protocol_core::wire::rs485::Frame::from_packet(&ask).unwrap();
        // In two pieces, which are one message.
        let (first, second) = (&frame.encode()[..5], &frame.encode()[5..]);
        rs485.write_all(first).unwrap();
        if is_slow {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        rs485.write_all(second).unwrap();
        let answer = client.ask(r#"{"advance":{"us":2000}}"#);
        assert_eq!(answer["ok"]["at_us"], 2_000 * (tick + 1));
        let _ = slcan.read_to_end(&mut got.0);
        let _ = rs485.read_to_end(&mut got.1);
    }
    let state = client.ask(r#"{"state":{}}"#).to_string();
    (got.0, got.1, state)
}

#[test]
fn same_calls_in_lock_step_give_the_same_bytes() {
    let (slcan, rs485, state) = run_in_lock_step(7, false);
    // Of 400 replies of 22 characters and 100 of 13 bytes four fifths come: a tenth of the questions is lost, and of
    // the answers.
    assert!(slcan.len() > 300 * 22 && rs485.len() > 70 * 13, "{} {}", slcan.len(), rs485.len());
    let again = run_in_lock_step(7, true);
    assert!(slcan == again.0, "the adapter's bytes differ");
    assert!(rs485 == again.1, "the line's bytes differ");
    assert_eq!(state, again.2);
    assert_ne!(slcan, run_in_lock_step(8, false).0);
}

#[test]
fn a_second_of_four_motors_takes_far_less_in_lock_step() {
    let served = Served::start(|server| {
        let can = Fleet::new(4).on_can(1_000_000).unwrap();
        server.host_can(&can);
        server.serve_adapter(&can).unwrap();
        server.in_lock_step();
    });
    let mut client = served.client();
    let steps = (0..100).map(|_| {
        let start = std::time::Instant::now();
        client.ask(r#"{"advance":{"us":10000}}"#);
        start.elapsed()
    });
    // A machine that does other things meanwhile is late with many of the steps, and with some it is not.
    let mut steps: Vec<_> = steps.collect();
    steps.sort_unstable();
    assert!(steps[25] * 100 < std::time::Duration::from_millis(700), "{steps:?}");
    assert_eq!(client.ask(r#"{"time":{}}"#)["ok"]["at_us"], 1_000_000);
}

#[test]
fn lock_step_time_stands_until_a_client_advances_it() {
    let served = Served::start(one_in_lock_step);
    let (mut one, mut other) = (served.client(), served.client());
    std::thread::sleep(std::time::Duration::from_millis(20));
    assert_eq!(one.ask(r#"{"time":{}}"#)["ok"]["at_us"], 0);
    for wrong in [r#"{"advance":{}}"#, r#"{"advance":{"us":1,"until_us":1}}"#] {
        assert_eq!(one.ask(wrong)["error"], "expected either us or until_us");
    }
    // A way that does not end before somebody leaves; who asks meanwhile is answered, and may not go its own.
    one.send(&format!(r#"{{"advance":{{"us":{}}}}}"#, u64::MAX));
    let refused = loop {
        let answer = other.ask(r#"{"advance":{"us":0}}"#);
        if answer["error"].is_string() {
            break answer;
        }
    };
    assert!(refused["error"].as_str().unwrap().starts_with("another program lets time go on"));
    assert!(other.ask(r#"{"time":{}}"#)["ok"]["at_us"].is_u64());
    drop(one);
    while other.ask(r#"{"advance":{"us":0}}"#)["error"].is_string() {}
    let start = other.ask(r#"{"time":{}}"#)["ok"]["at_us"].as_u64().unwrap();
    assert_eq!(other.ask(r#"{"advance":{"us":20000000}}"#)["ok"]["at_us"], start + 20_000_000);
    assert_eq!(other.ask(r#"{"time":{}}"#)["ok"]["at_us"], start + 20_000_000);
}

#[test]
fn each_request_does_what_it_says() {
    let served = Served::start(|server| {
        server.host_can(&Fleet::new(2).on_can(1_000_000).unwrap());
        server.in_lock_step();
    });
    let mut client = served.client();
    let mut after = |us: u32, requests: &[&str]| {
        let advance = format!(r#"{{"advance":{{"us":{us}}}}}"#);
        for request in requests.iter().copied().chain([&*advance]) {
            assert!(client.ask(request)["ok"].is_object(), "{request}");
        }
        client.ask(r#"{"state":{"motor":1}}"#)["ok"]["buses"][0].take()
    };
    let number = |bus: &Value, name: &str| bus["motors"][0][name].as_f64().unwrap();
    let arm = r#"{"load":{"load":{"arm":{"mass_kg":2,"length_m":0.5,"down_deg":0}}}}"#;
    let level = after(0, &[arm, r#"{"angle":{"angle_deg":90}}"#]);
    // It pulls down: 2 kg * 9.80665 m/s² * 0.5 m.
    assert!((number(&level, "load_torque_nm") + 9.80665).abs() < 1e-9, "{level}");
    let held = after(2_000, &[r#"{"temperature":{"motor_c":60,"mosfet_c":70}}"#]);
    let reported = ["motor_temperature_c", "mosfet_temperature_c"].map(|name| number(&held, name));
    assert_eq!(reported, [60.0, 70.0]);
    let warm = after(1_000_000, &[r#"{"temperature":{}}"#, r#"{"ambient":{"ambient_c":500}}"#]);
    assert!(number(&warm, "motor_temperature_c") > 60.01, "{warm}");
    let pushed = after(100_000, &[r#"{"load":{"load":{}}}"#, r#"{"push":{"torque_nm":-5}}"#]);
    assert!(number(&pushed, "speed_dps") < -1.0, "{pushed}");
    let supply = r#"{"supply":{"feedback_resistance_ohm":3,"capacitance_f":0.002}}"#;
    let expected = json!({ "voltage_v": 48.0, "resistance_ohm": 0.05, "feedback_resistance_ohm": 3.0, "capacitance_f": 0.002 });
    assert_has(&after(0, &[supply])["motors"][0]["supply"], &expected, supply);
    // Ten frames of 44 bits at least and 8 bytes, up to 132 with stuff bits.
    let traffic = after(9_500, &[r#"{"fault":{"fault":"babble=1ms@1"}}"#])["traffic"].take();
    let [frames, busy_us] = ["frames", "busy_us"].map(|name| traffic[name].as_u64().unwrap());
    assert!(frames == 10 && (440..=1_320).contains(&busy_us), "{traffic}");
}

#[test]
fn change_of_a_shared_supply_is_for_all_its_motors() {
    let served = Served::start(|server| {
        let fleet = Fleet::new(2).name("arm").supply(Supply::battery(48.0));
        server.host_can(&fleet.on_can(1_000_000).unwrap());
        server.host_can(&Fleet::new(1).name("tool").on_can(1_000_000).unwrap());
        server.in_lock_step();
    });
    let mut client = served.client();
    let refused = client.ask(r#"{"supply":{"bus":"arm","motor":2,"voltage_v":24}}"#);
    let expected =
        "expected a motor with a supply of its own, found motor 2 of arm, whose motors share one";
    assert!(refused["error"].as_str().unwrap().starts_with(expected), "{refused}");
    let refused = client.ask(r#"{"supply":{"voltage_v":-24}}"#);
    assert!(refused["error"].is_string(), "{refused}");
    // What cannot be on one bus is done on none: the resistor would burn all the time.
    let high = r#"{"supply":{"bus":"arm","brake_resistor":{"on_above_v":60,"off_below_v":50,"resistance_ohm":5}}}"#;
    assert!(client.ask(high)["ok"].is_object());
    assert!(client.ask(r#"{"supply":{"voltage_v":52}}"#)["error"].is_string());
    let tool = client.ask(r#"{"state":{"bus":"tool"}}"#)["ok"]["buses"][0]["motors"][0].take();
    assert_eq!(tool["supply"]["voltage_v"], 48.0);
    let brake = r#""brake_resistor":{"on_above_v":30,"off_below_v":28,"resistance_ohm":5}"#;
    let all = format!(r#"{{"supply":{{"voltage_v":24,{brake}}}}}"#);
    for request in [&*all, r#"{"advance":{"us":50000}}"#] {
        assert!(client.ask(request)["ok"].is_object(), "{request}");
    }
    let state = client.ask(r#"{"state":{}}"#)["ok"]["buses"].take();
    for (bus, place) in [(0, 0), (0, 1), (1, 0)] {
        let motor = &state[bus]["motors"][place];
        let voltage_v = motor["supply_voltage_v"].as_f64().unwrap();
        assert!((voltage_v - 24.0).abs() < 0.1, "{motor}");
    }
    let voltage_v = state[0]["supply_voltage_v"].as_f64().unwrap();
    assert!((voltage_v - 24.0).abs() < 0.1 && state[1]["supply_voltage_v"].is_null(), "{state}");
    for supply in [&state[0]["supply"], &state[1]["motors"][0]["supply"]] {
        assert_eq!(supply["brake_resistor"]["on_above_v"], 30.0, "{supply}");
    }
    for (request, stays) in [
        (r#"{"supply":{"bus":"arm","resistance_ohm":0.1}}"#, true),
        (r#"{"supply":{"bus":"arm","brake_resistor":null}}"#, false),
    ] {
        assert!(client.ask(request)["ok"].is_object(), "{request}");
        let state = client.ask(r#"{"state":{"bus":"arm"}}"#)["ok"]["buses"].take();
        assert_eq!(state[0]["supply"]["brake_resistor"].is_object(), stays, "{state}");
    }
    assert!(state[1]["supply"].is_null(), "it shares none");
}

/// Output that finds no room in a pseudo-terminal is kept. Input that comes while time advances waits for its end.
#[test]
fn lock_step_loses_nothing_and_delivers_nothing_too_early() {
    use std::io::Read as _;

    let (places, where_) = std::sync::mpsc::channel();
    let served = Served::start(move |server| {
        let can = Fleet::new(1).on_can(1_000_000).unwrap();
        server.host_can(&can);
        places.send(server.serve_adapter(&can).unwrap()).unwrap();
        server.in_lock_step();
    });
    let path = where_.recv().unwrap();
    let mut slcan = std::fs::File::options().read(true).write(true).open(path).unwrap();
    rustix::io::ioctl_fionbio(&slcan, true).unwrap();
    let (mut client, mut other) = (served.client(), served.client());
    slcan.write_all(b"O\r").unwrap();
    client.send(r#"{"advance":{"us":10000000}}"#);
    while other.ask(r#"{"time":{}}"#)["ok"]["at_us"] == 0 {}
    slcan.write_all(b"t14189C00000000000000\r").unwrap();
    while other.ask(r#"{"advance":{"us":0}}"#)["error"].is_string() {}
    let mut frames = |line: &str| {
        assert!(other.ask(line)["ok"].is_object());
        other.ask(r#"{"state":{}}"#)["ok"]["buses"][0]["traffic"]["frames"].as_u64().unwrap()
    };
    assert_eq!(frames(r#"{"time":{}}"#), 0);
    frames(r#"{"fault":{"fault":"babble=200us"}}"#);
    // Of some 14 characters each: more than a pseudo-terminal holds. Two are the question and its answer.
    let sent = frames(r#"{"advance":{"us":4000000}}"#);
    assert!(sent > 19_000, "{sent}");
    let mut got = Vec::new();
    let lines = |got: &[u8]| got.iter().filter(|&&byte| byte == b'\r').count() as u64;
    let begun = std::time::Instant::now();
    // The adapter's answers to O and to the question, and what it has heard: all but the question.
    while lines(&got) < sent + 1 && begun.elapsed() < LONG {
        let _ = slcan.read_to_end(&mut got);
        frames(r#"{"time":{}}"#);
    }
    assert_eq!(lines(&got), sent + 1);
}

#[test]
fn lock_step_time_stands_once_the_client_that_advanced_it_has_left() {
    let served = Served::start(one_in_lock_step);
    let (mut one, mut other) = (served.client(), served.client());
    one.send(&format!(r#"{{"advance":{{"us":{}}}}}"#, u64::MAX));
    let goes_on = |other: &mut Client| other.ask(r#"{"advance":{"us":0}}"#)["error"].is_string();
    while !goes_on(&mut other) {}
    // One that only has nothing more to say waits for its answer.
    one.stream.shutdown(std::net::Shutdown::Write).unwrap();
    assert!(goes_on(&mut other));
    drop(one);
    let left = std::time::Instant::now();
    while goes_on(&mut other) {
        assert!(left.elapsed() < LONG, "it goes on");
    }
}

/// `printf '{"log":{}}\n' | socat - UNIX:control` is such a listener.
#[test]
fn client_that_only_reads_the_log_gets_it_until_it_disconnects() {
    let served = Served::start(one_in_lock_step);
    let (mut listener, mut other) = (served.client(), served.client());
    listener.send(r#"{"log":{}}"#);
    listener.stream.shutdown(std::net::Shutdown::Write).unwrap();
    assert!(listener.next()["ok"].is_object());
    let mut clients = || {
        assert!(other.ask(r#"{"fault":{"fault":"over-voltage"}}"#)["ok"].is_object());
        assert!(other.ask(r#"{"advance":{"us":1000}}"#)["ok"].is_object());
        assert!(other.ask(r#"{"fault":{"fault":"clear"}}"#)["ok"].is_object());
        assert!(other.ask(r#"{"advance":{"us":1000}}"#)["ok"].is_object());
    };
    clients();
    let text = |line: Value| line["log"]["event"].to_string();
    let reported = [listener.next(), listener.next()].map(text);
    assert!(
        reported[0].contains("fault-raised") && reported[1].contains("fault-cleared"),
        "{reported:?}"
    );
    drop(listener);
    clients();
}

/// Programs that never stop writing to the ports, whether sense or not, and never read.
#[test]
fn flood_on_the_ports_does_not_block_other_clients() {
    use std::io::Write as _;

    for is_in_lock_step in [false, true] {
        let (places, where_) = std::sync::mpsc::channel();
        let served = Served::start(move |server| {
            let fleet = Fleet::new(1);
            let can = fleet.on_can(1_000_000).unwrap();
            server.host_can(&can);
            places.send(server.serve_adapter(&can).unwrap()).unwrap();
            let line = fleet.on_rs485(1_000_000).unwrap();
            places.send(server.serve_line(&line, Default::default()).unwrap()).unwrap();
            if is_in_lock_step {
                server.in_lock_step();
            }
        });
        let is_over = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        let floods = [&b"V\r"[..], &[0x3E]].map(|sense| {
            let path = where_.recv().unwrap();
            let is_over = std::sync::Arc::clone(&is_over);
            std::thread::spawn(move || {
                let mut file = std::fs::File::options().read(true).write(true).open(path).unwrap();
                rustix::io::ioctl_fionbio(&file, true).unwrap();
                let flood = sense.repeat(1024);
                while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                    let _ = file.write(&flood);
                }
            })
        });
        let mut client = served.client();
        for _ in 0..50 {
            assert!(client.ask(r#"{"time":{}}"#)["ok"].is_object());
        }
        is_over.store(true, std::sync::atomic::Ordering::Relaxed);
        floods.into_iter().for_each(|flood| flood.join().unwrap());
    }
}

#[test]
fn a_fault_waits_for_its_condition_and_strikes_once() {
    let served = Served::start(|server| {
        let faults = ["over-speed@2?angle>90+10ms".parse().unwrap()];
        server.host_can(&Fleet::new(2).faults(faults).on_can(1_000_000).unwrap());
        server.in_lock_step();
    });
    let mut client = served.client();
    let mut errors = |line: &str| {
        assert!(client.ask(line)["ok"].is_object(), "{line}");
        let step = client.ask(r#"{"advance":{"us":5000}}"#);
        assert!(step["ok"].is_object());
        let motors = client.ask(r#"{"state":{}}"#)["ok"]["buses"][0]["motors"].take();
        [0, 1].map(|motor| motors[motor]["errors"].as_array().unwrap().len())
    };
    // The other motor is none of its business, and neither is the time before it may begin.
    assert_eq!(errors(r#"{"angle":{"motor":1,"angle_deg":95}}"#), [0, 0]);
    assert_eq!(errors(r#"{"angle":{"motor":2,"angle_deg":95}}"#), [0, 1]);
    assert_eq!(errors(r#"{"fault":{"fault":"clear"}}"#), [0, 0]);
    assert_eq!(errors(r#"{"angle":{"motor":2,"angle_deg":100}}"#), [0, 0]);
    assert_eq!(errors(r#"{"fault":{"fault":"stall@1?angle<-5"}}"#), [0, 0]);
    assert_eq!(errors(r#"{"angle":{"angle_deg":-10}}"#), [1, 0]);
}

#[test]
fn a_fault_for_all_buses_strikes_on_each_as_its_motor_meets_the_condition() {
    let served = Served::start(|server| {
        server.host_can(&Fleet::new(1).on_can(1_000_000).unwrap());
        server.host_can(&Fleet::new(1).name("arm").on_can(1_000_000).unwrap());
        server.in_lock_step();
    });
    let mut client = served.client();
    let mut errors = |line: &str| {
        assert!(client.ask(line)["ok"].is_object(), "{line}");
        assert!(client.ask(r#"{"advance":{"us":1000}}"#)["ok"].is_object());
        let buses = client.ask(r#"{"state":{}}"#)["ok"]["buses"].take();
        [0, 1].map(|bus| buses[bus]["motors"][0]["errors"].as_array().unwrap().len())
    };
    assert_eq!(errors(r#"{"fault":{"fault":"over-speed@1?angle>90"}}"#), [0, 0]);
    assert_eq!(errors(r#"{"angle":{"bus":"arm","angle_deg":95}}"#), [0, 1]);
    assert_eq!(errors(r#"{"fault":{"bus":"arm","fault":"clear"}}"#), [0, 0]);
    assert_eq!(errors(r#"{"angle":{"bus":"can","angle_deg":95}}"#), [1, 0]);
    // What strikes at once has done so when that is answered.
    assert!(client.ask(r#"{"fault":{"fault":"clear"}}"#)["ok"].is_object());
    let state = client.ask(r#"{"state":{"bus":"can"}}"#);
    assert_eq!(state["ok"]["buses"][0]["motors"][0]["errors"], json!([]));
}

/// The mechanics would move the shaft away at once, although `{"ok": …}` had said that it is there.
#[test]
fn shaft_led_by_mechanics_refuses_an_angle_and_feels_no_load() {
    use myactuator_protocol_core::time::Duration;

    struct Still;
    impl Mechanics for Still {
        fn step(&mut self, _: Duration, _: &mut [Shaft]) -> Result<(), Failure> {
            Ok(())
        }
    }
    let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
    fleet.lead(&fleet.drives[..1], Duration::from_millis(1), Still).unwrap();
    let served = Served::start(move |server| {
        server.host_can(&fleet);
        server.in_lock_step();
    });
    let mut client = served.client();
    let refused = client.ask(r#"{"angle":{"angle_deg":90}}"#)["error"].to_string();
    assert!(refused.contains("found one that mechanics move"), "{refused}");
    client.ask(r#"{"load":{"load":{"torque_nm":-5}}}"#);
    let state = client.ask(r#"{"state":{}}"#);
    let motors = &state["ok"]["buses"][0]["motors"];
    let reported = [0, 1].map(|place| {
        let motor = &motors[place];
        (motor["led"] == true, motor["load_torque_nm"].as_f64(), motor["angle_deg"].as_f64())
    });
    assert_eq!(reported, [(true, Some(0.0), Some(0.0)), (false, Some(-5.0), Some(0.0))]);
}

#[test]
fn number_of_waiting_faults_on_a_bus_is_limited() {
    let served = Served::start(|server| {
        server.host_can(&Fleet::new(1).on_can(1_000_000).unwrap());
        server.host_can(&Fleet::new(1).name("arm").on_can(1_000_000).unwrap());
        server.in_lock_step();
    });
    let mut client = served.client();
    let waits = r#"{"fault":{"bus":"arm","fault":"clear+1ms"}}"#;
    for _ in 0..1_000 {
        assert!(client.ask(waits)["ok"].is_object());
    }
    // On no bus if one has no room.
    for full in [waits, r#"{"fault":{"fault":"cut@1"}}"#] {
        let reported = client.ask(full)["error"].as_str().unwrap().to_owned();
        assert!(
            reported.starts_with("expected at most 1000 faults that wait on a bus"),
            "{reported}"
        );
        assert!(reported.contains("on arm"), "{reported}");
    }
    let state = client.ask(r#"{"state":{}}"#);
    assert_eq!(state["ok"]["buses"][0]["motors"][0]["cut"], false);
    assert!(client.ask(r#"{"advance":{"us":1000}}"#)["ok"].is_object());
    assert!(client.ask(waits)["ok"].is_object());
}

/// The robot whose faults strike by time and by condition: its second shaft falls.
const FALLING: &str = r#"
    [[bus]]
    name = "arm"
    kind = "can"
    bit_rate = 1_000_000
    faults = ["over-voltage@1+5ms", "stall@1?temperature<30+17ms", "over-speed@2?angle<80", "reset@2+600ms"]

    [[bus.motor]]
    id = 1

    [[bus.motor]]
    id = 2
    model = "RMD-X8-P20-120"
    start_angle_deg = 90
    load = { arm = { mass_kg = 4, length_m = 0.5, down_deg = 0 } }
"#;

#[test]
fn faults_of_a_robot_strike_alike_in_lock_step_and_in_a_program() {
    let robot = crate::sim::Robot::from_toml(FALLING, "").unwrap();
    let fleet = robot.can("arm").unwrap();
    let mut log = crate::sim::DriveLog::of(&fleet);
    let mut reported = Vec::new();
    for _ in 0..800 {
        fleet.world.run_for(myactuator_protocol_core::time::Duration::from_millis(1));
        reported.extend(log.poll(fleet.world.now()).iter().map(log_line));
    }
    let served = Served::start(move |server| {
        server.host_can(&robot.can("arm").unwrap());
        server.in_lock_step();
    });
    let mut client = served.client();
    client.ask(r#"{"log":{}}"#);
    client.send(r#"{"advance":{"us":800000}}"#);
    let mut heard = Vec::new();
    loop {
        let line = client.next();
        if line["ok"].is_object() {
            break;
        }
        heard.push(line);
    }
    let reported: Vec<Value> =
        reported.iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(heard, reported);
    let at_us = |event: &str| {
        let is_it = |line: &&Value| line["log"]["event"]["fault-raised"] == event;
        heard.iter().find(is_it).unwrap()["log"]["at_us"].as_u64()
    };
    assert_eq!((at_us("OVER_VOLTAGE"), at_us("STALL")), (Some(5_000), Some(17_000)));
    assert!(at_us("OVER_SPEED") > Some(17_000) && at_us("OVER_SPEED") < Some(600_000));
}

//! `myactuator sim FILE`: a robot of several buses.

use std::fs;
use std::path::Path;

use rustix::process::Signal;
use serde_json::json;

use crate::run::{run, run_words, tells_of_silence, text, unless_late};
use crate::sim_serve::{Simulation, done_at, ended_well};

const ROBOT: &str = r#"
    seed = 3

    [[bus]]
    name = "arm"
    kind = "can"
    bit_rate = 500_000
    faults = ["encoder-data@4"]

    [[bus.motor]]
    ids = [4, 2]
    start_angle_deg = 30

    [[bus]]
    name = "leg"
    kind = "can"
    bit_rate = 1_000_000

    [bus.defaults]
    model = "RMD-X6-P20-60"

    [[bus.motor]]
    id = 4

    [[bus]]
    name = "tool"
    kind = "rs485"
    bit_rate = 115_200
    adapter = "echo"

    [[bus.motor]]
    id = 1
    start_angle_deg = -12
"#;

fn written(folder: &Path, text: &str) -> String {
    let file = folder.join("robot.toml");
    fs::write(&file, text).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn each_bus_of_a_file_is_served_with_its_motors_under_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(folder.path(), ROBOT);
    let [links, memory] = ["links", "memory"].map(|name| folder.path().join(name));
    let options = ["--link", links.to_str().unwrap(), "--memory", memory.to_str().unwrap()];
    let simulation = Simulation::start(3, &[&[file.as_str()], &options[..]].concat());
    for (name, kind, bit_rate, motors) in [
        ("arm", "slcan", 500_000, json!([2, 4])),
        ("leg", "slcan", 1_000_000, json!([4])),
        ("tool", "rs485", 115_200, json!([1])),
    ] {
        let place = simulation.named(name);
        assert_eq!(place["kind"], kind);
        assert_eq!(place["bit_rate"], bit_rate);
        assert_eq!(place["motors"], motors);
        assert_eq!(place["link"], links.join(name).to_str().unwrap());
        assert_eq!(fs::read_link(links.join(name)).unwrap().to_str(), place["path"].as_str());
    }
    let bus = |name| simulation.named(name)["bus"].as_str().unwrap();
    assert!(bus("tool").ends_with("/tool@115200,echo"), "{}", bus("tool"));
    let status = |name, id| done_at(bus(name), &["status", "--id", id]);
    let arm = status("arm", "2");
    assert!(arm.contains("angle 30 deg") && arm.contains("no error"), "{arm}");
    // A fault acts on its own bus only, although the other has a motor with this id, too.
    assert!(status("arm", "4").contains("encoder data wrong"), "{}", status("arm", "4"));
    let leg = status("leg", "4");
    assert!(leg.contains("angle 0 deg") && leg.contains("no error"), "{leg}");
    assert!(done_at(bus("leg"), &["scan"]).contains("X6-60"));
    assert!(status("tool", "1").contains("angle -12 deg"), "{}", status("tool", "1"));

    assert_eq!(simulation.end(Signal::INT), ended_well());
    assert_eq!(fs::read_dir(links).unwrap().count(), 0);
    for file in ["arm/shaft-2.json", "arm/shaft-4.json", "leg/shaft-4.json", "tool/shaft-1.json"] {
        assert!(memory.join(file).is_file(), "{file}");
    }
}

#[test]
fn a_gripper_presses_against_what_is_in_its_way() {
    let folder = tempfile::tempdir().unwrap();
    let gripper = r#"
        [[bus]]
        name = "gripper"
        kind = "can"
        bit_rate = 1_000_000

        [[bus.motor]]
        id = 1
        load = { upper_stop = { at_deg = 20, stiffness_nm_per_rad = 500, restitution = 0 } }
    "#;
    // It grips from the same place each time.
    let attempt = || {
        let simulation = Simulation::start(1, &[&written(folder.path(), gripper)]);
        let bus = simulation.named("gripper")["bus"].as_str().unwrap();
        let grip = "move --id 1 --angle-deg 90 --max-torque-pct 10 --press --yes --bus";
        let output = run_words(&format!("{grip} {bus}"));
        (simulation.end(Signal::INT), [output.stdout, output.stderr].concat())
    };
    let (end, message) = unless_late(attempt, |(_, message)| tells_of_silence(text(message)));
    let message = text(&message);
    assert!(message.contains("motor 1 has met something at 2"), "{message}");
    assert_eq!(end, ended_well());
}

#[test]
fn options_conflict_with_a_robot_file_and_its_errors_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    let file = written(folder.path(), ROBOT);
    let refused = |arguments: &[&str], status, expected: &str| {
        let output = run(&[&["sim"], arguments].concat());
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{message}");
        assert!(message.contains(expected), "{message}");
    };
    for option in [
        "--count 2",
        "--same-id 1",
        "--model RMD-X8-PRO",
        "--firmware v4.3",
        "--ranges 12.566,45,500,5,60",
        "--brakes",
        "--quirk slow-boot",
        "--fault cut",
        "--bit-rate 500000",
        "--rs485-rate 115200",
        "--can vcan0",
        "--only slcan",
    ] {
        let words: Vec<&str> = option.split(' ').collect();
        refused(&[&[file.as_str()], &words[..]].concat(), 2, "cannot be used with");
    }
    let wrong = written(folder.path(), &ROBOT.replace("id = 4", "id = 40"));
    refused(&[&wrong], 2, "robot.toml, line 23: motor id must be 1 to 32, but 40 was given");
    // If there is no such interface nothing is served, and the error names the bus.
    let nowhere = ROBOT.replace("name = \"leg\"", "name = \"leg\"\ninterface = \"no-such-can\"");
    let nowhere = written(folder.path(), &nowhere);
    let expected = "error: bus \"leg\": there is no CAN interface \"no-such-can\" to serve it on";
    refused(&[&nowhere], 1, expected);
    let made = "make a virtual one with 'sudo ip link add dev no-such-can type vcan' and";
    refused(&[&nowhere], 1, made);
    // The library simulates this, but no adapter has it.
    let odd = written(folder.path(), &ROBOT.replace("500_000", "400_000"));
    refused(&[&odd], 1, "bus \"arm\": bit_rate: expected a bit rate that SLCAN adapters know");
    refused(&["nothing.toml"], 2, "the robot's file \"nothing.toml\" cannot be read");
}

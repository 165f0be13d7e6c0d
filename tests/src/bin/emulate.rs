//! Runs a board's firmware in the emulator on a bus of simulated drives, to try it by hand: `cargo emulate mps2_an386
//! --bin rs485`.

use std::error::Error;
use std::io::{self, BufRead as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc::{self, Sender};
use std::thread;
use std::time::Duration;

use myactuator_host_std::sim::Fleet;
use myactuator_tests::emulator::board::{Board, Wire};
use myactuator_tests::emulator::drives::Drives;
use myactuator_tests::emulator::panel::{Breakage, Panel};
use myactuator_tests::emulator::{Emulated, Failure};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// The number of drives.
const DRIVES: u8 = 4;

const KEYS: &str = "\
Enter presses the button: until then nothing moves. \"long\" and Enter is a long press: it shuts the
motors down when they are stopped. \"panic\", \"fault\", \"hang\", \"overflow\" and \"unexpected\" break the
firmware.
Ctrl-C ends everything.";

/// What the user enters.
enum Input {
    Line(String),
    End,
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error + Send + Sync>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(board), Some(image), None) = (arguments.next(), arguments.next(), arguments.next())
    else {
        return Err(
            "expected two arguments: the name of a board and the file of its firmware".into()
        );
    };
    let board: Board = board.to_string_lossy().parse()?;
    let image = PathBuf::from(image);
    let program = image.file_name().unwrap_or_default().to_string_lossy();
    let wire = Wire::of_program(&program)?;

    let (sender, inputs) = mpsc::channel();
    read_input(sender)?;
    let drives = Drives::new(&Fleet::new(DRIVES).brakes(true), wire)?;
    println!("{board} in QEMU, with {DRIVES} simulated drives on {wire}.\n{KEYS}\n");
    let mut emulated = Emulated::start(board, wire, &image, drives, |line| println!("{line}"))?;
    loop {
        match inputs.recv_timeout(Duration::from_millis(100)) {
            Ok(Input::Line(line)) => run_command(line.trim(), &mut emulated.panel)?,
            Ok(Input::End) | Err(mpsc::RecvTimeoutError::Disconnected) => return Ok(()),
            Err(mpsc::RecvTimeoutError::Timeout) if emulated.log.is_open() => {}
            Err(mpsc::RecvTimeoutError::Timeout) => {
                return Err(format!("QEMU has ended: {}", emulated.qemu.complaints()).into());
            }
        }
    }
}

fn run_command(line: &str, panel: &mut Panel) -> Result<(), Failure> {
    match line {
        "" => panel.press(),
        "long" => panel.hold(),
        "panic" => panel.break_it(Breakage::Panic),
        "fault" => panel.break_it(Breakage::Fault),
        "hang" => panel.break_it(Breakage::Hang),
        "overflow" => panel.break_it(Breakage::Overflow),
        "unexpected" => panel.break_it(Breakage::Unexpected),
        _ => {
            println!("{KEYS}");
            Ok(())
        }
    }
}

/// Passes on the lines of standard input, and signals to end. The end of standard input does not end the program.
fn read_input(sender: Sender<Input>) -> io::Result<()> {
    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    let end = sender.clone();
    thread::spawn(move || {
        if signals.forever().next().is_some() {
            // Without a receiver the program is ending already.
            let _ = end.send(Input::End);
        }
    });
    thread::spawn(move || {
        for line in io::stdin().lock().lines().map_while(Result::ok) {
            if sender.send(Input::Line(line)).is_err() {
                return;
            }
        }
    });
    Ok(())
}

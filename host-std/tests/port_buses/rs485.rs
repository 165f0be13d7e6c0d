//! A serial port. Masters ask on one in `tests/program/sim_serve.rs`.

use std::io::{Read, Write};

use embedded_io::{Read as _, ReadReady as _, Write as _};
use myactuator_host_std::open::BusError;
use myactuator_host_std::port::{PortError, Rs485};
use myactuator_protocol_core::command::ReadMultiTurnAngle;
use myactuator_protocol_core::io::{CallError, Runner};
use rustix::thread::{CapabilitySet, capabilities, set_capabilities};

use crate::drive::{self, motor};
use crate::pty;

#[test]
fn a_port_belongs_to_one_program() {
    let (_line, path) = pty::open();
    let first = Rs485::open(&path, 115_200).unwrap();
    let error = Rs485::open(&path, 115_200).unwrap_err();
    assert!(matches!(error, PortError::InUse(_)), "{error}");
    assert!(error.to_string().contains(path.to_str().unwrap()), "{error}");
    drop(first);
    Rs485::open(&path, 115_200).unwrap();
}

/// A root user passes by a port that somebody has for himself; others do not.
#[test]
fn a_port_is_free_again_as_soon_as_it_is_closed() {
    let (_line, path) = pty::open();
    // As one that serves drives does, so that the terminal lives on.
    let _held = std::fs::File::options().read(true).write(true).open(&path).unwrap();
    let mut rights = capabilities(None).unwrap();
    rights.effective.remove(CapabilitySet::SYS_ADMIN);
    set_capabilities(None, rights).unwrap();
    for bit_rate in [115_200, 500_000, 1_000_000] {
        let port = Rs485::open(&path, bit_rate).unwrap();
        assert!(std::fs::File::open(&path).is_err());
        drop(port);
    }
}

#[test]
fn the_line_runs_at_the_rate_that_was_asked_for() {
    for bit_rate in [1_200, 115_200, 1_500_000, 2_500_000] {
        let (_line, path) = pty::open();
        let port = Rs485::open(&path, bit_rate).unwrap();
        let settings = rustix::termios::tcgetattr(&port).unwrap();
        assert_eq!(settings.output_speed(), bit_rate);
        assert_eq!(settings.input_speed(), bit_rate);
    }
}

#[test]
fn bytes_pass_unchanged_both_ways() {
    let every_byte: Vec<u8> = (0..=255).collect();
    let (mut line, path) = pty::open();
    let mut port = Rs485::open(&path, 115_200).unwrap();
    assert!(!port.read_ready().unwrap());
    port.write_all(&every_byte).unwrap();
    port.flush().unwrap();
    let mut heard = [0; 256];
    line.read_exact(&mut heard).unwrap();
    assert_eq!(heard, every_byte[..]);
    line.write_all(&every_byte).unwrap();
    port.read_exact(&mut heard).unwrap();
    assert_eq!(heard, every_byte[..]);
    assert!(!port.read_ready().unwrap());
}

#[test]
fn paths_that_are_no_serial_port_are_reported() {
    let error = |path: &str| Rs485::open(path, 115_200).unwrap_err();
    assert!(matches!(error("/dev/there-is-no-such-port"), PortError::NoSuchPort(_)));
    assert!(matches!(error("/dev/null"), PortError::NotASerialPort(_)));
    assert!(matches!(error("/dev"), PortError::NotASerialPort(_)));
    assert!(matches!(error(env!("CARGO_MANIFEST_PATH")), PortError::NotASerialPort(_)));
}

#[test]
fn adapter_that_is_pulled_out_is_reported() {
    let (line, path) = pty::open();
    let mut master = drive::open(&format!("rs485:{}@2500000", path.display())).unwrap();
    drop(line);
    let error = master.ask(motor(1), ReadMultiTurnAngle).unwrap_err();
    let CallError::Bus(error) = error else { panic!("{error}") };
    assert!(matches!(error, BusError::Port(PortError::PortGone(_))), "{error}");
}

#[test]
fn bytes_that_a_stalled_port_does_not_take_are_discarded() {
    let (mut line, path) = pty::open();
    let mut port = Rs485::open(&path, 115_200).unwrap();
    let mut taken = 0;
    let error = (0..10_000).find_map(|_| match port.write(&[0; 100]) {
        Ok(length) => {
            taken += length;
            None
        }
        Err(error) => Some(error),
    });
    let error = error.expect("a pseudo-terminal has an end");
    assert!(matches!(error, PortError::Stalled(_)), "{error}");
    drop(port);
    let (mut heard, mut chunk) = (0, [0; 256]);
    while let Ok(length @ 1..) = line.read(&mut chunk) {
        heard += length;
    }
    assert!(heard < taken, "{heard} of {taken}");
}

/// A reply to an earlier program, to a stop for example, must not pass for a reply to this one.
#[test]
fn bytes_that_came_before_a_port_was_opened_are_not_received() {
    let (mut line, path) = pty::open();
    // The terminal lives on, as a serial port does.
    let earlier = std::fs::File::open(&path).unwrap();
    line.write_all(b"early\n").unwrap();
    let has_come = (0..5_000).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(1));
        rustix::io::ioctl_fionread(&earlier).unwrap() > 0
    });
    assert!(has_come);
    let mut port = Rs485::open(&path, 115_200).unwrap();
    assert!(!port.read_ready().unwrap());
}

//! What is said of CAN interfaces that cannot be opened. Frames over one need a Linux with CAN, which
//! not every machine has.

use myactuator_host_std::port::{PortError, SocketCan};

#[test]
fn missing_interface_is_reported() {
    let error = SocketCan::open("no-such-can").unwrap_err();
    assert!(matches!(error, PortError::NoSuchInterface { .. }), "{error}");
    let message = error.to_string();
    let (none, some) = (": this machine has none", ": there are ");
    assert!(message.starts_with("there is no CAN interface \"no-such-can\": "), "{message}");
    assert!(message.contains(none) || message.contains(some), "{message}");
}

#[test]
fn error_of_a_missing_interface_lists_those_that_exist() {
    let there = vec!["can0".to_owned(), "vcan0".to_owned()];
    let message = PortError::NoSuchInterface { name: "cna0".to_owned(), there }.to_string();
    assert!(
        message.starts_with("there is no CAN interface \"cna0\": there are can0 vcan0; "),
        "{message}"
    );
}

#[test]
fn interface_that_is_not_for_can_is_reported() {
    let error = SocketCan::open("lo").unwrap_err();
    assert!(matches!(error, PortError::NoCanSupport | PortError::NotCan(_)), "{error}");
}

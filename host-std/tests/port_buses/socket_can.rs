//! What is said of CAN interfaces that cannot be opened. Frames over one need a Linux with CAN, which
//! not every machine has.

use myactuator_host_std::port::{PortError, SocketCan};

#[test]
fn an_interface_that_is_not_there_is_told() {
    let error = SocketCan::open("no-such-can").unwrap_err();
    assert!(matches!(error, PortError::NoSuchInterface { .. }), "{error}");
    let told = error.to_string();
    let (none, some) = (": this machine has none", ": there are ");
    assert!(told.starts_with("there is no CAN interface \"no-such-can\": "), "{told}");
    assert!(told.contains(none) || told.contains(some), "{told}");
}

#[test]
fn those_that_there_are_are_told() {
    let there = vec!["can0".to_owned(), "vcan0".to_owned()];
    let told = PortError::NoSuchInterface { name: "cna0".to_owned(), there }.to_string();
    assert!(
        told.starts_with("there is no CAN interface \"cna0\": there are can0 vcan0; "),
        "{told}"
    );
}

#[test]
fn an_interface_that_is_not_for_can_is_told() {
    let error = SocketCan::open("lo").unwrap_err();
    assert!(matches!(error, PortError::NoCanSupport | PortError::NotCan(_)), "{error}");
}

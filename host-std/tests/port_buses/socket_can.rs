//! What is said of CAN interfaces that cannot be opened. Frames over one need a Linux with CAN, which
//! not every machine has.

use myactuator_host_std::port::{PortError, SocketCan};
use rustix::net::{AddressFamily, SocketType, socket};

#[test]
fn an_interface_that_is_not_there_is_told() {
    let error = SocketCan::open("no-such-can").unwrap_err();
    let can_sockets = socket(AddressFamily::CAN, SocketType::RAW, None);
    if can_sockets.err() == Some(rustix::io::Errno::AFNOSUPPORT) {
        assert!(matches!(error, PortError::NoCanSupport), "{error}");
        assert!(error.to_string().starts_with("this machine's Linux has no CAN sockets: "));
    } else {
        assert!(matches!(error, PortError::NoSuchInterface(_)), "{error}");
        assert!(error.to_string().starts_with("there is no network interface \"no-such-can\": "));
    }
}

#[test]
fn an_interface_that_is_not_for_can_is_told() {
    let error = SocketCan::open("lo").unwrap_err();
    assert!(matches!(error, PortError::NoCanSupport | PortError::NotCan(_)), "{error}");
}

//! MyActuator servo motors on a host.

pub mod bus;

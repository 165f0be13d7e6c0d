//! MyActuator servo motors on a host.

//! MyActuator servo motors on a host.

pub mod nvm;
pub mod plant;

//! The buses that an address opens: simulated ones, and real ones as far as every Linux machine has
//! them: serial ports by pseudo-terminals, with drives and adapters played at the other end.

mod drive;
mod pty;
mod rs485;
mod simulated;
mod slcan;
mod socket_can;

//! Real buses, as far as every Linux machine has them: serial ports by pseudo-terminals, with drives
//! and adapters played at the other end.

mod drive;
mod pty;
mod rs485;
mod slcan;
mod socket_can;

//! The application on the RS485 line, and its end.

use myactuator_mcu_example::{Board, Movement, RestartCause, Setup, run};
use myactuator_protocol_core::io::SerialMaster;
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::MaxSpeed;

use crate::end::end;
use crate::last_line::LastLine;
use crate::line::Line;
use crate::time::TimeBase;
use crate::{MOTORS, motors};

/// The highest speed, in degrees per second.
const MAX_SPEED: MaxSpeed = MaxSpeed::from_raw(100);

/// The application's settings on a line: positions, as many as the line carries.
pub fn setup(config: &Config) -> Setup {
    let movement = Movement::Position { max_speed: MAX_SPEED };
    Setup { search: motors(), cycle: cycle(config), ..Setup::new(movement) }
}

/// Runs the application on the line forever.
pub fn run_rs485(
    line: Line,
    config: Config,
    setup: Setup,
    time: TimeBase,
    board: &mut impl Board,
    cause: RestartCause,
) -> ! {
    let mut bus = SerialMaster::<_, _, MOTORS>::new(line, time, config);
    run(&mut bus, board, setup, cause)
}

/// The loop blocks while a frame is sent, and a cycle that begins half a cycle late counts as missed.
fn cycle(config: &Config) -> Duration {
    let is_slow = config.frame_time > Duration::from_micros(300);
    if is_slow { Duration::from_millis(5) } else { Duration::from_millis(1) }
}

/// The end after a panic, a fault, or an exception without a handler: stops the motors, and restarts.
pub extern "C" fn end_on_rs485(at: u32) -> ! {
    end(at, LastLine::take, LastLine::send)
}

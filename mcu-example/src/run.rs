//! The loop in which every program ends: [`run`] if the bus is polled, [`run_async`] as a task. Both only carry events
//! and the time to the [`App`].

use myactuator_protocol_core::io::{AsyncRunner, Runner};

use crate::app::{App, Moment, Setup};
use crate::board::{Board, RestartCause};

/// Runs the application forever.
pub fn run<const N: usize>(
    bus: &mut impl Runner<N>,
    board: &mut impl Board,
    setup: Setup,
    cause: RestartCause,
) -> ! {
    let now = bus.now();
    let mut app = App::start(setup, cause, &mut Moment { now, master: bus.master(), board });
    loop {
        cycle(&mut app, bus, board);
    }
}

/// Runs one cycle: runs the bus until the next cycle is due, then begins it.
pub fn cycle<const N: usize>(app: &mut App<N>, bus: &mut impl Runner<N>, board: &mut impl Board) {
    while bus.now() < app.next_cycle() {
        match bus.poll() {
            Ok(Some(event)) => {
                let now = bus.now();
                app.handle_event(&event, &mut Moment { now, master: bus.master(), board });
            }
            Ok(None) => bus.idle(app.next_cycle()),
            Err(_) => {
                let now = bus.now();
                app.handle_bus_error(&mut Moment { now, master: bus.master(), board });
                bus.idle(app.next_cycle());
            }
        }
    }
    let now = bus.now();
    app.begin_cycle(&mut Moment { now, master: bus.master(), board });
}

/// [`run`] as a task.
pub async fn run_async<const N: usize>(
    bus: &mut impl AsyncRunner<N>,
    board: &mut impl Board,
    setup: Setup,
    cause: RestartCause,
) -> ! {
    let now = bus.now();
    let mut app = App::start(setup, cause, &mut Moment { now, master: bus.master(), board });
    loop {
        cycle_async(&mut app, bus, board).await;
    }
}

/// [`cycle`] as a task.
pub async fn cycle_async<const N: usize>(
    app: &mut App<N>,
    bus: &mut impl AsyncRunner<N>,
    board: &mut impl Board,
) {
    while bus.now() < app.next_cycle() {
        match bus.run(Some(app.next_cycle())).await {
            Ok(Some(event)) => {
                let now = bus.now();
                app.handle_event(&event, &mut Moment { now, master: bus.master(), board });
            }
            Ok(None) => {}
            Err(_) => {
                let now = bus.now();
                app.handle_bus_error(&mut Moment { now, master: bus.master(), board });
            }
        }
    }
    let now = bus.now();
    app.begin_cycle(&mut Moment { now, master: bus.master(), board });
}

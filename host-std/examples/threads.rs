//! One bus for several threads: two motors moved at the same time, what the bus reports, a motor that restarts, and
//! the stop of all, also by Ctrl-C.
//!
//! `cargo run -p myactuator-host-std --example threads`; after `--`, another bus than a simulated one

use std::error::Error;
use std::ops::ControlFlow;
use std::{io, thread};

use myactuator_host_std::open::BusAddress;
use myactuator_host_std::protocol::MotorId;
use myactuator_host_std::protocol::command::{AbsolutePosition, ReadMultiTurnAngle};
use myactuator_host_std::protocol::io::bring_up::MoveLimits;
use myactuator_host_std::protocol::master::{Event, MotorSet, StopKind};
use myactuator_host_std::protocol::units::{Angle, MaxSpeed};
use myactuator_host_std::share::{Guard, SharedBus};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// Errors that may come from another thread.
type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Moves one motor, and waits until it stands there.
fn reach(bus: &SharedBus, motor: MotorId, degrees: f32) -> Outcome<()> {
    let there = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(180.0)?,
        angle: Angle::from_degrees(degrees)?,
    };
    let limits = MoveLimits::default();
    let arrival = bus.move_to(motor, there, &limits, |_| ControlFlow::Continue(()))?;
    println!("motor {motor} is at {}", arrival.angle);
    Ok(())
}

/// Restarts a motor, as after an error. Its turns may be gone with that, so that nothing moves it until somebody has
/// seen where it believes to be, and says so.
fn restart(bus: &SharedBus, motor: MotorId) -> Outcome<()> {
    bus.restart(motor)?;
    println!("motor {motor} says that it is at {}", bus.ask(motor, ReadMultiTurnAngle)?.angle);
    bus.resume(motor)?;
    bus.release_brake(motor)?;
    reach(bus, motor, 10.0)
}

/// From now on Ctrl-C, a hang-up or a request to end stops all motors, so that whoever moves one is told, and leaves.
fn stop_at_signals(bus: &SharedBus) -> io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGHUP, SIGTERM])?;
    // A handle would keep the bus running.
    let bus = bus.downgrade();
    thread::spawn(move || {
        for _ in signals.forever() {
            if let Some(bus) = bus.upgrade() {
                // Who does not confirm it is reported.
                let _stopping = bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY);
            }
        }
    });
    Ok(())
}

fn run(address: &BusAddress) -> Outcome<()> {
    let arm = [MotorId::new(1)?, MotorId::new(2)?];
    let bus = SharedBus::open(address, StopKind::Hold)?;
    stop_at_signals(&bus)?;

    // Whoever is interested reads what the bus reports, in a thread that ends with the bus.
    let events = bus.subscribe(1000);
    let reporting = thread::spawn(move || {
        for event in events {
            match event {
                Event::Restarted { motor } => println!("motor {motor} has restarted"),
                Event::StopUnconfirmed { motor } => println!("cut the power of motor {motor}"),
                _ => {}
            }
        }
    });

    // However this is left from here on, by `?` or by its end, all motors are stopped.
    let guard = Guard::new(bus, StopKind::Hold);
    let moved = thread::scope(|scope| {
        let moving = arm.map(|motor| {
            let bus = &*guard;
            scope.spawn(move || {
                bus.release_brake(motor)?;
                reach(bus, motor, 45.0)
            })
        });
        moving.map(|moving| moving.join().expect("no thread panics"))
    });
    for outcome in moved {
        outcome?;
    }
    restart(&guard, arm[1])?;

    // Any thread may stop all motors, at any time, before anything else.
    let unconfirmed = guard.finish()?;
    // That was the last handle: the bus has ended.
    reporting.join().expect("it does not panic");
    if unconfirmed.is_empty() {
        Ok(())
    } else {
        Err(format!("cut the power of {unconfirmed}").into())
    }
}

fn main() -> Outcome<()> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "sim:2".to_owned());
    run(&address.parse()?)
}

#[test]
fn runs_on_either_bus_until_a_signal_ends_it() {
    for address in ["sim:2", "sim:2,rs485"] {
        run(&address.parse().unwrap()).unwrap();
    }
    for signal in [SIGINT, SIGHUP, SIGTERM] {
        let bus = SharedBus::open(&"sim:1".parse().unwrap(), StopKind::Hold).unwrap();
        stop_at_signals(&bus).unwrap();
        thread::spawn(move || {
            thread::sleep(std::time::Duration::from_millis(300));
            signal_hook::low_level::raise(signal).unwrap();
        });
        let ended = reach(&bus, MotorId::MIN, 3_600.0).unwrap_err();
        assert!(ended.to_string().contains("the motors were stopped"), "{signal}: {ended}");
    }
}

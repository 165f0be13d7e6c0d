//! One bus for several tasks, under a virtual clock: one owns it, and does what the others signal. Of what a task wants
//! only the newest counts, so nobody waits for the bus; a stop is looked at first; a task that falls silent is noticed.
//!
//! `cargo run -p myactuator-host-std --example several_tasks`; in firmware with signals of `CriticalSectionRawMutex`

use std::error::Error;

use embassy_futures::join::join4;
use embassy_futures::select::{Either3, select_array, select3};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::signal::Signal;
use myactuator_host_std::protocol::MotorId;
use myactuator_host_std::protocol::command::Speed;
use myactuator_host_std::protocol::io::{AsyncClock, AsyncRunner, CallError, guarded};
use myactuator_host_std::protocol::master::{MotorSet, StopKind};
use myactuator_host_std::protocol::time::{Duration, Instant};
use myactuator_host_std::protocol::units::{MaxTorque, SpeedTarget};
use myactuator_host_std::sim::{CanFleet, Fleet};

/// For this long a motor goes on as its task wanted last.
const LONGEST_SILENCE: Duration = Duration::from_millis(100);

type Wanted = Signal<NoopRawMutex, Speed>;
type Button = Signal<NoopRawMutex, ()>;

/// Why the task of the bus has ended.
#[derive(Debug, PartialEq)]
enum End {
    Pressed,
    /// The task of one of the motors wants nothing any more.
    Silent,
}

/// The task that owns the bus, until the button is pressed or another task falls silent. Then all motors are stopped,
/// as by each error: gives those that have not confirmed it, too.
async fn own<R: AsyncRunner<8>>(
    bus: &mut R,
    motors: [MotorId; 2],
    wanted: &[Wanted; 2],
    button: &Button,
) -> (Result<End, CallError<R::Error>>, MotorSet) {
    let work = async |bus: &mut R| {
        let mut latest = [bus.now() + LONGEST_SILENCE; 2];
        loop {
            let until = latest[0].min(latest[1]);
            if bus.now() >= until {
                return Ok(End::Silent);
            }
            let newest = select_array(wanted.each_ref().map(Signal::wait));
            // Whichever comes first. The bus goes on in the next round, since a future of it may be dropped.
            match select3(button.wait(), bus.run(Some(until)), newest).await {
                Either3::First(()) => return Ok(End::Pressed),
                // A `Watch` would note the event.
                Either3::Second(outcome) => drop(outcome.map_err(CallError::Bus)?),
                Either3::Third((speed, of)) => {
                    bus.set_point(motors[of], speed)?;
                    latest[of] = bus.now() + LONGEST_SILENCE;
                }
            }
        }
    };
    guarded(bus, StopKind::Hold, work).await
}

/// The task of a motor: has it turn so until then, now this way, now that way.
async fn swing(mut clock: impl AsyncClock, wanted: &Wanted, dps: f32, until: Instant) {
    for cycle in 0_u64.. {
        let way = if cycle / 25 % 2 == 0 { 1.0 } else { -1.0 };
        let speed = SpeedTarget::from_dps(way * dps).expect("a speed that motors have");
        wanted.signal(Speed { max_torque: MaxTorque::NO_LIMIT, speed });
        let next = clock.now() + Duration::from_millis(10);
        if next > until {
            return;
        }
        clock.wait_until(next).await;
    }
}

/// The task of a button that is pressed then.
async fn press(mut clock: impl AsyncClock, button: &Button, at: Instant) {
    clock.wait_until(at).await;
    button.signal(());
}

/// Presses the button then, where one of the tasks is silent from then on.
fn run(fleet: &CanFleet, pressed: Instant, silent: Instant) -> Result<End, Box<dyn Error>> {
    let (mut bus, clock) = (fleet.async_master::<8>(), || fleet.world.clock());
    let (wanted, button) = ([Wanted::new(), Wanted::new()], Button::new());
    let motors = [MotorId::new(1)?, MotorId::new(2)?];
    let end = Instant::from_millis(1_000);
    let ((ended, unconfirmed), ..) = fleet.block_on(join4(
        own(&mut bus, motors, &wanted, &button),
        swing(clock(), &wanted[0], 30.0, end),
        swing(clock(), &wanted[1], 60.0, silent),
        press(clock(), &button, pressed),
    ));
    let ended = ended?;
    if unconfirmed.is_empty() {
        Ok(ended)
    } else {
        Err(format!("cut the power of motors {unconfirmed}").into())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let fleet = Fleet::new(2).on_can(1_000_000)?;
    let ended = run(&fleet, Instant::from_millis(500), Instant::from_millis(1_000))?;
    println!(
        "{ended:?} at {:.3} s, and all motors stand",
        fleet.world.now().as_micros() as f64 / 1e6
    );
    Ok(())
}

#[test]
fn motors_stand_after_the_button_and_after_a_task_falls_silent() {
    let ms = Instant::from_millis;
    for (pressed, silent, expected) in
        [(ms(500), ms(1_000), End::Pressed), (ms(900), ms(300), End::Silent)]
    {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        assert_eq!(run(&fleet, pressed, silent).unwrap(), expected);
        for drive in &fleet.drives {
            let stands = drive.with(|drive| drive.plant().output_speed_dps().abs() < 0.5);
            assert!(stands, "motor {}", drive.motor());
        }
    }
}

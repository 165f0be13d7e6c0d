//! A robot of two arms from one file, under a virtual clock: both arms are moved at once, each by a task on its own
//! bus. All that was on the buses is printed as `candump -L` would, for `myactuator decode` and other tools.
//!
//! `cargo run -p myactuator-host-std --example two_arms | cargo run -- decode`

use std::error::Error;

use embassy_futures::join::join;
use myactuator_host_std::protocol::MotorId;
use myactuator_host_std::protocol::command::{AbsolutePosition, ReadMultiTurnAngle};
use myactuator_host_std::protocol::io::{AsyncRunner, async_bring_up, guarded};
use myactuator_host_std::protocol::master::{MotorSet, StopKind};
use myactuator_host_std::protocol::time::Duration;
use myactuator_host_std::protocol::units::{Angle, MaxSpeed};
use myactuator_host_std::protocol::wire::can::SimpleFrame;
use myactuator_host_std::sim::bus;
use myactuator_host_std::sim::bus::trace::{Event, Record};
use myactuator_host_std::sim::{CanFleet, Robot};
use myactuator_host_std::text::can::frame;

const ARM: [u8; 3] = [1, 2, 3];

/// Where the joints are, and those that have not confirmed the stop.
type Reached = (Result<[Angle; 3], Box<dyn Error>>, MotorSet);

/// Opens the brakes, has all joints go to these angles, and tells where they are after two seconds.
async fn reach<R: AsyncRunner<3>>(
    bus: &mut R,
    to_deg: [f32; 3],
) -> Result<[Angle; 3], Box<dyn Error>>
where
    R::Error: std::fmt::Debug + 'static,
{
    let arm = ARM.map(|id| MotorId::new(id).expect("1 to 32"));
    for motor in arm {
        async_bring_up::release_brake(bus, motor).await?;
    }
    let max_speed = MaxSpeed::from_dps(90.0)?;
    for (motor, degrees) in arm.into_iter().zip(to_deg) {
        let angle = Angle::from_degrees(degrees)?;
        bus.ask(motor, AbsolutePosition { max_speed, angle }).await?;
    }
    let there = bus.now() + Duration::from_secs(2);
    bus.run_until(there, |_event| {}).await?;
    let mut angles = [Angle::from_raw(0); 3];
    for (motor, angle) in arm.into_iter().zip(&mut angles) {
        *angle = bus.ask(motor, ReadMultiTurnAngle).await?.angle;
    }
    Ok(angles)
}

/// What a bus carries from now on, as lines of `candump -L` each with its time in nanoseconds.
fn listen(fleet: &CanFleet) -> impl Fn() -> Vec<(u64, String)> {
    let (log, name) = (fleet.world.log(), fleet.name.clone());
    move || {
        let line = |record: Record<SimpleFrame>| match record.event {
            Event::Carried { frame: it, .. } => {
                let seconds = record.at_ns as f64 / 1e9;
                Some((record.at_ns, format!("({seconds:.6}) {name} {}", frame(&it))))
            }
            _ => None,
        };
        log.take().into_iter().filter_map(line).collect()
    }
}

fn report(fleet: &CanFleet, (reached, running): Reached) -> Result<(), Box<dyn Error>> {
    let [shoulder, elbow, wrist] = reached?;
    eprintln!("{}: shoulder {shoulder}, elbow {elbow}, wrist {wrist}", fleet.name);
    if running.is_empty() { Ok(()) } else { Err(format!("cut the power of {running}").into()) }
}

fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::from_toml(include_str!("two_arms.toml"), "")?;
    let (left, right) = (robot.can("left")?, robot.can("right")?);
    let heard = [listen(&left), listen(&right)];

    let (mut of_left, mut of_right) = (left.async_master::<3>(), right.async_master::<3>());
    // However an arm's work ends, the arm is stopped.
    let both = join(
        guarded(&mut of_left, StopKind::Hold, async |bus| reach(bus, [40.0, 90.0, -30.0]).await),
        guarded(&mut of_right, StopKind::Hold, async |bus| reach(bus, [-40.0, 90.0, 30.0]).await),
    );
    // Time passes alike on both buses.
    let (of_left, of_right) = bus::block_on(&[&left.world, &right.world], both);

    let mut lines: Vec<_> = heard.iter().flat_map(|heard| heard()).collect();
    lines.sort();
    lines.iter().for_each(|(_, line)| println!("{line}"));
    report(&left, of_left)?;
    report(&right, of_right)
}

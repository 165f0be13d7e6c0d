//! Simulated motors whose shafts another process moves: `mechanics.py` beside this file.
//!
//! `python3 host-std/examples/mechanics.py /tmp/mechanics &`
//! `cargo run -p myactuator-host-std --example own_mechanics -- /tmp/mechanics`

use std::error::Error;
use std::os::unix::net::UnixStream;

use myactuator_host_std::protocol::MotorId;
use myactuator_host_std::protocol::command::AbsolutePosition;
use myactuator_host_std::protocol::io::Runner;
use myactuator_host_std::protocol::time::Duration;
use myactuator_host_std::protocol::units::{Angle, MaxSpeed};
use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::mechanics::Remote;
use myactuator_host_std::sim::plant::MotorParameters;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("which socket? See the first lines of this file.")?;
    let process = UnixStream::connect(&path)?;
    // A process that hangs is as good as none.
    process.set_read_timeout(Some(std::time::Duration::from_secs(5)))?;

    let model = MotorParameters::named("RMD-X8-P20-120")?;
    let fleet = Fleet::new(2).model(model).on_can(1_000_000)?;
    fleet.lead(&fleet.drives, Duration::from_micros(500), Remote::new(process))?;

    // Motor 1 turns; motor 2, which nobody drives, is drawn along by the spring between the two.
    let turn = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(90.0)?,
        angle: Angle::from_degrees(60.0)?,
    };
    fleet.master::<2>().ask(MotorId::new(1)?, turn)?;
    for _ in 0..5 {
        fleet.world.run_for(Duration::from_millis(400));
        let angle = |place: usize| fleet.drives[place].with(|it| it.plant().output_angle_deg());
        let [first, second] = [angle(0), angle(1)];
        let seconds = fleet.world.now().as_micros() as f64 / 1e6;
        println!("{seconds:.1}s: {first:.2} deg, {second:.2} deg");
    }
    match fleet.mechanics_failure() {
        Some(failure) => Err(failure.into()),
        None => Ok(()),
    }
}

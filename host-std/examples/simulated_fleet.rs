//! Simulated drives under a virtual clock: a test that takes no time and is the same in every run.
//!
//! `cargo run -p myactuator-host-std --example simulated_fleet`

use std::error::Error;

use myactuator_host_std::protocol::MotorId;
use myactuator_host_std::protocol::command::{AbsolutePosition, ReadMultiTurnAngle};
use myactuator_host_std::protocol::io::Runner;
use myactuator_host_std::protocol::time::Duration;
use myactuator_host_std::protocol::units::{Angle, MaxSpeed};
use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::plant::Load;

fn main() -> Result<(), Box<dyn Error>> {
    let fleet = Fleet::new(3).seed(7).on_can(1_000_000)?;
    let mut master = fleet.master::<3>();

    // A bad cable loses every tenth reply; a weight of 2 N·m hangs on the shaft of motor 2.
    let bad_cable = FaultPlan { lose: 0.1, ..FaultPlan::NONE };
    fleet.world.set_faults(Direction::ToPorts, bad_cable);
    let weight = Load { torque_nm: -2.0, ..Load::NONE };
    fleet.drives[1].with(|drive| drive.plant_mut().set_load(weight))?;

    let quarter = AbsolutePosition {
        max_speed: MaxSpeed::from_dps(90.0)?,
        angle: Angle::from_degrees(90.0)?,
    };
    for motor in MotorId::all().take(3) {
        master.ask(motor, quarter)?;
    }
    for _ in 0..4 {
        fleet.world.run_for(Duration::from_millis(500));
        print!("{:.1} s:", fleet.world.now().as_micros() as f64 / 1e6);
        for motor in MotorId::all().take(3) {
            let told = master.ask(motor, ReadMultiTurnAngle)?.angle;
            let lost = master.master().health(motor).lost;
            print!("  motor {motor} at {told}, replies lost: {lost};");
        }
        println!();
    }

    // What the master cannot know: where the shafts really are.
    for drive in &fleet.drives {
        let degrees = drive.with(|drive| drive.plant().output_angle_deg());
        println!("motor {} is at {degrees:.3} deg", drive.motor());
    }
    Ok(())
}

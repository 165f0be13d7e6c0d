//! `myactuator demo`: four simulated drives, from first contact to shutdown.

use std::error::Error;
use std::f32::consts::TAU;
use std::io::{self, StdoutLock, Write};
use std::ops::ControlFlow;

use clap::Args;
use myactuator_host_std::BusKind;
use myactuator_host_std::open::AnyMaster;
use myactuator_host_std::sim::Fleet;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    AbsolutePosition, AnyReply, MotionRanges, MotionSetPoint, ReadMultiTurnAngle, ReadStatus2,
};
use myactuator_protocol_core::io::{Runner, bring_up};
use myactuator_protocol_core::master::{Event, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, MaxSpeed};

use super::{Outcome, Unfinished, names};

const MOTORS: u8 = 4;
/// Of either bus.
const BIT_RATE: u32 = 1_000_000;

/// Show four simulated drives at work: no motor and no bus needed
///
/// A master finds and identifies them, moves one, streams set-points to all and shuts them down.
///
/// Exit status: 0 all shown, 1 not, 2 wrong usage.
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// The bus that they are on
    #[arg(long, value_parser = names::bus(), default_value_t)]
    bus: BusKind,
}

type Told<T = ()> = Result<T, Box<dyn Error>>;

pub(super) fn run(arguments: &Arguments) -> Outcome {
    Tour::start(arguments.bus).and_then(Tour::run).map_err(|error| {
        let io_error = error.downcast_ref::<io::Error>();
        match io_error.map(io::Error::kind) {
            Some(io::ErrorKind::BrokenPipe) => Unfinished::ReaderLeft,
            _ => Unfinished::Failed(format!("the demonstration ended early: {error}")),
        }
    })
}

/// A master, its kind of bus, and the output.
struct Tour {
    bus: BusKind,
    master: AnyMaster<8>,
    out: StdoutLock<'static>,
}

impl Tour {
    fn start(bus: BusKind) -> Told<Self> {
        let fleet = Fleet::new(MOTORS);
        let mut out = io::stdout().lock();
        let (master, name) = match bus {
            BusKind::Can => {
                (AnyMaster::SimulatedCan(fleet.on_can(BIT_RATE)?.master()), "a CAN bus")
            }
            BusKind::Rs485 => {
                (AnyMaster::SimulatedRs485(fleet.on_rs485(BIT_RATE)?.master()), "an RS485 line")
            }
        };
        writeln!(
            out,
            "{MOTORS} simulated drives on {name} at {} Mbit/s, in virtual time.",
            BIT_RATE / 1_000_000
        )?;
        Ok(Self { bus, master, out })
    }

    fn run(mut self) -> Told {
        let motors = self.find()?;
        self.identify(motors)?;
        self.go()?;
        if self.bus == BusKind::Rs485 {
            writeln!(
                self.out,
                "\nMotion mode exists on CAN only; here the motors follow absolute positions."
            )?;
        }
        self.stream(motors)?;
        self.shut_down(motors)
    }

    fn find(&mut self) -> Told<MotorSet> {
        let start = self.master.now();
        let motors = bring_up::scan(&mut self.master, MotorSet::ALL, |_, _| {})?;
        let (span, count) = (self.seconds_since(start), motors.len());
        writeln!(self.out, "\nAsked for ids 1 to 32 in {span:.2} s: {count} answer ({motors}).")?;
        Ok(motors)
    }

    fn identify(&mut self, motors: MotorSet) -> Told {
        writeln!(self.out)?;
        for motor in motors.iter() {
            let is = bring_up::identify(&mut self.master, motor)?;
            let feedback = self.master.ask(motor, ReadStatus2)?;
            writeln!(
                self.out,
                "  motor {motor}: {}, software of {}, up for {:.1} s, {}, {}, {}, at {}",
                is.model.map_or("no model".to_owned(), |model| model.to_string()),
                is.version,
                f64::from(is.run_time.raw()) / 1000.0,
                is.status.voltage,
                is.status.temperature,
                is.status.errors,
                feedback.angle,
            )?;
        }
        Ok(())
    }

    /// Moves motor 1 to an angle and shows where it is on the way.
    fn go(&mut self) -> Told {
        const TARGET_DEG: f32 = 90.0;
        const LINE_EVERY: Duration = Duration::from_millis(100);
        let motor = MotorId::MIN;
        let max_speed = MaxSpeed::from_dps(180.0)?;
        let angle = Angle::from_degrees(TARGET_DEG)?;
        writeln!(self.out, "\nMotor {motor} goes to {angle}, at {max_speed} at the most:\n")?;
        let command = AbsolutePosition { max_speed, angle };
        let limits = bring_up::MoveLimits::default();
        let (mut next, mut shown) = (Duration::ZERO, Ok(()));
        let end = bring_up::move_to(&mut self.master, motor, command, &limits, |look| {
            if look.time < next {
                return ControlFlow::Continue(());
            }
            next = next + LINE_EVERY;
            let (span, degrees) = (look.time.as_secs_f32(), look.angle.degrees());
            let dps = look.feedback.speed.to_string();
            let bar = "#".repeat((degrees / TARGET_DEG * 40.0).clamp(0.0, 40.0) as usize);
            shown = writeln!(self.out, "  {span:4.1} s {degrees:7.2} deg {dps:>8}  |{bar:<40}|");
            if shown.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        shown?;
        let arrival = end?;
        let (at, span) = (arrival.angle, arrival.time.as_secs_f32());
        writeln!(self.out, "\n  It has arrived at {at} after {span:.2} s.")?;
        Ok(())
    }

    /// For two seconds, sends every motor its next set-point as soon as it has answered the last.
    fn stream(&mut self, motors: MotorSet) -> Told {
        const SPAN: Duration = Duration::from_secs(2);
        let mut centres = [0.0_f32; MotorId::COUNT];
        for motor in motors.iter() {
            let angle = self.master.ask(motor, ReadMultiTurnAngle)?.angle;
            centres[motor.index()] = angle.degrees().to_radians();
        }
        let start = self.master.now();
        let mut answers = 0_u32;
        let (mut lowest, mut highest) = (f32::INFINITY, f32::NEG_INFINITY);
        for motor in motors.iter() {
            self.swing(motor, centres[motor.index()], 0.0)?;
        }
        while self.master.now() - start < SPAN {
            let Some(event) = self.master.poll()? else {
                self.master.idle(start + SPAN);
                continue;
            };
            let Event::Feedback { motor, reply } = event else { continue };
            answers += 1;
            if motor == MotorId::MIN {
                let degrees = measured_deg(&reply);
                (lowest, highest) = (lowest.min(degrees), highest.max(degrees));
            }
            let time = (self.master.now() - start).as_secs_f32();
            self.swing(motor, centres[motor.index()], time)?;
        }
        let span = f64::from((self.master.now() - start).as_secs_f32());
        let count = motors.len();
        let rate = f64::from(answers) / count as f64 / span;
        let title = match self.bus {
            BusKind::Can => "Motion mode",
            BusKind::Rs485 => "Position",
        };
        writeln!(
            self.out,
            "\n{title}: all {count} motors swing at {rate:.0} set-points a second each.\n  \
             Motor 1 swings from {lowest:.1} to {highest:.1} deg."
        )?;
        Ok(())
    }

    /// Sends the next set-point of a swing of ±0.5 rad, one a second, around the angle of a motor: in motion mode where
    /// that exists, else as absolute positions.
    fn swing(&mut self, motor: MotorId, centre_rad: f32, time: f32) -> Told {
        let phase = TAU * time;
        let position_rad = centre_rad + 0.5 * phase.sin();
        match self.bus {
            BusKind::Can => {
                let velocity_rad_s = 0.5 * TAU * phase.cos();
                let (kp, kd, torque_nm) = (40.0, 2.0, 0.0);
                let set_point = MotionSetPoint { position_rad, velocity_rad_s, kp, kd, torque_nm };
                self.master.set_point(motor, MotionRanges::V4_3.quantise(&set_point)?)?;
            }
            BusKind::Rs485 => {
                let max_speed = MaxSpeed::from_dps(360.0)?;
                let angle = Angle::from_degrees(position_rad.to_degrees())?;
                self.master.set_point(motor, AbsolutePosition { max_speed, angle })?;
            }
        }
        Ok(())
    }

    fn shut_down(mut self, motors: MotorSet) -> Told {
        let start = self.master.now();
        let unconfirmed = self.master.stop_all(StopKind::Off, motors);
        if !unconfirmed.is_empty() {
            return Err(
                format!("these motors have not confirmed the shutdown: {unconfirmed}").into()
            );
        }
        let (count, span_ms) = (motors.len(), 1e3 * self.seconds_since(start));
        writeln!(self.out, "\nShut down: all {count} have confirmed within {span_ms:.1} ms.")?;
        write!(self.out, "Replies lost of those received:")?;
        for motor in motors.iter() {
            let health = self.master.master().health(motor);
            write!(self.out, " {motor}: {}/{}", health.lost, health.answered)?;
        }
        writeln!(self.out, ".")?;
        Ok(())
    }

    fn seconds_since(&self, start: Instant) -> f64 {
        (self.master.now() - start).as_micros() as f64 / 1e6
    }
}

fn measured_deg(reply: &AnyReply) -> f32 {
    match reply {
        AnyReply::Motion(raw) => MotionRanges::V4_3.feedback(raw).position_rad.to_degrees(),
        AnyReply::AbsolutePosition(feedback) => feedback.angle.degrees(),
        _ => f32::NAN,
    }
}

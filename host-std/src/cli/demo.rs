//! `myactuator demo`: four simulated drives, from first contact to shutdown.

use std::error::Error;
use std::fmt::Write as _;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use clap::Args;
use myactuator_host_std::BusKind;
use myactuator_host_std::sim::Fleet;
use myactuator_host_std::sim::bus::{Medium, World, trace};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::{
    AbsolutePosition, AnyReply, Feedback, MotionRanges, MotionSetPoint, ReadMultiTurnAngle,
    ReadStatus2,
};
use myactuator_protocol_core::io::{Runner, bring_up};
use myactuator_protocol_core::master::{Bus, Config, Event, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, MaxSpeed};

use super::{DONE, FAILED, names, tell};

const MOTORS: u8 = 4;
const CAN_BIT_RATE: u32 = 1_000_000;
const RS485_BIT_RATE: u32 = 1_000_000;
/// What the simulated drives take from a command to its reply, on average.
const RESPONSE: Duration = Duration::from_micros(800);
const RESPONSE_SPREAD: Duration = Duration::from_micros(100);

/// Show four simulated drives at work: no motor and no bus needed
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// The bus that they are on
    #[arg(long, value_parser = names::bus(), default_value_t)]
    bus: BusKind,
}

type Failure = Box<dyn Error + Send + Sync>;

/// Runs the demonstration.
pub(super) fn run(arguments: &Arguments) -> u8 {
    let out = &mut io::stdout().lock();
    match show(arguments.bus, out) {
        Ok(()) => DONE,
        // Nobody is left to tell: `… | head`.
        Err(error) if is_broken_pipe(&*error) => DONE,
        Err(error) => {
            tell("error", format_args!("the demonstration ended early: {error}"));
            FAILED
        }
    }
}

fn is_broken_pipe(error: &(dyn Error + Send + Sync + 'static)) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

fn show(bus: BusKind, out: &mut impl Write) -> Result<(), Failure> {
    let min = Duration::from_micros(RESPONSE.as_micros() - RESPONSE_SPREAD.as_micros());
    let fleet = Fleet::new(MOTORS).response(min, RESPONSE + RESPONSE_SPREAD);
    match bus {
        BusKind::Can => {
            let fleet = fleet.on_can(CAN_BIT_RATE)?;
            writeln!(
                out,
                "{MOTORS} simulated drives on a CAN bus at {} Mbit/s, in virtual time.",
                CAN_BIT_RATE / 1_000_000
            )?;
            let traffic = Traffic::watch(&fleet.world);
            tour(&mut fleet.master::<8>(), Wire { bus, traffic }, out)
        }
        BusKind::Rs485 => {
            let fleet = fleet.on_rs485(RS485_BIT_RATE)?;
            writeln!(
                out,
                "{MOTORS} simulated drives on an RS485 line at {} Mbit/s, in virtual time.",
                RS485_BIT_RATE / 1_000_000
            )?;
            let traffic = Traffic::watch(&fleet.world);
            tour(&mut fleet.master::<8>(), Wire { bus, traffic }, out)
        }
    }
}

/// What is known about the wire under the tour.
struct Wire {
    bus: BusKind,
    traffic: Traffic,
}

fn tour<R: Runner<8>>(master: &mut R, wire: Wire, out: &mut impl Write) -> Result<(), Failure>
where
    R::Error: Send + Sync + 'static,
{
    let motors = find(master, out)?;
    identify(master, motors, out)?;
    go(master, out)?;
    match wire.bus {
        BusKind::Can => {
            stream(master, motors, &wire.traffic, "Motion mode", motion, bound_on_can, out)?
        }
        BusKind::Rs485 => {
            writeln!(
                out,
                "\nMotion mode exists on CAN only; here the motors follow absolute positions."
            )?;
            stream(master, motors, &wire.traffic, "Position", position, bound_on_rs485, out)?;
        }
    }
    shut_down(master, motors, out)
}

fn find<R: Runner<8>>(master: &mut R, out: &mut impl Write) -> Result<MotorSet, Failure>
where
    R::Error: Send + Sync + 'static,
{
    let start = master.now();
    let motors = bring_up::scan(master, MotorSet::ALL, |_, _| {})?;
    writeln!(
        out,
        "\nAsked for ids 1 to 32 in {:.2} s: {} answer ({motors}).",
        seconds(start, master),
        motors.len()
    )?;
    Ok(motors)
}

fn identify<R: Runner<8>>(
    master: &mut R,
    motors: MotorSet,
    out: &mut impl Write,
) -> Result<(), Failure>
where
    R::Error: Send + Sync + 'static,
{
    writeln!(out)?;
    for motor in motors.iter() {
        let is = bring_up::identify(master, motor)?;
        let feedback: Feedback = master.ask(motor, ReadStatus2)?;
        writeln!(
            out,
            "  motor {motor}: {}, software of {}, up for {:.1} s, {}, {}, {}, at {}",
            is.model,
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

/// Moves motor 1 to an angle and watches it arrive.
fn go<R: Runner<8>>(master: &mut R, out: &mut impl Write) -> Result<(), Failure>
where
    R::Error: Send + Sync + 'static,
{
    const TARGET_DEG: f32 = 90.0;
    const NEAR_DEG: f32 = 0.1;
    const LONGEST: Duration = Duration::from_secs(5);
    let motor = MotorId::MIN;
    let max_speed = MaxSpeed::from_dps(180.0)?;
    writeln!(out, "\nMotor {motor} goes to {TARGET_DEG} deg, at {max_speed} at the most:\n")?;
    let start = master.now();
    master.ask(motor, AbsolutePosition { max_speed, angle: Angle::from_degrees(TARGET_DEG)? })?;
    for tick in 0.. {
        wait_until(master, start + Duration::from_millis(100).times(tick))?;
        let degrees = master.ask(motor, ReadMultiTurnAngle)?.angle.degrees();
        let speed = master.ask(motor, ReadStatus2)?.speed;
        let bar = "#".repeat((degrees / TARGET_DEG * 40.0).clamp(0.0, 40.0) as usize);
        writeln!(
            out,
            "  {:4.1} s {degrees:7.2} deg {:>8}  |{bar:<40}|",
            seconds(start, master),
            speed.to_string()
        )?;
        if (degrees - TARGET_DEG).abs() <= NEAR_DEG && speed.dps() == 0.0 {
            writeln!(out, "\n  It has arrived.")?;
            return Ok(());
        }
        if master.now() - start > LONGEST {
            return Err(
                format!("motor {motor} has not reached {TARGET_DEG} deg within {LONGEST}").into()
            );
        }
    }
    Ok(())
}

/// A swing of ±0.5 rad around where each motor is.
fn motion<R: Runner<8>>(
    master: &mut R,
    motor: MotorId,
    centre_rad: f32,
    time: f32,
) -> Result<(), Failure> {
    let phase = std::f32::consts::TAU * time;
    let set_point = MotionSetPoint {
        position_rad: centre_rad + 0.5 * phase.sin(),
        velocity_rad_s: 0.5 * std::f32::consts::TAU * phase.cos(),
        kp: 40.0,
        kd: 2.0,
        torque_nm: 0.0,
    };
    master.set_point(motor, MotionRanges::V4_3.quantise(&set_point)?)?;
    Ok(())
}

/// The same swing, by absolute positions.
fn position<R: Runner<8>>(
    master: &mut R,
    motor: MotorId,
    centre_rad: f32,
    time: f32,
) -> Result<(), Failure> {
    let degrees = (centre_rad + 0.5 * (std::f32::consts::TAU * time).sin()).to_degrees();
    let angle = Angle::from_degrees(degrees)?;
    master.set_point(motor, AbsolutePosition { max_speed: MaxSpeed::from_dps(360.0)?, angle })?;
    Ok(())
}

type SetPoint<R> = fn(&mut R, MotorId, f32, f32) -> Result<(), Failure>;

/// Gives every motor its next set-point as soon as it has answered the last, for two seconds.
fn stream<R: Runner<8>>(
    master: &mut R,
    motors: MotorSet,
    traffic: &Traffic,
    title: &str,
    set_point: SetPoint<R>,
    bound: fn(MotorSet, &Mean) -> f64,
    out: &mut impl Write,
) -> Result<(), Failure>
where
    R::Error: Send + Sync + 'static,
{
    const SPAN: Duration = Duration::from_secs(2);
    let mut centres = [0.0_f32; MotorId::COUNT];
    for motor in motors.iter() {
        centres[motor.index()] =
            master.ask(motor, ReadMultiTurnAngle)?.angle.degrees().to_radians();
    }
    let start = master.now();
    traffic.restart();
    let mut answers = 0_u32;
    let mut swing_deg = (f32::INFINITY, f32::NEG_INFINITY);
    for motor in motors.iter() {
        set_point(master, motor, centres[motor.index()], 0.0)?;
    }
    while master.now() - start < SPAN {
        let Some(event) =
            master.poll().map_err(|error| format!("the bus reports an error: {error:?}"))?
        else {
            master.idle(start + SPAN);
            continue;
        };
        let Event::Feedback { motor, reply } = event else { continue };
        answers += 1;
        if motor == MotorId::MIN {
            let degrees = measured_deg(&reply);
            swing_deg = (swing_deg.0.min(degrees), swing_deg.1.max(degrees));
        }
        let time = (master.now() - start).as_secs_f32();
        set_point(master, motor, centres[motor.index()], time)?;
    }
    let rate =
        f64::from(answers) / motors.len() as f64 / f64::from((master.now() - start).as_secs_f32());
    let bound = bound(motors, &traffic.mean());
    writeln!(
        out,
        "\n{title}: all {} motors swing at {rate:.0} set-points a second each.\n  \
         The wire and the drives' {RESPONSE} set a bound of {bound:.0}: that is {:.0} % of it.\n  \
         Motor 1 swings from {:.1} to {:.1} deg.",
        motors.len(),
        100.0 * rate / bound,
        swing_deg.0,
        swing_deg.1,
    )?;
    Ok(())
}

fn measured_deg(reply: &AnyReply) -> f32 {
    match reply {
        AnyReply::Motion(raw) => MotionRanges::V4_3.feedback(raw).position_rad.to_degrees(),
        AnyReply::AbsolutePosition(feedback) => feedback.angle.degrees(),
        _ => f32::NAN,
    }
}

fn shut_down<R: Runner<8>>(
    master: &mut R,
    motors: MotorSet,
    out: &mut impl Write,
) -> Result<(), Failure>
where
    R::Error: Send + Sync + 'static,
{
    let start = master.now();
    let unconfirmed = master.stop_all(StopKind::Off, motors);
    if !unconfirmed.is_empty() {
        return Err(format!("these motors have not confirmed the shutdown: {unconfirmed}").into());
    }
    writeln!(
        out,
        "\nShut down: all {} have confirmed within {:.1} ms.",
        motors.len(),
        1e3 * seconds(start, master)
    )?;
    let mut lost = String::new();
    for motor in motors.iter() {
        let health = master.master().health(motor);
        write!(lost, " {motor}: {}/{}", health.lost, health.answered)?;
    }
    writeln!(out, "Replies lost of those received:{lost}.")?;
    Ok(())
}

fn seconds<R: Runner<8>>(since: Instant, master: &R) -> f64 {
    (master.now() - since).as_micros() as f64 / 1e6
}

fn wait_until<R: Runner<8>>(master: &mut R, until: Instant) -> Result<(), Failure> {
    while master.now() < until {
        if master.poll().map_err(|error| format!("the bus reports an error: {error:?}"))?.is_none()
        {
            master.idle(until);
        }
    }
    Ok(())
}

/// Mean times on the wire, in seconds.
struct Mean {
    command: f64,
    reply: f64,
}

/// Sums up how long commands and replies are on the wire.
#[derive(Clone, Default)]
struct Traffic(Arc<Mutex<Sums>>);

#[derive(Default)]
struct Sums {
    command_ns: u64,
    commands: u64,
    reply_ns: u64,
    replies: u64,
}

impl Traffic {
    fn watch<B: Medium>(world: &World<B>) -> Self {
        let traffic = Self::default();
        let sums = Arc::clone(&traffic.0);
        world.observe(move |record| {
            if let trace::Event::Carried { started_ns, .. } = record.event {
                let mut sums = sums.lock().unwrap_or_else(PoisonError::into_inner);
                let span = record.at_ns - started_ns;
                // The drives are attached first, the master last.
                if record.station.index() < usize::from(MOTORS) {
                    sums.reply_ns += span;
                    sums.replies += 1;
                } else {
                    sums.command_ns += span;
                    sums.commands += 1;
                }
            }
        });
        traffic
    }

    fn restart(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Sums::default();
    }

    fn mean(&self) -> Mean {
        let sums = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mean = |ns: u64, count: u64| ns as f64 / 1e9 / count.max(1) as f64;
        Mean {
            command: mean(sums.command_ns, sums.commands),
            reply: mean(sums.reply_ns, sums.replies),
        }
    }
}

/// A motor's next command follows its reply, and the wire carries one frame at a time with a pause of
/// three bits after each.
fn bound_on_can(motors: MotorSet, mean: &Mean) -> f64 {
    let pause = 3.0 / f64::from(CAN_BIT_RATE);
    let wire = mean.command + mean.reply + 2.0 * pause;
    let response = RESPONSE.as_micros() as f64 / 1e6;
    1.0 / (wire * motors.len() as f64).max(wire + response)
}

/// One exchange at a time on the whole line, the drives' response and turning around included.
fn bound_on_rs485(motors: MotorSet, mean: &Mean) -> f64 {
    let turnaround = match Config::rs485(RS485_BIT_RATE, false).bus {
        Bus::Rs485 { turnaround, .. } => turnaround,
        Bus::Can => Duration::ZERO,
    };
    let waiting = (RESPONSE + turnaround).as_micros() as f64 / 1e6;
    1.0 / ((mean.command + waiting + mean.reply) * motors.len() as f64)
}

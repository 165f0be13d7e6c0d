//! Controllers of other kinds, a host that looks now and then, and loss: the mean of all motors and the slowest motor.

use myactuator_host_std::sim::bus::can::{ControllerConfig, QueueOrder};
use myactuator_protocol_core::command::ReadStatus2;
use myactuator_protocol_core::io::{CanMaster, Clock, Runner};
use myactuator_protocol_core::master::{Config, Event};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Channel, MotorId, Packet};

use crate::stage::{INTERMISSION_S, Seen, Stage, Surroundings};
use crate::{
    Kind, LIMIT, RESPONSE_MAX, RESPONSE_MIN, SETTLE, SPAN, command, cycle_s, for_each_count,
    reference, swing,
};

const LONGEST_PAUSE: Duration = Duration::from_millis(1);
const LOSS: f32 = 0.01;

#[derive(Clone, Copy)]
enum Controller {
    Fifo,
    /// Three mailboxes that send in the order in which they were filled.
    InOrder,
    /// Three mailboxes that send by priority. A more urgent frame pushes another out.
    ByPriority,
}

impl Controller {
    const fn config(self) -> ControllerConfig {
        match self {
            Self::Fifo => ControllerConfig::SOCKETCAN,
            Self::InOrder => {
                ControllerConfig { order: QueueOrder::Fifo, ..ControllerConfig::MAILBOXES }
            }
            Self::ByPriority => ControllerConfig::MAILBOXES,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Fifo => "FIFO of ten",
            Self::InOrder => "three in order",
            Self::ByPriority => "three mailboxes",
        }
    }
}

#[derive(Clone, Copy)]
enum Looking {
    AtOnce,
    NowAndThen,
}

/// One line of the table, with the largest ratios to the bound: of the mean of the motors and of the slowest.
struct Case(Kind, Controller, Looking, f32, [f64; 2]);

/// The budget is [`LIMIT`] for all. A case that does not keep it today has a ceiling at its present figure:
///
/// - A host that looks now and then: no motor gets more than two rounds ahead of one whose answer may be pending. So
///   sooner or later all motors wait for the last reply and for the look that finds it. The more commands a look may
///   queue, the longer replies wait for them: a FIFO of ten is slower than three mailboxes.
/// - Mailboxes by priority with such a host: after a short pause frames of the last look are still pending, and
///   commands with lower ids would push them out. So fewer commands go then, although the wire may be free sooner. All
///   commands of a look go in the order of the ids, so the last motor of three is slower anyway.
/// - A set-point whose feedback is lost is waited for until a less urgent reply has come, and for three usual round
///   trips. For the motor of the highest id there is no such reply: the other motors get two rounds ahead of it, and
///   wait until the bus was quiet.
/// - A request that is lost: see the crate's documentation.
const CASES: [Case; 20] = {
    use Controller::{ByPriority, Fifo, InOrder};
    use Kind::{Feedback, Motion};
    use Looking::{AtOnce, NowAndThen};
    const BUDGET: [f64; 2] = [LIMIT; 2];
    [
        Case(Motion, Fifo, AtOnce, 0.0, BUDGET),
        Case(Motion, InOrder, AtOnce, 0.0, BUDGET),
        Case(Motion, ByPriority, AtOnce, 0.0, BUDGET),
        Case(Motion, Fifo, NowAndThen, 0.0, [1.15, 1.15]),
        Case(Motion, InOrder, NowAndThen, 0.0, [1.06, 1.06]),
        Case(Motion, ByPriority, NowAndThen, 0.0, [1.10, 1.10]),
        Case(Motion, Fifo, AtOnce, LOSS, [1.09, 1.10]),
        Case(Motion, InOrder, AtOnce, LOSS, [1.09, 1.10]),
        Case(Motion, ByPriority, AtOnce, LOSS, [1.10, 1.10]),
        Case(Motion, Fifo, NowAndThen, LOSS, [1.12, 1.16]),
        Case(Motion, InOrder, NowAndThen, LOSS, [1.09, 1.13]),
        Case(Motion, ByPriority, NowAndThen, LOSS, [1.12, 1.14]),
        Case(Feedback, Fifo, AtOnce, 0.0, BUDGET),
        Case(Feedback, ByPriority, AtOnce, 0.0, BUDGET),
        Case(Feedback, Fifo, NowAndThen, 0.0, [1.15, 1.15]),
        Case(Feedback, ByPriority, NowAndThen, 0.0, [1.10, 1.10]),
        Case(Feedback, Fifo, AtOnce, LOSS, [2.66, 3.15]),
        Case(Feedback, ByPriority, AtOnce, LOSS, [2.72, 3.05]),
        Case(Feedback, Fifo, NowAndThen, LOSS, [2.04, 2.49]),
        Case(Feedback, ByPriority, NowAndThen, LOSS, [2.17, 2.56]),
    ]
};

/// Ratios of the cycle time to its bound.
struct Ratios {
    mean: f64,
    slowest: f64,
}

impl Case {
    fn surroundings(&self) -> Surroundings {
        let &Self(_, controller, looking, loss, _) = self;
        let longest_pause = match looking {
            Looking::AtOnce => None,
            Looking::NowAndThen => Some(LONGEST_PAUSE),
        };
        Surroundings { controller: controller.config(), longest_pause, loss }
    }

    fn measure(&self, motors: u8) -> Ratios {
        let kind = self.0;
        let Stage { motors, port, host, seen, looks, responses } =
            Stage::new(self.surroundings(), motors);
        let mut bus = CanMaster::<_, _, 32>::new(port, host, Config::CAN);
        let mut order = motors.clone();
        if matches!(self.1, Controller::ByPriority) {
            // By rising urgency, so that mailboxes push frames out, which happens sooner or later in any program.
            order.reverse();
        }
        for motor in order {
            command(&mut bus, motor, kind);
            let event = bus.poll();
            assert!(matches!(event, Ok(None)), "nobody answers yet: {event:?}");
        }
        let start = bus.now() + SETTLE;
        run(&mut bus, kind, start);
        Stage::forget(&seen, &looks, &responses);
        let answers = run(&mut bus, kind, start + SPAN);
        let seen = seen.lock().unwrap();
        let bound_s =
            self.bound_s(&seen, &looks.lock().unwrap(), &responses.lock().unwrap(), motors.len());
        let (mut cycles_s, mut bounds_s, mut slowest) = (0.0, 0.0, 0.0_f64);
        for motor in motors {
            let answers = &answers[motor.index()];
            let lost = f64::from(seen.lost[motor.index()]);
            let (cycle_s, bound_s) =
                (cycle_s(answers), bound_s * (1.0 + lost / answers.len() as f64));
            cycles_s += cycle_s;
            bounds_s += bound_s;
            slowest = slowest.max(cycle_s / bound_s);
        }
        Ratios { mean: cycles_s / bounds_s, slowest }
    }

    /// The bound of a cycle without loss.
    fn bound_s(&self, seen: &Seen, looks: &[Instant], responses: &[u64], motors: usize) -> f64 {
        let frame_s = seen.frames_ns.iter().sum::<u64>() as f64 / 1e9 / seen.frames_ns.len() as f64;
        let wire_s = 2.0 * frame_s * motors as f64;
        // Only the next frame waits for the intermission.
        let frames_s = 2.0 * (frame_s - INTERMISSION_S);
        match self.2 {
            Looking::AtOnce => {
                let response_us = responses.iter().sum::<u64>() as f64 / responses.len() as f64;
                wire_s.max(frames_s + response_us / 1e6)
            }
            Looking::NowAndThen => {
                wire_s.max(turn_s(looks, frames_s)).max(self.reference_s(motors as u8))
            }
        }
    }

    /// Cycle time of a master without rules, without loss.
    fn reference_s(&self, motors: u8) -> f64 {
        let surroundings = Surroundings { loss: 0.0, ..self.surroundings() };
        let Stage { motors, mut port, host, .. } = Stage::new(surroundings, motors);
        let next = |motor: MotorId| match self.0 {
            Kind::Feedback => {
                Packet { channel: Channel::Command(motor.into()), data: ReadStatus2.encode() }
            }
            Kind::Motion => swing(motor, host.now()).packet(motor),
        };
        let (ready, start) = (motors.iter().copied().collect(), host.now() + SETTLE);
        let answers = reference::answers(&mut port, &host, ready, next, start, start + SPAN);
        SPAN.as_micros() as f64 / 1e6 / f64::from(answers) * motors.len() as f64
    }
}

/// Mean time from a look that sends a command to the first look that finds the reply, if both frames together take
/// `frames_s`: over all looks, and evenly over all responses.
fn turn_s(looks: &[Instant], frames_s: f64) -> f64 {
    let (mut sum_us, mut count) = (0, 0);
    for response in (RESPONSE_MIN.as_micros()..=RESPONSE_MAX.as_micros()).step_by(20) {
        let busy = Duration::from_micros((frames_s * 1e6) as u64 + response);
        let mut later = looks.iter().peekable();
        for &look in looks {
            while later.next_if(|&&later| later < look + busy).is_some() {}
            let Some(&&found) = later.peek() else { break };
            sum_us += (found - look).as_micros();
            count += 1;
        }
    }
    sum_us as f64 / 1e6 / f64::from(count)
}

/// Runs until `until`. Each answer, and each answer that fails to come, leads to the next command. Returns when each
/// motor answered.
fn run<R: Runner<32>>(bus: &mut R, kind: Kind, until: Instant) -> Vec<Vec<Instant>> {
    let mut answers = vec![Vec::new(); MotorId::COUNT];
    while bus.now() < until {
        let motor = match bus.poll() {
            Ok(Some(Event::Reply { ticket, .. })) => {
                answers[ticket.motor().index()].push(bus.now());
                ticket.motor()
            }
            Ok(Some(Event::Feedback { motor, .. })) => {
                answers[motor.index()].push(bus.now());
                motor
            }
            Ok(Some(Event::Failed { ticket, .. })) => ticket.motor(),
            Ok(Some(Event::SetPointUnanswered { motor })) => motor,
            // The second answer to a request that was sent twice.
            Ok(Some(Event::Stray { .. })) => continue,
            Ok(Some(event)) => panic!("nothing of the kind was asked for: {event:?}"),
            Ok(None) => {
                bus.idle(until);
                continue;
            }
            Err(error) => panic!("the simulated bus fails: {error:?}"),
        };
        command(bus, motor, kind);
    }
    answers
}

/// Prints the worst ratios over 1 to 32 motors. Returns whether all are within their ceilings.
pub(crate) fn table() -> bool {
    println!("\nCAN at 1000 kbit/s: the worst ratios over 1 to 32 motors, budget {LIMIT}");
    println!(
        "  cycles       controller       host looks   loss    mean  ceiling  slowest  ceiling"
    );
    let mut is_good = true;
    for case in &CASES {
        let &Case(kind, controller, looking, loss, ceilings) = case;
        let mut worst = Ratios { mean: 0.0, slowest: 0.0 };
        for (_, ratios) in for_each_count(|motors| case.measure(motors)) {
            worst.mean = worst.mean.max(ratios.mean);
            worst.slowest = worst.slowest.max(ratios.slowest);
        }
        let [of_mean, of_slowest] = ceilings;
        let is_within = worst.mean <= of_mean && worst.slowest <= of_slowest;
        is_good &= is_within;
        println!(
            "  {:11}  {:15}  {:9}  {:4} %  {:6.3} {of_mean:8.2} {:8.3} {of_slowest:8.2}{}",
            kind.name(),
            controller.name(),
            match looking {
                Looking::AtOnce => "at once",
                Looking::NowAndThen => "0..1 ms",
            },
            (loss * 100.0).round(),
            worst.mean,
            worst.slowest,
            if is_within { "" } else { "  TOO SLOW" },
        );
    }
    is_good
}

//! Calls in any order, to motors that hear or do not. No motor is switched on that was last commanded to be off, and a
//! motor that has confirmed no stop gets it again.

use super::*;

const MOTORS: usize = 3;
/// By when a motor that has confirmed no stop has the next: a line that is full of others' takes so long.
const SOON: u64 = 1_000;

struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 33) % end
    }
}

/// What a motor was commanded, and what is known of it.
#[derive(Clone, Copy, Default)]
struct Commanded {
    /// The last word was to be off, not to be held or to move.
    off: bool,
    /// A stop that is in force was to be off.
    off_in_force: bool,
    stopped: bool,
    hears: bool,
    /// It has not confirmed its stop, and is to get it again by then.
    due: Option<u64>,
}

impl Commanded {
    fn stop(&mut self, kind: StopKind) {
        self.off_in_force |= kind == StopKind::Off;
        self.off = self.off_in_force;
        self.due = None;
    }

    fn lift(&mut self) {
        (self.off_in_force, self.due) = (false, None);
    }
}

struct Run {
    master: Master<4>,
    random: Random,
    commanded: [Commanded; MOTORS],
    all_stopped: bool,
    now: u64,
    answers: Vec<(u64, MotorId, Data)>,
    calls: Vec<std::string::String>,
}

fn motor(of: usize) -> MotorId {
    id(of as u8 + 1)
}

fn index(motor: MotorId) -> usize {
    usize::from(motor.get() - 1)
}

impl Run {
    fn is_line(&self) -> bool {
        self.master.config().is_rs485()
    }

    fn call(&mut self) {
        let (of, now) = (self.random.below(MOTORS as u64) as usize, ms(self.now));
        let kind = if self.random.below(2) == 0 { StopKind::Hold } else { StopKind::Off };
        let call = self.random.below(14);
        self.calls.push(std::format!("{}: {call} for motor {}, {kind:?}", self.now, of + 1));
        let (master, commanded) = (&mut self.master, &mut self.commanded);
        match call {
            0 | 1 => {
                master.stop(motor(of), kind).unwrap();
                commanded[of].stop(kind);
                commanded[of].stopped = true;
            }
            2 => {
                master.stop_all(kind, MotorSet::EMPTY).unwrap();
                let is_off_for_all = master.config().is_rs485() && kind == StopKind::Off;
                for (of, commanded) in commanded.iter_mut().enumerate() {
                    if is_off_for_all || master.motors().contains(motor(of)) {
                        commanded.stop(kind);
                    }
                }
                self.all_stopped = true;
            }
            3 => {
                master.lift_stop();
                for commanded in commanded {
                    commanded.lift();
                    commanded.stopped = false;
                }
                self.all_stopped = false;
            }
            4 => {
                master.lift_stop_of(motor(of));
                commanded[of].stopped = false;
                if !self.all_stopped {
                    commanded[of].lift();
                }
            }
            5 if master.forget(motor(of)) => commanded[of].due = None,
            6 if master.request(motor(of), Shutdown).is_ok() => {
                (commanded[of].off, commanded[of].due) = (true, None);
            }
            7 if master.request(motor(of), Stop).is_ok() => {
                (commanded[of].off, commanded[of].due) = (false, None);
            }
            8 => drop(master.request(motor(of), ReadMultiTurnAngle)),
            9 if master.broadcast(Shutdown, MotorSet::EMPTY).is_ok() => {
                commanded.iter_mut().for_each(|commanded| commanded.off = true);
            }
            10 if master.set_point(motor(of), torque(1.0), now).is_ok() => {
                commanded[of].off = false
            }
            11 => commanded[of].hears = !commanded[of].hears,
            12 => master.handle_bus_down(now),
            13 => self.answers.push((self.now, motor(of), ANGLE_REPLY)),
            _ => {}
        }
    }

    fn look(&mut self) {
        let now = ms(self.now);
        let (heard, later) = self.answers.drain(..).partition(|&(at, ..)| at <= self.now);
        self.answers = later;
        let heard: Vec<_> = heard;
        for (_, from, data) in heard {
            self.hear(from, data);
        }
        for event in events(&mut self.master, now) {
            match event {
                Event::StopUnconfirmed { motor } => {
                    let commanded = &mut self.commanded[index(motor)];
                    commanded.due =
                        (commanded.stopped || self.all_stopped).then_some(self.now + SOON);
                }
                // That was no word.
                Event::BroadcastDone { was_sent: false, .. } => {
                    self.commanded
                        .iter_mut()
                        .for_each(|commanded| commanded.off &= commanded.off_in_force);
                }
                Event::Failed {
                    ticket,
                    failure: Failure::BusDown | Failure::Stopped | Failure::StopUnconfirmed,
                } => {
                    let commanded = &mut self.commanded[index(ticket.motor())];
                    commanded.off &= commanded.off_in_force;
                }
                _ => {}
            }
        }
        while let Some(packet) = self.master.poll_transmit(now) {
            let is_handed_back = !self.is_line() && self.random.below(40) == 0;
            self.master.handle_transmitted(now);
            if is_handed_back {
                self.master.handle_pushed_out(&packet);
            }
            let Channel::Command(Target::Motor(to)) = packet.channel else { continue };
            let commanded = &mut self.commanded[index(to)];
            let is_hold = packet.data == Stop.encode();
            assert!(!(is_hold && commanded.off), "motor {to} is to be off: {:#?}", self.calls);
            if is_hold || packet.data == Shutdown.encode() {
                commanded.due = commanded.due.map(|_| self.now + SOON);
            }
            if commanded.hears && !is_handed_back {
                let answer = match packet.data[0] {
                    0x92 => ANGLE_REPLY,
                    0xA1 => TORQUE_REPLY,
                    _ => packet.data,
                };
                self.answers.push((self.now + 1, to, answer));
            }
        }
        let late = self
            .commanded
            .iter()
            .position(|commanded| commanded.due.is_some_and(|due| due < self.now));
        assert_eq!(late.map(motor), None, "no stop for {SOON} ms: {:#?}", self.calls);
        self.now += 1;
    }

    fn hear(&mut self, from: MotorId, data: Data) {
        let now = ms(self.now);
        let event = if self.is_line() {
            self.master.handle_line(&Frame { address: Target::Motor(from), data }, now)
        } else {
            reply(&mut self.master, from.get(), data, now)
        };
        let ends = |event| match event {
            Event::StopConfirmed { .. } => true,
            Event::Reply { kind, .. } => kind.ends_motion(),
            _ => false,
        };
        if event.is_some_and(ends) {
            self.commanded[index(from)].due = None;
        }
    }
}

#[test]
fn motor_last_shut_down_stays_off_and_unconfirmed_stop_is_repeated() {
    for config in [Config::CAN, Config::rs485(1_000_000, false)] {
        for seed in 0..2_000 {
            let mut run = Run {
                master: Master::new(config),
                random: Random(seed),
                commanded: [Commanded::default(); MOTORS],
                all_stopped: false,
                now: 0,
                answers: Vec::new(),
                calls: std::vec![std::format!("seed {seed}")],
            };
            for _ in 0..60 {
                run.call();
                for _ in 0..[1, 5, 50, 1_200][run.random.below(4) as usize] {
                    run.look();
                }
            }
        }
    }
}

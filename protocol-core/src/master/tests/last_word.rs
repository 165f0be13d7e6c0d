//! Calls in any order, to motors that hear or do not. No motor is switched on that was last told to be off, and a motor
//! that has confirmed no stop gets it again.

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

/// What a motor was told, and what is known of it.
#[derive(Clone, Copy, Default)]
struct Told {
    /// The last word was to be off, not to be held or to move.
    off: bool,
    /// A stop that is in force was to be off.
    off_in_force: bool,
    stopped: bool,
    hears: bool,
    /// It has not confirmed its stop, and is to get it again by then.
    due: Option<u64>,
}

impl Told {
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
    told: [Told; MOTORS],
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
        let (master, told) = (&mut self.master, &mut self.told);
        match call {
            0 | 1 => {
                master.stop(motor(of), kind).unwrap();
                told[of].stop(kind);
                told[of].stopped = true;
            }
            2 => {
                master.stop_all(kind, MotorSet::EMPTY).unwrap();
                let is_off_for_all = master.config().is_rs485() && kind == StopKind::Off;
                for (of, told) in told.iter_mut().enumerate() {
                    if is_off_for_all || master.motors().contains(motor(of)) {
                        told.stop(kind);
                    }
                }
                self.all_stopped = true;
            }
            3 => {
                master.lift_stop();
                for told in told {
                    told.lift();
                    told.stopped = false;
                }
                self.all_stopped = false;
            }
            4 => {
                master.lift_stop_of(motor(of));
                told[of].stopped = false;
                if !self.all_stopped {
                    told[of].lift();
                }
            }
            5 if master.forget(motor(of)) => told[of].due = None,
            6 if master.request(motor(of), Shutdown).is_ok() => {
                (told[of].off, told[of].due) = (true, None);
            }
            7 if master.request(motor(of), Stop).is_ok() => {
                (told[of].off, told[of].due) = (false, None);
            }
            8 => drop(master.request(motor(of), ReadMultiTurnAngle)),
            9 if master.broadcast(Shutdown, MotorSet::EMPTY).is_ok() => {
                told.iter_mut().for_each(|told| told.off = true);
            }
            10 if master.set_point(motor(of), torque(1.0), now).is_ok() => told[of].off = false,
            11 => told[of].hears = !told[of].hears,
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
                    let told = &mut self.told[index(motor)];
                    told.due = (told.stopped || self.all_stopped).then_some(self.now + SOON);
                }
                // That was no word.
                Event::BroadcastDone { was_sent: false, .. } => {
                    self.told.iter_mut().for_each(|told| told.off &= told.off_in_force);
                }
                Event::Failed {
                    ticket,
                    failure: Failure::BusDown | Failure::Stopped | Failure::StopUnconfirmed,
                } => {
                    let told = &mut self.told[index(ticket.motor())];
                    told.off &= told.off_in_force;
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
            let told = &mut self.told[index(to)];
            let is_hold = packet.data == Stop.encode();
            assert!(!(is_hold && told.off), "motor {to} is to be off: {:#?}", self.calls);
            if is_hold || packet.data == Shutdown.encode() {
                told.due = told.due.map(|_| self.now + SOON);
            }
            if told.hears && !is_handed_back {
                let answer = match packet.data[0] {
                    0x92 => ANGLE_REPLY,
                    0xA1 => TORQUE_REPLY,
                    _ => packet.data,
                };
                self.answers.push((self.now + 1, to, answer));
            }
        }
        let late = self.told.iter().position(|told| told.due.is_some_and(|due| due < self.now));
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
            self.told[index(from)].due = None;
        }
    }
}

#[test]
fn nobody_is_switched_on_who_was_told_last_to_be_off_and_who_confirms_no_stop_gets_it_again() {
    for config in [Config::CAN, Config::rs485(1_000_000, false)] {
        for seed in 0..2_000 {
            let mut run = Run {
                master: Master::new(config),
                random: Random(seed),
                told: [Told::default(); MOTORS],
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

//! What callers ask of the master: requests, set-points and broadcasts, each with a token of its own.

use myactuator_protocol_core::command::{
    AbsolutePosition, AccelerationIndex, ActiveReply, Command, IncrementalPosition, LockBrake,
    PidIndex, RawCommand, RawMotion, ReadAcceleration, ReadMultiTurnAngle, ReadMultiTurnEncoder,
    ReadPid, ReadRunTime, ReadStatus2, ReadVersionDate, ReportedCommand, Reset, Shutdown, Speed,
    Stop, Switch, WritePidRam,
};
use myactuator_protocol_core::error::{DecodeError, RequestError};
use myactuator_protocol_core::master::{MotorSet, Patience};
use myactuator_protocol_core::opcode::{Opcode, ReplyRule};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{
    Angle, Gain, MaxSpeed, MaxTorque, ReportInterval, SpeedTarget,
};
use myactuator_protocol_core::{Channel, Data, Kind, MotorId};
use myactuator_tests::rig::{STREAM_MARK, with_token};
use myactuator_tests::values::id;

use super::callers::Session;
use super::drives::UNKNOWN;
use super::names::REQUESTS;
use super::oracle::{Asked, Open, is_move};
use super::to_all::{SHUTDOWN, STOP};
use super::truth::Page;
use super::world::Rough;

/// The most attempts of a request, unless it has a retry policy of its own.
const ATTEMPTS: u32 = 3;

/// Marks a speed request, to distinguish it from a set-point of a stream.
const REQUEST_MARK: u8 = 7;

/// 0xB1 with a token in the bytes that its reply leaves free.
struct RunTimeWithToken(u32);

impl Command for RunTimeWithToken {
    type Reply = <ReadRunTime as Command>::Reply;

    fn kind(&self) -> Kind {
        ReadRunTime.kind()
    }

    fn encode(&self) -> Data {
        let mut data = ReadRunTime.encode();
        data[1..4].copy_from_slice(&self.0.to_le_bytes()[..3]);
        data
    }

    fn decode_reply(data: &Data) -> Result<Self::Reply, DecodeError> {
        ReadRunTime::decode_reply(data)
    }
}

impl<W: Rough> Session<W> {
    pub(super) fn token(&mut self) -> u32 {
        self.asked += 1;
        REQUESTS | self.asked
    }

    /// Motors that are expected to answer a command to all. Others may answer as well.
    fn expected(&self) -> MotorSet {
        self.motors().filter(|motor| motor.get() % 3 != 0).collect()
    }

    pub(super) fn ask_all(&mut self) {
        let token = self.token();
        let expected = self.expected();
        let master = self.stage.host.master();
        let (begun, data) = match self.dice.below(5) {
            0..2 => {
                let command = with_token(ReadMultiTurnAngle, token);
                (master.broadcast(command, expected), command.encode())
            }
            2..4 => {
                let command = with_token(ReadPid { index: PidIndex::SPEED_KP }, token);
                (master.broadcast(command, expected), command.encode())
            }
            _ => {
                let (max_speed, angle) = (MaxSpeed::NO_LIMIT, Angle::from_raw(token as i32));
                let command = IncrementalPosition { max_speed, angle };
                (master.broadcast(command, expected), command.encode())
            }
        };
        let known = master.motors();
        let mut truth = self.stage.book.open();
        let any = |is_so: fn(&Page) -> bool| truth.pages.iter().any(is_so);
        match begun {
            Ok(()) if is_move(&data) && any(|page| page.is_stopped || page.has_restarted()) => {
                truth.breaks("all are moved, and one is stopped or has restarted");
            }
            Ok(()) => truth.put_to_all(&data, known, MotorSet::EMPTY),
            Err(RequestError::Stopped) if any(|page| page.is_stopped) => return,
            Err(RequestError::Restarted) => return,
            Err(RequestError::Busy) if truth.all_are_told_again() => return,
            Err(error) => truth.breaks(format!("{error} to {data:X?} to all")),
        }
        drop(truth);
        self.all_asked_since = self.stage.book.open().clocks.calm;
        self.oracle.broadcast = Some(Asked { data, expected, answered: MotorSet::EMPTY });
    }

    /// Sends all a command that ends their motion.
    pub(super) fn end_all(&mut self) {
        let token = self.token();
        let expected = self.expected();
        let master = self.stage.host.master();
        let (begun, data) = match self.more.below(5) {
            0..2 => {
                let command = with_token(Shutdown, token);
                (master.broadcast(command, expected), command.encode())
            }
            2..4 => {
                let command = with_token(Stop, token);
                (master.broadcast(command, expected), command.encode())
            }
            _ => {
                let command = with_token(LockBrake, token);
                (master.broadcast(command, expected), command.encode())
            }
        };
        let known = master.motors();
        let open = &self.oracle.open;
        let holds = |motor: &MotorId| open[motor.index()].is_some_and(|open| open.data[0] == STOP);
        let holding: MotorSet = self.motors().filter(holds).collect();
        let now = self.now();
        let mut truth = self.stage.book.open();
        truth.tick(now);
        match begun {
            Ok(()) => truth.put_to_all(&data, known, holding),
            Err(RequestError::Busy) if truth.all_are_told_again() => return,
            Err(error) => truth.breaks(format!("{error} to {data:X?} to all")),
        }
        drop(truth);
        self.oracle.totals.ended_all += 1;
        self.all_asked_since = self.stage.book.open().clocks.calm;
        self.oracle.broadcast = Some(Asked { data, expected, answered: MotorSet::EMPTY });
    }

    pub(super) fn ask_one(&mut self, index: usize) {
        let motor = id(index as u8 + 1);
        let token = self.token();
        let conditions = self.scenario.conditions;
        let choice = self.dice.below(1_000);
        let index = self.dice.below(3) as u8;
        match choice {
            // A restart keeps a motor quiet for two seconds, so it is rare.
            0 if self.scenario.motors == 32 || conditions.restarts => {
                self.put(motor, with_token(Reset, token));
            }
            0..300 => {
                let index = PidIndex::from_raw(index);
                self.put(motor, with_token(ReadPid { index }, token));
            }
            300..400 => {
                let index = AccelerationIndex::from_raw(index);
                self.put(motor, with_token(ReadAcceleration { index }, token));
            }
            400..550 => self.put(motor, with_token(ReadMultiTurnAngle, token)),
            550..600 => self.put(motor, with_token(ReadMultiTurnEncoder, token)),
            600..650 => self.put(motor, with_token(ReadStatus2, token)),
            650..700 => self.put(motor, with_token(ReadVersionDate, token)),
            700..720 => self.put(motor, RunTimeWithToken(token)),
            720..740 => self.put(motor, with_token(Shutdown, token)),
            740..750 => self.put(motor, with_token(Stop, token)),
            750..760 => self.put(motor, with_token(LockBrake, token)),
            760..770 if conditions.repeats => {
                let mut data = [UNKNOWN, 0, 0, 0, 0, 0, 0, 0];
                data[4..].copy_from_slice(&token.to_le_bytes());
                self.put(motor, RawCommand::new(data, ReplyRule::Values, false));
            }
            770..775 if conditions.reports && W::NAME == "CAN" => self.have_it_report(motor, index),
            760..850 => {
                // A finite number whatever the token.
                let value = Gain::new(f32::from_bits(token)).expect("finite");
                self.put(motor, WritePidRam { index: PidIndex::SPEED_KP, value });
            }
            850..900 => {
                let max_torque = MaxTorque::from_raw(REQUEST_MARK);
                let speed = SpeedTarget::from_raw(token as i32);
                self.put(motor, Speed { max_torque, speed });
            }
            _ => {
                let (max_speed, angle) = (MaxSpeed::NO_LIMIT, Angle::from_raw(token as i32));
                self.put(motor, IncrementalPosition { max_speed, angle });
            }
        }
    }

    fn have_it_report(&mut self, motor: MotorId, choice: u8) {
        let of = [Opcode::ReadStatus2, Opcode::ReadMultiTurnAngle, Opcode::ReadMultiTurnEncoder];
        let of = of[usize::from(choice)];
        let command = ReportedCommand::of(of).expect("a read");
        let enable = if self.dice.below(3) == 0 { Switch::Off } else { Switch::On };
        let interval = ReportInterval::from_raw(1 + self.dice.below(3) as u16);
        self.put(motor, ActiveReply { command, enable, interval });
    }

    fn put<C: Command>(&mut self, motor: MotorId, command: C) {
        let patience = (self.dice.below(4) == 0 && command.kind() == Kind::Known(Opcode::ReadPid))
            .then_some(Patience { reply_timeout: Duration::from_millis(2), attempts: 2 });
        let (kind, data) = (command.kind(), command.encode());
        let is_stopped = self.stopped.contains(motor);
        let moves = matches!(kind, Kind::Known(Opcode::Speed | Opcode::IncrementalPosition));
        let awaits_resume = self.stage.book.open().pages[motor.index()].has_restarted();
        let master = self.stage.host.master();
        let asked = match patience {
            Some(patience) => master.request_with(motor, command, patience),
            None => master.request(motor, command),
        };
        if asked.is_err() {
            // Its token was not used, and there are few.
            self.asked -= 1;
        }
        match asked {
            Ok(ticket) => {
                assert!(!(moves && awaits_resume), "{kind:?} {}", self.told());
                assert!(
                    !(is_stopped && kind.is_refused_while_stopped()),
                    "{kind:?} {}",
                    self.told()
                );
                self.oracle.totals.requests += 1;
                self.since[motor.index()] = self.now();
                let timeout = patience.map_or(self.bounds.timeout(&data), |it| it.reply_timeout);
                let attempts = patience.map_or(ATTEMPTS, |it| it.attempts.into());
                let longest = self.bounds.request(&data, timeout, attempts);
                let begun = self.stage.book.open().clocks.free;
                self.limits[motor.index()] = (begun, longest);
                self.oracle.open[motor.index()] = Some(Open { ticket: ticket.id(), kind, data });
                let (known, now) = (self.stage.host.master().motors(), self.now());
                let mut truth = self.stage.book.open();
                truth.put(motor, Channel::Command(motor.into()), &data);
                truth.known = known;
                if matches!(data[0], SHUTDOWN | STOP) {
                    truth.tick(now);
                    truth.ends_alone(motor, data[0]);
                }
            }
            Err(RequestError::Stopped) if is_stopped => {}
            Err(RequestError::Restarted) if moves => {}
            // A stop is in flight.
            Err(RequestError::Busy) if self.is_stopping(motor) => {
                if kind.ends_motion() {
                    let mut truth = self.stage.book.open();
                    truth.pages[motor.index()].set_points.may_be_dropped();
                }
            }
            // The motor follows a stream of this kind, or reports it: ask for something else.
            Err(RequestError::Streamed(Opcode::Speed)) => {}
            Err(RequestError::Reported(_)) if self.scenario.conditions.reports => {}
            Err(error) => panic!("{error}: {}", self.told()),
        }
    }

    fn is_stopping(&self, motor: MotorId) -> bool {
        let truth = self.stage.book.open();
        let page = &truth.pages[motor.index()];
        page.is_stopping || page.may_be_stopping
    }

    pub(super) fn stream(&mut self, index: usize) {
        let motor = id(index as u8 + 1);
        // A set-point has 16 bits for its token.
        if self.numbers[index] > u32::from(u16::MAX) - 2 {
            return;
        }
        self.due[index] = false;
        // A new set-point often replaces one that is still pending.
        for _ in 0..=self.dice.below(2) {
            let number = self.numbers[index];
            self.numbers[index] += 1;
            let host = &mut self.stage.host;
            let channel = Channel::Command(motor.into());
            let (put, channel, data) = match (index % 3, W::NAME) {
                (0, _) => {
                    let angle = Angle::from_raw(number as i32);
                    let command = AbsolutePosition { max_speed: MaxSpeed::from_raw(100), angle };
                    (host.set_point(motor, command), channel, command.encode())
                }
                (1, "CAN") => {
                    let [high, low] = (number as u16).to_be_bytes();
                    let data = [high, low, 0, 0, 0, 0, 0, 0];
                    (host.set_point(motor, RawMotion::decode(&data)), Channel::Motion(motor), data)
                }
                _ => {
                    let max_torque = MaxTorque::from_raw(STREAM_MARK);
                    let speed = SpeedTarget::from_raw(number as i32);
                    let command = Speed { max_torque, speed };
                    (host.set_point(motor, command), channel, command.encode())
                }
            };
            let mut truth = self.stage.book.open();
            let page = &truth.pages[motor.index()];
            match put {
                Ok(()) => {
                    let is_refused = page.is_stopped || page.has_restarted();
                    truth.put(motor, channel, &data);
                    drop(truth);
                    self.streamed[index] = self.now();
                    assert!(!is_refused, "motor {motor} takes a set-point. {}", self.told());
                    continue;
                }
                Err(RequestError::Stopped) if page.is_stopped => {}
                Err(RequestError::Busy | RequestError::Restarted) => {}
                Err(error) => {
                    drop(truth);
                    panic!("{error}: {}", self.told())
                }
            }
            self.due[index] = true;
        }
    }
}

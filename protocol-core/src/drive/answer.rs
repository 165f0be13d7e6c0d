//! What each command does, and what it is answered with, as [`decisions`](super::decisions) says.

use crate::command::{
    AccelerationReading, AnyCommand, AnyReply, BusId, BusIdReply, Feedback, FunctionControl, Model,
    MotionFeedback, MultiTurnAngle, MultiTurnEncoder, MultiTurnEncoderOffset, MultiTurnEncoderRaw,
    PidGain, RawMotionFeedback, RunTime, RunningMode, SingleTurnAngle, SingleTurnAngleV4_4,
    SingleTurnEncoder, SingleTurnFeedback, Status1, Status3, U12, Version,
};
use crate::data::Data;
use crate::drive::encoder::saturated;
use crate::drive::protection::{Heard, STEADY_COMMANDS, STEADY_COMMANDS_SEEN};
use crate::drive::{Bus, Drive, Event, IgnoreReason, Memory, NotRunReason, Plant, Settings, brake};
use crate::opcode::Opcode;
use crate::packet::Packet;
use crate::time::{Duration, Instant};
use crate::units::{
    CoarseSpeed, Current, Milliseconds, ReportedAcceleration, Temperature, Voltage,
};

mod run;

/// For so long after it took a bus id, a drive takes the same command for another drive's reply.
const ANOTHERS_REPLY: Duration = Duration::from_millis(20);

/// What becomes of a command.
pub(super) enum Answer {
    Data(Data),
    None,
    Ignored(IgnoreReason),
}

impl From<AnyReply> for Answer {
    fn from(reply: AnyReply) -> Self {
        Self::Data(reply.encode())
    }
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// Does what the command says.
    pub(super) fn answer(
        &mut self,
        command: AnyCommand,
        opcode: Opcode,
        packet: &Packet,
        now: Instant,
    ) -> Answer {
        let quirks = self.parameters.quirks;
        let needed =
            if quirks.lost_master_heartbeat { STEADY_COMMANDS_SEEN } else { STEADY_COMMANDS };
        match self.protection.hear(now, self.protection_timeout(), needed) {
            Heard::Recovered => self.events.push(Event::ProtectionRecovered),
            Heard::Unsteady { first: true } if quirks.lost_master_heartbeat => {
                self.not_run(opcode, NotRunReason::CommunicationLost);
                return Answer::Data(packet.data);
            }
            Heard::Steady | Heard::Unsteady { .. } => {}
        }
        let echo = || Answer::Data(packet.data);
        let unknown = Answer::Ignored(IgnoreReason::UnknownCode(opcode));
        match command {
            AnyCommand::ReadPid(read) => match self.active.gains.get(read.index) {
                Some(value) => AnyReply::ReadPid(PidGain { index: read.index, value }).into(),
                None => unknown,
            },
            AnyCommand::WritePidRam(write) => {
                if self.active.gains.get(write.index).is_none() {
                    return unknown;
                }
                self.active.gains.set(write.index, write.value);
                AnyReply::WritePidRam(write).into()
            }
            AnyCommand::WritePidRom(write) => {
                if self.active.gains.get(write.index).is_none() {
                    return unknown;
                }
                self.write_rom(opcode, echo(), |settings| {
                    settings.gains.set(write.index, write.value);
                })
            }
            AnyCommand::ReadAcceleration(read) => match self.active.accelerations.get(read.index) {
                Some(held) => {
                    let acceleration = ReportedAcceleration::from_raw(held.raw());
                    let reading = AccelerationReading { index: read.index, acceleration };
                    AnyReply::ReadAcceleration(reading).into()
                }
                None => unknown,
            },
            AnyCommand::WriteAcceleration(write) => {
                if self.active.accelerations.get(write.index).is_none() {
                    return unknown;
                }
                self.write_rom(opcode, echo(), |settings| {
                    settings.accelerations.set(write.index, write.acceleration);
                })
            }
            AnyCommand::SetEncoderZero(set) => {
                let stored = Settings { zero_offset: set.offset, ..self.stored };
                self.keep(stored, echo())
            }
            AnyCommand::SetCurrentPositionZero(_) => {
                let offset = self.encoder.raw_reading();
                let reply = AnyReply::SetCurrentPositionZero(MultiTurnEncoderOffset { offset });
                self.keep(Settings { zero_offset: offset, ..self.stored }, reply.into())
            }
            AnyCommand::FunctionControl(function) => self.function(function, echo()),
            AnyCommand::BusId(BusId::Read) => {
                let [.., low, high] = packet.data;
                if (low, high) != (0, 0) {
                    return Answer::Ignored(IgnoreReason::AnothersReply);
                }
                let id = self.active.id;
                AnyReply::BusId(match self.parameters.bus {
                    Bus::Can => BusIdReply::OnCan(id),
                    Bus::Rs485 => BusIdReply::OnRs485(id),
                })
                .into()
            }
            AnyCommand::BusId(BusId::Write(id)) => {
                let heard = self
                    .id_taken
                    .is_some_and(|(taken, at)| taken == id && now - at < ANOTHERS_REPLY);
                if heard {
                    return Answer::Ignored(IgnoreReason::AnothersReply);
                }
                self.id_taken = Some((id, now));
                self.keep(Settings { id, ..self.stored }, echo())
            }
            AnyCommand::CommunicationLossProtection(set) => {
                let answer = self.write_rom(opcode, echo(), |settings| {
                    settings.protection_timeout = set.timeout;
                });
                if set.timeout.raw() == 0 && self.protection.forgive() {
                    self.events.push(Event::ProtectionRecovered);
                }
                answer
            }
            AnyCommand::SetBaudRate(set) => {
                let rate = match self.parameters.bus {
                    Bus::Can => set.baud_rate.can_bits_per_second(),
                    Bus::Rs485 => set.baud_rate.rs485_bits_per_second(),
                };
                if rate.is_none() {
                    return unknown;
                }
                let [a, b, c, d] = self.random.next().to_le_bytes();
                let [e, f, g, _] = self.random.next().to_le_bytes();
                let before = self.active.baud_rate;
                let garbage = Answer::Data([packet.data[0], a, b, c, d, e, f, g]);
                let answer = self.write_rom(opcode, garbage, |settings| {
                    settings.baud_rate = set.baud_rate;
                });
                if self.active.baud_rate != before {
                    self.events.push(Event::BitRateChanged(self.active.baud_rate));
                }
                answer
            }
            AnyCommand::ActiveReply(set) => {
                let Some(reported) = set.command.opcode() else { return unknown };
                if set.enable.is_on() {
                    self.reporting.enable(reported, set.interval, now);
                } else {
                    self.reporting.disable(reported);
                }
                Answer::None
            }
            AnyCommand::Reset(_) => {
                self.restart(now);
                Answer::None
            }
            AnyCommand::ReleaseBrake(_) => {
                if self.protection.is_tripped() {
                    self.not_run(opcode, NotRunReason::CommunicationLost);
                } else {
                    let at = brake::opening_time(now, &quirks, &mut self.random);
                    self.brake.release(at);
                }
                echo()
            }
            AnyCommand::LockBrake(_) => {
                self.brake.lock();
                if self.brake.holds() {
                    self.controller.shut_down();
                }
                echo()
            }
            AnyCommand::Shutdown(_) => {
                self.controller.shut_down();
                self.brake.lock_unless_requested();
                echo()
            }
            AnyCommand::Stop(_) => {
                self.run_stop();
                echo()
            }
            AnyCommand::Torque(torque) => {
                self.run_torque(&torque);
                AnyReply::Torque(self.feedback()).into()
            }
            AnyCommand::Speed(speed) => {
                self.run_speed(&speed);
                AnyReply::Speed(self.feedback()).into()
            }
            AnyCommand::AbsolutePosition(position) => {
                self.run_absolute(&position);
                AnyReply::AbsolutePosition(self.feedback()).into()
            }
            AnyCommand::SingleTurnPosition(position) => {
                if !self.run_single_turn(&position) {
                    return unknown;
                }
                AnyReply::SingleTurnPosition(self.single_turn_feedback()).into()
            }
            AnyCommand::IncrementalPosition(position) => {
                self.run_incremental(&position);
                AnyReply::IncrementalPosition(self.feedback()).into()
            }
            AnyCommand::ForcePosition(position) => {
                self.run_force(&position);
                AnyReply::ForcePosition(self.feedback()).into()
            }
            AnyCommand::Motion(motion) => {
                self.run_motion(&motion);
                AnyReply::Motion(self.motion_feedback()).into()
            }
            // What only reads.
            _ if self.reporting.reports(opcode) => {
                Answer::Ignored(IgnoreReason::ReportedActively(opcode))
            }
            _ => self.reading(opcode).map_or(Answer::None, Answer::from),
        }
    }

    /// The reply to a read that names nothing; `None` for kinds that [`answer`](Self::answer) does.
    pub(super) fn reading(&self, opcode: Opcode) -> Option<AnyReply> {
        let m = &self.measurement;
        Some(match opcode {
            Opcode::ReadMultiTurnEncoder => AnyReply::ReadMultiTurnEncoder(MultiTurnEncoder {
                position: self.encoder.position_reading(),
            }),
            Opcode::ReadMultiTurnEncoderRaw => {
                AnyReply::ReadMultiTurnEncoderRaw(MultiTurnEncoderRaw {
                    raw: self.encoder.raw_reading(),
                })
            }
            Opcode::ReadMultiTurnEncoderOffset => {
                AnyReply::ReadMultiTurnEncoderOffset(MultiTurnEncoderOffset {
                    offset: self.encoder.offset_reading(),
                })
            }
            Opcode::ReadRunningMode => {
                AnyReply::ReadRunningMode(RunningMode { mode: self.controller.mode() })
            }
            Opcode::ReadSingleTurnEncoder => {
                let [position, raw, offset] = self.encoder.single_turn();
                AnyReply::ReadSingleTurnEncoder(SingleTurnEncoder { position, raw, offset })
            }
            Opcode::ReadMultiTurnAngle => {
                AnyReply::ReadMultiTurnAngle(MultiTurnAngle { angle: self.encoder.angle_reading() })
            }
            Opcode::ReadSingleTurnAngle => AnyReply::ReadSingleTurnAngle(SingleTurnAngle {
                angle: self.encoder.single_turn_angle(),
            }),
            Opcode::ReadSingleTurnAngleV4_4 => {
                let angle = self.encoder.half_turn_angle();
                AnyReply::ReadSingleTurnAngleV4_4(SingleTurnAngleV4_4 { angle })
            }
            Opcode::ReadStatus1 => AnyReply::ReadStatus1(Status1 {
                temperature: celsius(m.motor_temperature_c),
                mosfet_temperature: celsius(m.mos_temperature_c),
                brake: self.brake.command(),
                voltage: Voltage::saturating_from_volts(m.supply_voltage_v).unwrap_or_default(),
                errors: self.faults.all(),
            }),
            Opcode::ReadStatus2 => AnyReply::ReadStatus2(self.feedback()),
            Opcode::ReadStatus3 => {
                let [phase_a_current, phase_b_current, phase_c_current] =
                    m.phase_currents_a.map(amperes);
                let temperature = celsius(m.motor_temperature_c);
                AnyReply::ReadStatus3(Status3 {
                    temperature,
                    phase_a_current,
                    phase_b_current,
                    phase_c_current,
                })
            }
            Opcode::ReadRunTime => {
                let millis = self.run_time(self.clock).as_millis();
                let run_time = Milliseconds::from_raw(u32::try_from(millis).unwrap_or(u32::MAX));
                AnyReply::ReadRunTime(RunTime { run_time })
            }
            Opcode::ReadVersionDate => {
                AnyReply::ReadVersionDate(Version { version_date: self.parameters.version_date })
            }
            Opcode::ReadModel => AnyReply::ReadModel(Model { model: self.parameters.model }),
            // Each kind stands here or above, so that the compiler asks for a new one.
            Opcode::FunctionControl
            | Opcode::ReadPid
            | Opcode::WritePidRam
            | Opcode::WritePidRom
            | Opcode::ReadAcceleration
            | Opcode::WriteAcceleration
            | Opcode::SetEncoderZero
            | Opcode::SetCurrentPositionZero
            | Opcode::Reset
            | Opcode::ReleaseBrake
            | Opcode::LockBrake
            | Opcode::BusId
            | Opcode::Shutdown
            | Opcode::Stop
            | Opcode::Torque
            | Opcode::Speed
            | Opcode::AbsolutePosition
            | Opcode::SingleTurnPosition
            | Opcode::IncrementalPosition
            | Opcode::ForcePosition
            | Opcode::CommunicationLossProtection
            | Opcode::SetBaudRate
            | Opcode::ActiveReply
            | Opcode::Motion => return None,
        })
    }

    fn feedback(&self) -> Feedback {
        let m = &self.measurement;
        Feedback {
            temperature: celsius(m.motor_temperature_c),
            current: amperes(m.current_a),
            speed: dps(m.speed_dps),
            angle: self.encoder.coarse_reading(),
        }
    }

    fn single_turn_feedback(&self) -> SingleTurnFeedback {
        let Feedback { temperature, current, speed, .. } = self.feedback();
        let [encoder, _, _] = self.encoder.single_turn();
        SingleTurnFeedback { temperature, current, speed, encoder }
    }

    fn motion_feedback(&self) -> RawMotionFeedback {
        let (id, m) = (self.active.id, &self.measurement);
        let number = |x: f32| if x.is_nan() { 0.0 } else { x };
        let feedback = MotionFeedback {
            position_rad: self.encoder.angle_deg().to_radians() as f32,
            velocity_rad_s: number(m.speed_dps.to_radians()),
            torque_nm: number(m.current_a * self.parameters.torque_constant_nm_per_a),
        };
        // Only what is no number is refused, and no such thing is left.
        self.parameters.motion_ranges.quantise_feedback(id, &feedback).unwrap_or(
            RawMotionFeedback {
                id_byte: id.get(),
                position: 0,
                velocity: U12::default(),
                torque: U12::default(),
            },
        )
    }

    fn function(&mut self, function: FunctionControl, echo: Answer) -> Answer {
        let opcode = Opcode::FunctionControl;
        if self.parameters.quirks.rom_needs_shutdown && !self.controller.is_off() {
            self.not_run(opcode, NotRunReason::NotShutDown);
            return echo;
        }
        match function {
            FunctionControl::ClearMultiTurn => {
                let zero = self.encoder.raw_within_turn();
                let stored = Settings { zero_offset: saturated(zero), ..self.stored };
                let answer = self.keep(stored, echo);
                if matches!(answer, Answer::Data(_)) {
                    self.turns_to_clear = self.encoder.raw().saturating_sub(zero);
                }
                answer
            }
            FunctionControl::CanIdFilter(on) => {
                self.write_rom(opcode, echo, |settings| settings.can_id_filter = on.is_on())
            }
            FunctionControl::ErrorReporting(on) => {
                self.reporting.set_errors_wanted(on.is_on());
                echo
            }
            FunctionControl::SaveMultiTurn(on) => {
                self.keep(Settings { save_multi_turn: on.is_on(), ..self.stored }, echo)
            }
            FunctionControl::SetCanId(id) => {
                let answer = self.keep(Settings { id, ..self.stored }, echo);
                if self.parameters.quirks.silent_id_change { Answer::None } else { answer }
            }
            FunctionControl::MaxPositiveAngle(angle) => {
                let angle = Some(crate::units::Angle::from_raw(angle));
                self.write_rom(opcode, echo, |settings| settings.max_positive_angle = angle)
            }
            FunctionControl::MaxNegativeAngle(angle) => {
                let angle = Some(crate::units::Angle::from_raw(angle));
                self.write_rom(opcode, echo, |settings| settings.max_negative_angle = angle)
            }
            FunctionControl::Other(_) => Answer::Ignored(IgnoreReason::UnknownCode(opcode)),
        }
    }

    /// Changes what is stored and what acts. `answer` is what a drive says if that worked.
    fn write_rom(
        &mut self,
        opcode: Opcode,
        answer: Answer,
        change: impl Fn(&mut Settings),
    ) -> Answer {
        let needs_shutdown = self.parameters.quirks.rom_needs_shutdown
            && matches!(opcode, Opcode::WritePidRom | Opcode::SetBaudRate);
        if needs_shutdown && !self.controller.is_off() {
            self.not_run(opcode, NotRunReason::NotShutDown);
            return answer;
        }
        let mut stored = self.stored;
        change(&mut stored);
        if self.store(stored) {
            change(&mut self.active);
            answer
        } else {
            Answer::None
        }
    }

    /// Changes what is stored only: it acts after a restart.
    fn keep(&mut self, stored: Settings, answer: Answer) -> Answer {
        if self.store(stored) { answer } else { Answer::None }
    }

    fn not_run(&mut self, opcode: Opcode, reason: NotRunReason) {
        self.events.push(Event::NotRun { opcode, reason });
    }
}

fn celsius(x: f32) -> Temperature {
    Temperature::saturating_from_celsius(x).unwrap_or_default()
}

fn amperes(x: f32) -> Current {
    Current::saturating_from_amperes(x).unwrap_or_default()
}

fn dps(x: f32) -> CoarseSpeed {
    CoarseSpeed::saturating_from_dps(x).unwrap_or_default()
}

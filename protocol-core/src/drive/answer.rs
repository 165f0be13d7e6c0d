//! What each command does, and what it is answered with, as [`decisions`](super::decisions) says.

use crate::command::{
    AccelerationReading, AnyCommand, BusId, BusIdReply, Feedback, FunctionControl, Model,
    MotionFeedback, MultiTurnAngle, MultiTurnEncoder, MultiTurnEncoderOffset, MultiTurnEncoderRaw,
    PidGain, RawMotionFeedback, ReadAcceleration, ReadPid, Reply, RunTime, RunningMode,
    SingleTurnAngle, SingleTurnAngleV4_4, SingleTurnEncoder, SingleTurnFeedback, Status1, Status3,
    U12, Version, WriteAcceleration, WritePidRam, WritePidRom, with_opcode,
};
use crate::data::Data;
use crate::drive::control::SetPoint;
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

use run::LockedBrake;

/// For so long after it took a bus id, a drive takes the same command for another drive's reply.
const ANOTHERS_REPLY: Duration = Duration::from_millis(20);

/// What becomes of a command.
pub(super) enum Answer {
    Data(Data),
    None,
    Ignored(IgnoreReason),
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
        if self.reporting.reports(opcode) {
            return Answer::Ignored(IgnoreReason::ReportedActively(opcode));
        }
        self.carry_out(command, opcode, &packet.data, now)
    }

    /// The reply to a read that names nothing, which the drive reports by itself.
    pub(super) fn report(&mut self, opcode: Opcode, now: Instant) -> Option<Data> {
        let data = with_opcode(opcode);
        let read = AnyCommand::decode_as(opcode, &data).ok()?;
        match self.carry_out(read, opcode, &data, now) {
            Answer::Data(reply) => Some(reply),
            Answer::None | Answer::Ignored(_) => None,
        }
    }

    /// Each kind stands here, so that the compiler asks for a new one.
    fn carry_out(
        &mut self,
        command: AnyCommand,
        opcode: Opcode,
        data: &Data,
        now: Instant,
    ) -> Answer {
        let echo = Answer::Data(*data);
        let unknown = Answer::Ignored(IgnoreReason::UnknownCode(opcode));
        let (m, encoder) = (&self.measurement, &self.encoder);
        let stall_a = self.parameters.stall_current_a;
        match command {
            AnyCommand::ReadPid(ReadPid { index }) => match self.active.gains.get(index) {
                Some(value) => Answer::Data(PidGain { index, value }.encode(opcode)),
                None => unknown,
            },
            AnyCommand::WritePidRam(WritePidRam { index, value }) => {
                if self.active.gains.set(index, value) { echo } else { unknown }
            }
            AnyCommand::WritePidRom(WritePidRom { index, value }) => {
                if self.active.gains.get(index).is_none() {
                    return unknown;
                }
                self.write_rom(opcode, echo, |settings| {
                    settings.gains.set(index, value);
                })
            }
            AnyCommand::ReadAcceleration(ReadAcceleration { index }) => {
                let Some(held) = self.active.accelerations.get(index) else { return unknown };
                let acceleration = ReportedAcceleration::from_raw(held.raw());
                Answer::Data(AccelerationReading { index, acceleration }.encode(opcode))
            }
            AnyCommand::WriteAcceleration(WriteAcceleration { index, acceleration }) => {
                if self.active.accelerations.get(index).is_none() {
                    return unknown;
                }
                self.write_rom(opcode, echo, |settings| {
                    settings.accelerations.set(index, acceleration);
                })
            }
            AnyCommand::ReadMultiTurnEncoder(_) => {
                let position = encoder.position_reading();
                Answer::Data(MultiTurnEncoder { position }.encode(opcode))
            }
            AnyCommand::ReadMultiTurnEncoderRaw(_) => {
                Answer::Data(MultiTurnEncoderRaw { raw: encoder.raw_reading() }.encode(opcode))
            }
            AnyCommand::ReadMultiTurnEncoderOffset(_) => {
                let offset = encoder.offset_reading();
                Answer::Data(MultiTurnEncoderOffset { offset }.encode(opcode))
            }
            AnyCommand::SetEncoderZero(set) => {
                self.keep(Settings { zero_offset: set.offset, ..self.stored }, echo)
            }
            AnyCommand::SetCurrentPositionZero(_) => {
                let offset = encoder.raw_reading();
                let reply = MultiTurnEncoderOffset { offset }.encode(opcode);
                self.keep(Settings { zero_offset: offset, ..self.stored }, Answer::Data(reply))
            }
            AnyCommand::ReadSingleTurnEncoder(_) => {
                let [position, raw, offset] = encoder.single_turn();
                Answer::Data(SingleTurnEncoder { position, raw, offset }.encode(opcode))
            }
            AnyCommand::ReadMultiTurnAngle(_) => {
                Answer::Data(MultiTurnAngle { angle: encoder.angle_reading() }.encode(opcode))
            }
            AnyCommand::ReadSingleTurnAngle(_) => {
                Answer::Data(SingleTurnAngle { angle: encoder.single_turn_angle() }.encode(opcode))
            }
            AnyCommand::ReadSingleTurnAngleV4_4(_) => {
                let angle = encoder.half_turn_angle();
                Answer::Data(SingleTurnAngleV4_4 { angle }.encode(opcode))
            }
            AnyCommand::ReadStatus1(_) => {
                let status = Status1 {
                    temperature: celsius(m.motor_temperature_c),
                    mosfet_temperature: celsius(m.mos_temperature_c),
                    brake: self.brake.command(),
                    voltage: Voltage::saturating_from_volts(m.supply_voltage_v).unwrap_or_default(),
                    errors: self.faults.all(),
                };
                Answer::Data(status.encode(opcode))
            }
            AnyCommand::ReadStatus2(_) => self.feedback_to(opcode),
            AnyCommand::ReadStatus3(_) => {
                let [phase_a_current, phase_b_current, phase_c_current] =
                    m.phase_currents_a.map(amperes);
                let temperature = celsius(m.motor_temperature_c);
                let status =
                    Status3 { temperature, phase_a_current, phase_b_current, phase_c_current };
                Answer::Data(status.encode(opcode))
            }
            AnyCommand::ReadRunningMode(_) => {
                Answer::Data(RunningMode { mode: self.controller.mode() }.encode(opcode))
            }
            AnyCommand::ReadRunTime(_) => {
                let millis = self.run_time(self.clock).as_millis();
                let run_time = Milliseconds::from_raw(u32::try_from(millis).unwrap_or(u32::MAX));
                Answer::Data(RunTime { run_time }.encode(opcode))
            }
            AnyCommand::ReadVersionDate(_) => {
                let version_date = self.parameters.version_date;
                Answer::Data(Version { version_date }.encode(opcode))
            }
            AnyCommand::ReadModel(_) => {
                Answer::Data(Model { model: self.parameters.model }.encode(opcode))
            }
            AnyCommand::FunctionControl(function) => self.function(function, echo),
            AnyCommand::BusId(BusId::Read) => {
                let [.., low, high] = *data;
                if (low, high) != (0, 0) {
                    return Answer::Ignored(IgnoreReason::AnothersReply);
                }
                let id = self.active.id;
                let reply = match self.parameters.bus {
                    Bus::Can => BusIdReply::OnCan(id),
                    Bus::Rs485 => BusIdReply::OnRs485(id),
                };
                Answer::Data(reply.encode(opcode))
            }
            AnyCommand::BusId(BusId::Write(id)) => {
                let heard = self
                    .id_taken
                    .is_some_and(|(taken, at)| taken == id && now - at < ANOTHERS_REPLY);
                if heard {
                    return Answer::Ignored(IgnoreReason::AnothersReply);
                }
                self.id_taken = Some((id, now));
                self.keep(Settings { id, ..self.stored }, echo)
            }
            AnyCommand::CommunicationLossProtection(set) => {
                let answer = self.write_rom(opcode, echo, |settings| {
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
                let garbage = Answer::Data([data[0], a, b, c, d, e, f, g]);
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
                    let quirks = self.parameters.quirks;
                    let at = brake::opening_time(now, &quirks, &mut self.random);
                    self.brake.release(at);
                }
                echo
            }
            AnyCommand::LockBrake(_) => {
                self.brake.lock();
                if self.brake.holds() {
                    self.controller.shut_down();
                }
                echo
            }
            AnyCommand::Shutdown(_) => {
                self.controller.shut_down();
                self.brake.lock_unless_requested();
                echo
            }
            AnyCommand::Stop(_) => {
                // A locked brake holds already.
                if !self.brake.holds() {
                    self.run(opcode, SetPoint::Stop, LockedBrake::Forbids);
                }
                echo
            }
            AnyCommand::Torque(torque) => {
                let set_point = SetPoint::Current { current_a: torque.current.amperes() };
                self.run(opcode, set_point, LockedBrake::Forbids);
                self.feedback_to(opcode)
            }
            AnyCommand::Speed(speed) => {
                self.run_speed(&speed);
                self.feedback_to(opcode)
            }
            AnyCommand::AbsolutePosition(to) => {
                self.run_position(opcode, to.angle.degrees_f64(), to.max_speed, stall_a);
                self.feedback_to(opcode)
            }
            AnyCommand::SingleTurnPosition(position) => {
                if !self.run_single_turn(&position) {
                    return unknown;
                }
                let Feedback { temperature, current, speed, .. } = self.feedback();
                let [encoder, _, _] = self.encoder.single_turn();
                let feedback = SingleTurnFeedback { temperature, current, speed, encoder };
                Answer::Data(feedback.encode(opcode))
            }
            AnyCommand::IncrementalPosition(by) => {
                let target = encoder.angle_deg() + by.angle.degrees_f64();
                self.run_position(opcode, target, by.max_speed, stall_a);
                self.feedback_to(opcode)
            }
            AnyCommand::ForcePosition(to) => {
                let limit_a = self.limit_a(to.max_torque);
                self.run_position(opcode, to.angle.degrees_f64(), to.max_speed, limit_a);
                self.feedback_to(opcode)
            }
            AnyCommand::Motion(motion) => {
                let set_point = SetPoint::Motion(self.parameters.motion_ranges.set_point(&motion));
                self.run(opcode, set_point, LockedBrake::Forbids);
                Answer::Data(self.motion_feedback().encode())
            }
            // Never here: what the firmware does not know has no kind.
            AnyCommand::Raw(_) => Answer::Ignored(IgnoreReason::UnknownCommand),
        }
    }

    fn feedback_to(&self, opcode: Opcode) -> Answer {
        Answer::Data(self.feedback().encode(opcode))
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

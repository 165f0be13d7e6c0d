//! What each command does and how it is answered, as [`decisions`](super::decisions) says.

use crate::command::*;
use crate::data::Data;
use crate::drive::control::SetPoint;
use crate::drive::encoder::saturated;
use crate::drive::protection::{Heard, STEADY_COMMANDS, STEADY_COMMANDS_SEEN};
use crate::drive::{Bus, Drive, Event, IgnoreReason, Memory, NotRunReason, Plant, Settings};
use crate::opcode::Opcode;
use crate::packet::Packet;
use crate::time::{Duration, Instant};
use crate::units::{
    Angle, CoarseSpeed, Current, Milliseconds, ReportedAcceleration, Temperature, Voltage,
};

mod run;

use run::LockedBrake;

/// For this long after a drive took a bus id, it takes the same command for another drive's reply.
const ANOTHERS_REPLY: Duration = Duration::from_millis(20);

/// The data field of the answer, if there is one, or why the command has no effect.
pub(super) type Answer = Result<Option<Data>, IgnoreReason>;

impl<P: Plant, M: Memory> Drive<P, M> {
    /// Does what the command says.
    pub(super) fn answer(&mut self, opcode: Opcode, packet: &Packet, now: Instant) -> Answer {
        let quirks = self.parameters.quirks;
        let needed =
            if quirks.lost_master_heartbeat { STEADY_COMMANDS_SEEN } else { STEADY_COMMANDS };
        match self.protection.hear(now, self.protection_timeout(), needed) {
            Heard::Recovered => self.events.push(Event::ProtectionRecovered),
            Heard::Unsteady { first: true } if quirks.lost_master_heartbeat => {
                self.not_run(opcode, NotRunReason::CommunicationLost);
                return Ok(Some(packet.data));
            }
            Heard::Steady | Heard::Unsteady { .. } => {}
        }
        if self.reporting.reports(opcode) {
            return Err(IgnoreReason::ReportedActively(opcode));
        }
        let answer = self.carry_out(opcode, &packet.data, now)?;
        let is_silent = quirks.silent_while_reporting && self.reporting.is_on();
        Ok(answer.filter(|_| !is_silent))
    }

    /// The reply to a read without an index, which the drive reports on its own.
    pub(super) fn report(&mut self, opcode: Opcode, now: Instant) -> Option<Data> {
        self.carry_out(opcode, &with_opcode(opcode), now).ok().flatten()
    }

    /// Every kind is listed here, so that the compiler asks for a new one. (It asks for a row's command in the same
    /// round, as this is a match of kinds and not of commands.)
    fn carry_out(&mut self, opcode: Opcode, data: &Data, now: Instant) -> Answer {
        let echo = Some(*data);
        let unknown = Err(IgnoreReason::UnknownCode(opcode));
        let (m, encoder) = (&self.measurement, &self.encoder);
        let stall_a = self.parameters.stall_current_a;
        Ok(match opcode {
            Opcode::ReadPid => {
                let ReadPid { index } = ReadPid::decode(data)?;
                let Some(value) = self.active.gains.get(index) else { return unknown };
                Some(PidGain { index, value }.encode(opcode))
            }
            Opcode::WritePidRam => {
                let WritePidRam { index, value } = WritePidRam::decode(data)?;
                if !self.active.gains.set(index, value) {
                    return unknown;
                }
                echo
            }
            Opcode::WritePidRom => {
                let WritePidRom { index, value } = WritePidRom::decode(data)?;
                if self.active.gains.get(index).is_none() {
                    return unknown;
                }
                self.write_rom(opcode, *data, |settings| {
                    settings.gains.set(index, value);
                })
            }
            Opcode::ReadAcceleration => {
                let ReadAcceleration { index } = ReadAcceleration::decode(data)?;
                let Some(held) = self.active.accelerations.get(index) else { return unknown };
                let acceleration = ReportedAcceleration::from_raw(held.raw());
                Some(AccelerationReading { index, acceleration }.encode(opcode))
            }
            Opcode::WriteAcceleration => {
                let WriteAcceleration { index, acceleration } = WriteAcceleration::decode(data)?;
                if self.active.accelerations.get(index).is_none() {
                    return unknown;
                }
                self.write_rom(opcode, *data, |settings| {
                    settings.accelerations.set(index, acceleration);
                })
            }
            Opcode::ReadMultiTurnEncoder => {
                let position = encoder.position_reading();
                Some(MultiTurnEncoder { position }.encode(opcode))
            }
            Opcode::ReadMultiTurnEncoderRaw => {
                Some(MultiTurnEncoderRaw { raw: encoder.raw_reading() }.encode(opcode))
            }
            Opcode::ReadMultiTurnEncoderOffset => {
                let offset = encoder.offset_reading();
                Some(MultiTurnEncoderOffset { offset }.encode(opcode))
            }
            Opcode::SetEncoderZero => {
                let set = SetEncoderZero::decode(data)?;
                self.keep(Settings { zero_offset: set.offset, ..self.stored }, *data)
            }
            Opcode::SetCurrentPositionZero => {
                let offset = encoder.raw_reading();
                let reply = MultiTurnEncoderOffset { offset }.encode(opcode);
                self.keep(Settings { zero_offset: offset, ..self.stored }, reply)
            }
            Opcode::ReadSingleTurnEncoder => {
                let [position, raw, offset] = encoder.single_turn();
                Some(SingleTurnEncoder { position, raw, offset }.encode(opcode))
            }
            Opcode::ReadMultiTurnAngle => {
                Some(MultiTurnAngle { angle: encoder.angle_reading() }.encode(opcode))
            }
            Opcode::ReadSingleTurnAngle => {
                Some(SingleTurnAngle { angle: encoder.single_turn_angle() }.encode(opcode))
            }
            Opcode::ReadSingleTurnAngleV4_4 => {
                let angle = encoder.half_turn_angle();
                Some(SingleTurnAngleV4_4 { angle }.encode(opcode))
            }
            Opcode::ReadStatus1 => {
                let status = Status1 {
                    temperature: celsius(m.motor_temperature_c),
                    mosfet_temperature: celsius(m.mos_temperature_c),
                    brake: self.told_brake(),
                    voltage: Voltage::saturating_from_volts(m.supply_voltage_v).unwrap_or_default(),
                    errors: self.faults.all(),
                };
                Some(status.encode(opcode))
            }
            Opcode::ReadStatus2 => self.feedback_to(opcode),
            Opcode::ReadStatus3 => {
                let [phase_a_current, phase_b_current, phase_c_current] =
                    m.phase_currents_a.map(amperes);
                let temperature = celsius(m.motor_temperature_c);
                let status =
                    Status3 { temperature, phase_a_current, phase_b_current, phase_c_current };
                Some(status.encode(opcode))
            }
            Opcode::ReadRunningMode => {
                Some(RunningMode { mode: self.controller.mode() }.encode(opcode))
            }
            Opcode::ReadRunTime => {
                // Begins anew at 2^32 ms.
                let run_time = Milliseconds::from_raw(self.run_time(self.clock).as_millis() as u32);
                Some(RunTime { run_time }.encode(opcode))
            }
            Opcode::ReadVersionDate => {
                let version_date = self.parameters.version_date;
                Some(Version { version_date }.encode(opcode))
            }
            Opcode::ReadModel => Some(Model { model: self.parameters.model }.encode(opcode)),
            Opcode::FunctionControl => self.function(FunctionControl::decode(data)?, *data)?,
            Opcode::BusId => match BusId::decode(data)? {
                BusId::Read => {
                    let [.., low, high] = *data;
                    if (low, high) != (0, 0) {
                        return Err(IgnoreReason::AnothersReply);
                    }
                    let id = self.active.id;
                    let reply = match self.parameters.bus {
                        Bus::Can => BusIdReply::OnCan(id),
                        Bus::Rs485 => BusIdReply::OnRs485(id),
                    };
                    Some(reply.encode(opcode))
                }
                BusId::Write(id) => {
                    let heard = self
                        .id_taken
                        .is_some_and(|(taken, at)| taken == id && now - at < ANOTHERS_REPLY);
                    if heard {
                        return Err(IgnoreReason::AnothersReply);
                    }
                    self.id_taken = Some((id, now));
                    self.keep(Settings { id, ..self.stored }, *data)
                }
            },
            Opcode::CommunicationLossProtection => {
                let set = CommunicationLossProtection::decode(data)?;
                let answer = self.write_rom(opcode, *data, |settings| {
                    settings.protection_timeout = set.timeout;
                });
                if set.timeout.raw() == 0 && self.protection.forgive() {
                    self.events.push(Event::ProtectionRecovered);
                }
                answer
            }
            Opcode::SetBaudRate => {
                let set = SetBaudRate::decode(data)?;
                if self.parameters.bus.bits_per_second(set.baud_rate).is_none() {
                    return unknown;
                }
                let [a, b, c, d] = self.random.next().to_le_bytes();
                let [e, f, g, _] = self.random.next().to_le_bytes();
                let garbage = [data[0], a, b, c, d, e, f, g];
                if self.needs_shutdown(opcode) {
                    return Ok(Some(garbage));
                }
                self.keep(Settings { baud_rate: set.baud_rate, ..self.stored }, garbage)
            }
            Opcode::ActiveReply => {
                let set = ActiveReply::decode(data)?;
                let Some(reported) = set.command.opcode() else { return unknown };
                if set.enable.is_on() {
                    self.reporting.enable(reported, set.interval, now);
                } else {
                    self.reporting.disable(reported);
                }
                None
            }
            Opcode::Reset => {
                self.restart(now);
                None
            }
            Opcode::ReleaseBrake => {
                if self.protection.is_tripped() {
                    self.not_run(opcode, NotRunReason::CommunicationLost);
                } else {
                    let at = self.brake_moves_at(now);
                    self.brake.release(at, now);
                }
                echo
            }
            Opcode::LockBrake => {
                let at = self.brake_moves_at(now);
                self.brake.lock(at, now);
                if self.follow_brake(now) && self.brake.holds() && !self.controller.is_off() {
                    let input = self.input();
                    self.controller.set(SetPoint::Stop, &input);
                }
                echo
            }
            Opcode::Shutdown => {
                self.controller.shut_down();
                let at = self.brake_moves_at(now);
                self.brake.lock_unless_requested(at, now);
                echo
            }
            Opcode::Stop => {
                // A locked brake holds already.
                if !self.brake.holds() {
                    self.run(opcode, SetPoint::Stop, LockedBrake::Forbids);
                }
                echo
            }
            Opcode::Torque => {
                let torque = Torque::decode(data)?;
                let set_point = SetPoint::Current { current_a: torque.current.amperes() };
                self.run(opcode, set_point, LockedBrake::Forbids);
                self.feedback_to(opcode)
            }
            Opcode::Speed => {
                let speed = Speed::decode(data)?;
                self.run_speed(&speed);
                self.feedback_to(opcode)
            }
            Opcode::AbsolutePosition => {
                let to = AbsolutePosition::decode(data)?;
                self.run_position(opcode, to.angle.degrees_f64(), to.max_speed, stall_a);
                self.feedback_to(opcode)
            }
            Opcode::SingleTurnPosition => {
                let position = SingleTurnPosition::decode(data)?;
                if !self.run_single_turn(&position) {
                    return unknown;
                }
                let Feedback { temperature, current, speed, .. } = self.feedback();
                let [encoder, _, _] = self.encoder.single_turn();
                let feedback = SingleTurnFeedback { temperature, current, speed, encoder };
                Some(feedback.encode(opcode))
            }
            Opcode::IncrementalPosition => {
                let by = IncrementalPosition::decode(data)?;
                let target = encoder.angle_deg() + by.angle.degrees_f64();
                self.run_position(opcode, target, by.max_speed, stall_a);
                self.feedback_to(opcode)
            }
            Opcode::ForcePosition => {
                let to = ForcePosition::decode(data)?;
                let limit_a = self.limit_a(to.max_torque);
                self.run_position(opcode, to.angle.degrees_f64(), to.max_speed, limit_a);
                self.feedback_to(opcode)
            }
            Opcode::Motion => {
                let motion = RawMotion::decode(data);
                let set_point = SetPoint::Motion(self.parameters.motion_ranges.set_point(&motion));
                self.run(opcode, set_point, LockedBrake::Forbids);
                Some(self.motion_feedback().encode())
            }
        })
    }

    fn feedback_to(&self, opcode: Opcode) -> Option<Data> {
        Some(self.feedback().encode(opcode))
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
        let (id, m) = (self.replies_as(), &self.measurement);
        let number = |x: f32| if x.is_nan() { 0.0 } else { x };
        let feedback = MotionFeedback {
            position_rad: self.encoder.angle_deg().to_radians() as f32,
            velocity_rad_s: number(m.speed_dps.to_radians()),
            torque_nm: number(m.current_a * self.parameters.torque_constant_nm_per_a),
        };
        // Only what is no number is refused, and nothing of that kind is left.
        let steps = self.parameters.motion_ranges.quantise_feedback(id, &feedback);
        steps.unwrap_or(RawMotionFeedback { id_byte: id.get(), ..RawMotionFeedback::default() })
    }

    fn function(&mut self, function: FunctionControl, echo: Data) -> Answer {
        let opcode = Opcode::FunctionControl;
        if self.parameters.quirks.rom_needs_shutdown && !self.controller.is_off() {
            self.not_run(opcode, NotRunReason::NotShutDown);
            return Ok(Some(echo));
        }
        Ok(match function {
            FunctionControl::ClearMultiTurn => {
                let zero = self.encoder.raw_within_turn();
                let stored = Settings { zero_offset: saturated(zero), ..self.stored };
                let answer = self.keep(stored, echo);
                if answer.is_some() {
                    self.turns_to_clear = self.encoder.raw().saturating_sub(zero);
                }
                answer
            }
            FunctionControl::CanIdFilter(on) => {
                self.write_rom(opcode, echo, |settings| settings.can_id_filter = on.is_on())
            }
            FunctionControl::ErrorReporting(on) => {
                self.reporting.set_errors_wanted(on.is_on());
                Some(echo)
            }
            FunctionControl::SaveMultiTurn(on) => {
                self.keep(Settings { save_multi_turn: on.is_on(), ..self.stored }, echo)
            }
            FunctionControl::SetCanId(id) => {
                let answer = self.keep(Settings { id, ..self.stored }, echo);
                if self.parameters.quirks.silent_id_change { None } else { answer }
            }
            FunctionControl::MaxPositiveAngle(angle) => {
                let angle = Some(Angle::from_raw(angle));
                self.limit_position(echo, |settings| settings.max_positive_angle = angle)
            }
            FunctionControl::MaxNegativeAngle(angle) => {
                let angle = Some(Angle::from_raw(angle));
                self.limit_position(echo, |settings| settings.max_negative_angle = angle)
            }
            FunctionControl::Other(_) => return Err(IgnoreReason::UnknownCode(opcode)),
        })
    }

    /// Functions 6 and 7.
    fn limit_position(&mut self, echo: Data, change: impl Fn(&mut Settings)) -> Option<Data> {
        let answer = self.write_rom(Opcode::FunctionControl, echo, change)?;
        let limits = self.active.position_limits();
        self.controller.keep_within(limits, self.encoder.angle_deg());
        Some(answer)
    }

    /// Changes what is stored and what acts. `answer` is the reply if that worked.
    fn write_rom(
        &mut self,
        opcode: Opcode,
        answer: Data,
        change: impl Fn(&mut Settings),
    ) -> Option<Data> {
        if self.needs_shutdown(opcode) {
            return Some(answer);
        }
        let mut stored = self.stored;
        change(&mut stored);
        self.store(stored).then(|| {
            change(&mut self.active);
            answer
        })
    }

    /// Whether this is not stored because the motor is not shut down: a quirk.
    fn needs_shutdown(&mut self, opcode: Opcode) -> bool {
        let is_refused = self.parameters.quirks.rom_needs_shutdown
            && matches!(opcode, Opcode::WritePidRom | Opcode::SetBaudRate)
            && !self.controller.is_off();
        if is_refused {
            self.not_run(opcode, NotRunReason::NotShutDown);
        }
        is_refused
    }

    /// Changes only what is stored: it acts after a restart.
    fn keep(&mut self, stored: Settings, answer: Data) -> Option<Data> {
        self.store(stored).then_some(answer)
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

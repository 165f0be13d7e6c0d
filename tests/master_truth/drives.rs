//! Drives that note the truth and misbehave as real drives do. And another master.

use std::collections::VecDeque;
use std::marker::PhantomData;

use myactuator_host_std::sim::bus::Node;
use myactuator_protocol_core::command::{
    AbsolutePosition, IncrementalPosition, PidIndex, ReadMultiTurnAngle, ReadPid, ReadStatus2,
    Speed, Stop,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, MaxSpeed, MaxTorque, SpeedTarget};
use myactuator_protocol_core::wire::rs485::Receiver;
use myactuator_protocol_core::{Channel, Command, Data, MotorId, Packet, Target};
use myactuator_tests::dice::Dice;
use myactuator_tests::rig::with_token;
use myactuator_tests::values::LOST_MASTER;
use myactuator_tests::wire::Wire;

use super::names::{REPORTS, STRANGER_MARK, STRANGERS, has_angle, has_values, is_asking};
use super::restarts::WRAPS_MS;
use super::scenarios::Scenario;
use super::truth::{Book, DONE};
use super::turning::Shaft;

/// A byte that no drive here knows.
pub(crate) const UNKNOWN: u8 = 0x71;
/// How often a drive that has lost its master reports that. Real drives do so once a second.
const HEARTBEAT: Duration = Duration::from_millis(20);
/// How long it hears nothing before that.
const DEAF: Duration = Duration::from_millis(8);
const DAY_MS: u64 = 24 * 3_600 * 1_000;
/// How long a drive takes to restart (field notes).
pub(crate) const BOOT: Duration = Duration::from_millis(1_100);

/// A drive that answers every command after 0.7 to 0.9 ms, in order, with the command's own token.
pub(crate) struct Drive<W> {
    wire: PhantomData<W>,
    motor: MotorId,
    receiver: Receiver,
    replies: VecDeque<(Instant, Packet)>,
    dice: Dice,
    book: Book,
    /// It hears nothing before this time, because it restarts or its wire is loose.
    deaf_until: Instant,
    booted: Instant,
    /// How long it had run when the master began.
    ran_ms: u64,
    /// It has lost its master, and reports that next at this time.
    lost: Option<Instant>,
    /// What it reports on its own: command byte, interval, next time.
    report: Option<(u8, Duration, Instant)>,
    reported: u32,
    last_reply: Option<Packet>,
    shaft: Shaft,
    /// How long it takes to restart.
    pub(crate) boot: Duration,
    /// One reply in this many comes twice, 0 for none.
    pub(crate) repeats: u64,
    /// It does not hear commands to all (function 2).
    pub(crate) is_deaf_to_all: bool,
}

impl<W> Drive<W> {
    pub(crate) fn new(motor: MotorId, seed: u64, book: Book) -> Self {
        let mut dice = Dice::new(seed);
        let shaft = Shaft::new(&mut dice);
        book.open().page(motor).turning.is_fast = shaft.is_fast();
        Self {
            wire: PhantomData,
            motor,
            receiver: Receiver::new(),
            replies: VecDeque::new(),
            dice,
            book,
            deaf_until: Instant::ZERO,
            booted: Instant::ZERO,
            ran_ms: 0,
            lost: None,
            report: None,
            reported: 0,
            last_reply: None,
            shaft,
            boot: Duration::ZERO,
            repeats: 0,
            is_deaf_to_all: false,
        }
    }

    /// Draws how long it has run already.
    pub(crate) fn has_run(&mut self, dice: &mut Dice) {
        // In the last case it is about to wrap.
        let ages = [
            dice.below(10_000),
            dice.below(DAY_MS),
            dice.below(WRAPS_MS),
            WRAPS_MS - 1 - dice.below(10_000),
        ];
        self.ran_ms = ages[dice.below(4) as usize];
        self.book.open().pages[self.motor.index()].run_time.had_run(self.ran_ms);
    }

    /// It loses its master.
    pub(crate) fn lose_master(&mut self, now: Instant) {
        self.deaf_until = self.deaf_until.max(now + DEAF);
        self.lost = Some(self.deaf_until);
    }

    /// It reports an error on its own (function 3).
    pub(crate) fn report_error(&mut self, now: Instant) {
        let data = self.report_of(0x9A);
        self.replies.push_back((now, Packet { channel: Channel::Reply(self.motor), data }));
    }

    fn report_of(&mut self, byte: u8) -> Data {
        self.reported += 1;
        let token = REPORTS | self.reported;
        self.book.open().pages[self.motor.index()].reports.insert(token);
        let mut data = [byte, 0, 0, DONE, 0, 0, 0, 0];
        data[4..].copy_from_slice(&token.to_le_bytes());
        data
    }

    fn restart(&mut self, now: Instant) {
        self.replies.clear();
        self.receiver.reset();
        self.shaft.loses_turns(now);
        self.deaf_until = now + self.boot;
        (self.booted, self.ran_ms) = (self.deaf_until, 0);
        (self.lost, self.report, self.last_reply) = (None, None, None);
        self.book.open().has_restarted(self.motor);
    }

    fn hear(&mut self, packet: &Packet, now: Instant) {
        let channel = match packet.channel {
            Channel::Command(Target::Motor(motor)) if motor == self.motor => Channel::Reply(motor),
            Channel::Command(Target::All) if !self.is_deaf_to_all => Channel::Reply(self.motor),
            Channel::Motion(motor) if motor == self.motor => Channel::MotionReply(motor),
            _ => return,
        };
        // On RS485 the reply of another drive with the same id looks like a command.
        if now < self.deaf_until || packet.data[0] == LOST_MASTER[0] {
            return;
        }
        self.speak_up(now);
        let ignores = self.lost.take().is_some();
        self.book.open().heard(self.motor, packet, ignores, now);
        let command = packet.data;
        if ignores {
            return self.answer(Packet { channel, data: command }, now);
        }
        if channel == Channel::Reply(self.motor) {
            match command[0] {
                0x76 => return self.restart(now),
                0xB6 => {
                    let every = 10_000 * u64::from(u16::from_le_bytes([command[3], command[4]]));
                    let every = Duration::from_micros(every);
                    self.report = (command[2] != 0).then_some((command[1], every, now + every));
                    return;
                }
                UNKNOWN => {
                    // Like firmware 2025070202.
                    if let Some(last) = self.last_reply {
                        self.book.open().was_doubled(self.motor);
                        self.answer(last, now);
                    }
                    return;
                }
                byte if self.report.is_some_and(|(reported, ..)| reported == byte) => return,
                _ if !is_asking(packet) => return,
                _ => {}
            }
        }
        let reply = Packet { channel, data: self.values(&command, channel, now) };
        self.last_reply = Some(reply);
        self.answer(reply, now);
        if self.repeats > 0 && self.dice.below(self.repeats) == 0 {
            self.book.open().was_doubled(self.motor);
            self.answer(reply, now);
        }
    }

    fn values(&self, command: &Data, channel: Channel, now: Instant) -> Data {
        let mut data = *command;
        match channel {
            Channel::MotionReply(motor) => {
                data = [motor.get(), command[0], command[1], DONE, 0, command[7], 0, 0];
            }
            _ if command[0] == 0xB1 => {
                let run_time = (self.ran_ms + (now - self.booted).as_millis()) as u32;
                data[4..].copy_from_slice(&run_time.to_le_bytes());
            }
            _ if has_values(command[0]) => {
                data[3] = DONE;
                if has_angle(command[0]) {
                    data[6..].copy_from_slice(&self.shaft.angle(now).to_le_bytes());
                }
            }
            _ => {}
        }
        data
    }

    fn answer(&mut self, reply: Packet, now: Instant) {
        self.book.open().page(self.motor).said.insert(reply.data);
        let due = now + Duration::from_micros(700 + self.dice.below(201));
        let due = self.replies.back().map_or(due, |(before, _)| due.max(*before));
        self.replies.push_back((due, reply));
    }

    fn speak_up(&mut self, now: Instant) {
        let channel = Channel::Reply(self.motor);
        if let Some(at) = self.lost.as_mut().filter(|at| **at <= now) {
            *at = now + HEARTBEAT;
            self.book.open().pages[self.motor.index()].lost_master_untold = true;
            self.replies.push_back((now, Packet { channel, data: LOST_MASTER }));
        }
        if let Some((byte, every, at)) = self.report.filter(|(.., at)| *at <= now) {
            self.report = Some((byte, every, at + every));
            let data = self.report_of(byte);
            self.replies.push_back((now, Packet { channel, data }));
        }
    }
}

impl<W: Wire> Node<W::Frame> for Drive<W> {
    fn handle_frame(&mut self, frame: &W::Frame, now: Instant) {
        if let Some(packet) = W::packet(&mut self.receiver, frame, true) {
            self.hear(&packet, now);
        }
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<W::Frame> {
        self.speak_up(now);
        self.replies.pop_front_if(|(due, _)| *due <= now).map(|(_, packet)| W::frame(&packet))
    }

    fn poll_at(&self) -> Option<Instant> {
        let reply = self.replies.front().map(|(due, _)| *due);
        let report = self.report.map(|(.., at)| at);
        [reply, self.lost, report].into_iter().flatten().min()
    }

    fn reset(&mut self, now: Instant) {
        self.restart(now);
    }
}

/// Another master. Now and then it asks the first motor, or any motor, sometimes stops it, and may move it.
pub(crate) struct Stranger<W> {
    wire: PhantomData<W>,
    dice: Dice,
    next: Instant,
    asked: u32,
    motor: MotorId,
    /// Decides when it moves a motor, if it does.
    moves: Option<Dice>,
    /// If it turns to any motor: decides which of this many is next, and whether it moves that in motion mode.
    roams: Option<(Dice, u8)>,
}

impl<W: Wire> Stranger<W> {
    pub(crate) fn new(scenario: &Scenario) -> Self {
        let Scenario { seed, motors, conditions, .. } = *scenario;
        Self {
            wire: PhantomData,
            dice: Dice::new(seed),
            next: Instant::from_micros(2_000),
            asked: 0,
            motor: MotorId::MIN,
            moves: conditions.stranger_moves.then(|| Dice::new(seed ^ 0x50BE)),
            roams: conditions.stranger_roams.then(|| (Dice::new(seed ^ 0x7A3D), motors)),
        }
    }

    /// Goes on to another motor. Returns whether it moves that motor in motion mode.
    fn roam(&mut self) -> bool {
        let Some((dice, motors)) = &mut self.roams else { return false };
        let next = MotorId::new(dice.below(u64::from(*motors)) as u8 + 1);
        self.motor = next.unwrap_or(MotorId::MIN);
        let is_motion = dice.below(6) == 0;
        is_motion && self.moves.is_some() && W::NAME == "CAN"
    }

    /// A command that moves the motor, if it is time for one.
    fn motion(&mut self) -> Option<Data> {
        let dice = self.moves.as_mut()?;
        let value = (STRANGERS | self.asked) as i32;
        let (max_speed, angle) = (MaxSpeed::NO_LIMIT, Angle::from_raw(value));
        let mut data = match dice.below(6) {
            0 => return Some(IncrementalPosition { max_speed, angle }.encode()),
            1 => AbsolutePosition { max_speed, angle }.encode(),
            2 => {
                let speed = SpeedTarget::from_raw(value);
                Speed { max_torque: MaxTorque::NO_LIMIT, speed }.encode()
            }
            _ => return None,
        };
        data[1] = STRANGER_MARK;
        Some(data)
    }
}

impl<W: Wire> Node<W::Frame> for Stranger<W> {
    fn handle_frame(&mut self, _: &W::Frame, _: Instant) {}

    fn poll_transmit(&mut self, now: Instant) -> Option<W::Frame> {
        if now < self.next {
            return None;
        }
        self.next = now + Duration::from_micros(1_000 + self.dice.below(20_000));
        self.asked += 1;
        let token = STRANGERS | self.asked;
        let pid = |index| with_token(ReadPid { index }, token).encode();
        let data = match self.dice.below(20) {
            0..8 => with_token(ReadMultiTurnAngle, token).encode(),
            8..11 => pid(PidIndex::from_raw(1)),
            // Our callers never ask this.
            11..16 => pid(PidIndex::POSITION_KD),
            16..19 => with_token(ReadStatus2, token).encode(),
            _ => with_token(Stop, token).encode(),
        };
        let data = self.motion().unwrap_or(data);
        let packet = if self.roam() {
            let [high, low] = (self.asked as u16).to_be_bytes();
            let data = [high, low, 0, 0, 0, 0, 0, STRANGER_MARK];
            Packet { channel: Channel::Motion(self.motor), data }
        } else {
            Packet { channel: Channel::Command(self.motor.into()), data }
        };
        Some(W::frame(&packet))
    }

    fn poll_at(&self) -> Option<Instant> {
        Some(self.next)
    }
}

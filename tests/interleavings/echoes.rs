//! Searches every interleaving of a line and its adapter. The loop over RS485 is cloned and run, with a master of two
//! motors, a direction pin and everything that the loop knows of echoes.
//!
//! The adapter may or may not echo, and the loop may or may not be configured for that. The adapter hands over bytes in
//! order, at once or later. So an echo comes alone, or in one burst with the answer. Every command here, except the
//! read of the status, is acknowledged by its own bytes. Two things must hold:
//!
//! - No echo passes for an answer.
//! - Answers of a working motor do not pass for echoes so often that the motor counts as silent.

mod adapters;
mod line;
mod port;

use std::hash::Hash;

use myactuator_protocol_core::command::{LockBrake, ReadMultiTurnAngle, ReadStatus1};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::{HalfDuplex, Runner, SerialMaster};
use myactuator_protocol_core::master::{
    Bus, Config, Event, Failure, MotorSet, Presence, StopKind, Ticket, TicketId,
};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Command, MotorId};

use super::canonical;
use super::search::{Broken, Searched};
use super::world::{self, Medium, motor_at};
use line::Line;
use port::{End, Lent, NoDelay, Pin, Port};

/// The longest sleep of a loop.
const LONGEST_IDLE: Duration = Duration::from_millis(10);
/// How long the program is halted: longer than it waits for any echo.
const HALT: Duration = Duration::from_millis(150);
/// The longest that anything takes in a world without faults, whatever happened before.
const LONGEST_WAIT: Duration = Duration::from_millis(200);
/// The largest number of rounds in a row that find something to do.
const MOST_ROUNDS: usize = 20;
/// How many bytes of a frame the port takes before it fails.
const CUT_AT: usize = 7;

/// A call, for the motor with this index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Call {
    /// A read of the angle, which is 0.
    Angle(u8),
    Status(u8),
    Lock(u8),
    Stop(u8),
    StopAll,
    Lift,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// The next frame that is sent reaches no drive.
    Deaf,
    /// The port takes the beginning of the next frame and then fails.
    CutShort,
    /// The next bytes from the adapter are lost.
    Lose,
    /// The next bytes from the adapter are damaged and no frame any more.
    Harm,
    /// An answer comes twice.
    Double,
    /// Something comes late.
    Late,
    /// The bytes that have arrived are lost in the port, and the port reports that.
    ReadFails,
    /// The program is halted. Everything comes meanwhile.
    Halt,
    /// The same, but the adapter still holds the echoes, and answers are lost.
    HaltAndHold,
    LoseMaster(u8),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    Call(Call),
    /// The loop polls the port until there is nothing to do, and sends.
    Poll,
    /// The adapter hands over the next bytes.
    Arrive,
    /// Time passes until something happens.
    Wait,
    Fault(Fault),
}

/// An adapter, the motors that are there, the calls, and the faults that may occur.
#[derive(Clone, Copy, Debug)]
pub(super) struct Adapter {
    pub(super) name: &'static str,
    pub(super) echoes: bool,
    pub(super) is_told: bool,
    pub(super) is_there: [bool; 2],
    pub(super) calls: &'static [Call],
    pub(super) most_calls: u8,
    pub(super) faults: &'static [Fault],
    pub(super) most_faults: u8,
    pub(super) depth: usize,
}

/// What is known of one motor.
#[derive(Clone, Copy, Debug, Default, Hash)]
struct Truth {
    /// The command byte of a request without an outcome so far.
    open: Option<u8>,
    /// A stop was called and is neither confirmed nor given up.
    is_stopping: bool,
}

type Loop = SerialMaster<HalfDuplex<Port, Pin, NoDelay>, Lent, 2>;

#[derive(Clone)]
pub(super) struct State {
    arm: Loop,
    end: End,
    line: Line,
    adapter: &'static Adapter,
    truth: [Truth; 2],
    tickets: [Option<TicketId>; 2],
    calls_left: u8,
    faults_left: u8,
    /// The loop has processed everything that has come.
    is_polled: bool,
    steps: Vec<Step>,
}

fn config(is_told: bool) -> Config {
    let bus = Bus::Rs485 { turnaround: Duration::ZERO, echo: is_told };
    // Only its bytes and its place distinguish an echo from an answer on any line. With three attempts a command is
    // answered even if one attempt goes wrong and, for a missing echo, another's answer is taken.
    Config { bus, attempts: 3, shortest_response: Duration::ZERO, ..world::config(Medium::Line) }
}

impl State {
    pub(super) fn new(adapter: &'static Adapter) -> Self {
        let mut end = End { now: world::START, ..End::default() };
        let mut arm = end.lend(|| {
            let Ok(port) = HalfDuplex::new(Port, Pin, NoDelay, 0, 0);
            SerialMaster::new(port, Lent, config(adapter.is_told))
        });
        arm.master().handle_timeout(end.now);
        Self {
            arm,
            end,
            line: Line::new(adapter.echoes, adapter.is_there),
            adapter,
            truth: [Truth::default(); 2],
            tickets: [None; 2],
            calls_left: adapter.most_calls,
            faults_left: adapter.most_faults,
            is_polled: false,
            steps: Vec::new(),
        }
    }

    fn faults_had(&self) -> u8 {
        self.adapter.most_faults - self.faults_left
    }

    fn call(&mut self, call: Call) -> bool {
        self.calls_left -= 1;
        self.is_polled = false;
        match call {
            Call::Angle(at) => self.request(at, ReadMultiTurnAngle),
            Call::Status(at) => self.request(at, ReadStatus1),
            Call::Lock(at) => self.request(at, LockBrake),
            Call::Stop(at) => {
                let motor = motor_at(at.into());
                let is_put = self.arm.master().stop(motor, StopKind::Hold).is_ok();
                self.stops(motor);
                is_put
            }
            Call::StopAll => {
                let all = [0, 1].map(motor_at).into_iter().collect::<MotorSet>();
                let is_put = self.arm.master().stop_all(StopKind::Hold, all).is_ok();
                all.iter().for_each(|motor| self.stops(motor));
                is_put
            }
            Call::Lift => {
                self.arm.master().lift_stop();
                true
            }
        }
    }

    fn request<C: Command>(&mut self, at: u8, command: C) -> bool {
        let (motor, [byte, ..]) = (motor_at(at.into()), command.encode());
        let asked: Result<Ticket<C>, RequestError> = self.arm.master().request(motor, command);
        let Ok(ticket) = asked else { return false };
        self.tickets[motor.index()] = Some(ticket.id());
        self.truth[motor.index()].open = Some(byte);
        self.line.drive_of(motor).look_for(byte);
        true
    }

    /// Notes a stop. A stop in flight goes on.
    fn stops(&mut self, motor: MotorId) {
        if !std::mem::replace(&mut self.truth[motor.index()].is_stopping, true) {
            self.line.drive_of(motor).look_for(0x81);
        }
    }

    /// Runs the loop until there is nothing to do. `is_heard`: whether drives hear the first frame that it sends.
    /// Returns whether it sent anything.
    fn poll(&mut self, is_heard: bool) -> Result<bool, Broken> {
        self.is_polled = true;
        let mut has_sent = false;
        for _ in 0..MOST_ROUNDS {
            let may_fail = self.end.fails_behind.is_some() || self.end.read_fails;
            let (event, has_failed) = match self.end.lend(|| self.arm.poll()) {
                Ok(event) => (event, false),
                Err(_) if may_fail => (None, true),
                Err(error) => return Err(format!("the loop fails: {error:?}")),
            };
            let sent = std::mem::take(&mut self.end.written);
            if let Some(event) = &event {
                self.told(event)?;
            }
            if !sent.is_empty() {
                self.line.carry(&sent, self.end.now, is_heard || has_sent);
                has_sent = true;
            } else if event.is_none() && !has_failed {
                self.end.fails_behind = None;
                self.check_after_round()?;
                return Ok(has_sent);
            }
        }
        Err("the loop finds no end".into())
    }

    fn check_after_round(&mut self) -> Result<(), Broken> {
        if self.end.sends || self.end.has_sent_into_nothing {
            return Err("the transceiver's direction is wrong".into());
        }
        if self.line.have_met && self.faults_had() == 0 {
            return Err("a command meets an answer on the line".into());
        }
        for motor in [0, 1].map(motor_at) {
            let health = self.arm.master().health(motor);
            let is_heard = health.last_seen.is_some() || health.presence == Presence::Present;
            if is_heard && !self.line.drive_of(motor).is_there {
                return Err("a motor that is not there seems to be heard".into());
            }
        }
        Ok(())
    }

    /// Each event must be true.
    fn told(&mut self, event: &Event) -> Result<(), Broken> {
        match *event {
            Event::Reply { ticket, data, .. } => {
                let byte = self.close(ticket)?;
                if self.line.may_be_older(ticket.motor()) {
                    return Ok(());
                }
                if !self.line.drive_of(ticket.motor()).has_executed(byte) {
                    return Err("a command that was not executed is answered".into());
                }
                let is_its = data[0] == byte && (byte == 0x9A) == (data[1..] != [0; 7]);
                if is_its { Ok(()) } else { Err("an answer has wrong values".into()) }
            }
            Event::Failed { ticket, failure } => {
                self.close(ticket)?;
                let is_well = self.line.drive_of(ticket.motor()).is_there
                    && self.adapter.most_faults - self.faults_left < 2;
                if failure == Failure::NoReply && is_well {
                    return Err("a working motor counts as silent".into());
                }
                Ok(())
            }
            Event::StopConfirmed { motor } => {
                if !std::mem::take(&mut self.truth[motor.index()].is_stopping) {
                    return Err("a stop is confirmed that nobody waits for".into());
                }
                let is_heard = self.line.drive_of(motor).has_executed(0x81);
                if is_heard || self.line.may_be_older(motor) {
                    return Ok(());
                }
                Err("a stop is confirmed, and not heard".into())
            }
            Event::StopUnconfirmed { motor } if self.line.drive_of(motor).is_there => {
                Err("the stop of a working motor is not confirmed".into())
            }
            _ => Ok(()),
        }
    }

    fn close(&mut self, ticket: TicketId) -> Result<u8, Broken> {
        let index = ticket.motor().index();
        let is_its = self.tickets[index].take() == Some(ticket);
        let open = self.truth[index].open.take().filter(|_| is_its);
        open.ok_or_else(|| "an outcome of a request that is not open".into())
    }

    /// When something happens next, after the loop has processed everything that has come.
    fn next_moment(&mut self) -> Result<Instant, Broken> {
        let now = self.end.now;
        self.end.lend(|| self.arm.idle(now + LONGEST_IDLE));
        if self.end.idle_until <= now {
            return Err("a sleep that does not end".into());
        }
        let coming = self.line.next_at().filter(|&at| at > now);
        Ok(coming.map_or(self.end.idle_until, |at| at.min(self.end.idle_until)))
    }

    fn wait(&mut self) -> Result<bool, Broken> {
        if !self.is_polled {
            return Ok(false);
        }
        let until = self.next_moment()?;
        let late = self.line.late_at(until);
        let may_be_late = self.adapter.faults.contains(&Fault::Late);
        let is_possible =
            late.is_some_and(|late| late == 0 || may_be_late && late <= self.faults_left);
        if is_possible {
            self.faults_left -= late.unwrap_or(0);
            (self.end.now, self.is_polled) = (until, false);
        }
        Ok(is_possible)
    }

    fn arrive(&mut self) -> bool {
        let bytes = self.line.hand_over(self.end.now);
        let is_there = bytes.is_some();
        self.end.arrived.extend(bytes.into_iter().flatten());
        self.is_polled &= !is_there;
        is_there
    }

    fn fault(&mut self, fault: Fault) -> Result<bool, Broken> {
        self.faults_left -= 1;
        match fault {
            Fault::Deaf => self.poll(false),
            Fault::CutShort => {
                self.end.fails_behind = Some(CUT_AT);
                self.poll(true)
            }
            Fault::Lose => Ok(self.line.harm(true, self.end.now)),
            Fault::Harm => Ok(self.line.harm(false, self.end.now)),
            Fault::Double => Ok(self.line.double(self.end.now)),
            Fault::Late => Ok(false),
            Fault::ReadFails => {
                let is_any = !self.end.arrived.is_empty();
                self.line.lose(self.end.arrived.make_contiguous());
                self.end.read_fails = true;
                self.poll(true)?;
                Ok(is_any)
            }
            Fault::Halt => {
                self.end.now += HALT;
                self.end.arrived.extend(self.line.all());
                self.is_polled = false;
                Ok(true)
            }
            Fault::HaltAndHold => {
                self.end.now += HALT;
                self.is_polled = false;
                Ok(self.line.hold_echoes(self.end.now))
            }
            Fault::LoseMaster(at) => {
                let is_free = self.line.is_free() && !self.arm.master().is_anything_in_flight();
                self.line.lose_master(at.into(), self.end.now);
                Ok(is_free)
            }
        }
    }
}

impl Searched for State {
    type Step = Step;

    fn possible(&self) -> Vec<Step> {
        let mut steps = vec![Step::Poll, Step::Arrive, Step::Wait];
        if self.calls_left > 0 {
            steps.extend(self.adapter.calls.iter().copied().map(Step::Call));
        }
        if self.faults_left > 0 {
            steps.extend(self.adapter.faults.iter().copied().map(Step::Fault));
        }
        steps
    }

    fn step(&mut self, step: Step) -> Result<bool, Broken> {
        self.steps.push(step);
        match step {
            Step::Call(call) => Ok(self.call(call)),
            Step::Poll if self.is_polled => Ok(false),
            Step::Poll => self.poll(true).map(|_| true),
            Step::Arrive => Ok(self.arrive()),
            Step::Wait => self.wait(),
            Step::Fault(fault) => self.fault(fault),
        }
    }

    fn steps(&self) -> &[Step] {
        &self.steps
    }

    fn number(&self) -> u64 {
        canonical::number(&self.arm, self.end.now, |hasher| {
            self.line.hash_from_now(self.end.now, hasher);
            (&self.truth, &self.end.arrived).hash(hasher);
            (self.calls_left, self.faults_left, self.is_polled).hash(hasher);
        })
    }

    /// Once no call and no fault is left, everything must end.
    fn check(&self) -> Result<(), Broken> {
        let is_last = matches!(self.steps.last(), Some(Step::Call(_) | Step::Fault(_)));
        let is_over = (self.calls_left, self.faults_left) == (0, 0);
        if is_over && is_last { self.check_end() } else { Ok(()) }
    }

    fn check_end(&self) -> Result<(), Broken> {
        let mut state = self.clone();
        let end = state.end.now + LONGEST_WAIT;
        while state.end.now < end {
            while state.arrive() {}
            state.poll(true)?;
            if !state.arrive() {
                state.end.now = state.next_moment()?;
            }
        }
        for (truth, drive) in state.truth.iter().zip(&state.line.drives) {
            if truth.open.is_some() {
                return Err("a request hangs".into());
            }
            if truth.is_stopping && drive.is_there {
                return Err("a stop hangs".into());
            }
        }
        Ok(())
    }
}

//! One state: the master, its world, and what can happen next. `oracle` checks what must hold.

use std::fmt;

use myactuator_protocol_core::master::{Master, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::Received;
use myactuator_protocol_core::wire::rs485;
use myactuator_protocol_core::{Channel, Packet};

use super::callers::Call;
use super::canonical;
use super::oracle::check_poll_at;
use super::search::{Broken, Searched};
use super::world::{self, Medium, World, motor_at, motor_of, moves, urgency};

/// The next step. The numbers are indices of motors or of frames in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    Call(Call),
    /// The same, before the caller has taken pending events.
    CallBeforeEvents(Call),
    /// The bus takes the offered packet. Until then it refuses it.
    Take,
    /// It takes the packet and hands back this frame, which is less urgent.
    TakeForAnother(u8),
    /// The drives hear a command: the first one, or one that is more urgent than all before it.
    Hear(u8),
    HearTwice(u8),
    LoseCommand(u8),
    /// A motor's first reply comes.
    Reply(u8),
    ReplyTwice(u8),
    LoseReply(u8),
    LoseMaster(u8),
    /// Another master asks one of our motors and one of its own, and both answer.
    Foreign,
    /// On a line: another master stops motor 1, which hears it or not.
    ForeignStop(StopKind, bool),
    /// On a line: it takes the offered packet, and the master receives its echo.
    TakeAndEcho,
    /// On a line: it takes the offered packet, and no drive hears it.
    TakeAndLose,
    /// The bus is cut. Commands in flight stay pending.
    Cut,
    Mend,
    /// A millisecond passes.
    Tick,
    /// The time of `poll_at` comes.
    Sleep,
}

/// One state.
#[derive(Clone)]
pub(crate) struct State<const N: usize> {
    pub(super) master: Master<N>,
    pub(crate) world: World,
    /// The possible calls.
    calls: &'static [Call],
    /// How many calls may still be made.
    pub(super) calls_left: u8,
    /// The steps that led here.
    pub(crate) steps: Vec<Step>,
}

/// A world without faults comes to rest in this many steps.
const MOST_STEPS: usize = 300;

/// How far a search goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub(crate) name: &'static str,
    pub(crate) medium: Medium,
    /// The possible calls.
    pub(crate) calls: &'static [Call],
    /// The number of calls in one run.
    pub(crate) most_calls: u8,
    pub(crate) faults: u8,
    pub(crate) depth: usize,
}

impl<const N: usize> State<N> {
    pub(crate) fn new(bounds: &Bounds) -> Self {
        let &Bounds { medium, calls, most_calls: calls_left, faults, .. } = bounds;
        let mut master = Master::new(world::config(medium));
        master.handle_timeout(world::START);
        let world = World::new(medium, N, faults);
        Self { master, world, calls, calls_left, steps: Vec::new() }
    }
}

impl<const N: usize> Searched for State<N> {
    type Step = Step;

    fn number(&self) -> u64 {
        canonical::number(&self.master, self.world.now, |hasher| self.world.hash_from_now(hasher))
    }

    fn steps(&self) -> &[Step] {
        &self.steps
    }

    fn possible(&self) -> Vec<Step> {
        let calls = self.calls;
        let mut steps = vec![Step::Take, Step::Tick, Step::Sleep];
        if self.calls_left > 0 {
            steps.extend(calls.iter().copied().map(Step::Call));
            if self.master.clone().poll_event().is_some() {
                steps.extend(calls.iter().copied().map(Step::CallBeforeEvents));
            }
        }
        let may_fail = self.world.faults_left > 0;
        for index in 0..self.world.commands.len() as u8 {
            steps.extend([Step::Hear(index)]);
            if may_fail {
                steps.extend([Step::HearTwice(index), Step::LoseCommand(index)]);
                steps.push(Step::TakeForAnother(index));
            }
        }
        let is_line = self.world.medium == Medium::Line;
        for motor in 0..N as u8 {
            if self.world.first_reply(motor.into()).is_some() {
                steps.push(Step::Reply(motor));
                if may_fail {
                    steps.extend([Step::ReplyTwice(motor), Step::LoseReply(motor)]);
                }
            }
            if may_fail && !is_line {
                steps.push(Step::LoseMaster(motor));
            }
        }
        match self.world.medium {
            Medium::Line if may_fail => {
                steps.extend([Step::Foreign, Step::TakeAndLose, Step::TakeAndEcho]);
                for kind in [StopKind::Hold, StopKind::Off] {
                    steps.extend([true, false].map(|is_heard| Step::ForeignStop(kind, is_heard)));
                }
            }
            Medium::Line => steps.push(Step::Foreign),
            Medium::Can => steps.push(Step::Foreign),
            Medium::CanThatIsCut => steps.extend([Step::Foreign, Step::Cut, Step::Mend]),
        }
        steps
    }

    fn step(&mut self, step: Step) -> Result<bool, Broken> {
        self.steps.push(step);
        if let Step::CallBeforeEvents(call) = step {
            return Ok(self.call(call));
        }
        // A caller may call before it takes an event, but takes it soon.
        self.poll_events()?;
        if let Step::Call(call) = step {
            return Ok(self.call(call));
        }
        self.master.handle_timeout(self.world.now);
        self.poll_events()?;
        let is_done = self.of_bus(step)?;
        // After receiving, the loop reads the time, too.
        self.master.handle_timeout(self.world.now);
        Ok(is_done)
    }

    fn check(&self) -> Result<(), Broken> {
        check_poll_at(&self.master, self.world.now)
    }

    fn check_end(&self) -> Result<(), Broken> {
        let mut state = self.clone();
        let since = state.world.now;
        state.world.faults_left = u8::MAX;
        state.world.mend();
        for _ in 0..MOST_STEPS {
            state.master.handle_timeout(state.world.now);
            state.poll_events()?;
            while state.take(None)? {}
            if !state.world.commands.is_empty() {
                state.hear(0, 1);
                continue;
            }
            let replies = &state.world.replies;
            let first = (0..N).filter_map(|motor| Some((state.world.first_reply(motor)?, motor)));
            if let Some((_, motor)) = first.min().filter(|_| !replies.is_empty()) {
                state.reply(motor, false)?;
                continue;
            }
            match state.master.poll_at() {
                Some(at) => {
                    if at <= state.world.now {
                        return Err("a sleep that does not end".into());
                    }
                    state.pass(at);
                }
                None => return state.check_over(since),
            }
        }
        Err("it never comes to rest".into())
    }
}

impl<const N: usize> State<N> {
    /// Takes this step on the bus.
    fn of_bus(&mut self, step: Step) -> Result<bool, Broken> {
        match step {
            Step::Call(_) | Step::CallBeforeEvents(_) => Ok(false),
            Step::Take => self.take(None),
            Step::TakeAndLose => {
                self.world.loses_next = true;
                Ok(self.world.fault() && self.take(None)?)
            }
            Step::Cut => Ok(self.world.fault() && self.world.cut()),
            Step::Mend => Ok(self.world.mend()),
            Step::TakeForAnother(index) => Ok(self.world.fault() && self.take(Some(index.into()))?),
            Step::Hear(index) => Ok(self.hear(index.into(), 1)),
            Step::HearTwice(index) => Ok(self.world.fault() && self.hear(index.into(), 2)),
            Step::LoseCommand(index) => {
                self.world.commands.remove(index.into());
                Ok(!self.world.is_cut() && self.world.fault())
            }
            Step::Reply(motor) => self.reply(motor.into(), false),
            Step::ReplyTwice(motor) => Ok(self.world.fault() && self.reply(motor.into(), true)?),
            Step::LoseReply(motor) => {
                if let Some(index) = self.world.first_reply(motor.into()) {
                    self.world.lose_reply(index);
                }
                Ok(self.world.fault())
            }
            Step::LoseMaster(motor) => {
                self.world.lose_master(motor.into());
                Ok(!self.world.is_cut() && self.world.fault())
            }
            Step::Foreign => self.foreign(),
            Step::ForeignStop(kind, is_heard) => self.foreign_stop(kind, is_heard),
            Step::TakeAndEcho => {
                let packet = self.master.clone().poll_transmit(self.world.now);
                let is_taken = self.world.fault() && self.take(None)?;
                packet.filter(|_| is_taken).map_or(Ok(()), |packet| self.receive(packet))?;
                Ok(is_taken)
            }
            Step::Tick => Ok(self.pass(self.world.now + Duration::from_millis(1))),
            Step::Sleep => {
                let at = self.master.poll_at();
                let tick = self.world.now + Duration::from_millis(1);
                Ok(at.is_some_and(|at| at > tick && self.pass(at)))
            }
        }
    }

    fn pass(&mut self, until: Instant) -> bool {
        self.world.pass(until)
    }

    /// The bus takes the offered packet, and may hand another frame back for it.
    fn take(&mut self, for_another: Option<usize>) -> Result<bool, Broken> {
        let now = self.world.now;
        if for_another.is_none() && !self.world.has_room() {
            return Ok(false);
        }
        let Some(packet) = self.master.poll_transmit(now) else { return Ok(false) };
        let call = self.check_offered(&packet)?;
        if let Some(index) = for_another {
            let other = self.world.commands[index];
            if urgency(&packet) >= urgency(&other.packet) {
                return Ok(false);
            }
            self.world.commands.remove(index);
            self.note_sent(&other.packet, other.call, false);
            self.master.handle_transmitted(now);
            self.master.handle_pushed_out(&other.packet);
        } else {
            self.master.handle_transmitted(now);
        }
        self.note_sent(&packet, call, true);
        // After a fault the master may not see the end of an exchange.
        if !self.world.send(packet, call) && !self.world.had_fault {
            return Err("a command meets an answer on the line".into());
        }
        Ok(true)
    }

    fn note_sent(&mut self, packet: &Packet, call: u8, is_sent: bool) {
        if let Some(kind) = world::kind_of_stop(packet) {
            for (index, truth) in self.world.truth.iter_mut().enumerate() {
                let is_to_it = motor_of(packet).is_none_or(|motor| motor == motor_at(index));
                if is_to_it && truth.wants == Some(kind) {
                    truth.is_wanted_sent = is_sent;
                }
            }
        }
        let Some(truth) = motor_of(packet).and_then(|motor| self.world.truth_of(motor)) else {
            return;
        };
        let is_callers = truth.open.is_some_and(|open| open.data == packet.data);
        if let Some(kind) = world::kind_of_stop(packet).filter(|_| is_sent && !is_callers) {
            truth.stop_taken = Some((call, kind));
        }
        if !moves(packet) {
            return;
        }
        let bit = 1 << call;
        let sent = match packet.channel {
            Channel::Command(_) if packet.data[0] == 0xA8 => &mut truth.moves_sent,
            _ => &mut truth.set_points_sent,
        };
        if is_sent { *sent |= bit } else { *sent &= !bit }
    }

    fn hear(&mut self, index: usize, times: u8) -> bool {
        match self.world.may_leave(index) {
            // Overtaking counts as a fault.
            Some(true) if index > 0 && !self.world.fault() => false,
            Some(true) => {
                self.world.hear(index, times);
                true
            }
            _ => false,
        }
    }

    /// A motor's first reply comes when it is ready.
    pub(super) fn reply(&mut self, motor: usize, again: bool) -> Result<bool, Broken> {
        let Some(index) = self.world.first_reply(motor) else { return Ok(false) };
        let at = self.world.ready_at(index).max(self.world.now);
        if !self.world.pass(at) {
            return Ok(false);
        }
        let packet = self.world.take_reply(index, again);
        self.receive(packet)?;
        Ok(true)
    }

    pub(super) fn receive(&mut self, packet: Packet) -> Result<(), Broken> {
        let now = self.world.now;
        let event = if self.world.medium == Medium::Line {
            let frame = rs485::Frame::from_packet(&packet).expect("no motion mode on a line");
            self.master.handle_line(&frame, now)
        } else {
            self.master.handle_frame(&Received::Packet(packet), now)
        };
        match event {
            Some(event) => self.told(&event),
            None => Ok(()),
        }
    }

    fn poll_events(&mut self) -> Result<(), Broken> {
        while let Some(event) = self.master.poll_event() {
            self.told(&event)?;
        }
        Ok(())
    }
}

impl<const N: usize> fmt::Debug for State<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}\n{:?}\n{:?}", self.steps, self.world, self.master)
    }
}

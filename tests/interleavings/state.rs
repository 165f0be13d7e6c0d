//! One state: the engine and its world, what can happen next, and what must hold whatever does.

use std::fmt;

use myactuator_protocol_core::master::{Event, Master, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::Received;
use myactuator_protocol_core::wire::rs485;
use myactuator_protocol_core::{Channel, Data, MotorId, Packet};

use super::callers::Call;
use super::canonical;
use super::world::{self, Medium, Open, World, call_of, motor_at, motor_of, moves, urgency};

/// What must hold and did not.
pub(crate) type Broken = String;

/// What happens next. The numbers are indices of motors or of frames on their way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    Call(Call),
    /// The same, before the caller has taken the events that wait.
    CallBeforeEvents(Call),
    /// The bus takes what the master offers. Until then it is refused.
    Take,
    /// It takes it and hands this frame back, which is less urgent.
    TakeForAnother(u8),
    /// The drives hear a command; not the first in the row, if it is more urgent than those before.
    Hear(u8),
    HearTwice(u8),
    LoseCommand(u8),
    /// A motor's first reply comes.
    Reply(u8),
    ReplyTwice(u8),
    LoseReply(u8),
    LoseMaster(u8),
    /// Somebody else's answers come: from a motor of ours, and from one of theirs.
    Foreign,
    /// On a line: it takes what the master offers, and nobody hears it.
    TakeAndLose,
    /// The bus is cut: what is on its way to the drives stays there.
    Cut,
    Mend,
    /// A millisecond passes.
    Tick,
    /// The time comes that `poll_at` gave.
    Sleep,
}

/// One state.
#[derive(Clone)]
pub(crate) struct State<const N: usize> {
    pub(super) master: Master<N>,
    pub(crate) world: World,
    /// So many calls may still be made.
    pub(super) calls_left: u8,
    /// How it came to be.
    pub(crate) steps: Vec<Step>,
}

/// The longest that anything may take in a world that is well: a stop that was overtaken, and before it
/// requests that wait for late replies.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// And in so many steps.
const MOST_STEPS: usize = 300;

impl<const N: usize> State<N> {
    pub(crate) fn new(medium: Medium, calls: u8, faults: u8) -> Self {
        let mut master = Master::new(world::config(medium));
        master.handle_timeout(world::START);
        let world = World::new(medium, N, faults);
        Self { master, world, calls_left: calls, steps: Vec::new() }
    }

    pub(crate) fn number(&self) -> u64 {
        canonical::number(&self.master, &self.world)
    }

    /// All that may happen next; some of it turns out not to be possible.
    pub(crate) fn possible(&self, calls: &[Call]) -> Vec<Step> {
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
            Medium::Line if may_fail => steps.push(Step::TakeAndLose),
            Medium::Line => {}
            Medium::Can => steps.push(Step::Foreign),
            Medium::CanThatIsCut => steps.extend([Step::Foreign, Step::Cut, Step::Mend]),
        }
        steps
    }

    /// Lets this happen. `Ok(false)`: it cannot.
    pub(crate) fn step(&mut self, step: Step) -> Result<bool, Broken> {
        self.steps.push(step);
        if let Step::CallBeforeEvents(call) = step {
            return Ok(self.call(call));
        }
        // A caller may make a call before it takes an event, but takes it soon.
        self.poll_events()?;
        if let Step::Call(call) = step {
            return Ok(self.call(call));
        }
        self.master.handle_timeout(self.world.now);
        self.poll_events()?;
        let is_done = self.of_bus(step)?;
        // Whoever has received looks at the time, too.
        self.master.handle_timeout(self.world.now);
        Ok(is_done)
    }

    /// Lets this happen on the bus.
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
            Step::Foreign => {
                self.foreign()?;
                Ok(!self.world.is_cut())
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

    /// The bus takes what is offered, and hands another frame back for it.
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
        // After a fault the end of an exchange may not be seen.
        if !self.world.send(packet, call) && !self.world.had_fault {
            return Err("a command meets an answer on the line".into());
        }
        Ok(true)
    }

    /// What the master offers must not be older than a stop, nor than a newer set-point, and must not
    /// move a motor that is stopped. Gives the call that it is of.
    fn check_offered(&mut self, packet: &Packet) -> Result<u8, Broken> {
        let call = call_of(packet);
        self.check_kind_of_stop(packet)?;
        let stops_all = self.world.stops_all;
        let Some(truth) = motor_of(packet).and_then(|motor| self.world.truth_of(motor)) else {
            let is_wrong = |truth: &world::Truth| truth.is_stopped || call < truth.last_stop;
            let is_stopped = stops_all || self.world.truth.iter().any(is_wrong);
            if moves(packet) && is_stopped {
                return Err("all are moved, and one is stopped".into());
            }
            let is_of_stop_all = world::stops(packet) && call == 0;
            return Ok(if is_of_stop_all { self.world.stop_all_call } else { call });
        };
        if moves(packet) {
            if stops_all || truth.is_stopped {
                return Err("a stopped motor is moved".into());
            }
            if call < truth.last_stop {
                return Err("motion is sent that is older than a stop".into());
            }
            let bit = 1 << call;
            if packet.data[0] == 0xA8 && truth.moves_sent & bit != 0 {
                return Err("a relative move is sent twice".into());
            }
            if truth.set_points_sent >= bit && packet.data[0] != 0xA8 {
                return Err("a set-point is sent after itself or a newer one".into());
            }
        }
        Ok(if world::stops(packet) && call == 0 { truth.call_of_stop() } else { call })
    }

    /// No older hold switches on whom something newer has switched off, and no older Shutdown lets go whom something
    /// newer holds.
    fn check_kind_of_stop(&self, packet: &Packet) -> Result<(), Broken> {
        let Some(kind) = world::kind_of_stop(packet) else { return Ok(()) };
        let mut of = self.world.truth.iter().enumerate();
        let is_undone = of.any(|(index, truth)| {
            let is_to_it = motor_of(packet).is_none_or(|motor| motor == motor_at(index));
            is_to_it && truth.is_wanted_sent && truth.wants.is_some_and(|wanted| wanted != kind)
        });
        if is_undone { Err(format!("an older {kind:?} undoes a newer one")) } else { Ok(()) }
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
            // To be overtaken is a fault of its own.
            Some(true) if index > 0 && !self.world.fault() => false,
            Some(true) => {
                self.world.hear(index, times);
                true
            }
            _ => false,
        }
    }

    /// A motor's first reply comes when it is ready.
    fn reply(&mut self, motor: usize, again: bool) -> Result<bool, Broken> {
        let Some(index) = self.world.first_reply(motor) else { return Ok(false) };
        let at = self.world.ready_at(index).max(self.world.now);
        if !self.world.pass(at) {
            return Ok(false);
        }
        let packet = self.world.take_reply(index, again);
        self.receive(packet)?;
        Ok(true)
    }

    fn receive(&mut self, packet: Packet) -> Result<(), Broken> {
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

    fn foreign(&mut self) -> Result<(), Broken> {
        let of = |motor, byte| Packet {
            channel: Channel::Reply(motor),
            data: [byte, 1, 0, 0, 0xEE, 0, 0, 0],
        };
        self.receive(of(motor_at(0), 0x60))?;
        self.receive(of(motor_at(2), 0x92))
    }

    fn poll_events(&mut self) -> Result<(), Broken> {
        while let Some(event) = self.master.poll_event() {
            self.told(&event)?;
        }
        Ok(())
    }

    /// Each event must be true.
    fn told(&mut self, event: &Event) -> Result<(), Broken> {
        match *event {
            Event::Reply { ticket, data, .. } => {
                let motor = ticket.motor();
                let open = self.close(motor, |open| open.ticket == ticket)?;
                self.check_answer(&open.data, &data)?;
                match data[0] {
                    0x80 => self.check_heard(motor, call_of_data(&open.data)),
                    _ => Ok(()),
                }
            }
            Event::Sent { ticket, .. } | Event::Failed { ticket, .. } => {
                self.close(ticket.motor(), |open| open.ticket == ticket).map(|_| ())
            }
            Event::BroadcastReply { reply, .. } => {
                let Some(call) = self.world.broadcast else {
                    return Err("a broadcast that is over is answered".into());
                };
                let data = reply.encode();
                // The answer to what stops has no values, and feedback is a stream's as well.
                let is_any =
                    matches!(data[0], 0x80 | 0x81 | 0xA1) || self.world.is_doubled(data[0]);
                let is_its = is_any || self.world.was_cut || call_of_data(&data) == call;
                if is_its { Ok(()) } else { Err("a broadcast is given another's answer".into()) }
            }
            Event::BroadcastDone { .. } => match self.world.broadcast.take() {
                Some(_) => Ok(()),
                None => Err("a broadcast is over twice".into()),
            },
            Event::StopConfirmed { motor } => self.check_confirmed(motor),
            Event::StopUnconfirmed { .. } => Err("a stop is not confirmed".into()),
            _ => Ok(()),
        }
    }

    fn close(&mut self, motor: MotorId, is_it: impl Fn(&Open) -> bool) -> Result<Open, Broken> {
        let open = self.world.truth_of(motor).and_then(|truth| truth.open.take());
        open.filter(is_it).ok_or_else(|| "an outcome of a request that is not open".into())
    }

    fn check_answer(&self, asked: &Data, answer: &Data) -> Result<(), Broken> {
        let byte = answer[0];
        let may_be_older = self.world.is_doubled(byte) || self.world.was_cut;
        if call_of_data(asked) != call_of_data(answer) && !may_be_older {
            return Err("a request is given another's answer".into());
        }
        let may_be_untold = self.world.lost_master_untold || self.world.is_doubled(byte);
        if !World::says_done(answer) && !may_be_untold {
            return Err("the echo of an ignored command is given as its answer".into());
        }
        Ok(())
    }

    fn check_confirmed(&mut self, motor: MotorId) -> Result<(), Broken> {
        let Some(truth) = self.world.truth_of(motor) else { return Ok(()) };
        let stop = truth.call_of_stop();
        let taken = truth.stop_taken.take();
        if !std::mem::take(&mut truth.is_stopping) && std::mem::take(&mut truth.all_call) == 0 {
            return Err("a stop is confirmed that nobody waits for".into());
        }
        self.check_heard(motor, stop)?;
        match taken {
            // A hold of all that waits is not what is confirmed.
            Some((_, StopKind::Off)) => Ok(()),
            _ => self.check_held(motor),
        }
    }

    /// The drive must have heard this stop after the last motion that is older.
    fn check_heard(&self, motor: MotorId, stop: u8) -> Result<(), Broken> {
        let Some(truth) = self.world.truth.get(motor.index()) else { return Ok(()) };
        let heard = truth.stop_heard;
        let is_older = |frame: &world::Frame| {
            let is_to_it = motor_of(&frame.packet).is_none_or(|to| to == motor);
            moves(&frame.packet) && is_to_it && frame.call < stop
        };
        let is_stop_doubled = self.world.is_stop_doubled();
        if heard < stop && !is_stop_doubled && !self.world.was_cut {
            return Err("a stop is confirmed, and not heard".into());
        }
        if !is_stop_doubled && self.world.commands.iter().any(is_older) {
            return Err("a stop is confirmed, and older motion is still to come".into());
        }
        Ok(())
    }

    /// Who is to be held and has confirmed it is let go by nothing that is older.
    fn check_held(&self, motor: MotorId) -> Result<(), Broken> {
        let Some(truth) = self.world.truth.get(motor.index()) else { return Ok(()) };
        let lets_go = |frame: &world::Frame| {
            let is_to_it = motor_of(&frame.packet).is_none_or(|to| to == motor);
            is_to_it && world::kind_of_stop(&frame.packet) == Some(StopKind::Off)
        };
        if truth.wants == Some(StopKind::Hold) && self.world.commands.iter().any(lets_go) {
            return Err("a hold is confirmed, and a Shutdown is still to come".into());
        }
        Ok(())
    }

    /// Whether `poll_at` is true.
    pub(crate) fn check_poll_at(&self) -> Result<(), Broken> {
        check_poll_at(&self.master, self.world.now)
    }

    /// In a world that is well from now on everything must come to its end.
    pub(crate) fn check_end(&self) -> Result<(), Broken> {
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

    fn check_over(&self, since: Instant) -> Result<(), Broken> {
        if self.world.now - since > LONGEST_WAIT {
            return Err("it takes too long".into());
        }
        if self.world.broadcast.is_some() {
            return Err("a broadcast hangs".into());
        }
        if self.master.is_anything_in_flight() {
            return Err("something is in flight for ever".into());
        }
        for truth in &self.world.truth {
            if truth.open.is_some() {
                return Err("a request hangs".into());
            }
            if truth.is_stopping {
                return Err("a stop hangs".into());
            }
            let is_heard = truth.stop_heard >= truth.stop_call || self.world.is_stop_doubled();
            if truth.is_stopped && !is_heard {
                return Err("a stopped motor moves".into());
            }
            let is_other =
                truth.heard.is_some_and(|heard| truth.wants.is_some_and(|it| it != heard));
            if truth.is_stopped && truth.last_stop == truth.stop_call && is_other {
                return Err("a motor is off and was to be held, or the other way round".into());
            }
        }
        Ok(())
    }
}

fn call_of_data(data: &Data) -> u8 {
    data[4]
}

/// Whether `poll_at` is true: not now when there is nothing to do, and nothing to do before it.
pub(crate) fn check_poll_at<const N: usize>(
    master: &Master<N>,
    now: Instant,
) -> Result<(), Broken> {
    let mut master = master.clone();
    master.handle_timeout(now);
    while master.poll_event().is_some() {}
    if master.poll_transmit(now).is_some() {
        return Ok(());
    }
    let at = master.poll_at();
    if at.is_some_and(|at| at <= now) {
        return Err("poll_at is not after now, and there is nothing to do".into());
    }
    let soon = now + Duration::from_millis(20);
    let before = at.unwrap_or(soon).min(soon).as_micros() - 1;
    let before = Instant::from_micros(before);
    master.handle_timeout(before);
    if master.poll_transmit(before).is_some() {
        return Err("something is sent before poll_at".into());
    }
    if master.poll_event().is_some() {
        return Err("something is told before poll_at".into());
    }
    Ok(())
}

impl<const N: usize> fmt::Debug for State<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}\n{:?}\n{:?}", self.steps, self.world, self.master)
    }
}

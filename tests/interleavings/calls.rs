//! Random calls, in any order and at any time, with frames that make sense and frames that do not. These properties
//! hold whatever callers and a bus do:
//!
//! - Nothing panics.
//! - While a motor is stopped, the master offers nothing that could move it.
//! - Each ticket ends exactly once, within a limited time after the last call.
//! - After a restart of a motor, nothing that moves it is offered before a caller resumes it.
//! - `poll_transmit` offers the same packet again until it is taken.
//! - Nothing happens on its own before `poll_at`.
//! - No more commands are counted as answered or lost than were sent.

use std::collections::HashSet;

use myactuator_protocol_core::command::{
    AbsolutePosition, IncrementalPosition, LockBrake, PidIndex, RawCommand, RawMotion,
    ReadMultiTurnAngle, ReadPid, ReadStatus1, ReadStatus2, ReleaseBrake, Reset, Shutdown, Speed,
    Torque,
};
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::master::{
    Bus, Config, Event, Master, MotorSet, Patience, StopKind, Ticket, TicketId,
};
use myactuator_protocol_core::opcode::{Opcode, ReplyRule};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::{Angle, Current, MaxSpeed, MaxTorque, SpeedTarget};
use myactuator_protocol_core::wire::can::Received;
use myactuator_protocol_core::wire::rs485::Frame;
use myactuator_protocol_core::{Channel, Command, Data, Kind, MotorId, Packet, Target};
use myactuator_tests::dice::any_data;
use proptest::prelude::*;

use super::longer::same_runs;
use super::oracle::check_poll_at;

/// Fewer places than motors.
const PLACES: usize = 3;
/// By then everything in flight is over: restarts, retries and late answers.
const LONGEST_END: Duration = Duration::from_secs(10);

#[derive(Clone, Copy, Debug)]
enum Asked {
    Angle,
    Pid(u8),
    Status,
    Move,
    Speed,
    Shutdown,
    Lock,
    Release,
    Reset,
    Raw { moves: bool },
}

#[derive(Clone, Copy, Debug)]
enum SetPoint {
    Torque,
    Position,
    Motion,
}

#[derive(Clone, Copy, Debug)]
enum Call {
    Request(MotorId, Asked),
    RequestWith(MotorId, Asked, u64, u8),
    SetPoint(MotorId, SetPoint),
    Broadcast(Asked, u8),
    Stop(MotorId, StopKind),
    StopAll(StopKind, u8),
    Lift,
    LiftOf(MotorId),
    Resume(MotorId),
    Forget(MotorId),
    BusDown,
    /// The bus takes what is offered.
    Take,
    /// It hands back one of the last packets that it took.
    HandBack(u8),
    /// It hands back a packet that it never took.
    HandBackAny(MotorId, Data),
    /// One of the last commands is answered.
    Answer(u8),
    LostMaster(MotorId),
    Receive(MotorId, bool, Data),
    Wait(u64),
    Sleep,
    PollEvents,
}

fn motor() -> impl Strategy<Value = MotorId> {
    prop::sample::select(vec![1, 2, 3, 4, 32]).prop_map(|id| MotorId::new(id).expect("1 to 32"))
}

fn asked() -> impl Strategy<Value = Asked> {
    prop_oneof![
        3 => Just(Asked::Angle),
        2 => (0_u8..3).prop_map(Asked::Pid),
        1 => Just(Asked::Status),
        2 => Just(Asked::Move),
        1 => Just(Asked::Speed),
        2 => Just(Asked::Shutdown),
        1 => Just(Asked::Lock),
        1 => Just(Asked::Release),
        1 => Just(Asked::Reset),
        1 => any::<bool>().prop_map(|moves| Asked::Raw { moves }),
    ]
}

fn call() -> impl Strategy<Value = Call> {
    let stop = prop::sample::select(vec![StopKind::Hold, StopKind::Off]);
    let set_point =
        prop::sample::select(vec![SetPoint::Torque, SetPoint::Position, SetPoint::Motion]);
    prop_oneof![
        6 => (motor(), asked()).prop_map(|(motor, asked)| Call::Request(motor, asked)),
        2 => (motor(), asked(), 0_u64..30_000, 0_u8..20)
            .prop_map(|(motor, asked, micros, times)| Call::RequestWith(motor, asked, micros, times)),
        6 => (motor(), set_point).prop_map(|(motor, kind)| Call::SetPoint(motor, kind)),
        2 => (asked(), 0_u8..16).prop_map(|(asked, expected)| Call::Broadcast(asked, expected)),
        2 => (motor(), stop.clone()).prop_map(|(motor, kind)| Call::Stop(motor, kind)),
        1 => (stop, 0_u8..16).prop_map(|(kind, also)| Call::StopAll(kind, also)),
        1 => Just(Call::Lift),
        1 => motor().prop_map(Call::LiftOf),
        1 => motor().prop_map(Call::Resume),
        1 => motor().prop_map(Call::Forget),
        1 => Just(Call::BusDown),
        16 => Just(Call::Take),
        2 => (0_u8..4).prop_map(Call::HandBack),
        1 => (motor(), any_data()).prop_map(|(motor, data)| Call::HandBackAny(motor, data)),
        12 => (0_u8..4).prop_map(Call::Answer),
        1 => motor().prop_map(Call::LostMaster),
        2 => (motor(), any::<bool>(), any_data())
            .prop_map(|(motor, is_motion, data)| Call::Receive(motor, is_motion, data)),
        6 => prop_oneof![3 => 0_u64..3_000, 2 => 0..60_000_u64, 1 => 0..4_000_000_u64]
            .prop_map(Call::Wait),
        4 => Just(Call::Sleep),
        4 => Just(Call::PollEvents),
    ]
}

/// The master, and what the test knows of it.
struct Model {
    master: Master<PLACES>,
    is_rs485: bool,
    now: Instant,
    open: HashSet<TicketId>,
    ended: HashSet<TicketId>,
    stops_all: bool,
    stopped: MotorSet,
    /// Motors whose restart was reported, and that no caller has resumed.
    restarted: MotorSet,
    /// The last packets that the bus took, newest first.
    sent: Vec<Packet>,
    /// The number of commands sent to each motor.
    asking: [u64; MotorId::COUNT],
}

fn set_of(bits: u8) -> MotorSet {
    let ids = [1, 2, 3, 32].into_iter().enumerate();
    let chosen = ids.filter(|(bit, _)| bits & 1 << bit != 0);
    chosen.filter_map(|(_, id)| MotorId::new(id).ok()).collect()
}

/// Whether a command may move a motor, by the manual.
fn moves(packet: &Packet) -> bool {
    const BYTES: [u8; 6] = [0xA1, 0xA2, 0xA4, 0xA6, 0xA8, 0xA9];
    matches!(packet.channel, Channel::Motion(_)) || BYTES.contains(&packet.data[0])
}

/// Whether a command may move a motor, let its load fall, or restart it.
fn is_dangerous(packet: &Packet) -> bool {
    moves(packet) || matches!(packet.data[0], 0x76 | 0x77)
}

impl Model {
    fn new(config: Config) -> Self {
        Self {
            is_rs485: matches!(config.bus, Bus::Rs485 { .. }),
            master: Master::new(config),
            now: Instant::ZERO,
            open: HashSet::new(),
            ended: HashSet::new(),
            stops_all: false,
            stopped: MotorSet::EMPTY,
            restarted: MotorSet::EMPTY,
            sent: Vec::new(),
            asking: [0; MotorId::COUNT],
        }
    }

    fn call(&mut self, call: Call) -> Result<(), TestCaseError> {
        match call {
            Call::Request(motor, asked) => self.ask(motor, asked, None)?,
            Call::RequestWith(motor, asked, micros, attempts) => {
                let reply_timeout = Duration::from_micros(micros);
                self.ask(motor, asked, Some(Patience { reply_timeout, attempts }))?;
            }
            Call::SetPoint(motor, kind) => self.set_point(motor, kind)?,
            Call::Broadcast(asked, expected) => self.broadcast(asked, set_of(expected)),
            Call::Stop(motor, kind) => {
                if self.master.stop(motor, kind).is_ok() {
                    self.stopped.insert(motor);
                }
            }
            Call::StopAll(kind, also) => {
                let _ = self.master.stop_all(kind, set_of(also));
                self.stops_all = true;
            }
            Call::Lift => {
                self.master.lift_stop();
                self.stops_all = false;
                self.stopped = MotorSet::EMPTY;
            }
            Call::LiftOf(motor) => {
                self.master.lift_stop_of(motor);
                self.stopped.remove(motor);
            }
            Call::Resume(motor) => {
                // A caller takes all events before it resumes a motor: one of them may report a restart.
                self.poll_events()?;
                self.master.resume(motor);
                self.restarted.remove(motor);
            }
            Call::Forget(motor) => self.forget(motor)?,
            Call::BusDown => self.master.handle_bus_down(self.now),
            Call::Take => self.take()?,
            Call::HandBack(index) => {
                if usize::from(index) < self.sent.len() {
                    let packet = self.sent.remove(index.into());
                    self.master.handle_pushed_out(&packet);
                }
            }
            Call::HandBackAny(motor, data) => {
                let channel = Channel::Command(Target::Motor(motor));
                self.master.handle_pushed_out(&Packet { channel, data });
            }
            Call::Answer(index) => {
                if let Some(reply) = self.sent.get(usize::from(index)).and_then(reply_to) {
                    self.receive(reply)?;
                }
            }
            Call::LostMaster(motor) => {
                let data = [0xF1, 0, 0, 0, 0, 0, 0, 0];
                self.receive(Packet { channel: Channel::Reply(motor), data })?;
            }
            Call::Receive(motor, is_motion, data) => {
                let of = if is_motion { Channel::MotionReply } else { Channel::Reply };
                self.receive(Packet { channel: of(motor), data })?;
            }
            Call::Wait(micros) => self.now += Duration::from_micros(micros),
            Call::Sleep => {
                if let Some(at) = self.master.poll_at() {
                    self.now = self.now.max(at);
                }
            }
            Call::PollEvents => self.poll_events()?,
        }
        self.check()
    }

    fn ask(
        &mut self,
        motor: MotorId,
        asked: Asked,
        patience: Option<Patience>,
    ) -> Result<(), TestCaseError> {
        match asked {
            Asked::Angle => self.put(motor, ReadMultiTurnAngle, patience),
            Asked::Pid(index) => {
                self.put(motor, ReadPid { index: PidIndex::from_raw(index) }, patience)
            }
            Asked::Status => self.put(motor, ReadStatus1, patience),
            Asked::Move => self.put(motor, step(), patience),
            Asked::Speed => self.put(motor, speed(), patience),
            Asked::Shutdown => self.put(motor, Shutdown, patience),
            Asked::Lock => self.put(motor, LockBrake, patience),
            Asked::Release => self.put(motor, ReleaseBrake, patience),
            Asked::Reset => self.put(motor, Reset, patience),
            Asked::Raw { moves } => self.put(motor, raw(moves), patience),
        }
    }

    fn put<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        patience: Option<Patience>,
    ) -> Result<(), TestCaseError> {
        let kind = command.kind();
        let asked: Result<Ticket<C>, RequestError> = match patience {
            Some(patience) => self.master.request_with(motor, command, patience),
            None => self.master.request(motor, command),
        };
        let is_stopped = self.stops_all || self.stopped.contains(motor);
        let may_be_put = !(is_stopped && kind.is_refused_while_stopped());
        match asked {
            Ok(ticket) => {
                prop_assert!(may_be_put, "{kind:?} is taken of a motor that is stopped");
                let id = ticket.id();
                let is_new = !self.ended.contains(&id) && self.open.insert(id);
                prop_assert!(is_new, "a ticket twice: {id:?}");
                let of_motor = self.open.iter().filter(|open| open.motor() == motor).count();
                prop_assert_eq!(of_motor, 1, "two requests of one motor");
            }
            Err(error) => {
                let is_refused = error == RequestError::Stopped;
                prop_assert_eq!(is_refused, !may_be_put, "{:?}: {:?}", kind, error);
            }
        }
        Ok(())
    }

    fn set_point(&mut self, motor: MotorId, kind: SetPoint) -> Result<(), TestCaseError> {
        let now = self.now;
        let put = match kind {
            SetPoint::Torque => {
                self.master.set_point(motor, Torque { current: Current::from_raw(1) }, now)
            }
            SetPoint::Position => {
                let (max_speed, angle) = (MaxSpeed::from_raw(1), Angle::from_raw(1));
                self.master.set_point(motor, AbsolutePosition { max_speed, angle }, now)
            }
            SetPoint::Motion => self.master.set_point(motor, RawMotion::decode(&[1; 8]), now),
        };
        let is_stopped = self.stops_all || self.stopped.contains(motor);
        prop_assert!(
            put.is_err() || !is_stopped,
            "a set-point is taken of a motor that is stopped"
        );
        Ok(())
    }

    fn broadcast(&mut self, asked: Asked, expected: MotorSet) {
        // Refused or not: the effect shows in what is offered.
        let _ = match asked {
            Asked::Angle => self.master.broadcast(ReadMultiTurnAngle, expected),
            Asked::Pid(index) => {
                self.master.broadcast(ReadPid { index: PidIndex::from_raw(index) }, expected)
            }
            Asked::Status => self.master.broadcast(ReadStatus2, expected),
            Asked::Move => self.master.broadcast(step(), expected),
            Asked::Speed => self.master.broadcast(speed(), expected),
            Asked::Shutdown => self.master.broadcast(Shutdown, expected),
            Asked::Lock => self.master.broadcast(LockBrake, expected),
            Asked::Release => self.master.broadcast(ReleaseBrake, expected),
            Asked::Reset => self.master.broadcast(Reset, expected),
            Asked::Raw { moves } => self.master.broadcast(raw(moves), expected),
        };
    }

    fn forget(&mut self, motor: MotorId) -> Result<(), TestCaseError> {
        let has_open = self.open.iter().any(|open| open.motor() == motor);
        if self.master.forget(motor) {
            prop_assert!(!has_open, "a motor is forgotten whose request is open");
            // It may still be among the silent motors of a command to all.
            self.restarted.remove(motor);
        }
        Ok(())
    }

    fn take(&mut self) -> Result<(), TestCaseError> {
        let offered = self.master.poll_transmit(self.now);
        prop_assert_eq!(self.master.poll_transmit(self.now), offered, "it is not offered again");
        let Some(packet) = offered else { return Ok(()) };
        let is_stopped = match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => {
                self.stops_all || self.stopped.contains(motor)
            }
            _ => self.stops_all || !self.stopped.is_empty(),
        };
        prop_assert!(!(is_stopped && is_dangerous(&packet)), "{packet:?} is offered while stopped");
        let has_restarted = match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => {
                self.restarted.contains(motor)
            }
            _ => !self.restarted.is_empty(),
        };
        prop_assert!(!(has_restarted && moves(&packet)), "{packet:?} is offered after a restart");
        self.master.handle_transmitted(self.now);
        match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => {
                self.asking[motor.index()] += 1;
            }
            _ => self.asking.iter_mut().for_each(|asking| *asking += 1),
        }
        self.sent.insert(0, packet);
        self.sent.truncate(4);
        Ok(())
    }

    fn receive(&mut self, packet: Packet) -> Result<(), TestCaseError> {
        let event = if self.is_rs485 {
            let Some(frame) = Frame::from_packet(&packet) else { return Ok(()) };
            self.master.handle_line(&frame, self.now)
        } else {
            self.master.handle_frame(&Received::Packet(packet), self.now)
        };
        event.map_or(Ok(()), |event| self.told(&event))
    }

    fn poll_events(&mut self) -> Result<(), TestCaseError> {
        self.master.handle_timeout(self.now);
        // A few for each motor.
        for _ in 0..100 {
            match self.master.poll_event() {
                Some(event) => self.told(&event)?,
                None => return Ok(()),
            }
        }
        Err(TestCaseError::fail("events without end"))
    }

    fn told(&mut self, event: &Event) -> Result<(), TestCaseError> {
        if let Event::Reply { ticket, .. }
        | Event::Sent { ticket, .. }
        | Event::Failed { ticket, .. } = *event
        {
            prop_assert!(self.open.remove(&ticket), "{event:?} of a ticket that is not open");
            self.ended.insert(ticket);
        }
        if let Event::Restarted { motor } = *event {
            self.restarted.insert(motor);
        }
        Ok(())
    }

    fn check(&self) -> Result<(), TestCaseError> {
        check_poll_at(&self.master, self.now).map_err(TestCaseError::fail)?;
        for motor in self.master.motors().iter() {
            let health = self.master.health(motor);
            let told = u64::from(health.answered) + u64::from(health.lost);
            let asking = self.asking[motor.index()];
            prop_assert!(
                told <= asking,
                "{told} of {asking} commands of motor {motor} came to an end"
            );
        }
        Ok(())
    }

    /// Lifts all stops and lets nothing answer any more: everything must end.
    fn end(&mut self) -> Result<(), TestCaseError> {
        self.master.lift_stop();
        let end = self.now + LONGEST_END;
        for _ in 0..3_000 {
            self.poll_events()?;
            if self.master.poll_transmit(self.now).is_some() {
                self.take()?;
                continue;
            }
            match self.master.poll_at() {
                Some(at) if at > end => break,
                Some(at) => self.now = self.now.max(at),
                None => break,
            }
        }
        prop_assert!(self.open.is_empty(), "{:?} never end", self.open);
        prop_assert!(!self.master.is_anything_in_flight(), "something is in flight for ever");
        Ok(())
    }
}

const fn step() -> IncrementalPosition {
    IncrementalPosition { max_speed: MaxSpeed::from_raw(1), angle: Angle::from_raw(1) }
}

const fn speed() -> Speed {
    Speed { max_torque: MaxTorque::from_raw(1), speed: SpeedTarget::from_raw(1) }
}

/// A command that no firmware here knows.
const fn raw(moves: bool) -> RawCommand {
    RawCommand::new([0x71, 0, 0, 0, 0, 0, 0, 0], ReplyRule::Values, moves)
}

/// The reply of a drive.
fn reply_to(command: &Packet) -> Option<Packet> {
    let channel = match command.channel {
        Channel::Command(Target::Motor(motor)) => Channel::Reply(motor),
        Channel::Command(Target::All) => Channel::Reply(MotorId::MIN),
        Channel::Motion(motor) => Channel::MotionReply(motor),
        _ => return None,
    };
    let opcode = Opcode::from_byte(command.data[0]);
    let kind = opcode.map(Kind::Known).filter(|_| !matches!(channel, Channel::MotionReply(_)));
    kind.is_none_or(Kind::has_reply).then_some(Packet { channel, data: command.data })
}

fn run(config: Config, calls: &[Call]) -> Result<(), TestCaseError> {
    let mut model = run_for_now(config, calls)?;
    model.end()
}

fn run_for_now(config: Config, calls: &[Call]) -> Result<Model, TestCaseError> {
    let mut model = Model::new(config);
    for &call in calls {
        model.call(call)?;
    }
    Ok(model)
}

/// The configuration with all times replaced by this one.
fn of_one_time(config: Config, time: Duration) -> Config {
    let bus = match config.bus {
        Bus::Can => Bus::Can,
        Bus::Rs485 { echo, .. } => Bus::Rs485 { turnaround: time, echo },
    };
    Config {
        bus,
        reply_timeout: time,
        longest_reply_timeout: time,
        frame_time: time,
        shortest_response: time,
        longest_response: time,
        late_window: time,
        set_point_max_age: time,
        restart_time: time,
        settle_time: time,
        attempts: u8::MAX,
        ..config
    }
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    prop::collection::vec(call(), 1..200)
}

proptest! {
    #![proptest_config(same_runs())]

    #[test]
    fn any_calls_on_can(calls in calls()) {
        run(Config::CAN, &calls)?;
    }

    #[test]
    fn any_calls_on_rs485(calls in calls()) {
        run(Config::rs485(1_000_000, false), &calls)?;
    }

    #[test]
    fn any_calls_with_time_outs_that_adapt(calls in calls(), longest in 0_u64..100_000) {
        let longest = Duration::from_micros(longest);
        let can = Config { reply_timeout: Duration::from_millis(2), ..Config::CAN };
        run(can.adapting_up_to(longest), &calls)?;
        run(Config::rs485(1_000_000, false).adapting_up_to(longest), &calls)?;
    }

    #[test]
    fn any_calls_with_times_of_a_moment_and_of_years(calls in calls()) {
        for config in [Config::CAN, Config::rs485(1_000_000, false)] {
            run(of_one_time(config, Duration::from_micros(1)), &calls)?;
            run_for_now(of_one_time(config, Duration::from_secs(1 << 30)), &calls)?;
        }
    }
}

//! What happens in each cycle.

mod button;
mod locks;
mod motor;
mod path;
mod rounds;
mod script;
mod setup;
mod state;

use heapless::Vec;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::AnyReply;
use myactuator_protocol_core::master::{Event, Master, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};

use self::button::{Button, Press};
use self::locks::Locks;
use self::motor::Motor;
use self::rounds::Rounds;
use self::script::{Answer, Script, Step};
pub use self::setup::{Movement, Setup};
use self::state::State;
use crate::board::{Board, RestartCause, Usage};
use crate::report::{Report, Trouble};

/// How long a stop is waited for before whoever has not confirmed it is reported, and all are told to stop once
/// more. It is shorter than a protection: on RS485 the stops to motors that do not answer leave room for
/// nothing else that the others could hear.
const LONGEST_STOP: Duration = Duration::from_millis(400);
/// How often a stop is repeated for motors that have not confirmed it: they may come back, still moving. Shorter
/// than a protection, too.
const STOP_AGAIN: Duration = Duration::from_millis(400);
/// A running motor that was not heard for so long has gone.
const SILENT_AFTER: Duration = Duration::from_millis(100);
/// While a line waits for the answer of a motor that has gone, nobody else is asked. If none at all was heard for
/// longer than that by this much, it is the bus that has gone.
const ROUND: Duration = Duration::from_millis(10);
/// The watchdog is fed only as long as each running motor was heard within this time.
const SEEN_WITHIN: Duration = Duration::from_millis(50);
const SECOND: Duration = Duration::from_secs(1);
/// Whoever presses the button so soon after the motors were stopped by something else meant to stop them.
const STOPPED_BY_ITSELF: Duration = Duration::from_secs(1);

/// What the application works with at one moment.
#[derive(Debug)]
pub struct Moment<'a, const N: usize, B> {
    /// Takes commands.
    pub master: &'a mut Master<N>,
    /// The time.
    pub now: Instant,
    /// The board.
    pub board: &'a mut B,
}

/// The application of a bus with up to `N` motors: told every event and the beginning of every cycle,
/// it says to the [`Master`] what is to be done.
#[derive(Debug)]
pub struct App<const N: usize> {
    setup: Setup,
    state: State,
    motors: Vec<Motor, N>,
    /// Those that are missed when they do not answer: the required ones, and whoever has answered anything
    /// since the start.
    expected: MotorSet,
    locks: Locks,
    /// Those whose errors were told since the button was pressed.
    failed: MotorSet,
    /// Those whose brakes were told to lock by a shutdown that was broken off, and that nobody has looked at since.
    unseen: MotorSet,
    /// From when on it shows whether their shafts stand.
    shows_at: Instant,
    rounds: Rounds,
    button: Button,
    /// A press that begins before this does not start the motors.
    may_start_at: Instant,
    /// Whether the press under way may.
    may_start: bool,
    next_cycle: Instant,
}

impl<const N: usize> App<N> {
    /// Begins with a stop to all motors that may be there, whatever the cause of the start: they may
    /// have gone on while nobody watched.
    pub fn start(setup: Setup, cause: RestartCause, at: &mut Moment<'_, N, impl Board>) -> Self {
        at.board.log(&Report::Started { cause });
        let mut app = Self {
            setup,
            state: State::Stopped { kind: setup.stop, unconfirmed: MotorSet::EMPTY, again: at.now },
            motors: Vec::new(),
            expected: setup.required,
            locks: Locks::new(),
            failed: MotorSet::EMPTY,
            unseen: MotorSet::EMPTY,
            shows_at: at.now,
            rounds: Rounds::new(at.now),
            button: Button::new(),
            // Who restarts by itself was running, perhaps, and stops.
            may_start_at: match cause {
                RestartCause::Power => at.now,
                _ => at.now + STOPPED_BY_ITSELF,
            },
            may_start: false,
            next_cycle: at.now,
        };
        app.stop(setup.stop, at);
        app
    }

    /// When the next cycle is to [begin](Self::begin_cycle).
    pub const fn next_cycle(&self) -> Instant {
        self.next_cycle
    }

    /// Takes note of an event. Call it with each as soon as it comes.
    pub fn handle_event(&mut self, event: &Event, at: &mut Moment<'_, N, impl Board>) {
        match *event {
            Event::StopConfirmed { motor } => self.stop_is_over(motor, true),
            Event::StopUnconfirmed { motor } => self.stop_is_over(motor, false),
            Event::Feedback { motor, reply } => {
                let ranges = match self.setup.movement {
                    Movement::Motion { ranges, .. } => Some(ranges),
                    Movement::Position { .. } => None,
                };
                if let Some(motor) = self.motor(motor) {
                    motor.feedback(&reply, ranges, at.now);
                }
            }
            Event::Report { motor, reply: AnyReply::ReadStatus1(status) }
                if !status.errors.is_empty() =>
            {
                self.trouble(Trouble::Errors { motor, flags: status.errors }, at);
            }
            Event::Restarted { motor } => {
                // Those that are moved are stopped by this; others get no set-points before they were found.
                at.master.resume(motor);
                if self.motor(motor).is_some() {
                    self.trouble(Trouble::Restarted { motor }, at);
                }
            }
            Event::LostMaster { motor } if self.motor(motor).is_some() => {
                self.trouble(Trouble::LostMaster { motor }, at);
            }
            _ => self.handle_answer(event, at),
        }
    }

    /// The bus driver reports an error.
    pub fn handle_bus_error(&mut self, at: &mut Moment<'_, N, impl Board>) {
        self.trouble(Trouble::BusDown, at);
    }

    /// Begins a cycle: [`next_cycle`](Self::next_cycle) is over.
    pub fn begin_cycle(&mut self, at: &mut Moment<'_, N, impl Board>) {
        let is_late = at.now > self.next_cycle + half(self.setup.cycle);
        self.next_cycle = if is_late { at.now } else { self.next_cycle } + self.setup.cycle;

        match self.button.look(at.board.is_button_down(), at.now) {
            Some(press) => self.pressed(press, at),
            None => self.go_on(is_late, at),
        }

        at.board.set_light(self.is_light_on(at.now));
        let sees_its_motors = !self.is_running() || self.longest_silence(at.now).1 <= SEEN_WITHIN;
        if !is_late && sees_its_motors {
            at.board.feed_watchdog();
        }
    }

    fn pressed(&mut self, press: Press, at: &mut Moment<'_, N, impl Board>) {
        match (&self.state, press) {
            (State::Stopped { .. }, Press::Down) => self.may_start = at.now >= self.may_start_at,
            (State::Stopped { .. }, Press::Short) if !self.may_start => {}
            (State::Stopped { .. }, Press::Short) => {
                for motor in &self.motors {
                    at.master.forget(motor.id);
                }
                self.motors.clear();
                self.failed = MotorSet::EMPTY;
                let all = self.known();
                self.enter(State::Finding(Script::find(all, at.now)), at);
            }
            (State::Stopped { .. }, Press::Long) => {
                self.failed = MotorSet::EMPTY;
                self.unseen = MotorSet::EMPTY;
                let script = Script::shut_down(self.expected, at.now);
                self.enter(State::ShuttingDown { script, turning: MotorSet::EMPTY }, at);
            }
            // The press that stops, or comes while motors are being stopped, is used up: letting go does
            // not start anything.
            _ => {
                self.button.use_up();
                self.trouble(Trouble::Button, at);
            }
        }
    }

    fn go_on(&mut self, is_late: bool, at: &mut Moment<'_, N, impl Board>) {
        // Before anything else is asked.
        self.locks.ask(&self.setup, at.master);
        match &mut self.state {
            State::Stopping { kind, waiting, unconfirmed, until } => {
                let (kind, unconfirmed) = (*kind, waiting.with(*unconfirmed));
                let is_over = waiting.is_empty() || at.now >= *until;
                // Who has not confirmed it by then is not waited for: a load may fall.
                let is_looking =
                    (is_over || at.now >= self.shows_at) && self.look(kind, unconfirmed, at);
                if is_over && !is_looking {
                    self.tell_stopped(kind, unconfirmed, at);
                }
            }
            State::Stopped { kind, unconfirmed, again } => {
                let (kind, unconfirmed) = (*kind, *unconfirmed);
                if !unconfirmed.is_empty() && at.now >= *again {
                    *again = at.now + STOP_AGAIN;
                    // Those that the master has no place for stay unconfirmed.
                    let _ = at.master.stop_all(kind, unconfirmed);
                }
                self.look(kind, unconfirmed, at);
            }
            State::Finding(script)
            | State::Preparing(script)
            | State::ShuttingDown { script, .. }
            | State::Looking { script, .. } => match script.go_on(&self.setup, at.master, at.now) {
                Step::Waiting => {}
                Step::Refused(motor) => self.trouble(Trouble::Refused { motor }, at),
                Step::Over => self.script_is_over(at),
            },
            State::Running { cycles, overruns, .. } => {
                *cycles = cycles.saturating_add(1);
                *overruns = overruns.saturating_add(is_late.into());
                self.control(at);
            }
        }
        // In every state, and also to those whose firmware nobody has asked for yet: a motor that hears
        // nothing lets go.
        self.rounds.ask(self.attended(), &self.setup, at.master, at.now);
    }

    /// Looks at the shafts of those that have confirmed their stop, and that nobody has looked at since a shutdown was
    /// broken off, however late that is: until then a load may fall. Whether there are any.
    fn look(
        &mut self,
        kind: StopKind,
        unconfirmed: MotorSet,
        at: &mut Moment<'_, N, impl Board>,
    ) -> bool {
        let motors = self.unseen.without(unconfirmed);
        if motors.is_empty() {
            return false;
        }
        self.unseen = self.unseen.without(motors);
        let (script, turning) = (Script::look(motors, self.shows_at), MotorSet::EMPTY);
        self.enter(State::Looking { script, turning, kind, unconfirmed }, at);
        true
    }

    fn tell_stopped(
        &mut self,
        kind: StopKind,
        unconfirmed: MotorSet,
        at: &mut Moment<'_, N, impl Board>,
    ) {
        let unheard = unconfirmed.without(self.expected);
        if !unheard.is_empty() {
            at.board.log(&Report::Unheard { motors: unheard });
        }
        at.board.log(&Report::Stopped { unconfirmed: unconfirmed.without(unheard) });
        // The unheard get their stop again, too: one whose replies are lost may hear it.
        self.enter(State::Stopped { kind, unconfirmed, again: at.now }, at);
    }

    fn script_is_over(&mut self, at: &mut Moment<'_, N, impl Board>) {
        let found = self.found();
        match &mut self.state {
            State::Finding(_) if found.is_empty() => {
                self.trouble(Trouble::NoMotor, at);
            }
            State::Finding(_) => {
                // Nothing moves yet; but opening a brake is refused while a stop is in force.
                at.master.lift_stop();
                self.enter(State::Preparing(Script::prepare(found, at.now)), at);
            }
            State::ShuttingDown { script, turning } | State::Looking { script, turning, .. } => {
                let is_any_turning = !turning.is_empty();
                match script.next_of_shutting_down(self.expected, *turning, at.now) {
                    Some(next) => {
                        *script = next;
                        if is_any_turning {
                            // As above: brakes are to open.
                            at.master.lift_stop();
                        }
                    }
                    None if is_any_turning => self.stop(StopKind::Hold, at),
                    None => {
                        let kind = match self.state {
                            State::Looking { kind, .. } => kind,
                            _ => StopKind::Off,
                        };
                        self.stop(kind, at);
                    }
                }
            }
            State::Preparing(script) => {
                match script.next_of_preparing(&self.setup, found, at.now) {
                    Some(next) => self.state = State::Preparing(next),
                    None => {
                        for motor in &mut self.motors {
                            motor.begin(at.master.health(motor.id), at.now);
                        }
                        // All hold, their brakes open.
                        self.unseen = MotorSet::EMPTY;
                        let (since, next_second) = (at.now, at.now + SECOND);
                        let running = State::Running { since, cycles: 0, overruns: 0, next_second };
                        self.enter(running, at);
                    }
                }
            }
            _ => {}
        }
    }

    /// One cycle of motion.
    fn control(&mut self, at: &mut Moment<'_, N, impl Board>) {
        if let (Some(motor), silence) = self.longest_silence(at.now)
            && silence > SILENT_AFTER
        {
            return self.trouble(self.silent(motor, at), at);
        }
        let State::Running { since, next_second, .. } = &self.state else { return };
        let (since, is_second) = (*since, at.now >= *next_second);
        for motor in &self.motors {
            if !motor.put_set_point(&self.setup, at.now - since, at.master, at.now) {
                let motor = motor.id;
                // The event that says so may be yet to come.
                let trouble = match at.master.has_restarted(motor) {
                    true => Trouble::Restarted { motor },
                    false => Trouble::Refused { motor },
                };
                return self.trouble(trouble, at);
            }
        }
        if is_second {
            self.report_second(at);
        }
    }

    fn report_second(&mut self, at: &mut Moment<'_, N, impl Board>) {
        let State::Running { cycles, overruns, next_second, .. } = &mut self.state else { return };
        *next_second += SECOND;
        let (cycles, overruns) = (*cycles, *overruns);
        let lost = self.motors.iter().map(|motor| motor.lost(at.master.health(motor.id))).sum();
        let slowest = self.motors.iter_mut().map(Motor::take_answered).min().unwrap_or(0);
        let Usage { stack, queued, dropped } = at.board.usage();
        let second = Report::Second { cycles, overruns, slowest, lost, stack, queued, dropped };
        at.board.log(&second);
        for motor in &self.motors {
            at.board.log(&Report::Measured { motor: motor.id, angle: motor.angle });
        }
    }

    /// The outcome of a request: that of the rounds or the script's.
    fn handle_answer(&mut self, event: &Event, at: &mut Moment<'_, N, impl Board>) {
        self.locks.note(event);
        let answer = self.rounds.take(event).or_else(|| match &mut self.state {
            State::Finding(script)
            | State::Preparing(script)
            | State::ShuttingDown { script, .. } => script.take(event),
            State::Looking { script, .. } => {
                let answer = script.take(event);
                if let Some((motor, Answer::None)) = answer {
                    // It is looked at once it confirms the next stop.
                    self.unseen.insert(motor);
                }
                answer
            }
            _ => None,
        });
        let Some((motor, answer)) = answer else { return };
        if let Some(trouble) = self.note(motor, answer, at) {
            self.trouble(trouble, at);
        }
    }

    /// Takes note of an answer; gives what is wrong with it.
    fn note(
        &mut self,
        motor: MotorId,
        answer: Answer,
        at: &mut Moment<'_, N, impl Board>,
    ) -> Option<Trouble> {
        match answer {
            Answer::None if !self.expected.contains(motor) => {
                // Nobody has this id.
                at.master.forget(motor);
                None
            }
            Answer::None => Some(self.silent(motor, at)),
            Answer::Done => None,
            Answer::Version(version_date) => {
                self.expected.insert(motor);
                let is_known = self.setup.accepts(version_date);
                match self.motors.push(Motor::new(motor, version_date)) {
                    _ if !is_known => Some(Trouble::OtherFirmware { motor, version_date }),
                    Err(_) => Some(Trouble::Refused { motor }),
                    Ok(()) => None,
                }
            }
            Answer::Model(model) => {
                let version_date = self.motor(motor)?.version_date;
                at.board.log(&Report::Found { motor, model, version_date });
                None
            }
            Answer::Errors(flags) => Some(Trouble::Errors { motor, flags }),
            Answer::Turns => Some(Trouble::Turns { motor }),
            Answer::Angle(angle) => {
                self.motor(motor)?.angle = angle;
                None
            }
            Answer::Home(angle) => {
                let setup = self.setup;
                if !self.motor(motor)?.can_begin_at(angle, &setup) {
                    return Some(Trouble::OutOfRange { motor });
                }
                at.board.log(&Report::Ready { motor, angle });
                None
            }
        }
    }

    /// Tells what is wrong and stops all motors. Where they are stopped already, only errors are told.
    fn trouble(&mut self, trouble: Trouble, at: &mut Moment<'_, N, impl Board>) {
        if let Trouble::Errors { motor, .. } = trouble {
            // Told before or not: it confirms a stop and holds nothing, and its brake may have been told to open.
            self.locks.want(motor);
            if self.failed.contains(motor) {
                return;
            }
            self.failed.insert(motor);
        }
        let is_error = matches!(trouble, Trouble::Errors { .. });
        let goes_on = match self.state {
            State::Stopping { .. } | State::Stopped { .. } => true,
            // Nothing else keeps those that turn from being held again.
            State::Looking { .. } => {
                !matches!(trouble, Trouble::Turns { .. } | Trouble::Refused { .. })
            }
            // It has cut its output, and its brake is told to lock: the others are shut down all the same.
            State::ShuttingDown { .. } => is_error,
            _ => false,
        };
        if goes_on && !is_error {
            return;
        }
        at.board.log(&Report::Trouble(trouble));
        if goes_on {
            return;
        }
        if trouble != Trouble::Button {
            self.may_start_at = at.now + STOPPED_BY_ITSELF;
        }
        match (&mut self.state, trouble) {
            // It holds again once all were looked at.
            (
                State::ShuttingDown { turning, .. } | State::Looking { turning, .. },
                Trouble::Turns { motor },
            ) => turning.insert(motor),
            // With a brake that is not locked, off is no stop; behind one that slips, nor is that.
            (State::ShuttingDown { script, .. }, _) => {
                self.shows_at = script.shows_at(at.now);
                self.unseen = self.expected;
                self.stop(self.setup.stop, at);
            }
            _ => self.stop(self.setup.stop, at),
        }
    }

    fn stop(&mut self, kind: StopKind, at: &mut Moment<'_, N, impl Board>) {
        let all = self.known();
        // Those that the master has no place for stay unconfirmed.
        let _ = at.master.stop_all(kind, all);
        let waiting: MotorSet = at.master.motors();
        let unconfirmed = all.without(waiting);
        let until = at.now + LONGEST_STOP;
        self.enter(State::Stopping { kind, waiting, unconfirmed, until }, at);
    }

    fn stop_is_over(&mut self, stopped: MotorId, is_confirmed: bool) {
        if is_confirmed {
            self.expected.insert(stopped);
        }
        match &mut self.state {
            State::Stopping { waiting, unconfirmed, .. } => {
                waiting.remove(stopped);
                if !is_confirmed {
                    unconfirmed.insert(stopped);
                }
            }
            State::Stopped { unconfirmed, .. } | State::Looking { unconfirmed, .. }
                if is_confirmed =>
            {
                unconfirmed.remove(stopped);
            }
            _ => {}
        }
    }

    fn enter(&mut self, state: State, at: &mut Moment<'_, N, impl Board>) {
        self.state = state;
        at.board.log(&Report::State(self.state.name()));
    }

    fn is_running(&self) -> bool {
        matches!(self.state, State::Running { .. })
    }

    /// The motor that was not heard for longest, and for how long.
    fn longest_silence(&self, now: Instant) -> (Option<MotorId>, Duration) {
        let silences = self.motors.iter().map(|motor| (Some(motor.id), motor.silence(now)));
        silences.max_by_key(|&(_, silence)| silence).unwrap_or((None, Duration::ZERO))
    }

    /// What it means that this motor is not heard. With it alone nobody can tell a bus from a motor that
    /// is gone: whoever looks begins at the motor.
    fn silent(&self, motor: MotorId, at: &Moment<'_, N, impl Board>) -> Trouble {
        let longest_wait = at.master.config().reply_timeout + ROUND;
        let is_bus = self.is_running()
            && self.motors.len() > 1
            && self.motors.iter().all(|motor| motor.silence(at.now) > longest_wait);
        if is_bus { Trouble::BusDown } else { Trouble::Silent { motor } }
    }

    fn motor(&mut self, id: MotorId) -> Option<&mut Motor> {
        self.motors.iter_mut().find(|motor| motor.id == id)
    }

    /// All that may be there: the expected ones, and before any was found whoever is looked for.
    fn known(&self) -> MotorSet {
        if self.motors.is_empty() { self.expected.with(self.setup.search) } else { self.expected }
    }

    /// Those that the rounds go to: all that are expected, less those that are being stopped.
    fn attended(&self) -> MotorSet {
        match self.state {
            State::Stopping { .. } => MotorSet::EMPTY,
            State::Stopped { unconfirmed, .. } | State::Looking { unconfirmed, .. } => {
                self.expected.without(unconfirmed)
            }
            _ => self.expected,
        }
    }

    fn found(&self) -> MotorSet {
        self.motors.iter().map(|motor| motor.id).collect()
    }

    /// On while the motors run, blinking fast while it is busy, slowly while it waits.
    fn is_light_on(&self, now: Instant) -> bool {
        let blink =
            |half_period_ms: u64| (now.as_micros() / (half_period_ms * 1_000)).is_multiple_of(2);
        match self.state {
            State::Running { .. } => true,
            State::Stopped { .. } => blink(500),
            _ => blink(100),
        }
    }
}

const fn half(span: Duration) -> Duration {
    Duration::from_micros(span.as_micros() / 2)
}

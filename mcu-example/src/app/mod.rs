//! What happens in each cycle.

mod answers;
mod belief;
mod button;
mod locks;
mod motor;
mod path;
mod rounds;
mod running;
mod script;
mod setup;
mod state;
mod stopping;

use heapless::Vec;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::AnyReply;
use myactuator_protocol_core::master::{Event, Master, MotorSet, StopKind};
use myactuator_protocol_core::time::Instant;

use self::belief::{Belief, Beliefs, Seen};
use self::button::{Button, Press};
use self::locks::Locks;
use self::motor::Motor;
use self::rounds::Rounds;
use self::running::{SECOND, SEEN_WITHIN, Silence};
use self::script::{Part, Question, Script, Step};
pub use self::setup::{Movement, Setup};
use self::state::State;
use crate::board::{Board, RestartCause};
use crate::report::{Report, Trouble};

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

/// The application of a bus with up to `N` motors. It gets every event and the beginning of every cycle, and gives its
/// commands to the [`Master`].
#[derive(Debug)]
pub struct App<const N: usize> {
    setup: Setup,
    state: State,
    motors: Vec<Motor, N>,
    /// Motors that must answer: the required ones, and those that have answered anything since the start.
    expected: MotorSet,
    beliefs: Beliefs,
    locks: Locks,
    /// From when on a check shows whether shafts stand.
    shows_at: Instant,
    rounds: Rounds,
    /// Asks the [watched](Self::watched) motors.
    watch: Rounds,
    button: Button,
    next_cycle: Instant,
}

impl<const N: usize> App<N> {
    /// Begins with a stop to all motors that may be there, whatever the cause of the start: they may have moved on
    /// without a master.
    pub fn start(setup: Setup, cause: RestartCause, at: &mut Moment<'_, N, impl Board>) -> Self {
        at.board.log(&Report::Started { cause });
        let mut app = Self {
            setup,
            state: State::Stopped { kind: setup.stop, unconfirmed: MotorSet::EMPTY, again: at.now },
            motors: Vec::new(),
            expected: setup.required,
            beliefs: Beliefs::new(),
            locks: Locks::new(),
            shows_at: at.now,
            rounds: Rounds::new(&[Question::Errors, Question::RunTime, Question::Angle], at.now),
            watch: Rounds::new(&[Question::Stands], at.now),
            button: Button::new(at.now),
            next_cycle: at.now,
        };
        // The motors may have been running, whatever the cause: the supply may have failed for a moment.
        app.button.stopped(at.now);
        app.stop(setup.stop, at);
        app
    }

    /// When the next cycle is to [begin](Self::begin_cycle).
    pub const fn next_cycle(&self) -> Instant {
        self.next_cycle
    }

    /// Takes note of an event. Call it with every event, as soon as it comes.
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
                // Motors that are moved are stopped by this. Others get no set-points before they are found.
                at.master.resume(motor);
                self.has_let_go(motor, Trouble::Restarted { motor }, at);
            }
            Event::LostMaster { motor } => {
                self.has_let_go(motor, Trouble::LostMaster { motor }, at);
            }
            _ => self.handle_answer(event, at),
        }
    }

    /// The bus driver reports an error.
    pub fn handle_bus_error(&mut self, at: &mut Moment<'_, N, impl Board>) {
        self.trouble(Trouble::BusDown, at);
    }

    /// Begins a cycle. Call it when [`next_cycle`](Self::next_cycle) has come.
    pub fn begin_cycle(&mut self, at: &mut Moment<'_, N, impl Board>) {
        let late = at.now - self.next_cycle;
        let is_late = late + late > self.setup.cycle;
        self.next_cycle = if is_late { at.now } else { self.next_cycle } + self.setup.cycle;

        let longest = self.longest_silence(at.now);
        match self.button.look(at.board.is_button_down(), at.now) {
            Some(press) => self.pressed(press, at),
            None => self.go_on(is_late, longest, at),
        }

        at.board.set_light(self.is_light_on(at.now));
        let sees_its_motors = !self.is_running() || longest.1 <= SEEN_WITHIN;
        if !is_late && sees_its_motors {
            at.board.feed_watchdog();
        }
    }

    // Rare: its registers are not to be saved in every cycle.
    #[inline(never)]
    fn pressed(&mut self, press: Press, at: &mut Moment<'_, N, impl Board>) {
        match (&self.state, press) {
            (State::Stopped { .. }, Press::Down) => {}
            (&State::Stopped { kind, .. }, Press::Short) => {
                // Its errors are read and reported once more.
                self.locks.forget_errors();
                let failed = self.beliefs.those(Belief::has_failed);
                if self.attended().iter().any(|motor| failed.contains(motor)) {
                    // Whoever saw its load fall pressed to stop it.
                    return;
                }
                self.motors.clear();
                let all = self.known();
                let script = Script::new(Part::Find, all, at.now);
                self.enter(State::Finding { script, kind }, at);
            }
            (State::Stopped { .. }, Press::Long) => {
                self.locks.shut_down(self.expected);
                self.beliefs.see_all(self.expected, Seen::ShutDown);
                let script = Script::new(Part::Lock, self.expected, at.now);
                self.enter(State::ShuttingDown { script, turning: MotorSet::EMPTY }, at);
            }
            // A press that stops the motors, or comes while they are being stopped, is used up: releasing the button
            // starts nothing.
            _ => {
                self.button.use_up();
                self.trouble(Trouble::Button, at);
            }
        }
    }

    // Inlined, it costs some 30 instructions in every cycle.
    #[inline(never)]
    fn go_on(&mut self, is_late: bool, longest: Silence, at: &mut Moment<'_, N, impl Board>) {
        // Before anything else is asked.
        self.locks.ask(&self.setup, at.master, at.now);
        match &mut self.state {
            State::Stopping { .. } | State::Stopped { .. } => self.go_on_stopping(at),
            State::Running { cycles, overruns, .. } => {
                *cycles = cycles.saturating_add(1);
                *overruns = overruns.saturating_add(is_late.into());
                self.control(longest, at);
            }
            state => match state.script().map(|it| it.go_on(&self.setup, at.master, at.now)) {
                Some(Step::Refused(motor)) => self.trouble(Trouble::Refused { motor }, at),
                Some(Step::Over) => self.script_is_over(at),
                Some(Step::Waiting) | None => self.ask_watched(at),
            },
        }
        // In every state, and also to motors whose firmware was not asked for yet: a motor that hears nothing cuts its
        // output.
        if self.rounds.is_due(at.now) {
            let (motors, watched) = (self.attended(), self.watch.asked());
            self.rounds.ask(motors, watched, &self.setup, at.master, at.now);
        }
    }

    // Rare, as well.
    #[inline(never)]
    fn script_is_over(&mut self, at: &mut Moment<'_, N, impl Board>) {
        let found = self.found();
        match &mut self.state {
            State::Finding { .. } if found.is_empty() => {
                self.trouble(Trouble::NoMotor, at);
            }
            State::Finding { .. } => {
                // It was not told to hold again yet. Whoever saw it let go pressed to stop it.
                let gone = self.beliefs.those(Belief::has_let_go);
                if let Some(motor) = found.iter().find(|&motor| gone.contains(motor)) {
                    return self.trouble(Trouble::Restarted { motor }, at);
                }
                // Nothing moves yet, but a brake cannot be opened while a stop is in force.
                at.master.lift_stop();
                self.enter(State::Preparing(Script::new(Part::Protect, found, at.now)), at);
            }
            State::ShuttingDown { script, turning } | State::Looking { script, turning, .. } => {
                let is_any_turning = !turning.is_empty();
                match script.next_of_shutting_down(self.expected, *turning, at.now) {
                    Some(next) => {
                        *script = next;
                        if is_any_turning {
                            // Brakes have to open here, too.
                            at.master.lift_stop();
                        }
                    }
                    None => {
                        let kind = match self.state {
                            _ if is_any_turning => StopKind::Hold,
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
                        self.beliefs.see_all(found, Seen::Ready);
                        let (since, next_second) = (at.now, at.now + SECOND);
                        let running = State::Running { since, cycles: 0, overruns: 0, next_second };
                        self.enter(running, at);
                    }
                }
            }
            _ => {}
        }
    }

    fn enter(&mut self, state: State, at: &mut Moment<'_, N, impl Board>) {
        self.state = state;
        at.board.log(&Report::State(self.state.name()));
    }

    fn motor(&mut self, id: MotorId) -> Option<&mut Motor> {
        self.motors.iter_mut().find(|motor| motor.id == id)
    }

    /// All motors that may be there: the expected ones and, before any was found, those that are searched.
    fn known(&self) -> MotorSet {
        if self.motors.is_empty() { self.expected.with(self.setup.search) } else { self.expected }
    }

    /// The motors of the rounds: all expected ones, except those that are being stopped.
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

    /// On while the motors run, blinking slowly while it waits for the button, blinking fast otherwise.
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

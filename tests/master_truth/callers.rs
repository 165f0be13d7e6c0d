//! Callers: when they ask, stop, lift and rest, and when they ask for more than the bus carries. Also the loop of a
//! run.

use myactuator_host_std::sim::bus::faults::{Babble, Direction};
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::master::{Event, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_tests::dice::Dice;
use myactuator_tests::values::id;

use super::bounds::{Bounds, Quiet};
use super::oracle::{Oracle, Totals};
use super::restarts::RESTART_IS_TOLD;
use super::scenarios::{Pace, Scenario, Trouble};
use super::world::{Rough, RoughError, Stage};

const HOUR: Duration = Duration::from_secs(3_600);

/// One run of a scenario.
pub(crate) struct Session<W: Rough> {
    pub(super) scenario: Scenario,
    pub(super) stage: Stage<W>,
    pub(super) oracle: Oracle,
    pub(super) dice: Dice,
    pub(super) asked: u32,
    /// When each open request was put, in the world's time.
    pub(super) since: Vec<Instant>,
    /// When it was put, in free time, and how long it may take.
    pub(super) limits: Vec<(Duration, Duration)>,
    pub(super) bounds: Bounds,
    /// When the newest command to all was put, in calm time.
    pub(super) all_asked_since: Duration,
    pub(super) watched_at: Instant,
    /// Something was due after the last round in which nothing was heard.
    pub(super) is_left_due: bool,
    /// When each motor's newest set-point was put, in the world's time.
    pub(super) streamed: Vec<Instant>,
    /// The number of each motor's next set-point.
    pub(super) numbers: Vec<u32>,
    next_ask: Vec<Instant>,
    /// Motors whose set-point has an outcome, so that the next can be put.
    pub(super) due: Vec<bool>,
    /// Decides what was added to the callers later, so that old seeds keep their meaning.
    pub(super) more: Dice,
    /// When one motor is stopped next on its own, while a command to all may be pending.
    overtakes_at: Option<Instant>,
    /// If all are stopped again: how, how often, and when next.
    pub(super) again: Option<(StopKind, Duration, Instant)>,
    /// The stopped motors, and when the stop is lifted, once all have confirmed.
    pub(super) stopped: MotorSet,
    lifted_at: Option<Instant>,
    rests_until: Instant,
    next_mischief: Instant,
    pub(super) mischief: Option<usize>,
}

impl<W: Rough> Session<W> {
    pub(crate) fn new(scenario: Scenario) -> Self {
        let stage = Stage::<W>::new(&scenario);
        for direction in [Direction::ToNodes, Direction::ToPorts, Direction::Echo] {
            stage.world.set_faults(direction, scenario.plan::<W>(direction));
        }
        {
            let mut truth = stage.book.open();
            truth.flips = scenario.trouble == Trouble::Undetected;
            truth.reorders = matches!(scenario.trouble, Trouble::Reorder | Trouble::All);
            if scenario.conditions.repeats && W::NAME == "RS485" {
                truth.offers.unknown_commands_are_asked();
            }
            if scenario.is_kind() {
                let motors = u64::from(scenario.motors);
                // CAN: queued frames, and two frames for each motor. RS485: the exchange in flight, a stop to all, and
                // an exchange with each motor.
                let within =
                    if W::NAME == "CAN" { 2_000 + 300 * motors } else { 12_000 + 1_500 * motors };
                truth.first_stops_within = Some(Duration::from_micros(within));
            }
        }
        let count = usize::from(scenario.motors);
        Self {
            scenario,
            stage,
            oracle: Oracle::new(),
            dice: Dice::new(scenario.seed),
            asked: 0,
            since: vec![Instant::ZERO; count],
            limits: vec![(Duration::ZERO, Duration::ZERO); count],
            bounds: Bounds::new(&scenario, scenario.longest::<W>()),
            all_asked_since: Duration::ZERO,
            watched_at: Instant::ZERO,
            is_left_due: false,
            streamed: vec![Instant::ZERO; count],
            numbers: vec![1; count],
            next_ask: vec![Instant::ZERO; count],
            due: vec![true; count],
            more: Dice::new(scenario.seed ^ 0x3A11),
            overtakes_at: None,
            again: None,
            stopped: MotorSet::EMPTY,
            lifted_at: None,
            rests_until: Instant::ZERO,
            next_mischief: Instant::ZERO,
            mischief: None,
        }
    }

    pub(super) fn told(&self) -> String {
        format!("{}, {}: {:?}", W::NAME, self.scenario, self.oracle.totals)
    }

    /// Fails if anything is broken.
    fn judge(&self) {
        let broken = std::mem::take(&mut self.stage.book.open().broken);
        assert!(broken.is_empty(), "{}\n{}", broken.join("\n"), self.told());
    }

    pub(super) fn motors(&self) -> impl Iterator<Item = MotorId> + use<W> {
        MotorId::all().take(self.scenario.motors.into())
    }

    pub(crate) fn run(mut self) -> Totals {
        let mut quiet = false;
        loop {
            self.watch();
            let more = self.oracle.totals.requests < self.scenario.requests;
            if more {
                self.make_mischief();
                self.ask();
            } else if !quiet {
                quiet = true;
                self.end_mischief();
            }
            self.lift();
            if !more && self.is_over() {
                break;
            }
            let (now, failures) = (self.stage.host.now(), self.stage.book.open().failures);
            let heard = match self.stage.host.poll() {
                Ok(None) => {
                    self.check_wake(now, failures);
                    self.wait()
                }
                heard => heard,
            };
            match heard {
                Ok(Some(event)) => {
                    self.take(&event);
                    // On a dead bus a caller answers each drop with a new set-point, which takes some time.
                    self.stage.world.run_for(Duration::from_micros(1));
                }
                Ok(None) => {}
                Err(_) => {
                    self.oracle.totals.bus_errors += 1;
                    self.stage.book.open().failure_is_told();
                    self.stage.world.run_for(Duration::from_micros(200));
                }
            }
            self.judge();
        }
        self.check_health();
        self.judge();
        self.oracle.totals.excused = self.stage.book.open().excused.clone();
        self.oracle.totals.turned = self.stage.book.open().turned;
        self.oracle.totals
    }

    fn is_over(&self) -> bool {
        self.oracle.open.iter().all(Option::is_none)
            && self.oracle.broadcast.is_none()
            && self.stopped.is_empty()
            && !self.motors().any(|motor| self.awaits_feedback(motor))
    }

    /// Whether an event of its newest set-point must still come: it has none, and no caller has stopped the motor
    /// since.
    fn awaits_feedback(&self, motor: MotorId) -> bool {
        let truth = self.stage.book.open();
        let page = &truth.pages[motor.index()];
        !self.due[motor.index()]
            && page.set_points.put_at > page.stop_called.max(page.may_be_stopping_since)
    }

    /// A set-point waits until it is too old, or its feedback may be lost. And for a while no caller looks.
    fn longest_stream_wait(&self) -> Duration {
        let config = self.scenario.longest::<W>();
        config.set_point_max_age + config.reply_timeout + Duration::from_millis(60)
    }

    /// Now, in the world's time.
    pub(super) fn now(&self) -> Instant {
        self.stage.world.now()
    }

    /// A request and a set-point are two exchanges. On CAN they take 0.5 ms of wire. On RS485 they take 2.5 ms, because
    /// nothing else is sent meanwhile. Faults take more.
    fn pace(&self) -> Duration {
        let one = if W::NAME == "CAN" { 1_000 } else { 3_000 };
        let more = 100 + 4 * u64::from(self.scenario.percent);
        Duration::from_micros(one * u64::from(self.scenario.motors) * more / 100)
    }

    /// Sleeps until the master has something to do or a frame arrives. If the master's `poll_at` forgets anything, an
    /// outcome comes far too late.
    fn wait(&mut self) -> Result<Option<Event>, RoughError> {
        let now = self.now();
        for motor in self.motors() {
            let waited = now - self.streamed[motor.index()];
            let hangs = self.awaits_feedback(motor) && waited > self.longest_stream_wait();
            assert!(!hangs, "a set-point of motor {motor} hangs. {}", self.told());
            let mut truth = self.stage.book.open();
            let (page, now) = (&truth.pages[motor.index()], truth.now);
            if page.set_points.is_dropped_for_nothing(now, RESTART_IS_TOLD) {
                truth.breaks(format!("a set-point of motor {motor} was dropped for nothing"));
            } else if page.turning.is_restart_untold(now, RESTART_IS_TOLD) {
                truth.breaks(format!("the angle of motor {motor} jumps, and nothing is reported"));
            } else if page.run_time.is_restart_untold(now) {
                truth.breaks(format!(
                    "motor {motor} has run for less long, and nothing is reported"
                ));
            }
        }
        if self.scenario.conditions.jumps && self.dice.below(20_000) == 0 {
            self.jump();
            return Ok(None);
        }
        let is_waiting = !self.is_over();
        let mut until = if is_waiting && self.lifted_at.is_none() && self.dice.below(4) == 0 {
            now + Duration::from_secs(10)
        } else {
            let next = self.next_ask.iter().min().copied().unwrap_or(now).max(self.rests_until);
            next.max(now + Duration::from_micros(100))
        };
        // A cut wire is mended in time, so that no frame is held back for longer than the master assumes.
        if self.scenario.trouble == Trouble::Cut && self.mischief.is_some() {
            until = until.min(self.next_mischief);
        }
        let truth = self.stage.book.open();
        let shown = until + truth.clock_ahead;
        drop(truth);
        self.stage.host.wait(shown)
    }

    /// The caller does not look for an hour.
    fn jump(&mut self) {
        self.stage.world.run_for(Duration::from_micros(self.dice.below(30_000)));
        let now = self.now();
        let mut truth = self.stage.book.open();
        truth.clocks.disturb(Quiet::None);
        truth.clock_ahead = truth.clock_ahead + HOUR;
        truth.tick(now);
        truth.was_held_up();
    }

    /// Cuts, slows, babbles and restarts for the scenario's share of the time. Now and then a drive restarts, loses its
    /// master or reports an error.
    fn make_mischief(&mut self) {
        let now = self.now();
        let which = self.dice.below(self.stage.stations.len() as u64) as usize;
        let node = self.stage.stations[which];
        let conditions = self.scenario.conditions;
        match self.dice.below(20_000) {
            0 if conditions.restarts => self.stage.world.reset(node),
            1..5 if conditions.lost_masters => {
                self.stage.drive(which, |drive| drive.lose_master(now));
            }
            5..25 if conditions.reports => {
                self.stage.drive(which, |drive| drive.report_error(now));
            }
            _ => {}
        }
        let Scenario { trouble, percent, .. } = self.scenario;
        if !trouble.is_by_hand() || percent == 0 || now < self.next_mischief {
            return;
        }
        if self.mischief.is_some() {
            self.end_mischief();
            self.next_mischief = now + Duration::from_micros(500 * (100 - u64::from(percent)));
            return;
        }
        let world = &self.stage.world;
        match trouble {
            Trouble::Cut if conditions.cuts_master && self.more.below(2) == 0 => {
                world.cut(self.stage.port);
            }
            Trouble::Cut => world.cut(node),
            Trouble::Slow => world.slow_down(node, Duration::from_millis(3)),
            Trouble::Babble => {
                let interval = Duration::from_micros(200);
                world.babble(node, Some(Babble { interval, frame: None }));
            }
            _ => world.reset(node),
        }
        self.mischief = Some(which);
        self.next_mischief = now + Duration::from_micros(500 * u64::from(percent));
    }

    fn end_mischief(&mut self) {
        if let Some(which) = self.mischief.take() {
            let node = self.stage.stations[which];
            self.stage.world.mend(node);
            self.stage.world.mend(self.stage.port);
            self.stage.world.slow_down(node, Duration::ZERO);
            self.stage.world.babble(node, None);
        }
    }

    fn ask(&mut self) {
        let now = self.now();
        let conditions = self.scenario.conditions;
        if now < self.rests_until {
            return;
        }
        if conditions.pace == Pace::Rests && self.dice.below(2_000) == 0 {
            self.rests_until = now + Duration::from_micros(self.dice.below(300_000));
            return;
        }
        if !conditions.is_plain {
            if self.stopped.is_empty() && self.dice.below(2_000) == 0 {
                self.stop();
            }
            if self.oracle.broadcast.is_none() && self.dice.below(500) == 0 {
                self.ask_all();
            }
            self.end_and_stop_more(now);
        }
        for index in 0..usize::from(self.scenario.motors) {
            if now < self.next_ask[index] {
                continue;
            }
            // Half of them as soon as the previous one is over.
            let waits = if conditions.pace == Pace::Flood { 0 } else { self.dice.below(2) };
            self.next_ask[index] = now + Duration::from_micros(self.pace().as_micros() * 2 * waits);
            if self.oracle.open[index].is_none() {
                self.ask_one(index);
            }
            if self.due[index] {
                self.stream(index);
            }
        }
    }

    /// Stops all motors or one.
    fn stop(&mut self) {
        let kind = if self.dice.below(2) == 0 { StopKind::Hold } else { StopKind::Off };
        let one = self.dice.below(3) == 0;
        let motor = if one { self.dice.below(self.scenario.motors.into()) as u8 + 1 } else { 0 };
        self.stop_now(kind, one.then(|| id(motor)));
        self.oracle.totals.stops += 1;
        if !one && self.scenario.conditions.stops_again {
            let now = self.now();
            let every = [100, 1_000, 5_000][self.more.below(3) as usize];
            self.again = Some((kind, Duration::from_micros(every), now));
            self.lifted_at = Some(now + Duration::from_micros(self.more.below(100_000)));
        }
    }

    /// Stops this motor, or all.
    fn stop_now(&mut self, kind: StopKind, one: Option<MotorId>) {
        let all: MotorSet = self.motors().collect();
        let master = self.stage.host.master();
        self.stopped = match one {
            Some(motor) => {
                master.stop(motor, kind).expect("there is a place");
                motor.into()
            }
            None => {
                master.stop_all(kind, all).expect("there is a place for all");
                all
            }
        };
        let (known, now) = (master.motors(), self.now());
        let mut truth = self.stage.book.open();
        // Nobody has read the clock since a wait began.
        truth.tick(now);
        truth.stop(self.stopped, kind, one.is_none(), known);
    }

    /// Ends the motion of all, often with a stop of one after it, and stops all once more.
    fn end_and_stop_more(&mut self, now: Instant) {
        if self.scenario.conditions.ends_all {
            if self.oracle.broadcast.is_none() && self.more.below(400) == 0 {
                self.end_all();
                let soon = Duration::from_micros(self.more.below(3) * self.more.below(1_000));
                self.overtakes_at = (self.more.below(2) == 0).then_some(now + soon);
            }
            if self.overtakes_at.take_if(|at| *at <= now).is_some() && self.stopped.is_empty() {
                let kind = if self.more.below(2) == 0 { StopKind::Hold } else { StopKind::Off };
                let motor = self.more.below(self.scenario.motors.into()) as u8 + 1;
                self.stop_now(kind, Some(id(motor)));
                self.oracle.totals.stops += 1;
            }
        }
        if let Some((kind, every, _)) = self.again.filter(|(.., next)| *next <= now) {
            self.again = Some((kind, every, now + every));
            // Rarely the kind changes.
            let other = if self.more.below(2) == 0 { StopKind::Hold } else { StopKind::Off };
            let kind = if self.more.below(16) == 0 { other } else { kind };
            self.stop_now(kind, None);
            self.oracle.totals.stops_again += 1;
        }
    }

    /// Lifts the stop some time after all have confirmed it, rarely before.
    fn lift(&mut self) {
        if self.stopped.is_empty() {
            return;
        }
        let now = self.now();
        let truth = self.stage.book.open();
        let is_over = !self.stopped.iter().any(|motor| truth.pages[motor.index()].is_stopping);
        drop(truth);
        if self.lifted_at.is_none() && is_over {
            self.lifted_at = Some(now + Duration::from_micros(self.dice.below(40_000)));
        }
        let is_time = self.lifted_at.is_some_and(|at| at <= now);
        if is_time || self.dice.below(5_000) == 0 {
            self.stage.host.master().lift_stop();
            self.stage.book.open().lift(self.stopped);
            self.stopped = MotorSet::EMPTY;
            (self.lifted_at, self.again) = (None, None);
            self.due.fill(true);
        }
    }

    fn take(&mut self, event: &Event) {
        // Nothing is counted for a motor without a place.
        if let Event::Stray { motor, .. } = *event
            && !self.stage.host.master().motors().contains(motor)
        {
            return;
        }
        self.oracle.hear(event, &mut self.stage.book.open());
        match *event {
            Event::Feedback { motor, .. }
            | Event::SetPointUnanswered { motor }
            | Event::SetPointDropped { motor } => self.due[motor.index()] = true,
            Event::Restarted { motor } => {
                self.due[motor.index()] = true;
                // Some read its angle first.
                if self.dice.below(2) == 0 {
                    self.stream(motor.index());
                }
                self.stage.host.master().resume(motor);
                self.stage.book.open().pages[motor.index()].awaits_resume = false;
            }
            _ => {}
        }
    }

    fn check_health(&mut self) {
        let conditions = self.scenario.conditions;
        // Only without stops, which push other commands aside, and without frames that are neither answered nor lost.
        let exactly = conditions.is_plain && !conditions.lost_masters && !conditions.restarts;
        for motor in self.motors() {
            let health = self.stage.host.master().health(motor);
            let is_idle = self.due[motor.index()];
            let mut truth = self.stage.book.open();
            self.oracle.check_health(motor, health, exactly && is_idle, &mut truth);
        }
    }
}

//! How long anything may take, and which time counts.
//!
//! No bound holds while a bus takes nothing, and requests wait for stops and for commands to all. So there are three
//! clocks. Each stands still while something is in flight for which its requests have to wait. That has a bound as
//! well, so nothing waits forever. None of these clocks is the master's, which may jump.

use myactuator_protocol_core::Data;
use myactuator_protocol_core::master::{Bus, Config};
use myactuator_protocol_core::time::{Duration, Instant};

use super::drives::UNKNOWN;
use super::scenarios::Scenario;
use super::to_all::SHUTDOWN;

/// The attempts of a stop, and the time-out of each.
pub(super) const STOP_ATTEMPTS: u32 = 15;
const LONGEST_STOP_TIMEOUT: Duration = Duration::from_millis(50);
/// The time-out of a write to ROM, and of a command that no firmware knows.
pub(super) const ROM_TIMEOUT: Duration = Duration::from_millis(20);
/// The longest time without a look: the caller takes earlier events first, or waits after a failure.
const NOBODY_LOOKS: Duration = Duration::from_millis(5);

/// What goes on, and so which clocks run.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub(crate) enum Quiet {
    /// The bus takes nothing, or nobody knows how long anything takes. No clock runs.
    #[default]
    None,
    /// The bus takes what it is given.
    Steady,
    /// In addition no stop is in flight, and no request that ends motion delays a move of all.
    Calm,
    /// In addition no command to all is in flight.
    Free,
}

/// The clocks, each since the run began.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clocks {
    pub(crate) steady: Duration,
    pub(crate) calm: Duration,
    pub(crate) free: Duration,
    /// The time of the last look, and the least quiet state since.
    looked: Instant,
    since: Quiet,
}

impl Clocks {
    /// Advances to this time of the world, at which this goes on.
    pub(crate) fn pass(&mut self, now: Instant, is: Quiet) {
        self.disturb(is);
        for (clock, of) in [
            (&mut self.steady, Quiet::Steady),
            (&mut self.calm, Quiet::Calm),
            (&mut self.free, Quiet::Free),
        ] {
            if self.since >= of {
                *clock = *clock + (now - self.looked);
            }
        }
        (self.looked, self.since) = (now, is);
    }

    /// It was no more quiet than this, even if only for a moment.
    pub(crate) fn disturb(&mut self, to: Quiet) {
        if to < self.since {
            self.since = to;
        }
    }
}

/// The bounds of one scenario.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    config: Config,
    step: Duration,
    /// The wait for a motor's turn: each other motor sends its request and its set-point first.
    turn: Duration,
    /// The time in which each stop in flight is sent once.
    round_of_stops: Duration,
}

impl Bounds {
    pub(crate) fn new(scenario: &Scenario, config: Config) -> Self {
        let motors = u32::from(scenario.motors);
        // A coarse clock shows each time-out up to a step late.
        let step = Duration::from_millis(u64::from(scenario.conditions.coarse_clock));
        let timeout = config.reply_timeout + step;
        let (turn, round_of_stops) = match config.bus {
            // Two commands and two replies of each motor. Its own set-point may be lost. So may the set-point of
            // another motor, for whose pending answer it waits.
            Bus::Can => {
                let all = config.frame_time.times(4 * motors);
                (all + timeout + timeout, all)
            }
            // One exchange at a time, each with a motor that may be silent. Other senders on the line may take as much
            // time.
            Bus::Rs485 { turnaround, echo } => {
                let conditions = &scenario.conditions;
                let motors =
                    motors * (1 + u32::from(conditions.twins) + u32::from(conditions.stranger));
                let frames = config.frame_time.times(2) + turnaround + NOBODY_LOOKS;
                let longest = if scenario.conditions.repeats { ROM_TIMEOUT } else { timeout };
                let exchange = timeout.max(longest) + frames;
                let stop = timeout.min(LONGEST_STOP_TIMEOUT) + frames;
                // If no echo is configured, a read that shows whether there is one may come before each exchange.
                let reads = if echo { 1 } else { 2 };
                (exchange.times(2 * reads * motors), stop.times(reads * motors))
            }
        };
        Self { config, step, turn, round_of_stops }
    }

    /// For this long a reply to a command that was given up may come. Until then no command is sent whose reply looks
    /// the same.
    fn late(&self) -> Duration {
        self.config.reply_timeout + self.config.late_window + self.step
    }

    /// The time-out of the reply to this command.
    pub(crate) fn timeout(&self, data: &Data) -> Duration {
        let timeout = self.config.reply_timeout;
        if data[0] == UNKNOWN { timeout.max(ROM_TIMEOUT) } else { timeout }
    }

    /// How long the master leaves a motor alone after a command to restart.
    pub(crate) fn restart(&self) -> Duration {
        self.config.restart_time
    }

    /// The longest that a request with this many attempts takes, in free time.
    pub(crate) fn request(&self, data: &Data, timeout: Duration, attempts: u32) -> Duration {
        let attempt = timeout + self.step + self.turn;
        // After its answer, a request that ends motion waits until nothing sent before it can move the motor any more.
        // Then it is sent again.
        let once_more =
            if is_ending(data) { self.late() + self.late() + attempt } else { Duration::ZERO };
        attempt.times(attempts) + self.late() + self.config.settle_time + once_more + NOBODY_LOOKS
    }

    /// The longest that a command to all takes, in calm time: after requests in flight, and after the answers to the
    /// command to all before. (A command that moves waits for everything that ends motion. The time is not calm then.)
    pub(crate) fn broadcast(&self) -> Duration {
        let Config { reply_timeout, attempts, .. } = self.config;
        let begun = self.request(
            &[SHUTDOWN, 0, 0, 0, 0, 0, 0, 0],
            reply_timeout.max(ROM_TIMEOUT),
            attempts.into(),
        );
        begun + self.late() + self.late() + reply_timeout + NOBODY_LOOKS
    }

    /// The longest that a stop takes, in steady time: all its attempts, after what is in flight, and until nothing sent
    /// before it can move the motor any more. On CAN every second unanswered attempt may extend that.
    pub(crate) fn stop(&self) -> Duration {
        let timeout = self.config.reply_timeout.min(LONGEST_STOP_TIMEOUT);
        let (attempt, waits) = match self.config.bus {
            Bus::Can => (timeout + self.step + self.round_of_stops, STOP_ATTEMPTS / 2 + 1),
            // On a line only one waits at a time.
            Bus::Rs485 { .. } => (self.round_of_stops, 1),
        };
        attempt.times(STOP_ATTEMPTS) + self.late() + self.late().times(waits) + NOBODY_LOOKS
    }
}

pub(super) fn is_ending(data: &Data) -> bool {
    matches!(data[0], 0x78 | 0x80 | 0x81)
}

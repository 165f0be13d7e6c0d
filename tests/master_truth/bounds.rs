//! How long anything may take, and which time counts for it.
//!
//! No bound holds for a bus that takes nothing, and requests wait for stops and for commands to all. So there are three
//! clocks. Each of them stands still while something goes on for which its requests have to wait. That has a bound as
//! well, so nothing waits forever. None of the clocks is the master's, which may jump.

use myactuator_protocol_core::Data;
use myactuator_protocol_core::master::{Bus, Config};
use myactuator_protocol_core::time::{Duration, Instant};

use super::drives::UNKNOWN;
use super::scenarios::Scenario;
use super::to_all::SHUTDOWN;

/// The attempts of a stop, and the time-out of each.
const STOP_ATTEMPTS: u32 = 15;
const LONGEST_STOP_TIMEOUT: Duration = Duration::from_millis(50);
/// The time-out of a write to ROM, and of a command that no firmware knows.
const ROM_TIMEOUT: Duration = Duration::from_millis(20);
/// The longest time without a look: a caller takes the events before this one, or has failed.
const NOBODY_LOOKS: Duration = Duration::from_millis(5);

/// What time counts while.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub(crate) enum Quiet {
    /// The bus takes nothing, or it is not known how long anything takes.
    #[default]
    None,
    /// It takes what it is given.
    Steady,
    /// In addition no stop is in flight, and nothing that ends motion while all are to be moved.
    Calm,
    /// In addition no command to all is in flight.
    Free,
}

/// Times that count, each since the run began.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clocks {
    pub(crate) steady: Duration,
    pub(crate) calm: Duration,
    pub(crate) free: Duration,
    /// The time of the last look, and the least that went on since.
    looked: Instant,
    since: Quiet,
}

impl Clocks {
    /// Advances to this time of the world, in which this goes on.
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

    /// No more than this went on, even if only for a moment.
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
    /// Until it is a motor's turn: each other motor has its request and its set-point first.
    turn: Duration,
    /// Until each stop under way has been sent once.
    round_of_stops: Duration,
}

impl Bounds {
    pub(crate) fn new(scenario: &Scenario, config: Config) -> Self {
        let motors = u32::from(scenario.motors);
        // A clock of coarse steps shows each time-out up to a step late.
        let step = Duration::from_millis(u64::from(scenario.conditions.coarse_clock));
        let timeout = config.reply_timeout + step;
        let (turn, round_of_stops) = match config.bus {
            // Two commands and two replies of each motor. Its own set-point may be lost. So may the set-point of
            // another motor that may be waiting for its turn to answer, which is waited for.
            Bus::Can => {
                let all = config.frame_time.times(4 * motors);
                (all + timeout + timeout, all)
            }
            // One exchange at a time, each with a motor that may be silent. Another sender on the line may take as much
            // time.
            Bus::Rs485 { turnaround, echo } => {
                let conditions = &scenario.conditions;
                let motors =
                    motors * (1 + u32::from(conditions.twins) + u32::from(conditions.stranger));
                let frames = config.frame_time.times(2) + turnaround + NOBODY_LOOKS;
                let longest = if scenario.conditions.repeats { ROM_TIMEOUT } else { timeout };
                let exchange = timeout.max(longest) + frames;
                let stop = timeout.min(LONGEST_STOP_TIMEOUT) + frames;
                // If it was not configured whether the adapter echoes, each comes after a read that shows it.
                let reads = if echo { 1 } else { 2 };
                (exchange.times(2 * reads * motors), stop.times(reads * motors))
            }
        };
        Self { config, step, turn, round_of_stops }
    }

    /// For this long a reply to a command that was given up may come, and nothing is sent that could be mistaken for
    /// it.
    fn late(&self) -> Duration {
        self.config.reply_timeout + self.config.late_window + self.step
    }

    /// The time-out of the reply to this.
    pub(crate) fn timeout(&self, data: &Data) -> Duration {
        let timeout = self.config.reply_timeout;
        if data[0] == UNKNOWN { timeout.max(ROM_TIMEOUT) } else { timeout }
    }

    /// How long a motor that was told to restart is left alone.
    pub(crate) fn restart(&self) -> Duration {
        self.config.restart_time
    }

    /// A request with this many attempts, in free time.
    pub(crate) fn request(&self, data: &Data, timeout: Duration, attempts: u32) -> Duration {
        let attempt = timeout + self.step + self.turn;
        // A request that ends motion is answered, waits until nothing sent before it can move the motor any more, and
        // is sent again.
        let once_more =
            if is_ending(data) { self.late() + self.late() + attempt } else { Duration::ZERO };
        attempt.times(attempts) + self.late() + self.config.settle_time + once_more + NOBODY_LOOKS
    }

    /// A command to all, in calm time: after what has begun, and after the answers to the one before. (One that moves
    /// waits for everything that ends motion, so the time is not calm then.)
    pub(crate) fn broadcast(&self) -> Duration {
        let Config { reply_timeout, attempts, .. } = self.config;
        let begun = self.request(
            &[SHUTDOWN, 0, 0, 0, 0, 0, 0, 0],
            reply_timeout.max(ROM_TIMEOUT),
            attempts.into(),
        );
        begun + self.late() + self.late() + reply_timeout + NOBODY_LOOKS
    }

    /// A stop, in steady time: all its attempts, after what is in flight, and until nothing sent before it can move the
    /// motor any more. On CAN an attempt that is not answered may extend that, once every second.
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

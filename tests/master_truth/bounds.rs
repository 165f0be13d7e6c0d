//! How long anything may take at the most, and what time counts for it.
//!
//! No bound holds for a bus that takes nothing, and requests wait for stops and for commands to all. So there are three
//! clocks, each of which stands while what comes before the thing goes on. Whatever keeps one of them standing has a
//! bound itself, so that nothing waits for ever. None of them is the master's: that one may jump.

use myactuator_protocol_core::Data;
use myactuator_protocol_core::master::{Bus, Config};
use myactuator_protocol_core::time::{Duration, Instant};

use super::drives::UNKNOWN;
use super::scenarios::Scenario;
use super::to_all::SHUTDOWN;

/// A stop is sent so often, and waited for no longer than this.
const STOP_ATTEMPTS: u32 = 15;
const LONGEST_STOP_TIMEOUT: Duration = Duration::from_millis(50);
/// What the reply to a write to ROM is waited for; so is that to a command that no firmware knows.
const ROM_TIMEOUT: Duration = Duration::from_millis(20);
/// Nobody looks for so long at the most: a caller takes the events before this one, or has failed.
const NOBODY_LOOKS: Duration = Duration::from_millis(5);

/// What goes on.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub(crate) enum Quiet {
    /// The bus takes nothing, or nobody can say for how long anything takes.
    #[default]
    None,
    /// It takes what it is given.
    Steady,
    /// And no stop is under way, nor what ends motion while all are to be moved.
    Calm,
    /// And nothing to all.
    Free,
}

/// Times that count, each since the run began.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clocks {
    pub(crate) steady: Duration,
    pub(crate) calm: Duration,
    pub(crate) free: Duration,
    /// When somebody looked last, and the least that went on since.
    looked: Instant,
    since: Quiet,
}

impl Clocks {
    /// It is this late in the world, and this goes on.
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

    /// No more than this went on, if only for a moment.
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
    /// Until it is a motor's turn: each other one has its request and its set-point before.
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
            // Two commands and two replies of each. Its own set-point may be lost, and one of another motor's that may
            // be waiting for its turn to answer is waited for.
            Bus::Can => {
                let all = config.frame_time.times(4 * motors);
                (all + timeout + timeout, all)
            }
            // One exchange at a time, each with a motor that may be silent; and whoever else speaks on the line has as
            // much of it.
            Bus::Rs485 { turnaround, echo } => {
                let conditions = &scenario.conditions;
                let motors =
                    motors * (1 + u32::from(conditions.twins) + u32::from(conditions.stranger));
                let frames = config.frame_time.times(2) + turnaround + NOBODY_LOOKS;
                let longest = if scenario.conditions.repeats { ROM_TIMEOUT } else { timeout };
                let exchange = timeout.max(longest) + frames;
                let stop = timeout.min(LONGEST_STOP_TIMEOUT) + frames;
                // Where nobody has said whether the adapter echoes, each goes behind a read that shows it.
                let reads = if echo { 1 } else { 2 };
                (exchange.times(2 * reads * motors), stop.times(reads * motors))
            }
        };
        Self { config, step, turn, round_of_stops }
    }

    /// For as long as this a reply to what was given up may come, and nothing that could be mistaken for it goes.
    fn late(&self) -> Duration {
        self.config.reply_timeout + self.config.late_window + self.step
    }

    /// What a reply to this is waited for.
    pub(crate) fn timeout(&self, data: &Data) -> Duration {
        let timeout = self.config.reply_timeout;
        if data[0] == UNKNOWN { timeout.max(ROM_TIMEOUT) } else { timeout }
    }

    /// A motor that was told to restart is left alone for so long.
    pub(crate) fn restart(&self) -> Duration {
        self.config.restart_time
    }

    /// A request with so many attempts, in free time.
    pub(crate) fn request(&self, data: &Data, timeout: Duration, attempts: u32) -> Duration {
        let attempt = timeout + self.step + self.turn;
        // What ends motion is answered, waits until nothing from before can move the motor any more, and goes again.
        let once_more =
            if is_ending(data) { self.late() + self.late() + attempt } else { Duration::ZERO };
        attempt.times(attempts) + self.late() + self.config.settle_time + once_more + NOBODY_LOOKS
    }

    /// A command to all, in calm time: behind what has begun, and behind the answers to the one before. (One that moves
    /// waits for whatever ends motion, so that it is not calm then.)
    pub(crate) fn broadcast(&self) -> Duration {
        let Config { reply_timeout, attempts, .. } = self.config;
        let begun = self.request(
            &[SHUTDOWN, 0, 0, 0, 0, 0, 0, 0],
            reply_timeout.max(ROM_TIMEOUT),
            attempts.into(),
        );
        begun + self.late() + self.late() + reply_timeout + NOBODY_LOOKS
    }

    /// A stop, in steady time: all its attempts, behind what is in flight, and until nothing from before can move
    /// the motor any more. On CAN an attempt that is not answered may say that it can, once more: at every second.
    pub(crate) fn stop(&self) -> Duration {
        let timeout = self.config.reply_timeout.min(LONGEST_STOP_TIMEOUT);
        let (attempt, waits) = match self.config.bus {
            Bus::Can => (timeout + self.step + self.round_of_stops, STOP_ATTEMPTS / 2 + 1),
            // On a line nobody waits beside another.
            Bus::Rs485 { .. } => (self.round_of_stops, 1),
        };
        attempt.times(STOP_ATTEMPTS) + self.late() + self.late().times(waits) + NOBODY_LOOKS
    }
}

pub(super) fn is_ending(data: &Data) -> bool {
    matches!(data[0], 0x78 | 0x80 | 0x81)
}

//! A run: one trouble, how often it strikes, and the conditions with which it is combined.

use std::fmt;

use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_protocol_core::master::Config;
use myactuator_protocol_core::time::Duration;
use myactuator_tests::dice::Dice;
use myactuator_tests::wire::Wire;

/// The longest time-outs of a master that measures how long replies take, as on the buses of hosts.
const LONGEST_REPLY_TIMEOUT: Duration = Duration::from_millis(40);

/// The troubles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Trouble {
    /// Random, in both directions.
    Lose,
    Corrupt,
    /// CAN: half of the corrupted frames pass the CRC.
    Undetected,
    /// Replies arrive twice.
    DoubleReplies,
    /// Commands and replies arrive twice.
    DoubleAll,
    Delay,
    Reorder,
    /// All of the above except undetected corruption and doubled commands, at a fifth of the rate each.
    All,
    /// By hand, for that share of the time: a drive's wire is cut, a drive is slow, a station babbles, or a drive is
    /// restarted at the beginning of that time.
    Cut,
    Slow,
    Babble,
    Restart,
}

impl Trouble {
    pub(crate) fn is_by_hand(self) -> bool {
        matches!(self, Self::Cut | Self::Slow | Self::Babble | Self::Restart)
    }
}

/// Whether the adapter echoes (RS485).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Echo {
    #[default]
    None,
    Configured,
    /// The loop has to find out.
    Unknown,
}

/// The load from callers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Pace {
    /// The bus is busy but never full. (On a full CAN bus the replies of the highest ids wait.)
    #[default]
    Busy,
    /// More than the bus carries.
    Flood,
    /// Now and then no load at all.
    Rests,
}

/// The loop that runs the master.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Loop {
    #[default]
    Polled,
    Async,
    /// Its futures are dropped now and then, wherever they wait.
    AsyncDropped,
}

/// The properties of a world. In the default nothing goes wrong.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Conditions {
    /// Received frames and bytes are handed over once in this many milliseconds.
    pub(crate) burst_ms: u64,
    /// The clock has a resolution of 1 ms.
    pub(crate) coarse_clock: bool,
    pub(crate) clock_start_ms: u64,
    /// Now and then the caller does not look for an hour.
    pub(crate) jumps: bool,
    /// A CAN controller with three mailboxes by priority, instead of a queue of ten.
    pub(crate) mailboxes: bool,
    /// The port refuses to send for a while.
    pub(crate) refuses: bool,
    /// Any call of the port may fail.
    pub(crate) fails: bool,
    pub(crate) echo: Echo,
    /// The trouble of echoes, and its rate in percent.
    pub(crate) echo_trouble: Option<(Trouble, u32)>,
    /// Each switch of direction may be heard as a byte.
    pub(crate) noise: bool,
    /// Another drive has the first one's id.
    pub(crate) twins: bool,
    /// Another master asks the first motor.
    pub(crate) stranger: bool,
    /// It also moves that motor.
    pub(crate) stranger_moves: bool,
    /// It asks and moves any motor, on CAN also in motion mode.
    pub(crate) stranger_roams: bool,
    /// Drives have run for long when the master begins, each for a different time.
    pub(crate) have_run: bool,
    /// Drives restart, on their own and on command. A restart takes 1.1 s.
    pub(crate) restarts: bool,
    /// Drives lose their master.
    pub(crate) lost_masters: bool,
    /// Drives send reports: errors, and active replies.
    pub(crate) reports: bool,
    /// Drives answer twice, and answer unknown commands.
    pub(crate) repeats: bool,
    pub(crate) pace: Pace,
    pub(crate) runs: Loop,
    /// No caller stops anything, or sends anything to all.
    pub(crate) is_plain: bool,
    /// Commands to all end motion, and single motors are stopped at the same time.
    pub(crate) ends_all: bool,
    /// A caller that stops all repeats that in every cycle.
    pub(crate) stops_again: bool,
    /// Random drives do not hear commands to all (function 2).
    pub(crate) deaf_to_all: bool,
    /// Now and then the master's own wire is cut, so that nothing acknowledges the frames in its mailboxes.
    pub(crate) cuts_master: bool,
    /// Time-outs follow the measured round trips, as on the buses of hosts. Nobody tells the master of bursts.
    pub(crate) adapts: bool,
}

/// One run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scenario {
    pub(crate) trouble: Trouble,
    pub(crate) percent: u32,
    pub(crate) motors: u8,
    pub(crate) requests: u64,
    pub(crate) seed: u64,
    pub(crate) conditions: Conditions,
}

impl fmt::Display for Scenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { trouble, percent, motors, seed, conditions, .. } = self;
        write!(f, "seed {seed}: {trouble:?} {percent} %, {motors} motors, {conditions:?}")
    }
}

impl Scenario {
    /// A world in which nothing goes wrong except for this trouble.
    pub(crate) fn of(trouble: Trouble, percent: u32, motors: u8, requests: u64) -> Self {
        let seed = trouble as u64 * 1_000_000 + u64::from(percent) * 1_000 + u64::from(motors);
        Self { trouble, percent, motors, requests, seed, conditions: Conditions::default() }
    }

    /// Any combination, drawn by the seed.
    pub(crate) fn drawn<W: Wire>(seed: u64, requests: u64) -> Self {
        let mut dice = Dice::new(seed);
        let mut one_of = |choices: &[u64]| choices[dice.below(choices.len() as u64) as usize];
        let troubles = [
            Trouble::Lose,
            Trouble::Corrupt,
            Trouble::DoubleReplies,
            Trouble::DoubleAll,
            Trouble::Delay,
            Trouble::Reorder,
            Trouble::All,
            Trouble::Cut,
            Trouble::Slow,
            Trouble::Babble,
        ];
        let trouble = troubles[one_of(&[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]) as usize];
        let percent = one_of(&[0, 0, 0, 1, 1, 5, 10]) as u32;
        let motors = one_of(&[1, 1, 2, 3, 5, 8, 16, 32]) as u8;
        let mut sometimes = || one_of(&[0, 0, 0, 1]) == 1;
        let is_can = W::NAME == "CAN";
        let mut conditions = Conditions {
            coarse_clock: sometimes(),
            jumps: sometimes(),
            mailboxes: is_can && (sometimes() || sometimes()),
            refuses: sometimes(),
            fails: sometimes(),
            noise: !is_can && sometimes(),
            twins: sometimes(),
            stranger: sometimes(),
            restarts: sometimes(),
            lost_masters: sometimes(),
            reports: sometimes(),
            repeats: sometimes(),
            is_plain: sometimes(),
            ..Conditions::default()
        };
        conditions.burst_ms = one_of(&[0, 0, 0, 1, 4, 16]);
        conditions.clock_start_ms = one_of(&[0, 0, 1, 3_600_000]);
        conditions.pace = [Pace::Busy, Pace::Flood, Pace::Rests][one_of(&[0, 0, 1, 2]) as usize];
        if !is_can {
            conditions.echo =
                [Echo::None, Echo::Configured, Echo::Unknown][one_of(&[0, 0, 1, 1, 2]) as usize];
        }
        let loops = [Loop::Polled, Loop::Async, Loop::AsyncDropped];
        conditions.runs = loops[one_of(&[0, 0, 1, 2]) as usize];
        // Additions are drawn last, so that the rest of a seed's world stays the same.
        conditions.ends_all = one_of(&[0, 1]) == 1;
        conditions.stops_again = one_of(&[0, 0, 0, 1]) == 1;
        conditions.deaf_to_all = is_can && one_of(&[0, 0, 1]) == 1;
        if conditions.echo != Echo::None {
            let troubles = [Trouble::Lose, Trouble::Corrupt, Trouble::Delay];
            let trouble = troubles.get(one_of(&[0, 1, 2, 3]) as usize);
            conditions.echo_trouble =
                trouble.map(|&trouble| (trouble, one_of(&[1, 5, 20, 50]) as u32));
        }
        conditions.stranger_moves = conditions.stranger && one_of(&[0, 1]) == 1;
        conditions.have_run = one_of(&[0, 1]) == 1;
        conditions.stranger_roams = conditions.stranger && one_of(&[0, 1]) == 1;
        conditions.cuts_master = trouble == Trouble::Cut && one_of(&[0, 1]) == 1;
        Self { trouble, percent, motors, requests, seed, conditions }
    }

    /// The world that this seed drew before there were additions.
    pub(crate) fn as_first_drawn(mut self) -> Self {
        let c = &mut self.conditions;
        (c.ends_all, c.stops_again, c.deaf_to_all) = (false, false, false);
        c.echo_trouble = None;
        (c.stranger_moves, c.stranger_roams, c.have_run) = (false, false, false);
        c.cuts_master = false;
        if c.echo == Echo::Unknown {
            self.keep_the_line_to_the_master();
        }
        self
    }

    /// The same for a master that has to measure how long replies take.
    pub(crate) fn adapting(mut self) -> Self {
        self.conditions.adapts = true;
        self
    }

    /// Nothing sends except drives that are asked.
    fn keep_the_line_to_the_master(&mut self) {
        if self.trouble.is_by_hand() {
            self.trouble = Trouble::Lose;
        }
        let c = &mut self.conditions;
        (c.twins, c.stranger, c.lost_masters, c.reports, c.repeats) =
            (false, false, false, false, false);
    }

    /// The master's configuration, which must allow for frames that are held back for longer than usual.
    pub(crate) fn config<W: Wire>(&self) -> Config {
        let mut config = W::CONFIG;
        if let myactuator_protocol_core::master::Bus::Rs485 { echo, .. } = &mut config.bus {
            *echo = self.conditions.echo == Echo::Configured;
        }
        // On a CAN bus where every other frame breaks, controllers go bus-off and recover. Frames stay in them
        // meanwhile.
        let breaks = matches!(self.trouble, Trouble::Corrupt | Trouble::Undetected);
        if W::NAME == "CAN" && breaks && self.percent >= 50 {
            config.late_window = Duration::from_millis(1_000);
        }
        if self.conditions.coarse_clock {
            config = config.for_clock_step(Duration::from_millis(1));
        }
        if self.conditions.adapts {
            config = config.adapting_up_to(LONGEST_REPLY_TIMEOUT);
        } else if self.conditions.burst_ms > 0 {
            let burst = Duration::from_millis(self.conditions.burst_ms);
            config.reply_timeout = config.reply_timeout + burst;
            config.late_window = config.late_window + burst + burst;
        }
        config
    }

    /// The same with the longest time-outs that it may use. What takes longer than `longest_response` may count as lost
    /// even with the shortest.
    pub(crate) fn longest<W: Wire>(&self) -> Config {
        let config = self.config::<W>();
        let more = config.longest_reply_timeout - config.reply_timeout;
        Config {
            reply_timeout: config.reply_timeout + more,
            late_window: config.late_window + more,
            ..config
        }
    }

    /// The longest delay of a frame.
    fn latest<W: Wire>() -> Duration {
        Duration::from_millis(if W::NAME == "CAN" { 15 } else { 4 })
    }

    pub(crate) fn plan<W: Wire>(&self, direction: Direction) -> FaultPlan {
        let (trouble, percent) = match direction {
            Direction::Echo => self.conditions.echo_trouble.unwrap_or((Trouble::Lose, 0)),
            _ => (self.trouble, self.percent),
        };
        let p = percent as f32 / 100.0;
        let late = Self::latest::<W>();
        let to_ports = direction == Direction::ToPorts;
        let mut plan = FaultPlan {
            delay_min: Duration::from_micros(500),
            delay_max: late,
            reorder_hold: late,
            ..FaultPlan::NONE
        };
        match trouble {
            Trouble::Lose => plan.lose = p,
            Trouble::Corrupt => plan.corrupt = p,
            Trouble::Undetected => (plan.corrupt, plan.undetected) = (p, 0.5),
            Trouble::DoubleReplies => plan.duplicate = if to_ports { p } else { 0.0 },
            Trouble::DoubleAll => plan.duplicate = p,
            Trouble::Delay => plan.delay = p,
            Trouble::Reorder => plan.reorder = p,
            Trouble::All => {
                let fifth = p / 5.0;
                (plan.lose, plan.corrupt, plan.delay, plan.reorder) = (fifth, fifth, fifth, fifth);
                plan.duplicate = if to_ports { fifth } else { 0.0 };
            }
            Trouble::Cut | Trouble::Slow | Trouble::Babble | Trouble::Restart => {}
        }
        plan
    }

    /// Whether nothing can go wrong with any exchange.
    pub(crate) fn is_kind(&self) -> bool {
        let c = &self.conditions;
        let is_odd = c.refuses || c.fails || c.twins || c.stranger || c.restarts || c.lost_masters;
        let is_odd = is_odd || c.reports || c.repeats || c.jumps || c.echo != Echo::None || c.noise;
        let is_late = c.burst_ms > 0 || c.coarse_clock || c.pace == Pace::Flood;
        self.percent == 0 && self.motors < 8 && !is_odd && !is_late
    }
}

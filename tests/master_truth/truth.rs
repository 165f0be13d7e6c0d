//! What really happened: the calls, the commands that the bus took, what drives heard and sent, and the replies. Frames
//! are distinguished by their tokens.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use myactuator_protocol_core::master::{Bus, Config, MotorSet};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Channel, Data, MotorId, Packet, Target};

use super::bounds::{Clocks, Quiet};
use super::doubt::Doubt;
use super::excuses::{Excuse, Excuses};
use super::names::{Name, Question};
use super::restarts::RunTime;
use super::set_points::SetPoints;
use super::stops::{Answers, Offers, StopToAll};
use super::to_all::ToAll;
use super::turning::Turning;

/// Byte 3 of a reply with values: the command was executed, not only handed back.
pub(crate) const DONE: u8 = 0xD0;
/// A motor that was silent for this long may have restarted.
pub(super) const MAY_HAVE_RESTARTED: Duration = Duration::from_secs(1);

/// A bus that takes nothing for this long carries nothing.
pub(super) const STUCK_AFTER: Duration = Duration::from_millis(5);

/// What happened to one command.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sending {
    /// When its caller put it.
    pub(crate) put: u64,
    /// How often the bus took it and did not hand it back.
    pub(crate) taken: u32,
    pub(crate) last_taken: Instant,
    /// It was handed back when its time may have been up, which may not have been reported yet.
    pub(crate) was_lost_and_back: bool,
    /// How often it reached a drive, and how often that drive ignored it.
    pub(crate) heard: u32,
    pub(crate) ignored: u32,
    /// How often it reached a drive since the bus took it last. (All stops have the same name.)
    pub(super) heard_since: u32,
    /// How often a reply to it reached the master.
    pub(crate) delivered: u32,
    /// The last attempt was answered, in time for the strictest of the master's bounds.
    pub(crate) was_answered: bool,
}

impl Sending {
    /// Whether no caller has put it and the bus has not taken it.
    pub(super) fn was_never_put(&self) -> bool {
        self.put == 0 && self.taken == 0
    }
}

/// The truth about one motor.
#[derive(Clone, Debug, Default)]
pub(crate) struct Page {
    pub(crate) sendings: HashMap<Name, Sending>,
    /// Commands with a reply that the bus took.
    pub(crate) asking: u64,
    /// How many of these were handed back when their time may have been up. They are not lost, but may be reported so.
    pub(crate) lost_and_back: u64,
    /// How many of these were handed back after an answer that may have passed for theirs: an answer to another master,
    /// or one that came twice.
    pub(crate) answered_and_back: u64,
    /// When another master was last answered, for each question.
    pub(super) strangers_answered_at: HashMap<Question, Instant>,
    /// When the last command with a reply was taken, and how many in a row were since the motor was heard.
    pub(super) asked_at: Instant,
    pub(super) unanswered: u32,
    /// When the loop last sent it the read that shows an echo.
    pub(super) asked_for_echo_at: Instant,
    /// The last command with a reply was answered in time.
    pub(super) answered_newest: bool,
    pub(super) newest_set_point: u32,
    pub(crate) set_points: SetPoints,
    /// A caller has stopped it and not lifted that, and when.
    pub(crate) is_stopped: bool,
    pub(crate) stop_called: u64,
    pub(super) stop_called_at: Instant,
    /// How well it answered then.
    pub(super) answers: Answers,
    /// The stop is neither confirmed nor given up.
    pub(crate) is_stopping: bool,
    /// A stop may be in flight since then: the command to all that began it may have been dropped meanwhile.
    pub(crate) may_be_stopping: bool,
    /// The stop was reported as unconfirmed. It goes on while it is in force.
    pub(crate) was_given_up: bool,
    pub(crate) may_be_stopping_since: u64,
    /// The drive must have heard a stop after this: after the first call, if others follow before it is lifted.
    pub(super) stop_due_since: u64,
    /// The command that stops it, and others that may be in flight instead.
    pub(crate) stop: Name,
    pub(super) other_stops: Vec<Name>,
    /// The stop before, if that was in flight. A controller may still hand it back.
    pub(super) stop_before: Option<Name>,
    /// It has heard the stop to all. Its answer to that confirms its own stop.
    pub(super) is_told_with_all: bool,
    /// The bus has taken a stop of this motor, and since then nothing that a stop refuses. The first stops of all other
    /// motors come before its next one.
    pub(super) is_told: bool,
    /// How many stops the bus has taken since then.
    pub(super) tellings: u32,
    /// One of these was handed back, and another stop is to follow. The master may take it for that one.
    pub(super) may_be_untold: bool,
    /// The value of `is_told` when this stop was called.
    pub(super) was_told: bool,
    /// The stop may have begun anew, so it is not known which attempt is the first.
    pub(super) is_begun_anew: bool,
    /// When the stop was called, in steady time.
    pub(super) stopping_since: Duration,
    /// When the bus last took a command to restart it, in the world's time.
    pub(super) reset_at: Option<Instant>,
    /// When a caller last stopped it, even if that began nothing.
    pub(super) stop_asked: u64,
    pub(crate) is_confirmed: bool,
    pub(crate) stops_taken: u32,
    pub(crate) stop_heard: u64,
    /// When the newest command that ends motion was put, of those that the bus has taken.
    pub(super) ended: u64,
    /// The same for commands to it alone or stops, and for those that the drive has heard.
    pub(super) ended_alone: u64,
    pub(super) ended_heard: u64,
    /// When a caller's open request that ends motion was put.
    pub(super) ends: Option<u64>,
    /// When a move came out of a mailbox after that request.
    pub(super) moved_behind: u64,
    /// When a caller last put a command to all that ends motion, and when one that switches off.
    pub(super) ended_with_all: u64,
    pub(super) let_go: u64,
    /// When it last heard each command that ends motion, by command byte.
    pub(super) endings_heard: HashMap<u8, u64>,
    /// When it last restarted, if that was not reported yet.
    pub(crate) restarted: Option<u64>,
    /// The master has sent it a command to restart and not reported a restart since.
    pub(crate) was_reset: bool,
    pub(crate) awaits_resume: bool,
    /// A false restart or a wrong angle was reported last, for this reason.
    pub(super) misled: Option<(Excuse, Instant)>,
    pub(crate) turning: Turning,
    pub(crate) run_time: RunTime,
    /// How often the master has heard that the motor has lost it.
    pub(crate) lost_master_delivered: u32,
    /// How many frames of its motion mode were delivered that name another: bits were flipped in them.
    pub(crate) no_feedback: u32,
    /// It has reported that it has lost its master, and none of these messages has reached the master.
    pub(crate) lost_master_untold: bool,
    /// By what has reached the master, it ignores the next command.
    pub(crate) ignores_next: bool,
    pub(crate) reports: HashSet<u32>,
    /// All data that it has answered.
    pub(crate) said: HashSet<Data>,
    /// When the master last heard it.
    pub(crate) delivered_at: Option<Instant>,
    /// The longest time without hearing it since its restart was reported.
    pub(crate) longest_silence: Duration,
    pub(crate) excuses: Excuses,
}

/// The truth about everything. Times are the master's, unless the field says otherwise.
#[derive(Debug)]
pub(crate) struct Truth {
    pub(crate) pages: Vec<Page>,
    /// Counts events, to show which came earlier.
    moment: u64,
    pub(crate) now: Instant,
    /// The same in the world's time.
    pub(super) world: Instant,
    /// How far the master's clock is ahead of the world's, and its step.
    pub(crate) clock_ahead: Duration,
    pub(crate) clock_step: Duration,
    pub(crate) late_window: Duration,
    /// A reply that does not come within this time counts as lost.
    pub(super) reply_timeout: Duration,
    /// A reply that comes within this time does not count as lost.
    pub(super) longest_response: Duration,
    pub(crate) set_point_max_age: Duration,
    pub(super) restart_takes: Duration,
    pub(super) offers: Offers,
    pub(super) stop_to_all: StopToAll,
    /// How often the port has failed or refused.
    pub(crate) failures: u64,
    /// When it last did, or took nothing.
    pub(super) failed: u64,
    /// When no caller had looked for an hour last.
    pub(super) held_up: u64,
    /// The port has failed, and a dropped task may have kept the failure for its next round. Commands that are put
    /// before that round may be dropped in it.
    pub(super) failure_is_kept: bool,
    pub(super) clocks: Clocks,
    /// When the bus last failed or refused a frame although it had room, and when it last took a frame, in the world's
    /// time.
    bus_failed_at: Option<Instant>,
    pub(super) bus_took_at: Instant,
    /// When the bus last took a command to all.
    pub(super) last_to_all: Option<Instant>,
    /// The last command of a caller to all.
    pub(crate) to_all: Option<ToAll>,
    /// The motors that have a place.
    pub(super) known: MotorSet,
    /// Motors that a stop keeps off until it is lifted.
    pub(super) switched_off: MotorSet,
    /// How many motors got their own command instead of one to all that ends motion.
    pub(crate) turned: u64,
    /// An answer to the stop to all confirms a motor's own stop. Not on a line.
    pub(super) stop_to_all_is_answered: bool,
    /// An adapter hands back each command.
    pub(crate) echoes: bool,
    /// Whether an acknowledgement may pass for an echo.
    pub(super) doubt: Doubt,
    /// Two motors have this id.
    pub(crate) twin: Option<MotorId>,
    /// Each motor's first stop comes within this time, if there is such a bound.
    pub(crate) first_stops_within: Option<Duration>,
    /// Flipped bits pass the CRC, so no token can be trusted.
    pub(crate) flips: bool,
    /// The wire changes the order of frames, which no real wire does. So a frame that comes after a command that ends
    /// motion may be older.
    pub(crate) reorders: bool,
    /// The violations found.
    pub(crate) broken: Vec<String>,
    pub(crate) excused: HashMap<Excuse, u64>,
}

/// A shared handle of the truth.
#[derive(Clone, Debug)]
pub(crate) struct Book(Arc<Mutex<Truth>>);

impl Book {
    pub(crate) fn new(config: &Config) -> Self {
        Self(Arc::new(Mutex::new(Truth {
            pages: vec![Page::default(); MotorId::COUNT],
            moment: 0,
            now: Instant::ZERO,
            world: Instant::ZERO,
            clock_ahead: Duration::ZERO,
            clock_step: Duration::from_micros(1),
            late_window: config.late_window,
            reply_timeout: config.reply_timeout,
            longest_response: config.longest_response.min(config.reply_timeout),
            set_point_max_age: config.set_point_max_age,
            restart_takes: config.restart_time,
            offers: Offers::new(config),
            stop_to_all: StopToAll::default(),
            failures: 0,
            failed: 0,
            held_up: 0,
            failure_is_kept: false,
            clocks: Clocks::default(),
            bus_failed_at: None,
            bus_took_at: Instant::ZERO,
            last_to_all: None,
            to_all: None,
            known: MotorSet::EMPTY,
            switched_off: MotorSet::EMPTY,
            turned: 0,
            stop_to_all_is_answered: config.bus == Bus::Can,
            echoes: false,
            doubt: Doubt::of(config),
            twin: None,
            first_stops_within: None,
            flips: false,
            reorders: false,
            broken: Vec::new(),
            excused: HashMap::new(),
        })))
    }

    /// Locks the truth. Do not hold the guard while the world runs.
    pub(crate) fn open(&self) -> MutexGuard<'_, Truth> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Page {
    /// Whether it has restarted as far as a caller can know, so that nothing may move it.
    pub(crate) fn has_restarted(&self) -> bool {
        self.awaits_resume || self.turning.has_jumped()
    }

    pub(crate) fn waits_for_first_stop(&self) -> bool {
        let is_told = self.stops_taken > 0 || self.is_told || self.is_told_with_all;
        self.is_stopping && !is_told
    }

    /// Notes that this command stops it, unless it was dropped.
    pub(super) fn may_be_stopping(&mut self, stop: Name, since: u64) {
        if self.is_stopping {
            self.is_begun_anew = true;
        } else {
            self.may_be_untold &= self.stops_taken == 0;
            (self.may_be_stopping, self.stops_taken) = (true, 0);
            self.was_told = self.is_told;
            self.is_told_with_all = false;
        }
        self.other_stops.push(self.stop);
        (self.stop, self.may_be_stopping_since) = (stop, since);
        self.set_points.may_be_dropped();
    }
}

impl Truth {
    pub(crate) fn next_moment(&mut self) -> u64 {
        self.moment += 1;
        self.moment
    }

    /// Takes the world's time, and returns what the master's clock shows.
    pub(crate) fn tick(&mut self, world: Instant) -> Instant {
        self.world = world;
        let exact = (world + self.clock_ahead).as_micros();
        self.now = Instant::from_micros(exact - exact % self.clock_step.as_micros());
        self.now
    }

    /// When the master's clock shows this or more, in the world's time.
    pub(crate) fn world_time(&self, shown: Instant) -> Instant {
        let step = self.clock_step.as_micros();
        let shown = shown.as_micros().div_ceil(step).saturating_mul(step);
        Instant::from_micros(shown.saturating_sub(self.clock_ahead.as_micros()))
    }

    pub(super) fn page(&mut self, motor: MotorId) -> &mut Page {
        &mut self.pages[motor.index()]
    }

    pub(crate) fn breaks(&mut self, what: impl Into<String>) {
        // A few are enough. Thousands would follow.
        if self.broken.len() < 5 {
            self.broken.push(what.into());
        }
    }

    /// A caller has put this command.
    pub(crate) fn put(&mut self, motor: MotorId, channel: Channel, data: &Data) {
        let (put, now, max_age) = (self.next_moment(), self.now, self.set_point_max_age);
        let failure_is_kept = self.failure_is_kept;
        let name = Name::of(&Packet { channel, data: *data });
        let page = self.page(motor);
        page.sendings.entry(name).or_default().put = put;
        if name.is_set_point() {
            page.set_points.put(name.token, now, max_age);
            page.set_points.put_at = put;
            if failure_is_kept {
                page.set_points.may_be_dropped();
            }
        } else if name.is_ending() {
            page.ends = Some(put);
            page.set_points.may_be_dropped();
        }
    }

    /// Whether this is one of the master's own stops, or a command to all that ends motion and goes to each motor
    /// separately.
    pub(super) fn is_stop(&self, packet: &Packet) -> bool {
        let name = Name::of(packet);
        let is_turned = |page: &Page| {
            name.is_ending() && (page.stop == name || page.other_stops.contains(&name))
        };
        name.is_stop()
            || matches!(packet.channel, Channel::Command(Target::Motor(motor)) if is_turned(&self.pages[motor.index()]))
    }

    /// The excuse for a doubled frame of this motor.
    pub(crate) fn doubled(&self, motor: MotorId) -> Excuse {
        if self.twin == Some(motor) { Excuse::TwoMotorsOfOneId } else { Excuse::Doubled }
    }

    /// A drive or the bus has doubled a frame of this motor.
    pub(crate) fn was_doubled(&mut self, motor: MotorId) {
        let (excuse, now, window) = (self.doubled(motor), self.now, self.late_window);
        self.page(motor).excuses.note_doubling(excuse, now, window);
    }

    pub(crate) fn has_restarted(&mut self, motor: MotorId) {
        let moment = self.next_moment();
        let page = self.page(motor);
        page.restarted = Some(moment);
        page.run_time.begins_at_zero();
    }

    /// No caller has looked for an hour. What was to move since before that is too old.
    pub(crate) fn was_held_up(&mut self) {
        self.held_up = self.next_moment();
        self.command_to_all_may_be_dropped();
        self.no_offer_was_possible();
    }

    /// The port has failed or refused. Pending commands may be dropped.
    pub(crate) fn port_has_failed(&mut self) {
        self.pages.iter_mut().for_each(|page| page.set_points.may_be_dropped());
        self.command_to_all_may_be_dropped();
        (self.failures, self.failed) = (self.failures + 1, self.next_moment());
        self.doubt.port_has_failed();
    }

    /// The port has failed while receiving.
    pub(crate) fn receiving_has_failed(&mut self) {
        self.port_has_failed();
        self.bus_has_failed();
        self.failure_is_kept = true;
    }

    /// The loop has reported a failure, so it keeps none. If it has kept one, the failure comes when it is reported.
    pub(crate) fn failure_is_told(&mut self) {
        if std::mem::take(&mut self.failure_is_kept) {
            self.failed = self.next_moment();
        }
    }

    /// The port is full. If that lasts, the bus has failed.
    pub(crate) fn port_is_full(&mut self) {
        self.failed = self.next_moment();
        if self.world - self.bus_took_at > STUCK_AFTER {
            self.bus_has_failed();
        }
    }

    /// The port has an error, or takes nothing although it has room.
    pub(crate) fn bus_has_failed(&mut self) {
        self.bus_failed_at = Some(self.world);
        self.clocks.disturb(Quiet::None);
    }

    /// Whether the bus carries frames, and has done so for so long that nothing from before a failure may still come.
    pub(super) fn is_steady(&self) -> bool {
        self.bus_failed_at.is_none_or(|at| self.world - at > self.late_window)
    }

    pub(crate) fn excuse(&mut self, excuse: Excuse) {
        *self.excused.entry(excuse).or_default() += 1;
    }
}

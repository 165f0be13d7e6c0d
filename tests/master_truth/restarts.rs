//! What shows that a motor has restarted, besides its turns: how long it was silent, and its run time.

use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Data, MotorId};

use super::excuses::Excuse;
use super::truth::{MAY_HAVE_RESTARTED, Sending, Truth};

/// A run time wraps after this many milliseconds.
pub(super) const WRAPS_MS: u64 = 1 << 32;
/// After this long a run time shows nothing.
const IS_OLD: i64 = 48 * 24 * 3_600 * 1_000_000;
/// A drive's clock may differ by this much plus one part in this many. Steps of clocks are allowed for.
const CLOCKS_DIFFER: i64 = 250_000;
const CLOCKS_DIFFER_BY: i64 = 64;
const STEPS: i64 = 10_000;
/// By then a restart is reported: its event waits for earlier events, and for a caller that does not look.
pub(super) const RESTART_IS_TOLD: Duration = Duration::from_millis(50);

/// What is known about how long a drive has run.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RunTime {
    /// Since when the drive runs as far as the master knows, by the master's clock, in microseconds.
    since: Option<i64>,
    /// A restart was reported before the drive was ever heard. It may not have been there.
    is_unheard: bool,
    /// When its run time showed a restart that was not reported yet.
    shown: Option<Instant>,
    /// When it wraps, in the world's time, unless the master has read it since.
    begins_anew: Option<Instant>,
    /// The master knows how long the drive has run: it has read that, and no possible restart was reported since.
    is_known: bool,
    /// When it was first read after it had wrapped, by the master's clock.
    read_anew: Option<Instant>,
}

impl RunTime {
    /// How long the drive had run when the world began.
    pub(crate) fn had_run(&mut self, ran_ms: u64) {
        self.begins_anew = Some(Instant::from_millis(WRAPS_MS - ran_ms));
    }

    /// The drive restarts and counts from 0.
    pub(crate) fn begins_at_zero(&mut self) {
        self.begins_anew = None;
    }

    /// An answer of the drive was reported.
    fn is_there(&mut self, now: Instant) {
        let now = now.as_micros() as i64;
        let since = self.since.get_or_insert(now);
        if std::mem::take(&mut self.is_unheard) {
            *since = now.max(*since);
        }
    }

    /// A restart is reported, which may last until `until`. `was_heard`: whether the drive was heard before.
    fn restarted(&mut self, until: Instant, was_heard: bool) {
        self.is_unheard = !was_heard;
        (self.since, self.shown) = (Some(until.as_micros() as i64), None);
        self.is_known = false;
    }

    /// Its run time is reported, in answer to a command of the time `sent`.
    fn read(&mut self, ran_ms: u32, sent: Instant, now: Instant, world: Instant, shows: bool) {
        let ran = i64::from(ran_ms) * 1_000;
        let least = self.since.map_or(0, |since| sent.as_micros() as i64 - since);
        let most = ran + ran / CLOCKS_DIFFER_BY + CLOCKS_DIFFER + STEPS;
        if shows && (most..IS_OLD).contains(&least) {
            self.shown.get_or_insert(now);
        }
        self.since = Some(now.as_micros() as i64 - ran);
        let has_begun_anew = self.begins_anew.take_if(|at| *at <= world).is_some();
        let was_known = std::mem::replace(&mut self.is_known, true);
        self.read_anew = (has_begun_anew && !was_known).then_some(now);
    }

    /// Whether it may show less than the drive has run, which no master can know.
    fn may_have_begun_anew(&self, now: Instant, world: Instant) -> bool {
        !self.is_known && self.begins_anew.is_some_and(|at| at <= world)
            || self.read_anew.is_some_and(|at| now - at <= RESTART_IS_TOLD)
    }

    /// Whether a restart that it shows was not reported in time.
    pub(crate) fn is_restart_untold(&self, now: Instant) -> bool {
        self.shown.is_some_and(|since| now - since > RESTART_IS_TOLD)
    }
}

/// An answer of this motor to a request of a caller is reported.
pub(super) fn note_answered(motor: MotorId, data: &Data, of: &Sending, truth: &mut Truth) {
    let (now, world) = (truth.now, truth.world);
    let is_clear = !truth.flips && truth.twin != Some(motor);
    let page = truth.page(motor);
    page.run_time.is_there(now);
    if data[0] != 0xB1 {
        return;
    }
    let ran_ms = u32::from_le_bytes([data[4], data[5], data[6], data[7]]);
    // One of several attempts may have been answered, and a made-up answer shows nothing.
    let is_its_own = of.taken == 1 && of.delivered == 1 && of.ignored == 0;
    let is_plain = is_clear && is_its_own && page.excuses.of((0xB1, 0), now).is_none();
    let shows = is_plain && page.restarted.is_some();
    page.run_time.read(ran_ms, of.last_taken, now, world, shows);
}

/// A restart is reported. The motor must have restarted, or must not have been heard for a second.
pub(super) fn check_restarted(motor: MotorId, truth: &mut Truth) {
    let (now, world, restart_takes) = (truth.now, truth.world, truth.restart_takes);
    let page = &mut truth.pages[motor.index()];
    // The frame that ends the silence may be an answer that looks like an echo.
    let silence = page.delivered_at.map_or(MAY_HAVE_RESTARTED, |before| truth.now - before);
    let may_have = std::mem::take(&mut page.longest_silence).max(silence) >= MAY_HAVE_RESTARTED;
    let has = page.restarted.take().is_some() | std::mem::take(&mut page.was_reset);
    // Other causes:
    // - a run time of 0, handed back by a drive that has ignored the question;
    // - old feedback that a bus has held back for longer than expected;
    // - feedback that another station has made up, also in motion mode (0).
    let misleading =
        [0xB1, 0xA2, 0xA4, 0].into_iter().find_map(|byte| page.excuses.of((byte, 0), now));
    let may_seem_so = page.turning.may_seem_to_jump(now);
    // From a made-up angle it jumps back. This may also be the jump to that angle.
    let was_misled = page.misled.take();
    let is_there = was_misled.filter(|(_, told)| now - *told <= RESTART_IS_TOLD);
    let is_misled = misleading.filter(|_| !may_have && !has).map(|excuse| (excuse, now));
    page.misled = is_misled.or(is_there);
    let misleading = misleading.or(was_misled.map(|(excuse, _)| excuse));
    let may_have_begun_anew = page.run_time.may_have_begun_anew(now, world);
    page.awaits_resume = true;
    page.run_time.restarted(now + restart_takes, page.delivered_at.is_some());
    page.set_points.restarted();
    page.turning.restarted();
    if truth.twin == Some(motor) && !may_have && !has {
        // The run times of two drives: one may be less than the other.
        truth.excuse(Excuse::TwoMotorsOfOneId);
    } else if let Some(excuse) = misleading.filter(|_| !may_have && !has) {
        truth.excuse(excuse);
    } else if may_have_begun_anew && !may_have && !has {
        truth.excuse(Excuse::RunTimeBeganAnew);
    } else if may_seem_so && !may_have && !has {
        truth.excuse(Excuse::FastAndLate);
    } else if !may_have && !has && !truth.flips {
        truth.breaks(format!("motor {motor} has not restarted"));
    }
}

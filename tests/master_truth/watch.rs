//! Checks that everything ends in time, and that `poll_at` is right.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::time::{Duration, Instant};

use super::bounds::{Quiet, is_ending};
use super::callers::Session;
use super::oracle::{Open, is_move};
use super::scenarios::Trouble;
use super::truth::Page;
use super::world::Rough;

/// How often this is checked.
const WATCHED_EVERY: Duration = Duration::from_millis(1);

impl<W: Rough> Session<W> {
    /// Everything in flight must end in time.
    pub(super) fn watch(&mut self) {
        let now = self.now();
        if now - self.watched_at < WATCHED_EVERY {
            return;
        }
        self.watched_at = now;
        // On a line a babbler does not keep others from sending. On CAN it may win each arbitration.
        let is_bus_full =
            W::NAME == "CAN" && self.scenario.trouble == Trouble::Babble && self.mischief.is_some();
        let is_free = self.oracle.broadcast.is_none();
        let mut truth = self.stage.book.open();
        truth.tick(now);
        let pages = || truth.pages.iter().take(self.scenario.motors.into());
        let ends = |open: &Option<Open>| open.is_some_and(|open| is_ending(&open.data));
        let waits_to_move = self.oracle.broadcast.is_some_and(|asked| is_move(&asked.data));
        let is_held_back = waits_to_move && self.oracle.open.iter().any(ends);
        let is_calm =
            !is_held_back && !pages().any(|page| page.is_stopping || page.may_be_stopping);
        let calm = match () {
            () if is_bus_full || !truth.is_steady() => Quiet::None,
            () if !is_calm => Quiet::Steady,
            () if !is_free => Quiet::Calm,
            () => Quiet::Free,
        };
        truth.clocks.pass(now, calm);
        let clocks = truth.clocks;
        let pages = || truth.pages.iter().take(self.scenario.motors.into());
        let mut slowest = self.oracle.totals.slowest;
        let mut check = |which: usize, took: Duration, longest: Duration| {
            slowest[which] = slowest[which].max(took.as_micros() * 100 / longest.as_micros());
            (took > longest).then(|| format!("takes {took} and not {longest}"))
        };
        let mut hangs = Vec::new();
        for (page, motor) in pages().zip(MotorId::all()) {
            if let Some(open) = self.oracle.open[motor.index()] {
                let (begun, longest) = self.limits[motor.index()];
                let restart = self.bounds.restart();
                let since = self.since[motor.index()];
                let rests = page.reset_at.is_some_and(|at| at + restart > since);
                let longest = if rests { longest + restart } else { longest };
                let late = check(0, clocks.free - begun, longest);
                hangs.extend(late.map(|late| format!("motor {motor}: {open:?} {late}")));
            }
            if page.is_stopping {
                let late = check(2, clocks.steady - page.stopping_since, self.bounds.stop());
                hangs.extend(late.map(|late| format!("motor {motor}: its stop {late}")));
            }
        }
        if let Some(asked) = self.oracle.broadcast {
            let (longest, restart) = (self.bounds.broadcast(), self.bounds.restart());
            // A Shutdown that waits for the end of a restart comes before a command that holds all.
            let rested = |page: &Page| page.reset_at.is_some_and(|at| at + restart + longest > now);
            let longest = if pages().any(rested) { longest + restart } else { longest };
            let late = check(1, clocks.calm - self.all_asked_since, longest);
            hangs.extend(late.map(|late| format!("{asked:?} {late}")));
        }
        hangs.into_iter().for_each(|what| truth.breaks(what));
        drop(truth);
        self.oracle.totals.slowest = slowest;
    }

    /// After a round at this time nothing may be due any more, unless the port has not taken it. Something that became
    /// due because of what the round sent may be left to the next round.
    pub(super) fn check_wake(&mut self, now: Instant, failures: u64) {
        let at = self.stage.host.wakes_at().filter(|at| *at <= now);
        let mut truth = self.stage.book.open();
        let is_due = at.is_some() && truth.failures == failures;
        if std::mem::replace(&mut self.is_left_due, is_due) && is_due {
            truth.breaks(format!("{at:?} was due after two rounds, the last at {now:?}"));
        }
    }
}

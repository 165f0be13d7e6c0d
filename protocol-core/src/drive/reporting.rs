//! What a drive sends on its own: active replies (0xB6), error reports (function 3) and the heartbeat of a lost master
//! (a quirk), as [`decisions`](super::decisions) says.

use heapless::Vec;

use crate::opcode::Opcode;
use crate::time::{Duration, Instant};
use crate::units::ReportInterval;

const ERROR_INTERVAL: Duration = Duration::from_millis(100);
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);

/// Something that happens at an interval.
#[derive(Clone, Copy, Debug)]
struct Timer {
    due: Instant,
    interval: Duration,
}

impl Timer {
    /// Whether it is due; if so, sets it again. A late caller gets no more than one.
    fn is_due(&mut self, now: Instant) -> bool {
        let due = self.due <= now;
        if due {
            let next = self.due + self.interval;
            self.due = if next > now { next } else { now + self.interval };
        }
        due
    }
}

/// What is to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Report {
    Status1,
    Heartbeat,
    Active(Opcode),
}

#[derive(Clone, Debug, Default)]
pub(super) struct Reporting {
    commands: Vec<Opcode, 7>,
    active: Option<Timer>,
    errors_wanted: bool,
    errors: Option<Timer>,
    heartbeat: Option<Timer>,
}

impl Reporting {
    pub(super) fn enable(&mut self, opcode: Opcode, interval: ReportInterval, now: Instant) {
        if !self.reports(opcode) {
            let _ = self.commands.push(opcode);
        }
        let interval = Duration::from_millis(u64::from(interval.raw().max(1)) * 10);
        self.active = Some(Timer { due: now + interval, interval });
    }

    pub(super) fn disable(&mut self, opcode: Opcode) {
        self.commands.retain(|&reported| reported != opcode);
        if self.commands.is_empty() {
            self.active = None;
        }
    }

    /// Whether this is reported actively.
    pub(super) fn reports(&self, opcode: Opcode) -> bool {
        self.commands.contains(&opcode)
    }

    /// Whether anything is reported actively.
    pub(super) fn is_on(&self) -> bool {
        !self.commands.is_empty()
    }

    pub(super) fn set_errors_wanted(&mut self, wanted: bool) {
        self.errors_wanted = wanted;
    }

    pub(super) const fn errors_wanted(&self) -> bool {
        self.errors_wanted
    }

    /// Takes over what lasts: whether there is an error, whether the master is lost.
    pub(super) fn follow(&mut self, error: bool, master_lost: bool, now: Instant) {
        let keep = |lasts: bool, timer: Option<Timer>, interval| {
            lasts.then(|| timer.unwrap_or(Timer { due: now, interval }))
        };
        self.errors = keep(error && self.errors_wanted, self.errors, ERROR_INTERVAL);
        self.heartbeat = keep(master_lost, self.heartbeat, HEARTBEAT_INTERVAL);
    }

    /// What is due, errors first.
    pub(super) fn poll(&mut self, now: Instant) -> Option<Report> {
        let due = |timer: &mut Option<Timer>| timer.as_mut().is_some_and(|timer| timer.is_due(now));
        if due(&mut self.errors) {
            Some(Report::Status1)
        } else if due(&mut self.heartbeat) {
            Some(Report::Heartbeat)
        } else if due(&mut self.active) {
            let next = self.commands.first().copied();
            self.commands.rotate_left(usize::from(next.is_some()));
            next.map(Report::Active)
        } else {
            None
        }
    }

    /// When the next is due.
    pub(super) fn poll_at(&self) -> Option<Instant> {
        [self.errors, self.heartbeat, self.active].into_iter().flatten().map(|t| t.due).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    #[test]
    fn a_late_caller_gets_one_and_not_all_that_it_missed() {
        let mut reporting = Reporting::default();
        reporting.enable(Opcode::ReadStatus2, ReportInterval::from_raw(1), at(0));
        assert!(reporting.poll(at(105)).is_some());
        assert_eq!(reporting.poll(at(105)), None);
        assert_eq!(reporting.poll_at(), Some(at(115)));
        reporting.disable(Opcode::ReadStatus2);
        assert_eq!(reporting.poll_at(), None);
    }

    #[test]
    fn an_interval_of_zero_is_the_shortest() {
        let mut reporting = Reporting::default();
        reporting.enable(Opcode::ReadStatus2, ReportInterval::from_raw(0), at(0));
        assert_eq!(reporting.poll_at(), Some(at(10)));
    }
}

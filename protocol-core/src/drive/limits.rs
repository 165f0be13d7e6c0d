//! What keeps the current from being what the loops want. Reports when that begins and when it ends.

use crate::drive::event::Limit;
use crate::drive::{Actuation, Drive, Event, Memory, Plant};
use crate::time::Duration;

/// How long a limit must act, or no longer act, before that is reported.
const CONFIRM: Duration = Duration::from_millis(10);
/// From this share of its limit on, a current counts as being at the limit.
const AT_LIMIT: f32 = 0.999;
/// The supply's voltage is the limit if more than this share of the drive's current is missing.
const MISSING: f32 = 0.05;

/// One control step, as far as it concerns limits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// What the loops ask for, A.
    pub(super) wanted_a: f32,
    /// What flows, A.
    pub(super) flows_a: f32,
    /// The command's limit, not above that of the drive, A.
    pub(super) limit_a: f32,
    /// The drive's own limit at its present temperature, A.
    pub(super) largest_a: f32,
    /// The drive's own limit when cold, A.
    pub(super) stall_a: f32,
}

impl Step {
    fn limit(self) -> Option<Limit> {
        let direction = if self.wanted_a < 0.0 { -1.0 } else { 1.0 };
        let missing_a = self.wanted_a.abs() - self.flows_a * direction;
        if missing_a > MISSING * self.stall_a {
            Some(Limit::Voltage)
        } else if self.wanted_a.abs() < AT_LIMIT * self.limit_a {
            None
        } else if self.limit_a < self.largest_a {
            Some(Limit::CommandTorque)
        } else if self.largest_a < self.stall_a {
            Some(Limit::Temperature)
        } else {
            Some(Limit::StallCurrent)
        }
    }
}

/// What may act: nothing, or a limit.
const ALL: [Option<Limit>; 5] = [
    None,
    Some(Limit::CommandTorque),
    Some(Limit::StallCurrent),
    Some(Limit::Temperature),
    Some(Limit::Voltage),
];

/// Which limit acts, as last reported.
#[derive(Clone, Debug, Default)]
pub(super) struct Limits {
    told: Option<Limit>,
    /// For how long each of [`ALL`] has acted since the reported one last did.
    acted: [Duration; ALL.len()],
}

impl Limits {
    /// Takes a step of length `span`; `None` with the output off. If the limit has changed, returns the one that has
    /// ended and the one that has begun.
    pub(super) fn observe(
        &mut self,
        step: Option<Step>,
        span: Duration,
    ) -> Option<(Option<Limit>, Option<Limit>)> {
        let now = step.and_then(Step::limit);
        if now == self.told {
            self.acted = Default::default();
            return None;
        }
        let mut changed = Duration::ZERO;
        for (acted, limit) in self.acted.iter_mut().zip(ALL) {
            if limit == now {
                *acted = *acted + span;
            }
            changed = changed + *acted;
        }
        // An output that is off is no longer limited.
        if changed < CONFIRM && step.is_some() {
            return None;
        }
        let acted = core::mem::take(&mut self.acted);
        let longest = acted.iter().zip(ALL).max_by_key(|&(acted, _)| acted);
        let begun = step.and(longest).and_then(|(_, limit)| limit);
        let ended = core::mem::replace(&mut self.told, begun);
        Some((ended, begun))
    }
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// The largest current at the present temperature, A.
    pub(super) fn largest_a(&self) -> f32 {
        let share = self.parameters.derating.map_or(1.0, |it| it.share(&self.measurement));
        self.parameters.stall_current_a * share
    }

    /// Reports which limit of the current begins to act, and which ends.
    pub(super) fn watch_limits(&mut self, actuation: &Actuation, span: Duration) {
        let stall_a = self.parameters.stall_current_a;
        let largest_a = self.largest_a();
        let step = actuation.output_on.then(|| Step {
            wanted_a: actuation.current_a,
            flows_a: self.measurement.current_a,
            limit_a: self.controller.limit_a().min(largest_a),
            largest_a,
            stall_a,
        });
        if let Some((ended, begun)) = self.limits.observe(step, span) {
            let ended = ended.map(Event::Unlimited);
            let begun = begun.map(Event::Limited);
            [ended, begun].into_iter().flatten().for_each(|event| self.events.push(event));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FREE: Step =
        Step { wanted_a: 1.0, flows_a: 1.0, limit_a: 12.0, largest_a: 12.0, stall_a: 12.0 };
    const STALL: Step = Step { wanted_a: -12.0, flows_a: -12.0, ..FREE };

    /// What is reported in this many steps of 1 ms, and when.
    fn reported(
        limits: &mut Limits,
        step: Option<Step>,
        millis: u32,
    ) -> Option<(u32, Option<Limit>)> {
        let span = Duration::from_millis(1);
        let changes = (1..=millis).map(|at| (at, limits.observe(step, span)));
        let mut changes = changes.filter_map(|(at, change)| Some((at, change?.1)));
        let first = changes.next();
        assert_eq!(changes.next(), None);
        first
    }

    #[test]
    fn limit_is_reported_when_it_begins_and_when_it_ends() {
        let mut limits = Limits::default();
        assert_eq!(reported(&mut limits, Some(FREE), 100), None);
        assert_eq!(reported(&mut limits, Some(STALL), 9), None);
        assert_eq!(reported(&mut limits, Some(FREE), 1), None);
        assert_eq!(reported(&mut limits, Some(STALL), 100), Some((10, Some(Limit::StallCurrent))));
        assert_eq!(reported(&mut limits, Some(FREE), 100), Some((10, None)));
        assert_eq!(reported(&mut limits, Some(STALL), 10), Some((10, Some(Limit::StallCurrent))));
        assert_eq!(reported(&mut limits, None, 100), Some((1, None)));
    }

    #[test]
    fn longest_acting_of_alternating_limits_is_reported() {
        let starved = Some(Step { flows_a: -6.0, ..STALL });
        let mut limits = Limits::default();
        assert_eq!(reported(&mut limits, starved, 9), None);
        assert_eq!(reported(&mut limits, Some(STALL), 1), Some((1, Some(Limit::Voltage))));
        assert_eq!(reported(&mut limits, Some(STALL), 10), Some((10, Some(Limit::StallCurrent))));
        // For most of the time nothing limits it.
        assert_eq!(reported(&mut limits, starved, 4), None);
        assert_eq!(reported(&mut limits, Some(FREE), 6), Some((6, None)));
    }

    #[test]
    fn each_limit_has_its_name() {
        let by_command = Step { limit_a: 1.0, ..FREE };
        assert_eq!(by_command.limit(), Some(Limit::CommandTorque));
        let hot = Step { limit_a: 0.5, largest_a: 0.5, ..FREE };
        assert_eq!(hot.limit(), Some(Limit::Temperature));
        let starved = Step { wanted_a: -10.0, flows_a: -9.0, ..FREE };
        assert_eq!(starved.limit(), Some(Limit::Voltage));
        let driven_back = Step { wanted_a: 1.0, flows_a: -1.0, ..FREE };
        assert_eq!(driven_back.limit(), Some(Limit::Voltage));
        assert_eq!(Step { flows_a: 0.9, ..FREE }.limit(), None);
    }
}

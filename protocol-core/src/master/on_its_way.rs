//! Until when something that was sent may still reach a drive, though nobody waits for it.

use crate::master::Config;
use crate::time::Instant;

#[derive(Clone, Copy, Debug, Default)]
pub(super) enum OnItsWay {
    /// It has, or never will.
    #[default]
    No,
    /// The bus is whole: not after this.
    Until(Instant),
    /// Not after this on a whole bus. But nothing was heard since, apart from what was on its way to us: the bus may
    /// be cut, and this in a mailbox for as long as that lasts.
    WhileCut(Instant),
    /// It was over then by time alone. If the bus was cut meanwhile, it lies in a mailbox yet: until something is heard.
    OverByTime(Instant),
}

impl OnItsWay {
    /// Something more may come until then; where the bus may be cut, for as long as it is.
    #[inline(never)]
    pub(super) fn put(&mut self, until: Instant, may_be_cut: bool) {
        let until = self.end_on_whole_bus().map_or(until, |at| at.max(until));
        *self = if may_be_cut { Self::WhileCut(until) } else { Self::Until(until) };
    }

    pub(super) fn is_any(self) -> bool {
        self.end_on_whole_bus().is_some()
    }

    /// When it is over, if time alone ends it.
    pub(super) fn end(self) -> Option<Instant> {
        match self {
            Self::Until(at) => Some(at),
            Self::No | Self::WhileCut(_) | Self::OverByTime(_) => None,
        }
    }

    /// When it is over unless the bus is cut.
    pub(super) fn end_on_whole_bus(self) -> Option<Instant> {
        match self {
            Self::No | Self::OverByTime(_) => None,
            Self::Until(at) | Self::WhileCut(at) => Some(at),
        }
    }

    /// The bus carries nothing: it comes later.
    pub(super) fn extend(&mut self, until: Instant) {
        if let Self::Until(at) | Self::WhileCut(at) = self {
            *at = until.max(*at);
        }
    }

    /// The bus is whole: if it lay in a mailbox all the time, it comes now.
    pub(super) fn note_bus_alive(&mut self, now: Instant, config: &Config) {
        if let Self::WhileCut(at) = *self {
            *self = Self::Until(at.max(now + config.late_window));
        }
    }

    /// Takes note of the time. Something was last heard at `heard_at`: what was on its way to us before the bus was
    /// cut is heard within the usual time-out.
    #[inline(never)]
    pub(super) fn age(&mut self, now: Instant, heard_at: Instant, config: &Config) {
        if self.end_on_whole_bus().is_some_and(|end| heard_at + config.late_window >= end) {
            self.note_bus_alive(heard_at, config);
        }
        if let Some(end) = self.end().filter(|&end| end <= now) {
            *self = Self::OverByTime(end);
        }
        if matches!(self, Self::OverByTime(at) if *at <= heard_at) {
            *self = Self::No;
        }
    }

    /// The drive has answered what ends its motion: nothing from before comes any more.
    pub(super) fn finish(&mut self) {
        *self = Self::No;
    }
}

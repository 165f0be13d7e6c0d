//! Until when something that was sent may still reach a drive, although nothing waits for it.

use crate::master::Config;
use crate::time::Instant;

#[derive(Clone, Copy, Debug, Default)]
pub(super) enum OnItsWay {
    /// It has arrived, or never will.
    #[default]
    No,
    /// The bus is intact: it arrives by then, or never.
    Until(Instant),
    /// On an intact bus it arrives by then, or never. But nothing was heard since, except for what was already on its
    /// way to us. The bus may be cut, and this may stay in a mailbox for as long as that lasts.
    WhileCut(Instant),
    /// Over since then, by time alone. If the bus was cut meanwhile, this may still be in a mailbox, until something is
    /// heard.
    OverByTime(Instant),
}

impl OnItsWay {
    /// Something more was due by then, and may arrive later or, if the bus may be cut, for as long as it is.
    #[inline(never)]
    pub(super) fn put(&mut self, due: Instant, may_be_cut: bool, config: &Config) {
        let until = due + config.late_window;
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

    /// It may have been due only by then.
    pub(super) fn extend(&mut self, due: Instant, config: &Config) {
        if let Self::Until(at) | Self::WhileCut(at) = self {
            *at = (due + config.late_window).max(*at);
        }
    }

    /// The bus is intact: if it was still in a mailbox, it leaves that now.
    pub(super) fn note_bus_alive(&mut self, now: Instant, config: &Config) {
        if let Self::WhileCut(at) = *self {
            *self = Self::Until(at.max(now + config.late_window));
        }
    }

    /// Takes note of the time. Something was last heard at `heard_at`. What was on its way to us before a cut is heard
    /// within the usual time-out.
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
}

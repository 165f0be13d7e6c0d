//! The configuration as a master keeps it.

use crate::firmware::Firmware;
use crate::kind::Kind;
use crate::master::config::{Bus, Config, Patience};
use crate::master::ticks::Span;
use crate::opcode::{Opcode, Repeat};
use crate::time::Duration;

/// The bus, and what an adapter hands back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wire {
    Can,
    Rs485,
    EchoingRs485,
}

/// [`Config`] in as few bytes as it takes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Compact {
    pub(super) wire: Wire,
    pub(super) firmware: Firmware,
    pub(super) turnaround_us: u16,
    pub(super) timeout: Span,
    pub(super) attempts: u8,
    pub(super) frame_us: u16,
    pub(super) shortest_us: u16,
    pub(super) longest_us: u16,
    pub(super) late_ms: u16,
    pub(super) max_age_ms: u16,
    pub(super) restart_ms: u16,
    pub(super) settle: Span,
}

/// A span in microseconds, or the longest that fits.
#[inline(never)]
fn micros(span: Duration) -> u16 {
    span.as_micros().min(u16::MAX.into()) as u16
}

/// A span in milliseconds, rounded up, at most 30 s.
#[inline(never)]
fn millis(span: Duration) -> u16 {
    // Cut off first: a microcontroller has no division of 64 bits.
    (span.as_micros().min(30_000_000) as u32).div_ceil(1000) as u16
}

impl Compact {
    pub(super) fn new(config: &Config) -> Self {
        let (wire, turnaround) = match config.bus {
            Bus::Can => (Wire::Can, Duration::ZERO),
            Bus::Rs485 { turnaround, echo: false } => (Wire::Rs485, turnaround),
            Bus::Rs485 { turnaround, echo: true } => (Wire::EchoingRs485, turnaround),
        };
        Self {
            wire,
            firmware: config.firmware,
            turnaround_us: micros(turnaround),
            timeout: Span::from_duration(config.reply_timeout),
            attempts: config.attempts,
            frame_us: micros(config.frame_time),
            shortest_us: micros(config.shortest_response),
            longest_us: micros(config.longest_response),
            late_ms: millis(config.late_window),
            max_age_ms: millis(config.set_point_max_age),
            restart_ms: millis(config.restart_time),
            settle: Span::from_duration(config.settle_time),
        }
    }

    pub(super) fn is_rs485(&self) -> bool {
        self.wire != Wire::Can
    }

    pub(super) fn late_window(&self) -> Duration {
        Duration::from_millis(self.late_ms.into())
    }

    pub(super) fn patience(&self, kind: Kind) -> Patience {
        let attempts = match kind.repeat() {
            Repeat::Harmless => self.attempts,
            Repeat::Stale | Repeat::ActsAgain => 1,
        };
        Patience { reply_timeout: self.timeout.duration(), attempts }
    }

    /// How long a motor is left alone after a command without reply.
    pub(super) fn hold_after(&self, kind: Kind) -> Duration {
        if kind == Kind::Known(Opcode::Reset) {
            Duration::from_millis(self.restart_ms.into())
        } else {
            self.settle.duration()
        }
    }
}

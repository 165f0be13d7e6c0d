//! What a motor reports unasked, as 0xB6 told it to.

use crate::data::Data;
use crate::master::motor::Motor;
use crate::master::motor::restarts::RESTART_TAKES;
use crate::opcode::Opcode;
use crate::time::{Duration, Instant};

/// A motor that has not reported for this many of its intervals no longer does.
const REPORTS_MISSED: u32 = 3;

impl Motor {
    /// Whether it reports this unasked. A motor that was not heard for long no longer does.
    pub(crate) fn reports(&self, bit: u8, now: Instant) -> bool {
        if self.reports & bit == 0 {
            return false;
        }
        let interval = Duration::from_millis(10 * u64::from(self.report_interval));
        let longest_silence = RESTART_TAKES + interval.times(REPORTS_MISSED);
        let since = self.health.last_seen().map_or(self.sent, |seen| seen.max(self.sent));
        now - since < longest_silence
    }

    /// It was told what to report from now on, or what to stop reporting.
    pub(super) fn note_reports(&mut self, data: &Data) {
        let [_, command, enable, low, high, ..] = *data;
        let bit = Opcode::from_byte(command).map_or(0, reported_bit);
        self.reports &= !bit;
        if enable != 0 {
            self.reports |= bit;
            let interval = u16::from_le_bytes([low, high]);
            self.report_interval = self.report_interval.max(interval);
        }
    }
}

/// The bit of a command that a drive can report unasked (2.34.2); 0 for any other.
pub(crate) fn reported_bit(opcode: Opcode) -> u8 {
    opcode.report_place().map_or(0, |place| 1 << place)
}

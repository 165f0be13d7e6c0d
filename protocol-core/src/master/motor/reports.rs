//! What a motor reports by itself, as it was told by 0xB6.

use crate::data::Data;
use crate::master::motor::Motor;
use crate::master::motor::restarts::RESTART_TAKES;
use crate::opcode::Opcode;
use crate::time::{Duration, Instant};

/// One that has not reported for so many of its intervals does so no more.
const REPORTS_MISSED: u32 = 3;

impl Motor {
    /// Whether it reports this by itself.
    pub(in crate::master) fn reports(&self, bit: u8, now: Instant) -> bool {
        self.reports & bit != 0 && self.may_report_yet(now)
    }

    /// It was told what to report from now on, or what no more.
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

    /// Whether it reports, as it was told: one that was not heard for so long does so no more.
    fn may_report_yet(&self, now: Instant) -> bool {
        let interval = Duration::from_millis(10 * u64::from(self.report_interval));
        let longest_silence = RESTART_TAKES + interval.times(REPORTS_MISSED);
        let since = self.health.last_seen().map_or(self.sent, |seen| seen.max(self.sent));
        now - since < longest_silence
    }
}

/// The bit of a command that a drive can report by itself (2.34.2), and none of any other.
pub(in crate::master) fn reported_bit(opcode: Opcode) -> u8 {
    opcode.report_place().map_or(0, |place| 1 << place)
}

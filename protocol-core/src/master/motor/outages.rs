//! The bus carries nothing, or may carry nothing: what waits is dropped, and what is late may be later.

use crate::master::config::Config;
use crate::master::event::Failure;
use crate::master::health::SILENT_AFTER;
use crate::master::motor::Motor;
use crate::time::Instant;

impl Motor {
    /// The bus carries nothing: what waits is dropped, except for stops, and late replies come later.
    pub(crate) fn bus_is_down(&mut self, now: Instant, config: &Config) {
        if self.is_waiting() && !self.is_stop_waiting() {
            self.unreached = self.unreached.saturating_add(1);
            if self.unreached >= SILENT_AFTER {
                self.note_silence(config, now);
            }
        }
        self.late.extend(now + config.late_window);
        self.on_its_way.extend(now, config);
        self.drop_waiting_set_point();
        if self.request.waiting().is_some_and(|asked| !asked.is_stop()) {
            self.request_has_failed(Failure::BusDown, config, now);
        }
    }

    /// The bus may be down: what waits is dropped if a stop would refuse it. Late replies come later if what has arrived
    /// may be kept back.
    pub(crate) fn bus_may_be_down(&mut self, may_be_kept: bool, now: Instant, config: &Config) {
        if may_be_kept {
            // Not for longer: errors that pause for one look would prolong it for ever.
            self.late.extend(now + config.reply_timeout);
        }
        self.drop_waiting_set_point();
        if self.request.waiting().is_some() {
            self.withdraw(Failure::BusDown, config, now);
        }
    }
}

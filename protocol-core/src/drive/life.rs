//! Supply, start and restart (manual 2.26), as [`decisions`](super::decisions) says.

use crate::command::ErrorFlags;
use crate::drive::reply::Replies;
use crate::drive::{Drive, Event, Memory, Plant, Protection, Quirks, Reporting, Settings};
use crate::time::{Duration, Instant};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Life {
    /// No supply.
    Off,
    /// Too little supply for the electronics, which start on their own when it is back.
    BrownedOut,
    /// Starting, and deaf.
    Booting {
        /// When the start began.
        since: Instant,
        /// When it is done.
        until: Instant,
    },
    /// Hears commands.
    Running {
        /// When the start began.
        since: Instant,
    },
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// Takes the supply away. The turns are saved if function 4 is on. The output is off and the brake
    /// locked until [`power_on`](Self::power_on); the motor goes on turning as the plant lets it, if
    /// [`advance`](Self::advance) is still called.
    pub fn power_off(&mut self, now: Instant) {
        self.advance(now);
        self.lose_power(Life::Off);
    }

    fn lose_power(&mut self, life: Life) {
        if self.is_powered() {
            self.save_turns();
            self.outgoing.clear();
            self.halt();
            self.events.push(Event::PoweredOff);
        }
        self.life = life;
    }

    /// Whether it has supply, also while it starts.
    pub const fn is_powered(&self) -> bool {
        matches!(self.life, Life::Booting { .. } | Life::Running { .. })
    }

    /// Checks whether the supply's voltage has become too low for the electronics, or enough again.
    pub(super) fn follow_supply(&mut self) {
        let lowest_v = self.parameters.brown_out_voltage_v;
        let voltage_v = self.measurement.supply_voltage_v;
        match self.life {
            Life::Off => {}
            Life::BrownedOut => {
                if voltage_v >= lowest_v + self.parameters.limits.voltage_margin_v {
                    self.boot(self.clock);
                }
            }
            Life::Booting { .. } | Life::Running { .. } => {
                if voltage_v < lowest_v {
                    self.lose_power(Life::BrownedOut);
                }
            }
        }
    }

    /// Gives the supply back, if it has the voltage for a start.
    pub fn power_on(&mut self, now: Instant) {
        self.advance(now);
        if self.life != Life::Off {
            return;
        }
        if self.measurement.supply_voltage_v < self.parameters.brown_out_voltage_v {
            self.life = Life::BrownedOut;
        } else {
            self.boot(now);
        }
    }

    /// 0x76.
    pub(super) fn restart(&mut self, now: Instant) {
        self.events.push(Event::Reset);
        self.save_turns();
        self.halt();
        self.boot(now);
    }

    /// Begins a start.
    pub(super) fn boot(&mut self, now: Instant) {
        let until = now + self.parameters.start_time();
        self.life = Life::Booting { since: now, until };
        if until <= now {
            self.start(now);
        }
    }

    /// Ends a start that began at `since`: takes over what is stored, and hears commands from now on.
    pub(super) fn start(&mut self, since: Instant) {
        self.life = Life::Running { since };
        let restored = self.memory.load();
        let failed = restored.is_err();
        if let Ok(Some(settings)) = restored {
            self.stored = settings;
        }
        let before = core::mem::replace(&mut self.active, self.stored);
        let keeps_turns = self.active.save_multi_turn && !self.parameters.quirks.turns_lost;
        let saved = self.active.saved_position.filter(|_| keeps_turns);
        self.encoder.start(self.measurement.encoder_pulses, self.active.zero_offset, saved);
        self.turns_to_clear = 0;
        self.events.push(Event::Started);
        if self.active.baud_rate != before.baud_rate {
            self.events.push(Event::BitRateChanged(self.active.baud_rate));
        }
        self.change_faults(|faults| faults.restart());
        if failed {
            self.memory_failed();
        }
    }

    /// Loses everything in RAM.
    fn halt(&mut self) {
        self.cut_output();
        self.protection = Protection::default();
        self.reporting = Reporting::default();
        self.replies = Replies::default();
    }

    /// What a drive with function 4 on does before its supply is gone (2.35.4).
    fn save_turns(&mut self) {
        let Life::Running { .. } = self.life else { return };
        let position = self.encoder.raw().saturating_sub(self.turns_to_clear);
        let saved_position = self.active.save_multi_turn.then_some(position);
        self.store(Settings { saved_position, ..self.stored });
    }

    /// Keeps settings in ROM. Returns whether that worked.
    pub(super) fn store(&mut self, settings: Settings) -> bool {
        if settings == self.stored {
            return true;
        }
        let stored = self.memory.store(&settings).is_ok();
        if stored {
            self.stored = settings;
            if self.parameters.quirks.slow_rom {
                self.replies.wait_until(self.clock + Quirks::SLOW_ROM);
            }
        } else {
            self.memory_failed();
        }
        stored
    }

    fn memory_failed(&mut self) {
        self.events.push(Event::MemoryFailed);
        self.change_faults(|faults| faults.raise(ErrorFlags::CALIBRATION_PARAMETERS));
    }

    /// Time since the last start began (0xB1).
    pub(super) fn run_time(&self, now: Instant) -> Duration {
        if let Life::Running { since } = self.life { now - since } else { Duration::ZERO }
    }
}

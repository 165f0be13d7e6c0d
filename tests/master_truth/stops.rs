//! Checks that each stop is first sent in time, in any world: as soon as the port takes it, and before anything else.
//! The stop of a motor that answers comes before that of one that does not.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::master::{Bus, Config, MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};

use super::bounds::ROM_TIMEOUT;
use super::doubt::shows_echo;
use super::names::Name;
use super::to_all::SHUTDOWN;
use super::truth::{Page, Truth};

/// If a port refuses the stop, it is offered again after 1 ms. A caller that takes an error or events first does not
/// look meanwhile.
const NEXT_OFFER: Duration = Duration::from_micros(1_500);
/// A motor that has not answered this many commands in a row counts as dead.
const IS_DEAD: u32 = 5;

/// How well a motor answered when it was stopped, as far as that is certain.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Answers {
    /// It answered its last command, in time.
    Well,
    #[default]
    Unsure,
    /// It has answered nothing for a long time.
    Never,
}

/// The one stop to all that is sent before the motors' own stops. It also reaches motors that are not known.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StopToAll {
    /// The kind that must be sent.
    due: Option<StopKind>,
    /// The kind that was sent last.
    went: Option<StopKind>,
    /// A command to all has moved motors, some of which may not be known.
    were_moved: bool,
}

/// When the port must be offered a first stop, in the world's time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Offers {
    /// Within this time after the last offer, or after the stop was called.
    within: Duration,
    pub(super) since: Instant,
}

impl Offers {
    pub(crate) fn new(config: &Config) -> Self {
        let within = match config.bus {
            Bus::Can => NEXT_OFFER,
            // The exchange in flight, or one with a motor that is not there.
            Bus::Rs485 { turnaround, .. } => {
                let exchange = config.reply_timeout + config.frame_time.times(2);
                NEXT_OFFER + exchange + config.settle_time + turnaround
            }
        };
        Self { within, since: Instant::ZERO }
    }

    /// On a line a command that no firmware knows has a longer time-out, like a write to ROM.
    pub(crate) fn unknown_commands_are_asked(&mut self) {
        self.within = self.within + ROM_TIMEOUT;
    }
}

impl Truth {
    /// Never due if flipped bits may fake an answer to the stop to all: then a motor's own stop may wait.
    pub(super) fn is_first_stop_due(&self) -> bool {
        let waits =
            self.stop_to_all.due.is_some() || self.pages.iter().any(Page::waits_for_first_stop);
        !self.flips && waits
    }

    /// A caller stops all, and may or may not have lifted an earlier stop. Decides whether a stop to all must be sent,
    /// too. It is not sent if it would hold a motor that a stop keeps off. If all are stopped again, and nothing was
    /// moved since, it is not repeated.
    pub(super) fn stops_all(&mut self, kind: StopKind, is_again: bool) {
        let holds_who_is_off = kind == StopKind::Hold && !self.switched_off.is_empty();
        let known = self.known.iter().map(|motor| &self.pages[motor.index()]);
        let is_any_moved = known.clone().any(|page| !page.is_told && !page.is_stopping);
        let is_new = !is_again && (self.stop_to_all.went != Some(kind) || is_any_moved);
        // On CAN, only a command to all can have moved motors that are not known.
        let is_needed = !self.stop_to_all_is_answered || self.stop_to_all.were_moved;
        if is_needed && is_new && !holds_who_is_off {
            if !self.is_first_stop_due() {
                self.offers.since = self.world;
            }
            self.stop_to_all.due = Some(kind);
        } else if kind == StopKind::Off {
            // No motor is to be held any more, and motors without a place were off before.
            self.stop_to_all.due.take_if(|due| *due == StopKind::Hold);
        }
    }

    /// The bus has taken a command to all.
    pub(super) fn all_are_told(&mut self, name: Name) {
        let it = &mut self.stop_to_all;
        it.were_moved |= name.moves();
        if name.is_stop() {
            let kind = if name.byte == SHUTDOWN { StopKind::Off } else { StopKind::Hold };
            (it.due, it.went) = (None, Some(kind));
        }
    }

    /// A caller has lifted the stop of these motors.
    pub(crate) fn lift(&mut self, motors: MotorSet) {
        self.switched_off = MotorSet::EMPTY;
        for motor in motors.iter() {
            let page = self.page(motor);
            (page.is_stopped, page.is_confirmed) = (false, false);
        }
    }

    pub(super) fn answers(&mut self, motor: MotorId) -> Answers {
        let (now, window) = (self.now, self.late_window);
        // A motor that does not answer a command to all in time has missed it.
        let is_asked_with_all = self.last_to_all.is_some_and(|at| now - at <= window);
        let is_in_doubt = self.flips || self.echoes || self.twin == Some(motor);
        let page = self.page(motor);
        if page.unanswered >= IS_DEAD && now - page.asked_at > window {
            Answers::Never
        } else if page.answered_newest && !is_asked_with_all && !is_in_doubt {
            Answers::Well
        } else {
            Answers::Unsure
        }
    }

    /// The port is offered this packet; `None` for bytes without one.
    pub(crate) fn offered(&mut self, packet: Option<&Packet>) {
        if !self.is_first_stop_due() {
            return;
        }
        let Offers { within, since } = self.offers;
        let (took, within) = (self.world - since, within + self.clock_step);
        if took > within {
            self.breaks(format!("no first stop is tried for {took}, and not {within}"));
        }
        // The read that shows an echo may come before a first stop. It goes to a motor that seems to be there: a read to
        // a dead motor would only cost time.
        let asks = |packet: &Packet| shows_echo(packet) && self.doubt.is_open();
        if let Some(packet) = packet.filter(|packet| !self.is_stop(packet) && !asks(packet)) {
            self.breaks(format!("{packet:X?} goes before a first stop"));
        }
        self.offers.since = self.world;
    }

    /// The port has held an offered packet until now, or no caller has looked.
    pub(crate) fn no_offer_was_possible(&mut self) {
        self.offers.since = self.world;
    }

    /// The bus has taken a stop. Every motor must get its first stop in time, and before any motor gets its second.
    pub(super) fn check_stops(&mut self, motor: MotorId) {
        if self.stop_to_all.due.is_some() && !self.flips {
            self.breaks(format!("motor {motor} is stopped, and all are to be first"));
        }
        let page = self.page(motor);
        let is_second = page.stops_taken > 0 || page.is_told && !page.may_be_untold;
        let is_sure = !page.is_begun_anew && !page.may_be_stopping;
        if is_second && is_sure && self.is_first_stop_due() {
            let first: MotorSet = MotorId::all()
                .filter(|motor| self.pages[motor.index()].waits_for_first_stop())
                .collect();
            self.breaks(format!("motor {motor} gets a second stop before the first of {first}"));
        }
        let is_first_due_to =
            |page: &Page, answers| page.waits_for_first_stop() && page.answers == answers;
        if is_first_due_to(self.page(motor), Answers::Never)
            && self.pages.iter().any(|page| is_first_due_to(page, Answers::Well))
        {
            self.breaks(format!(
                "motor {motor} never answers, and is stopped before one that does"
            ));
        }
        let (now, within) = (self.now, self.first_stops_within);
        let page = self.page(motor);
        // A stop that only may be in flight has no time of its call.
        let is_called = page.is_stopping && !is_second;
        let took = now - page.stop_called_at;
        if let Some(within) = within.filter(|within| is_called && took > *within) {
            self.breaks(format!("motor {motor}: its first stop takes {took} and not {within}"));
        }
    }
}

//! Whether a motor was spoken to steadily.
//!
//! A drive that heard nothing for longer than its protection time (0xB3) cuts its output. After that it answers the
//! first commands and does not obey: communication has to be steady again first (2.31.1). Only a drive with a message of
//! its own for that (0xF1) says so. So a motor that was not spoken to steadily is not believed to hold (0x81), and is
//! told again.

use crate::master::motor::Motor;
use crate::master::motor::restarts::RESTART_TAKES;
use crate::master::motor::stopping::LastStop;
use crate::master::request::Asked;
use crate::master::stop::StopKind;
use crate::packet::Packet;
use crate::time::{Duration, Instant};

/// After a longer pause between two commands a drive may have let go.
const LONGEST_PAUSE: Duration = Duration::from_millis(150);

/// After one that is longer than this it has to be told again to hold. That takes three commands, so that others of a
/// line wait longer.
const PAUSE_OF_LOSS: Duration = Duration::from_millis(400);

/// A silence that shows more than a lost answer: a motor that [is kept alive](crate::io::KeepAlive) is asked every 100
/// ms.
const LONGEST_SILENCE: Duration = Duration::from_millis(250);

/// How many commands in a row a motor has to answer until it obeys for sure. It obeys the last of them.
const STEADY_AFTER: u8 = 3;

/// How many commands a motor has answered since the last long pause, or since the master knows it: nobody may have
/// spoken to it before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Answered(u8);

impl Motor {
    /// Whether it obeys for sure.
    pub(crate) fn is_steady(&self) -> bool {
        self.answered.0 >= STEADY_AFTER
    }

    /// Whether it has answered nothing since a long pause.
    pub(super) fn is_anew(&self) -> bool {
        self.answered.0 == 0
    }

    /// A command is sent now. If there was a long pause before it, the next commands may be answered and not obeyed. So
    /// many motors take turns on a line.
    #[inline]
    pub(crate) fn note_pause(&mut self, on_line: u32, now: Instant) {
        if self.pause_before(now) > LONGEST_PAUSE || self.was_missed() {
            self.may_begin_anew(on_line, now);
        }
    }

    /// For how long it was sent nothing, or nothing was heard of it: what a controller hands back was never on the bus.
    fn pause_before(&self, now: Instant) -> Duration {
        now - self.sent.min(self.health.heard_at())
    }

    /// The same, whatever the pause.
    #[inline(never)]
    pub(crate) fn may_begin_anew(&mut self, on_line: u32, now: Instant) {
        if self.health.last_seen().is_none() {
            return;
        }
        // Twice the time of one exchange with each.
        let longest = LONGEST_PAUSE.max(self.health.round_trip().times(2 * on_line));
        let pause = self.pause_before(now);
        if pause > longest {
            self.answered = Answered(0);
        }
        // It may have restarted, and its caller does not know.
        if pause >= RESTART_TAKES {
            self.is_left_to_hold = false;
        }
        // What it reports unasked does not show that it hears anything.
        if pause > PAUSE_OF_LOSS.max(longest.times(2)) || self.is_silent_for_long() {
            self.has_let_go();
        }
    }

    /// It is heard after this silence. Some of it was asked in vain, or what is in flight is answered only now.
    #[inline]
    pub(super) fn note_silence_of(
        &mut self,
        silence: Duration,
        was_asked_in_vain: bool,
        now: Instant,
    ) {
        if silence > LONGEST_PAUSE {
            self.note_pause_within(silence, was_asked_in_vain, now);
        }
    }

    #[inline(never)]
    fn note_pause_within(&mut self, silence: Duration, was_asked_in_vain: bool, now: Instant) {
        let silence = match was_asked_in_vain {
            true => silence,
            false if self.is_in_flight() => silence.min(now - self.sent),
            false => return,
        };
        if silence > LONGEST_SILENCE {
            self.has_let_go();
        } else if silence > LONGEST_PAUSE {
            self.answered = Answered(0);
        }
    }

    /// Its drive says that it has let go, sends a command back that it has ignored, or may have let go.
    #[inline(never)]
    pub(crate) fn has_let_go(&mut self) {
        self.answered = Answered(0);
        self.doubt_hold();
    }

    /// A hold that it has confirmed no longer counts.
    pub(super) fn doubt_hold(&mut self) {
        if let LastStop::Confirmed(StopKind::Hold) = self.last_stop {
            self.last_stop = LastStop::MayHaveLetGo;
        }
    }

    /// It has answered a command.
    #[inline]
    pub(super) fn note_answer(&mut self) {
        if !self.is_steady() {
            self.answered.0 += 1;
        }
    }

    /// Whether it has confirmed that it holds, and may have let go since. Nothing has to be known of that while it is
    /// silent.
    pub(crate) fn may_have_let_go(&self, says_so: bool) -> bool {
        let answers = !self.was_missed() && !self.is_anew();
        matches!(self.last_stop, LastStop::MayHaveLetGo) && (answers || says_so)
    }

    /// Whether it may be told to hold again. A caller's own command that ends its motion goes first.
    pub(crate) fn may_be_held_again(&self, is_stopped: bool) -> bool {
        match is_stopped {
            true => !self.request.under_way().is_some_and(Asked::ends_motion),
            false => self.is_left_to_hold && self.request.is_none() && self.stream.is_none(),
        }
    }

    /// Whether this may be a motion command, and not feedback. After a silence a drive may send back the first command,
    /// perhaps behind its answers to others. Feedback names its motor, except that of some drives.
    pub(super) fn may_be_sent_back(&self, reply: &Packet) -> bool {
        reply.is_motion() && self.id.is_some_and(|id| id.get() != reply.data[0])
    }
}

//! What happens to a frame: the bus takes it or hands it back, a drive hears it, and a reply reaches the master.

use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Channel, MotorId, Packet, Target};

use super::doubt::{SHOWS_ECHO, shows_echo};
use super::excuses::Excuse;
use super::names::{Name, REPORTS, has_values, is_asking, question_of};
use super::stops::Answers;
use super::to_all::STOP;
use super::truth::{DONE, MAY_HAVE_RESTARTED, Truth};

/// A reply that comes earlier than this after its command may pass for a doubled frame.
const TOO_SOON: Duration = Duration::from_micros(500);

impl Truth {
    /// The bus has taken a command of the master's.
    pub(crate) fn taken(&mut self, packet: &Packet) {
        match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => {
                self.taken_of(motor, packet);
            }
            _ => {
                let name = Name::of(packet);
                let is_stop = name.is_stop();
                if !is_stop {
                    self.caller_reaches_all(name);
                }
                self.last_to_all = Some(self.now);
                self.all_are_told(name);
                for motor in MotorId::all() {
                    let page = self.page(motor);
                    let sending = page.sendings.get(&name).copied().unwrap_or_default();
                    let put = if is_stop { page.stop_called } else { sending.put };
                    if name.moves() && (page.is_stopped || put < page.ended || sending.taken > 0) {
                        self.breaks(format!("{name:X?} moves all, and motor {motor} is stopped"));
                    }
                    // A motor that does not answer counts as having missed it.
                    let page = self.page(motor);
                    page.answered_newest &= is_stop;
                    if name.moves() {
                        (page.is_told, page.tellings) = (false, 0);
                    }
                    self.note_taken(motor, packet, put);
                }
            }
        }
    }

    fn taken_of(&mut self, motor: MotorId, packet: &Packet) {
        let (name, now) = (Name::of(packet), self.now);
        self.doubt.taken(motor, name, self.world);
        if shows_echo(packet) {
            self.page(motor).asked_for_echo_at = now;
            if !self.doubt.is_open() {
                self.breaks(format!("motor {motor} is asked for an echo of which all is known"));
            }
            return;
        }
        if is_asking(packet) {
            let page = self.page(motor);
            (page.asked_at, page.answered_newest) = (now, false);
            page.unanswered += 1;
        }
        if self.is_stop(packet) {
            self.check_stops(motor);
            let page = self.page(motor);
            let is_asked = page.is_stopping || page.may_be_stopping;
            let wrong = if !is_asked {
                Some("and must not stop")
            } else if name.byte == STOP && name.token == 0 && page.stop_asked < page.let_go {
                Some("after a command that has let all go")
            } else {
                None
            };
            if let Some(wrong) = wrong {
                self.breaks(format!("motor {motor} is sent {name:X?}, {wrong}"));
            }
            let page = self.page(motor);
            let called = page.stop_called;
            page.stops_taken += 1;
            page.is_told = true;
            page.tellings += 1;
            self.note_taken(motor, packet, called);
            return;
        }
        let page = self.page(motor);
        let Some(sending) = page.sendings.get(&name).copied() else {
            return self.breaks(format!("motor {motor}: {name:X?} was never put"));
        };
        let is_dangerous = name.moves() || matches!(name.byte, 0x76 | 0x77);
        let wrong = if is_dangerous && page.is_stopped {
            "is sent to a stopped motor"
        } else if name.moves() && sending.put < page.ended_with_all {
            "is sent after all were told to end their motion"
        } else if name.byte == STOP && sending.put < page.let_go {
            "holds after a command that has let all go"
        } else if name.moves() && sending.put < page.ended {
            "is sent after a newer command that ends motion"
        } else if name.is_set_point() && name.token <= page.newest_set_point {
            "is sent after itself or a newer one"
        } else if name.byte == 0xA8 && sending.taken > 0 {
            "acts again, and is sent again"
        } else if name.is_set_point() && page.has_restarted() {
            "is sent to a motor that has restarted"
        } else {
            ""
        };
        // A stop refuses these commands, and so it refuses 0xB6 (reports).
        if is_dangerous || name.byte == 0xB6 {
            (page.is_told, page.tellings) = (false, 0);
        }
        if name.is_set_point() {
            page.newest_set_point = page.newest_set_point.max(name.token);
        }
        let was_dropped =
            if name.is_set_point() { page.set_points.taken(name.token, now) } else { None };
        let wrong = was_dropped.unwrap_or(wrong);
        if !wrong.is_empty() {
            self.breaks(format!("motor {motor}: {name:X?} {wrong}"));
        }
        self.note_taken(motor, packet, sending.put);
    }

    fn note_taken(&mut self, motor: MotorId, packet: &Packet, put: u64) {
        let (name, now, world) = (Name::of(packet), self.now, self.world);
        self.bus_took_at = world;
        let page = self.page(motor);
        let sending = page.sendings.entry(name).or_default();
        sending.put = sending.put.max(put);
        sending.taken += 1;
        (sending.last_taken, sending.heard_since) = (now, 0);
        if name.is_ending() {
            page.ended = page.ended.max(put);
            if name.is_stop() || packet.channel != Channel::Command(Target::All) {
                page.ended_alone = page.ended_alone.max(put);
            }
        }
        if name.byte == 0x76 {
            (page.was_reset, page.awaits_resume, page.reset_at) = (true, true, Some(world));
        }
        sending.was_answered = false;
        page.asking += u64::from(is_asking(packet));
    }

    /// The controller has handed a command back.
    pub(crate) fn handed_back(&mut self, packet: &Packet) {
        let name = Name::of(packet);
        let (is_stop, now, longest) = (self.is_stop(packet), self.now, self.longest_response);
        let was_due = self.is_first_stop_due();
        if matches!(packet.channel, Channel::Command(Target::All)) && !is_stop {
            self.command_to_all_is_handed_back(name);
        }
        let (motors, is_own): (Vec<MotorId>, bool) = match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => (vec![motor], true),
            _ => (MotorId::all().collect(), false),
        };
        for motor in motors {
            let page = self.page(motor);
            let is_before = is_own && page.stop_before == Some(name) && name != page.stop;
            page.asking -= u64::from(is_asking(packet));
            page.unanswered = page.unanswered.saturating_sub(u32::from(is_own));
            if let Some(sending) = page.sendings.get_mut(&name) {
                sending.taken -= 1;
                let may_be_lost = is_own && now - sending.last_taken >= longest;
                sending.was_lost_and_back |= may_be_lost;
                page.lost_and_back += u64::from(may_be_lost && is_asking(packet));
                let question = question_of(packet);
                let strangers = page.strangers_answered_at.get(&question);
                let may_be_answered = strangers.is_some_and(|at| *at >= sending.last_taken)
                    || page.excuses.holds(Excuse::Doubled, question, now);
                page.answered_and_back += u64::from(is_own && may_be_answered && is_asking(packet));
            }
            if is_stop || is_before {
                // A command to all is no motor's own.
                let is_of_this = is_own && !is_before;
                page.stops_taken = page.stops_taken.saturating_sub(u32::from(is_of_this));
                page.tellings = page.tellings.saturating_sub(u32::from(is_own));
                if is_own && name != page.stop {
                    // An earlier stop. If only that one was sent to the motor, the motor has no stop now.
                    page.may_be_untold = true;
                    if page.tellings == 0 {
                        (page.is_told, page.was_told) = (false, false);
                    }
                }
                page.is_told &= !is_own || page.stops_taken > 0 || page.was_told;
            } else if name.is_set_point() && page.newest_set_point == name.token {
                // It may be sent again.
                page.newest_set_point -= 1;
            } else if is_own && name.is_ending() {
                // As far as the master knows, the frame may be a stop's that the motor has had: it looks like a request
                // that is over.
                let put = page.sendings.get(&name).map(|sending| sending.put);
                let is_over = page.ends != put
                    || put < Some(page.stop_called.max(page.may_be_stopping_since));
                page.may_be_untold |= is_over;
            }
            if name.is_set_point() {
                page.set_points.handed_back(name.token, now);
            }
        }
        // It may have been in the controller for long.
        if !was_due && self.is_first_stop_due() {
            self.offers.since = self.world;
        }
    }

    /// A drive has heard a command, and may ignore it.
    pub(crate) fn heard(&mut self, motor: MotorId, packet: &Packet, ignores: bool, at: Instant) {
        self.tick(at);
        let moment = self.next_moment();
        let (name, now, window) = (Name::of(packet), self.now, self.late_window);
        if name.is_strangers() || shows_echo(packet) {
            return;
        }
        let doubled = self.doubled(motor);
        let (has_twin, flips) = (self.twin == Some(motor), self.flips);
        let reorders = self.reorders;
        let is_can = self.stop_to_all_is_answered;
        let tells = is_can && name.is_stop();
        let is_own = packet.channel != Channel::Command(Target::All);
        let is_alone = name.is_stop() || is_own;
        let page = self.page(motor);
        // An answer to a command to all does not show that commands sent before have arrived.
        let ended = page.ended_alone;
        let sending = page.sendings.entry(name).or_default();
        sending.heard += 1;
        sending.heard_since += 1;
        sending.ignored += u32::from(ignores);
        let sending = *sending;
        let doubled = if sending.was_never_put() { Excuse::MadeUp } else { doubled };
        // On a line two drives with one id take each other's acknowledgements for commands, maybe forever.
        let is_by_both = has_twin && sending.heard_since > 1;
        if is_by_both || sending.heard > sending.taken && (has_twin || !name.is_stop()) {
            page.excuses.note(question_of(packet), doubled, now, window);
        }
        if ignores && page.lost_master_untold {
            page.excuses.note(question_of(packet), Excuse::LostMasterUntold, now, window);
        }
        if name.is_ending() {
            // A drive that ignores it stands still as well, since its output is cut.
            page.stop_heard = moment;
            page.is_told_with_all |= tells && name == page.stop;
            page.endings_heard.insert(name.byte, moment);
            if is_alone {
                page.ended_heard = page.ended_heard.max(sending.put);
            }
        }
        let is_late = now - sending.last_taken > window;
        let most = if has_twin { 2 } else { 1 };
        let is_again = name.byte == 0xA8 && sending.heard > most && sending.heard > sending.taken;
        let excuse = if is_late {
            Some(Excuse::HeldBack)
        } else {
            page.excuses.doubling(now).or_else(|| page.excuses.of(question_of(packet), now))
        };
        if !name.moves() || ignores || flips {
            return;
        }
        let was_ended = sending.put < ended && page.ended_heard >= ended;
        let is_behind = was_ended && !page.is_stopping && !reorders;
        // By priority a move of all, or one in motion mode, may leave its mailbox after a command that ends motion.
        // Then that command is sent once more, and reported as answered only after the move. A move that another
        // station has made up was in no mailbox.
        let is_less_urgent = is_can && (!is_own || name.byte == 0) && !sending.was_never_put();
        let goes_again = is_less_urgent && page.ends == Some(ended);
        if is_behind && goes_again {
            page.moved_behind = moment;
        }
        let wrong = if page.is_confirmed {
            "reaches a motor whose stop is confirmed"
        } else if is_behind && !goes_again {
            "reaches the motor after a newer command that ends motion"
        } else if is_again {
            "acts again, and is heard again"
        } else {
            return;
        };
        match excuse {
            Some(excuse) => self.excuse(excuse),
            None => self.breaks(format!("motor {motor}: {name:X?} {wrong}")),
        }
    }

    /// A frame has reached the master that looks like a reply.
    pub(crate) fn delivered(&mut self, packet: &Packet) {
        let (Channel::Reply(motor) | Channel::MotionReply(motor)) = packet.channel else { return };
        let (name, question, now) = (Name::of(packet), question_of(packet), self.now);
        let (window, doubled) = (self.late_window, self.doubled(motor));
        let longest = self.longest_response;
        let copies = 1 + u32::from(self.echoes);
        let may_pass_for_echo = self.doubt.is_open() && !has_values(name.byte);
        let takes_read_for_echo = self.doubt.takes_read_for_echo(name.byte);
        self.doubt.delivered(motor, packet, self.world);
        let is_misled = self.echoes && self.doubt.is_misled();
        let is_no_echo = packet.data[3] == DONE || name.byte == 0xB1 && copies == 1;
        let page = self.page(motor);
        // Not in motion mode, where the first byte is an id.
        let is_lost_master = name.byte == 0xF1;
        // A frame that may pass for an echo need not be taken for one.
        page.unanswered = 0;
        if page.answers == Answers::Never {
            page.answers = Answers::Unsure;
        }
        if is_lost_master {
            page.lost_master_untold = false;
            page.ignores_next = true;
            page.lost_master_delivered += 1;
        }
        // An echo does not count as hearing the motor, nor does a reply that passes for an echo.
        let is_read_back = takes_read_for_echo && !is_no_echo && page.sendings.contains_key(&name);
        let may_be_echo = copies > 1 || may_pass_for_echo || is_read_back;
        if !may_be_echo || packet.data[3] == DONE || is_lost_master {
            // If all earlier frames may have been echoes, it is not known when the motor was heard before.
            let unknown = MAY_HAVE_RESTARTED.times(copies - 1);
            let silence = page.delivered_at.map_or(unknown, |before| now - before);
            page.longest_silence = page.longest_silence.max(silence);
            page.delivered_at = Some(now);
        }
        let is_motion = matches!(packet.channel, Channel::MotionReply(_));
        if is_motion && packet.data[0] != motor.get() {
            page.no_feedback += 1;
        }
        if is_misled && packet.data[3] != DONE && !is_lost_master {
            page.excuses.note(question, Excuse::EchoesTaken, now, window);
        }
        if name == SHOWS_ECHO {
            // The answer goes to no caller, unless it comes when it is no longer expected.
            if now - page.asked_for_echo_at > window {
                page.excuses.note(question, Excuse::HeldBack, now, window);
            }
        } else if name.is_strangers() {
            page.strangers_answered_at.insert(question, now);
            page.excuses.note(question, Excuse::AnotherMaster, now, window);
        } else if name.token & 0xFF00_0000 == REPORTS {
            page.excuses.note(question, Excuse::ReportedByItself, now, window);
        } else if (!page.sendings.contains_key(&name)
            || is_no_echo && !page.said.contains(&packet.data))
            && !is_lost_master
        {
            // A collision may also leave the token unchanged.
            page.excuses.note(question, Excuse::MadeUp, now, window);
        } else if name.is_stop() {
            // All stops have the same name: it answers the last one, or one before.
            let last = page.sendings.get(&name).map(|sending| sending.last_taken);
            if last.is_some_and(|at| now - at > window) {
                page.excuses.note(question, Excuse::HeldBack, now, window);
            }
        } else if let Some(sending) = page.sendings.get_mut(&name) {
            sending.delivered += 1;
            let took = now - sending.last_taken;
            let is_in_time = TOO_SOON <= took && took < longest;
            let is_executed = packet.data[3] == DONE || copies == 1 && !has_values(name.byte);
            if is_in_time
                && is_executed
                && !may_pass_for_echo
                && sending.ignored == 0
                && !sending.was_answered
            {
                sending.was_answered = true;
                page.set_points.answered_soon += u64::from(name.is_set_point());
                page.answered_newest |= sending.last_taken == page.asked_at;
            }
            if sending.delivered > sending.taken * copies {
                // Noise may make a command that the drive hears and answers.
                let doubled = if sending.was_never_put() { Excuse::MadeUp } else { doubled };
                page.excuses.note(question, doubled, now, window);
            } else if now - sending.last_taken > window {
                page.excuses.note(question, Excuse::HeldBack, now, window);
            }
        }
    }
}

//! Checks each event against what really happened.

use std::collections::HashMap;

use myactuator_protocol_core::command::AnyReply;
use myactuator_protocol_core::master::{Event, Failure, Health, MotorSet, TicketId};
use myactuator_protocol_core::{Channel, Data, Kind, MotorId, Packet};

use super::bounds::STOP_ATTEMPTS;
use super::excuses::Excuse;
use super::names::{Name, has_values, question_of};
use super::restarts::{check_restarted, note_answered};
use super::sayings::{
    check_answer, check_confirmed, check_ended, check_feedback, check_report, check_was_heard,
};
use super::to_all::STOP;
use super::truth::{DONE, Sending, Truth};

/// A request without an outcome so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Open {
    pub(crate) ticket: TicketId,
    pub(crate) kind: Kind,
    pub(crate) data: Data,
}

/// A broadcast in flight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asked {
    pub(crate) data: Data,
    pub(crate) expected: MotorSet,
    pub(crate) answered: MotorSet,
}

/// What the master has reported of one motor so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Told {
    pub(crate) no_reply: u64,
    pub(crate) unanswered: u64,
    pub(crate) strays: u64,
    lost_master: u32,
    /// How many set-points seemed ignored, because an echo or flipped bits passed for a command that their drive hands
    /// back.
    seemed_ignored: u32,
    /// When its last restart was reported.
    restarted: u64,
}

/// The results of a scenario.
#[derive(Clone, Debug, Default)]
pub(crate) struct Totals {
    pub(crate) requests: u64,
    pub(crate) replies: u64,
    pub(crate) sent: u64,
    pub(crate) failed: HashMap<Why, u64>,
    pub(crate) feedback: u64,
    pub(crate) unanswered: u64,
    pub(crate) stops: u64,
    /// Stops of all that were called again before they were lifted.
    pub(crate) stops_again: u64,
    /// Commands to all that end motion, and how many motors got one of their own because a stop came before.
    pub(crate) ended_all: u64,
    pub(crate) turned: u64,
    pub(crate) confirmed: u64,
    pub(crate) unconfirmed: u64,
    pub(crate) broadcasts: u64,
    pub(crate) reports: u64,
    pub(crate) restarted: u64,
    pub(crate) lost_master: u64,
    pub(crate) bus_errors: u64,
    pub(crate) excused: HashMap<Excuse, u64>,
    /// The longest that a request, a command to all and a stop took, in percent of their bounds.
    pub(crate) slowest: [u64; 3],
}

/// Why requests failed, to be counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Why {
    NoReply,
    NotExecuted,
    Stopped,
    BusDown,
    Other,
}

impl From<Failure> for Why {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::NoReply => Self::NoReply,
            Failure::NotExecuted => Self::NotExecuted,
            Failure::Stopped | Failure::StopUnconfirmed => Self::Stopped,
            Failure::BusDown => Self::BusDown,
            _ => Self::Other,
        }
    }
}

impl Totals {
    pub(crate) fn failed(&self, why: Why) -> u64 {
        self.failed.get(&why).copied().unwrap_or(0)
    }
}

/// Compares the master's events with the truth.
#[derive(Debug)]
pub(crate) struct Oracle {
    pub(crate) open: Vec<Option<Open>>,
    pub(crate) broadcast: Option<Asked>,
    pub(crate) told: Vec<Told>,
    pub(crate) totals: Totals,
}

impl Oracle {
    pub(crate) fn new() -> Self {
        Self {
            open: vec![None; MotorId::COUNT],
            broadcast: None,
            told: vec![Told::default(); MotorId::COUNT],
            totals: Totals::default(),
        }
    }

    /// Checks an event.
    pub(crate) fn hear(&mut self, event: &Event, truth: &mut Truth) {
        match *event {
            Event::Reply { ticket, kind, data } => {
                let Some(open) = self.close(ticket, event, truth) else { return };
                self.totals.replies += 1;
                if open.kind != kind {
                    truth.breaks(format!("{event:?} of a {:?}", open.kind));
                }
                check_answer(ticket.motor(), &open.data, &data, truth);
                if ends_motion(&open.data) {
                    check_ended(ticket.motor(), &open.data, truth);
                }
                let of = sending(ticket.motor(), &open.data, truth);
                note_answered(ticket.motor(), &data, &of, truth);
            }
            Event::Sent { ticket, .. } => {
                let Some(open) = self.close(ticket, event, truth) else { return };
                self.totals.sent += 1;
                let taken = sending(ticket.motor(), &open.data, truth).taken;
                if open.kind.has_reply() || taken == 0 {
                    truth.breaks(format!("{event:?}, and it was taken {taken} times"));
                }
            }
            Event::Failed { ticket, failure } => {
                let Some(open) = self.close(ticket, event, truth) else { return };
                *self.totals.failed.entry(failure.into()).or_default() += 1;
                self.check_failure(ticket.motor(), &open, failure, truth);
            }
            Event::Feedback { motor, reply } => {
                self.totals.feedback += 1;
                check_feedback(motor, &reply, truth);
            }
            Event::SetPointUnanswered { motor } => {
                self.totals.unanswered += 1;
                self.told[motor.index()].unanswered += 1;
                let (now, window) = (truth.now, truth.late_window);
                let is_echo = [0xA2, 0xA4]
                    .into_iter()
                    .any(|byte| is_echo_for_answer(motor, &[byte, 0, 0, 0, 0, 0, 0, 0], truth));
                let page = truth.page(motor);
                page.turning.was_given_up(now + window);
                // A drive that has lost its master hands back the first command, which it has ignored.
                if is_echo || page.no_feedback > 0 {
                    page.no_feedback = page.no_feedback.saturating_sub(1);
                    page.set_points.seemed_ignored();
                    self.told[motor.index()].seemed_ignored += 1;
                }
                if !page.set_points.unanswered() && page.lost_master_delivered == 0 {
                    truth.breaks(format!("{event:?}, and all were answered"));
                }
            }
            Event::SetPointDropped { motor } => {
                let (now, max_age) = (truth.now, truth.set_point_max_age);
                if !truth.page(motor).set_points.dropped(now, max_age) {
                    truth.breaks(format!("{event:?}, and none was"));
                }
            }
            Event::BroadcastReply { motor, reply } => self.check_broadcast(motor, &reply, truth),
            Event::BroadcastDone { silent, was_sent } => match self.broadcast.take() {
                Some(asked)
                    if asked.expected.without(asked.answered) == silent
                        && truth.to_all.is_some_and(|it| was_sent == (it.taken > 0))
                        && truth.to_all.is_some_and(|it| was_sent || it.may_be_unsent()) => {}
                asked => truth.breaks(format!("{event:?} of {asked:?}")),
            },
            Event::StopConfirmed { motor } => {
                self.totals.confirmed += 1;
                check_confirmed(motor, truth);
            }
            Event::StopUnconfirmed { motor } => {
                self.totals.unconfirmed += 1;
                let moment = truth.next_moment();
                let page = truth.page(motor);
                let may_be = std::mem::take(&mut page.may_be_stopping);
                let was_stopping = std::mem::take(&mut page.is_stopping) || may_be;
                let taken = page.stops_taken;
                let attempts = match std::mem::replace(&mut page.was_given_up, true) {
                    true => 1,
                    false => STOP_ATTEMPTS,
                };
                if page.is_stopped {
                    // The stop goes on. Only its confirmation is still reported.
                    (page.may_be_stopping, page.may_be_stopping_since) = (true, moment);
                    page.may_be_untold &= page.stops_taken == 0;
                    (page.stops_taken, page.was_told) = (0, page.is_told);
                }
                if !was_stopping || taken < attempts {
                    truth.breaks(format!("{event:?} after {taken} attempts"));
                }
            }
            Event::Report { motor, reply } => {
                self.totals.reports += 1;
                check_report(motor, &reply, truth);
            }
            Event::Restarted { motor } => {
                self.totals.restarted += 1;
                self.told[motor.index()].restarted = truth.next_moment();
                check_restarted(motor, truth);
            }
            Event::LostMaster { motor } => {
                self.totals.lost_master += 1;
                let told = &mut self.told[motor.index()];
                told.lost_master += 1;
                if told.lost_master > truth.pages[motor.index()].lost_master_delivered {
                    truth.breaks(format!("{event:?}, and it has not"));
                }
            }
            Event::Stray { motor, .. } => self.told[motor.index()].strays += 1,
            Event::Overrun => {
                self.totals.bus_errors += 1;
                truth.failure_is_told();
            }
            ref other => truth.breaks(format!("an unexpected event: {other:?}")),
        }
    }

    /// The request that the ticket names, which must be open.
    fn close(&mut self, ticket: TicketId, event: &Event, truth: &mut Truth) -> Option<Open> {
        let open = self.open[ticket.motor().index()].take();
        let open = open.filter(|open| open.ticket == ticket);
        match open {
            Some(open) if ends_motion(&open.data) => truth.page(ticket.motor()).ends = None,
            Some(_) => {}
            None => truth.breaks(format!("no request waits for {event:?}")),
        }
        open
    }

    fn check_failure(&mut self, motor: MotorId, open: &Open, failure: Failure, truth: &mut Truth) {
        let of = sending(motor, &open.data, truth);
        let is_true = match failure {
            Failure::NoReply => {
                self.told[motor.index()].no_reply += 1;
                let was_sent = of.taken > 0 || of.was_lost_and_back;
                was_sent && (!of.was_answered || truth.flips)
            }
            // One of the two drives has lost its master, and the other answers.
            Failure::NotExecuted if truth.twin == Some(motor) => {
                truth.excuse(Excuse::TwoMotorsOfOneId);
                true
            }
            Failure::NotExecuted if of.ignored > 0 || truth.flips => true,
            // A command that comes back unchanged was handed back, if it is no echo.
            Failure::NotExecuted if is_echo_for_answer(motor, &open.data, truth) => true,
            // It is not sent more often to a motor that was never spoken to steadily.
            Failure::NotExecuted if open.data[0] == STOP && of.taken >= 15 => true,
            // The drive ignored another command, unnoticed. An acknowledgement looks like a command that is handed
            // back.
            Failure::NotExecuted => {
                let page = &mut truth.pages[motor.index()];
                let is_next = std::mem::take(&mut page.ignores_next) && !has_values(open.data[0]);
                if is_next {
                    truth.excuse(Excuse::LostMasterUntold);
                }
                is_next
            }
            Failure::Stopped => {
                let was_held = open.data[0] == STOP && truth.pages[motor.index()].let_go > of.put;
                if was_held {
                    truth.is_let_go(motor);
                }
                let page = &truth.pages[motor.index()];
                page.stop_called.max(page.may_be_stopping_since) > of.put
                    || is_move(&open.data) && page.ended_with_all > of.put
                    || was_held
            }
            // A stop that was given up is sent again, whatever callers asked meanwhile.
            Failure::StopUnconfirmed => {
                let page = &truth.pages[motor.index()];
                page.was_given_up && page.may_be_stopping
            }
            // The command was dropped. If it may be repeated, only its last attempt was dropped.
            Failure::BusDown => {
                let byte = open.data[0];
                let may_be = of.taken == 0 || is_repeated(byte) || has_no_token(byte);
                may_be && (truth.failed > of.put || truth.failure_is_kept)
            }
            // A move that was put before its motor's restart was reported, or before nobody looked for an hour.
            Failure::Dropped => {
                let is_older = of.put < self.told[motor.index()].restarted && of.taken == 0;
                open.kind.is_refused_while_stopped() && (is_older || of.put < truth.held_up)
            }
            _ => false,
        };
        if !is_true {
            truth.breaks(format!("motor {motor}: {failure:?} of {:02X?}: {of:?}", open.data));
        }
    }

    fn check_broadcast(&mut self, motor: MotorId, reply: &AnyReply, truth: &mut Truth) {
        self.totals.broadcasts += 1;
        let Some(asked) = &mut self.broadcast else {
            return truth.breaks(format!("motor {motor} answers no broadcast"));
        };
        if !asked.expected.contains(motor) || asked.answered.contains(motor) {
            truth.breaks(format!("motor {motor} answers a broadcast again, or is not asked"));
        }
        let asked = self.broadcast.as_mut().map(|asked| {
            asked.answered.insert(motor);
            asked.data
        });
        if let Some(data) = asked {
            let mut answer = reply.encode();
            answer[3] = DONE;
            if !has_values(data[0]) {
                // The answer is reported without its token, so only the drive knows whether it was asked.
                return check_was_heard(motor, &data, truth);
            }
            check_answer(motor, &data, &answer, truth);
        }
    }

    /// Each lost frame is counted once, and nothing else is.
    pub(crate) fn check_health(
        &self,
        motor: MotorId,
        health: Health,
        exactly: bool,
        truth: &mut Truth,
    ) {
        let (page, told) = (&truth.pages[motor.index()], &self.told[motor.index()]);
        let asking = page.asking;
        // An ignored set-point counts as unanswered, but not as lost. So does one that may have been ignored: the drive
        // may have ignored the one before, or a command of another master.
        let heard = page.sendings.values().map(|sending| sending.ignored);
        let ignored = heard.sum::<u32>() + told.lost_master + told.seemed_ignored;
        let (answered, lost) = (u64::from(health.answered), u64::from(health.lost));
        // Counters stay at their largest value.
        let most = u64::from(u16::MAX);
        // A set-point that seemed ignored is neither answered nor lost.
        let exactly = exactly && !truth.excused.contains_key(&Excuse::EchoesTaken);
        // Late feedback was reported last, and the newest set-point is in flight.
        let is_one_under_way =
            !page.answered_newest && truth.now - page.asked_at < truth.reply_timeout;
        let over = asking.saturating_sub(is_one_under_way.into());
        let is_wrong = answered + lost > asking + page.answered_and_back
            || exactly && answered + lost < over
            || lost + page.lost_and_back + u64::from(ignored) < told.no_reply.max(told.unanswered)
            || u64::from(health.stray) < told.strays.min(most)
            || told.lost_master < page.lost_master_delivered;
        if is_wrong {
            truth.breaks(format!("motor {motor}: {health:?} of {asking} commands, {told:?}"));
        }
    }
}

/// 0xB6 has no room for a token, so equal ones cannot be distinguished.
fn has_no_token(byte: u8) -> bool {
    byte == 0xB6
}

/// Whether the master repeats the command on its own: reads, RAM writes, and commands that stop.
fn is_repeated(byte: u8) -> bool {
    matches!(
        byte,
        0x30 | 0x31 | 0x42 | 0x60 | 0x77 | 0x78 | 0x80 | 0x81 | 0x90..=0x9D | 0xB1 | 0xB2
    )
}

fn name_of(data: &Data) -> Name {
    Name::of(&Packet { channel: Channel::Command(MotorId::MIN.into()), data: *data })
}

pub(super) fn is_move(data: &Data) -> bool {
    name_of(data).moves()
}

fn ends_motion(data: &Data) -> bool {
    name_of(data).is_ending()
}

pub(super) fn sending(motor: MotorId, data: &Data, truth: &Truth) -> Sending {
    let packet = Packet { channel: Channel::Command(motor.into()), data: *data };
    truth.pages[motor.index()].sendings.get(&Name::of(&packet)).copied().unwrap_or_default()
}

/// Whether an echo of this may have passed for a command that its drive hands back. If so, excuses it.
fn is_echo_for_answer(motor: MotorId, data: &Data, truth: &mut Truth) -> bool {
    let question = question_of(&Packet { channel: Channel::Reply(motor), data: *data });
    let excuses = &truth.pages[motor.index()].excuses;
    let is_echo = excuses.holds(Excuse::EchoesTaken, question, truth.now);
    if is_echo {
        truth.excuse(Excuse::EchoesTaken);
    }
    is_echo
}

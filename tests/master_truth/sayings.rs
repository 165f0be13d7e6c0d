//! Checks what the master reports that a motor has said: an answer, feedback, a confirmation, a report.

use myactuator_protocol_core::command::AnyReply;
use myactuator_protocol_core::{Channel, Data, MotorId, Packet};

use super::excuses::Excuse;
use super::names::{Name, has_angle, has_values, question_of};
use super::oracle::sending;
use super::truth::{DONE, Sending, Truth};

/// An answer must be that motor's answer to this request, from a drive that has executed it.
pub(super) fn check_answer(motor: MotorId, asked: &Data, answer: &Data, truth: &mut Truth) {
    let of = |data: &Data| Packet { channel: Channel::Reply(motor), data: *data };
    let (question, answered) = (Name::of(&of(asked)), Name::of(&of(answer)));
    if truth.flips {
        // One flipped bit on each way, or a bit that makes it the answer to another command.
        let was_asked = |bit: u8| {
            let mut before = *answer;
            before[0] ^= 1 << bit;
            sending(motor, &before, truth).heard > 0
        };
        let is_another = (0..8).any(was_asked);
        if (question.token ^ answered.token).count_ones() > 2 && !is_another {
            truth.breaks(format!("motor {motor}: asked {asked:02X?}, was given {answer:02X?}"));
        }
        return;
    }
    let is_done = answer[3] == DONE || !has_values(asked[0]) || asked[0] == 0xB1;
    if question == answered && is_done {
        return;
    }
    excused_or(motor, &of(asked), truth, || {
        format!("motor {motor}: asked {asked:02X?}, was given {answer:02X?}")
    });
}

/// The drive must have heard the command that it acknowledges: this one, or an equal stop that overtook it.
pub(super) fn check_was_heard(motor: MotorId, asked: &Data, truth: &mut Truth) {
    let page = &truth.pages[motor.index()];
    let heard = page.endings_heard.get(&asked[0]).copied();
    if heard.is_none_or(|at| at < page.ended_with_all) && !truth.flips {
        let packet = Packet { channel: Channel::Reply(motor), data: *asked };
        excused_or(motor, &packet, truth, || format!("motor {motor} has not heard {asked:02X?}"));
    }
}

/// The drive must have heard a request that ends motion after any move that came out of a mailbox.
pub(super) fn check_ended(motor: MotorId, asked: &Data, truth: &mut Truth) {
    let page = &truth.pages[motor.index()];
    if page.moved_behind > page.stop_heard && !truth.flips {
        let packet = Packet { channel: Channel::Reply(motor), data: *asked };
        excused_or(motor, &packet, truth, || format!("motor {motor} moves after {asked:02X?}"));
    }
}

/// Returns the excuse for a wrong answer to this. Without an excuse something is broken.
fn excused_or(
    motor: MotorId,
    asked: &Packet,
    truth: &mut Truth,
    what: impl FnOnce() -> String,
) -> Option<Excuse> {
    let (now, window, question) = (truth.now, truth.late_window, question_of(asked));
    let excuses = &mut truth.pages[motor.index()].excuses;
    let excuse = excuses.take(question, now, window).or_else(|| excuses.doubling(now));
    match excuse {
        Some(excuse) => truth.excuse(excuse),
        None => truth.breaks(what()),
    }
    excuse
}

/// Feedback must be that motor's, to a set-point that it has executed, or late to a request of the same kind. Feedback
/// shows the motor's state, but not the command to which it belongs.
pub(super) fn check_feedback(motor: MotorId, reply: &AnyReply, truth: &mut Truth) {
    let data = reply.encode();
    let is_motion = matches!(reply, AnyReply::Motion(_));
    let channel = if is_motion { Channel::MotionReply(motor) } else { Channel::Reply(motor) };
    let packet = Packet { channel, data };
    let name = Name::of(&packet);
    let sending = truth.pages[motor.index()].sendings.get(&name).copied().unwrap_or_default();
    note_angle(motor, &data, &sending, truth);
    if truth.flips || data[3] == DONE && name.moves() && sending.heard > sending.ignored {
        return;
    }
    let excuse =
        excused_or(motor, &packet, truth, || format!("motor {motor}: {reply:?} is no feedback"));
    if let Some(made_up) = excuse.filter(|excuse| *excuse != Excuse::Doubled) {
        // From such an angle it jumps back.
        let now = truth.now;
        truth.page(motor).misled = Some((made_up, now));
    }
}

/// Notes the angle that the motor reports.
fn note_angle(motor: MotorId, data: &Data, sending: &Sending, truth: &mut Truth) {
    if truth.flips || truth.twin == Some(motor) {
        return;
    }
    let (now, window) = (truth.now, truth.late_window);
    let page = truth.page(motor);
    if !has_angle(data[0]) || data[3] != DONE {
        return page.turning.is_unknown();
    }
    let is_certain = sending.was_answered && sending.delivered == 1;
    page.turning.told(i16::from_le_bytes([data[6], data[7]]), is_certain, now, window);
}

/// The drive must have heard a stop since the stop was called.
pub(super) fn check_confirmed(motor: MotorId, truth: &mut Truth) {
    let now = truth.now;
    let page = &mut truth.pages[motor.index()];
    let may_be = std::mem::take(&mut page.may_be_stopping);
    page.other_stops.clear();
    page.was_given_up = false;
    if !std::mem::take(&mut page.is_stopping) && !may_be {
        return truth.breaks(format!("motor {motor} confirms no stop"));
    }
    if page.stop_heard > page.stop_due_since {
        page.is_confirmed = page.is_stopped;
        return;
    }
    let of_stops = [0x80, 0x81].into_iter().find_map(|byte| page.excuses.of((byte, 0), now));
    match of_stops.or_else(|| page.excuses.doubling(now)) {
        Some(excuse) => truth.excuse(excuse),
        None => truth.breaks(format!("motor {motor} confirms a stop that it has not heard")),
    }
}

pub(super) fn check_report(motor: MotorId, reply: &AnyReply, truth: &mut Truth) {
    let data = reply.encode();
    let packet = Packet { channel: Channel::Reply(motor), data };
    let reports = &truth.pages[motor.index()].reports;
    // Motors that are not expected to answer a broadcast may also answer. And late errors are reported.
    let has_errors = data[0] == 0x9A && data[6..] != [0, 0];
    let may_come = |it: &Sending| it.heard > 0 && (it.put == 0 || has_errors);
    let is_unexpected =
        truth.pages[motor.index()].sendings.get(&Name::of(&packet)).is_some_and(may_come);
    let is_report = is_unexpected || reports.contains(&Name::of(&packet).token)
        // Of an error report, the voltage comes back, but not all bits of the flags.
        || data[0] == 0x9A && reports.iter().any(|token| token.to_le_bytes()[..2] == data[4..6]);
    if !is_report && !truth.flips {
        excused_or(motor, &packet, truth, || format!("motor {motor} reports {reply:?} on its own"));
    }
}

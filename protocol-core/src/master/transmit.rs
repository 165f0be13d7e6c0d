//! What leaves the master, and what becomes of it.

use crate::command::awaits_reply;
use crate::data::Data;
use crate::id::Target;
use crate::kind::Kind;
use crate::master::motor::Motor;
use crate::master::{Master, reported_bit};
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};

/// What [`Master::poll_transmit`] has offered last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Offer {
    /// Of the motor with this place.
    Request(u8),
    /// Of the motor with this place.
    SetPoint(u8),
    Broadcast,
    StopToAll,
}

impl<const N: usize> Master<N> {
    /// What to send next. It counts as sent only after [`handle_transmitted`](Self::handle_transmitted);
    /// until then each call chooses anew, so that what was offered is never staler than what waits.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Packet> {
        self.now = now;
        self.offer = None;
        if self.config.is_rs485() && self.busy_until > now {
            return None;
        }
        let offer = if self.config.is_rs485() && self.is_anything_in_flight() {
            self.choose_interruption().filter(|&(at, _)| at <= now)?.1
        } else {
            self.choose(now)?
        };
        self.offer = Some(offer);
        match offer {
            Offer::Request(place) => self.motors.get(usize::from(place))?.request_packet(),
            Offer::SetPoint(place) => self.motors.get(usize::from(place))?.set_point_packet(),
            Offer::Broadcast => self.broadcast.packet(),
            Offer::StopToAll => self.stop_to_all_packet(),
        }
    }

    /// The bus has taken what [`poll_transmit`](Self::poll_transmit) offered last. On RS485: its
    /// last byte has left.
    ///
    /// Nothing may be asked of the master between the two: a call that puts or stops something takes the offer
    /// back, so that a frame which was taken all the same would count as never sent, and be sent again.
    pub fn handle_transmitted(&mut self, now: Instant) {
        self.now = now;
        let Some(offer) = self.offer.take() else { return };
        // An answer that nobody waits for may come all the same, and must not meet a command.
        let mut silence = Duration::ZERO;
        match offer {
            Offer::Request(place) => {
                let place = usize::from(place);
                let Some(asked) = self.motors.get(place).and_then(|m| m.request.waiting().copied())
                else {
                    return;
                };
                let pause = (!awaits_reply(asked.kind(), &asked.data)).then(|| {
                    silence = self.config.settle_time;
                    self.config.hold_after(asked.kind())
                });
                self.due = now;
                let round = self.change_at(place, |motor, config| {
                    motor.request_was_sent(now, pause, config);
                    note_report(motor, asked.kind(), &asked.data);
                    motor.round
                });
                self.pace = round.unwrap_or(self.pace);
            }
            Offer::SetPoint(place) => {
                let place = usize::from(place);
                self.due = self.due.min(now + self.config.longest_response);
                let round = self.change_at(place, |motor, _| {
                    motor.set_point_was_sent(now);
                    motor.round
                });
                self.pace = round.unwrap_or(self.pace);
            }
            Offer::Broadcast => {
                if let (Some(kind), data) = self.broadcast.command() {
                    for place in self.places.taken.iter() {
                        self.change_at(place, |motor, _| note_report(motor, kind, &data));
                    }
                }
                self.broadcast.was_sent(now, &self.config);
            }
            Offer::StopToAll => {
                self.stop_to_all = None;
                silence = self.config.settle_time;
            }
        }
        if self.config.is_rs485() {
            self.line_is_free_after_turnaround(now + silence);
        } else {
            self.bus_is_busy(now);
        }
    }

    /// The bus has handed back a frame that it had taken, because another was more urgent: it was not
    /// sent. It waits again, unless something newer does.
    pub fn handle_pushed_out(&mut self, packet: &Packet) {
        self.offer = None;
        self.due = self.now;
        match packet.channel {
            Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => {
                let (now, ended) = (self.now, self.broadcast.ended_motion());
                self.change(motor, |motor, _| {
                    motor.was_pushed_out(packet, ended);
                    // It is offered again before anybody looks at the time.
                    motor.drop_what_is_too_old(now);
                });
            }
            Channel::Command(Target::All) | Channel::BusId => {
                self.broadcast.was_pushed_out(packet, self.is_any_stopped());
            }
            Channel::Reply(_) | Channel::MotionReply(_) => {}
        }
    }
}

/// Keeps track of what a motor reports by itself, from the commands that switch it.
fn note_report(motor: &mut Motor, sent: Kind, data: &Data) {
    match sent.opcode() {
        Some(Opcode::Reset) => motor.note_reports(u8::MAX, None),
        Some(Opcode::ActiveReply) => {
            let [_, command, enable, low, high, ..] = *data;
            let bit = Opcode::from_byte(command).and_then(reported_bit).unwrap_or(0);
            let interval = u16::from_le_bytes([low, high]);
            motor.note_reports(bit, (enable != 0).then_some(interval));
        }
        _ => {}
    }
}

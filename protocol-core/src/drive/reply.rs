//! Under which id a drive replies, and when.

use crate::drive::{Bus, Drive, Memory, Outgoing, Parameters, Plant, Quirks};
use crate::id::{MotorId, Target};
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};
use crate::wire::rs485::FRAME_LENGTH;

/// What a drive remembers of its replies until a restart.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Replies {
    last: Option<Packet>,
    /// Until then it writes its ROM.
    busy_until: Instant,
}

impl Replies {
    /// Answers nothing before `until`.
    pub(super) fn wait_until(&mut self, until: Instant) {
        self.busy_until = until;
    }
}

impl<P: Plant, M: Memory> Drive<P, M> {
    /// The id under which it sends replies.
    pub(super) const fn replies_as(&self) -> MotorId {
        if self.parameters.quirks.answers_as_new_id { self.stored.id } else { self.active.id }
    }

    /// Queues the reply to a command that came on this channel. Replies leave in the order of their commands: the first
    /// in the queue delays those after it, as a drive does one thing after the other.
    pub(super) fn reply(&mut self, packet: Packet, to: Channel, now: Instant) {
        let Parameters { response_delay_min: min, response_delay_max: max, .. } = self.parameters;
        let begun = now.max(self.replies.busy_until);
        let due = begun + self.random.between(min, max) + self.turn(to);
        self.replies.last = Some(packet);
        self.outgoing.push(Outgoing { due, packet });
    }

    /// Answers a command that the drive does not know: not at all, unless a quirk is on.
    pub(super) fn reply_to_unknown(&mut self, to: Channel, now: Instant) {
        let last = self.replies.last.filter(|_| self.parameters.quirks.repeats_last_reply);
        if let Some(last) = last {
            self.reply(last, to, now);
        }
    }

    /// How long the drive lets others answer first, as [`broadcast_slots`](Quirks::broadcast_slots) says.
    fn turn(&self, to: Channel) -> Duration {
        let Parameters { quirks, bus, response_delay_min, response_delay_max, .. } =
            self.parameters;
        let to_all = matches!(to, Channel::Command(Target::All) | Channel::BusId);
        if !(quirks.broadcast_slots && bus == Bus::Rs485 && to_all) {
            return Duration::ZERO;
        }
        // A byte is ten bits on the line.
        let rate = self.active.baud_rate.rs485_bits_per_second().unwrap_or(115_200);
        let frame = (FRAME_LENGTH as u64 * 10_000_000).div_ceil(u64::from(rate));
        let spread = response_delay_max - response_delay_min;
        let slot = Duration::from_micros(frame) + spread + Quirks::SLOT_GUARD;
        slot.times(u32::from(self.replies_as().get()) - 1)
    }
}

//! A command to all motors, and who has answered it.

use crate::channel::{Channel, Packet};
use crate::field::Data;
use crate::id::{MotorId, Target};
use crate::master::ticks::{Span, Tick};
use crate::master::{Master, MotorSet};
use crate::opcode::Opcode;
use crate::time::Instant;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    None,
    Waiting,
    InFlight,
    Done,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Broadcast {
    data: Data,
    expected: MotorSet,
    answered: MotorSet,
    deadline: Tick,
    state: State,
}

impl Broadcast {
    pub(super) fn new(data: Data, expected: MotorSet) -> Self {
        Self {
            data,
            expected,
            answered: MotorSet::EMPTY,
            deadline: Tick::default(),
            state: State::Waiting,
        }
    }

    pub(super) fn is_active(&self) -> bool {
        self.state != State::None
    }

    pub(super) fn is_waiting(&self) -> bool {
        self.state == State::Waiting
    }

    pub(super) fn is_in_flight(&self) -> bool {
        self.state == State::InFlight
    }

    pub(super) fn cancel(&mut self) {
        if self.is_active() {
            self.state = State::Done;
        }
    }

    fn is_bus_id(&self) -> bool {
        Opcode::BusId.byte() == Some(self.data[0])
    }

    pub(super) fn packet(&self) -> Packet {
        let channel = if self.is_bus_id() { Channel::BusId } else { Channel::Command(Target::All) };
        Packet { channel, data: self.data }
    }

    pub(super) fn was_sent(&mut self, now: Instant, timeout: Span) {
        let opcode = Opcode::from_byte(self.data[0]);
        let awaits_reply = opcode.is_some_and(Opcode::has_reply) && !self.expected.is_empty();
        self.state = if awaits_reply { State::InFlight } else { State::Done };
        self.deadline = Tick::after(now, timeout);
    }

    /// Whether this reply of `motor` answers the broadcast; each motor does so once.
    pub(super) fn take_reply(&mut self, motor: MotorId, data: &Data) -> bool {
        let opcode = Opcode::from_byte(self.data[0]);
        let answers = self.is_in_flight()
            && opcode.is_some_and(|opcode| opcode.answers(&self.data, data))
            && !self.answered.contains(motor);
        if answers {
            self.answered.insert(motor);
            if self.expected.without(self.answered).is_empty() {
                self.state = State::Done;
            }
        }
        answers
    }

    pub(super) fn poll_at(&self, now: Instant) -> Option<Instant> {
        self.is_in_flight().then(|| self.deadline.instant(now))
    }

    pub(super) fn bridge_gap(&mut self, now: Instant) {
        self.deadline = Tick::at(now);
    }

    /// The silent ones of a broadcast that is over, once.
    pub(super) fn take_result(&mut self) -> Option<MotorSet> {
        (self.state == State::Done).then(|| {
            self.state = State::None;
            self.silent()
        })
    }

    fn silent(&self) -> MotorSet {
        self.expected.without(self.answered)
    }
}

impl<const N: usize> Master<N> {
    /// Ends a broadcast whose time is up. The silent ones may still answer it late.
    pub(super) fn age_broadcast(&mut self, now: Instant) {
        if !self.broadcast.is_in_flight() || !self.broadcast.deadline.is_reached(now) {
            return;
        }
        self.broadcast.state = State::Done;
        let (silent, late_window) = (self.broadcast.silent(), self.config.late_window());
        for (lane, tally) in self.lanes.iter_mut().zip(&mut self.tallies) {
            if lane.motor.is_some_and(|motor| silent.contains(motor)) {
                lane.missed(tally);
                lane.owe_one_more(now, late_window);
            }
        }
    }
}

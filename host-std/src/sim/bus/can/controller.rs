//! A station's CAN controller: its queue and its error counters.

use std::collections::VecDeque;

use myactuator_protocol_core::wire::can::SimpleFrame;

use super::bus::Ending;
use super::timing::arbitration_key;
use crate::sim::bus::nanos::{Nanos, bits};

/// From this count of either counter on, a controller is error-passive.
const PASSIVE: u16 = 128;
/// Above this transmit error count a controller leaves the bus.
const BUS_OFF_ABOVE: u16 = 255;
/// How much longer an error-passive sender waits.
const SUSPEND: u64 = 8;
/// Eleven recessive bits make one sequence towards the end of bus-off.
const SEQUENCE: u64 = 11;
/// How many sequences end it.
const RECOVERY_SEQUENCES: u64 = 128;
/// The wire of all stations whose own is not cut.
pub(super) const COMMON_WIRE: usize = 0;

/// Which frame of a transmit queue goes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueueOrder {
    /// The oldest, as in SocketCAN. An important frame waits for the others.
    Fifo,
    /// The one with the highest priority on the bus, or the oldest of equal ones, as with mailboxes. If
    /// all mailboxes are taken, a new frame replaces one of lower priority; see
    /// [`embedded_can::nb::Can::transmit`].
    Priority,
}

/// A CAN controller's properties.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControllerConfig {
    /// How many frames can wait for the bus, including the one on the wire. 0 counts as 1.
    pub transmit_queue: usize,
    /// Which of them goes first.
    pub order: QueueOrder,
    /// How many frames can wait to be read. Further frames are lost, and counted. A
    /// [`Node`](crate::sim::bus::Node) takes its frames at once and needs no such queue.
    pub receive_queue: usize,
}

impl ControllerConfig {
    /// Linux's usual CAN interface: ten frames in order.
    pub const SOCKETCAN: Self =
        Self { transmit_queue: 10, order: QueueOrder::Fifo, receive_queue: 1024 };
    /// A microcontroller's: three mailboxes by priority.
    pub const MAILBOXES: Self =
        Self { transmit_queue: 3, order: QueueOrder::Priority, receive_queue: 64 };
}

/// The error state of a controller (fault confinement of ISO 11898-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorState {
    /// Takes part fully.
    Active,
    /// Has counted 128 errors: it waits eight bits longer before it sends again, and cannot destroy
    /// others' frames.
    Passive,
    /// Has counted more than 255 transmit errors and takes no part.
    BusOff,
}

/// The status of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControllerStatus {
    /// Transmit error count: 8 more for a failed frame, 1 less for a good one.
    pub transmit_errors: u16,
    /// Receive error count: 1 more for a broken frame, 1 less for a good one.
    pub receive_errors: u16,
    /// The state that follows from them.
    pub state: ErrorState,
    /// Frames that wait for the bus, the one on the wire included.
    pub queued: usize,
    /// Received frames that wait to be read.
    pub received: usize,
    /// Received frames that were lost because nobody had read those before.
    pub overflows: u64,
}

#[derive(Debug)]
struct Pending {
    frame: SimpleFrame,
    key: u64,
    since: Nanos,
    on_wire: bool,
}

/// A station's part in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Sender,
    Receiver,
    /// It has another bit rate, so it finds an error in every frame.
    Stranger,
}

/// A controller that waits for the end of bus-off.
#[derive(Clone, Copy, Debug)]
struct Recovery {
    /// Sequences of eleven recessive bits that are still missing.
    wanted: u64,
    /// From when on the bus has been idle.
    since: Nanos,
}

#[derive(Debug)]
pub(super) struct Controller {
    config: ControllerConfig,
    pub(super) bit_rate: u32,
    /// In the order of sending.
    queue: VecDeque<Pending>,
    transmit_errors: u16,
    receive_errors: u16,
    /// Until when an error-passive sender waits.
    suspended_until: Nanos,
    recovery: Option<Recovery>,
    /// [`COMMON_WIRE`], or its own stub.
    pub(super) wire: usize,
    /// From when on it follows what is on its wire.
    pub(super) joined: Nanos,
}

impl Controller {
    pub(super) fn new(config: ControllerConfig, bit_rate: u32) -> Self {
        Self {
            config,
            bit_rate,
            queue: VecDeque::new(),
            transmit_errors: 0,
            receive_errors: 0,
            suspended_until: 0,
            recovery: None,
            wire: COMMON_WIRE,
            joined: 0,
        }
    }

    /// How long this many of its bits last.
    pub(super) fn bits(&self, count: u64) -> Nanos {
        bits(count, self.bit_rate)
    }

    /// When silence ends its bus-off.
    pub(super) fn recovers_at(&self) -> Option<Nanos> {
        let Recovery { wanted, since } = self.recovery?;
        Some(since.saturating_add(self.bits(wanted * SEQUENCE)))
    }

    pub(super) fn state(&self) -> ErrorState {
        if self.is_bus_off() {
            ErrorState::BusOff
        } else if self.transmit_errors.max(self.receive_errors) >= PASSIVE {
            ErrorState::Passive
        } else {
            ErrorState::Active
        }
    }

    pub(super) const fn is_bus_off(&self) -> bool {
        self.transmit_errors > BUS_OFF_ABOVE
    }

    /// Its status, with what its port knows of received frames.
    pub(super) fn status(&self, (received, overflows): (usize, u64)) -> ControllerStatus {
        ControllerStatus {
            transmit_errors: self.transmit_errors,
            receive_errors: self.receive_errors,
            state: self.state(),
            queued: self.queue.len(),
            received,
            overflows,
        }
    }

    pub(super) fn room(&self) -> usize {
        self.config.transmit_queue.max(1).saturating_sub(self.queue.len())
    }

    /// From when on it has a frame to send, and that frame's priority.
    pub(super) fn wants_bus(&self) -> Option<(Nanos, u64)> {
        if self.is_bus_off() {
            return None;
        }
        let pending = self.queue.front()?;
        Some((pending.since.max(self.suspended_until), pending.key))
    }

    pub(super) fn push(&mut self, frame: SimpleFrame, now: Nanos) -> bool {
        if self.room() == 0 {
            return false;
        }
        let key = arbitration_key(&frame);
        let place = match self.config.order {
            QueueOrder::Fifo => self.queue.len(),
            QueueOrder::Priority => self.queue.partition_point(|pending| pending.key <= key),
        };
        self.queue.insert(place, Pending { frame, key, since: now, on_wire: false });
        true
    }

    /// Takes back a queued frame of lower priority than this one: the youngest of the lowest. Never the one on the
    /// wire.
    pub(super) fn displace(&mut self, by: &SimpleFrame) -> Option<SimpleFrame> {
        if self.config.order != QueueOrder::Priority {
            return None;
        }
        let key = arbitration_key(by);
        let gives_way = |pending: &Pending| pending.key > key && !pending.on_wire;
        let place = self.queue.iter().rposition(gives_way)?;
        Some(self.queue.remove(place)?.frame)
    }

    /// The frame that goes first.
    pub(super) fn next_frame(&self) -> Option<SimpleFrame> {
        Some(self.queue.front()?.frame)
    }

    /// Puts the first frame on the wire.
    pub(super) fn begin(&mut self) {
        if let Some(pending) = self.queue.front_mut() {
            pending.on_wire = true;
        }
    }

    /// The frame on the wire is done. If it failed, it stays for the next attempt.
    pub(super) fn end(&mut self, ending: Ending) {
        if let Some(place) = self.queue.iter().position(|pending| pending.on_wire) {
            match ending {
                Ending::Sent { .. } => drop(self.queue.remove(place)),
                Ending::Unacknowledged | Ending::Broken => self.queue[place].on_wire = false,
            }
        }
    }

    /// After a frame of its own: applies what its errors forbid from when the bus is free again.
    pub(super) fn stand_back(&mut self, free_at: Nanos) {
        match self.state() {
            ErrorState::Active => {}
            ErrorState::Passive => self.suspended_until = free_at + self.bits(SUSPEND),
            ErrorState::BusOff => {
                self.recovery = Some(Recovery { wanted: RECOVERY_SEQUENCES, since: free_at });
            }
        }
    }

    /// Silence begins at `at`, after this many sequences of recessive bits.
    pub(super) fn begin_silence(&mut self, at: Nanos, sequences: u64) {
        if let Some(recovery) = &mut self.recovery {
            recovery.wanted = recovery.wanted.saturating_sub(sequences);
            recovery.since = at;
        }
    }

    /// The wire is busy from `at` on. Counts the silence before towards the end of bus-off.
    pub(super) fn end_silence(&mut self, at: Nanos) {
        let sequence = self.bits(SEQUENCE);
        if let Some(recovery) = &mut self.recovery {
            let seen = at.saturating_sub(recovery.since) / sequence;
            recovery.wanted = recovery.wanted.saturating_sub(seen);
        }
    }

    pub(super) fn clear(&mut self) {
        self.queue.clear();
        self.recover();
    }

    /// Counts the outcome of a frame.
    pub(super) fn count(&mut self, ending: Ending, role: Role) {
        let is_active = self.state() == ErrorState::Active;
        match (role, ending) {
            (Role::Sender, Ending::Sent { .. }) => {
                self.transmit_errors = self.transmit_errors.saturating_sub(1);
            }
            // Missing acknowledgements alone lead to error-passive and never to bus-off.
            (Role::Sender, Ending::Unacknowledged) if !is_active => {}
            (Role::Sender, Ending::Unacknowledged | Ending::Broken) => {
                self.transmit_errors = self.transmit_errors.saturating_add(8);
            }
            (Role::Receiver, Ending::Sent { .. }) => {
                self.receive_errors = self.receive_errors.saturating_sub(1);
            }
            (Role::Receiver, Ending::Unacknowledged) => {}
            (Role::Receiver, Ending::Broken) => self.count_received(1),
            // It hears the others' flags after its own.
            (Role::Stranger, _) => self.count_received(if is_active { 1 + 8 } else { 1 }),
        }
    }

    /// More than 128 means nothing: the state stays the same from there on.
    fn count_received(&mut self, errors: u16) {
        self.receive_errors = (self.receive_errors + errors).min(PASSIVE);
    }

    pub(super) fn recover(&mut self) {
        self.transmit_errors = 0;
        self.receive_errors = 0;
        self.suspended_until = 0;
        self.recovery = None;
    }
}

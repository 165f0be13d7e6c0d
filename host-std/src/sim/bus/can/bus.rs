//! The wire and who is on it.

use embedded_can::{Frame, StandardId};
use myactuator_protocol_core::wire::can::SimpleFrame;

use super::controller::{
    Controller, ControllerConfig, ErrorState, RECOVERY_SEQUENCES, Recovery, Role, SEQUENCE,
};
use super::timing::{AFTER_ACKNOWLEDGE, INTERMISSION, frame_bits};
use crate::sim::bus::faults::Disturbance;
use crate::sim::bus::medium::{Arrival, Medium, Part, Surroundings, Wire, sealed::Bus};
use crate::sim::bus::nanos::{NEVER, Nanos, bits};
use crate::sim::bus::random::Random;
use crate::sim::bus::trace::Event;

/// Flag of six bits, the others' echo of six more, delimiter of eight.
const ERROR_FRAME: u32 = 6 + 6 + 8;
/// The flag of a sender that nobody hears has no echo.
const LONE_ERROR_FRAME: u32 = 6 + 8;
/// How much longer an error-passive sender waits.
const SUSPEND: u32 = 8;
/// A stranger signals an error after so many of its own bits, of which five at most may be equal.
const STRANGE: u32 = 6;

/// How a frame on the wire will end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ending {
    /// Whole, and maybe with a data bit flipped that nobody notices.
    Sent {
        flipped: Option<u64>,
    },
    Unacknowledged,
    /// With an error frame.
    Broken,
}

#[derive(Debug)]
struct Transmission {
    /// All that send this very frame.
    senders: Vec<usize>,
    frame: SimpleFrame,
    started: Nanos,
    ending: Ending,
    /// That of the senders.
    bit_rate: u32,
    /// In what bits its end is counted: those of the slowest that signals an error.
    end_rate: u32,
}

#[derive(Debug)]
enum Phase {
    Idle {
        since: Nanos,
    },
    Sending {
        transmission: Transmission,
        until: Nanos,
    },
    /// Error frame and intermission.
    Gap {
        until: Nanos,
    },
}

/// A CAN bus and the controllers on it.
#[derive(Debug)]
pub struct CanBus {
    /// That of whoever has no other.
    bit_rate: u32,
    pub(super) controllers: Vec<Controller>,
    /// The common wire, then each station's stub.
    wires: Vec<Phase>,
    messages: u64,
}

const fn place(wire: Wire) -> usize {
    match wire {
        Wire::Common => 0,
        Wire::Stub(station) => station + 1,
    }
}

impl CanBus {
    pub(super) fn new(bit_rate: u32) -> Self {
        Self {
            bit_rate,
            controllers: Vec::new(),
            wires: vec![Phase::Idle { since: 0 }],
            messages: 0,
        }
    }

    /// The wires with somebody on them.
    fn wires(&self) -> Vec<Wire> {
        let stubs = self.controllers.iter().map(|controller| controller.wire);
        let stubs = stubs.filter(|&wire| wire != Wire::Common);
        std::iter::once(Wire::Common).chain(stubs).collect()
    }

    fn on(&self, wire: Wire) -> impl Iterator<Item = (usize, &Controller)> {
        self.controllers.iter().enumerate().filter(move |(_, controller)| controller.wire == wire)
    }

    fn on_mut(&mut self, wire: Wire) -> impl Iterator<Item = (usize, &mut Controller)> {
        let all = self.controllers.iter_mut().enumerate();
        all.filter(move |(_, controller)| controller.wire == wire)
    }

    fn next_on(&self, wire: Wire) -> Nanos {
        match &self.wires[place(wire)] {
            Phase::Sending { until, .. } | Phase::Gap { until } => *until,
            Phase::Idle { since } => {
                let mut next = NEVER;
                for (_, controller) in self.on(wire) {
                    if let Some((from, _)) = controller.wants_bus() {
                        next = next.min(from.max(*since));
                    }
                    if let Some(at) = controller.recovers_at() {
                        next = next.min(at);
                    }
                }
                next
            }
        }
    }

    /// The wire is taken from `now` on: counts what silence there was towards the end of bus-off.
    fn end_silence(&mut self, wire: Wire, now: Nanos) {
        for (_, controller) in self.on_mut(wire) {
            let sequence = controller.bits(SEQUENCE);
            if let Some(recovery) = &mut controller.recovery {
                let seen = now.saturating_sub(recovery.since) / sequence;
                recovery.wanted = recovery.wanted.saturating_sub(seen);
            }
        }
    }

    /// The wire is free again at `until`; the delimiter, end of frame and intermission before were
    /// one sequence of eleven recessive bits.
    fn begin_silence(&mut self, wire: Wire, until: Nanos) {
        for (_, controller) in self.on_mut(wire) {
            if let Some(recovery) = &mut controller.recovery {
                recovery.wanted = recovery.wanted.saturating_sub(1);
                recovery.since = until;
            }
        }
    }

    /// Whether somebody has followed what these send from its beginning, and acknowledges it.
    fn is_heard(&self, wire: Wire, senders: &[usize], bit_rate: u32, started: Nanos) -> bool {
        let mut others = self.on(wire).filter(|(station, _)| !senders.contains(station));
        others.any(|(_, other)| {
            other.bit_rate == bit_rate && other.joined <= started && !other.is_bus_off()
        })
    }

    fn start_on(&mut self, wire: Wire, around: &mut Surroundings<SimpleFrame>) {
        let now = around.now;
        let waiting = |(station, controller): (usize, &Controller)| {
            let (from, key) = controller.wants_bus()?;
            (from <= now).then_some((key, station))
        };
        let Some((_, first)) = self.on(wire).filter_map(waiting).min() else { return };
        let Some(frame) = self.controllers[first].next_frame() else { return };
        let bit_rate = self.controllers[first].bit_rate;
        let senders: Vec<usize> = self
            .on(wire)
            .filter(|(_, it)| it.bit_rate == bit_rate && it.next_frame() == Some(frame))
            .filter_map(waiting)
            .map(|(_, station)| station)
            .collect();
        self.end_silence(wire, now);
        for &station in &senders {
            self.controllers[station].begin();
        }
        let length = frame_bits(&frame) - INTERMISSION;
        let disturbance = around.injector.disturbance(first, length);
        let is_heard = self.is_heard(wire, &senders, bit_rate, now);
        let (mut is_broken_after, mut end_rate) = (NEVER, bit_rate);
        for (_, other) in self.on(wire) {
            if other.bit_rate != bit_rate && other.state() == ErrorState::Active {
                is_broken_after = is_broken_after.min(other.bits(STRANGE));
                end_rate = end_rate.min(other.bit_rate);
            }
        }
        let (ending, taken) = match disturbance {
            Some(Disturbance::Detected(bit)) => (Ending::Broken, bit),
            _ if is_broken_after < NEVER => (Ending::Broken, length),
            _ if !is_heard => (Ending::Unacknowledged, length - AFTER_ACKNOWLEDGE),
            Some(Disturbance::Undetected(bit)) => (Ending::Sent { flipped: Some(bit) }, length),
            None => (Ending::Sent { flipped: None }, length),
        };
        let taken = bits(taken.into(), bit_rate).min(is_broken_after);
        let transmission =
            Transmission { senders, frame, started: now, ending, bit_rate, end_rate };
        self.wires[place(wire)] = Phase::Sending { transmission, until: now + taken };
    }

    fn finish_on(&mut self, wire: Wire, around: &mut Surroundings<SimpleFrame>) {
        let now = around.now;
        let phase = &mut self.wires[place(wire)];
        match phase {
            Phase::Sending { until, .. } if *until <= now => {
                let sent = std::mem::replace(phase, Phase::Gap { until: now });
                if let Phase::Sending { transmission, .. } = sent {
                    self.end_transmission(wire, transmission, around);
                }
            }
            Phase::Gap { until } if *until <= now => {
                *phase = Phase::Idle { since: *until };
                self.recover_on(wire, around);
            }
            Phase::Idle { .. } => self.recover_on(wire, around),
            Phase::Sending { .. } | Phase::Gap { .. } => {}
        }
    }

    fn recover_on(&mut self, wire: Wire, around: &mut Surroundings<SimpleFrame>) {
        for station in 0..self.controllers.len() {
            let controller = &mut self.controllers[station];
            let is_due = controller.recovers_at().is_some_and(|at| at <= around.now);
            if is_due && controller.wire == wire {
                controller.recover();
                around.freed.push(station);
                around.record(station, || Event::Recovered);
            }
        }
    }

    fn end_transmission(
        &mut self,
        wire: Wire,
        transmission: Transmission,
        around: &mut Surroundings<SimpleFrame>,
    ) {
        let Transmission { senders, frame, started: started_ns, ending, bit_rate, end_rate } =
            transmission;
        let now = around.now;
        let gap = match ending {
            Ending::Sent { .. } => INTERMISSION,
            Ending::Unacknowledged => LONE_ERROR_FRAME + INTERMISSION,
            Ending::Broken => ERROR_FRAME + INTERMISSION,
        };
        let free_at = now + bits(gap.into(), end_rate);
        self.wires[place(wire)] = Phase::Gap { until: free_at };
        self.begin_silence(wire, free_at);
        let mut deaf = senders.clone();
        for (station, controller) in self.on_mut(wire) {
            if senders.contains(&station) {
                controller.count(ending, Role::Sender);
            } else if controller.joined > started_ns {
                // It waits for the end of what it has not heard begin.
            } else if controller.bit_rate != bit_rate {
                deaf.push(station);
                controller.count(ending, Role::Stranger);
            } else {
                controller.count(ending, Role::Receiver);
            }
        }
        for &station in &senders {
            let controller = &mut self.controllers[station];
            controller.end(ending);
            match controller.state() {
                ErrorState::Active => {}
                ErrorState::Passive => {
                    controller.suspended_until = free_at + controller.bits(SUSPEND);
                }
                ErrorState::BusOff => {
                    controller.recovery =
                        Some(Recovery { wanted: RECOVERY_SEQUENCES, since: free_at });
                    around.record(station, || Event::BusOff);
                }
            }
            around.record(station, || match ending {
                Ending::Sent { .. } => Event::Carried { frame, started_ns },
                Ending::Unacknowledged => Event::Unacknowledged { frame, started_ns },
                Ending::Broken => Event::Broken { frame, started_ns },
            });
        }
        if let Ending::Sent { flipped } = ending {
            around.freed.extend(&senders);
            let mut unit = frame;
            if let Some(bit) = flipped {
                Self::flip_bit(&mut unit, bit);
            }
            self.messages += 1;
            let message = self.messages;
            let part = Some(Part { message, index: 0, of: 1, whole: Some(unit) });
            around.arrivals.push(Arrival {
                sender: senders[0],
                deaf,
                started: started_ns,
                on: wire,
                unit,
                part,
            });
        }
    }

    /// Ends a station's part in what is on its wire, because it is leaving that or is being reset: it follows what
    /// begins from now on.
    fn break_off(&mut self, station: usize, around: &mut Surroundings<SimpleFrame>) {
        let wire = self.controllers[station].wire;
        self.controllers[station].joined = around.now;
        let Phase::Sending { transmission, until } = &mut self.wires[place(wire)] else { return };
        if transmission.senders == [station] {
            transmission.ending = Ending::Broken;
            *until = around.now;
            return self.finish_on(wire, around);
        }
        // The wire sees no change, unless nobody is left to acknowledge.
        transmission.senders.retain(|&sender| sender != station);
        let Transmission { started, bit_rate, ending, .. } = *transmission;
        let slot_bits = frame_bits(&transmission.frame) - INTERMISSION - AFTER_ACKNOWLEDGE;
        let slot = started + bits(slot_bits.into(), bit_rate);
        let senders = transmission.senders.clone();
        let is_open = matches!(ending, Ending::Sent { .. }) && around.now < slot;
        if is_open
            && !self.is_heard(wire, &senders, bit_rate, started)
            && let Phase::Sending { transmission, until } = &mut self.wires[place(wire)]
        {
            (transmission.ending, *until) = (Ending::Unacknowledged, slot);
        }
        self.controllers[station].end(Ending::Broken);
    }
}

impl Medium for CanBus {}

impl Bus for CanBus {
    type Frame = SimpleFrame;
    type Attachment = ControllerConfig;

    const DELIVERS_CORRUPTED: bool = false;

    fn attach(&mut self, config: ControllerConfig) {
        self.controllers.push(Controller::new(config, self.bit_rate));
        self.wires.push(Phase::Idle { since: 0 });
    }

    fn next_event(&self) -> Nanos {
        self.wires().into_iter().map(|wire| self.next_on(wire)).min().unwrap_or(NEVER)
    }

    fn finish(&mut self, around: &mut Surroundings<SimpleFrame>) {
        for wire in self.wires() {
            self.finish_on(wire, around);
        }
    }

    fn start(&mut self, around: &mut Surroundings<SimpleFrame>) {
        for wire in self.wires() {
            if let Phase::Idle { .. } = self.wires[place(wire)] {
                self.start_on(wire, around);
            }
        }
    }

    fn room(&self, station: usize) -> usize {
        self.controllers[station].room()
    }

    fn submit(&mut self, station: usize, frame: SimpleFrame, now: Nanos) -> bool {
        self.controllers[station].push(frame, now)
    }

    fn hears(&self, station: usize, arrival: &Arrival<SimpleFrame>) -> bool {
        let controller = &self.controllers[station];
        controller.wire == arrival.on
            && controller.joined <= arrival.started
            && !controller.is_bus_off()
            && !arrival.deaf.contains(&station)
    }

    fn cut(&mut self, station: usize, is_cut: bool, around: &mut Surroundings<SimpleFrame>) {
        let wire = if is_cut { Wire::Stub(station) } else { Wire::Common };
        if self.controllers[station].wire == wire {
            return;
        }
        self.break_off(station, around);
        self.controllers[station].wire = wire;
        if is_cut {
            self.wires[place(wire)] = Phase::Idle { since: around.now };
        }
        if let Some(recovery) = &mut self.controllers[station].recovery {
            recovery.since = around.now;
        }
    }

    fn bit_rate(&mut self, station: usize) -> &mut u32 {
        &mut self.controllers[station].bit_rate
    }

    fn reset(&mut self, station: usize, around: &mut Surroundings<SimpleFrame>) {
        self.break_off(station, around);
        self.controllers[station].clear();
        around.freed.push(station);
    }

    fn flip_bit(frame: &mut SimpleFrame, bit: u64) {
        let mut data = [0; 8];
        let length = frame.data().len();
        if length == 0 {
            return;
        }
        data[..length].copy_from_slice(frame.data());
        let bit = bit as usize % (length * 8);
        data[bit / 8] ^= 1 << (bit % 8);
        if let Some(flipped) = SimpleFrame::new(frame.id(), &data[..length]) {
            *frame = flipped;
        }
    }

    fn garbage(random: &mut Random) -> SimpleFrame {
        let id = StandardId::new(random.below(0x800) as u16).unwrap_or(StandardId::MAX);
        let length = random.below(9) as usize;
        let data: [u8; 8] = std::array::from_fn(|_| random.byte());
        // Eight bytes at most always fit.
        SimpleFrame::new(id, &data[..length]).unwrap_or_else(|| Self::garbage(random))
    }

    fn units(frame: &SimpleFrame) -> Vec<SimpleFrame> {
        vec![*frame]
    }
}

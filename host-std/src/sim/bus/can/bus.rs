//! The wire and the stations on it.

use embedded_can::{Frame, StandardId};
use myactuator_protocol_core::wire::can::SimpleFrame;

use super::controller::{COMMON_WIRE, Controller, ControllerConfig, ErrorState, Role};
use super::timing::{AFTER_ACKNOWLEDGE, INTERMISSION, frame_bits};
use crate::sim::bus::faults::Disturbance;
use crate::sim::bus::medium::{Arrival, Medium, Part, Surroundings, flip_bit_of, sealed::Bus};
use crate::sim::bus::nanos::{NEVER, Nanos, bits};
use crate::sim::bus::random::Random;
use crate::sim::bus::trace::Event;

/// A flag of six bits, its echo from the other stations of six more, and a delimiter of eight.
const ERROR_FRAME: u32 = 6 + 6 + 8;
/// The flag of a sender without listeners has no echo.
const LONE_ERROR_FRAME: u32 = 6 + 8;
/// A station at another bit rate signals an error after this many of its own bits. At most five may be equal.
const STRANGE: u64 = 6;

/// How a frame on the wire will end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ending {
    /// Whole, possibly with a flipped data bit that no station notices.
    Sent {
        flipped: Option<u64>,
    },
    Unacknowledged,
    /// With an error frame.
    Broken,
}

#[derive(Debug)]
struct Transmission {
    /// All stations that send this same frame.
    senders: Vec<usize>,
    frame: SimpleFrame,
    started: Nanos,
    ending: Ending,
    /// The wire of the senders.
    bit_rate: u32,
    /// The bits in which its end is counted: those of the slowest station that signals an error.
    end_rate: u32,
}

impl Transmission {
    /// The part of a station on its wire; `None` for one that takes no part.
    fn role(&self, station: usize, controller: &Controller) -> Option<Role> {
        if self.senders.contains(&station) {
            Some(Role::Sender)
        } else if controller.joined > self.started || controller.is_bus_off() {
            // It waits for the end of a frame whose beginning it has not heard.
            None
        } else if controller.bit_rate != self.bit_rate {
            Some(Role::Stranger)
        } else {
            Some(Role::Receiver)
        }
    }

    /// Whether a station acknowledges it.
    fn is_heard(&self, wire: usize, controllers: &[Controller]) -> bool {
        controllers.iter().enumerate().any(|(station, controller)| {
            controller.wire == wire && self.role(station, controller) == Some(Role::Receiver)
        })
    }
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
    /// The rate of stations that have no other.
    bit_rate: u32,
    pub(super) controllers: Vec<Controller>,
    /// The common wire, then each station's stub.
    wires: Vec<Phase>,
    messages: u64,
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

    /// Whether a station is on that wire.
    fn is_used(&self, wire: usize) -> bool {
        wire == COMMON_WIRE || self.controllers[wire - 1].wire == wire
    }

    fn on(&self, wire: usize) -> impl Iterator<Item = (usize, &Controller)> {
        self.controllers.iter().enumerate().filter(move |(_, controller)| controller.wire == wire)
    }

    fn on_mut(&mut self, wire: usize) -> impl Iterator<Item = (usize, &mut Controller)> {
        let all = self.controllers.iter_mut().enumerate();
        all.filter(move |(_, controller)| controller.wire == wire)
    }

    fn next_on(&self, wire: usize) -> Nanos {
        match &self.wires[wire] {
            Phase::Sending { until, .. } | Phase::Gap { until } => *until,
            Phase::Idle { since } => {
                let sends_at = |it: &Controller| Some(it.wants_bus()?.0.max(*since));
                let times = self.on(wire).flat_map(|(_, it)| [sends_at(it), it.recovers_at()]);
                times.flatten().min().unwrap_or(NEVER)
            }
        }
    }

    fn start_on(&mut self, wire: usize, around: &mut Surroundings<SimpleFrame>) {
        let Phase::Idle { .. } = self.wires[wire] else { return };
        let now = around.now;
        let waiting = |(station, controller): (usize, &Controller)| {
            let (from, key) = controller.wants_bus()?;
            (from <= now).then_some((key, station))
        };
        let Some((_, first)) = self.on(wire).filter_map(waiting).min() else { return };
        let Some(frame) = self.controllers[first].next_frame() else { return };
        let bit_rate = self.controllers[first].bit_rate;
        let (mut senders, mut is_broken_after, mut end_rate) = (Vec::new(), NEVER, bit_rate);
        for (station, controller) in self.on_mut(wire) {
            controller.end_silence(now);
            let is_ready = waiting((station, controller)).is_some();
            if is_ready && controller.bit_rate == bit_rate && controller.next_frame() == Some(frame)
            {
                controller.begin();
                senders.push(station);
            } else if controller.bit_rate != bit_rate && controller.state() == ErrorState::Active {
                is_broken_after = is_broken_after.min(controller.bits(STRANGE));
                end_rate = end_rate.min(controller.bit_rate);
            }
        }
        let length = frame_bits(&frame) - INTERMISSION;
        let ending = Ending::Sent { flipped: None };
        let mut transmission =
            Transmission { senders, frame, started: now, ending, bit_rate, end_rate };
        let taken;
        (transmission.ending, taken) = match around.injector.disturbance(first, length) {
            Some(Disturbance::Detected(bit)) => (Ending::Broken, bit),
            _ if is_broken_after < NEVER => (Ending::Broken, length),
            _ if !transmission.is_heard(wire, &self.controllers) => {
                (Ending::Unacknowledged, length - AFTER_ACKNOWLEDGE)
            }
            Some(Disturbance::Undetected(bit)) => (Ending::Sent { flipped: Some(bit) }, length),
            None => (ending, length),
        };
        let until = now + bits(taken.into(), bit_rate).min(is_broken_after);
        self.wires[wire] = Phase::Sending { transmission, until };
    }

    fn finish_on(&mut self, wire: usize, around: &mut Surroundings<SimpleFrame>) {
        let now = around.now;
        let phase = &mut self.wires[wire];
        match phase {
            Phase::Sending { until, .. } | Phase::Gap { until } if *until > now => return,
            Phase::Sending { .. } => {
                let sent = std::mem::replace(phase, Phase::Gap { until: now });
                if let Phase::Sending { transmission, .. } = sent {
                    self.end_transmission(wire, &transmission, around);
                }
                return;
            }
            Phase::Gap { until } => *phase = Phase::Idle { since: *until },
            Phase::Idle { .. } => {}
        }
        for (station, controller) in self.on_mut(wire) {
            if controller.recovers_at().is_some_and(|at| at <= now) {
                controller.recover();
                around.freed.push(station);
                around.record(station, || Event::Recovered);
            }
        }
    }

    fn end_transmission(
        &mut self,
        wire: usize,
        transmission: &Transmission,
        around: &mut Surroundings<SimpleFrame>,
    ) {
        let &Transmission { frame, started: started_ns, ending, end_rate, .. } = transmission;
        let gap = match ending {
            Ending::Sent { .. } => INTERMISSION,
            Ending::Unacknowledged => LONE_ERROR_FRAME + INTERMISSION,
            Ending::Broken => ERROR_FRAME + INTERMISSION,
        };
        let free_at = around.now + bits(gap.into(), end_rate);
        self.wires[wire] = Phase::Gap { until: free_at };
        let mut hearers = Vec::with_capacity(self.controllers.len());
        for (station, controller) in self.on_mut(wire) {
            // Delimiter, end of frame and intermission were one sequence of recessive bits.
            controller.begin_silence(free_at, 1);
            let Some(role) = transmission.role(station, controller) else { continue };
            controller.count(ending, role);
            match role {
                Role::Receiver => hearers.push(station),
                Role::Stranger => {}
                Role::Sender => {
                    controller.end(ending);
                    controller.stand_back(free_at);
                    if controller.is_bus_off() {
                        around.record(station, || Event::BusOff);
                    }
                    around.record(station, || match ending {
                        Ending::Sent { .. } => Event::Carried { frame, started_ns },
                        Ending::Unacknowledged => Event::Unacknowledged { frame, started_ns },
                        Ending::Broken => Event::Broken { frame, started_ns },
                    });
                }
            }
        }
        if let Ending::Sent { flipped } = ending {
            around.freed.extend(&transmission.senders);
            let mut unit = frame;
            if let Some(bit) = flipped {
                Self::flip_bit(&mut unit, bit);
            }
            self.messages += 1;
            let part = Part { message: self.messages, index: 0, of: 1, whole: Some(unit) };
            let sender = transmission.senders[0];
            around.arrivals.push(Arrival { sender, hearers, unit, part: Some(part) });
        }
    }

    /// Ends a station's part in what is on its wire, because it leaves that wire or is reset. It follows what begins
    /// from now on.
    fn break_off(&mut self, station: usize, around: &mut Surroundings<SimpleFrame>) {
        let wire = self.controllers[station].wire;
        self.controllers[station].joined = around.now;
        let Phase::Sending { transmission, until } = &mut self.wires[wire] else { return };
        if transmission.senders == [station] {
            transmission.ending = Ending::Broken;
            *until = around.now;
            return self.finish_on(wire, around);
        }
        transmission.senders.retain(|&sender| sender != station);
        self.controllers[station].end(Ending::Broken);
        // The wire sees no change, unless no station is left to acknowledge.
        let slot_bits = frame_bits(&transmission.frame) - INTERMISSION - AFTER_ACKNOWLEDGE;
        let slot = transmission.started + bits(slot_bits.into(), transmission.bit_rate);
        if matches!(transmission.ending, Ending::Sent { .. })
            && around.now < slot
            && !transmission.is_heard(wire, &self.controllers)
        {
            (transmission.ending, *until) = (Ending::Unacknowledged, slot);
        }
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
        let wires = (0..self.wires.len()).filter(|&wire| self.is_used(wire));
        wires.map(|wire| self.next_on(wire)).min().unwrap_or(NEVER)
    }

    fn finish(&mut self, around: &mut Surroundings<SimpleFrame>) {
        for wire in 0..self.wires.len() {
            if self.is_used(wire) {
                self.finish_on(wire, around);
            }
        }
    }

    fn start(&mut self, around: &mut Surroundings<SimpleFrame>) {
        for wire in 0..self.wires.len() {
            if self.is_used(wire) {
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

    fn cut(&mut self, station: usize, is_cut: bool, around: &mut Surroundings<SimpleFrame>) {
        let wire = if is_cut { station + 1 } else { COMMON_WIRE };
        self.break_off(station, around);
        self.controllers[station].wire = wire;
        if is_cut {
            self.wires[wire] = Phase::Idle { since: around.now };
        }
        self.controllers[station].begin_silence(around.now, 0);
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
        let mut data = frame.data().to_vec();
        flip_bit_of(&mut data, bit);
        if !frame.is_remote_frame()
            && let Some(flipped) = SimpleFrame::new(frame.id(), &data)
        {
            *frame = flipped;
        }
    }

    fn garbage(random: &mut Random) -> SimpleFrame {
        let id = StandardId::new(random.below(0x800) as u16).unwrap_or(StandardId::MAX);
        let length = random.below(9) as usize;
        let data: [u8; 8] = std::array::from_fn(|_| random.byte());
        // Eight bytes always fit.
        SimpleFrame::new(id, &data[..length]).unwrap_or_else(|| Self::garbage(random))
    }

    fn units(frame: &SimpleFrame) -> Vec<SimpleFrame> {
        vec![*frame]
    }
}

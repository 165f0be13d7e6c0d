//! Faults, by chance and on call.
//!
//! Chance is seeded: the same world with the same seed fails in the same places. Each direction has
//! a [`FaultPlan`], and so may each node. Functions of [`World`](super::World) cut and mend a wire, reset a station,
//! slow it down and let it babble, at any time.
//!
//! Faults strike frames on CAN and messages on RS485. A message is what a node returns in one piece
//! or what a master writes in one call.

use super::nanos::{Nanos, from_duration};
use super::random::{Random, Stream};
use myactuator_protocol_core::time::Duration;

/// The direction of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// Sent by a master's port.
    ToNodes,
    /// Sent by a node.
    ToPorts,
    /// What an [echoing](super::rs485::TransceiverConfig::echo) transceiver hands back to its sender.
    Echo,
}

const DIRECTIONS: usize = 3;

/// How likely each fault is. Probabilities are from 0 to 1; less is never, more is always.
///
/// All faults except `corrupt` on CAN are drawn separately for each receiver, as if its own transceiver,
/// controller or adapter failed: a broadcast may reach some and not others, and an echo may break although the message
/// reaches all others. In any case the frame takes its time on the wire, and on CAN it is
/// acknowledged.
///
/// ```
/// use myactuator_host_std::sim::bus::faults::FaultPlan;
///
/// let bad_cable = FaultPlan { lose: 0.01, corrupt: 0.05, ..FaultPlan::NONE };
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultPlan {
    /// The frame does not arrive.
    pub lose: f32,
    /// A bit is disturbed. On RS485 one bit of the message arrives flipped. On CAN all stations see the
    /// disturbance, which takes an error frame and a retransmission, and is counted; it is drawn once
    /// for each attempt, by the plan of the sender's direction (or of the sending node).
    pub corrupt: f32,
    /// CAN only: the share of the corrupted frames that pass the CRC and so arrive with a flipped
    /// data bit. On a real bus that practically never happens, so leave this 0 unless a test is about wrong data.
    pub undetected: f32,
    /// The frame arrives twice.
    pub duplicate: f32,
    /// The frame arrives late, as through a slow adapter. Later frames to that receiver wait for it, so that
    /// delay alone does not change the order.
    pub delay: f32,
    /// The shortest delay of a late frame.
    pub delay_min: Duration,
    /// The longest delay of a late frame.
    pub delay_max: Duration,
    /// The frame arrives after the next one.
    pub reorder: f32,
    /// How long a reordered frame waits for the next one. Then it arrives without it.
    pub reorder_hold: Duration,
}

impl FaultPlan {
    /// No faults. A delay would be 1 to 5 ms, and a reordered frame would wait for 10 ms.
    pub const NONE: Self = Self {
        lose: 0.0,
        corrupt: 0.0,
        undetected: 0.0,
        duplicate: 0.0,
        delay: 0.0,
        delay_min: Duration::from_millis(1),
        delay_max: Duration::from_millis(5),
        reorder: 0.0,
        reorder_hold: Duration::from_millis(10),
    };

    fn is_quiet(&self) -> bool {
        let chances = [self.lose, self.corrupt, self.duplicate, self.delay, self.reorder];
        // NaN is never, like 0.
        !chances.iter().any(|&chance| chance > 0.0)
    }
}

/// What a babbling station sends.
#[derive(Clone, Debug, PartialEq)]
pub struct Babble<F> {
    /// Time from one frame to the next; at least a microsecond.
    pub interval: Duration,
    /// The same frame again and again; `None` for random ones: on CAN any standard identifier, length
    /// and data, on RS485 1 to 16 bytes.
    pub frame: Option<F>,
}

/// What happens to a message on its way to one receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Fate {
    pub(crate) lost: bool,
    /// Which unit of the message, and which bit of that unit.
    pub(crate) flipped: Option<(usize, u64)>,
    pub(crate) duplicated: bool,
    pub(crate) late_by: Option<Nanos>,
    /// How long it waits for the message after it.
    pub(crate) held_for: Option<Nanos>,
}

/// What happens to a CAN frame on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Disturbance {
    /// An error frame begins at this bit.
    Detected(u32),
    /// This data bit is flipped, and no station notices.
    Undetected(u64),
}

#[derive(Clone, Copy, Debug)]
struct Station {
    is_node: bool,
    /// Its own plans, which replace the directions'.
    own: [Option<FaultPlan>; DIRECTIONS],
}

/// Draws the faults.
#[derive(Debug)]
pub(crate) struct Injector {
    plans: [FaultPlan; DIRECTIONS],
    stations: Vec<Station>,
    random: [Random; DIRECTIONS],
    pub(crate) babble: Random,
}

impl Injector {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            plans: [FaultPlan::NONE; DIRECTIONS],
            stations: Vec::new(),
            random: [Stream::ToNodes, Stream::ToPorts, Stream::Echo]
                .map(|stream| Random::new(seed, stream)),
            babble: Random::new(seed, Stream::Babble),
        }
    }

    pub(crate) fn attach(&mut self, is_node: bool) {
        self.stations.push(Station { is_node, own: [None; DIRECTIONS] });
    }

    pub(crate) fn set(&mut self, direction: Direction, plan: FaultPlan) {
        self.plans[direction as usize] = plan;
    }

    pub(crate) fn set_own(
        &mut self,
        station: usize,
        direction: Direction,
        plan: Option<FaultPlan>,
    ) {
        self.stations[station].own[direction as usize] = plan;
    }

    /// Changes a direction's plan for all stations, or for one, which has its own plan from then on.
    pub(crate) fn change(
        &mut self,
        station: Option<usize>,
        direction: Direction,
        change: impl Fn(&mut FaultPlan),
    ) {
        let way = direction as usize;
        let common = &mut self.plans[way];
        if let Some(station) = station {
            change(self.stations[station].own[way].get_or_insert(*common));
        } else {
            let own = self.stations.iter_mut().filter_map(|station| station.own[way].as_mut());
            own.chain([common]).for_each(change);
        }
    }

    /// Whether there is nothing to draw.
    pub(crate) fn is_quiet(&self) -> bool {
        let own = self.stations.iter().flat_map(|station| station.own.iter().flatten());
        self.plans.iter().chain(own).all(FaultPlan::is_quiet)
    }

    fn direction(&self, sender: usize) -> Direction {
        if self.stations[sender].is_node { Direction::ToPorts } else { Direction::ToNodes }
    }

    /// The plan of the node at either end, or else of the direction. For an echo, the plan of the station that hears
    /// it.
    fn plan(&self, sender: usize, receiver: usize, direction: Direction) -> FaultPlan {
        let node = if self.stations[sender].is_node { sender } else { receiver };
        let way = direction as usize;
        self.stations[node].own[way].unwrap_or(self.plans[way])
    }

    /// Whether a CAN frame of this many bits, excluding the intermission, is disturbed on the wire.
    pub(crate) fn disturbance(&mut self, sender: usize, bits: u32) -> Option<Disturbance> {
        let direction = self.direction(sender);
        let plan = self.plan(sender, sender, direction);
        let random = &mut self.random[direction as usize];
        if !random.chance(plan.corrupt) {
            return None;
        }
        Some(if random.chance(plan.undetected) {
            Disturbance::Undetected(random.below(64))
        } else {
            Disturbance::Detected(1 + random.below(bits.into()) as u32)
        })
    }

    /// What happens to a message of this many units between these two; if they are one station, to its echo. `corrupts`
    /// says whether corruption strikes here; on CAN it strikes on the wire.
    pub(crate) fn fate(
        &mut self,
        sender: usize,
        receiver: usize,
        units: usize,
        corrupts: bool,
    ) -> Fate {
        let is_echo = sender == receiver;
        let direction = if is_echo { Direction::Echo } else { self.direction(sender) };
        let plan = self.plan(sender, receiver, direction);
        let random = &mut self.random[direction as usize];
        let lost = random.chance(plan.lose);
        let flipped = (corrupts && random.chance(plan.corrupt))
            .then(|| (random.below(units as u64) as usize, random.below(8)));
        let duplicated = random.chance(plan.duplicate);
        let late_by = random.chance(plan.delay).then(|| {
            let least = from_duration(plan.delay_min);
            let spread = from_duration(plan.delay_max).saturating_sub(least);
            least.saturating_add(random.below(spread.saturating_add(1)))
        });
        let held_for = random.chance(plan.reorder).then(|| from_duration(plan.reorder_hold));
        Fate { lost, flipped, duplicated, late_by, held_for }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: usize = 1;

    fn injector(direction: Direction, plan: FaultPlan) -> Injector {
        let mut injector = Injector::new(3);
        injector.attach(false);
        injector.attach(true);
        injector.set(direction, plan);
        injector
    }

    #[test]
    fn a_nodes_own_plan_goes_first() {
        let mut injector = injector(Direction::ToNodes, FaultPlan { lose: 1.0, ..FaultPlan::NONE });
        injector.set_own(NODE, Direction::ToNodes, Some(FaultPlan::NONE));
        assert!(!injector.fate(0, NODE, 1, true).lost);
        injector.set_own(NODE, Direction::ToNodes, None);
        assert!(injector.fate(0, NODE, 1, true).lost);
    }

    #[test]
    fn delay_stays_within_its_bounds() {
        let plan = FaultPlan {
            delay: 1.0,
            delay_min: Duration::from_micros(10),
            delay_max: Duration::from_micros(12),
            ..FaultPlan::NONE
        };
        let mut injector = injector(Direction::ToNodes, plan);
        for _ in 0..1_000 {
            let late = injector.fate(0, NODE, 1, true).late_by.unwrap();
            assert!((10_000..=12_000).contains(&late), "{late}");
        }
    }
}

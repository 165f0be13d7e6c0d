//! The chain of events: what is due when, and which station gets it.

use std::collections::{BTreeMap, VecDeque};

use myactuator_protocol_core::time::{Duration, Instant};

use super::faults::{Babble, Fate, Injector};
use super::medium::{Arrival, Medium, Part, Surroundings};
use super::nanos::{NEVER, Nanos, from_duration, from_instant, to_instant};
use super::node::Node;
use super::trace::{Event, Fault};

const MICROSECOND: Nanos = 1_000;

struct Station<F> {
    /// `None` for a port.
    node: Option<Box<dyn Node<F>>>,
    /// When the node wants to be asked again.
    wake: Nanos,
    /// The node may have more to send than its controller took.
    is_blocked: bool,
    /// How late its frames get to its controller.
    slowness: Nanos,
    /// Frames that are delayed on their way to the controller, with their time of arrival there.
    backlog: VecDeque<(Nanos, F)>,
    /// The first of them has arrived and finds no room.
    is_backlog_stuck: bool,
    /// What it babbles, and when next.
    babble: Option<(Babble<F>, Nanos)>,
    received: VecDeque<F>,
    receive_queue: usize,
    overflows: u64,
    is_cut: bool,
    /// The node has no power.
    is_off: bool,
    /// A caller waits to send.
    wants_room: bool,
    /// Nothing may arrive before this: it would overtake a late message.
    not_before: Nanos,
    /// Arrivals come only at multiples of this.
    bursts: Nanos,
    /// What waits to be overtaken by the next message.
    held: VecDeque<F>,
    /// Which message that was.
    held_message: u64,
}

impl<F> Station<F> {
    /// When it does something on its own.
    fn due(&self) -> Nanos {
        let babble = self.babble.as_ref().filter(|_| !self.is_off).map_or(NEVER, |(_, at)| *at);
        let backlog = self.backlog.front().filter(|_| !self.is_backlog_stuck);
        self.wake.min(babble).min(backlog.map_or(NEVER, |(at, _)| *at))
    }
}

enum Late<F> {
    Deliver(F),
    /// This message has waited long enough to be overtaken.
    Release(u64),
}

/// Work that is done at its time. It returns after how long it is done again, or `None` to end.
pub(crate) struct Planned<B: Medium> {
    pub(crate) at: Nanos,
    pub(crate) work: Box<Work<B>>,
}

pub(crate) type Work<B> = dyn FnMut(&mut Kernel<B>, Instant) -> Option<Duration> + Send;

/// By time, then by order of sending: the receiver, and what it gets.
type LateArrivals<F> = BTreeMap<(Nanos, u64), (usize, Late<F>)>;

/// A world without its lock.
pub(crate) struct Kernel<B: Medium> {
    pub(crate) bus: B,
    /// The clock, and what else the bus uses.
    pub(crate) around: Surroundings<B::Frame>,
    stations: Vec<Station<B::Frame>>,
    /// What is still to arrive.
    late: LateArrivals<B::Frame>,
    pub(crate) planned: Vec<Planned<B>>,
    sequence: u64,
    /// What the ports got so far: received units, and room that had been missing.
    pub(crate) arrivals: u64,
    /// The message whose fates are drawn.
    message: u64,
    /// What happens to it at each receiver.
    fates: BTreeMap<usize, Fate>,
}

impl<B: Medium> Kernel<B> {
    pub(crate) fn new(bus: B, seed: u64) -> Self {
        Self {
            bus,
            around: Surroundings {
                now: 0,
                injector: Injector::new(seed),
                observers: Vec::new(),
                arrivals: Vec::new(),
                freed: Vec::new(),
            },
            stations: Vec::new(),
            late: BTreeMap::new(),
            planned: Vec::new(),
            sequence: 0,
            arrivals: 0,
            message: 0,
            fates: BTreeMap::new(),
        }
    }

    pub(crate) fn attach(
        &mut self,
        node: Option<Box<dyn Node<B::Frame>>>,
        how: B::Attachment,
        receive_queue: usize,
    ) -> usize {
        self.bus.attach(how);
        self.around.injector.attach(node.is_some());
        // A node is asked as soon as time goes on.
        let wake = if node.is_some() { self.around.now } else { NEVER };
        self.stations.push(Station {
            node,
            wake,
            is_blocked: false,
            slowness: 0,
            backlog: VecDeque::new(),
            is_backlog_stuck: false,
            babble: None,
            received: VecDeque::new(),
            receive_queue,
            overflows: 0,
            is_cut: false,
            is_off: false,
            wants_room: false,
            not_before: 0,
            bursts: 1,
            held: VecDeque::new(),
            held_message: 0,
        });
        self.stations.len() - 1
    }

    /// When something happens next; `NEVER` if nothing does.
    pub(crate) fn next_event(&self) -> Nanos {
        let stations = self.stations.iter().map(Station::due).min().unwrap_or(NEVER);
        let late = self.late.first_key_value().map_or(NEVER, |((at, _), _)| *at);
        let planned = self.planned.iter().map(|it| it.at).min().unwrap_or(NEVER);
        stations.min(late).min(planned).min(self.bus.next_event()).max(self.around.now)
    }

    /// Lets everything up to `at` happen, and sets the clock to it.
    pub(crate) fn run_until(&mut self, at: Nanos) {
        loop {
            let next = self.next_event();
            if next > at {
                break;
            }
            self.step(next);
        }
        self.around.now = self.around.now.max(at);
    }

    /// Does what is due at `at`, which must be the time of the next event.
    pub(crate) fn step(&mut self, at: Nanos) {
        self.around.now = self.around.now.max(at);
        self.bus.finish(&mut self.around);
        self.spread();
        let now = self.around.now;
        while let Some(entry) = self.late.first_entry().filter(|it| it.key().0 <= now) {
            let (station, late) = entry.remove();
            match late {
                Late::Deliver(unit) => self.deliver(station, &unit),
                Late::Release(message) if self.stations[station].held_message == message => {
                    self.release(station);
                }
                Late::Release(_) => {}
            }
        }
        self.work();
        for station in 0..self.stations.len() {
            if self.stations[station].due() <= self.around.now {
                self.serve(station);
            }
        }
        self.bus.start(&mut self.around);
        self.spread();
    }

    /// Does the work that is due.
    fn work(&mut self) {
        let now = self.around.now;
        let mut planned = std::mem::take(&mut self.planned);
        planned.retain_mut(|it| {
            if it.at > now {
                return true;
            }
            let again = (it.work)(self, to_instant(now));
            it.at = it.at.saturating_add(from_duration(again.unwrap_or_default()));
            again.is_some()
        });
        self.planned = planned;
    }

    /// Passes on what the bus has done.
    fn spread(&mut self) {
        for arrival in std::mem::take(&mut self.around.arrivals) {
            self.arrive(&arrival);
        }
        for station in std::mem::take(&mut self.around.freed) {
            let state = &mut self.stations[station];
            state.is_backlog_stuck = false;
            if state.is_blocked {
                state.wake = self.around.now;
            }
            if std::mem::take(&mut state.wants_room) {
                self.arrivals += 1;
            }
        }
    }

    /// Delivers what is complete on the wire to every station that hears it.
    fn arrive(&mut self, arrival: &Arrival<B::Frame>) {
        let Arrival { sender, hearers, unit, part } = arrival;
        let injector = &mut self.around.injector;
        // No fault can strike what a collision left.
        let part = part.as_ref().filter(|_| !injector.is_quiet());
        if let Some(part) = part.filter(|part| part.message != self.message) {
            self.message = part.message;
            let fates = hearers.iter().map(|&hearer| {
                (hearer, injector.fate(*sender, hearer, part.of, B::DELIVERS_CORRUPTED))
            });
            self.fates = fates.collect();
        }
        for &hearer in hearers {
            match part {
                Some(part) => self.arrive_by_fate(hearer, arrival, part),
                None => self.deliver_in_order(hearer, unit, 0),
            }
        }
    }

    fn arrive_by_fate(&mut self, to: usize, arrival: &Arrival<B::Frame>, part: &Part<B::Frame>) {
        let fate = self.fates.get(&to).copied().unwrap_or_default();
        let now = self.around.now;
        let from = super::StationId(arrival.sender);
        let is_first = part.index == 0;
        let mut note = |is_so, fault| {
            if is_so {
                self.around.record(to, || Event::Faulted { from, fault });
            }
        };
        note(is_first && fate.lost, Fault::Lost);
        if fate.lost {
            return;
        }
        let mut unit = arrival.unit.clone();
        if let Some((_, bit)) = fate.flipped.filter(|(index, _)| *index == part.index) {
            note(true, Fault::Corrupted);
            B::flip_bit(&mut unit, bit);
        }
        note(is_first && fate.duplicated, Fault::Duplicated);
        let copy = part.whole.as_ref().filter(|_| fate.duplicated);
        let units = std::iter::once(unit).chain(copy.map(B::units).unwrap_or_default());
        let state = &mut self.stations[to];
        let is_its_turn_to_wait = state.held.is_empty() || state.held_message == part.message;
        if let Some(wait) = fate.held_for.filter(|_| is_its_turn_to_wait) {
            note(is_first, Fault::Reordered);
            let is_new = state.held.is_empty();
            state.held.extend(units);
            state.held_message = part.message;
            if is_new {
                self.schedule(now.saturating_add(wait), to, Late::Release(part.message));
            }
            return;
        }
        let late_by = fate.late_by.unwrap_or(0);
        note(is_first && fate.late_by.is_some(), Fault::Delayed(late_by));
        for unit in units {
            self.deliver_in_order(to, &unit, late_by);
        }
        if part.whole.is_some() {
            self.release(to);
        }
    }

    /// Delivers now or later, but never before a message that is late itself.
    fn deliver_in_order(&mut self, to: usize, unit: &B::Frame, late_by: Nanos) {
        let Station { not_before, bursts, .. } = self.stations[to];
        let at = self.around.now.saturating_add(late_by).max(not_before);
        let at = at.div_ceil(bursts).saturating_mul(bursts);
        // Earlier arrivals that are due now may still wait for their turn.
        if at <= self.around.now && not_before != self.around.now {
            self.deliver(to, unit);
        } else {
            self.stations[to].not_before = at;
            self.schedule(at, to, Late::Deliver(unit.clone()));
        }
    }

    fn release(&mut self, to: usize) {
        while let Some(unit) = self.stations[to].held.pop_front() {
            self.deliver_in_order(to, &unit, 0);
        }
    }

    fn schedule(&mut self, at: Nanos, station: usize, late: Late<B::Frame>) {
        self.sequence += 1;
        self.late.insert((at, self.sequence), (station, late));
    }

    fn deliver(&mut self, to: usize, unit: &B::Frame) {
        let now = self.around.now;
        let state = &mut self.stations[to];
        if let Some(node) = &mut state.node {
            if node.accepts(unit) {
                node.handle_frame(unit, to_instant(now));
                self.serve_node(to);
            }
            return;
        }
        if state.received.len() >= state.receive_queue {
            state.overflows += 1;
            self.around.record(to, || Event::Overflowed { frame: unit.clone() });
            return;
        }
        state.received.push_back(unit.clone());
        self.arrivals += 1;
    }

    /// Does what a station does on its own at its time.
    fn serve(&mut self, station: usize) {
        let now = self.around.now;
        let state = &mut self.stations[station];
        while self.bus.room(station) > 0
            && state.backlog.front().is_some_and(|(at, _)| *at <= now)
            && let Some((_, frame)) = state.backlog.pop_front()
        {
            self.bus.submit(station, frame, now);
        }
        state.is_backlog_stuck = state.backlog.front().is_some_and(|(at, _)| *at <= now);
        if let Some((babble, at)) = &mut state.babble
            && (*at <= now && !state.is_off)
        {
            let random = &mut self.around.injector.babble;
            let frame = babble.frame.clone().unwrap_or_else(|| B::garbage(random));
            *at = now.saturating_add(from_duration(babble.interval).max(MICROSECOND));
            // A full queue drops it: more will follow.
            self.bus.submit(station, frame, now);
        }
        if state.wake <= now {
            self.serve_node(station);
        }
    }

    /// Has a node asked in this step although it did not request that.
    pub(crate) fn wake(&mut self, station: usize) {
        self.stations[station].wake = self.around.now;
    }

    /// Asks a node what it has to send although it did not request that.
    pub(crate) fn serve_now(&mut self, station: usize) {
        self.serve_node(station);
        self.bus.start(&mut self.around);
        self.spread();
    }

    /// Asks a node what it has to send.
    fn serve_node(&mut self, station: usize) {
        let at = self.around.now;
        let now = to_instant(at);
        let state = &mut self.stations[station];
        state.wake = NEVER;
        let Some(node) = &mut state.node else { return };
        node.advance(now);
        let is_off = !node.is_powered();
        if let Some(bit_rate) = node.bit_rate() {
            self.bus.set_bit_rate(station, bit_rate, &mut self.around);
        }
        if is_off != state.is_off {
            self.empty(station);
            self.connect(station, self.stations[station].is_cut, is_off);
        }
        let state = &mut self.stations[station];
        let Some(node) = &mut state.node else { return };
        state.is_blocked = true;
        while self.bus.room(station) > state.backlog.len() {
            let Some(frame) = node.poll_transmit(now) else {
                state.is_blocked = false;
                break;
            };
            // After the frames that are still delayed, so that a drive that is fast again keeps the order.
            let under_way = state.backlog.back().map_or(0, |(at, _)| *at);
            let ready = at.saturating_add(state.slowness).max(under_way);
            if ready > at {
                state.backlog.push_back((ready, frame));
            } else {
                self.bus.submit(station, frame, at);
            }
        }
        state.wake = match node.poll_at().map(from_instant) {
            Some(wake) if wake > at => wake,
            // It will be asked when there is room.
            Some(_) if state.is_blocked => NEVER,
            Some(_) => (at / MICROSECOND + 1) * MICROSECOND,
            None => NEVER,
        };
    }

    /// Queues what a port sends. False if there is no room.
    pub(crate) fn submit(&mut self, station: usize, frame: B::Frame) -> bool {
        let now = self.around.now;
        let taken = self.bus.submit(station, frame, now);
        self.stations[station].wants_room |= !taken;
        taken
    }

    pub(crate) fn has_room(&self, station: usize) -> bool {
        self.bus.room(station) > 0
    }

    pub(crate) fn has_received(&self, station: usize) -> bool {
        !self.stations[station].received.is_empty()
    }

    /// Takes the oldest unit that a port has received.
    pub(crate) fn read(&mut self, station: usize) -> Option<B::Frame> {
        self.stations[station].received.pop_front()
    }

    /// Units that wait to be read, and how many were lost.
    pub(crate) fn received(&self, station: usize) -> (usize, u64) {
        let state = &self.stations[station];
        (state.received.len(), state.overflows)
    }

    pub(crate) fn is_cut(&self, station: usize) -> bool {
        self.stations[station].is_cut
    }

    /// A station whose wire is cut, or that has no power, is off the bus.
    fn connect(&mut self, station: usize, is_cut: bool, is_off: bool) {
        let state = &mut self.stations[station];
        let was_apart = state.is_cut || state.is_off;
        (state.is_cut, state.is_off) = (is_cut, is_off);
        if was_apart != (is_cut || is_off) {
            self.bus.cut(station, !was_apart, &mut self.around);
        }
    }

    pub(crate) fn cut(&mut self, station: usize, is_cut: bool) {
        self.connect(station, is_cut, self.stations[station].is_off);
        let event = if is_cut { Event::Cut } else { Event::Mended };
        self.around.record(station, || event);
        self.spread();
    }

    pub(crate) fn set_bit_rate(&mut self, station: usize, bit_rate: u32) {
        self.bus.set_bit_rate(station, bit_rate, &mut self.around);
        self.spread();
    }

    pub(crate) fn reset(&mut self, station: usize) {
        self.empty(station);
        let now = self.around.now;
        self.around.record(station, || Event::Reset);
        let state = &mut self.stations[station];
        if let Some(node) = &mut state.node {
            node.reset(to_instant(now));
            state.wake = now;
        }
        self.spread();
    }

    /// Without power, what is queued to be sent is lost, and so is what was received and not read.
    fn empty(&mut self, station: usize) {
        self.bus.reset(station, &mut self.around);
        let state = &mut self.stations[station];
        state.backlog.clear();
        state.is_backlog_stuck = false;
        state.received.clear();
    }

    pub(crate) fn hand_over_every(&mut self, station: usize, period: Duration) {
        self.stations[station].bursts = from_duration(period).max(1);
    }

    pub(crate) fn slow_down(&mut self, station: usize, by: Duration) {
        self.stations[station].slowness = from_duration(by);
        self.around.record(station, || Event::Slowed(from_duration(by)));
    }

    pub(crate) fn babble(&mut self, station: usize, babble: Option<Babble<B::Frame>>) {
        let now = self.around.now;
        self.around.record(station, || Event::Babbles(babble.is_some()));
        self.stations[station].babble = babble.map(|babble| (babble, now));
    }
}

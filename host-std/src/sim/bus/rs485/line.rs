//! The line and the stations on it.

use std::collections::VecDeque;

use super::TransceiverConfig;
use crate::sim::bus::medium::{Arrival, Medium, Part, Surroundings, flip_bit_of, sealed::Bus};
use crate::sim::bus::nanos::{NEVER, Nanos, bits, from_duration};
use crate::sim::bus::random::{Random, Stream};
use crate::sim::bus::trace::Event;

/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: u64 = 10;

#[derive(Debug)]
struct Message {
    number: u64,
    bytes: Vec<u8>,
    /// How many of them are over.
    ended: usize,
    /// When its first byte began. Before that, when it was queued.
    started: Nanos,
    is_garbled: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Driver {
    Off,
    /// Switches to sending.
    SwitchingOn {
        until: Nanos,
    },
    /// A byte is on the line.
    Sending {
        since: Nanos,
        until: Nanos,
    },
    /// Still drives the line.
    SwitchingOff {
        until: Nanos,
    },
}

#[derive(Debug)]
struct Station {
    config: TransceiverConfig,
    bit_rate: u32,
    queue: VecDeque<Message>,
    driver: Driver,
    /// When the sequence of bytes without a gap began, and how many bytes it has. The end of a byte is counted from
    /// there, so that rounding errors do not add up.
    run_started: Nanos,
    run_bytes: u64,
    is_cut: bool,
}

impl Station {
    /// Whether it hears what is on the line.
    fn listens(&self) -> bool {
        !self.is_cut && (self.driver == Driver::Off || self.config.echo)
    }
}

/// The byte that all receivers are receiving.
#[derive(Debug)]
struct Heard {
    sender: usize,
    until: Nanos,
    /// Its value; `None` if another driver was on meanwhile.
    byte: Option<(u8, Part<Vec<u8>>)>,
}

/// What a receiver at another bit rate reads from a message. From the edge of a start bit on it samples the middle of
/// each of its own bits. Without a stop bit it still reads a byte, and then waits for the line to be high. Times are in
/// units of which a sent bit has `2 * own_rate`.
fn misread(sent: &[u8], sent_rate: u32, own_rate: u32) -> Vec<u8> {
    let (sent_bit, own_bit) = (2 * u64::from(own_rate.max(1)), 2 * u64::from(sent_rate.max(1)));
    let is_high = |at: u64| {
        let (byte, bit) = (at / sent_bit / BITS_PER_BYTE, at / sent_bit % BITS_PER_BYTE);
        match sent.get(byte as usize) {
            Some(byte) => bit > 0 && (u64::from(*byte) | 1 << 8) >> (bit - 1) & 1 == 1,
            None => true,
        }
    };
    let end = sent.len() as u64 * BITS_PER_BYTE * sent_bit;
    let (mut at, mut bytes) = (0, Vec::new());
    while at < end {
        let is_one = |bit| u8::from(is_high(at + own_bit * bit + own_bit / 2));
        // The line may be high again in the middle of an apparent start bit.
        if is_one(0) == 0 {
            bytes.push((1..=8).rev().fold(0, |byte, bit| byte << 1 | is_one(bit)));
            at += own_bit * 9 + own_bit / 2;
        }
        for level in [false, true] {
            while at < end && is_high(at) == level {
                at = (at / sent_bit + 1) * sent_bit;
            }
        }
    }
    bytes
}

/// A byte that only this station hears.
fn for_itself(station: usize, byte: u8) -> Arrival<Vec<u8>> {
    Arrival { sender: station, hearers: vec![station], unit: vec![byte], part: None }
}

/// An RS485 line and the stations on it.
#[derive(Debug)]
pub struct Rs485Line {
    /// The rate of stations that have no other.
    bit_rate: u32,
    stations: Vec<Station>,
    heard: Option<Heard>,
    messages: u64,
    random: Random,
}

impl Rs485Line {
    pub(super) fn new(bit_rate: u32, seed: u64) -> Self {
        Self {
            bit_rate,
            stations: Vec::new(),
            heard: None,
            messages: 0,
            random: Random::new(seed, Stream::Line),
        }
    }

    fn others_drive(&self, station: usize) -> bool {
        self.stations.iter().enumerate().any(|(other, it)| {
            let is_on = matches!(it.driver, Driver::Sending { .. } | Driver::SwitchingOff { .. });
            other != station && is_on && !it.is_cut
        })
    }

    /// Puts the next byte of a station on the line. It must have one.
    fn begin_byte(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        let now = around.now;
        let disturbed = !self.stations[station].is_cut && self.others_drive(station);
        let state = &mut self.stations[station];
        state.run_bytes += 1;
        let until = state.run_started + bits(BITS_PER_BYTE * state.run_bytes, state.bit_rate);
        state.driver = Driver::Sending { since: now, until };
        let Some(message) = state.queue.front_mut() else { return };
        let (index, of) = (message.ended, message.bytes.len());
        if index == 0 {
            message.started = now;
        }
        message.is_garbled |= disturbed;
        if state.is_cut {
            return;
        }
        match &mut self.heard {
            // It is heard as part of the byte that began before.
            Some(heard) => heard.byte = None,
            None => {
                let whole = (index + 1 == of).then(|| message.bytes.clone());
                let part = Part { message: message.number, index, of, whole };
                let byte = Some((message.bytes[index], part));
                self.heard = Some(Heard { sender: station, until, byte });
            }
        }
        if disturbed {
            // A collision: nothing that is on the line now arrives as it was sent.
            (0..self.stations.len()).for_each(|station| self.spoil_byte(station));
        }
    }

    /// What a station is sending now, if anything, does not arrive as it was sent.
    fn spoil_byte(&mut self, station: usize) {
        let state = &mut self.stations[station];
        if let (false, Driver::Sending { .. }, Some(message)) =
            (state.is_cut, state.driver, state.queue.front_mut())
        {
            message.is_garbled = true;
            if let Some(heard) = &mut self.heard {
                heard.byte = None;
            }
        }
    }

    fn end_heard(&mut self, around: &mut Surroundings<Vec<u8>>) {
        let Some(heard) = self.heard.take_if(|heard| heard.until <= around.now) else { return };
        let Heard { sender, byte, .. } = heard;
        let (byte, part) =
            byte.map_or_else(|| (self.random.byte(), None), |(it, part)| (it, Some(part)));
        let bit_rate = self.stations[sender].bit_rate;
        let hears = |it: &Station| it.bit_rate == bit_rate && it.listens();
        let all = self.stations.iter().enumerate();
        let hearers = all.filter(|(_, it)| hears(it)).map(|(station, _)| station).collect();
        around.arrivals.push(Arrival { sender, hearers, unit: vec![byte], part });
    }

    /// After a collision receivers may begin in the middle of a byte.
    fn hear_the_rest(&mut self, now: Nanos) {
        if self.heard.is_some() {
            return;
        }
        let rest = self.stations.iter().enumerate().find(|(_, station)| {
            !station.is_cut
                && matches!(station.driver, Driver::Sending { since, until } if since < now && now < until)
        });
        if let Some((sender, station)) = rest {
            let until = now + bits(BITS_PER_BYTE, station.bit_rate);
            self.heard = Some(Heard { sender, until, byte: None });
        }
    }

    fn byte_is_over(&self, station: usize, now: Nanos) -> bool {
        matches!(self.stations[station].driver, Driver::Sending { until, .. } if until <= now)
    }

    /// A station's byte is over. If it has more to send, its driver stays as it is.
    fn end_byte(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        around.freed.push(station);
        let state = &mut self.stations[station];
        let Some(message) = state.queue.front_mut() else { return };
        if state.is_cut && state.config.echo {
            around.arrivals.push(for_itself(station, message.bytes[message.ended]));
        }
        message.ended += 1;
        if message.ended == message.bytes.len()
            && let Some(message) = state.queue.pop_front()
        {
            self.end_message(station, message, around);
        }
        let state = &mut self.stations[station];
        if state.queue.is_empty() {
            let until = around.now + from_duration(state.config.switch_to_receive);
            state.driver = Driver::SwitchingOff { until };
        }
    }

    fn end_message(&self, station: usize, message: Message, around: &mut Surroundings<Vec<u8>>) {
        let Message { bytes: frame, started: started_ns, is_garbled, .. } = message;
        let sender = &self.stations[station];
        for (stranger, it) in self.stations.iter().enumerate() {
            if !sender.is_cut && it.bit_rate != sender.bit_rate && it.listens() {
                let misread = misread(&frame, sender.bit_rate, it.bit_rate);
                around.arrivals.extend(misread.into_iter().map(|byte| for_itself(stranger, byte)));
            }
        }
        around.record(station, || {
            if is_garbled {
                Event::Broken { frame, started_ns }
            } else {
                Event::Carried { frame, started_ns }
            }
        });
    }

    /// A direction switch may be heard.
    fn switch(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        if self.random.chance(self.stations[station].config.switch_noise) {
            around.arrivals.push(for_itself(station, self.random.byte()));
        }
    }

    /// Whether a station has sent everything and listens again.
    pub(super) fn is_drained(&self, station: usize) -> bool {
        let station = &self.stations[station];
        station.queue.is_empty() && station.driver == Driver::Off
    }
}

impl Medium for Rs485Line {}

impl Bus for Rs485Line {
    type Frame = Vec<u8>;
    type Attachment = TransceiverConfig;

    const DELIVERS_CORRUPTED: bool = true;

    fn attach(&mut self, config: TransceiverConfig) {
        self.stations.push(Station {
            config,
            bit_rate: self.bit_rate,
            queue: VecDeque::new(),
            driver: Driver::Off,
            run_started: 0,
            run_bytes: 0,
            is_cut: false,
        });
    }

    fn next_event(&self) -> Nanos {
        let stations = self.stations.iter().map(|it| match (it.driver, it.queue.front()) {
            (Driver::Off, None) => NEVER,
            (Driver::Off | Driver::SwitchingOff { .. }, Some(queued)) => queued.started,
            (Driver::SwitchingOn { until } | Driver::Sending { until, .. }, _)
            | (Driver::SwitchingOff { until }, None) => until,
        });
        let heard = self.heard.as_ref().map(|heard| heard.until);
        stations.chain(heard).min().unwrap_or(NEVER)
    }

    fn finish(&mut self, around: &mut Surroundings<Vec<u8>>) {
        let now = around.now;
        // First what is heard, while the drivers are still as they were.
        self.end_heard(around);
        // Then all ends before any beginning, so that a station that releases the line now disturbs none.
        for station in 0..self.stations.len() {
            if self.byte_is_over(station, now) {
                self.end_byte(station, around);
            }
        }
        for station in 0..self.stations.len() {
            let state = &mut self.stations[station];
            if let Driver::SwitchingOff { until } = state.driver
                && until <= now
                && state.queue.is_empty()
            {
                state.driver = Driver::Off;
                around.freed.push(station);
                self.switch(station, around);
            }
        }
        for station in 0..self.stations.len() {
            if self.byte_is_over(station, now) {
                self.begin_byte(station, around);
            }
        }
        self.hear_the_rest(now);
    }

    fn start(&mut self, around: &mut Surroundings<Vec<u8>>) {
        let now = around.now;
        for station in 0..self.stations.len() {
            let state = &mut self.stations[station];
            if state.queue.is_empty() {
                continue;
            }
            if state.driver == Driver::Off {
                let until = now + from_duration(state.config.switch_to_send);
                state.driver = Driver::SwitchingOn { until };
                self.switch(station, around);
            }
            let is_on = match self.stations[station].driver {
                Driver::SwitchingOn { until } => until <= now,
                // No switch is needed.
                Driver::SwitchingOff { .. } => true,
                Driver::Off | Driver::Sending { .. } => false,
            };
            if is_on {
                let state = &mut self.stations[station];
                (state.run_started, state.run_bytes) = (now, 0);
                self.begin_byte(station, around);
            }
        }
    }

    fn room(&self, station: usize) -> usize {
        let Station { config, queue, .. } = &self.stations[station];
        let queued: usize = queue.iter().map(|message| message.bytes.len() - message.ended).sum();
        config.transmit_buffer.max(1).saturating_sub(queued)
    }

    fn submit(&mut self, station: usize, bytes: Vec<u8>, now: Nanos) -> bool {
        if bytes.is_empty() {
            return true;
        }
        if self.room(station) == 0 {
            return false;
        }
        self.messages += 1;
        let (number, started) = (self.messages, now);
        let message = Message { number, bytes, ended: 0, started, is_garbled: false };
        self.stations[station].queue.push_back(message);
        true
    }

    fn cut(&mut self, station: usize, is_cut: bool, _: &mut Surroundings<Vec<u8>>) {
        // A change within a byte spoils it.
        self.spoil_byte(station);
        self.stations[station].is_cut = is_cut;
        self.spoil_byte(station);
    }

    fn bit_rate(&mut self, station: usize) -> &mut u32 {
        &mut self.stations[station].bit_rate
    }

    fn reset(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        self.spoil_byte(station);
        let state = &mut self.stations[station];
        state.queue.clear();
        state.driver = Driver::Off;
        around.freed.push(station);
    }

    fn flip_bit(bytes: &mut Vec<u8>, bit: u64) {
        flip_bit_of(bytes, bit);
    }

    fn garbage(random: &mut Random) -> Vec<u8> {
        (0..=random.below(16)).map(|_| random.byte()).collect()
    }

    fn units(bytes: &Vec<u8>) -> Vec<Vec<u8>> {
        bytes.iter().map(|&byte| vec![byte]).collect()
    }
}

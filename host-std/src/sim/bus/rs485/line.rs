//! The line and who is on it.

use std::collections::VecDeque;

use super::TransceiverConfig;
use crate::sim::bus::medium::{Arrival, Medium, Part, Surroundings, Wire, sealed::Bus};
use crate::sim::bus::nanos::{NEVER, Nanos, bits, from_duration};
use crate::sim::bus::random::{Random, Stream};
use crate::sim::bus::trace::Event;

/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: u64 = 10;

#[derive(Debug)]
struct Message {
    number: u64,
    bytes: Vec<u8>,
    /// How many of them have begun.
    begun: usize,
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
    /// Still holds the line.
    SwitchingOff {
        until: Nanos,
    },
}

#[derive(Debug)]
struct Station {
    config: TransceiverConfig,
    bit_rate: u32,
    queue: VecDeque<Message>,
    queued_bytes: usize,
    queued_since: Nanos,
    driver: Driver,
    /// When the run of bytes without a gap began, and how many bytes it has: a byte's end is counted
    /// from there, so that roundings do not add up.
    run_started: Nanos,
    run_bytes: u64,
    is_cut: bool,
}

impl Station {
    /// Whether it sends, and does not hear what is on the line meanwhile.
    fn is_deaf(&self) -> bool {
        self.driver != Driver::Off && !self.config.echo
    }
}

/// The byte that all receivers are in the middle of.
#[derive(Debug)]
struct Heard {
    sender: usize,
    started: Nanos,
    until: Nanos,
    byte: u8,
    part: Option<Part<Vec<u8>>>,
    /// Another driver was on meanwhile.
    is_garbled: bool,
}

/// What a receiver at another bit rate makes of a message. From the edge of a start bit on it looks at the
/// middle of each of its own bits; what has no stop bit is a byte as well, and then it waits for the line to
/// be high. Times are counted in units of which a sent bit has `2 * own_rate`.
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
        // The line may be high again in the middle of what looked like a start bit.
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

/// A byte that nobody but this station hears.
fn for_itself(station: usize, started: Nanos, byte: u8) -> Arrival<Vec<u8>> {
    let (deaf, unit) = (Vec::new(), vec![byte]);
    Arrival { sender: station, deaf, started, on: Wire::Stub(station), unit, part: None }
}

/// An RS485 line and the stations on it.
#[derive(Debug)]
pub struct Rs485Line {
    /// That of whoever has no other.
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
        self.stations.iter().enumerate().any(|(other, state)| {
            let is_on =
                matches!(state.driver, Driver::Sending { .. } | Driver::SwitchingOff { .. });
            other != station && is_on && !state.is_cut
        })
    }

    /// Puts the next byte of a station on the line. It must have one.
    fn begin_byte(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        let now = around.now;
        let disturbed = self.others_drive(station);
        let state = &mut self.stations[station];
        state.run_bytes += 1;
        let until = state.run_started + bits(BITS_PER_BYTE * state.run_bytes, state.bit_rate);
        state.driver = Driver::Sending { since: now, until };
        let Some(message) = state.queue.front_mut() else { return };
        let index = message.begun;
        message.begun += 1;
        if index == 0 {
            message.started = now;
        }
        message.is_garbled |= disturbed;
        let byte = message.bytes[index];
        let of = message.bytes.len();
        let whole = (index + 1 == of).then(|| message.bytes.clone());
        let part = Some(Part { message: message.number, index, of, whole });
        if state.is_cut {
            return;
        }
        if disturbed {
            self.garble();
        }
        match &mut self.heard {
            // Heard as part of the byte that began before.
            Some(heard) => heard.is_garbled = true,
            None => {
                self.heard = Some(Heard {
                    sender: station,
                    started: now,
                    until,
                    byte,
                    part,
                    is_garbled: disturbed,
                });
            }
        }
    }

    /// A collision: nothing that is on the line now arrives as it was sent.
    fn garble(&mut self) {
        if let Some(heard) = &mut self.heard {
            heard.is_garbled = true;
        }
        for station in self.stations.iter_mut().filter(|station| !station.is_cut) {
            if let (Driver::Sending { .. }, Some(message)) =
                (station.driver, station.queue.front_mut())
            {
                message.is_garbled = true;
            }
        }
    }

    fn end_heard(&mut self, around: &mut Surroundings<Vec<u8>>) {
        let Some(mut heard) = self.heard.take_if(|heard| heard.until <= around.now) else { return };
        if heard.is_garbled {
            heard.byte = self.random.byte();
            heard.part = None;
        }
        let bit_rate = self.stations[heard.sender].bit_rate;
        let stations = self.stations.iter().enumerate();
        let is_deaf = |it: &Station| it.is_deaf() || it.bit_rate != bit_rate;
        let deaf = stations.filter(|(_, it)| is_deaf(it)).map(|(station, _)| station).collect();
        around.arrivals.push(Arrival {
            sender: heard.sender,
            deaf,
            started: heard.started,
            on: Wire::Common,
            unit: vec![heard.byte],
            part: heard.part,
        });
    }

    /// After a collision receivers may fall into the middle of a byte.
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
            self.heard =
                Some(Heard { sender, started: now, until, byte: 0, part: None, is_garbled: true });
        }
    }

    fn byte_is_over(&self, station: usize, now: Nanos) -> bool {
        matches!(self.stations[station].driver, Driver::Sending { until, .. } if until <= now)
    }

    /// A station's byte is over. If it has more to send, its driver stays as it is.
    fn end_byte(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        let now = around.now;
        let state = &mut self.stations[station];
        state.queued_bytes -= 1;
        around.freed.push(station);
        if state.is_cut
            && state.config.echo
            && let Some(message) = state.queue.front()
        {
            around.arrivals.push(for_itself(station, now, message.bytes[message.begun - 1]));
        }
        if state.queue.front().is_some_and(|message| message.begun == message.bytes.len())
            && let Some(message) = state.queue.pop_front()
        {
            let Message { bytes: frame, started: started_ns, is_garbled, .. } = message;
            let (is_cut, bit_rate) = (state.is_cut, state.bit_rate);
            let strangers = self.stations.iter().enumerate().filter(|(_, it)| {
                it.bit_rate != bit_rate && !it.is_deaf() && !it.is_cut && !is_cut
            });
            for (stranger, it) in strangers {
                let misread = misread(&frame, bit_rate, it.bit_rate);
                let bytes = misread.into_iter().map(|byte| for_itself(stranger, now, byte));
                around.arrivals.extend(bytes);
            }
            around.record(station, || {
                if is_garbled {
                    Event::Broken { frame, started_ns }
                } else {
                    Event::Carried { frame, started_ns }
                }
            });
        }
        let state = &mut self.stations[station];
        if state.queue.is_empty() {
            let until = now + from_duration(state.config.switch_to_receive);
            state.driver = Driver::SwitchingOff { until };
        }
    }

    /// A direction switch may be heard.
    fn switch(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        if self.random.chance(self.stations[station].config.switch_noise) {
            around.arrivals.push(for_itself(station, around.now, self.random.byte()));
        }
    }

    fn start_sending(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        let state = &mut self.stations[station];
        state.run_started = around.now;
        state.run_bytes = 0;
        self.begin_byte(station, around);
    }

    /// Whether all that a station had to send has left it and it listens again.
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
            queued_bytes: 0,
            queued_since: 0,
            driver: Driver::Off,
            run_started: 0,
            run_bytes: 0,
            is_cut: false,
        });
    }

    fn next_event(&self) -> Nanos {
        let stations = self.stations.iter().map(|station| match station.driver {
            Driver::Off if station.queue.is_empty() => NEVER,
            Driver::Off => station.queued_since,
            Driver::SwitchingOff { .. } if !station.queue.is_empty() => station.queued_since,
            Driver::SwitchingOn { until }
            | Driver::Sending { until, .. }
            | Driver::SwitchingOff { until } => until,
        });
        let heard = self.heard.as_ref().map(|heard| heard.until);
        stations.chain(heard).min().unwrap_or(NEVER)
    }

    fn finish(&mut self, around: &mut Surroundings<Vec<u8>>) {
        let now = around.now;
        // First what is heard, while the drivers are as they were.
        self.end_heard(around);
        // Then all ends before any beginning, so that who lets go now disturbs nobody.
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
            match state.driver {
                Driver::Off => {
                    let until = now + from_duration(state.config.switch_to_send);
                    state.driver = Driver::SwitchingOn { until };
                    self.switch(station, around);
                    if until <= now {
                        self.start_sending(station, around);
                    }
                }
                Driver::SwitchingOn { until } if until <= now => {
                    self.start_sending(station, around)
                }
                // The driver is still on: no switch is needed.
                Driver::SwitchingOff { .. } => self.start_sending(station, around),
                Driver::SwitchingOn { .. } | Driver::Sending { .. } => {}
            }
        }
    }

    fn room(&self, station: usize) -> usize {
        let station = &self.stations[station];
        station.config.transmit_buffer.max(1).saturating_sub(station.queued_bytes)
    }

    fn submit(&mut self, station: usize, bytes: Vec<u8>, now: Nanos) -> bool {
        if bytes.is_empty() {
            return true;
        }
        if self.room(station) == 0 {
            return false;
        }
        let state = &mut self.stations[station];
        self.messages += 1;
        state.queued_bytes += bytes.len();
        if state.queue.is_empty() {
            state.queued_since = now;
        }
        state.queue.push_back(Message {
            number: self.messages,
            bytes,
            begun: 0,
            started: now,
            is_garbled: false,
        });
        true
    }

    fn hears(&self, station: usize, arrival: &Arrival<Vec<u8>>) -> bool {
        match arrival.on {
            Wire::Stub(own) => own == station,
            Wire::Common => !self.stations[station].is_cut && !arrival.deaf.contains(&station),
        }
    }

    fn cut(&mut self, station: usize, is_cut: bool, _: &mut Surroundings<Vec<u8>>) {
        if self.stations[station].is_cut == is_cut {
            return;
        }
        // What changes within a byte spoils it.
        if let Driver::Sending { .. } = self.stations[station].driver {
            if let Some(heard) = &mut self.heard {
                heard.is_garbled = true;
            }
            if let Some(message) = self.stations[station].queue.front_mut() {
                message.is_garbled = true;
            }
        }
        self.stations[station].is_cut = is_cut;
    }

    fn bit_rate(&mut self, station: usize) -> &mut u32 {
        &mut self.stations[station].bit_rate
    }

    fn reset(&mut self, station: usize, around: &mut Surroundings<Vec<u8>>) {
        let state = &mut self.stations[station];
        if let Driver::Sending { .. } = state.driver
            && !state.is_cut
            && let Some(heard) = &mut self.heard
        {
            heard.is_garbled = true;
        }
        state.queue.clear();
        state.queued_bytes = 0;
        state.driver = Driver::Off;
        around.freed.push(station);
    }

    fn flip_bit(bytes: &mut Vec<u8>, bit: u64) {
        let length = bytes.len().max(1);
        let bit = bit as usize % (length * 8);
        if let Some(byte) = bytes.get_mut(bit / 8) {
            *byte ^= 1 << (bit % 8);
        }
    }

    fn garbage(random: &mut Random) -> Vec<u8> {
        (0..=random.below(16)).map(|_| random.byte()).collect()
    }

    fn units(bytes: &Vec<u8>) -> Vec<Vec<u8>> {
        bytes.iter().map(|&byte| vec![byte]).collect()
    }
}

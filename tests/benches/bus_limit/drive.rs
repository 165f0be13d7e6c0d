//! A drive without a motor: it only answers, and costs next to nothing to simulate.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use myactuator_host_std::sim::bus::Node;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::{self, SimpleFrame};
use myactuator_protocol_core::{Channel, MotorId, Packet, Target};
use myactuator_tests::dice::Dice;

use crate::{RESPONSE_MAX, RESPONSE_MIN};

/// All response times that were drawn, in microseconds.
pub(crate) type Responses = Arc<Mutex<Vec<u64>>>;

/// Answers every command after a random time between the shortest and the longest response.
pub(crate) struct Answering {
    motor: MotorId,
    dice: Dice,
    replies: VecDeque<(Instant, SimpleFrame)>,
    responses: Responses,
}

impl Answering {
    pub(crate) fn new(motor: MotorId, seed: u64, responses: &Responses) -> Self {
        let dice = Dice::new(seed << 8 | u64::from(motor.get()));
        Self { motor, dice, replies: VecDeque::new(), responses: Arc::clone(responses) }
    }
}

impl Node<SimpleFrame> for Answering {
    fn handle_frame(&mut self, frame: &SimpleFrame, now: Instant) {
        let can::Received::Packet(command) = can::decode(frame) else { return };
        // Random values, so that frames have their average length.
        let mut data = std::array::from_fn(|_| self.dice.byte());
        let channel = match command.channel {
            Channel::Command(Target::Motor(motor)) if motor == self.motor => {
                data[0] = command.data[0];
                Channel::Reply(motor)
            }
            Channel::Motion(motor) if motor == self.motor => {
                // Positions that jump would look like restarts.
                (data[0], data[1]) = (motor.get(), 0x80);
                Channel::MotionReply(motor)
            }
            _ => return,
        };
        let (min, max) = (RESPONSE_MIN.as_micros(), RESPONSE_MAX.as_micros());
        let response = min + self.dice.below(max - min + 1);
        self.responses.lock().unwrap().push(response);
        let reply = can::encode(&Packet { channel, data }).expect("eight bytes fit");
        self.replies.push_back((now + Duration::from_micros(response), reply));
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<SimpleFrame> {
        self.replies.pop_front_if(|(due, _)| *due <= now).map(|(_, reply)| reply)
    }

    fn poll_at(&self) -> Option<Instant> {
        self.replies.front().map(|(due, _)| *due)
    }
}

//! What a master assumes about its bus, and its time-outs and attempts.

use crate::firmware::Firmware;
use crate::kind::Kind;
use crate::opcode::{Opcode, Repeat};
use crate::time::Duration;

/// The bus of a master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Bus {
    /// CAN: every motor may have a request in flight.
    Can,
    /// RS485: one exchange at a time on the whole line.
    Rs485 {
        /// Pause between the end of a reply and the next command, in which the drives turn around.
        turnaround: Duration,
        /// Whether the adapter hands back what is sent. If so, the first frame with the same bytes is dropped.
        ///
        /// If this is `false`, the [loops](crate::io) find out whether the adapter echoes, until four answers in a row
        /// have come without an echo. If the echo of a command may pass for its answer, they first read that motor's
        /// status (0x9A), and take a frame that equals the command for its echo:
        ///
        /// - The first attempt of a stop does not wait for that read. It is then confirmed by the next attempt.
        /// - A motor that is not there is waited for twice: for the read, and for the command.
        /// - A command that is sent only once, because it writes to ROM, counts as not answered if the read was lost.
        ///
        /// See [`EchoFilter`](crate::io::EchoFilter).
        ///
        /// If this is `true` and the adapter does not echo, an answer that equals its command counts as the echo: no
        /// stop is confirmed, and no reading of 0 is heard.
        echo: bool,
    },
}

/// Bits of a CAN frame with eight data bytes, with as many stuff bits as possible and the pause after it.
const LONGEST_CAN_FRAME_BITS: u32 = 135;

/// How long the reply to a write to ROM (0x43) is waited for at least.
const ROM_TIMEOUT: Duration = Duration::from_millis(20);

/// The behaviour of a master. Start from [`can`](Self::can) or [`rs485`](Self::rs485).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Config {
    /// The bus. A [loop](crate::io) on the other kind of bus takes the configuration as one for its own, with these
    /// time-outs.
    pub bus: Bus,
    /// Which revision of the protocol the motors speak. It decodes what comes without a typed request: feedback,
    /// reports, answers to broadcasts.
    pub firmware: Firmware,
    /// How long to wait for a reply after a command is sent, at least 1 ms. It is longer than a drive takes, because on
    /// a full bus replies queue behind the frames of other motors.
    ///
    /// For a command that is sent only once because it writes to ROM, it is at least 20 ms: the write takes long, and
    /// only its reply shows that it was done.
    pub reply_timeout: Duration,
    /// If this is longer than `reply_timeout`, time-outs follow the measured round trips between the two. Until
    /// something was measured they are as long as this. So an adapter that holds replies back needs no configuration,
    /// and a fast bus stays fast. `late_window` and `longest_response` grow and shrink by the same amount. A
    /// [`Patience`] is not changed. See [`adapting_up_to`](Self::adapting_up_to).
    pub longest_reply_timeout: Duration,
    /// How often a request is sent at most if repeating it is harmless, 1 to 15.
    pub attempts: u8,
    /// How long a frame is on the wire at most.
    pub frame_time: Duration,
    /// A reply that comes sooner than this after a command cannot be its answer: a drive needs some 0.8 ms. This tells
    /// a doubled frame from the answer to the next request of its kind.
    ///
    /// Nor is a frame an answer if it looks like the last answer and comes within 0.5 ms (on CAN within two frames, if
    /// that is longer) both of what was last heard of the motor and of the command. If a drive answers twice, and the
    /// second answer comes later than that after the next command, it is believed.
    ///
    /// If the clock's steps are longer than this, it must be 0: see [`for_clock_step`](Self::for_clock_step). Then none
    /// of this applies: an answer within the same step as its command is in time.
    pub shortest_response: Duration,
    /// How long a reply takes at most when it need not wait for the bus, including what adapters and the steps of the
    /// clock add. If `reply_timeout` is shorter, that counts.
    ///
    /// On CAN the others [wait](crate::master#how-the-bus-is-shared) for a motor that may still be waiting to answer:
    /// until this time is over and the bus shows that no answer waits. On either bus, feedback of a stream counts as
    /// lost no sooner than this, nor sooner than three of the motor's usual round trips.
    pub longest_response: Duration,
    /// How long a reply may still come after its command was given up or, if a stop took its place, after the stop's
    /// time-out. Until then the motor gets no request that would have the same reply, so that the late reply cannot be
    /// taken for its answer. It does get others: see [there](crate::master#how-answers-find-their-questions).
    pub late_window: Duration,
    /// A set-point that has waited longer than this is dropped.
    pub set_point_max_age: Duration,
    /// How long a motor is sent nothing after its restart (0x76).
    pub restart_time: Duration,
    /// How long a motor is sent nothing after another command without reply.
    pub settle_time: Duration,
}

impl Config {
    /// For CAN at 1 Mbit/s and firmware V4.3.
    pub const CAN: Self = Self::can(1_000_000);

    /// For CAN at `bit_rate`: replies within 3 ms and the time of 128 frames, which is two cycles of 32 motors; three
    /// attempts. With fewer motors a shorter `reply_timeout` is enough: four frames for each.
    pub const fn can(bit_rate: u32) -> Self {
        let rate = if bit_rate == 0 { 1_000_000 } else { bit_rate };
        let frame_micros = (LONGEST_CAN_FRAME_BITS * 1_000_000 / rate) as u64 + 1;
        let reply_micros = 3_000 + 128 * frame_micros;
        Self {
            bus: Bus::Can,
            firmware: Firmware::V4_3,
            reply_timeout: Duration::from_micros(reply_micros),
            longest_reply_timeout: Duration::ZERO,
            attempts: 3,
            frame_time: Duration::from_micros(frame_micros),
            shortest_response: Duration::from_micros(2 * frame_micros),
            longest_response: Duration::from_millis(2),
            late_window: Duration::from_micros(2 * reply_micros),
            set_point_max_age: Duration::from_millis(50),
            restart_time: Duration::from_millis(2_000),
            settle_time: Duration::from_millis(5),
        }
    }

    /// For RS485 at `bit_rate`: replies within 5 ms and the time of the reply's own bytes; three attempts. `echo` says
    /// whether the adapter hands back what is sent. If that is not known, `false`: then it is
    /// [found out](crate::io::EchoFilter).
    pub const fn rs485(bit_rate: u32, echo: bool) -> Self {
        let rate = if bit_rate == 0 { 115_200 } else { bit_rate };
        // 13 bytes of 10 bits.
        let frame_micros = (130_000_000 / rate) as u64 + 1;
        Self {
            bus: Bus::Rs485 { turnaround: Duration::from_micros(100), echo },
            reply_timeout: Duration::from_micros(5_000 + 2 * frame_micros),
            late_window: Duration::from_micros(10_000 + 2 * frame_micros),
            frame_time: Duration::from_micros(frame_micros),
            shortest_response: Duration::ZERO,
            ..Self::CAN
        }
    }

    /// The same with time-outs that follow the measured round trips: no shorter than they are here, and up to
    /// `longest`.
    ///
    /// ```
    /// use myactuator_protocol_core::master::Config;
    /// use myactuator_protocol_core::time::Duration;
    ///
    /// // An adapter of unknown make may hold a reply back for 16 ms.
    /// let config = Config::rs485(115_200, false).adapting_up_to(Duration::from_millis(40));
    /// ```
    #[must_use]
    pub const fn adapting_up_to(self, longest: Duration) -> Self {
        Self { longest_reply_timeout: longest, ..self }
    }

    /// The same for a clock that goes on in steps, such as the tick of 1 ms of a HAL or of an operating system. What it
    /// shows as no time may have been a step: `shortest_response` becomes shorter by that, and `longest_response` longer.
    ///
    /// Each lost reply is waited for longer by some steps, and the measured round trips are as coarse as the clock.
    ///
    /// ```
    /// use myactuator_protocol_core::master::Config;
    /// use myactuator_protocol_core::time::Duration;
    ///
    /// let config = Config::CAN.for_clock_step(Duration::from_millis(1));
    /// assert_eq!(config.shortest_response, Duration::ZERO);
    /// ```
    #[must_use]
    pub const fn for_clock_step(self, step: Duration) -> Self {
        let step_us = step.as_micros();
        let shortest_us = self.shortest_response.as_micros().saturating_sub(step_us);
        let longest_us = self.longest_response.as_micros().saturating_add(step_us);
        Self {
            shortest_response: Duration::from_micros(shortest_us),
            longest_response: Duration::from_micros(longest_us),
            ..self
        }
    }

    /// For a loop on CAN.
    pub(crate) const fn on_can(self) -> Self {
        Self { bus: Bus::Can, ..self }
    }

    /// For a loop on RS485. What a configuration for CAN does not say is that of 115200 bit/s.
    pub(crate) const fn on_line(mut self) -> Self {
        const LINE: Config = Config::rs485(115_200, false);
        if !self.is_rs485() {
            (self.bus, self.frame_time) = (LINE.bus, LINE.frame_time);
            self.shortest_response = LINE.shortest_response;
        }
        self
    }

    pub(crate) const fn is_rs485(&self) -> bool {
        matches!(self.bus, Bus::Rs485 { .. })
    }

    /// RS485: whether the adapter echoes, as far as is known.
    pub(crate) const fn echoes(&self) -> bool {
        matches!(self.bus, Bus::Rs485 { echo: true, .. })
    }

    pub(super) fn patience(&self, kind: Kind) -> Patience {
        let reply_timeout = self.reply_timeout;
        match kind.repeat() {
            Repeat::Harmless => Patience { reply_timeout, attempts: self.attempts },
            Repeat::ActsAgain if !kind.moves() => {
                Patience { reply_timeout: reply_timeout.max(ROM_TIMEOUT), attempts: 1 }
            }
            Repeat::Stale | Repeat::ActsAgain => Patience { reply_timeout, attempts: 1 },
        }
    }

    /// A doubled frame comes this soon after the first. No drive answers the next command so quickly. On CAN the frame
    /// takes its time on the wire.
    pub(super) fn doubled_within(&self) -> Duration {
        let soon = Duration::from_micros(500);
        if self.is_rs485() { soon } else { soon.max(self.frame_time.times(2)) }
    }

    /// How long a motor is sent nothing after a command without reply.
    pub(super) fn hold_after(&self, kind: Kind) -> Duration {
        if kind == Kind::Known(Opcode::Reset) { self.restart_time } else { self.settle_time }
    }
}

/// How to treat one request, where the master's [`Config`] does not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Patience {
    /// How long to wait for a reply.
    pub reply_timeout: Duration,
    /// How often to send it at most, 1 to 15. If the command acts again with each sending, more than 1 is only for a
    /// caller that knows that this does no harm.
    pub attempts: u8,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reply time-out, late window, shortest response and time of a frame, in microseconds.
    fn times(config: Config) -> [u64; 4] {
        [config.reply_timeout, config.late_window, config.shortest_response, config.frame_time]
            .map(Duration::as_micros)
    }

    #[test]
    fn times_follow_the_bit_rate() {
        // 135 bits, rounded up; 3 ms and 128 frames; twice that; two frames.
        assert_eq!(times(Config::can(1_000_000)), [20_408, 40_816, 272, 136]);
        assert_eq!(times(Config::can(250_000)), [72_248, 144_496, 1_082, 541]);
        assert_eq!(times(Config::can(0)), times(Config::CAN));
        // 130 bits, rounded up; 5 ms and two frames; 10 ms and two frames; none.
        assert_eq!(times(Config::rs485(115_200, false)), [7_258, 12_258, 0, 1_129]);
        assert_eq!(times(Config::rs485(1_000_000, false)), [5_262, 10_262, 0, 131]);
        assert_eq!(times(Config::rs485(0, true)), times(Config::rs485(115_200, false)));
    }

    #[test]
    fn a_clock_step_is_taken_from_the_shortest_response_and_added_to_the_longest() {
        let responses = |step_us| {
            let config = Config::CAN.for_clock_step(Duration::from_micros(step_us));
            [config.shortest_response, config.longest_response].map(Duration::as_micros)
        };
        assert_eq!(responses(0), [272, 2_000]);
        assert_eq!(responses(30), [242, 2_030]);
        assert_eq!(responses(1_000), [0, 3_000]);
    }

    #[test]
    fn a_write_to_rom_is_waited_for_longer_than_a_line_asks() {
        let patience = |opcode| {
            let it = Config::rs485(1_000_000, false).patience(Kind::Known(opcode));
            (it.reply_timeout.as_micros(), it.attempts)
        };
        assert_eq!(patience(Opcode::WritePidRom), (20_000, 1));
        assert_eq!(patience(Opcode::IncrementalPosition), (5_262, 1));
        assert_eq!(patience(Opcode::AbsolutePosition), (5_262, 1));
        assert_eq!(patience(Opcode::ReadModel), (5_262, 3));
    }
}

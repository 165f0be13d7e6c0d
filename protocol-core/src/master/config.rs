//! What a master assumes about its bus, and how patient it is.

use crate::time::Duration;

/// The bus that a master speaks on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Bus {
    /// CAN: every motor may have a request in flight.
    Can,
    /// RS485: one exchange at a time on the whole line.
    Rs485 {
        /// Pause between the end of a reply and the next command, for the drives to turn around.
        turnaround: Duration,
        /// Whether the adapter hands back what is sent. Then the first frame after a sending is
        /// taken for the echo if it has the same bytes.
        echo: bool,
    },
}

/// How a master behaves. Start from [`CAN`](Self::CAN) or [`rs485`](Self::rs485).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Config {
    /// The bus.
    pub bus: Bus,
    /// How long to wait for a reply after a command is sent, 1 to 261 ms. On a full bus replies
    /// queue behind other motors' frames, so this is longer than a drive takes.
    pub reply_timeout: Duration,
    /// How often at most a request is sent whose repetition is harmless, 1 to 15.
    pub attempts: u8,
    /// Replies that come sooner after their command than this cannot be its answer: a drive needs
    /// some 0.8 ms. This tells a doubled frame from the answer to the next request of its kind.
    pub shortest_response: Duration,
    /// For how long after its command a late reply may still come, up to 30 s. Until then no other
    /// request goes to that motor, so that the late reply cannot be taken for its answer.
    pub late_window: Duration,
    /// A set-point that has waited longer than this is dropped, up to 30 s.
    pub set_point_max_age: Duration,
    /// How long a motor is left alone after it was told to restart, up to 30 s.
    pub restart_time: Duration,
    /// How long a motor is left alone after another command without reply, up to 30 s.
    pub settle_time: Duration,
}

impl Config {
    /// For CAN: replies within 20 ms, three attempts.
    pub const CAN: Self = Self {
        bus: Bus::Can,
        reply_timeout: Duration::from_millis(20),
        attempts: 3,
        shortest_response: Duration::from_micros(250),
        late_window: Duration::from_millis(40),
        set_point_max_age: Duration::from_millis(50),
        restart_time: Duration::from_millis(2_000),
        settle_time: Duration::from_millis(5),
    };

    /// For RS485 at `bit_rate`: replies within 5 ms and the time of the reply's own bytes, three
    /// attempts.
    pub const fn rs485(bit_rate: u32, echo: bool) -> Self {
        let rate = if bit_rate == 0 { 115_200 } else { bit_rate };
        // 13 bytes of 10 bits.
        let frame_micros = (130_000_000 / rate) as u64 + 1;
        Self {
            bus: Bus::Rs485 { turnaround: Duration::from_micros(100), echo },
            reply_timeout: Duration::from_micros(5_000 + 2 * frame_micros),
            late_window: Duration::from_micros(10_000 + 2 * frame_micros),
            shortest_response: Duration::ZERO,
            ..Self::CAN
        }
    }
}

/// How one request is to be treated, where the master's [`Config`] does not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Patience {
    /// How long to wait for a reply, 1 to 261 ms.
    pub reply_timeout: Duration,
    /// How often at most to send it, 1 to 15. More than once is for commands that act again with
    /// each sending only if that does no harm here: the caller must know.
    pub attempts: u8,
}

//! Whether an acknowledgement may pass for an echo. It may until answers have shown that the adapter does not echo.

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::Packet;
use myactuator_protocol_core::command::ReadStatus1;
use myactuator_protocol_core::master::{Bus, Config};
use myactuator_protocol_core::time::{Duration, Instant};

use super::names::Name;
use super::truth::DONE;

/// A reply to one of these never has the same bytes as the command.
const NEVER_LIKE_THEIR_REPLY: [u8; 3] = [0x9A, 0xB2, 0xB5];
/// This many answers without an echo show that there is none.
const ANSWERS: u8 = 4;
/// A later answer shows nothing, because its echo is not awaited for longer: 100 ms, less the steps of the clock.
const SHOWS_WITHIN: Duration = Duration::from_millis(98);

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Doubt {
    /// An echo is configured, or this is no line.
    Never,
    /// How many answers are still needed, the last read that may bring one, and what has come.
    Open { left: u8, asked: Option<Asked>, come: Come },
}

/// A read whose answer shows something: which motor was asked what, and when, in the world's time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Asked {
    what: (MotorId, u8),
    at: Instant,
}

/// What has come to reads that show an echo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Come {
    /// If an echo came last: of this.
    echo: Option<(MotorId, u8)>,
    /// How many answers have come since without their echo.
    without: u8,
    /// This motor has reported that it has lost its master. Until it answers, a command that comes back may be no echo,
    /// so it shows none.
    hands_back: Option<MotorId>,
}

impl Doubt {
    pub(super) fn of(config: &Config) -> Self {
        if matches!(config.bus, Bus::Rs485 { echo: false, .. }) {
            Self::Open { left: ANSWERS, asked: None, come: Come::default() }
        } else {
            Self::Never
        }
    }

    pub(super) fn is_open(self) -> bool {
        matches!(self, Self::Open { left: 1.., .. })
    }

    /// Whether a read that comes back unchanged passes for an echo. If no answer to it has the same bytes, it always
    /// does.
    pub(super) fn takes_read_for_echo(self, byte: u8) -> bool {
        self.is_open() || self != Self::Never && NEVER_LIKE_THEIR_REPLY.contains(&byte)
    }

    /// Noise has destroyed the echoes of so many reads in a row that an echoing adapter seems not to echo.
    pub(super) fn is_misled(self) -> bool {
        matches!(self, Self::Open { come: Come { without: ANSWERS.., .. }, .. })
    }

    /// The bus has taken this command.
    pub(super) fn taken(&mut self, motor: MotorId, name: Name, world: Instant) {
        if let Self::Open { asked, come, .. } = self
            && NEVER_LIKE_THEIR_REPLY.contains(&name.byte)
        {
            (*asked, come.echo) = (Some(Asked { what: (motor, name.byte), at: world }), None);
        }
    }

    /// This packet has come, from a drive or from the adapter.
    pub(super) fn delivered(&mut self, motor: MotorId, packet: &Packet, world: Instant) {
        let byte = packet.data[0];
        if matches!(byte, 0x76 | 0xB6) {
            // No drive answers these.
            return self.has_echoed();
        }
        let Self::Open { left, asked, come } = self else { return };
        if byte == 0xF1 {
            come.hands_back = Some(motor);
        }
        if !NEVER_LIKE_THEIR_REPLY.contains(&byte) {
            return;
        }
        if packet.data[3] != DONE {
            (*left, *asked) = (ANSWERS, None);
            if come.hands_back != Some(motor) {
                *come = Come { echo: Some((motor, byte)), ..Come::default() };
            }
            return;
        }
        let answered = asked.take_if(|asked| asked.what == (motor, byte));
        let is_soon = answered.is_some_and(|asked| world - asked.at <= SHOWS_WITHIN);
        *left = left.saturating_sub(is_soon.into());
        come.hands_back.take_if(|hands_back| *hands_back == motor);
        // An answer after its echo shows nothing more.
        let has_echoed = come.echo.take_if(|echo| *echo == (motor, byte)).is_some();
        come.without = come.without.saturating_add((!has_echoed).into());
    }

    /// A command that no drive answers has come back.
    pub(super) fn has_echoed(&mut self) {
        if let Self::Open { left, asked, come } = self {
            (*left, *asked, *come) = (ANSWERS, None, Come::default());
        }
    }

    /// An echo may be lost.
    pub(super) fn port_has_failed(&mut self) {
        if let Self::Open { asked, .. } = self {
            *asked = None;
        }
    }
}

/// The loop's own read that shows an echo, and the answer to it.
pub(super) const SHOWS_ECHO: Name = Name { byte: 0x9A, token: 0 };

/// Whether this is the loop's own read, or its echo.
pub(super) fn shows_echo(packet: &Packet) -> bool {
    packet.data == ReadStatus1.encode()
}

//! Gains of the current, speed and position loops (manual 2.1 to 2.3).

use crate::units::Gain;

code! {
    /// Which gain (2.1.4).
    PidIndex "gain index" {
        /// Current loop, proportional.
        CURRENT_KP = 0x01 "current-kp",
        /// Current loop, integral.
        CURRENT_KI = 0x02 "current-ki",
        /// Speed loop, proportional.
        SPEED_KP = 0x04 "speed-kp",
        /// Speed loop, integral.
        SPEED_KI = 0x05 "speed-ki",
        /// Position loop, proportional.
        POSITION_KP = 0x07 "position-kp",
        /// Position loop, integral.
        POSITION_KI = 0x08 "position-ki",
        /// Position loop, derivative.
        POSITION_KD = 0x09 "position-kd",
    }
}

command! {
    /// Read one gain: 0x30 (2.1).
    ReadPid -> PidGain {
        /// Which gain.
        index: PidIndex => 1,
    }
}

reply! {
    /// One gain, as 0x30 returns it (2.1.3).
    PidGain {
        /// Which gain.
        index: PidIndex => 1,
        /// Its value.
        value: Gain => 4,
    }
}

command! {
    /// Write one gain to RAM, lost at power-off and reset: 0x31 (2.2). Not while the motor starts or
    /// moves. The reply is the same frame.
    WritePidRam -> Self {
        /// Which gain.
        index: PidIndex => 1,
        /// Its new value.
        value: Gain => 4,
    }
}

command! {
    /// Write one gain to ROM, kept over power-off: 0x32 (2.3). Not while the motor starts or moves.
    /// The reply is the same frame.
    WritePidRom -> Self {
        /// Which gain.
        index: PidIndex => 1,
        /// Its new value.
        value: Gain => 4,
    }
}

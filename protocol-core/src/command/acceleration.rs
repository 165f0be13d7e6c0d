//! Planning accelerations (manual 2.4 and 2.5).

use crate::units::{Acceleration, ReportedAcceleration};

code! {
    /// Which of the four planning accelerations (2.4.4).
    AccelerationIndex "acceleration index" {
        /// Position planning, from the start speed to the maximum speed.
        POSITION_ACCELERATION = 0x00 "position-acceleration",
        /// Position planning, from the maximum speed to standstill.
        POSITION_DECELERATION = 0x01 "position-deceleration",
        /// Speed planning, up to the target speed, in either direction of turning.
        SPEED_ACCELERATION = 0x02 "speed-acceleration",
        /// Speed planning, down to the target speed in the same direction.
        SPEED_DECELERATION = 0x03 "speed-deceleration",
    }
}

command! {
    /// Read one acceleration: 0x42 (2.4).
    ReadAcceleration -> AccelerationReading {
        /// Which acceleration.
        index: AccelerationIndex => 1,
    }
}

reply! {
    /// One acceleration, as 0x42 returns it (2.4.3).
    AccelerationReading {
        /// Which acceleration.
        index: AccelerationIndex => 1,
        /// Its value.
        acceleration: ReportedAcceleration => 4,
    }
}

command! {
    /// Write one acceleration to RAM and ROM: 0x43 (2.5). Not while the motor starts or moves. The
    /// reply is the same frame.
    WriteAcceleration -> Self {
        /// Which acceleration.
        index: AccelerationIndex => 1,
        /// Its new value; 0 for no planning.
        acceleration: Acceleration => 4,
    }
}

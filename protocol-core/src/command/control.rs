//! Commands that move or stop the motor (manual 2.17 to 2.24).
//!
//! By the manual 0xA1, 0xA2, 0xA4, 0xA8 and 0xA9 run only while the motor has no fault (2.19.1, 2.20.1, 2.21.1, 2.23.1,
//! 2.24.1); of 0xA6 and motion mode it says nothing. Nor does it say what a drive with a fault answers, so feedback
//! does not show that the command runs. The errors are in [`Status1`](crate::command::Status1).

use crate::command::status::Feedback;
use crate::units::{
    Angle, CoarseSpeed, Current, MaxSpeed, MaxTorque, SingleTurnPulses, SingleTurnTarget,
    SpeedTarget, Temperature,
};

command! {
    /// Switch the output off and leave every control mode: 0x80 (2.17). The reply is the same frame.
    ///
    /// The shaft is free to turn unless a brake holds it, which takes its time to lock: see
    /// [`StopKind::Off`](crate::master::StopKind::Off). A stream goes on after this command; to keep a motor stopped
    /// use [`Master::stop`](crate::master::Master::stop).
    Shutdown -> Self
}

command! {
    /// Stop, and hold still against outside force: 0x81 (2.18). The reply is the same frame. A stream goes on after
    /// this command; to keep a motor stopped use [`Master::stop`](crate::master::Master::stop).
    Stop -> Self
}

command! {
    /// Run at a torque current: 0xA1 (2.19). It runs only without a fault. A motor with a brake needs
    /// [`ReleaseBrake`](crate::command::ReleaseBrake) first.
    Torque -> Feedback {
        /// The torque current, positive for positive turning.
        current: Current => 4,
    }
}

command! {
    /// Run at a speed: 0xA2 (2.20). It runs only without a fault. The speed planning accelerations
    /// apply.
    Speed -> Feedback {
        // 2.20.2 and 2.24.2 print DATA[2] in their formulas; the examples use DATA[1].
        /// The largest torque; 0 for no limit but the stall current.
        max_torque: MaxTorque => 1,
        /// The speed of the output shaft, positive for positive turning.
        speed: SpeedTarget => 4,
    }
}

command! {
    /// Go to a multi-turn angle, from wherever the shaft is: 0xA4 (2.21). It runs only without a fault. With a position
    /// planning acceleration of 0 the drive tracks the angle directly, otherwise along a planned profile.
    AbsolutePosition -> Feedback {
        /// The fastest turning on the way. 0 sets no limit in direct tracking (acceleration 0); with planning the
        /// manual does not say what it does.
        max_speed: MaxSpeed => 2,
        /// Where to go.
        angle: Angle => 4,
    }
}

code! {
    /// Which way to turn to a single-turn angle (2.22.1).
    Direction "direction" {
        /// Clockwise.
        CLOCKWISE = 0x00 "clockwise",
        /// Counter-clockwise.
        COUNTER_CLOCKWISE = 0x01 "counter-clockwise",
    }
}

command! {
    /// Go to an angle within one turn: 0xA6 (2.22), for direct-drive motors in single-turn mode (function 4 off).
    SingleTurnPosition -> SingleTurnFeedback {
        /// Which way to turn.
        direction: Direction => 1,
        /// The fastest turning on the way. The manual does not say what 0 does.
        max_speed: MaxSpeed => 2,
        /// Where to go.
        angle: SingleTurnTarget => 4,
    }
}

reply! {
    /// What 0xA6 answers: as [`Feedback`], with an encoder position in the angle's place (2.22.3).
    SingleTurnFeedback {
        /// Motor temperature.
        temperature: Temperature => 1,
        /// Torque current.
        current: Current => 2,
        /// Speed of the output shaft.
        speed: CoarseSpeed => 4,
        /// Encoder position from the zero.
        encoder: SingleTurnPulses => 6,
    }
}

command! {
    /// Go on by an angle from the current position: 0xA8 (2.23). It runs only without a fault. Sent
    /// twice, it moves twice.
    IncrementalPosition -> Feedback {
        /// The fastest turning on the way. The manual does not say what 0 does.
        max_speed: MaxSpeed => 2,
        /// How far to go; the sign is the direction.
        angle: Angle => 4,
    }
}

command! {
    /// Go to a multi-turn angle with limited torque: 0xA9 (2.24). It runs only without a fault.
    ForcePosition -> Feedback {
        /// The largest torque; above the stall current it limits nothing. Do not send 0: the manual does not say what
        /// it does here, and in a speed command it sets no limit.
        max_torque: MaxTorque => 1,
        /// The fastest turning on the way. The manual does not say what 0 does.
        max_speed: MaxSpeed => 2,
        /// Where to go.
        angle: Angle => 4,
    }
}

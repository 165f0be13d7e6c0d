//! The torques on a shaft that is led from outside.

/// What acted on a [led](super::SimulatedMotor::lead) shaft since it was led last, the mean over that time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShaftTorque {
    /// Torque of the motor and of a hand, less viscous friction, N·m at the output shaft.
    pub torque_nm: f64,
    /// What dry friction, the gear's loss and a closed brake take at most, against the movement, N·m. They
    /// turn no movement round: a shaft at rest that is pushed with less stays at rest.
    pub friction_nm: f64,
}

/// The sums of a shaft's torques over the steps since it was led.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Led {
    torque_nm: f64,
    friction_nm: f64,
    steps: u32,
}

impl Led {
    /// Adds those of a step.
    pub(super) fn add(&mut self, torque_nm: f64, friction_nm: f64) {
        self.torque_nm += torque_nm;
        self.friction_nm += friction_nm;
        self.steps += 1;
    }

    /// The mean of what acted; zero if no time has passed.
    pub(super) fn mean(self) -> ShaftTorque {
        let steps = f64::from(self.steps.max(1));
        ShaftTorque { torque_nm: self.torque_nm / steps, friction_nm: self.friction_nm / steps }
    }
}

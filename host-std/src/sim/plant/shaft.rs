//! What turns: the motor's side and the load's side of the gear, and the play between its teeth.
//!
//! While the teeth press on each other both sides turn as one. They part when the load would run away from the motor,
//! cross the play separately, and meet without bouncing: the speeds become equal, the momentum stays, and the loss is μ
//! Δω² / 2, where μ is the product of both inertias divided by their sum. The moment at which they meet is exact within
//! the step, so the gap is never more than the play.

/// One inertia, and how a step of time changes its speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inertia {
    kg_m2: f64,
    /// Share of the speed that viscous friction leaves after one step.
    speed_kept: f64,
    /// Speed that 1 N·m gives in one step, rad/s.
    speed_per_torque: f64,
}

impl Inertia {
    pub(super) fn new(kg_m2: f64, viscous_nm_s_per_rad: f64, step_s: f64) -> Self {
        // -expm1(-x)/x tends to 1 as friction vanishes.
        let x = viscous_nm_s_per_rad * step_s / kg_m2;
        let mean_kept = if x > 0.0 { -libm::expm1(-x) / x } else { 1.0 };
        let speed_per_torque = mean_kept * step_s / kg_m2;
        Self { kg_m2, speed_kept: libm::exp(-x), speed_per_torque }
    }

    fn speed_after(&self, speed_rad_s: f64, acting: Acting) -> f64 {
        let freely = speed_rad_s * self.speed_kept + acting.torque_nm * self.speed_per_torque;
        let most_taken = acting.dry_nm * self.speed_per_torque;
        if freely.abs() <= most_taken { 0.0 } else { freely - most_taken.copysign(freely) }
    }
}

/// What acts on a side, except viscous friction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Acting {
    pub(super) torque_nm: f64,
    /// The most that is taken from any movement, N·m.
    pub(super) dry_nm: f64,
}

/// A gear whose teeth have play: its two separate sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct Play {
    /// How far the motor's side can be ahead of the load's or behind it until the teeth meet, rad.
    pub(super) half_rad: f64,
    pub(super) motor: Inertia,
    pub(super) load: Inertia,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Teeth {
    Closed,
    /// The motor's side turns with a speed of its own.
    Open {
        motor_rad_s: f64,
    },
}

/// Where both sides of the gear are, as angles of the output, and how fast they turn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shaft {
    /// The load's side.
    pub(super) angle_rad: f64,
    pub(super) speed_rad_s: f64,
    /// How far the motor's side is ahead.
    ahead_rad: f64,
    teeth: Teeth,
}

impl Shaft {
    /// Both sides at an angle with a speed; with play in the middle of it.
    pub(super) const fn at(angle_rad: f64, speed_rad_s: f64, has_play: bool) -> Self {
        let teeth = if has_play { Teeth::Open { motor_rad_s: speed_rad_s } } else { Teeth::Closed };
        Self { angle_rad, speed_rad_s, ahead_rad: 0.0, teeth }
    }

    /// Both sides at rest, the motor's as far ahead as the play lets it be.
    pub(super) fn at_rest(angle_rad: f64, motor_rad: f64, play: Option<&Play>) -> Self {
        let half_rad = play.map_or(0.0, |play| play.half_rad);
        let ahead_rad = motor_rad - angle_rad;
        // Angles are given in degrees, which rounds them: a side that was in contact is in contact again.
        let is_between = ahead_rad.abs() < half_rad * (1.0 - 1e-6);
        Self {
            angle_rad,
            speed_rad_s: 0.0,
            ahead_rad: if is_between { ahead_rad } else { half_rad.copysign(ahead_rad) },
            teeth: if is_between { Teeth::Open { motor_rad_s: 0.0 } } else { Teeth::Closed },
        }
    }

    /// Gives both sides a speed.
    pub(super) fn set_speed(&mut self, speed_rad_s: f64) {
        self.speed_rad_s = speed_rad_s;
        if let Teeth::Open { motor_rad_s } = &mut self.teeth {
            *motor_rad_s = speed_rad_s;
        }
    }

    pub(super) fn motor_angle_rad(&self) -> f64 {
        self.angle_rad + self.ahead_rad
    }

    pub(super) const fn motor_speed_rad_s(&self) -> f64 {
        match self.teeth {
            Teeth::Closed => self.speed_rad_s,
            Teeth::Open { motor_rad_s } => motor_rad_s,
        }
    }

    /// Turns on for a time at its speeds.
    pub(super) fn drift(&mut self, play: Option<&Play>, span_s: f64) {
        let (Teeth::Open { motor_rad_s }, Some(play)) = (self.teeth, play) else {
            self.angle_rad += self.speed_rad_s * span_s;
            return;
        };
        let closing_rad_s = motor_rad_s - self.speed_rad_s;
        let ahead_rad = self.ahead_rad + closing_rad_s * span_s;
        if ahead_rad.abs() <= play.half_rad {
            self.ahead_rad = ahead_rad;
            self.angle_rad += self.speed_rad_s * span_s;
            return;
        }
        let side_rad = play.half_rad.copysign(ahead_rad);
        let until_s = ((side_rad - self.ahead_rad) / closing_rad_s).clamp(0.0, span_s);
        let momentum = play.motor.kg_m2 * motor_rad_s + play.load.kg_m2 * self.speed_rad_s;
        self.angle_rad += self.speed_rad_s * until_s;
        self.speed_rad_s = momentum / (play.motor.kg_m2 + play.load.kg_m2);
        self.angle_rad += self.speed_rad_s * (span_s - until_s);
        self.ahead_rad = side_rad;
        self.teeth = Teeth::Closed;
    }

    /// The speeds after a step.
    pub(super) fn push(
        &mut self,
        whole: &Inertia,
        play: Option<&Play>,
        motor: Acting,
        load: Acting,
    ) {
        if let Some(play) = play {
            let motor_rad_s = play.motor.speed_after(self.motor_speed_rad_s(), motor);
            let load_rad_s = play.load.speed_after(self.speed_rad_s, load);
            let parts = (load_rad_s - motor_rad_s) * self.ahead_rad > 0.0;
            if parts || self.teeth != Teeth::Closed {
                self.teeth = Teeth::Open { motor_rad_s };
                self.speed_rad_s = load_rad_s;
                return;
            }
        }
        let both = Acting {
            torque_nm: motor.torque_nm + load.torque_nm,
            dry_nm: motor.dry_nm + load.dry_nm,
        };
        self.speed_rad_s = whole.speed_after(self.speed_rad_s, both);
    }
}

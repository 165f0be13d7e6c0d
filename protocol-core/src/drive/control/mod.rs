//! What the motor is to do and the current for it, as [`decisions`](super::decisions) says.

mod loops;
mod planner;

use crate::command::{Mode, MotionSetPoint};
use crate::drive::settings::{Accelerations, Gains, PositionLimits};

use loops::{Loops, Output, current, limited};
use planner::{Pace, Profile, ramp};

/// What a command has set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum SetPoint {
    /// A torque current.
    Current { current_a: f32 },
    /// A speed, with a limited torque.
    Speed { speed_dps: f32, limit_a: f32 },
    /// A position, with a limited torque and speed (0 for no limit of the command's own).
    Position { target_deg: f64, max_speed_dps: f32, limit_a: f32 },
    /// Slow down, then hold still.
    Stop,
    /// Position, speed and torque at once.
    Motion(MotionSetPoint),
}

/// The set-point, and how far it is carried out.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Task {
    Off,
    Current { current_a: f32 },
    Speed { target_dps: f32, now_dps: f32, limit_a: f32 },
    Position { target_deg: f64, max_speed_dps: f32, limit_a: f32, plan: Plan },
    Stopping { now_dps: f32 },
    Motion(MotionSetPoint),
}

/// How a position command goes to its target.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Plan {
    /// Not planned yet, or never: direct tracking.
    None,
    /// Along this profile.
    Moves(Profile),
    /// As before, but the profile waits for a shaft that cannot follow it.
    Waits(Profile),
}

impl Plan {
    /// The plan from which a new command goes on.
    fn go_on(self, input: &Input) -> Self {
        match self {
            Self::Moves(profile) | Self::Waits(profile) => {
                let away_deg = (profile.position_deg - input.angle_deg).abs();
                let held = matches!(self, Self::Waits(_)) && input.speed_dps.abs() < STANDING_DPS;
                // A shaft that was held back starts again from where it is.
                if held || away_deg >= LOST_PROFILE_DEG { Self::None } else { self }
            }
            Self::None => self,
        }
    }
}

/// The inputs of the controller.
#[derive(Clone, Copy, Debug)]
pub(super) struct Input {
    pub(super) angle_deg: f64,
    pub(super) speed_dps: f32,
    pub(super) current_a: f32,
    pub(super) stall_current_a: f32,
    pub(super) torque_constant_nm_per_a: f32,
    /// The highest speed of a profile whose command sets no limit.
    pub(super) max_speed_dps: f32,
}

/// Below this speed a stopping motor counts as standing, degrees per second.
const STANDING_DPS: f32 = 1.0;

/// A shaft that stands closer than this to its target is there, degrees. It is the unit in which positions
/// are commanded.
const THERE_DEG: f32 = 0.01;

/// A shaft that is farther than this from its profile, degrees, no longer follows it.
const LOST_PROFILE_DEG: f64 = 10.0;

#[derive(Clone, Debug)]
pub(super) struct Controller {
    task: Task,
    loops: Loops,
}

impl Controller {
    pub(super) fn new() -> Self {
        Self { task: Task::Off, loops: Loops::default() }
    }

    /// Switches the output off and leaves every mode.
    pub(super) fn shut_down(&mut self) {
        *self = Self::new();
    }

    pub(super) const fn is_off(&self) -> bool {
        matches!(self.task, Task::Off)
    }

    /// Which loop runs (0x70).
    pub(super) const fn mode(&self) -> Mode {
        match self.task {
            Task::Off => Mode::from_raw(0),
            Task::Current { .. } | Task::Motion(_) => Mode::CURRENT,
            Task::Speed { .. } | Task::Stopping { .. } => Mode::SPEED,
            Task::Position { .. } => Mode::POSITION,
        }
    }

    /// The command's own limit of the current, A; infinite for none.
    pub(super) const fn limit_a(&self) -> f32 {
        match self.task {
            Task::Speed { limit_a, .. } | Task::Position { limit_a, .. } => limit_a,
            Task::Off | Task::Current { .. } | Task::Motion(_) | Task::Stopping { .. } => {
                f32::INFINITY
            }
        }
    }

    /// Takes a set-point, and goes on smoothly from what runs.
    pub(super) fn set(&mut self, set_point: SetPoint, input: &Input) {
        let before = self.task;
        self.task = match set_point {
            SetPoint::Current { current_a } => Task::Current { current_a },
            SetPoint::Motion(motion) => Task::Motion(motion),
            SetPoint::Speed { speed_dps, limit_a } => {
                Task::Speed { target_dps: speed_dps, now_dps: self.ramp_start(input), limit_a }
            }
            SetPoint::Stop => match before {
                // Already standing: goes on holding the same place.
                Task::Position { target_deg, limit_a, .. }
                    if limit_a >= input.stall_current_a
                        && (target_deg - input.angle_deg).abs() < 0.5
                        && input.speed_dps.abs() < STANDING_DPS =>
                {
                    self.hold(target_deg, input)
                }
                _ => Task::Stopping { now_dps: self.ramp_start(input) },
            },
            SetPoint::Position { target_deg, max_speed_dps, limit_a } => {
                let plan = match before {
                    Task::Position { plan, .. } => plan.go_on(input),
                    _ => Plan::None,
                };
                Task::Position { target_deg, max_speed_dps, limit_a, plan }
            }
        };
        if core::mem::discriminant(&before) != core::mem::discriminant(&self.task) {
            // When the mode changes, the share of the current that the load takes stays.
            self.loops.restart(match before {
                Task::Off => 0.0,
                Task::Current { .. } | Task::Motion(_) => input.current_a,
                Task::Speed { .. } | Task::Position { .. } | Task::Stopping { .. } => {
                    self.loops.load_a()
                }
            });
        }
    }

    /// Ends the motion under way at these limits; a shaft that is beyond them stays where it is.
    pub(super) fn keep_within(&mut self, limits: PositionLimits, angle_deg: f64) {
        if let Task::Position { target_deg, .. } = &mut self.task {
            *target_deg = limits.around(angle_deg).nearest(*target_deg);
        }
    }

    /// Where a ramp begins: at the ramp that already runs, or at the measured speed.
    fn ramp_start(&self, input: &Input) -> f32 {
        match self.task {
            Task::Speed { now_dps, .. } | Task::Stopping { now_dps } => now_dps,
            _ => input.speed_dps,
        }
    }

    fn hold(&self, target_deg: f64, input: &Input) -> Task {
        // Not planned: a profile that rests at its target is direct tracking of it.
        Task::Position {
            target_deg,
            max_speed_dps: 0.0,
            limit_a: input.stall_current_a,
            plan: Plan::Moves(Profile { position_deg: target_deg, speed_dps: 0.0 }),
        }
    }

    /// Runs one step of the loops. Returns the output current, `None` for the output off.
    pub(super) fn step(
        &mut self,
        input: &Input,
        gains: &Gains,
        accelerations: &Accelerations,
        dt: f32,
    ) -> Option<f32> {
        let stall_a = input.stall_current_a;
        let speed_up = accelerations.speed_acceleration.dps2();
        let slow_down = accelerations.speed_deceleration.dps2();
        let ramp_is_over = matches!(self.task, Task::Stopping { now_dps } if now_dps == 0.0);
        if ramp_is_over && input.speed_dps.abs() < STANDING_DPS {
            self.task = self.hold(input.angle_deg, input);
        }
        let loops = &mut self.loops;
        let (wanted_a, limit_a) = match &mut self.task {
            Task::Off => return None,
            Task::Current { current_a } => (*current_a, stall_a),
            Task::Motion(set_point) => (motion_current(set_point, input), stall_a),
            Task::Speed { target_dps, now_dps, limit_a } => {
                let next_dps = ramp(*now_dps, *target_dps, speed_up, slow_down, dt);
                // Heat may have lowered the drive's own limit since.
                let limit_a = limit_a.min(stall_a);
                (follow(loops, gains, now_dps, next_dps, input, limit_a, dt), limit_a)
            }
            Task::Stopping { now_dps } => {
                let next_dps = ramp(*now_dps, 0.0, speed_up, slow_down, dt);
                (follow(loops, gains, now_dps, next_dps, input, stall_a, dt), stall_a)
            }
            Task::Position { target_deg, max_speed_dps, limit_a, plan } => {
                let limit_a = limit_a.min(stall_a);
                let set_limit = (*max_speed_dps > 0.0).then_some(*max_speed_dps);
                let own_limit = input.max_speed_dps;
                let (now, goal, max_dps) = match pace(accelerations, set_limit, own_limit) {
                    Some(pace) => {
                        let now = match *plan {
                            Plan::Moves(profile) | Plan::Waits(profile) => profile,
                            Plan::None => Profile {
                                position_deg: input.angle_deg,
                                speed_dps: input.speed_dps,
                            },
                        };
                        let mut goal = now;
                        goal.advance(*target_deg, &pace, dt);
                        (Some(now), goal, pace.max_speed_dps.max(goal.speed_dps.abs()))
                    }
                    None => {
                        let goal = Profile { position_deg: *target_deg, speed_dps: 0.0 };
                        (None, goal, set_limit.unwrap_or(f32::MAX))
                    }
                };
                let error_deg = (goal.position_deg - input.angle_deg) as f32;
                let speed_dps =
                    loops.position(gains, error_deg, goal.speed_dps, input.speed_dps, max_dps, dt);
                let wrong_dps = speed_dps - input.speed_dps;
                let is_there = error_deg.abs() < THERE_DEG && wrong_dps.abs() < STANDING_DPS;
                let output = if is_there {
                    loops.speed_at_rest(gains, wrong_dps, limit_a)
                } else {
                    loops.speed(gains, wrong_dps, limit_a, dt)
                };
                *plan = now.map_or(Plan::None, |now| {
                    let further_deg = (goal.position_deg - now.position_deg) as f32;
                    let faster_dps = goal.speed_dps - now.speed_dps;
                    let change_dps = gains.position_kp.value() * further_deg + faster_dps;
                    if runs_ahead(change_dps, &output) {
                        Plan::Waits(now)
                    } else {
                        Plan::Moves(goal)
                    }
                });
                (output.value, limit_a)
            }
        };
        let limit_a = limit_a.min(stall_a);
        let wanted_a = limited(wanted_a, limit_a);
        Some(current(gains, wanted_a, input.current_a, limit_a, dt))
    }
}

/// The current that brings the shaft to `next_dps`, the next speed of the ramp after `now_dps`.
fn follow(
    loops: &mut Loops,
    gains: &Gains,
    now_dps: &mut f32,
    next_dps: f32,
    input: &Input,
    limit_a: f32,
    dt: f32,
) -> f32 {
    let output = loops.speed(gains, next_dps - input.speed_dps, limit_a, dt);
    *now_dps = if runs_ahead(next_dps - *now_dps, &output) {
        input.speed_dps.max(now_dps.min(next_dps)).min(now_dps.max(next_dps))
    } else {
        next_dps
    };
    output.value
}

/// Whether a plan that changes by `change_dps` asks for more of what a limit already takes away. Then the plan waits
/// for the shaft: a lead over the shaft would have to be made good by overshooting.
fn runs_ahead(change_dps: f32, output: &Output) -> bool {
    change_dps * output.beyond > 0.0
}

/// How a planned position moves; `None` for direct tracking, which is an acceleration of 0 (2.21.1).
fn pace(accelerations: &Accelerations, set_limit: Option<f32>, own_limit: f32) -> Option<Pace> {
    let acceleration_dps2 = accelerations.position_acceleration.dps2();
    let deceleration_dps2 = accelerations.position_deceleration.dps2();
    (acceleration_dps2 > 0.0).then(|| Pace {
        max_speed_dps: set_limit.unwrap_or(own_limit),
        acceleration_dps2,
        deceleration_dps2: if deceleration_dps2 > 0.0 {
            deceleration_dps2
        } else {
            acceleration_dps2
        },
    })
}

/// The manual's expression (5.1), with the torque divided by the torque constant.
fn motion_current(set_point: &MotionSetPoint, input: &Input) -> f32 {
    let position_rad = input.angle_deg.to_radians() as f32;
    let velocity_rad_s = input.speed_dps.to_radians();
    let torque_nm = set_point.kp * (set_point.position_rad - position_rad)
        + set_point.kd * (set_point.velocity_rad_s - velocity_rad_s)
        + set_point.torque_nm;
    torque_nm / input.torque_constant_nm_per_a
}

#[cfg(test)]
mod tests {
    use super::*;

    const INPUT: Input = Input {
        angle_deg: 180.0,
        speed_dps: 90.0,
        current_a: 0.0,
        stall_current_a: 12.0,
        torque_constant_nm_per_a: 2.0,
        max_speed_dps: 1_000.0,
    };

    fn step(controller: &mut Controller, input: &Input) -> Option<f32> {
        let gains = Gains::tuned(0.02, 2.0, 100.0);
        controller.step(input, &gains, &Accelerations::default(), 0.001)
    }

    #[test]
    fn modes_are_reported_as_the_manual_numbers_them() {
        let mut controller = Controller::new();
        assert_eq!((controller.mode(), step(&mut controller, &INPUT)), (Mode::from_raw(0), None));
        let full = INPUT.stall_current_a;
        for (set_point, mode) in [
            (SetPoint::Current { current_a: 1.0 }, Mode::CURRENT),
            (SetPoint::Speed { speed_dps: 1.0, limit_a: full }, Mode::SPEED),
            (
                SetPoint::Position { target_deg: 1.0, max_speed_dps: 1.0, limit_a: full },
                Mode::POSITION,
            ),
            (SetPoint::Motion(MotionSetPoint::default()), Mode::CURRENT),
            (SetPoint::Stop, Mode::SPEED),
        ] {
            controller.set(set_point, &INPUT);
            assert_eq!(controller.mode(), mode);
            assert!(step(&mut controller, &INPUT).is_some());
        }
        controller.shut_down();
        assert!(controller.is_off());
    }

    #[test]
    fn a_torque_constant_of_zero_puts_out_nothing_wild() {
        let mut controller = Controller::new();
        controller.set(SetPoint::Motion(MotionSetPoint::default()), &INPUT);
        let input =
            Input { torque_constant_nm_per_a: 0.0, speed_dps: 0.0, angle_deg: 0.0, ..INPUT };
        assert_eq!(step(&mut controller, &input), Some(0.0));
    }
}

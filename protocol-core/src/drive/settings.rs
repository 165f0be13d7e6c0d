//! What a drive keeps over power-off, and where.

use crate::command::{AccelerationIndex, BaudCode, PidIndex};
use crate::id::MotorId;
use crate::units::{Acceleration, Angle, EncoderPulses, Gain, Milliseconds};

/// The gains of the control loops (2.1.4), each as its loop uses it: see
/// [`Gains::tuned`] for the units.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Gains {
    /// Current loop, proportional: the share of a missing current that comes within 0.1 ms, 1 for all.
    pub current_kp: Gain,
    /// Current loop, integral: the share that comes within a second besides, 1/s.
    pub current_ki: Gain,
    /// Speed loop, proportional, A per degree per second.
    pub speed_kp: Gain,
    /// Speed loop, integral, A per degree.
    pub speed_ki: Gain,
    /// Position loop, proportional, 1/s.
    pub position_kp: Gain,
    /// Position loop, integral, 1/s².
    pub position_ki: Gain,
    /// Position loop, derivative: a bare number.
    pub position_kd: Gain,
}

impl Gains {
    /// Gains for a motor whose output shaft has this inertia in kg·m² and gives this torque in N·m for
    /// 1 A, so that its speed settles with this bandwidth in rad/s. The bandwidth should stay well below
    /// the control rate: 1000 rad/s suits 10 kHz.
    ///
    /// A drive does not know its load. A load makes the speed loop slower by as much as the inertia grows, but not the
    /// loops around it. So those are far slower. With `B` the bandwidth, `P` the position loop's gain, `I` the speed
    /// loop's integral gain over its proportional gain and `n` the growth, the loops' polynomial is
    /// `n·s³ + B·s² + B·(P + I)·s + B·P·I`. It is stable as long as `n < B·(P + I) / (P·I)`: 240 times.
    ///
    /// If an argument is not a positive number, the gains of the speed loop are 0, and no speed or position command
    /// moves the motor.
    pub fn tuned(inertia_kg_m2: f32, torque_constant_nm_per_a: f32, bandwidth_rad_s: f32) -> Self {
        let positive = |x: f32| if x.is_finite() && x > 0.0 { x } else { 0.0 };
        let gain = |x: f32| Gain::new(x).unwrap_or(Gain::ZERO);
        let bandwidth = positive(bandwidth_rad_s);
        let speed_kp = positive(inertia_kg_m2) * bandwidth / torque_constant_nm_per_a;
        let speed_kp = positive(speed_kp.to_radians());
        Self {
            current_kp: gain(1.0),
            current_ki: gain(100.0),
            speed_kp: gain(speed_kp),
            speed_ki: gain(speed_kp * bandwidth / 200.0),
            position_kp: gain(bandwidth / 40.0),
            position_ki: Gain::ZERO,
            position_kd: Gain::ZERO,
        }
    }

    /// The gain with this index, `None` for one that the manual does not name.
    pub const fn get(mut self, index: PidIndex) -> Option<Gain> {
        self.place(index).copied()
    }

    /// Sets the gain with this index, and returns whether the manual names it.
    pub const fn set(&mut self, index: PidIndex, value: Gain) -> bool {
        set(self.place(index), value)
    }

    const fn place(&mut self, index: PidIndex) -> Option<&mut Gain> {
        Some(match index {
            PidIndex::CURRENT_KP => &mut self.current_kp,
            PidIndex::CURRENT_KI => &mut self.current_ki,
            PidIndex::SPEED_KP => &mut self.speed_kp,
            PidIndex::SPEED_KI => &mut self.speed_ki,
            PidIndex::POSITION_KP => &mut self.position_kp,
            PidIndex::POSITION_KI => &mut self.position_ki,
            PidIndex::POSITION_KD => &mut self.position_kd,
            _ => return None,
        })
    }
}

const fn set<T: Copy>(place: Option<&mut T>, value: T) -> bool {
    let is_known = place.is_some();
    if let Some(place) = place {
        *place = value;
    }
    is_known
}

/// The four planning accelerations (2.4.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Accelerations {
    /// Position planning, up to the maximum speed. [`Acceleration::NONE`] for direct tracking.
    pub position_acceleration: Acceleration,
    /// Position planning, down to standstill. [`Acceleration::NONE`] for the acceleration's value.
    pub position_deceleration: Acceleration,
    /// Speed planning, away from standstill. [`Acceleration::NONE`] for as hard as the current allows.
    pub speed_acceleration: Acceleration,
    /// Speed planning, towards standstill. [`Acceleration::NONE`] for as hard as the current allows.
    pub speed_deceleration: Acceleration,
}

impl Accelerations {
    /// The acceleration with this index, `None` for one that the manual does not name.
    pub const fn get(mut self, index: AccelerationIndex) -> Option<Acceleration> {
        self.place(index).copied()
    }

    /// Sets the acceleration with this index, and returns whether the manual names it.
    pub const fn set(&mut self, index: AccelerationIndex, value: Acceleration) -> bool {
        set(self.place(index), value)
    }

    const fn place(&mut self, index: AccelerationIndex) -> Option<&mut Acceleration> {
        Some(match index {
            AccelerationIndex::POSITION_ACCELERATION => &mut self.position_acceleration,
            AccelerationIndex::POSITION_DECELERATION => &mut self.position_deceleration,
            AccelerationIndex::SPEED_ACCELERATION => &mut self.speed_acceleration,
            AccelerationIndex::SPEED_DECELERATION => &mut self.speed_deceleration,
            _ => return None,
        })
    }
}

const FACTORY_ACCELERATION: Acceleration = match Acceleration::try_from_raw(10_000) {
    Ok(acceleration) => acceleration,
    Err(_) => Acceleration::NONE,
};

/// 10000 dps/s each, the manual's example (2.4.5).
impl Default for Accelerations {
    fn default() -> Self {
        Self {
            position_acceleration: FACTORY_ACCELERATION,
            position_deceleration: FACTORY_ACCELERATION,
            speed_acceleration: FACTORY_ACCELERATION,
            speed_deceleration: FACTORY_ACCELERATION,
        }
    }
}

/// Everything that a drive keeps over power-off, and
/// [when a change acts](super::decisions#what-is-kept-and-when-it-acts).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Settings {
    /// The motor's id (0x79, function 5), on CAN and RS485 alike.
    pub id: MotorId,
    /// Gains of the control loops (0x32).
    pub gains: Gains,
    /// Planning accelerations (0x43).
    pub accelerations: Accelerations,
    /// The raw encoder position that counts as zero (0x63, 0x64, function 1).
    pub zero_offset: EncoderPulses,
    /// Whether commands to all motors (CAN 0x280) go unheard (function 2).
    pub can_id_filter: bool,
    /// Whether the turns are saved (function 4).
    pub save_multi_turn: bool,
    /// The raw encoder position at the last power-off or restart, where turns are saved.
    pub saved_position: Option<i64>,
    /// The largest angle of position commands (function 6), `None` while there is no limit. On the bus
    /// its unit is [taken to be](super::decisions#motion) 0.01 degrees.
    pub max_positive_angle: Option<Angle>,
    /// The smallest angle of position commands (function 7), as
    /// [`max_positive_angle`](Self::max_positive_angle).
    pub max_negative_angle: Option<Angle>,
    /// The longest silence before the output is cut (0xB3); 0 for no protection.
    pub protection_timeout: Milliseconds,
    /// The bit rate of the bus (0xB4).
    pub baud_rate: BaudCode,
}

impl Settings {
    /// What a drive leaves the factory with: no limits, no protection, turns not saved, and
    /// 1 Mbit/s on CAN.
    pub fn factory(id: MotorId, gains: Gains, baud_rate: BaudCode) -> Self {
        Self {
            id,
            gains,
            accelerations: Accelerations::default(),
            zero_offset: EncoderPulses::from_raw(0),
            can_id_filter: false,
            save_multi_turn: false,
            saved_position: None,
            max_positive_angle: None,
            max_negative_angle: None,
            protection_timeout: Milliseconds::from_raw(0),
            baud_rate,
        }
    }

    pub(super) fn position_limits(&self) -> PositionLimits {
        let degrees = |angle: Option<Angle>| angle.map(Angle::degrees_f64);
        PositionLimits {
            smallest_deg: degrees(self.max_negative_angle).unwrap_or(f64::NEG_INFINITY),
            largest_deg: degrees(self.max_positive_angle).unwrap_or(f64::INFINITY),
        }
    }
}

/// The angles between which position commands move the shaft, degrees (functions 6 and 7).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PositionLimits {
    smallest_deg: f64,
    largest_deg: f64,
}

impl PositionLimits {
    /// The nearest allowed angle. If the two limits leave none, function 7's limit is used.
    pub(super) fn nearest(&self, angle_deg: f64) -> f64 {
        angle_deg.min(self.largest_deg).max(self.smallest_deg)
    }

    /// The same limits, widened if needed to include the shaft's own angle.
    pub(super) fn around(&self, angle_deg: f64) -> Self {
        Self {
            smallest_deg: self.smallest_deg.min(angle_deg),
            largest_deg: self.largest_deg.max(angle_deg),
        }
    }
}

/// A drive's non-volatile memory.
///
/// A store must be all or nothing: after a loss of power in the middle of one, `load` returns either
/// the settings before or those after.
pub trait Memory {
    /// What can go wrong.
    type Error;

    /// What was stored last, `None` if nothing ever was.
    ///
    /// # Errors
    /// If the memory cannot be read, or holds what no drive stored.
    fn load(&mut self) -> Result<Option<Settings>, Self::Error>;

    /// Keeps `settings` over power-off. A drive calls it only when something has changed.
    ///
    /// # Errors
    /// If they are not kept.
    fn store(&mut self, settings: &Settings) -> Result<(), Self::Error>;
}

/// A memory that outlives a simulated power-off, and nothing more.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RamMemory {
    /// What was stored last.
    pub settings: Option<Settings>,
    /// How often something was stored.
    pub stores: u32,
}

impl Memory for RamMemory {
    type Error = core::convert::Infallible;

    fn load(&mut self) -> Result<Option<Settings>, Self::Error> {
        Ok(self.settings)
    }

    fn store(&mut self, settings: &Settings) -> Result<(), Self::Error> {
        self.settings = Some(*settings);
        self.stores = self.stores.saturating_add(1);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_index_has_its_own_place() {
        let mut gains = Gains::tuned(0.02, 2.0, 100.0);
        for (place, &index) in PidIndex::ALL.iter().enumerate() {
            gains.set(index, Gain::new(place as f32).unwrap());
        }
        for (place, &index) in PidIndex::ALL.iter().enumerate() {
            assert_eq!(gains.get(index).unwrap().value(), place as f32);
        }
        assert_eq!(gains.get(PidIndex::from_raw(3)), None);

        let mut accelerations = Accelerations::default();
        for (place, &index) in AccelerationIndex::ALL.iter().enumerate() {
            accelerations.set(index, Acceleration::try_from_raw(100 + place as u32).unwrap());
        }
        for (place, &index) in AccelerationIndex::ALL.iter().enumerate() {
            assert_eq!(accelerations.get(index).unwrap().raw(), 100 + place as u32);
        }
    }

    #[test]
    fn tuned_gains_follow_inertia_and_torque_constant() {
        // 0.02 kg·m² * 100 rad/s / 2 N·m/A = 1 A per rad/s.
        let gains = Gains::tuned(0.02, 2.0, 100.0);
        assert!((gains.speed_kp.value() - core::f32::consts::PI / 180.0).abs() < 1e-7);
        assert_eq!(gains.position_kp.value(), 2.5);
        for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(Gains::tuned(bad, 2.0, 100.0).speed_kp, Gain::ZERO);
            assert_eq!(Gains::tuned(0.02, bad, 100.0).speed_kp, Gain::ZERO);
        }
    }
}

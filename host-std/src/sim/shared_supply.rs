//! A supply that all drives of a bus share.

use std::fmt;
use std::sync::{Arc, Mutex};

use myactuator_protocol_core::time::{Duration, Instant};

use super::BusFleet;
use super::bus::{Medium, lock};
use super::plant::{CommonPoint, ImpossibleFigure, STEP, Supply};
use super::seat::Seat;

/// While one of the drives turns fast or draws much, what they draw is added up in every step of the physics, since it
/// then depends too much on the voltage for a longer period. Otherwise it is added up once in so many steps.
const CALM_STEPS: u32 = 10;

/// A supply that drives share; clones are the same supply. If one drive draws current, the voltage sags for all. If one
/// feeds back, the others use that first.
#[derive(Clone)]
pub struct SharedSupply(Arc<Mutex<CommonPoint>>);

impl fmt::Debug for SharedSupply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("SharedSupply").field(&self.supply()).finish()
    }
}

impl SharedSupply {
    /// Its figures.
    pub fn supply(&self) -> Supply {
        *lock(&self.0).supply()
    }

    /// Changes its figures. Its capacitor keeps its voltage at first, and follows.
    ///
    /// # Errors
    /// [`ImpossibleFigure`] for a figure that no supply has.
    pub fn set_supply(&self, supply: Supply) -> Result<(), ImpossibleFigure> {
        supply.check()?;
        lock(&self.0).replace_supply(supply);
        Ok(())
    }

    /// Its voltage between the drives' cables, V.
    pub fn voltage_v(&self) -> f64 {
        lock(&self.0).voltage_v()
    }
}

impl<B: Medium> BusFleet<B> {
    /// Connects all drives to one supply.
    pub(super) fn share_supply(&mut self, supply: Supply) -> Result<(), ImpossibleFigure> {
        supply.check()?;
        let seats: Vec<Arc<Mutex<Seat>>> =
            self.drives.iter().map(|it| Arc::clone(&it.seat)).collect();
        let own_f = |seat: &Arc<Mutex<Seat>>| lock(seat).drive.plant().supply().capacitance_f;
        let step_s = STEP.as_micros() as f64 * 1e-6;
        let point = CommonPoint::new(supply, seats.iter().map(own_f).sum(), step_s);
        for seat in &seats {
            lock(seat).drive.plant_mut().join(&point);
        }
        let point = Arc::new(Mutex::new(point));
        let stations: Vec<usize> = self.drives.iter().map(|it| it.station().index()).collect();
        self.shared_supply = Some(SharedSupply(Arc::clone(&point)));
        let mut steps = 1;
        self.world.plan(STEP, move |kernel, now| {
            let are_calm = step(&point, &seats, now, steps, |place| kernel.wake(stations[place]));
            steps = if are_calm { CALM_STEPS } else { 1 };
            Some(Duration::from_micros(STEP.as_micros() * u64::from(steps)))
        });
        Ok(())
    }
}

/// The charge that the drives have drawn in a period of so many steps gives the voltage of the next. Returns whether
/// all of them are calm. A drive that goes off or starts is woken, since its controller does the same. Only one lock is
/// held at a time: code that works on a drive may look at its supply.
fn step(
    point: &Mutex<CommonPoint>,
    seats: &[Arc<Mutex<Seat>>],
    now: Instant,
    steps: u32,
    mut wake: impl FnMut(usize),
) -> bool {
    let (mut charge_c, mut are_calm) = (0.0, true);
    for (place, seat) in seats.iter().enumerate() {
        let mut seat = lock(seat);
        let was_powered = seat.drive.is_powered();
        seat.catch_up(now);
        if seat.drive.is_powered() != was_powered {
            wake(place);
        }
        let plant = seat.drive.plant_mut();
        charge_c += plant.take_charge_c();
        are_calm &= plant.is_calm();
    }
    let point = {
        let mut point = lock(point);
        point.draw_c(charge_c, steps);
        *point
    };
    for seat in seats {
        lock(seat).drive.plant_mut().follow(&point);
    }
    are_calm
}

#[cfg(test)]
mod tests {
    use myactuator_protocol_core::MotorId;
    use myactuator_protocol_core::command::{ReadStatus1, Torque};
    use myactuator_protocol_core::io::Runner as _;
    use myactuator_protocol_core::units::Current;

    use super::*;
    use crate::sim::plant::{BrakeResistor, Load, MotorParameters};
    use crate::sim::{CanFleet, Fleet};

    const CABLE_OHM: f64 = 0.05;

    /// Two motors, behind half an ohm.
    fn fleet(supply: Supply) -> CanFleet {
        let rotor = Load { inertia_kg_m2: 0.05, ..Load::NONE };
        Fleet::new(2).load(rotor).supply(supply).on_can(1_000_000).unwrap()
    }

    /// It takes back little.
    fn bench(voltage_v: f64) -> Supply {
        Supply { feedback_resistance_ohm: 20.0, ..Supply::battery(voltage_v) }
    }

    fn soft() -> Supply {
        Supply { resistance_ohm: 0.5, ..Supply::battery(48.0) }
    }

    /// Voltage and current at each drive's input.
    fn inputs(fleet: &CanFleet) -> Vec<(f64, f64)> {
        let input = |it: &crate::sim::DriveHandle| {
            it.with(|drive| {
                let it = drive.state().measurement;
                (it.supply_voltage_v.into(), it.supply_current_a.into())
            })
        };
        fleet.drives.iter().map(input).collect()
    }

    #[test]
    fn current_of_one_motor_sags_the_voltage_of_all() {
        let fleet = fleet(soft());
        let mut master = fleet.master::<2>();
        for motor in MotorId::all().take(2) {
            fleet.drives[motor.index()].with(|it| it.plant_mut().force_brake(Some(false)));
        }
        // The first one pushes against its brake, which nobody opens; the second idles.
        let push = Torque { current: Current::from_amperes(9.5).unwrap() };
        master.set_point_and_wait(MotorId::MIN, push).unwrap();
        fleet.world.run_for(Duration::from_millis(20));
        let inputs = inputs(&fleet);
        let total_a: f64 = inputs.iter().map(|(_, current_a)| current_a).sum();
        assert!(total_a > 1.0, "{inputs:?}");
        // Kirchhoff, by hand: 48 V, half an ohm for both, and each one's own cable.
        for (voltage_v, current_a) in inputs {
            let by_hand_v = 48.0 - 0.5 * total_a - CABLE_OHM * current_a;
            assert!((voltage_v - by_hand_v).abs() < 0.01, "{voltage_v} {by_hand_v}");
        }
    }

    #[test]
    fn feedback_of_one_motor_raises_all_and_a_brake_resistor_burns_it() {
        let brake = BrakeResistor { on_above_v: 55.0, off_below_v: 54.0, resistance_ohm: 5.0 };
        let voltages_v = |brake_resistor| {
            let fleet = fleet(Supply { brake_resistor, ..bench(48.0) });
            fleet.drives[0].with(|it| it.plant_mut().set_output_speed_dps(6_000.0)).unwrap();
            let after_a_ms = || {
                fleet.world.run_for(Duration::from_millis(1));
                // The idle one's.
                inputs(&fleet)[1].0
            };
            std::iter::repeat_with(after_a_ms).take(50).collect::<Vec<_>>()
        };
        let highest_v = |voltages_v: &[f64]| voltages_v.iter().copied().fold(0.0, f64::max);
        let (free_v, braked_v) = (voltages_v(None), voltages_v(Some(brake)));
        assert!(highest_v(&free_v) > 60.0, "{free_v:?}");
        assert!(highest_v(&braked_v) < highest_v(&free_v) - 3.0, "{braked_v:?}, {free_v:?}");
        // It goes off again at 54 V, within a step of the physics.
        let burning: Vec<_> = braked_v.iter().skip_while(|&&it| it < 54.5).take(5).collect();
        assert!(burning.iter().all(|&&it| it > 53.0), "{braked_v:?}");
    }

    #[test]
    fn feedback_of_many_motors_raises_the_voltage_like_that_of_one() {
        // Diodes conduct in X15s that are turned too fast, 12 A per volt each.
        let model = MotorParameters::named("RMD-X15-P20-450").unwrap();
        let dps = 1.5 * model.rating.no_load_speed_rpm * 6.0;
        let heavy = Load { inertia_kg_m2: 50.0, ..Load::NONE };
        let of = |count| Fleet::new(count).model(model.clone()).load(heavy);
        for (count, supply) in [(2, bench(48.0)), (12, Supply::battery(48.0))] {
            let fleet = of(count).supply(supply).on_can(1_000_000).unwrap();
            // One, with its share of the supply.
            let share = 1.0 / f64::from(count);
            let supply = Supply {
                resistance_ohm: CABLE_OHM + supply.resistance_ohm / share,
                feedback_resistance_ohm: CABLE_OHM + supply.feedback_resistance_ohm / share,
                ..supply
            };
            let alone = of(1).on_can(1_000_000).unwrap();
            alone.drives[0].with(|it| it.plant_mut().set_supply(supply)).unwrap();
            for drive in fleet.drives.iter().chain(&alone.drives) {
                drive.with(|it| it.plant_mut().set_output_speed_dps(dps)).unwrap();
            }
            for ms in 0..20 {
                fleet.world.run_for(Duration::from_millis(1));
                alone.world.run_for(Duration::from_millis(1));
                let (voltage_v, alone_v) = (inputs(&fleet)[0].0, inputs(&alone)[0].0);
                let near_v = if ms < 5 { 6.0 } else { 1.5 };
                assert!(
                    (voltage_v - alone_v).abs() < near_v,
                    "{count}, {ms} ms: {voltage_v}, {alone_v}"
                );
            }
        }
    }

    #[test]
    fn dip_after_feedback_is_no_deeper_than_the_resistance_makes_it() {
        let fleet = fleet(bench(48.0));
        // A little above 48 V, as after a stop.
        fleet.drives[0].with(|it| it.plant_mut().set_output_speed_dps(1_600.0)).unwrap();
        fleet.world.run_for(Duration::from_millis(2));
        let mut point = *lock(&fleet.shared_supply().unwrap().0);
        // 30 A for a millisecond: 48 V - 50 mOhm * 30 A.
        point.draw_c(0.03, 10);
        assert!((point.voltage_v() - 46.5).abs() < 1.0, "{}", point.voltage_v());
    }

    #[test]
    fn own_supply_of_a_motor_becomes_its_cable_to_the_shared_one() {
        let fleet = fleet(soft());
        let brake = BrakeResistor { on_above_v: 20.0, off_below_v: 15.0, resistance_ohm: 5.0 };
        let other = Supply { resistance_ohm: 0.2, brake_resistor: Some(brake), ..bench(12.0) };
        fleet.drives[0].with(|it| it.plant_mut().set_supply(other)).unwrap();
        fleet.world.run_for(Duration::from_millis(20));
        let own = fleet.drives[0].with(|it| *it.plant().supply());
        assert_eq!((own.resistance_ohm, own.feedback_resistance_ohm), (0.2, 0.2));
        assert_eq!((own.brake_resistor, own.capacitance_f), (None, 1000e-6));
        assert_eq!(own.voltage_v, fleet.shared_supply().unwrap().voltage_v());
        assert!(inputs(&fleet)[0].0 > 47.0);
    }

    #[test]
    fn shared_supply_can_be_replaced() {
        let fleet = fleet(soft());
        let shared = fleet.shared_supply().unwrap();
        shared.set_supply(Supply::battery(24.0)).unwrap();
        fleet.world.run_for(Duration::from_millis(50));
        assert!((shared.voltage_v() - 24.0).abs() < 0.1);
        assert!(inputs(&fleet).iter().all(|(voltage_v, _)| (voltage_v - 24.0).abs() < 0.1));
        assert!(shared.set_supply(Supply::battery(f64::NAN)).is_err());
        assert!(Fleet::new(1).supply(Supply::battery(f64::NAN)).on_can(1_000_000).is_err());
        assert!(Fleet::new(1).on_can(1_000_000).unwrap().shared_supply().is_none());
    }

    /// An emergency stop that takes the motors' power does the same.
    #[test]
    fn drives_whose_supply_is_taken_away_are_off_and_start_again_with_it() {
        let fleet = fleet(soft());
        let shared = fleet.shared_supply().unwrap();
        let mut master = fleet.master::<2>();
        let powered =
            || fleet.drives.iter().map(|it| it.with(|it| it.state().powered)).collect::<Vec<_>>();
        let mut volts = |voltage_v| {
            shared.set_supply(Supply { voltage_v, ..soft() }).unwrap();
            fleet.world.run_for(Duration::from_millis(50));
            (master.ask(MotorId::MIN, ReadStatus1).is_ok(), powered())
        };
        assert_eq!(volts(6.0), (true, vec![true; 2]), "it has an error, and answers");
        assert_eq!(volts(0.0), (false, vec![false; 2]));
        assert!(inputs(&fleet).iter().all(|&(_, current_a)| current_a == 0.0));
        assert_eq!(volts(4.8), (false, vec![false; 2]), "not before there are 5 V");
        assert_eq!(volts(48.0), (true, vec![true; 2]));
    }

    #[test]
    fn the_same_supply_again_changes_nothing() {
        let brake = BrakeResistor { on_above_v: 60.0, off_below_v: 50.0, resistance_ohm: 5.0 };
        let fleet = fleet(Supply { brake_resistor: Some(brake), ..bench(48.0) });
        let mut point = *lock(&fleet.shared_supply().unwrap().0);
        // Somewhat above 48 V it takes nothing back; 45 mC lift 3 mF by 15 V then, and the resistor goes on.
        point.draw_c(-0.003, 1);
        point.draw_c(-0.045, 1);
        let mut voltages_v = Vec::new();
        let mut again = point;
        for _ in 0..200 {
            again.replace_supply(*again.supply());
            again.draw_c(0.0, 1);
            point.draw_c(0.0, 1);
            assert_eq!(again.voltage_v(), point.voltage_v());
            voltages_v.push(point.voltage_v());
        }
        // It stays on below 60 V: 9.6 V behind 4 Ohm, thus 12 ms to an e-th of the way, by hand.
        let after_2_ms_v = 9.6 + (voltages_v[0] - 9.6) * (-2.0_f64 / 12.0).exp();
        assert!((voltages_v[20] - after_2_ms_v).abs() < 1e-6, "{voltages_v:?}");
        // And goes off at 50 V, from where 20 Ohm take it to 48 V.
        assert!((49.0..50.0).contains(&voltages_v[199]), "{voltages_v:?}");
    }

    #[test]
    fn standing_motors_cost_few_steps_of_their_shared_supply() {
        let fleet = fleet(Supply::battery(48.0));
        let end = Instant::from_micros(100_000);
        let steps = std::iter::repeat_with(|| fleet.world.step());
        let steps = steps.take_while(|_| fleet.world.now() < end).count();
        assert!((90..200).contains(&steps), "{steps}");
    }

    #[test]
    fn dead_supply_costs_few_steps_and_drives_start_once_it_is_back() {
        let fleet = fleet(soft());
        let (shared, mut master) = (fleet.shared_supply().unwrap(), fleet.master::<2>());
        shared.set_supply(Supply { voltage_v: 0.0, ..soft() }).unwrap();
        fleet.world.run_for(Duration::from_secs(1));
        let end = fleet.world.now() + Duration::from_millis(100);
        let steps = std::iter::repeat_with(|| fleet.world.step());
        let steps = steps.take_while(|_| fleet.world.now() < end).count();
        // Every millisecond the supply's, and that of each drive.
        assert!((90..400).contains(&steps), "{steps}");
        shared.set_supply(soft()).unwrap();
        let is_on = || fleet.drives[0].with(|it| it.state().running);
        let started = std::iter::repeat_with(|| fleet.world.step()).position(|_| is_on());
        assert!(started.is_some());
        let at = fleet.world.now();
        assert!(master.ask(MotorId::MIN, ReadStatus1).is_ok());
        assert!(fleet.world.now() - at < Duration::from_millis(2), "it was heard at once");
    }

    #[test]
    fn the_same_time_in_other_portions_gives_the_same_bits() {
        let run = |portions_us: &[u64]| {
            let fleet = fleet(soft());
            fleet.drives[0].with(|it| it.plant_mut().set_output_speed_dps(1_000.0)).unwrap();
            for &portion_us in portions_us
                .iter()
                .cycle()
                .take_while(|_| fleet.world.now() < Instant::from_micros(90_000))
            {
                fleet.world.run_for(Duration::from_micros(portion_us));
            }
            fleet.world.run_until(Instant::from_micros(120_000));
            (fleet.shared_supply().unwrap().voltage_v().to_bits(), format!("{:?}", inputs(&fleet)))
        };
        assert_eq!(run(&[333]), run(&[7_000, 100]));
    }
}

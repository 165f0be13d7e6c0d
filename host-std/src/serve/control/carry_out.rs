//! What requests do to simulated buses.

use myactuator_protocol_core::MotorId;
use serde_json::{Value, json};

use super::request::{Request, Stuck};
use crate::serve::hosted::Hosted;
use crate::sim::PlannedFault;
use crate::sim::plant::{SimulatedMotor, Supply};

/// The buses on which requests work.
#[derive(Debug)]
pub(in crate::serve) struct Scene<'a> {
    pub(in crate::serve) hosts: &'a mut [Box<dyn Hosted>],
}

/// So many faults may wait on a bus for their time or their condition.
const MOST_PLANNED: usize = 1_000;

/// Mechanics would put it back at once.
const LED: &str = "expected a shaft that its motor and its load move, found one that mechanics move: turn it there";

type Done<T = Value> = Result<T, String>;

impl Scene<'_> {
    /// Carries out a request, except [`Request::Log`] and [`Request::Advance`]. Returns the answer.
    ///
    /// # Errors
    /// A sentence; then nothing has changed.
    pub(in crate::serve) fn carry_out(&mut self, request: Request) -> Done {
        match request {
            Request::Time {} | Request::Log {} | Request::Advance { .. } => {}
            Request::State { bus, motor } => {
                let places = self.places(bus.as_deref(), motor)?;
                let buses: Vec<_> =
                    places.iter().map(|&place| self.hosts[place].state(motor)).collect();
                let mut answer = self.time();
                answer["buses"] = json!(buses);
                return Ok(answer);
            }
            Request::Load { bus, motor, load } => {
                self.change(bus, motor, |motor| motor.set_load(load).map_err(|it| it.to_string()))?;
            }
            Request::Supply {
                bus,
                motor,
                voltage_v,
                resistance_ohm,
                feedback_resistance_ohm,
                capacitance_f,
                brake_resistor,
            } => {
                let of_old = |old: Supply| Supply {
                    voltage_v: voltage_v.unwrap_or(old.voltage_v),
                    resistance_ohm: resistance_ohm.unwrap_or(old.resistance_ohm),
                    feedback_resistance_ohm: feedback_resistance_ohm
                        .unwrap_or(old.feedback_resistance_ohm),
                    capacitance_f: capacitance_f.unwrap_or(old.capacitance_f),
                    brake_resistor: brake_resistor.unwrap_or(old.brake_resistor),
                };
                self.change_supply(bus, motor, of_old)?;
            }
            Request::Push { bus, motor, torque_nm } => self.change(bus, motor, |motor| {
                motor.set_external_torque_nm(torque_nm).map_err(|it| it.to_string())
            })?,
            Request::Angle { bus, motor, angle_deg } => self.change(bus, motor, |motor| {
                if motor.is_led() {
                    return Err(LED.to_owned());
                }
                motor.set_output_angle_deg(angle_deg).map_err(|it| it.to_string())
            })?,
            Request::Ambient { bus, motor, ambient_c } => self.change(bus, motor, |motor| {
                motor.set_ambient_c(ambient_c).map_err(|it| it.to_string())
            })?,
            Request::Temperature { bus, motor, motor_c, mosfet_c } => {
                self.change(bus, motor, |motor| {
                    motor
                        .force_motor_temperature_c(motor_c)
                        .and_then(|()| motor.force_mos_temperature_c(mosfet_c))
                        .map_err(|it| it.to_string())
                })?;
            }
            Request::Brake { bus, motor, stuck } => self.change(bus, motor, |motor| {
                motor.force_brake(stuck.map(|stuck| stuck == Stuck::Released));
                Ok(())
            })?,
            Request::Cable { bus, motor, cut } => {
                for place in self.places(bus.as_deref(), motor)? {
                    self.hosts[place].set_cable(motor, cut);
                }
            }
            Request::Fault { bus, fault } => {
                let fault: PlannedFault = fault.parse().map_err(|error| format!("{error}"))?;
                let places = self.places(bus.as_deref(), fault.motor)?;
                let is_full = |&&place: &&usize| self.hosts[place].planned() >= MOST_PLANNED;
                if let Some(&full) = places.iter().find(is_full) {
                    let name = self.hosts[full].name();
                    return Err(format!(
                        "expected at most {MOST_PLANNED} faults that wait on a bus, found as many on {name}: \
                         plan the next when some have struck"
                    ));
                }
                places.into_iter().for_each(|place| self.hosts[place].plan(fault));
            }
        }
        Ok(self.time())
    }

    /// Changes the supplies of single motors, and those that motors share.
    fn change_supply(
        &mut self,
        bus: Option<String>,
        motor: Option<MotorId>,
        of_old: impl Fn(Supply) -> Supply,
    ) -> Done<()> {
        let places = self.places(bus.as_deref(), motor)?;
        let shared = |&place: &usize| self.hosts[place].shared_supply();
        for (place, shared) in places.iter().filter_map(|place| Some((place, shared(place)?))) {
            if let Some(motor) = motor {
                let name = self.hosts[*place].name();
                return Err(format!(
                    "expected a motor with a supply of its own, found motor {motor} of {name}, whose motors share \
                     one: change that without \"motor\""
                ));
            }
            of_old(shared.supply()).check().map_err(|it| it.to_string())?;
        }
        let own: Vec<_> = places.iter().copied().filter(|place| shared(place).is_none()).collect();
        self.change_at(own, motor, |motor| {
            let new = of_old(*motor.supply());
            motor.set_supply(new).map_err(|it| it.to_string())
        })?;
        places.iter().filter_map(shared).try_for_each(|shared| {
            shared.set_supply(of_old(shared.supply())).map_err(|it| it.to_string())
        })
    }

    /// The simulated time.
    pub(super) fn time(&self) -> Value {
        json!({ "at_us": self.hosts.first().map_or(0, |host| host.now().as_micros()) })
    }

    /// The places of the buses that are meant: the named one or all, of these the ones that have the named motor.
    fn places(&self, bus: Option<&str>, motor: Option<MotorId>) -> Done<Vec<usize>> {
        let names: Vec<&str> = self.hosts.iter().map(|host| host.name()).collect();
        let is_meant = |name: &str| bus.is_none_or(|bus| bus == name);
        if let Some(bus) = bus
            && !names.contains(&bus)
        {
            return Err(format!("there is no bus \"{bus}\": there are {}", names.join(", ")));
        }
        let has_motor = |host: &dyn Hosted| {
            motor.is_none_or(|motor| host.drives().iter().any(|drive| drive.motor() == motor))
        };
        let places: Vec<usize> = self
            .hosts
            .iter()
            .enumerate()
            .filter(|(_, host)| is_meant(host.name()) && has_motor(&***host))
            .map(|(place, _)| place)
            .collect();
        match motor {
            Some(motor) if places.is_empty() => {
                let on = bus.map_or_else(|| names.join(" or "), str::to_owned);
                Err(format!("there is no motor {motor} on {on}"))
            }
            _ => Ok(places),
        }
    }

    /// Changes the motors that are meant, or none if the change is refused for one of them.
    fn change(
        &mut self,
        bus: Option<String>,
        motor: Option<MotorId>,
        work: impl Fn(&mut SimulatedMotor) -> Done<()>,
    ) -> Done<()> {
        let places = self.places(bus.as_deref(), motor)?;
        self.change_at(places, motor, work)
    }

    fn change_at(
        &self,
        places: Vec<usize>,
        motor: Option<MotorId>,
        work: impl Fn(&mut SimulatedMotor) -> Done<()>,
    ) -> Done<()> {
        let drives: Vec<_> = places
            .into_iter()
            .flat_map(|place| self.hosts[place].drives())
            .filter(|drive| motor.is_none_or(|motor| drive.motor() == motor))
            .collect();
        for drive in &drives {
            drive.with(|drive| work(&mut drive.plant().clone()))?;
        }
        drives.into_iter().try_for_each(|drive| drive.with(|drive| work(drive.plant_mut())))
    }
}

//! What the tables of a robot's file mean, and what is wrong with them.

use std::collections::BTreeMap;
use std::ops::{Range, RangeInclusive};
use std::path::Path;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::VersionDate;
use myactuator_protocol_core::time::Duration;
use toml::Spanned;

use super::table::{BusTable, Ids, MechanicsTable, MotorTable, QuirkNames, RobotTable, Word};
use super::{MechanicsProcess, Robot, RobotBus};
use crate::BusKind;
use crate::LINE_RATES;
use crate::sim::model_file::{line_of, named_model, of_toml};
use crate::sim::plant::MotorParameters;
use crate::sim::{Fleet, MotorSetup};

/// A line, from 1, and what is wrong there.
type Wrong = (usize, String);

/// The fastest rate is that of classic CAN, the slowest the slowest of adapters.
const CAN_RATES: RangeInclusive<u32> = 10_000..=1_000_000;
/// From the plant's step to a period with which no loop of a drive is stable.
const MECHANICS_PERIODS_US: RangeInclusive<u64> = 100..=100_000;
/// The longest that a drive may take to answer, ms.
const LONGEST_RESPONSE_MS: f64 = 1_000.0;
/// The longest name of a bus, which becomes the name of a file.
const LONGEST_NAME: usize = 64;

pub(super) fn robot(text: &str, folder: &Path) -> Result<Robot, Wrong> {
    let file = File { text, folder };
    let robot: RobotTable = toml::from_str(text).map_err(|error| wrong_table(text, &error))?;
    if robot.bus.is_empty() {
        return Err((1, "expected at least one [[bus]], found none".into()));
    }
    let mut names = BTreeMap::new();
    let mut buses = Vec::new();
    for bus in robot.bus {
        let (at, bus) = (bus.span(), bus.into_inner());
        let line = file.line(bus.name.span().start);
        if let Some(first) = names.insert(bus.name.get_ref().clone(), line) {
            let name = bus.name.get_ref();
            return Err((line, format!("the bus in line {first} is called \"{name}\", too")));
        }
        buses.push(file.bus(bus, at)?);
    }
    Ok(Robot { buses }.seed(robot.seed.unwrap_or(1)))
}

/// What is wrong with the tables of a file. Single brackets where double ones are needed have a message of their own.
fn wrong_table(text: &str, error: &toml::de::Error) -> Wrong {
    let (line, what) = of_toml(text, error);
    let found =
        text.lines().nth(line - 1).unwrap_or_default().split('#').next().unwrap_or_default();
    match found.trim() {
        header @ ("[bus]" | "[bus.motor]") => {
            (line, format!("expected [{header}], for there may be several, found {header}"))
        }
        _ => (line, what),
    }
}

struct File<'a> {
    text: &'a str,
    folder: &'a Path,
}

impl File<'_> {
    fn line(&self, at: usize) -> usize {
        line_of(self.text, at)
    }

    fn wrong(&self, at: &Range<usize>, what: impl Into<String>) -> Wrong {
        (self.line(at.start), what.into())
    }

    fn bus(&self, bus: BusTable, at: Range<usize>) -> Result<RobotBus, Wrong> {
        let Word(kind) = bus.kind;
        let name = self.name(&bus.name)?;
        let bit_rate = self.bit_rate(kind, &bus.bit_rate)?;
        if let (BusKind::Can, Some(adapter)) = (kind, &bus.adapter) {
            return Err(self.wrong(&adapter.span(), "adapter is for buses of the kind rs485"));
        }
        if let (BusKind::Rs485, Some(interface)) = (kind, &bus.interface) {
            return Err(self.wrong(&interface.span(), "interface is for buses of the kind can"));
        }
        let defaults = self.defaults(bus.defaults)?;
        if bus.motor.is_empty() {
            return Err(self.wrong(&at, format!("the bus \"{name}\" has no [[bus.motor]]")));
        }
        let mut lines = BTreeMap::new();
        let mut motors = Vec::new();
        for motor in &bus.motor {
            for setup in self.motors(motor, &defaults)? {
                let line = self.line(motor.span().start);
                let first = lines.insert(setup.id, line).filter(|_| !bus.shared_ids);
                if let Some(first) = first {
                    let id = setup.id;
                    return Err((
                        line,
                        format!(
                            "motor {id} of the bus \"{name}\" is in line {first} already: take another id, or \
                             say shared_ids = true in its [[bus]] for motors as from the factory"
                        ),
                    ));
                }
                motors.push(setup);
            }
        }
        for fault in &bus.faults {
            let Word(planned) = fault.get_ref();
            if let Some(motor) = planned.motor.filter(|motor| !lines.contains_key(motor)) {
                let what = format!("the fault is for motor {motor}, which is not on this bus");
                return Err(self.wrong(&fault.span(), what));
            }
        }
        let faults = bus.faults.iter().map(|fault| fault.get_ref().0);
        let mut fleet = Fleet::of(motors).name(name).faults(faults);
        if let Some(supply) = bus.supply {
            let checked = supply.get_ref().check();
            checked.map_err(|error| self.wrong(&supply.span(), error.to_string()))?;
            fleet = fleet.supply(supply.into_inner());
        }
        Ok(RobotBus {
            fleet,
            kind,
            bit_rate,
            adapter: bus.adapter.map(Spanned::into_inner).unwrap_or_default(),
            bursts: Duration::from_millis(bus.bursts_ms.unwrap_or(0).into()),
            mechanics: bus.mechanics.map(|it| self.mechanics(it)).transpose()?,
            interface: bus.interface.map(Spanned::into_inner),
        })
    }

    /// Reads a name that a file can have.
    fn name(&self, name: &Spanned<String>) -> Result<String, Wrong> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let text = name.get_ref();
        if (1..=LONGEST_NAME).contains(&text.len()) && text.chars().all(is_plain) {
            return Ok(text.clone());
        }
        let expected = format!("expected 1 to {LONGEST_NAME} letters, digits, \"-\" or \"_\"");
        Err(self.wrong(&name.span(), format!("{expected}, found \"{text}\"")))
    }

    fn mechanics(&self, table: MechanicsTable) -> Result<MechanicsProcess, Wrong> {
        let (socket, given_us) = (self.folder.join(table.socket), *table.period_us.get_ref());
        if MECHANICS_PERIODS_US.contains(&given_us) {
            return Ok(MechanicsProcess { socket, period: Duration::from_micros(given_us) });
        }
        let (min, max) = MECHANICS_PERIODS_US.into_inner();
        let what = format!("expected a period of {min} to {max} us, found {given_us}");
        Err(self.wrong(&table.period_us.span(), what))
    }

    fn bit_rate(&self, kind: BusKind, rate: &Spanned<u32>) -> Result<u32, Wrong> {
        let allowed = match kind {
            BusKind::Can => CAN_RATES,
            BusKind::Rs485 => LINE_RATES,
        };
        let given = *rate.get_ref();
        if allowed.contains(&given) {
            return Ok(given);
        }
        let (min, max) = allowed.into_inner();
        let what = format!("expected {min} to {max} bit/s, found {given}");
        Err(self.wrong(&rate.span(), what))
    }

    fn defaults(&self, defaults: Option<Spanned<MotorTable>>) -> Result<MotorTable, Wrong> {
        let Some(defaults) = defaults else { return Ok(MotorTable::default()) };
        if defaults.get_ref().id.is_some() || defaults.get_ref().ids.is_some() {
            let what = "[bus.defaults] has no id: each [[bus.motor]] has its own";
            return Err(self.wrong(&defaults.span(), what));
        }
        Ok(defaults.into_inner())
    }

    /// The motors of a table, which differ only in their ids.
    fn motors(
        &self,
        table: &Spanned<MotorTable>,
        defaults: &MotorTable,
    ) -> Result<Vec<MotorSetup>, Wrong> {
        let (at, motor) = (table.span(), table.get_ref());
        let ids: Vec<MotorId> = match (motor.id, &motor.ids) {
            (Some(id), None) => vec![id],
            (None, Some(Ids(ids))) => ids.clone(),
            (None, None) => return Err(self.wrong(&at, "expected id or ids, found neither")),
            (Some(_), Some(_)) => {
                return Err(self.wrong(&at, "expected either id or ids, found both"));
            }
        };
        let usual = MotorSetup::new(MotorId::MIN);
        let model = motor.model.as_ref().or(defaults.model.as_ref());
        let response = motor.response_ms.as_ref().or(defaults.response_ms.as_ref());
        let QuirkNames(quirks) =
            motor.quirks.or(defaults.quirks).unwrap_or(QuirkNames(usual.quirks));
        let setup = MotorSetup {
            model: model.map(|model| self.model(model)).transpose()?,
            firmware: motor.firmware.or(defaults.firmware),
            motion_ranges: motor.motion.or(defaults.motion),
            version_date: motor.version_date.or(defaults.version_date).map(VersionDate::from_raw),
            quirks,
            response: response.map_or(Ok(usual.response), |response| self.response(response))?,
            has_brake: motor.brake.or(defaults.brake).unwrap_or(usual.has_brake),
            load: motor.load.or(defaults.load).unwrap_or(usual.load),
            start_angle_deg: motor
                .start_angle_deg
                .or(defaults.start_angle_deg)
                .unwrap_or(usual.start_angle_deg),
            ..usual
        };
        // What is impossible is reported with its line, not when the motors are put on a bus.
        let made = Fleet::of([setup.clone()]).on_can(*CAN_RATES.end());
        made.map_err(|error| self.wrong(&at, error.to_string()))?;
        Ok(ids.into_iter().map(|id| MotorSetup { id, ..setup.clone() }).collect())
    }

    fn model(&self, name: &Spanned<String>) -> Result<MotorParameters, Wrong> {
        named_model(name.get_ref(), self.folder).map_err(|what| self.wrong(&name.span(), what))
    }

    fn response(&self, given_ms: &Spanned<[f64; 2]>) -> Result<(Duration, Duration), Wrong> {
        let &[min_ms, max_ms] = given_ms.get_ref();
        if !(0.0..=LONGEST_RESPONSE_MS).contains(&max_ms) || !(0.0..=max_ms).contains(&min_ms) {
            let expected = format!(
                "expected the shortest and the longest time of an answer, 0 to {LONGEST_RESPONSE_MS} ms"
            );
            return Err(
                self.wrong(&given_ms.span(), format!("{expected}, found {min_ms} and {max_ms}"))
            );
        }
        let time = |ms: f64| Duration::from_micros((ms * 1e3).round() as u64);
        Ok((time(min_ms), time(max_ms)))
    }
}

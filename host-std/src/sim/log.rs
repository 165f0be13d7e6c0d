//! A log of what drives did, and of what they did not do and why.

mod event;
mod wire;

use std::fmt;
use std::mem::discriminant;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::drive::Event;
use myactuator_protocol_core::packet::Channel;
use myactuator_protocol_core::time::{Duration, Instant};
use serde::Serialize;

use super::bus::Medium;
use super::{BusFleet, DriveHandle};
use wire::{Counted, WireLog};

pub use event::{FrameFault, LogEvent};

/// Equal records are reported once, and then counted for so long.
const FOLD: Duration = Duration::from_secs(1);
/// So many different things are counted of each drive at once.
const MOST_COUNTED: usize = 16;

/// Something that happened in a drive (ignored, refused, limited, faulted, restarted), or to it on its wire (cut off,
/// a frame lost by chance).
///
/// As text it is a line for people, with the reason and what to do about it; as JSON it is an object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogRecord {
    /// When, in simulated time; in JSON in microseconds.
    #[serde(rename = "at_us")]
    pub at: Instant,
    /// [The bus's name](BusFleet::name).
    pub bus: String,
    /// The id that the drive started with.
    pub motor: MotorId,
    /// How often it happened. Repetitions are reported at most once a second, with their number.
    pub count: u32,
    /// So many events before this one were lost because they were not polled in time.
    pub lost: u32,
    /// What happened; the last event if there are several.
    pub event: LogEvent,
}

impl fmt::Display for LogRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { at, bus, motor, count, lost, event } = self;
        let (seconds, micros) = (at.as_micros() / 1_000_000, at.as_micros() % 1_000_000);
        write!(f, "{seconds}.{micros:06} s  {bus} motor {motor} {event}")?;
        if *count > 1 {
            write!(f, " ({count} times)")?;
        }
        if *lost > 0 {
            write!(f, " ({lost} events before it were lost)")?;
        }
        Ok(())
    }
}

/// Collects what happens in the drives of a bus, and to them on their wires, from when it is made.
///
/// It takes the events from the drives: [`poll_event`] does not return them again. A drive keeps
/// [16 events](myactuator_protocol_core::drive::QUEUE_LENGTH), so poll often.
///
/// ```
/// use myactuator_host_std::protocol::MotorId;
/// use myactuator_host_std::protocol::command::Torque;
/// use myactuator_host_std::protocol::io::Runner;
/// use myactuator_host_std::protocol::units::Current;
/// use myactuator_host_std::sim::{DriveLog, Fleet};
///
/// let fleet = Fleet::new(1).brakes(true).on_can(1_000_000)?;
/// let mut log = DriveLog::of(&fleet);
/// let current = Current::from_amperes(1.0)?;
/// fleet.master::<1>().set_point_and_wait(MotorId::new(1)?, Torque { current })?;
/// let told = log.poll(fleet.world.now());
/// assert!(told[0].to_string().contains("can motor 1 answers torque (0xA1) and does not run it: its brake is locked"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// [`poll_event`]: myactuator_protocol_core::drive::Drive::poll_event
#[derive(Debug)]
pub struct DriveLog {
    bus: String,
    wire: WireLog,
    drives: Vec<Watched>,
}

#[derive(Debug)]
struct Watched {
    drive: DriveHandle,
    /// How many events it has lost, and how many of these are to be reported.
    lost: u32,
    untold: u32,
    recent: Vec<Recent>,
}

/// Something that was reported, and the number of equal events since.
#[derive(Debug)]
struct Recent {
    told: Instant,
    last: (Instant, LogEvent),
    count: u32,
}

impl DriveLog {
    /// A log of these drives, without what has happened before.
    pub fn of<B: Medium>(fleet: &BusFleet<B>) -> Self {
        let watch = |drive: &DriveHandle| {
            let (_, lost) = drive.take_events();
            Watched { drive: drive.clone(), lost, untold: 0, recent: Vec::new() }
        };
        let drives = fleet.drives.iter().map(watch).collect();
        Self { bus: fleet.name.clone(), wire: WireLog::of(fleet), drives }
    }

    /// What is to be reported at `now`, by drive and then by time.
    pub fn poll(&mut self, now: Instant) -> Vec<LogRecord> {
        let mut records = Vec::new();
        for (place, watched) in self.drives.iter_mut().enumerate() {
            let motor = watched.drive.motor();
            let mut report = |at, event, count, lost| {
                records.push(LogRecord { at, bus: self.bus.clone(), motor, count, lost, event });
            };
            let (events, lost) = watched.drive.take_events();
            let newly_lost = lost.wrapping_sub(std::mem::replace(&mut watched.lost, lost));
            watched.untold = watched.untold.saturating_add(newly_lost);
            let own = events.into_iter();
            let own = own.map(|(at, event)| Counted { at, event: event.into(), count: 1 });
            let mut each: Vec<Counted> = own.chain(self.wire.take(place)).collect();
            each.sort_by_key(|counted| counted.at);
            for Counted { at, event, count } in each {
                watched.report_counted(at, &mut report);
                let alike = |recent: &&mut Recent| is_alike(&recent.last.1, &event);
                if let Some(recent) = watched.recent.iter_mut().find(alike) {
                    recent.last = (at, event);
                    recent.count = recent.count.saturating_add(count);
                } else {
                    report(at, event, count, std::mem::take(&mut watched.untold));
                    if watched.recent.len() < MOST_COUNTED {
                        watched.recent.push(Recent { told: at, last: (at, event), count: 0 });
                    }
                }
            }
            watched.report_counted(now, &mut report);
        }
        records
    }
}

impl Watched {
    /// Reports how often things came again, when their second is over. Things that did not are forgotten.
    fn report_counted(
        &mut self,
        now: Instant,
        report: &mut impl FnMut(Instant, LogEvent, u32, u32),
    ) {
        self.recent.retain_mut(|recent| {
            if now - recent.told < FOLD {
                return true;
            }
            let count = std::mem::take(&mut recent.count);
            if count > 0 {
                let (at, event) = recent.last;
                report(at, event, count, std::mem::take(&mut self.untold));
                recent.told = now;
            }
            count > 0
        });
    }
}

/// Whether two events are the same for a reader: the values of a command make no difference.
fn is_alike(a: &LogEvent, b: &LogEvent) -> bool {
    let (LogEvent::Drive(a), LogEvent::Drive(b)) = (a, b) else {
        // Of what lasts each counts.
        return a == b && !a.is_lasting();
    };
    match (a, b) {
        (
            Event::Ignored { packet, reason },
            Event::Ignored { packet: other, reason: other_reason },
        ) => {
            // A motion command begins with its position.
            let is_motion = matches!(packet.channel, Channel::Motion(_));
            packet.channel == other.channel
                && (is_motion || packet.data[0] == other.data[0])
                && discriminant(reason) == discriminant(other_reason)
        }
        (Event::TargetLimited { opcode, .. }, Event::TargetLimited { opcode: other, .. }) => {
            opcode == other
        }
        (a, b) => a == b,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Fleet;
    use crate::sim::bus::faults::{Direction, FaultPlan};
    use crate::sim::bus::trace;
    use crate::sim::plant::{EndStop, Load};
    use myactuator_protocol_core::command::{
        AbsolutePosition, ErrorFlags, ForcePosition, FunctionControl, RawMotion, ReadStatus1,
        Reset, Shutdown,
    };
    use myactuator_protocol_core::drive::{Limit, NotRunReason};
    use myactuator_protocol_core::io::Runner;
    use myactuator_protocol_core::units::{Angle, MaxSpeed, MaxTorque};
    use myactuator_protocol_core::wire::can::SimpleFrame;

    const MOTOR: MotorId = MotorId::MIN;

    #[test]
    fn command_refused_500_times_a_second_is_one_line_a_second() {
        let fleet = Fleet::new(1).brakes(true).name("arm").on_can(1_000_000).unwrap();
        let mut log = DriveLog::of(&fleet);
        let mut master = fleet.master::<1>();
        let mut logged = Vec::new();
        for tick in 0..1_250_u32 {
            let motion = RawMotion { position: tick as u16, ..RawMotion::decode(&[0; 8]) };
            master.set_point(MOTOR, motion).unwrap();
            let next = master.now() + Duration::from_millis(2);
            master.run_until(next, |_| {}).unwrap();
            logged.extend(log.poll(fleet.world.now()));
        }
        let counts: Vec<u32> = logged.iter().map(|record| record.count).collect();
        // At 0, 1 and 2 s; the rest of the third second is told when that is over.
        assert_eq!(counts.len(), 3, "{logged:?}");
        assert_eq!(counts[0], 1);
        assert!(counts[1..].iter().all(|count| (499..=501).contains(count)), "{counts:?}");
        fleet.world.run_for(Duration::from_secs(1));
        let rest: Vec<u32> = log.poll(fleet.world.now()).iter().map(|it| it.count).collect();
        assert_eq!(counts.iter().sum::<u32>() + rest[0], 1_250);
        fleet.world.run_for(Duration::from_secs(5));
        assert_eq!(log.poll(fleet.world.now()), []);
        let LogEvent::Drive(Event::NotRun { reason, .. }) = logged[0].event else {
            panic!("{}", logged[0])
        };
        assert_eq!(reason, NotRunReason::BrakeLocked);
        assert!(
            logged[1].to_string().contains("s  arm motor 1 answers motion and does not run it")
        );
        assert!(
            logged[1].to_string().ends_with(&format!("({} times)", counts[1])),
            "{}",
            logged[1]
        );
    }

    #[test]
    fn limits_are_logged_when_they_begin_and_when_they_end() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let wall = EndStop { at_deg: 0.0, stiffness_nm_per_rad: 200.0, restitution: 0.0 };
        let load = Load { upper_stop: Some(wall), ..Load::NONE };
        fleet.drives[0].with(|drive| drive.plant_mut().set_load(load)).unwrap();
        let mut log = DriveLog::of(&fleet);
        let mut master = fleet.master::<1>();
        let mut logged = || {
            fleet.world.run_for(Duration::from_millis(500));
            let records = log.poll(fleet.world.now());
            let own = |record: LogRecord| match record.event {
                LogEvent::Drive(event) => Some(event),
                _ => None,
            };
            records.into_iter().filter_map(own).collect::<Vec<_>>()
        };
        let max_speed = MaxSpeed::from_dps(100.0).unwrap();
        let angle = Angle::from_degrees(90.0).unwrap();
        let max_torque = MaxTorque::from_percent(20.0).unwrap();
        master.ask(MOTOR, ForcePosition { max_torque, max_speed, angle }).unwrap();
        assert_eq!(logged(), [Event::Limited(Limit::CommandTorque)]);
        master.ask(MOTOR, Shutdown).unwrap();
        assert_eq!(logged(), [Event::Unlimited(Limit::CommandTorque)]);

        master.ask(MOTOR, FunctionControl::MaxPositiveAngle(500)).unwrap();
        assert_eq!(logged(), []);
        master.ask(MOTOR, AbsolutePosition { max_speed, angle }).unwrap();
        let limited = logged();
        let [Event::TargetLimited { asked_deg: 90.0, limit_deg: 5.0, .. }] = limited[..] else {
            panic!("{limited:?}");
        };
        // What does not run has no target.
        fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::OVER_SPEED));
        logged();
        master.ask(MOTOR, AbsolutePosition { max_speed, angle }).unwrap();
        let not_run = logged();
        assert!(matches!(not_run[..], [Event::NotRun { .. }]), "{not_run:?}");
    }

    #[test]
    fn each_cut_and_mend_of_a_cable_is_logged_once() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let mut log = DriveLog::of(&fleet);
        let station = fleet.drives[1].station();
        for _ in 0..2 {
            fleet.world.cut(station);
            fleet.world.cut(station);
            fleet.world.run_for(Duration::from_millis(10));
            fleet.world.mend(station);
            fleet.world.mend(station);
        }
        fleet.world.mend(fleet.drives[0].station());
        let logged = log.poll(fleet.world.now());
        let expected = [
            "0.000000 s  can motor 2 is off the bus: its cable is cut",
            "0.010000 s  can motor 2 has its cable back",
            "0.010000 s  can motor 2 is off the bus: its cable is cut",
            "0.020000 s  can motor 2 has its cable back",
        ];
        assert_eq!(logged.iter().map(ToString::to_string).collect::<Vec<_>>(), expected);
        assert_eq!(serde_json::to_value(logged[0].event).unwrap(), "cable-cut");
        fleet.world.run_for(Duration::from_secs(2));
        assert_eq!(log.poll(fleet.world.now()), []);
        // One that was cut before there was a log.
        fleet.world.cut(station);
        let mut log = DriveLog::of(&fleet);
        fleet.world.cut(station);
        fleet.world.mend(station);
        let logged = log.poll(fleet.world.now());
        assert_eq!(logged.iter().map(|it| it.event).collect::<Vec<_>>(), [LogEvent::CableMended]);
    }

    #[test]
    fn random_faults_are_logged_with_their_motor_and_number() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let mut log = DriveLog::of(&fleet);
        let always = |plan: fn(&mut FaultPlan)| {
            let mut always = FaultPlan::NONE;
            plan(&mut always);
            Some(always)
        };
        let [first, second] = [0, 1].map(|place| fleet.drives[place].station());
        let (to, from) = (Direction::ToNodes, Direction::ToPorts);
        let mut master = fleet.master::<2>();
        let mut logged = |asked: u8| {
            let _ = master.ask(MotorId::new(asked).unwrap(), ReadStatus1);
            let logged = log.poll(fleet.world.now());
            logged.iter().map(|it| (it.motor.get(), it.event, it.count)).collect::<Vec<_>>()
        };
        assert_eq!(logged(1), []);
        // Asked three times, each lost: one line at once, and the number after a second.
        fleet.world.set_node_faults(first, to, always(|plan| plan.lose = 1.0));
        assert_eq!(logged(1), [(1, LogEvent::FrameToDrive(FrameFault::Lost), 3)]);
        fleet.world.set_node_faults(first, to, None);
        fleet.world.set_node_faults(second, from, always(|plan| plan.duplicate = 1.0));
        assert_eq!(logged(2), [(2, LogEvent::FrameFromDrive(FrameFault::Duplicated), 1)]);
        // Nobody but its sender hears that a frame was disturbed.
        fleet.world.set_node_faults(second, from, always(|plan| plan.corrupt = 1.0));
        let trace = fleet.world.log();
        let broken = logged(2);
        let [(2, LogEvent::FrameFromDrive(FrameFault::Broken), count)] = broken[..] else {
            panic!("{broken:?}");
        };
        let of_second = |record: &trace::Record<SimpleFrame>| {
            record.station == second && matches!(record.event, trace::Event::Broken { .. })
        };
        let each = trace.take().iter().filter(|record| of_second(record)).count();
        assert!(each > 10 && count as usize == each, "{count} of {each}");
        let json = serde_json::to_value(LogEvent::FrameToDrive(FrameFault::Lost)).unwrap();
        assert_eq!(json, serde_json::json!({ "frame-to-drive": "lost" }));
        let text = LogEvent::FrameToDrive(FrameFault::Lost).to_string();
        assert_eq!(text, "was to hear a frame that is lost, by a fault");
    }

    #[test]
    fn records_have_their_time_and_are_json() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut log = DriveLog::of(&fleet);
        let mut master = fleet.master::<1>();
        let asked = master.now();
        master.ask(MOTOR, Reset).unwrap();
        fleet.world.run_for(Duration::from_millis(1));
        let logged = log.poll(fleet.world.now());
        // A frame of 8 bytes takes 111 µs and up to 24 stuff bits.
        let after = logged[0].at - asked;
        assert!((111..=135).contains(&after.as_micros()), "{after}");
        let json = serde_json::to_value(&logged[0]).unwrap();
        let expected = serde_json::json!({
            "at_us": logged[0].at.as_micros(),
            "bus": "can",
            "motor": 1,
            "count": 1,
            "lost": 0,
            "event": "reset",
        });
        assert_eq!(json, expected);
    }

    #[test]
    fn number_of_lost_events_is_logged() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut log = DriveLog::of(&fleet);
        for _ in 0..20 {
            fleet.drives[0].with(|drive| {
                drive.raise_fault(ErrorFlags::OVER_SPEED);
                drive.clear_fault(ErrorFlags::OVER_SPEED);
            });
        }
        let logged = log.poll(fleet.world.now());
        // Of 40 events 16 are kept.
        assert_eq!(logged[0].lost, 24);
        assert!(
            logged[0].to_string().ends_with("(24 events before it were lost)"),
            "{}",
            logged[0]
        );
    }

    /// The events that are only counted take part in this, too.
    #[test]
    fn each_event_is_logged_or_counted_or_lost() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        let mut log = DriveLog::of(&fleet);
        let mut logged = Vec::new();
        for times in [1, 20, 20] {
            for _ in 0..times {
                fleet.drives[0].with(|drive| {
                    drive.raise_fault(ErrorFlags::OVER_SPEED);
                    drive.clear_fault(ErrorFlags::OVER_SPEED);
                });
            }
            logged.extend(log.poll(fleet.world.now()));
        }
        assert_eq!(logged.len(), 2);
        fleet.world.run_for(FOLD);
        logged.extend(log.poll(fleet.world.now()));
        let sum = |of: fn(&LogRecord) -> u32| logged.iter().map(of).sum::<u32>();
        // 2 * 16 are kept of 80 after the first two.
        assert_eq!((sum(|it| it.count), sum(|it| it.lost)), (34, 48), "{logged:?}");
    }
}

//! A fault in one word, as people type it.

use std::str::FromStr;

use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::command::ErrorFlags;
use myactuator_protocol_core::time::Duration;

use super::condition::Condition;
use crate::Unexpected;
use crate::sim::bus::faults::{Direction, FaultPlan};

/// What a time looks like.
const TIME: &str = "a time with its unit such as 500us, 2ms or 1.5s";
/// How likely a fault is by default.
const USUAL_CHANCE: f32 = 0.01;
/// The shortest pause: no frame is over sooner on a CAN bus at 1 Mbit/s, and drives that babble without a pause
/// take all of a computer's time.
const SHORTEST_BABBLE: Duration = Duration::from_micros(47);
/// The longest delay: late frames are kept, and on a busy bus these are many.
const LONGEST_DELAY: Duration = Duration::from_secs(10);
/// The pause between two frames of a babbling drive by default.
const USUAL_BABBLE: Duration = Duration::from_millis(10);

/// Something that goes wrong, where, and when: `KIND[=VALUE][@WHERE][?CONDITION][+TIME]`.
///
/// | kind | value, and its default | what happens |
/// |---|---|---|
/// | `lose` | chance, 0.01 | a frame does not arrive |
/// | `corrupt` | chance, 0.01 | a bit is disturbed: on CAN an error frame and a repetition, on RS485 a wrong bit |
/// | `undetected` | share, 0.01 | this share of the corrupted CAN frames passes the CRC with a wrong bit |
/// | `duplicate` | chance, 0.01 | a frame arrives twice |
/// | `delay` | chance, `0.1:2ms` or `0.1:1ms..5ms`, 0.01:1ms..5ms | a frame arrives late, by 10s at most |
/// | `reorder` | chance, 0.01 | a frame arrives after the next one |
/// | `babble` | pause, 47us at least, 10ms | a drive sends random frames |
/// | `slow` | time | everything that a drive sends comes so much later |
/// | `cut` | | a drive's wire is cut |
/// | `mend` | | ends `cut`, `slow` and `babble` |
/// | `reset` | | a drive's power is cycled |
/// | an error's name, such as `stall` | | a drive has this error |
/// | `clear` | | removes the causes of such errors |
///
/// - Later frames to the receiver of one that `delay` strikes wait for it, so the order stays.
/// - `@WHERE` is the id of a motor; without it the fault strikes all motors. A fault by chance may have a direction
///   instead or as well, `@to-drives`, `@from-drives` or `@2,from-drives`; without it the fault strikes both
///   directions.
/// - `?CONDITION` is a [`Condition`] on the named motor, as in `cut@1?angle>90`. The fault begins as soon as it is met,
///   but not before its time. Each drive with that id, on each bus that is meant, is struck once, when that drive meets
///   the condition.
/// - `+TIME` counts from when the drives were put on their bus ([`Fleet::faults`](super::Fleet::faults)), or from when
///   the fault is planned ([`BusFleet::plan`](super::BusFleet::plan)), by the bus's clock. Times are numbers with `us`,
///   `ms` or `s`.
///
/// ```
/// use myactuator_host_std::sim::PlannedFault;
///
/// let fault: PlannedFault = "lose=0.05@from-drives".parse()?;
/// assert_eq!(fault.motor, None);
/// let fault: PlannedFault = "stall@2+1.5s".parse()?;
/// assert_eq!(fault.after.as_millis(), 1_500);
/// # Ok::<(), myactuator_host_std::Unexpected>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedFault {
    /// What goes wrong.
    pub kind: FaultKind,
    /// The motor that it strikes; `None` for all.
    pub motor: Option<MotorId>,
    /// The direction of the frames that it strikes; `None` for both. Only for faults by chance.
    pub direction: Option<Direction>,
    /// When it begins, after the start. Faults that begin at the same time do so in the order in which they were
    /// planned.
    pub after: Duration,
    /// What the motor must reach before the fault begins, checked every millisecond from `after` on.
    pub condition: Option<Condition>,
}

/// The kinds of faults that can be planned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// Frames are struck by chance from now on.
    Chance(Chance),
    /// A drive sends random frames with this pause between them.
    Babble(Duration),
    /// What a drive sends comes so much later.
    Slow(Duration),
    /// A drive's wire is cut.
    Cut,
    /// A drive's wire is whole again, and the drive neither slow nor babbling.
    Mend,
    /// A drive's power is cycled.
    Reset,
    /// A drive has this error.
    Error(ErrorFlags),
    /// The causes of errors that were raised by faults are gone.
    Clear,
}

/// Faults that strike frames by chance, as in [`FaultPlan`]. Chances are from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Chance {
    /// [`FaultPlan::lose`].
    Lose(f32),
    /// [`FaultPlan::corrupt`].
    Corrupt(f32),
    /// [`FaultPlan::undetected`].
    Undetected(f32),
    /// [`FaultPlan::duplicate`].
    Duplicate(f32),
    /// [`FaultPlan::delay`].
    Delay {
        /// How likely it is.
        chance: f32,
        /// The shortest delay of a frame.
        min: Duration,
        /// The longest delay of a frame.
        max: Duration,
    },
    /// [`FaultPlan::reorder`].
    Reorder(f32),
}

impl Chance {
    /// Adds this to a plan.
    pub const fn add_to(self, plan: &mut FaultPlan) {
        match self {
            Self::Lose(chance) => plan.lose = chance,
            Self::Corrupt(chance) => plan.corrupt = chance,
            Self::Undetected(share) => plan.undetected = share,
            Self::Duplicate(chance) => plan.duplicate = chance,
            Self::Delay { chance, min, max } => {
                plan.delay = chance;
                plan.delay_min = min;
                plan.delay_max = max;
            }
            Self::Reorder(chance) => plan.reorder = chance,
        }
    }
}

impl FromStr for PlannedFault {
    type Err = Unexpected;

    fn from_str(whole: &str) -> Result<Self, Unexpected> {
        let (text, after) = match whole.rsplit_once('+') {
            Some((_, after)) if after.contains(['@', '?']) => {
                let expected = "its time at the end, as in cut@1?angle>90+5s";
                return Err(Unexpected::new(expected, whole));
            }
            Some((text, after)) => (text, parse_time(after)?),
            None => (whole, Duration::ZERO),
        };
        let (text, condition) = match text.split_once('?') {
            Some((text, condition)) => (text, Some(condition.parse()?)),
            None => (text, None),
        };
        let (text, place) = match text.split_once('@') {
            Some((text, place)) => (text, Some(place)),
            None => (text, None),
        };
        let (name, value) = match text.split_once('=') {
            Some((name, value)) => (name, Some(value)),
            None => (text, None),
        };
        let kind = kind(name, value)?;
        let (motor, direction) = place.map_or(Ok((None, None)), whom)?;
        if direction.is_some() && !matches!(kind, FaultKind::Chance(_)) {
            let expected =
                format!("{name} without to-drives and from-drives: it is no fault by chance");
            return Err(Unexpected::new(expected, place.unwrap_or_default()));
        }
        if condition.is_some() && motor.is_none() {
            let expected = "the motor that the condition is on, as in cut@1?angle>90";
            return Err(Unexpected::new(expected, whole));
        }
        Ok(Self { kind, motor, direction, after, condition })
    }
}

/// The names of all kinds.
fn kinds() -> String {
    let errors: Vec<&str> = ErrorFlags::NAMED.iter().filter_map(|error| error.name()).collect();
    format!(
        "lose, corrupt, undetected, duplicate, delay, reorder, babble, slow, cut, mend, reset, clear \
         or an error ({})",
        errors.join(", ")
    )
}

fn kind(name: &str, value: Option<&str>) -> Result<FaultKind, Unexpected> {
    let usual = || value.map_or(Ok(USUAL_CHANCE), chance);
    let kind = match name {
        "lose" => FaultKind::Chance(Chance::Lose(usual()?)),
        "corrupt" => FaultKind::Chance(Chance::Corrupt(usual()?)),
        "undetected" => FaultKind::Chance(Chance::Undetected(usual()?)),
        "duplicate" => FaultKind::Chance(Chance::Duplicate(usual()?)),
        "delay" => FaultKind::Chance(delay(value)?),
        "reorder" => FaultKind::Chance(Chance::Reorder(usual()?)),
        "babble" => FaultKind::Babble(value.map_or(Ok(USUAL_BABBLE), pause)?),
        "slow" => FaultKind::Slow(parse_time(value.unwrap_or_default())?),
        _ => {
            let kind = match name {
                "cut" => FaultKind::Cut,
                "mend" => FaultKind::Mend,
                "reset" => FaultKind::Reset,
                "clear" => FaultKind::Clear,
                _ => ErrorFlags::NAMED
                    .iter()
                    .find(|error| error.name() == Some(name))
                    .map(|&error| FaultKind::Error(error))
                    .ok_or_else(|| Unexpected::new(kinds(), name))?,
            };
            if let Some(found) = value {
                return Err(Unexpected::new(format!("{name} without a value"), found));
            }
            kind
        }
    };
    Ok(kind)
}

fn pause(text: &str) -> Result<Duration, Unexpected> {
    let pause = parse_time(text)?;
    let expected = "a pause of at least 47us: a frame takes as long";
    (pause >= SHORTEST_BABBLE).then_some(pause).ok_or_else(|| Unexpected::new(expected, text))
}

fn delay(value: Option<&str>) -> Result<Chance, Unexpected> {
    let FaultPlan { delay_min: min, delay_max: max, .. } = FaultPlan::NONE;
    let Some(value) = value else {
        return Ok(Chance::Delay { chance: USUAL_CHANCE, min, max });
    };
    let Some((likely, late)) = value.split_once(':') else {
        return Ok(Chance::Delay { chance: chance(value)?, min, max });
    };
    let (least, most) = late.split_once("..").unwrap_or((late, late));
    let (min, max) = (parse_time(least)?, parse_time(most)?);
    if min > max {
        return Err(Unexpected::new(TIME, late));
    }
    if max > LONGEST_DELAY {
        return Err(Unexpected::new("a delay of at most 10s", late));
    }
    Ok(Chance::Delay { chance: chance(likely)?, min, max })
}

fn chance(text: &str) -> Result<f32, Unexpected> {
    let chance = text.parse().ok().filter(|chance| (0.0..=1.0).contains(chance));
    chance.ok_or_else(|| Unexpected::new("a chance from 0 to 1 such as 0.01", text))
}

/// Parses a time with its unit, such as `500us`, `2ms` or `1.5s`, as in faults.
///
/// # Errors
/// [`Unexpected`], also for more than a year.
pub fn parse_time(text: &str) -> Result<Duration, Unexpected> {
    /// The longest that makes sense, in microseconds: a year.
    const LONGEST_US: f64 = 365.0 * 86_400.0 * 1e6;
    let wrong = || Unexpected::new(TIME, text);
    let unit_at = text.find(|c: char| c.is_ascii_alphabetic()).ok_or_else(wrong)?;
    let (number, unit) = text.split_at(unit_at);
    let micros = match unit {
        "us" => 1.0,
        "ms" => 1e3,
        "s" => 1e6,
        _ => return Err(wrong()),
    } * number.parse::<f64>().map_err(|_| wrong())?;
    if !(0.0..=LONGEST_US).contains(&micros) {
        return Err(wrong());
    }
    Ok(Duration::from_micros(micros.round() as u64))
}

fn whom(text: &str) -> Result<(Option<MotorId>, Option<Direction>), Unexpected> {
    let wrong = || {
        let last = MotorId::COUNT;
        let place = format!(
            "a motor from 1 to {last}, to-drives, from-drives, or both with a comma after \"@\""
        );
        Unexpected::new(place, text)
    };
    let (mut motor, mut direction) = (None, None);
    for word in text.split(',') {
        let was_told = match word {
            "to-drives" => direction.replace(Direction::ToNodes).is_some(),
            "from-drives" => direction.replace(Direction::ToPorts).is_some(),
            id => {
                let id = id.parse().ok().and_then(|id| MotorId::new(id).ok()).ok_or_else(wrong)?;
                motor.replace(id).is_some()
            }
        };
        if was_told {
            return Err(wrong());
        }
    }
    Ok((motor, direction))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> PlannedFault {
        text.parse().unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    fn refused(text: &str) -> String {
        text.parse::<PlannedFault>().unwrap_err().to_string()
    }

    #[test]
    fn every_kind_is_read() {
        let kinds = [
            ("lose=0.25", FaultKind::Chance(Chance::Lose(0.25))),
            ("corrupt", FaultKind::Chance(Chance::Corrupt(0.01))),
            ("undetected=1", FaultKind::Chance(Chance::Undetected(1.0))),
            ("duplicate=0", FaultKind::Chance(Chance::Duplicate(0.0))),
            ("reorder=0.5", FaultKind::Chance(Chance::Reorder(0.5))),
            ("babble", FaultKind::Babble(Duration::from_millis(10))),
            ("babble=250us", FaultKind::Babble(Duration::from_micros(250))),
            ("slow=2ms", FaultKind::Slow(Duration::from_millis(2))),
            ("cut", FaultKind::Cut),
            ("mend", FaultKind::Mend),
            ("reset", FaultKind::Reset),
            ("clear", FaultKind::Clear),
            ("stall", FaultKind::Error(ErrorFlags::STALL)),
            ("under-voltage", FaultKind::Error(ErrorFlags::UNDER_VOLTAGE)),
        ];
        for (text, kind) in kinds {
            let expected = PlannedFault {
                kind,
                motor: None,
                direction: None,
                after: Duration::ZERO,
                condition: None,
            };
            assert_eq!(fault(text), expected, "{text}");
        }
    }

    #[test]
    fn a_delay_has_a_time_or_two() {
        let late = |chance, min, max| {
            let (min, max) = (Duration::from_millis(min), Duration::from_millis(max));
            FaultKind::Chance(Chance::Delay { chance, min, max })
        };
        assert_eq!(fault("delay").kind, late(0.01, 1, 5));
        assert_eq!(fault("delay=0.1").kind, late(0.1, 1, 5));
        assert_eq!(fault("delay=0.1:2ms").kind, late(0.1, 2, 2));
        assert_eq!(fault("delay=0.1:2ms..30ms").kind, late(0.1, 2, 30));
        assert!(refused("delay=0.1:3ms..2ms").contains("\"3ms..2ms\""));
        assert_eq!(fault("delay=1:10s").kind, late(1.0, 10_000, 10_000));
        // A busy bus has 20,000 frames a second for each who hears them: all of them wait.
        assert!(refused("delay=1:1ms..11s").starts_with("expected a delay of at most 10s"));
    }

    #[test]
    fn motor_direction_condition_and_time_of_a_fault_are_read() {
        let motor = Some(MotorId::new(3).unwrap());
        let all = fault("lose=0.5@3,from-drives+1.5s");
        assert_eq!((all.motor, all.direction), (motor, Some(Direction::ToPorts)));
        assert_eq!(all.after, Duration::from_millis(1_500));
        let way = fault("lose@to-drives");
        assert_eq!((way.motor, way.direction), (None, Some(Direction::ToNodes)));
        assert_eq!(fault("cut@3+20ms").motor, motor);
        let then = fault("lose=1@3,to-drives?speed<-5.5+2s");
        assert_eq!((then.motor, then.direction), (motor, Some(Direction::ToNodes)));
        assert_eq!(then.after, Duration::from_secs(2));
        assert_eq!(then.condition, Some("speed<-5.5".parse().unwrap()));
    }

    #[test]
    fn wrong_faults_are_refused_with_what_is_expected() {
        assert!(refused("loose").starts_with("expected lose, corrupt"));
        assert!(refused("loose").contains("stall, under-voltage"));
        for wrong in ["lose=2", "lose=-0.1", "lose=NaN", "lose="] {
            assert!(refused(wrong).starts_with("expected a chance"), "{wrong}");
        }
        for wrong in ["slow", "slow=5", "slow=ms", "slow=-1s", "babble=inf", "cut+soon"] {
            assert!(refused(wrong).starts_with("expected a time"), "{wrong}");
        }
        for wrong in ["babble=0us", "babble=46us"] {
            assert!(refused(wrong).starts_with("expected a pause of at least 47us"), "{wrong}");
        }
        for wrong in ["cut@0", "cut@33", "cut@", "lose@1,2", "lose@sideways"] {
            assert!(refused(wrong).starts_with("expected a motor"), "{wrong}");
        }
        for wrong in ["cut?angle>5", "lose@to-drives?angle>5"] {
            assert!(refused(wrong).starts_with("expected the motor that the condition"), "{wrong}");
            assert!(refused(wrong).ends_with(&format!("found \"{wrong}\"")), "{wrong}");
        }
        for wrong in ["cut+5s@1", "cut@1+5s?angle>5"] {
            assert!(refused(wrong).starts_with("expected its time at the end, as in"), "{wrong}");
        }
        assert!(refused("cut@1?angle").starts_with("expected angle, speed"));
        assert_eq!(refused("cut=2"), "expected cut without a value, found \"2\"");
        assert!(refused("stall@to-drives").starts_with("expected stall without to-drives"));
    }

    #[test]
    fn chances_add_up_in_one_plan() {
        let mut plan = FaultPlan::NONE;
        let texts = "lose=0.1 corrupt=0.2 undetected=0.3 duplicate=0.4 delay=0.5:7ms reorder=0.6";
        for text in texts.split(' ') {
            let FaultKind::Chance(chance) = fault(text).kind else { panic!("{text}") };
            chance.add_to(&mut plan);
        }
        let late = Duration::from_millis(7);
        let expected = FaultPlan {
            lose: 0.1,
            corrupt: 0.2,
            undetected: 0.3,
            duplicate: 0.4,
            delay: 0.5,
            delay_min: late,
            delay_max: late,
            reorder: 0.6,
            ..FaultPlan::NONE
        };
        assert_eq!(plan, expected);
    }
}

//! The requests.

use myactuator_protocol_core::MotorId;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use crate::sim::model_file::in_plain_words;
use crate::sim::plant::{BrakeResistor, Load};

/// A request: an object with one key, its name, and what belongs to it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(in crate::serve) enum Request {
    Time {},
    State {
        bus: Option<String>,
        motor: Option<MotorId>,
    },
    Log {},
    Load {
        bus: Option<String>,
        motor: Option<MotorId>,
        load: Load,
    },
    Supply {
        bus: Option<String>,
        motor: Option<MotorId>,
        voltage_v: Option<f64>,
        resistance_ohm: Option<f64>,
        feedback_resistance_ohm: Option<f64>,
        capacitance_f: Option<f64>,
        #[serde(default, deserialize_with = "given")]
        brake_resistor: Option<Option<BrakeResistor>>,
    },
    Push {
        bus: Option<String>,
        motor: Option<MotorId>,
        torque_nm: f64,
    },
    Angle {
        bus: Option<String>,
        motor: Option<MotorId>,
        angle_deg: f64,
    },
    Ambient {
        bus: Option<String>,
        motor: Option<MotorId>,
        ambient_c: f64,
    },
    Temperature {
        bus: Option<String>,
        motor: Option<MotorId>,
        motor_c: Option<f64>,
        mosfet_c: Option<f64>,
    },
    Brake {
        bus: Option<String>,
        motor: Option<MotorId>,
        stuck: Option<Stuck>,
    },
    Cable {
        bus: Option<String>,
        motor: Option<MotorId>,
        cut: bool,
    },
    Fault {
        bus: Option<String>,
        fault: String,
    },
    Advance {
        us: Option<u64>,
        until_us: Option<u64>,
    },
}

/// `Some` for a key that is given, also as `null`; without the key the field is `None`.
fn given<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// How a brake sticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(in crate::serve) enum Stuck {
    Locked,
    Released,
}

impl Request {
    /// Reads a line.
    ///
    /// # Errors
    /// A sentence.
    pub(super) fn parse(line: &[u8]) -> Result<Self, String> {
        serde_json::from_slice(line).map_err(|error| {
            let wrong = found_instead(line).unwrap_or_else(|| in_plain_words_of_json(&error));
            format!(
                "expected a request, such as {{\"state\":{{\"motor\":1}}}}, on one line: {wrong}"
            )
        })
    }
}

/// Says what is wrong, without the names of this program's types.
fn in_plain_words_of_json(error: &serde_json::Error) -> String {
    let whole = error.to_string();
    let (what, place) = whole.rsplit_once(" at line ").unwrap_or((&whole, ""));
    let plain =
        in_plain_words(what).map(|plain| plain.replace("expected a table", "expected an object"));
    plain.map_or(whole.clone(), |plain| format!("{plain} at line {place}"))
}

/// Says what was found in place of an object with one key whose value is an object, if that is what is wrong.
fn found_instead(line: &[u8]) -> Option<String> {
    let found: Value = serde_json::from_slice(line).ok()?;
    let Value::Object(keys) = &found else { return Some(format!("found {found}")) };
    let mut names = keys.iter();
    match (names.next(), names.next()) {
        (Some((_, Value::Object(_))), None) => None,
        (Some((name, value)), None) => Some(format!(
            "found {value} after \"{name}\", where an object with its quantities belongs, or {{}} for none"
        )),
        (None, _) => Some("found no name of one".to_owned()),
        (Some(_), Some(_)) => Some(format!("found {} at once", keys.len())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_a_request_are_explained() {
        let wrong = |line: &str| Request::parse(line.as_bytes()).unwrap_err();
        assert!(wrong("hello").contains("expected value"), "{}", wrong("hello"));
        assert!(wrong(r#"{"stat":{}}"#).contains("unknown variant `stat`, expected one of `time`"));
        assert!(wrong(r#"{"state":{"moter":1}}"#).contains("unknown field `moter`"));
        assert!(wrong(r#"{"state":{"motor":33}}"#).contains("motor id"));
        assert!(wrong(r#"{"push":{"motor":1}}"#).contains("missing field `torque_nm`"));
        assert!(wrong(r#"{"load":{"load":{"weight":1}}}"#).contains("unknown field `weight`"));
        assert!(wrong(r#"{"time":{}} {"time":{}}"#).contains("trailing"));
        for (line, plain) in [
            (
                r#"{"supply":{"voltage_v":"24"}}"#,
                "expected a number, found string \"24\" at line 1",
            ),
            (r#"{"load":{"load":null}}"#, "expected an object, found null"),
            (r#"{"load":{"load":5}}"#, "expected an object, found integer `5`"),
            (r#"{"state":{"motor":"1"}}"#, "expected a whole number from 0 to 255, found string"),
            (
                r#"{"advance":{"us":1.5}}"#,
                "expected a whole number that is not negative, found floating",
            ),
        ] {
            assert!(wrong(line).contains(plain), "{}", wrong(line));
        }
        for (line, sentence) in [
            (
                r#"{"time":null}"#,
                r#"found null after "time", where an object with its quantities belongs, or {} for none"#,
            ),
            (r#"{"angle":90}"#, r#"found 90 after "angle", where an object "#),
            (r#""time""#, r#"found "time""#),
            ("{}", "found no name of one"),
            (r#"{"time":{},"state":{}}"#, "found 2 at once"),
            ("[]", "found []"),
        ] {
            let message = wrong(line);
            assert!(message.starts_with("expected a request, such as "), "{message}");
            assert!(message.contains(&format!(" on one line: {sentence}")), "{line}: {message}");
        }
    }
}

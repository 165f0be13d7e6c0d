//! `myactuator sim-control`: looks at the drives of a running `sim`, and changes their surroundings.

mod table;

use std::io::{self, BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use myactuator_host_std::sim::{PlannedFault, parse_time};
use myactuator_protocol_core::MotorId;
use serde_json::{Map, Value, json};

use super::{Outcome, Unfinished, arguments as parse, print_line};

/// Look at the drives of a running `sim --control`, and change their surroundings
///
/// Exit status: 0 done, 1 not, 2 wrong usage.
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// The socket that `sim --control` was given
    #[arg(value_name = "PATH")]
    socket: PathBuf,
    /// Print answers as the simulation sends them, one JSON object a line
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

/// Which motors: all of all buses by default.
#[derive(Clone, Debug, Args)]
struct Whom {
    /// On this bus only, such as can or rs485
    #[arg(long, value_name = "NAME")]
    bus: Option<String>,
    /// This motor only
    #[arg(long, value_name = "ID", value_parser = parse::motor_id)]
    id: Option<MotorId>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Show the true state, whatever encoders and drives report
    State {
        #[command(flatten)]
        whom: Whom,
    },
    /// Put a load on the shaft in place of the last one
    Load {
        #[command(flatten)]
        whom: Whom,
        /// As JSON, such as {"arm":{"mass_kg":2,"length_m":0.4,"down_deg":0}}; {} for none
        #[arg(value_parser = object)]
        load: Value,
    },
    /// Push the shaft from outside, until another torque is given
    #[command(allow_negative_numbers = true)]
    Push {
        #[command(flatten)]
        whom: Whom,
        /// Torque, N·m
        #[arg(value_parser = parse::finite)]
        torque_nm: f64,
    },
    /// Put the shaft at an angle, at rest
    #[command(allow_negative_numbers = true)]
    Angle {
        #[command(flatten)]
        whom: Whom,
        /// Degrees, turns included
        #[arg(value_parser = parse::finite)]
        angle_deg: f64,
    },
    /// Change the supply; what is not given stays as it is
    #[command(group = clap::ArgGroup::new("what").multiple(true).required(true))]
    Supply {
        #[command(flatten)]
        whom: Whom,
        /// Voltage without load, V
        #[arg(long, group = "what", value_name = "V", value_parser = parse::finite, allow_negative_numbers = true)]
        voltage_v: Option<f64>,
        /// Internal resistance, ohm
        #[arg(long, group = "what", value_name = "OHM", value_parser = parse::finite, allow_negative_numbers = true)]
        resistance_ohm: Option<f64>,
        /// Resistance against current that flows back, ohm
        #[arg(long, group = "what", value_name = "OHM", value_parser = parse::finite, allow_negative_numbers = true)]
        feedback_resistance_ohm: Option<f64>,
        /// Capacitance at the drive's input, F
        #[arg(long, group = "what", value_name = "F", value_parser = parse::finite, allow_negative_numbers = true)]
        capacitance_f: Option<f64>,
        /// Resistor that burns what is fed back: the voltage above which it is on, the one below which it is off, V, and
        /// its resistance, ohm, as in 52,50,2; or none
        #[arg(long, group = "what", value_name = "ON,OFF,OHM", value_parser = brake_resistor)]
        brake_resistor: Option<Value>,
    },
    /// Set the temperature of the air, °C
    #[command(allow_negative_numbers = true)]
    Ambient {
        #[command(flatten)]
        whom: Whom,
        /// Degrees Celsius
        #[arg(value_parser = parse::finite)]
        ambient_c: f64,
    },
    /// Hold temperatures, °C; one that is not given is simulated
    #[command(allow_negative_numbers = true)]
    Temperature {
        #[command(flatten)]
        whom: Whom,
        /// Of the winding, °C
        #[arg(long, value_name = "C", value_parser = parse::finite)]
        motor_c: Option<f64>,
        /// Of the output stage, °C
        #[arg(long, value_name = "C", value_parser = parse::finite)]
        mosfet_c: Option<f64>,
    },
    /// Make the brake stick, or work again
    Brake {
        #[command(flatten)]
        whom: Whom,
        /// What it does
        #[arg(value_enum)]
        state: Brake,
    },
    /// Cut a motor's cable, or mend it
    Cable {
        #[command(flatten)]
        whom: Whom,
        /// How it is from now on
        #[arg(value_enum)]
        state: Cable,
    },
    /// Make something go wrong, in the words of `sim --fault`; +TIME counts from now
    Fault {
        /// On this bus only
        #[arg(long, value_name = "NAME")]
        bus: Option<String>,
        /// Such as stall@2, cut@1+2s or mend
        #[arg(value_parser = fault)]
        fault: String,
    },
    /// Print what drives ignore, refuse and suffer from now on, until Ctrl-C
    Log,
    /// With sim --lock-step: advance time by this much, and wait until that is over
    Advance {
        /// Such as 500us, 20ms or 1.5s
        #[arg(value_parser = time_us)]
        time: u64,
    },
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Brake {
    /// Sticks closed, whatever its drive does
    Locked,
    /// Sticks open, whatever its drive does
    Released,
    /// Does what its drive wants
    Works,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Cable {
    /// The motor neither hears nor answers
    Cut,
    /// The motor hears and answers again
    #[value(alias = "mend")]
    Whole,
}

fn object(text: &str) -> Result<Value, String> {
    let value: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    if value.is_object() { Ok(value) } else { Err("expected a JSON object".into()) }
}

/// `null` means none.
fn brake_resistor(text: &str) -> Result<Value, String> {
    if text == "none" {
        return Ok(Value::Null);
    }
    let figures: Result<Vec<f64>, _> = text.split(',').map(parse::finite).collect();
    match figures.as_deref() {
        Ok(&[on_above_v, off_below_v, resistance_ohm]) => Ok(json!({
            "on_above_v": on_above_v,
            "off_below_v": off_below_v,
            "resistance_ohm": resistance_ohm,
        })),
        _ => Err(format!(
            "expected three numbers such as 52,50,2 (above which voltage it goes on, below which off, V, and its \
             resistance, ohm), or none, found \"{text}\""
        )),
    }
}

/// Parsed here, so that a mistake is reported as for `sim --fault`.
fn fault(text: &str) -> Result<String, String> {
    text.parse::<PlannedFault>().map(|_| text.to_owned()).map_err(|error| error.to_string())
}

fn time_us(text: &str) -> Result<u64, String> {
    parse_time(text).map(|time| time.as_micros()).map_err(|error| error.to_string())
}

impl Whom {
    /// A request of this name to these motors, with its other values.
    fn request(&self, name: &str, takes: Value) -> Value {
        let mut all = match takes {
            Value::Object(takes) => takes,
            _ => Map::new(),
        };
        all.extend(self.bus.as_ref().map(|bus| ("bus".to_owned(), json!(bus))));
        all.extend(self.id.map(|id| ("motor".to_owned(), json!(id))));
        // What is not given is left out.
        all.retain(|_, value| !value.is_null());
        json!({ name: all })
    }
}

impl Command {
    fn request(&self) -> Value {
        match self {
            Self::State { whom } => whom.request("state", Value::Null),
            Self::Load { whom, load } => whom.request("load", json!({ "load": load })),
            Self::Push { whom, torque_nm } => {
                whom.request("push", json!({ "torque_nm": torque_nm }))
            }
            Self::Angle { whom, angle_deg } => {
                whom.request("angle", json!({ "angle_deg": angle_deg }))
            }
            Self::Supply {
                whom,
                voltage_v,
                resistance_ohm,
                feedback_resistance_ohm,
                capacitance_f,
                brake_resistor,
            } => {
                let takes = json!({
                    "voltage_v": voltage_v,
                    "resistance_ohm": resistance_ohm,
                    "feedback_resistance_ohm": feedback_resistance_ohm,
                    "capacitance_f": capacitance_f,
                });
                let mut request = whom.request("supply", takes);
                // Null removes it; to leave it out changes nothing.
                if let Some(brake_resistor) = brake_resistor {
                    request["supply"]["brake_resistor"] = brake_resistor.clone();
                }
                request
            }
            Self::Ambient { whom, ambient_c } => {
                whom.request("ambient", json!({ "ambient_c": ambient_c }))
            }
            Self::Temperature { whom, motor_c, mosfet_c } => {
                whom.request("temperature", json!({ "motor_c": motor_c, "mosfet_c": mosfet_c }))
            }
            Self::Cable { whom, state } => {
                whom.request("cable", json!({ "cut": *state == Cable::Cut }))
            }
            Self::Brake { whom, state } => {
                let stuck = match state {
                    Brake::Locked => json!("locked"),
                    Brake::Released => json!("released"),
                    Brake::Works => Value::Null,
                };
                whom.request("brake", json!({ "stuck": stuck }))
            }
            Self::Fault { bus, fault } => {
                let whom = Whom { bus: bus.clone(), id: None };
                whom.request("fault", json!({ "fault": fault }))
            }
            Self::Log => json!({ "log": {} }),
            Self::Advance { time } => json!({ "advance": { "us": time } }),
        }
    }
}

/// Sends the request and prints the answer. The log goes on until the simulation ends.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    let path = arguments.socket.display();
    let broken = |error: io::Error| {
        Unfinished::Failed(format!(
            "the simulation at {path} does not answer: {error}; start one with sim --control {path}"
        ))
    };
    let mut stream = UnixStream::connect(&arguments.socket).map_err(broken)?;
    stream.write_all(format!("{}\n", arguments.command.request()).as_bytes()).map_err(broken)?;
    let mut lines = BufReader::new(stream).lines();
    let Some(answer) = lines.next() else {
        return Err(broken(io::ErrorKind::UnexpectedEof.into()));
    };
    let answer: Value = serde_json::from_str(&answer.map_err(broken)?).map_err(|error| {
        Unfinished::Failed(format!("{path} is not the socket of a simulation: {error}"))
    })?;
    if let Some(sentence) = answer["error"].as_str() {
        return Err(Unfinished::Failed(sentence.to_owned()));
    }
    if arguments.json {
        print_line(&answer.to_string())?;
    } else {
        for line in table::lines(&answer["ok"]) {
            print_line(&line)?;
        }
    }
    if !matches!(arguments.command, Command::Log) {
        return Ok(());
    }
    for line in lines {
        let line = line.map_err(broken)?;
        let record: Value = serde_json::from_str(&line).unwrap_or_default();
        match record["log"]["text"].as_str() {
            Some(text) if !arguments.json => print_line(text)?,
            _ => print_line(&line)?,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn commands_are_requests() {
        let told = |words: &str| {
            let words = ["sim-control", "here"].into_iter().chain(words.split(' '));
            Cli::try_parse_from(words).unwrap().arguments.command.request()
        };
        for (words, request) in [
            ("state", r#"{"state":{}}"#),
            ("state --bus can --id 3", r#"{"state":{"bus":"can","motor":3}}"#),
            ("load --id 1 {}", r#"{"load":{"motor":1,"load":{}}}"#),
            ("push --id 2 -1.5", r#"{"push":{"motor":2,"torque_nm":-1.5}}"#),
            ("angle 90", r#"{"angle":{"angle_deg":90.0}}"#),
            ("supply --voltage-v 24", r#"{"supply":{"voltage_v":24.0}}"#),
            ("supply --capacitance-f 0.01", r#"{"supply":{"capacitance_f":0.01}}"#),
            (
                "supply --bus arm --brake-resistor 52,50,2",
                r#"{"supply":{"bus":"arm","brake_resistor":{"on_above_v":52.0,"off_below_v":50.0,"resistance_ohm":2.0}}}"#,
            ),
            ("supply --brake-resistor none", r#"{"supply":{"brake_resistor":null}}"#),
            ("temperature --id 2 --motor-c -5", r#"{"temperature":{"motor":2,"motor_c":-5.0}}"#),
            ("temperature", r#"{"temperature":{}}"#),
            ("cable --bus can cut", r#"{"cable":{"bus":"can","cut":true}}"#),
            ("cable --id 3 whole", r#"{"cable":{"motor":3,"cut":false}}"#),
            ("ambient -20", r#"{"ambient":{"ambient_c":-20.0}}"#),
            ("brake --id 1 locked", r#"{"brake":{"motor":1,"stuck":"locked"}}"#),
            ("brake works", r#"{"brake":{}}"#),
            ("fault cut@1+2s", r#"{"fault":{"fault":"cut@1+2s"}}"#),
            ("log", r#"{"log":{}}"#),
            ("advance 1.5ms", r#"{"advance":{"us":1500}}"#),
        ] {
            let request: Value = serde_json::from_str(request).unwrap();
            assert_eq!(told(words), request, "{words}");
        }
        let wrong = |words: &str| {
            let words = ["sim-control", "here"].into_iter().chain(words.split(' '));
            Cli::try_parse_from(words).unwrap_err().to_string()
        };
        assert!(wrong("fault loose").contains("expected lose, corrupt"));
        assert!(wrong("advance 5").contains("expected a time with its unit"));
        assert!(wrong("supply --id 1").contains("--voltage-v"), "nothing would change");
        for words in ["supply --voltage-v 48V", "supply --voltage-v nan", "push 5Nm", "ambient inf"]
        {
            assert!(wrong(words).contains("expected a number such as 1.5, found"), "{words}");
        }
        assert!(wrong("supply --brake-resistor 52,50").contains("expected three numbers such as"));
        assert!(wrong("load 5").contains("expected a JSON object"));
    }
}

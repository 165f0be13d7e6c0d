//! Turns options into what they mean, or into a sentence.

use std::fs;

use myactuator_host_std::sim::plant::MotorParameters;
use myactuator_protocol_core::drive::Quirks;
use serde_json::{Map, Value};

/// Behaviour beside the manual.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Quirk {
    /// The drives', by the name of its field in [`Quirks`].
    Drive(String),
    /// The RS485 adapter's echo.
    Echo,
    /// The RS485 adapter's echo, with noise.
    EchoNoise,
}

const ECHO: &str = "echo";
const ECHO_NOISE: &str = "echo-noise";

/// The drives' quirks as they are called in files.
fn fields() -> Vec<String> {
    match serde_json::to_value(Quirks::default()) {
        Ok(Value::Object(fields)) => fields.into_iter().map(|(name, _)| name).collect(),
        _ => Vec::new(),
    }
}

/// All quirks, as they are called on the command line.
pub(super) fn quirk_names() -> Vec<String> {
    let fields = fields().into_iter().map(|field| field.replace('_', "-"));
    fields.chain([ECHO.to_owned(), ECHO_NOISE.to_owned()]).collect()
}

pub(super) fn quirk(text: &str) -> Result<Quirk, String> {
    match text {
        ECHO => Ok(Quirk::Echo),
        ECHO_NOISE => Ok(Quirk::EchoNoise),
        _ if quirk_names().iter().any(|name| name == text) => {
            Ok(Quirk::Drive(text.replace('-', "_")))
        }
        _ => Err(format!("expected one of {}, found \"{text}\"", quirk_names().join(", "))),
    }
}

/// The drives' quirks among these.
pub(super) fn drives_quirks(quirks: &[Quirk]) -> serde_json::Result<Quirks> {
    let fields = quirks.iter().filter_map(|quirk| match quirk {
        Quirk::Drive(field) => Some((field.clone(), Value::Bool(true))),
        Quirk::Echo | Quirk::EchoNoise => None,
    });
    serde_json::from_value(Value::Object(fields.collect::<Map<_, _>>()))
}

/// The model of this name, or in this file.
pub(super) fn model(text: &str) -> Result<MotorParameters, String> {
    if !text.ends_with(".toml") {
        return MotorParameters::named(text).map_err(|error| error.to_string());
    }
    let file = fs::read_to_string(text)
        .map_err(|error| format!("the model's file \"{text}\" cannot be read: {error}"))?;
    MotorParameters::from_toml(&file)
        .map_err(|error| format!("{text}: {}", error.to_string().trim_end().replace('\n', " ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_quirk_of_the_drive_has_a_name() {
        for name in quirk_names() {
            let quirk = quirk(&name).unwrap();
            let quirks = drives_quirks(std::slice::from_ref(&quirk)).unwrap();
            let is_the_drives = !name.starts_with("echo");
            assert_eq!(quirks != Quirks::default(), is_the_drives, "{name}");
        }
        let both = [quirk("slow-boot").unwrap(), quirk("turns-lost").unwrap()];
        let expected = Quirks { slow_boot: true, turns_lost: true, ..Quirks::default() };
        assert_eq!(drives_quirks(&both).unwrap(), expected);
        assert!(quirk("slow_boot").unwrap_err().contains("slow-boot, slow-brake"));
    }
}

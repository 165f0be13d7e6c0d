//! Turns options into what they mean, or into a sentence.

use std::fs;

use myactuator_host_std::sim::plant::MotorParameters;
use myactuator_protocol_core::drive::Quirks;
use serde_json::{Map, Value};

/// The RS485 adapter's quirks: it hands back what is sent, without noise or with it.
pub(super) const ECHO: &str = "echo";
pub(super) const ECHO_NOISE: &str = "echo-noise";

/// All quirks: those of drives are the fields of [`Quirks`].
pub(super) fn quirk_names() -> Vec<String> {
    let fields = match serde_json::to_value(Quirks::default()) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    };
    let of_drives = fields.keys().map(|field| field.replace('_', "-"));
    of_drives.chain([ECHO.to_owned(), ECHO_NOISE.to_owned()]).collect()
}

pub(super) fn quirk(text: &str) -> Result<String, String> {
    let names = quirk_names();
    let known = names.iter().find(|name| *name == text).cloned();
    known.ok_or_else(|| format!("expected one of {}, found \"{text}\"", names.join(", ")))
}

/// The drives' quirks among these.
pub(super) fn drives_quirks(quirks: &[String]) -> serde_json::Result<Quirks> {
    let of_drives = quirks.iter().filter(|name| *name != ECHO && *name != ECHO_NOISE);
    let fields = of_drives.map(|name| (name.replace('-', "_"), Value::Bool(true)));
    serde_json::from_value(Value::Object(fields.collect()))
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

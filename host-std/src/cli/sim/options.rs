//! Turns options into what they mean, or into a sentence.

use myactuator_host_std::Unexpected;
use myactuator_host_std::sim::plant::MotorParameters;
use myactuator_host_std::sim::{self, Adapter};
use myactuator_protocol_core::drive::Quirks;

/// The RS485 adapter's quirks: it hands back what is sent, without noise or with it.
const ECHO: &str = "echo";
const ECHO_NOISE: &str = "echo-noise";

/// All quirks: the drives' and the adapter's.
pub(super) fn quirk_names() -> Vec<String> {
    let of_drives = sim::quirk_names().into_iter();
    of_drives.chain([ECHO.to_owned(), ECHO_NOISE.to_owned()]).collect()
}

pub(super) fn quirk(text: &str) -> Result<String, String> {
    let names = quirk_names();
    let known = names.iter().find(|name| *name == text).cloned();
    known.ok_or_else(|| format!("expected one of {}, found \"{text}\"", names.join(", ")))
}

/// The drives' quirks among these.
pub(super) fn drives_quirks(quirks: &[String]) -> Result<Quirks, Unexpected> {
    sim::quirks_named(quirks.iter().filter(|name| *name != ECHO && *name != ECHO_NOISE))
}

/// The adapter that they make.
pub(super) fn adapter(quirks: &[String]) -> Adapter {
    let has = |name: &str| quirks.iter().any(|quirk| quirk == name);
    if has(ECHO_NOISE) {
        Adapter::EchoNoise
    } else if has(ECHO) {
        Adapter::Echo
    } else {
        Adapter::Plain
    }
}

/// The model of this name, or in this file.
pub(super) fn model(text: &str) -> Result<MotorParameters, String> {
    sim::named_model(text, "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quirks_are_the_drives_or_the_adapters() {
        for name in quirk_names() {
            let quirk = quirk(&name).unwrap();
            let quirks = std::slice::from_ref(&quirk);
            let is_the_drives = !name.starts_with("echo");
            assert_eq!(drives_quirks(quirks).unwrap() != Quirks::default(), is_the_drives);
            assert_eq!(adapter(quirks) == Adapter::Plain, is_the_drives, "{name}");
        }
        assert!(quirk("slow_boot").unwrap_err().contains("slow-boot, slow-brake"));
        assert_eq!(adapter(&["echo".to_owned()]), Adapter::Echo);
        assert_eq!(adapter(&["echo".to_owned(), "echo-noise".to_owned()]), Adapter::EchoNoise);
    }
}

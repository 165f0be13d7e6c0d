//! Turns options into their values, or into a sentence about what is allowed.

use myactuator_host_std::Unexpected;
use myactuator_host_std::sim::plant::MotorParameters;
use myactuator_host_std::sim::{self, Adapter};
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::time::Duration;

/// The RS485 adapter's quirks: it echoes what is sent, without or with noise.
const ECHO: &str = "echo";
const ECHO_NOISE: &str = "echo-noise";
/// The quirk of all adapters, and how often those with FTDI's chips hand over what they receive.
const BURSTS: &str = "bursts";
const USUAL_BURSTS: Duration = Duration::from_millis(16);

const OF_ADAPTERS: [&str; 3] = [ECHO, ECHO_NOISE, BURSTS];

/// All quirks: the drives' and the adapter's.
pub(super) fn quirk_names() -> Vec<String> {
    let of_drives = sim::quirk_names().into_iter();
    of_drives.chain(OF_ADAPTERS.map(str::to_owned)).collect()
}

pub(super) fn quirk(text: &str) -> Result<String, String> {
    let names = quirk_names();
    let known = names.iter().find(|name| *name == text).cloned();
    known.ok_or_else(|| format!("expected one of {}, found \"{text}\"", names.join(", ")))
}

/// The drives' quirks among these.
pub(super) fn drives_quirks(quirks: &[String]) -> Result<Quirks, Unexpected> {
    sim::quirks_named(quirks.iter().filter(|name| !OF_ADAPTERS.contains(&name.as_str())))
}

/// The adapter with these quirks.
pub(super) fn adapter(quirks: &[String]) -> Adapter {
    if has(quirks, ECHO_NOISE) {
        Adapter::EchoNoise
    } else if has(quirks, ECHO) {
        Adapter::Echo
    } else {
        Adapter::Plain
    }
}

/// How often adapters hand over what they receive; zero for at once.
pub(super) fn bursts(quirks: &[String]) -> Duration {
    if has(quirks, BURSTS) { USUAL_BURSTS } else { Duration::ZERO }
}

fn has(quirks: &[String], name: &str) -> bool {
    quirks.iter().any(|quirk| quirk == name)
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
            let is_an_adapters =
                adapter(quirks) != Adapter::Plain || bursts(quirks).as_millis() == 16;
            assert_eq!(
                drives_quirks(quirks).unwrap() == Quirks::default(),
                is_an_adapters,
                "{name}"
            );
        }
        assert!(quirk("slow_boot").unwrap_err().contains("slow-boot, slow-brake"));
        assert_eq!(adapter(&["echo".to_owned()]), Adapter::Echo);
        assert_eq!(adapter(&["echo".to_owned(), "echo-noise".to_owned()]), Adapter::EchoNoise);
    }
}

//! The quirks of drives by name, as people write them on a command line and in files.

use myactuator_protocol_core::drive::Quirks;
use serde_json::{Map, Value};

use crate::Unexpected;

/// The names of all [`Quirks`]: those of the fields, with `-` for `_`, such as "slow-boot".
pub fn quirk_names() -> Vec<String> {
    let fields = match serde_json::to_value(Quirks::default()) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    };
    fields.keys().map(|field| field.replace('_', "-")).collect()
}

/// The quirks with these names.
///
/// ```
/// use myactuator_host_std::sim::quirks_named;
///
/// assert!(quirks_named(["slow-boot"])?.slow_boot);
/// assert!(quirks_named(["slow_boot"]).is_err());
/// # Ok::<(), myactuator_host_std::Unexpected>(())
/// ```
///
/// # Errors
/// [`Unexpected`], which lists all names.
pub fn quirks_named<N: AsRef<str>>(
    names: impl IntoIterator<Item = N>,
) -> Result<Quirks, Unexpected> {
    let known = quirk_names();
    let mut fields = Map::new();
    for name in names {
        let name = name.as_ref();
        if !known.iter().any(|known| known == name) {
            return Err(Unexpected::new(format!("one of {}", known.join(", ")), name));
        }
        fields.insert(name.replace('-', "_"), Value::Bool(true));
    }
    let unread = |_| Unexpected::new("quirks", "something else");
    serde_json::from_value(Value::Object(fields)).map_err(unread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_quirk_has_a_name() {
        let names = quirk_names();
        assert!(names.contains(&"slow-boot".to_owned()), "{names:?}");
        for name in &names {
            assert_ne!(quirks_named([name]).unwrap(), Quirks::default(), "{name}");
        }
        let expected = Quirks { slow_boot: true, turns_lost: true, ..Quirks::default() };
        assert_eq!(quirks_named(["slow-boot", "turns-lost"]).unwrap(), expected);
        assert_eq!(quirks_named::<&str>([]).unwrap(), Quirks::default());
        let told = quirks_named(["slow_boot"]).unwrap_err().to_string();
        assert!(told.contains("one of slow-boot, slow-brake"), "{told}");
        assert!(told.ends_with("found \"slow_boot\""), "{told}");
    }
}

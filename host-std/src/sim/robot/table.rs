//! The tables of a robot's file, as they are written.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::drive::Quirks;
use myactuator_protocol_core::{Firmware, MotorId};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use toml::Spanned;

use super::Adapter;
use crate::sim::plant::{Load, Supply};
use crate::sim::{PlannedFault, quirks_named};
use crate::{BusKind, Unexpected};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RobotTable {
    pub(super) seed: Option<u64>,
    #[serde(default)]
    pub(super) bus: Vec<Spanned<BusTable>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BusTable {
    pub(super) name: Spanned<String>,
    pub(super) kind: Word<BusKind>,
    pub(super) bit_rate: Spanned<u32>,
    pub(super) adapter: Option<Spanned<Adapter>>,
    pub(super) bursts_ms: Option<u16>,
    pub(super) mechanics: Option<MechanicsTable>,
    pub(super) supply: Option<Spanned<Supply>>,
    pub(super) interface: Option<Spanned<String>>,
    #[serde(default)]
    pub(super) faults: Vec<Spanned<Word<PlannedFault>>>,
    #[serde(default)]
    pub(super) shared_ids: bool,
    pub(super) defaults: Option<Spanned<MotorTable>>,
    #[serde(default)]
    pub(super) motor: Vec<Spanned<MotorTable>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MechanicsTable {
    pub(super) socket: PathBuf,
    pub(super) period_us: Spanned<u64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MotorTable {
    pub(super) id: Option<MotorId>,
    pub(super) ids: Option<Ids>,
    pub(super) model: Option<Spanned<String>>,
    pub(super) firmware: Option<Firmware>,
    pub(super) motion: Option<MotionRanges>,
    pub(super) version_date: Option<u32>,
    pub(super) quirks: Option<QuirkNames>,
    pub(super) response_ms: Option<Spanned<[f64; 2]>>,
    pub(super) brake: Option<bool>,
    pub(super) load: Option<Load>,
    pub(super) start_angle_deg: Option<f64>,
}

/// What is read from one word.
#[derive(Clone, Copy, Debug)]
pub(super) struct Word<T>(pub(super) T);

impl<'de, T: FromStr<Err = Unexpected>> Deserialize<'de> for Word<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map(Self).map_err(D::Error::custom)
    }
}

/// A list of names.
#[derive(Clone, Copy, Debug)]
pub(super) struct QuirkNames(pub(super) Quirks);

impl<'de> Deserialize<'de> for QuirkNames {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let names = Vec::<String>::deserialize(deserializer)?;
        if let Some(name) = names.iter().find(|name| matches!(name.as_str(), "echo" | "echo-noise"))
        {
            let what = format!("\"{name}\" is the line's: say adapter = \"{name}\" in its [[bus]]");
            return Err(D::Error::custom(what));
        }
        if names.iter().any(|name| name == "bursts") {
            let what = "\"bursts\" is the bus's: say bursts_ms = 16 in its [[bus]]";
            return Err(D::Error::custom(what));
        }
        quirks_named(names).map(Self).map_err(D::Error::custom)
    }
}

/// `"1-6"` or `[1, 2, 5]`.
#[derive(Clone, Debug)]
pub(super) struct Ids(pub(super) Vec<MotorId>);

impl<'de> Deserialize<'de> for Ids {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(IdsVisitor)
    }
}

struct IdsVisitor;

impl<'de> Visitor<'de> for IdsVisitor {
    type Value = Ids;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ids such as \"1-6\" or [1, 2, 5], each from 1 to 32")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Ids, E> {
        let id = |text: &str| MotorId::new(text.trim().parse().ok()?).ok();
        let ends = text.split_once('-').and_then(|(first, last)| Some((id(first)?, id(last)?)));
        match ends {
            Some((first, last)) if first <= last => {
                let span = MotorId::all().filter(|id| (first..=last).contains(id));
                Ok(Ids(span.collect()))
            }
            _ => Err(E::invalid_value(serde::de::Unexpected::Str(text), &self)),
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Ids, A::Error> {
        let mut ids = Vec::new();
        while let Some(id) = seq.next_element()? {
            ids.push(id);
        }
        if ids.is_empty() {
            return Err(A::Error::invalid_length(0, &self));
        }
        Ok(Ids(ids))
    }
}

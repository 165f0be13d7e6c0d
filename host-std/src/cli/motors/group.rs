//! The fields that a motor has reported, from several replies.

use std::fmt;
use std::slice;

use myactuator_host_std::explain::{Values, values};
use myactuator_protocol_core::command::{Field, Fields, Phrase, RunningMode};
use myactuator_protocol_core::{Data, MotorId};
use serde_json::{Value, json};

use super::session::Session;

/// Fields of replies, one line for people.
#[derive(Clone, Debug, Default)]
pub(super) struct Group(Vec<Part>);

#[derive(Clone, Debug)]
struct Part {
    field: &'static Field,
    data: Data,
    /// What people read instead of the value.
    words: Option<&'static str>,
}

impl Group {
    /// Adds this reply's fields at the end.
    pub(super) fn and<R: Fields>(self, reply: &R) -> Self {
        self.and_but(reply, &[])
    }

    /// The same, without these fields.
    pub(super) fn and_but<R: Fields>(mut self, reply: &R, but: &[&str]) -> Self {
        let mut data = [0; 8];
        reply.put(&mut data);
        let wanted = R::FIELDS.iter().filter(|field| !but.contains(&field.name));
        self.0.extend(wanted.map(|field| Part { field, data, words: None }));
        self
    }

    /// The same for the running mode, which has no name while nothing runs.
    pub(super) fn and_mode(self, mode: &RunningMode) -> Self {
        let mut group = self.and(mode);
        if !mode.mode.runs()
            && let Some(part) = group.0.last_mut()
        {
            part.words = Some("nothing runs (mode 0)");
        }
        group
    }

    fn values(&self) -> Values {
        let each = self.0.iter();
        each.flat_map(|part| values(slice::from_ref(part.field), &part.data, None)).collect()
    }
}

impl Session {
    /// A motor's fields as one JSON object.
    pub(super) fn json(&self, motor: MotorId, groups: &[Group], note: Option<String>) -> Value {
        let mut object = json!({ "bus": self.address.to_string(), "id": motor.get() });
        if let Value::Object(object) = &mut object {
            object.extend(groups.iter().flat_map(Group::values));
            object.extend(note.map(|note| ("note".to_owned(), note.into())));
        }
        object
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, Part { field, data, words }) in self.0.iter().enumerate() {
            f.write_str(if place == 0 { "" } else { ", " })?;
            match words {
                Some(words) => f.write_str(words)?,
                None => Phrase { fields: slice::from_ref(field), data, ranges: None }.fmt(f)?,
            }
        }
        Ok(())
    }
}

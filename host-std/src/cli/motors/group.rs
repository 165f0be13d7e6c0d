//! What a motor has reported, put together from several replies.

use std::fmt;
use std::slice;

use myactuator_host_std::explain::{Values, values};
use myactuator_protocol_core::command::{Field, Fields, Phrase};
use myactuator_protocol_core::{Data, MotorId};
use serde_json::{Value, json};

use super::session::Session;

/// Fields of replies, one line for people.
#[derive(Clone, Debug, Default)]
pub(super) struct Group(Vec<(&'static Field, Data)>);

impl Group {
    /// This reply's fields behind those that are there.
    pub(super) fn and<R: Fields>(self, reply: &R) -> Self {
        self.and_but(reply, &[])
    }

    /// The same, without these fields.
    pub(super) fn and_but<R: Fields>(mut self, reply: &R, but: &[&str]) -> Self {
        let mut data = [0; 8];
        reply.put(&mut data);
        let wanted = R::FIELDS.iter().filter(|field| !but.contains(&field.name));
        self.0.extend(wanted.map(|field| (field, data)));
        self
    }

    fn values(&self) -> Values {
        let each = self.0.iter();
        each.flat_map(|(field, data)| values(slice::from_ref(field), data, None)).collect()
    }
}

impl Session {
    /// A motor's fields as one JSON object.
    pub(super) fn json(&self, motor: MotorId, groups: &[Group]) -> String {
        let mut object = json!({ "bus": self.address.to_string(), "id": motor.get() });
        if let Value::Object(object) = &mut object {
            object.extend(groups.iter().flat_map(Group::values));
        }
        object.to_string()
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (field, data)) in self.0.iter().enumerate() {
            let between = if place == 0 { "" } else { ", " };
            write!(
                f,
                "{between}{}",
                Phrase { fields: slice::from_ref(field), data, ranges: None }
            )?;
        }
        Ok(())
    }
}

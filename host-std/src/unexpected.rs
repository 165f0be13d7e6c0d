//! The error of text that a person typed.

/// Text that is not what was expected. The error of everything in this crate that is parsed from a few words.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found \"{found}\"")]
pub struct Unexpected {
    /// What was expected, with an example or the range.
    pub expected: String,
    /// What was found in its place.
    pub found: String,
}

impl Unexpected {
    pub(crate) fn new(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { expected: expected.into(), found: found.into() }
    }
}

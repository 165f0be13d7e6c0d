//! Models by name or by file, and where in a file or a request something is wrong.

use std::fs;
use std::path::Path;

use super::plant::{MotorParameters, ParameterError};

/// The model of this name or, if the name ends in `.toml`, the model in that file in `folder`.
///
/// # Errors
/// One sentence: what was expected, and what was found.
pub fn named_model(name: &str, folder: impl AsRef<Path>) -> Result<MotorParameters, String> {
    if !name.ends_with(".toml") {
        return MotorParameters::named(name).map_err(|error| error.to_string());
    }
    let path = folder.as_ref().join(name);
    let file = || format!("the model's file \"{}\"", path.display());
    let text =
        fs::read_to_string(&path).map_err(|error| format!("{} cannot be read: {error}", file()))?;
    MotorParameters::from_toml(&text).map_err(|error| match error {
        ParameterError::Toml(error) => {
            let (line, what) = of_toml(&text, &error);
            format!("{}, line {line}: {what}", file())
        }
        other => format!("{}: {other}", file()),
    })
}

/// The number of the line of a text in which this byte is, from 1.
pub(super) fn line_of(text: &str, at: usize) -> usize {
    let before = text.as_bytes().get(..at).unwrap_or_default();
    before.iter().filter(|&&byte| byte == b'\n').count() + 1
}

/// The line in which something is wrong, and what, in one line.
pub(super) fn of_toml(text: &str, error: &toml::de::Error) -> (usize, String) {
    let at = error.span().map_or(0, |span| span.start);
    let what = error.message().trim_end().replace('\n', ", ");
    (line_of(text, at), in_plain_words(&what).unwrap_or(what))
}

/// What was expected and what was found, in the words of a person who writes a file or a request, if serde names a type
/// of this program.
pub(crate) fn in_plain_words(what: &str) -> Option<String> {
    let (found, expected) = what
        .strip_prefix("invalid type: ")
        .or_else(|| what.strip_prefix("invalid value: "))?
        .split_once(", expected ")?;
    let expected = match expected {
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" => "a whole number from 0 to 4294967295",
        "u64" => "a whole number that is not negative",
        "f32" | "f64" => "a number",
        "a boolean" => "true or false",
        "a string" | "path string" => "a text in quotes",
        "a sequence" => "a list in brackets",
        "an array of length 2" => "a list of 2 numbers",
        table if table.starts_with("struct ") => "a table",
        other => other,
    };
    Some(format!("expected {expected}, found {found}"))
}

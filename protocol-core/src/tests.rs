//! Tables that are written by hand in the documentation are true.

use std::path::Path;
use std::string::String;
use std::vec::Vec;
use std::{format, fs};

const LIB: &str = include_str!("lib.rs");
/// Private modules below the map.
const GROUND: [&str; 2] = ["data", "round"];

/// The modules of the map, from the ground up.
fn layers() -> Vec<&'static str> {
    let rows = LIB.lines().filter(|line| line.starts_with("//! | [`"));
    let names = rows.filter_map(|row| row.split(" | ").nth(1));
    names.flat_map(|cell| cell.split('`').skip(1).step_by(2)).collect()
}

/// The modules that a file imports from, its tests and comments apart.
fn imports(text: &str) -> Vec<&str> {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or(text);
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let paths = lines.flat_map(|line| line.split("crate::").skip(1));
    paths
        .filter_map(|path| path.split(|c: char| !(c.is_ascii_lowercase() || c == '_')).next())
        .collect()
}

fn check(path: &Path, allowed: &[&str]) -> usize {
    if path.is_dir() {
        let entries = fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path());
        return entries
            .filter(|path| !path.ends_with("tests"))
            .map(|path| check(&path, allowed))
            .sum();
    }
    let text: String = fs::read_to_string(path).unwrap();
    let found = imports(&text);
    for import in &found {
        // Names that the crate exports at its root begin with a capital letter.
        assert!(import.is_empty() || allowed.contains(import), "{path:?} imports {import}");
    }
    found.len()
}

#[test]
fn each_layer_imports_from_those_before_it_only() {
    let layers = layers();
    assert_eq!(layers.len(), LIB.matches("\npub mod ").count(), "{layers:?}");
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut count = 0;
    for (place, layer) in layers.iter().enumerate() {
        let file = src.join(format!("{layer}.rs"));
        let path = if file.exists() { file } else { src.join(layer) };
        count += check(&path, &[&GROUND, &layers[..=place]].concat());
    }
    assert!(count > 200, "{count} imports found");
}

#[test]
fn every_chapter_is_in_the_table_of_chapters() {
    let text = include_str!("command/mod.rs");
    for line in text.lines().filter(|line| line.starts_with("pub mod ")) {
        let chapter = line.trim_start_matches("pub mod ").trim_end_matches(';');
        assert!(text.contains(&format!("[`{chapter}`]")), "{chapter}");
    }
}

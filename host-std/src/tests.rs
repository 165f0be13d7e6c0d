//! The map of layers in the documentation is true.

use std::fs;
use std::path::Path;

const LIB: &str = include_str!("lib.rs");

/// The rows of the map: a layer, and those that it stands on.
fn layers() -> Vec<(&'static str, Vec<&'static str>)> {
    let names = |cell: &'static str| cell.split('`').skip(1).step_by(2).collect::<Vec<_>>();
    let rows = LIB.lines().filter(|line| line.starts_with("//! | [`"));
    let rows = rows.map(|row| row.split(" | ").collect::<Vec<_>>());
    rows.map(|cells| (names(cells[1])[0], names(cells[3]))).collect()
}

/// The modules of this crate that a file names, its tests and comments apart.
fn imports(text: &str) -> impl Iterator<Item = &str> {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or(text);
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let paths = lines.flat_map(|line| line.split("crate::").skip(1));
    // Names that the crate exports at its root begin with a capital letter.
    paths.filter_map(|path| path.split(|c: char| !c.is_ascii_lowercase()).next())
}

fn check(path: &Path, allowed: &[&str]) -> usize {
    if path.is_dir() {
        let files = fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path());
        return files
            .filter(|path| !path.ends_with("tests.rs"))
            .map(|path| check(&path, allowed))
            .sum();
    }
    let text = fs::read_to_string(path).unwrap();
    let found = imports(&text).filter(|import| !import.is_empty());
    found.inspect(|import| assert!(allowed.contains(import), "{path:?} imports {import}")).count()
}

#[test]
fn each_layer_imports_from_those_that_it_stands_on_only() {
    let layers = layers();
    assert_eq!(layers.len(), LIB.matches("\npub mod ").count(), "{layers:?}");
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let imports = layers
        .into_iter()
        .map(|(layer, below)| check(&src.join(layer), &[&[layer], &below[..]].concat()));
    assert!(imports.sum::<usize>() > 50);
}

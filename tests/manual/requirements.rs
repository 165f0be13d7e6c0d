//! Proves that the list of requirements is complete: every section of the manual is there, no requirement is without a
//! test unless it says why, and every named test exists. `.ci/manual` reads from the output of `cargo test` that these
//! tests have run.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use myactuator_tests::requirements::TEXT;
use myactuator_tests::vectors::headings;

/// A line of the list and those below it.
#[derive(Debug)]
struct Requirement {
    section: &'static str,
    number: u32,
    /// Names of tests, and words that stand for tests.
    tests: Vec<&'static str>,
    decided: Option<&'static str>,
    untested: Option<&'static str>,
}

/// The list.
#[derive(Default)]
struct List {
    /// The words that stand for tests.
    words: BTreeMap<&'static str, Vec<&'static str>>,
    headings: Vec<(&'static str, &'static str)>,
    requirements: Vec<Requirement>,
    /// Sections that say why they require nothing.
    empty: BTreeSet<&'static str>,
}

impl List {
    fn read() -> Self {
        let mut list = Self::default();
        let begin = TEXT.find("\n# 1 ").expect("a first chapter") + 1;
        let (introduction, chapters) = TEXT.split_at(begin);
        for line in introduction.lines().filter_map(|line| line.strip_prefix("  - ")) {
            let (word, tests) = line.split_once(": ").expect(line);
            let tests =
                list.names(tests).unwrap_or_else(|expected| panic!("expected {expected}: {line}"));
            list.words.insert(word, tests);
        }
        for line in chapters.lines().filter(|line| !line.is_empty()) {
            list.read_line(line).unwrap_or_else(|expected| panic!("expected {expected}: {line}"));
        }
        list
    }

    fn read_line(&mut self, line: &'static str) -> Result<(), &'static str> {
        if line.starts_with('#') {
            let (hashes, heading) = line.split_once(' ').ok_or("a heading")?;
            let (section, title) = heading.split_once(' ').ok_or("a section and its title")?;
            let depth = section.split('.').count();
            if hashes.len() != depth {
                return Err("a # for each number of the section");
            }
            self.headings.push((section, title));
        } else if let Some(why) = line.strip_prefix("No requirement: ") {
            let section = self.headings.last().ok_or("a heading before")?.0;
            let is_new = self.empty.insert(section);
            (is_new && why.ends_with('.')).then_some(()).ok_or("one reason, with a full stop")?;
        } else if let Some(line) = line.strip_prefix("- **") {
            let (id, rest) = line.split_once("** ").ok_or("- **ID** WHO: TEXT")?;
            let (section, number) = id.split_once('-').ok_or("an id as 2.4.3-1")?;
            if self.headings.last().map(|heading| heading.0) != Some(section) {
                return Err("an id of the section that it stands in");
            }
            let number = number.parse().map_err(|_| "an id as 2.4.3-1")?;
            let (who, text) = rest.split_once(": ").ok_or("who is bound")?;
            let is_said = text.ends_with('.') && ["frame", "drive", "master"].contains(&who);
            is_said.then_some(()).ok_or("frame, drive or master, and a sentence")?;
            let tests = Vec::new();
            let (decided, untested) = (None, None);
            self.requirements.push(Requirement { section, number, tests, decided, untested });
        } else {
            let line = line.strip_prefix("  - ").ok_or("a line of the list")?;
            let (key, value) = line.split_once(": ").ok_or("a line of the list")?;
            let tests = if key == "test" { self.names(value)? } else { Vec::new() };
            let of = self.requirements.last_mut().ok_or("a requirement before")?;
            let order = "test, decided and untested in this order, each once";
            match key {
                "test" if of.tests.is_empty() && (of.decided, of.untested) == (None, None) => {
                    of.tests = tests;
                }
                "decided" if (of.decided, of.untested) == (None, None) => {
                    of.decided = Some(value);
                }
                "untested" if of.untested.is_none() => of.untested = Some(value),
                _ => return Err(order),
            }
        }
        Ok(())
    }

    /// The names in a value: words, and tests in the form in which `.ci/manual` finds them.
    fn names(&self, value: &'static str) -> Result<Vec<&'static str>, &'static str> {
        let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "_:".contains(c);
        let name = |name: &'static str| match name.strip_prefix('`')?.strip_suffix('`') {
            Some(test) if test.contains("::") && test.chars().all(is_name) => Some(test),
            _ => None,
        };
        let word = |name| self.words.get_key_value(name).map(|(word, _)| *word);
        let names = value.split(", ").map(|it| name(it).or_else(|| word(it)));
        names.collect::<Option<_>>().ok_or("words, and tests as `program::module::name`")
    }

    /// The tests that a requirement or a word names.
    fn tests(&self) -> BTreeSet<&'static str> {
        let of_requirements = self.requirements.iter().flat_map(|of| &of.tests);
        let named = of_requirements.chain(self.words.values().flatten()).copied();
        named.filter(|test| !self.words.contains_key(test)).collect()
    }
}

#[test]
fn every_section_of_the_manual_is_there() {
    let list = List::read();
    assert_eq!(list.headings, headings().collect::<Vec<_>>());
    for (section, title) in &list.headings {
        let below = format!("{section}.");
        let has_sections = list.headings.iter().any(|(other, _)| other.starts_with(&below));
        let has_lines = list.requirements.iter().any(|of| of.section == *section);
        let says_why = list.empty.contains(section);
        assert!(
            has_lines != says_why || (has_sections && !says_why),
            "{section} {title}: needs lines, or one that begins with \"No requirement: \""
        );
    }
}

#[test]
fn ids_are_unique_and_grow() {
    for pair in List::read().requirements.windows(2) {
        let [before, of] = pair else { unreachable!("windows of 2") };
        let grows = of.section != before.section || of.number > before.number;
        assert!(grows, "{}-{} does not stand in order", of.section, of.number);
    }
}

#[test]
fn every_requirement_names_a_test_or_says_why_not() {
    for of in List::read().requirements {
        let why = "needs \"  - test: \" or \"  - untested: \"";
        assert!(!of.tests.is_empty() || of.untested.is_some(), "{of:?} {why}");
    }
}

/// The source file of the module that a test's name names, or of the nearest module around it.
fn source(test: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut parts = test.split("::").peekable();
    let mut at = match *parts.peek()? {
        "myactuator_protocol_core" => root.join("../protocol-core/src"),
        "myactuator_host_std" => root.join("../host-std/src"),
        program if root.join(program).exists() => root.to_path_buf(),
        _ => root.join("../host-std/tests"),
    };
    if test.starts_with("myactuator_") {
        parts.next();
    }
    let mut found = None;
    for part in parts {
        at.push(part);
        let files = [at.with_extension("rs"), at.join("mod.rs")];
        found = files.into_iter().find(|file| file.is_file()).or(found);
    }
    found
}

/// `.ci/manual` would pass over such a name, and its test might never run.
#[test]
fn test_name_that_ci_would_not_look_up_is_refused() {
    let mut list = List::default();
    list.words.insert("examples", vec!["manual::buses::one"]);
    for line in ["# 1 Buses", "- **1-1** drive: Hears."] {
        list.read_line(line).unwrap();
    }
    for wrong in [
        "  - test: manual::buses::one",
        "  - test: `one`",
        "  - test: `manual::buses::One`",
        "  - test: example",
        "    - test: `manual::buses::one`",
        "- test: `manual::buses::one`",
    ] {
        assert!(list.read_line(wrong).is_err(), "{wrong}");
    }
    list.read_line("  - test: `manual::buses::one`, examples").unwrap();
    assert_eq!(list.requirements[0].tests, ["manual::buses::one", "examples"]);
}

/// Finds misspelt names. Whether a test ran is checked by `.ci/manual`.
#[test]
fn each_named_test_is_in_the_sources() {
    for test in List::read().tests() {
        let file = source(test).unwrap_or_else(|| panic!("{test}: there is no such program"));
        let text = std::fs::read_to_string(&file).expect("a source");
        let name = test.rsplit("::").next().unwrap();
        let begin = ["(", "<"].iter().find_map(|end| text.find(&format!("fn {name}{end}")));
        let begin = begin.unwrap_or_else(|| panic!("{test}: {} has no such test", file.display()));
        let attributes = text[..begin].rsplit("\n\n").next().unwrap();
        assert!(!attributes.contains("#[ignore"), "{test} is ignored");
    }
}

#[test]
fn each_word_for_tests_is_used() {
    let list = List::read();
    for word in list.words.keys() {
        let is_used = list.requirements.iter().any(|of| of.tests.contains(word));
        assert!(is_used, "{word} stands for tests that no line names");
    }
}

/// Lines name headings of `drive::decisions`. Each must exist, and each heading must be named.
#[test]
fn named_decisions_and_headings_of_decisions_match() {
    let decisions = include_str!("../../protocol-core/src/drive/decisions.rs");
    let headings: BTreeSet<_> =
        decisions.lines().filter_map(|line| line.strip_prefix("//! # ")).collect();
    let mut named = BTreeSet::new();
    for of in List::read().requirements {
        let Some((_, heading)) = of.decided.unwrap_or("").split_once("`drive::decisions`, ") else {
            continue;
        };
        let heading = heading.trim_end_matches('.');
        assert!(headings.contains(heading), "{}-{}: no {heading}", of.section, of.number);
        named.insert(heading);
    }
    assert_eq!(named, headings, "every heading of drive::decisions is named");
}

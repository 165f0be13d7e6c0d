//! A breadth-first search, which finds the shortest way to a violation.

use std::collections::{BTreeMap, HashSet};
use std::io::{Write as _, stderr};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// A violation.
pub(crate) type Broken = String;

/// A state of the search: the code under test, the world around it, and the steps that led here.
pub(crate) trait Searched: Clone + Send + Sync {
    type Step: Copy + std::fmt::Debug + Send;

    /// All steps that may come next. Some of them turn out to be impossible.
    fn possible(&self) -> Vec<Self::Step>;

    /// Takes this step. `Ok(false)` if it is impossible.
    fn step(&mut self, step: Self::Step) -> Result<bool, Broken>;

    /// The steps so far.
    fn steps(&self) -> &[Self::Step];

    /// A number that equal states share.
    fn number(&self) -> u64;

    /// Checks a state that was not seen before.
    fn check(&self) -> Result<(), Broken>;

    /// Checks that everything ends if the world has no faults from now on.
    fn check_end(&self) -> Result<(), Broken>;
}

const SHARDS: usize = 64;
const THREADS: usize = 2;
/// A thread takes this many states at a time.
const CHUNK: usize = 256;

/// The numbers of the states that were seen.
struct Seen(Vec<Mutex<HashSet<u64>>>);

impl Seen {
    fn new() -> Self {
        Self((0..SHARDS).map(|_| Mutex::default()).collect())
    }

    fn insert(&self, number: u64) -> bool {
        self.0[number as usize % SHARDS].lock().unwrap().insert(number)
    }
}

/// The violations found, each with the shortest way to it.
type Found<S> = BTreeMap<Broken, Vec<<S as Searched>::Step>>;

/// Searches all states that this one leads to within this many steps, and fails with the first violation.
pub(crate) fn search<S: Searched>(name: &str, start: S, most_steps: usize) {
    let begun = Instant::now();
    let seen = Seen::new();
    let found = Mutex::new(Found::<S>::new());
    let mut level = vec![start];
    let mut states = 1;
    let mut depth = 0;
    while !level.is_empty() && depth < most_steps && found.lock().unwrap().is_empty() {
        depth += 1;
        level = next_level(&level, depth == most_steps, &seen, &found);
        states += level.len();
        if std::env::var_os("INTERLEAVINGS_LEVELS").is_some() {
            println!("  {depth}: {} {:?}", level.len(), begun.elapsed());
        }
    }
    let found = found.into_inner().unwrap();
    let whole = if level.is_empty() { "all there are" } else { "bounded" };
    // Directly to the error output, so that every run of the tests shows it.
    let _ = writeln!(
        stderr(),
        "{name}, depth {depth} ({whole}), {states} states, {:.1} s",
        begun.elapsed().as_secs_f32()
    );
    let ways: Vec<_> = found.iter().map(|(what, way)| format!("{what}:\n    {way:?}")).collect();
    assert!(found.is_empty(), "{}", ways.join("\n"));
}

/// The states that one more step leads to and that were not seen before.
fn next_level<S: Searched>(
    level: &[S],
    is_deepest: bool,
    seen: &Seen,
    found: &Mutex<Found<S>>,
) -> Vec<S> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut new = Vec::new();
        loop {
            let from = next.fetch_add(CHUNK, Ordering::Relaxed).min(level.len());
            let chunk = &level[from..(from + CHUNK).min(level.len())];
            if chunk.is_empty() {
                return new;
            }
            for state in chunk {
                follow(state, is_deepest, seen, found, &mut new);
            }
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    })
}

fn follow<S: Searched>(
    state: &S,
    is_deepest: bool,
    seen: &Seen,
    found: &Mutex<Found<S>>,
    new: &mut Vec<S>,
) {
    let mut is_last = true;
    for step in state.possible() {
        let mut after = state.clone();
        let result = match after.step(step) {
            Ok(true) if seen.insert(after.number()) => {
                let result = after.check();
                // A hang lasts until the end of the search, so checking there is enough.
                if is_deepest { result.and_then(|()| after.check_end()) } else { result }
            }
            Ok(true) => {
                is_last = false;
                continue;
            }
            Ok(false) => continue,
            Err(broken) => Err(broken),
        };
        is_last = false;
        match result {
            Ok(()) => new.push(after),
            Err(broken) => {
                let mut found = found.lock().unwrap();
                let way = found.entry(broken).or_insert_with(|| after.steps().to_vec());
                if after.steps().len() < way.len() {
                    *way = after.steps().to_vec();
                }
            }
        }
    }
    if is_last && let Err(broken) = state.check_end() {
        found.lock().unwrap().entry(broken).or_insert_with(|| state.steps().to_vec());
    }
}

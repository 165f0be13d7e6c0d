//! The search: breadth first, so that the shortest way to what must not be is found.

use std::collections::{BTreeMap, HashSet};
use std::io::{Write as _, stderr};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use super::callers::Call;
use super::state::{Broken, State, Step};
use super::world::Medium;

/// How far a search goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub(crate) name: &'static str,
    pub(crate) medium: Medium,
    /// What callers do.
    pub(crate) calls: &'static [Call],
    /// So many of it in one run.
    pub(crate) most_calls: u8,
    pub(crate) faults: u8,
    pub(crate) depth: usize,
}

const SHARDS: usize = 64;
const THREADS: usize = 2;
/// A thread takes so many states at a time.
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

/// What was found, each with the shortest way to it.
type Found = BTreeMap<Broken, Vec<Step>>;

/// Searches all states up to these bounds, and fails with what it finds first.
pub(crate) fn search<const N: usize>(bounds: &Bounds) {
    let begun = Instant::now();
    let seen = Seen::new();
    let found = Mutex::new(Found::new());
    let mut level = vec![State::<N>::new(bounds.medium, bounds.most_calls, bounds.faults)];
    let mut states = 1;
    let mut depth = 0;
    while !level.is_empty() && depth < bounds.depth && found.lock().unwrap().is_empty() {
        depth += 1;
        level = next_level(&level, bounds, depth, &seen, &found);
        states += level.len();
        if std::env::var_os("INTERLEAVINGS_LEVELS").is_some() {
            println!("  {depth}: {} {:?}", level.len(), begun.elapsed());
        }
    }
    let found = found.into_inner().unwrap();
    let whole = if level.is_empty() { "all there are" } else { "bounded" };
    // Past what the test program keeps to itself, so that every run of the tests shows it.
    let _ = writeln!(
        stderr(),
        "{}: {N} motor(s), {} calls, {} faults, depth {depth} ({whole}), {states} states, {:.1} s",
        bounds.name,
        bounds.most_calls,
        bounds.faults,
        begun.elapsed().as_secs_f32()
    );
    let ways: Vec<_> = found.iter().map(|(what, way)| format!("{what}:\n    {way:?}")).collect();
    assert!(found.is_empty(), "{}", ways.join("\n"));
}

/// The states that one more step leads to and that were not seen before.
fn next_level<const N: usize>(
    level: &[State<N>],
    bounds: &Bounds,
    depth: usize,
    seen: &Seen,
    found: &Mutex<Found>,
) -> Vec<State<N>> {
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
                follow(state, bounds, depth, seen, found, &mut new);
            }
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    })
}

fn follow<const N: usize>(
    state: &State<N>,
    bounds: &Bounds,
    depth: usize,
    seen: &Seen,
    found: &Mutex<Found>,
    new: &mut Vec<State<N>>,
) {
    let mut is_last = true;
    for step in state.possible(bounds.calls) {
        let mut after = state.clone();
        let result = match after.step(step) {
            Ok(true) if seen.insert(after.number()) => {
                let result = after.check_poll_at();
                // What hangs, hangs until the end of the search: to look there is enough.
                if depth == bounds.depth { result.and_then(|()| after.check_end()) } else { result }
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
                let way = found.entry(broken).or_insert_with(|| after.steps.clone());
                if after.steps.len() < way.len() {
                    *way = after.steps;
                }
            }
        }
    }
    if is_last && let Err(broken) = state.check_end() {
        found.lock().unwrap().entry(broken).or_insert_with(|| state.steps.clone());
    }
}

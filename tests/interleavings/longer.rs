//! Random runs that are longer than the search reaches, with the same steps, the same world and the same oracle.

use myactuator_protocol_core::time::{Duration, Instant};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::{Config, RngSeed};

use super::search::Searched;
use super::state::{Bounds, State, Step};

/// Calls of one run. The model has a bit for each.
const CALLS: u8 = 30;
const FAULTS: u8 = 12;
/// If a motor is not heard for longer, it may have restarted, which is not in the model.
const LONGEST_RUN: Duration = Duration::from_millis(900);

/// The sort of steps from which the next one is drawn. If all steps were drawn alike, nearly all would be calls and
/// faults.
#[derive(Clone, Copy, Debug)]
enum Sort {
    Call,
    Bus,
    Fault,
    Time,
}

fn sort_of(step: Step) -> Sort {
    match step {
        Step::Call(_) | Step::CallBeforeEvents(_) => Sort::Call,
        Step::Take | Step::Hear(_) | Step::Reply(_) => Sort::Bus,
        Step::Tick | Step::Sleep => Sort::Time,
        Step::TakeForAnother(_)
        | Step::HearTwice(_)
        | Step::LoseCommand(_)
        | Step::ReplyTwice(_)
        | Step::LoseReply(_)
        | Step::LoseMaster(_)
        | Step::TakeAndLose
        | Step::Cut
        | Step::Mend
        | Step::TakeAndEcho
        | Step::ForeignStop(..)
        | Step::Foreign => Sort::Fault,
    }
}

fn any_sort() -> impl Strategy<Value = Sort> {
    prop_oneof![
        1 => Just(Sort::Fault),
        3 => Just(Sort::Call),
        3 => Just(Sort::Time),
        12 => Just(Sort::Bus),
    ]
}

fn run<const N: usize>(bounds: &Bounds, choices: &[(Sort, Index)]) -> Result<(), TestCaseError> {
    let mut state = State::<N>::new(&Bounds { most_calls: CALLS, faults: FAULTS, ..*bounds });
    let end = state.world.now + LONGEST_RUN;
    let failed =
        |state: &State<N>, broken| Err(TestCaseError::fail(format!("{broken}\n{state:?}")));
    for (sort, index) in choices {
        let is_of_sort =
            |step: &Step| std::mem::discriminant(&sort_of(*step)) == std::mem::discriminant(sort);
        let steps: Vec<Step> = state.possible().into_iter().filter(is_of_sort).collect();
        if steps.is_empty() || is_after(&state, end) {
            continue;
        }
        let mut after = state.clone();
        match after.step(*index.get(&steps)) {
            Ok(false) => continue,
            Ok(true) => state = after,
            Err(broken) => return failed(&after, broken),
        }
        if let Err(broken) = state.check() {
            return failed(&state, broken);
        }
    }
    state.check_end().or_else(|broken| failed(&state, broken))
}

fn is_after<const N: usize>(state: &State<N>, end: Instant) -> bool {
    state.world.now >= end
}

fn choices() -> impl Strategy<Value = Vec<(Sort, Index)>> {
    prop::collection::vec((any_sort(), any::<Index>()), 50..400)
}

/// The same runs each time, unless `PROPTEST_CASES` or `PROPTEST_RNG_SEED` asks for others.
pub(super) fn same_runs() -> Config {
    let given = Config::default();
    let is_given = |name| std::env::var_os(name).is_some();
    Config {
        cases: if is_given("PROPTEST_CASES") { given.cases } else { 500 },
        rng_seed: if is_given("PROPTEST_RNG_SEED") { given.rng_seed } else { RngSeed::Fixed(1) },
        failure_persistence: None,
        ..given
    }
}

proptest! {
    #![proptest_config(same_runs())]

    #[test]
    fn one_motor_by_chance(choices in choices()) {
        run::<1>(&crate::ONE, &choices)?;
    }

    #[test]
    fn two_motors_by_chance(choices in choices()) {
        run::<2>(&crate::TWO, &choices)?;
    }

    #[test]
    fn a_cut_bus_by_chance(choices in choices()) {
        run::<1>(&crate::CUT_FOR_LONG, &choices)?;
    }

    #[test]
    fn a_line_by_chance(choices in choices()) {
        run::<1>(&crate::LINE, &choices)?;
    }
}

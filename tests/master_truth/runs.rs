//! The tests.

use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Config, Patience};
use myactuator_protocol_core::time::Duration;
use myactuator_tests::rig::{Rig, angle};
use myactuator_tests::script::late_by;
use myactuator_tests::values::id;
use myactuator_tests::wire::Wire as _;

use super::callers::Session;
use super::excuses::Excuse;
use super::oracle::Why;
use super::scenarios::{Scenario, Trouble};
use super::world::Rough;

const RATES: [u32; 4] = [0, 1, 10, 50];
const MOTORS: [u8; 4] = [1, 3, 8, 32];
/// Requests in each scenario. Twelve troubles have sixteen scenarios each: 307 200 requests on CAN and 57 600 on RS485,
/// whose bytes take longer to simulate.
const ON_CAN: u64 = 1_600;
const ON_RS485: u64 = 300;
/// Drawn scenarios, and the requests of each: 750 000 on both buses, so that there are more than a million in total.
const DRAWN_ON_CAN: u64 = 640;
const DRAWN_ON_RS485: u64 = 110;
const DRAWN_REQUESTS: u64 = 1_000;
/// This many tests share them, so that they run in parallel.
const SHARES: u64 = 4;

fn run<W: Rough>(scenario: Scenario) {
    let totals = Session::<W>::new(scenario).run();
    let told = format!("{}, {scenario}: {totals:?}", W::NAME);
    if std::env::var_os("MASTER_TRUTH_TOTALS").is_some() {
        println!("{told}");
    }
    let failed: u64 = totals.failed.values().sum();
    assert_eq!(totals.replies + totals.sent + failed, totals.requests, "{told}");
    if scenario.is_kind() {
        // Nothing goes wrong, so nothing may be reported as wrong.
        let odd = failed - totals.failed(Why::Stopped);
        assert_eq!((odd, totals.unanswered), (0, 0), "{told}");
        assert_eq!((totals.unconfirmed, totals.bus_errors), (0, 0), "{told}");
        // Except: if a run time wraps that was not read before, its drive seems to have restarted.
        let mut excused = totals.excused.clone();
        let begun_anew = excused.remove(&Excuse::RunTimeBeganAnew).unwrap_or(0);
        assert!(begun_anew == 0 || scenario.conditions.have_run, "{told}");
        assert_eq!(totals.restarted, begun_anew, "{told}");
        assert!(excused.is_empty(), "{told}");
    }
    // Some worlds are down or stopped for most of the time.
    let ended_early = totals.failed(Why::BusDown) + totals.failed(Why::Stopped);
    let of_others = totals.requests - ended_early;
    assert!(totals.replies * 10 > of_others, "hardly any answers: {told}");
}

/// Runs every rate and several numbers of motors with this trouble.
fn each<W: Rough>(trouble: Trouble) {
    let requests = if W::NAME == "CAN" { ON_CAN } else { ON_RS485 };
    for percent in RATES {
        for motors in MOTORS {
            run::<W>(Scenario::of(trouble, percent, motors, requests));
        }
    }
}

macro_rules! each_trouble {
    ($($name:ident: $trouble:ident,)+) => {
        mod can {
            $(#[test] fn $name() { super::each::<super::CanBus>(super::Trouble::$trouble); })+
        }
        mod rs485 {
            $(#[test] fn $name() { super::each::<super::Rs485Line>(super::Trouble::$trouble); })+
        }
    };
}

each_trouble! {
    lost: Lose,
    corrupted: Corrupt,
    corrupted_unnoticed: Undetected,
    replies_doubled: DoubleReplies,
    all_doubled: DoubleAll,
    delayed: Delay,
    reordered: Reorder,
    everything: All,
    wires_cut: Cut,
    drives_slow: Slow,
    babble: Babble,
    power_cycled: Restart,
}

fn drawn<W: Rough>(share: u64, scenarios: u64) {
    for seed in (share..scenarios).step_by(SHARES as usize) {
        let scenario = Scenario::drawn::<W>(seed, DRAWN_REQUESTS);
        run::<W>(if seed / SHARES % 3 == 2 { scenario.adapting() } else { scenario });
    }
}

macro_rules! drawn {
    ($($name:ident: $share:literal,)+) => {
        mod drawn_on_can {
            $(#[test] fn $name() { super::drawn::<super::CanBus>($share, super::DRAWN_ON_CAN); })+
        }
        mod drawn_on_rs485 {
            $(#[test] fn $name() { super::drawn::<super::Rs485Line>($share, super::DRAWN_ON_RS485); })+
        }
    };
}

drawn! {
    first: 0,
    second: 1,
    third: 2,
    fourth: 3,
}

fn once<W: Rough>(seed: u64) {
    run::<W>(Scenario::drawn::<W>(seed, DRAWN_REQUESTS).as_first_drawn());
}

#[test]
fn seeds_that_once_failed_pass() {
    // A clock jumps. Then a motor is first heard whose answers all looked like echoes before. Its silence is reported
    // once more.
    once::<Rs485Line>(3573);
    // A command to all is in a mailbox when a stop ends it, and is handed back. So it was not sent.
    once::<CanBus>(10_003);
    // Two motors with one id answer each other endlessly on a line. A stop does not wait for the end.
    once::<Rs485Line>(10_035);
}

fn as_drawn<W: Rough>(seed: u64) {
    run::<W>(Scenario::drawn::<W>(seed, DRAWN_REQUESTS));
}

#[test]
fn seeds_that_failed_later_pass() {
    // Two motors with one id answer each other every millisecond, and the clock has steps of a millisecond. The line
    // never seems free. Nothing may wait longer than its bound nevertheless.
    as_drawn::<Rs485Line>(300_309);
    as_drawn::<Rs485Line>(3_004);
    // A stop that may be in flight already is called again, now of the other kind. It has all its attempts.
    as_drawn::<Rs485Line>(9_194);
    // An answer long after a read of the status does not answer that read, and shows nothing about an echo.
    as_drawn::<Rs485Line>(5_123);
    // No caller has looked for an hour when the loop's own read is answered.
    as_drawn::<Rs485Line>(71_135);
    // Noise has destroyed four echoes in a row. Then echoes of set-points pass for commands that are handed back. The
    // set-points seem ignored, but none is lost.
    as_drawn::<Rs485Line>(700_335);
    // A collision makes a frame that a drive hears. The frame is made up, and the next angle jumps from the one in it.
    as_drawn::<Rs485Line>(710_003);
    // Noise looks like a reply in motion mode, and begins like the report of a drive that has lost its master.
    as_drawn::<CanBus>(1_140);
    // A port has failed when a task was dropped. A command ends the motion of all before the task's next round.
    as_drawn::<CanBus>(500_942);
    // A run time is read shortly before it wraps. Then a silence is reported as a restart, so the run time is unknown
    // again.
    as_drawn::<Rs485Line>(9_002_221);
    as_drawn::<Rs485Line>(9_000_723);
    as_drawn::<Rs485Line>(9_002_613);
    // Two motors with one id answer a stop. Earlier stops reached neither. The second answer passes for an answer to
    // the stop to all.
    as_drawn::<CanBus>(9_002_429);
    // The last feedback of a run is late. The set-point after it is still in flight and not counted yet.
    as_drawn::<CanBus>(9_001_529);
    // A motor that was never heard gets a command to restart and is first heard after an hour. Only then is it known to
    // run.
    as_drawn::<CanBus>(9_103_926);
    // A move of all is in a mailbox when a request ends the motion of one motor. The request is sent again after the
    // move.
    as_drawn::<CanBus>(9_002_488);
    // No caller has looked for an hour. A set-point whose time is up is handed back before that is reported.
    as_drawn::<CanBus>(9_100_934);
    // All hold, a command lets them go, and that command is handed back because another stop is sent in its place. That
    // stop may be the motor's first.
    as_drawn::<CanBus>(9_100_933);
    // Because of noise an echo passes for a command that a drive ignores. It is reported after the answer, which comes
    // twice.
    as_drawn::<Rs485Line>(9_101_198);
    // A collision makes an answer with another angle. Its token and its CRC are right.
    as_drawn::<Rs485Line>(9_101_525);
    // An answer comes twice and passes for the answer to a command that is then handed back.
    as_drawn::<CanBus>(9_400_910);
    // Another station makes up a move in motion mode after a request that ends motion. No mailbox has held it back.
    as_drawn::<CanBus>(9_404_136);
    // Nothing goes wrong, but a run time wraps that was not read before.
    as_drawn::<Rs485Line>(9_402_152);
    // No caller looks for an hour, and answers to a stop stay in a port. They come after a command that ends the motion
    // of all.
    as_drawn::<Rs485Line>(9_410_924);
    // A stop has pushed aside a request to hold, which is then handed back. To the master it may have been the motor's
    // stop.
    as_drawn::<CanBus>(9_411_783);
    // A drive that has lost its master hands back the first read in a second. That passes for an echo, and the motor
    // counts as heard only with its answer.
    as_drawn::<Rs485Line>(9_420_244);
    // A stop to all is pending on a line and is lifted, and all are stopped again. It was not sent to any motor yet, so
    // it must be sent.
    as_drawn::<Rs485Line>(9_412_258);
    // These seeds notice deliberate faults in the master that nothing else notices:
    // - An answer that belongs to an earlier command confirms a stop.
    // - A command that ends the motion of all is handed back and not sent again.
    // - A command that was answered and is handed back counts as answered.
    as_drawn::<CanBus>(2_706);
    as_drawn::<CanBus>(1_827);
    as_drawn::<CanBus>(3_082);
}

/// Runs the drawn scenario of the seed in `MASTER_TRUTH_SEED` on both buses. Without that variable it does nothing.
#[test]
fn alone() {
    let Some(seed) = std::env::var("MASTER_TRUTH_SEED").ok().and_then(|seed| seed.parse().ok())
    else {
        return;
    };
    let (can, rs485) = (Scenario::drawn::<CanBus>, Scenario::drawn::<Rs485Line>);
    run::<CanBus>(can(seed, DRAWN_REQUESTS));
    run::<Rs485Line>(rs485(seed, DRAWN_REQUESTS));
    run::<CanBus>(can(seed, DRAWN_REQUESTS).adapting());
    run::<Rs485Line>(rs485(seed, DRAWN_REQUESTS).adapting());
}

/// Whether the second of two equal requests gets the answer to the first, if the drive's wire holds that back for
/// `delay`.
fn is_fooled(delay: Duration, late_window: Duration) -> bool {
    let config = Config { late_window, ..CanBus::CONFIG };
    let mut rig = Rig::<CanBus>::with_config(1, 1, config);
    let motor = id(1);
    rig.world.set_faults(Direction::ToPorts, late_by(delay));
    let once = Patience { reply_timeout: Duration::from_millis(20), attempts: 1 };
    let (first, second) = (angle(1), angle(2));
    assert!(rig.runner.ask_with(motor, first, Some(once), |_| {}).is_err());
    // The bus has no faults any more, but the first reply is still in flight.
    rig.world.set_faults(Direction::ToPorts, FaultPlan::NONE);
    let mut fooled = false;
    for _ in 0..20 {
        let answer = rig.runner.ask_with(motor, second, Some(once), |_| {});
        fooled |= matches!(answer, Ok(reply) if reply.angle.raw() == 1);
    }
    fooled
}

/// The documented limit: a reply that comes later than the late window allows may pass for the answer to the next
/// request of its kind.
#[test]
fn the_late_window_must_be_as_long_as_the_bus_holds_frames_back() {
    let ms = Duration::from_millis;
    // The window of 40 ms begins when the request is given up, after 20 ms.
    for delay in [25, 40, 55] {
        assert!(!is_fooled(ms(delay), ms(40)), "{delay} ms");
    }
    assert!(is_fooled(ms(70), ms(40)), "if this holds now, the documentation can promise more");
    assert!(!is_fooled(ms(70), ms(80)));
}

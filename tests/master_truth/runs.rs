//! The runs.

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
/// Requests in each scenario. With twelve troubles in sixteen scenarios each that is 307 200 on CAN and 57 600 on
/// RS485, whose bytes take longer to simulate.
const ON_CAN: u64 = 1_600;
const ON_RS485: u64 = 300;
/// Drawn scenarios, and requests of each: 750 000 on both buses, so that all are a million and more.
const DRAWN_ON_CAN: u64 = 640;
const DRAWN_ON_RS485: u64 = 110;
const DRAWN_REQUESTS: u64 = 1_000;
/// This many tests share them, to run in parallel.
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
        // But a run time that was not read may wrap, and then its drive seems to have restarted.
        let mut excused = totals.excused.clone();
        let begun_anew = excused.remove(&Excuse::RunTimeBeganAnew).unwrap_or(0);
        assert!(begun_anew == 0 || scenario.conditions.have_run, "{told}");
        assert_eq!(totals.restarted, begun_anew, "{told}");
        assert!(excused.is_empty(), "{told}");
    }
    // Some worlds are down, or stopped, for most of the time.
    let ended_early = totals.failed(Why::BusDown) + totals.failed(Why::Stopped);
    let of_others = totals.requests - ended_early;
    assert!(totals.replies * 10 > of_others, "hardly any answers: {told}");
}

/// Every rate and several numbers of motors with this trouble.
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
        run::<W>(Scenario::drawn::<W>(seed, DRAWN_REQUESTS));
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
fn what_once_broke() {
    // A clock jumps. Then a motor is first heard that had answered only with what looks like an echo: its silence is
    // reported once more.
    once::<Rs485Line>(3573);
    // A question to all is in a mailbox when a stop ends it, and is handed back: it was not sent.
    once::<CanBus>(10_003);
    // Two motors with one id answer each other endlessly on a line: a stop does not wait for that.
    once::<Rs485Line>(10_035);
}

fn as_drawn<W: Rough>(seed: u64) {
    run::<W>(Scenario::drawn::<W>(seed, DRAWN_REQUESTS));
}

#[test]
fn what_broke_later() {
    // Two motors with one id answer each other every millisecond, and the clock has steps as long. The line is never
    // seen free, and still nothing waits longer than its bound.
    as_drawn::<Rs485Line>(300_309);
    as_drawn::<Rs485Line>(3_004);
    // A stop that may be in flight already is called again, now of the other kind: it has all its attempts.
    as_drawn::<Rs485Line>(9_194);
    // An answer long after a read of the status does not answer that, and shows nothing of an echo.
    as_drawn::<Rs485Line>(5_123);
    // No caller has looked for an hour when the loop's own question is answered.
    as_drawn::<Rs485Line>(71_135);
    // Noise has destroyed four echoes in a row, and then echoes of set-points say that these were ignored: none is
    // lost.
    as_drawn::<Rs485Line>(700_335);
    // A collision makes a frame that its drive hears. The frame is made up, and from the angle that it says the next
    // one jumps.
    as_drawn::<Rs485Line>(710_003);
    // Noise that looks like a reply in motion mode begins as if the drive had lost its master.
    as_drawn::<CanBus>(1_140);
    // A port has failed when a task was dropped, and all are told to end their motion before its next round.
    as_drawn::<CanBus>(500_942);
    // A run time is read shortly before it wraps, and then a silence is reported as a restart: then it is not known any
    // more.
    as_drawn::<Rs485Line>(9_002_221);
    as_drawn::<Rs485Line>(9_000_723);
    as_drawn::<Rs485Line>(9_002_613);
    // Two motors with one id answer a stop, and earlier ones reached neither: the second answer is taken for one to
    // all.
    as_drawn::<CanBus>(9_002_429);
    // The last feedback of a run is late, and the set-point after it is still in flight: it is not counted yet.
    as_drawn::<CanBus>(9_001_529);
    // A motor that was never heard is told to restart, and first heard after an hour: only then is it known to run.
    as_drawn::<CanBus>(9_103_926);
    // A move of all is in a mailbox, and one motor is told to end its motion: that is sent again after the move.
    as_drawn::<CanBus>(9_002_488);
    // No caller has looked for an hour, and a set-point whose time is up since then is handed back before that is
    // reported.
    as_drawn::<CanBus>(9_100_934);
    // A command that lets go of what all hold is handed back when another stop is sent in its place: that may be its
    // first.
    as_drawn::<CanBus>(9_100_933);
    // An echo that noise made pass for a command that a drive ignores is reported after the answer, which comes twice.
    as_drawn::<Rs485Line>(9_101_198);
    // A collision makes an answer of another angle, whose token and check are right.
    as_drawn::<Rs485Line>(9_101_525);
    // An answer that comes twice is taken for that to a command which is handed back then.
    as_drawn::<CanBus>(9_400_910);
    // Another station makes up a move in motion mode, after a request that ends motion: no mailbox has held it back.
    as_drawn::<CanBus>(9_404_136);
    // Nothing goes wrong, and a run time that was not read wraps.
    as_drawn::<Rs485Line>(9_402_152);
    // No caller looks for an hour, in which answers to a stop wait in a port: they come after what ends the motion of
    // all.
    as_drawn::<Rs485Line>(9_410_924);
    // A request to hold that a stop has pushed aside is handed back: to the master it may be what had told its motor to
    // stop.
    as_drawn::<CanBus>(9_411_783);
    // A drive that has lost its master hands back the first read in a second: that is taken for an echo, and the motor
    // is heard with its answer.
    as_drawn::<Rs485Line>(9_420_244);
    // A stop to all waits for its line and is lifted, and all are stopped again. It was not sent to any motor yet, and
    // is sent.
    as_drawn::<Rs485Line>(9_412_258);
    // Deliberate faults that nothing else notices: an answer that is owed confirms a stop; what ends the motion of all
    // is not sent again when it is handed back; what was answered and is handed back counts as answered.
    as_drawn::<CanBus>(2_706);
    as_drawn::<CanBus>(1_827);
    as_drawn::<CanBus>(3_082);
}

/// Runs the drawn scenario of the seed in `MASTER_TRUTH_SEED`, on both buses; without it, nothing.
#[test]
fn alone() {
    let Some(seed) = std::env::var("MASTER_TRUTH_SEED").ok().and_then(|seed| seed.parse().ok())
    else {
        return;
    };
    run::<CanBus>(Scenario::drawn::<CanBus>(seed, DRAWN_REQUESTS));
    run::<Rs485Line>(Scenario::drawn::<Rs485Line>(seed, DRAWN_REQUESTS));
}

/// The consequence of a late reply that the drive's wire has held back for `delay`: whether the second of two equal
/// requests gets the first one's answer.
fn is_fooled(delay: Duration, late_window: Duration) -> bool {
    let config = Config { late_window, ..CanBus::CONFIG };
    let mut rig = Rig::<CanBus>::with_config(1, 1, config);
    let motor = id(1);
    rig.world.set_faults(Direction::ToPorts, late_by(delay));
    let once = Patience { reply_timeout: Duration::from_millis(20), attempts: 1 };
    let (first, second) = (angle(1), angle(2));
    assert!(rig.runner.ask_with(motor, first, Some(once), |_| {}).is_err());
    // The bus is well again, but the first reply is still on its way.
    rig.world.set_faults(Direction::ToPorts, FaultPlan::NONE);
    let mut fooled = false;
    for _ in 0..20 {
        let answer = rig.runner.ask_with(motor, second, Some(once), |_| {});
        fooled |= matches!(answer, Ok(reply) if reply.angle.raw() == 1);
    }
    fooled
}

/// The documented limit: what comes later than the late window allows may be taken for the answer to
/// the next request of its kind.
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

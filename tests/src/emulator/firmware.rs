//! A board's firmware, its drives, and checks of both ends.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant as WallTime};

use myactuator_host_std::sim::{DriveHandle, Fleet};
use myactuator_protocol_core::time::Instant;

use super::board::{Board, Wire};
use super::drives::{Adapter, Drives};
use super::image;
use super::log::{Line, Mark, Second};
use super::panel::Breakage;
use super::truth::{Look, Truth};
use super::urgency::{REPLY_TIMEOUT, Stalls};
use super::{Emulated, Failure};

/// They run in real time, so several at once would be late.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// A drive confirms a stop before its shaft has come to rest.
const COMES_TO_REST: Duration = Duration::from_millis(20);
/// The application runs a cycle each millisecond. If this many of a second are missing, the emulator stood still.
const CYCLES: u32 = 1_000;
const STOOD_STILL: u32 = 15;
/// Lines of the log that are shown when something is wrong.
const TAIL: usize = 40;

/// A firmware that runs. Everything ends when this is dropped.
///
/// Its methods panic if a test has failed, with the end of the log.
#[derive(Debug)]
pub struct Firmware {
    emulated: Emulated,
    /// What the shafts really did.
    pub truth: Truth,
    /// How often the machine was busy with something else.
    pub stalls: Stalls,
    /// The point up to which the log was read.
    read: Mark,
    /// The cycles that the application last reported.
    cycles: u32,
    /// Replies that were too late because the emulator stood still or was slow.
    stood_still: usize,
    _alone: MutexGuard<'static, ()>,
}

impl Firmware {
    /// Starts a board's program, which is named after its bus, with these drives, behind this adapter.
    ///
    /// # Panics
    /// If it does not start: what is missing, and how to get it.
    pub fn start(board: Board, program: &str, fleet: &Fleet, adapter: Adapter) -> Self {
        let alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        match Self::try_start(board, program, fleet, adapter, alone) {
            Ok(firmware) => firmware,
            Err(error) => panic!("{program} of {board} does not start: {error}"),
        }
    }

    fn try_start(
        board: Board,
        program: &str,
        fleet: &Fleet,
        adapter: Adapter,
        alone: MutexGuard<'static, ()>,
    ) -> Result<Self, Failure> {
        let wire = Wire::of_program(program)?;
        let image = image::find(board, program)?;
        let drives = Drives::new(fleet, wire)?.behind(adapter);
        drives.listen();
        let truth = Truth::observe(drives.handles().to_vec());
        // Before the emulator starts, since they have the same priority.
        let stalls = Stalls::count();
        let emulated = Emulated::start(board, wire, &image, drives, |_| {})?;
        let read = Mark::default();
        Ok(Self { emulated, truth, stalls, read, cycles: 0, stood_still: 0, _alone: alone })
    }

    /// The drives that it moves.
    pub fn drives(&self) -> &Drives {
        &self.emulated.drives
    }

    /// A drive, by its id.
    pub fn drive(&self, id: usize) -> &DriveHandle {
        &self.emulated.drives.handles()[id - 1]
    }

    /// Presses the button.
    #[track_caller]
    pub fn press(&mut self) {
        let pressed = self.emulated.panel.press();
        self.expect(pressed);
    }

    /// Holds the button until that is a long press.
    #[track_caller]
    pub fn hold(&mut self) {
        let held = self.emulated.panel.hold();
        self.expect(held);
    }

    /// Breaks the firmware. Returns when, on the drives' clock.
    pub fn break_it(&mut self, how: Breakage) -> Instant {
        let now = self.emulated.drives.now();
        let broken = self.emulated.panel.break_it(how);
        self.expect(broken);
        now
    }

    /// Whether the light is on.
    pub fn is_light_on(&mut self) -> bool {
        let is_on = self.emulated.panel.is_light_on();
        self.expect(is_on)
    }

    /// The next line of the log that begins with `text`; those before it are skipped.
    #[track_caller]
    pub fn wait_for(&mut self, text: &str, within: Duration) -> Line {
        match self.emulated.log.wait(self.read, within, |line| line.text.starts_with(text)) {
            Some((line, read)) => {
                self.read = read;
                line
            }
            None => self.fail(&format!("the firmware does not say \"{text}\" within {within:?}")),
        }
    }

    /// The next second that the application reports.
    #[track_caller]
    pub fn wait_for_second(&mut self) -> Second {
        let line = self.wait_for("Second", Duration::from_secs(3));
        let Some(second) = line.second() else {
            self.fail(&format!("this is no second: {line}"));
        };
        // They start again with each motion.
        let before = if self.cycles < second.cycles { self.cycles } else { 0 };
        let missing = CYCLES.saturating_sub(second.cycles - before);
        if missing >= STOOD_STILL {
            // A master repeats a command after this many milliseconds, so each of these may cost a reply.
            let late = missing / REPLY_TIMEOUT.as_millis() as u32 + 1;
            // The set-point of each drive, and the question that one of them is asked besides.
            self.stood_still += late as usize * (self.drives().handles().len() + 1);
        }
        self.cycles = second.cycles;
        second
    }

    /// How many replies may have come too late so far because the machine was busy with something else, or the emulator
    /// itself stood still.
    pub fn excused(&self) -> usize {
        self.stalls.excused() + self.stood_still
    }

    /// The lines that were not read yet. They stay so.
    pub fn unread(&self) -> Vec<Line> {
        self.emulated.log.since(self.read)
    }

    /// All lines from the start.
    pub fn reports(&self) -> Vec<Line> {
        self.emulated.log.since(Mark::default())
    }

    /// Skips the log until now.
    pub fn skip(&mut self) {
        self.read = self.emulated.log.mark();
    }

    /// Fails unless the log could be read without a gap.
    #[track_caller]
    pub fn check_log(&self) {
        let garbled = self.emulated.log.garbled();
        if garbled > 0 {
            self.fail(&format!("{garbled} lines of the log cannot be read"));
        }
    }

    /// Waits until all shafts turn faster than this, by their mean speed, and returns when that was. If set-points are
    /// few, shafts move in steps.
    #[track_caller]
    pub fn wait_until_moving(&self, speed_dps: f32) -> Instant {
        let until = WallTime::now() + Duration::from_secs(4);
        while WallTime::now() < until {
            if self.truth.mean_dps().iter().all(|mean| mean.abs() > speed_dps) {
                return self.drives().now();
            }
            thread::sleep(Duration::from_millis(2));
        }
        self.fail(&format!("not all motors turn at {speed_dps} degrees a second"))
    }

    /// The state of all drives now.
    pub fn looks(&self) -> Vec<Look> {
        self.drives().handles().iter().map(Look::at).collect()
    }

    /// This, and the longest time for which the machine was busy with something else.
    pub fn with_stalls(&self, within: Duration) -> Duration {
        within + self.stalls.longest()
    }

    /// Fails unless all these shafts stood still from this long after `since` until now. The delay of the machine
    /// itself is added to that. Call it a while after that.
    #[track_caller]
    pub fn check_still(&self, since: Instant, within: Duration) {
        let (moved_for, within) = (self.truth.moved_for(since), self.with_stalls(within));
        if moved_for.iter().any(|&moved_for| moved_for > within) {
            self.fail(&format!("shafts moved for {moved_for:?}, which is longer than {within:?}"));
        }
    }

    /// Fails unless nothing moves in the next `span`, except for the moment in which shafts come to rest, and the
    /// application starts nothing.
    #[track_caller]
    pub fn check_stays_stopped(&mut self, span: Duration) {
        self.skip();
        let since = self.drives().now();
        thread::sleep(span);
        self.check_still(since, COMES_TO_REST);
        if !self.unread().is_empty() {
            self.fail(&format!(
                "nobody has pressed the button, yet the firmware says: {:?}",
                self.unread()
            ));
        }
    }

    /// Fails, and shows what there is to see.
    #[track_caller]
    pub fn fail(&self, what: &str) -> ! {
        let Emulated { log, qemu, drives, .. } = &self.emulated;
        let ended = if log.is_open() { "" } else { ", and the emulator has ended" };
        let looks: String = self.looks().iter().map(|look| format!("  {look:?}\n")).collect();
        panic!(
            "{what}\nthe end of the log{ended}:\n{}drives:\n{looks}simulation: {:?}\nemulator: {:?}\n\
             this machine kept threads waiting for up to {:?}: that excuses {} lost replies",
            log.tail(TAIL),
            drives.notices(),
            qemu.complaints(),
            self.stalls.longest(),
            self.excused(),
        )
    }

    #[track_caller]
    fn expect<T>(&self, result: Result<T, Failure>) -> T {
        result.unwrap_or_else(|error| self.fail(&error.to_string()))
    }
}

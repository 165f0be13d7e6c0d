//! A board's firmware with its drives, and checks of both ends.

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
use super::processor::{REPLY_TIMEOUT, Stalls};
use super::truth::{Sample, Truth};
use super::{Emulated, Failure};

/// Tests run in real time. Several at once would delay each other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// How long a shaft may still move after its drive has confirmed a stop.
const COMES_TO_REST: Duration = Duration::from_millis(20);
/// The cycle of the emulated boards. If so many cycles of a second are missing, the emulator stood still.
const CYCLE: Duration = Duration::from_millis(20);
const CYCLES: u32 = 50;
const STOOD_STILL: u32 = 2;
/// The number of lines of the log that a failure shows.
const TAIL: usize = 40;

/// Running firmware. Everything ends when this is dropped.
///
/// If a check fails, the methods panic with the end of the log.
#[derive(Debug)]
pub struct Firmware {
    emulated: Emulated,
    /// The true motion of the shafts.
    pub truth: Truth,
    /// How long the machine was busy with other work.
    pub stalls: Stalls,
    /// The point up to which the log was read.
    read: Mark,
    /// The cycles that the application reported last.
    cycles: u32,
    /// The number of replies that may have been late because the emulator stood still or was slow.
    stood_still: usize,
    _alone: MutexGuard<'static, ()>,
}

impl Firmware {
    /// Starts a board's program, which is named after its bus, with these drives and this adapter.
    ///
    /// # Panics
    /// If the program does not start: what is missing, and how to get it.
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
        let drives = Drives::new(fleet, wire)?.with_adapter(adapter);
        drives.listen();
        let truth = Truth::observe(drives.handles().to_vec());
        // Before the emulator starts, whose first bytes may be late otherwise.
        let stalls = Stalls::count();
        let emulated = Emulated::start(board, wire, &image, drives, |_| {})?;
        let read = Mark::default();
        Ok(Self { emulated, truth, stalls, read, cycles: 0, stood_still: 0, _alone: alone })
    }

    /// The drives on the bus.
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

    /// Holds the button for a long press.
    #[track_caller]
    pub fn hold(&mut self) {
        let held = self.emulated.panel.hold();
        self.expect(held);
    }

    /// Breaks the firmware. Returns the time on the drives' clock.
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

    /// Waits for the next line of the log that begins with `text`, and skips those before it.
    #[track_caller]
    pub fn wait_for(&mut self, text: &str, within: Duration) -> Line {
        match self.emulated.log.wait(self.read, within, |line| line.text.starts_with(text)) {
            Some((line, read)) => {
                self.read = read;
                line
            }
            None => self
                .fail(&format!("expected the log line \"{text}\" within {within:?}, found none")),
        }
    }

    /// Waits for the application's next report of a second.
    #[track_caller]
    pub fn wait_for_second(&mut self) -> Second {
        let line = self.wait_for("Second", Duration::from_secs(3));
        let Some(second) = line.second() else {
            self.fail(&format!("expected the report of a second, found \"{line}\""));
        };
        // The count starts again with each motion.
        let before = if self.cycles < second.cycles { self.cycles } else { 0 };
        let missing = CYCLES.saturating_sub(second.cycles - before);
        if missing >= STOOD_STILL {
            // A master repeats a command after this time-out, so each time-out may cost a reply.
            let late = (missing * CYCLE).as_millis() / REPLY_TIMEOUT.as_millis() + 1;
            // In flight are the set-point of each drive, and a query of one of them.
            self.stood_still += late as usize * (self.drives().handles().len() + 1);
        }
        self.cycles = second.cycles;
        second
    }

    /// How many replies may have been late so far because the machine was busy with other work, or the emulator itself
    /// stood still.
    pub fn excused(&self) -> usize {
        self.stalls.excused() + self.stood_still
    }

    /// The lines that were not read yet. They stay unread.
    pub fn unread(&self) -> Vec<Line> {
        self.emulated.log.since(self.read)
    }

    /// All lines since the start.
    pub fn reports(&self) -> Vec<Line> {
        self.emulated.log.since(Mark::default())
    }

    /// Skips the log so far.
    pub fn skip(&mut self) {
        self.read = self.emulated.log.mark();
    }

    /// Fails unless the whole log could be decoded.
    #[track_caller]
    pub fn check_log(&self) {
        let garbled = self.emulated.log.garbled();
        if garbled > 0 {
            self.fail(&format!("{garbled} frames of the log cannot be decoded"));
        }
    }

    /// Waits until the mean speed of all shafts is above this, and returns the time. It is the mean speed because
    /// shafts move in steps if set-points are few.
    #[track_caller]
    pub fn wait_until_moving(&self, speed_dps: f32) -> Instant {
        let until = WallTime::now() + Duration::from_secs(4);
        while WallTime::now() < until {
            if self.truth.mean_dps().iter().all(|mean| mean.abs() > speed_dps) {
                return self.drives().now();
            }
            thread::sleep(Duration::from_millis(2));
        }
        self.fail(&format!(
            "expected all shafts above {speed_dps} degrees per second, found {:?}",
            self.truth.mean_dps()
        ))
    }

    /// The state of each drive now.
    pub fn samples(&self) -> Vec<Sample> {
        self.drives().handles().iter().map(Sample::at).collect()
    }

    /// This time plus the longest for which the machine was busy with other work in a tenth of a second.
    pub fn with_stalls(&self, within: Duration) -> Duration {
        within + self.stalls.longest()
    }

    /// Fails unless all shafts have stood still since `within` after `since`, plus the delay of the machine itself.
    /// Call this some time later, so that it sees a shaft that moves too long.
    #[track_caller]
    pub fn check_still(&self, since: Instant, within: Duration) {
        let (moved_for, within) = (self.truth.moved_for(since), self.with_stalls(within));
        if moved_for.iter().any(|&moved_for| moved_for > within) {
            self.fail(&format!(
                "expected shafts to stop within {within:?}, they moved for {moved_for:?}"
            ));
        }
    }

    /// Fails unless nothing moves in the next `span`, except for the time in which shafts come to rest, and the
    /// application reports nothing.
    #[track_caller]
    pub fn check_stays_stopped(&mut self, span: Duration) {
        self.skip();
        let since = self.drives().now();
        thread::sleep(span);
        self.check_still(since, COMES_TO_REST);
        if !self.unread().is_empty() {
            self.fail(&format!(
                "expected no log line, as the button was not pressed, found {:?}",
                self.unread()
            ));
        }
    }

    /// Fails, and shows the log, the drives and the delays of the machine.
    #[track_caller]
    pub fn fail(&self, what: &str) -> ! {
        let Emulated { log, qemu, drives, .. } = &self.emulated;
        let ended = if log.is_open() { "" } else { " (the emulator has ended)" };
        let samples: String =
            self.samples().iter().map(|sample| format!("  {sample:?}\n")).collect();
        panic!(
            "{what}\nthe end of the log{ended}:\n{}drives:\n{samples}simulation: {:?}\nemulator: {:?}\n\
             this machine kept threads waiting for up to {:?} of a tenth of a second, and excuses {} lost replies",
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

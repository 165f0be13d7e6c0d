//! A board with its drives.

use std::path::Path;

use tempfile::TempDir;

use super::Failure;
use super::board::{Board, Wire};
use super::drives::Drives;
use super::log::{Line, Log};
use super::panel::Panel;
use super::qemu::Qemu;
use super::socket::Waiting;

/// A board that runs, and the drives that it moves. All end when this is dropped.
#[derive(Debug)]
pub struct Emulated {
    /// What the firmware reports.
    pub log: Log,
    /// The button.
    pub panel: Panel,
    /// The drives. They end before the emulator, which would otherwise be missing for them.
    pub drives: Drives,
    /// The emulator.
    pub qemu: Qemu,
    _folder: TempDir,
}

impl Emulated {
    /// Starts a board with these drives. Calls `tell` with each line that the firmware logs.
    ///
    /// # Errors
    /// What is missing, and how to get it.
    pub fn start(
        board: Board,
        wire: Wire,
        image: &Path,
        mut drives: Drives,
        tell: impl FnMut(&Line) + Send + 'static,
    ) -> Result<Self, Failure> {
        let folder = tempfile::tempdir()?;
        let [bus, panel] = ["bus", "panel"].map(|name| folder.path().join(name));
        let (bus_end, panel_end) = (Waiting::at(&bus)?, Waiting::at(&panel)?);
        let (qemu, output) = Qemu::start(board, wire, image, &bus, &panel)?;
        let log = Log::decode(image, output, tell)?;
        let connect = |end: Waiting| {
            end.connect(|| log.is_open()).map_err(|error| format!("{error}: {}", qemu.complaints()))
        };
        drives.serve(connect(bus_end)?)?;
        let panel = Panel::new(connect(panel_end)?);
        Ok(Self { log, panel, drives, qemu, _folder: folder })
    }
}

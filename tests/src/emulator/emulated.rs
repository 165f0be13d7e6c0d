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

/// A running board, and the drives that it moves. Everything ends when this is dropped.
#[derive(Debug)]
pub struct Emulated {
    /// The log of the firmware.
    pub log: Log,
    /// The button.
    pub panel: Panel,
    /// The drives. They end before the emulator: otherwise they would report it as lost.
    pub drives: Drives,
    /// The emulator.
    pub qemu: Qemu,
    _folder: TempDir,
}

impl Emulated {
    /// Starts a board with these drives. Calls `on_line` with each line that the firmware logs.
    ///
    /// # Errors
    /// A sentence: what is missing, and how to get it.
    pub fn start(
        board: Board,
        wire: Wire,
        image: &Path,
        mut drives: Drives,
        on_line: impl FnMut(&Line) + Send + 'static,
    ) -> Result<Self, Failure> {
        let folder = tempfile::tempdir()?;
        let [bus, panel] = ["bus", "panel"].map(|name| folder.path().join(name));
        let (bus_end, panel_end) = (Waiting::at(&bus)?, Waiting::at(&panel)?);
        let (qemu, output) = Qemu::start(board, wire, image, &bus, &panel)?;
        let log = Log::decode(image, output, on_line)?;
        let connect = |end: Waiting| {
            end.connect(|| log.is_open()).map_err(|error| format!("{error}: {}", qemu.complaints()))
        };
        drives.serve(connect(bus_end)?)?;
        let panel = Panel::new(connect(panel_end)?);
        Ok(Self { log, panel, drives, qemu, _folder: folder })
    }
}

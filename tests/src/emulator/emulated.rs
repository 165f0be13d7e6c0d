//! A board with its drives.

use std::path::Path;

use tempfile::TempDir;

use super::Failure;
use super::board::{Board, Wire};
use super::drives::Drives;
use super::log::{Line, Log};
use super::panel::{Panel, Waiting};
use super::qemu::Qemu;
use super::urgency;

/// A board that runs, and the drives that it moves. All end when this is dropped.
#[derive(Debug)]
pub struct Emulated {
    /// What the firmware tells.
    pub log: Log,
    /// The button.
    pub panel: Panel,
    /// The emulator.
    pub qemu: Qemu,
    /// The drives.
    pub drives: Drives,
    _folder: TempDir,
}

impl Emulated {
    /// Starts a board with these drives; calls `tell` with each line that the firmware tells.
    ///
    /// # Errors
    /// What is missing, and how to get it.
    pub fn start(
        board: Board,
        wire: Wire,
        image: &Path,
        drives: Drives,
        tell: impl FnMut(&Line) + Send + 'static,
    ) -> Result<Self, Failure> {
        let folder = tempfile::tempdir()?;
        let socket = folder.path().join("panel");
        let waiting = Waiting::at(&socket)?;
        let (qemu, output) = Qemu::start(board, wire, image, drives.path(), &socket)?;
        let log = Log::decode(image, output, tell)?;
        let panel = waiting
            .connect(|| log.is_open())
            .map_err(|error| format!("{error}: {}", qemu.complaints()))?;
        urgency::take();
        Ok(Self { log, panel, qemu, drives, _folder: folder })
    }
}

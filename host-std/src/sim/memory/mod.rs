//! What a simulated drive remembers over power-off: in the process, or in a [file](FileStore). It
//! knows neither bus nor physics.

mod file_store;

use std::fmt;
use std::path::PathBuf;

use myactuator_protocol_core::drive::{Memory, Settings};

pub use file_store::{Damage, FileStore, StoreError};

/// A drive's non-volatile memory: in this process, or in a file.
#[derive(Debug)]
pub enum DriveMemory {
    /// As long as the simulation lives.
    Process(Option<Settings>),
    /// In a file, safe against a crash in the middle of a write.
    File(FileStore<Settings>),
}

impl DriveMemory {
    /// A memory in this file, which need not exist.
    pub fn in_file(path: impl Into<PathBuf>) -> Self {
        Self::File(FileStore::new(path))
    }
}

/// The file of a drive's memory cannot be read or written.
#[derive(Debug)]
pub struct MemoryError(StoreError);

impl fmt::Display for MemoryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for MemoryError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.0)
    }
}

impl Memory for DriveMemory {
    type Error = MemoryError;

    fn load(&mut self) -> Result<Option<Settings>, MemoryError> {
        match self {
            Self::Process(settings) => Ok(*settings),
            Self::File(store) => store.load().map_err(MemoryError),
        }
    }

    fn store(&mut self, settings: &Settings) -> Result<(), MemoryError> {
        match self {
            Self::Process(kept) => {
                *kept = Some(*settings);
                Ok(())
            }
            Self::File(store) => store.store(settings).map_err(MemoryError),
        }
    }
}

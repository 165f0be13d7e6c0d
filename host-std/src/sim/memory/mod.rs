//! What a simulated drive remembers over power-off: in the process, or in a [file](FileStore). It
//! knows neither bus nor physics.

mod file_store;

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

impl Memory for DriveMemory {
    type Error = StoreError;

    fn load(&mut self) -> Result<Option<Settings>, StoreError> {
        match self {
            Self::Process(settings) => Ok(*settings),
            Self::File(store) => store.load(),
        }
    }

    fn store(&mut self, settings: &Settings) -> Result<(), StoreError> {
        match self {
            Self::Process(kept) => {
                *kept = Some(*settings);
                Ok(())
            }
            Self::File(store) => store.store(settings),
        }
    }
}

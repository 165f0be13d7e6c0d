//! What a simulated drive remembers while it is off: in the process, or in a file that is safe against
//! a crash in the middle of a write. This module knows neither bus nor physics.
//!
//! The file is text: a line with a checksum, then JSON.
//!
//! ```text
//! myactuator-store 1 length 17 crc32 9b1d3a2c
//! {"speed_kp":0.05}
//! ```
//!
//! New settings are written to a second file beside it, flushed to the disk, and then replace the old ones by a
//! rename, which is atomic. Whenever the power fails, the next start reads either the old settings or the new ones.
//! The checksum shows damage by a failing disk or an editor. A damaged file is never guessed at, and is left in place
//! for a person to look at.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crc::{CRC_32_ISO_HDLC, Crc};
use myactuator_protocol_core::drive::{Memory, Settings};
use serde::Serialize;
use serde::de::DeserializeOwned;

const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// A drive's non-volatile memory.
#[derive(Debug)]
pub enum DriveMemory {
    /// What was last stored, for as long as the simulation lives.
    Process(Option<Settings>),
    /// This file. It need not exist, but its folder must when something is stored. It has one writer
    /// at a time.
    File(PathBuf),
}

impl Memory for DriveMemory {
    type Error = StoreError;

    fn load(&mut self) -> Result<Option<Settings>, StoreError> {
        match self {
            Self::Process(settings) => Ok(*settings),
            Self::File(path) => load(path),
        }
    }

    fn store(&mut self, settings: &Settings) -> Result<(), StoreError> {
        match self {
            Self::Process(kept) => {
                *kept = Some(*settings);
                Ok(())
            }
            Self::File(path) => store(path, settings),
        }
    }
}

pub(super) fn load<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, StoreError> {
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(StoreError::io("read", path)(error)),
    };
    let json =
        unframe(&bytes).map_err(|damage| StoreError::Damaged { path: path.to_owned(), damage })?;
    serde_json::from_slice(json).map(Some).map_err(StoreError::content(path))
}

fn store(path: &Path, settings: &Settings) -> Result<(), StoreError> {
    let file = write_beside(path, settings)?;
    file.sync_all().map_err(StoreError::io("flush", path))?;
    put_in_place(path)?;
    // The rename itself is on the disk once the folder is flushed.
    let folder = path.parent().filter(|folder| *folder != Path::new(""));
    File::open(folder.unwrap_or(Path::new(".")))
        .and_then(|folder| folder.sync_all())
        .map_err(StoreError::io("flush the folder of", path))
}

/// Stores as for a memory, but without the flush to the disk, which takes long.
pub(super) fn store_unflushed(path: &Path, kept: &impl Serialize) -> Result<(), StoreError> {
    write_beside(path, kept)?;
    put_in_place(path)
}

fn write_beside(path: &Path, kept: &impl Serialize) -> Result<File, StoreError> {
    let json = serde_json::to_vec(kept).map_err(StoreError::content(path))?;
    let mut file = File::create(beside(path)).map_err(StoreError::io("create", path))?;
    file.write_all(&frame(&json)).map_err(StoreError::io("write", path))?;
    Ok(file)
}

fn put_in_place(path: &Path) -> Result<(), StoreError> {
    fs::rename(beside(path), path).map_err(StoreError::io("replace", path))
}

/// The file that is written before it replaces the other: same folder, hence same disk.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".new");
    name.into()
}

fn header(json: &[u8]) -> String {
    format!("myactuator-store 1 length {} crc32 {:08x}\n", json.len(), CRC32.checksum(json))
}

fn frame(json: &[u8]) -> Vec<u8> {
    [header(json).as_bytes(), json, b"\n"].concat()
}

/// The JSON inside, if the file is what [`frame`] writes, to the byte.
fn unframe(bytes: &[u8]) -> Result<&[u8], Damage> {
    let head_end = bytes.iter().position(|&byte| byte == b'\n').ok_or(Damage::NoHeader)?;
    let (head, body) = bytes.split_at(head_end + 1);
    if !head.starts_with(b"myactuator-store 1 ") {
        return Err(Damage::NoHeader);
    }
    let (last, json) = body.split_last().ok_or(Damage::Checksum)?;
    if *last == b'\n' && head == header(json).as_bytes() { Ok(json) } else { Err(Damage::Checksum) }
}

/// What is wrong with a damaged file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Damage {
    /// It does not begin like a file of a memory: empty, cut off early, or another file.
    #[error("it does not begin with \"myactuator-store 1\" and a checksum")]
    NoHeader,
    /// Length or checksum do not fit the content: cut off, or changed.
    #[error("its content does not have the length and checksum of its first line")]
    Checksum,
}

/// Why settings were not loaded or stored. After a failed store the previous settings are still there.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The file system reports an error.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried, as a verb.
        action: &'static str,
        /// The memory's file.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// The file is not as it was written.
    #[error(
        "{} is damaged: {damage}. Restore it from a copy, or delete it to begin anew",
        path.display()
    )]
    Damaged {
        /// The memory's file.
        path: PathBuf,
        /// What is wrong with it.
        damage: Damage,
    },
    /// The file is intact, but holds something else.
    #[error(
        "the content for {} does not fit: {source}. It may stem from another version",
        path.display()
    )]
    Content {
        /// The memory's file.
        path: PathBuf,
        /// What was expected and found.
        source: serde_json::Error,
    },
}

impl StoreError {
    fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.to_owned(), source }
    }

    fn content(path: &Path) -> impl FnOnce(serde_json::Error) -> Self {
        move |source| Self::Content { path: path.to_owned(), source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::MotorId;
    use myactuator_protocol_core::command::BaudCode;
    use myactuator_protocol_core::drive::Gains;

    fn settings(saved_position: i64) -> Settings {
        let gains = Gains::tuned(0.02, 2.0, 100.0);
        let factory = Settings::factory(MotorId::MIN, gains, BaudCode::CAN_1M_RS485_500K);
        Settings { saved_position: Some(saved_position), ..factory }
    }

    fn file_in(folder: &tempfile::TempDir) -> PathBuf {
        folder.path().join("motor-1.json")
    }

    /// CRC-32 of "123456789" is CBF43926 in every catalogue of CRCs.
    #[test]
    fn the_checksum_is_the_common_crc32() {
        assert_eq!(header(b"123456789"), "myactuator-store 1 length 9 crc32 cbf43926\n");
    }

    /// A crash before the rename leaves any part of the new file beside the old one.
    #[test]
    fn a_crash_while_writing_leaves_the_settings_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = file_in(&folder);
        // Before anything was ever stored.
        fs::write(beside(&path), b"myactuator-store 1 len").unwrap();
        assert_eq!(load::<Settings>(&path).unwrap(), None);
        store(&path, &settings(1)).unwrap();
        let new = frame(&serde_json::to_vec(&settings(2)).unwrap());
        for written in 0..=new.len() {
            fs::write(beside(&path), &new[..written]).unwrap();
            assert_eq!(
                load::<Settings>(&path).unwrap(),
                Some(settings(1)),
                "{written} bytes written"
            );
        }
        store(&path, &settings(3)).unwrap();
        assert_eq!(load::<Settings>(&path).unwrap(), Some(settings(3)));
        assert!(!beside(&path).exists());
    }

    #[test]
    fn damaged_file_is_reported_left_as_found_and_can_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = file_in(&folder);
        let whole = frame(br#"{"gain":1}"#);
        let cut_off = (0..whole.len()).map(|length| whole[..length].to_vec());
        let flipped = (0..whole.len() * 8).map(|bit| {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            bytes
        });
        for damaged in cut_off.chain(flipped).chain([b"\0\0\0\0".to_vec()]) {
            fs::write(&path, &damaged).unwrap();
            let error = load::<Settings>(&path).unwrap_err();
            assert!(matches!(error, StoreError::Damaged { .. }), "{damaged:?}: {error}");
            assert!(error.to_string().contains("motor-1.json is damaged"), "{error}");
            assert_eq!(fs::read(&path).unwrap(), damaged);
        }
        store(&path, &settings(4)).unwrap();
        assert_eq!(load::<Settings>(&path).unwrap(), Some(settings(4)));
    }

    #[test]
    fn undamaged_file_with_other_content_is_not_reported_as_damaged() {
        let folder = tempfile::tempdir().unwrap();
        let path = file_in(&folder);
        fs::write(&path, frame(b"[true]")).unwrap();
        assert!(matches!(load::<Settings>(&path), Err(StoreError::Content { .. })));
    }

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none").join("motor.json");
        assert_eq!(load::<Settings>(&path).unwrap(), None);
        let error = store(&path, &settings(1)).unwrap_err().to_string();
        assert!(error.starts_with("cannot create ") && error.contains("none"), "{error}");
    }
}

//! Non-volatile memory in a file, safe against a crash in the middle of a write.
//!
//! [`FileStore`] keeps one value. The file is text: a line with a checksum, then JSON.
//!
//! ```text
//! myactuator-store 1 length 17 crc32 9b1d3a2c
//! {"speed_kp":0.05}
//! ```
//!
//! A new value is written to a second file beside it, flushed to the disk, and put in the place of
//! the old one by a rename, which the disk does wholly or not at all. Whenever the power fails,
//! the next start reads the old value or the new one. What still gets damaged, by a failing disk or
//! an editor, is told by the checksum, never guessed at, and left in place for a person to look at.

use std::fmt;
use std::fs::{self, File};
use std::io::{self, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::Serialize;
use serde::de::DeserializeOwned;

const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// One value of type `T` in a file.
///
/// One store per file at a time: two writers of the same file may take turns, not overlap.
///
/// ```
/// use myactuator_host_std::sim::memory::FileStore;
///
/// # let dir = tempfile::tempdir()?;
/// # let path = dir.path().join("motor-1.json");
/// let store = FileStore::<Vec<u32>>::new(path);
/// assert_eq!(store.load()?, None);
/// store.store(&vec![1, 2, 3])?;
/// assert_eq!(store.load()?, Some(vec![1, 2, 3]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct FileStore<T> {
    path: PathBuf,
    value: PhantomData<fn() -> T>,
}

impl<T: Serialize + DeserializeOwned> FileStore<T> {
    /// A store in this file. Nothing is read or made yet; the folder must be there when a value is
    /// stored.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), value: PhantomData }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The value stored last; `None` where nothing was ever stored.
    ///
    /// # Errors
    /// [`StoreError`]: the file cannot be read, is damaged, or holds something else than a `T`.
    pub fn load(&self) -> Result<Option<T>, StoreError> {
        let bytes = match fs::read(&self.path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(self.io("read", error)),
        };
        let json = unframe(&bytes)
            .map_err(|damage| StoreError::Damaged { path: self.path.clone(), damage })?;
        serde_json::from_slice(json)
            .map(Some)
            .map_err(|source| StoreError::Content { path: self.path.clone(), source })
    }

    /// Stores `value` in the place of the one before. When it returns `Ok`, the disk has it; after
    /// an error, the value before is still there.
    ///
    /// # Errors
    /// [`StoreError`]: the value does not survive JSON (an infinite number, say), or the file cannot
    /// be written.
    pub fn store(&self, value: &T) -> Result<(), StoreError> {
        let content = |source| StoreError::Content { path: self.path.clone(), source };
        let json = serde_json::to_vec(value).map_err(content)?;
        // What could not be loaded again must not replace what can.
        serde_json::from_slice::<T>(&json).map_err(content)?;

        let temporary = self.temporary_path();
        let mut file = File::create(&temporary).map_err(|error| self.io("create", error))?;
        file.write_all(&frame(&json)).map_err(|error| self.io("write", error))?;
        file.sync_all().map_err(|error| self.io("flush", error))?;
        drop(file);
        fs::rename(&temporary, &self.path).map_err(|error| self.io("replace", error))?;
        // The rename itself is on the disk once the folder is.
        File::open(self.folder())
            .and_then(|folder| folder.sync_all())
            .map_err(|error| self.io("flush the folder of", error))
    }

    /// The file that is written before it takes the other's place: same folder, hence same disk.
    fn temporary_path(&self) -> PathBuf {
        let mut name = self.path.clone().into_os_string();
        name.push(".new");
        name.into()
    }

    fn folder(&self) -> &Path {
        match self.path.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        }
    }

    fn io(&self, action: &'static str, source: io::Error) -> StoreError {
        StoreError::Io { action, path: self.path.clone(), source }
    }
}

impl<T> fmt::Debug for FileStore<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FileStore").field("path", &self.path).finish()
    }
}

fn header(json: &[u8]) -> String {
    format!("myactuator-store 1 length {} crc32 {:08x}\n", json.len(), CRC32.checksum(json))
}

fn frame(json: &[u8]) -> Vec<u8> {
    let mut bytes = header(json).into_bytes();
    bytes.extend_from_slice(json);
    bytes.push(b'\n');
    bytes
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
    /// It does not begin like a store's file: empty, cut off early, or another file.
    #[error("it does not begin with \"myactuator-store 1\" and a checksum")]
    NoHeader,
    /// Length or checksum do not fit the content: cut off, or changed.
    #[error("its content does not have the length and checksum of its first line")]
    Checksum,
}

/// Why a value was not loaded or stored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The file system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried, as a verb.
        action: &'static str,
        /// The store's file.
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
        /// The store's file.
        path: PathBuf,
        /// What is wrong with it.
        damage: Damage,
    },
    /// The file is as it was written but holds another type, or the value cannot be kept as JSON.
    #[error(
        "the content for {} does not fit: {source}. It may stem from another version",
        path.display()
    )]
    Content {
        /// The store's file.
        path: PathBuf,
        /// What was expected and found.
        source: serde_json::Error,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    type Settings = std::collections::BTreeMap<String, u32>;

    fn settings(gain: u32) -> Settings {
        [("gain".to_owned(), gain), ("offset".to_owned(), 7)].into()
    }

    fn store_in(folder: &tempfile::TempDir) -> FileStore<Settings> {
        FileStore::new(folder.path().join("motor-1.json"))
    }

    /// CRC-32 of "123456789" is CBF43926 in every catalogue of CRCs.
    #[test]
    fn the_checksum_is_the_common_crc32() {
        assert_eq!(header(b"123456789"), "myactuator-store 1 length 9 crc32 cbf43926\n");
    }

    #[test]
    fn keeps_the_last_value() {
        let folder = tempfile::tempdir().unwrap();
        let store = store_in(&folder);
        assert!(store.load().unwrap().is_none());
        store.store(&settings(1)).unwrap();
        store.store(&settings(2)).unwrap();
        assert_eq!(store_in(&folder).load().unwrap(), Some(settings(2)));
        assert!(!store.temporary_path().exists());
    }

    /// A crash before the rename leaves any part of the new file beside the old one.
    #[test]
    fn a_crash_while_writing_leaves_the_value_before() {
        let folder = tempfile::tempdir().unwrap();
        let store = store_in(&folder);
        // Before anything was ever stored.
        fs::write(store.temporary_path(), b"myactuator-store 1 len").unwrap();
        assert_eq!(store.load().unwrap(), None);
        store.store(&settings(1)).unwrap();
        let new = frame(&serde_json::to_vec(&settings(2)).unwrap());
        for written in 0..=new.len() {
            fs::write(store.temporary_path(), &new[..written]).unwrap();
            assert_eq!(store.load().unwrap(), Some(settings(1)), "{written} bytes written");
        }
        store.store(&settings(3)).unwrap();
        assert_eq!(store.load().unwrap(), Some(settings(3)));
        assert!(!store.temporary_path().exists());
    }

    #[test]
    fn a_file_cut_off_at_any_length_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let store = store_in(&folder);
        store.store(&settings(1)).unwrap();
        let whole = fs::read(store.path()).unwrap();
        for length in 0..whole.len() {
            fs::write(store.path(), &whole[..length]).unwrap();
            let error = store.load().unwrap_err();
            assert!(matches!(error, StoreError::Damaged { .. }), "{length} bytes: {error}");
            assert_eq!(fs::read(store.path()).unwrap(), &whole[..length], "left as found");
        }
        fs::write(store.path(), &whole).unwrap();
        assert_eq!(store.load().unwrap(), Some(settings(1)));
    }

    #[test]
    fn any_flipped_bit_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let store = store_in(&folder);
        store.store(&settings(1)).unwrap();
        let whole = fs::read(store.path()).unwrap();
        for bit in 0..whole.len() * 8 {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            fs::write(store.path(), &bytes).unwrap();
            let result = store.load();
            assert!(matches!(result, Err(StoreError::Damaged { .. })), "bit {bit}: {result:?}");
        }
    }

    #[test]
    fn a_damaged_file_can_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let store = store_in(&folder);
        fs::write(store.path(), b"\0\0\0\0").unwrap();
        let error = store.load().unwrap_err().to_string();
        assert!(error.contains("motor-1.json is damaged"), "{error}");
        store.store(&settings(4)).unwrap();
        assert_eq!(store.load().unwrap(), Some(settings(4)));
    }

    #[test]
    fn another_type_is_told_apart_from_damage() {
        let folder = tempfile::tempdir().unwrap();
        let store = store_in(&folder);
        FileStore::<Vec<bool>>::new(store.path()).store(&vec![true]).unwrap();
        assert!(matches!(store.load(), Err(StoreError::Content { .. })));
    }

    /// JSON has no infinity: it would be written as null and be lost.
    #[test]
    fn what_would_not_load_again_does_not_replace_what_does() {
        let folder = tempfile::tempdir().unwrap();
        let store = FileStore::<f64>::new(folder.path().join("gain.json"));
        store.store(&1.5).unwrap();
        assert!(matches!(store.store(&f64::INFINITY), Err(StoreError::Content { .. })));
        assert_eq!(store.load().unwrap(), Some(1.5));
    }

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let store = FileStore::<u32>::new(folder.path().join("none").join("motor.json"));
        assert_eq!(store.load().unwrap(), None);
        let error = store.store(&1).unwrap_err().to_string();
        assert!(error.starts_with("cannot create ") && error.contains("none"), "{error}");
    }
}

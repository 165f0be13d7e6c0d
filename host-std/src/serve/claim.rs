//! Names in the file system that only one simulation has at a time.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

/// A path that only this simulation has for as long as this value lives: that of a link to what it serves, or of a
/// socket.
///
/// It is a lock on a file beside the path, `.NAME.lock`, which is removed with this value. If a process is killed, the
/// file stays and the lock does not.
#[derive(Debug)]
pub struct Claim {
    lock: PathBuf,
    _locked: File,
}

impl Claim {
    /// Claims this path, whatever is there; `None` if another simulation has claimed it.
    ///
    /// # Errors
    /// What the file system reports if the file beside the path cannot be made or locked; also for a path without a
    /// name.
    pub fn on(path: &Path) -> io::Result<Option<Self>> {
        let name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?;
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(".lock");
        let lock = path.with_file_name(hidden);
        loop {
            let file = File::options().create(true).truncate(false).write(true).open(&lock)?;
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => {}
                Err(Errno::WOULDBLOCK) => return Ok(None),
                Err(Errno::INTR) => continue,
                Err(error) => return Err(error.into()),
            }
            // The process that had it may have removed the file since it was opened; the next would lock a new file.
            let locked = file.metadata()?;
            let is_same =
                |found: fs::Metadata| (found.dev(), found.ino()) == (locked.dev(), locked.ino());
            if fs::metadata(&lock).is_ok_and(is_same) {
                return Ok(Some(Self { lock, _locked: file }));
            }
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.lock);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[test]
    fn path_has_one_owner_however_many_threads_claim_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let (owners, claims) = (AtomicU32::new(0), AtomicU32::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..3_000 {
                        let Some(claim) = Claim::on(&path).unwrap() else { continue };
                        assert_eq!(owners.fetch_add(1, Ordering::SeqCst), 0);
                        claims.fetch_add(1, Ordering::Relaxed);
                        std::thread::yield_now();
                        owners.fetch_sub(1, Ordering::SeqCst);
                        drop(claim);
                    }
                });
            }
        });
        assert!(claims.into_inner() > 0);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(Claim::on(Path::new("/")).is_err());
    }
}

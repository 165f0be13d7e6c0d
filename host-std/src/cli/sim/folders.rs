//! Folders that outlive a run: the drives' memories, and links to where they are served.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use myactuator_host_std::serve::Claim;
use rustix::fs::{FlockOperation, flock};

/// The folder of the drives' settings. One simulation at a time can use it.
#[derive(Debug)]
pub(super) struct MemoryFolder {
    path: PathBuf,
    /// Holds the lock.
    _folder: File,
}

impl MemoryFolder {
    /// Opens the folder, and makes it if need be.
    pub(super) fn open(path: &Path) -> Result<Self, String> {
        make(path)?;
        let folder = File::open(path).map_err(|error| fails(path, &error))?;
        flock(&folder, FlockOperation::NonBlockingLockExclusive).map_err(|_| {
            format!(
                "another simulation keeps its drives' memories in {}: end it, or take another folder",
                path.display()
            )
        })?;
        Ok(Self { path: path.to_owned(), _folder: folder })
    }

    /// The subfolder for the drives on this bus.
    pub(super) fn of(&self, bus: &str) -> Result<PathBuf, String> {
        let path = self.path.join(bus);
        make(&path)?;
        Ok(path)
    }
}

fn make(folder: &Path) -> Result<(), String> {
    fs::create_dir_all(folder).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => format!(
            "expected a folder, or a free name, found a file in the way of {}: take another folder",
            folder.display()
        ),
        _ => fails(folder, &error),
    })
}

fn fails(folder: &Path, error: &io::Error) -> String {
    format!("cannot use the folder {}: {error}", folder.display())
}

/// Where pseudo-terminals are.
const PSEUDO_TERMINALS: &str = "/dev/pts";

/// Links to pseudo-terminals. Each belongs to one simulation. They are removed on drop.
#[derive(Debug)]
pub(super) struct Links {
    folder: Option<PathBuf>,
    made: Vec<Link>,
}

#[derive(Debug)]
struct Link {
    path: PathBuf,
    target: PathBuf,
    _claim: Claim,
}

impl Links {
    /// Makes the folder if need be. Without a folder no links are made.
    pub(super) fn in_folder(folder: Option<&Path>) -> Result<Self, String> {
        folder.map_or(Ok(()), make)?;
        Ok(Self { folder: folder.map(Path::to_owned), made: Vec::new() })
    }

    /// Makes a link of this name if links are wanted. Replaces a link of an earlier run, but not one that another
    /// simulation has. Nor one to anything but a pseudo-terminal: a stop for a real bus would go to simulated drives.
    pub(super) fn add(&mut self, name: &str, target: &Path) -> Result<Option<PathBuf>, String> {
        let Some(folder) = &self.folder else { return Ok(None) };
        let link = folder.join(name);
        let claim = Claim::on(&link).map_err(|error| fails(folder, &error))?.ok_or_else(|| {
            let link = link.display();
            format!("another simulation has the link {link}: end it, or take another folder")
        })?;
        let is_link = fs::symlink_metadata(&link).map(|found| found.is_symlink());
        let made = match is_link {
            Ok(false) => Err(io::Error::other("something that is not a link has this name")),
            Ok(true) => match fs::canonicalize(&link) {
                Ok(found) if !found.starts_with(PSEUDO_TERMINALS) => Err(io::Error::other(
                    format!("it is there, and leads to {}: take another folder", found.display()),
                )),
                _ => fs::remove_file(&link).and_then(|()| symlink(target, &link)),
            },
            Err(_) => symlink(target, &link),
        };
        made.map_err(|error| format!("the link {} cannot be made: {error}", link.display()))?;
        let (path, target) = (link.clone(), target.to_owned());
        self.made.push(Link { path, target, _claim: claim });
        Ok(Some(link))
    }
}

impl Drop for Links {
    fn drop(&mut self) {
        for Link { path, target, .. } in &self.made {
            // Somebody may have put something else there by hand.
            if fs::read_link(path).is_ok_and(|found| found == *target) {
                let _ = fs::remove_file(path);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_replace_abandoned_links_and_are_removed_with_their_owner() {
        let folder = tempfile::tempdir().unwrap();
        let links = || Links::in_folder(Some(folder.path())).unwrap();
        let mut first = links();
        let link = first.add("rs485", Path::new("/dev/null")).unwrap().unwrap();
        let mut second = links();
        let message = second.add("rs485", Path::new("/dev/zero")).unwrap_err();
        assert!(message.starts_with("another simulation has the link "), "{message}");
        assert_eq!(fs::read_link(&link).unwrap(), Path::new("/dev/null"));
        second.add("slcan", Path::new("/dev/zero")).unwrap();
        drop(first);
        assert!(fs::symlink_metadata(&link).is_err());
        // The link that a killed simulation has left. Another terminal may have the number now.
        for abandoned in ["/dev/pts/65535", "/dev/pts/ptmx"] {
            let _ = fs::remove_file(&link);
            symlink(abandoned, &link).unwrap();
            let mut next = links();
            next.add("rs485", Path::new("/dev/zero")).unwrap();
            assert_eq!(fs::read_link(&link).unwrap(), Path::new("/dev/zero"));
        }
        drop(second);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        fs::write(&link, "mine").unwrap();
        let mut third = Links::in_folder(Some(folder.path())).unwrap();
        assert!(third.add("rs485", Path::new("/dev/null")).unwrap_err().contains("not a link"));
        drop(third);
        assert_eq!(fs::read_to_string(&link).unwrap(), "mine");
    }

    #[test]
    fn link_to_a_real_port_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("rs485");
        symlink("/dev/null", &link).unwrap();
        let mut links = Links::in_folder(Some(folder.path())).unwrap();
        let message = links.add("rs485", Path::new("/dev/zero")).unwrap_err();
        assert!(message.ends_with("leads to /dev/null: take another folder"), "{message}");
        drop(links);
        assert_eq!(fs::read_link(&link).unwrap(), Path::new("/dev/null"));
    }

    #[test]
    fn one_simulation_has_a_memory_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drives");
        let first = MemoryFolder::open(&path).unwrap();
        assert!(MemoryFolder::open(&path).unwrap_err().contains("another simulation"));
        assert!(first.of("can").unwrap().is_dir());
        drop(first);
        assert!(MemoryFolder::open(&path).is_ok());
        let file = folder.path().join("file");
        fs::write(&file, "mine").unwrap();
        for path in [file.clone(), file.join("drives")] {
            let message = MemoryFolder::open(&path).unwrap_err();
            assert!(message.starts_with("expected a folder, "), "{message}");
            assert!(
                message.ends_with(&format!("{}: take another folder", path.display())),
                "{message}"
            );
        }
    }
}

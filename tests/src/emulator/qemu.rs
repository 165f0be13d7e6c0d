//! The emulator's process.

use std::env;
use std::ffi::OsString;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use super::board::{Board, Port, Wire};
use super::{Failure, target_dir};

const NAME: &str = "qemu-system-arm";

/// Runs the emulator until its standard input is closed: it ends with this process, however that ends. Its standard
/// output ends with it. It has priority over all ordinary processes, if that is allowed. It leaves Ctrl-C in a terminal
/// to others.
const KEEPER: &str = r#"
    trap '' INT HUP TERM
    if chrt --rr 1 true 2>/dev/null; then set -- chrt --rr 1 "$@"; fi
    "$@" </dev/null & emulator=$!
    exec >/dev/null
    read -r _
    kill -9 $emulator
    wait
"#;

/// A running emulator. It ends when this is dropped.
#[derive(Debug)]
pub struct Qemu {
    keeper: Child,
    stdin: Option<ChildStdin>,
    complaints: Arc<Mutex<String>>,
}

/// Where the emulator is.
///
/// # Errors
/// It is missing, and how to get it.
pub fn find() -> Result<PathBuf, Failure> {
    let path = env::var_os("PATH").unwrap_or_default();
    // Where apt-get cannot install it, .ci/run unpacks it there.
    let unpacked = target_dir().join("qemu/usr/bin");
    let places = env::split_paths(&path).chain([unpacked]);
    places.map(|folder| folder.join(NAME)).find(|file| file.is_file()).ok_or_else(|| {
        format!(
            "{NAME} is missing: install it (Debian's package has the same name), or run .ci/run, \
             which brings it"
        )
        .into()
    })
}

impl Qemu {
    /// Starts a board with this firmware, its bus and its panel on sockets that somebody listens at. What
    /// the firmware tells comes out of the second of the two.
    ///
    /// # Errors
    /// A sentence.
    pub fn start(
        board: Board,
        wire: Wire,
        image: &Path,
        bus: &Path,
        panel: &Path,
    ) -> Result<(Self, ChildStdout), Failure> {
        let ports = board.ports(wire).ok_or_else(|| format!("{board} has no way to {wire}"))?;
        let mut keeper = Command::new("/bin/sh")
            .args(["-c", KEEPER, "sh"])
            .arg(find()?)
            .args(["-machine", board.machine(), "-display", "none", "-monitor", "none"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .arg("-chardev")
            .arg(with_path("socket,id=bus,path=", bus))
            .arg("-chardev")
            .arg(with_path("socket,id=panel,path=", panel))
            .args(ports.iter().flat_map(|port| {
                let end = match port {
                    Port::Bus => "chardev:bus",
                    Port::Panel => "chardev:panel",
                    Port::Nothing => "null",
                };
                ["-serial", end]
            }))
            .arg("-kernel")
            .arg(image)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let complaints = Arc::<Mutex<String>>::default();
        let (stdout, stderr) = (keeper.stdout.take(), keeper.stderr.take());
        if let Some(mut stderr) = stderr {
            let complaints = Arc::clone(&complaints);
            thread::spawn(move || {
                let mut chunk = [0; 512];
                while let Ok(length @ 1..) = stderr.read(&mut chunk) {
                    let text = String::from_utf8_lossy(chunk.get(..length).unwrap_or_default());
                    complaints.lock().unwrap_or_else(PoisonError::into_inner).push_str(&text);
                }
            });
        }
        let stdout = stdout.ok_or("the emulator has no output")?;
        Ok((Self { stdin: keeper.stdin.take(), keeper, complaints }, stdout))
    }

    /// What it complained of so far.
    pub fn complaints(&self) -> String {
        self.complaints.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        drop(self.stdin.take());
        // It has nothing else to do than to end.
        let _ = self.keeper.wait();
    }
}

fn with_path(option: &str, path: &Path) -> OsString {
    let mut option = OsString::from(option);
    option.push(path);
    option
}

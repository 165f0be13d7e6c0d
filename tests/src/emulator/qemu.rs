//! The emulator's process.

use std::env;
use std::ffi::OsString;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use super::board::{Board, Port, Wire};
use super::{Failure, processor, target_dir};

const NAME: &str = "qemu-system-arm";

/// Runs the emulator until standard input is closed, so that the emulator ends whenever this process ends. Standard
/// output ends with the emulator, which gets the processor that the first argument names, and goes before other
/// ordinary processes there, if the system allows that. The script ignores Ctrl-C in a terminal.
const KEEPER: &str = r#"
    trap '' INT HUP TERM
    processor=$1; shift
    renice -n -20 -p $$ >/dev/null 2>&1
    if taskset -c $processor true 2>/dev/null; then set -- taskset -c $processor "$@"; fi
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

/// Returns the path of the emulator.
///
/// # Errors
/// A sentence: the emulator is missing, and how to get it.
pub fn find() -> Result<PathBuf, Failure> {
    let path = env::var_os("PATH").unwrap_or_default();
    // If apt-get cannot install the emulator, .ci/run unpacks it there.
    let unpacked = target_dir().join("qemu/usr/bin");
    let places = env::split_paths(&path).chain([unpacked]);
    places.map(|folder| folder.join(NAME)).find(|file| file.is_file()).ok_or_else(|| {
        format!(
            "{NAME} is missing: install it (Debian's package has the same name), or run .ci/run, \
             which installs it"
        )
        .into()
    })
}

impl Qemu {
    /// Starts a board with this firmware. Its bus and its panel connect to the sockets at these paths, which must be
    /// listening. Also returns the stream of the firmware's log.
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
        let ports = board.ports(wire).ok_or_else(|| format!("{board} has no port for {wire}"))?;
        let mut keeper = Command::new("/bin/sh")
            .args(["-c", KEEPER, "sh", &processor::shared().to_string()])
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

    /// What the emulator has written to standard error so far.
    pub fn complaints(&self) -> String {
        self.complaints.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        drop(self.stdin.take());
        // With its input closed, all it does is to end.
        let _ = self.keeper.wait();
    }
}

fn with_path(option: &str, path: &Path) -> OsString {
    let mut option = OsString::from(option);
    option.push(path);
    option
}

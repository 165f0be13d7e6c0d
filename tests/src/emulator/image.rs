//! The image file of the firmware, found or built.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use super::board::Board;
use super::{Failure, target_dir};

/// The target of the boards' firmware.
const TARGET: &str = "thumbv7em-none-eabihf";
/// The environment variable that names a folder of built firmware, as BOARD/PROGRAM.
const FOLDER: &str = "FIRMWARE_DIR";

/// Returns the file of a board's program. If the environment variable `FIRMWARE_DIR` names a folder, this is
/// `BOARD/PROGRAM` in it. Otherwise Cargo builds it now.
///
/// # Errors
/// A sentence: what is missing, and how to get it.
pub fn find(board: Board, program: &str) -> Result<PathBuf, Failure> {
    let Some(folder) = env::var_os(FOLDER) else { return build(board, program) };
    let file = Path::new(&folder).join(board.name()).join(program);
    if !file.is_file() {
        return Err(format!("the folder that {FOLDER} names has no {board}/{program}").into());
    }
    Ok(file)
}

/// Builds the program, and copies it to where another board's program of the same name does not replace it.
fn build(board: Board, program: &str) -> Result<PathBuf, Failure> {
    need_target()?;
    let output = cargo()
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(["build", "--profile", "firmware", "--target", TARGET])
        .args(["--package", board.name(), "--bin", program])
        .args(["--message-format", "json-render-diagnostics"])
        .stderr(Stdio::inherit())
        .output()?;
    if !output.status.success() {
        return Err(format!("Cargo cannot build the program {program} of {board}").into());
    }
    let built = String::from_utf8(output.stdout)?
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["target"]["name"] == program)
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .ok_or_else(|| format!("Cargo does not report where it has built {program} of {board}"))?;
    let folder = target_dir().join("emulated").join(board.name());
    fs::create_dir_all(&folder)?;
    let file = folder.join(program);
    fs::copy(built, &file)?;
    Ok(file)
}

fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

fn need_target() -> Result<(), Failure> {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output =
        Command::new(rustc).args(["--print", "target-libdir", "--target", TARGET]).output()?;
    let library = String::from_utf8(output.stdout)?;
    let is_core = |name: &str| name.starts_with("libcore-") && name.ends_with(".rlib");
    let has_core = fs::read_dir(library.trim()).is_ok_and(|mut files| {
        files.any(|file| file.is_ok_and(|file| file.file_name().to_str().is_some_and(is_core)))
    });
    if has_core {
        return Ok(());
    }
    Err(format!(
        "Rust's library for {TARGET} is missing: install it with `rustup target add {TARGET}`, or \
         run .ci/run, which has another way"
    )
    .into())
}

//! Tells the linker how to lay out the firmware. It is here and not in `.cargo/config.toml`, so that it holds for this
//! package only, and in whichever way Cargo is called.

fn main() {
    println!("cargo::rerun-if-changed=memory.x");
    // cortex-m-rt's link.x includes memory.x, which is next to this file.
    println!("cargo::rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    // In a microcontroller's flash, sections are not aligned to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
    #[cfg(feature = "c")]
    c();
}

/// The C that Rust is compared with.
#[cfg(feature = "c")]
fn c() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../c");
    println!("cargo::rerun-if-changed={folder}");
    cc::Build::new()
        .files(["frames.c", "rs485.c"].map(|file| format!("{folder}/{file}")))
        .opt_level(2)
        .force_frame_pointer(false) // as plain -O2
        .warnings(true)
        .extra_warnings(true)
        .warnings_into_errors(true)
        .compile("frames_in_c");
}

//! Tells the linker how to lay out the firmware. Here rather than in `.cargo/config.toml`, so that
//! it holds for this package alone and however Cargo is called.

fn main() {
    println!("cargo::rerun-if-changed=memory.x");
    // cortex-m-rt's link.x includes memory.x, which lies beside this file.
    println!("cargo::rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    // Sections of a microcontroller's flash are not aligned to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
}

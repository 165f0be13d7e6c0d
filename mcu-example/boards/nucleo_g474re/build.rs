//! Tells the linker how to lay out the firmware. It is here and not in `.cargo/config.toml`, so that it holds for this
//! package only, and in whichever way Cargo is called.

fn main() {
    println!("cargo::rerun-if-changed=memory.x");
    // cortex-m-rt's link.x includes memory.x, which is next to this file.
    println!("cargo::rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    // In a microcontroller's flash, sections are not aligned to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
}

//! Tells the linker how to lay out the firmware.

fn main() {
    println!("cargo::rerun-if-changed=memory.x");
    println!("cargo::rerun-if-changed=device.x");
    // cortex-m-rt's link.x includes memory.x and device.x, which are next to this file.
    println!("cargo::rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    // In a microcontroller's flash, sections are not aligned to the pages of an operating system.
    println!("cargo::rustc-link-arg-bins=--nmagic");
}

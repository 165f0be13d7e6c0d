//! The holding brake (manual 2.27 and 2.28).
//!
//! A brake takes 50 to 150 ms to open. A motor that is driven before that works against it, and a load falls as soon as
//! it opens unless the motor holds (0x81); [`bring_up::release_brake`](crate::io::bring_up::release_brake) takes care
//! of both. Locking takes time, too: a load falls if the output goes off before (0x80).

command! {
    /// Open the brake: 0x77 (2.27). The reply is the same frame, and comes before the brake is open.
    ReleaseBrake -> Self
}

command! {
    /// Close the brake: 0x78 (2.28). The motor cannot run then; without power it is in this state
    /// too. The reply is the same frame, and comes before the brake holds.
    LockBrake -> Self
}

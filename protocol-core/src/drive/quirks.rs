//! What real drives were seen to do beside the manual, each as an option of its own.

use crate::time::Duration;

/// Field behaviour that the manual does not describe. All off by default.
///
/// Some reports need no option, because the manual itself says so: polls of what is reported actively
/// stay unanswered (2.34), and the turns are lost at a restart unless function 4 is on (2.35.4). An
/// adapter's echo is the bus's affair, not the drive's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
pub struct Quirks {
    /// After 0x76 and at power-on the drive hears nothing for [`SLOW_BOOT`](Self::SLOW_BOOT).
    pub slow_boot: bool,
    /// The brake opens [`SLOW_BRAKE_MIN`](Self::SLOW_BRAKE_MIN) to
    /// [`SLOW_BRAKE_MAX`](Self::SLOW_BRAKE_MAX) after the command to. The drive does not wait for it.
    pub slow_brake: bool,
    /// After a communication loss the drive sends a frame 0xF1 once a second; it answers the first
    /// command then with the same bytes and ignores it, and obeys the second if that comes in time.
    pub lost_master_heartbeat: bool,
    /// Function 5 (id change) has its effect but no reply.
    pub silent_id_change: bool,
    /// The turns are lost at every restart, even with function 4 on.
    pub turns_lost: bool,
    /// 0x20, 0x32 and 0xB4 are answered as ever but change nothing unless the motor is shut down
    /// (0x80).
    pub rom_needs_shutdown: bool,
}

impl Quirks {
    /// How long a drive with [`slow_boot`](Self::slow_boot) takes.
    pub const SLOW_BOOT: Duration = Duration::from_millis(1_100);
    /// The shortest that a [`slow_brake`](Self::slow_brake) takes.
    pub const SLOW_BRAKE_MIN: Duration = Duration::from_millis(50);
    /// The longest that a [`slow_brake`](Self::slow_brake) takes.
    pub const SLOW_BRAKE_MAX: Duration = Duration::from_millis(150);
}

//! What real drives were seen to do that the manual does not describe, each as an option of its own.

use crate::time::Duration;

/// Field behaviour that the manual does not describe. All off by default.
///
/// Some reports need no option, because the manual itself says so: polls of what is reported actively stay unanswered
/// (2.34), and the turns are lost at a restart unless function 4 is on (2.35.4). An adapter's echo belongs to the bus
/// and not to the drive; that all motors come with id 1 belongs to a fleet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
pub struct Quirks {
    /// After 0x76 and at power-on the drive hears nothing for [`SLOW_BOOT`](Self::SLOW_BOOT).
    pub slow_boot: bool,
    /// The brake opens or locks [`SLOW_BRAKE_MIN`](Self::SLOW_BRAKE_MIN) to [`SLOW_BRAKE_MAX`](Self::SLOW_BRAKE_MAX)
    /// after its command. The drive does not wait for it to open. After 0x78 the drive goes on holding until the brake
    /// does; 0x80 and errors switch the output off at once.
    pub slow_brake: bool,
    /// After a communication loss the drive sends a frame 0xF1 once a second. It then answers the first command with
    /// the same bytes and ignores it, and obeys the second if that comes in time.
    pub lost_master_heartbeat: bool,
    /// Function 5 (id change) has its effect but no reply.
    pub silent_id_change: bool,
    /// The turns are lost at every restart, even with function 4 on.
    pub turns_lost: bool,
    /// 0x20, 0x32 and 0xB4 are answered as ever but change nothing unless the motor is shut down
    /// (0x80).
    pub rom_needs_shutdown: bool,
    /// A command that the drive does not know is answered with its last reply once more, if there was
    /// one since the start (firmware 2025070202, with 0x79 to one motor's identifier).
    pub repeats_last_reply: bool,
    /// The drive answers under a new id as soon as that is stored, the echo of function 5 included, and
    /// hears only the old one until the restart (firmware 2025070202).
    pub answers_as_new_id: bool,
    /// 0x9A says "released" only while the drive obeys a command that moves or holds the motor, whatever
    /// its brake does (firmware 2025070202).
    pub brake_told_by_motion: bool,
    /// While anything is reported actively (0xB6), no command is answered, of whatever kind; each has
    /// its effect. 2.34.1 can be read so.
    pub silent_while_reporting: bool,
    /// On RS485 drives answer commands to all (0xCD) one after the other, by their ids.
    ///
    /// Without this, each drive answers after its usual delay, as to a command of its own, and the answers of several
    /// collide. In 6.2 four drives answer "at the same time", in an order that depends on "the delay of each on the
    /// bus"; and yet all four frames come whole, in the order of the ids. So each drive waits for a time of its own,
    /// and only the id is surely different. A drive waits for as many slots as there are smaller ids, whether a drive
    /// has them or not. A slot is a frame's time at the drive's bit rate, the spread of its response delay, and
    /// [`SLOT_GUARD`](Self::SLOT_GUARD). How real drives do it is not reported.
    pub broadcast_slots: bool,
    /// A change of what is stored (ROM) takes [`SLOW_ROM`](Self::SLOW_ROM). Its reply, and the replies to whatever is
    /// sent meanwhile, come later by that time.
    pub slow_rom: bool,
}

impl Quirks {
    /// How long a drive with [`slow_boot`](Self::slow_boot) takes.
    pub const SLOW_BOOT: Duration = Duration::from_millis(1_100);
    /// The shortest that a [`slow_brake`](Self::slow_brake) takes.
    pub const SLOW_BRAKE_MIN: Duration = Duration::from_millis(50);
    /// The longest that a [`slow_brake`](Self::slow_brake) takes.
    pub const SLOW_BRAKE_MAX: Duration = Duration::from_millis(150);
    /// How long a [`slow_rom`](Self::slow_rom) takes. This is an estimate, as nobody has reported a figure. Masters
    /// elsewhere wait 20 ms for 0x43, where others of their time-outs are 3 ms; and erasing a page of a small
    /// controller's flash takes about as long.
    pub const SLOW_ROM: Duration = Duration::from_millis(15);
    /// The pause between two [slots](Self::broadcast_slots): the time that a master elsewhere waits at each change of
    /// direction.
    pub const SLOT_GUARD: Duration = Duration::from_micros(100);
}

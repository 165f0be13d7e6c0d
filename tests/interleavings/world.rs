//! The model of the world: commands in flight, drives that answer in order, replies in flight, and the truth, which the
//! oracle knows and the master does not.
//!
//! The bus is one of these:
//!
//! - CAN, with mailboxes that send by priority.
//! - A line. A command arrives as soon as it is sent, all answers come in order, and the answers of two motors to one
//!   command collide.
//!
//! Times are whole milliseconds, so that states recur. A drive takes one millisecond to answer. A command and its reply
//! arrive within [`Config::late_window`] after the command was sent, as the master's documentation demands.

use std::hash::{Hash, Hasher};

use myactuator_protocol_core::master::{Bus, Config, StopKind, TicketId};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::{Channel, Data, MotorId, Packet, Target};
use myactuator_tests::values::LOST_MASTER;

use super::canonical::from_now;

const MS: Duration = Duration::from_millis(1);
/// How long a drive takes to answer.
const RESPONSE: Duration = MS;
/// How many frames a controller holds.
const MAILBOXES: usize = 3;
/// Byte 1 of a reply to an executed command, unless the reply is an acknowledgement.
const DONE: u8 = 0x11;

/// The clock does not start at zero, because zero means "never" to the master.
pub(crate) const START: Instant = Instant::from_millis(1_000);

/// What carries the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Medium {
    Can,
    /// It may be cut, as a fault, and mended at any time.
    CanThatIsCut,
    /// RS485.
    Line,
}

/// A cut is noticed by then.
const LONGEST_CUT: Duration = Duration::from_millis(30);

/// The master's configuration: the order of the times is that of [`Config::CAN`].
pub(crate) fn config(medium: Medium) -> Config {
    let (bus, settle_time) = match medium {
        Medium::Can | Medium::CanThatIsCut => (Bus::Can, MS),
        // Longer than any answer that is not late.
        Medium::Line => (Bus::Rs485 { turnaround: Duration::ZERO, echo: false }, MS.times(3)),
    };
    Config {
        bus,
        reply_timeout: Duration::from_millis(3),
        attempts: 2,
        frame_time: Duration::ZERO,
        shortest_response: RESPONSE,
        longest_response: Duration::from_millis(2),
        late_window: Duration::from_millis(5),
        set_point_max_age: Duration::from_millis(3),
        settle_time,
        ..Config::CAN
    }
}

/// A frame in flight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) packet: Packet,
    /// The number of the call to which it belongs.
    pub(crate) call: u8,
    /// When its command was sent.
    sent: Instant,
    /// A reply does not arrive before this time.
    ready: Instant,
    /// Its delay was counted as a fault.
    is_late: bool,
}

impl Frame {
    fn hash_from_now<H: Hasher>(&self, now: Instant, hasher: &mut H) {
        (self.packet.channel, self.packet.data, self.call, self.is_late).hash(hasher);
        from_now(self.sent, now, config(Medium::Can).late_window).hash(hasher);
        from_now(self.ready, now, Duration::ZERO).hash(hasher);
    }

    fn motor(&self) -> Option<MotorId> {
        motor_of(&self.packet)
    }
}

/// The motor that a command is for or a reply is from, if it is one.
pub(crate) fn motor_of(packet: &Packet) -> Option<MotorId> {
    match packet.channel {
        Channel::Command(Target::Motor(motor)) | Channel::Motion(motor) => Some(motor),
        Channel::Reply(motor) | Channel::MotionReply(motor) => Some(motor),
        _ => None,
    }
}

/// Whether a command moves the motor.
pub(crate) fn moves(packet: &Packet) -> bool {
    matches!(packet.channel, Channel::Motion(_))
        || matches!(packet.channel, Channel::Command(_)) && matches!(packet.data[0], 0xA1 | 0xA8)
}

/// Whether a command stops the motor.
pub(crate) fn stops(packet: &Packet) -> bool {
    kind_of_stop(packet).is_some()
}

/// How a command stops the motor, if it does.
pub(crate) fn kind_of_stop(packet: &Packet) -> Option<StopKind> {
    match packet.channel {
        Channel::Command(_) if packet.data[0] == 0x81 => Some(StopKind::Hold),
        Channel::Command(_) if packet.data[0] == 0x80 => Some(StopKind::Off),
        _ => None,
    }
}

/// The number of the call to which a command or its true reply belongs. It is 0 for the master's own stops.
pub(crate) fn call_of(packet: &Packet) -> u8 {
    match packet.channel {
        Channel::Motion(_) | Channel::MotionReply(_) => packet.data[7],
        _ => packet.data[4],
    }
}

/// A bit for each command byte, to note which were doubled.
fn bit_of(byte: u8) -> u8 {
    match byte {
        0x92 => 1,
        0xA8 => 2,
        0x80 => 4,
        0x81 => 8,
        0xA1 => 16,
        _ => 32,
    }
}

/// A request without an outcome so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Open {
    pub(crate) ticket: TicketId,
    pub(crate) data: Data,
}

/// The truth about one motor.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Truth {
    pub(crate) open: Option<Open>,
    /// A stop of this motor alone was called and not lifted.
    pub(crate) is_stopped: bool,
    /// A stop that was not lifted has switched it off.
    pub(crate) is_off: bool,
    /// How the last command or call that ended its motion stopped it, if that is certain.
    pub(crate) wants: Option<StopKind>,
    /// Whether a command of that kind was sent.
    pub(crate) is_wanted_sent: bool,
    /// The call of the last command to all that ended its motion. The motor may get its own command instead and confirm
    /// that.
    pub(crate) all_call: u8,
    /// The call that stopped it last, and the last call that was a stop or a request that ends motion.
    pub(crate) stop_call: u8,
    pub(crate) last_stop: u8,
    /// Its own stop that the bus has taken and that is not confirmed: its call, which later calls do not change, and
    /// its kind.
    pub(crate) stop_taken: Option<(u8, StopKind)>,
    /// A stop is neither confirmed nor given up. The kind of the last stop.
    pub(crate) is_stopping: bool,
    pub(crate) stop_kind: Option<StopKind>,
    /// The set-points and moves that were sent and not handed back, a bit each.
    pub(crate) set_points_sent: u32,
    pub(crate) moves_sent: u32,
    /// The drive has heard the stop of this call, and no motion of an older call after it.
    pub(crate) stop_heard: u8,
    /// The kind of the last stop that the drive has heard.
    pub(crate) heard: Option<StopKind>,
    /// The drive has lost its master and ignores the next command.
    pub(crate) ignores: bool,
}

impl Truth {
    /// The call to which a stop of the master belongs.
    pub(crate) fn call_of_stop(&self) -> u8 {
        match self.stop_taken {
            _ if self.is_stopping => self.stop_call,
            Some((call, _)) => call,
            None => self.stop_call.max(self.all_call),
        }
    }

    /// Whether it is being sent its own copy of a command to all that ends motion, and nothing that moves it was sent
    /// since.
    pub(crate) fn is_told_for_all(&self, kind: StopKind) -> bool {
        let is_newer = |sent: u32| sent >> self.all_call != 0;
        self.all_call != 0
            && self.stop_taken == Some((self.all_call, kind))
            && !is_newer(self.set_points_sent)
            && !is_newer(self.moves_sent)
    }

    fn hash_all<H: Hasher>(&self, hasher: &mut H) {
        self.open.map(|open| open.data).hash(hasher);
        (self.is_stopped, self.is_off, self.is_stopping, self.is_wanted_sent).hash(hasher);
        (self.stop_call, self.last_stop, self.all_call).hash(hasher);
        self.stop_taken.map(|(call, _)| call).hash(hasher);
        [self.wants, self.heard, self.stop_kind, self.stop_taken.map(|(_, kind)| kind)]
            .map(|kind| kind.map(|it| it == StopKind::Off))
            .hash(hasher);
        (self.set_points_sent, self.moves_sent, self.stop_heard, self.ignores).hash(hasher);
    }
}

/// Everything except the master.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub(crate) medium: Medium,
    pub(crate) now: Instant,
    /// When the bus was cut, if it is cut.
    cut_at: Option<Instant>,
    /// A cut has delayed commands in flight for longer than the master may wait for them.
    pub(crate) was_cut: bool,
    /// No drive hears the next frame that is sent on a line.
    pub(crate) loses_next: bool,
    /// A stop of all was called and not lifted.
    pub(crate) stops_all: bool,
    /// The last call that stopped all. A stop to all belongs to it.
    pub(crate) stop_all_call: u8,
    /// In flight to the drives.
    pub(crate) commands: Vec<Frame>,
    /// In flight to the master.
    pub(crate) replies: Vec<Frame>,
    /// One for each motor.
    pub(crate) truth: Vec<Truth>,
    /// The call whose broadcast is in flight.
    pub(crate) broadcast: Option<u8>,
    /// How many calls were made. Their numbers show their order.
    pub(crate) calls: u8,
    /// How many faults may still happen.
    pub(crate) faults_left: u8,
    /// Whether a fault has happened.
    pub(crate) had_fault: bool,
    /// The byte of the master's stop to all on a line.
    stopped_all_by: Option<u8>,
    /// Commands that a drive heard or answered twice, so that their replies cannot be distinguished.
    doubled: u8,
    /// A drive's message that it has lost its master did not arrive.
    pub(crate) lost_master_untold: bool,
}

impl World {
    pub(crate) fn new(medium: Medium, motors: usize, faults: u8) -> Self {
        Self {
            medium,
            now: START,
            cut_at: None,
            was_cut: false,
            loses_next: false,
            stops_all: false,
            stop_all_call: 0,
            commands: Vec::new(),
            replies: Vec::new(),
            truth: vec![Truth::default(); motors],
            broadcast: None,
            calls: 0,
            faults_left: faults,
            had_fault: false,
            stopped_all_by: None,
            doubled: 0,
            lost_master_untold: false,
        }
    }

    pub(crate) fn hash_from_now<H: Hasher>(&self, hasher: &mut H) {
        for frames in [&self.commands, &self.replies] {
            frames.len().hash(hasher);
            frames.iter().for_each(|frame| frame.hash_from_now(self.now, hasher));
        }
        self.truth.iter().for_each(|truth| truth.hash_all(hasher));
        (self.broadcast, self.calls, self.faults_left).hash(hasher);
        (self.had_fault && self.medium == Medium::Line, self.stopped_all_by).hash(hasher);
        (self.doubled, self.lost_master_untold, self.was_cut).hash(hasher);
        (self.stops_all, self.stop_all_call).hash(hasher);
        self.cut_at.map(|at| from_now(at, self.now, LONGEST_CUT)).hash(hasher);
    }

    /// Whether one more fault may happen. If so, counts it.
    pub(crate) fn fault(&mut self) -> bool {
        let may = self.faults_left > 0;
        self.faults_left -= u8::from(may);
        self.had_fault |= may;
        may
    }

    /// Whether an answer with this command byte may belong to another command.
    pub(crate) fn is_doubled(&self, byte: u8) -> bool {
        self.doubled & bit_of(byte) != 0
    }

    /// As [`is_doubled`](Self::is_doubled), for any stop.
    pub(crate) fn is_stop_doubled(&self) -> bool {
        self.is_doubled(0x80) || self.is_doubled(0x81)
    }

    pub(crate) fn has_room(&self) -> bool {
        self.commands.len() < MAILBOXES
    }

    pub(crate) fn truth_of(&mut self, motor: MotorId) -> Option<&mut Truth> {
        self.truth.get_mut(motor.index())
    }

    /// Lets time pass. `false` if it may not, because a frame must arrive before.
    pub(crate) fn pass(&mut self, until: Instant) -> bool {
        let patience = config(self.medium);
        if let Some(at) = self.cut_at {
            let is_reply_too_late = !self.replies.is_empty() && until > at + patience.reply_timeout;
            if until > at + LONGEST_CUT || is_reply_too_late {
                return false;
            }
            // Commands in flight wait for the end of the cut.
            self.now = self.now.max(until);
            return true;
        }
        let is_too_late = |frame: &Frame, more| until + more >= frame.sent + patience.late_window;
        if self.commands.iter().any(|frame| is_too_late(frame, RESPONSE))
            || self.replies.iter().any(|frame| is_too_late(frame, Duration::ZERO))
        {
            return false;
        }
        for frame in self.commands.iter_mut().chain(&mut self.replies) {
            if until > frame.sent + patience.longest_response && !frame.is_late {
                if self.faults_left == 0 {
                    return false;
                }
                self.faults_left -= 1;
                self.had_fault = true;
                frame.is_late = true;
            }
        }
        self.now = self.now.max(until);
        true
    }

    /// The controller takes a frame, or the line carries it. `false` if it collides with an answer there.
    pub(crate) fn send(&mut self, packet: Packet, call: u8) -> bool {
        let (sent, ready) = (self.now, self.now);
        self.commands.push(Frame { packet, call, sent, ready, is_late: false });
        if self.medium != Medium::Line {
            return true;
        }
        // If two frames collide, neither is heard.
        let under_way = self.replies.len();
        self.replies.retain(|reply| reply.ready <= self.now);
        let is_clear = self.replies.len() == under_way;
        if std::mem::take(&mut self.loses_next) || !is_clear {
            self.commands.clear();
        } else {
            self.hear(0, 1);
        }
        if motor_of(&packet).is_none() && self.truth.len() > 1 {
            self.replies.retain(|reply| reply.sent < sent || reply.call != call);
        }
        is_clear
    }

    /// Cuts the bus, if it is whole.
    pub(crate) fn cut(&mut self) -> bool {
        let is_whole = self.cut_at.is_none();
        self.cut_at = self.cut_at.or(Some(self.now));
        is_whole
    }

    /// Mends the bus, if it is cut. The times of pending commands start now.
    pub(crate) fn mend(&mut self) -> bool {
        let was_cut = self.cut_at.take().is_some();
        if was_cut {
            self.was_cut |= !self.commands.is_empty();
            self.commands.iter_mut().for_each(|frame| frame.sent = self.now);
        }
        was_cut
    }

    pub(crate) fn is_cut(&self) -> bool {
        self.cut_at.is_some()
    }

    /// Whether this frame may leave next: it is the first, or more urgent than all before it. `None` if there is no
    /// such frame, or the bus is cut.
    pub(crate) fn may_leave(&self, index: usize) -> Option<bool> {
        let frame = self.commands.get(index).filter(|_| !self.is_cut())?;
        let mut before = self.commands.iter().take(index);
        Some(before.all(|other| urgency(&frame.packet) < urgency(&other.packet)))
    }

    /// The drives hear this frame, this many times.
    pub(crate) fn hear(&mut self, index: usize, times: u8) {
        let frame = self.commands.remove(index);
        if times > 1 {
            self.doubled |= bit_of(byte_of(&frame.packet));
        }
        // On a line the master does not wait for the answers to its stop to all. If they come after it has released the
        // line, they pass for the answers to the stops of single motors.
        if self.medium == Medium::Line && frame.motor().is_none() && call_of(&frame.packet) == 0 {
            self.stopped_all_by = Some(byte_of(&frame.packet));
        }
        if let Some(byte) = self.stopped_all_by.filter(|_| self.had_fault) {
            self.doubled |= bit_of(byte);
        }
        for _ in 0..times {
            match frame.motor() {
                Some(motor) => self.hears(motor, &frame),
                None => (0..self.truth.len()).for_each(|index| self.hears(motor_at(index), &frame)),
            }
        }
    }

    /// Another master stops a motor, after everything that this master did.
    pub(crate) fn stopped_by_another(&mut self, packet: Packet) {
        let (sent, ready, call) = (self.now, self.now, self.calls);
        if let Some(truth) = motor_of(&packet).and_then(|motor| self.truth_of(motor)) {
            truth.wants = None;
        }
        self.commands.push(Frame { packet, call, sent, ready, is_late: false });
        self.hear(self.commands.len() - 1, 1);
    }

    fn hears(&mut self, motor: MotorId, frame: &Frame) {
        let Some(truth) = self.truth.get_mut(motor.index()) else { return };
        let ignores = std::mem::take(&mut truth.ignores);
        if let Some(kind) = kind_of_stop(&frame.packet) {
            truth.heard = Some(kind).filter(|_| !ignores);
            // A drive that ignores it stands still as well, since its output is cut.
            truth.stop_heard = truth.stop_heard.max(frame.call);
        } else if moves(&frame.packet) && !ignores && frame.call < truth.stop_heard {
            truth.stop_heard = 0;
        }
        let mut packet = frame.packet;
        packet.channel = match packet.channel {
            Channel::Motion(motor) => Channel::MotionReply(motor),
            _ => Channel::Reply(motor),
        };
        if !ignores && !stops(&frame.packet) {
            packet.data[1] = DONE;
        }
        let ready = self.now + RESPONSE;
        self.replies.push(Frame { packet, ready, ..*frame });
    }

    /// A drive has lost its master. It reports that and stands still.
    pub(crate) fn lose_master(&mut self, index: usize) {
        let motor = motor_at(index);
        let Some(truth) = self.truth.get_mut(index) else { return };
        truth.ignores = true;
        let packet = Packet { channel: Channel::Reply(motor), data: LOST_MASTER };
        let (sent, ready) = (self.now, self.now);
        self.replies.push(Frame { packet, call: 0, sent, ready, is_late: false });
    }

    /// The first reply of this motor. The replies of one drive come in order, and on a line so do all replies.
    pub(crate) fn first_reply(&self, motor: usize) -> Option<usize> {
        if self.medium == Medium::Line {
            let first = self.replies.first()?;
            return (first.motor() == Some(motor_at(motor))).then_some(0);
        }
        self.replies.iter().position(|frame| frame.motor() == Some(motor_at(motor)))
    }

    /// When this reply arrives.
    pub(crate) fn ready_at(&self, index: usize) -> Instant {
        self.replies.get(index).map_or(self.now, |frame| frame.ready)
    }

    /// Takes a reply out. With `again` it stays and comes once more.
    pub(crate) fn take_reply(&mut self, index: usize, again: bool) -> Packet {
        if again {
            let packet = self.replies[index].packet;
            self.doubled |= bit_of(byte_of(&packet));
            return packet;
        }
        self.replies.remove(index).packet
    }

    /// A reply is lost.
    pub(crate) fn lose_reply(&mut self, index: usize) {
        self.lost_master_untold |= self.replies.remove(index).packet.data == LOST_MASTER;
    }

    /// Whether a reply to this command says that it was executed.
    pub(crate) fn says_done(data: &Data) -> bool {
        matches!(data[0], 0x80 | 0x81) || data[1] == DONE
    }
}

/// The motor at a place.
pub(crate) fn motor_at(index: usize) -> MotorId {
    MotorId::new(index as u8 + 1).expect("one or two motors")
}

/// The command byte; motion mode has none.
fn byte_of(packet: &Packet) -> u8 {
    match packet.channel {
        Channel::Motion(_) | Channel::MotionReply(_) => 0,
        _ => packet.data[0],
    }
}

/// The identifier: the smaller, the more urgent.
pub(crate) fn urgency(packet: &Packet) -> u16 {
    match packet.channel {
        Channel::Command(Target::Motor(motor)) => 0x140 + u16::from(motor.get()),
        Channel::Motion(motor) => 0x400 + u16::from(motor.get()),
        _ => 0x280,
    }
}

//! What an RS485 adapter hands back of the bytes that were sent.

use crate::id::{MotorId, Target};
use crate::master::MotorSet;
use crate::opcode::{LOST_MASTER_BYTE, Opcode, ReplyRule};
use crate::time::{Duration, Instant};
use crate::wire::rs485::Frame;

/// How long after its sending an echo comes at most, if the port is read meanwhile: adapters hand over what they
/// received every 16 ms.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// How many answers in a row without an echo show that there is none. Noise may take some echoes.
const ARE_ENOUGH: u8 = 4;
/// How many sent frames may wait for their echo.
const SENDINGS: usize = 8;

/// Tells echoes from replies, by place and by their bytes.
///
/// Of the frames that equal one that was sent, the first is its echo, whatever comes before it. So a reply that equals
/// its command, such as an acknowledgement of 0x81, counts only if more such frames come than were sent: if no drive
/// answers, none is left. If reading failed and more frames were sent than are remembered before their echoes came, no
/// acknowledgement counts until these must have come.
///
/// # Whether an adapter echoes
/// An adapter that was not configured to echo is treated as one that may, until it is shown that it does not: four
/// answers in a row came without the echo of what they answer. An answer shows that the drive has heard the command,
/// and an echo comes before the answer. This counts only for commands whose answer never is the same bytes: a read of
/// the status, the date or the model.
///
/// So before the loops send a command whose answer may be the same bytes, they read that motor's status; see
/// [`Bus::Rs485`](crate::master::Bus::Rs485) for the exception and the costs. But once a command seems answered, that
/// motor's status is read before the stops of others are sent: otherwise each of these would be waited for in vain.
///
/// An adapter is found to echo if something comes back that no drive sends: a frame to all, or two of these reads of
/// one motor. A single read may be handed back by a drive that has lost its master (0xF1) and ignored it; if its 0xF1
/// was heard, the read shows nothing. An adapter that was found to echo counts as quiet after four answers in a row
/// without an echo.
#[derive(Clone, Debug)]
pub struct EchoFilter {
    adapter: Adapter,
    /// The frames that were sent and have not come back, the newest first.
    sent: [Option<Sent>; SENDINGS],
    /// The motors for which the last frame sent can show whether there is an echo, but nothing has come yet that does.
    asked: MotorSet,
    /// A frame to this motor has come back: it has answered, or the adapter echoes.
    seems_there: Option<MotorId>,
    /// These motors have said that they have lost their master, and hand the next command back.
    hand_back: MotorSet,
    /// When the last frame was sent that found no place in `sent` any more and may still come back.
    forgotten: Option<Instant>,
    /// When the port was last found empty.
    empty_at: Instant,
}

#[derive(Clone, Copy, Debug)]
struct Sent {
    frame: Frame,
    at: Instant,
    /// An answer without its echo shows that there is none.
    shows: bool,
}

/// What is known of the adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Adapter {
    /// It echoes, by configuration.
    Echoes,
    /// It was found to echo; but since then this many answers in a row came without an echo.
    FoundEchoing { answers: u8 },
    /// No echo was found, and this many answers in a row came without one. Frames to `suspected` have come back before.
    NoneFound { answers: u8, suspected: MotorSet },
}

impl EchoFilter {
    /// A filter for an adapter that is configured to echo, or not to.
    pub const fn new(is_echoing: bool) -> Self {
        let none_found = Adapter::NoneFound { answers: 0, suspected: MotorSet::EMPTY };
        let adapter = if is_echoing { Adapter::Echoes } else { none_found };
        let (nobody, empty_at) = (MotorSet::EMPTY, Instant::ZERO);
        let (sent, asked, hand_back) = ([None; SENDINGS], nobody, nobody);
        Self { adapter, sent, asked, seems_there: None, hand_back, forgotten: None, empty_at }
    }

    /// Whether the adapter echoes, by configuration or because it was found to.
    pub const fn is_echoing(&self) -> bool {
        !matches!(self.adapter, Adapter::NoneFound { .. })
    }

    /// Whether answers have shown that it does not.
    const fn is_quiet(&self) -> bool {
        matches!(self.adapter, Adapter::NoneFound { answers: ARE_ENOUGH.., .. })
    }

    /// The motor whose status is to be read before this frame, because that shows an echo and this frame's own echo may
    /// look like its answer. Each motor is named once, if nothing comes of it.
    pub(super) fn asks_before(&self, frame: &Frame, is_first_stop: bool) -> Option<MotorId> {
        if self.is_echoing() || self.is_quiet() || !can_be_a_reply(frame) {
            return None;
        }
        let to = match frame.address {
            Target::Motor(motor) if !is_first_stop => Some(motor),
            Target::Motor(_) | Target::All => None,
        };
        [self.seems_there, to].into_iter().flatten().find(|&motor| !self.asked.contains(motor))
    }

    /// Takes note of a frame that was sent.
    pub fn sent(&mut self, frame: Frame, now: Instant) {
        let shows = shows_echo(&frame);
        match frame.address {
            Target::Motor(motor) if shows => self.asked.insert(motor),
            Target::Motor(motor) => self.asked.remove(motor),
            Target::All => {}
        }
        // Each makes way for the next one, up to a free place. If there is none, the oldest is forgotten.
        let mut newer = Some(Sent { frame, at: now, shows });
        for place in &mut self.sent {
            newer = core::mem::replace(place, newer);
            if newer.is_none() {
                return;
            }
        }
        self.forgotten = newer.map(|sent| sent.at);
    }

    /// Whether a received frame is the echo of one that was sent.
    pub fn is_echo(&mut self, frame: &Frame) -> bool {
        let is_equal = |place: &Option<Sent>| place.is_some_and(|sent| sent.frame == *frame);
        // Not that of a frame that was answered before its echo came: that echo is lost.
        let may_come = |place: &Option<Sent>| is_equal(place) && place.is_some_and(|it| it.shows);
        let first = self.sent.iter().rposition(may_come);
        let first = first.or_else(|| self.sent.iter().rposition(is_equal));
        let Some(first) = first else {
            let is_forgotten =
                self.forgotten.is_some() && !self.is_quiet() && may_be_a_command(frame);
            if !is_forgotten {
                self.has_answered(frame);
            }
            return is_forgotten;
        };
        if can_be_a_reply(frame) {
            if self.is_quiet() {
                return false;
            }
            if let Target::Motor(motor) = frame.address {
                self.seems_there = Some(motor);
            }
        } else {
            // Earlier frames may have been lost, and this may be the echo of another.
            self.show_nothing();
            if !self.is_handed_back(frame.address) {
                self.has_shown(frame.address, self.adapter.has_echoed(frame.address));
            }
        }
        if let Some(first) = self.sent.get_mut(first) {
            *first = None;
        }
        true
    }

    /// Whether this is the first command that comes back since its drive has lost its master: that may be no echo.
    fn is_handed_back(&mut self, address: Target) -> bool {
        let Target::Motor(motor) = address else { return false };
        let is_first = self.hand_back.contains(motor);
        self.hand_back.remove(motor);
        is_first
    }

    /// A frame that is no echo may be an answer. If the echo of what it answers has not come yet, it does not come any
    /// more.
    fn has_answered(&mut self, frame: &Frame) {
        match (frame.address, frame.data) {
            (Target::Motor(motor), [LOST_MASTER_BYTE, ..]) => self.hand_back.insert(motor),
            // A motor that answers hands nothing back any more.
            (Target::Motor(motor), _) => self.hand_back.remove(motor),
            (Target::All, _) => {}
        }
        let mut shows = false;
        for sent in self.sent.iter_mut().flatten() {
            let asked = &sent.frame;
            if (asked.address, asked.data[0]) == (frame.address, frame.data[0]) {
                shows |= core::mem::take(&mut sent.shows);
            }
        }
        if shows {
            self.has_shown(frame.address, self.adapter.has_not_echoed());
        }
    }

    /// Takes note of what is now known of the adapter from a frame to this address.
    fn has_shown(&mut self, address: Target, adapter: Adapter) {
        self.adapter = adapter;
        if let Target::Motor(motor) = address {
            self.asked.remove(motor);
        }
    }

    /// Echoes of what was sent may be lost, or it was not sent whole: an answer without its echo shows nothing.
    pub(super) fn show_nothing(&mut self) {
        self.sent.iter_mut().flatten().for_each(|sent| sent.shows = false);
    }

    /// Takes note that the port holds nothing now: what was sent long ago does not come back any more. Time alone does
    /// not show that: if a program was halted, its port holds the echoes of all that it sent.
    pub fn found_empty(&mut self, now: Instant) {
        let pause = now - core::mem::replace(&mut self.empty_at, now);
        if pause > LONGEST_WAIT {
            // The adapter may still hold them.
            let sent = self.sent.iter_mut().flatten().map(|sent| &mut sent.at);
            sent.chain(&mut self.forgotten).for_each(|at| *at = now);
        }
        self.forgotten = self.forgotten.filter(|&at| now - at <= LONGEST_WAIT);
        for place in &mut self.sent {
            *place = place.filter(|sent| now - sent.at <= LONGEST_WAIT);
        }
    }
}

impl Adapter {
    /// A frame to this address has come back, and is no answer.
    fn has_echoed(self, address: Target) -> Self {
        match (self, address) {
            (Self::Echoes, _) => self,
            (Self::NoneFound { suspected, .. }, Target::Motor(motor))
                if !suspected.contains(motor) =>
            {
                Self::NoneFound { answers: 0, suspected: suspected.with(motor.into()) }
            }
            _ => Self::FoundEchoing { answers: 0 },
        }
    }

    /// An answer has come without the echo of what it answers.
    fn has_not_echoed(self) -> Self {
        match self {
            Self::Echoes => self,
            Self::FoundEchoing { answers } if answers + 1 < ARE_ENOUGH => {
                Self::FoundEchoing { answers: answers + 1 }
            }
            Self::NoneFound { answers, suspected } if answers + 1 < ARE_ENOUGH => {
                Self::NoneFound { answers: answers + 1, suspected }
            }
            Self::FoundEchoing { .. } | Self::NoneFound { .. } => {
                Self::NoneFound { answers: ARE_ENOUGH, suspected: MotorSet::EMPTY }
            }
        }
    }
}

/// Whether a drive can answer a command with the command's own bytes. It cannot if the command goes to all motors, if
/// it has no answer that can be waited for, or if the answer has values that are never all zero: a voltage, a date, a
/// name.
fn can_be_a_reply(command: &Frame) -> bool {
    let is_silent = |opcode: Opcode| !opcode.reply_rule().has_reply();
    let never = opcode(command).is_some_and(is_silent) || shows_echo(command);
    command.as_reply().is_some() && !never
}

/// Whether a drive answers a command, and never with the command's own bytes.
fn shows_echo(command: &Frame) -> bool {
    const NEVER: [Opcode; 3] = [Opcode::ReadStatus1, Opcode::ReadVersionDate, Opcode::ReadModel];
    command.as_reply().is_some() && opcode(command).is_some_and(|it| NEVER.contains(&it))
}

fn opcode(frame: &Frame) -> Option<Opcode> {
    let [byte, ..] = frame.data;
    Opcode::from_byte(byte)
}

/// Whether a frame says no more than a command does: it is an acknowledgement, or has no values. The message that a
/// drive has lost its master is never a command, so it does not count.
fn may_be_a_command(frame: &Frame) -> bool {
    let [byte, values @ ..] = frame.data;
    let rule = opcode(frame).map(Opcode::reply_rule);
    let says_little = values == [0; 7] || rule.is_some_and(|rule| rule != ReplyRule::Values);
    says_little && byte != LOST_MASTER_BYTE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{
        Command, ReadModel, ReadMultiTurnAngle, ReadStatus1, ReadVersionDate, Reset, Shutdown, Stop,
    };
    use crate::id::MotorId;
    use crate::packet::{Channel, Packet};

    fn frame(command: impl Command) -> Frame {
        let channel = Channel::Command(Target::Motor(MotorId::MIN));
        Frame::from_packet(&Packet { channel, data: command.encode() }).unwrap()
    }

    fn ms(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    #[test]
    fn equal_frame_is_a_reply_only_beyond_the_number_sent() {
        let mut filter = EchoFilter::new(true);
        let stop = frame(Stop);
        filter.sent(stop, ms(0));
        filter.sent(stop, ms(20));
        let late = Frame { data: [0x92; 8], ..stop };
        assert!(!filter.is_echo(&late), "whatever comes before");
        assert!(filter.is_echo(&stop));
        assert!(filter.is_echo(&stop));
        assert!(!filter.is_echo(&stop));
    }

    #[test]
    fn oldest_frame_is_forgotten_first_though_all_times_are_equal() {
        let mut filter = EchoFilter::new(true);
        let shutdown = frame(Shutdown);
        filter.found_empty(ms(0));
        (1..=8).for_each(|at| filter.sent(frame(ReadStatus1), ms(at)));
        filter.sent(shutdown, ms(9));
        // The program was halted.
        filter.found_empty(ms(200));
        (0..7).for_each(|_| filter.sent(frame(ReadStatus1), ms(201)));
        assert!(filter.is_echo(&shutdown), "those before are older");
    }

    #[test]
    fn no_acknowledgement_counts_while_a_forgotten_frame_may_come_back() {
        let mut filter = EchoFilter::new(true);
        filter.found_empty(ms(0));
        (0..9).for_each(|_| filter.sent(frame(Stop), ms(1)));
        assert!((0..8).all(|_| filter.is_echo(&frame(Stop))));
        assert!(filter.is_echo(&frame(Stop)), "the one that was forgotten");
        let write = Frame { data: [0x31, 1, 0, 0, 0, 0, 0x80, 0x3F], ..frame(Stop) };
        assert!(filter.is_echo(&write), "so it may have been");
        assert!(filter.is_echo(&frame(ReadMultiTurnAngle)), "and so may one without values");
        let angle = Frame { data: [0x92, 0, 0, 0, 0xA0, 0x8C, 0, 0], ..frame(Stop) };
        assert!(!filter.is_echo(&angle), "that is no command");
        let lost_master = Frame { data: [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ..frame(Stop) };
        assert!(!filter.is_echo(&lost_master), "nor is that");
        // The program was halted: the adapter may hold it yet.
        [500, 560, 600].into_iter().for_each(|at| filter.found_empty(ms(at)));
        assert!(filter.is_echo(&frame(Stop)));
        filter.found_empty(ms(601));
        assert!(!filter.is_echo(&frame(Stop)));
    }

    #[test]
    fn echo_of_equal_frames_is_that_of_the_first() {
        let mut filter = EchoFilter::new(true);
        filter.found_empty(ms(0));
        [0, 60].into_iter().for_each(|at| filter.sent(frame(Stop), ms(at)));
        assert!(filter.is_echo(&frame(Stop)));
        [60, 110, 155].into_iter().for_each(|at| filter.found_empty(ms(at)));
        assert!(filter.is_echo(&frame(Stop)), "that of the second is not late");
    }

    #[test]
    fn status_date_and_model_reads_that_come_back_twice_show_an_echo() {
        for command in [frame(ReadStatus1), frame(ReadVersionDate), frame(ReadModel)] {
            let mut filter = EchoFilter::new(false);
            for is_found in [false, true] {
                filter.sent(command, ms(0));
                assert!(filter.is_echo(&command));
                assert_eq!(filter.is_echoing(), is_found, "{command:?}");
            }
        }
    }

    #[test]
    fn lost_echo_is_no_longer_expected_after_100_ms() {
        let mut filter = EchoFilter::new(true);
        filter.sent(frame(Stop), ms(0));
        [1, 60, 101].into_iter().for_each(|at| filter.found_empty(ms(at)));
        assert!(!filter.is_echo(&frame(Stop)));
    }

    #[test]
    fn echo_is_recognised_after_a_halt_of_the_program() {
        let mut filter = EchoFilter::new(true);
        filter.found_empty(ms(0));
        filter.sent(frame(Stop), ms(0));
        // A second in which the program was halted; the adapter hands it over a little later.
        filter.found_empty(ms(1_000));
        filter.found_empty(ms(1_016));
        assert!(filter.is_echo(&frame(Stop)));
    }

    #[test]
    fn stop_to_all_that_comes_back_shows_an_echo_at_once() {
        let mut filter = EchoFilter::new(false);
        let to_all = Frame { address: Target::All, ..frame(Stop) };
        filter.sent(to_all, ms(0));
        filter.sent(frame(Stop), ms(2));
        assert!(filter.is_echo(&to_all) && filter.is_echoing());
        assert!(filter.is_echo(&frame(Stop)));
        assert!(!filter.is_echo(&frame(Stop)), "that is the drive's");
        // What drives answer to all is no sign of it.
        let mut filter = EchoFilter::new(false);
        let bus_id = Frame { address: Target::All, data: [0x79, 0, 0, 0, 0, 0, 0, 2] };
        filter.sent(bus_id, ms(0));
        assert!(filter.is_echo(&bus_id) && !filter.is_echoing());
    }

    /// A read that shows an echo is sent to this motor, and answered; before that it comes back, or does not.
    fn exchange(filter: &mut EchoFilter, motor: u8, echoes: bool) {
        let address = MotorId::new(motor).unwrap().into();
        let command = Frame { address, ..frame(ReadStatus1) };
        filter.sent(command, ms(1));
        assert!(!echoes || filter.is_echo(&command), "no values are all zero");
        assert!(!filter.is_echo(&Frame { data: [0x9A; 8], ..command }), "that is its answer");
    }

    /// Whether a read that shows an echo goes before a stop.
    fn asks(filter: &EchoFilter) -> bool {
        filter.asks_before(&frame(Stop), false).is_some()
    }

    /// Whether the answer to a stop counts.
    fn believes(filter: &mut EchoFilter) -> bool {
        filter.sent(frame(Stop), ms(1));
        !filter.is_echo(&frame(Stop))
    }

    #[test]
    fn acknowledgement_counts_only_after_four_answers_without_echo() {
        let mut filter = EchoFilter::new(false);
        assert!(asks(&filter));
        // Once, if nobody answers.
        filter.sent(frame(ReadStatus1), ms(1));
        assert!(!asks(&filter) && !believes(&mut filter) && asks(&filter));
        for motor in 1..=3 {
            exchange(&mut filter, motor, false);
            assert!(!believes(&mut filter) && asks(&filter), "noise may have taken {motor} echoes");
        }
        exchange(&mut filter, 4, false);
        assert!(believes(&mut filter) && !asks(&filter));
    }

    #[test]
    fn only_answers_in_a_row_show_that_there_is_no_echo() {
        let mut filter = EchoFilter::new(false);
        for motor in 1..8 {
            exchange(&mut filter, motor, false);
            exchange(&mut filter, motor, true);
            assert!(!believes(&mut filter), "{motor}");
        }
    }

    #[test]
    fn each_read_counts_as_answered_without_echo_once_at_most() {
        let mut filter = EchoFilter::new(false);
        filter.sent(frame(ReadStatus1), ms(1));
        let other = Frame { address: MotorId::new(2).unwrap().into(), ..frame(ReadStatus1) };
        for data in [[0x9A; 8], [0xB2; 8]] {
            assert!(!filter.is_echo(&Frame { data, ..other }));
            assert!(!filter.is_echo(&Frame { data, ..frame(ReadStatus1) }));
            assert!(!filter.is_echo(&Frame { data, ..frame(ReadStatus1) }), "doubled");
        }
        assert!(!believes(&mut filter));
        // What may answer with the command's own bytes shows nothing, either; nor what no table has.
        for byte in [0x92, 0x55] {
            for _ in 0..4 {
                filter.sent(Frame { data: [byte, 0, 0, 0, 0, 0, 0, 0], ..frame(Stop) }, ms(1));
                assert!(!filter.is_echo(&Frame { data: [byte; 8], ..frame(Stop) }));
            }
            assert!(!believes(&mut filter), "{byte:#X}");
        }
    }

    /// Reads of motor 1 go without their echo, and what another motor or another command answers comes between.
    #[test]
    fn answers_to_other_reads_do_not_show_a_missing_echo() {
        let read = frame(ReadStatus1);
        let of_other = Frame { address: MotorId::new(2).unwrap().into(), data: [0x9A; 8] };
        for answer in [of_other, Frame { data: [0xB2; 8], ..read }] {
            let mut filter = EchoFilter::new(false);
            for _ in 0..4 {
                filter.sent(read, ms(1));
                assert!(!filter.is_echo(&answer));
            }
            assert!(!believes(&mut filter));
        }
    }

    #[test]
    fn reset_and_model_read_show_an_echo_and_wait_for_no_other_read() {
        for command in [frame(Reset), frame(ReadModel)] {
            let mut filter = EchoFilter::new(false);
            assert_eq!(filter.asks_before(&command, false), None);
            for is_found in [false, true] {
                filter.sent(command, ms(0));
                assert!(filter.is_echo(&command));
                assert_eq!(filter.is_echoing(), is_found, "{command:?}");
            }
        }
    }

    #[test]
    fn frame_that_came_back_leaves_its_place_to_the_next() {
        let mut filter = EchoFilter::new(true);
        filter.sent(frame(Shutdown), ms(0));
        (0..7).for_each(|_| filter.sent(frame(ReadStatus1), ms(1)));
        assert!(filter.is_echo(&frame(ReadStatus1)));
        filter.sent(frame(ReadStatus1), ms(2));
        assert!(filter.is_echo(&frame(Shutdown)));
        assert!(!filter.is_echo(&frame(Shutdown)), "nothing was forgotten: that is the drive's");
    }

    #[test]
    fn without_echo_an_acknowledgement_counts_however_much_was_sent_since() {
        let mut filter = EchoFilter::new(false);
        (1..=4).for_each(|motor| exchange(&mut filter, motor, false));
        filter.sent(frame(Stop), ms(1));
        (0..8).for_each(|_| filter.sent(frame(ReadMultiTurnAngle), ms(1)));
        assert!(!filter.is_echo(&frame(Stop)));
    }

    #[test]
    fn one_command_sent_back_after_a_lost_master_shows_no_echo() {
        let mut filter = EchoFilter::new(false);
        let lost = [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0];
        assert!(!filter.is_echo(&Frame { data: lost, ..frame(ReadStatus1) }));
        for is_found in [false, false, true] {
            filter.sent(frame(ReadStatus1), ms(1));
            assert!(filter.is_echo(&frame(ReadStatus1)));
            assert_eq!(filter.is_echoing(), is_found);
        }
    }

    #[test]
    fn possibly_lost_echo_does_not_count_as_missing() {
        let mut filter = EchoFilter::new(false);
        for _ in 0..4 {
            filter.sent(frame(ReadStatus1), ms(1));
            filter.show_nothing();
            assert!(!filter.is_echo(&Frame { data: [0x9A; 8], ..frame(ReadStatus1) }));
        }
        assert!(!believes(&mut filter));
    }

    #[test]
    fn unconfigured_echo_is_found() {
        let mut filter = EchoFilter::new(false);
        // Once may be a drive that lost its master and has ignored the command.
        for is_found in [false, true] {
            filter.sent(frame(ReadStatus1), ms(2));
            assert!(filter.is_echo(&frame(ReadStatus1)));
            assert_eq!(filter.is_echoing(), is_found);
        }
        assert!(!believes(&mut filter));
        // Two drives may have lost their master, and each has ignored one.
        let mut both = EchoFilter::new(false);
        for (motor, is_found) in [(1, false), (2, false), (3, false), (1, true)] {
            let address = MotorId::new(motor).unwrap().into();
            both.sent(Frame { address, ..frame(ReadStatus1) }, ms(2));
            assert!(both.is_echo(&Frame { address, ..frame(ReadStatus1) }));
            assert_eq!(both.is_echoing(), is_found, "{motor}");
        }
        // Also where answers have shown that there is none; one alone is in doubt until others do again.
        let mut quiet = EchoFilter::new(false);
        (1..=4).for_each(|motor| exchange(&mut quiet, motor, false));
        exchange(&mut quiet, 1, true);
        assert!(!quiet.is_echoing() && !believes(&mut quiet));
        (1..=4).for_each(|motor| exchange(&mut quiet, motor, false));
        exchange(&mut quiet, 1, true);
        assert!(!quiet.is_echoing(), "it has answered in between");
        exchange(&mut quiet, 1, true);
        assert!(quiet.is_echoing());
    }

    #[test]
    fn found_echo_ends_after_four_answers_in_a_row_without_it() {
        let mut filter = EchoFilter::new(false);
        (1..=2).for_each(|_| exchange(&mut filter, 1, true));
        for echoes in [false, false, false, true, false, false, false] {
            exchange(&mut filter, 1, echoes);
            assert!(!believes(&mut filter));
        }
        exchange(&mut filter, 2, false);
        assert!(believes(&mut filter));
        // Of one that was configured nothing is believed but that.
        let mut configured = EchoFilter::new(true);
        exchange(&mut configured, 1, true);
        (0..9).for_each(|_| exchange(&mut configured, 1, false));
        assert!(!believes(&mut configured));
    }

    /// It sends back its next command only: an echo that comes after an answer is one, and shows it.
    #[test]
    fn drive_that_answered_since_it_lost_its_master_hides_no_echo() {
        let mut filter = EchoFilter::new(false);
        let read = frame(ReadStatus1);
        let status = Frame { data: [0x9A, 20, 20, 1, 0xE0, 1, 0, 0], ..read };
        let lost = Frame { data: [LOST_MASTER_BYTE, 0, 0, 0, 0, 0, 0, 0], ..read };
        assert!(!filter.is_echo(&lost));
        // Noise takes four echoes in a row, so that the adapter seems quiet.
        for at in [10, 20, 30, 40] {
            filter.sent(read, ms(at));
            assert!(!filter.is_echo(&status));
            filter.found_empty(ms(at + 5));
        }
        (5..35).for_each(|count| filter.found_empty(ms(10 * count)));
        filter.sent(read, ms(350));
        assert!(filter.is_echo(&read));
        assert!(!filter.is_echo(&status));
        filter.sent(frame(Stop), ms(360));
        assert!(filter.is_echo(&frame(Stop)), "it confirms nothing");
    }
}

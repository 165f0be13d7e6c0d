//! What an RS485 adapter hands back of one's own bytes.

use crate::id::Target;
use crate::opcode::{Opcode, ReplyRule};
use crate::time::{Duration, Instant};
use crate::wire::rs485::{FRAME_LENGTH, Frame, HEADER};

/// An echo does not come later after its sending, if somebody looks: adapters hand over what they received every
/// 16 ms.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// So many echoes in a row may be missing of an adapter that was found to echo.
const MISSING: u8 = 3;
/// So many sendings may wait for their echo.
const SENDINGS: usize = 8;

/// Tells echoes from replies: by place and by their bytes.
///
/// Of the frames that equal one that was sent, the first is its echo, whatever comes before it. So of a
/// reply that equals its command, an acknowledgement of 0x81 for example, only what is more than was
/// sent counts: without a drive that answers, nothing is left. Where more were sent than are remembered before
/// their echoes came, because reading failed, no acknowledgement counts until those must have come.
///
/// An echo that nobody configured is found by what comes back and no drive sends: a frame that nobody answers, by
/// which the loops ask, or one to all, with which a stop of all motors begins. Or by two sendings to one motor that
/// come back although no reply to them can be the same bytes: one may have lost its master and ignored the first.
/// The adapter counts as quiet again if four of its echoes in a row do not come back although other frames do.
///
/// The loops ask twice at first, and go on with one such frame before each that can be a reply until they hear
/// something else; they ask again when reading has failed. Where two and more have not come back and nothing else was
/// heard, the line may be dead, or have been: what comes first then and equals a sending is no reply. A stop is
/// confirmed by its next attempt then.
#[derive(Clone, Debug)]
pub struct EchoFilter {
    adapter: Adapter,
    /// What was sent and has not come back, with the time of that, the newest first.
    sent: [Option<(Frame, Instant)>; SENDINGS],
    /// When the last was sent that found no place there any more and may come back yet.
    forgotten: Option<Instant>,
    /// When the port was found empty last.
    empty_at: Instant,
    /// Something else was heard since an echo was missed last. A line that is dead takes echoes, too, and shows
    /// nothing by that.
    is_alive: bool,
}

/// What a frame is that came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Came {
    Echo,
    /// A reply that equals its command, if the adapter does not echo, of which nothing is known.
    Either,
    Other,
}

/// What is known of the adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Adapter {
    /// It echoes, as was said.
    Echoes,
    /// It does not, as was said, and nothing speaks against it but that of a frame to this one.
    IsQuiet { suspected: Option<Target> },
    /// It echoes, as was found; but so many in a row have not come back since.
    FoundEchoing { missing: u8 },
}

impl EchoFilter {
    /// For an adapter that is said to echo, or not to.
    pub const fn new(is_echoing: bool) -> Self {
        let adapter =
            if is_echoing { Adapter::Echoes } else { Adapter::IsQuiet { suspected: None } };
        let (sent, empty_at) = ([None; SENDINGS], Instant::ZERO);
        Self { adapter, sent, forgotten: None, empty_at, is_alive: false }
    }

    /// Whether the adapter echoes, as was said or found.
    pub const fn is_echoing(&self) -> bool {
        !matches!(self.adapter, Adapter::IsQuiet { .. })
    }

    /// Takes note that the adapter echoes.
    pub(super) fn is_found(&mut self) {
        self.adapter = Adapter::FoundEchoing { missing: 0 };
    }

    /// Takes note of a frame that was sent.
    pub fn sent(&mut self, frame: Frame, now: Instant) {
        // Each makes way for the next one, up to a free place. Without one the oldest is forgotten.
        let mut newer = Some((frame, now));
        for place in &mut self.sent {
            newer = core::mem::replace(place, newer);
            if newer.is_none() {
                return;
            }
        }
        self.forgotten = newer.map(|(_, at)| at);
    }

    /// Whether a frame that came is the echo of one that was sent.
    pub fn is_echo(&mut self, frame: &Frame) -> bool {
        self.take(frame) == Came::Echo
    }

    /// What a frame is that came.
    pub(super) fn take(&mut self, frame: &Frame) -> Came {
        let is_equal = |place: &&mut Option<_>| place.is_some_and(|(sent, _)| sent == *frame);
        let Some(first) = self.sent.iter_mut().rfind(is_equal) else {
            if self.forgotten.is_some() && self.is_echoing() && may_be_a_command(frame) {
                return Came::Echo;
            }
            self.is_alive = true;
            return Came::Other;
        };
        match self.adapter {
            Adapter::Echoes => {}
            Adapter::FoundEchoing { .. } if can_be_a_reply(frame) => {}
            Adapter::IsQuiet { .. } if can_be_a_reply(frame) => return Came::Either,
            Adapter::IsQuiet { suspected }
                if frame.as_reply().is_some() && suspected != Some(frame.address) =>
            {
                self.adapter = Adapter::IsQuiet { suspected: suspected.or(Some(frame.address)) };
            }
            Adapter::IsQuiet { .. } | Adapter::FoundEchoing { .. } => {
                self.adapter = Adapter::FoundEchoing { missing: 0 };
            }
        }
        *first = None;
        Came::Echo
    }

    /// Takes note that the port holds nothing now: what was sent long ago does not come back any more. Time
    /// alone does not say so: where a program was halted, its port holds the echoes of all that it sent.
    pub fn found_empty(&mut self, now: Instant) {
        let pause = now - core::mem::replace(&mut self.empty_at, now);
        if pause > LONGEST_WAIT {
            // The adapter may hold them yet.
            let sent = self.sent.iter_mut().flatten().map(|(_, at)| at);
            sent.chain(&mut self.forgotten).for_each(|at| *at = now);
        }
        self.forgotten = self.forgotten.filter(|&at| now - at <= LONGEST_WAIT);
        for place in &mut self.sent {
            let Some((frame, at)) = *place else { continue };
            if now - at <= LONGEST_WAIT {
                continue;
            }
            *place = None;
            if !can_be_a_reply(&frame) && core::mem::take(&mut self.is_alive) {
                self.adapter = self.adapter.has_missed_one();
            }
        }
    }
}

impl Adapter {
    /// One echo has not come. Of those that noise may have taken, some are excused: an echo that passes for
    /// a confirmation is worse than a confirmation that passes for an echo.
    fn has_missed_one(self) -> Self {
        match self {
            Self::Echoes => self,
            Self::FoundEchoing { missing } if missing < MISSING => {
                Self::FoundEchoing { missing: missing + 1 }
            }
            Self::FoundEchoing { .. } | Self::IsQuiet { .. } => Self::IsQuiet { suspected: None },
        }
    }
}

/// A frame that comes back only as an echo. An adapter that echoes hands it back before the echo of what is sent
/// after it, so that a stop's echo is known for one however late both are.
///
/// While nothing comes back, it may be the line that takes it: so it goes before each frame that can be a reply
/// until something else is heard.
#[derive(Clone, Debug)]
pub(super) struct Probe {
    stage: Stage,
    /// So many of its bytes have come back in a row.
    matched: usize,
}

/// What the probe has shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Nothing yet: it is to be sent so often.
    Due(u8),
    /// It has gone: if there is an echo, it comes before all that is sent now.
    Gone,
    /// That was sent, too, and nothing has been heard since.
    Unheard,
    /// It may have been lost, and what was sent behind it not.
    Doubtful { is_due: bool },
    /// Something was heard in doubt, so that the line is whole: it is to be sent once more, and an echo would come.
    Last,
    /// There is no echo: something else was heard after it.
    Spent,
}

impl Probe {
    /// A read of the status (0x9A) from motor 33, which no motor can be (1 to 32): nobody answers it, not even a
    /// drive that lost its master and hands its first command back.
    pub(super) const FRAME: [u8; FRAME_LENGTH] =
        [0x3E, 33, 0x08, 0x9A, 0, 0, 0, 0, 0, 0, 0, 0x73, 0x70];

    /// Noise may spoil one.
    const TIMES: u8 = 2;

    pub(super) const fn new() -> Self {
        Self { stage: Stage::Due(Self::TIMES), matched: 0 }
    }

    /// Whether it is to be sent now.
    pub(super) fn is_due(&self) -> bool {
        use Stage::{Doubtful, Due, Last, Unheard};
        matches!(self.stage, Due(_) | Unheard | Doubtful { is_due: true } | Last)
    }

    /// The port has taken all of it: of less no echo would be known.
    pub(super) fn was_sent(&mut self) {
        self.stage = match self.stage {
            Stage::Due(left) if left > 1 => Stage::Due(left - 1),
            Stage::Due(_) => Stage::Gone,
            // What took those before it may have taken this one, and end before what follows.
            Stage::Unheard | Stage::Doubtful { .. } => Stage::Doubtful { is_due: false },
            Stage::Last => Stage::Spent,
            known @ (Stage::Gone | Stage::Spent) => known,
        };
    }

    /// The port has taken a frame that can be a reply.
    pub(super) fn was_followed(&mut self) {
        self.stage = match self.stage {
            Stage::Gone => Stage::Unheard,
            Stage::Doubtful { .. } => Stage::Doubtful { is_due: true },
            known @ (Stage::Due(_) | Stage::Unheard | Stage::Last | Stage::Spent) => known,
        };
    }

    /// Reading has failed: what came back may be lost.
    pub(super) fn may_be_lost(&mut self) {
        self.stage = match self.stage {
            Stage::Gone => Stage::Doubtful { is_due: false },
            Stage::Unheard | Stage::Last | Stage::Spent => Stage::Doubtful { is_due: true },
            known @ (Stage::Due(_) | Stage::Doubtful { .. }) => known,
        };
    }

    /// A good frame has come. Gives whether it is to be taken for an echo if it can be one.
    pub(super) fn something_came(&mut self) -> bool {
        let (stage, is_in_doubt) = match self.stage {
            Stage::Gone | Stage::Unheard | Stage::Spent => (Stage::Spent, false),
            Stage::Doubtful { .. } | Stage::Last => (Stage::Last, true),
            Stage::Due(_) => (self.stage, true),
        };
        self.stage = stage;
        is_in_doubt
    }

    /// Whether with this byte it has come back. Before it was sent that is another master's.
    pub(super) fn has_come_back(&mut self, byte: u8) -> bool {
        // None of its bytes is like the first.
        let matched = if byte == HEADER { 0 } else { self.matched };
        let is_next = Self::FRAME.get(matched) == Some(&byte);
        self.matched = if is_next { matched + 1 } else { 0 };
        self.matched == FRAME_LENGTH && self.stage != Stage::Due(Self::TIMES)
    }
}

/// Whether a drive can answer a command with the command's own bytes. Not to all motors, and not where the command
/// has no values and the reply some that are never all zero: a voltage, a date, a name.
pub(super) fn can_be_a_reply(command: &Frame) -> bool {
    if command.as_reply().is_none() {
        return false;
    }
    const NEVER: [Opcode; 3] = [Opcode::ReadStatus1, Opcode::ReadVersionDate, Opcode::ReadModel];
    let [byte, ..] = command.data;
    !Opcode::from_byte(byte).is_some_and(|opcode| NEVER.contains(&opcode))
}

/// Whether a frame says no more than a command: an acknowledgement, or without values.
fn may_be_a_command(frame: &Frame) -> bool {
    let [byte, values @ ..] = frame.data;
    let rule = Opcode::from_byte(byte).map(Opcode::reply_rule);
    values == [0; 7] || rule.is_some_and(|rule| rule != ReplyRule::Values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{Command, ReadModel, ReadStatus1, ReadVersionDate, Shutdown, Stop};
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
    fn of_equal_frames_only_what_is_more_than_was_sent_is_a_reply() {
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
    fn the_probe_is_a_good_frame_to_nobody() {
        use crate::wire::rs485::Fault;
        assert_eq!(Frame::decode(&Probe::FRAME), Err(Fault::Address));
        // The CRC over a whole frame comes to 0.
        let crc = crc::Crc::<u16>::new(&crc::CRC_16_MODBUS).checksum(&Probe::FRAME);
        assert_eq!(crc, 0);
        assert_eq!(Probe::FRAME[2..11], frame(ReadStatus1).encode()[2..11]);
    }

    #[test]
    fn the_probe_is_known_by_all_of_its_bytes_in_a_row() {
        let mut probe = Probe::new();
        assert!(probe.is_due());
        probe.was_sent();
        let mut backs = |bytes: &[u8]| bytes.iter().filter(|&&it| probe.has_come_back(it)).count();
        let (start, rest) = Probe::FRAME.split_at(5);
        assert_eq!(backs(&[0x00, 0x3E]) + backs(&Probe::FRAME), 1);
        assert_eq!(backs(start) + backs(&[0x55]) + backs(rest), 0);
        assert_eq!(backs(start) + backs(&Probe::FRAME) + backs(&Probe::FRAME), 2);
    }

    #[test]
    fn the_oldest_makes_way_also_where_all_are_of_one_time() {
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
    fn of_more_than_are_remembered_no_acknowledgement_counts_until_their_echoes_must_have_come() {
        let mut filter = EchoFilter::new(true);
        filter.found_empty(ms(0));
        (0..9).for_each(|_| filter.sent(frame(Stop), ms(1)));
        assert!((0..8).all(|_| filter.is_echo(&frame(Stop))));
        assert!(filter.is_echo(&frame(Stop)), "the one that was forgotten");
        let write = Frame { data: [0x31, 1, 0, 0, 0, 0, 0x80, 0x3F], ..frame(Stop) };
        assert!(filter.is_echo(&write), "so it may have been");
        let angle = Frame { data: [0x92, 0, 0, 0, 0xA0, 0x8C, 0, 0], ..frame(Stop) };
        assert!(!filter.is_echo(&angle), "that is no command");
        // The program was halted: the adapter may hold it yet.
        [500, 560, 600].into_iter().for_each(|at| filter.found_empty(ms(at)));
        assert!(filter.is_echo(&frame(Stop)));
        filter.found_empty(ms(601));
        assert!(!filter.is_echo(&frame(Stop)));
    }

    #[test]
    fn of_equal_sendings_the_first_has_come_back() {
        let mut filter = EchoFilter::new(true);
        filter.found_empty(ms(0));
        [0, 60].into_iter().for_each(|at| filter.sent(frame(Stop), ms(at)));
        assert!(filter.is_echo(&frame(Stop)));
        [60, 110, 155].into_iter().for_each(|at| filter.found_empty(ms(at)));
        assert!(filter.is_echo(&frame(Stop)), "that of the second is not late");
    }

    #[test]
    fn an_acknowledgement_that_does_not_come_is_no_echo_that_does_not() {
        let mut filter = EchoFilter::new(false);
        filter.is_found();
        for at in [0, 1_000, 2_000, 3_000, 4_000] {
            filter.sent(frame(Stop), ms(at));
            assert!(!filter.is_echo(&Frame { data: [0x9A; 8], ..frame(Stop) }), "others are heard");
            [1, 60, 102].into_iter().for_each(|later| filter.found_empty(ms(at + later)));
            assert!(filter.is_echoing());
        }
    }

    #[test]
    fn what_comes_back_and_then_does_not_is_no_echo() {
        let mut filter = EchoFilter::new(false);
        filter.sent(frame(ReadStatus1), ms(0));
        assert!(filter.is_echo(&frame(ReadStatus1)));
        filter.sent(frame(ReadStatus1), ms(10));
        assert!(!filter.is_echo(&Frame { data: [0x9A; 8], ..frame(Stop) }), "that is its answer");
        [11, 60, 111].into_iter().for_each(|at| filter.found_empty(ms(at)));
        for (at, is_found) in [(200, false), (210, true)] {
            filter.sent(frame(ReadStatus1), ms(at));
            assert!(filter.is_echo(&frame(ReadStatus1)));
            assert_eq!(filter.is_echoing(), is_found);
        }
    }

    #[test]
    fn a_voltage_a_date_and_a_name_are_never_all_zero() {
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
    fn an_echo_that_was_lost_is_not_waited_for_for_ever() {
        let mut filter = EchoFilter::new(true);
        filter.sent(frame(Stop), ms(0));
        [1, 60, 101].into_iter().for_each(|at| filter.found_empty(ms(at)));
        assert!(!filter.is_echo(&frame(Stop)));
    }

    #[test]
    fn an_echo_that_nobody_looked_for_is_one_however_late() {
        let mut filter = EchoFilter::new(true);
        filter.found_empty(ms(0));
        filter.sent(frame(Stop), ms(0));
        // A second in which the program was halted; the adapter hands it over a little later.
        filter.found_empty(ms(1_000));
        filter.found_empty(ms(1_016));
        assert!(filter.is_echo(&frame(Stop)));
    }

    #[test]
    fn a_stop_of_all_that_comes_back_shows_an_echo_before_any_stop_can_seem_confirmed() {
        let mut filter = EchoFilter::new(false);
        let to_all = Frame { address: Target::All, ..frame(Stop) };
        filter.sent(to_all, ms(0));
        filter.sent(frame(Stop), ms(2));
        assert!(filter.is_echo(&to_all));
        assert!(filter.is_echo(&frame(Stop)));
        assert!(!filter.is_echo(&frame(Stop)), "that is the drive's");
        // What drives answer to all is no sign of it.
        let mut filter = EchoFilter::new(false);
        let bus_id = Frame { address: Target::All, data: [0x79, 0, 0, 0, 0, 0, 0, 2] };
        filter.sent(bus_id, ms(0));
        assert!(!filter.is_echo(&bus_id));
    }

    #[test]
    fn an_echo_that_nobody_configured_is_found() {
        let mut filter = EchoFilter::new(false);
        filter.sent(frame(Stop), ms(0));
        assert!(!filter.is_echo(&frame(Stop)), "it may well be the answer");
        // Once may be a drive that lost its master and has ignored the command.
        for (at, is_found) in [(2, false), (4, true)] {
            filter.sent(frame(ReadStatus1), ms(at));
            assert!(filter.is_echo(&frame(ReadStatus1)), "no values are all zero");
            assert_eq!(filter.is_echoing(), is_found);
        }
        filter.sent(frame(Stop), ms(6));
        assert!(filter.is_echo(&frame(Stop)));
        // Two drives may have lost their master, and each has ignored one.
        let mut both = EchoFilter::new(false);
        for (motor, is_found) in [(1, false), (2, false), (3, false), (1, true)] {
            let address = MotorId::new(motor).unwrap().into();
            both.sent(Frame { address, ..frame(ReadStatus1) }, ms(2));
            assert!(both.is_echo(&Frame { address, ..frame(ReadStatus1) }));
            assert_eq!(both.is_echoing(), is_found, "{motor}");
        }
        // Noise may take one; but it is none if it then stays away while the drive is heard.
        let miss = |filter: &mut EchoFilter, at| {
            filter.sent(frame(ReadStatus1), ms(at));
            assert!(!filter.is_echo(&Frame { data: [0x9A; 8], ..frame(ReadStatus1) }));
            [1, 60, 102].into_iter().for_each(|later| filter.found_empty(ms(at + later)));
            assert!(!filter.is_echo(&frame(Stop)));
        };
        miss(&mut filter, 1_000);
        assert!(filter.is_echoing());
        filter.sent(frame(ReadStatus1), ms(1_500));
        assert!(filter.is_echo(&frame(ReadStatus1)));
        for (at, is_echoing) in [(2_000, true), (3_000, true), (4_000, true), (5_000, false)] {
            miss(&mut filter, at);
            assert_eq!(filter.is_echoing(), is_echoing);
        }
    }
}

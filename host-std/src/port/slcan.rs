//! SLCAN adapters on serial ports of this machine.

use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::Path;
use std::time::{Duration, Instant};

use embedded_can::nb::Can;
use myactuator_protocol_core::wire::can::SimpleFrame;
use rustix::event::PollFlags;

use crate::port::clock::{Backlog, since_boot};
use crate::port::outage::Outage;
use crate::port::outbox::Outbox;
use crate::port::tty::Tty;
use crate::port::{HostClock, PortError};
use crate::text::slcan::{AdapterCommand, Answer, Codec, Rate};

/// The rate of the serial line, which USB adapters ignore.
const LINE_RATE: u32 = 115_200;
/// How long an adapter may take to answer while it is set up. Some never answer.
const ANSWER_TIME: Duration = Duration::from_millis(100);
/// An adapter that says nothing for so long has said what it had to say.
const QUIET: Duration = Duration::from_millis(20);
/// How soon an adapter that refuses what it is told is opened once more.
const REOPEN_AFTER: Duration = Duration::from_millis(100);
/// Bytes read at once, and how often in one call at the most.
const CHUNK: usize = 256;
const READS_A_CALL: usize = 16;

/// A CAN bus behind an SLCAN adapter.
///
/// The adapter is one on USB, for which the rate of the serial line means nothing; others have to run
/// at 115200 bit/s. It is opened here and closed when this is dropped; no other program can open the
/// port meanwhile.
///
/// BEL from the adapter counts as a bus that carries nothing: from then until a frame comes,
/// [`transmit`](Can::transmit) refuses, with an error, all that could move a motor; stop the motors then, as with
/// [`SocketCan`](crate::port::SocketCan). Meanwhile it opens the adapter once more, ten times a second, with what it
/// sends: one that has restarted by itself takes no stop before. A port that takes nothing for 20 ms is emptied, for what
/// it holds is stale. What its driver does not give back, and what the adapter itself holds, the beginning of a line
/// included, may be sent when the bus is back, and many adapters report nothing at all: protect the drives on their own
/// side, by communication-loss protection (0xB3).
///
/// A USB adapter that collects what it receives, up to 16 ms for some, is told not to, where its driver
/// offers that and the user may: otherwise see [`SlowAdapter`](crate::port::SlowAdapter).
#[derive(Debug)]
pub struct Slcan {
    tty: Tty,
    rate: Rate,
    /// When it was told to open last.
    opened: Instant,
    codec: Codec,
    /// What has arrived and is still to be looked at.
    unread: VecDeque<u8>,
    unsent: Outbox,
    outage: Outage,
    backlog: Backlog,
}

impl Slcan {
    /// Opens the adapter on this serial port and puts it on the bus.
    ///
    /// Takes up to half a second with adapters that answer nothing. Where another program, which knows no lock,
    /// talks to the adapter all the time, refusals may be meant for that one and count for nothing, so that a stop
    /// can go all the same.
    ///
    /// # Errors
    /// [`PortError`]: there is no such port, it is no serial port, the user may not open it, another
    /// program has it open, or the adapter refuses the bit rate or to open.
    pub fn open(path: impl AsRef<Path>, rate: Rate) -> Result<Self, PortError> {
        let mut slcan = Self {
            tty: Tty::open(path.as_ref(), LINE_RATE)?,
            rate,
            opened: Instant::now(),
            codec: Codec::default(),
            unread: VecDeque::new(),
            unsent: Outbox::default(),
            outage: Outage::default(),
            backlog: Backlog::default(),
        };
        // Makes nothing of a line that an interrupted program left, which may be all of a move but its end, and closes
        // what it left open. An adapter refuses the first, and one that is closed already the second.
        slcan.unsent.put_junk();
        slcan.answer(is_outcome)?;
        slcan.set_up(AdapterCommand::Close)?;
        // Answers to what an earlier program said last may still be on their way.
        let is_quiet = slcan.read_until_quiet()?;
        slcan.tty.discard_input()?;
        slcan.unread.clear();
        slcan.codec = Codec::default();
        for command in [AdapterCommand::SetRate(rate), AdapterCommand::Open] {
            let is_refused = slcan.set_up(command)? == Some(Answer::Refused);
            // What is refused may be another program's, which may have this command's answer, too.
            if is_refused && is_quiet && slcan.answer(|answer| *answer == Answer::Done)?.is_none() {
                return Err(PortError::Refused(slcan.tty.name().to_owned()));
            }
        }
        Ok(slcan)
    }

    /// A clock that waits for this adapter.
    ///
    /// # Errors
    /// [`PortError::Os`] when the operating system has no file descriptor left.
    pub fn clock(&self) -> Result<HostClock, PortError> {
        HostClock::with_backlog(self, self.backlog.clone())
            .map_err(|error| PortError::os(self.tty.name(), error))
    }

    /// An adapter that refuses what it is told may have restarted, and be off the bus. One that is not refuses this, too,
    /// or does it again.
    fn reopen_if_refused(&mut self) {
        if self.outage.is_refusal() && self.opened.elapsed() >= REOPEN_AFTER {
            self.opened = Instant::now();
            self.unsent.put(AdapterCommand::SetRate(self.rate));
            self.unsent.put(AdapterCommand::Open);
        }
    }

    /// Sends a command of the set-up and waits for its answer; `None` if none comes.
    fn set_up(&mut self, command: AdapterCommand) -> Result<Option<Answer>, PortError> {
        self.unsent.put(command);
        self.answer(is_outcome)
    }

    /// Waits for such an answer; `None` if none comes.
    fn answer(&mut self, is_it: impl Fn(&Answer) -> bool) -> Result<Option<Answer>, PortError> {
        let deadline = Instant::now() + ANSWER_TIME;
        loop {
            self.send_on()?;
            while let Some(answer) = self.next_answer()? {
                if is_it(&answer) {
                    return Ok(Some(answer));
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            self.tty.wait(PollFlags::IN, Some(left))?;
        }
    }

    /// Passes over what arrives, until nothing has for a while. False where there is no end of it: then another
    /// program talks to the adapter.
    fn read_until_quiet(&mut self) -> Result<bool, PortError> {
        let end = Instant::now() + ANSWER_TIME;
        let mut has_come = true;
        while has_come && Instant::now() < end {
            self.tty.wait(PollFlags::IN, Some(QUIET))?;
            has_come = self.next_answer()?.is_some();
        }
        Ok(!has_come)
    }

    /// Hands the port what it has not taken yet.
    fn send_on(&mut self) -> Result<(), PortError> {
        let sent = self.unsent.send_on(since_boot(), |bytes| self.tty.write(bytes));
        self.backlog.set(!self.unsent.is_empty());
        if sent? {
            return Ok(());
        }
        let stalled = PortError::Stalled(self.tty.name().to_owned());
        self.outage.begin(stalled.clone());
        self.tty.discard_output()?;
        Err(stalled)
    }

    /// The next answer among what has arrived.
    fn next_answer(&mut self) -> Result<Option<Answer>, PortError> {
        for _ in 0..READS_A_CALL {
            while let Some(byte) = self.unread.pop_front() {
                if let Some(answer) = self.codec.feed(byte) {
                    return Ok(Some(answer));
                }
            }
            let mut chunk = [0; CHUNK];
            match self.tty.read(&mut chunk)? {
                Some(length) => self.unread.extend(&chunk[..length]),
                None => break,
            }
        }
        Ok(None)
    }
}

/// Whether an adapter says that it has done what it was told, or not.
fn is_outcome(answer: &Answer) -> bool {
    matches!(answer, Answer::Done | Answer::Refused)
}

impl Drop for Slcan {
    /// Takes the adapter off the bus, as far as it still listens. It answers once it has taken what was sent
    /// before; what an adapter that does not answer has not taken by then is thrown away, the close with it, so that this
    /// is sent once more.
    fn drop(&mut self) {
        if self.unsent.is_empty() {
            self.unsent.put(AdapterCommand::Nothing);
            if let Ok(Some(_)) = self.set_up(AdapterCommand::Close) {
                return;
            }
        }
        let _ = self.tty.discard_output();
        self.unsent.drop_rest();
        self.unsent.put(AdapterCommand::Close);
        let _ = self.send_on();
    }
}

impl AsFd for Slcan {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.tty.as_fd()
    }
}

impl Can for Slcan {
    type Frame = SimpleFrame;
    type Error = PortError;

    fn transmit(&mut self, frame: &SimpleFrame) -> nb::Result<Option<SimpleFrame>, PortError> {
        self.send_on()?;
        if !self.unsent.is_empty() {
            return Err(nb::Error::WouldBlock);
        }
        self.outage.admit(frame)?;
        self.reopen_if_refused();
        self.unsent.put(AdapterCommand::Transmit(*frame));
        self.send_on()?;
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<SimpleFrame, PortError> {
        self.send_on()?;
        while let Some(answer) = self.next_answer()? {
            match answer {
                Answer::Frame(frame) => {
                    self.outage.end();
                    return Ok(frame);
                }
                Answer::Refused => {
                    self.outage.begin(PortError::Refused(self.tty.name().to_owned()));
                }
                _ => {}
            }
        }
        Err(nb::Error::WouldBlock)
    }
}

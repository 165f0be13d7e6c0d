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
/// After so long a silence no more answers of an adapter are expected.
const QUIET: Duration = Duration::from_millis(20);
/// After how long an adapter that refuses commands is opened once more.
const REOPEN_AFTER: Duration = Duration::from_millis(100);
/// Bytes per read, and the most reads in one call.
const CHUNK: usize = 256;
const READS_A_CALL: usize = 16;

/// A CAN bus behind an SLCAN adapter.
///
/// USB adapters ignore the rate of the serial line; others have to run at 115200 bit/s. The adapter is opened here and
/// closed when this is dropped. No other program can open the port meanwhile.
///
/// - **The adapter answers BEL:** the bus counts as carrying nothing. From then until a frame comes,
///   [`transmit`](Can::transmit) returns an error for all that could move a motor; stop the motors then, as with
///   [`SocketCan`](crate::port::SocketCan). Meanwhile, with what it sends, it opens the adapter once more, up to ten
///   times a second: an adapter that has restarted accepts no stop before that.
/// - **The port takes nothing for 20 ms:** it is emptied, since what it holds is stale.
///
/// What its driver does not give back, and what the adapter itself holds, even the beginning of a line, may be sent when
/// the bus is back. Many adapters report nothing at all. So protect the drives on their own side, with
/// communication-loss protection (0xB3).
///
/// Some USB adapters collect what they receive, for up to 16 ms. They are told not to, if the driver
/// offers that and the user has the permission; otherwise see [`SlowAdapter`](crate::port::SlowAdapter).
#[derive(Debug)]
pub struct Slcan {
    tty: Tty,
    rate: Rate,
    /// When the adapter was last told to open.
    opened: Instant,
    codec: Codec,
    /// What has arrived and was not decoded yet.
    unread: VecDeque<u8>,
    unsent: Outbox,
    outage: Outage,
    backlog: Backlog,
}

impl Slcan {
    /// Opens the adapter on this serial port and puts it on the bus.
    ///
    /// This takes up to half a second with an adapter that answers nothing. If another program that ignores the lock
    /// talks to the adapter all the time, refusals may be meant for that program. They are ignored, so that a stop
    /// can still be sent.
    ///
    /// # Errors
    /// [`PortError`]: there is no such port; it is no serial port; the user may not open it; another
    /// program has it open; or the adapter refuses the bit rate or refuses to open.
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
        // Invalidates a line that an interrupted program has left, which may be all of a move but its end. Then closes
        // what that program has left open. An adapter refuses the first; one that is closed already refuses the second.
        slcan.unsent.put_junk();
        slcan.answer(is_outcome)?;
        slcan.set_up(AdapterCommand::Close)?;
        // Answers to the last commands of an earlier program may still be on their way.
        let is_quiet = slcan.read_until_quiet()?;
        slcan.tty.discard_input()?;
        slcan.unread.clear();
        slcan.codec = Codec::default();
        for command in [AdapterCommand::SetRate(rate), AdapterCommand::Open] {
            let is_refused = slcan.set_up(command)? == Some(Answer::Refused);
            // The refusal may be of another program's command, and that program may get this command's answer.
            if is_refused && is_quiet && slcan.answer(|answer| *answer == Answer::Done)?.is_none() {
                return Err(PortError::Refused(slcan.tty.name().to_owned()));
            }
        }
        Ok(slcan)
    }

    /// A clock that waits for this adapter.
    ///
    /// # Errors
    /// [`PortError::Os`] if the operating system has no file descriptor left.
    pub fn clock(&self) -> Result<HostClock, PortError> {
        HostClock::with_backlog(self, self.backlog.clone())
            .map_err(|error| PortError::os(self.tty.name(), error))
    }

    /// An adapter that refuses commands may have restarted, and be off the bus: opens it once more. One that has not
    /// restarted refuses this, too, or does it again.
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

    /// Ignores what arrives, until nothing has for a while. False if there is no end of it: then another
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

/// Whether an answer says that the adapter has done or refused a command.
fn is_outcome(answer: &Answer) -> bool {
    matches!(answer, Answer::Done | Answer::Refused)
}

impl Drop for Slcan {
    /// Takes the adapter off the bus, as far as it still listens. It answers once it has taken what was sent before. If
    /// it does not answer, what it has not taken is thrown away. The close may be part of that, so it is sent once
    /// more.
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

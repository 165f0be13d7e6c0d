//! Cases that no master can know, as documented in `master`. Each excuse is noted when its cause happens, frame by
//! frame. It holds for that question of that motor, for as long as the consequences may last.

use std::collections::HashMap;

use myactuator_protocol_core::time::{Duration, Instant};

use super::names::Question;

/// Why an event may be wrong, or a command may come when it must not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Excuse {
    /// A drive answered twice, or a command reached it twice.
    Doubled,
    /// The same, because two motors have one id.
    TwoMotorsOfOneId,
    /// Another master asks the same.
    AnotherMaster,
    /// Another station sends, in a drive's name, a frame that no drive has sent.
    MadeUp,
    /// The bus has held a frame back for longer than the late window.
    HeldBack,
    /// The drive has lost its master, and its report of that was lost. It hands back the command that it ignores.
    LostMasterUntold,
    /// No echo is configured, the adapter echoes, and noise has destroyed the echoes of four reads in a row. So it
    /// seems not to echo, and this is an echo.
    EchoesTaken,
    /// A drive's run time has wrapped, as it does after 49.7 days, and the master had not read it before.
    RunTimeBeganAnew,
    /// The angle of a shaft that turns fast is reported late, after a reply that was lost.
    FastAndLate,
    /// A report of the drive (0xB6, function 3) looks like an answer.
    ReportedByItself,
}

/// The excuses that hold for one motor, and until when.
#[derive(Clone, Debug, Default)]
pub(crate) struct Excuses {
    /// For each question, the newest last.
    questions: HashMap<Question, Vec<(Excuse, Instant)>>,
    /// Some frame was doubled, but it is not known which.
    doubling: Option<(Excuse, Instant)>,
}

impl Excuses {
    /// Notes what has happened to a frame of this question. For a late window, the answer to the next frame of this
    /// question may be another's.
    pub(crate) fn note(&mut self, of: Question, excuse: Excuse, now: Instant, window: Duration) {
        let excuses = self.questions.entry(of).or_default();
        excuses.retain(|(other, until)| *other != excuse && now <= *until);
        excuses.push((excuse, now + window));
    }

    /// Notes that some frame was doubled.
    pub(crate) fn note_doubling(&mut self, excuse: Excuse, now: Instant, window: Duration) {
        self.doubling = Some((excuse, now + window.times(2)));
    }

    /// The excuse for a wrong answer to this question. The right answer may still come and pass for the answer to the
    /// next one, so the excuse goes on holding.
    pub(crate) fn take(&mut self, of: Question, now: Instant, window: Duration) -> Option<Excuse> {
        let excuse = self.of(of, now)?;
        self.note(of, excuse, now, window);
        Some(excuse)
    }

    pub(crate) fn of(&self, question: Question, now: Instant) -> Option<Excuse> {
        self.holding(question, now).last()
    }

    /// Whether this excuse holds, whatever was noted since.
    pub(crate) fn holds(&self, excuse: Excuse, of: Question, now: Instant) -> bool {
        self.holding(of, now).any(|holding| holding == excuse)
    }

    fn holding(&self, of: Question, now: Instant) -> impl Iterator<Item = Excuse> {
        let excuses = self.questions.get(&of).into_iter().flatten();
        excuses.filter(move |(_, until)| now <= *until).map(|(excuse, _)| *excuse)
    }

    /// The excuse for a doubled frame if tokens do not help: all acknowledgements of a stop are alike.
    pub(crate) fn doubling(&self, now: Instant) -> Option<Excuse> {
        self.doubling.filter(|(_, until)| now <= *until).map(|(excuse, _)| excuse)
    }
}

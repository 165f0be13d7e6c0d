//! Replies that may still come to commands that were given up, or whose place a stop took.

use crate::data::Data;
use crate::kind::Kind;
use crate::master::Config;
use crate::packet::Packet;
use crate::time::Instant;

/// What tells the replies to one command from those to another: its kind and, if the kind has one, its key byte. A
/// reply does not say which of two equal commands it answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Question {
    pub(super) kind: Kind,
    key: u8,
}

impl Question {
    /// What this command asks. Inlined, since the kind of a set-point is known at compile time.
    #[inline(always)]
    pub(super) fn of(kind: Kind, command: &Data) -> Self {
        Self { kind, key: kind.key(command).unwrap_or(0) }
    }

    /// What every command of this kind asks, if the kind has no key byte.
    pub(super) const fn without_key(kind: Kind) -> Self {
        Self { kind, key: 0 }
    }

    /// Whether this can be a reply to it; or, for a command that was handed back, whether it asks this.
    pub(super) fn is_answered_by(self, reply: &Packet) -> bool {
        if reply.is_motion() {
            return self.kind.is_motion();
        }
        let data = &reply.data;
        self.kind.byte() == Some(data[0]) && self.kind.key(data).unwrap_or(0) == self.key
    }
}

/// What the replies belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Of {
    /// Its time was up, and it counted as lost.
    Request,
    /// A stop took its place: it counted as nothing.
    RequestStopped,
    /// Counts as nothing: a stop that was confirmed by the answer to another of its sendings, a stop to all that tells
    /// the motor nothing new, or a read of the status for the transport.
    Nobody,
    /// A further attempt of a request that was answered: it counted as lost.
    RequestAnswered,
    /// Its time was up, and it counted as lost.
    Stream,
    /// A stop took its place: it counted as nothing.
    StreamStopped,
    /// A set-point that counted as lost. A reply came since, which was taken for that to the next one.
    StreamAnswered,
}

/// Replies that may still come, to one question.
#[derive(Clone, Copy, Debug)]
struct Late {
    question: Question,
    of: Of,
    /// At most this many.
    replies: u8,
    /// Not after this time.
    until: Instant,
}

impl Late {
    fn may_move(&self) -> bool {
        self.question.kind.may_move()
    }
}

/// How many questions of one motor may have late replies. No more are asked: see [`has_room`](LateReplies::has_room).
const QUESTIONS: usize = 3;
/// At most this many replies to one question are expected. Answers that come together count as one, and each sending of
/// a stop prolongs the wait for them.
const MOST_REPLIES: u8 = 2 * crate::master::stop::STOP_ATTEMPTS;

/// The late replies that may still come from one motor.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LateReplies([Option<Late>; QUESTIONS]);

impl LateReplies {
    /// This many replies to this question were due by then and may come late. Returns whether an entry made way whose
    /// command may still move the motor.
    pub(super) fn expect(
        &mut self,
        question: Question,
        of: Of,
        replies: u8,
        due: Instant,
        config: &Config,
    ) -> bool {
        let until = due + config.late_window;
        if let Some(late) = self.of(question) {
            late.of = of;
            late.replies = late.replies.saturating_add(replies).min(MOST_REPLIES);
            late.until = late.until.max(until);
            return false;
        }
        // There is no room, which only stops cause. The entry that ends first makes way, if possible none that may
        // still move the motor: its reply shows that the command has arrived.
        let is_worth = |late: &Option<Late>| late.map(|it| (it.may_move(), it.until));
        let least = self.0.iter_mut().min_by_key(|place| is_worth(place));
        let late = Late { question, of, replies: replies.min(MOST_REPLIES), until };
        least.and_then(|place| place.replace(late)).is_some_and(|made_way| made_way.may_move())
    }

    fn of(&mut self, question: Question) -> Option<&mut Late> {
        self.0.iter_mut().flatten().find(|late| late.question == question)
    }

    /// This many fewer replies may come to the first question that matches. Returns what they belong to.
    fn expect_fewer(
        &mut self,
        replies: u8,
        is_it: impl Fn(Question) -> bool,
    ) -> Option<(Of, Question)> {
        let mut places = self.0.iter_mut();
        let place = places.find(|place| place.is_some_and(|late| is_it(late.question)))?;
        let late = (*place)?;
        let replies = late.replies.saturating_sub(replies);
        *place = (replies > 0).then_some(Late { replies, ..late });
        Some((late.of, late.question))
    }

    pub(super) fn is_empty(&self) -> bool {
        matches!(self.0, [None, None, None])
    }

    /// Whether one more question can be given up.
    pub(super) fn has_room(&self) -> bool {
        matches!(self.0, [None, _, _] | [_, None, _] | [_, _, None])
    }

    /// Whether the reply to this question could be one of these.
    pub(super) fn may_be_mistaken(&self, question: Question) -> bool {
        self.0.iter().flatten().any(|late| late.question == question)
    }

    pub(super) fn may_move(&self) -> bool {
        self.0.iter().flatten().any(Late::may_move)
    }

    /// A reply that may have been one of these was taken for the answer to another command. Which reply is still to
    /// come is not known, so one is expected for as long as that to the last command. Returns whether there is such an
    /// entry.
    pub(super) fn prolong(&mut self, question: Question, now: Instant, config: &Config) -> bool {
        let Some(late) = self.of(question) else { return false };
        (late.until, late.of) = (late.until.max(now + config.late_window), Of::StreamAnswered);
        true
    }

    /// Takes a reply that is one of these. Returns what it belongs to and what it answers. If it may be the last reply
    /// doubled, all are still expected.
    pub(super) fn take(&mut self, reply: &Packet, may_be_doubled: bool) -> Option<(Of, Question)> {
        self.expect_fewer(u8::from(!may_be_doubled), |asked| asked.is_answered_by(reply))
    }

    /// Removes what can no longer come. Returns whether a command that may move the motor was among it.
    pub(super) fn expire(&mut self, now: Instant) -> bool {
        let mut could_move = false;
        for place in &mut self.0 {
            if let Some(late) = place.take_if(|late| late.until <= now) {
                could_move |= late.may_move();
            }
        }
        could_move
    }

    /// All of these may come until then.
    pub(super) fn extend(&mut self, until: Instant) {
        for late in self.0.iter_mut().flatten() {
            late.until = late.until.max(until);
        }
    }

    /// When the next of these can no longer come.
    pub(super) fn next_end(&self) -> Option<Instant> {
        self.0.iter().flatten().map(|late| late.until).min()
    }

    /// This many of these are no longer late: the command that they answer goes on.
    pub(super) fn withdraw(&mut self, question: Question, replies: u8) {
        let _ = self.expect_fewer(replies, |asked| asked == question);
    }
}

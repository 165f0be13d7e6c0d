//! Replies to commands that were given up, or that a stop went over: they may still come.

use crate::data::Data;
use crate::kind::Kind;
use crate::packet::Packet;
use crate::time::Instant;

/// What tells the replies to one command from those to another: its kind and, where the kind has one,
/// its key byte. Nothing in a reply says which of two equal commands it answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Question {
    pub(super) kind: Kind,
    key: u8,
}

impl Question {
    /// What this command asks. Inlined, since the kind of a set-point is known when it is compiled.
    #[inline(always)]
    pub(super) fn of(kind: Kind, command: &Data) -> Self {
        Self { kind, key: kind.key(command).unwrap_or(0) }
    }

    /// What every command of this kind asks, where it has no key byte.
    pub(super) const fn without_key(kind: Kind) -> Self {
        Self { kind, key: 0 }
    }

    /// Whether this can be a reply to it; or, of a command that was never sent, whether it asks this.
    pub(super) fn is_answered_by(self, reply: &Packet) -> bool {
        if reply.is_motion() {
            return self.kind.is_motion();
        }
        let data = &reply.data;
        self.kind.byte() == Some(data[0]) && self.kind.key(data).unwrap_or(0) == self.key
    }
}

/// Whether a request or a set-point of a stream was given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Of {
    /// Its time was up, and it counted as lost.
    Request,
    /// A stop went over it: it counted as nothing.
    RequestStopped,
    /// A stop that is confirmed by the answer to another of its sendings, one to all that tells the motor nothing
    /// new, or a read of the status for the transport. It counts as nothing.
    Nobody,
    /// An attempt of a request that has its answer by another: it counted as lost.
    RequestAnswered,
    /// Its time was up, and it counted as lost.
    Stream,
    /// A stop went over it: it counted as nothing.
    StreamStopped,
    /// One of a stream that counted as lost, and a reply has come since that was taken for that to the next.
    StreamAnswered,
}

/// Replies that may still come, to one question.
#[derive(Clone, Copy, Debug)]
struct Late {
    question: Question,
    of: Of,
    /// So many at the most.
    replies: u8,
    /// Not after this.
    until: Instant,
}

impl Late {
    fn may_move(&self) -> bool {
        self.question.kind.may_move()
    }
}

/// How many questions of one motor may have late replies. More are never asked: see
/// [`has_room`](LateReplies::has_room).
const QUESTIONS: usize = 3;
/// More replies to one question are not waited for: answers that come together count as one, and each sending of a stop
/// prolongs for how long they are.
const MOST_REPLIES: u8 = 2 * crate::master::stop::STOP_ATTEMPTS;

/// The late replies that may still come from one motor.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LateReplies([Option<Late>; QUESTIONS]);

impl LateReplies {
    /// So many replies to this question may come until then. Whether one made way for that whose command may
    /// yet move the motor.
    pub(super) fn expect(
        &mut self,
        question: Question,
        of: Of,
        replies: u8,
        until: Instant,
    ) -> bool {
        if let Some(late) = self.of(question) {
            late.of = of;
            late.replies = late.replies.saturating_add(replies).min(MOST_REPLIES);
            late.until = late.until.max(until);
            return false;
        }
        // Without room, which only stops bring about, the one that ends first makes way, but none that may yet
        // move the motor if there is another: its reply tells that it has come.
        let is_worth = |late: &Option<Late>| late.map(|it| (it.may_move(), it.until));
        let least = self.0.iter_mut().min_by_key(|place| is_worth(place));
        let late = Late { question, of, replies: replies.min(MOST_REPLIES), until };
        least.and_then(|place| place.replace(late)).is_some_and(|made_way| made_way.may_move())
    }

    fn of(&mut self, question: Question) -> Option<&mut Late> {
        self.0.iter_mut().flatten().find(|late| late.question == question)
    }

    /// So many fewer replies may come to the first of these questions. Gives what they are of.
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
        self.end_of(question).is_some()
    }

    /// Whether a command is among them that may move the motor: it may not have reached it yet.
    pub(super) fn may_move(&self) -> bool {
        self.0.iter().flatten().any(Late::may_move)
    }

    /// Something else was answered by what may have been one of these: whose reply is still to come
    /// nobody knows, so it may come for as long as that of the last. Whether there is such a one.
    pub(super) fn prolong(&mut self, question: Question, until: Instant) -> bool {
        let Some(late) = self.of(question) else { return false };
        (late.until, late.of) = (late.until.max(until), Of::StreamAnswered);
        true
    }

    /// Takes a reply that is one of these, and gives what it is of and what it answers. One that may be the last one
    /// once more is none of these for sure: they are still expected then.
    pub(super) fn take(&mut self, reply: &Packet, may_be_doubled: bool) -> Option<(Of, Question)> {
        self.expect_fewer(u8::from(!may_be_doubled), |asked| asked.is_answered_by(reply))
    }

    /// Forgets what cannot come any more. Whether a command that may move the motor was among it.
    pub(super) fn expire(&mut self, now: Instant) -> bool {
        let mut could_move = false;
        for place in &mut self.0 {
            if let Some(late) = place.take_if(|late| late.until <= now) {
                could_move |= late.may_move();
            }
        }
        could_move
    }

    /// Nothing came while the bus was down: none of these ends before then.
    pub(super) fn extend(&mut self, until: Instant) {
        for late in self.0.iter_mut().flatten() {
            late.until = late.until.max(until);
        }
    }

    /// When the next of these cannot come any more.
    pub(super) fn next_end(&self) -> Option<Instant> {
        self.0.iter().flatten().map(|late| late.until).min()
    }

    /// So many of these are no longer late: what they answer goes on.
    pub(super) fn withdraw(&mut self, question: Question, replies: u8) {
        let _ = self.expect_fewer(replies, |asked| asked == question);
    }

    /// When replies to this question cannot come any more.
    pub(super) fn end_of(&self, question: Question) -> Option<Instant> {
        let mut all = self.0.iter().flatten();
        all.find(|late| late.question == question).map(|late| late.until)
    }
}

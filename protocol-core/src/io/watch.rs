//! What goes wrong with motors while a control loop moves them.

use crate::command::{
    AnyReply, BrakeCommand, Command, ErrorFlags, ReadRunTime, ReadStatus1, Status1,
};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::kind::Kind;
use crate::master::{Event, Master, MotorSet, Presence};
use crate::opcode::Opcode;
use crate::time::{Duration, Instant};

/// How many times the longest silence a question may stay unanswered.
const LONGEST_UNANSWERED: u32 = 10;

/// What is wrong: the motors should be stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum Trouble {
    /// The loop itself was held up for longer than [`Watch::longest_silence`].
    #[error("the control loop was held up for {0}")]
    Late(Duration),
    /// No feedback has come for longer than [`Watch::longest_silence`].
    #[error("motor {0} is not heard: is it powered and connected, and is this its id?")]
    Silent(MotorId),
    /// The drive reports an error (0x9A) and goes on answering. Take it that it has cut its output and holds nothing;
    /// the manual does not say so, nor what its brake does.
    #[error("motor {motor} reports an error ({errors}), and may hold nothing")]
    Errors {
        /// The motor.
        motor: MotorId,
        /// What its drive reports.
        errors: ErrorFlags,
    },
    /// The drive has [restarted](Event::Restarted), or may have: its turns may be lost.
    #[error(
        "motor {0} has restarted, or was silent for as long as that takes, and its turns may be lost: stop it, read its \
         angle, then lift the stop and resume"
    )]
    Restarted(MotorId),
    /// The drive has [lost its master](Event::LostMaster): it has cut its output, and locked its brake if it has one.
    #[error(
        "motor {0} has cut its output: it had heard nothing for longer than its protection allows"
    )]
    LostMaster(MotorId),
    /// The drive reports (0x9A) that it was last told to lock its brake, which [has to be open](Watch::open_brakes). It
    /// may have restarted just now: then its turns may be lost, too. Open its brake by
    /// [`release_brake`](crate::io::bring_up::release_brake), which finds that out.
    #[error(
        "motor {0} reports a locked brake, against which the loop would work; if it has restarted, its turns may be lost"
    )]
    BrakeLocked(MotorId),
    /// A question of the watch had no answer for ten times [`Watch::longest_silence`], so the state of the motor is not
    /// known. Or its answer was not [noted](Watch::note), or the motor was busy at every look.
    #[error(
        "motor {0} gives feedback, but no answer to the question for its errors or its run time was noted"
    )]
    Unanswered(MotorId),
}

/// Why a control loop has ended. Both kinds of errors become one by `?`.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum LoopError<E> {
    /// What a [`Watch`] has found.
    #[error(transparent)]
    Trouble(#[from] Trouble),
    /// A set-point was refused, or the bus reports an error.
    #[error(transparent)]
    Call(#[from] CallError<E>),
}

/// Watches motors that a control loop moves by set-points.
///
/// Feedback alone does not show everything. A drive that has cut its output because of an error goes on sending
/// feedback. A drive whose supply fails only for a moment comes back with its turns lost. So a watch asks the motors in
/// turn for their errors (0x9A) and their run time (0xB1): one question at a time, each until its answer is noted.
///
/// ```no_run
/// # use myactuator_protocol_core::command::SetPoint;
/// # use myactuator_protocol_core::io::{Guard, LoopError, Runner, Watch};
/// # use myactuator_protocol_core::master::{MotorSet, StopKind};
/// # use myactuator_protocol_core::{MotorId, time::Duration};
/// # fn control<R: Runner<8>, C: SetPoint>(bus: &mut R, arm: MotorSet, plan: impl Fn(MotorId) -> C)
/// # -> Result<(), LoopError<R::Error>> {
/// let mut bus = Guard::new(bus, StopKind::Hold);
/// let mut watch = Watch::new(arm, bus.now());
/// loop {
///     let now = bus.now();
///     watch.look(bus.master(), now)?;
///     for motor in arm.iter() {
///         bus.set_point(motor, plan(motor))?;
///     }
///     bus.run_until(now + Duration::from_millis(5), |event| watch.note(&event))?;
/// }
/// # }
/// ```
///
/// A drive that has lost its master (0xB3) is found by the frame (0xF1) in which it [says so](Event::LostMaster), which
/// the manual does not know. Of a drive that does not send it, an outage shows only as silence. So let the protection be
/// longer than the [longest silence](Self::longest_silence) and the
/// [reply time-out](crate::master::Config::reply_timeout) together. Otherwise a drive may let go and lock its brake, and
/// be heard again just in time: then the loop goes on against the brake, unless [its brake is
/// watched](Self::open_brakes).
///
/// It does not see another master that moves the motors, too, nor a second motor with the id of one. The answers to that
/// master, or those of that motor, are counted in [`Health::stray`](crate::master::Health::stray).
///
/// It stops nothing itself: leave the loop through the stop, as a [`Guard`](crate::io::Guard) does.
///
/// Make a new watch when the set of motors changes, for example because one of them is stopped, and when the loop goes on
/// after a stop. Two watches may share a bus: pass each event to both.
#[derive(Clone, Debug)]
pub struct Watch {
    motors: MotorSet,
    longest_silence: Duration,
    ask_every: Duration,
    open_brakes: MotorSet,
    begun: Instant,
    /// When it looked last.
    looked: Instant,
    /// When the next question may be put.
    next: Instant,
    /// Counts the answers to the questions: one of each motor, then the other one of each.
    turn: usize,
    /// Since when the present question could be put.
    due: Instant,
    trouble: Option<Trouble>,
}

impl Watch {
    /// Watches these motors from now on. Each needs a stream of set-points, for its feedback shows that it is there.
    pub const fn new(motors: MotorSet, now: Instant) -> Self {
        Self {
            motors,
            longest_silence: Duration::from_millis(100),
            ask_every: Duration::from_millis(10),
            open_brakes: MotorSet::EMPTY,
            begun: now,
            looked: now,
            next: now,
            turn: 0,
            due: now,
            trouble: None,
        }
    }

    /// The motors that it watches.
    pub const fn motors(&self) -> MotorSet {
        self.motors
    }

    /// This watch, begun anew: for a loop that goes on after a stop.
    #[must_use]
    pub const fn anew(&self, now: Instant) -> Self {
        Self::new(self.motors, now)
            .longest_silence(self.longest_silence)
            .ask_every(self.ask_every)
            .open_brakes(self.open_brakes)
    }

    /// How long a motor may give no feedback, and the loop may be held up; 100 ms unless said otherwise.
    ///
    /// On CAN at 1 Mbit/s that outlasts a few lost frames: a lost frame keeps the next one back for up to the
    /// [reply time-out](crate::master::Config::reply_timeout). Elsewhere it would end healthy loops. Allow several times
    /// that time-out, which is longer at lower bit rates; and with an adapter that delivers in bursts, several bursts
    /// on CAN, and on RS485 several for each motor. Or make the adapter faster.
    #[must_use]
    pub const fn longest_silence(mut self, time: Duration) -> Self {
        self.longest_silence = time;
        self
    }

    /// The shortest time between two questions; 10 ms unless said otherwise. The next question is not asked before the
    /// last was answered. Each takes the place of one set-point of its motor.
    ///
    /// With the default each of eight motors is asked for its errors every 160 ms. With more motors or a slow adapter it
    /// takes longer. Then let the drives of a CAN bus report errors
    /// ([function 3](crate::command::FunctionControl::ErrorReporting)), which [`note`](Self::note) takes, too.
    #[must_use]
    pub const fn ask_every(mut self, time: Duration) -> Self {
        self.ask_every = time;
        self
    }

    /// Of the motors that are watched, these brakes have to be open, from the first answer on. Without this a locked
    /// brake is no trouble, since the watch does not know who has one.
    ///
    /// Leave out a drive that reports an open brake only while it runs a command: some firmware does (2025070202, seen
    /// in the field), and would end the loop when the motor rests.
    #[must_use]
    pub const fn open_brakes(mut self, motors: MotorSet) -> Self {
        self.open_brakes = motors;
        self
    }

    /// Until when the loop has to look next. After that a thread, a task or an interrupt may stop the motors, which a
    /// loop that hangs cannot. A loop that ends has to tell whoever waits for this.
    #[must_use]
    pub fn late_after(&self) -> Instant {
        self.looked + self.longest_silence
    }

    /// Reports what is wrong, and asks the next question when it is due. Call it once a cycle, after the events of the
    /// last cycle were [noted](Self::note), and before you ask anything yourself: a motor that is busy is not asked.
    ///
    /// # Errors
    /// [`Trouble`]. An error that was noted is reported once, the rest for as long as it lasts: leave the loop.
    pub fn look<const N: usize>(
        &mut self,
        master: &mut Master<N>,
        now: Instant,
    ) -> Result<(), Trouble> {
        match self.trouble.take() {
            // A drive that restarts has a locked brake.
            Some(Trouble::BrakeLocked(motor)) if master.has_restarted(motor) => {
                return Err(Trouble::Restarted(motor));
            }
            Some(trouble) => return Err(trouble),
            None => {}
        }
        let is_late = now > self.late_after();
        let held_up = now - core::mem::replace(&mut self.looked, now);
        if is_late {
            return Err(Trouble::Late(held_up));
        }
        for motor in self.motors.iter() {
            if master.has_restarted(motor) {
                // It may have lost its cable, and not its supply.
                let is_heard = master.health(motor).presence != Presence::Silent;
                let trouble = if is_heard { Trouble::Restarted } else { Trouble::Silent };
                return Err(trouble(motor));
            }
            // It was told before this watch, or to a call that waited.
            if master.has_lost_master(motor) {
                return Err(Trouble::LostMaster(motor));
            }
            let heard = master.latest_feedback(motor).map_or(self.begun, |(_, at)| at);
            if now - heard.max(self.begun) > self.longest_silence {
                return Err(Trouble::Silent(motor));
            }
        }
        if let Some((motor, question)) = self.question() {
            if now - self.due > self.longest_silence.times(LONGEST_UNANSWERED) {
                return Err(Trouble::Unanswered(motor));
            }
            if now >= self.next {
                // The answer comes as an event. While the motor is busy, also with this, it is asked at each look.
                let asked = match question {
                    Opcode::ReadStatus1 => master.request(motor, ReadStatus1).is_ok(),
                    _ => master.request(motor, ReadRunTime).is_ok(),
                };
                if asked {
                    self.next = now + self.ask_every;
                }
            }
        }
        Ok(())
    }

    /// What is to be asked: 0x9A or 0xB1.
    fn question(&self) -> Option<(MotorId, Opcode)> {
        let is_for_errors = self.turn < self.motors.len();
        let question = if is_for_errors { Opcode::ReadStatus1 } else { Opcode::ReadRunTime };
        Some((self.motors.iter().cycle().nth(self.turn)?, question))
    }

    /// Takes note of an event. Call it with each one. A call that waits, such as
    /// [`ask`](crate::io::Runner::ask), drops those of others: an answer that it drops is asked for again.
    pub fn note(&mut self, event: &Event) {
        let status_of = |motor, Status1 { errors, brake, .. }| {
            let is_locked = brake == BrakeCommand::LOCK && self.open_brakes.contains(motor);
            let trouble = match errors.is_empty() {
                false => Some(Trouble::Errors { motor, errors }),
                true => is_locked.then_some(Trouble::BrakeLocked(motor)),
            };
            (motor, Some(Opcode::ReadStatus1), trouble)
        };
        // No matter who has asked, or whether anyone has. The master keeps what a run time says of a restart.
        let (motor, answer, trouble) = match *event {
            Event::LostMaster { motor } => (motor, None, Some(Trouble::LostMaster(motor))),
            Event::Report { motor, reply: AnyReply::ReadStatus1(status) }
            | Event::BroadcastReply { motor, reply: AnyReply::ReadStatus1(status) } => {
                status_of(motor, status)
            }
            Event::Reply { ticket, kind: Kind::Known(opcode), data } => {
                match ReadStatus1::decode_reply(&data) {
                    Ok(status) => status_of(ticket.motor(), status),
                    Err(_) => (ticket.motor(), Some(opcode), None),
                }
            }
            _ => return,
        };
        if answer.is_some_and(|answer| self.question() == Some((motor, answer))) {
            self.turn = if self.turn + 1 < 2 * self.motors.len() { self.turn + 1 } else { 0 };
            self.due = self.next.max(self.looked);
        }
        if self.motors.contains(motor) {
            self.trouble = self.trouble.or(trouble);
        }
    }
}

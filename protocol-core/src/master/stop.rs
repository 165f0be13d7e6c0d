//! Stops, which go before everything else.

use crate::command::{Shutdown, Stop};
use crate::data::Data;
use crate::error::RequestError;
use crate::id::{MotorId, Target};
use crate::kind::Kind;
use crate::master::late::Question;
use crate::master::motor::Motor;
use crate::master::motor::stopping::{LastStop, StopSent};
use crate::master::request::{Asked, Purpose};
use crate::master::{Bus, Master, MotorSet, Patience};
use crate::opcode::Opcode;
use crate::packet::{Channel, Packet};
use crate::time::{Duration, Instant};

/// How motors are to be stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum StopKind {
    /// 0x81: stop and hold still (2.18), with all the torque that the drive has. The motor confirms that it was told,
    /// and needs time to come to rest. Where a load could fall, read its errors (0x9A) and lock a brake: a motor that
    /// reports an error confirms and holds nothing.
    ///
    /// One that has lost its master (0xB3) answers and does nothing, too, until it was spoken to steadily again. So a
    /// motor that is new to the master, or was not spoken to or silent for more than 150 ms (on a slow line for twice
    /// an exchange with each motor, if that is longer), has to answer three commands before its confirmation counts.
    /// With a shorter protection it may not obey yet. A [`KeepAlive`](crate::io::KeepAlive) tells it again to hold if
    /// it has restarted later, says that it has lost its master, was silent for more than 250 ms, or was sent nothing
    /// for more than 400 ms, or twice as long a pause.
    Hold,
    /// 0x80: switch the outputs off (2.17). The shafts are free to turn unless brakes hold them. A brake that was opened
    /// by 0x77 may stay open, and any brake takes up to 200 ms to lock: where a load could fall, first hold it, lock
    /// the brake (0x78), and wait for that long.
    Off,
}

impl StopKind {
    pub(super) const fn command(self) -> (Kind, Data) {
        match self {
            Self::Hold => (Kind::Known(Opcode::Stop), Stop.encode()),
            Self::Off => (Kind::Known(Opcode::Shutdown), Shutdown.encode()),
        }
    }

    pub(super) const fn question(self) -> Question {
        Question::without_key(self.command().0)
    }

    /// The kind of stop that this command is: 0x81 or 0x80, else `None`.
    pub fn by(command: Kind) -> Option<Self> {
        match command.opcode()? {
            Opcode::Stop => Some(Self::Hold),
            Opcode::Shutdown => Some(Self::Off),
            _ => None,
        }
    }
}

/// The longest wait for a stop's confirmation before the stop is sent again. Also how long a stop waits on RS485 for
/// another motor's answer.
pub(super) const LONGEST_STOP_TIMEOUT: Duration = Duration::from_millis(50);
/// How many stop frames a motor gets before it counts as not stopped.
pub(super) const STOP_ATTEMPTS: u8 = 15;
/// How long such a motor gets no further stop, at least; then it gets one more.
const STOP_AGAIN_AFTER: Duration = Duration::from_millis(100);
/// RS485: the stops of motors that do not answer leave the others this many times their own time.
const LINE_FOR_OTHERS: u32 = 4;

impl<const N: usize> Master<N> {
    /// Stops every motor [that has a place](Self::motors) and those of `also`, before anything else is sent and, on
    /// CAN, whatever is in flight.
    ///
    /// - Requests and set-points that wait are dropped. Until [`lift_stop`](Self::lift_stop) whatever may move a motor
    ///   [is refused](Kind::is_refused_while_stopped), as are restarts and writes to ROM. Reads are not.
    /// - Each motor gets its first stop before any gets its second. A motor that was stopped before, and was sent
    ///   nothing since that a stop would refuse, has had its first.
    /// - A stop that is not confirmed within [`Config::reply_timeout`](crate::master::Config::reply_timeout), or within
    ///   50 ms if that is shorter, is repeated: it is sent up to 15 times in all, or 30 if this is called again
    ///   meanwhile.
    /// - Then an event reports that the motor has confirmed it, or that it has not. A confirmation counts only once
    ///   nothing that was sent before the stop can move the motor any more, for example from a controller's mailbox.
    /// - While the bus takes nothing, for example because its cable is off, the stop waits and neither is reported.
    ///   Have a time limit of your own, as the loops of [`io`](crate::io) have. After it, a motor that has not
    ///   confirmed **needs its power cut**.
    /// - While the stop is in force, a motor that has not confirmed gets one more every 100 ms, or as often as RS485
    ///   has time for it, and at once when it is heard: it may be back on the bus at any time.
    /// - A program may call this in every cycle. If it is called again, even if it was lifted in between, a stop under
    ///   way goes on: nothing that moves is sent before that is over. On RS485 every second turn then goes to others,
    ///   as it does after the first stops of motors that are silent. On CAN a motor that has confirmed, and was sent
    ///   nothing since that a stop would refuse, is told again once the motors that were sent no more than it have had
    ///   their turn to answer. Such calls leave the motors no time for requests. After a lost answer, the next
    ///   confirmation comes only when that answer can no longer come.
    ///
    /// # Motors without a place
    /// One stop to all is sent before each motor's own in these cases:
    ///
    /// - on RS485;
    /// - on CAN, once a [`broadcast`](Self::broadcast) may have moved motors that have no place, or a scan has found
    ///   more motors than there are places;
    /// - if there is no place for all of `also`, or if no motor has a place.
    ///
    /// A motor without a place gets that single frame and confirms nothing. So name all motors that a broadcast may
    /// reach, there or in `also`.
    ///
    /// If this is called again and nothing was moved since, the stop to all is repeated at most every 100 ms, on CAN
    /// only if there is no place for all of `also`. If no motor has a place, it is repeated with each call.
    ///
    /// # A motor that is off stays off
    /// If a stop has switched a motor off, no other stop switches it on until the first is lifted:
    ///
    /// - It gets [`StopKind::Off`] where [`StopKind::Hold`] is called for.
    /// - A request to hold it (0x81) is refused.
    /// - A stop to all that would hold it is left out.
    ///
    /// After a stop of all with `Off` this applies to every motor, also to one that gets its place later. A stop to all
    /// that still waits to switch off is sent all the same.
    ///
    /// # Errors
    /// [`RequestError::TooManyMotors`] if there is no place for all of `also`; the others are stopped all the same, and
    /// one stop goes to all.
    pub fn stop_all(&mut self, kind: StopKind, also: MotorSet) -> Result<(), RequestError> {
        self.stop_count = self.stop_count.wrapping_add(1);
        self.let_line_answer();
        let was_stopped = self.stops_all.is_some();
        let is_called_again = self.stop_to_all_was == Some(kind) && !self.was_any_moved();
        self.broadcast.cancel();
        self.broadcast.was_overtaken(kind, MotorSet::ALL);
        let mut result = Ok(());
        for motor in also.iter() {
            result = result.and(self.place_for(motor).map(|_| ()));
        }
        for motor in self.motors().iter() {
            self.put_stop(motor, kind, Purpose::Stop);
        }
        if self.stops_all != Some(StopKind::Off) {
            self.stops_all = Some(kind);
        }
        if kind == StopKind::Off {
            self.switched_off = MotorSet::ALL;
        }
        let goes =
            self.is_same_for_all(kind) && self.is_stop_to_all_due(is_called_again, result.is_err());
        // One that waits has reached no motor yet: it goes, or this one in its place if it was lifted.
        let waits = self.stop_to_all.map(|it| if was_stopped { it } else { kind });
        let waits = waits.filter(|&it| self.is_same_for_all(it));
        self.stop_to_all = goes.then_some(kind).or(waits);
        result
    }

    /// Whether any motor was sent something since its last stop that a stop would refuse.
    #[inline(never)]
    fn was_any_moved(&self) -> bool {
        let stands =
            |motor: &Motor| motor.stop_sent != StopSent::None || motor.waits_for_first_stop();
        !self.at(self.places.taken).all(|(_, motor)| stands(motor))
    }

    /// Whether one stop to all is sent beside each motor's own, for motors without a place, which nothing else reaches.
    /// Called again, it is sent only after a rest, and not while a motor's stop waits for pending answers: it would
    /// prolong that wait.
    fn is_stop_to_all_due(&self, is_called_again: bool, is_no_place_left: bool) -> bool {
        // No motor is known: a stop to all is all that can be done.
        if self.places.taken.is_empty() {
            return true;
        }
        let is_needed = self.config.is_rs485() || is_no_place_left;
        if !is_called_again {
            return is_needed || self.broadcast.may_be_unnamed;
        }
        let waits = |asked: &Asked| asked.proof.waits();
        let (sent, mut stops) = (self.stop_to_all_sent, self.at(self.places.stops));
        is_needed
            && self.now - sent >= STOP_AGAIN_AFTER
            && !stops.any(|(_, motor)| motor.request.waiting().is_some_and(waits))
    }

    /// Stops one motor, as [`stop_all`](Self::stop_all) stops all. Until [`lift_stop`](Self::lift_stop) or
    /// [`lift_stop_of`](Self::lift_stop_of), the same commands to it are refused. A stop to all that was not sent
    /// yet still goes first: motors without a place may get no other.
    ///
    /// No [broadcast](Self::broadcast) that was put before undoes this stop.
    ///
    /// # Errors
    /// [`RequestError::TooManyMotors`] if there is no place for it.
    pub fn stop(&mut self, motor: MotorId, kind: StopKind) -> Result<(), RequestError> {
        self.stop_count = self.stop_count.wrapping_add(1);
        self.let_line_answer();
        self.broadcast.cancel_what_moves();
        self.place_for(motor)?;
        self.put_stop(motor, kind, Purpose::Stop);
        self.stopped.insert(motor);
        Ok(())
    }

    /// RS485: what ends motion leaves the answer to what is in flight time to come. They would collide, and neither
    /// would be heard.
    pub(super) fn let_line_answer(&mut self) {
        if let (Bus::Rs485 { .. }, Some(sent)) = (self.config.bus, self.in_flight_since()) {
            self.busy_until = self.busy_until.max(sent + self.config.settle_time);
        }
    }

    /// When the last of what is in flight was sent.
    pub(super) fn in_flight_since(&self) -> Option<Instant> {
        let of_motors = self.at(self.places.in_flight).map(|(_, motor)| motor.sent);
        of_motors.chain(self.broadcast.in_flight_since()).max()
    }

    #[inline(never)]
    pub(super) fn put_stop(&mut self, motor: MotorId, kind: StopKind, purpose: Purpose) {
        let kind = if self.switched_off.contains(motor) { StopKind::Off } else { kind };
        // A stop that goes once more automatically is what the motor was told last, for example by a request. No caller
        // has called for that as a stop, so it does not keep the motor off.
        if kind == StopKind::Off && purpose == Purpose::Stop {
            self.switched_off.insert(motor);
        }
        self.overtakes_broadcast(motor, kind);
        self.offer = None;
        let stop = self.stop_of(kind.command(), purpose);
        let (pace, now) = (self.pace, self.now);
        self.change(motor, |motor, config| {
            motor.join(pace);
            motor.stop(stop, config, now);
        });
    }

    /// The motors that have confirmed their last stop, and have not let go since, as far as is known.
    pub(crate) fn stops_confirmed(&self) -> MotorSet {
        self.motors_whose(|stop| matches!(stop, LastStop::Confirmed(_)))
    }

    /// The motors that have not confirmed it, and get it once more from time to time at best.
    pub(crate) fn stops_given_up(&self) -> MotorSet {
        self.motors_whose(|stop| matches!(stop, LastStop::Unconfirmed { .. }))
    }

    fn motors_whose(&self, is_it: impl Fn(LastStop) -> bool) -> MotorSet {
        // None of these has a stop under way.
        let all = self.at(self.places.taken).filter(|(_, motor)| is_it(motor.last_stop));
        all.filter_map(|(_, motor)| motor.id).collect()
    }

    /// Sends a stop in force once more, when it is time, to each motor that has not confirmed it: otherwise the motor
    /// would still turn when its cable is repaired.
    pub(super) fn stop_again(&mut self) {
        let rest = self.rest_before_next_stop();
        for place in self.places.taken.iter() {
            self.stop_once_more(place, rest);
        }
    }

    /// A motor that was heard, and has not confirmed a stop in force, is back. It gets the stop at once, before it is
    /// asked anything more.
    #[inline(never)]
    pub(super) fn stop_who_is_back(&mut self, motor: MotorId) {
        let Some(place) = self.places.of(motor) else { return };
        // A request under way is answered first. A motor that answers requests, but no stop, leaves half of the time to
        // others.
        if self.motors.get(place).is_some_and(|motor| motor.request.is_none()) {
            self.stop_once_more(place, self.stop_timeout());
        }
    }

    /// Sends the motor at this place its unconfirmed stop once more, if it has rested for this long.
    /// Inlined: a call costs firmware more flash.
    #[inline(always)]
    fn stop_once_more(&mut self, place: usize, rest: Duration) {
        let stop = self.motors.get(place).and_then(|motor| self.unconfirmed_stop(motor));
        if let Some((motor, kind, _)) = stop.filter(|(.., since)| *since + rest <= self.now) {
            self.let_line_answer();
            self.put_stop(motor, kind, Purpose::StopAgain);
        }
    }

    /// When a motor gets a stop once more.
    pub(super) fn stops_again_at(&self) -> Option<Instant> {
        if !self.is_any_stopped() {
            return None;
        }
        let all = self.at(self.places.taken);
        let first = all.filter_map(|(_, motor)| Some(self.unconfirmed_stop(motor)?.2)).min()?;
        Some(first + self.rest_before_next_stop())
    }

    /// The stop in force that this motor has not confirmed, and since when nothing was done about it.
    fn unconfirmed_stop(&self, motor: &Motor) -> Option<(MotorId, StopKind, Instant)> {
        let (id, (kind, since)) = (motor.id?, motor.unconfirmed_stop()?);
        (self.is_stopped(id) && !self.is_end_of_all_waiting()).then_some((id, kind, since))
    }

    /// Whether all motors are about to be told something that may be a different stop, or to let go.
    fn is_end_of_all_waiting(&self) -> bool {
        self.broadcast.waiting().is_some_and(Kind::ends_motion)
    }

    fn rest_before_next_stop(&self) -> Duration {
        if !self.config.is_rs485() {
            return STOP_AGAIN_AFTER;
        }
        let all = self.at(self.places.taken);
        let silent = all.filter(|(_, motor)| self.unconfirmed_stop(motor).is_some()).count() as u32;
        STOP_AGAIN_AFTER.max(self.stop_timeout().times(LINE_FOR_OTHERS * silent))
    }

    /// One motor is told to end its motion: a command to all that was put before must not undo that.
    pub(super) fn overtakes_broadcast(&mut self, motor: MotorId, by: StopKind) {
        self.broadcast.was_overtaken(by, motor.into());
        if self.broadcast.is_waiting() {
            self.end_motion_of_all();
        }
    }

    pub(super) fn stop_of(&self, (kind, data): (Kind, Data), purpose: Purpose) -> Asked {
        let attempts = if purpose == Purpose::StopAgain { 1 } else { STOP_ATTEMPTS };
        let patience = Patience { reply_timeout: self.stop_timeout(), attempts };
        Asked::new(purpose, Question::of(kind, &data), data, patience)
    }

    pub(crate) fn stop_timeout(&self) -> Duration {
        self.config.reply_timeout.min(LONGEST_STOP_TIMEOUT)
    }

    /// A command that ends the motion of all waits or was handed back: it is sent. If it would undo a later stop of one
    /// motor, each of the others that have a place gets it individually, and no motor is restarted.
    pub(super) fn end_motion_of_all(&mut self) {
        let (Some(kind), data) = self.broadcast.command() else { return };
        let (held, off) = self.broadcast.stopped_since();
        let undone = match kind.opcode() {
            _ if !kind.ends_motion() => return,
            Some(Opcode::Shutdown) => held,
            // A motor that a stop has switched off stays off until that is lifted, whenever it was.
            Some(Opcode::Stop) => off.with(self.switched_off),
            Some(Opcode::LockBrake) => MotorSet::EMPTY,
            _ => held.with(off),
        };
        if undone.is_empty() {
            return self.broadcast.goes_again();
        }
        self.broadcast.cancel();
        if kind.is_refused_while_stopped() {
            return;
        }
        let (stop, now) = (self.stop_of((kind, data), Purpose::Stop), self.now);
        self.let_line_answer();
        for motor in self.motors().without(held.with(off).with(undone)).iter() {
            self.change(motor, |motor, config| motor.put_stop(stop, config, now));
        }
    }

    /// Whether a motor was [stopped](Self::stop), individually or with [all](Self::stop_all), and the stop was not
    /// lifted.
    pub fn is_stopped(&self, motor: MotorId) -> bool {
        self.stops_all.is_some() || self.stopped.contains(motor)
    }

    /// The motors that a stop in force has switched off: no other stop switches them on. After a stop of all, every id.
    pub const fn switched_off(&self) -> MotorSet {
        self.switched_off
    }

    pub(super) fn is_any_stopped(&self) -> bool {
        self.stops_all.is_some() || !self.stopped.is_empty()
    }

    /// How many stops were called for so far, of one motor or of all, for [`lift_stop_if`](Self::lift_stop_if). Each call
    /// of [`stop`](Self::stop) and [`stop_all`](Self::stop_all) counts, also those of a guard, and of a function that
    /// gives up. Code that stops motors itself before it goes on takes this before, and adds the number of its own
    /// calls: what is called for while it waits for them counts, too.
    pub const fn stop_count(&self) -> u32 {
        self.stop_count
    }

    /// As [`lift_stop`](Self::lift_stop), unless a stop was called for since [`stop_count`](Self::stop_count) was this,
    /// by a button for example that somebody has pressed meanwhile. Returns whether it has lifted all stops.
    ///
    /// ```
    /// # use myactuator_protocol_core::io::{CallError, Runner};
    /// # use myactuator_protocol_core::command::ReadStatus1;
    /// # use myactuator_protocol_core::MotorId;
    /// /// Somebody says that the arm may go on. Returns whether it may, when all is checked.
    /// fn go_on<R: Runner<8>>(bus: &mut R, arm: [MotorId; 3]) -> Result<bool, CallError<R::Error>> {
    ///     let stops = bus.master().stop_count();
    ///     // Meanwhile the button may be pressed again.
    ///     for status in bus.ask_together(arm.map(|motor| (motor, ReadStatus1))) {
    ///         if !status?.errors.is_empty() {
    ///             return Ok(false);
    ///         }
    ///     }
    ///     Ok(bus.master().lift_stop_if(stops))
    /// }
    /// ```
    #[must_use = "if it is false, the motors stay stopped"]
    pub fn lift_stop_if(&mut self, stop_count: u32) -> bool {
        let is_newest = self.stop_count == stop_count;
        if is_newest {
            self.lift_stop();
        }
        is_newest
    }

    /// Lifts every stop, no matter which caller called for it, and when: what [`stop_all`](Self::stop_all) and
    /// [`stop`](Self::stop) refused is accepted again.
    ///
    /// A motor that has confirmed its stop is not asked anything meanwhile. If its power may have been off since, read
    /// its run time (0xB1) when it is back and before you lift the stop. That shows that it has
    /// [restarted](crate::master::Event::Restarted), in which case its turns may be lost.
    pub fn lift_stop(&mut self) {
        self.stops_all = None;
        self.stopped = MotorSet::EMPTY;
        self.switched_off = MotorSet::EMPTY;
    }

    /// Lifts the [`stop`](Self::stop) of this motor, **no matter which caller called for it**. Where several callers
    /// stop one motor, only the one that knows why it was stopped should lift it. A stop of all stays in force, also
    /// for this motor.
    pub fn lift_stop_of(&mut self, motor: MotorId) {
        self.stopped.remove(motor);
        if self.stops_all.is_none() {
            self.switched_off.remove(motor);
        }
    }

    /// Whether a stop of this kind may go to all at once: it switches on no motor that is to stay off.
    fn is_same_for_all(&self, kind: StopKind) -> bool {
        kind == StopKind::Off || self.switched_off.is_empty()
    }

    /// The stop to all was sent.
    #[inline(never)]
    pub(super) fn stop_to_all_was_sent(&mut self) {
        let Some(kind) = self.stop_to_all.take() else { return };
        let now = self.now;
        self.is_any_off_since = false;
        self.stop_to_all_sent = now;
        self.stop_to_all_was = Some(kind);
        let told = kind.question();
        let due = now + self.config.reply_timeout;
        self.change_all(|motor, config| {
            // Its answer counts as one to the motor's own stop, but not on RS485. There motors that rest between their
            // turns would have to be told three times anew, again and again.
            if !config.is_rs485() {
                motor.may_begin_anew(0, now);
            }
            motor.stop_to_all_was_sent(told, due, config);
        });
        if !self.config.is_rs485() {
            self.broadcast.stop_was_sent(told.kind, due, &self.config);
        }
    }

    /// If this is the stop to all, and in force, it was handed back and is sent once more. Returns whether it is.
    pub(super) fn stop_to_all_was_pushed_out(&mut self, packet: &Packet) -> bool {
        let is_it = |kind: &StopKind| kind.command().1 == packet.data;
        let Some(kind) = self.stops_all.filter(is_it) else { return false };
        let is_undone = kind == StopKind::Hold && self.is_any_off_since;
        let told = kind.question();
        self.change_all(|motor, _| motor.stop_to_all_was_pushed_out(told, packet));
        if self.is_same_for_all(kind) && !is_undone {
            self.stop_to_all = Some(kind);
        }
        true
    }

    /// Whether a [stop of all](Self::stop_all) waits to be sent to all at once, which also stops motors that have no
    /// place. No motor confirms it: to wait for a stop, wait for this, too.
    pub const fn is_stop_to_all_waiting(&self) -> bool {
        self.stop_to_all.is_some()
    }

    /// The stop to all motors at once, if it is to be sent.
    pub(super) fn stop_to_all_packet(&self) -> Option<Packet> {
        let (_, data) = self.stop_to_all?.command();
        Some(Packet { channel: Channel::Command(Target::All), data })
    }
}

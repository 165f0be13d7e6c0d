//! Ways of working, with a handle.

use std::fmt;
use std::ops::ControlFlow;

use embassy_futures::block_on;
use myactuator_protocol_core::error::RequestError;
use myactuator_protocol_core::io::CallError;
use myactuator_protocol_core::io::async_bring_up::{self, Calls};
use myactuator_protocol_core::io::bring_up::{
    BringUpError, Identity, MoveCommand, MoveFailure, MoveLimits, MoveProgress, NotArrived,
    Protection,
};
use myactuator_protocol_core::master::{MotorSet, StopKind};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::units::Milliseconds;
use myactuator_protocol_core::{Command, MotorId, Opcode};

use super::calls::{Insistence, Order};
use super::desk::Opening;
use super::past::Past;
use super::{SharedBus, SharedBusError};

impl<E: fmt::Debug + Send + Sync + 'static> SharedBus<E> {
    /// Waits until a motor answers, after power-on for example, as
    /// [`bring_up::wait_until_there`](myactuator_protocol_core::io::bring_up::wait_until_there) does.
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn wait_until_there(
        &self,
        motor: MotorId,
        time: Duration,
    ) -> Result<(), BringUpError<SharedBusError<E>>> {
        block_on(async_bring_up::wait_until_there(&mut Way::on(self, motor), motor, time))
    }

    /// Reads what identifies a motor, and its state, as
    /// [`bring_up::identify`](myactuator_protocol_core::io::bring_up::identify) does.
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn identify(&self, motor: MotorId) -> Result<Identity, CallError<SharedBusError<E>>> {
        block_on(async_bring_up::identify(&mut Way::on(self, motor), motor))
    }

    /// Moves a motor to an angle, or by one, and watches it until it stands there, as
    /// [`bring_up::move_to`](myactuator_protocol_core::io::bring_up::move_to) does. Meanwhile other threads may move
    /// other motors.
    ///
    /// - If another thread ends this motor's motion, by a stop or by a command that ends motion, the move ends, too,
    ///   even if that stop is lifted at once.
    /// - Until the move has ended, and the motor is stopped if the move has failed, another `move_to` of this motor is
    ///   refused at once ([`MoveFailure::UnderWay`]).
    /// - Set-points and commands are not refused. A move that fails stops the motor, also if they have moved it on.
    /// - A motor that was let go (0x80) meanwhile is not switched on by that stop.
    ///
    /// ```
    /// # use std::ops::ControlFlow;
    /// # use myactuator_host_std::open::BusAddress;
    /// # use myactuator_host_std::protocol::MotorId;
    /// # use myactuator_host_std::protocol::command::AbsolutePosition;
    /// # use myactuator_host_std::protocol::master::StopKind;
    /// # use myactuator_host_std::protocol::units::{Angle, MaxSpeed};
    /// # use myactuator_host_std::share::SharedBus;
    /// # let bus = SharedBus::open(&"sim:2".parse::<BusAddress>()?, StopKind::Hold)?;
    /// let elbow = MotorId::new(2)?;
    /// bus.release_brake(elbow)?;
    /// let command = AbsolutePosition {
    ///     max_speed: MaxSpeed::from_dps(180.0)?,
    ///     angle: Angle::from_degrees(10.0)?,
    /// };
    /// let go_on = |_: &_| ControlFlow::Continue(());
    /// let arrival = bus.move_to(elbow, command, &Default::default(), go_on)?;
    /// assert!((arrival.angle.degrees() - 10.0).abs() < 0.3);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn move_to<C: MoveCommand>(
        &self,
        motor: MotorId,
        command: C,
        limits: &MoveLimits,
        on_look: impl FnMut(&MoveProgress) -> ControlFlow<()>,
    ) -> Result<MoveProgress, NotArrived<SharedBusError<E>>> {
        let Some(_moving) = self.desk().begin_move(motor) else {
            return Err(NotArrived { motor, why: MoveFailure::UnderWay, is_stopped: false });
        };
        let mut way = Way::on(self, motor);
        let arrived = block_on(async_bring_up::move_to(&mut way, motor, command, limits, on_look))?;
        self.desk().note_arrival(motor, way.since);
        Ok(arrived)
    }

    /// Opens a motor's brake while the motor holds, and waits until it is open, as
    /// [`bring_up::release_brake`](myactuator_protocol_core::io::bring_up::release_brake) does. This ends a motion that
    /// another thread has commanded. Questions of other threads to this motor, except those that end motion or open its
    /// brake, wait until it has been told to hold. Set-points do not wait: let no thread stream to this motor, or it
    /// moves on, and its brake may be locked while it turns.
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn release_brake(&self, motor: MotorId) -> Result<(), BringUpError<SharedBusError<E>>> {
        block_on(async_bring_up::release_brake(&mut Way::on(self, motor), motor))
    }

    /// Waits until a motor stands, after a stop for example, as
    /// [`bring_up::wait_until_stands`](myactuator_protocol_core::io::bring_up::wait_until_stands) does.
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn wait_until_stands(
        &self,
        motor: MotorId,
        time: Duration,
    ) -> Result<(), BringUpError<SharedBusError<E>>> {
        block_on(async_bring_up::wait_until_stands(&mut Way::on(self, motor), motor, time))
    }

    /// Locks the brake of a motor that stands, and waits until it has had the time to lock, as
    /// [`bring_up::lock_brake`](myactuator_protocol_core::io::bring_up::lock_brake) does. A set-point of another thread
    /// that comes meanwhile may open it again. A [stop](Self::stop) in force refuses such set-points. It also
    /// refuses to open a brake that slips, and then the load falls: for a load, [lift](Self::lift_stop_of) the stop
    /// before this call, and let no thread stream to the motor.
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn lock_brake(&self, motor: MotorId) -> Result<(), BringUpError<SharedBusError<E>>> {
        block_on(async_bring_up::lock_brake(&mut Way::on(self, motor), motor))
    }

    /// Checks that the shaft of a motor that is off stands behind its locked brake, as
    /// [`bring_up::check_brake`](myactuator_protocol_core::io::bring_up::check_brake) does.
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn check_brake(&self, motor: MotorId) -> Result<(), BringUpError<SharedBusError<E>>> {
        block_on(async_bring_up::check_brake(&mut Way::on(self, motor), motor))
    }

    /// Sets after how long without a command a motor stops on its own (0xB3), as
    /// [`bring_up::protect`](myactuator_protocol_core::io::bring_up::protect) does. A command of any thread counts.
    /// While a function here waits, the bus asks the other motors, except those that may be moving, since whoever moves
    /// them may hang, and those that are off.
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn protect(
        &self,
        motor: MotorId,
        timeout: Milliseconds,
    ) -> Result<Protection, BringUpError<SharedBusError<E>>> {
        block_on(async_bring_up::protect(&mut Way::on(self, motor), motor, timeout))
    }

    /// Restarts a drive (0x76), which also clears errors whose cause is gone, and waits until it answers, as
    /// [`bring_up::restart`](myactuator_protocol_core::io::bring_up::restart) does. From before this call on, let no
    /// other thread move the motor. After the restart all threads are refused what moves it. Read its angle, since
    /// whole turns may be lost, [`resume`](Self::resume), and open its brake again.
    ///
    /// **For 2 s nothing is sent to the motor, and a question of another thread to it waits for as long**, also an
    /// `ask_together` that names it beside others.
    ///
    /// ```
    /// # use myactuator_host_std::open::BusAddress;
    /// # use myactuator_host_std::protocol::MotorId;
    /// # use myactuator_host_std::protocol::command::ReadMultiTurnAngle;
    /// # use myactuator_host_std::protocol::master::StopKind;
    /// # use myactuator_host_std::share::SharedBus;
    /// # let bus = SharedBus::open(&"sim:2".parse::<BusAddress>()?, StopKind::Hold)?;
    /// let elbow = MotorId::new(2)?;
    /// bus.restart(elbow)?;
    /// println!("it believes to be at {}", bus.ask(elbow, ReadMultiTurnAngle)?.angle);
    /// bus.resume(elbow)?;
    /// bus.release_brake(elbow)?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As there; what concerns the thread of the bus is a [`CallError::Bus`].
    pub fn restart(&self, motor: MotorId) -> Result<(), BringUpError<SharedBusError<E>>> {
        block_on(async_bring_up::restart(&mut Way::on(self, motor), motor, motor))
    }
}

/// A bus as ways of working see it. Each of its futures blocks, so that none has to be woken.
struct Way<'a, E> {
    bus: &'a SharedBus<E>,
    /// The motor's past when this began: nothing from here follows an end of motion, or a restart, that came
    /// since.
    since: Past,
    /// While it opens the motor's brake and has not told the motor to hold.
    opening: Option<Opening<'a, E>>,
    /// The last time that the clock of the bus returned.
    now: Instant,
}

impl<'a, E: fmt::Debug + Send + Sync + 'static> Way<'a, E> {
    fn on(bus: &'a SharedBus<E>, motor: MotorId) -> Self {
        Self { bus, since: bus.desk().past(motor), opening: None, now: Instant::ZERO }
    }

    /// Waits until the clock of the bus has reached `earliest`; returns its time.
    fn time_at(&mut self, earliest: Instant) -> Result<Instant, SharedBusError<E>> {
        let desk = self.bus.desk();
        let _at_work = desk.begin_work();
        self.now = desk.wait(desk.wait_until(earliest))?;
        Ok(self.now)
    }
}

impl<E: fmt::Debug + Send + Sync + 'static> Calls<{ MotorId::COUNT }> for Way<'_, E> {
    type Error = SharedBusError<E>;

    fn now(&mut self) -> Instant {
        // If the thread has ended, the next call says so.
        self.time_at(Instant::ZERO).unwrap_or(self.now)
    }

    async fn wait_until(&mut self, until: Instant) -> Result<(), CallError<Self::Error>> {
        self.time_at(until).map(|_| ()).map_err(call_error)
    }

    async fn ask_often<C: Command>(
        &mut self,
        motor: MotorId,
        command: C,
        attempts: Option<u8>,
    ) -> Result<C::Reply, CallError<Self::Error>> {
        let insistence = attempts.map_or(Insistence::Usual, Insistence::Attempts);
        let ends_motion = command.kind().ends_motion();
        if command.kind() == Opcode::ReleaseBrake.into() {
            self.opening = Some(self.bus.desk().begin_opening(motor));
        } else if !ends_motion {
            // It would wait for itself.
            self.opening = None;
        }
        let at_work = self.bus.desk().begin_work();
        let reply = self.bus.put(motor, &command, insistence, Some(self.since));
        drop(at_work);
        // It may have been sent, whatever the outcome.
        let is_refused = matches!(reply, Err(SharedBusError::Refused { .. }));
        if !is_refused {
            self.since.note_own(command.kind());
        }
        if ends_motion {
            self.opening = None;
        }
        reply.map_err(call_error)
    }

    async fn stop(&mut self, motor: MotorId, kind: StopKind) -> bool {
        self.bus.stop_since(motor, kind, Some(self.since)).is_ok_and(MotorSet::is_empty)
    }

    fn begin_stop(&mut self, motor: MotorId, kind: StopKind) {
        // If the thread has ended, it has stopped the motors.
        let _ = self.bus.desk().stop(motor, kind, Some(self.since));
    }

    fn may_move(&mut self, motor: MotorId) -> Result<(), RequestError> {
        self.bus.desk().may_move(motor, self.since)
    }

    fn note_restart(&mut self, motor: MotorId) {
        // As above.
        let _ = self.bus.desk().order(Order::NoteRestart(motor));
    }

    /// Does nothing: other threads may move the motor, too, and each has to know of the restart first.
    fn resume(&mut self, _: MotorId) {}
}

fn call_error<E>(error: SharedBusError<E>) -> CallError<SharedBusError<E>> {
    match error {
        SharedBusError::Refused { motor, refusal } => CallError::Refused { motor, refusal },
        SharedBusError::Failed { motor, failure } => CallError::Failed { motor, failure },
        error @ (SharedBusError::Bus(_) | SharedBusError::Held | SharedBusError::Panicked(_)) => {
            CallError::Bus(error)
        }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc::{self, sync_channel};
    use std::thread;
    use std::time;

    use embedded_can::{Frame as _, nb};
    use myactuator_protocol_core::command::{
        AbsolutePosition, ErrorFlags, ReadModel, ReadMultiTurnAngle, ReadRunningMode, ReadStatus1,
        ReleaseBrake, Reset, Shutdown, Stop,
    };
    use myactuator_protocol_core::io::CanMaster;
    use myactuator_protocol_core::master::{Config, Event};
    use myactuator_protocol_core::units::{Angle, MaxSpeed};
    use myactuator_protocol_core::wire::can::SimpleFrame;
    use myactuator_protocol_core::{Channel, Packet};

    use super::*;
    use crate::share::tests::{PANIC, fragile, id, packets, shared, shared_fleet};
    use crate::sim::Fleet;
    use crate::sim::bus::can::{CanError, CanPort};
    use crate::sim::bus::trace::Log;
    use crate::sim::plant::Load;

    fn to(degrees: f32, dps: f32) -> AbsolutePosition {
        AbsolutePosition {
            max_speed: MaxSpeed::from_dps(dps).unwrap(),
            angle: Angle::from_degrees(degrees).unwrap(),
        }
    }

    #[test]
    fn motor_is_awaited_and_identified() {
        let (fleet, bus) = shared(1);
        let station = fleet.drives[0].station();
        fleet.world.cut(station);
        let absent = bus.wait_until_there(id(1), Duration::from_millis(50)).unwrap_err();
        assert!(matches!(absent, BringUpError::NotThere(motor) if motor == id(1)), "{absent}");
        thread::scope(|scope| {
            let waiting = scope.spawn(|| bus.wait_until_there(id(1), Duration::from_secs(60)));
            thread::sleep(time::Duration::from_millis(100));
            assert!(!waiting.is_finished());
            fleet.world.mend(station);
            waiting.join().unwrap().unwrap();
        });
        assert_eq!(
            bus.identify(id(1)).unwrap().model,
            Some(bus.ask(id(1), ReadModel).unwrap().model)
        );
    }

    fn go_on(_: &MoveProgress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    type Moved = Result<MoveProgress, NotArrived<SharedBusError<CanError>>>;

    /// Moves a motor for ten seconds if nothing ends that, and calls `then` at a look at which it is on its way.
    fn moved(bus: &SharedBus<CanError>, motor: MotorId, mut then: impl FnMut()) -> Moved {
        let mut is_called = false;
        bus.move_to(motor, to(900.0, 90.0), &MoveLimits::default(), |look| {
            if look.angle.degrees() > 3.0 && !std::mem::replace(&mut is_called, true) {
                then();
            }
            ControlFlow::Continue(())
        })
    }

    /// Whether it stands, 100 ms after that.
    fn stands(bus: &SharedBus<CanError>, motor: MotorId) -> bool {
        let angle = || bus.ask(motor, ReadMultiTurnAngle).unwrap().angle.raw();
        thread::sleep(time::Duration::from_millis(100));
        let before = angle();
        thread::sleep(time::Duration::from_millis(100));
        angle() == before
    }

    #[test]
    fn two_threads_move_two_motors_at_the_same_time() {
        let (_fleet, bus) = shared(2);
        let (met, meets) = (sync_channel(1), sync_channel(1));
        // Each sees the other on its way before it arrives.
        let ways = [(1, met.0, meets.1), (2, meets.0, met.1)].map(|(motor, say, hear)| {
            let (bus, mut has_met) = (bus.clone(), false);
            thread::spawn(move || {
                bus.move_to(id(motor), to(30.0, 60.0), &MoveLimits::default(), |look| {
                    if look.angle.degrees() > 3.0 && !std::mem::replace(&mut has_met, true) {
                        say.send(()).unwrap();
                        hear.recv_timeout(time::Duration::from_secs(10)).expect("the other moves");
                    }
                    ControlFlow::Continue(())
                })
            })
        });
        for way in ways {
            let arrival = way.join().unwrap().unwrap();
            assert!((arrival.angle.degrees() - 30.0).abs() <= 0.2, "{}", arrival.angle);
        }
    }

    #[test]
    fn move_that_another_thread_stops_ends_with_that_reason() {
        let (_fleet, bus) = shared(1);
        let ended = moved(&bus, id(1), || {
            let bus = bus.clone();
            let stopping = thread::spawn(move || bus.stop_all(StopKind::Hold, MotorSet::EMPTY));
            assert_eq!(stopping.join().unwrap().unwrap(), MotorSet::EMPTY);
        });
        let why = ended.unwrap_err();
        assert_eq!(
            why.to_string(),
            "motor 1 has not arrived: the motors were stopped: lift the stop first, if one is in force; it has \
             confirmed the stop, which stays in force until it is lifted"
        );
        assert!(stands(&bus, id(1)));
    }

    #[test]
    fn stops_of_another_thread_do_not_end_the_wait_for_a_motor_to_stand() {
        let (_fleet, bus) = shared(1);
        bus.ask(id(1), ReadStatus1).unwrap();
        thread::scope(|scope| {
            scope.spawn(|| {
                // They drop the questions that are under way.
                for _ in 0..500 {
                    let unconfirmed = bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap();
                    assert_eq!(unconfirmed, MotorSet::EMPTY);
                }
            });
            bus.wait_until_stands(id(1), Duration::from_secs(60)).unwrap();
        });
    }

    #[test]
    fn motor_switched_off_by_another_thread_during_a_move_stays_off() {
        let (_fleet, bus) = shared(1);
        let ended = moved(&bus, id(1), || {
            let bus = bus.clone();
            // It may be told that the stop of the move came first.
            let _ = thread::spawn(move || bus.ask(id(1), Shutdown)).join().unwrap();
        });
        let why = ended.unwrap_err();
        assert!(why.is_stopped, "{why}");
        assert!(!bus.ask(id(1), ReadRunningMode).unwrap().mode.runs());
    }

    #[test]
    fn caller_that_began_before_a_restart_moves_nothing_after_it() {
        let (_fleet, bus) = shared(1);
        let way = &mut Way::on(&bus, id(1));
        bus.ask(id(1), ReadMultiTurnAngle).unwrap();
        way.note_restart(id(1));
        bus.resume(id(1)).unwrap();
        assert_eq!(way.may_move(id(1)), Err(RequestError::Restarted));
        assert!(block_on(way.ask(id(1), to(90.0, 10.0))).is_err());
        assert!(stands(&bus, id(1)));
        assert_eq!(Way::on(&bus, id(1)).may_move(id(1)), Ok(()), "who begins now");
    }

    /// The hold would switch the motor on again. That it was not sent is no end of motion of the caller's own.
    #[test]
    fn caller_whose_hold_was_refused_moves_nothing_after_it() {
        let (fleet, bus) = shared(1);
        let way = &mut Way::on(&bus, id(1));
        bus.ask(id(1), Shutdown).unwrap();
        let log = fleet.world.log();
        assert!(block_on(way.ask(id(1), Stop)).is_err());
        assert_eq!(way.may_move(id(1)), Err(RequestError::Stopped));
        assert!(block_on(way.ask(id(1), to(90.0, 10.0))).is_err());
        assert_eq!(sent(&log), [0_u8; 0]);
    }

    /// A way of working that is left by a panic begins this stop. The motor is off, and was not switched on since.
    #[test]
    fn stop_that_is_only_begun_leaves_a_motor_off_that_another_thread_has_switched_off() {
        let (fleet, bus) = shared(1);
        let way = &mut Way::on(&bus, id(1));
        bus.ask(id(1), Shutdown).unwrap();
        let log = fleet.world.log();
        way.begin_stop(id(1), StopKind::Hold);
        // This goes after the stop.
        bus.ask(id(1), ReadStatus1).unwrap();
        let sent = sent(&log);
        assert!(sent.contains(&0x80) && !sent.contains(&0x81), "{sent:02X?}");
    }

    #[test]
    fn motor_that_does_not_confirm_its_stop_is_not_reported_as_stopped() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
        fleet.world.cut(fleet.drives[0].station());
        let stops = |motor| block_on(Way::on(&bus, id(motor)).stop(id(motor), StopKind::Hold));
        assert_eq!([1, 2].map(stops), [false, true]);
    }

    /// The motor does not hear them; the other one acknowledges the frames.
    #[test]
    fn way_of_working_asks_as_often_as_it_says() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
        fleet.world.cut(fleet.drives[0].station());
        let log = fleet.world.log();
        for attempts in [1, 2, 5] {
            let way = &mut Way::on(&bus, id(1));
            assert!(block_on(way.ask_often(id(1), ReadModel, Some(attempts))).is_err());
            let asked = sent(&log).into_iter().filter(|byte| *byte == 0xB5).count();
            assert_eq!(asked, usize::from(attempts));
        }
    }

    #[test]
    fn drive_that_restarts_during_a_move_is_not_moved_until_resumed() {
        let restart = "reset@1+1s".parse().unwrap();
        let fleet = Fleet::new(1).faults([restart]).on_can(1_000_000).unwrap();
        let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
        let events = bus.subscribe(100_000);
        let ended = moved(&bus, id(1), || {});
        let why = ended.unwrap_err().why;
        let is_restart = |call: &CallError<_>| {
            matches!(call, CallError::Refused { refusal: RequestError::Restarted, .. })
        };
        assert!(matches!(&why, MoveFailure::Call(call) if is_restart(call)), "{why}");
        let mut reported = std::iter::from_fn(|| events.try_next());
        assert!(reported.any(|event| event == Event::Restarted { motor: id(1) }));
        bus.lift_stop().unwrap();
        assert!(bus.set_point(id(1), to(0.0, 10.0)).is_err(), "until it is resumed");
        bus.wait_until_stands(id(1), Duration::from_secs(1)).unwrap();
    }

    #[test]
    fn panic_during_a_move_stops_the_motor() {
        let (_fleet, bus) = shared(1);
        let panics = || -> () { panic!("as it is meant to") };
        assert!(catch_unwind(AssertUnwindSafe(|| moved(&bus, id(1), panics))).is_err());
        assert!(stands(&bus, id(1)));
        assert!(bus.set_point(id(1), to(0.0, 10.0)).is_err(), "the stop is in force");
    }

    /// The second move is refused at once: nothing of it was sent when the first looks again.
    #[test]
    fn second_move_of_a_moving_motor_is_refused() {
        let (fleet, bus) = shared(1);
        let log = fleet.world.log();
        let mut is_asked = false;
        let arrived = bus.move_to(id(1), to(30.0, 60.0), &MoveLimits::default(), |look| {
            if look.angle.degrees() > 3.0 && !std::mem::replace(&mut is_asked, true) {
                let bus = bus.clone();
                sent(&log);
                let other = thread::spawn(move || {
                    bus.move_to(id(1), to(-90.0, 60.0), &MoveLimits::default(), go_on)
                });
                let returned = other.join().unwrap().unwrap_err();
                assert!(matches!(returned.why, MoveFailure::UnderWay), "{returned}");
                assert_eq!(
                    returned.to_string(),
                    "motor 1 has not arrived: another move of it is under way and goes on: wait for its end, or stop \
                     the motor"
                );
                assert_eq!(sent(&log), [0_u8; 0]);
            }
            ControlFlow::Continue(())
        });
        assert!(is_asked);
        assert!((arrived.unwrap().angle.degrees() - 30.0).abs() <= 0.2);
    }

    #[test]
    fn however_a_move_has_ended_its_motor_may_be_moved_again() {
        let (_fleet, bus) = shared(2);
        let back = |degrees| {
            bus.lift_stop().unwrap();
            bus.move_to(id(1), to(degrees, 180.0), &MoveLimits::default(), go_on).unwrap();
        };
        back(5.0);
        back(0.0);
        let gives_up = |_: &MoveProgress| ControlFlow::Break(());
        bus.move_to(id(1), to(90.0, 90.0), &MoveLimits::default(), gives_up).unwrap_err();
        back(0.0);
        let panics = || -> () { panic!("as it is meant to") };
        assert!(catch_unwind(AssertUnwindSafe(|| moved(&bus, id(1), panics))).is_err());
        back(0.0);
        assert_eq!(bus.stop(id(1), StopKind::Hold).unwrap(), MotorSet::EMPTY);
        bus.move_to(id(1), to(90.0, 90.0), &MoveLimits::default(), go_on).unwrap_err();
        back(0.0);
    }

    #[test]
    fn virtual_time_goes_on_while_a_move_waits() {
        let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
        let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
        bus.release_brake(id(1)).unwrap();
        let arrival = bus.move_to(id(1), to(90.0, 45.0), &MoveLimits::default(), go_on).unwrap();
        assert!((arrival.angle.degrees() - 90.0).abs() <= 0.2, "{}", arrival.angle);
    }

    /// Locking the brake fails, and the motor holds again with its brake open.
    fn check_that_the_motor_holds_after_a_slip(bus: &SharedBus<CanError>) {
        let returned = bus.lock_brake(id(1));
        assert!(
            matches!(returned, Err(BringUpError::BrakeSlips { holds: Some(true), .. })),
            "{returned:?}"
        );
    }

    /// The lock (0x78) that this caller sent itself does not keep it from opening the brake again.
    #[test]
    fn motor_holds_its_load_again_when_its_brake_slips() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let (fleet, bus) = shared_fleet(&Fleet::new(1).brakes(true).load(load));
        bus.release_brake(id(1)).unwrap();
        fleet.drives[0].with(|drive| drive.plant_mut().force_brake(Some(true)));
        check_that_the_motor_holds_after_a_slip(&bus);
        let degrees = || bus.ask(id(1), ReadMultiTurnAngle).unwrap().angle.degrees();
        let held = degrees();
        thread::sleep(time::Duration::from_millis(300));
        assert!((degrees() - held).abs() < 1.0, "{held} and {}", degrees());
    }

    /// One that is not answered would keep the motor from being told to hold, while its load falls.
    #[test]
    fn question_of_another_thread_waits_until_a_motor_whose_brake_opens_was_told_to_hold() {
        let (fleet, bus) = shared_fleet(&Fleet::new(1).brakes(true));
        let (log, way) = (fleet.world.log(), &mut Way::on(&bus, id(1)));
        block_on(way.ask(id(1), ReleaseBrake)).unwrap();
        thread::scope(|scope| {
            let asking = scope.spawn(|| bus.ask(id(1), ReadModel));
            thread::sleep(time::Duration::from_millis(50));
            block_on(way.ask(id(1), Stop)).unwrap();
            asking.join().unwrap().unwrap();
        });
        // It has answered one command before the first of these.
        assert_eq!(sent(&log), [0x77, 0x81, 0x81, 0xB5]);
    }

    /// It asks something else instead, or ends.
    #[test]
    fn caller_that_has_opened_a_brake_and_does_not_hold_blocks_nobody() {
        let (_fleet, bus) = shared_fleet(&Fleet::new(1).brakes(true));
        let mut way = Way::on(&bus, id(1));
        block_on(way.ask(id(1), ReleaseBrake)).unwrap();
        block_on(way.ask(id(1), ReadStatus1)).unwrap();
        bus.ask(id(1), ReadModel).unwrap();
        block_on(way.ask(id(1), ReleaseBrake)).unwrap();
        drop(way);
        bus.ask(id(1), ReadModel).unwrap();
    }

    /// A restart takes more than a second.
    #[test]
    fn others_hold_while_a_motor_is_restarted() {
        let (fleet, bus) = shared_fleet(&Fleet::new(2).brakes(true));
        bus.release_brake(id(2)).unwrap();
        bus.protect(id(2), Milliseconds::from_raw(400)).unwrap();
        bus.restart(id(1)).unwrap();
        assert!(fleet.drives[1].with(|drive| drive.state()).output_on);
    }

    /// A bus that tells this when a frame with this byte was sent, and when it is answered.
    struct Tells<F>(CanPort, u8, F);

    impl<F: FnMut(&str)> nb::Can for Tells<F> {
        type Frame = SimpleFrame;
        type Error = CanError;

        fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, CanError> {
            let handed_back = self.0.transmit(frame)?;
            if frame.data()[0] == self.1 {
                (self.2)("sent");
            }
            Ok(handed_back)
        }

        fn receive(&mut self) -> ::nb::Result<SimpleFrame, CanError> {
            let frame = self.0.receive()?;
            if frame.data()[0] == self.1 {
                (self.2)("answered");
            }
            Ok(frame)
        }
    }

    /// What is sent while a brake opens and another thread does this at this moment, and whether the brake is released.
    fn opened(
        (byte, moment): (u8, &'static str),
        meanwhile: fn(&SharedBus<CanError>),
    ) -> (Vec<u8>, bool) {
        let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
        let (opens, is_opening) = mpsc::channel();
        let port = Tells(fleet.world.port(), byte, move |now: &str| {
            if now == moment {
                let _ = opens.send(());
                // The other thread calls meanwhile.
                thread::sleep(time::Duration::from_millis(50));
            }
        });
        let clock = fleet.world.clock();
        let master = CanMaster::<_, _, { MotorId::COUNT }>::new(port, clock, Config::CAN);
        let (log, bus) = (fleet.world.log(), SharedBus::new(master, StopKind::Hold));
        let other = bus.clone();
        let calling = thread::spawn(move || {
            is_opening.recv().unwrap();
            meanwhile(&other);
        });
        let is_released = bus.release_brake(id(1)).is_ok();
        calling.join().unwrap();
        (sent(&log), is_released)
    }

    /// Checks that a brake is locked that opens when another thread switches the motor off, in this way and at this
    /// moment. Nothing else can hold its load then.
    fn is_locked_though_opened(
        (byte, moment): (u8, &'static str),
        switch_off: fn(&SharedBus<CanError>),
    ) {
        let (sent, is_released) = opened((byte, moment), switch_off);
        assert!(!is_released, "{byte:02X} {moment}");
        // While the thread of the release is away, the clock goes on, and the motor is kept alive.
        let mut since_off =
            sent.iter().filter(|&&byte| byte != 0xB1).skip_while(|&&byte| byte != 0x80).take(6);
        // At once, not after all the looks while the brake opens.
        assert!(since_off.any(|&byte| byte == 0x78), "{byte:02X} {moment}: {sent:02X?}");
    }

    #[test]
    fn brake_of_a_motor_that_another_thread_switches_off_while_it_opens_is_locked() {
        is_locked_though_opened((0x77, "answered"), |bus| _ = bus.ask(id(1), Shutdown).unwrap());
        for moment in [(0x77, "sent"), (0x77, "answered"), (0x81, "sent"), (0x81, "answered")] {
            is_locked_though_opened(moment, |bus| {
                assert!(bus.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap().is_empty());
            });
        }
    }

    /// The stop is what holds its load.
    #[test]
    fn brake_of_a_motor_that_another_thread_stops_to_hold_while_it_opens_is_released() {
        let (sent, is_released) = opened((0x81, "answered"), |bus| {
            assert!(bus.stop(id(1), StopKind::Hold).unwrap().is_empty());
        });
        assert!(is_released && !sent.contains(&0x78), "{sent:02X?}");
    }

    /// A bus on which the answers to 0x78 are lost.
    struct Deaf(CanPort);

    impl nb::Can for Deaf {
        type Frame = SimpleFrame;
        type Error = CanError;

        fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, CanError> {
            self.0.transmit(frame)
        }

        fn receive(&mut self) -> ::nb::Result<SimpleFrame, CanError> {
            loop {
                let frame = self.0.receive()?;
                if frame.data()[0] != 0x78 {
                    return Ok(frame);
                }
            }
        }
    }

    #[test]
    fn motor_holds_its_load_again_after_an_unanswered_lock_that_slips() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let fleet = Fleet::new(1).brakes(true).load(load).on_can(1_000_000).unwrap();
        let (port, clock) = (Deaf(fleet.world.port()), fleet.world.clock());
        let master = CanMaster::<_, _, { MotorId::COUNT }>::new(port, clock, Config::CAN);
        let bus = SharedBus::new(master, StopKind::Hold);
        bus.release_brake(id(1)).unwrap();
        fleet.drives[0].with(|drive| drive.plant_mut().force_brake(Some(true)));
        check_that_the_motor_holds_after_a_slip(&bus);
    }

    #[test]
    fn protection_is_stored_in_the_drive_and_refused_while_stopped() {
        let (fleet, bus) = shared(1);
        let timeout = Milliseconds::from_raw(500);
        assert_eq!(bus.protect(id(1), timeout).unwrap(), Protection::Confirmed);
        let stored = fleet.drives[0].with(|drive| drive.stored_settings().protection_timeout);
        assert_eq!(stored, timeout);
        assert_eq!(bus.stop_all(StopKind::Hold, MotorSet::EMPTY).unwrap(), MotorSet::EMPTY);
        assert!(bus.protect(id(1), timeout).is_err(), "a stop refuses it");
    }

    /// The bytes of the commands that were sent since this was last asked.
    fn sent(log: &Log<SimpleFrame>) -> Vec<u8> {
        let is_command = |packet: &Packet| matches!(packet.channel, Channel::Command(_));
        packets(log).iter().filter(|packet| is_command(packet)).map(|it| it.data[0]).collect()
    }

    /// Another thread sets points for it all the while.
    #[test]
    fn restarted_drive_has_no_error_and_is_not_moved_until_resumed() {
        let (fleet, bus) = shared_fleet(&Fleet::new(2).brakes(true));
        fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
        let errors = || bus.ask(id(1), ReadStatus1).unwrap().errors;
        assert!(!errors().is_empty());
        fleet.drives[0].with(|drive| drive.clear_fault(ErrorFlags::all()));
        let is_over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    let _ = bus.set_point(id(1), to(90.0, 10.0));
                    bus.ask(id(2), ReadStatus1).unwrap();
                }
            });
            let log = fleet.world.log();
            let returned = bus.restart(id(1));
            let sent = sent(&log);
            // Behind the last 0x76 nothing has moved it.
            let refused = bus.set_point(id(1), to(90.0, 10.0));
            is_over.store(true, Ordering::Relaxed);
            assert!(returned.is_ok(), "{returned:?}");
            let restarted = sent.iter().rposition(|byte| *byte == 0x76).expect("it was told to");
            assert!(!sent[restarted..].contains(&0xA4), "{sent:02X?}");
            let refused = refused.unwrap_err().to_string();
            assert!(refused.starts_with("motor 1: the motor may have restarted"), "{refused}");
        });
        assert_eq!(errors(), ErrorFlags::empty());
        bus.resume(id(1)).unwrap();
        bus.release_brake(id(1)).unwrap();
        assert!(bus.move_to(id(1), to(5.0, 90.0), &MoveLimits::default(), go_on).is_ok());
    }

    /// A bus that loses the first 0x76.
    struct Forgetful(CanPort, bool);

    impl nb::Can for Forgetful {
        type Frame = SimpleFrame;
        type Error = CanError;

        fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, CanError> {
            if frame.data()[0] == 0x76 && !std::mem::replace(&mut self.1, true) {
                return Ok(None);
            }
            self.0.transmit(frame)
        }

        fn receive(&mut self) -> ::nb::Result<SimpleFrame, CanError> {
            self.0.receive()
        }
    }

    #[test]
    fn restart_that_a_drive_missed_is_sent_again() {
        let fleet = Fleet::new(1).brakes(true).on_can(1_000_000).unwrap();
        fleet.drives[0].with(|drive| drive.raise_fault(ErrorFlags::STALL));
        fleet.drives[0].with(|drive| drive.clear_fault(ErrorFlags::all()));
        // A busy machine holds this thread up for no more than half of that, while virtual time goes on.
        fleet.world.run_for(Duration::from_secs(60));
        let (port, clock) = (Forgetful(fleet.world.port(), false), fleet.world.clock());
        let master = CanMaster::<_, _, { MotorId::COUNT }>::new(port, clock, Config::CAN);
        let bus = SharedBus::new(master, StopKind::Hold);
        assert!(!bus.ask(id(1), ReadStatus1).unwrap().errors.is_empty());
        let returned = bus.restart(id(1));
        assert!(returned.is_ok(), "{returned:?}");
        assert!(bus.ask(id(1), ReadStatus1).unwrap().errors.is_empty());
        assert!(bus.set_point(id(1), to(5.0, 10.0)).is_err(), "until it is resumed");
    }

    #[test]
    fn brake_holds_the_load_while_its_motor_restarts() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let fleet = Fleet::new(1).brakes(true).load(load).on_can(1_000_000).unwrap();
        let bus = SharedBus::new(fleet.master::<8>(), StopKind::Hold);
        bus.release_brake(id(1)).unwrap();
        let angle_deg = || fleet.drives[0].with(|drive| drive.plant().output_angle_deg());
        let (log, held_deg) = (fleet.world.log(), angle_deg());
        bus.restart(id(1)).unwrap();
        let mut commands = sent(&log);
        commands.retain(|byte| [0x76, 0x78, 0x80].contains(byte));
        assert_eq!(commands, [0x78, 0x80, 0x76]);
        assert!((angle_deg() - held_deg).abs() < 1.0, "{held_deg} and {}", angle_deg());
    }

    #[test]
    fn motor_whose_brake_slips_holds_its_load_and_is_not_restarted() {
        let load = Load { torque_nm: 5.0, ..Load::NONE };
        let (fleet, bus) = shared_fleet(&Fleet::new(1).brakes(true).load(load));
        bus.release_brake(id(1)).unwrap();
        fleet.drives[0].with(|drive| drive.plant_mut().force_brake(Some(true)));
        let log = fleet.world.log();
        let returned = bus.restart(id(1));
        assert!(
            matches!(returned, Err(BringUpError::BrakeSlips { holds: Some(true), .. })),
            "{returned:?}"
        );
        assert!(!sent(&log).contains(&0x76));
    }

    #[test]
    fn restart_while_stopped_is_refused_before_the_motor_is_switched_off() {
        let (fleet, bus) = shared(1);
        assert_eq!(bus.stop_all(StopKind::Hold, id(1).into()).unwrap(), MotorSet::EMPTY);
        let log = fleet.world.log();
        let returned = bus.restart(id(1)).unwrap_err();
        assert!(returned.to_string().contains("the motors were stopped"), "{returned}");
        assert_eq!(sent(&log), [0_u8; 0]);
    }

    /// The stop comes while the brake locks for the restart.
    #[test]
    fn stop_during_a_restart_keeps_the_motor_switched_on() {
        let (fleet, bus) = shared_fleet(&Fleet::new(1).brakes(true));
        bus.release_brake(id(1)).unwrap();
        let log = fleet.world.log();
        thread::scope(|scope| {
            let restart = scope.spawn(|| bus.restart(id(1)));
            while !sent(&log).contains(&0x78) {
                thread::sleep(time::Duration::from_millis(1));
            }
            assert_eq!(bus.stop(id(1), StopKind::Hold).unwrap(), MotorSet::EMPTY);
            let returned = restart.join().unwrap().unwrap_err();
            assert!(returned.to_string().contains("the motors were stopped"), "{returned}");
        });
        let sent = sent(&log);
        assert!(sent.contains(&0x81) && !sent.contains(&0x80), "{sent:02X?}");
    }

    /// The stop comes between the shutdown of the motor and the reset (0x76).
    #[test]
    fn reset_of_a_restart_begun_before_a_stop_is_refused() {
        let (fleet, bus) = shared(1);
        let way = &mut Way::on(&bus, id(1));
        block_on(way.ask(id(1), Shutdown)).unwrap();
        assert_eq!(bus.stop(id(1), StopKind::Hold).unwrap(), MotorSet::EMPTY);
        bus.lift_stop().unwrap();
        let log = fleet.world.log();
        assert!(block_on(way.ask(id(1), Reset)).is_err());
        assert_eq!(sent(&log), [0_u8; 0]);
        assert!(bus.ask(id(1), Reset).is_ok(), "who begins now");
    }

    #[test]
    fn a_move_ends_when_the_thread_of_the_bus_has_panicked() {
        let (_fleet, order, bus) = fragile();
        let ended = moved(&bus, id(1), || order.store(PANIC, Ordering::SeqCst));
        let why = ended.unwrap_err();
        assert!(why.to_string().contains("has ended: "), "{why}");
        assert!(!why.is_stopped);
    }
}

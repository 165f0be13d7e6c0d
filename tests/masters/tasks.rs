//! The same ways of working as async tasks. Each is one future, which may be dropped at any point.

use std::fmt::Debug;
use std::ops::ControlFlow;

use embassy_futures::select::{Either, select};
use myactuator_host_std::sim::bus::Medium;
use myactuator_host_std::sim::{BusFleet, Fleet};
use myactuator_protocol_core::RequestError;
use myactuator_protocol_core::command::{AnyReply, ReadMultiTurnAngle, ReadStatus1};
use myactuator_protocol_core::io::async_bring_up::{self, move_to};
use myactuator_protocol_core::io::bring_up::{MoveFailure, MoveLimits, Protection};
use myactuator_protocol_core::io::{AsyncClock, AsyncRunner, CallError, Clock};
use myactuator_protocol_core::master::{Failure, MotorSet, StopKind};
use myactuator_protocol_core::units::Milliseconds;
use myactuator_tests::fleet::{state, turn_to};
use myactuator_tests::values::{go_to, grip_at, id, millis, push};

/// Makes a test for each bus of each async function.
macro_rules! on_both_buses {
    ($($name:ident)+) => {
        mod on_can {
            $(#[test] fn $name() {
                let fleet = super::fleet().on_can(1_000_000).unwrap();
                fleet.block_on(super::$name(&fleet, &mut fleet.async_master::<8>()));
            })+
        }
        mod on_rs485 {
            $(#[test] fn $name() {
                let fleet = super::fleet().on_rs485(1_000_000).unwrap();
                fleet.block_on(super::$name(&fleet, &mut fleet.async_master::<8>()));
            })+
        }
    };
}

on_both_buses! {
    a_motor_is_found_named_zeroed_and_renamed
    motors_are_asked_together
    a_set_point_is_waited_for
    a_motor_arrives
    motor_that_is_held_is_stopped
    a_move_that_is_dropped_stops_its_motor
    a_stop_that_is_dropped_goes_on
}

fn fleet() -> Fleet {
    Fleet::new(3).brakes(true)
}

fn go_on<T>(_: &T) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

async fn a_motor_is_found_named_zeroed_and_renamed<B: Medium, R: AsyncRunner<8>>(
    fleet: &BusFleet<B>,
    bus: &mut R,
) where
    R::Error: Debug + PartialEq,
{
    let all: MotorSet = [1, 2, 3].into_iter().map(id).collect();
    assert_eq!(async_bring_up::scan(bus, MotorSet::ALL, |_, _| {}).await, Ok(all));
    turn_to(&fleet.drives[1], 40.0);
    let is = async_bring_up::identify(bus, id(2)).await.unwrap();
    assert!(is.model.is_some() && is.status.errors.is_empty(), "{is:?}");
    async_bring_up::zero_here(bus, id(2)).await.unwrap();
    assert!(bus.ask(id(2), ReadMultiTurnAngle).await.unwrap().angle.degrees().abs() < 0.5);
    assert_eq!(async_bring_up::is_shared(bus, id(2)).await, Ok(false));
    async_bring_up::change_id(bus, id(2), id(7)).await.unwrap();
    assert_eq!(async_bring_up::is_there(bus, id(7)).await, Ok(true));
    assert_eq!(async_bring_up::is_there(bus, id(2)).await, Ok(false));
    assert!(!bus.master().motors().contains(id(2)), "each stop of all would wait for it");
    async_bring_up::release_brake(bus, id(7)).await.unwrap();
    let limit = Milliseconds::from_raw(200);
    assert_eq!(async_bring_up::protect(bus, id(7), limit).await, Ok(Protection::Confirmed));
}

async fn motors_are_asked_together<B: Medium, R: AsyncRunner<8>>(fleet: &BusFleet<B>, bus: &mut R)
where
    R::Error: Debug + PartialEq,
{
    turn_to(&fleet.drives[2], 30.0);
    let soon = bus.now() + millis(20);
    bus.run_until(soon, |_| {}).await.unwrap();
    let asked = [3, 9, 1].map(|motor| (id(motor), ReadMultiTurnAngle));
    let returned = bus.ask_together(asked).await;
    let returned = returned.map(|answer| answer.map(|reply| reply.angle.degrees().round()));
    assert_eq!(
        returned,
        [Ok(30.0), Err(CallError::Failed { motor: id(9), failure: Failure::NoReply }), Ok(0.0)]
    );
}

async fn a_set_point_is_waited_for<B: Medium, R: AsyncRunner<8>>(_: &BusFleet<B>, bus: &mut R)
where
    R::Error: Debug + PartialEq,
{
    let feedback = bus.set_point_and_wait(id(1), push(0.0)).await.unwrap();
    let latest = bus.master().latest_feedback(id(1)).map(|(reply, _time)| reply);
    assert_eq!(latest, Some(AnyReply::Torque(feedback)));
    assert!(bus.stop(id(1), StopKind::Hold).await);
    let refused = bus.set_point_and_wait(id(1), push(0.0)).await;
    assert_eq!(refused, Err(CallError::refused(id(1))(RequestError::Stopped)));
}

async fn a_motor_arrives<B: Medium, R: AsyncRunner<8>>(fleet: &BusFleet<B>, bus: &mut R)
where
    R::Error: Debug + PartialEq,
{
    async_bring_up::release_brake(bus, id(1)).await.unwrap();
    let limits = MoveLimits::default();
    let arrival = move_to(bus, id(1), go_to(60.0, 180), &limits, go_on).await.unwrap();
    assert!((arrival.angle.degrees() - 60.0).abs() <= 0.2, "{arrival:?}");
    assert!((state(&fleet.drives[0]).angle_deg - 60.0).abs() < 0.3);
}

async fn motor_that_is_held_is_stopped<B: Medium, R: AsyncRunner<8>>(_: &BusFleet<B>, bus: &mut R)
where
    R::Error: Debug + PartialEq,
{
    async_bring_up::release_brake(bus, id(1)).await.unwrap();
    // Friction holds its shaft.
    let limits = MoveLimits::default();
    let not_arrived = move_to(bus, id(1), grip_at(60.0, 1), &limits, go_on).await.unwrap_err();
    assert!(matches!(not_arrived.why, MoveFailure::Stalled { .. }), "{not_arrived}");
    assert!(not_arrived.is_stopped);
}

async fn a_move_that_is_dropped_stops_its_motor<B: Medium, R: AsyncRunner<8>>(
    fleet: &BusFleet<B>,
    bus: &mut R,
) where
    R::Error: Debug + PartialEq,
{
    async_bring_up::release_brake(bus, id(1)).await.unwrap();
    let mut clock = fleet.world.clock();
    let soon = clock.now() + millis(250);
    let limits = MoveLimits::default();
    let moving = move_to(bus, id(1), go_to(90.0, 180), &limits, go_on);
    let first = select(moving, clock.wait_until(soon)).await;
    assert!(matches!(first, Either::Second(())), "it takes half a second");
    let refused = bus.set_point(id(1), push(0.1));
    assert_eq!(refused, Err(CallError::refused(id(1))(RequestError::Stopped)));
    // Any other future of the loop sends the stop first.
    bus.ask(id(2), ReadStatus1).await.unwrap();
    let later = bus.now() + millis(500);
    bus.run_until(later, |_| {}).await.unwrap();
    let at = state(&fleet.drives[0]).angle_deg;
    assert!((10.0..80.0).contains(&at), "{at}");
}

async fn a_stop_that_is_dropped_goes_on<B: Medium, R: AsyncRunner<8>>(
    fleet: &BusFleet<B>,
    bus: &mut R,
) where
    R::Error: Debug + PartialEq,
{
    async_bring_up::release_brake(bus, id(1)).await.unwrap();
    bus.ask(id(1), go_to(90.0, 180)).await.unwrap();
    let soon = bus.now() + millis(250);
    bus.run_until(soon, |_| {}).await.unwrap();
    let now = bus.now();
    let dropped = select(bus.stop_all(StopKind::Hold, MotorSet::EMPTY), async {}).await;
    assert!(matches!(dropped, Either::Second(())) && bus.now() == now);
    let later = now + millis(500);
    bus.run_until(later, |_| {}).await.unwrap();
    let at = state(&fleet.drives[0]).angle_deg;
    assert!((10.0..80.0).contains(&at), "{at}");
}

//! The async loop over CAN.

use core::fmt;
use core::future::ready;
use core::marker::PhantomData;

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embedded_can::Frame;

use crate::io::async_clock::{AsyncClock, wait};
use crate::io::async_runner::{AsyncRunner, earlier};
use crate::io::can::{FRAMES_A_ROUND, note_failed_receive, take_back};
use crate::io::runner::{RETRY_AFTER, STUCK_AFTER};
use crate::master::{Config, Event, Master};
use crate::time::{Duration, Instant};
use crate::wire::can;

/// An async CAN controller: what embedded-can has no trait for.
///
/// The drivers of the HALs have these two functions under other names, often on two halves.
/// [`CanHalves`] makes them one of these.
///
/// The futures need not be `Send`: one task runs one bus.
#[allow(async_fn_in_trait, reason = "one task runs one bus, so nothing asks for Send")]
pub trait AsyncCan {
    /// The driver's frame.
    type Frame: Frame;
    /// What the driver reports when it fails.
    type Error: embedded_can::Error;

    /// Gives a frame to the controller and is done once it has taken it, that is, once it lies in a
    /// mailbox or queue. It must not wait until the frame is on the bus: one frame would be on its
    /// way at a time. Gives the frame that had to make way for it, if one had.
    ///
    /// It is dropped when the controller takes nothing for the time of a frame. A frame whose future was
    /// dropped must not have been taken: it is offered again, unless something more urgent is.
    async fn transmit(&mut self, frame: &Self::Frame) -> Result<Option<Self::Frame>, Self::Error>;

    /// The next frame from the bus.
    ///
    /// It is dropped and called anew all the time. Dropping must lose no frame: one that arrives
    /// later, or has arrived, is for the next call.
    async fn receive(&mut self) -> Result<Self::Frame, Self::Error>;
}

impl<C: AsyncCan + ?Sized> AsyncCan for &mut C {
    type Frame = C::Frame;
    type Error = C::Error;

    async fn transmit(&mut self, frame: &C::Frame) -> Result<Option<C::Frame>, C::Error> {
        (**self).transmit(frame).await
    }

    async fn receive(&mut self) -> Result<C::Frame, C::Error> {
        (**self).receive().await
    }
}

/// An [`AsyncCan`] from the two halves of a driver, whatever they are called.
///
/// ```
/// # mod hal {
/// #     pub use myactuator_protocol_core::wire::can::SimpleFrame as Frame;
/// #     pub struct Envelope { pub frame: Frame }
/// #     #[derive(Debug)] pub struct BusError;
/// #     impl embedded_can::Error for BusError {
/// #         fn kind(&self) -> embedded_can::ErrorKind { embedded_can::ErrorKind::Other }
/// #     }
/// #     pub struct CanTx; pub struct CanRx;
/// #     impl CanTx { pub async fn write(&mut self, _: &Frame) -> Option<Frame> { None } }
/// #     impl CanRx { pub async fn read(&mut self) -> Result<Envelope, BusError> { Err(BusError) } }
/// # }
/// use myactuator_protocol_core::io::{AsyncCan, CanHalves};
///
/// # let (mut tx, mut rx) = (hal::CanTx, hal::CanRx);
/// // let (mut tx, mut rx) = can.split();
/// let can = CanHalves::new(
///     async |frame: &hal::Frame| Ok(tx.write(frame).await),
///     async || rx.read().await.map(|envelope| envelope.frame),
/// );
/// # fn is_can(_: impl AsyncCan<Frame = hal::Frame, Error = hal::BusError>) {}
/// # is_can(can);
/// ```
///
/// What [`AsyncCan`] asks of `transmit` and `receive` holds for the two functions.
pub struct CanHalves<T, R, F, E> {
    transmit: T,
    receive: R,
    kinds: PhantomData<fn() -> (F, E)>,
}

impl<T, R, F, E> CanHalves<T, R, F, E>
where
    T: AsyncFnMut(&F) -> Result<Option<F>, E>,
    R: AsyncFnMut() -> Result<F, E>,
{
    /// The function that sends and the one that receives.
    pub const fn new(transmit: T, receive: R) -> Self {
        Self { transmit, receive, kinds: PhantomData }
    }
}

impl<T, R, F, E> fmt::Debug for CanHalves<T, R, F, E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CanHalves").finish_non_exhaustive()
    }
}

impl<T, R, F, E> AsyncCan for CanHalves<T, R, F, E>
where
    T: AsyncFnMut(&F) -> Result<Option<F>, E>,
    R: AsyncFnMut() -> Result<F, E>,
    F: Frame,
    E: embedded_can::Error,
{
    type Frame = F;
    type Error = E;

    async fn transmit(&mut self, frame: &F) -> Result<Option<F>, E> {
        (self.transmit)(frame).await
    }

    async fn receive(&mut self) -> Result<F, E> {
        (self.receive)().await
    }
}

/// Runs a [`Master`] on an async CAN controller.
///
/// It gives the controller frames for as long as it takes them at once, and looks for a received one
/// after each, so that a controller with few places for received frames loses none.
#[derive(Debug)]
pub struct AsyncCanMaster<C, K, const N: usize> {
    can: C,
    clock: K,
    master: Master<N>,
    /// Since when the bus has not taken what is offered to it.
    stuck_since: Option<Instant>,
    /// Until when it was offered something last.
    offered_at: Instant,
    /// The event of a frame, until somebody takes it. Here rather than in a future, which may be
    /// dropped.
    told: Option<Event>,
}

impl<C: AsyncCan, K: AsyncClock, const N: usize> AsyncCanMaster<C, K, N> {
    /// A loop on this controller, timed by this clock.
    pub fn new(can: C, clock: K, config: Config) -> Self {
        Self {
            can,
            clock,
            master: Master::new(config),
            stuck_since: None,
            offered_at: Instant::ZERO,
            told: None,
        }
    }

    /// The controller and the clock back.
    pub fn release(self) -> (C, K) {
        (self.can, self.clock)
    }

    fn take(&mut self, received: Result<C::Frame, C::Error>) -> Result<(), C::Error> {
        let now = self.clock.now();
        match received {
            Ok(frame) => {
                self.told = self.master.handle_frame(&can::decode(&frame), now);
                Ok(())
            }
            Err(error) => {
                note_failed_receive(&mut self.master, &error, now);
                Err(error)
            }
        }
    }

    /// Takes what the controller holds, up to the first event, but not so much that a babbling bus could
    /// keep the task.
    async fn receive(&mut self) -> Result<(), C::Error> {
        for _ in 0..FRAMES_A_ROUND {
            if self.told.is_some() {
                return Ok(());
            }
            match select(self.can.receive(), ready(())).await {
                Either::First(received) => self.take(received)?,
                Either::Second(()) => return Ok(()),
            }
        }
        yield_now().await;
        Ok(())
    }

    /// Sends what the bus takes, up to the first event. Gives a time to try again if it takes no
    /// more.
    async fn transmit(&mut self) -> Result<Option<Instant>, C::Error> {
        loop {
            let now = self.clock.now();
            // A task that did something else meanwhile has not found the bus stuck.
            if now - core::mem::replace(&mut self.offered_at, now) >= STUCK_AFTER {
                self.stuck_since = None;
            }
            let is_stuck = self.stuck_since.is_some_and(|since| now - since >= STUCK_AFTER);
            let Some(packet) = self.master.poll_transmit(now) else { return Ok(None) };
            // A HAL that refuses eight bytes is no CAN HAL; nothing can be sent on it.
            let Some(frame) = can::encode::<C::Frame>(&packet) else { return Ok(None) };
            self.stuck_since.get_or_insert(now);
            // While it waits nothing is received, and a controller has few places for that. A bus that is
            // stuck is offered it all the same, as it may be well again.
            let frame_time = self.master.config().frame_time;
            let patience = if is_stuck { Duration::ZERO } else { frame_time };
            let patience = self.clock.wait_until(now + patience);
            match select(self.can.transmit(&frame), patience).await {
                Either::First(Ok(pushed_out)) => {
                    self.stuck_since = None;
                    self.master.handle_transmitted(self.clock.now());
                    take_back(&mut self.master, pushed_out.as_ref());
                }
                Either::First(Err(error)) => {
                    self.stuck_since = None;
                    self.master.handle_bus_down(self.clock.now());
                    return Err(error);
                }
                Either::Second(()) if is_stuck => {
                    self.master.handle_bus_down(now);
                    return Ok(Some(self.clock.now() + RETRY_AFTER));
                }
                Either::Second(()) => self.offered_at = self.clock.now(),
            }
            self.receive().await?;
            if self.told.is_some() {
                return Ok(None);
            }
        }
    }
}

impl<C: AsyncCan, K: AsyncClock, const N: usize> AsyncRunner<N> for AsyncCanMaster<C, K, N> {
    type Error = C::Error;

    fn master(&mut self) -> &mut Master<N> {
        &mut self.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, C::Error> {
        loop {
            // What was received comes first, so that the caller's answer to it is there when the
            // next command is chosen.
            if let Err(error) = self.receive().await {
                // Some controllers report a bad state with each look: no stop waits for its end.
                let _ = self.transmit().await;
                return Err(error);
            }
            if let Some(event) = self.told.take() {
                return Ok(Some(event));
            }
            self.master.handle_timeout(self.clock.now());
            let retry_at = self.transmit().await?;
            let event = self.told.take().or_else(|| self.master.poll_event());
            if event.is_some() || until.is_some_and(|until| until <= self.clock.now()) {
                return Ok(event);
            }
            let wake_at = earlier(earlier(self.master.poll_at(), retry_at), until);
            let timer = wait(&mut self.clock, wake_at);
            if let Either::First(received) = select(self.can.receive(), timer).await {
                self.take(received)?;
            }
        }
    }
}

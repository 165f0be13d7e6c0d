//! The async loop over CAN.

use core::fmt;
use core::future::poll_fn;
use core::pin::pin;
use core::task::{Context, Poll};

use embedded_can::{Frame, nb};

use crate::io::async_runner::AsyncRunner;
use crate::io::can::CanPort;
use crate::io::clock::AsyncClock;
use crate::io::pump::Pump;
use crate::io::rest::rest;
use crate::master::{Config, Event, Master};
use crate::time::Instant;

/// An async CAN controller, for which embedded-can has no trait.
///
/// The drivers of the HALs have these two functions under other names, often on two halves. What they should report,
/// and what not, is told [there](crate::io#what-a-driver-reports).
///
/// ```
/// # mod hal {
/// #     pub use myactuator_protocol_core::wire::can::SimpleFrame as Frame;
/// #     pub struct Envelope { pub frame: Frame }
/// #     #[derive(Debug)]
/// #     pub struct BusError;
/// #     impl embedded_can::Error for BusError {
/// #         fn kind(&self) -> embedded_can::ErrorKind { embedded_can::ErrorKind::Other }
/// #     }
/// #     pub struct CanTx;
/// #     pub struct CanRx;
/// #     impl CanTx { pub async fn write(&mut self, _: &Frame) -> Option<Frame> { None } }
/// #     impl CanRx { pub async fn read(&mut self) -> Result<Envelope, BusError> { Err(BusError) } }
/// # }
/// use myactuator_protocol_core::io::AsyncCan;
///
/// struct Can {
///     tx: hal::CanTx,
///     rx: hal::CanRx,
/// }
///
/// impl AsyncCan for Can {
///     type Frame = hal::Frame;
///     type Error = hal::BusError;
///
///     async fn transmit(&mut self, frame: &hal::Frame) -> Result<Option<hal::Frame>, hal::BusError> {
///         Ok(self.tx.write(frame).await)
///     }
///
///     async fn receive(&mut self) -> Result<hal::Frame, hal::BusError> {
///         Ok(self.rx.read().await?.frame)
///     }
/// }
/// ```
///
/// The futures need not be `Send`: one task runs one bus.
#[allow(async_fn_in_trait, reason = "one task runs one bus, so nothing asks for Send")]
pub trait AsyncCan {
    /// The driver's frame.
    type Frame: Frame;
    /// What the driver reports when it fails.
    type Error: embedded_can::Error;

    /// Hands a frame to the controller. Completes once the controller has taken the frame into a mailbox or queue, and
    /// returns the frame that had to make way for it, if one had. It must not wait until the frame is on the bus: then
    /// only one frame at a time would be in flight.
    ///
    /// It is polled once. If it is pending then, it is dropped, and the controller counts as taking nothing. A frame
    /// whose future was dropped must not have been taken. The frame, or a more urgent one, is offered again when the
    /// task is woken, or after a millisecond. So a controller should wake the task when it has room again. A controller
    /// that needs more than one poll to take a frame, behind SPI for example, gets a task of its own and a channel.
    async fn transmit(&mut self, frame: &Self::Frame) -> Result<Option<Self::Frame>, Self::Error>;

    /// The next frame from the bus.
    ///
    /// It is dropped and called again all the time, mostly after one poll. Dropping must lose no frame: one that
    /// arrives later, or has arrived, is for the next call.
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

/// Runs a [`Master`] on an async CAN controller.
pub struct AsyncCanMaster<C: AsyncCan, K, const N: usize> {
    can: C,
    clock: K,
    pump: Pump<N>,
    /// What was received while the task waited.
    received: Option<Result<C::Frame, C::Error>>,
}

impl<C: AsyncCan, K: AsyncClock, const N: usize> AsyncCanMaster<C, K, N> {
    /// A loop on this controller, timed by this clock. The configuration has to say if the clock is
    /// [coarse](Config::for_clock_step).
    pub fn new(can: C, clock: K, config: Config) -> Self {
        Self { can, clock, pump: Pump::new(config.on_can()), received: None }
    }

    /// Returns the controller and the clock.
    pub fn release(self) -> (C, K) {
        (self.can, self.clock)
    }
}

impl<C: AsyncCan, K, const N: usize> fmt::Debug for AsyncCanMaster<C, K, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AsyncCanMaster").field("pump", &self.pump).finish_non_exhaustive()
    }
}

impl<C: AsyncCan, K: AsyncClock, const N: usize> AsyncRunner<N> for AsyncCanMaster<C, K, N> {
    type Error = C::Error;

    fn master(&mut self) -> &mut Master<N> {
        &mut self.pump.master
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }

    async fn run(&mut self, until: Option<Instant>) -> Result<Option<Event>, C::Error> {
        let Self { can, clock, pump, received } = self;
        if let Some(event) = pump.left_event() {
            return Ok(Some(event));
        }
        clock.wait_until(pump.rests_until).await;
        loop {
            let now = clock.now();
            let event = poll_fn(|context| {
                let mut once = PolledOnce { can, received, context };
                Poll::Ready(pump.round(&mut CanPort(&mut once), now))
            })
            .await?
            .or_else(|| pump.master.poll_event());
            if event.is_some() || until.is_some_and(|until| until <= now) {
                return Ok(event);
            }
            let (wake_at, is_refused) = (pump.wake_at(until), pump.refusals.retry_at().is_some());
            rest(pin!(can.receive()), received, clock, wake_at, is_refused).await;
        }
    }
}

/// Makes an async controller one that never waits.
struct PolledOnce<'a, 'b, C: AsyncCan> {
    can: &'a mut C,
    received: &'a mut Option<Result<C::Frame, C::Error>>,
    context: &'a mut Context<'b>,
}

impl<C: AsyncCan> nb::Can for PolledOnce<'_, '_, C> {
    type Frame = C::Frame;
    type Error = C::Error;

    fn transmit(&mut self, frame: &C::Frame) -> ::nb::Result<Option<C::Frame>, C::Error> {
        now_or_never(pin!(self.can.transmit(frame)).poll(self.context))
    }

    fn receive(&mut self) -> ::nb::Result<C::Frame, C::Error> {
        match self.received.take() {
            Some(received) => received.map_err(::nb::Error::Other),
            None => now_or_never(pin!(self.can.receive()).poll(self.context)),
        }
    }
}

fn now_or_never<T, E>(poll: Poll<Result<T, E>>) -> ::nb::Result<T, E> {
    match poll {
        Poll::Ready(result) => result.map_err(::nb::Error::Other),
        Poll::Pending => Err(::nb::Error::WouldBlock),
    }
}

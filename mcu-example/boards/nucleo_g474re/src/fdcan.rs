//! CAN: FDCAN1 on PA11 and PA12, 1 Mbit/s, classic frames.

use core::fmt;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_stm32::can::config::TxBufferMode;
use embassy_stm32::can::{
    Can, CanConfigurator, Frame, IT0InterruptHandler, IT1InterruptHandler, OperatingMode,
};
use embassy_stm32::peripherals::{FDCAN1, PA11, PA12};
use embassy_stm32::{Peri, bind_interrupts, pac};
use embassy_time::{Duration, Instant, with_deadline};
use embedded_can::ErrorKind;
use myactuator_mcu_example::Usage;
use myactuator_protocol_core::io::AsyncCan;

/// Bit rate, bit/s.
pub const BIT_RATE: u32 = 1_000_000;

/// A controller that takes nothing for this long is on a bus where no other node listens. It is less than the time
/// after which the loop gives up, which would leave pending frames in the controller.
const STUCK_AFTER: Duration = Duration::from_millis(10);

/// Whether the controller takes part in the bus, so that last words can be sent by it.
pub(crate) static TAKES_PART: AtomicBool = AtomicBool::new(false);

bind_interrupts!(struct Irqs {
    FDCAN1_IT0 => IT0InterruptHandler<FDCAN1>;
    FDCAN1_IT1 => IT1InterruptHandler<FDCAN1>;
});

/// Why the bus is down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum BusDown {
    /// The controller has switched itself off after too many errors. It comes back on its own.
    Off,
    /// The controller gets no frame onto the bus: nothing acknowledges.
    TakesNothing,
}

impl embedded_can::Error for BusDown {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// The controller, for the async loop.
///
/// When the bus is down, what the controller has not sent yet is dropped. Otherwise it would be sent whenever the bus
/// comes back, and move a motor long after everything was stopped.
pub struct FdCan {
    can: Can<'static>,
    /// Since when the controller takes nothing. The loop itself gives up a call sooner, to see what was received, and
    /// calls again.
    stuck_since: Option<Instant>,
}

impl FdCan {
    /// Starts the controller.
    pub fn new(
        controller: Peri<'static, FDCAN1>,
        rx: Peri<'static, PA11>,
        tx: Peri<'static, PA12>,
    ) -> Self {
        let mut configurator = CanConfigurator::new(controller, rx, tx, Irqs);
        configurator.set_bitrate(BIT_RATE);
        let mut config = configurator.config();
        // First in, first out. By priority, the driver's default, a stop could overtake an older set-point, which would
        // then follow it.
        config.tx_buffer_mode = TxBufferMode::Fifo;
        // `discard_pending` does this. The driver would go on with what was pending.
        config.automatic_bus_off_recovery = false;
        configurator.set_config(config);
        let can = configurator.start(OperatingMode::NormalOperationMode);
        TAKES_PART.store(true, Ordering::Relaxed);
        Self { can, stuck_since: None }
    }
}

impl fmt::Debug for FdCan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FdCan").finish_non_exhaustive()
    }
}

impl AsyncCan for FdCan {
    type Frame = Frame;
    type Error = BusDown;

    async fn transmit(&mut self, frame: &Frame) -> Result<Option<Frame>, BusDown> {
        let stuck_since = *self.stuck_since.get_or_insert_with(Instant::now);
        let written = with_deadline(stuck_since + STUCK_AFTER, self.can.write(frame)).await;
        self.stuck_since = None;
        match written {
            Ok(pushed_out) => Ok(pushed_out),
            Err(_) => {
                discard_pending();
                Err(BusDown::TakesNothing)
            }
        }
    }

    async fn receive(&mut self) -> Result<Frame, BusDown> {
        loop {
            if is_off() {
                discard_pending();
                return Err(BusDown::Off);
            }
            // An error is the driver's report of one disturbed frame, which its sender sends again.
            if let Ok(envelope) = self.can.read().await {
                note_received();
                return Ok(envelope.frame);
            }
        }
    }
}

/// The most frames that were waiting in the controller, which has room for three, and how often it had no room.
static MOST: AtomicU32 = AtomicU32::new(0);
static DROPPED: AtomicU32 = AtomicU32::new(0);

/// A frame was taken from the controller.
fn note_received() {
    let left: u32 = pac::FDCAN1.rxfs(0).read().ffl().into();
    MOST.fetch_max(left + 1, Ordering::Relaxed);
    if pac::FDCAN1.ir().read().rfl(0) {
        // Cleared by writing 1.
        pac::FDCAN1.ir().write(|w| w.set_rfl(0, true));
        DROPPED.fetch_add(1, Ordering::Relaxed);
    }
}

/// The controller's part of the board's usage, in frames.
pub(crate) fn usage() -> Usage {
    Usage {
        queued: MOST.load(Ordering::Relaxed),
        dropped: DROPPED.load(Ordering::Relaxed),
        ..Usage::default()
    }
}

/// Whether the controller has switched itself off. Nothing else switches it off while it runs.
pub(crate) fn is_off() -> bool {
    pac::FDCAN1.cccr().read().init()
}

/// How often to poll a bit that the controller sets within a few cycles of its own clock.
const LOOKS: u32 = 10_000;

/// Drops what the controller has not sent, and what it has received and not handed over. Then lets it take part in the
/// bus again as soon as that is quiet: after bus-off, 128 times eleven recessive bits.
pub(crate) fn discard_pending() {
    let cccr = pac::FDCAN1.cccr();
    cccr.modify(|w| w.set_init(true));
    let _ = (0..LOOKS).any(|_| cccr.read().init());
    // This also resets all queues and requests (reference manual RM0440, 44.3.2).
    cccr.modify(|w| w.set_cce(true));
    let _ = (0..LOOKS).any(|_| cccr.read().cce());
    cccr.modify(|w| w.set_cce(false));
    cccr.modify(|w| w.set_init(false));
    let _ = (0..LOOKS).any(|_| !cccr.read().init());
}

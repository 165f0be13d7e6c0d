//! RS485: USART1 on PA9 and PA10, with PA12 as the transceiver's direction.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_stm32::gpio::Pull;
use embassy_stm32::interrupt::{self, typelevel::Handler};
use embassy_stm32::peripherals::{PA9, PA10, PA12, USART1};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config, ConfigError};
use embassy_stm32::{Peri, bind_interrupts, pac};
use static_cell::StaticCell;

/// Bit rate, bit/s: the one with which drives are delivered.
pub const BIT_RATE: u32 = 115_200;

/// Room for received bytes: more than the line brings in ten cycles.
const RECEIVED: usize = 256;
/// Room for bytes to send: more than a frame.
const TO_SEND: usize = 32;

/// Whether the port is set up, so that last words can be sent by it.
pub(crate) static IS_SET_UP: AtomicBool = AtomicBool::new(false);

/// Bytes that were overrun or disturbed. The driver ignores them. It does not report how many bytes are queued, nor how
/// many find its buffer full.
static DROPPED: AtomicU32 = AtomicU32::new(0);

/// How many received bytes were lost, as far as known.
pub(crate) fn dropped() -> u32 {
    DROPPED.load(Ordering::Relaxed)
}

bind_interrupts!(struct Irqs {
    // In this order, since the driver clears what is counted here.
    USART1 => CountErrors, BufferedInterruptHandler<USART1>;
});

struct CountErrors;

impl Handler<interrupt::typelevel::USART1> for CountErrors {
    unsafe fn on_interrupt() {
        let status = pac::USART1.isr().read();
        let is_lost = status.ore() || status.fe() || status.ne();
        DROPPED.fetch_add(is_lost.into(), Ordering::Relaxed);
    }
}

/// Opens the port. Interrupts fill its buffer, so that a `read` may be dropped at any time. The USART itself switches
/// the direction. Call it once.
///
/// # Errors
/// If the clock does not allow the bit rate.
pub fn rs485(
    port: Peri<'static, USART1>,
    rx: Peri<'static, PA10>,
    tx: Peri<'static, PA9>,
    direction: Peri<'static, PA12>,
) -> Result<BufferedUart<'static>, ConfigError> {
    static SEND: StaticCell<[u8; TO_SEND]> = StaticCell::new();
    static RECEIVE: StaticCell<[u8; RECEIVED]> = StaticCell::new();

    let mut config = Config::default();
    config.baudrate = BIT_RATE;
    // While the transceiver sends, it does not drive its output.
    config.rx_pull = Pull::Up;
    // In sixteenths of a bit: the transceiver gets one bit to switch before the data and half a bit after it.
    config.de_assertion_time = 16;
    config.de_deassertion_time = 8;
    let send = SEND.init([0; TO_SEND]);
    let receive = RECEIVE.init([0; RECEIVED]);
    let port = BufferedUart::new_with_de(port, rx, tx, direction, Irqs, send, receive, config)?;
    IS_SET_UP.store(true, Ordering::Relaxed);
    Ok(port)
}

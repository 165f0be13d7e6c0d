//! RS485: USART1 on PA9 and PA10, with PA12 as the transceiver's direction.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_stm32::gpio::Pull;
use embassy_stm32::interrupt::{self, typelevel::Handler};
use embassy_stm32::peripherals::{PA9, PA10, PA12, USART1};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config, ConfigError};
use embassy_stm32::{Peri, bind_interrupts, pac};
use static_cell::StaticCell;

/// Bits a second: what drives are delivered with.
pub const BIT_RATE: u32 = 115_200;

/// Places for received bytes: more than the line brings in ten cycles.
const RECEIVED: usize = 256;
/// Places for bytes to be sent: more than a frame.
const TO_SEND: usize = 32;

/// Whether the port is set up, so that last words may be sent by it.
pub(crate) static IS_SET_UP: AtomicBool = AtomicBool::new(false);

/// Bytes that came before the one before them was taken, or were disturbed. The driver passes them over.
/// It does not tell how many wait, nor how many find its buffer full.
static DROPPED: AtomicU32 = AtomicU32::new(0);

/// How many received bytes were lost, as far as that is known.
pub(crate) fn dropped() -> u32 {
    DROPPED.load(Ordering::Relaxed)
}

bind_interrupts!(struct Irqs {
    // In this order: the driver clears what is counted.
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

/// Opens the port. Interrupts fill its buffer, so that a `read` may be dropped at any time; the USART
/// itself switches the direction. Call it once.
///
/// # Errors
/// A bit rate that the clock does not allow.
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
    // While it sends, the transceiver lets go of its output.
    config.rx_pull = Pull::Up;
    // In sixteenths of a bit: the transceiver is given one bit to begin with and half a one to end with.
    config.de_assertion_time = 16;
    config.de_deassertion_time = 8;
    let send = SEND.init([0; TO_SEND]);
    let receive = RECEIVE.init([0; RECEIVED]);
    let port = BufferedUart::new_with_de(port, rx, tx, direction, Irqs, send, receive, config)?;
    IS_SET_UP.store(true, Ordering::Relaxed);
    Ok(port)
}

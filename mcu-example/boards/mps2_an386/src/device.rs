//! The machine's registers and interrupts: Arm's Cortex-M System Design Kit (DDI 0479), wired as in
//! application note 386.

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;
use tock_registers::registers::{ReadOnly, ReadWrite, WriteOnly};
use tock_registers::{register_bitfields, register_structs};

/// The clock of processor and peripherals.
pub(crate) const CLOCK_HZ: u32 = 25_000_000;

register_bitfields![u32,
    pub(crate) UartState [
        TX_FULL OFFSET(0) NUMBITS(1) [],
        RX_FULL OFFSET(1) NUMBITS(1) [],
        /// Written 1, it is cleared.
        RX_OVERRUN OFFSET(3) NUMBITS(1) []
    ],
    pub(crate) UartControl [
        TX_ENABLE OFFSET(0) NUMBITS(1) [],
        RX_ENABLE OFFSET(1) NUMBITS(1) [],
        TX_INTERRUPT OFFSET(2) NUMBITS(1) [],
        RX_INTERRUPT OFFSET(3) NUMBITS(1) []
    ],
    /// Written 1, they are cleared.
    pub(crate) UartInterrupts [
        TX OFFSET(0) NUMBITS(1) [],
        RX OFFSET(1) NUMBITS(1) []
    ],
    pub(crate) TimerControl [
        ENABLE OFFSET(0) NUMBITS(1) [],
        INTERRUPT OFFSET(3) NUMBITS(1) []
    ],
    /// Written 1, it is cleared.
    pub(crate) TimerInterrupt [
        PENDING OFFSET(0) NUMBITS(1) []
    ],
    pub(crate) WatchdogControl [
        /// Counts, and raises the non-maskable interrupt at its end.
        INTERRUPT OFFSET(0) NUMBITS(1) [],
        /// Resets when it ends a second time in a row.
        RESET OFFSET(1) NUMBITS(1) []
    ],
];

register_structs! {
    pub(crate) UartRegisters {
        (0x00 => pub(crate) data: ReadWrite<u32>),
        (0x04 => pub(crate) state: ReadWrite<u32, UartState::Register>),
        (0x08 => pub(crate) control: ReadWrite<u32, UartControl::Register>),
        (0x0C => pub(crate) interrupts: ReadWrite<u32, UartInterrupts::Register>),
        (0x10 => pub(crate) bit_divisor: ReadWrite<u32>),
        (0x14 => @END),
    },
    /// Counts down, and begins again from `reload`; if that is 0, it counts only once.
    pub(crate) TimerRegisters {
        (0x00 => pub(crate) control: ReadWrite<u32, TimerControl::Register>),
        (0x04 => pub(crate) value: ReadWrite<u32>),
        (0x08 => pub(crate) reload: ReadWrite<u32>),
        (0x0C => pub(crate) interrupt: ReadWrite<u32, TimerInterrupt::Register>),
        (0x10 => @END),
    },
    pub(crate) WatchdogRegisters {
        (0x000 => pub(crate) load: ReadWrite<u32>),
        (0x004 => value: ReadOnly<u32>),
        (0x008 => pub(crate) control: ReadWrite<u32, WatchdogControl::Register>),
        /// Any write restarts the count.
        (0x00C => pub(crate) clear: WriteOnly<u32>),
        (0x010 => _reserved),
        (0xC00 => pub(crate) lock: ReadWrite<u32>),
        (0xC04 => @END),
    }
}

/// The UARTs that are wired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UartId {
    /// The RS485 line.
    Uart0,
    /// The SLCAN adapter.
    Uart1,
    /// The panel.
    Uart2,
}

impl UartId {
    pub(crate) fn registers(self) -> &'static UartRegisters {
        let address = match self {
            Self::Uart0 => 0x4000_4000,
            Self::Uart1 => 0x4000_5000,
            Self::Uart2 => 0x4000_6000,
        };
        // SAFETY: a UART's registers are always at this address, and are only accessed by volatile reads and writes.
        unsafe { &*core::ptr::with_exposed_provenance(address) }
    }

    pub(crate) const fn interrupts(self) -> [Interrupt; 2] {
        match self {
            Self::Uart0 => [Interrupt::UART0RX, Interrupt::UART0TX],
            Self::Uart1 => [Interrupt::UART1RX, Interrupt::UART1TX],
            Self::Uart2 => [Interrupt::UART2RX, Interrupt::UART2TX],
        }
    }
}

/// Counts the time.
pub(crate) fn timer0() -> &'static TimerRegisters {
    // SAFETY: as for the UARTs.
    unsafe { &*core::ptr::with_exposed_provenance(0x4000_0000) }
}

/// Wakes the processor.
pub(crate) fn timer1() -> &'static TimerRegisters {
    // SAFETY: as for the UARTs.
    unsafe { &*core::ptr::with_exposed_provenance(0x4000_1000) }
}

pub(crate) fn watchdog() -> &'static WatchdogRegisters {
    // SAFETY: as for the UARTs.
    unsafe { &*core::ptr::with_exposed_provenance(0x4000_8000) }
}

/// The interrupts of what is used here. The others are at 6, 7 and from 10 on.
#[allow(clippy::upper_case_acronyms, missing_docs, reason = "the machine's names")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub(crate) enum Interrupt {
    UART0RX = 0,
    UART0TX = 1,
    UART1RX = 2,
    UART1TX = 3,
    UART2RX = 4,
    UART2TX = 5,
    TIMER0 = 8,
    TIMER1 = 9,
}

/// `cortex_m_rt::interrupt` looks names up in this.
pub(crate) use Interrupt as interrupt;

// SAFETY: these are the numbers of the machine's interrupts.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

/// Enables these interrupts.
pub(crate) fn unmask(interrupts: &[Interrupt]) {
    for interrupt in interrupts {
        // SAFETY: no critical section here is made by masking single interrupts.
        unsafe { NVIC::unmask(*interrupt) }
    }
}

unsafe extern "C" {
    fn UART0RX();
    fn UART0TX();
    fn UART1RX();
    fn UART1TX();
    fn UART2RX();
    fn UART2TX();
    fn TIMER0();
    fn TIMER1();
}

type Vector = Option<unsafe extern "C" fn()>;

/// The machine's part of the vector table. The interrupts that are 0 here are never unmasked.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [Vector; 10] = [
    Some(UART0RX),
    Some(UART0TX),
    Some(UART1RX),
    Some(UART1TX),
    Some(UART2RX),
    Some(UART2TX),
    None,
    None,
    Some(TIMER0),
    Some(TIMER1),
];

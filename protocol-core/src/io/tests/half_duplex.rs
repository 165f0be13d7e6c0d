//! The direction pin.

use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use std::rc::Rc;
use std::vec::Vec;

use super::world::{Broken, block_on, polls};
use crate::io::{HalfDuplex, HalfDuplexError};
use embedded_hal::digital::{ErrorType as PinErrorType, OutputPin};
use embedded_io::ErrorType;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Act {
    High,
    Low,
    Wait(u32),
    Write(usize),
    Flush,
}

use Act::{Flush, High, Low, Wait, Write};

/// Port, pin and delay in one, all writing to one log.
#[derive(Clone, Debug, Default)]
struct Rig {
    log: Rc<RefCell<Vec<Act>>>,
    fails: bool,
    cannot_flush: bool,
    hangs: bool,
    /// So many bytes it takes yet.
    room: Option<Rc<Cell<usize>>>,
    fails_when_full: bool,
}

impl Rig {
    fn note(&self, act: Act) {
        self.log.borrow_mut().push(act);
    }

    fn half_duplex(self) -> HalfDuplex<Self, Self, Self> {
        HalfDuplex::new(self.clone(), self.clone(), self, 3_000, 5_000).unwrap()
    }

    fn log(&self) -> Vec<Act> {
        self.log.borrow().clone()
    }

    fn outcome<T>(&self, value: T) -> Result<T, Broken> {
        if self.fails { Err(Broken) } else { Ok(value) }
    }
}

impl PinErrorType for Rig {
    type Error = Infallible;
}

impl OutputPin for Rig {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.note(Low);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.note(High);
        Ok(())
    }
}

impl embedded_hal::delay::DelayNs for Rig {
    fn delay_ns(&mut self, ns: u32) {
        self.note(Wait(ns));
    }
}

impl embedded_hal_async::delay::DelayNs for Rig {
    async fn delay_ns(&mut self, ns: u32) {
        self.note(Wait(ns));
    }
}

impl ErrorType for Rig {
    type Error = Broken;
}

impl embedded_io::Read for Rig {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, Broken> {
        buf.fill(7);
        self.outcome(buf.len())
    }
}

impl embedded_io::Write for Rig {
    fn write(&mut self, buf: &[u8]) -> Result<usize, Broken> {
        self.note(Write(buf.len()));
        let Some(room) = &self.room else { return self.outcome(buf.len()) };
        let taken = buf.len().min(room.get());
        room.set(room.get() - taken);
        if taken == 0 && self.fails_when_full { Err(Broken) } else { Ok(taken) }
    }

    fn flush(&mut self) -> Result<(), Broken> {
        self.note(Flush);
        if self.cannot_flush { Err(Broken) } else { Ok(()) }
    }
}

impl embedded_io_async::Read for Rig {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Broken> {
        embedded_io::Read::read(self, buf)
    }
}

impl embedded_io_async::Write for Rig {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Broken> {
        if self.hangs {
            core::future::pending::<()>().await;
        }
        embedded_io::Write::write(self, buf)
    }

    async fn flush(&mut self) -> Result<(), Broken> {
        embedded_io::Write::flush(self)
    }
}

const SENT: [Act; 8] = [Low, High, Wait(3_000), Write(2), Write(1), Flush, Wait(5_000), Low];

#[test]
fn the_pin_is_high_from_before_the_first_byte_to_after_the_last() {
    use embedded_io::Write;
    let rig = Rig::default();
    let mut port = rig.clone().half_duplex();
    assert_eq!(port.write(&[1, 2]), Ok(2));
    assert_eq!(port.write(&[3]), Ok(1));
    assert_eq!(port.flush(), Ok(()));
    assert_eq!(rig.log(), SENT);
    // With nothing written there is nothing to turn.
    assert_eq!(port.flush(), Ok(()));
    assert_eq!(rig.log()[8..], [Flush]);
}

#[test]
fn async_pin_is_high_from_before_the_first_byte_to_after_the_last() {
    use embedded_io_async::Write;
    let rig = Rig::default();
    let mut port = rig.clone().half_duplex();
    block_on(async {
        assert_eq!(port.write(&[1, 2]).await, Ok(2));
        assert_eq!(port.write(&[3]).await, Ok(1));
        assert_eq!(port.flush().await, Ok(()));
    });
    assert_eq!(rig.log(), SENT);
    // With nothing written there is nothing to turn.
    assert_eq!(block_on(port.flush()), Ok(()));
    assert_eq!(rig.log()[8..], [Flush]);
}

#[test]
fn the_pin_is_low_after_an_error() {
    let error = Err(HalfDuplexError::Serial(Broken));
    let rig = Rig { fails: true, ..Rig::default() };
    let mut port = rig.clone().half_duplex();
    assert_eq!(embedded_io::Write::write(&mut port, &[1]), error);
    assert_eq!(rig.log(), [Low, High, Wait(3_000), Write(1), Low]);
    let mut port = rig.clone().half_duplex();
    assert_eq!(block_on(embedded_io_async::Write::write(&mut port, &[1])), error);
    assert_eq!(rig.log()[5..], [Low, High, Wait(3_000), Write(1), Low]);
}

#[test]
fn the_pin_is_low_after_a_flush_that_failed() {
    use embedded_io::Write;
    let rig = Rig { cannot_flush: true, ..Rig::default() };
    let mut port = rig.clone().half_duplex();
    assert_eq!(port.write(&[1]), Ok(1));
    assert_eq!(port.flush(), Err(HalfDuplexError::Serial(Broken)));
    assert_eq!(rig.log().last(), Some(&Low));
}

#[test]
fn pin_falls_with_the_next_flush_after_a_dropped_write() {
    use embedded_io_async::Write;
    let rig = Rig { hangs: true, ..Rig::default() };
    let mut port = rig.clone().half_duplex();
    assert!(polls(port.write(&[1]), 5).is_none());
    assert_eq!(rig.log().last(), Some(&Wait(3_000)), "still high");
    block_on(port.flush()).unwrap();
    assert_eq!(rig.log().last(), Some(&Low));
}

/// A port that takes so many bytes and then nothing, or reports an error.
fn full_after_two(fails: bool) -> Rig {
    Rig { room: Some(Rc::new(Cell::new(2))), fails_when_full: fails, ..Rig::default() }
}

#[test]
fn pin_falls_only_after_the_bytes_taken_by_a_full_port_have_left() {
    // A driver that goes off in mid-byte cuts what is on the line.
    let cut = [Low, High, Wait(3_000), Write(3), Write(1), Flush, Wait(5_000), Low];
    for fails in [false, true] {
        let last = if fails { Err(HalfDuplexError::Serial(Broken)) } else { Ok(0) };
        let rig = full_after_two(fails);
        let mut port = rig.clone().half_duplex();
        assert_eq!(embedded_io::Write::write(&mut port, &[1, 2, 3]), Ok(2));
        assert_eq!(embedded_io::Write::write(&mut port, &[3]), last);
        assert_eq!(rig.log(), cut);
        let rig = full_after_two(fails);
        let mut port = rig.clone().half_duplex();
        block_on(async {
            use embedded_io_async::Write;
            assert_eq!(port.write(&[1, 2, 3]).await, Ok(2));
            assert_eq!(port.write(&[3]).await, last);
        });
        assert_eq!(rig.log(), cut);
    }
}

#[test]
fn reading_leaves_the_pin_alone() {
    let rig = Rig::default();
    let mut port = rig.clone().half_duplex();
    let mut buf = [0; 3];
    assert_eq!(embedded_io::Read::read(&mut port, &mut buf), Ok(3));
    assert_eq!(block_on(embedded_io_async::Read::read(&mut port, &mut buf)), Ok(3));
    assert_eq!(buf, [7; 3]);
    assert_eq!(rig.log(), [Low]);
}

#[test]
fn the_pin_is_low_where_nothing_was_taken() {
    let rig = Rig::default();
    let mut port = rig.clone().half_duplex();
    // Of nothing the port takes nothing, as a full one may.
    assert_eq!(embedded_io::Write::write(&mut port, &[]), Ok(0));
    assert_eq!(rig.log(), [Low, High, Wait(3_000), Write(0), Low]);
    assert_eq!(block_on(embedded_io_async::Write::write(&mut port, &[])), Ok(0));
    assert_eq!(rig.log()[5..], [High, Wait(3_000), Write(0), Low]);
}

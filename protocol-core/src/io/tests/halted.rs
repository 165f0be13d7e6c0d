//! The program is halted for longer than a stop is tried: suspended, or in a debugger.

use core::cell::Cell;

use super::id;
use super::world::{Broken, TestCan, TestClock, TestSerial, block_on};
use crate::io::{AsyncCanMaster, AsyncClock, AsyncRunner, CanMaster, Clock, Runner, SerialMaster};
use crate::master::{Config, MotorSet, StopKind};
use crate::time::Instant;

/// A clock that is looked at for the first time after the halt when so many looks are left.
struct Halting {
    clock: TestClock,
    looks_left: Cell<usize>,
}

impl Halting {
    fn new(clock: &TestClock, looks_left: usize) -> Self {
        Self { clock: clock.clone(), looks_left: Cell::new(looks_left) }
    }
}

impl Clock for Halting {
    fn now(&self) -> Instant {
        let left = self.looks_left.get();
        self.looks_left.set(left.saturating_sub(1));
        if left == 1 {
            self.clock.advance(1_500_000);
        }
        self.clock.now()
    }

    fn idle(&self, until: Instant) {
        self.clock.idle(until);
    }
}

impl AsyncClock for Halting {
    async fn wait_until(&mut self, until: Instant) {
        self.clock.wait_until(until).await;
    }
}

fn three() -> MotorSet {
    [1, 2, 3].map(id).into_iter().collect()
}

#[test]
fn stop_of_all_reaches_each_motor_whenever_the_program_is_halted() {
    for looks in 1..40 {
        let clock = TestClock::default();
        let bus = TestCan::new(&clock);
        let halting = Halting::new(&clock, looks);
        let mut arm = CanMaster::<_, _, 4>::new(bus.clone(), halting, Config::CAN);
        assert!(arm.stop_all(StopKind::Hold, three()).is_empty(), "at look {looks}");

        let halting = Halting::new(&clock, looks);
        let mut arm = AsyncCanMaster::<_, _, 4>::new(bus, halting, Config::CAN);
        let unconfirmed = block_on(arm.stop_all(StopKind::Hold, three()));
        assert!(unconfirmed.is_empty(), "a task, at look {looks}");

        let port = TestSerial::new(&clock);
        let (halting, config) = (Halting::new(&clock, looks), Config::rs485(115_200, false));
        let mut arm = SerialMaster::<_, _, 4>::new(port, halting, config);
        assert!(arm.stop_all(StopKind::Hold, three()).is_empty(), "a line, at look {looks}");
    }
}

/// Takes every byte, and keeps it: each wait for the last one takes a second, and ends in vain.
struct Stuck(TestClock);

impl embedded_io::ErrorType for Stuck {
    type Error = Broken;
}

impl embedded_io::Read for Stuck {
    fn read(&mut self, _: &mut [u8]) -> Result<usize, Broken> {
        Err(Broken)
    }
}

impl embedded_io::ReadReady for Stuck {
    fn read_ready(&mut self) -> Result<bool, Broken> {
        Ok(false)
    }
}

impl embedded_io::Write for Stuck {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Broken> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Broken> {
        self.0.advance(1_000_000);
        Err(Broken)
    }
}

#[test]
fn stop_of_all_over_a_port_that_blocks_the_loop_ends_within_5_s() {
    let clock = TestClock::default();
    let config = Config::rs485(115_200, false);
    let mut arm = SerialMaster::<_, _, 8>::new(Stuck(clock.clone()), clock.clone(), config);
    let motors = (1..=8).map(id).collect();
    assert_eq!(arm.stop_all(StopKind::Hold, motors), motors);
    assert!(clock.now() <= Instant::from_millis(5_000), "{}", clock.now() - Instant::ZERO);
}

//! The host's clock, which decides when it looks at its bus.

use std::cell::RefCell;
use std::sync::{Arc, Mutex};

use myactuator_host_std::sim::bus::SimClock;
use myactuator_host_std::sim::bus::can::{CanBus, CanWorld};
use myactuator_protocol_core::io::Clock;
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_tests::dice::Dice;

/// The times at which the host looked.
pub(crate) type Looks = Arc<Mutex<Vec<Instant>>>;

/// A host's clock.
pub(crate) enum Host {
    /// It wakes up as soon as something arrives.
    AtOnce(SimClock<CanBus>),
    /// It looks after random pauses of up to `longest`, whatever has arrived.
    Looking { world: CanWorld, longest: Duration, dice: RefCell<Dice>, looks: Looks },
}

impl Clock for Host {
    fn now(&self) -> Instant {
        match self {
            Self::AtOnce(clock) => clock.now(),
            Self::Looking { world, .. } => world.now(),
        }
    }

    fn idle(&self, until: Instant) {
        match self {
            Self::AtOnce(clock) => clock.idle(until),
            Self::Looking { world, longest, dice, looks } => {
                let pause = dice.borrow_mut().below(longest.as_micros() + 1);
                world.run_for(Duration::from_micros(pause));
                looks.lock().unwrap().push(world.now());
            }
        }
    }
}

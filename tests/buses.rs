//! The simulated buses under the virtual clock.

mod buses {
    mod can;
    mod faults;
    mod rs485;
}

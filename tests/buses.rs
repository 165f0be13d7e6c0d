//! The simulated buses under the virtual clock.

mod buses {
    mod bursts;
    mod can;
    mod faults;
    mod rates;
    mod rs485;
}

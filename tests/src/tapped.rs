//! A loop of a bus whose events pass through a function.

use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Event, Master};
use myactuator_protocol_core::time::Instant;

/// The loop, and what becomes of what it returns.
#[derive(Debug)]
pub struct Tapped<'a, R, F>(pub &'a mut R, pub F);

impl<R: Runner<8>, F: FnMut(Option<Event>) -> Option<Event>> Runner<8> for Tapped<'_, R, F> {
    type Error = R::Error;

    fn master(&mut self) -> &mut Master<8> {
        self.0.master()
    }

    fn now(&self) -> Instant {
        self.0.now()
    }

    fn poll(&mut self) -> Result<Option<Event>, R::Error> {
        Ok((self.1)(self.0.poll()?))
    }

    fn idle(&mut self, until: Instant) {
        self.0.idle(until);
    }
}

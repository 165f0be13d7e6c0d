//! Lock-step: time goes on only as far as a client says.

use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

use myactuator_protocol_core::time;
use serde_json::json;

use super::{End, LONGEST_WAIT, Notice, ServeError, Server};

/// Time goes on for at most so long before the server looks at `stop` and at requests.
const TURN: Duration = Duration::from_millis(5);
/// How often the log is reported, in the drives' time.
const LOG_EVERY: time::Duration = time::Duration::from_millis(1);

/// Time is to go on, and a client waits until it has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Advance {
    client: u64,
    until: time::Instant,
}

impl Server {
    /// As in real time, except for the clock.
    pub(super) fn serve_in_steps(
        &mut self,
        stop: BorrowedFd<'_>,
        notify: &mut dyn FnMut(Notice),
    ) -> Result<(), ServeError> {
        self.ends.iter_mut().for_each(|end| end.hold());
        loop {
            self.answer_requests(notify)?;
            // Nothing else could end it.
            let is_there =
                |it: &Advance| self.control.as_ref().is_some_and(|all| all.has(it.client));
            self.advance = self.advance.filter(is_there);
            if let Some(Advance { client, until }) = self.advance
                && self.go_on(until, notify)?
            {
                self.advance = None;
                if let Some(control) = &mut self.control {
                    control.answer(client, Ok(json!({ "at_us": until.as_micros() })));
                }
            }
            let busy = self.advance.is_some() || self.is_asked();
            let ends = self.ends.iter_mut().filter_map(|end| end.patience()).min();
            let wait = if busy { Duration::ZERO } else { ends.unwrap_or(LONGEST_WAIT) };
            if self.wait(stop, wait)? {
                return Ok(());
            }
            if self.advance.is_none() {
                // Adapters answer at once; bytes of a line wait for the next request, all as one message.
                let at_once = |end: &&mut Box<dyn End>| end.answers_at_once();
                for end in self.ends.iter_mut().filter(at_once) {
                    end.take_in()?;
                    end.pump(notify)?;
                }
            }
        }
    }

    /// What programs have written counts from now on.
    pub(super) fn take_in(&mut self, notify: &mut dyn FnMut(Notice)) -> Result<(), ServeError> {
        if self.advance.is_some() {
            // It counts when that is over, whenever it was written.
            return Ok(());
        }
        self.ends.iter_mut().try_for_each(|end| end.take_in())?;
        self.pump(notify)
    }

    /// Notes how far a client lets time go.
    ///
    /// # Errors
    /// A sentence.
    pub(super) fn begin_advance(
        &mut self,
        client: u64,
        us: Option<u64>,
        until_us: Option<u64>,
    ) -> Result<(), String> {
        if !self.is_in_lock_step {
            return Err("time goes on by itself: start with --lock-step to say how far".into());
        }
        if self.advance.is_some() {
            return Err("another program lets time go on: wait until that is over".into());
        }
        let now = self.now();
        let until = match (us, until_us) {
            (Some(us), None) => now + time::Duration::from_micros(us),
            (None, Some(until_us)) => time::Instant::from_micros(until_us),
            _ => return Err("expected either us or until_us".into()),
        };
        if until < now {
            let now_us = now.as_micros();
            return Err(format!("expected a time from now on ({now_us} us), found one before"));
        }
        self.advance = Some(Advance { client, until });
        Ok(())
    }

    /// Lets time go on for a while; returns whether it has reached `until`.
    fn go_on(
        &mut self,
        until: time::Instant,
        notify: &mut dyn FnMut(Notice),
    ) -> Result<bool, ServeError> {
        let turn = Instant::now();
        let mut logged = self.now();
        loop {
            let now = self.now();
            self.pump(notify)?;
            let is_there = now >= until;
            if is_there || now - logged >= LOG_EVERY {
                logged = now;
                self.report_log(notify);
            }
            if is_there || turn.elapsed() >= TURN {
                return Ok(is_there);
            }
            let events = self.hosts.iter().filter_map(|host| host.next_event());
            let next = events.fold(until, time::Instant::min);
            self.hosts.iter().for_each(|host| host.run_until(next));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;
    use std::os::unix::net::UnixStream;

    use myactuator_protocol_core::MotorId;
    use myactuator_protocol_core::command::ReadMultiTurnAngle;
    use myactuator_protocol_core::wire::rs485::Frame;

    use super::*;
    use crate::sim::Fleet;
    use crate::sim::bus::rs485::TransceiverConfig;

    #[test]
    fn bytes_written_while_time_advances_are_sent_in_the_next_advance() {
        let line = Fleet::new(1).on_rs485(1_000_000).unwrap();
        let log = line.world.log();
        let (mut program, device) = UnixStream::pair().unwrap();
        let mut server = Server::new();
        server.serve_line_on(&line, TransceiverConfig::default(), device).unwrap();
        server.ends.iter_mut().for_each(|end| end.hold());
        server.advance = Some(Advance { client: 0, until: time::Instant::from_micros(20_000) });
        let ask = Frame::from_packet(&ReadMultiTurnAngle.packet(MotorId::MIN)).unwrap();
        program.write_all(&ask.encode()).unwrap();
        let carried_after = |server: &mut Server, until_ms: u64| {
            server.take_in(&mut |_| {}).unwrap();
            line.world.run_until(time::Instant::from_micros(until_ms * 1_000));
            server.pump(&mut |_| {}).unwrap();
            log.take().len()
        };
        assert_eq!(carried_after(&mut server, 20), 0);
        server.advance = None;
        // The question and its answer.
        assert_eq!(carried_after(&mut server, 40), 2);
    }
}

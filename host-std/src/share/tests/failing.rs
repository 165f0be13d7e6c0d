//! A driver that fails to receive for a while.

use std::collections::VecDeque;
use std::sync::atomic::AtomicBool;

use embedded_can::{ErrorKind, nb};
use myactuator_protocol_core::io::Clock;

use super::*;

#[derive(Clone, Copy, Debug)]
struct Failed;

impl embedded_can::Error for Failed {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// A controller whose motors answer at once.
struct Can {
    fails_to_receive: Arc<AtomicBool>,
    received: VecDeque<SimpleFrame>,
}

impl nb::Can for Can {
    type Frame = SimpleFrame;
    type Error = Failed;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Failed> {
        if let Received::Packet(Packet { channel: Channel::Command(Target::Motor(motor)), data }) =
            can::decode(frame)
        {
            let data = [data[0], 30, 0, 0, 0xE5, 0x01, 0, 0];
            let answer = Packet { channel: Channel::Reply(motor), data };
            self.received.extend(can::encode::<SimpleFrame>(&answer));
        }
        Ok(None)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Failed> {
        if self.fails_to_receive.load(Ordering::SeqCst) {
            return Err(::nb::Error::Other(Failed));
        }
        self.received.pop_front().ok_or(::nb::Error::WouldBlock)
    }
}

struct RealTime(time::Instant);

impl Clock for RealTime {
    fn now(&self) -> Instant {
        Instant::ZERO + self.0.elapsed().into()
    }

    fn idle(&self, _: Instant) {
        thread::sleep(time::Duration::from_millis(1));
    }
}

/// What was under way is dropped by a stop, which is an event: the bus fails all the same.
#[test]
fn an_event_of_a_bus_that_fails_does_not_show_that_it_works() {
    let fails_to_receive = Arc::new(AtomicBool::new(false));
    let can = Can { fails_to_receive: Arc::clone(&fails_to_receive), received: VecDeque::new() };
    let config = Config { shortest_response: Duration::ZERO, ..Config::CAN };
    let master = CanMaster::<_, _, 8>::new(can, RealTime(time::Instant::now()), config);
    let bus = SharedBus::new(master, StopKind::Hold);
    bus.ask(id(1), ReadStatus1).unwrap();
    fails_to_receive.store(true, Ordering::SeqCst);
    assert!(matches!(bus.ask(id(1), ReadStatus1), Err(SharedBusError::Bus(_))));
    drop(bus.begin_stop_all(StopKind::Hold, MotorSet::EMPTY));
    thread::sleep(time::Duration::from_millis(30));
    fails_to_receive.store(false, Ordering::SeqCst);
    thread::sleep(time::Duration::from_millis(100));
    // Not the error that is over.
    bus.ask(id(1), ReadStatus1).unwrap();
}

//! A bus with drives, and a record of what really happens on it.

use std::cell::RefCell;
use std::sync::{Arc, Mutex};

use myactuator_host_std::sim::bus::can::{CanPort, CanWorld, ControllerConfig};
use myactuator_host_std::sim::bus::faults::{Direction, FaultPlan};
use myactuator_host_std::sim::bus::trace;
use myactuator_protocol_core::MotorId;
use myactuator_protocol_core::time::Duration;
use myactuator_tests::dice::Dice;

use crate::drive::{Answering, Responses};
use crate::host::{Host, Looks};
use crate::reference::motor_of;

pub(crate) const BIT_RATE: u32 = 1_000_000;
/// Three bits between two frames.
pub(crate) const INTERMISSION_S: f64 = 3.0 / BIT_RATE as f64;
const SEED: u64 = 1;

/// The conditions under which a master works.
#[derive(Clone, Copy)]
pub(crate) struct Surroundings {
    pub(crate) controller: ControllerConfig,
    /// The longest pause of the host between two looks; `None` if it looks at once.
    pub(crate) longest_pause: Option<Duration>,
    /// The share of all frames that is lost on the way.
    pub(crate) loss: f32,
}

/// What happened on the bus.
#[derive(Default)]
pub(crate) struct Seen {
    /// How long each frame occupied the wire, in nanoseconds.
    pub(crate) frames_ns: Vec<u64>,
    /// How many frames to and from each motor were lost.
    pub(crate) lost: [u32; MotorId::COUNT],
}

/// A bus with drives, a port for the master, and its host.
pub(crate) struct Stage {
    pub(crate) motors: Vec<MotorId>,
    pub(crate) port: CanPort,
    pub(crate) host: Host,
    pub(crate) seen: Arc<Mutex<Seen>>,
    pub(crate) looks: Looks,
    pub(crate) responses: Responses,
}

impl Stage {
    pub(crate) fn new(surroundings: Surroundings, motors: u8) -> Self {
        let world = CanWorld::new(BIT_RATE, SEED);
        let motors: Vec<MotorId> = MotorId::all().take(motors.into()).collect();
        let (looks, responses) = (Looks::default(), Responses::default());
        for (place, &motor) in motors.iter().enumerate() {
            let station = world.attach(Answering::new(motor, SEED, &responses));
            assert_eq!(station.index(), place);
        }
        let port = world.port_with(surroundings.controller);
        let seen = watch(&world, &port);
        let plan = FaultPlan { lose: surroundings.loss, ..FaultPlan::NONE };
        for direction in [Direction::ToNodes, Direction::ToPorts] {
            world.set_faults(direction, plan);
        }
        let host = match surroundings.longest_pause {
            None => Host::AtOnce(world.clock()),
            Some(longest) => Host::Looking {
                world,
                longest,
                dice: RefCell::new(Dice::new(SEED)),
                looks: Arc::clone(&looks),
            },
        };
        Self { motors, port, host, seen, looks, responses }
    }

    /// Forgets what was seen.
    pub(crate) fn forget(seen: &Mutex<Seen>, looks: &Looks, responses: &Responses) {
        *seen.lock().unwrap() = Seen::default();
        looks.lock().unwrap().clear();
        responses.lock().unwrap().clear();
    }
}

/// Notes what happens between the master and the motors. A motor's index is its place on the bus.
fn watch(world: &CanWorld, port: &CanPort) -> Arc<Mutex<Seen>> {
    let seen = Arc::new(Mutex::new(Seen::default()));
    let (noted, master) = (Arc::clone(&seen), port.station());
    let mut asked = None;
    world.observe(move |record| match record.event {
        trace::Event::Carried { started_ns, frame } => {
            if record.station == master {
                asked = motor_of(&frame).map(MotorId::index);
            }
            let intermission_ns = 3_000_000_000 / u64::from(BIT_RATE);
            noted.lock().unwrap().frames_ns.push(record.at_ns - started_ns + intermission_ns);
        }
        trace::Event::Faulted { from, fault: trace::Fault::Lost } => {
            let heard = record.station.index();
            // A frame for another motor need not be heard.
            if record.station == master {
                noted.lock().unwrap().lost[from.index()] += 1;
            } else if from == master && asked == Some(heard) {
                noted.lock().unwrap().lost[heard] += 1;
            }
        }
        _ => {}
    });
    seen
}

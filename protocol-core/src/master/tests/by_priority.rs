//! A controller with three mailboxes that sends by priority and hands back what has to make way, and a bus on which
//! answers arbitrate. No stop is handed back for ever, and none stays unconfirmed.

use super::*;

const MAILBOXES: usize = 3;

/// Commands to motors with lower ids are sent sooner.
fn priority(packet: &Packet) -> Option<core::cmp::Reverse<MotorId>> {
    match packet.channel {
        Channel::Command(Target::Motor(motor)) => Some(core::cmp::Reverse(motor)),
        _ => None,
    }
}

/// In each of these milliseconds, what is in the mailboxes is sent, and answered by all motors but the `absent`. Then
/// the caller has its `cycle`, and then the master runs. Returns when each motor got its first stop, and how often
/// it got anything else.
fn commanded(
    master: &mut Master<32>,
    span: core::ops::Range<u64>,
    absent: MotorSet,
    cycle: impl FnMut(&mut Master<32>, u64),
) -> [(Option<u64>, u64); MotorId::COUNT] {
    commanded_with_all(master, span, absent, cycle).0
}

/// The same, and how often a command to all was sent.
fn commanded_with_all(
    master: &mut Master<32>,
    span: core::ops::Range<u64>,
    absent: MotorSet,
    mut cycle: impl FnMut(&mut Master<32>, u64),
) -> ([(Option<u64>, u64); MotorId::COUNT], u64) {
    let mut to_all = 0;
    let mut commanded = [(None, 0); MotorId::COUNT];
    let mut mailboxes = Vec::<Packet>::new();
    for now in span {
        for packet in core::mem::take(&mut mailboxes) {
            let Channel::Command(Target::Motor(motor)) = packet.channel else {
                to_all += 1;
                let reads = packet.data == ReadMultiTurnAngle.encode();
                let data = if reads { ANGLE_REPLY } else { packet.data };
                for motor in MotorSet::ALL.without(absent).iter() {
                    reply(master, motor.get(), data, ms(now));
                }
                continue;
            };
            let is_stop = packet.data[0] == 0x80;
            let (stopped_at, others) = &mut commanded[motor.index()];
            if is_stop {
                stopped_at.get_or_insert(now);
            } else {
                *others += 1;
            }
            if !absent.contains(motor) {
                let data = if is_stop { packet.data } else { TORQUE_REPLY };
                reply(master, motor.get(), data, ms(now));
            }
        }
        cycle(master, now);
        events(master, ms(now));
        while let Some(packet) = master.poll_transmit(ms(now)) {
            let last = mailboxes.iter().min_by_key(|packet| priority(packet)).copied();
            let makes_way = last.filter(|_| mailboxes.len() == MAILBOXES);
            if makes_way.is_some_and(|last| priority(&last) >= priority(&packet)) {
                break;
            }
            mailboxes.retain(|it| Some(*it) != makes_way);
            mailboxes.push(packet);
            master.handle_transmitted(ms(now));
            makes_way.iter().for_each(|packet| master.handle_pushed_out(packet));
        }
    }
    (commanded, to_all)
}

fn first(motors: u8) -> impl Iterator<Item = MotorId> {
    MotorId::all().take(motors.into())
}

#[test]
fn cyclic_stop_of_all_reaches_each_motor() {
    for motors in [6, 8, 12, 16, 32] {
        let mut master = Master::new(Config::CAN);
        let commanded = commanded(&mut master, 0..100, MotorSet::EMPTY, |master, _| {
            master.stop_all(StopKind::Off, first(motors).collect()).unwrap();
        });
        // Three a millisecond, and they are answered in the next one.
        let last = u64::from(motors).div_ceil(MAILBOXES as u64);
        for motor in first(motors) {
            let (at, _) = commanded[motor.index()];
            assert!(at.is_some_and(|at| at <= last), "motor {motor} of {motors}: {at:?}");
        }
    }
}

/// The motor has not answered its last request, so the others do not wait for its turn.
#[test]
fn stop_of_a_silent_motor_is_sent_before_the_streams_of_others() {
    for motors in 4..=12 {
        let mut master = Master::new(Config::CAN);
        let last = id(motors);
        let commanded = commanded(&mut master, 0..300, last.into(), |master, now| {
            if now == 100 {
                let _read = master.request(last, ReadModel).unwrap();
            }
            if now == 200 {
                master.stop(last, StopKind::Off).unwrap();
            }
            for motor in first(motors - 1) {
                master.set_point(motor, torque(1.0), ms(now)).unwrap();
            }
        });
        // It has to make way at 200 ms, is alone in the mailboxes at 201 ms, and is sent.
        assert!(commanded[last.index()].0.is_some_and(|at| at <= 202), "of {motors}");
    }
}

/// A cycle in which each of these gets a set-point.
fn stream(motors: MotorSet) -> impl FnMut(&mut Master<32>, u64) {
    move |master, now| {
        for motor in motors.iter() {
            master.set_point(motor, torque(1.0), ms(now)).unwrap();
        }
    }
}

/// The last motor has streamed alone, and then an idle one was stopped; or two or three answers of it were lost; or all
/// have streamed, and it has answered none.
#[test]
fn streams_of_all_have_equal_shares_whatever_was_before() {
    for motors in [4, 6, 9, 12, 16] {
        let last = id(motors);
        for history in 0..5 {
            let mut master = Master::new(Config::CAN);
            match history {
                1 => {
                    commanded(&mut master, 0..3_000, MotorSet::EMPTY, stream(last.into()));
                    commanded(&mut master, 3_000..3_100, MotorSet::EMPTY, |master, now| {
                        if now == 3_050 {
                            master.stop(id(1), StopKind::Off).unwrap();
                        }
                    });
                    master.lift_stop();
                }
                2 | 3 => {
                    commanded(&mut master, 3_000..3_100, last.into(), |master, now| {
                        if now == 3_000 {
                            let patience = master.patience(history);
                            let _read = master.request_with(last, ReadModel, patience).unwrap();
                        }
                    });
                }
                4 => {
                    let all = stream(first(motors).collect());
                    commanded(&mut master, 0..3_100, last.into(), all);
                }
                _ => {}
            }
            let all = stream(first(motors).collect());
            let commanded = commanded(&mut master, 3_100..3_600, MotorSet::EMPTY, all);
            let shares: Vec<_> = first(motors).map(|motor| commanded[motor.index()].1).collect();
            let (least, most) = (shares.iter().min().unwrap(), shares.iter().max().unwrap());
            assert!(most - least <= 3 + most / 20, "of {motors}, {history}: {shares:?}");
        }
    }
}

/// The turns of the stopped motor are no measure for the others.
#[test]
fn streams_have_equal_shares_while_one_motor_is_stopped_in_every_cycle() {
    for (motors, stopped) in [(8, 1), (8, 8), (12, 1), (12, 12), (32, 1), (32, 32)] {
        let mut master = Master::new(Config::CAN);
        let others = first(motors).collect::<MotorSet>().without(id(stopped).into());
        let mut streams = stream(others);
        let commanded = commanded(&mut master, 0..1_000, MotorSet::EMPTY, |master, now| {
            master.stop(id(stopped), StopKind::Off).unwrap();
            streams(master, now);
        });
        let shares: Vec<_> = others.iter().map(|motor| commanded[motor.index()].1).collect();
        let (least, most) = (shares.iter().min().unwrap(), shares.iter().max().unwrap());
        assert!(most - least <= 3 + most / 20, "of {motors}, {stopped}: {shares:?}");
    }
}

/// How often a command to all is sent in 200 ms in which this many motors are stopped in every cycle. That is more than
/// the mailboxes hold, and all of it goes before a command to all.
fn broadcasts_during_stops(motors: u8, mut command: impl FnMut(&mut Master<32>, u64)) -> u64 {
    let mut master = Master::new(Config::CAN);
    let (_, to_all) = commanded_with_all(&mut master, 0..200, MotorSet::EMPTY, |master, now| {
        for motor in first(motors) {
            master.stop(motor, StopKind::Off).unwrap();
        }
        command(master, now);
    });
    to_all
}

#[test]
fn broadcast_is_sent_though_motors_are_stopped_in_every_cycle() {
    for motors in [3, 4, 6, 12, 31] {
        for expected in [first(motors).collect(), MotorSet::EMPTY] {
            let reads = broadcasts_during_stops(motors, |master, _| {
                let _active = master.broadcast(ReadMultiTurnAngle, expected);
            });
            assert!(reads >= 10, "{reads} beside stops of {motors}, {expected:?}");
        }
        let locks = broadcasts_during_stops(motors, |master, _| {
            let _active = master.broadcast(LockBrake, MotorSet::EMPTY);
        });
        assert!(locks >= 10, "{locks} beside stops of {motors}");
    }
}

#[test]
fn stop_to_all_is_sent_though_motors_are_stopped_in_every_cycle() {
    for motors in [3, 4, 6, 12, 31] {
        let stops = broadcasts_during_stops(motors, |master, now| {
            if now == 100 {
                master.broadcast.may_be_unnamed = true;
                master.stop_all(StopKind::Off, MotorSet::EMPTY).unwrap();
            }
        });
        assert!(stops >= 1, "beside stops of {motors}");
    }
}

/// Others stream, one is stopped, and all are asked for something, in every cycle.
#[test]
fn requested_shutdown_is_sent_within_41_ms_during_cyclic_broadcasts() {
    for motors in [4, 6, 8, 10] {
        let mut master = Master::new(Config::CAN);
        let mut streams = stream(first(motors).filter(|&motor| motor > id(2)).collect());
        let commanded = commanded(&mut master, 0..600, MotorSet::EMPTY, |master, now| {
            streams(master, now);
            master.stop(id(2), StopKind::Off).unwrap();
            let _active = master.broadcast(ReadMultiTurnAngle, first(motors).collect());
            if now == 100 {
                let _off = master.request(id(1), Shutdown).unwrap();
            }
        });
        // As long as one command to all may take, and the next.
        let (at, _) = commanded[0];
        assert!(at.is_some_and(|at| at <= 141), "of {motors}: {at:?}");
    }
}

/// The last motor has answered nothing before.
#[test]
fn request_to_the_last_motor_is_sent_though_others_stream() {
    for motors in [4, 6, 9, 12, 16] {
        let mut master = Master::new(Config::CAN);
        let last = id(motors);
        let mut others = stream(first(motors - 1).collect());
        commanded(&mut master, 0..100, last.into(), |master, now| {
            if now == 0 {
                let _read = master.request(last, ReadModel).unwrap();
            }
        });
        let commanded = commanded(&mut master, 100..120, MotorSet::EMPTY, |master, now| {
            if now == 110 {
                let _read = master.request(last, ReadRunTime).unwrap();
            }
            others(master, now);
        });
        assert_eq!(commanded[last.index()], (None, 1), "of {motors}");
    }
}

/// A queue as SocketCAN has it, with room for this many frames: a bus of eight frames a millisecond, on which answers
/// arbitrate. Drives answer after 7 frames' time.
struct Arbitrating {
    room: usize,
    queue: std::collections::VecDeque<Packet>,
    /// From which slot on each may come.
    answers: Vec<(u64, MotorId, Data)>,
    /// How many there are.
    motors: u8,
    /// How often all were asked, and the first was stopped.
    to_all: u32,
    stops_of_first: u32,
}

impl Arbitrating {
    fn new(room: usize, motors: u8) -> Self {
        let (queue, answers) = Default::default();
        Self { room, queue, answers, motors, to_all: 0, stops_of_first: 0 }
    }

    /// Carries a frame. If it is an answer, returns whose it is.
    fn carry(&mut self, slot: u64) -> Option<(MotorId, Data)> {
        // The ids of commands are the lower ones.
        if let Some(packet) = self.queue.pop_front() {
            if packet.channel == Channel::Command(Target::All) {
                let answers = first(self.motors).map(|motor| (slot + 7, motor, ANGLE_REPLY));
                self.answers.extend(answers);
                self.to_all += 1;
            }
            if let Channel::Command(Target::Motor(motor)) = packet.channel {
                self.stops_of_first += u32::from(motor == id(1) && packet.data[0] == 0x80);
                let is_torque = packet.data[0] == 0xA1;
                let data = if is_torque { TORQUE_REPLY } else { packet.data };
                self.answers.push((slot + 7, motor, data));
            }
            return None;
        }
        let ready = self.answers.iter().filter(|(at, ..)| *at <= slot);
        let first = *ready.min_by_key(|(_, motor, _)| *motor)?;
        self.answers.retain(|it| *it != first);
        Some((first.1, first.2))
    }

    /// Takes what the master has to send.
    fn fill(&mut self, master: &mut Master<32>, now: Instant) {
        while self.queue.len() < self.room {
            let Some(packet) = master.poll_transmit(now) else { break };
            master.handle_transmitted(now);
            self.queue.push_back(packet);
        }
    }
}

#[test]
fn cyclic_stop_of_all_is_confirmed_by_each_motor_though_answers_arbitrate() {
    for motors in [8, 16, 32] {
        let (mut master, mut bus) = (Master::<32>::new(Config::CAN), Arbitrating::new(10, motors));
        let mut silent: MotorSet = first(motors).collect();
        for slot in 0..400 {
            let now = Instant::from_micros(125 * slot);
            if let Some((motor, data)) = bus.carry(slot) {
                let event = reply(&mut master, motor.get(), data, now);
                if event == confirmed(motor.get()) {
                    silent.remove(motor);
                }
            }
            if slot % 8 == 0 {
                master.stop_all(StopKind::Off, first(motors).collect()).unwrap();
            }
            assert_eq!(events(&mut master, now), []);
            bus.fill(&mut master, now);
        }
        assert_eq!(silent, MotorSet::EMPTY, "of {motors}");
    }
}

/// One or two answers of the motor were lost; the bus is full, and answers of lower ids go before its own.
#[test]
fn motor_with_lost_answers_still_confirms_its_stop_within_20_ms() {
    for (motors, lost) in [(6_u8, 1), (9, 1), (12, 1), (6, 2), (9, 2), (12, 2)] {
        let (mut master, mut bus) =
            (Master::<32>::new(Config::CAN), Arbitrating::new(MAILBOXES, motors));
        let last = id(motors);
        let mut others = stream(first(motors - 1).collect());
        let (mut loses, mut stopped_at, mut confirmed_at) = (0, 0, None);
        for slot in 0..8_000 {
            let now = Instant::from_micros(125 * slot);
            if let Some((motor, data)) = bus.carry(slot) {
                if motor == last && loses > 0 {
                    loses -= 1;
                } else if reply(&mut master, motor.get(), data, now) == confirmed(motors) {
                    confirmed_at.get_or_insert(slot);
                }
            }
            others(&mut master, slot / 8);
            if slot == 800 {
                loses = lost;
                let patience = master.patience(lost);
                let _read = master.request_with(last, ReadModel, patience).unwrap();
            }
            if slot == 1_200 {
                stopped_at = slot;
                master.stop(last, StopKind::Off).unwrap();
            }
            events(&mut master, now);
            bus.fill(&mut master, now);
        }
        let confirmed_after = confirmed_at.map(|at| at - stopped_at);
        assert!(
            confirmed_after.is_some_and(|slots| slots <= 8 * 20),
            "{motors}, {lost}: {confirmed_after:?}"
        );
    }
}

/// The others stream, and the bus is never quiet.
#[test]
fn cyclic_stop_and_cyclic_broadcast_both_get_turns_on_a_full_bus() {
    for (motors, room) in [(6_u8, MAILBOXES), (12, MAILBOXES), (6, 10), (12, 10)] {
        let (mut master, mut bus) =
            (Master::<32>::new(Config::CAN), Arbitrating::new(room, motors));
        let mut others = stream(first(motors).filter(|&motor| motor > id(1)).collect());
        for slot in 0..8_000 {
            let now = Instant::from_micros(125 * slot);
            if let Some((motor, data)) = bus.carry(slot) {
                reply(&mut master, motor.get(), data, now);
            }
            others(&mut master, slot / 8);
            master.stop(id(1), StopKind::Off).unwrap();
            let _active = master.broadcast(ReadMultiTurnAngle, first(motors).collect());
            events(&mut master, now);
            bus.fill(&mut master, now);
        }
        let (to_all, stops) = (bus.to_all, bus.stops_of_first);
        assert!(
            to_all >= 40 && stops >= 40,
            "of {motors}, {room}: {to_all} and {stops} in a second"
        );
    }
}

/// Nobody answers what goes to all, so that it could go again at once.
#[test]
fn cyclic_stop_and_cyclic_broadcast_without_answers_both_get_turns() {
    let command = RawCommand::new([0xE3, 0, 0, 0, 0, 0, 0, 0], ReplyRule::Silent, false);
    for (motors, streams) in [(6, false), (6, true), (12, false), (12, true)] {
        let (mut master, mut bus) =
            (Master::<32>::new(Config::CAN), Arbitrating::new(MAILBOXES, motors));
        let mut others = stream(first(motors).filter(|&motor| motor > id(1)).collect());
        for slot in 0..8_000 {
            let now = Instant::from_micros(125 * slot);
            let carried = bus.carry(slot);
            bus.answers.retain(|(_, _, data)| *data != ANGLE_REPLY);
            if let Some((motor, data)) = carried {
                reply(&mut master, motor.get(), data, now);
            }
            if streams {
                others(&mut master, slot / 8);
            }
            master.stop(id(1), StopKind::Off).unwrap();
            let _active = master.broadcast(command, MotorSet::EMPTY);
            events(&mut master, now);
            bus.fill(&mut master, now);
        }
        let (to_all, stops) = (bus.to_all, bus.stops_of_first);
        assert!(
            to_all >= 40 && stops >= 40,
            "of {motors}, {streams}: {to_all} and {stops} in a second"
        );
    }
}

/// A frame sent ahead would be pushed out, or would push one out that all then wait for.
#[test]
fn a_motor_gets_a_round_less_ahead_for_each_frame_that_could_be_pushed_out() {
    let at = Instant::from_micros;
    let answer = |master: &mut Master<8>, motor, now| {
        feedback_of_all(master, motor..=motor, at(now));
        stream_to(master, motor..=motor, at(now));
        (sent(master, at(now)).len(), master.poll_at())
    };
    for pushes_out in [false, true] {
        let mut master = Master::<8>::new(Config::CAN);
        stream_to(&mut master, 1..=8, ms(0));
        let last = sent(&mut master, ms(0))[7];
        if pushes_out {
            master.handle_pushed_out(&last);
            assert_eq!(sent(&mut master, ms(0)), [last]);
        }
        feedback_of_all(&mut master, 1..=8, ms(2));
        stream_to(&mut master, 1..=8, ms(10));
        assert_eq!(sent(&mut master, ms(10)).len(), 8, "frames of 136 us, until 11.088 ms");
        if !pushes_out {
            assert_eq!([10_300, 10_900].map(|now| answer(&mut master, 1, now).0), [1, 1]);
            continue;
        }
        // Three may be in the mailboxes: no motor gets ahead.
        assert_eq!(answer(&mut master, 1, 10_300), (0, Some(at(10_816))));
        assert_eq!(sent(&mut master, at(10_815)), []);
        assert_eq!(sent(&mut master, at(10_816)).len(), 1, "until 11.224 ms");
        assert_eq!(answer(&mut master, 2, 10_820), (0, Some(at(10_952))));
        assert_eq!(sent(&mut master, at(10_952)).len(), 1, "until 11.360 ms");
        // Two: one round.
        assert_eq!(answer(&mut master, 1, 11_100), (0, Some(at(11_224))));
        // A stop waits for none of that.
        master.stop(id(3), StopKind::Off).unwrap();
        assert_eq!(sent(&mut master, at(11_100)), [packet_to(3, Shutdown.encode())]);
        assert_eq!(sent(&mut master, at(11_359)), []);
        assert_eq!(sent(&mut master, at(11_360)).len(), 1);
    }
}

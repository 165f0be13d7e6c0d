//! Where ids decide who is first: a controller of three mailboxes that sends by priority, and hands back what has to make
//! way, and a bus on which answers arbitrate. No stop is handed back for ever, and none unconfirmed.

use super::*;

const MAILBOXES: usize = 3;

/// Motors are told by their id, the lower the sooner.
fn priority(packet: &Packet) -> Option<core::cmp::Reverse<MotorId>> {
    match packet.channel {
        Channel::Command(Target::Motor(motor)) => Some(core::cmp::Reverse(motor)),
        _ => None,
    }
}

/// Goes on for so many milliseconds: what lies in the mailboxes is sent and answered, by all but who is `absent`, then
/// the caller has its `cycle`, and then the master is looked after. Gives when each motor was first told to stop.
fn told(
    master: &mut Master<32>,
    span: core::ops::Range<u64>,
    absent: MotorSet,
    mut cycle: impl FnMut(&mut Master<32>, u64),
) -> [Option<u64>; MotorId::COUNT] {
    let mut told = [None; MotorId::COUNT];
    let mut mailboxes = Vec::<Packet>::new();
    for now in span {
        for packet in core::mem::take(&mut mailboxes) {
            let Channel::Command(Target::Motor(motor)) = packet.channel else { continue };
            let is_stop = packet.data[0] == 0x80;
            if is_stop {
                told[motor.index()].get_or_insert(now);
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
    told
}

fn first(motors: u8) -> impl Iterator<Item = MotorId> {
    MotorId::all().take(motors.into())
}

#[test]
fn a_stop_of_all_of_every_cycle_reaches_each_motor() {
    for motors in [6, 8, 12, 16, 32] {
        let mut master = Master::new(Config::CAN);
        let told = told(&mut master, 0..100, MotorSet::EMPTY, |master, _| {
            master.stop_all(StopKind::Off, first(motors).collect()).unwrap();
        });
        // Three a millisecond, and they are answered in the next one.
        let last = u64::from(motors).div_ceil(MAILBOXES as u64);
        for motor in first(motors) {
            let at = told[motor.index()];
            assert!(at.is_some_and(|at| at <= last), "motor {motor} of {motors}: {at:?}");
        }
    }
}

/// It has not answered when it was asked, so that nobody waits for its turn.
#[test]
fn a_stop_of_one_goes_before_the_streams_of_others_though_it_seems_dead() {
    for motors in 4..=12 {
        let mut master = Master::new(Config::CAN);
        let last = id(motors);
        let told = told(&mut master, 0..300, last.into(), |master, now| {
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
        // It has to make way at 200 ms, lies there alone at 201 ms, and is sent.
        assert_eq!(told[last.index()], Some(202), "of {motors}");
    }
}

/// A queue as SocketCAN has it: a bus of eight frames a millisecond, on which answers arbitrate. Drives answer after 7
/// frames' time.
#[test]
fn a_stop_of_all_of_every_cycle_is_confirmed_by_each_motor_though_answers_arbitrate() {
    for motors in [8, 16, 32] {
        let mut master = Master::<32>::new(Config::CAN);
        let mut queue = std::collections::VecDeque::<MotorId>::new();
        let mut answers = Vec::<(u64, MotorId)>::new();
        let mut silent: MotorSet = first(motors).collect();
        for slot in 0..400 {
            let now = Instant::from_micros(125 * slot);
            let ready =
                answers.iter().filter(|(at, _)| *at <= slot).min_by_key(|(_, motor)| *motor);
            // The ids of commands are the lower ones.
            match (queue.pop_front(), ready.copied()) {
                (Some(motor), _) => answers.push((slot + 7, motor)),
                (None, Some(answer)) => {
                    answers.retain(|it| *it != answer);
                    let event = reply(&mut master, answer.1.get(), Shutdown.encode(), now);
                    if event == confirmed(answer.1.get()) {
                        silent.remove(answer.1);
                    }
                }
                (None, None) => {}
            }
            if slot % 8 == 0 {
                master.stop_all(StopKind::Off, first(motors).collect()).unwrap();
            }
            assert_eq!(events(&mut master, now), []);
            while queue.len() < 10 {
                let Some(packet) = master.poll_transmit(now) else { break };
                master.handle_transmitted(now);
                let Channel::Command(Target::Motor(motor)) = packet.channel else { continue };
                queue.push_back(motor);
            }
        }
        assert_eq!(silent, MotorSet::EMPTY, "of {motors}");
    }
}

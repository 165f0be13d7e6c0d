//! What was sent to all and lies in a mailbox while something else was sent to all since; what is handed back after a
//! restart or a failure.

use super::*;

/// A motor that is known, and then silent until a restart of it is told.
fn restarted(between: impl FnOnce(&mut Master<2>) -> Packet) -> (Master<2>, Packet) {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    let once = Patience { attempts: 1, reply_timeout: Duration::from_millis(20) };
    let _ = master.request_with(id(1), ReadModel, once).unwrap();
    sent(&mut master, ms(2));
    events(&mut master, ms(70));
    let in_mailbox = between(&mut master);
    reply(&mut master, 1, [0x9A, 50, 30, 1, 0xE5, 0x01, 0, 0], ms(1_100)).unwrap();
    (master, in_mailbox)
}

#[test]
fn a_move_of_all_that_is_handed_back_after_a_restart_was_told_does_not_go_by_itself() {
    for (expected, is_resumed) in
        [(id(1).into(), false), (MotorSet::EMPTY, false), (id(1).into(), true)]
    {
        let (mut master, in_mailbox) = restarted(|master| {
            master.broadcast(step(), expected).unwrap();
            sent(master, ms(1_090))[0]
        });
        let told: Vec<Event> = core::iter::from_fn(|| {
            master.places.news.iter().next()?;
            master.change(id(1), take_news)?
        })
        .collect();
        assert!(told.contains(&Event::Restarted { motor: id(1) }), "{told:?}");
        master.handle_pushed_out(&in_mailbox);
        if is_resumed {
            master.resume(id(1));
        }
        assert_eq!(master.poll_transmit(ms(1_100)), None, "{expected:?}");
        let told = events(&mut master, ms(1_100));
        assert!(
            told.contains(&Event::BroadcastDone { silent: expected, was_sent: false }),
            "{told:?}"
        );
    }
}

#[test]
fn a_stop_that_is_handed_back_after_it_has_failed_was_not_lost_rather_than_not_answered() {
    let mut master = Master::<2>::new(Config::CAN);
    let _ = ask(&mut master, 1, ReadMultiTurnAngle, ms(0));
    reply(&mut master, 1, ANGLE_REPLY, ms(1)).unwrap();
    master.stop(id(1), StopKind::Off).unwrap();
    let mut in_mailbox = None;
    for attempt in 0..15 {
        in_mailbox = sent(&mut master, ms(2 + 21 * attempt)).pop();
    }
    assert_eq!(events(&mut master, ms(317)), [Event::StopUnconfirmed { motor: id(1) }]);
    let counted = |master: &Master<2>| (master.health(id(1)).answered, master.health(id(1)).lost);
    assert_eq!(counted(&master), (1, 15));
    master.handle_pushed_out(&in_mailbox.unwrap());
    assert_eq!(counted(&master), (1, 14));
}

#[test]
fn feedback_counts_as_lost_when_its_time_is_up_also_where_that_is_shorter_than_the_longest_response()
 {
    let mut config = Config { reply_timeout: Duration::from_micros(1_200), ..Config::CAN };
    config.late_window = Duration::from_millis(3);
    let mut master = Master::<2>::new(config);
    master.set_point(id(1), torque(1.0), ms(0)).unwrap();
    assert_eq!(sent(&mut master, ms(0)).len(), 1);
    let at = master.poll_at().unwrap();
    assert_eq!(at, Instant::from_micros(1_200));
    assert_eq!(events(&mut master, at), [Event::SetPointUnanswered { motor: id(1) }]);
}

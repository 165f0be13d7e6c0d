//! Watched moves: what ends them.

use core::future::poll_fn;
use core::ops::ControlFlow;

use embedded_can::{Frame as _, nb};

use super::id;
use super::world::{Broken, TestCan, block_on, on_can, pending};
use crate::command::{AbsolutePosition, ErrorFlags};
use crate::io::async_bring_up::move_to;
use crate::io::bring_up::{self, MoveFailure, MoveLimits};
use crate::io::{AsyncCan, AsyncCanMaster, CanMaster};
use crate::opcode::Opcode;
use crate::units::{Angle, MaxSpeed};
use crate::wire::can::SimpleFrame;

/// A bus whose motors come nearer, to 360 degrees, and then report an error.
#[derive(Clone, Debug)]
struct Faulty {
    can: TestCan,
    /// So often a motor is read short of 360 degrees yet.
    is_short: u8,
    /// So many statuses say yet that there is no error.
    is_well: u8,
}

impl nb::Can for Faulty {
    type Frame = SimpleFrame;
    type Error = Broken;

    fn transmit(&mut self, frame: &SimpleFrame) -> ::nb::Result<Option<SimpleFrame>, Broken> {
        nb::Can::transmit(&mut self.can, frame)
    }

    fn receive(&mut self) -> ::nb::Result<SimpleFrame, Broken> {
        let frame = nb::Can::receive(&mut self.can)?;
        let mut data: [u8; 8] = frame.data().try_into().unwrap();
        let next = |left: &mut u8| core::mem::replace(left, left.saturating_sub(1)) > 0;
        match Opcode::from_byte(data[0]) {
            Some(Opcode::ReadMultiTurnAngle) if next(&mut self.is_short) => data[5] -= 4,
            Some(Opcode::ReadStatus1) if !next(&mut self.is_well) => data[6] = 0x04,
            _ => {}
        }
        Ok(SimpleFrame::new(frame.id(), &data).unwrap())
    }
}

impl AsyncCan for Faulty {
    type Frame = SimpleFrame;
    type Error = Broken;

    async fn transmit(&mut self, frame: &SimpleFrame) -> Result<Option<SimpleFrame>, Broken> {
        AsyncCan::transmit(&mut self.can, frame).await
    }

    async fn receive(&mut self) -> Result<SimpleFrame, Broken> {
        poll_fn(|_| pending(nb::Can::receive(self))).await
    }
}

/// An error that has come by the look that finds the motor at its target wins: it holds nothing there.
#[test]
fn who_arrives_with_an_error_has_not_arrived() {
    let command =
        AbsolutePosition { max_speed: MaxSpeed::from_raw(360), angle: Angle::from_raw(36_000) };
    let limits = MoveLimits::default();
    // It is looked at in any case in the first and in every fifth look.
    for looks in 0_u8..=5 {
        // One angle and one status are read before the move is sent.
        let (is_short, is_well) = (1 + looks, 1 + looks.div_ceil(5));
        let go_on = |_: &_| ControlFlow::Continue(());
        let (_, _, mut arm) = on_can(|can, clock, config| {
            CanMaster::<_, _, 4>::new(Faulty { can, is_short, is_well }, clock, config)
        });
        let polled = bring_up::move_to(&mut arm, id(1), command, &limits, go_on);
        let (_, _, mut arm) = on_can(|can, clock, config| {
            AsyncCanMaster::<_, _, 4>::new(Faulty { can, is_short, is_well }, clock, config)
        });
        let awaited = block_on(move_to(&mut arm, id(1), command, &limits, go_on));
        for moved in [polled, awaited] {
            let why = moved.map_err(|it| (it.why, it.is_stopped));
            let fault = MoveFailure::Fault(ErrorFlags::UNDER_VOLTAGE);
            assert_eq!(why, Err((fault, true)), "after {looks} looks");
        }
    }
}

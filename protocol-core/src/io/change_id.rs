//! Gives a motor another id.
//!
//! Function 5 (0x20) comes first: it names its motor, and every firmware seen so far knows it. If nobody acknowledges
//! that and the motor is alone, 0x79 follows, which every connected motor obeys. A drive is restarted only when the id
//! is known to be taken. One that did not take it would come back as it was, and its shaft would be free for nothing.

use crate::command::{
    AnyReply, BusId, Command, FunctionControl, ReadMultiTurnAngle, ReadRunTime, ReadStatus1,
    ReadStatus2, ReadStatus3,
};
use crate::id::MotorId;
use crate::io::asking::CallError;
use crate::io::async_runner::AsyncRunner;
use crate::io::brake::switch_off;
use crate::io::keep_alive::KeptAlive;
use crate::io::outcome::BringUpError;
use crate::io::presence::{find, is_there};
use crate::io::restart::restart_what_is_off;
use crate::io::standing::{check_not_stopped, check_stands};
use crate::master::{Event, Failure, MotorSet, Patience, has_errors};
use crate::time::Duration;

/// How long an acknowledgement may take.
const ACKNOWLEDGED_IN: Duration = Duration::from_millis(100);
/// How long after the first answer a second one may come: an adapter may hold it back for 16 ms.
const SECOND_ANSWER: Duration = Duration::from_millis(25);
/// How long the first answer may take at least, on a busy machine for example.
const ANSWERED_IN: Duration = Duration::from_millis(100);
/// How often a question is put if it is lost, or if its answers are, like those of two motors on a line.
const ATTEMPTS: usize = 3;
/// How often the questions are put that tell two motors with one id apart.
const ROUNDS: usize = 3;
/// How often an id is asked whose answers are not understood, and after how many silences nobody has it.
const QUESTIONS: usize = 10;
const SILENCES: usize = 2;
/// How long to listen for noise behind each of these questions. Others hear nothing meanwhile.
const LISTENING: Duration = Duration::from_millis(10);

/// As [`bring_up::change_id`](crate::io::bring_up::change_id). If this future is dropped:
///
/// - Ids that were asked keep their places in the master, as with [`scan`](crate::io::async_bring_up::scan).
/// - The motor may be off, with only its brake to hold a load.
/// - It may have either id, at the latest from its next start on: scan again.
pub async fn change_id<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    from: MotorId,
    to: MotorId,
) -> Result<(), BringUpError<R::Error>> {
    // A call that changes nothing is not refused.
    if from != to {
        check_not_stopped(runner, from)?;
    }
    // Both ids are spoken to. Nothing is written unless the master has places for them.
    runner.master().has_places_for([from, to].into()).map_err(CallError::refused(to))?;
    let (mut there, garbled) = (MotorSet::EMPTY, runner.master().garbled());
    find(runner, MotorSet::ALL, &mut there, |_, _| {}).await?;
    let is_clean = |runner: &mut R| runner.master().garbled() == garbled;
    let is_had = async |runner: &mut R, id, other| match there.contains(id) {
        true => Ok(true),
        false if is_clean(runner) => Ok(false),
        false => has_one(runner, id, other).await,
    };
    if !is_had(runner, from, to).await? {
        return Err(BringUpError::NotThere(from));
    }
    if from == to {
        return Ok(());
    }
    if is_had(runner, to, from).await? {
        return Err(BringUpError::IdTaken(to));
    }
    if is_shared(runner, from).await? {
        return Err(BringUpError::IdShared(from));
    }
    check_stands(runner, from).await?;
    // Some drives keep nothing unless they are shut down.
    switch_off(runner, from).await?;
    // Motors that nobody understands may be others. Known ones may be out.
    let is_alone = there.with(runner.master().motors()) == from.into() && is_clean(runner);
    write_id(runner, from, to, is_alone).await.map_err(|error| error.behind_a_write(from))
}

/// Whether a motor has an id that the search did not find, while something came that is no frame. Noise comes now and
/// then, also while nobody is asked, or with the other id's answers as well. Refuses motors that answer at the same time
/// on a line, so that they are not understood, and so much noise that nothing shows who answers.
async fn has_one<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    id: MotorId,
    other: MotorId,
) -> Result<bool, BringUpError<R::Error>> {
    let (mut silences, mut is_noisy) = (0, false);
    for _ in 0..QUESTIONS {
        match hear(runner, id).await? {
            (true, _) => return Ok(true),
            (false, false) => silences += 1,
            (false, true) => {}
        }
        // One question may have been lost.
        if silences == SILENCES {
            return Ok(false);
        }
        let garbled = runner.master().garbled();
        let end = runner.now() + LISTENING;
        runner.run_until(end, |_| {}).await?;
        is_noisy |= runner.master().garbled() != garbled;
    }
    if is_noisy {
        return Err(BringUpError::Noise(id));
    }
    for _ in 0..ROUNDS {
        let (_, is_garbled) = hear(runner, other).await?;
        if !is_garbled {
            return Err(BringUpError::IdShared(id));
        }
    }
    Ok(false)
}

/// Asks this id. Returns whether it answers, and whether anything came that is no frame.
async fn hear<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    id: MotorId,
) -> Result<(bool, bool), CallError<R::Error>> {
    let garbled = runner.master().garbled();
    let is_there = is_there(runner, id).await?;
    Ok((is_there, runner.master().garbled() != garbled))
}

/// Writes the id and puts it into force.
async fn write_id<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    from: MotorId,
    to: MotorId,
    is_alone: bool,
) -> Result<(), BringUpError<R::Error>> {
    let is_taken = is_taken_by_function_5(runner, from, to).await?
        || is_alone && is_taken_by_0x79(runner, from, to).await?;
    if !is_taken {
        return Err(BringUpError::IdNotTaken { from, to, is_alone });
    }
    // Some motors answer under the new id without a restart.
    if !is_there(runner, to).await? {
        restart_what_is_off(runner, from, to).await?;
    }
    if is_there(runner, from).await? {
        return Err(BringUpError::IdShared(from));
    }
    // Others that had it already may have been out, or not understood.
    if is_shared(runner, to).await? {
        return Err(BringUpError::IdShared(to));
    }
    runner.master().forget(from);
    Ok(())
}

/// Whether the motor has acknowledged the id, under the old one or the new one.
async fn is_taken_by_function_5<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    from: MotorId,
    to: MotorId,
) -> Result<bool, CallError<R::Error>> {
    let command = FunctionControl::SetCanId(to);
    let echo = command.encode();
    let mut is_taken = false;
    let mut hear = |event| {
        if let Event::Stray { motor, data } = event {
            is_taken |= (motor == from || motor == to) && data == echo;
        }
    };
    // The command is over when it was sent: drives were seen to take it without an answer.
    runner.ask_with(from, command, None, &mut hear).await?;
    let end = runner.now() + ACKNOWLEDGED_IN;
    let all = KeptAlive::new(runner, MotorSet::ALL);
    all.during(async |bus| bus.run_until(end, hear).await).await?;
    Ok(is_taken || is_there(runner, to).await?)
}

/// Whether somebody has acknowledged the id that goes to all connected motors.
async fn is_taken_by_0x79<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    from: MotorId,
    to: MotorId,
) -> Result<bool, CallError<R::Error>> {
    runner.master().broadcast(BusId::Write(to), to.into()).map_err(CallError::refused(from))?;
    let mut is_taken = false;
    let end = runner.now() + ACKNOWLEDGED_IN;
    let hear = |event| {
        is_taken |= matches!(event, Event::BroadcastReply { reply: AnyReply::BusId(_), .. });
    };
    // It is alone: nobody else is to be asked meanwhile.
    runner.run_until(end, hear).await?;
    Ok(is_taken || is_there(runner, to).await?)
}

/// As [`bring_up::is_shared`](crate::io::bring_up::is_shared).
pub async fn is_shared<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    id: MotorId,
) -> Result<bool, CallError<R::Error>> {
    // An answer to an earlier question may have come late, or have been lost. Not twice.
    Ok(seems_shared(runner, id).await? && seems_shared(runner, id).await?)
}

async fn seems_shared<R: AsyncRunner<N>, const N: usize>(
    runner: &mut R,
    id: MotorId,
) -> Result<bool, CallError<R::Error>> {
    let others = KeptAlive::new(runner, MotorSet::ALL.without(id.into()));
    let asking = others.during(async |bus| {
        for _ in 0..ROUNDS {
            let is_one = answers_once(bus, id, ReadStatus2).await?
                && answers_once(bus, id, ReadRunTime).await?
                && answers_once(bus, id, ReadStatus3).await?
                && answers_once(bus, id, ReadMultiTurnAngle).await?
                && answers_once(bus, id, ReadStatus1).await?;
            if !is_one {
                return Ok(true);
            }
        }
        Ok(false)
    });
    asking.await
}

/// Whether exactly one readable answer comes.
async fn answers_once<R: AsyncRunner<N>, C: Command + Copy, const N: usize>(
    runner: &mut R,
    id: MotorId,
    command: C,
) -> Result<bool, CallError<R::Error>> {
    // If a question were put again while its answer is late, one motor would answer twice, too.
    let (kind, usual) = (command.kind(), runner.master().patience(1));
    let patience = Patience { reply_timeout: usual.reply_timeout.max(ANSWERED_IN), ..usual };
    for _ in 0..ATTEMPTS {
        let mut is_once = true;
        let mut hear = |event| match event {
            Event::Stray { motor, .. } if motor == id => is_once = false,
            // A second 0x9A looks like a report, and one with errors may well be one (function 3).
            Event::Report { motor, reply } if motor == id && reply.opcode() == kind.opcode() => {
                is_once &= has_errors(&reply);
            }
            _ => {}
        };
        let is_answered = match runner.ask_with(id, command, Some(patience), &mut hear).await {
            Ok(_) => true,
            Err(CallError::Failed {
                failure: Failure::NoReply | Failure::Unreadable(_), ..
            }) => false,
            Err(error) => return Err(error),
        };
        // Otherwise, too: on RS485 nobody else was spoken to while the answer was waited for.
        let both_have_answered = runner.now() + SECOND_ANSWER;
        runner.run_until(both_have_answered, hear).await?;
        if is_answered {
            return Ok(is_once);
        }
    }
    Ok(false)
}

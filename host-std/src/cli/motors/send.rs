//! `myactuator send`: one command, known or not, and its reply.

use myactuator_host_std::BusKind;
use myactuator_host_std::explain::{Explainer, FrameDirection};
use myactuator_host_std::open::BusError;
use myactuator_protocol_core::command::{
    AnyCommand, AnyReply, BusId, Phrase, RawCommand, SetBaudRate, awaits_reply,
};
use myactuator_protocol_core::io::{CallError, Runner};
use myactuator_protocol_core::master::{Config, Event, Failure, MotorSet, StopKind};
use myactuator_protocol_core::opcode::{Reach, Repeat, ReplyRule};
use myactuator_protocol_core::{Channel, Data, Firmware, Kind, MotorId, Opcode, Packet, Target};

use super::advice::{follow_up, risk};
use super::halt::halt;
use super::help::{SIGNALS, STOPS, paragraphs};
use super::moving::{LONGEST_WAIT, named};
use super::on_bus::OnBus;
use super::revision::MotorRevision;
use super::session::{Consent, Session, needs_consent, say};
use crate::cli::wanted::Wanted;
use crate::cli::{Outcome, Unfinished, arguments as parse, report};

/// Send one command to a motor or to all, and explain what is answered
///
/// The command is one of the table, by its name, or eight bytes of your own. A command to all is one frame that all
/// hear.
///
/// A command that sets a motor in motion leaves it moving: 'myactuator stop' ends that. If such a command is not
/// answered, or Ctrl-C is pressed, the motor is stopped (0x81).
///
/// If two motors seem to have the id, or no motor answers, a command that writes memory, restarts a motor, lets its
/// shaft go or is not known here is refused; one that moves is sent to both, with a note. There is no such check for
/// commands that only read or end motion, for 0xB6, and for all motors.
///
/// A bit rate is refused if the manual has no such rate on this bus. As bytes of your own it is sent.
///
/// What has to follow a command before it takes effect, such as a restart, is noted after its reply.
///
/// On RS485 the replies of several motors to a command to all collide, so they are not required.
///
/// Exit status: 0 sent, and answered by each motor that had to, 1 not, 2 wrong usage.
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = false, after_help = paragraphs([STOPS, SIGNALS]))]
pub(in crate::cli) struct Arguments {
    #[command(flatten)]
    on: OnBus,
    /// The motor, 1 to 32, or all on the bus.
    #[arg(long, global = true, value_parser = parse::target, allow_hyphen_values = true)]
    id: Option<Target>,
    /// Print one JSON object a reply, as decode does.
    #[arg(long, global = true)]
    json: bool,
    #[command(flatten)]
    revision: MotorRevision,
    #[command(flatten)]
    consent: Consent,
    #[command(subcommand)]
    command: Wanted,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let kind = arguments.command.kind()?;
    let target = parse::whom(kind, arguments.id)?;
    let bus = if reads(kind) { arguments.on.to_look()? } else { arguments.on.to_act()? };
    parse::check_bus(kind, bus.kind())?;
    if let Wanted::Table(table) = &arguments.command
        && let Ok(AnyCommand::SetBaudRate(SetBaudRate { baud_rate })) = table.command(None)
    {
        parse::check_baud_rate(baud_rate, bus.kind())?;
    }
    if let (Some(opcode), Some(firmware)) =
        (arguments.command.opcode(), arguments.revision.firmware)
    {
        parse::check_firmware(opcode, firmware)?;
    }
    if needs_consent(kind) {
        arguments.consent.check(&bus)?;
    }
    let config = Config { firmware: read_as(arguments), ..bus.config() };
    let session = Session::open_with(bus, config)?;
    session.note_slow_adapter();
    let mut session = Session { yes: arguments.consent.yes, ..session };
    if let Target::Motor(motor) = target {
        session.look_for_two(motor, kind)?;
    }
    run_on(&mut session, arguments)
}

/// The firmware by which replies are read: the one that was given, else the first that has the command. All firmwares
/// that have a command share its layout.
fn read_as(arguments: &Arguments) -> Firmware {
    let has_it = |firmware: &Firmware| match arguments.command.opcode() {
        Some(opcode) => opcode.is_in(*firmware),
        None => true,
    };
    let first = || Firmware::ALL.iter().copied().find(has_it);
    arguments.revision.firmware.or_else(first).unwrap_or(Firmware::V4_3)
}

/// Whether this only asks a motor for values.
fn reads(kind: Kind) -> bool {
    let has_values = |opcode: Opcode| opcode.reply_rule() == ReplyRule::Values;
    kind.opcode().is_some_and(has_values) && !needs_consent(kind)
}

fn run_on(session: &mut Session, arguments: &Arguments) -> Outcome {
    let kind = arguments.command.kind()?;
    let target = parse::whom(kind, arguments.id)?;
    let motors = if target == Target::All && kind.ends_motion() && !needs_consent(kind) {
        // Before anything is asked: it takes seconds to find all on a line, and those that hear may not be heard.
        let command = arguments.command.command(None)?;
        let _nobody = broadcast(session, as_raw(command), MotorSet::EMPTY, |_, _, _| Ok(()))?;
        session.meant(target).map_err(|error| match error {
            Unfinished::Failed(why) => {
                Unfinished::Failed(format!("{command} was sent to all, but {why}"))
            }
            other => other,
        })?
    } else {
        session.meant(target)?
    };
    let mut ranges = arguments.revision.ranges;
    for motor in motors.iter() {
        if let Some(opcode) = arguments.command.opcode() {
            arguments.revision.check_has(session, motor, opcode)?;
        }
        if kind.is_motion() {
            ranges = Some(arguments.revision.scales(session, motor)?);
        }
    }
    let direction = FrameDirection::Reply;
    let explainer = Explainer { firmware: read_as(arguments), ranges, direction };
    let command = arguments.command.command(ranges.as_ref())?;
    let sending = Sending { command, explainer, json: arguments.json };
    if needs_consent(kind) {
        session.confirm(motors, &sending.question(motors))?;
    }
    let send = |session: &mut Session| match target {
        Target::Motor(motor) => sending.to_one(session, motor),
        Target::All => sending.to_all(session, motors),
    };
    if !kind.moves() {
        send(session)?;
        let hint = |subcommand: &str| session.hint(subcommand, target);
        if let Some(note) = follow_up(sending.command, target, hint) {
            report("note", note);
        }
        return Ok(());
    }
    // After a command that moves, the motor is stopped if something fails, or if the program ends before its reply is
    // read.
    session.moving(motors, |session| {
        if target == Target::All {
            session.master.moved = MotorSet::ALL;
        }
        let sent = send(session).and_then(|()| session.wait_for_reader());
        if sent.is_err() && target == Target::All {
            // Also those that the scan has not found. The stop that follows reports on the others.
            let _ = halt(session, target, StopKind::Hold);
        }
        sent
    })?;
    let stop = session.hint("stop", target);
    report("note", format!("{} may go on: {stop} ends that", named(motors)));
    Ok(())
}

/// The command as a request of the master, which knows those of the table by their command byte.
fn as_raw(command: AnyCommand) -> RawCommand {
    match command {
        AnyCommand::Raw(command) => command,
        known => RawCommand::new(known.encode(), ReplyRule::Values, true),
    }
}

/// Sends all motors a command, and hands on what is answered. Returns those of `expected` that did not answer.
fn broadcast(
    session: &mut Session,
    command: RawCommand,
    expected: MotorSet,
    mut on_reply: impl FnMut(&Session, MotorId, AnyReply) -> Outcome,
) -> Outcome<MotorSet> {
    let sent = session.master.master().broadcast(command, expected);
    sent.map_err(|refusal| Unfinished::Failed(refusal.to_string()))?;
    loop {
        session.check_interrupted()?;
        match session.master.poll()? {
            Some(Event::BroadcastReply { motor, reply }) => on_reply(session, motor, reply)?,
            Some(Event::BroadcastDone { silent, was_sent: true }) => return Ok(silent),
            Some(Event::BroadcastDone { .. }) => {
                return Err(Unfinished::Failed(Failure::BusDown.to_string()));
            }
            Some(_) => {}
            None => {
                let soon = session.master.now() + LONGEST_WAIT;
                session.master.idle(soon);
            }
        }
    }
}

/// A command, and how its replies are reported.
struct Sending {
    command: AnyCommand,
    explainer: Explainer,
    json: bool,
}

impl Sending {
    fn kind(&self) -> Kind {
        self.command.kind()
    }

    fn words(&self) -> String {
        match self.command {
            AnyCommand::Motion(motion) => {
                let (fields, ranges) = (Opcode::Motion.command_fields(), &self.explainer.ranges);
                let values = Phrase { fields, data: &motion.encode(), ranges: ranges.as_ref() };
                format!("{}: {values}", Opcode::Motion)
            }
            command => command.to_string(),
        }
    }

    fn question(&self, motors: MotorSet) -> String {
        let who = if motors.len() == 1 { "Motor" } else { "Motors" };
        format!("{who} {motors} will be sent {}. {}", self.words(), risk(self.command))
    }

    fn to_one(&self, session: &mut Session, motor: MotorId) -> Outcome {
        let master = &mut session.master;
        let reply = match self.command {
            AnyCommand::Motion(motion) => master.ask(motor, motion).map(|reply| reply.encode()),
            _ => master.ask(motor, as_raw(self.command)).map(|reply| reply.0),
        };
        match reply {
            Ok(data) if awaits_reply(self.kind(), &as_raw(self.command).encode()) => {
                self.print(session, motor, data)
            }
            Ok(_) => self.print_sent(motor.into()),
            Err(error) => Err(self.failure(session, motor, error)),
        }
    }

    fn failure(
        &self,
        session: &mut Session,
        motor: MotorId,
        error: CallError<BusError>,
    ) -> Unfinished {
        match (self.kind(), error) {
            (Kind::Raw { byte, .. }, CallError::Failed { failure: Failure::NoReply, .. }) => {
                Unfinished::Failed(format!(
                    "motor {motor}: no reply to command byte 0x{byte:02X}: its firmware may not know \
                     it, or send no reply to it (--reply none); else, is the motor powered, and is \
                     this its id?"
                ))
            }
            (kind, error @ CallError::Failed { failure: Failure::NoReply, .. })
                if kind.repeat() == Repeat::ActsAgain =>
            {
                Unfinished::Failed(format!(
                    "{error} It was sent once, and may have been carried out: check what the motor does and \
                     has stored before you send it again"
                ))
            }
            (_, error) => session.failed(error),
        }
    }

    fn to_all(&self, session: &mut Session, motors: MotorSet) -> Outcome {
        let expected = match self.command {
            _ if !self.kind().has_reply() => MotorSet::EMPTY,
            // They answer with the new id.
            AnyCommand::BusId(BusId::Write(id)) => id.into(),
            _ => motors,
        };
        let at_once = session.address.kind() == BusKind::Rs485 && expected.len() > 1;
        let print =
            |session: &Session, motor, reply: AnyReply| self.print(session, motor, reply.encode());
        let silent = broadcast(session, as_raw(self.command), expected, print)?;
        if expected.is_empty() {
            return self.print_sent(motors);
        }
        if silent.is_empty() {
            return Ok(());
        }
        if at_once {
            report(
                "note",
                format!(
                    "{}: sent {}; on RS485 the replies of several motors collide, so it is not known which of them have \
                     received it",
                    named(motors),
                    self.words()
                ),
            );
            return Ok(());
        }
        let unknown = match self.kind() {
            Kind::Known(_) => "",
            Kind::Raw { .. } => "firmware may not know the command byte; ",
        };
        let why = match session.address.kind() {
            BusKind::Can => {
                "on CAN a motor whose id filter is on (function 2) does not hear what goes to all"
            }
            BusKind::Rs485 => "is it powered, and is this its id?",
        };
        Err(Unfinished::Failed(format!("no reply from {}: {unknown}{why}", named(silent))))
    }

    /// Says that the command was sent, if no reply is awaited.
    fn print_sent(&self, motors: MotorSet) -> Outcome {
        if self.json {
            return Ok(());
        }
        say(&format!("{}: sent {}; no reply is awaited", named(motors), self.words()))
    }

    /// Prints a reply, as `decode` does.
    fn print(&self, session: &Session, motor: MotorId, data: Data) -> Outcome {
        let channel = match self.kind().opcode().map(Opcode::reach) {
            Some(Reach::One) => Channel::MotionReply(motor),
            Some(Reach::Connected) => Channel::BusId,
            Some(Reach::OneOrAll) | None => Channel::Reply(motor),
        };
        let bus = session.address.kind();
        let Some(explanation) = self.explainer.packet(bus, &Packet { channel, data }) else {
            return Ok(());
        };
        say(&if self.json { explanation.to_json().to_string() } else { explanation.to_string() })?;
        if explanation.is_decoded() { Ok(()) } else { Err(Unfinished::FailedAndReported) }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use myactuator_host_std::open::{AnyMaster, BusAddress};
    use myactuator_host_std::sim::bus::can::ControllerConfig;
    use myactuator_host_std::sim::bus::trace;
    use myactuator_host_std::sim::{Fleet, LineFleet};
    use myactuator_protocol_core::command::{
        MotionLimits, MotionRanges, ReadStatus1, Stop, VersionDate,
    };
    use myactuator_protocol_core::io::CanMaster;
    use myactuator_protocol_core::time::Duration;

    use super::super::simulated::{sent, typed, with};
    use super::*;

    /// Sends on these drives. Returns the outcome, and the packets that were sent.
    fn send(fleet: &Fleet, line: &str) -> (Outcome, Vec<Packet>) {
        let arguments: Arguments = typed(line);
        let fleet = fleet.on_can(1_000_000).unwrap();
        let log = fleet.world.log();
        let config = Config { firmware: read_as(&arguments), ..Config::CAN };
        let mut session = with(&fleet, config);
        let outcome = run_on(&mut session, &arguments);
        // A command without a reply is still in flight.
        fleet.world.run_for(Duration::from_millis(1));
        (outcome, sent(&log))
    }

    fn failed(fleet: &Fleet, line: &str) -> (String, Vec<Packet>) {
        match send(fleet, line) {
            (Err(Unfinished::Failed(sentence)), packets) => (sentence, packets),
            other => panic!("{other:?}"),
        }
    }

    /// A session with drives on a line.
    fn on_line(motors: u8) -> (LineFleet, Session) {
        let fleet = Fleet::new(motors).on_rs485(115_200).unwrap();
        let mut session = Session::by(AnyMaster::SimulatedRs485(fleet.master()));
        session.address = BusAddress::Simulated { motors, kind: BusKind::Rs485 };
        (fleet, session)
    }

    const C0: Data = [0xC0, 1, 2, 3, 4, 5, 6, 7];

    #[test]
    fn unknown_command_is_sent_once_and_its_silence_is_explained() {
        let (message, packets) = failed(&Fleet::new(1), "--id 1 raw C0 01 2 3,4 0x5 0607");
        assert_eq!(
            message,
            "motor 1: no reply to command byte 0xC0: its firmware may not know it, or send no reply to it (--reply none); else, is the motor powered, and is this its id?"
        );
        let channel = Channel::Command(Target::Motor(MotorId::MIN));
        assert_eq!(packets, [Packet { channel, data: C0 }]);
        // A command that has no reply is not waited for.
        let (outcome, packets) = send(&Fleet::new(1), "--id 1 raw C001020304050607 --reply none");
        assert_eq!((outcome, packets), (Ok(()), vec![Packet { channel, data: C0 }]));
    }

    #[test]
    fn command_to_all_on_rs485_succeeds_without_replies() {
        let (fleet, mut session) = on_line(3);
        let log = fleet.world.log();
        assert_eq!(run_on(&mut session, &typed("--id all read-run-time")), Ok(()));
        let to_all = [0x3E, 0xCD, 8, 0xB1];
        assert_eq!(carried(&log).iter().filter(|frame| frame.starts_with(&to_all)).count(), 1);
    }

    fn carried(log: &trace::Log<Vec<u8>>) -> Vec<Vec<u8>> {
        let frames = log.take().into_iter().filter_map(|record| match record.event {
            trace::Event::Carried { frame, .. } => Some(frame),
            _ => None,
        });
        frames.collect()
    }

    /// To find out who is there takes seconds on a line, and may find nobody who hears it.
    #[test]
    fn what_ends_motion_of_all_is_sent_before_anything_else() {
        for (line, byte) in [("stop", 0x81), ("shutdown", 0x80), ("lock-brake", 0x78)] {
            let (fleet, mut session) = on_line(2);
            let log = fleet.world.log();
            assert_eq!(run_on(&mut session, &typed(&format!("--id all {line}"))), Ok(()));
            assert_eq!(carried(&log)[0][..4], [0x3E, 0xCD, 8, byte]);

            let faults = ["lose=1@from-drives".parse().unwrap()];
            let fleet = Fleet::new(1).faults(faults);
            let (message, packets) = failed(&fleet, &format!("--id all {line}"));
            assert_eq!(
                (packets[0].channel, packets[0].data[0]),
                (Channel::Command(Target::All), byte)
            );
            assert!(message.starts_with(line) && message.contains("was sent to all"), "{message}");
        }
    }

    #[test]
    fn missing_reply_on_rs485_is_reported_without_a_hint_at_can() {
        let (fleet, mut session) = on_line(1);
        fleet.world.cut(fleet.drives[0].station());
        let explainer = Explainer::new(Firmware::V4_3);
        let sending = Sending { command: Stop.into(), explainer, json: false };
        // It answers a scan, and is cut off then.
        let Err(Unfinished::Failed(message)) = sending.to_all(&mut session, MotorId::MIN.into())
        else {
            panic!("nobody answers");
        };
        assert_eq!(message, "no reply from motor 1: is it powered, and is this its id?");
    }

    #[test]
    fn unanswered_command_that_acts_each_time_may_have_been_carried_out() {
        let fleet = Fleet::new(1).faults(["cut@1".parse().unwrap()]);
        let (message, _) = failed(&fleet, "--id 1 set-current-position-zero");
        assert!(message.contains("may have been carried out"), "{message}");
    }

    #[test]
    fn a_motor_that_may_move_and_does_not_answer_is_stopped() {
        let (message, packets) =
            failed(&Fleet::new(1), "--id 1 raw --moves C0 01 02 03 04 05 06 07");
        assert!(
            message.ends_with(
                "; motor 1 is stopped and holds still (0x81) unless its protection (0xB3) ends that"
            ),
            "{message}"
        );
        let (first, rest) = packets.split_first().unwrap();
        assert_eq!((first.data, rest[0].data[0]), (C0, 0x81));
        // Its errors and its running mode are read.
        let is_expected = |packet: &Packet| [0x81, 0x9C, 0x9A, 0x70].contains(&packet.data[0]);
        assert!(rest[1..].iter().all(is_expected), "{rest:?}");
        // A read is none of those.
        let (message, packets) = failed(&Fleet::new(1), "--id 9 read-status1");
        assert!(!message.contains("stopped"), "{message}");
        assert!(packets.iter().all(|packet| packet.data[0] == 0x9A));
    }

    #[test]
    fn a_motor_that_was_sent_off_before_an_interruption_is_stopped() {
        let fleet = Fleet::new(2).on_can(1_000_000).unwrap();
        for line in ["--id 1", "--id all"] {
            let mut session = Session::on(&fleet);
            session.interrupted.store(true, Ordering::Relaxed);
            let line = format!("{line} --json speed --speed-dps 90 --max-torque-pct 0");
            let outcome = run_on(&mut session, &typed(&line));
            let Err(Unfinished::Interrupted(message)) = outcome else {
                panic!("{line}: {outcome:?}")
            };
            assert!(message.starts_with("interrupted; motor"), "{message}");
            let is_told = |whose| {
                message.ends_with(&format!("(0x81) unless {whose} protection (0xB3) ends that"))
            };
            assert!(is_told("its") || is_told("their"), "{message}");
        }
        // A command that does not move needs no stop.
        let mut session = Session::on(&fleet);
        session.interrupted.store(true, Ordering::Relaxed);
        assert_eq!(run_on(&mut session, &typed("--id 1 read-status1")), Ok(()));
    }

    /// Motor 2 never answers, so a scan does not find it. It hears the command to all.
    #[test]
    fn command_to_all_that_fails_is_followed_by_a_stop_to_all() {
        let turns = |faults: &[String]| {
            let faults = faults.iter().map(|fault| fault.parse().unwrap());
            let fleet = Fleet::new(2).faults(faults).on_can(1_000_000).unwrap();
            let mut session = Session::on(&fleet);
            let arguments = typed("--id all speed --speed-dps 90 --max-torque-pct 0");
            let outcome = run_on(&mut session, &arguments);
            let later = session.master.now() + Duration::from_secs(1);
            session.wait_until(later).unwrap();
            (outcome, fleet.drives[1].with(|drive| drive.plant().output_speed_dps() > 80.0))
        };
        let deaf = "lose=1@2,from-drives".to_owned();
        let fleet = Fleet::new(2).faults([deaf.parse().unwrap()]).on_can(1_000_000).unwrap();
        let mut session = Session::on(&fleet);
        assert_eq!(session.meant(Target::All), Ok(MotorId::MIN.into()));
        let after_scan = session.master.now().as_micros();
        assert_eq!(turns(std::slice::from_ref(&deaf)), (Ok(()), true));
        let (outcome, turns) = turns(&[deaf, format!("lose=1@1,from-drives+{after_scan}us")]);
        let Err(Unfinished::Failed(message)) = outcome else { panic!("{outcome:?}") };
        assert!(message.starts_with("no reply from motor 1"), "{message}");
        assert!(!turns, "{message}");
    }

    #[test]
    fn question_before_sending_names_the_command_and_its_risk() {
        let question = |line: &str| {
            let ranges = Some(MotionRanges::V4_3);
            let command = typed::<Arguments>(line).command.command(ranges.as_ref()).unwrap();
            let explainer = Explainer { ranges, ..Explainer::new(Firmware::V4_3) };
            let sending = Sending { command, explainer, json: false };
            needs_consent(sending.kind()).then(|| sending.question(MotorId::MIN.into()))
        };
        assert_eq!(question("read-pid --index 1"), None);
        assert_eq!(question("stop"), None);
        let asked = question("torque --current-a 1").unwrap();
        let sent =
            "Motor 1 will be sent torque (0xA1): current 1 A. This may set a shaft in motion,";
        assert!(asked.starts_with(sent), "{asked}");
        let motion = "motion --position-rad 1 --velocity-rad-s 0 --kp 1 --kd 1 --torque-nm 0";
        let asked = question(motion).unwrap();
        assert!(asked.starts_with("Motor 1 will be sent motion: position 1 rad, "), "{asked}");
    }

    #[test]
    fn command_to_all_is_sent_as_one_frame() {
        let (outcome, packets) = send(&Fleet::new(3), "--id all read-status2");
        assert_eq!(outcome, Ok(()));
        let channel = Channel::Command(Target::All);
        let to_all = packets.iter().filter(|packet| packet.channel == channel);
        assert_eq!(to_all.map(|packet| packet.data[0]).collect::<Vec<_>>(), [0x9C]);
        let (message, _) = failed(&Fleet::new(3), "--id all raw C0 0 0 0 0 0 0 0");
        assert!(
            message.starts_with("no reply from motors 1 2 3: firmware may not know"),
            "{message}"
        );
    }

    #[test]
    fn command_to_all_that_a_cut_bus_dropped_is_not_reported_as_sent() {
        let fleet = Fleet::new(1).on_can(1_000_000).unwrap();
        fleet.world.cut(fleet.drives[0].station());
        let small = ControllerConfig { transmit_queue: 1, ..ControllerConfig::SOCKETCAN };
        let port = fleet.world.port_with(small);
        let master = CanMaster::new(port, fleet.world.clock(), Config::CAN);
        let master = AnyMaster::SimulatedCan(master);
        let mut session = Session::by(master);
        // It fills the controller, so that later frames are refused.
        let _ = session.master.master().request(MotorId::MIN, ReadStatus1).unwrap();
        session.master.poll().unwrap();
        let arguments: Arguments = typed("--id all shutdown");
        let command = arguments.command.command(None).unwrap();
        let explainer = Explainer::new(Firmware::V4_3);
        let sending = Sending { command, explainer, json: false };
        let Err(Unfinished::Failed(message)) = sending.to_all(&mut session, MotorId::MIN.into())
        else {
            panic!("it was not sent");
        };
        let expected = "the bus carried nothing, so the command was dropped: check its wiring, its bit rate and the \
                        motors' power";
        assert_eq!(message, expected);
    }

    #[test]
    fn a_motors_firmware_must_have_the_command() {
        let limits = MotionLimits { torque_nm: 60.0, ..MotionRanges::V4_3.limits() };
        let ranges = MotionRanges::new(limits).unwrap();
        let v4_4 = Fleet::new(2).firmware(Firmware::V4_4).motion_ranges(ranges);
        let (message, _) = failed(&v4_4, "--id 1 read-single-turn-angle");
        assert_eq!(
            message,
            "motor 1 speaks v4.4: v4.4 has no read-single-turn-angle (0x94): take read-single-turn-angle-v4.4"
        );
        let (message, packets) = failed(&v4_4, "bus-id --access read");
        assert_eq!(message, "motor 1 speaks v4.4: v4.4 has no bus-id (0x79)");
        assert!(packets.iter().all(|packet| packet.data[0] != 0x79));
        for id in ["1", "all"] {
            let line = format!("--id {id} read-single-turn-angle-v4.4");
            assert_eq!(send(&v4_4, &line).0, Ok(()));
        }
    }

    #[test]
    fn motion_needs_scales_that_are_known() {
        let motion =
            "--id 1 motion --position-rad 0 --velocity-rad-s 0 --kp 1 --kd 1 --torque-nm 0";
        let unknown = Fleet::new(1).version_date(VersionDate::from_raw(2_025_070_202));
        let (message, packets) = failed(&unknown, motion);
        assert!(
            message.contains("version date 2025070202, which is not that of a known firmware"),
            "{message}"
        );
        let is_motion = |packet: &Packet| packet.channel == Channel::Motion(MotorId::MIN);
        assert!(!packets.iter().any(is_motion));
        for known in ["--firmware v4.3", "--ranges 12.5,45,500,5,24"] {
            let (outcome, packets) = send(&unknown, &format!("{motion} {known}"));
            assert_eq!(outcome, Ok(()));
            assert_eq!(packets.iter().filter(|packet| is_motion(packet)).count(), 1, "{known}");
        }
    }
}

//! What `myactuator send` says of a command: its risk before it is sent, and what has to follow.

use myactuator_protocol_core::command::{
    AbsolutePosition, ActiveReply, AnyCommand, BusId, ForcePosition, FunctionControl,
    IncrementalPosition, SingleTurnPosition, Speed, Switch,
};
use myactuator_protocol_core::opcode::Usage;
use myactuator_protocol_core::units::{MaxSpeed, MaxTorque};
use myactuator_protocol_core::{Kind, Opcode, Target};

use super::session::sets_gains;

/// A command of the table that was given as bytes is that command.
fn known(command: AnyCommand) -> AnyCommand {
    let decoded = |opcode| AnyCommand::decode_as(opcode, &command.encode()).ok();
    match command {
        AnyCommand::Raw(_) => command.kind().opcode().and_then(decoded).unwrap_or(command),
        known => known,
    }
}

/// What may happen, for the question before this command is sent.
pub(super) fn risk(command: AnyCommand) -> String {
    let command = known(command);
    let kind = command.kind();
    let what = match (kind, command) {
        (kind, _) if sets_gains(kind) => {
            "A motor that runs or holds may swing, or let its load go."
        }
        (kind, _) if kind.moves() => {
            "This may set a shaft in motion, which goes on until another command ends it."
        }
        (Kind::Raw { .. }, _) => "What it does is not known here: it may write memory.",
        (_, AnyCommand::BusId(BusId::Write(_))) => "All that are connected take this id.",
        (_, AnyCommand::FunctionControl(FunctionControl::SetCanId(_))) => {
            "Nothing checks whether another motor has this id: 'myactuator id' does."
        }
        (_, AnyCommand::CommunicationLossProtection(it)) if it.timeout.raw() > 0 => {
            "It cuts its output when it hears nothing for that time, also while it holds: a load can fall then."
        }
        (Kind::Known(Opcode::ReleaseBrake), _) => "A load can turn the shaft then.",
        (Kind::Known(Opcode::Reset), _) => "Hold the shaft if a load pulls at it.",
        _ => "This may write memory.",
    };
    let at_rest = match kind.opcode().map(Opcode::usage) {
        Some(Usage::AtRest) => " The manual wants that only while the motor stands.",
        _ => "",
    };
    format!("{}{}{what}{at_rest}", without_torque_limit(command), without_speed_limit(command))
}

/// What a torque limit of 0 means.
fn without_torque_limit(command: AnyCommand) -> &'static str {
    match command {
        AnyCommand::Speed(Speed { max_torque, .. }) if max_torque == MaxTorque::NO_LIMIT => {
            "0 % means no limit of torque. "
        }
        AnyCommand::ForcePosition(ForcePosition { max_torque, .. })
            if max_torque == MaxTorque::NO_LIMIT =>
        {
            "0 % may mean no limit of torque: the manual does not say. "
        }
        _ => "",
    }
}

/// What a speed limit of 0 may mean: by 2.21.1 it is none in direct tracking, and 2.22 to 2.24 say nothing.
fn without_speed_limit(command: AnyCommand) -> &'static str {
    match command {
        AnyCommand::AbsolutePosition(AbsolutePosition { max_speed, .. })
        | AnyCommand::SingleTurnPosition(SingleTurnPosition { max_speed, .. })
        | AnyCommand::IncrementalPosition(IncrementalPosition { max_speed, .. })
        | AnyCommand::ForcePosition(ForcePosition { max_speed, .. })
            if max_speed == MaxSpeed::NO_LIMIT =>
        {
            "0 dps may mean no limit of speed. "
        }
        _ => "",
    }
}

/// What has to follow a command before it takes effect or is kept, and what is different from then on; `None` for most
/// commands. `hint` says how to type a subcommand for these motors.
pub(super) fn follow_up(
    command: AnyCommand,
    target: Target,
    hint: impl Fn(&str) -> String,
) -> Option<String> {
    let command = known(command);
    // `reset` is for one motor.
    let restart = if target == Target::All { "send reset" } else { "reset" };
    let effect = match command {
        AnyCommand::SetEncoderZero(_)
        | AnyCommand::SetCurrentPositionZero(_)
        | AnyCommand::FunctionControl(
            FunctionControl::ClearMultiTurn | FunctionControl::SaveMultiTurn(_),
        ) => Some(format!("this takes effect after a restart: {} (0x76)", hint(restart))),
        // Some answer under the new id from now on, and hear only the old one until then.
        AnyCommand::FunctionControl(FunctionControl::SetCanId(_)) => Some(
            "this takes effect when the motor is powered on again; until then it may answer as another than it hears"
                .to_owned(),
        ),
        AnyCommand::ActiveReply(ActiveReply { enable: Switch::On, .. }) => Some(
            "some drives answer nothing else while they report: 'active-reply' with '--enable off' ends that"
                .to_owned(),
        ),
        AnyCommand::FunctionControl(FunctionControl::CanIdFilter(Switch::On)) => {
            Some("a motor whose filter is on does not hear commands to all (0x280)".to_owned())
        }
        AnyCommand::SetBaudRate(_) => Some(
            "this takes effect when the motor is powered on again, or restarts: it is on this bus only if the bus has \
             that bit rate then; what it answers now may be garbage"
                .to_owned(),
        ),
        _ => None,
    };
    let is_kept = match command {
        AnyCommand::FunctionControl(_)
        | AnyCommand::WritePidRom(_)
        | AnyCommand::SetBaudRate(_) => {
            Some("some drives keep this only if they were shut down (0x80) before".to_owned())
        }
        _ => None,
    };
    let parts: Vec<String> = effect.into_iter().chain(is_kept).collect();
    (!parts.is_empty()).then(|| parts.join("; "))
}

#[cfg(test)]
mod tests {
    use myactuator_protocol_core::MotorId;
    use myactuator_protocol_core::command::MotionRanges;

    use super::super::simulated::typed;
    use super::*;
    use crate::cli::wanted::Wanted;

    #[derive(Debug, clap::Args)]
    struct Line {
        #[command(subcommand)]
        wanted: Wanted,
    }

    fn command(line: &str) -> AnyCommand {
        typed::<Line>(line).wanted.command(Some(&MotionRanges::V4_3)).unwrap()
    }

    #[test]
    fn risk_names_what_may_happen() {
        let moves = "This may set a shaft in motion, which goes on until another command ends it.";
        let motion = "motion --position-rad 1 --velocity-rad-s 0 --kp 1 --kd 1 --torque-nm 0";
        for (line, message) in [
            ("torque --current-a 1", moves),
            (motion, moves),
            ("raw --moves C0 0 0 0 0 0 0 0", moves),
            ("speed --speed-dps 1 --max-torque-pct 1", moves),
            ("raw C0 0 0 0 0 0 0 0", "What it does is not known here: it may write memory."),
            ("bus-id --access write --motor-id 2", "All that are connected take this id."),
            ("raw 79 0 0 0 0 0 0 2", "All that are connected take this id."),
            ("set-baud-rate --baud-rate 1", "This may write memory."),
            (
                "function-control --index set-can-id --value 7",
                "Nothing checks whether another motor has this id: 'myactuator id' does. The manual wants that only \
                 while the motor stands.",
            ),
            (
                "communication-loss-protection --timeout-ms 20",
                "It cuts its output when it hears nothing for that time, also while it holds: a load can fall then. \
                 The manual wants that only while the motor stands.",
            ),
        ] {
            assert_eq!(risk(command(line)), message, "{line}");
        }
    }

    #[test]
    fn risk_says_what_a_limit_of_0_means() {
        let torque = "0 % may mean no limit of torque: the manual does not say. ";
        let speed = "0 dps may mean no limit of speed. ";
        let both = format!("{torque}{speed}This may set a");
        for (line, message) in [
            ("speed --speed-dps 1 --max-torque-pct 0", "0 % means no limit of torque. This may"),
            ("raw A2 0 0 0 64 0 0 0", "0 % means no limit of torque. This may"),
            ("absolute-position --max-speed-dps 0 --angle-deg 1", speed),
            ("incremental-position --max-speed-dps 0 --angle-deg 1", speed),
            ("single-turn-position --max-speed-dps 0 --angle-deg 1 --direction 0", speed),
            ("force-position --max-torque-pct 0 --max-speed-dps 1 --angle-deg 1", torque),
            ("force-position --max-torque-pct 1 --max-speed-dps 0 --angle-deg 1", speed),
            ("force-position --max-torque-pct 0 --max-speed-dps 0 --angle-deg 1", &both),
            ("absolute-position --max-speed-dps 1 --angle-deg 0", "This may set a shaft"),
        ] {
            let said = risk(command(line));
            assert!(said.starts_with(message), "{line}: {said}");
        }
    }

    /// 2.2.1, 2.3.1, 2.5.1, 2.9.1, 2.10.1, 2.31.1 and 2.35.1, but not 2.32.1.
    #[test]
    fn risk_says_that_parameters_are_written_to_a_motor_that_stands() {
        let at_rest = " The manual wants that only while the motor stands.";
        for line in [
            "write-pid-ram --index speed-kp --value 1",
            "write-pid-rom --index speed-kp --value 1",
            "write-acceleration --index 0 --acceleration-dps2 100",
            "set-encoder-zero --offset-pulses 1",
            "set-current-position-zero",
            "communication-loss-protection --timeout-ms 0",
            "function-control --index clear-multi-turn",
        ] {
            let said = risk(command(line));
            let gains = line.starts_with("write-pid");
            let what = if gains {
                "A motor that runs or holds may swing"
            } else {
                "This may write memory."
            };
            assert!(said.starts_with(what) && said.ends_with(at_rest), "{line}: {said}");
        }
        assert!(!risk(command("set-baud-rate --baud-rate 1")).contains(at_rest));
        assert!(!risk(command("torque --current-a 1")).contains(at_rest));
    }

    /// What follows this command to motor 1, in words.
    fn after(line: &str) -> String {
        let hint = |subcommand: &str| format!("'{subcommand}'");
        follow_up(command(line), MotorId::MIN.into(), hint).unwrap_or_default()
    }

    #[test]
    fn zeros_and_some_functions_take_effect_after_a_restart() {
        let restart = "this takes effect after a restart: 'reset' (0x76)";
        for line in ["set-encoder-zero --offset-pulses 1", "set-current-position-zero"] {
            assert_eq!(after(line), restart, "{line}");
        }
        for line in ["clear-multi-turn", "save-multi-turn --value on"] {
            let said = after(&format!("function-control --index {line}"));
            assert!(said.starts_with(restart), "{line}: {said}");
        }
        for line in ["error-reporting --value on", "max-positive-angle --value 7"] {
            let said = after(&format!("function-control --index {line}"));
            assert!(!said.contains("restart"), "{line}: {said}");
        }
        let said = after("function-control --index set-can-id --value 7");
        assert!(
            said.starts_with("this takes effect when the motor is powered on again;"),
            "{said}"
        );
        let by_send = "this takes effect after a restart: 'send reset' (0x76)";
        let hint = |subcommand: &str| format!("'{subcommand}'");
        let to_all = follow_up(command("set-current-position-zero"), Target::All, hint);
        assert_eq!(to_all.as_deref(), Some(by_send));
    }

    #[test]
    fn bit_rate_takes_effect_at_the_next_power_on() {
        let said = after("set-baud-rate --baud-rate 1");
        assert!(said.starts_with("this takes effect when the motor is powered on again"), "{said}");
        assert!(said.contains("what it answers now may be garbage"), "{said}");
    }

    #[test]
    fn motor_with_its_filter_on_does_not_hear_commands_to_all() {
        let deaf = "a motor whose filter is on does not hear commands to all (0x280)";
        assert!(after("function-control --index can-id-filter --value on").starts_with(deaf));
        assert!(after("raw 20 2 0 0 1 0 0 0").starts_with(deaf));
        assert!(!after("function-control --index can-id-filter --value off").contains("0x280"));
    }

    #[test]
    fn some_drives_keep_writes_only_while_they_are_shut_down() {
        let keeps = "some drives keep this only if they were shut down (0x80) before";
        for line in [
            "function-control --index error-reporting --value on",
            "function-control --index clear-multi-turn",
            "write-pid-rom --index speed-kp --value 1",
            "set-baud-rate --baud-rate 1",
        ] {
            assert!(after(line).ends_with(keeps), "{line}: {}", after(line));
        }
        for line in ["write-pid-ram --index speed-kp --value 1", "stop", "raw C0 0 0 0 0 0 0 0"] {
            assert_eq!(after(line), "", "{line}");
        }
    }
}

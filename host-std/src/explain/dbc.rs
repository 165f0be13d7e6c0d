//! The table of commands as a DBC file, which tools of other makers read: [`Dbc`].

use std::fmt::{self, Write as _};
use std::ops::RangeInclusive;

use myactuator_protocol_core::command::{Field, MotionRanges, When};
use myactuator_protocol_core::quantity::{Form, Place, Quantity, Steps};
use myactuator_protocol_core::wire::can::identifier;
use myactuator_protocol_core::{Channel, Firmware, Kind, MotorId, Opcode, Target};

/// What is on a CAN bus, as a DBC file: its `Display` is the file, made from the table of commands.
///
/// | message | identifier | carries |
/// |---|---|---|
/// | `motor_1_command` … `motor_32_command` | 0x140 + id | commands to one motor |
/// | `motor_1_reply` … | 0x240 + id | its replies, asked for or reported |
/// | `motor_1_motion_command` … | 0x400 + id | motion mode |
/// | `motor_1_motion_reply` … | 0x500 + id | its replies |
/// | `all_motors_command` | 0x280 | commands to all motors |
/// | `bus_id` | 0x300 | bus id, both ways |
///
/// The signal `command_byte` says which command a message is, and selects its other signals (it multiplexes them).
/// Messages of motion mode have none. If a field's meaning depends on the value of another one, that one selects again.
/// Such messages need a reader of extended multiplexing (`SG_MUL_VAL_`).
///
/// A signal's name has its command, then the value that selects it (`other` for all values without a name), then its
/// [`Field::key`], which ends in the unit: `absolute_position_angle_deg`, `function_control_can_id_filter_value`.
/// Characters of a text are numbered from 1: `read_model_model_1`. A motion value without a known scale is a step:
/// `motion_position_raw`. Some names have more than 32 characters, and the oldest readers truncate these.
///
/// Names of codes are value tables, meanings are comments. The text is ASCII, so its encoding does not matter: units
/// are `degC` and `N.m` instead of °C and N·m.
///
/// At 0x300 a command cannot be distinguished from its reply, so it shows the reply's signals, too. If a drive reports
/// a bare bus id and not a reply identifier (4.3), it is shown as a negative number.
///
/// ```
/// use myactuator_host_std::explain::Dbc;
/// use myactuator_host_std::protocol::{Firmware, MotorId};
///
/// let file = Dbc { motor: Some(MotorId::new(3)?), ..Dbc::new(Firmware::V4_3) }.to_string();
/// // 0x143 = 323 and 0xA4 = 164: a set-point's angle, 0.01 deg a step in the last four bytes.
/// assert!(file.contains("BO_ 323 motor_3_command: 8 master"));
/// assert!(file.contains(
///     "SG_ absolute_position_angle_deg m164 : 32|32@1- (0.01,0) [-21474836.48|21474836.47] \"deg\" motor_3"
/// ));
/// # Ok::<(), myactuator_host_std::protocol::OutOfRange>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dbc {
    /// Which revision of the protocol the motors speak.
    pub firmware: Firmware,
    /// The scales of their motion mode; without them its values are steps.
    pub ranges: Option<MotionRanges>,
    /// The only motor; without it, all 32.
    pub motor: Option<MotorId>,
}

impl Dbc {
    /// For all motors of this firmware, with its own scales where it has them.
    pub const fn new(firmware: Firmware) -> Self {
        Self { firmware, ranges: firmware.motion_ranges(), motor: None }
    }

    fn motors(&self) -> impl Iterator<Item = MotorId> {
        let only = self.motor;
        MotorId::all().filter(move |id| only.is_none_or(|only| only == *id))
    }

    fn messages(&self) -> Vec<Message> {
        let of_one = |id: MotorId| {
            let commands = [Channel::Command(id.into()), Channel::Motion(id)];
            let replies = [Channel::Reply(id), Channel::MotionReply(id)];
            commands.into_iter().chain(replies)
        };
        let of_any = [Channel::Command(Target::All), Channel::BusId];
        let channels = self.motors().flat_map(of_one).chain(of_any);
        channels.filter_map(|channel| self.message(channel)).collect()
    }

    /// The message of a channel; `None` if there is none.
    fn message(&self, channel: Channel) -> Option<Message> {
        let mut signals = Vec::new();
        let mut kinds = Vec::new();
        for &opcode in Opcode::ALL.iter().filter(|opcode| opcode.is_in(self.firmware)) {
            if let Some(fields) = fields(opcode, channel) {
                kinds.extend(opcode.byte().map(|byte| (byte.into(), opcode.name())));
                let each = fields.iter();
                signals
                    .extend(each.flat_map(|field| self.signals(opcode, channel, field, &fields)));
            }
        }
        if !kinds.is_empty() {
            signals.insert(0, command_byte(kinds));
        }
        (!signals.is_empty()).then_some(Message { channel, signals })
    }

    /// A field as its signals: a text has one for each character, all others have one.
    fn signals(
        &self,
        opcode: Opcode,
        channel: Channel,
        field: &Field,
        fields: &[&Field],
    ) -> Vec<Signal> {
        let Field { name, quantity, place, when, .. } = *field;
        let condition = Condition::of(when, opcode, fields);
        let key = match quantity.form {
            Form::Motion(_) if self.ranges.is_none() => format!("{name}_raw"),
            _ => field.key().to_string(),
        };
        let signal = |key: &str, place: Place| Signal {
            name: signal_name(opcode, condition.as_ref().map_or("", |of| of.word), key),
            condition: condition.clone(),
            selects: fields.iter().any(|other| selector(other.when) == Some(place)),
            place,
            values: Values::of(quantity, place, self.ranges.as_ref()),
            comment: comment(opcode, channel, field),
        };
        match (quantity.form, place) {
            (Form::Text, Place::Bytes { first, count }) => (0..count)
                .map(|character| {
                    let place = Place::Bytes { first: first + character, count: 1 };
                    signal(&format!("{key}_{}", character + 1), place)
                })
                .collect(),
            _ => vec![signal(&key, place)],
        }
    }
}

impl fmt::Display for Dbc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "VERSION \"{}\"\n", self.firmware)?;
        writeln!(f, "NS_ :\n\tCM_\n\tVAL_\n\tSIG_VALTYPE_\n\tSG_MUL_VAL_\n\nBS_:\n")?;
        write!(f, "BU_: master")?;
        self.motors().try_for_each(|id| write!(f, " motor_{id}"))?;
        writeln!(f, "\n")?;
        let mut sections = [const { String::new() }; 5];
        self.messages().iter().try_for_each(|message| message.write(&mut sections))?;
        f.write_str(&sections.concat())
    }
}

/// The fields of a kind on a channel; `None` if it does not occur there.
fn fields(opcode: Opcode, channel: Channel) -> Option<Vec<&'static Field>> {
    let (command, target) = match channel {
        Channel::Command(target) => (channel, target),
        Channel::Reply(id) => (Channel::Command(id.into()), id.into()),
        Channel::Motion(id) | Channel::MotionReply(id) => (Channel::Motion(id), id.into()),
        Channel::BusId => (channel, Target::All),
    };
    if Kind::from(opcode).channel_to(target) != Ok(command) {
        return None;
    }
    let both_ways = channel == Channel::BusId;
    let is_reply = command != channel;
    if is_reply && !opcode.has_reply() {
        return None;
    }
    let mut fields: Vec<&Field> = Vec::new();
    if !is_reply {
        fields.extend(opcode.command_fields());
    }
    for field in opcode.reply_fields().iter().filter(|_| is_reply || both_ways) {
        if !fields.contains(&field) {
            fields.push(field);
        }
    }
    Some(fields)
}

/// What a field means, and what its command does.
fn comment(opcode: Opcode, channel: Channel, field: &Field) -> String {
    let mut comment = field.meaning.to_owned();
    if let Form::Flags(_) = field.quantity.form {
        comment += " One bit for each; several may be set.";
    }
    if channel == Channel::BusId && !opcode.command_fields().contains(field) {
        comment += " In replies only.";
    }
    format!("{comment} {} Manual {}.", opcode.meaning(), opcode.section())
}

/// The position of the byte that decides whether a field is there.
const fn selector(when: When) -> Option<Place> {
    match when {
        When::Always => None,
        When::Byte(at, _) | When::NoneOf(at, _) => Some(Place::Bytes { first: at, count: 1 }),
    }
}

const COMMAND_BYTE: &str = "command_byte";

fn command_byte(kinds: Vec<(u16, &'static str)>) -> Signal {
    Signal {
        name: COMMAND_BYTE.to_owned(),
        condition: None,
        selects: true,
        place: Place::Bytes { first: 0, count: 1 },
        values: Values { names: kinds, ..Values::whole(0xFF) },
        comment: "Which command it is.".to_owned(),
    }
}

/// The name of a signal from its command, the value that selects it (or nothing), and its key.
fn signal_name(opcode: Opcode, word: &str, key: &str) -> String {
    let words = [opcode.name(), word, key].into_iter().filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("_").replace(['-', '.'], "_")
}

/// When a signal is there.
#[derive(Clone)]
struct Condition {
    /// The signal that selects it.
    selector: String,
    /// The values that select.
    values: Vec<RangeInclusive<u8>>,
    /// The name of these values; empty for a command byte.
    word: &'static str,
}

impl Condition {
    fn of(when: When, opcode: Opcode, fields: &[&Field]) -> Option<Self> {
        let selecting = fields.iter().find(|field| Some(field.place) == selector(when));
        let Some(selecting) = selecting else {
            let byte = opcode.byte()?;
            let selector = COMMAND_BYTE.to_owned();
            return Some(Self { selector, values: vec![byte..=byte], word: "" });
        };
        let (values, word) = match when {
            When::Byte(_, code) => {
                let name = selecting.quantity.name_of(code.into());
                (vec![code..=code], name.unwrap_or(OTHER))
            }
            When::NoneOf(_, codes) => (all_but(codes), OTHER),
            When::Always => return None,
        };
        let selector = signal_name(opcode, "", &selecting.key().to_string());
        Some(Self { selector, values, word })
    }
}

/// The name of values without a name.
const OTHER: &str = "other";

/// All other bytes, in as few ranges as possible.
fn all_but(codes: &[u8]) -> Vec<RangeInclusive<u8>> {
    let mut ranges: Vec<RangeInclusive<u8>> = Vec::new();
    for byte in (0..=u8::MAX).filter(|byte| !codes.contains(byte)) {
        match ranges.last_mut() {
            Some(range) if range.end().checked_add(1) == Some(byte) => {
                *range = *range.start()..=byte
            }
            _ => ranges.push(byte..=byte),
        }
    }
    ranges
}

/// What the numbers of a signal mean.
struct Values {
    /// `'+'` or, with a sign, `'-'`.
    sign: char,
    is_float: bool,
    factor: f64,
    offset: f64,
    /// The smallest and largest amount; twice 0 for no limits.
    ends: (f64, f64),
    unit: &'static str,
    names: Vec<(u16, &'static str)>,
}

impl Values {
    /// A whole number from 0.
    const fn whole(max: u64) -> Self {
        Self {
            sign: '+',
            is_float: false,
            factor: 1.0,
            offset: 0.0,
            ends: (0.0, max as f64),
            unit: "",
            names: Vec::new(),
        }
    }

    fn of(quantity: &Quantity, place: Place, ranges: Option<&MotionRanges>) -> Self {
        let last = u64::MAX >> (64 - place.bits());
        let whole = Self { unit: quantity.unit.symbol(), ..Self::whole(last) };
        match quantity.form {
            Form::Steps(Steps { min, max, zero, .. }) => {
                let low = if zero.is_some() { min.min(0) } else { min };
                Self {
                    sign: if min < 0 { '-' } else { '+' },
                    factor: quantity.amount(1),
                    ends: (quantity.amount(low), quantity.amount(max)),
                    ..whole
                }
            }
            Form::Float => Self { sign: '-', is_float: true, ends: (0.0, 0.0), ..whole },
            Form::Code(names) | Form::Flags(names) => {
                Self { names: names.iter().map(|name| (name.raw, name.name)).collect(), ..whole }
            }
            Form::Switch => Self { ends: (0.0, 1.0), names: vec![(0, "off"), (1, "on")], ..whole },
            Form::ReplyIdentifier => {
                let first = MotorId::MIN;
                let base = identifier(Channel::Reply(first)) - u16::from(first.get());
                Self { offset: -f64::from(base), ends: (1.0, MotorId::COUNT as f64), ..whole }
            }
            Form::Motion(scale) => match ranges {
                Some(ranges) => {
                    let (low, high) = (ranges.value(scale, 0), ranges.value(scale, last as u16));
                    Self {
                        factor: (high - low) / last as f64,
                        offset: low,
                        ends: (low, high),
                        ..whole
                    }
                }
                None => Self { unit: "", ..whole },
            },
            _ => whole,
        }
    }
}

struct Signal {
    name: String,
    condition: Option<Condition>,
    /// Whether other signals are there for some of its values only.
    selects: bool,
    place: Place,
    values: Values,
    comment: String,
}

impl Signal {
    fn write_layout(&self, f: &mut String, receiver: &str) -> fmt::Result {
        write!(f, " SG_ {}", self.name)?;
        let first = self.condition.as_ref().and_then(|condition| condition.values.first());
        match (first, self.selects) {
            (None, false) => {}
            (None, true) => f.write_str(" M")?,
            (Some(values), false) => write!(f, " m{}", values.start())?,
            (Some(values), true) => write!(f, " m{}M", values.start())?,
        }
        // A DBC file counts bits from the lowest of the first byte up. It names the lowest bit of a little-endian
        // signal, and the highest of a big-endian one.
        let (start, order) = match self.place {
            Place::Bytes { first, .. } => (first * 8, 1),
            Place::Bits { first, .. } => (first / 8 * 8 + 7 - first % 8, 0),
        };
        let Values { sign, factor, offset, ends: (low, high), unit, .. } = self.values;
        let (bits, unit) = (self.place.bits(), ascii(unit));
        writeln!(
            f,
            " : {start}|{bits}@{order}{sign} ({factor},{offset}) [{low}|{high}] \"{unit}\" {receiver}"
        )
    }
}

struct Message {
    channel: Channel,
    /// If one signal selects the others, it comes first.
    signals: Vec<Signal>,
}

impl Message {
    /// Writes this message's part of each section of the file.
    fn write(
        &self,
        [layouts, comments, names, floats, selections]: &mut [String; 5],
    ) -> fmt::Result {
        const NOBODY_IN_PARTICULAR: &str = "Vector__XXX";
        let master = || "master".to_owned();
        let nobody = || NOBODY_IN_PARTICULAR.to_owned();
        let motor = |id: MotorId| format!("motor_{id}");
        let (message, sender, receiver) = match self.channel {
            Channel::Command(Target::All) => ("all_motors_command".to_owned(), master(), nobody()),
            Channel::Command(Target::Motor(id)) => {
                (format!("motor_{id}_command"), master(), motor(id))
            }
            Channel::Reply(id) => (format!("motor_{id}_reply"), motor(id), master()),
            Channel::BusId => ("bus_id".to_owned(), nobody(), nobody()),
            Channel::Motion(id) => (format!("motor_{id}_motion_command"), master(), motor(id)),
            Channel::MotionReply(id) => (format!("motor_{id}_motion_reply"), motor(id), master()),
        };
        let id = identifier(self.channel);
        writeln!(layouts, "BO_ {id} {message}: 8 {sender}")?;
        writeln!(comments, "CM_ BO_ {id} \"{}\";", self.channel)?;
        // If several signals select, each signal has to name the one that selects it.
        let several_select = self.signals.iter().filter(|signal| signal.selects).count() > 1;
        for signal in &self.signals {
            signal.write_layout(layouts, &receiver)?;
            let Signal { name, condition, values, comment, .. } = signal;
            writeln!(comments, "CM_ SG_ {id} {name} \"{}\";", ascii(comment))?;
            if !values.names.is_empty() {
                let each = values.names.iter().map(|(value, name)| format!(" {value} \"{name}\""));
                writeln!(names, "VAL_ {id} {name}{} ;", each.collect::<String>())?;
            }
            if values.is_float {
                writeln!(floats, "SIG_VALTYPE_ {id} {name} : 1;")?;
            }
            if let Some(Condition { selector, values, .. }) = condition
                && several_select
            {
                let each = values.iter().map(|range| format!("{}-{}", range.start(), range.end()));
                let ranges = each.collect::<Vec<_>>().join(", ");
                writeln!(selections, "SG_MUL_VAL_ {id} {name} {selector} {ranges};")?;
            }
        }
        writeln!(layouts)
    }
}

/// Text that is the same in every encoding that a reader may expect, and that does not end a string.
fn ascii(text: &str) -> String {
    let text = text.replace('°', "deg").replace('·', ".").replace('"', "'");
    text.replace(|other: char| !other.is_ascii(), "?")
}

#[cfg(test)]
mod tests {
    use super::*;
    use myactuator_protocol_core::command::MotionLimits;

    fn of_motor(id: u8, firmware: Firmware) -> String {
        Dbc { motor: MotorId::new(id).ok(), ..Dbc::new(firmware) }.to_string()
    }

    /// The lines of a message, from its head to the empty line behind its signals.
    fn message<'a>(file: &'a str, head: &str) -> Vec<&'a str> {
        let mut lines = file.lines().skip_while(|line| *line != head);
        assert_eq!(lines.next(), Some(head));
        lines.take_while(|line| !line.is_empty()).collect()
    }

    fn assert_line(file: &str, expected: &str) {
        assert!(file.lines().any(|line| line == expected), "no line is {expected}");
    }

    /// The name of a signal, and what stands between it and the colon.
    fn signal(line: &str) -> (&str, &str) {
        let rest = line.strip_prefix(" SG_ ").unwrap();
        let (head, _) = rest.split_once(" :").unwrap();
        head.split_once(' ').unwrap_or((head, ""))
    }

    #[test]
    fn motion_mode_is_big_endian() {
        // A DBC file numbers bits 7..0 in byte 0, 15..8 in byte 1, and so on; a big-endian signal starts
        // at its highest. 5.2: position is bytes 0 and 1 (7); velocity byte 2 (23) and the upper half of
        // byte 3; kp the lower half of byte 3 (24 + 3) and byte 4; kd byte 5 (47) and the upper half of
        // byte 6; torque the lower half of byte 6 (48 + 3) and byte 7.
        // 25/65535, 90/4095, 500/4095, 5/4095 and 48/4095 a step.
        let file = of_motor(1, Firmware::V4_3);
        assert_eq!(
            message(&file, "BO_ 1025 motor_1_motion_command: 8 master"),
            [
                r#" SG_ motion_position_rad : 7|16@0+ (0.00038147554741741054,-12.5) [-12.5|12.5] "rad" motor_1"#,
                r#" SG_ motion_velocity_rad_s : 23|12@0+ (0.02197802197802198,-45) [-45|45] "rad/s" motor_1"#,
                r#" SG_ motion_kp : 27|12@0+ (0.1221001221001221,0) [0|500] "N.m/rad" motor_1"#,
                r#" SG_ motion_kd : 47|12@0+ (0.001221001221001221,0) [0|5] "N.m.s/rad" motor_1"#,
                r#" SG_ motion_torque_nm : 51|12@0+ (0.011721611721611722,-24) [-24|24] "N.m" motor_1"#,
            ]
        );
        // 5.3: one byte further on, and torque in the lower half of byte 4 (32 + 3) and byte 5.
        let reply = message(&file, "BO_ 1281 motor_1_motion_reply: 8 motor_1");
        let starts: Vec<_> =
            reply.iter().map(|line| line.split(['|', ' ']).nth(4).unwrap()).collect();
        assert_eq!(starts, ["0", "15", "31", "35"]);
    }

    /// By 2.21.1 no limit, but in direct tracking only; 2.22 to 2.24 say nothing of it.
    #[test]
    fn comment_says_what_a_0_does_in_that_command() {
        let file = of_motor(1, Firmware::V4_3);
        let comment = |id: u16, signal: &str| {
            let head = format!("CM_ SG_ {id} {signal} ");
            file.lines().find_map(|line| line.strip_prefix(&head)).unwrap().to_owned()
        };
        let unknown = "\"The fastest turning on the way. The manual does not say what 0 does. Go ";
        for of in ["single_turn", "incremental", "force"] {
            let said = comment(321, &format!("{of}_position_max_speed_dps"));
            assert!(said.starts_with(unknown), "{said}");
        }
        let said = comment(321, "absolute_position_max_speed_dps");
        assert!(said.contains("0 sets no limit in direct tracking (acceleration 0)"), "{said}");
        // 2.29 and 2.31: the same type, in milliseconds.
        assert!(comment(577, "read_run_time_run_time_ms").starts_with("\"The time. Read how long"));
        let said = comment(321, "communication_loss_protection_timeout_ms");
        assert!(
            said.starts_with("\"The longest silence; 0 switches the protection off. Set"),
            "{said}"
        );
    }

    #[test]
    fn motion_mode_has_the_scale_that_was_given_or_none() {
        let limits = MotionLimits { torque_nm: 60.0, ..MotionRanges::V4_3.limits() };
        let ranges = MotionRanges::new(limits).ok();
        let file = Dbc { ranges, ..Dbc::new(Firmware::V4_4) }.to_string();
        // 120/4095 a step.
        assert_line(
            &file,
            r#" SG_ motion_torque_nm : 51|12@0+ (0.029304029304029304,-60) [-60|60] "N.m" motor_1"#,
        );
        let file = Dbc::new(Firmware::V4_4).to_string();
        assert_line(&file, r#" SG_ motion_torque_raw : 51|12@0+ (1,0) [0|4095] "" motor_1"#);
    }

    #[test]
    fn fields_are_selected_by_the_command_byte() {
        let file = of_motor(2, Firmware::V4_3);
        for line in [
            // 2.14: 0x9A = 154 at 0x242 = 578. Voltage is bytes 4 and 5 in 0.1 V, errors bytes 6 and 7.
            r#" SG_ command_byte M : 0|8@1+ (1,0) [0|255] "" master"#,
            r#" SG_ read_status1_temperature_c m154 : 8|8@1- (1,0) [-128|127] "degC" master"#,
            r#" SG_ read_status1_voltage_v m154 : 32|16@1+ (0.1,0) [0|6553.5] "V" master"#,
            r#" SG_ read_status1_errors m154 : 48|16@1+ (1,0) [0|65535] "" master"#,
            "VAL_ 578 read_status1_brake 0 \"lock\" 1 \"release\" ;",
            // 2.34: 0xB6 = 182 at 0x142 = 322, the interval in 10 ms.
            r#" SG_ active_reply_interval_ms m182 : 24|16@1+ (10,0) [0|655350] "ms" motor_2"#,
            "VAL_ 322 active_reply_enable 0 \"off\" 1 \"on\" ;",
            // 2.1: a float.
            r#" SG_ read_pid_value m48 : 32|32@1- (1,0) [0|0] "" master"#,
            "SIG_VALTYPE_ 578 read_pid_value : 1;",
            // 2.33: seven characters.
            r#" SG_ read_model_model_1 m181 : 8|8@1+ (1,0) [0|255] "" master"#,
            r#" SG_ read_model_model_7 m181 : 56|8@1+ (1,0) [0|255] "" master"#,
            r#"CM_ SG_ 322 active_reply_interval_ms "How often. Have a reply sent by itself at an interval. Manual 2.34.";"#,
        ] {
            assert_line(&file, line);
        }
    }

    #[test]
    fn fields_that_depend_on_another_are_selected_by_that() {
        let file = of_motor(1, Firmware::V4_3);
        for line in [
            // 2.35: 0x20 = 32, the index in byte 1, the value in the last four; 5 is a new id.
            r#" SG_ function_control_index m32M : 8|8@1+ (1,0) [0|255] "" motor_1"#,
            r#" SG_ function_control_set_can_id_value m5 : 32|32@1+ (1,0) [1|32] "" motor_1"#,
            "SG_MUL_VAL_ 321 function_control_index command_byte 32-32;",
            "SG_MUL_VAL_ 321 function_control_set_can_id_value function_control_index 5-5;",
            "SG_MUL_VAL_ 321 function_control_other_value function_control_index 0-0, 8-255;",
            // 4: 0x79 = 121 at 0x300 = 768, read or write in byte 2; what is read is 0x240 + id.
            r#" SG_ bus_id_access m121M : 16|8@1+ (1,0) [0|255] "" Vector__XXX"#,
            r#" SG_ bus_id_write_motor_id m0 : 56|8@1+ (1,0) [1|32] "" Vector__XXX"#,
            r#" SG_ bus_id_read_motor_id m1 : 48|16@1+ (1,-576) [1|32] "" Vector__XXX"#,
            "SG_MUL_VAL_ 768 bus_id_read_motor_id bus_id_access 1-1;",
        ] {
            assert_line(&file, line);
        }
        assert_eq!(all_but(&[0, 1, 255]), [2..=254]);
        assert_eq!(all_but(&[3, 5]), [0..=2, 4..=4, 6..=255]);
    }

    #[test]
    fn a_file_is_for_all_motors_or_for_one() {
        let ids = |file: &str| -> Vec<u16> {
            let heads = file.lines().filter_map(|line| line.strip_prefix("BO_ "));
            heads.map(|head| head.split(' ').next().unwrap().parse().unwrap()).collect()
        };
        let one = of_motor(3, Firmware::V4_3);
        assert_eq!(ids(&one), [0x143, 0x403, 0x243, 0x503, 0x280, 0x300]);
        assert_line(&one, "BU_: master motor_3");
        let all = ids(&Dbc::new(Firmware::V4_3).to_string());
        assert_eq!(all.len(), 32 * 4 + 2);
        assert!([0x141, 0x160, 0x260, 0x420, 0x520].iter().all(|id| all.contains(id)), "{all:?}");
        // V4.4 has no 0x79.
        assert!(!ids(&of_motor(3, Firmware::V4_4)).contains(&0x300));
    }

    #[test]
    fn every_command_and_reply_field_is_in_the_dbc_file() {
        for &firmware in Firmware::ALL {
            let file = of_motor(1, firmware);
            assert!(file.is_ascii());
            let kinds = |id: u16| {
                let start = format!("VAL_ {id} {COMMAND_BYTE} ");
                file.lines().find_map(|line| line.strip_prefix(&start)).unwrap_or_default()
            };
            for opcode in Opcode::ALL {
                let Some(byte) = opcode.byte() else { continue };
                let kind = format!("{byte} \"{}\" ", opcode.name());
                let has = opcode.is_in(firmware);
                let at = |id| kinds(id).contains(&kind);
                if *opcode == Opcode::BusId {
                    assert_eq!((at(0x300), at(0x141)), (has, false));
                } else {
                    assert_eq!((at(0x141), at(0x280)), (has, has), "{opcode}");
                    assert_eq!(at(0x241), has && opcode.has_reply(), "{opcode}");
                }
            }
            // Fields, of which those of a text are seven.
            let fields = |opcode: Opcode| {
                let fields = opcode.reply_fields().iter();
                fields
                    .map(|field| if field.quantity.form == Form::Text { 7 } else { 1 })
                    .sum::<usize>()
            };
            let answered = Opcode::ALL.iter().filter(|opcode| {
                opcode.is_in(firmware)
                    && opcode.has_reply()
                    && Kind::from(**opcode).channel_to(MotorId::MIN.into())
                        == Ok(Channel::Command(MotorId::MIN.into()))
            });
            let signals = message(&file, "BO_ 577 motor_1_reply: 8 motor_1");
            assert_eq!(signals.len(), 1 + answered.map(|opcode| fields(*opcode)).sum::<usize>());
        }
    }

    #[test]
    fn names_are_unique_and_every_signal_is_selected_once() {
        for &firmware in Firmware::ALL {
            let file = of_motor(1, firmware);
            for head in file.lines().filter(|line| line.starts_with("BO_ ")) {
                let id = head.split(' ').nth(1).unwrap();
                let signals: Vec<_> = message(&file, head).into_iter().map(signal).collect();
                let mut names: Vec<&str> = signals.iter().map(|(name, _)| *name).collect();
                names.sort_unstable();
                names.dedup();
                assert_eq!(names.len(), signals.len(), "{head}");
                let selectors: Vec<&str> = signals
                    .iter()
                    .filter(|(_, mark)| mark.ends_with('M'))
                    .map(|(name, _)| *name)
                    .collect();
                for (name, _) in signals.iter().filter(|(_, mark)| mark.starts_with('m')) {
                    let start = format!("SG_MUL_VAL_ {id} {name} ");
                    let selections: Vec<&str> =
                        file.lines().filter_map(|line| line.strip_prefix(&start)).collect();
                    assert_eq!(selections.len(), 1, "{name}");
                    let selector = selections[0].split(' ').next().unwrap();
                    assert!(selectors.contains(&selector), "{name}: {selector}");
                }
                let is_motion = head.contains("motion");
                assert_eq!(selectors.is_empty(), is_motion, "{head}");
            }
        }
    }
}

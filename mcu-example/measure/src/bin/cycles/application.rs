//! The whole application: one of its 1 kHz cycles with eight motors in motion mode.

use cortex_m_semihosting::hprintln;
use myactuator_mcu_example::{
    App, Board, Moment, Movement, Report, RestartCause, Setup, StateName, Usage,
};
use myactuator_protocol_core::command::MotionRanges;
use myactuator_protocol_core::firmware::Firmware;
use myactuator_protocol_core::master::{Config, Master};
use myactuator_protocol_core::time::{Duration, Instant};
use myactuator_protocol_core::wire::can::Received;
use myactuator_protocol_core::{Channel, Data, Packet, Target};

use crate::counter::instructions;
use crate::table::{Limit, Table};

/// A small microcontroller of the kind that this is for.
const CORE_HZ: u32 = 168_000_000;
/// Cycles that an instruction takes on a Cortex-M4F running from flash with an accelerator, in tenths:
/// loads, jumps and wait states together. An estimate on the safe side, not measured here.
const TENTHS_OF_CYCLES_AN_INSTRUCTION: u32 = 15;
const CYCLES_A_SECOND: u32 = 1_000;
/// What a cycle costs today, in instructions: on average, and at worst.
const CEILINGS: [u32; 2] = [14_570, 15_870];

const CYCLES: u32 = 300;

/// A board that remembers whether the motors run.
#[derive(Default)]
struct Panel {
    is_button_down: bool,
    state: Option<StateName>,
}

impl Board for Panel {
    fn is_button_down(&mut self) -> bool {
        self.is_button_down
    }
    fn set_light(&mut self, _: bool) {}
    fn feed_watchdog(&mut self) {}
    fn log(&mut self, report: &Report) {
        match report {
            Report::State(state) => self.state = Some(*state),
            Report::Trouble(trouble) => panic!("{trouble:?}"),
            _ => {}
        }
    }
    fn usage(&mut self) -> Usage {
        Usage::default()
    }
}

/// What a drive at rest answers.
fn answer(command: &Packet, now: Instant) -> Option<Packet> {
    let data = command.data;
    let put = |value: u32| -> Data {
        let [a, b, c, d] = value.to_le_bytes();
        [data[0], 0, 0, 0, a, b, c, d]
    };
    let (channel, data) = match command.channel {
        Channel::Motion(motor) => {
            let data = [motor.get(), 0x80, 0x00, 0x80, 0x08, 0x00, 0, 0];
            (Channel::MotionReply(motor), data)
        }
        Channel::Command(Target::Motor(motor)) if motor.get() <= 8 => {
            let data = match data[0] {
                0xB1 => put(now.as_micros() as u32 / 1_000),
                0xB2 => put(Firmware::V4_3.version_dates()[0].raw()),
                0x92 | 0x9A => put(0),
                _ => data,
            };
            (Channel::Reply(motor), data)
        }
        _ => return None,
    };
    Some(Packet { channel, data })
}

struct Firm {
    app: App<8>,
    master: Master<8>,
    board: Panel,
    now: Instant,
}

impl Firm {
    fn start() -> Self {
        let (mut master, mut board, now) =
            (Master::new(Config::CAN), Panel::default(), Instant::ZERO);
        let movement = Movement::Motion { ranges: MotionRanges::V4_3, kp: 50.0, kd: 2.0 };
        let at = &mut Moment { master: &mut master, now, board: &mut board };
        let app = App::start(Setup::new(movement), RestartCause::Power, at);
        Self { app, master, board, now }
    }

    /// One cycle: sends what there is, takes the answers half a millisecond later.
    fn cycle(&mut self) {
        let Self { app, master, board, now } = self;
        let mut answers = heapless::Vec::<Packet, 16>::new();
        while let Some(packet) = master.poll_transmit(*now) {
            master.handle_transmitted(*now);
            if let Some(answer) = answer(&packet, *now) {
                let _ = answers.push(answer);
            }
        }
        *now += Duration::from_micros(500);
        for answer in &answers {
            if let Some(event) = master.handle_frame(&Received::Packet(*answer), *now) {
                app.handle_event(&event, &mut Moment { master, now: *now, board });
            }
        }
        master.handle_timeout(*now);
        while let Some(event) = master.poll_event() {
            app.handle_event(&event, &mut Moment { master, now: *now, board });
        }
        *now = app.next_cycle();
        app.begin_cycle(&mut Moment { master, now: *now, board });
    }
}

pub(crate) fn measure(table: &mut Table) {
    let mut firm = Firm::start();
    (0..1_500).for_each(|_| firm.cycle());
    firm.board.is_button_down = true;
    (0..50).for_each(|_| firm.cycle());
    firm.board.is_button_down = false;
    (0..2_000).for_each(|_| firm.cycle());
    assert_eq!(firm.board.state, Some(StateName::Running));

    let mut worst = 0;
    let mut sum = 0;
    for _ in 0..CYCLES {
        let spent = instructions(|| firm.cycle());
        worst = worst.max(spent);
        sum += spent;
    }
    let per_mille = |spent: u32| {
        let a_second = u64::from(spent) * u64::from(CYCLES_A_SECOND);
        (a_second * u64::from(TENTHS_OF_CYCLES_AN_INSTRUCTION) * 100 / u64::from(CORE_HZ)) as u32
    };
    table.head("1 kHz cycle of the application, 8 motors");
    let mean = sum / CYCLES;
    table.row("instructions, on average", mean, Limit::Budget(CEILINGS[0]));
    table.row("instructions, at worst", worst, Limit::Budget(CEILINGS[1]));
    let share = per_mille(mean);
    hprintln!(
        "of a core of {} MHz, at {}.{} cycles an instruction: {}.{} %",
        CORE_HZ / 1_000_000,
        TENTHS_OF_CYCLES_AN_INSTRUCTION / 10,
        TENTHS_OF_CYCLES_AN_INSTRUCTION % 10,
        share / 10,
        share % 10
    );
}

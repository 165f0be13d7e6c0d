//! The application of the example firmware with simulated drives, on both buses.

mod brakes;
mod errors;
mod gone;
mod heard;
mod panel;
mod refused;
mod shutdown;
mod states;
mod watched;

use myactuator_host_std::sim::bus::can::CanBus;
use myactuator_host_std::sim::bus::rs485::Rs485Line;
use myactuator_host_std::sim::{BusFleet, DriveHandle, Fleet};
use myactuator_mcu_example::{
    App, Board, Moment, Movement, Report, RestartCause, Setup, StateName, Trouble, Usage, cycle,
};
use myactuator_protocol_core::command::{
    AnyReply, BrakeCommand, ErrorFlags, MotionRanges, Status1, VersionDate,
};
use myactuator_protocol_core::io::Runner;
use myactuator_protocol_core::master::{Event, MotorSet};
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::units::{Angle, MaxSpeed, Temperature, Voltage};
use myactuator_tests::fleet::{master, state, turn_to};
use myactuator_tests::on_both_buses;
use myactuator_tests::values::{id, millis};
use myactuator_tests::wire::Wire;

on_both_buses! {
    nothing_moves_before_the_button
    a_button_that_is_down_at_the_start_starts_nothing
    motors_are_named_and_reach_both_ends
    the_button_stops_within_a_few_cycles_and_letting_go_starts_nothing
    a_motor_that_is_unplugged_stops_all
    a_motor_that_restarts_stops_all
    a_motor_with_an_error_stops_all
    a_motor_of_another_firmware_is_not_moved
    a_motor_of_a_firmware_that_was_tried_is_moved
    a_dead_bus_is_reported_and_only_the_button_ends_that
    a_long_press_shuts_down
    a_motor_that_is_not_seen_does_not_feed_the_watchdog
    a_contact_that_bounces_at_the_stop_starts_nothing
    a_contact_that_bounces_at_the_start_starts_once
    a_press_while_stopping_starts_nothing
    a_motor_that_missed_its_stop_is_stopped_when_it_is_back
    a_shutdown_locks_the_brakes_of_the_others_when_one_is_silent
    a_motor_that_restarts_at_once_stops_all
    a_motor_that_restarts_while_getting_ready_is_not_moved
    a_firmware_that_has_restarted_keeps_its_motors_holding
    whatever_is_wrong_while_motors_run_stops_them
    a_late_cycle_is_counted_and_does_not_feed_the_watchdog
    a_motor_that_cannot_go_the_whole_way_is_not_moved
}

/// The movement of a bus's motors.
trait Moved: Wire {
    fn setup() -> Setup;
}

impl Moved for CanBus {
    fn setup() -> Setup {
        Setup::new(Movement::Motion { ranges: MotionRanges::V4_3, kp: 50.0, kd: 2.0 })
    }
}

impl Moved for Rs485Line {
    fn setup() -> Setup {
        Setup::new(Movement::Position { max_speed: MaxSpeed::from_raw(200) })
    }
}

#[derive(Default)]
struct Panel {
    is_button_down: bool,
    is_light_on: bool,
    fed: u32,
    reports: Vec<Report>,
}

impl Board for Panel {
    fn is_button_down(&mut self) -> bool {
        self.is_button_down
    }

    fn set_light(&mut self, on: bool) {
        self.is_light_on = on;
    }

    fn feed_watchdog(&mut self) {
        self.fed += 1;
    }

    fn log(&mut self, report: &Report) {
        self.reports.push(*report);
    }

    fn usage(&mut self) -> Usage {
        Usage { stack: 1_736, queued: 26, dropped: 3 }
    }
}

fn angle_deg(drive: &DriveHandle) -> f64 {
    drive.with(|drive| drive.plant().output_angle_deg())
}

fn speed_dps(drive: &DriveHandle) -> f64 {
    drive.with(|drive| drive.plant().output_speed_dps())
}

/// A firmware on a bus.
struct Firmware<'a, B: Moved> {
    bus: &'a BusFleet<B>,
    runner: B::Runner<8>,
    app: App<8>,
    panel: Panel,
}

impl<'a, B: Moved> Firmware<'a, B> {
    fn start(bus: &'a BusFleet<B>, panel: Panel) -> Self {
        Self::start_with(bus, panel, B::setup())
    }

    fn start_with(bus: &'a BusFleet<B>, panel: Panel, setup: Setup) -> Self {
        Self::start_on(bus, master(bus), panel, setup)
    }

    fn start_on(
        bus: &'a BusFleet<B>,
        mut runner: B::Runner<8>,
        mut panel: Panel,
        setup: Setup,
    ) -> Self {
        let now = runner.now();
        let at = &mut Moment { now, master: runner.master(), board: &mut panel };
        let app = App::start(setup, RestartCause::Power, at);
        Self { bus, runner, app, panel }
    }

    /// A firmware whose motors run.
    fn running(bus: &'a BusFleet<B>) -> Self {
        Self::running_on(bus, master(bus))
    }

    fn running_on(bus: &'a BusFleet<B>, runner: B::Runner<8>) -> Self {
        let mut firmware = Self::start_on(bus, runner, Panel::default(), B::setup());
        firmware.run_for(millis(1_500));
        firmware.press(millis(50));
        firmware.run_until(Report::State(StateName::Running), millis(3_000));
        firmware
    }

    fn run_for(&mut self, span: Duration) {
        let end = self.runner.now() + span;
        while self.runner.now() < end {
            cycle(&mut self.app, &mut self.runner, &mut self.panel);
        }
    }

    /// Runs until this is reported, from now on.
    #[track_caller]
    fn run_until(&mut self, report: Report, within: Duration) {
        let (told, end) = (self.panel.reports.len(), self.runner.now() + within);
        while !self.panel.reports[told..].contains(&report) {
            assert!(self.runner.now() < end, "no {report:?} in {:?}", &self.panel.reports[told..]);
            cycle(&mut self.app, &mut self.runner, &mut self.panel);
        }
    }

    /// Runs from the start until motors have been found and are prepared. No brake was told to open yet.
    #[track_caller]
    fn run_until_preparing(&mut self) {
        self.run_for(millis(1_500));
        self.press(millis(50));
        self.run_until(Report::State(StateName::Preparing), millis(1_000));
    }

    fn press(&mut self, span: Duration) {
        self.panel.is_button_down = true;
        self.run_for(span);
        self.panel.is_button_down = false;
        self.run_for(millis(2));
    }

    /// Drops the reports so far.
    fn forget(&mut self) {
        self.panel.reports.clear();
    }

    fn troubles(&self) -> Vec<Trouble> {
        let trouble = |report: &Report| match report {
            Report::Trouble(trouble) => Some(*trouble),
            _ => None,
        };
        self.panel.reports.iter().filter_map(trouble).collect()
    }

    fn is_anything_running(&self) -> bool {
        self.bus.drives.iter().any(|drive| speed_dps(drive).abs() > 1.0)
    }

    /// Waits for 1.1 s. Asserts that in the second after that nothing turns and nothing is reported.
    #[track_caller]
    fn stays_stopped(&mut self) {
        self.run_for(millis(1_100));
        let told = self.panel.reports.len();
        for _ in 0..100 {
            assert!(!self.is_anything_running());
            self.run_for(millis(10));
        }
        assert_eq!(self.panel.reports[told..], []);
    }
}

fn unplug<B: Moved>(bus: &BusFleet<B>, drive: &DriveHandle) {
    bus.world.cut(drive.station());
}

fn nothing_moves_before_the_button<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    let before: Vec<_> = bus.drives.iter().map(angle_deg).collect();
    firmware.run_for(millis(3_000));
    assert_eq!(before, bus.drives.iter().map(angle_deg).collect::<Vec<_>>());
    let nobody: MotorSet = (5..=8).map(id).collect();
    assert_eq!(
        firmware.panel.reports,
        [
            Report::Started { cause: RestartCause::Power },
            Report::State(StateName::Stopping),
            Report::Unheard { motors: nobody },
            Report::Stopped { unconfirmed: MotorSet::EMPTY },
            Report::State(StateName::Stopped),
        ]
    );
    assert!(firmware.panel.fed > 2_900, "{}", firmware.panel.fed);
}

fn a_button_that_is_down_at_the_start_starts_nothing<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let jammed = Panel { is_button_down: true, ..Panel::default() };
    let mut firmware = Firmware::start(&bus, jammed);
    firmware.run_for(millis(4_000));
    firmware.panel.is_button_down = false;
    firmware.stays_stopped();
}

fn told_by<B: Moved>(firmware: &Firmware<'_, B>, wanted: fn(&Report) -> bool) -> usize {
    firmware.panel.reports.iter().filter(|report| wanted(report)).count()
}

fn motors_are_named_and_reach_both_ends<B: Moved>() {
    let bus = B::drives(&Fleet::new(4).brakes(true)).unwrap();
    for (drive, degrees) in bus.drives.iter().zip([0.0, 40.0, -70.0, 120.0]) {
        turn_to(drive, degrees);
    }
    let mut firmware = Firmware::running(&bus);
    assert!(bus.drives.iter().all(|drive| state(drive).brake == BrakeCommand::RELEASE));
    assert_eq!(told_by(&firmware, |report| matches!(report, Report::Found { .. })), 4);
    assert_eq!(told_by(&firmware, |report| matches!(report, Report::Ready { .. })), 4);
    let home: Vec<_> = bus.drives.iter().map(angle_deg).collect();
    firmware.forget();
    let mut farthest = vec![0.0_f64; 4];
    for _ in 0..600 {
        firmware.run_for(millis(10));
        for ((drive, home), farthest) in bus.drives.iter().zip(&home).zip(&mut farthest) {
            let way = angle_deg(drive) - home;
            assert!((-2.0..22.0).contains(&way), "{way}");
            *farthest = farthest.max(way);
        }
    }
    assert!(farthest.iter().all(|&way| way > 18.0), "{farthest:?}");
    let last = firmware.panel.reports.iter().rev().find_map(|report| match *report {
        Report::Second { cycles, overruns, slowest, lost, stack, queued, dropped } => {
            assert_eq!((stack, queued, dropped), (1_736, 26, 3));
            Some((cycles, overruns, slowest, lost))
        }
        _ => None,
    });
    let (cycles, overruns, slowest, lost) = last.expect("six seconds");
    assert!((4_990..=6_010).contains(&cycles), "{cycles}");
    // Four motors share one bus, and the application's reads take a part of it.
    assert!((180..=1_010).contains(&slowest), "{slowest}");
    let seconds = told_by(&firmware, |report| matches!(report, Report::Second { .. }));
    assert!((5..=6).contains(&seconds), "{seconds}");
    assert_eq!((overruns, lost), (0, 0));
    assert!(firmware.panel.is_light_on);
    assert_eq!(firmware.troubles(), []);
}

fn the_button_stops_within_a_few_cycles_and_letting_go_starts_nothing<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    assert!(firmware.is_anything_running());
    firmware.panel.is_button_down = true;
    let pressed = firmware.runner.now();
    firmware.run_until(Report::Stopped { unconfirmed: MotorSet::EMPTY }, millis(100));
    let taken = firmware.runner.now() - pressed;
    assert!(taken < millis(20), "{taken}");
    firmware.panel.is_button_down = false;
    firmware.stays_stopped();
    assert_eq!(firmware.troubles(), [Trouble::Button]);
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
}

fn a_motor_that_is_unplugged_stops_all<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(500));
    unplug(&bus, &bus.drives[2]);
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(3) }), millis(200));
    firmware.run_until(Report::Stopped { unconfirmed: id(3).into() }, millis(1_100));
    bus.world.mend(bus.drives[2].station());
    firmware.stays_stopped();
    firmware.forget();
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
    assert_eq!(firmware.troubles(), []);
}

fn a_motor_that_restarts_stops_all<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(500));
    let now = firmware.runner.now();
    bus.drives[1].with(|drive| {
        drive.power_off(now);
        drive.power_on(now);
    });
    firmware.run_for(millis(300));
    let [Trouble::Restarted { motor } | Trouble::Silent { motor }] = firmware.troubles()[..] else {
        panic!("{:?}", firmware.panel.reports)
    };
    assert_eq!(motor, id(2));
    firmware.stays_stopped();
}

fn a_motor_with_an_error_stops_all<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(500));
    let flags = ErrorFlags::MOTOR_OVER_TEMPERATURE;
    bus.drives[3].with(|drive| drive.raise_fault(flags));
    let trouble = Trouble::Errors { motor: id(4), flags };
    firmware.run_until(Report::Trouble(trouble), millis(300));
    firmware.stays_stopped();
    // While it has the error, it does not run.
    firmware.forget();
    firmware.press(millis(50));
    firmware.run_until(Report::Trouble(trouble), millis(1_000));
    assert!(!firmware.panel.reports.contains(&Report::State(StateName::Running)));
}

fn a_motor_of_another_firmware_is_not_moved<B: Moved>() {
    let version_date = VersionDate::from_raw(20_231_201);
    let bus = B::drives(&Fleet::new(3).version_date(version_date)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    firmware.press(millis(50));
    let trouble = Trouble::OtherFirmware { motor: id(1), version_date };
    firmware.run_until(Report::Trouble(trouble), millis(1_000));
    firmware.run_for(millis(3_000));
    assert!(bus.drives.iter().all(|drive| angle_deg(drive).abs() < 0.1));
}

fn a_motor_of_a_firmware_that_was_tried_is_moved<B: Moved>() {
    let version_date = VersionDate::from_raw(20_251_101);
    let bus = B::drives(&Fleet::new(2).version_date(version_date)).unwrap();
    let setup = Setup { tried_version: Some(version_date), ..B::setup() };
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    firmware.run_for(millis(1_500));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(2_000));
}

fn a_dead_bus_is_reported_and_only_the_button_ends_that<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(500));
    bus.drives.iter().for_each(|drive| unplug(&bus, drive));
    firmware.run_until(Report::Trouble(Trouble::BusDown), millis(200));
    firmware.run_for(millis(1_000));
    bus.drives.iter().for_each(|drive| bus.world.mend(drive.station()));
    firmware.stays_stopped();
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
}

fn a_long_press_shuts_down<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(500));
    firmware.press(millis(50));
    firmware.run_for(millis(1_100));
    firmware.press(millis(1_100));
    firmware.run_for(millis(500));
    for drive in &bus.drives {
        assert!(!state(drive).output_on);
    }
    assert_eq!(firmware.troubles(), [Trouble::Button]);
}

/// For every motor: for some a read soon shows that it is missing, for others only unanswered set-points do.
fn a_motor_that_is_not_seen_does_not_feed_the_watchdog<B: Moved>() {
    let missed_after = (0..8).map(|index| {
        let bus = B::drives(&Fleet::new(8)).unwrap();
        let mut firmware = Firmware::running(&bus);
        firmware.run_for(millis(500));
        let (fed, unplugged) = (firmware.panel.fed, firmware.runner.now());
        unplug(&bus, &bus.drives[index]);
        let silent = Trouble::Silent { motor: bus.drives[index].motor() };
        firmware.run_until(Report::Trouble(silent), millis(102));
        let fed = firmware.panel.fed - fed;
        assert!(fed <= 52, "{fed}");
        firmware.runner.now() - unplugged
    });
    let last = missed_after.max().unwrap();
    assert!(last > millis(60), "this shows nothing: {last}");
}

/// The button goes down and bounces: closed for a millisecond, open for one, then held.
fn bounce_down<B: Moved>(firmware: &mut Firmware<'_, B>) {
    for is_down in [true, false, true] {
        firmware.panel.is_button_down = is_down;
        firmware.run_for(millis(1));
    }
}

fn a_contact_that_bounces_at_the_stop_starts_nothing<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    firmware.forget();
    bounce_down(&mut firmware);
    firmware.run_for(millis(300));
    firmware.panel.is_button_down = false;
    firmware.run_for(millis(1_500));
    assert_eq!(firmware.troubles(), [Trouble::Button]);
    assert!(
        !firmware.panel.reports.contains(&Report::State(StateName::Finding)),
        "the press that stopped started: {:?}",
        firmware.panel.reports
    );
}

fn a_contact_that_bounces_at_the_start_starts_once<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(1_500));
    firmware.panel.is_button_down = true;
    firmware.run_for(millis(100));
    for is_down in [false, true, false] {
        firmware.panel.is_button_down = is_down;
        firmware.run_for(millis(1));
    }
    firmware.run_for(millis(2_000));
    assert_eq!(firmware.troubles(), []);
}

fn a_press_while_stopping_starts_nothing<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.run_for(millis(300));
    unplug(&bus, &bus.drives[2]);
    firmware.run_until(Report::Trouble(Trouble::Silent { motor: id(3) }), millis(200));
    firmware.forget();
    // A person sees that and presses the button, too.
    firmware.panel.is_button_down = true;
    firmware.run_until(Report::State(StateName::Stopped), millis(1_100));
    firmware.panel.is_button_down = false;
    firmware.run_for(millis(1_500));
    assert!(
        !firmware.panel.reports.contains(&Report::State(StateName::Finding)),
        "it started: {:?}",
        firmware.panel.reports
    );
}

fn a_motor_that_missed_its_stop_is_stopped_when_it_is_back<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    // So slow that it lags far behind its set-points.
    let setup = Setup::new(Movement::Position { max_speed: MaxSpeed::from_raw(5) });
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    firmware.run_for(millis(1_500));
    firmware.press(millis(50));
    firmware.run_until(Report::State(StateName::Running), millis(3_000));
    firmware.run_for(millis(900));
    let cut = firmware.runner.now();
    unplug(&bus, &bus.drives[2]);
    firmware.run_until(Report::State(StateName::Stopped), millis(1_300));
    let gone = firmware.runner.now() - cut;
    assert!(gone < millis(450), "its protection would have ended it: {gone}");
    bus.world.mend(bus.drives[2].station());
    firmware.run_for(millis(1_000));
    let state = state(&bus.drives[2]);
    assert!(
        !firmware.is_anything_running(),
        "gone for {gone}, back for 1 s, still moving, {:?}, {state:?}, {:?}",
        speed_dps(&bus.drives[2]),
        firmware.panel.reports.last()
    );
}

fn a_shutdown_locks_the_brakes_of_the_others_when_one_is_silent<B: Moved>() {
    let bus = B::drives(&Fleet::new(4).brakes(true)).unwrap();
    let mut firmware = Firmware::running(&bus);
    firmware.press(millis(50));
    firmware.run_for(millis(500));
    unplug(&bus, &bus.drives[0]);
    firmware.press(millis(1_100));
    firmware.run_for(millis(300));
    for drive in &bus.drives[1..] {
        let state = state(drive);
        assert!(
            state.output_on || state.brake == BrakeCommand::LOCK,
            "off, and its brake is open: {state:?}"
        );
    }
}

fn a_motor_that_restarts_at_once_stops_all<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    let mut firmware = Firmware::running(&bus);
    let now = firmware.runner.now();
    bus.drives[3].with(|drive| {
        drive.power_off(now);
        drive.power_on(now);
    });
    firmware.run_for(millis(2_000));
    assert_eq!(firmware.troubles().len(), 1, "it was not noticed: {:?}", firmware.panel.reports);
}

fn a_motor_that_restarts_while_getting_ready_is_not_moved<B: Moved>() {
    for after in [150, 170, 190, 210] {
        let bus = B::drives(&Fleet::new(8).brakes(true)).unwrap();
        let mut firmware = Firmware::start(&bus, Panel::default());
        firmware.run_until_preparing();
        firmware.run_for(millis(after));
        let now = firmware.runner.now();
        assert_eq!(state(&bus.drives[7]).brake, BrakeCommand::RELEASE);
        bus.drives[7].with(|drive| {
            drive.power_off(now);
            drive.power_on(now);
        });
        firmware.run_for(millis(2_000));
        let state = state(&bus.drives[7]);
        assert!(
            !firmware.panel.reports.contains(&Report::State(StateName::Running)),
            "it is driven, its brake is {:?}, troubles {:?}",
            state.brake,
            firmware.troubles()
        );
    }
}

fn a_firmware_that_has_restarted_keeps_its_motors_holding<B: Moved>() {
    let bus = B::drives(&Fleet::new(4)).unwrap();
    drop(Firmware::running(&bus));
    let mut firmware = Firmware::start(&bus, Panel::default());
    firmware.run_for(millis(2_500));
    for drive in &bus.drives {
        assert!(state(drive).output_on, "{:?}", state(drive));
    }
}

/// The application receives these events directly, because no simulated bus causes them on its own.
fn whatever_is_wrong_while_motors_run_stops_them<B: Moved>() {
    let flags = ErrorFlags::MOTOR_OVER_TEMPERATURE;
    let hot = Status1 {
        temperature: Temperature::from_raw(90),
        mosfet_temperature: Temperature::from_raw(60),
        brake: BrakeCommand::RELEASE,
        voltage: Voltage::from_raw(480),
        errors: flags,
    };
    let motor = id(2);
    let cases = [
        (Some(Event::LostMaster { motor }), Trouble::LostMaster { motor }),
        (
            Some(Event::Report { motor, reply: AnyReply::ReadStatus1(hot) }),
            Trouble::Errors { motor, flags },
        ),
        (None, Trouble::BusDown),
    ];
    for (event, trouble) in cases {
        let bus = B::drives(&Fleet::new(2)).unwrap();
        let mut firmware = Firmware::running(&bus);
        let Firmware { runner, app, panel, .. } = &mut firmware;
        let now = runner.now();
        let at = &mut Moment { now, master: runner.master(), board: panel };
        match event {
            Some(event) => app.handle_event(&event, at),
            None => app.handle_bus_error(at),
        }
        assert_eq!(firmware.troubles(), [trouble]);
        firmware.stays_stopped();
    }
}

fn a_late_cycle_is_counted_and_does_not_feed_the_watchdog<B: Moved>() {
    let bus = B::drives(&Fleet::new(2)).unwrap();
    let mut firmware = Firmware::running(&bus);
    for (late_us, fed) in [(400, 1), (600, 0), (3_000, 0), (0, 1)] {
        let Firmware { runner, app, panel, .. } = &mut firmware;
        let (before, due) = (panel.fed, app.next_cycle());
        let now = due + Duration::from_micros(late_us);
        app.begin_cycle(&mut Moment { now, master: runner.master(), board: panel });
        assert_eq!(panel.fed - before, fed, "{late_us} us late");
        // The next cycle begins a millisecond after this one was due. If this one was too late, it counts from now.
        let next = if fed == 1 { due } else { now } + millis(1);
        assert_eq!(app.next_cycle(), next);
    }
    firmware.run_for(millis(1_100));
    let told = firmware.panel.reports.iter().find_map(|report| match report {
        Report::Second { overruns, .. } => Some(*overruns),
        _ => None,
    });
    assert_eq!(told, Some(2));
}

fn a_motor_that_cannot_go_the_whole_way_is_not_moved<B: Moved>() {
    // Motion mode reaches 12.5 rad, or 716 degrees; positions reach 21 million.
    let setup = Setup { amplitude: Angle::from_raw(72_000), ..B::setup() };
    let bus = B::drives(&Fleet::new(1)).unwrap();
    let mut firmware = Firmware::start_with(&bus, Panel::default(), setup);
    firmware.run_for(millis(1_500));
    firmware.press(millis(50));
    firmware.run_for(millis(1_500));
    let is_motion = matches!(B::setup().movement, Movement::Motion { .. });
    let expected: &[Trouble] =
        if is_motion { &[Trouble::OutOfRange { motor: id(1) }] } else { &[] };
    assert_eq!(firmware.troubles(), expected);
}

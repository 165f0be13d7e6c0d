//! The drive as a device: mode, restart, run time, version, model (manual 2.25, 2.26, 2.29, 2.30,
//! 2.33).

use core::fmt;

use crate::command::NoReply;
use crate::data::{self, Data};
use crate::firmware::Firmware;
use crate::quantity::{Form, OutOfRange, Quantity, Unit};
use crate::units::Milliseconds;

command! {
    /// Read which control loop runs: 0x70 (2.25).
    ReadRunningMode -> RunningMode
}

code! {
    /// A control loop (2.25.3).
    Mode "running mode" {
        /// Torque current.
        CURRENT = 1 "current",
        /// Speed.
        SPEED = 2 "speed",
        /// Position.
        POSITION = 3 "position",
    }
}

impl Mode {
    /// Whether any loop runs, so that the motor can hold its shaft. While none runs, drives were seen to report 0,
    /// which the manual does not name.
    pub const fn runs(self) -> bool {
        self.raw() != 0
    }
}

reply! {
    /// Which control loop runs (2.25.3).
    RunningMode {
        /// The loop.
        mode: Mode => 7,
    }
}

command! {
    /// Restart the drive: 0x76 (2.26). There is no reply; drives were seen to take about 1.1 s until
    /// they answer again. It is also what clears errors of level one.
    Reset -> NoReply
}

command! {
    /// Read how long the drive has run since its last start: 0xB1 (2.29).
    ReadRunTime -> RunTime
}

reply! {
    /// Time since the drive's last start (2.29.3).
    RunTime {
        /// The time.
        run_time: Milliseconds => 4,
    }
}

impl RunTime {
    /// Whether a drive that reports this, and reported `before` earlier, has started again in between: it has run for
    /// less time. The time also wraps to 0, after 49.7 days. So this is `false` if, counted over such a wrap, the two
    /// are less than an hour apart.
    ///
    /// A drive that has run for longer may also have started again, long ago.
    pub const fn shows_restart_since(self, before: Self) -> bool {
        const AN_HOUR_MS: u32 = 3_600_000;
        let (now, before) = (self.run_time.raw(), before.run_time.raw());
        now < before && now.wrapping_sub(before) >= AN_HOUR_MS
    }
}

command! {
    /// Read the date of the drive's software: 0xB2 (2.30).
    ReadVersionDate -> Version
}

reply! {
    /// Date of the drive's software (2.30.3).
    Version {
        /// The date.
        version_date: VersionDate => 4,
    }
}

/// A date as a decimal number, 20220206 for 2022-02-06 (2.30.4). Some drives add a two-digit build
/// number: 2023020601.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct VersionDate(u32);

impl VersionDate {
    /// Its name and form.
    pub const QUANTITY: Quantity =
        Quantity { name: "version date", unit: Unit::None, form: Form::Date };
    pub(crate) const BYTES: u8 = 4;

    /// The date with this number on the wire.
    pub const fn from_raw(raw: u32) -> Self {
        Self(raw)
    }

    /// The number on the wire.
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// Year, month and day, `None` if the number is no date.
    pub const fn year_month_day(self) -> Option<(u16, u8, u8)> {
        let date = if self.0 >= 1_000_000_000 { self.0 / 100 } else { self.0 };
        let (year, month, day) = (date / 10_000, date / 100 % 100, date % 100);
        if year >= 1000 && year <= 9999 && month >= 1 && month <= 12 && day >= 1 && day <= 31 {
            Some((year as u16, month as u8, day as u8))
        } else {
            None
        }
    }

    #[inline(always)]
    pub(crate) const fn put<const AT: usize>(self, data: &mut Data) {
        data::put_u32::<AT>(data, self.0);
    }

    #[inline(always)]
    pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
        Ok(Self(data::get_u32::<AT>(data)))
    }
}

impl Firmware {
    /// The version dates (0xB2) that are known to belong to it; simulated drives report the first. They are 2025-05-12,
    /// the day of protocol V4.3 (manual 9), and 2026-04-24, build 02, of a V4.4 that was met on a real motor.
    pub const fn version_dates(self) -> &'static [VersionDate] {
        match self {
            Self::V4_3 => &[VersionDate(20_250_512)],
            Self::V4_4 => &[VersionDate(2_026_042_402)],
        }
    }

    /// The firmware of a drive that reports this version date, if it is [known](Self::version_dates). No report ties
    /// any other date to a protocol, so for all others this is `None`, and nothing is guessed.
    pub fn of_version_date(date: VersionDate) -> Option<Self> {
        Self::ALL.iter().copied().find(|firmware| firmware.version_dates().contains(&date))
    }
}

impl fmt::Display for VersionDate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.year_month_day() {
            Some((year, month, day)) => write!(f, "{year:04}-{month:02}-{day:02}"),
            None => self.0.fmt(f),
        }
    }
}

command! {
    /// Read the motor's model: 0xB5 (2.33).
    ReadModel -> Model
}

reply! {
    /// The motor's model (2.33.3).
    Model {
        /// Its name.
        model: ModelName => 1,
    }
}

/// A model's name, up to seven ASCII characters (2.33.3). Shorter ones are filled up with zeros.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct ModelName([u8; 7]);

impl ModelName {
    /// Its name and form.
    pub const QUANTITY: Quantity =
        Quantity { name: "model name", unit: Unit::None, form: Form::Text };
    pub(crate) const BYTES: u8 = 7;

    /// The name with these bytes on the wire, whatever they are.
    pub const fn from_bytes(bytes: [u8; 7]) -> Self {
        Self(bytes)
    }

    /// The bytes on the wire.
    pub const fn bytes(self) -> [u8; 7] {
        self.0
    }

    /// The name without the zeros that fill it up; `None` if it is not printable ASCII.
    pub fn as_str(&self) -> Option<&str> {
        let name = self.0.split(|&byte| byte == 0).next()?;
        let filled = self.0.iter().skip(name.len()).all(|&byte| byte == 0);
        let printable = name.iter().all(|&byte| byte.is_ascii_graphic() || byte == b' ');
        if filled && printable { core::str::from_utf8(name).ok() } else { None }
    }

    #[inline(always)]
    pub(crate) const fn put<const AT: usize>(self, data: &mut Data) {
        let [a, b, c, d, e, f, g] = self.0;
        *data = [data[0], a, b, c, d, e, f, g];
    }

    #[inline(always)]
    pub(crate) const fn read<const AT: usize>(data: &Data) -> Result<Self, OutOfRange> {
        Ok(Self::of(data))
    }

    /// The name in the only place that a data field has for it.
    pub(crate) const fn of(data: &Data) -> Self {
        let [_, name @ ..] = *data;
        Self(name)
    }
}

/// The characters, with a point for each that is not printable.
#[cfg(feature = "defmt")]
impl defmt::Format for ModelName {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.as_str() {
            Some(name) => defmt::write!(f, "{=str}", name),
            None => defmt::write!(f, "{=[u8]:02x}", self.0),
        }
    }
}

impl fmt::Display for ModelName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.as_str() {
            Some(name) => f.write_str(name),
            None => self.0.iter().try_for_each(|&byte| {
                let printable = byte.is_ascii_graphic() || byte == b' ';
                write!(f, "{}", if printable { byte as char } else { '.' })
            }),
        }
    }
}

impl fmt::Debug for ModelName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ModelName({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_run_time_that_counts_on_from_0_is_no_restart() {
        let runs = |ms| RunTime { run_time: Milliseconds::from_raw(ms) };
        let shows_restart = |before, now| runs(now).shows_restart_since(runs(before));
        assert!(!shows_restart(94, 94));
        assert!(!shows_restart(94, 10_000_000));
        // The longest that it tells, and 100 ms or all but an hour later.
        assert!(!shows_restart(u32::MAX - 5, 94));
        assert!(!shows_restart(u32::MAX, 3_600_000 - 2));
        assert!(shows_restart(u32::MAX, 3_600_000 - 1));
        // The last after 24.9 and after 49.5 days.
        for before in [194, 1 << 31, 4_280_000_000] {
            assert!(shows_restart(before, 50), "{before}");
        }
    }

    #[test]
    fn dates_come_with_and_without_a_build_number() {
        assert_eq!(VersionDate::from_raw(20_220_206).to_string(), "2022-02-06");
        assert_eq!(VersionDate::from_raw(2_023_020_601).year_month_day(), Some((2023, 2, 6)));
        assert_eq!(VersionDate::from_raw(7).to_string(), "7");
        for no_date in [20_221_301, 20_220_001, 20_221_232, 20_221_200] {
            assert_eq!(VersionDate::from_raw(no_date).year_month_day(), None, "{no_date}");
        }
    }

    #[test]
    fn an_unknown_version_date_leads_to_no_firmware() {
        let of = |date| Firmware::of_version_date(VersionDate::from_raw(date));
        assert_eq!(of(20_250_512), Some(Firmware::V4_3));
        assert_eq!(of(2_026_042_402), Some(Firmware::V4_4));
        for unknown in [0, 20_220_206, 2_025_070_202, 2_025_051_201, 20_250_513, u32::MAX] {
            assert_eq!(of(unknown), None, "{unknown}");
        }
    }

    #[test]
    fn model_names_are_filled_up_and_never_trusted() {
        assert_eq!(ModelName::from_bytes(*b"RMD-X8\0").as_str(), Some("RMD-X8"));
        assert_eq!(ModelName::from_bytes(*b"X8\xFFS2V1").as_str(), None);
        assert_eq!(ModelName::from_bytes(*b"X8\xFFS2V1").to_string(), "X8.S2V1");
        assert_eq!(ModelName::from_bytes(*b"X8\0S2V1").as_str(), None);
        assert_eq!(std::format!("{:?}", ModelName::from_bytes(*b"RMD-X8\0")), "ModelName(RMD-X8)");
    }
}

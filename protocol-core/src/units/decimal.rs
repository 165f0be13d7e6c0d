//! Numbers of equal steps as text, without floating point, by width and precision of the format.

use core::fmt::{self, Alignment, Write};

use heapless::String;

use crate::quantity::Steps;

/// Hundredths are the finest step that there is.
const DIGITS: usize = 2;
/// More decimals than this are not printed: all after the second are zeros.
const MOST_DECIMALS: usize = 9;

/// Prints `raw` steps and the unit. `{:8.1}` gives one decimal and fills up to eight characters in
/// all, before the number unless the format says otherwise.
pub(crate) fn print(
    f: &mut fmt::Formatter<'_>,
    raw: i64,
    steps: &Steps,
    symbol: &str,
) -> fmt::Result {
    let factor = i64::from(steps.numerator) * 100 / i64::from(steps.denominator.max(1));
    let hundredths = raw.saturating_mul(factor);
    let mut text: String<48> = String::new();
    number(&mut text, hundredths, f.precision())?;
    if !symbol.is_empty() {
        write!(text, " {symbol}")?;
    }
    pad(f, &text)
}

fn number(out: &mut impl Write, hundredths: i64, precision: Option<usize>) -> fmt::Result {
    let magnitude = hundredths.unsigned_abs();
    let (magnitude, decimals) = match precision {
        // Halves away from zero, as values are rounded to steps.
        Some(0) => ((magnitude + 50) / 100 * 100, 0),
        Some(1) => ((magnitude + 5) / 10 * 10, 1),
        Some(many) => (magnitude, many.min(MOST_DECIMALS)),
        None if magnitude % 100 == 0 => (magnitude, 0),
        None if magnitude % 10 == 0 => (magnitude, 1),
        None => (magnitude, DIGITS),
    };
    if hundredths < 0 && magnitude > 0 {
        out.write_char('-')?;
    }
    write!(out, "{}", magnitude / 100)?;
    let rest = magnitude % 100;
    match decimals {
        0 => Ok(()),
        1 => write!(out, ".{}", rest / 10),
        more => write!(out, ".{rest:02}{:0<1$}", "", more - DIGITS),
    }
}

/// Fills up to the format's width.
pub(crate) fn pad(f: &mut fmt::Formatter<'_>, text: &str) -> fmt::Result {
    let missing = f.width().unwrap_or(0).saturating_sub(text.chars().count());
    let before = match f.align() {
        Some(Alignment::Left) => 0,
        Some(Alignment::Center) => missing / 2,
        Some(Alignment::Right) | None => missing,
    };
    let fill = f.fill();
    (0..before).try_for_each(|_| f.write_char(fill))?;
    f.write_str(text)?;
    (before..missing).try_for_each(|_| f.write_char(fill))
}

#[cfg(test)]
mod tests {
    use crate::units::{Angle, Current, ReportInterval, Voltage};
    use std::format;

    #[test]
    fn width_and_precision_are_obeyed() {
        let angle = Angle::from_raw(-12_345);
        assert_eq!(format!("{angle}"), "-123.45 deg");
        assert_eq!(format!("{angle:.1}"), "-123.5 deg");
        assert_eq!(format!("{angle:.0}"), "-123 deg");
        assert_eq!(format!("{angle:.4}"), "-123.4500 deg");
        assert_eq!(format!("{angle:14.1}"), "    -123.5 deg");
        assert_eq!(format!("{angle:<14.1}|"), "-123.5 deg    |");
        assert_eq!(format!("{angle:*^14.1}"), "**-123.5 deg**");
        assert_eq!(format!("{:6}", Voltage::from_raw(485)), "48.5 V");
        assert_eq!(format!("{}", Angle::MIN), "-21474836.48 deg");
        assert_eq!(format!("{}", ReportInterval::MAX), "655350 ms");
        assert_eq!(format!("{:.1}", Current::from_raw(-4)), "0.0 A");
        assert_eq!(format!("{}", Current::from_raw(-4)), "-0.04 A");
    }
}

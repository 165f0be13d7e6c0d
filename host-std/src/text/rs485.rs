//! RS485 bytes as text.

use crate::Unexpected;

/// Bytes as upper-case hexadecimal, separated by spaces: `3E 01 08`.
pub fn bytes(bytes: &[u8]) -> String {
    super::joined_hex(bytes, " ")
}

/// The bytes on a line of text, separated by commas or spaces, or as one string of digits.
///
/// A line is hexadecimal if a byte has `0x` or a letter A to F, if there are strings of four digits or more, or if
/// every byte has exactly two digits. Otherwise it is decimal. A whole frame is always read correctly, since it begins
/// with `3E` or `62` and contains zeros.
///
/// ```
/// use myactuator_host_std::text::rs485::parse_line;
///
/// assert_eq!(parse_line("3E 01 08").unwrap(), [62, 1, 8]);
/// assert_eq!(parse_line("0x3e,0x1,0x8").unwrap(), [62, 1, 8]);
/// assert_eq!(parse_line("3E0108").unwrap(), [62, 1, 8]);
/// assert_eq!(parse_line("62, 1, 8").unwrap(), [62, 1, 8]);
/// ```
///
/// # Errors
/// [`Unexpected`] names the first piece that is not a byte.
pub fn parse_line(line: &str) -> Result<Vec<u8>, Unexpected> {
    let tokens: Vec<&str> = line
        .split(|c: char| c == ',' || c.is_whitespace())
        .filter(|token| !token.is_empty())
        .collect();
    let hexadecimal = is_hexadecimal(&tokens);
    let expected =
        if hexadecimal { "hexadecimal bytes 00 to FF" } else { "decimal bytes 0 to 255" };
    let mut bytes = Vec::new();
    for token in tokens {
        let wrong = || Unexpected::new(format!("{expected} separated by spaces or commas"), token);
        if hexadecimal {
            parse_hex(token, &mut bytes).ok_or_else(wrong)?;
        } else {
            let digits = token.bytes().all(|byte| byte.is_ascii_digit());
            bytes.push(token.parse().ok().filter(|_| digits).ok_or_else(wrong)?);
        }
    }
    Ok(bytes)
}

fn is_hexadecimal(tokens: &[&str]) -> bool {
    tokens.iter().any(|token| {
        token.len() >= 4
            || strip_0x(token).is_some()
            || token.bytes().any(|byte| byte.is_ascii_alphabetic())
    }) || tokens.iter().all(|token| token.len() == 2)
}

fn strip_0x(token: &str) -> Option<&str> {
    token.strip_prefix("0x").or_else(|| token.strip_prefix("0X"))
}

fn parse_hex(token: &str, bytes: &mut Vec<u8>) -> Option<()> {
    let digits = strip_0x(token).unwrap_or(token);
    match digits.len() {
        0 => return None,
        1 => bytes.push(u8::from_str_radix(digits, 16).ok()?),
        _ => bytes.extend(super::can::hex_bytes(digits)?),
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const READ_PID: [u8; 13] = [0x3E, 1, 8, 0x30, 1, 0, 0, 0, 0, 0, 0, 0xE8, 0xDD];

    #[test]
    fn every_notation_gives_the_same_bytes() {
        for line in [
            "3E 01 08 30 01 00 00 00 00 00 00 E8 DD",
            "3e,01,08,30,01,00,00,00,00,00,00,e8,dd",
            "0x3E, 0x01, 0x08, 0x30, 0x01, 0x0, 0x0, 0x0, 0x0, 0x0, 0x0, 0xE8, 0xDD",
            "3E 1 8 30 1 0 0 0 0 0 0 E8 DD",
            "3E0108300100000000000 0E8DD".replace(' ', "").as_str(),
            "62 1 8 48 1 0 0 0 0 0 0 232 221",
            "62, 001, 008, 48, 1, 0, 0, 0, 0, 0, 0, 232, 221",
        ] {
            assert_eq!(parse_line(line).as_deref(), Ok(&READ_PID[..]), "{line}");
        }
        assert_eq!(bytes(&READ_PID), "3E 01 08 30 01 00 00 00 00 00 00 E8 DD");
    }

    #[test]
    fn words_that_are_no_byte_are_refused_by_name() {
        assert_eq!(
            parse_line("62 1 256").unwrap_err().to_string(),
            "expected decimal bytes 0 to 255 separated by spaces or commas, found \"256\""
        );
        assert_eq!(
            parse_line("3E 100").unwrap_err().to_string(),
            "expected hexadecimal bytes 00 to FF separated by spaces or commas, found \"100\""
        );
        assert!(parse_line("log.txt").is_err());
        assert!(parse_line("1 +2").is_err());
        assert!(parse_line("3E é").is_err());
        assert_eq!(parse_line(" , "), Ok(Vec::new()));
    }
}

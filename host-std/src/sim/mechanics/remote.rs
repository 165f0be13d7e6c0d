//! Mechanics in another process.

use std::io::{BufRead as _, BufReader, Read, Write};

use myactuator_protocol_core::time::Duration;
use serde::{Deserialize, Serialize};

use super::{Failure, Mechanics, Shaft};

/// The longest line that is read; 32 shafts need a tenth of that.
const LONGEST_LINE: u64 = 64 * 1024;

/// Asks a process over a socket what the shafts do, with one line of JSON in each direction per period. See the
/// [module](super).
///
/// The simulation waits for each answer, so that both have the same time. In case the process hangs, give the socket
/// time-outs for reading and writing (`set_read_timeout`).
#[derive(Debug)]
pub struct Remote<S> {
    stream: BufReader<S>,
}

#[derive(Serialize)]
struct Asked {
    period_us: u64,
    shafts: Vec<ShaftReport>,
}

#[derive(Serialize)]
struct ShaftReport {
    motor: u8,
    torque_nm: f64,
    friction_nm: f64,
    angle_deg: f64,
    speed_dps: f64,
}

#[derive(Deserialize)]
struct Answer {
    shafts: Vec<Moved>,
}

#[derive(Deserialize)]
struct Moved {
    angle_deg: f64,
    speed_dps: f64,
}

impl<S: Read + Write> Remote<S> {
    /// Mechanics in the process at the other end of this stream.
    pub fn new(stream: S) -> Self {
        Self { stream: BufReader::new(stream) }
    }

    fn exchange(&mut self, asked: &Asked) -> Result<Answer, Failure> {
        let mut line = serde_json::to_vec(asked)?;
        line.push(b'\n');
        self.stream.get_mut().write_all(&line)?;
        line.clear();
        self.stream.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line)?;
        if line.last() != Some(&b'\n') {
            return Err(match line.len() {
                0 => "it has closed the connection".into(),
                bytes => format!(
                    "expected a line of at most {LONGEST_LINE} bytes, found {bytes} without an end"
                ),
            }
            .into());
        }
        Ok(serde_json::from_slice(&line)?)
    }
}

impl<S: Read + Write + Send> Mechanics for Remote<S> {
    fn step(&mut self, period: Duration, shafts: &mut [Shaft]) -> Result<(), Failure> {
        let report = |shaft: &Shaft| ShaftReport {
            motor: shaft.motor.get(),
            torque_nm: shaft.acting.torque_nm,
            friction_nm: shaft.acting.friction_nm,
            angle_deg: shaft.angle_deg,
            speed_dps: shaft.speed_dps,
        };
        let asked =
            Asked { period_us: period.as_micros(), shafts: shafts.iter().map(report).collect() };
        let answer = self
            .exchange(&asked)
            .map_err(|error| format!("the process that moves the shafts: {error}"))?;
        if answer.shafts.len() != shafts.len() {
            let (expected, found) = (shafts.len(), answer.shafts.len());
            return Err(format!(
                "the process that moves the shafts: expected {expected} shafts, found {found}"
            )
            .into());
        }
        for (shaft, moved) in shafts.iter_mut().zip(answer.shafts) {
            (shaft.angle_deg, shaft.speed_dps) = (moved.angle_deg, moved.speed_dps);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::plant::ShaftTorque;
    use myactuator_protocol_core::MotorId;
    use std::os::unix::net::UnixStream;

    fn shaft() -> Shaft {
        let acting = ShaftTorque { torque_nm: 1.5, friction_nm: 0.25 };
        Shaft { motor: MotorId::MIN, acting, angle_deg: -90.0, speed_dps: 0.5 }
    }

    /// What a process that answers so leads to, and what it was asked.
    fn asked(answer: &str) -> (Result<Shaft, String>, String) {
        let (near, mut far) = UnixStream::pair().unwrap();
        far.write_all(answer.as_bytes()).unwrap();
        let mut shafts = [shaft()];
        let mut remote = Remote::new(near);
        far.shutdown(std::net::Shutdown::Write).unwrap();
        let moved = remote.step(Duration::from_millis(1), &mut shafts);
        drop(remote);
        let mut asked = String::new();
        far.read_to_string(&mut asked).unwrap();
        (moved.map(|()| shafts[0]).map_err(|error| error.to_string()), asked)
    }

    #[test]
    fn shafts_are_sent_and_received_as_one_line_each() {
        let (moved, asked) = asked("{\"shafts\":[{\"angle_deg\":-89.5,\"speed_dps\":2}]}\n");
        assert_eq!(moved, Ok(Shaft { angle_deg: -89.5, speed_dps: 2.0, ..shaft() }));
        let expected = r#"{"period_us":1000,"shafts":[{"motor":1,"torque_nm":1.5,"friction_nm":0.25,"angle_deg":-90.0,"speed_dps":0.5}]}"#;
        assert_eq!(asked, format!("{expected}\n"));
    }

    #[test]
    fn wrong_answers_are_explained() {
        let message = |answer: &str| asked(answer).0.unwrap_err();
        assert!(message("").ends_with("it has closed the connection"));
        assert!(message("{\"shafts\":[]").ends_with("found 12 without an end"));
        assert!(message("{\"shafts\":[]}\n").ends_with("expected 1 shafts, found 0"));
        assert!(message("{\"shaft\":[]}\n").contains("missing field `shafts`"));
    }
}

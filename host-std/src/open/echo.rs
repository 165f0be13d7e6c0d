//! Whether an RS485 adapter hands back what it sends, found out before anything else is sent.

use embedded_io::{Read, ReadReady, Write};
use myactuator_protocol_core::io::Clock;
use myactuator_protocol_core::time::Duration;
use myactuator_protocol_core::wire::rs485::FRAME_LENGTH;

/// A read of the status (0x9A) from motor 33, which no motor can be (1 to 32). So nobody answers it, not
/// even a drive that lost its master and hands its first command back: what comes back as it was sent is
/// an echo.
const PROBE: [u8; FRAME_LENGTH] = [0x3E, 33, 0x08, 0x9A, 0, 0, 0, 0, 0, 0, 0, 0x73, 0x70];

/// Noise may spoil one.
const PROBES: usize = 2;

/// How long an echo is waited for behind the time that a frame takes on the line: three times what
/// adapters keep received bytes for by default.
const WAIT: Duration = Duration::from_millis(50);

/// Sends [`PROBE`] and looks whether it comes back, within 0.1 s and the time of two frames.
///
/// # Errors
/// What the port reports.
pub(super) fn is_echoing<S: Read + ReadReady + Write>(
    serial: &mut S,
    clock: &impl Clock,
    frame_time: Duration,
) -> Result<bool, S::Error> {
    let mut latest = [0; FRAME_LENGTH];
    for _ in 0..PROBES {
        serial.write_all(&PROBE)?;
        serial.flush()?;
        let end = clock.now() + frame_time + WAIT;
        while clock.now() < end {
            if !serial.read_ready()? {
                clock.idle(end);
                continue;
            }
            let mut byte = [0];
            if serial.read(&mut byte)? == 0 {
                continue;
            }
            latest.rotate_left(1);
            latest[FRAME_LENGTH - 1] = byte[0];
            if latest == PROBE {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Fleet;
    use crate::sim::bus::rs485::{SerialWorld, TransceiverConfig};
    use crate::sim::bus::{Node, faults::Babble};
    use myactuator_protocol_core::time::Instant;
    use myactuator_protocol_core::wire::rs485::Frame;
    use myactuator_protocol_core::{Data, MotorId, Target};

    const BIT_RATE: u32 = 115_200;
    const FRAME_TIME: Duration = Duration::from_micros(1_129);
    const MILLISECOND: Duration = Duration::from_millis(1);
    const ECHOES: TransceiverConfig = echoing(true);
    const IS_QUIET: TransceiverConfig = echoing(false);

    const fn echoing(echo: bool) -> TransceiverConfig {
        TransceiverConfig {
            switch_to_send: Duration::ZERO,
            switch_to_receive: Duration::ZERO,
            echo,
            switch_noise: 0.0,
            transmit_buffer: 4096,
            receive_buffer: 4096,
        }
    }

    /// Whether an adapter is found to echo that hands over what it received this often.
    fn is_found_to_echo(
        world: &SerialWorld,
        transceiver: TransceiverConfig,
        every: Duration,
    ) -> bool {
        let mut port = world.port_with(transceiver);
        world.hand_over_every(port.station(), every);
        is_echoing(&mut port, &world.clock(), FRAME_TIME).unwrap()
    }

    fn line() -> SerialWorld {
        SerialWorld::new(BIT_RATE, 1)
    }

    #[test]
    fn an_echo_is_found_with_and_without_drives_noise_and_bursts() {
        let noisy = TransceiverConfig { switch_noise: 1.0, ..ECHOES };
        let with_drives = Fleet::new(2).on_rs485(BIT_RATE).unwrap();
        // Somebody speaks into the first probe.
        let spoilt = line();
        spoilt.attach(AnswersAll(Some(vec![0])));
        for (world, transceiver, every_ms, limit_ms) in [
            // The first echo ends it.
            (line(), ECHOES, 1, 20),
            (line(), noisy, 1, 20),
            (line(), ECHOES, 16, 20),
            (line(), noisy, 16, 20),
            (with_drives.world, noisy, 16, 20),
            (spoilt, ECHOES, 16, 80),
        ] {
            let case = format!("{transceiver:?}, every {every_ms} ms, until {limit_ms} ms");
            let every = Duration::from_millis(every_ms);
            assert!(is_found_to_echo(&world, transceiver, every), "{case}");
            assert!(limit_ms == 20 || world.now() > Instant::from_millis(50), "{case}");
            assert!(world.now() < Instant::from_millis(limit_ms), "{case}: {:?}", world.now());
        }
    }

    #[test]
    fn none_is_found_where_there_is_none() {
        let drives = Fleet::new(32).on_rs485(BIT_RATE).unwrap().world;
        let log = drives.log();
        for world in [line(), drives] {
            assert!(!is_found_to_echo(&world, IS_QUIET, MILLISECOND));
            // Two frames and 50 ms behind each, twice.
            let took = world.now();
            assert!(
                (Instant::from_millis(104)..Instant::from_millis(107)).contains(&took),
                "{took:?}"
            );
        }
        let records = log.take();
        let of_the_port = records.iter().filter(|record| record.station.index() == 32);
        assert!(records.len() >= 2 && of_the_port.count() == records.len(), "{records:?}");
    }

    /// Answers whatever it hears, as a status of whoever was asked.
    #[derive(Debug, Default)]
    struct AnswersAll(Option<Vec<u8>>);

    impl Node<Vec<u8>> for AnswersAll {
        fn handle_frame(&mut self, byte: &Vec<u8>, _: Instant) {
            // The last byte of the probe.
            if byte.as_slice() == [0x70] {
                let mut reply = PROBE;
                // Voltage 48.0 V (0x01E0), CRC of no interest.
                reply[7..9].copy_from_slice(&[0xE0, 0x01]);
                self.0 = Some(reply.to_vec());
            }
        }

        fn poll_transmit(&mut self, _: Instant) -> Option<Vec<u8>> {
            self.0.take()
        }

        fn poll_at(&self) -> Option<Instant> {
            self.0.is_some().then_some(Instant::ZERO)
        }
    }

    #[test]
    fn an_answer_is_no_echo() {
        let world = line();
        world.attach(AnswersAll::default());
        assert!(!is_found_to_echo(&world, IS_QUIET, MILLISECOND));
        let world = line();
        world.attach(AnswersAll::default());
        assert!(is_found_to_echo(&world, ECHOES, MILLISECOND));
    }

    #[test]
    fn a_line_that_never_rests_ends_it_in_time() {
        let world = line();
        let babbler = world.attach(AnswersAll::default());
        let babble = Babble { interval: Duration::from_millis(1), frame: None };
        world.babble(babbler, Some(babble));
        assert!(!is_found_to_echo(&world, IS_QUIET, MILLISECOND));
        assert!(world.now() < Instant::from_millis(250), "{:?}", world.now());
    }

    /// As the probe, but for a motor that there can be: the two differ in address and CRC alone.
    #[test]
    fn the_probe_is_a_frame_but_for_its_address() {
        let data: Data = [0x9A, 0, 0, 0, 0, 0, 0, 0];
        let [address, crc] = [&PROBE[1..2], &PROBE[11..]];
        assert!(MotorId::new(address[0]).is_err());
        let frame = Frame { address: Target::Motor(MotorId::MIN), data }.encode();
        assert_eq!((PROBE[0], &PROBE[2..11]), (frame[0], &frame[2..11]));
        let whole = crc::Crc::<u16>::new(&crc::CRC_16_MODBUS).checksum(&PROBE[..11]);
        assert_eq!(crc, whole.to_le_bytes());
    }
}

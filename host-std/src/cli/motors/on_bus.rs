//! Which bus a command is for: `--bus`, else the one of the environment. Simulated motors are the default only for
//! commands that read: `stop` must not report that motors stand which do not exist.

use std::env;

use myactuator_host_std::BusKind;
use myactuator_host_std::open::BusAddress;

use crate::cli::{Outcome, Unfinished};

/// The environment variable that names a bus.
const VARIABLE: &str = "MYACTUATOR_BUS";

/// Which bus.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct OnBus {
    /// The bus: can0, slcan:/dev/ttyACM0@1000000, rs485:/dev/ttyUSB0@115200, or N simulated motors: sim, sim:N,
    /// sim:N,rs485. After rs485:..., ",echo" says that the adapter echoes what it sends; without it the program
    /// finds out [default: MYACTUATOR_BUS of the environment, else sim for commands that only read].
    #[arg(long, global = true, value_name = "ADDRESS")]
    bus: Option<BusAddress>,
}

impl OnBus {
    /// The bus to read from: simulated motors if none is named.
    pub(super) fn to_look(&self) -> Outcome<BusAddress> {
        let simulated = BusAddress::Simulated { motors: 4, kind: BusKind::Can };
        Ok(self.named()?.unwrap_or(simulated))
    }

    /// The bus on which to stop, move or write to motors: it must be named.
    pub(super) fn to_act(&self) -> Outcome<BusAddress> {
        self.named()?.ok_or_else(|| {
            Unfinished::Usage(format!(
                "--bus is missing: this acts on motors, so say which bus they are on, by --bus or by the \
                 environment variable {VARIABLE}: can0, slcan:/dev/ttyACM0@1000000, \
                 rs485:/dev/ttyUSB0@115200, or sim for simulated ones"
            ))
        })
    }

    fn named(&self) -> Outcome<Option<BusAddress>> {
        if let Some(bus) = &self.bus {
            return Ok(Some(bus.clone()));
        }
        match env::var_os(VARIABLE).filter(|text| !text.is_empty()) {
            None => Ok(None),
            Some(text) => match text.to_string_lossy().parse() {
                Ok(bus) => Ok(Some(bus)),
                Err(error) => Err(Unfinished::Usage(format!("{VARIABLE}: {error}"))),
            },
        }
    }
}

//! The control socket's options.

use std::path::PathBuf;

use clap::Args;
use myactuator_host_std::serve::{ServeError, Server};
use serde_json::json;

#[derive(Debug, Args)]
pub(super) struct Options {
    /// Make a socket here through which programs, and sim-control, look at the drives and change their loads, supply,
    /// faults, cables and brakes
    #[arg(long, value_name = "PATH")]
    control: Option<PathBuf>,
    /// Stop time; only a program at the control socket advances it
    #[arg(long, requires = "control")]
    lock_step: bool,
}

impl Options {
    pub(super) const fn is_in_lock_step(&self) -> bool {
        self.lock_step
    }

    /// Returns the line that says where the socket is.
    pub(super) fn apply(
        &self,
        server: &mut Server,
        is_json: bool,
    ) -> Result<Option<String>, ServeError> {
        let Some(path) = &self.control else { return Ok(None) };
        server.control_at(path)?;
        if self.lock_step {
            server.in_lock_step();
        }
        Ok(Some(if is_json {
            json!({ "kind": "control", "path": path, "lock_step": self.lock_step }).to_string()
        } else {
            let path = path.display();
            let time = if self.lock_step {
                format!(
                    "   time stands still; to advance it: myactuator sim-control {path} advance 10ms"
                )
            } else {
                String::new()
            };
            format!("{:<12} {path}{time}", "control")
        }))
    }
}

//! What a frame says: its name, its fields with their units, and a sentence for people.
//!
//! An [`Explainer`] turns a frame into an [`Explanation`], which is a JSON object ([`Explanation::to_json`]) or a line
//! of text (`Display`). [`Rs485Stream`] finds the frames in a stream of bytes and reports what was discarded. [`Dbc`]
//! writes the table of commands as a file with which other makers' tools decode.
//!
//! It uses only [`text`](crate::text): it needs no bus, real or simulated.
//!
//! ```
//! use myactuator_host_std::explain::Explainer;
//! use myactuator_host_std::protocol::Firmware;
//! use myactuator_host_std::text;
//!
//! let frame = text::can::parse_line("141#A400F401A08C0000").unwrap();
//! let explanation = Explainer::new(Firmware::V4_3).can_frame(&frame);
//! assert_eq!(
//!     explanation.to_string(),
//!     "141#A400F401A08C0000  motor 1  command  absolute-position (0xA4): max speed 500 dps, angle 360 deg"
//! );
//! assert_eq!(explanation.to_json()["fields"]["angle_deg"], 360.0);
//! ```

mod dbc;
mod explanation;
mod reading;
mod stream;
mod values;

pub use dbc::Dbc;
pub use explanation::{Decoded, Explanation, FrameDirection, Reading};
pub use reading::Explainer;
pub use stream::Rs485Stream;
pub use values::{Values, values};

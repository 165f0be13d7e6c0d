//! What a frame says: its name, its fields with their units, and a sentence for people.
//!
//! [`can_frame`] and [`rs485_frame`] give an [`Explanation`], which is a JSON object
//! ([`Explanation::to_json`]) or a line of text (`Display`). [`Rs485Stream`] finds the frames in a
//! stream of bytes and tells what was thrown away.
//!
//! Stands on [`text`](crate::text) alone: it needs no bus, real or simulated.
//!
//! ```
//! use myactuator_host_std::{explain, text};
//!
//! let frame = text::can::parse_line("141#A400F401A08C0000").unwrap();
//! let explanation = explain::can_frame(&frame, None);
//! assert_eq!(
//!     explanation.to_string(),
//!     "141#A400F401A08C0000  motor 1  command  absolute-position (0xA4): max speed 500 dps, angle 360 deg"
//! );
//! assert_eq!(explanation.to_json()["fields"]["angle_deg"], 360.0);
//! ```

mod explanation;
mod fields;
mod prose;
mod reading;
mod stream;

pub use explanation::{Decoded, Explanation, FrameDirection};
pub use fields::{Fields, command_fields, reply_fields};
pub use prose::prose;
pub use reading::{NotASender, Sender, can_frame, rs485_frame};
pub use stream::Rs485Stream;

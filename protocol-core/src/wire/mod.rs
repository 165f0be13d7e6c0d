//! How a data field is framed on each bus. No meanings here: those are [`command`](crate::command)'s.

pub mod can;
pub mod rs485;

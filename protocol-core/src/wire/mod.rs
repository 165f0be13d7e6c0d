//! How a data field is framed on each bus. What its bytes mean is in [`command`](crate::command).

pub mod can;
pub mod rs485;

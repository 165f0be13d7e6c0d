//! The rows that are printed, and whether any is over.

use core::fmt;

use cortex_m_semihosting::hprintln;

/// What a row may cost.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Limit {
    /// As much as the C beside it, in tenths.
    OfC { cost: u32, tenths: u32 },
    /// A budget of the design.
    Budget(u32),
    /// What it costs today, where that is more than the budget: it may not get worse.
    Ceiling { budget: u32, ceiling: u32 },
}

/// Prints row after row.
#[derive(Debug, Default)]
pub(crate) struct Table {
    over: u32,
}

impl Table {
    /// The line above rows.
    pub(crate) fn head(&self, what: &str) {
        hprintln!("{:<40} {:>6} {:>6} {:>6}", what, "spent", "C", "budget");
    }

    /// A row.
    pub(crate) fn row(&mut self, name: impl fmt::Display, spent: u32, limit: Limit) {
        let (budget, most) = match limit {
            Limit::OfC { cost, tenths } => (cost * tenths / 10, cost * tenths / 10),
            Limit::Budget(budget) => (budget, budget),
            Limit::Ceiling { budget, ceiling } => (budget, ceiling),
        };
        let verdict = match spent {
            _ if spent > most => " TOO MANY",
            _ if spent > budget => " (over budget)",
            _ => "",
        };
        self.over += u32::from(spent > most);
        match limit {
            Limit::OfC { cost, .. } => {
                hprintln!("{:<40} {:>6} {:>6} {:>6}{}", name, spent, cost, budget, verdict);
            }
            _ => hprintln!("{:<40} {:>6} {:>6} {:>6}{}", name, spent, "", budget, verdict),
        }
    }

    /// How many rows were over.
    pub(crate) fn over(&self) -> u32 {
        self.over
    }
}

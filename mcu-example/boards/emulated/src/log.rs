//! The output of defmt: semihosting, with one call for each report.
//!
//! The emulator stops during each call, with interrupts off, and the motors wait. `defmt-semihosting` makes one call
//! for each byte.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m_semihosting::hio;
use critical_section::RestoreState;
use defmt::Encoder;
use heapless::Vec;

/// Longer than any report here. A longer one takes more than one call.
const REPORT_BYTES: usize = 128;

#[defmt::global_logger]
struct Logger;

struct Log {
    is_taken: AtomicBool,
    report: UnsafeCell<Report>,
}

/// Belongs to the holder of the log.
struct Report {
    interrupts: RestoreState,
    encoder: Encoder,
    encoded: Vec<u8, REPORT_BYTES>,
}

static LOG: Log = Log {
    is_taken: AtomicBool::new(false),
    report: UnsafeCell::new(Report {
        interrupts: RestoreState::invalid(),
        encoder: Encoder::new(),
        encoded: Vec::new(),
    }),
};

// SAFETY: the report is touched only between `acquire` and `release`, with interrupts off, on a
// processor that has one thread.
unsafe impl Sync for Log {}

impl Log {
    /// # Safety
    /// The log has to be taken, and the report must not be in use.
    #[expect(clippy::mut_from_ref, reason = "that is what taking it is for")]
    unsafe fn report(&self) -> &mut Report {
        // SAFETY: the caller has exclusive access.
        unsafe { &mut *self.report.get() }
    }
}

// SAFETY: between `acquire` and `release` nothing else runs.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: `release` restores what this returns.
        let interrupts = unsafe { critical_section::acquire() };
        assert!(!LOG.is_taken.swap(true, Ordering::Relaxed), "a report within a report");
        // SAFETY: it was taken just now.
        let report = unsafe { LOG.report() };
        report.interrupts = interrupts;
        report.encoder.start_frame(|bytes| push(&mut report.encoded, bytes));
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: the caller has acquired the log.
        let report = unsafe { LOG.report() };
        report.encoder.write(bytes, |bytes| push(&mut report.encoded, bytes));
    }

    /// Nothing is left to flush when a report is over.
    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: the caller has acquired the log.
        let report = unsafe { LOG.report() };
        report.encoder.end_frame(|bytes| push(&mut report.encoded, bytes));
        send(&mut report.encoded);
        let interrupts = report.interrupts;
        LOG.is_taken.store(false, Ordering::Relaxed);
        // SAFETY: it is what `acquire` was given.
        unsafe { critical_section::release(interrupts) }
    }
}

fn push(encoded: &mut Vec<u8, REPORT_BYTES>, bytes: &[u8]) {
    for &byte in bytes {
        if encoded.is_full() {
            send(encoded);
        }
        // There is room by now.
        let _ = encoded.push(byte);
    }
}

/// Output that is not taken is lost.
fn send(encoded: &mut Vec<u8, REPORT_BYTES>) {
    if let Ok(mut host) = hio::hstdout() {
        let _ = host.write_all(encoded);
    }
    encoded.clear();
}

//! What happens to a loop when work on it is left halfway.

/// What work is done on, and what is done to it when this is dropped, by a future that is dropped or by a panic that
/// unwinds.
pub(super) struct OnDrop<T, F: Fn(&mut T)> {
    pub(super) it: T,
    act: F,
}

impl<T, F: Fn(&mut T)> OnDrop<T, F> {
    pub(super) fn new(it: T, act: F) -> Self {
        Self { it, act }
    }

    /// Ends the work: nothing is done to `it`.
    pub(super) fn end(self) {
        core::mem::forget(self);
    }
}

impl<T, F: Fn(&mut T)> Drop for OnDrop<T, F> {
    fn drop(&mut self) {
        (self.act)(&mut self.it);
    }
}

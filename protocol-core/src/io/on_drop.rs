//! What becomes of a loop when work on it is left halfway.

/// A loop, and what is done to it when this is dropped: by a future that is, or by a panic that unwinds.
pub(super) struct OnDrop<'a, R, F: Fn(&mut R)> {
    pub(super) runner: &'a mut R,
    act: F,
}

impl<'a, R, F: Fn(&mut R)> OnDrop<'a, R, F> {
    pub(super) fn new(runner: &'a mut R, act: F) -> Self {
        Self { runner, act }
    }

    /// The work has come to its end, so that nothing is done.
    pub(super) fn end(self) {
        core::mem::forget(self);
    }
}

impl<R, F: Fn(&mut R)> Drop for OnDrop<'_, R, F> {
    fn drop(&mut self) {
        (self.act)(self.runner);
    }
}

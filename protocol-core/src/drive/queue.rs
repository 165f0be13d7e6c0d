//! Bounded queues that lose the oldest entry rather than the newest.

use heapless::Deque;

/// A queue of at most `N` entries. When it is full, it drops its oldest entry and counts it.
#[derive(Clone, Debug)]
pub(super) struct DropOldest<T, const N: usize> {
    entries: Deque<T, N>,
    dropped: u32,
}

impl<T, const N: usize> DropOldest<T, N> {
    pub(super) const fn new() -> Self {
        Self { entries: Deque::new(), dropped: 0 }
    }

    pub(super) fn push(&mut self, entry: T) {
        if self.entries.is_full() {
            self.entries.pop_front();
            self.dropped = self.dropped.saturating_add(1);
        }
        let _ = self.entries.push_back(entry);
    }

    pub(super) fn pop(&mut self) -> Option<T> {
        self.entries.pop_front()
    }

    pub(super) fn first(&self) -> Option<&T> {
        self.entries.front()
    }

    pub(super) fn clear(&mut self) {
        self.entries.clear();
    }

    pub(super) const fn dropped(&self) -> u32 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_gives_way_and_is_counted() {
        let mut queue = DropOldest::<u8, 2>::new();
        for entry in 1..=4 {
            queue.push(entry);
        }
        assert_eq!((queue.first(), queue.dropped()), (Some(&3), 2));
        assert_eq!((queue.pop(), queue.pop(), queue.pop()), (Some(3), Some(4), None));
    }
}

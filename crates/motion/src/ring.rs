//! A queue of fixed capacity whose items keep their number while others are pushed and popped.
//!
//! Numbers wrap at 2^32; the capacity is a power of two, so that a number's place survives the wrap.

/// Queue of at most `N` items, counted from the first that was ever pushed.
#[derive(Clone, Debug)]
pub(crate) struct Ring<T, const N: usize> {
    items: [T; N],
    first: u32,
    length: u32,
}

impl<T: Copy, const N: usize> Ring<T, N> {
    const CAPACITY: u32 = {
        assert!(N.is_power_of_two() && N <= 1 << 16);
        N as u32
    };

    /// An empty ring; `filler` fills the unused places.
    pub(crate) const fn new(filler: T) -> Self {
        Self {
            items: [filler; N],
            first: 0,
            length: 0,
        }
    }

    /// Number of the first item.
    pub(crate) fn first(&self) -> u32 {
        self.first
    }

    /// Number that the next item pushed will have.
    pub(crate) fn end(&self) -> u32 {
        self.first.wrapping_add(self.length)
    }

    pub(crate) fn length(&self) -> usize {
        self.length as usize
    }

    pub(crate) fn room(&self) -> usize {
        (Self::CAPACITY - self.length) as usize
    }

    /// The item with a number, if the ring still holds it.
    pub(crate) fn get(&self, number: u32) -> Option<&T> {
        if number.wrapping_sub(self.first) < self.length {
            self.items.get(number as usize % N)
        } else {
            None
        }
    }

    pub(crate) fn get_mut(&mut self, number: u32) -> Option<&mut T> {
        if number.wrapping_sub(self.first) < self.length {
            self.items.get_mut(number as usize % N)
        } else {
            None
        }
    }

    pub(crate) fn last_mut(&mut self) -> Option<&mut T> {
        self.get_mut(self.end().wrapping_sub(1))
    }

    /// Appends an item; returns `false` and changes nothing if there is no room.
    pub(crate) fn push(&mut self, item: T) -> bool {
        if self.room() == 0 {
            return false;
        }
        let end = self.end() as usize % N;
        if let Some(place) = self.items.get_mut(end) {
            *place = item;
        }
        self.length += 1;
        true
    }

    /// Removes the first item.
    pub(crate) fn pop(&mut self) -> Option<T> {
        let item = self.get(self.first).copied()?;
        self.first = self.first.wrapping_add(1);
        self.length -= 1;
        Some(item)
    }

    /// Removes the items before a number.
    pub(crate) fn forget_before(&mut self, number: u32) {
        while self.length > 0 && number.wrapping_sub(self.first).wrapping_sub(1) < Self::CAPACITY {
            self.pop();
        }
    }

    pub(crate) fn clear(&mut self) {
        self.first = self.end();
        self.length = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_keep_their_number_until_they_are_removed_also_over_the_wrap() {
        let mut ring = Ring::<u32, 4>::new(0);
        ring.first = u32::MAX - 1;
        for value in 0..4 {
            assert!(ring.push(value));
        }
        assert!(!ring.push(9));
        assert_eq!(
            (ring.get(u32::MAX - 1), ring.get(1), ring.get(2)),
            (Some(&0), Some(&3), None)
        );
        ring.forget_before(0);
        assert_eq!((ring.length(), ring.pop(), ring.end()), (2, Some(2), 2));
        ring.clear();
        assert_eq!((ring.pop(), ring.first(), ring.room()), (None, 2, 4));
    }
}

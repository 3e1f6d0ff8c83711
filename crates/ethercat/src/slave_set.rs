//! Sets of slaves: one bit for each place in the chain.
//!
//! Invariant: a place beyond [`SlaveSet::PLACES`] belongs to no set.

use core::ops::{BitOr, BitOrAssign};

/// A set of places in the chain, counted from 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SlaveSet(u64);

impl SlaveSet {
    /// Most places of a set.
    pub const PLACES: usize = u64::BITS as usize;
    /// No place.
    pub const NONE: Self = Self(0);
    /// All places.
    pub const ALL: Self = Self(u64::MAX);

    /// The set of one place; empty for a place beyond [`Self::PLACES`].
    #[inline]
    pub const fn of(place: usize) -> Self {
        if place < Self::PLACES {
            Self(1 << place)
        } else {
            Self::NONE
        }
    }

    /// The set of some places; those beyond [`Self::PLACES`] are left out.
    pub const fn places(places: &[usize]) -> Self {
        let (mut set, mut rest) = (Self::NONE, places);
        while let [place, behind @ ..] = rest {
            set = Self(set.0 | Self::of(*place).0);
            rest = behind;
        }
        set
    }

    /// Whether a place belongs to the set.
    #[inline]
    pub const fn contains(self, place: usize) -> bool {
        self.0 & Self::of(place).0 != 0
    }

    /// Whether the set has no place.
    #[inline]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The last place; `None` without one.
    pub const fn last(self) -> Option<usize> {
        match self.0.checked_ilog2() {
            Some(place) => Some(place as usize),
            None => None,
        }
    }

    /// Number of places.
    #[cold]
    #[inline(never)]
    pub const fn count(self) -> u32 {
        self.0.count_ones()
    }

    /// Those of the first 32 places, one bit each.
    #[inline]
    pub(crate) const fn first(self) -> u32 {
        self.0 as u32
    }

    /// The places that also belong to another set.
    #[inline]
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// The places that do not belong to another set.
    #[inline]
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }
}

/// A set of places in the chain, as narrow as the places allow.
pub(crate) trait Places: Copy + PartialEq + BitOrAssign {
    /// No place.
    const NONE: Self;

    /// The set of one place.
    fn of(place: usize) -> Self;

    /// The places that do not belong to another set.
    fn without(self, other: Self) -> Self;

    /// Number of places.
    fn count(self) -> u32;
}

/// The first 32 places.
impl Places for u32 {
    const NONE: Self = 0;

    #[inline(always)]
    fn of(place: usize) -> Self {
        1 << (place & 31)
    }

    #[inline(always)]
    fn without(self, other: Self) -> Self {
        self & !other
    }

    #[inline(always)]
    fn count(self) -> u32 {
        self.count_ones()
    }
}

impl Places for SlaveSet {
    const NONE: Self = Self::NONE;

    #[inline]
    fn of(place: usize) -> Self {
        Self::of(place)
    }

    #[inline]
    fn without(self, other: Self) -> Self {
        self.without(other)
    }

    #[inline]
    fn count(self) -> u32 {
        self.count()
    }
}

/// The set of the places whose bits are set.
impl From<u32> for SlaveSet {
    #[inline]
    fn from(places: u32) -> Self {
        Self(places.into())
    }
}

impl BitOr for SlaveSet {
    type Output = Self;

    #[inline]
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for SlaveSet {
    #[inline]
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl FromIterator<usize> for SlaveSet {
    fn from_iter<T: IntoIterator<Item = usize>>(places: T) -> Self {
        places.into_iter().fold(Self::NONE, |set, place| set | Self::of(place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_has_the_places_that_were_put_into_it_and_no_other() {
        const SET: SlaveSet = SlaveSet::places(&[0, 5, 63, 64, 1_000]);
        for place in 0..200 {
            assert_eq!(SET.contains(place), [0, 5, 63].contains(&place), "{place}");
            assert!(!SlaveSet::NONE.contains(place));
            assert_eq!(SlaveSet::ALL.contains(place), place < 64);
        }
        assert_eq!(
            (SET.last(), SlaveSet::NONE.last(), SlaveSet::of(0).last()),
            (Some(63), None, Some(0))
        );
        assert_eq!((SET.count(), SET), (3, [63, 0, 5, 64].into_iter().collect()));
    }

    #[test]
    fn sets_are_united_cut_and_subtracted() {
        let (low, high) = (SlaveSet::places(&[1, 2]), SlaveSet::places(&[2, 63]));
        assert_eq!(low | high, SlaveSet::places(&[1, 2, 63]));
        assert_eq!(low.and(high), SlaveSet::of(2));
        assert_eq!(low.without(high), SlaveSet::of(1));
        assert!(low.without(SlaveSet::ALL).is_empty() && !low.is_empty());
    }
}

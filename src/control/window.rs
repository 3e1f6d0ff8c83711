//! The sampler's look-ahead: setpoints of this millisecond and the next ones.
//!
//! Invariant: a setpoint is copied once, from the queue into the window, and stays at its place until its time is
//! over.

use super::cycle::Queued;
use super::position::Place;
use crate::ethercat::queue;
use crate::motion::Setpoint;
use crate::robots::AXES;
use heapless::spsc::Consumer;

/// Number of setpoints of the look-ahead, for the velocity feed-forward.
pub(super) const LOOK_AHEAD: usize = 12;
/// Most setpoints taken from the queue or discarded in a millisecond: at a start the window fills in two.
const TAKEN_MAX: usize = 8;
/// Slots of the window: a power of two, so that an index is wrapped by a mask.
const SLOTS: usize = LOOK_AHEAD.next_power_of_two();

/// Setpoints of this millisecond and the next ones.
#[derive(Debug)]
pub(super) struct Window {
    setpoints: [Setpoint; SLOTS],
    first: usize,
    length: usize,
}

impl Window {
    pub(super) fn new() -> Self {
        Self {
            setpoints: [Setpoint::default(); SLOTS],
            first: 0,
            length: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.length = 0;
    }

    pub(super) fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Number of setpoints.
    pub(super) fn length(&self) -> usize {
        self.length
    }

    /// The setpoint so many milliseconds from this one on; `None` after the end.
    pub(super) fn get(&self, ahead: usize) -> Option<&Setpoint> {
        (ahead < self.length).then(|| &self.setpoints[(self.first + ahead) % SLOTS])
    }

    /// Discards the setpoints behind the first `length`.
    pub(super) fn truncate(&mut self, length: usize) {
        self.length = self.length.min(length);
    }

    /// Removes the first setpoint.
    #[inline]
    pub(super) fn advance(&mut self) {
        if self.length > 0 {
            self.first = (self.first + 1) % SLOTS;
            self.length -= 1;
        }
    }

    /// Takes the setpoints of a start from the queue while there is room, and discards those of other starts.
    #[inline]
    pub(super) fn fill(&mut self, setpoints: &mut Consumer<'_, Queued>, epoch: u8) {
        for _ in 0..TAKEN_MAX {
            if self.length >= LOOK_AHEAD {
                return;
            }
            let Some(queued) = queue::front(setpoints) else {
                return;
            };
            if queued.epoch == epoch {
                self.setpoints[(self.first + self.length) % SLOTS] = queued.setpoint;
                self.length += 1;
            }
            queue::drop_front(setpoints);
        }
    }

    /// Whether there is room for another setpoint.
    pub(super) fn has_room(&self) -> bool {
        self.length < LOOK_AHEAD
    }

    /// Adds a setpoint behind the others, if there is room.
    pub(super) fn push(&mut self, setpoint: &Setpoint) {
        if self.has_room() {
            self.setpoints[(self.first + self.length) % SLOTS] = *setpoint;
            self.length += 1;
        }
    }

    /// This millisecond's setpoint.
    #[inline]
    pub(super) fn first(&self) -> Option<&Setpoint> {
        (self.length > 0).then(|| &self.setpoints[self.first % SLOTS])
    }

    /// Velocities of all axes `whole` milliseconds from this one on, and a millisecond later, rad/s. After the end the
    /// last velocities are used; without any they are 0.
    #[inline]
    pub(super) fn velocities_around(&self, whole: usize) -> [&[f64; AXES]; 2] {
        let Some(last) = self.length.checked_sub(1) else {
            return [&[0.0; AXES]; 2];
        };
        [whole, whole + 1].map(|ahead| &self.setpoints[(self.first + ahead.min(last)) % SLOTS].velocity_rad_s)
    }

    /// Position of an axis `place` milliseconds from this one on, rad. After the end the last position is used; `None`
    /// without setpoints.
    pub(super) fn position_rad(&self, axis: usize, place: Place) -> Option<f64> {
        let last = self.length.checked_sub(1)?;
        let [low, high] = [place.whole, place.whole + 1].map(|ahead| {
            let setpoint = &self.setpoints[(self.first + ahead.min(last)) % SLOTS];
            setpoint.position_rad.get(axis).copied()
        });
        Some(place.between(low?, high?))
    }

    /// An axis's velocities from this millisecond on, rad/s.
    pub(super) fn velocities_rad_s(&self, axis: usize) -> impl Iterator<Item = f64> {
        (0..self.length).map(move |ahead| {
            let setpoint = &self.setpoints[(self.first + ahead) % SLOTS];
            setpoint.velocity_rad_s.get(axis).copied().unwrap_or(0.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heapless::spsc::Queue;

    /// Setpoint of a start, with this velocity of all axes.
    fn queued(epoch: u8, velocity_rad_s: f64) -> Queued {
        let setpoint = Setpoint {
            velocity_rad_s: [velocity_rad_s; AXES],
            ..Setpoint::default()
        };
        Queued { epoch, setpoint }
    }

    #[test]
    fn after_the_end_the_last_velocities_are_used_and_none_of_earlier_setpoints() {
        let mut queue = Queue::<Queued, 8>::new();
        let (mut producer, mut consumer) = queue.split();
        let mut window = Window::new();
        assert_eq!(window.velocities_around(0), [&[0.0; AXES]; 2]);
        for velocity_rad_s in [7.0, 8.0, 9.0, 10.0, 11.0] {
            assert!(producer.enqueue(queued(1, velocity_rad_s)).is_ok());
        }
        window.fill(&mut consumer, 1);
        window.clear();
        for velocity_rad_s in [1.0, 2.0, 3.0] {
            assert!(producer.enqueue(queued(2, velocity_rad_s)).is_ok());
        }
        window.fill(&mut consumer, 2);
        for (whole, expected) in [(0, [1.0, 2.0]), (1, [2.0, 3.0]), (2, [3.0, 3.0]), (9, [3.0, 3.0])] {
            let expected = expected.map(|velocity_rad_s| [velocity_rad_s; AXES]);
            assert_eq!(
                window.velocities_around(whole).map(|velocities| *velocities),
                expected,
                "{whole} ms ahead"
            );
        }
    }

    #[test]
    fn a_position_ahead_is_interpolated_and_stays_at_the_last() {
        let mut queue = Queue::<Queued, 8>::new();
        let (mut producer, mut consumer) = queue.split();
        let mut window = Window::new();
        assert_eq!(window.position_rad(1, Place::new(2.0)), None);
        for position_rad in [1.0, 2.0, 4.0] {
            let mut queued = queued(1, 0.0);
            queued.setpoint.position_rad = [0.0, position_rad, 0.0, 0.0];
            assert!(producer.enqueue(queued).is_ok());
        }
        window.fill(&mut consumer, 1);
        for (ahead_ms, expected_rad) in [(0.0, 1.0), (0.25, 1.25), (1.5, 3.0), (2.0, 4.0), (9.5, 4.0)] {
            assert_eq!(
                window.position_rad(1, Place::new(ahead_ms)),
                Some(expected_rad),
                "{ahead_ms} ms ahead"
            );
        }
        window.clear();
        assert_eq!(window.position_rad(1, Place::new(0.0)), None);
    }

    #[test]
    fn setpoints_of_another_start_are_discarded() {
        let mut queue = Queue::<Queued, 8>::new();
        let (mut producer, mut consumer) = queue.split();
        for (epoch, velocity_rad_s) in [(1, 5.0), (2, 6.0), (1, 7.0)] {
            assert!(producer.enqueue(queued(epoch, velocity_rad_s)).is_ok());
        }
        let mut window = Window::new();
        window.fill(&mut consumer, 2);
        assert_eq!(
            window.first().map(|setpoint| setpoint.velocity_rad_s),
            Some([6.0; AXES])
        );
        window.advance();
        assert!(window.is_empty() && window.first().is_none());
    }
}

//! Makes a failing episode small: fewer events, wishes and values, earlier, with less to draw.
//!
//! A change is kept if the smaller episode still breaks the same rule. Each kind of change is tried until none helps.

use super::episode::{Episode, Figure};
use super::{Failure, Rule, run};

/// Most episodes that are run to make one smaller.
const TRIES_MAX: usize = 400;
/// Time that stays behind a failure before the healing, ms.
const REST_MS: u32 = 10;

/// The healing is not moved by less than this, ms.
const HEALING_STEP_MS: u32 = 100;

/// The search for a smaller episode.
struct Search<'p> {
    best: Episode,
    failure: Failure,
    tries: usize,
    progress: &'p mut dyn FnMut(usize),
}

impl Search<'_> {
    /// Keeps `candidate` if it breaks the same rule.
    fn attempt(&mut self, candidate: Episode) -> bool {
        if self.tries >= TRIES_MAX || candidate == self.best {
            return false;
        }
        self.tries += 1;
        (self.progress)(self.tries);
        match run(&candidate).failure {
            Some(failure) if failure.rule == self.failure.rule => {
                (self.best, self.failure) = (candidate, failure);
                true
            }
            _ => false,
        }
    }

    /// Removes runs of items, long ones first.
    fn remove<T: Clone>(&mut self, items: fn(&mut Episode) -> &mut Vec<T>) {
        let mut length = items(&mut self.best).len();
        while length > 0 {
            let mut at = 0;
            while at < items(&mut self.best).len() {
                let mut smaller = self.best.clone();
                let all = items(&mut smaller);
                all.drain(at..(at + length).min(all.len()));
                if !self.attempt(smaller) {
                    at += length;
                }
            }
            length /= 2;
        }
    }

    /// Takes values of the configuration back to their defaults: those of a group together, because a machine may be none with
    /// some of them only, then one after the other.
    fn reset_values(&mut self) {
        for (table, name) in groups(&self.best) {
            let mut smaller = self.best.clone();
            smaller.config.retain(|place, _| group(place) != (&table, &name));
            self.attempt(smaller);
        }
        for place in self.best.config.keys().cloned().collect::<Vec<_>>() {
            let mut smaller = self.best.clone();
            smaller.config.remove(&place);
            self.attempt(smaller);
        }
    }

    /// Ends the episode when it fails, or heals it soon after its last event.
    fn end_earlier(&mut self) {
        if self.failure.rule != Rule::Liveness {
            if self.failure.time_ms < self.best.duration_ms {
                let mut shorter = self.best.clone();
                shorter.duration_ms = self.failure.time_ms + REST_MS;
                shorter.events.retain(|event| event.at_ms <= shorter.duration_ms);
                self.attempt(shorter);
            }
            return;
        }
        let least_ms = self.best.events.last().map_or(0, |event| event.at_ms) + REST_MS;
        let mut step_ms = self.best.duration_ms.saturating_sub(least_ms);
        while step_ms > HEALING_STEP_MS {
            let mut shorter = self.best.clone();
            shorter.duration_ms -= step_ms;
            step_ms = match self.attempt(shorter) {
                true => step_ms.min(self.best.duration_ms.saturating_sub(least_ms)),
                false => step_ms / 2,
            };
        }
    }

    /// Moves events to earlier times.
    fn shorten(&mut self) {
        for index in 0..self.best.events.len() {
            let floor_ms = if index == 0 {
                0
            } else {
                self.best.events[index - 1].at_ms
            };
            let mut step_ms = self.best.events[index].at_ms - floor_ms;
            while step_ms > 0 {
                let mut earlier = self.best.clone();
                earlier.events[index..]
                    .iter_mut()
                    .for_each(|event| event.at_ms = event.at_ms.saturating_sub(step_ms));
                let still_in_order = earlier.events[index].at_ms >= floor_ms;
                if !(still_in_order && self.attempt(earlier)) {
                    step_ms /= 2;
                }
            }
        }
    }

    /// Removes strokes and points from the drawings.
    fn simplify_figures(&mut self) {
        for figure in 0..self.best.figures.len() {
            for stroke in (0..self.best.figures[figure].0.len()).rev() {
                let mut smaller = self.best.clone();
                smaller.figures[figure].0.remove(stroke);
                self.attempt(smaller);
            }
            for stroke in 0..self.best.figures[figure].0.len() {
                while self.halve_points(figure, stroke) {}
            }
        }
        let mut without = self.best.clone();
        let drawn = without
            .wishes
            .iter()
            .any(|wish| matches!(wish, super::episode::Wish::Draw(_)));
        if !drawn {
            without
                .figures
                .iter_mut()
                .for_each(|figure| *figure = Figure::default());
            self.attempt(without);
        }
    }

    fn halve_points(&mut self, figure: usize, stroke: usize) -> bool {
        let points = self.best.figures[figure].0[stroke].len();
        let mut smaller = self.best.clone();
        smaller.figures[figure].0[stroke].truncate(points.div_ceil(2).max(2));
        points > 2 && self.attempt(smaller)
    }
}

/// The values that belong together with the one of this place: a table, or equal values of all axes.
fn group(place: &str) -> (&str, &str) {
    match place.split_once('.') {
        Some(("axes", value)) => ("axes", value.split_once('.').map_or(value, |(_, name)| name)),
        Some((table, _)) => (table, ""),
        None => (place, ""),
    }
}

/// The groups of an episode's values, each once.
fn groups(episode: &Episode) -> Vec<(String, String)> {
    let owned = |(table, name): (&str, &str)| (table.to_owned(), name.to_owned());
    let mut groups: Vec<_> = episode.config.keys().map(|place| owned(group(place))).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// A small episode that breaks the same rule as `episode`, and what it finds; `None` if `episode` does not fail.
/// `progress` gets the number of episodes tried.
pub fn shrink(episode: &Episode, progress: &mut dyn FnMut(usize)) -> Option<(Episode, Failure)> {
    let failure = run(episode).failure?;
    let mut search = Search {
        best: episode.clone(),
        failure,
        tries: 0,
        progress,
    };
    loop {
        let before = search.best.clone();
        search.end_earlier();
        search.remove(|episode| &mut episode.events);
        search.remove(|episode| &mut episode.wishes);
        search.reset_values();
        search.shorten();
        search.simplify_figures();
        if search.best == before {
            search.best.found = search.failure.to_string();
            return Some((search.best, search.failure));
        }
    }
}

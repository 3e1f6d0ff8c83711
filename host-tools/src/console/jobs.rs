//! Drawings: the one that is drawn, those that wait, those that are past.
//!
//! A waiting drawing begins when somebody says so: between two drawings the paper has to be changed. Invariants: at most
//! one drawing is active; the past keeps its last entries only.

use crate::link::progress::Progress;
use etherpen::link::protocol::PathVertex;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::Arc;

/// Drawings that may wait.
const WAITING_MAX: usize = 20;
/// Past drawings that are kept.
const PAST_MAX: usize = 50;

/// A drawing that can be drawn.
#[derive(Clone, Debug)]
pub struct Drawing {
    /// What a person calls it.
    pub name: String,
    /// The path, every vertex admitted.
    pub path: Arc<[PathVertex]>,
    /// Strokes.
    pub strokes: u32,
    /// Duration that the planner computed, s; not a number where it could not.
    pub planned_s: f64,
}

struct Job {
    number: u64,
    drawing: Drawing,
}

#[derive(Clone, Debug, Serialize)]
struct JobView {
    number: u64,
    name: String,
    strokes: u32,
    planned_s: f64,
}

impl JobView {
    fn of(job: &Job) -> Self {
        Self {
            number: job.number,
            name: job.drawing.name.clone(),
            strokes: job.drawing.strokes,
            planned_s: job.drawing.planned_s,
        }
    }
}

#[derive(Clone, Debug, Serialize)]
struct PastView {
    #[serde(flatten)]
    job: JobView,
    done: bool,
    text: String,
    drawn_s: f64,
}

/// What the page shows of the drawings.
#[derive(Debug, Serialize)]
pub struct JobsView {
    active: Option<JobView>,
    phase: String,
    waiting: Vec<JobView>,
    past: Vec<PastView>,
}

/// What the page shows of the progress.
#[derive(Debug, Serialize)]
pub struct ProgressView {
    job: u64,
    executed: usize,
    vertices: usize,
    strokes: u32,
    strokes_total: u32,
    executed_mm: f64,
    total_mm: f64,
    elapsed_s: f64,
    left_s: f64,
}

/// All drawings.
#[derive(Default)]
pub struct Jobs {
    active: Option<Job>,
    /// The drawing that was active last.
    last: Option<Job>,
    phase: String,
    waiting: Vec<Job>,
    past: VecDeque<PastView>,
    next: u64,
    elapsed_s: f64,
}

impl Jobs {
    /// None yet.
    pub fn new() -> Self {
        Self {
            active: None,
            last: None,
            phase: String::new(),
            waiting: Vec::new(),
            past: VecDeque::new(),
            next: 1,
            elapsed_s: 0.0,
        }
    }

    /// Lets a drawing wait; gives its number, or `None` where too many wait.
    pub fn enqueue(&mut self, drawing: Drawing) -> Option<u64> {
        if self.waiting.len() >= WAITING_MAX {
            return None;
        }
        let number = self.next;
        self.next += 1;
        self.waiting.push(Job { number, drawing });
        Some(number)
    }

    /// Forgets a waiting drawing; gives whether there was one.
    pub fn discard(&mut self, number: u64) -> bool {
        let before = self.waiting.len();
        self.waiting.retain(|job| job.number != number);
        self.waiting.len() < before
    }

    /// Makes a waiting drawing the active one; gives its name and path. `None` while another is active.
    pub fn start(&mut self, number: u64) -> Option<(String, Arc<[PathVertex]>)> {
        if self.active.is_some() {
            return None;
        }
        let index = self.waiting.iter().position(|job| job.number == number)?;
        let job = self.waiting.remove(index);
        let begun = (job.drawing.name.clone(), job.drawing.path.clone());
        self.active = Some(job);
        self.phase = "starting".to_owned();
        self.elapsed_s = 0.0;
        Some(begun)
    }

    /// Number of the active drawing.
    pub fn active(&self) -> Option<u64> {
        self.active.as_ref().map(|job| job.number)
    }

    /// Number and path of the drawing on the sheet: the active one, or the last that was.
    pub fn on_sheet(&self) -> Option<(u64, Arc<[PathVertex]>)> {
        let job = self.active.as_ref().or(self.last.as_ref())?;
        Some((job.number, job.drawing.path.clone()))
    }

    /// What the active drawing is doing.
    pub fn phase(&mut self, phase: impl Into<String>) {
        self.phase = phase.into();
    }

    /// How far the active drawing is.
    pub fn progress(&mut self, progress: &Progress) -> Option<ProgressView> {
        let job = self.active.as_ref()?;
        self.elapsed_s = progress.elapsed_s;
        Some(ProgressView {
            job: job.number,
            executed: progress.vertices,
            vertices: progress.vertices_total,
            strokes: progress.strokes,
            strokes_total: progress.strokes_total,
            executed_mm: progress.executed_mm,
            total_mm: progress.total_mm,
            elapsed_s: progress.elapsed_s,
            left_s: progress.left_s,
        })
    }

    /// The active drawing has ended.
    pub fn end(&mut self, done: bool, text: impl Into<String>) {
        let Some(job) = self.active.take() else { return };
        self.phase.clear();
        self.past.push_front(PastView {
            job: JobView::of(&job),
            done,
            text: text.into(),
            drawn_s: self.elapsed_s,
        });
        self.past.truncate(PAST_MAX);
        self.last = Some(job);
    }

    /// What the page shows.
    pub fn view(&self) -> JobsView {
        JobsView {
            active: self.active.as_ref().map(JobView::of),
            phase: self.phase.clone(),
            waiting: self.waiting.iter().map(JobView::of).collect(),
            past: self.past.iter().cloned().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::motion::Pen;

    fn drawing() -> Drawing {
        let vertex = |x_mm: i32| PathVertex {
            position_um: [x_mm * 1_000, 0, -850_000],
            pen: Pen::Down,
            stroke: 0,
        };
        Drawing {
            name: "line".to_owned(),
            path: (0..10).map(vertex).collect(),
            strokes: 1,
            planned_s: 1.0,
        }
    }

    #[test]
    fn one_drawing_is_active_and_the_others_wait_until_they_are_started() {
        let mut jobs = Jobs::new();
        let (first, second) = (jobs.enqueue(drawing()).unwrap(), jobs.enqueue(drawing()).unwrap());
        assert!(jobs.start(first).is_some());
        assert!(jobs.start(second).is_none());
        let progress = Progress {
            vertices: 10,
            elapsed_s: 2.0,
            ..Progress::default()
        };
        assert_eq!(jobs.progress(&progress).map(|view| view.executed), Some(10));
        jobs.end(true, "drawn");
        assert_eq!(jobs.active(), None);
        assert_eq!(jobs.on_sheet().map(|(number, _)| number), Some(first));
        assert!(jobs.start(second).is_some());
        assert_eq!(jobs.view().past.first().map(|past| past.drawn_s), Some(2.0));
    }

    #[test]
    fn queue_and_past_are_bounded() {
        let mut jobs = Jobs::new();
        for _ in 0..2 * PAST_MAX {
            let number = jobs.enqueue(drawing()).unwrap();
            jobs.start(number);
            jobs.end(false, "cancelled");
        }
        assert_eq!(jobs.view().past.len(), PAST_MAX);
        assert!((0..WAITING_MAX).all(|_| jobs.enqueue(drawing()).is_some()));
        assert_eq!(jobs.enqueue(drawing()), None);
        let number = jobs.view().waiting.first().map(|job| job.number).unwrap();
        assert!(jobs.discard(number) && !jobs.discard(number));
    }
}

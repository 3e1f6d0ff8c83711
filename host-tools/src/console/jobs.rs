//! Drawings: active, waiting and past ones.
//!
//! A waiting drawing starts only on request: the paper has to be changed between two drawings. A drawing that ended
//! early can continue where telemetry saw its ink end; the last millimetre is drawn again. Invariants: at most one
//! drawing is active; waiting drawings are bounded in number and length; only the last entries of the past are kept,
//! and only the paths of the last unfinished ones.

use super::signals::SignalRow;
use crate::job::ink::Ink;
use crate::job::progress::{PathMeasure, Progress};
use crate::job::remainder::{OVERLAP_UM, Remainder};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::Arc;

/// Most waiting drawings.
const WAITING_MAX: usize = 20;
/// Most past drawings kept.
const PAST_MAX: usize = 50;
/// Most vertices of all waiting drawings, and of all unfinished ones kept: 32 MB each.
const VERTICES_MAX: usize = 1_600_000;

/// A drawing ready to be drawn.
#[derive(Clone, Debug)]
pub struct PreparedDrawing {
    /// Name for display.
    pub name: String,
    /// The path, every vertex admitted.
    pub path: Arc<[PathVertex]>,
    /// Number of strokes.
    pub strokes: u32,
    /// Duration computed by the planner, s; NaN if it could not be computed.
    pub planned_s: f64,
}

struct QueuedDrawing {
    number: u64,
    drawing: PreparedDrawing,
    ink: Ink,
    measure: PathMeasure,
    /// The remainder since the drawing was continued, and the vertices executed before.
    rest: Option<(Remainder, usize)>,
    /// Executed vertices of the complete path.
    executed: usize,
    /// Drawing time before the drawing was continued, s.
    drawn_before_s: f64,
}

impl QueuedDrawing {
    fn new(number: u64, drawing: PreparedDrawing) -> Self {
        Self {
            number,
            ink: Ink::new(drawing.path.clone()),
            measure: PathMeasure::default(),
            rest: None,
            executed: 0,
            drawn_before_s: 0.0,
            drawing,
        }
    }

    /// Progress along the complete path, from the progress of the part being drawn.
    fn whole(&mut self, progress: &Progress) -> Progress {
        let Some((rest, before)) = &self.rest else {
            self.executed = progress.vertices;
            return *progress;
        };
        self.executed = rest.executed(progress.vertices, *before);
        let number = |vertices: usize| u32::try_from(vertices).unwrap_or(u32::MAX);
        Progress {
            elapsed_s: self.drawn_before_s + progress.elapsed_s,
            left_s: progress.left_s,
            ..self
                .measure
                .progress(number(*before), number(self.executed), progress.elapsed_s)
        }
    }
}

/// A drawing to be continued.
pub struct Unfinished {
    /// Name for display.
    pub name: String,
    /// The remaining path.
    pub path: Arc<[PathVertex]>,
    /// Whether nothing was drawn yet.
    pub is_whole: bool,
}

#[derive(Clone, Debug, Serialize)]
struct JobView {
    number: u64,
    name: String,
    strokes: u32,
    planned_s: f64,
}

impl JobView {
    fn of(job: &QueuedDrawing) -> Self {
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
    /// Whether the drawing can be continued.
    unfinished: bool,
    /// The stroke on which it continues, from 1.
    stroke: u32,
}

struct Past {
    view: PastView,
    /// Data needed to continue.
    job: Option<QueuedDrawing>,
}

/// Drawings as shown on the page.
#[derive(Debug, Serialize)]
pub struct JobsView {
    active: Option<JobView>,
    phase: String,
    waiting: Vec<JobView>,
    past: Vec<PastView>,
}

/// Progress as shown on the page.
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
    active: Option<QueuedDrawing>,
    /// Number and path of the last active drawing.
    last: Option<(u64, Arc<[PathVertex]>)>,
    phase: String,
    waiting: Vec<QueuedDrawing>,
    past: VecDeque<Past>,
    next: u64,
    /// Number of activations so far.
    activations: u64,
    elapsed_s: f64,
    restarted: bool,
}

impl Jobs {
    /// An empty list.
    pub fn new() -> Self {
        Self {
            active: None,
            last: None,
            phase: String::new(),
            waiting: Vec::new(),
            past: VecDeque::new(),
            next: 1,
            activations: 0,
            elapsed_s: 0.0,
            restarted: false,
        }
    }

    /// Queues a drawing; returns its number. A single drawing may be of any length.
    ///
    /// # Errors
    /// Too many drawings wait, or they are too long together.
    pub fn enqueue(&mut self, drawing: PreparedDrawing) -> Result<u64, &'static str> {
        if self.waiting.len() >= WAITING_MAX {
            return Err("the queue is full: 20 drawings wait; draw or discard one first");
        }
        let waiting: usize = self.waiting.iter().map(|job| job.drawing.path.len()).sum();
        if waiting > 0 && waiting + drawing.path.len() > VERTICES_MAX {
            return Err("the drawings in the queue would be too long together; draw or discard one first");
        }
        let number = self.next;
        self.next += 1;
        self.waiting.push(QueuedDrawing::new(number, drawing));
        Ok(number)
    }

    /// Discards a waiting drawing; returns whether it existed.
    pub fn discard(&mut self, number: u64) -> bool {
        let before = self.waiting.len();
        self.waiting.retain(|job| job.number != number);
        self.waiting.len() < before
    }

    /// Activates a waiting drawing; returns its name and path. `None` while another is active.
    pub fn start(&mut self, number: u64) -> Option<(String, Arc<[PathVertex]>)> {
        if self.active.is_some() {
            return None;
        }
        let index = self.waiting.iter().position(|job| job.number == number)?;
        let job = self.waiting.remove(index);
        let begun = (job.drawing.name.clone(), job.drawing.path.clone());
        self.activate(job);
        Some(begun)
    }

    fn activate(&mut self, job: QueuedDrawing) {
        self.elapsed_s = job.drawn_before_s;
        self.active = Some(job);
        self.activations += 1;
        self.phase = "starting".to_owned();
        self.restarted = false;
    }

    /// Activates an unfinished drawing again; returns its remainder.
    ///
    /// # Errors
    /// Another drawing is active, or nothing is left to continue.
    pub fn go_on(&mut self, number: u64, config: &Config) -> Result<Unfinished, &'static str> {
        if self.active.is_some() {
            return Err("another drawing is active");
        }
        let gone = "this drawing is no longer in the history; add it to the queue again";
        let index = self
            .past
            .iter()
            .position(|past| past.view.job.number == number && past.job.is_some());
        let past = index.and_then(|index| self.past.get_mut(index)).ok_or(gone)?;
        let job = past.job.as_mut().ok_or(gone)?;
        let (leg, end_um) = job.ink.end();
        let lift_um = (config.paper.pen_lift_mm * 1_000.0).round() as i32;
        let rest = Remainder::after(&job.drawing.path, leg, end_um, OVERLAP_UM, lift_um);
        if rest.vertices.is_empty() {
            past.job = None;
            past.view.unfinished = false;
            return Err("all of this drawing's strokes were drawn");
        }
        let unfinished = Unfinished {
            name: job.drawing.name.clone(),
            path: rest.vertices.clone().into(),
            is_whole: leg == 0,
        };
        job.drawn_before_s = past.view.drawn_s;
        job.measure = PathMeasure::new(&job.drawing.path, config);
        job.rest = Some((rest, job.executed));
        let job = index
            .and_then(|index| self.past.remove(index))
            .and_then(|past| past.job);
        self.activate(job.ok_or(gone)?);
        Ok(unfinished)
    }

    /// Follows the pen of the active drawing.
    pub fn follow(&mut self, row: &SignalRow) {
        let Some(job) = &mut self.active else { return };
        match (row.mode, row.pen) {
            (Mode::Drawing | Mode::Holding | Mode::Stopping, Pen::Down) => {
                job.ink.draws(row.stroke, row.measured_mm().map(f64::from));
            }
            _ => job.ink.lifted(),
        }
    }

    /// Records that the firmware was restarted; returns whether it was drawing.
    pub fn restarted(&mut self) -> bool {
        let begun = |job: &QueuedDrawing| job.executed > 0 || job.ink.end().0 > 0;
        self.restarted |= self.active.as_ref().is_some_and(begun);
        self.restarted
    }

    /// Whether the firmware was restarted since the active drawing began.
    pub fn is_restarted(&self) -> bool {
        self.restarted
    }

    /// Number of the present activation, which distinguishes it from earlier activations of a drawing; `None` while
    /// none is active.
    pub fn activation(&self) -> Option<u64> {
        self.active.as_ref().map(|_| self.activations)
    }

    /// Number and path of the drawing on the sheet: the active one, or the last active one.
    pub fn on_sheet(&self) -> Option<(u64, Arc<[PathVertex]>)> {
        let active = self.active.as_ref().map(|job| (job.number, job.drawing.path.clone()));
        active.or_else(|| self.last.clone())
    }

    /// Sets the phase of the active drawing.
    pub fn phase(&mut self, phase: impl Into<String>) {
        self.phase = phase.into();
    }

    /// Sets the progress of the active drawing.
    pub fn progress(&mut self, progress: &Progress) -> Option<ProgressView> {
        let job = self.active.as_mut()?;
        let progress = job.whole(progress);
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

    /// Ends the active drawing.
    pub fn end(&mut self, done: bool, text: impl Into<String>) {
        let Some(job) = self.active.take() else { return };
        self.phase.clear();
        let view = PastView {
            job: JobView::of(&job),
            done,
            text: text.into(),
            drawn_s: self.elapsed_s,
            unfinished: !done,
            stroke: job.ink.stroke().saturating_add(1),
        };
        self.last = Some((job.number, job.drawing.path.clone()));
        let job = (!done).then_some(job);
        self.past.push_front(Past { view, job });
        self.past.truncate(PAST_MAX);
        let mut vertices = 0;
        for past in &mut self.past {
            vertices += past.job.as_ref().map_or(0, |job| job.drawing.path.len());
            if vertices > VERTICES_MAX {
                past.job = None;
                past.view.unfinished = false;
            }
        }
    }

    /// The drawings as shown on the page.
    pub fn view(&self) -> JobsView {
        JobsView {
            active: self.active.as_ref().map(JobView::of),
            phase: self.phase.clone(),
            waiting: self.waiting.iter().map(JobView::of).collect(),
            past: self.past.iter().map(|past| past.view.clone()).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::motion::Pen;

    fn drawing() -> PreparedDrawing {
        let vertex = |x_mm: i32| PathVertex {
            position_um: [x_mm * 1_000, 0, -850_000],
            pen: Pen::Down,
            stroke: 0,
        };
        PreparedDrawing {
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
        assert_eq!(jobs.activation(), None);
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
        assert!((0..WAITING_MAX).all(|_| jobs.enqueue(drawing()).is_ok()));
        assert!(jobs.enqueue(drawing()).is_err_and(|why| why.contains("20 drawings")));
        let number = jobs.view().waiting.first().map(|job| job.number).unwrap();
        assert!(jobs.discard(number) && !jobs.discard(number));
    }

    #[test]
    fn what_waits_is_bounded_in_vertices_and_one_drawing_may_always_wait() {
        let long = |vertices: usize| PreparedDrawing {
            path: drawing().path.iter().copied().cycle().take(vertices).collect(),
            ..drawing()
        };
        let mut jobs = Jobs::new();
        let half = VERTICES_MAX / 2;
        let first = jobs.enqueue(long(half)).unwrap();
        assert!(jobs.enqueue(long(half)).is_ok());
        let refused = jobs.enqueue(long(1)).unwrap_err();
        assert!(refused.contains("draw or discard one"), "{refused}");
        assert!(jobs.discard(first) && jobs.enqueue(long(1)).is_ok());
        let mut jobs = Jobs::new();
        assert!(jobs.enqueue(long(VERTICES_MAX + 1)).is_ok() && jobs.enqueue(drawing()).is_err());
    }
}

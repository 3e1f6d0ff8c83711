//! Drawings: active, waiting and past ones.
//!
//! A waiting drawing starts only on request: the paper has to be changed between two drawings. A drawing that ended
//! early can continue where telemetry saw its ink end; the last millimetre is drawn again. A drawing of several layers
//! may pause before each of them, for another pen; it stays active in the pause. Invariants: at most one drawing is
//! active; waiting drawings are bounded in number and length; only the last entries of the past are kept, and only the
//! paths of the last unfinished ones.

use super::layers::{Layers, PathLayer, PauseView};
use super::signals::SignalRow;
use crate::job::ink::{Ink, InkEnd};
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
    /// Layers of the path, in the order of drawing.
    pub layers: Vec<PathLayer>,
    /// Duration computed by the planner, s; NaN if it could not be computed.
    pub planned_s: f64,
}

struct QueuedDrawing {
    number: u64,
    drawing: PreparedDrawing,
    ink: Ink,
    measure: PathMeasure,
    layers: Layers,
    /// The remainder since the drawing was continued, and the vertices executed before.
    rest: Option<(Remainder, usize)>,
    /// Where its ink ended when it was continued.
    ink_before: InkEnd,
    /// Executed vertices of the complete path.
    executed: usize,
    /// Drawing time before the drawing was continued, s.
    drawn_before_s: f64,
}

impl QueuedDrawing {
    fn new(number: u64, drawing: PreparedDrawing, pauses: bool) -> Self {
        let layers = if pauses { drawing.layers.clone() } else { Vec::new() };
        Self {
            number,
            ink: Ink::new(drawing.path.clone()),
            measure: PathMeasure::default(),
            layers: Layers::new(layers),
            rest: None,
            ink_before: InkEnd::default(),
            executed: 0,
            drawn_before_s: 0.0,
            drawing,
        }
    }

    /// The path from where the ink ends to the end of the present layer. Nothing of a layer that was drawn to its end is
    /// drawn again.
    fn rest(&mut self, config: &Config) -> Arc<[PathVertex]> {
        let lift_um = (config.paper.pen_lift_mm * 1_000.0).round() as i32;
        let (leg, end_um) = self.ink.end();
        let path = &self.drawing.path;
        let rest = match self.layers.drawn() {
            drawn if leg < drawn || (leg == 0 && self.layers.are_several()) => {
                Remainder::new(path, drawn, OVERLAP_UM, lift_um)
            }
            _ => Remainder::after(path, leg, end_um, OVERLAP_UM, lift_um),
        };
        let part = self.layers.part(&rest, path.len());
        self.measure = PathMeasure::new(path, config);
        self.rest = Some((rest, self.executed));
        self.ink_before = self.ink.keep();
        part
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

/// How a drawing that was drawn up to the end of its path or layer goes on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DrawnPart {
    /// The drawing is complete.
    Whole,
    /// The next layer waits for its pen.
    Pause(PauseView),
}

/// How an unfinished drawing is continued.
pub enum Continued {
    /// With a path.
    Path(Unfinished),
    /// With a pause: the next layer waits for its pen.
    Pause,
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
    /// The pause of the active drawing, if its next layer waits for its pen.
    pause: Option<PauseView>,
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

    /// Queues a drawing; returns its number. A single drawing may be of any length. With `pauses` it pauses between its
    /// layers.
    ///
    /// # Errors
    /// Too many drawings wait, or they are too long together.
    pub fn enqueue(&mut self, drawing: PreparedDrawing, pauses: bool) -> Result<u64, &'static str> {
        if self.waiting.len() >= WAITING_MAX {
            return Err("the queue is full: 20 drawings wait; draw or discard one first");
        }
        let waiting: usize = self.waiting.iter().map(|job| job.drawing.path.len()).sum();
        if waiting > 0 && waiting + drawing.path.len() > VERTICES_MAX {
            return Err("the drawings in the queue would be too long together; draw or discard one first");
        }
        let number = self.next;
        self.next += 1;
        self.waiting.push(QueuedDrawing::new(number, drawing, pauses));
        Ok(number)
    }

    /// Discards a waiting drawing; returns whether it existed.
    pub fn discard(&mut self, number: u64) -> bool {
        let before = self.waiting.len();
        self.waiting.retain(|job| job.number != number);
        self.waiting.len() < before
    }

    /// Activates a waiting drawing; returns its name and the path up to its first pause. `None` while another is active.
    pub fn start(&mut self, number: u64, config: &Config) -> Option<(String, Arc<[PathVertex]>)> {
        if self.active.is_some() {
            return None;
        }
        let index = self.waiting.iter().position(|job| job.number == number)?;
        let mut job = self.waiting.remove(index);
        let path = match job.layers.are_several() {
            true => job.rest(config),
            false => job.drawing.path.clone(),
        };
        let begun = (job.drawing.name.clone(), path);
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

    /// Activates an unfinished drawing again; returns its remainder up to the next pause, or that it pauses at once.
    ///
    /// # Errors
    /// Another drawing is active, or nothing is left to continue.
    pub fn go_on(&mut self, number: u64, config: &Config) -> Result<Continued, &'static str> {
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
        job.drawn_before_s = past.view.drawn_s;
        let waits = job.layers.wait();
        let unfinished = Unfinished {
            name: job.drawing.name.clone(),
            path: if waits { Arc::default() } else { job.rest(config) },
            is_whole: job.ink.end().0 == 0,
        };
        if !waits && unfinished.path.is_empty() {
            past.job = None;
            past.view.unfinished = false;
            return Err("all of this drawing's strokes were drawn");
        }
        let job = index
            .and_then(|index| self.past.remove(index))
            .and_then(|past| past.job);
        self.activate(job.ok_or(gone)?);
        Ok(if waits {
            Continued::Pause
        } else {
            Continued::Path(unfinished)
        })
    }

    /// The active drawing was drawn up to the end of its path or layer. A complete one is ended with
    /// [`Jobs::end`]; otherwise it stays active and pauses. `None` if no drawing is active, or if it pauses already.
    pub fn drawn(&mut self) -> Option<DrawnPart> {
        let job = self.active.as_mut().filter(|job| !job.layers.wait())?;
        if !job.layers.end() {
            return Some(DrawnPart::Whole);
        }
        job.drawn_before_s = self.elapsed_s;
        job.executed = job.layers.drawn();
        job.layers.view(job.number).map(DrawnPart::Pause)
    }

    /// Whether the active drawing waits for the next layer's pen.
    pub fn is_paused(&self) -> bool {
        self.active.as_ref().is_some_and(|job| job.layers.wait())
    }

    /// Ends the pause of the active drawing: the next layer's pen is in place. Returns that layer's path.
    ///
    /// # Errors
    /// This drawing is not active, or it does not wait for a pen.
    pub fn pen_is_in(&mut self, number: u64, config: &Config) -> Result<Unfinished, &'static str> {
        let active = self.active.as_mut().filter(|job| job.number == number);
        let job = active.ok_or("this drawing does not wait for a pen")?;
        if !job.layers.pen_is_in() {
            return Err("this drawing does not wait for a pen");
        }
        let unfinished = Unfinished {
            name: job.drawing.name.clone(),
            path: job.rest(config),
            is_whole: false,
        };
        self.activations += 1;
        self.phase = "starting".to_owned();
        self.restarted = false;
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

    /// Something behind so many vertices of what was sent of the active drawing is missing: its ink ends there, at a stroke's
    /// beginning or within a stroke.
    pub fn found_missing(&mut self, complete: usize) {
        if let Some(job) = &mut self.active {
            match job
                .rest
                .as_ref()
                .map_or(complete, |(rest, _)| rest.executed(complete, 0))
            {
                0 => job.ink.restore(job.ink_before),
                vertex => job.ink.back_to(vertex),
            }
        }
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
            pause: self.active.as_ref().and_then(|job| job.layers.view(job.number)),
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
            layers: Vec::new(),
            planned_s: 1.0,
        }
    }

    /// Two layers of one stroke each; each stroke is above, down, along and up.
    fn two_layers() -> PreparedDrawing {
        let stroke = |stroke: u32| {
            let vertex = move |(x_mm, z_mm, pen): (i32, i32, Pen)| PathVertex {
                position_um: [x_mm * 1_000, 0, z_mm * 1_000],
                pen,
                stroke,
            };
            let x_mm = 50 * stroke as i32;
            [
                (x_mm, -847, Pen::Up),
                (x_mm, -850, Pen::Up),
                (x_mm + 20, -850, Pen::Down),
                (x_mm + 20, -847, Pen::Up),
            ]
            .map(vertex)
        };
        let layer = |name: &str, end| PathLayer {
            name: name.to_owned(),
            end,
        };
        PreparedDrawing {
            path: [stroke(0), stroke(1)].concat().into(),
            strokes: 2,
            layers: vec![layer("red", 4), layer("blue", 8)],
            ..drawing()
        }
    }

    fn path(continued: Continued) -> Option<Arc<[PathVertex]>> {
        match continued {
            Continued::Path(unfinished) => Some(unfinished.path),
            Continued::Pause => None,
        }
    }

    #[test]
    fn a_stroke_that_is_not_whole_is_drawn_again_also_when_the_ink_had_gone_on_behind_it() {
        let (mut jobs, config) = (Jobs::new(), Config::default());
        let of_strokes = |count: u32| {
            let stroke = |stroke: u32| {
                let mut vertices = two_layers().path[..4].to_vec();
                for vertex in &mut vertices {
                    vertex.position_um[0] += 50_000 * stroke as i32;
                    vertex.stroke = stroke;
                }
                vertices
            };
            PreparedDrawing {
                path: (0..count).flat_map(stroke).collect(),
                strokes: count,
                ..drawing()
            }
        };
        let draws = |jobs: &mut Jobs, stroke: u32| {
            let ink = &mut jobs.active.as_mut().unwrap().ink;
            let x_mm = 50.0 * f64::from(stroke);
            (0..=200).for_each(|step| ink.draws(stroke, [x_mm + f64::from(step) / 10.0, 0.0, -850.0]));
            ink.lifted();
        };
        let number = jobs.enqueue(of_strokes(5), false).unwrap();
        assert!(jobs.start(number, &config).is_some());
        // The pen was beside the third stroke.
        [0, 1, 3].into_iter().for_each(|stroke| draws(&mut jobs, stroke));
        jobs.found_missing(8);
        jobs.end(false, "a fault");
        let whole = of_strokes(5).path;
        // The end of the stroke before is drawn again too, as the ink ends there.
        let begins_with = |rest: &[PathVertex], stroke: usize| {
            rest.ends_with(&whole[4 * stroke..]) && rest.len() <= whole.len() - 4 * stroke + 5
        };
        let rest = path(jobs.go_on(number, &config).unwrap()).unwrap();
        assert!(begins_with(&rest, 2), "{rest:?}");
        // Beside the fourth one now.
        [2, 4].into_iter().for_each(|stroke| draws(&mut jobs, stroke));
        let fourth = rest.iter().position(|vertex| vertex.stroke == 3).unwrap();
        jobs.found_missing(fourth);
        jobs.end(false, "a fault");
        let rest = path(jobs.go_on(number, &config).unwrap()).unwrap();
        assert!(begins_with(&rest, 3), "{rest:?}");
        // Beside the first of what was sent.
        draws(&mut jobs, 4);
        jobs.found_missing(0);
        jobs.end(false, "a fault");
        let rest = path(jobs.go_on(number, &config).unwrap()).unwrap();
        assert!(begins_with(&rest, 3), "{rest:?}");
    }

    #[test]
    fn layers_are_drawn_one_by_one_with_a_pause_that_outlives_a_cancel() {
        let (mut jobs, config) = (Jobs::new(), Config::default());
        let whole = two_layers().path;
        let number = jobs.enqueue(two_layers(), true).unwrap();
        assert_eq!(jobs.start(number, &config).unwrap().1[..], whole[..4]);
        assert!(jobs.pen_is_in(number, &config).is_err(), "no pen is awaited yet");
        let executed = |jobs: &mut Jobs, vertices| {
            let progress = Progress {
                vertices,
                elapsed_s: 3.0,
                ..Progress::default()
            };
            jobs.progress(&progress).map(|view| (view.executed, view.vertices))
        };
        assert_eq!(executed(&mut jobs, 4), Some((4, 8)));
        let Some(DrawnPart::Pause(pause)) = jobs.drawn() else {
            panic!("the second layer needs another pen")
        };
        assert_eq!((pause.layer.as_str(), pause.number, pause.layers), ("blue", 2, 2));
        assert_eq!(jobs.drawn(), None, "the end of another task ends no pause");
        assert!(jobs.is_paused() && jobs.activation().is_some());

        jobs.end(false, "cancelled in the pause");
        assert!(
            path(jobs.go_on(number, &config).unwrap()).is_none(),
            "the pen is asked for again"
        );
        assert!(jobs.pen_is_in(number + 1, &config).is_err());
        assert_eq!(jobs.pen_is_in(number, &config).unwrap().path[..], whole[4..]);
        assert!(
            jobs.pen_is_in(number, &config).is_err(),
            "a second press starts nothing"
        );
        // A refused start of the second layer does not lead back into the first.
        jobs.end(false, "the link broke");
        assert_eq!(path(jobs.go_on(number, &config).unwrap()).unwrap()[..], whole[4..]);
        assert_eq!(executed(&mut jobs, 4), Some((8, 8)));
        assert_eq!(jobs.drawn(), Some(DrawnPart::Whole));
        jobs.end(true, "drawn");
        assert!(
            jobs.view()
                .past
                .first()
                .is_some_and(|past| past.done && !past.unfinished)
        );
    }

    #[test]
    fn layers_are_drawn_without_a_pause_unless_it_is_wanted() {
        let (mut jobs, config) = (Jobs::new(), Config::default());
        let number = jobs.enqueue(two_layers(), false).unwrap();
        assert_eq!(jobs.start(number, &config).unwrap().1, two_layers().path);
        assert_eq!(jobs.drawn(), Some(DrawnPart::Whole));
    }

    #[test]
    fn one_drawing_is_active_and_the_others_wait_until_they_are_started() {
        let (mut jobs, config) = (Jobs::new(), Config::default());
        let (first, second) = (
            jobs.enqueue(drawing(), false).unwrap(),
            jobs.enqueue(drawing(), false).unwrap(),
        );
        assert!(jobs.start(first, &config).is_some());
        assert!(jobs.start(second, &config).is_none());
        let progress = Progress {
            vertices: 10,
            elapsed_s: 2.0,
            ..Progress::default()
        };
        assert_eq!(jobs.progress(&progress).map(|view| view.executed), Some(10));
        jobs.end(true, "drawn");
        assert_eq!(jobs.activation(), None);
        assert_eq!(jobs.on_sheet().map(|(number, _)| number), Some(first));
        assert!(jobs.start(second, &config).is_some());
        assert_eq!(jobs.view().past.first().map(|past| past.drawn_s), Some(2.0));
    }

    #[test]
    fn queue_and_past_are_bounded() {
        let (mut jobs, config) = (Jobs::new(), Config::default());
        for _ in 0..2 * PAST_MAX {
            let number = jobs.enqueue(drawing(), false).unwrap();
            jobs.start(number, &config);
            jobs.end(false, "cancelled");
        }
        assert_eq!(jobs.view().past.len(), PAST_MAX);
        assert!((0..WAITING_MAX).all(|_| jobs.enqueue(drawing(), false).is_ok()));
        assert!(
            jobs.enqueue(drawing(), false)
                .is_err_and(|why| why.contains("20 drawings"))
        );
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
        let first = jobs.enqueue(long(half), false).unwrap();
        assert!(jobs.enqueue(long(half), false).is_ok());
        let refused = jobs.enqueue(long(1), false).unwrap_err();
        assert!(refused.contains("draw or discard one"), "{refused}");
        assert!(jobs.discard(first) && jobs.enqueue(long(1), false).is_ok());
        let mut jobs = Jobs::new();
        assert!(jobs.enqueue(long(VERTICES_MAX + 1), false).is_ok() && jobs.enqueue(drawing(), false).is_err());
    }
}

//! The dialogue that leads the pen to the touches.
//!
//! Invariants: a step sideways never begins with the pen where it may touch the sheet; only the word `done` gives a result;
//! no touch outlives the reference in which it was taken.

use crate::commands::ended_by_a_signal;
use crate::error::{ProgramError, code};
use crate::job::Motion;
use crate::link::port::PortName;
use crate::link::text;
use crate::machine::access::{self, MachineAccess, OwnPort};
use crate::machine::{Order, Snapshot};
use crate::settings::sheet::found;
use crate::touches::{TOUCHES_MIN, Touch, TouchError, add, check_residual, tilt_deg};
use etherpen::application::Mode;
use etherpen::config::{Config, Paper};
use etherpen::messages::Status;
use etherpen::motion::{Outside, WorkArea};
use etherpen::robots::{JointAngles, Position};
use std::io::BufRead;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Longest move that one line of the dialogue orders, mm.
const STEP_MAX_MM: f64 = 500.0;
/// Time between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);
/// Time between two looks at a pen that has to stand still, and the farthest it may go meanwhile, mm.
const STILL: Duration = Duration::from_millis(60);
const STILL_MM: f64 = 0.05;
/// Distance from the border of the work area to which the pen is raised, mm: more than a measured height is off.
const BORDER_MM: f64 = 0.1;
/// The lines of the dialogue.
const WORDS: &str = "z -0.1: down by so many mm    x 10, y -5: sideways, raised first    Enter: the pen touches here\n\
                     undo: forget the last touch    done: compute the plane    Ctrl-C: end without it";

/// What the touches are for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wishes {
    /// How far below its first touch the pen draws, mm.
    pub(super) press_mm: f64,
    /// Whether the plane is stored.
    pub(super) store: bool,
}

/// Heights at which the pen may be on the sheet.
#[derive(Clone, Copy, Debug)]
struct Height {
    /// The last height seen, mm.
    last_mm: f64,
    /// Height to which the pen went down last, or at which it was found or touched, mm.
    low_mm: f64,
    /// Height of the last touch, mm.
    touched_mm: f64,
}

impl Height {
    /// A pen of which only its height is known: it may be on the sheet.
    fn new(z_mm: f64) -> Self {
        Self {
            last_mm: z_mm,
            low_mm: z_mm,
            touched_mm: f64::NEG_INFINITY,
        }
    }

    /// Takes the present height.
    fn see(&mut self, z_mm: f64) {
        if z_mm < self.last_mm - STILL_MM {
            self.low_mm = z_mm;
        }
        self.last_mm = z_mm;
    }

    /// The pen touches the sheet.
    fn touch(&mut self, z_mm: f64) {
        *self = Self {
            touched_mm: z_mm,
            ..Self::new(z_mm)
        };
    }

    /// Height to which the pen has to go before a step sideways, mm; `None` if it is raised already.
    fn before_step(&self, lift_mm: f64, distance_mm: f64) -> Option<f64> {
        let is_raised = self.last_mm - self.low_mm >= lift_mm - STILL_MM;
        let above_mm = self.last_mm.max(self.touched_mm);
        (!is_raised).then_some(above_mm + lift_mm + Paper::SLOPE_MAX * distance_mm)
    }
}

/// The dialogue that leads to the touches.
pub(super) struct Dialogue<'a> {
    config: &'a Config,
    area: WorkArea,
    port: PortName,
    wishes: Wishes,
    ended: Arc<AtomicBool>,
    lines: Receiver<String>,
    touches: Vec<Touch>,
    height: Option<Height>,
    /// The firmware's time when it was seen last, ms.
    seen_ms: u32,
}

impl<'a> Dialogue<'a> {
    pub(super) fn new(config: &'a Config, port: PortName, wishes: Wishes) -> Result<Self, ProgramError> {
        let area = WorkArea::new(&config.motion_settings())
            .map_err(|cause| ProgramError::failed("the dimensions", text::config_refusal(&cause.into())))?;
        let (sender, lines) = channel();
        // It ends with this process, at the latest.
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Ok(Self {
            config,
            area,
            port,
            wishes,
            ended: ended_by_a_signal()?,
            lines,
            touches: Vec::new(),
            height: None,
            seen_ms: 0,
        })
    }

    pub(super) fn run(mut self) -> Result<Vec<Touch>, ProgramError> {
        // A machine that does not know where it is, is told at once.
        self.position()?;
        eprintln!(
            "Move the pen to three or more places near the corners of the sheet, each time down until it touches.\n{WORDS}"
        );
        loop {
            eprint!("touch {}> ", self.touches.len() + 1);
            let line = self.line()?;
            match line.trim() {
                "" => self.touch(),
                "done" => match self.result() {
                    Ok(_) => return Ok(self.touches),
                    Err(cause) => eprintln!("{cause}"),
                },
                "undo" => match self.touches.pop() {
                    Some([x, y, _]) => eprintln!("forgotten: x {x:.1}, y {y:.1}"),
                    None => eprintln!("there is no touch"),
                },
                words => match step(words) {
                    Some(by_mm) => self.go(by_mm),
                    None => eprintln!("{WORDS}"),
                },
            }
        }
    }

    /// The next line. The end of standard input is an end without `done`.
    fn line(&self) -> Result<String, ProgramError> {
        let ended = || Err(ProgramError::new(code::FAILED, "ended; nothing was stored"));
        loop {
            if self.ended.load(Ordering::Relaxed) {
                return ended();
            }
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => return Ok(line),
                Err(RecvTimeoutError::Disconnected) => return ended(),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// The sheet that the touches give, in words.
    fn result(&self) -> Result<String, String> {
        if self.touches.len() < TOUCHES_MIN {
            let touches = self.touches.len();
            return Err(TouchError::Few { touches }.to_string());
        }
        let (paper, fit) = found(self.config, &self.touches, self.wishes.press_mm)?;
        if self.wishes.store {
            check_residual(&self.touches, &fit).map_err(|cause| cause.to_string())?;
        }
        Ok(format!(
            "tilt {:.3} degrees, at most {:.3} mm off the plane (touch {}); another touch, or done",
            tilt_deg(paper.slope),
            fit.residual_mm,
            fit.worst
        ))
    }

    fn own<T>(&self, work: impl FnOnce(OwnPort) -> T) -> T {
        let (config, ended) = (self.config, &self.ended);
        work(OwnPort {
            config: &|| Ok(config.clone()),
            interrupted: &|| Ok(Arc::clone(ended)),
            tell: &|waiting| eprintln!("{waiting}"),
        })
    }

    fn access(&self) -> Result<MachineAccess, ProgramError> {
        self.own(|own| MachineAccess::find(&self.port, own))
    }

    fn position(&mut self) -> Result<Position, ProgramError> {
        let snapshot = self.access()?.state()?;
        self.look(&snapshot)
    }

    /// Where the tool is. Touches from before a restart or a lost reference are forgotten.
    fn look(&mut self, snapshot: &Snapshot) -> Result<Position, ProgramError> {
        let keeps = |status: &Status| status.referenced && status.mode != Mode::Homing;
        let is_referenced = snapshot.status.as_ref().is_none_or(keeps);
        let now_ms = snapshot.sample.as_ref().map_or(self.seen_ms, |sample| sample.t_ms);
        let is_restarted = std::mem::replace(&mut self.seen_ms, now_ms) > now_ms;
        if (is_restarted || !is_referenced) && !self.touches.is_empty() {
            self.touches.clear();
            eprintln!("the touches so far are forgotten: the machine has lost its place meanwhile");
        }
        let position = standing(self.config, &self.area, snapshot)?;
        match &mut self.height {
            Some(height) => height.see(position.z_mm),
            none => *none = Some(Height::new(position.z_mm)),
        }
        Ok(position)
    }

    /// The place of a pen that stands still.
    fn still(&mut self) -> Result<Position, ProgramError> {
        let mut access = self.access()?;
        let before: Touch = self.look(&access.state()?)?.into();
        std::thread::sleep(STILL);
        let snapshot = access.state()?;
        let position = self.look(&snapshot)?;
        let now: Touch = position.into();
        let mode = snapshot.status.as_ref().map(|status| status.mode);
        let is_at_rest = matches!(mode, Some(Mode::Idle | Mode::DrivesOff | Mode::Fault));
        let stays = before
            .iter()
            .zip(now)
            .all(|(before, now)| (before - now).abs() < STILL_MM);
        match is_at_rest && stays {
            true => Ok(position),
            false => Err(ProgramError::new(
                code::FAILED,
                "the pen does not stand still: wait until it does, then press Enter again",
            )),
        }
    }

    /// Takes a touch; the operator sees why there is none.
    fn touch(&mut self) {
        let touch: Touch = match self.still() {
            Ok(position) => position.into(),
            Err(error) => return eprintln!("{}", error.message),
        };
        let [x, y, z] = touch;
        if let Some(height) = &mut self.height {
            height.touch(z);
        }
        let replaced = add(&mut self.touches, touch);
        let instead = replaced.map_or(String::new(), |number| format!(", in place of touch {number}"));
        eprintln!("touch {}: x {x:.2}, y {y:.2}, z {z:.3} mm{instead}", self.touches.len());
        if self.touches.len() >= TOUCHES_MIN {
            match self.result() {
                Ok(words) => eprintln!("{words}"),
                Err(cause) => eprintln!("{cause}; undo forgets the last touch"),
            }
        }
    }

    /// Moves the pen; the operator sees why it does not.
    fn go(&mut self, by_mm: [f64; 3]) {
        match self.moved(by_mm) {
            Ok(Position { x_mm, y_mm, z_mm }) => eprintln!("x {x_mm:.2}, y {y_mm:.2}, z {z_mm:.3} mm"),
            Err(error) => eprintln!("{}", error.message),
        }
    }

    /// Moves the pen, raised first if the step leads sideways; returns where it is then.
    fn moved(&mut self, by_mm: [f64; 3]) -> Result<Position, ProgramError> {
        let mut from = self.position()?;
        let distance_mm = by_mm[0].hypot(by_mm[1]);
        let lift_mm = self.config.paper.pen_lift_mm;
        let height = self.height.filter(|_| distance_mm > 0.0);
        if let Some(z_mm) = height.and_then(|height| height.before_step(lift_mm, distance_mm)) {
            let wanted_mm = reached_mm(&self.area, Position { z_mm, ..from });
            if wanted_mm > from.z_mm + STILL_MM {
                from = self.order(Position {
                    z_mm: wanted_mm,
                    ..from
                })?;
            }
            if from.z_mm < wanted_mm - STILL_MM {
                return Err(ProgramError::new(
                    code::FAILED,
                    "the pen was not raised, so it does not go sideways",
                ));
            }
        }
        let from: [f64; 3] = from.into();
        self.order(Position::from([0, 1, 2].map(|axis| from[axis] + by_mm[axis])))
    }

    fn order(&mut self, to: Position) -> Result<Position, ProgramError> {
        let order = Order::Motion(Motion::Move(to));
        self.own(|own| access::carry_out(&self.port, own, order))?;
        self.position()
    }
}

/// The height of a place, or the highest one below it that the machine reaches, mm. Below the border itself, so that the
/// measured height is inside too.
fn reached_mm(area: &WorkArea, above: Position) -> f64 {
    match area.nearest(&above) {
        Some(near) if near.z_mm < above.z_mm => near.z_mm - BORDER_MM,
        _ => above.z_mm,
    }
}

/// A move along one axis: its letter and the distance, mm.
fn step(words: &str) -> Option<[f64; 3]> {
    let (axis, distance) = words.split_at_checked(1)?;
    let axis = ["x", "y", "z"].iter().position(|name| *name == axis)?;
    let distance: f64 = distance.trim().parse().ok()?;
    let mut by_mm = [0.0; 3];
    if let Some(by) = by_mm.get_mut(axis).filter(|_| distance.abs() <= STEP_MAX_MM) {
        *by = distance;
        return Some(by_mm);
    }
    None
}

/// Where a machine's tool is.
fn standing(config: &Config, area: &WorkArea, snapshot: &Snapshot) -> Result<Position, ProgramError> {
    let status = snapshot.status.as_ref();
    let in_force = status.and_then(|status| status.config);
    let refused = |text: &str| Err(ProgramError::new(code::FAILED, text));
    if in_force.is_some() && in_force != config.hash() {
        return refused("the machine works with another configuration: name its file (--config)");
    }
    let sample = snapshot.sample.as_ref();
    let Some(sample) = sample.filter(|_| status.is_some_and(|status| status.referenced)) else {
        return refused("the machine does not know where its pen is: etherpen home, then try again");
    };
    let joints = JointAngles(sample.measured_rad.map(f64::from));
    let position = area.kinematics().forward(&joints).map_err(|cause| {
        let why = text::outside(&Outside::Kinematics(cause));
        ProgramError::new(code::FAILED, format!("the machine's position is not possible: {why}"))
    })?;
    match <[f64; 3]>::from(position).iter().all(|value| value.is_finite()) {
        true => Ok(position),
        false => refused("the machine does not report where its pen is: look at its drives (etherpen status)"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_a_letter_and_a_distance() {
        assert_eq!(step("x 10"), Some([10.0, 0.0, 0.0]));
        assert_eq!(step("z-0.05"), Some([0.0, 0.0, -0.05]));
        for wrong in ["", "x", "q 1", "y one", "z 501", "y nan", "é 1", "x 1 2"] {
            assert_eq!(step(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_pen_that_may_be_on_the_sheet_is_raised_before_a_step_sideways() {
        let steep_mm = 100.0 * Paper::SLOPE_MAX;
        // Found somewhere: nobody knows whether it touches.
        let mut height = Height::new(-20.0);
        assert_eq!(height.before_step(3.0, 100.0), Some(-17.0 + steep_mm));
        height.see(-17.0);
        assert_eq!(height.before_step(3.0, 100.0), None);
        // Down again, in two steps, without a touch.
        height.see(-18.0);
        height.see(-29.0);
        height.see(-27.0);
        assert_eq!(height.before_step(3.0, 10.0), Some(-24.0 + 10.0 * Paper::SLOPE_MAX));
        height.see(-26.0);
        assert_eq!(height.before_step(3.0, 10.0), None);
        // A touch, and a press deeper behind it.
        height.touch(-30.0);
        height.see(-30.4);
        assert_eq!(height.before_step(3.0, 0.0), Some(-27.0));
        height.see(-28.0);
        assert_eq!(height.before_step(3.0, 0.0), Some(-25.0));
        height.see(-27.4);
        assert_eq!(height.before_step(3.0, 0.0), None);
    }

    #[test]
    fn a_pen_is_raised_no_higher_than_just_below_the_border_of_the_work_area() {
        let config = crate::settings::machines::MACHINES[1].load().unwrap();
        let area = WorkArea::new(&config.motion_settings()).unwrap();
        let at = |z_mm: f64| Position {
            x_mm: 100.0,
            y_mm: 100.0,
            z_mm,
        };
        assert_eq!(reached_mm(&area, at(-5.0)), -5.0);
        let raised_mm = reached_mm(&area, at(12.0));
        assert_eq!(raised_mm, config.work_area.z_high_mm - BORDER_MM);
        assert!(area.contains(&at(raised_mm + STILL_MM)));
    }
}

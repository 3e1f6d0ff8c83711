//! `etherpen paper`: where the sheet lies, and how the pen finds it.

use super::ports::SessionPort;
use super::{ConfigArguments, ended_by_a_signal, print_json};
use crate::error::{ProgramError, code};
use crate::job::Motion;
use crate::link::port::PortName;
use crate::link::text;
use crate::machine::access::{self, MachineAccess, OwnPort};
use crate::machine::{Order, Snapshot};
use crate::settings::sheet::{follows, found, store_sheet};
use crate::terminal::counted;
use crate::touches::{Fit, PRESS_MM, TOUCHES_MIN, Touch, TouchError, fit, rise_mm, tilt_deg};
use etherpen::config::{Config, Paper};
use etherpen::motion::Outside;
use etherpen::robots::{JointAngles, Kinematics, Position};
use serde::Serialize;
use std::io::{BufRead, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Distance of a touch from the plane that is worth a word, mm: as much as a pen's spring gives way.
const RESIDUAL_MM: f64 = 0.3;
/// Longest move that one line of the dialogue orders, mm.
const STEP_MAX_MM: f64 = 500.0;
/// Time between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);
/// The lines of the dialogue.
const WORDS: &str = "x 10, y -5, z -0.1: move by so many mm, pen up    Enter: the pen touches here\n\
                     undo: forget the last touch    done: compute the plane    Ctrl-C: end without it";

/// Options of `etherpen paper`.
///
/// Without --touch it shows where the configuration says the sheet lies. With --touch and no places it asks for touches: jog
/// the pen to three or more places far apart, down until it touches the sheet, and press Enter. Jog here, on the console's page
/// or with `etherpen jog`. The lowest place is paper.pen_down_z_mm less paper.pressing_depth_mm: if the pen does not reach the
/// sheet, lower the first.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Find height and tilt from touches: position of the tool where the pen touched, mm, as `etherpen status` shows it; three
    /// or more of them. Without positions: ask. A negative x needs =: --touch=-80,70,-849.6.
    #[arg(long, value_name = "X,Y,Z", num_args = 0..=1, default_missing_value = ASK, value_parser = given)]
    touch: Vec<Given>,
    /// How far below its first touch the pen draws, mm.
    #[arg(long, value_name = "MM", default_value_t = PRESS_MM, value_parser = press)]
    press: f64,
    /// Store height and slope in the configuration file in use, or in `etherpen.toml` if there is none; the rest of the file
    /// is unchanged.
    #[arg(long, requires = "touch")]
    store: bool,
    #[command(flatten)]
    port: SessionPort,
    /// Print the result as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Value of `--touch` without a position.
const ASK: &str = "ask";

/// A value of `--touch`.
#[derive(Clone, Copy, Debug)]
enum Given {
    /// None: ask.
    Ask,
    /// A place that the pen touched.
    Place(Touch),
}

fn given(text: &str) -> Result<Given, String> {
    if text == ASK {
        return Ok(Given::Ask);
    }
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|number| number.trim().parse().ok().filter(|number: &f64| number.is_finite()))
        .collect();
    let touch: Option<Touch> = numbers.and_then(|numbers| numbers.try_into().ok());
    touch
        .map(Given::Place)
        .ok_or_else(|| "three finite numbers with commas between them are needed".into())
}

fn press(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(mm) if (0.0..=5.0).contains(&mm) => Ok(mm),
        _ => Err("a number of millimetres from 0 to 5 is needed".into()),
    }
}

/// What the command prints.
#[derive(Clone, Debug, Serialize)]
struct Answer {
    centre_mm: [f64; 2],
    size_mm: [f64; 2],
    /// The platform's z when the pen draws at the centre.
    pen_down_z_mm: f64,
    pen_lift_mm: f64,
    slope: [f64; 2],
    tilt_deg: f64,
    /// Difference between the highest and the lowest corner.
    rise_mm: f64,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    touches_mm: Vec<Touch>,
    /// Largest distance of a touch from the plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    residual_mm: Option<f64>,
    stored: Option<String>,
}

impl Answer {
    fn new(paper: &Paper) -> Self {
        Self {
            centre_mm: paper.centre_mm,
            size_mm: paper.size_mm,
            pen_down_z_mm: paper.pen_down_z_mm,
            pen_lift_mm: paper.pen_lift_mm,
            slope: paper.slope,
            tilt_deg: tilt_deg(paper.slope),
            rise_mm: rise_mm(paper),
            touches_mm: Vec::new(),
            residual_mm: None,
            stored: None,
        }
    }

    fn text(&self) -> String {
        let ([width, height], [x, y], [along_x, along_y]) = (self.size_mm, self.centre_mm, self.slope);
        format!(
            "sheet   {width:.1} x {height:.1} mm, centre at x {x:.1}, y {y:.1} mm\n\
             height  {:.3} mm at the centre when the pen draws, lifted by {:.1} mm\n\
             tilt    {:.3} degrees: {:+.3} mm over 100 mm of x, {:+.3} mm over 100 mm of y, {:.2} mm over the sheet\n",
            self.pen_down_z_mm,
            self.pen_lift_mm,
            self.tilt_deg,
            100.0 * along_x,
            100.0 * along_y,
            self.rise_mm
        )
    }
}

/// Runs the command.
///
/// # Errors
/// The machine cannot follow a tilted sheet, the touches give no plane, or errors of the configuration, machine or file.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    if arguments.touch.is_empty() {
        return show(arguments, &Answer::new(&config.paper));
    }
    let refused = |cause: String| ProgramError::new(code::USAGE, cause);
    follows(&config).map_err(refused)?;
    let store = arguments.store.then(|| arguments.config.file_to_store(&config));
    let store = store.transpose()?;
    let place = |given: &Given| match given {
        Given::Ask => None,
        Given::Place(touch) => Some(*touch),
    };
    let given: Vec<Touch> = arguments.touch.iter().filter_map(place).collect();
    let touches = match given.is_empty() {
        true => Dialogue::new(&config, arguments.port.find()?)?.run()?,
        false => given,
    };
    let (paper, found) = found(&config, &touches, arguments.press).map_err(refused)?;
    if found.residual_mm > RESIDUAL_MM {
        eprintln!(
            "touch {} is {:.2} mm off the plane: touch there again, or smooth the sheet",
            found.worst, found.residual_mm
        );
    }
    let mut answer = Answer {
        touches_mm: touches,
        residual_mm: Some(found.residual_mm),
        ..Answer::new(&paper)
    };
    if let Some(path) = store {
        let changed = store_sheet(&path, &paper)?;
        eprintln!("{} changed in {}.", counted(changed, "value"), path.display());
        answer.stored = Some(path.display().to_string());
    }
    show(arguments, &answer)
}

fn show(arguments: &Arguments, answer: &Answer) -> Result<(), ProgramError> {
    if arguments.json {
        return print_json(answer);
    }
    let mut shown = answer.text();
    if let Some(residual_mm) = answer.residual_mm {
        shown.push_str(&format!(
            "found   from {} touches, at most {residual_mm:.3} mm off the plane\n",
            answer.touches_mm.len()
        ));
        if answer.stored.is_none() {
            let [along_x, along_y] = answer.slope;
            shown.push_str(&format!(
                "Not stored; --store does that. In [paper]: pen_down_z_mm = {}, slope = [{along_x}, {along_y}]\n",
                answer.pen_down_z_mm
            ));
        }
    }
    std::io::stdout()
        .write_all(shown.as_bytes())
        .or_else(ProgramError::of_stdout)
}

/// The dialogue that leads to the touches.
struct Dialogue<'a> {
    config: &'a Config,
    kinematics: Kinematics,
    port: PortName,
    ended: Arc<AtomicBool>,
    lines: Receiver<String>,
    touches: Vec<Touch>,
}

impl<'a> Dialogue<'a> {
    fn new(config: &'a Config, port: PortName) -> Result<Self, ProgramError> {
        let kinematics =
            Kinematics::new(&config.geometry).map_err(|cause| ProgramError::failed("the dimensions", cause))?;
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
            kinematics,
            port,
            ended: ended_by_a_signal()?,
            lines,
            touches: Vec::new(),
        })
    }

    fn run(mut self) -> Result<Vec<Touch>, ProgramError> {
        // A machine that does not know where it is, is told at once.
        self.position()?;
        eprintln!(
            "Move the pen to three or more places near the corners of the sheet, each time down until it touches.\n{WORDS}"
        );
        loop {
            eprint!("touch {}> ", self.touches.len() + 1);
            let Some(line) = self.line()? else {
                return Ok(self.touches);
            };
            match line.trim() {
                "" => self.touch()?,
                "done" if self.touches.len() >= TOUCHES_MIN => return Ok(self.touches),
                "done" => eprintln!(
                    "{}",
                    TouchError::Few {
                        touches: self.touches.len()
                    }
                ),
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

    /// The next line; `None` when standard input has ended.
    fn line(&self) -> Result<Option<String>, ProgramError> {
        loop {
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => return Ok(Some(line)),
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
                Err(RecvTimeoutError::Timeout) if self.ended.load(Ordering::Relaxed) => {
                    return Err(ProgramError::new(code::FAILED, "ended; nothing was stored"));
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    fn own<T>(&self, work: impl FnOnce(OwnPort) -> T) -> T {
        let (config, ended) = (self.config, &self.ended);
        work(OwnPort {
            config: &|| Ok(config.clone()),
            interrupted: &|| Ok(Arc::clone(ended)),
            tell: &|waiting| eprintln!("{waiting}"),
        })
    }

    fn position(&self) -> Result<Position, ProgramError> {
        let snapshot = self.own(|own| MachineAccess::find(&self.port, own))?.state()?;
        standing(self.config, &self.kinematics, &snapshot)
    }

    fn touch(&mut self) -> Result<(), ProgramError> {
        let touch = self.position()?.into();
        let [x, y, z]: Touch = touch;
        self.touches.push(touch);
        eprintln!("touch {}: x {x:.2}, y {y:.2}, z {z:.3} mm", self.touches.len());
        match fit(&self.touches) {
            Ok(Fit { plane, residual_mm, .. }) => eprintln!(
                "tilt {:.3} degrees, at most {residual_mm:.3} mm off the plane; another touch, or done",
                tilt_deg(plane.slope)
            ),
            Err(TouchError::Few { .. }) => {}
            Err(cause) => eprintln!("{cause}; undo forgets the last touch"),
        }
        Ok(())
    }

    /// Moves the pen; the operator sees why it does not.
    fn go(&self, by_mm: [f64; 3]) {
        let moved = self.position().and_then(|from| {
            let from: [f64; 3] = from.into();
            let to = [0, 1, 2].map(|axis| from[axis] + by_mm[axis]);
            let order = Order::Motion(Motion::Move(Position::from(to)));
            self.own(|own| access::carry_out(&self.port, own, order))?;
            self.position()
        });
        match moved {
            Ok(Position { x_mm, y_mm, z_mm }) => eprintln!("x {x_mm:.2}, y {y_mm:.2}, z {z_mm:.3} mm"),
            Err(error) => eprintln!("{}", error.message),
        }
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
fn standing(config: &Config, kinematics: &Kinematics, snapshot: &Snapshot) -> Result<Position, ProgramError> {
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
    kinematics.forward(&joints).map_err(|cause| {
        let why = text::outside(&Outside::Kinematics(cause));
        ProgramError::new(code::FAILED, format!("the machine's position is not possible: {why}"))
    })
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
}

//! `etherpen paper`: where the sheet lies, and how the pen finds it.

mod dialogue;

use super::ports::SessionPort;
use super::{ConfigArguments, print_json};
use crate::error::{ProgramError, code};
use crate::settings::sheet::{follows, found, store_sheet};
use crate::terminal::counted;
use crate::touches::{PRESS_MM, Touch, check_residual, rise_mm, tilt_deg};
use dialogue::{Dialogue, Wishes};
use etherpen::config::Paper;
use serde::Serialize;
use std::io::Write;

/// Distance of a touch from the plane that is worth a word, mm: as much as a pen's spring gives way.
const RESIDUAL_MM: f64 = 0.3;

/// Options of `etherpen paper`.
///
/// Without --touch it shows where the configuration says the sheet lies. With --touch and no places it asks for touches: jog
/// the pen to three or more places far apart, down until it touches the sheet, and press Enter. Jog here, on the console's page
/// or with `etherpen jog`. A step sideways raises the pen first. The lowest place is paper.pressing_depth_mm below the sheet as
/// it is configured: if the pen does not reach the sheet, lower paper.pen_down_z_mm.
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
    /// is unchanged. Of four or more touches none may be more than 0.5 mm off the plane.
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
        true => {
            let wishes = Wishes {
                press_mm: arguments.press,
                store: arguments.store,
            };
            Dialogue::new(&config, arguments.port.find()?, wishes)?.run()?
        }
        false => given,
    };
    let (paper, found) = found(&config, &touches, arguments.press).map_err(refused)?;
    if arguments.store {
        check_residual(&touches, &found).map_err(|cause| refused(cause.to_string()))?;
    }
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
        let changed = store_sheet(&path, &config, &paper, "this command")?;
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

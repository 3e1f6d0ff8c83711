//! The time-optimal speed along the planner's own shaped path, by the crate copp (TOPP2-RA).
//!
//! Reads limits and vertices from standard input, prints `FIGURE SUBJECT VALUE`, a line each. The path is shaped by
//! etherpen and divided into a grid; copp gets the same joint speeds, joint accelerations, speed and acceleration of the
//! platform as rows, and solves between the places where the path rests. For the duration the grid is finer than the
//! planner's and the circle of the acceleration is a polygon around it, so the duration is a lower bound; for the planning
//! time the grid is the planner's own. The planner's time covers shaping, planning and all 1 ms references, copp's only
//! rows and solution.

use copp::constraints::Constraints;
use copp::solver::topp2_ra::{ReachSet2OptionsBuilder, Topp2ProblemBuilder, s_to_t_topp2, topp2_ra};
use etherpen::config::Config;
use etherpen::motion::{MotionCommand, MotionState, Outline, Pen, Section, Settings, Station, Trajectory, Vertex};
use etherpen::robots::{JointAngles, Kind, Kinematics, MAIN_AXES};
use nalgebra::DMatrix;
use std::error::Error;
use std::io::Read;
use std::time::Instant;

/// Refinements of the planner's grid for the duration.
const FINE: u32 = 6;
/// Directions of the polygon around the circle of the acceleration, in a quarter.
const DIRECTIONS: u32 = 16;
/// Directions of the polygon in a quarter where the planning time is measured: as many as the planner has.
const DIRECTIONS_TIMED: u32 = 4;
/// Millimetres in copp's unit of length: its tolerances are absolute, and in metres its numbers are about 1.
const UNIT_MM: f64 = 1_000.0;
/// Runs of which the fastest counts.
const RUNS: usize = 5;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// A place of the grid.
struct Place {
    /// Arc length from the last rest, mm.
    along_mm: f64,
    /// The path just before and just behind it.
    stations: Vec<Station>,
    /// Largest squared speed, mm2/s2.
    speed_squared: f64,
}

fn main() -> Outcome<()> {
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text)?;
    let (config, path) = parse(&text)?;
    let sections = sections(&config, &path)?;
    let fine = grids(&config, &sections, FINE);
    println!("duration_s copp {}", solve(&config, &fine, DIRECTIONS)?);
    let coarse = grids(&config, &sections, 1);
    let mut times = [f64::INFINITY; 2];
    for _ in 0..RUNS {
        let start = Instant::now();
        solve(&config, &coarse, DIRECTIONS_TIMED)?;
        times[0] = times[0].min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        plan(&config, &path)?;
        times[1] = times[1].min(start.elapsed().as_secs_f64());
    }
    println!("planning_s copp {}", times[0]);
    println!("planning_s etherpen {}", times[1]);
    Ok(())
}

/// First line: the kind of robot, of which the usual machine is meant. Second line: speeds and accelerations of the main
/// axes, speed and acceleration of the tool, tolerance. Then a vertex a line: x, y, z, pen.
fn parse(text: &str) -> Outcome<(Config, Vec<Vertex>)> {
    let mut lines = text.lines();
    let kind = lines.next().and_then(Kind::named).ok_or("no kind of robot")?;
    let mut lines = lines.map(|line| line.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>());
    let usual = Settings::usual(kind.geometry());
    let mut config = Config {
        geometry: usual.geometry,
        work_area: usual.work_area,
        paper: usual.paper,
        ..Config::default()
    };
    let limits = lines.next().ok_or("no limits")??;
    let [
        speed_a,
        speed_b,
        speed_c,
        acceleration_a,
        acceleration_b,
        acceleration_c,
        speed,
        acceleration,
        tolerance,
    ] = limits.as_slice()
    else {
        return Err("nine limits are needed".into());
    };
    let motion = &mut config.motion;
    let [_, _, _, turn_speed] = motion.joint_speed_rad_s;
    let [_, _, _, turn_acceleration] = motion.joint_acceleration_rad_s2;
    motion.joint_speed_rad_s = [*speed_a, *speed_b, *speed_c, turn_speed];
    motion.joint_acceleration_rad_s2 = [*acceleration_a, *acceleration_b, *acceleration_c, turn_acceleration];
    (motion.speed_mm_s, motion.travel_speed_mm_s) = (*speed, *speed);
    motion.acceleration_mm_s2 = *acceleration;
    (motion.tolerance_mm, motion.travel_tolerance_mm) = (*tolerance, *tolerance);
    motion.jerk_window_ms = 0;
    let mut path = Vec::new();
    for line in lines {
        let values = line?;
        let [x, y, z, pen] = values.as_slice() else {
            return Err("a vertex has four values".into());
        };
        path.push(Vertex {
            position: [*x, *y, *z].into(),
            pen: if *pen > 0.5 { Pen::Down } else { Pen::Up },
            stroke: 0,
        });
    }
    Ok((config, path))
}

fn sections(config: &Config, path: &[Vertex]) -> Outcome<Vec<Section>> {
    let [first, rest @ ..] = path else {
        return Err("no vertices".into());
    };
    let mut outline = Outline::new(&config.motion_settings(), first).map_err(|cause| format!("{cause:?}"))?;
    let (mut sections, mut rest) = (Vec::new(), rest.iter().peekable());
    loop {
        while let Some(vertex) = rest.peek() {
            if !outline.push(vertex) {
                break;
            }
            rest.next();
        }
        if rest.peek().is_none() {
            outline.finish();
        }
        match outline.next_leg() {
            Some(leg) => sections.extend(leg),
            None => return Ok(sections),
        }
    }
}

/// A grid for each part of the path between two rests.
fn grids(config: &Config, sections: &[Section], refinement: u32) -> Vec<Vec<Place>> {
    let mut grids = Vec::new();
    let mut grid: Vec<Place> = Vec::new();
    for section in sections {
        let motion = &config.motion;
        let speed = if section.is_drawn() {
            motion.speed_mm_s
        } else {
            motion.travel_speed_mm_s
        };
        let intervals = u32::from(section.intervals()) * refinement;
        let parameter = |interval: u32| f64::from(interval) / f64::from(intervals);
        let mut along_mm = grid.last().map_or(0.0, |place| place.along_mm);
        let place = |along_mm, at| Place {
            along_mm,
            stations: vec![section.station(at)],
            speed_squared: speed * speed,
        };
        match grid.last_mut() {
            None => grid.push(place(0.0, 0.0)),
            // Pieces join here: both sides' limits hold.
            Some(last) => {
                last.stations.push(section.station(0.0));
                last.speed_squared = last.speed_squared.min(speed * speed);
            }
        }
        for interval in 1..=intervals {
            along_mm += section.arc_mm(parameter(interval - 1), parameter(interval));
            grid.push(place(along_mm, parameter(interval)));
        }
        if section.stops() {
            grids.push(std::mem::take(&mut grid));
        }
    }
    grids
}

/// Duration of the whole path, s.
fn solve(config: &Config, grids: &[Vec<Place>], directions: u32) -> Outcome<f64> {
    let mut duration_s = 0.0;
    for grid in grids {
        duration_s += solve_part(config, grid, directions)?;
    }
    Ok(duration_s)
}

fn solve_part(config: &Config, grid: &[Place], directions: u32) -> Outcome<f64> {
    let motion = &config.motion;
    let s: Vec<f64> = grid.iter().map(|place| place.along_mm / UNIT_MM).collect();
    let count = grid.len();
    let speeds: Vec<f64> = grid
        .iter()
        .map(|place| speed_squared(config, place) / UNIT_MM.powi(2))
        .collect();
    // The direction across the path alone bounds the speed, see there.
    let polygon: Vec<(f64, f64)> = (0..directions)
        .map(|index| (std::f64::consts::FRAC_PI_2 * f64::from(index) / f64::from(directions)).sin_cos())
        .collect();
    let rows_of = |station: &Station| {
        let mut rows: Vec<(f64, f64, f64)> = Vec::new();
        for axis in 0..MAIN_AXES {
            let (slope, bend) = (
                station.joints.slope[axis] * UNIT_MM,
                station.joints.bend[axis] * UNIT_MM.powi(2),
            );
            let limit = motion.joint_acceleration_rad_s2[axis];
            rows.push((bend / limit, slope / limit, 1.0));
            rows.push((-bend / limit, -slope / limit, 1.0));
        }
        for (across, along) in &polygon {
            let limit = motion.acceleration_mm_s2 / UNIT_MM;
            let turn = across * station.curvature * UNIT_MM / limit;
            rows.push((turn, along / limit, 1.0));
            rows.push((turn, -along / limit, 1.0));
        }
        rows
    };
    let height = 2 * (MAIN_AXES * 2 + polygon.len() * 2);
    let (mut a, mut b) = (DMatrix::zeros(height, count), DMatrix::zeros(height, count));
    let mut most = DMatrix::from_element(height, count, 1.0);
    for (column, place) in grid.iter().enumerate() {
        for (row, (of_a, of_b, limit)) in place.stations.iter().flat_map(rows_of).enumerate() {
            (a[(row, column)], b[(row, column)], most[(row, column)]) = (of_a, of_b, limit);
        }
    }
    let mut constraints = Constraints::with_capacity(MAIN_AXES, count);
    let speeds = DMatrix::from_row_slice(1, count, &speeds);
    constraints
        .with_s(s.as_slice())?
        .with_constraint_1order(&speeds.as_view(), 0)?
        .with_constraint_2order(&a.as_view(), &b.as_view(), &most.as_view(), 0, false)?;
    let problem = Topp2ProblemBuilder::with_constraint(&constraints, (0, count - 1), (0.0, 0.0)).build()?;
    let squared = topp2_ra(&problem, &ReachSet2OptionsBuilder::new().build()?)?;
    Ok(s_to_t_topp2(&s, &squared, 0.0)?.0)
}

fn speed_squared(config: &Config, place: &Place) -> f64 {
    let slopes = place.stations.iter().flat_map(|station| station.joints.slope);
    let bends = place.stations.iter().map(|station| station.curvature);
    let most = bends.fold(place.speed_squared, |most, curvature| {
        most.min(config.motion.acceleration_mm_s2 / curvature)
    });
    slopes
        .zip(config.motion.joint_speed_rad_s.iter().take(MAIN_AXES).cycle())
        .fold(most, |most, (slope, speed)| most.min((speed / slope).powi(2)))
}

/// The planner's whole work for a path.
fn plan(config: &Config, path: &[Vertex]) -> Outcome<()> {
    let mut trajectory = Box::new(Trajectory::new(&config.motion_settings()).map_err(|cause| format!("{cause:?}"))?);
    let kinematics = Kinematics::new(&config.geometry).map_err(|cause| format!("{cause:?}"))?;
    let first = path.first().ok_or("no vertices")?;
    let [a, b, c] = kinematics
        .inverse(&first.position)
        .map_err(|cause| format!("{cause:?}"))?;
    trajectory.place(JointAngles([a, b, c, 0.0]));
    let (mut rest, mut started) = (path.iter(), false);
    loop {
        while trajectory.free() > 0 {
            match rest.next() {
                Some(vertex) => trajectory.push(*vertex).map_err(|cause| format!("{cause:?}"))?,
                None => {
                    trajectory.finish();
                    break;
                }
            }
        }
        if !started {
            trajectory
                .command(MotionCommand::Start)
                .map_err(|cause| format!("{cause:?}"))?;
            started = true;
        }
        std::hint::black_box(trajectory.step());
        if trajectory.state() == MotionState::Idle && rest.len() == 0 {
            return Ok(());
        }
    }
}

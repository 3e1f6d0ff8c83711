//! The graph of the operating modes in the documentation, from the transitions that the search reaches.
//!
//! `docs/modes.md` has the tables and `docs/modes.svg` the picture. After an intended change, run
//! `ETHERPEN_RENEW_MODES=1 cargo test --lib the_modes_in_the_documentation` and look at the picture.

extern crate std;

use super::super::step::{FOLLOWED_MS, RESET_MS, SETTLE_MS};
use super::super::*;
use super::world::Move;
use super::{COMMANDS_MAX, FOUND, Found, WAY_MAX_MS};
use std::collections::{BTreeMap, BTreeSet};
use std::format;
use std::path::PathBuf;
use std::string::{String, ToString};
use std::vec::Vec;

const TABLE: &str = "docs/modes.md";
const PICTURE: &str = "docs/modes.svg";
/// Set to write both files instead of comparing with them.
const RENEW: &str = "ETHERPEN_RENEW_MODES";

/// Why the mode changed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Event {
    Configuration,
    BusUp,
    /// A command that changes the mode at once.
    Command(String),
    Powered,
    Homed,
    HomingFailed,
    Searched,
    SearchEnded,
    AtRest,
    HostSilent,
    PowerOff,
    Recovered,
    Fault(&'static str),
}

impl Event {
    pub(super) fn of(before: &Application, step: Move, after: &Application) -> Self {
        match step {
            Move::Configure(_) => Self::Configuration,
            Move::Command(command) => {
                let told = format!("{command:?}");
                let name = told.split([' ', '(']).next().unwrap_or_default();
                Self::Command(name.to_string())
            }
            Move::Bus(BusCondition::Operational) => Self::BusUp,
            Move::Bus(_) => Self::Fault("the bus supervisor reports a failure"),
            _ => match after.fault.filter(|_| before.fault.is_none()) {
                Some(fault) => Self::Fault(told(&fault)),
                None if before.stop.is_some() => Self::PowerOff,
                None if before.recovering_since_ms.is_some() => Self::Recovered,
                None if before.mode == Mode::Homing && after.mode == Mode::Idle => Self::Searched,
                None if before.mode == Mode::Homing => Self::SearchEnded,
                None if before.enabling == Enabling::No && after.mode == Mode::Holding => Self::HostSilent,
                None => match before.enabling {
                    Enabling::Powering { .. } => Self::Powered,
                    Enabling::Homing { .. } if after.mode == Mode::Idle => Self::Homed,
                    Enabling::Homing { .. } => Self::HomingFailed,
                    Enabling::No => Self::AtRest,
                },
            },
        }
    }

    fn is_stop(&self) -> bool {
        matches!(self, Self::Fault(_)) || *self == Self::Command("Stop".to_string())
    }

    /// Its text in the picture.
    fn label(&self) -> &str {
        match self {
            Self::Configuration => "configuration",
            Self::BusUp => "bus up",
            Self::Command(name) => name,
            Self::Powered => "Enable",
            Self::Homed => "Home",
            Self::HomingFailed => "Home failed",
            Self::Searched => "switches found",
            Self::SearchEnded => "Cancel",
            Self::AtRest => "at rest",
            Self::HostSilent => "host silent",
            Self::PowerOff => "brakes, power off",
            Self::Recovered => "Acknowledge",
            Self::Fault(cause) => cause,
        }
    }

    /// Its text in the tables.
    fn text(&self) -> String {
        match self {
            Self::Configuration => "configuration accepted".to_string(),
            Self::BusUp => "bus operational".to_string(),
            Self::Command(name) => format!("`{name}`"),
            Self::Powered => "`Enable`, then drives powered".to_string(),
            Self::Homed => "`Home`, then angles known".to_string(),
            Self::HomingFailed => "`Home`, no angles in time".to_string(),
            Self::Searched => "home switches found".to_string(),
            Self::SearchEnded => "`Cancel` or host silent, then at rest".to_string(),
            Self::AtRest => "motion ended, at rest".to_string(),
            Self::HostSilent => "host silent".to_string(),
            Self::PowerOff => "standstill, brakes, power off".to_string(),
            Self::Recovered => "`Acknowledge`, then recovered".to_string(),
            Self::Fault(cause) => (*cause).to_string(),
        }
    }
}

fn told(fault: &Fault) -> &'static str {
    match fault {
        Fault::Blind { .. } => "the critical tasks latch a fault",
        Fault::EmergencyStop(StopSource::Input) => "the board's input opens",
        Fault::ReferenceLost { .. } => "an axis loses its joint angle",
        Fault::MotionStalled { .. } => "a motion makes no progress",
        Fault::EnableTimeout { .. } => "the drives take no power in time",
        _ => panic!("the graph has no name for {fault:?}"),
    }
}

/// Changes of the mode: numbers of both modes, and why.
pub(super) type Changes = BTreeMap<(u8, u8), BTreeSet<Event>>;

fn mode(number: u8) -> Mode {
    Mode::from_number(number).expect("a mode")
}

fn list(modes: &BTreeSet<u8>) -> String {
    let names = |numbers: &mut dyn Iterator<Item = u8>| {
        let names: Vec<String> = numbers.map(|number| format!("`{:?}`", mode(number))).collect();
        names.join(", ")
    };
    let mut others = (0..Mode::ALL.len() as u8).filter(|number| !modes.contains(number));
    match Mode::ALL.len() - modes.len() {
        0 => "every mode".to_string(),
        1 | 2 => format!("every mode but {}", names(&mut others)),
        _ => names(&mut modes.iter().copied()),
    }
}

/// A mode's comment in the code.
fn meaning(mode: Mode) -> String {
    let code = include_str!("../mode.rs");
    let (before, _) = code.split_once(&format!("    {mode:?},\n")).expect("the variant");
    let comment = before.lines().rev().find_map(|line| line.trim().strip_prefix("/// "));
    comment.expect("a comment").to_string()
}

fn table(found: &Found) -> String {
    let mut text = format!(
        "\
# Operating modes

Written from the code: an exhaustive search (`src/application/search`) applies every command, report of the bus, change of the
drives' and the trajectory's state, and waiting time, in every order, and finds {} states and {} transitions.
The picture and the tables show those that change the mode. A refused command changes nothing.
`cargo test --lib the_modes_in_the_documentation` compares; `ETHERPEN_RENEW_MODES=1` before it renews this page.

<img src=\"modes.svg\" width=\"920\" alt=\"The operating modes and the transitions between them\">

| mode | meaning |
|---|---|
",
        thousands(found.states.len()),
        thousands(found.transitions)
    );
    for mode in Mode::ALL {
        text += &format!("| `{mode:?}` | {} |\n", meaning(mode));
    }
    text += "\n## Transitions\n\n| from | event | to |\n|---|---|---|\n";
    let mut causes: BTreeMap<(&Event, u8), BTreeSet<u8>> = BTreeMap::new();
    for ((from, to), events) in &found.changes {
        for event in events {
            causes.entry((event, *to)).or_default().insert(*from);
        }
    }
    // Events that lead from the same modes to the same one share a row.
    let mut rows: BTreeMap<(&BTreeSet<u8>, u8), Vec<&Event>> = BTreeMap::new();
    for ((event, to), from) in &causes {
        if !event.is_stop() {
            rows.entry((from, *to)).or_default().push(event);
        }
    }
    for ((from, to), events) in rows {
        let events: Vec<String> = events.iter().map(|event| event.text()).collect();
        text += &format!("| {} | {} | `{:?}` |\n", list(from), events.join(", "), mode(to));
    }
    text += "
## Faults and stops

If a drive has power, or does not report that it has none, the mode becomes `Stopping`: quick stop, or a stop on the path that ends
in one ([stops.md](stops.md)), standstill, brakes, power off, then `Fault`. Otherwise it becomes `Fault` at once. The first fault
stays latched until `Acknowledge` has succeeded or a configuration was accepted.

| event | `Stopping` from | `Fault` at once from |
|---|---|---|
";
    let stops: BTreeSet<&Event> = causes
        .keys()
        .map(|(event, _)| *event)
        .filter(|event| event.is_stop())
        .collect();
    for event in stops {
        let from = |to: Mode| causes.get(&(event, to.number())).map_or("-".to_string(), list);
        text += &format!(
            "| {} | {} | {} |\n",
            event.text(),
            from(Mode::Stopping),
            from(Mode::Fault)
        );
    }
    text += &format!(
        "
## Time limits

| wait | at most |
|---|---|
| standstill after a stop has begun | {} ms |
| brakes closing before the power is taken | {} ms |
| drives following a change of their power; angles after `Home` | {} ms |
| bus and drives after `Acknowledge` (a drive's reset needs {RESET_MS} ms) | {} ms |
| joints following the last setpoint, before a motion counts as ended | {FOLLOWED_MS} ms |
| reports of the other tasks following a homing | {SETTLE_MS} ms |
| from any state to `Idle`, once nothing fails any more, with at most {COMMANDS_MAX} commands of the operator | {} ms |
",
        thousands(STANDSTILL_MAX_MS as usize),
        BRAKE_DELAY_MS,
        thousands(ENABLE_MAX_MS as usize),
        thousands(RECOVERY_MAX_MS as usize),
        thousands(WAY_MAX_MS as usize),
    );
    text
}

fn thousands(number: usize) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Centre of each mode's box in the picture, by number.
const CENTRES: [(f64, f64); 11] = [
    (280.0, 80.0),
    (280.0, 190.0),
    (280.0, 320.0),
    (500.0, 320.0),
    (520.0, 190.0),
    (800.0, 80.0),
    (940.0, 190.0),
    (730.0, 300.0),
    (730.0, 520.0),
    (280.0, 520.0),
    (500.0, 80.0),
];
/// Half a box's width and height.
const BOX: (f64, f64) = (72.0, 19.0);
/// How far the middle of an edge lies to the left of the straight line, if there is an edge back.
const BEND: f64 = 12.0;

/// An edge that is not a straight line or an arc with its text in the middle.
struct Route {
    from: Mode,
    to: Mode,
    path: &'static str,
    text: (f64, f64),
    anchor: &'static str,
}
const ROUTES: [Route; 10] = [
    Route {
        from: Mode::Idle,
        to: Mode::Homing,
        path: "M492 171V99",
        text: (488.0, 140.0),
        anchor: "end",
    },
    Route {
        from: Mode::Homing,
        to: Mode::Idle,
        path: "M512 99V171",
        text: (518.0, 143.0),
        anchor: "start",
    },
    Route {
        from: Mode::Unreferenced,
        to: Mode::Homing,
        path: "M442 301V99",
        text: (446.0, 230.0),
        anchor: "start",
    },
    Route {
        from: Mode::Homing,
        to: Mode::Unreferenced,
        path: "M432 99V301",
        text: (427.0, 130.0),
        anchor: "end",
    },
    Route {
        from: Mode::Fault,
        to: Mode::Startup,
        path: "M208 526H100V80H208",
        text: (94.0, 300.0),
        anchor: "end",
    },
    Route {
        from: Mode::Fault,
        to: Mode::BusConfiguring,
        path: "M208 514H140V190H208",
        text: (146.0, 400.0),
        anchor: "start",
    },
    Route {
        from: Mode::Fault,
        to: Mode::DrivesOff,
        path: "M335 501V339",
        text: (341.0, 480.0),
        anchor: "start",
    },
    Route {
        from: Mode::Stopping,
        to: Mode::DrivesOff,
        path: "M668 501L347 339",
        text: (500.0, 440.0),
        anchor: "end",
    },
    Route {
        from: Mode::Stopping,
        to: Mode::Idle,
        path: "M718 501L532 209",
        text: (668.0, 410.0),
        anchor: "start",
    },
    Route {
        from: Mode::Holding,
        to: Mode::Idle,
        path: "M694 281L556 209",
        text: (636.0, 240.0),
        anchor: "start",
    },
];

/// Frames around modes: title, and x, y, width, height.
const FRAMES: [(&str, [f64; 4]); 2] = [
    ("drives without power", [165.0, 30.0, 220.0, 330.0]),
    ("drives with power", [415.0, 30.0, 615.0, 330.0]),
];
/// One edge for those of several modes to the same mode.
struct Group {
    modes: &'static [Mode],
    to: Mode,
    path: &'static str,
    text: (f64, f64),
}
const GROUPS: [Group; 3] = [
    Group {
        modes: &[Mode::Startup, Mode::BusConfiguring, Mode::DrivesOff],
        to: Mode::Fault,
        path: "M232 360V501",
        text: (238.0, 440.0),
    },
    Group {
        modes: &[Mode::BusConfiguring, Mode::DrivesOff],
        to: Mode::Stopping,
        path: "M385 345L694 501",
        text: (540.0, 402.0),
    },
    Group {
        modes: &[
            Mode::Unreferenced,
            Mode::Homing,
            Mode::Idle,
            Mode::Moving,
            Mode::Drawing,
            Mode::Holding,
        ],
        to: Mode::Stopping,
        path: "M800 360L765 501",
        text: (800.0, 425.0),
    },
];

/// Lines of text around a point, or to one side of it.
fn lines(texts: &[String], (x, y): (f64, f64), anchor: &str) -> String {
    let first = y + 4.5 - 8.0 * (texts.len() as f64 - 1.0);
    let line = |(number, text): (usize, &String)| {
        let y = first + 16.0 * number as f64;
        format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" class=\"label\">{text}</text>\n")
    };
    texts.iter().enumerate().map(line).collect()
}

/// Where the line from a box's centre to a point leaves the box.
fn border((x, y): (f64, f64), towards: (f64, f64)) -> (f64, f64) {
    let (dx, dy) = (towards.0 - x, towards.1 - y);
    let scale = (BOX.0 / dx.abs()).min(BOX.1 / dy.abs());
    (x + dx * scale, y + dy * scale)
}

/// An edge as a path, its text's place, and to which side of the place the text lies.
fn arc(from: Mode, to: Mode, bend: f64) -> (String, (f64, f64), &'static str) {
    let (begin, end) = (CENTRES[from as usize], CENTRES[to as usize]);
    let (dx, dy) = (end.0 - begin.0, end.1 - begin.1);
    let length = libm::hypot(dx, dy);
    let left = (dy / length, -dx / length);
    // The curve's middle lies halfway between the straight line and the control point.
    let control = (
        (begin.0 + end.0) / 2.0 + 2.0 * bend * left.0,
        (begin.1 + end.1) / 2.0 + 2.0 * bend * left.1,
    );
    let (begin, end) = (border(begin, control), border(end, control));
    let middle = |begin: f64, control: f64, end: f64| begin / 4.0 + control / 2.0 + end / 4.0;
    let place = (
        middle(begin.0, control.0, end.0) + 10.0 * left.0,
        middle(begin.1, control.1, end.1) + 10.0 * left.1,
    );
    let anchor = match left.0 {
        side if side > 0.4 => "start",
        side if side < -0.4 => "end",
        _ => "middle",
    };
    let [bx, by, cx, cy, ex, ey] = [begin.0, begin.1, control.0, control.1, end.0, end.1];
    let path = format!("M{bx:.1} {by:.1}Q{cx:.1} {cy:.1} {ex:.1} {ey:.1}");
    (path, place, anchor)
}

/// Short texts of events. Faults and stops are one.
fn short<'a>(events: impl Iterator<Item = &'a Event> + Clone) -> Vec<String> {
    let named = events.clone().filter(|event| !event.is_stop());
    let mut texts: Vec<String> = named.map(|event| event.label().to_string()).collect();
    let stops: Vec<&Event> = events.filter(|event| event.is_stop()).collect();
    match stops.as_slice() {
        [] => {}
        [one] => texts.push(one.label().to_string()),
        _ => texts.push("Stop, any fault".to_string()),
    }
    texts
}

/// Takes the edges of a group; events that do not lead from all of its modes name those from which they lead.
fn of_group(group: &Group, edges: &mut Changes) -> Vec<String> {
    let mut from: BTreeMap<Event, Vec<String>> = BTreeMap::new();
    for mode in group.modes {
        let events = edges.remove(&(mode.number(), group.to.number()));
        let events = events.unwrap_or_else(|| panic!("{mode:?} does not lead to {:?}", group.to));
        assert!(events.iter().any(Event::is_stop), "{mode:?} has no stop");
        for event in events {
            from.entry(event).or_default().push(format!("{mode:?}"));
        }
    }
    let mut texts = Vec::from(["Stop, any fault".to_string()]);
    for (event, modes) in from.iter().filter(|(event, _)| !event.is_stop()) {
        texts.push(match modes.len() == group.modes.len() {
            true => event.label().to_string(),
            false => format!("{} ({})", event.label(), modes.join(", ")),
        });
    }
    texts
}

fn picture(found: &Found) -> String {
    let mut text = "\
<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"1050\" height=\"570\" viewBox=\"0 0 1050 570\" font-family=\"sans-serif\" font-size=\"14\">
<style>
.edge{fill:none;stroke:#444;stroke-width:1.4;marker-end:url(#tip)}
.label{paint-order:stroke;stroke:white;stroke-width:4px;fill:#222}
.group{fill:#f6f8fa;stroke:#999;stroke-dasharray:5 4}
</style>
<defs><marker id=\"tip\" viewBox=\"0 0 10 10\" refX=\"9\" refY=\"5\" markerWidth=\"8\" markerHeight=\"8\" orient=\"auto\"><path d=\"M0 0L10 5L0 10z\" fill=\"#444\"/></marker></defs>
<rect width=\"100%\" height=\"100%\" fill=\"white\"/>
"
    .to_string();
    for (title, [x, y, width, height]) in &FRAMES {
        text +=
            &format!("<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"10\" class=\"group\"/>\n");
        text += &format!(
            "<text x=\"{}\" y=\"{}\" fill=\"#666\">{title}</text>\n",
            x + 10.0,
            y + 20.0
        );
    }
    let mut edges = found.changes.clone();
    let mut draw = |path: &str, texts: &[String], place, anchor| {
        text += &format!("<path d=\"{path}\" class=\"edge\"/>\n");
        text += &lines(texts, place, anchor);
    };
    for group in &GROUPS {
        draw(group.path, &of_group(group, &mut edges), group.text, "start");
    }
    for ((from, to), events) in &edges {
        let is_pair = edges.contains_key(&(*to, *from));
        let (from, to) = (mode(*from), mode(*to));
        let texts = [short(events.iter()).join(", ")];
        match ROUTES.iter().find(|route| (route.from, route.to) == (from, to)) {
            Some(route) => draw(route.path, &texts, route.text, route.anchor),
            None => {
                let (path, place, anchor) = arc(from, to, if is_pair { BEND } else { 0.0 });
                draw(&path, &texts, place, anchor);
            }
        }
    }
    for mode in Mode::ALL {
        let (x, y) = CENTRES[mode as usize];
        let fill = match mode {
            Mode::Fault => "#fbd5d0",
            Mode::Stopping => "#fde8c4",
            Mode::Moving | Mode::Drawing | Mode::Holding => "#d5e8fb",
            Mode::Idle => "#d6f0d8",
            _ => "white",
        };
        let (left, top, width, height) = (x - BOX.0, y - BOX.1, 2.0 * BOX.0, 2.0 * BOX.1);
        text += &format!(
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" rx=\"6\" fill=\"{fill}\" stroke=\"#222\"/>\n"
        );
        text += &format!(
            "<text x=\"{x}\" y=\"{}\" text-anchor=\"middle\">{mode:?}</text>\n",
            y + 5.0
        );
    }
    text + "</svg>\n"
}

#[test]
fn the_modes_in_the_documentation_are_those_of_the_code() {
    for (file, made) in [(TABLE, table(&FOUND)), (PICTURE, picture(&FOUND))] {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(file);
        if std::env::var_os(RENEW).is_some() {
            std::fs::write(&path, &made).expect("the file can be written");
        }
        let written = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(
            written == made,
            "{file} is not what the search finds; renew it with {RENEW}=1"
        );
    }
}

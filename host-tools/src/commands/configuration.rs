//! `etherpen config`: a new configuration file, checks of one, and the values in effect with the source of each.

mod scan;

use super::bus::WayArguments;
use super::ports::OptionalPort;
use super::{ConfigArguments, print_json};
use crate::axes::{self, Motion};
use crate::error::{ProgramError, code};
use crate::settings::checking::{self, Finding, Gravity};
use crate::settings::machines::MachineChoice;
use crate::settings::reading;
use crate::settings::starting::{self, SIZES, Wishes};
use crate::terminal::counted;
use etherpen::config::Config;
use etherpen::robots::Kind;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;

/// Options of `etherpen config`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand, Debug)]
enum Command {
    /// Print every value in force.
    ///
    /// Values come from the built-in IRB 340 and from a file that overrides it (--config, else ETHERPEN_CONFIG, else
    /// etherpen.toml in this folder). The port comes from --port, else ETHERPEN_PORT.
    Show(Show),
    /// Check a configuration file: what is wrong with line and remedy, what is missing, what is unlikely.
    ///
    /// The exit code is 0 if the file can be used, with or without warnings, and 2 if not.
    Check(Check),
    /// Write a configuration file for a machine of your own.
    ///
    /// Asks on a terminal for everything that no option tells, and takes the bundled machine's value for an empty answer.
    /// Not on a terminal, --kind is needed, and what no option tells is the bundled machine's.
    /// With --scan the axes get the drives of the bus, in its order.
    New(New),
}

#[derive(clap::Args, Debug)]
struct Check {
    /// The file. Default: --config, else ETHERPEN_CONFIG, else etherpen.toml in this folder.
    file: Option<PathBuf>,
    /// Print the findings as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

#[derive(clap::Args, Debug)]
struct New {
    /// The file to write.
    #[arg(default_value = "etherpen.toml")]
    file: PathBuf,
    /// Kind of machine.
    #[arg(long, value_name = "KIND", value_parser = kind)]
    kind: Option<Kind>,
    /// Travel of a gantry or CoreXY along x, mm.
    #[arg(long, value_name = "MM")]
    width: Option<f64>,
    /// Travel of a gantry or CoreXY along y, mm.
    #[arg(long, value_name = "MM")]
    depth: Option<f64>,
    /// Travel of a gantry or SCARA along z, mm.
    #[arg(long, value_name = "MM")]
    height: Option<f64>,
    /// Length of a SCARA's inner link, mm.
    #[arg(long, value_name = "MM")]
    inner_link: Option<f64>,
    /// Length of a SCARA's outer link, mm.
    #[arg(long, value_name = "MM")]
    outer_link: Option<f64>,
    /// Linear delta: from the axis to a rod's upper joint, less that of the lower joint, mm.
    #[arg(long, value_name = "MM")]
    radius: Option<f64>,
    /// Length of a linear delta's rods, mm.
    #[arg(long, value_name = "MM")]
    rod: Option<f64>,
    /// Travel of linear axes for one turn of the pulley or screw, mm.
    #[arg(long, value_name = "MM")]
    pitch: Option<f64>,
    /// Motor turns for one turn of the joint, pulley or screw; of a SCARA's two links. Negative: the other way.
    #[arg(long, value_name = "TURNS", allow_negative_numbers = true)]
    gear: Option<f64>,
    /// Number of drives (etherpen bus scan lists them).
    #[arg(long, value_name = "NUMBER")]
    drives: Option<usize>,
    /// Look at the bus, and write its drives into the file: vendor, product, and what tells equal ones apart. The bus is
    /// reached by --interface, --udp, --unix or --port. Slaves of an unknown product are asked for their type, in PREOP for
    /// that time if they are in INIT; nothing is written if one does not answer. A board without a configuration gets that
    /// of the kind, keeps it, and brings its bus up.
    #[arg(long)]
    scan: bool,
    #[command(flatten)]
    way: WayArguments,
    /// Overwrite the file.
    #[arg(long)]
    force: bool,
}

fn kind(name: &str) -> Result<Kind, String> {
    let names = Kind::ALL.map(Kind::name).join(", ");
    Kind::named(name).ok_or_else(|| format!("it is one of {names}"))
}

/// The answer of `etherpen config check`.
#[derive(Debug, Serialize)]
struct Checked<'a> {
    file: String,
    /// Whether the file can be used.
    valid: bool,
    findings: &'a [Finding],
}

#[derive(clap::Args, Debug)]
struct Show {
    /// Print where each value comes from.
    #[arg(long)]
    origin: bool,
    /// Print the values as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    port: OptionalPort,
    #[command(flatten)]
    config: ConfigArguments,
}

/// A value and where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ConfigEntry {
    value: serde_json::Value,
    origin: String,
}

/// Runs the command.
///
/// # Errors
/// The configuration cannot be used.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let show = match &arguments.command {
        Command::Show(show) => show,
        Command::Check(check) => return check_file(check),
        Command::New(new) => return new_file(new),
    };
    let entries = entries(show)?;
    if show.json {
        return match show.origin {
            true => print_json(&entries),
            false => print_json(
                &entries
                    .iter()
                    .map(|(key, entry)| (key, &entry.value))
                    .collect::<BTreeMap<_, _>>(),
            ),
        };
    }
    let mut out = std::io::stdout().lock();
    for (key, entry) in &entries {
        let line = match show.origin {
            true => format!("{key} = {}  # {}", entry.value, entry.origin),
            false => format!("{key} = {}", entry.value),
        };
        writeln!(out, "{line}").or_else(ProgramError::of_stdout)?;
    }
    Ok(())
}

fn check_file(arguments: &Check) -> Result<(), ProgramError> {
    let file = arguments.file.clone().or_else(|| arguments.config.path());
    let Some(file) = file else {
        let message = "there is no etherpen.toml in this folder; name a file, or write one: etherpen config new";
        return Err(ProgramError::new(code::USAGE, message));
    };
    let shown = file.display().to_string();
    let text = crate::settings::read(&file)
        .map_err(|cause| ProgramError::new(code::USAGE, format!("{shown} cannot be read: {cause}")))?;
    if let Ok(config) = reading::configuration(&text) {
        axes::set_machine(config.geometry.kind());
    }
    let findings = checking::check(&text);
    let errors = findings
        .iter()
        .filter(|finding| finding.gravity == Gravity::Error)
        .count();
    if arguments.json {
        print_json(&Checked {
            file: shown.clone(),
            valid: errors == 0,
            findings: &findings,
        })?;
    } else {
        let mut out = std::io::stdout().lock();
        for finding in &findings {
            let gravity = if finding.gravity == Gravity::Error {
                "error"
            } else {
                "warning"
            };
            writeln!(out, "{gravity}: {shown}: {finding}").or_else(ProgramError::of_stdout)?;
        }
    }
    if errors > 0 {
        let message = format!("{shown} cannot be used: {}", counted(errors, "error"));
        return Err(ProgramError::new(code::USAGE, message));
    }
    eprintln!("{shown} can be used; {}.", counted(findings.len(), "warning"));
    Ok(())
}

fn new_file(arguments: &New) -> Result<(), ProgramError> {
    let usage = |message: String| ProgramError::new(code::USAGE, message);
    let shown = arguments.file.display();
    if arguments.file.exists() && !arguments.force {
        return Err(usage(format!(
            "{shown} exists; name another file, or overwrite it with --force"
        )));
    }
    let asks = std::io::stdin().is_terminal();
    let kind = match arguments.kind {
        Some(kind) => kind,
        None if asks => ask_kind()?,
        None => {
            let names = Kind::ALL.map(Kind::name).join(", ");
            return Err(usage(format!("which kind of machine? --kind is one of {names}")));
        }
    };
    axes::set_machine(kind);
    let mut wishes = Wishes {
        sizes_mm: [
            arguments.width,
            arguments.depth,
            arguments.height,
            arguments.inner_link,
            arguments.outer_link,
            arguments.radius,
            arguments.rod,
        ],
        pitch_mm: arguments.pitch,
        gear: arguments.gear,
        drives: arguments.drives,
        chain: Vec::new(),
    };
    if arguments.scan {
        // A board that has no configuration needs one to look at its bus.
        let config = starting::compose(kind, &wishes)
            .and_then(|text| reading::configuration(&text).map_err(|cause| cause.to_string()))
            .map_err(usage)?;
        wishes.chain = scan::chain(&mut *arguments.way.open(&config)?)?;
        if wishes.chain.is_empty() {
            return Err(ProgramError::new(code::FAILED, "there is no slave on the bus"));
        }
    } else if let Some(option) = arguments.way.other() {
        return Err(usage(format!(
            "{option} is the way to the bus that --scan looks at; add --scan"
        )));
    }
    if asks {
        ask(kind, &mut wishes)?;
    }
    let text = starting::compose(kind, &wishes).map_err(usage)?;
    crate::output_file::write(&arguments.file, text.as_bytes())
        .map_err(|cause| ProgramError::failed(format!("{shown} cannot be written"), cause))?;
    for note in starting::notes(&text, &wishes.chain).iter().filter(|_| arguments.scan) {
        eprintln!("{note}");
    }
    eprintln!(
        "Written: {shown}. Compare every line with your machine, then: etherpen config check {shown}; etherpen simulate FILE \
         --config {shown}"
    );
    Ok(())
}

/// Asks a question on the terminal; `None` for an empty answer, or if there are no more answers.
fn answer(question: &str) -> Result<Option<String>, ProgramError> {
    let failed = |cause| ProgramError::failed("the terminal", cause);
    eprint!("{question}: ");
    std::io::stderr().flush().map_err(failed)?;
    let mut line = String::new();
    std::io::stdin().read_line(&mut line).map_err(failed)?;
    Ok(Some(line.trim().to_owned()).filter(|line| !line.is_empty()))
}

fn ask_kind() -> Result<Kind, ProgramError> {
    let names = Kind::ALL.map(Kind::name).join(", ");
    let Some(name) = answer(&format!("kind of machine ({names})"))? else {
        return Err(ProgramError::new(code::USAGE, "no kind of machine was named"));
    };
    kind(&name).map_err(|cause| ProgramError::new(code::USAGE, format!("{name}: {cause}")))
}

/// Asks for what no option tells.
fn ask(kind: Kind, wishes: &mut Wishes) -> Result<(), ProgramError> {
    let usual = starting::usual(kind);
    let figure = |what: &str, usual: Option<f64>| -> Result<Option<f64>, ProgramError> {
        let Some(usual) = usual else { return Ok(None) };
        let Some(text) = answer(&format!("{what} [{usual}]"))? else {
            return Ok(None);
        };
        let number = text.parse().map(Some);
        number.map_err(|_| ProgramError::new(code::USAGE, format!("{what}: {text} is not a number")))
    };
    let sizes = SIZES.iter().zip(usual.sizes_mm);
    for ((size, usual), wish) in sizes.zip(&mut wishes.sizes_mm) {
        if wish.is_none() && size.suits(kind) {
            *wish = figure(size.what, usual)?;
        }
    }
    if wishes.pitch_mm.is_none() {
        wishes.pitch_mm = figure(
            "travel of linear axes for one turn of the pulley or screw, mm",
            usual.pitch_mm,
        )?;
    }
    if wishes.gear.is_none() {
        wishes.gear = figure("motor turns for one turn of the joint, pulley or screw", usual.gear)?;
    }
    if wishes.drives.is_none() && wishes.chain.is_empty() {
        let drives = usual.drives.map(|drives| drives as f64);
        wishes.drives = figure("number of drives", drives)?.map(|drives| drives as usize);
    }
    Ok(())
}

fn entries(show: &Show) -> Result<BTreeMap<String, ConfigEntry>, ProgramError> {
    let config = show.config.load()?;
    let failed = |cause: &dyn std::fmt::Display| ProgramError::new(code::USAGE, format!("the configuration: {cause}"));
    let mut entries = BTreeMap::new();
    let built_in = "built-in";
    let values = serde_json::to_value(&config).map_err(|cause| failed(&cause))?;
    flatten(&values, "", &mut |key, value| {
        let origin = built_in.to_owned();
        if let Some((key, value)) = in_units(&config, key, value) {
            entries.insert(key, ConfigEntry { value, origin });
        }
    });
    let source = match (&show.config.machine, show.config.file()) {
        (Some(MachineChoice::Bundled(machine)), _) => {
            Some((machine.text.to_owned(), format!("flag --machine {}", machine.name)))
        }
        (_, Some((path, how))) => {
            let text = std::fs::read_to_string(&path).map_err(|cause| failed(&cause))?;
            Some((text, format!("{} ({how})", path.display())))
        }
        (_, None) => None,
    };
    if let Some((text, origin)) = source {
        let written: serde_json::Value = toml::from_str(&text).map_err(|cause| failed(&cause))?;
        as_written(&config, &written, &origin, &mut entries);
    }
    let (value, origin) = match &show.port.port {
        Some(port) if show.port.is_from_environment() => (port.to_string().into(), "environment ETHERPEN_PORT"),
        Some(port) => (port.to_string().into(), "flag --port"),
        None => (serde_json::Value::Null, built_in),
    };
    let origin = origin.to_owned();
    entries.insert("port".into(), ConfigEntry { value, origin });
    Ok(entries)
}

/// Gives the values that a file writes their origin, and those that it writes otherwise than the controller has them its
/// own names and values.
fn as_written(config: &Config, written: &serde_json::Value, origin: &str, entries: &mut BTreeMap<String, ConfigEntry>) {
    let mut values: Vec<(String, serde_json::Value)> = Vec::new();
    flatten(written, "", &mut |key, value| {
        let Some(shared) = key.strip_prefix("axis_defaults.") else {
            return values.push((key, value.clone()));
        };
        // What an axis writes itself comes later, and replaces it.
        let of_axes = (0..config.bus.drives).map(|axis| (format!("axes[{axis}].{shared}"), value.clone()));
        values.splice(0..0, of_axes);
    });
    let kind = config.geometry.kind();
    let axis_of = |key: &str| {
        let (axis, name) = key.strip_prefix("axes[")?.split_once("].")?;
        Some((axis.parse::<usize>().ok()?, name.to_owned()))
    };
    let is_linear = |axis: usize| axes::motion(kind, axis) == Motion::Linear && axis < usize::from(config.bus.drives);
    // A linear axis's gear is that of its pulley or screw; without one the motor drives it directly.
    for axis in (0..usize::from(config.bus.drives)).filter(|axis| is_linear(*axis)) {
        if let Some(entry) = entries.get_mut(&format!("axes[{axis}].gear")) {
            entry.value = 1.0.into();
        }
    }
    for (key, value) in values {
        let origin = origin.to_owned();
        let of_axis = axis_of(&key);
        if let Some((axis, "home.switch")) = of_axis.as_ref().map(|(axis, name)| (*axis, name.as_str())) {
            entries.remove(&format!("axes[{axis}].home.io"));
            entries.insert(key, ConfigEntry { value, origin });
            continue;
        }
        if let Some((axis, "pitch_mm" | "gear")) = of_axis.as_ref().map(|(axis, name)| (*axis, name.as_str()))
            && is_linear(axis)
        {
            entries.insert(key, ConfigEntry { value, origin });
            continue;
        }
        // Where all axes are rotary, a list may be written under either name.
        let other = key
            .replace("joint_speed[", "joint_speed_rad_s[")
            .replace("joint_acceleration[", "joint_acceleration_rad_s2[");
        for key in [key, other] {
            if let Some(entry) = entries.get_mut(&key) {
                entry.origin.clone_from(&origin);
            }
        }
    }
}

/// A value as a configuration file names and writes it; `None` for one of an axis that the machine lacks.
fn in_units(config: &Config, key: String, value: &serde_json::Value) -> Option<(String, serde_json::Value)> {
    let kind = config.geometry.kind();
    let list = |name: &str| key.strip_prefix(name)?.strip_prefix('[')?.split_once(']');
    let exists = |axis: &str| axis.parse().ok().filter(|axis| *axis < usize::from(config.bus.drives));
    let scaled = |factor: f64| value.as_f64().map_or(value.clone(), |number| (number * factor).into());
    if let Some((axis, name)) = list("axes") {
        let axis = exists(axis)?;
        return Some(match axes::as_written(kind, axis, name.trim_start_matches('.')) {
            Some((name, factor)) => (format!("axes[{axis}].{name}"), scaled(factor)),
            None => (key, value.clone()),
        });
    }
    for (name, written) in [
        ("motion.joint_speed_rad_s", "motion.joint_speed"),
        ("motion.joint_acceleration_rad_s2", "motion.joint_acceleration"),
    ] {
        if let Some((axis, _)) = list(name) {
            let axis = exists(axis)?;
            let is_mixed = axes::motions(kind).contains(&Motion::Linear);
            let factor = axes::motion(kind, axis).factor();
            return Some(match is_mixed {
                true => (format!("{written}[{axis}]"), scaled(factor)),
                false => (key, value.clone()),
            });
        }
    }
    Some((key, value.clone()))
}

/// Visits every value that is not a table; list indices count from 0, in brackets.
fn flatten(value: &serde_json::Value, key: &str, visit: &mut dyn FnMut(String, &serde_json::Value)) {
    match value {
        serde_json::Value::Object(table) => {
            for (name, value) in table {
                let key = if key.is_empty() {
                    name.clone()
                } else {
                    format!("{key}.{name}")
                };
                flatten(value, &key, visit);
            }
        }
        serde_json::Value::Array(list) => {
            for (index, value) in list.iter().enumerate() {
                flatten(value, &format!("{key}[{index}]"), visit);
            }
        }
        value => visit(key.to_owned(), value),
    }
}

/// The file of a configuration, and how it was given.
pub(super) fn named(flag: Option<&PathBuf>) -> Option<(PathBuf, &'static str)> {
    let default = PathBuf::from("etherpen.toml");
    let from_environment = std::env::var_os("ETHERPEN_CONFIG").map(PathBuf::from);
    match flag {
        Some(path) if from_environment.as_ref() == Some(path) => Some((path.clone(), "environment ETHERPEN_CONFIG")),
        Some(path) => Some((path.clone(), "flag --config")),
        None if default.exists() => Some((default, "file in this folder")),
        None => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn show(config: Option<PathBuf>) -> BTreeMap<String, ConfigEntry> {
        let show = Show {
            origin: true,
            json: false,
            port: OptionalPort {
                port: "tcp:127.0.0.1:1".parse().ok(),
            },
            config: ConfigArguments { config, machine: None },
        };
        entries(&show).unwrap()
    }

    #[test]
    fn every_value_says_where_it_comes_from() {
        let path = std::env::temp_dir().join(format!("etherpen-origin-{}.toml", std::process::id()));
        std::fs::write(&path, "[motion]\nspeed_mm_s = 123.0\n").unwrap();
        let entries = show(Some(path.clone()));
        std::fs::remove_file(&path).unwrap();
        let speed = &entries["motion.speed_mm_s"];
        assert_eq!(speed.value, serde_json::json!(123.0));
        assert!(speed.origin.contains("flag --config") && speed.origin.contains("etherpen-origin"));
        assert_eq!(entries["motion.travel_speed_mm_s"].origin, "built-in");
        assert_eq!(entries["axes[3].gear"].origin, "built-in");
        assert_eq!(entries["port"].origin, "flag --port");
    }

    #[test]
    fn the_values_of_a_bundled_machine_come_from_its_option() {
        let shown = |name: &str| {
            let show = Show {
                origin: true,
                json: false,
                port: OptionalPort { port: None },
                config: ConfigArguments {
                    config: None,
                    machine: name.parse().ok(),
                },
            };
            entries(&show).unwrap()
        };
        let delta = shown("irb340");
        assert_eq!(delta["motion.joint_speed_rad_s[1]"].origin, "flag --machine irb340");
        assert_eq!(delta["axes[0].gear"].origin, "flag --machine irb340");
        assert_eq!(delta["axes[0].feed_forward_gain"].origin, "built-in");
        assert_eq!(shown("gantry")["axes[2].mass_kg"].origin, "flag --machine gantry");
    }

    #[test]
    fn a_machine_with_linear_axes_is_shown_as_its_file_writes_it() {
        let gantry = crate::settings::machines::MACHINES[1];
        let path = std::env::temp_dir().join(format!("etherpen-linear-{}.toml", std::process::id()));
        std::fs::write(&path, gantry.text).unwrap();
        let entries = show(Some(path.clone()));
        std::fs::remove_file(&path).unwrap();
        let speed = &entries["axes[2].output_max_mm_s"];
        assert_eq!(speed.value, serde_json::json!(1300.0));
        assert!(
            speed.origin.contains("flag --config"),
            "shared by the axes: {}",
            speed.origin
        );
        assert_eq!(entries["motion.joint_speed[2]"].value, serde_json::json!(300.0));
        for (key, value) in [
            ("axes[0].gear", serde_json::json!(1.0)),
            ("axes[0].pitch_mm", serde_json::json!(40.0)),
            ("axes[1].home.switch", serde_json::json!("y_home")),
            ("motion.joint_speed[0]", serde_json::json!(1000.0)),
        ] {
            let entry = &entries[key];
            assert!(
                entry.value == value && entry.origin.contains("flag --config"),
                "{key}: {entry:?}"
            );
        }
        assert!(!entries.contains_key("axes[1].home.io"));
        assert!(entries.keys().all(|key| !key.starts_with("axes[3]")), "three drives");
    }
}

//! The `etherpen` program: from a photograph to a drawing, on the robot, in the emulator or in virtual time.
#![forbid(unsafe_code)]

use clap::{Command, CommandFactory, FromArgMatches, Parser};
use host_tools::commands::{
    bench, blackbox, bus, calibrate, campaign, configuration, console, demo, doctor, draw, emulate, flash, identify,
    kinematics, operate, order, paper, plan, preview, record, recorded, reference, segment, shell, simulate, vectorize,
    verify,
};
use host_tools::drawing::preparation::confined;
use host_tools::eprintln;
use host_tools::error::{ProgramError, code};
use host_tools::terminal::{in_colour, is_cut};
use std::process::ExitCode;

/// Shown under the help and in the manual page of every command.
const EXIT_CODES: &str = "Exit codes: 0 done; 1 the work failed; 2 wrong usage; 3 the input file cannot be used; \
    4 a tool is missing; 5 no connection to the machine or the emulator; 6 the firmware speaks another protocol version; \
    7 the machine stopped with a fault; 8 the path ended and a part of the drawing is missing; 130 interrupted.";

/// Robot drawing machine: vectorises photographs and draws them with an EtherCAT robot.
#[derive(Parser)]
#[command(name = "etherpen", version, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Subcommand,
}

#[derive(clap::Subcommand)]
#[allow(clippy::large_enum_variant)] // one is alive
enum Subcommand {
    /// Convert a file into strokes for another process of this program.
    #[command(name = confined::COMMAND, hide = true)]
    Confined,
    /// Draw a photograph on the emulated robot; installs and builds what is missing.
    Demo(demo::Arguments),
    /// Serve the operator's page for a board, the emulator or a simulation.
    Console(console::Arguments),
    /// Draw a file on a running machine or emulator.
    Draw(draw::Arguments),
    #[command(flatten)]
    Operate(operate::Command),
    /// Show how a file would be drawn: order, travel moves, refusals, planned time.
    Preview(preview::Arguments),
    /// Turn a photograph into the lines of an SVG.
    Vectorize(vectorize::Arguments),
    /// Reorder the lines of an SVG for a short drawing time; keeps the scale and every line.
    Order(order::Arguments),
    /// Draw a file in virtual time in this process, with the firmware's tasks and the virtual cell.
    Simulate(simulate::Arguments),
    /// Run the firmware in QEMU with the virtual cell and print the port to connect to.
    Emulate(emulate::Arguments),
    /// Check tools, permissions, debug probe, port, firmware and configuration; says what to try.
    Doctor(doctor::Arguments),
    /// Build the firmware of the board NUCLEO-H743ZI2, write it to the board and verify it.
    Flash(flash::Arguments),
    /// Write or check a configuration file, or show the configuration with the origin of each value.
    Config(configuration::Arguments),
    /// Home: find the robot's pose from the resolvers, at the marks or at a known pose, and store it.
    #[command(visible_alias = "home")]
    Reference(reference::Arguments),
    /// Find the dimensions of the machine from marks that it drew, and store them.
    Calibrate(calibrate::Arguments),
    /// Measure the drives' delay and gain with a test motion, and store the resulting controller values.
    Identify(identify::Arguments),
    /// Show where the sheet lies, or find its height and tilt from places where the pen touches it, and store them.
    Paper(paper::Arguments),
    /// Record everything the firmware sends into an MCAP file, for export, plot, stats, Foxglove or PlotJuggler.
    Record(record::Arguments),
    /// Summarise a recording: duration, gaps, extremes of each signal, following errors, modes.
    Stats(recorded::StatsArguments),
    /// Draw signals of a recording: SVG or PNG, without a display.
    Plot(recorded::PlotArguments),
    /// Write a recording as a table: CSV or Parquet.
    Export(recorded::ExportArguments),
    /// Read a controller's black box: its last two seconds, kept over a reset.
    Blackbox(blackbox::Arguments),
    /// Plan a path with the firmware's planner; nothing moves.
    Plan(plan::Arguments),
    /// Turn positions into joint angles and back.
    Kinematics(kinematics::Arguments),
    /// Inspect and change the slaves on the bus.
    Bus(bus::Arguments),
    /// Run the virtual EtherCAT segment alone, for any master.
    Segment(segment::Arguments),
    /// Print the completions of a shell: bash, zsh, fish, elvish or PowerShell.
    Completions(shell::Completions),
    /// Write manual pages.
    Man(shell::Man),
    /// Compare the project's figures with those of its peers; installs and builds what is missing.
    Bench(bench::Arguments),
    /// Look for failures: random drawings, commands and faults in virtual time, judged by an independent monitor.
    Campaign(campaign::Arguments),
    /// Set up, format, lint, test and build everything, as continuous integration does.
    Verify(verify::Arguments),
}

/// The command line, with the exit codes in every command.
fn command_line() -> Command {
    fn explained(command: Command) -> Command {
        // A long text of its own would replace the short one.
        let own = command.get_after_long_help().map(ToString::to_string);
        let command = command.after_help(EXIT_CODES).mut_subcommands(explained);
        match own {
            Some(own) => command.after_long_help(format!("{own}\n\n{EXIT_CODES}")),
            None => command,
        }
    }
    explained(Arguments::command())
}

fn main() -> ExitCode {
    confined::enable();
    let arguments = Arguments::from_arg_matches(&command_line().get_matches()).unwrap_or_else(|error| error.exit());
    let result = match arguments.command {
        Subcommand::Bench(arguments) => bench::run(&arguments),
        Subcommand::Blackbox(arguments) => blackbox::run(&arguments),
        Subcommand::Bus(arguments) => bus::run(&arguments),
        Subcommand::Calibrate(arguments) => calibrate::run(&arguments),
        Subcommand::Campaign(arguments) => campaign::run(&arguments),
        Subcommand::Completions(arguments) => shell::completions(&arguments, command_line()),
        Subcommand::Confined => confined::run(),
        Subcommand::Config(arguments) => configuration::run(&arguments),
        Subcommand::Console(arguments) => console::run(&arguments),
        Subcommand::Demo(arguments) => demo::run(&arguments),
        Subcommand::Doctor(arguments) => doctor::run(&arguments),
        Subcommand::Draw(arguments) => draw::run(&arguments),
        Subcommand::Emulate(arguments) => emulate::run(&arguments),
        Subcommand::Flash(arguments) => flash::run(&arguments),
        Subcommand::Export(arguments) => recorded::export(&arguments),
        Subcommand::Plot(arguments) => recorded::plot(&arguments),
        Subcommand::Record(arguments) => record::run(&arguments),
        Subcommand::Stats(arguments) => recorded::stats(&arguments),
        Subcommand::Kinematics(arguments) => kinematics::run(&arguments),
        Subcommand::Order(arguments) => order::run(&arguments),
        Subcommand::Preview(arguments) => preview::run(&arguments),
        Subcommand::Man(arguments) => shell::man(&arguments, command_line()),
        Subcommand::Operate(command) => operate::run(&command),
        Subcommand::Paper(arguments) => paper::run(&arguments),
        Subcommand::Plan(arguments) => plan::run(&arguments),
        Subcommand::Identify(arguments) => identify::run(&arguments),
        Subcommand::Reference(arguments) => reference::run(&arguments),
        Subcommand::Segment(arguments) => segment::run(&arguments),
        Subcommand::Simulate(arguments) => simulate::run(&arguments),
        Subcommand::Vectorize(arguments) => vectorize::run(&arguments),
        Subcommand::Verify(arguments) => verify::run(&arguments),
    };
    match result {
        Ok(()) if is_cut() => ExitCode::from(code::FAILED),
        Ok(()) => ExitCode::SUCCESS,
        Err(ProgramError { code, message }) => {
            eprintln!("{}: {message}", in_colour("etherpen", "1;31"));
            ExitCode::from(code)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every command with an option `--port`: its name, and the environment variable that replaces the option.
    fn ports(command: &Command, name: &str, found: &mut Vec<(String, Option<String>)>) {
        let mut options = command.get_arguments();
        if let Some(port) = options.find(|argument| argument.get_long() == Some("port")) {
            let variable = port.get_env().map(|variable| variable.to_string_lossy().into_owned());
            found.push((name.trim().to_owned(), variable));
        }
        for subcommand in command.get_subcommands() {
            ports(subcommand, &format!("{name} {}", subcommand.get_name()), found);
        }
    }

    #[test]
    fn the_environment_names_the_port_of_every_command_that_takes_one() {
        let mut found = Vec::new();
        ports(&command_line(), "", &mut found);
        // The option of `emulate` is the number of the TCP port that it opens.
        found.retain(|(name, _)| name != "emulate");
        for (name, variable) in &found {
            assert_eq!(variable.as_deref(), Some("ETHERPEN_PORT"), "{name}");
        }
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        for name in [
            "draw",
            "console",
            "record",
            "blackbox",
            "reference",
            "identify",
            "doctor",
            "bus",
            "config show",
            "stop",
            "jog",
        ] {
            assert!(names.contains(&name), "{name} in {names:?}");
        }
    }
}

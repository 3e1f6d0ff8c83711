//! Prerequisites of the commands: the Rust target, QEMU, the firmware image.
//!
//! A new user runs one command; missing parts are installed, or the exact command to install them is shown.

use crate::error::{ProgramError, code};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The target of both boards.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// The emulator's program.
pub const QEMU: &str = "qemu-system-arm";
/// Oldest tested major version of QEMU.
pub const QEMU_MAJOR_MIN: u32 = 7;

/// A part that could not be set up.
#[derive(Debug)]
pub struct SetupError {
    /// What is missing, and what to do.
    pub message: String,
}

impl std::fmt::Display for SetupError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for SetupError {}

impl From<SetupError> for ProgramError {
    fn from(error: SetupError) -> Self {
        Self::new(code::TOOL, error)
    }
}

fn error<T>(message: impl Into<String>) -> Result<T, SetupError> {
    Err(SetupError {
        message: message.into(),
    })
}

/// Environment variable with the path of etherpen's sources, if they are not found automatically.
const SOURCES: &str = "ETHERPEN_SOURCES";

/// Root of etherpen's sources: the path in `ETHERPEN_SOURCES`, else the folder from which this program was built, else,
/// if that no longer exists, the checkout around the current folder.
pub fn workspace() -> PathBuf {
    let built_from = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."));
    if let Some(named) = std::env::var_os(SOURCES) {
        return named.into();
    }
    let here = std::env::current_dir().unwrap_or_default();
    let mut places = std::iter::once(built_from).chain(here.ancestors());
    places
        .find(|place| has_sources(place))
        .unwrap_or(built_from)
        .to_path_buf()
}

fn has_sources(folder: &Path) -> bool {
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap_or_default();
    manifest.contains("name = \"etherpen\"") && folder.join("host-tools/Cargo.toml").is_file()
}

/// Checks that etherpen's sources exist; firmware, samples and benchmarks need them.
///
/// # Errors
/// Where the sources were searched, and what to try.
pub fn ensure_sources() -> Result<PathBuf, SetupError> {
    let folder = workspace();
    if has_sources(&folder) {
        return Ok(folder);
    }
    error(format!(
        "this command needs etherpen's sources, and they are not in {}.\n\
         Try: run it in a checkout of etherpen, or name one: {SOURCES}=FOLDER",
        folder.display()
    ))
}

/// Output folder of cargo: `CARGO_TARGET_DIR`, or `target` in the workspace.
pub fn target_dir() -> PathBuf {
    match std::env::var_os("CARGO_TARGET_DIR") {
        Some(dir) if Path::new(&dir).is_absolute() => PathBuf::from(dir),
        Some(dir) => workspace().join(dir),
        None => workspace().join("target"),
    }
}

/// A cargo command in the workspace.
pub(crate) fn cargo() -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    // Flags from the environment would replace those that the boards need.
    command.env_remove("RUSTFLAGS").env_remove("CARGO_ENCODED_RUSTFLAGS");
    if let Ok(folder) = ensure_sources() {
        command.current_dir(folder);
    }
    command
}

/// The program rustup, with the toolchain of the sources if they exist.
fn rustup() -> Command {
    let mut command = Command::new("rustup");
    if let Ok(folder) = ensure_sources() {
        command.current_dir(folder);
    }
    command
}

/// The output of a command; `None` if it fails.
pub(crate) fn output(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Whether `program` can be started.
pub fn is_installed(program: &str) -> bool {
    // iproute2 accepts only the short option.
    let answers = |option| output(Command::new(program).arg(option)).is_some();
    answers("--version") || answers("-V")
}

/// Whether the Rust toolchain has the target of the boards.
pub fn has_target() -> bool {
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]));
    let installed = |root: &String| {
        Path::new(root.trim())
            .join("lib/rustlib")
            .join(TARGET)
            .join("lib")
            .is_dir()
    };
    sysroot.as_ref().is_some_and(installed)
}

/// Adds the Rust target of the boards if it is missing.
///
/// # Errors
/// The command that has to be run by hand.
pub fn ensure_target() -> Result<(), SetupError> {
    if has_target() {
        return Ok(());
    }
    eprintln!("etherpen: adding the Rust target {TARGET}");
    match rustup().args(["target", "add", TARGET]).status() {
        // rustup has no lock: another process may have added the target meanwhile.
        Ok(status) if status.success() || has_target() => Ok(()),
        Ok(status) => error(format!(
            "the Rust target {TARGET} could not be added (rustup: {status}).\nTry: rustup target add {TARGET}"
        )),
        Err(cause) => error(format!(
            "the Rust target {TARGET} is missing and rustup cannot be started ({cause}).\n\
             Try: install rustup, then: rustup target add {TARGET}; or install your distribution's package with that target"
        )),
    }
}

/// Adds a component of the Rust toolchain if it is missing.
///
/// # Errors
/// The command that has to be run by hand.
pub fn ensure_component(component: &str) -> Result<(), SetupError> {
    let subcommand = if component == "rustfmt" { "fmt" } else { component };
    if output(cargo().args([subcommand, "--version"])).is_some() {
        return Ok(());
    }
    eprintln!("etherpen: adding the toolchain's component {component}");
    let is_there = || output(cargo().args([subcommand, "--version"])).is_some();
    match rustup().args(["component", "add", component]).status() {
        Ok(status) if status.success() || is_there() => Ok(()),
        _ => error(format!(
            "{component} is missing.\nTry: rustup component add {component}"
        )),
    }
}

/// The Debian package of a program.
fn package(program: &str) -> &str {
    match program {
        QEMU => "qemu-system-arm",
        "ip" => "iproute2",
        other => other,
    }
}

/// Installs a missing program's Debian package, if the machine allows it.
///
/// # Errors
/// The command that has to be run by hand.
pub fn ensure_program(program: &str) -> Result<(), SetupError> {
    if is_installed(program) {
        return Ok(());
    }
    let package = package(program);
    let by_hand = format!(
        "{program} is needed and not installed. Try one of:\n\
         \x20 Debian, Ubuntu:  sudo apt-get update && sudo apt-get install -y --no-install-recommends {package}\n\
         \x20 Fedora:          sudo dnf install {package}\n\
         \x20 Arch:            sudo pacman -S {package}"
    );
    match install(package) {
        Ok(()) if is_installed(program) => Ok(()),
        Err(Some(why)) => error(format!("{by_hand}\n{why}")),
        _ => error(by_hand),
    }
}

/// Installs a Debian package, if the machine has such packages and allows it; the error is the reason, if there is one
/// to report.
fn install(package: &str) -> Result<(), Option<String>> {
    if !is_installed("apt-get") {
        return Err(None);
    }
    let prefix: &[&str] = if is_root() {
        &[]
    } else if is_installed("sudo") && (std::io::stdin().is_terminal() || sudo_needs_no_password()) {
        &["sudo"]
    } else {
        return Err(None);
    };
    eprintln!("etherpen: installing {package}");
    let apt = |arguments: &[&str]| {
        let attempt = || {
            let environment = ["env", "LC_ALL=C", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-q"];
            let mut words = prefix.iter().chain(&environment).chain(arguments);
            let mut command = Command::new(words.next().unwrap_or(&"env"));
            // Data goes to stdout; the messages of a package manager are not data.
            command.args(words).stdin(Stdio::inherit()).stdout(Stdio::null());
            match command.stderr(Stdio::piped()).output() {
                Ok(output) if output.status.success() => Ok(()),
                Ok(output) => Err(String::from_utf8_lossy(&output.stderr).into_owned()),
                Err(cause) => Err(cause.to_string()),
            }
        };
        let begun = Instant::now();
        unlocked(attempt, || {
            std::thread::sleep(LOCK_LOOK);
            begun.elapsed() < LOCK_MAX
        })
    };
    let install = ["install", "-y", "--no-install-recommends", package];
    apt(&install)
        .or_else(|_| apt(&["update"]).and_then(|()| apt(&install)))
        .map_err(Some)
}

/// Longest wait for another package manager to end. A fresh system updates itself for several minutes.
const LOCK_MAX: Duration = Duration::from_secs(900);
/// Time between two attempts.
const LOCK_LOOK: Duration = Duration::from_secs(2);

/// Repeats apt-get while another package manager holds one of its locks, until `wait` reports that the time is over;
/// the error is apt-get's output.
fn unlocked(mut attempt: impl FnMut() -> Result<(), String>, mut wait: impl FnMut() -> bool) -> Result<(), String> {
    let mut told = String::new();
    loop {
        let Err(said) = attempt() else { return Ok(()) };
        let Some(holder) = lock_holder(&said) else {
            eprint!("{said}");
            return Err(format!("apt-get said: {}", said.trim_end()));
        };
        if told != holder {
            let minutes = LOCK_MAX.as_secs() / 60;
            eprintln!("etherpen: waiting for {holder}, at most {minutes} minutes; Ctrl-C ends");
            told = holder;
        }
        if !wait() {
            return Err(format!(
                "apt-get could not begin: {told} still holds its lock; try again once that has ended"
            ));
        }
    }
}

/// The program that holds apt-get's lock, if that is why apt-get failed.
fn lock_holder(said: &str) -> Option<String> {
    let line = said
        .lines()
        .find(|line| line.contains("Could not get lock") || line.contains("Unable to lock"))?;
    let process = line.split_once("held by process ").map(|(_, process)| process);
    Some(match process.and_then(|process| process.split_once(')')) {
        Some((process, _)) => format!("another package manager, process {process})"),
        None => "another package manager".to_owned(),
    })
}

/// The version of vpype with which drawings are compared.
const VPYPE: &str = "vpype==1.15.0";
/// The version of unicorn, a Cortex-M7 emulator, on which the board's start-up is run.
const UNICORN: &str = "unicorn==2.1.4";
/// The version of pysoem, SOEM for Python, an EtherCAT master of another project that brings up the virtual segment.
const PYSOEM: &str = "pysoem==1.1.13";

/// The version of KickCAT, an EtherCAT master of another project that brings up the virtual segment.
const KICKCAT: &str = "kickcat==2.5";
/// The version of elkai, LKH for Python, which finds nearly the shortest tours.
const ELKAI: &str = "elkai==2.0.1";

/// A Python with vpype, in a separate folder below the target folder; installed if it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_vpype() -> Result<PathBuf, SetupError> {
    ensure_python("vpype", VPYPE, "; or leave vpype out: --subject etherpen")
}

/// A Python with unicorn, in a separate folder below the target folder; installed if it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_unicorn() -> Result<PathBuf, SetupError> {
    ensure_python("unicorn", UNICORN, "")
}

/// A Python with pysoem, in a separate folder below the target folder; installed if it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_pysoem() -> Result<PathBuf, SetupError> {
    ensure_python("pysoem", PYSOEM, "")
}

/// A Python with KickCAT, in a separate folder below the target folder; installed if it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_kickcat() -> Result<PathBuf, SetupError> {
    ensure_python("kickcat", KICKCAT, "")
}

/// A Python with elkai, in a separate folder below the target folder; installed if it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_elkai() -> Result<PathBuf, SetupError> {
    ensure_python("elkai", ELKAI, "; or leave it out: --quick")
}

/// What the portraits are compared with, each version pinned, and pip's extra words: the judge (dlib's detector and
/// identity network), and the programs that draw photographs. hatched without its viewers, of which it imports none.
const PORTRAITS: [(&str, &[&str]); 9] = [
    ("numpy==2.1.3", &[]),
    ("opencv-python-headless==4.10.0.84", &[]),
    ("shapely==2.0.6", &[]),
    ("scikit-image==0.25.2", &[]),
    ("matplotlib==3.10.3", &[]),
    ("dlib-bin==20.0.1.post1", &[]),
    ("face_recognition_models==0.3.0", &["--no-deps"]),
    ("plotline==0.2.0", &[]),
    ("hatched==0.2.0", &["--no-deps", "svgwrite==1.4.3"]),
];

/// A Python with the judge of portraits and the other programs that draw them, in a separate folder below the target
/// folder; installed if it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_portraits() -> Result<PathBuf, SetupError> {
    let imports = "import dlib, hatched, plotline, importlib.util as u; assert u.find_spec('face_recognition_models')";
    ensure_packages(
        "portraits",
        imports,
        &PORTRAITS,
        "; or leave the portraits out: --quick",
    )
}

/// The judge of faces' points, for Python 3.10 to 3.12, and what its mesh imports; the rest of what it asks for is never used.
const MESH: [(&str, &[&str]); 8] = [
    ("numpy==2.1.3", &[]),
    ("opencv-python-headless==4.10.0.84", &[]),
    ("matplotlib==3.10.3", &[]),
    ("protobuf==4.25.9", &[]),
    ("absl-py==2.5.1", &[]),
    ("flatbuffers==25.12.19", &[]),
    ("attrs==26.1.0", &[]),
    ("mediapipe==0.10.14", &["--no-deps"]),
];

/// A Python with the judge of faces' points, in a separate folder below the target folder; installed if it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_mesh() -> Result<PathBuf, SetupError> {
    ensure_packages("mesh", "from mediapipe.python.solutions import face_mesh", &MESH, "")
}

/// A Python with `module` from the given version of PyPI's `package`.
fn ensure_python(module: &str, package: &str, otherwise: &str) -> Result<PathBuf, SetupError> {
    ensure_packages(module, &format!("import {module}"), &[(package, &[])], otherwise)
}

/// A Python in a folder of this name in which `imports` runs, because packages of PyPI were installed with pip's extra
/// words.
fn ensure_packages(
    folder: &str,
    imports: &str,
    packages: &[(&str, &[&str])],
    otherwise: &str,
) -> Result<PathBuf, SetupError> {
    let dir = target_dir().join(folder);
    let python = dir.join("bin/python");
    let is_there = || output(Command::new(&python).args(["-c", imports])).is_some();
    if is_there() {
        return Ok(python);
    }
    ensure_program("python3")?;
    let environment = || output(Command::new("python3").args(["-m", "venv"]).arg(&dir)).is_some();
    let there = environment() || (install("python3-venv").is_ok() && environment());
    if !there {
        return error(
            "Python's venv is needed and missing.\nTry: sudo apt-get install -y python3-venv, or your system's package",
        );
    }
    for (package, words) in packages {
        eprintln!("etherpen: setting up {package} in {}", dir.display());
        let mut pip = Command::new(&python);
        pip.args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            package,
        ]);
        // Data goes to stdout; the messages of a package manager are not data.
        let installed = pip.args(*words).stdin(Stdio::null()).stdout(Stdio::null()).status();
        if !installed.is_ok_and(|status| status.success()) {
            return not_installed(&python, package, otherwise);
        }
    }
    match packages.last() {
        Some((package, _)) if !is_there() => not_installed(&python, package, otherwise),
        _ => Ok(python),
    }
}

fn not_installed(python: &Path, package: &str, otherwise: &str) -> Result<PathBuf, SetupError> {
    error(format!(
        "{package} could not be installed from PyPI.\nTry: {} -m pip install {package}{otherwise}",
        python.display()
    ))
}

fn is_root() -> bool {
    output(Command::new("id").arg("-u")).is_some_and(|id| id.trim() == "0")
}

fn sudo_needs_no_password() -> bool {
    output(Command::new("sudo").args(["-n", "true"])).is_some()
}

/// The first line of a program's version output; `None` when the program cannot be started.
pub fn version_line(program: &str) -> Option<String> {
    let text = output(Command::new(program).arg("--version"))?;
    text.lines().next().map(str::to_owned)
}

/// The first number of the first version in a line.
pub fn major(version: &str) -> Option<u32> {
    version
        .split_whitespace()
        .find_map(|word| word.split('.').next()?.parse().ok())
}

/// Installs QEMU if it is missing, and checks its version.
///
/// # Errors
/// The command that has to be run by hand, or that the version is too old.
pub fn ensure_qemu() -> Result<(), SetupError> {
    ensure_program(QEMU)?;
    let version = version_line(QEMU).unwrap_or_default();
    match major(&version) {
        Some(major) if major < QEMU_MAJOR_MIN => error(format!(
            "{QEMU} {major} is too old; version {QEMU_MAJOR_MIN} or newer is needed."
        )),
        _ => Ok(()),
    }
}

/// Builds the firmware of a board and returns the image's path.
///
/// # Errors
/// The build failed; the compiler has shown why.
pub fn build_firmware(board: &str) -> Result<PathBuf, SetupError> {
    build(board, &Program::Firmware(board), &target_dir())
}

/// Builds a board's firmware with additional features, into a separate folder so that the board's image is kept; without
/// additional features, builds the board's image itself. What both have in common is compiled once.
///
/// # Errors
/// As for [`build_firmware`].
pub fn build_variant(board: &str, features: &[&str]) -> Result<PathBuf, SetupError> {
    if features.is_empty() {
        return build_firmware(board);
    }
    let mut all = vec![board];
    all.extend(features);
    build(
        &all.join(","),
        &Program::Firmware(board),
        &target_dir().join("variants"),
    )
}

/// Builds an example for the emulated board; returns the image.
///
/// # Errors
/// As for [`build_firmware`].
pub fn build_example(name: &str) -> Result<PathBuf, SetupError> {
    build("emulated", &Program::Example(name), &target_dir())
}

/// Builds an example for this computer; returns the program.
///
/// # Errors
/// As for [`build_firmware`].
pub fn build_host_example(name: &str) -> Result<PathBuf, SetupError> {
    let mut command = cargo();
    // The whole workspace decides over features: with them, a run of all tests has built the example already.
    command.args(["build", "--workspace", "--example", name]);
    run_build(command, name)?;
    Ok(target_dir().join("debug/examples").join(name))
}

/// What is built for a board.
enum Program<'a> {
    Firmware(&'a str),
    Example(&'a str),
}

fn build(features: &str, program: &Program<'_>, target_dir: &Path) -> Result<PathBuf, SetupError> {
    ensure_target()?;
    let mut command = cargo();
    command.arg("build").arg("--target-dir").arg(target_dir);
    command.env("CARGO_BUILD_BUILD_DIR", self::target_dir());
    command.args([
        "--release",
        "-p",
        "etherpen",
        "--target",
        TARGET,
        "--no-default-features",
    ]);
    command.args(["--features", features]);
    let folder = target_dir.join(TARGET).join("release");
    let (kind, name, image) = match *program {
        Program::Firmware(name) => ("--bin", name, folder.join(name)),
        Program::Example(name) => ("--example", name, folder.join("examples").join(name)),
    };
    command.args([kind, name]);
    run_build(command, name)?;
    Ok(image)
}

fn run_build(mut command: Command, name: &str) -> Result<(), SetupError> {
    ensure_sources()?;
    match command.stdout(Stdio::null()).status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => error(format!("`{name}` could not be built (cargo: {status})")),
        Err(cause) => error(format!("cargo cannot be started: {cause}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOCKED: &str = "E: Could not get lock /var/lib/dpkg/lock-frontend. It is held by process 1423 (unattended-upgr)\n\
        N: Be aware that removing the lock file is not a solution and may break your system.\n\
        E: Unable to acquire the dpkg frontend lock (/var/lib/dpkg/lock-frontend), is another process using it?\n";

    #[test]
    fn who_holds_the_lock_of_the_package_manager_is_known_by_name() {
        let holder = "another package manager, process 1423 (unattended-upgr)";
        assert_eq!(lock_holder(LOCKED).as_deref(), Some(holder));
        let lists = "E: Could not get lock /var/lib/apt/lists/lock - open (11: Resource temporarily unavailable)\n\
            E: Unable to lock directory /var/lib/apt/lists/\n";
        assert_eq!(lock_holder(lists).as_deref(), Some("another package manager"));
        assert_eq!(lock_holder("E: Unable to locate package qemu-system-arm\n"), None);
    }

    #[test]
    fn a_lock_is_waited_for_until_it_is_free_with_an_end() {
        let mut answers = vec![Ok(()), Err(LOCKED.to_owned()), Err(LOCKED.to_owned())];
        let mut waited = 0;
        let attempt = || answers.pop().expect("no more attempts than needed");
        let ended = unlocked(attempt, || {
            waited += 1;
            true
        });
        assert_eq!((ended, waited), (Ok(()), 2));
        let late = unlocked(|| Err(LOCKED.to_owned()), || false).unwrap_err();
        assert!(late.contains("process 1423 (unattended-upgr) still holds"), "{late}");
        let mut attempts = 0;
        let failed = unlocked(
            || {
                attempts += 1;
                Err("E: Unable to locate package".to_owned())
            },
            || true,
        );
        assert!(failed.is_err_and(|said| said.contains("locate")) && attempts == 1);
    }

    #[test]
    fn sources_are_known_by_what_is_in_them() {
        assert!(has_sources(&workspace()) && ensure_sources().is_ok());
        assert!(!has_sources(&workspace().join("host-tools")) && !has_sources(&std::env::temp_dir()));
    }
}

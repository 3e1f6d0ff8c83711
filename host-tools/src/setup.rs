//! What the commands need on a machine: the Rust target, QEMU, the firmware image.
//!
//! A newcomer runs one command; whatever is missing is installed, or the exact command to install it is named.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The target of both boards.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// The emulator's program.
pub const QEMU: &str = "qemu-system-arm";
/// Oldest major version of QEMU the emulated board was tried with.
pub const QEMU_MAJOR_MIN: u32 = 7;

/// What could not be set up.
#[derive(Debug)]
pub struct SetupError {
    /// What is missing and what to do about it.
    pub message: String,
}

impl std::fmt::Display for SetupError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for SetupError {}

fn error<T>(message: impl Into<String>) -> Result<T, SetupError> {
    Err(SetupError {
        message: message.into(),
    })
}

/// Root of the workspace this program was built from.
pub fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap_or(Path::new("."))
        .to_path_buf()
}

/// Where cargo puts what it builds: `CARGO_TARGET_DIR` or `target` in the workspace.
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
    command
        .current_dir(workspace())
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS");
    command
}

/// What a command prints, if it succeeds.
pub(crate) fn output(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Whether `program` can be started.
pub fn is_installed(program: &str) -> bool {
    // iproute2 knows only the short form.
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

/// Adds the Rust target of the boards where it is missing.
///
/// # Errors
/// The command that has to be run by hand.
pub fn ensure_target() -> Result<(), SetupError> {
    if has_target() {
        return Ok(());
    }
    eprintln!("etherpen: adding the Rust target {TARGET}");
    let added = Command::new("rustup")
        .args(["target", "add", TARGET])
        .current_dir(workspace())
        .status();
    match added {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => error(format!(
            "the Rust target {TARGET} could not be added (rustup: {status}).\nTry: rustup target add {TARGET}"
        )),
        Err(cause) => error(format!(
            "the Rust target {TARGET} is missing and rustup cannot be started ({cause}).\n\
             Try: install rustup, then: rustup target add {TARGET}; or install your distribution's package with that target"
        )),
    }
}

/// Adds a component of the Rust toolchain where it is missing.
///
/// # Errors
/// The command that has to be run by hand.
pub fn ensure_component(component: &str) -> Result<(), SetupError> {
    let subcommand = if component == "rustfmt" { "fmt" } else { component };
    if output(cargo().args([subcommand, "--version"])).is_some() {
        return Ok(());
    }
    eprintln!("etherpen: adding the toolchain's component {component}");
    match Command::new("rustup")
        .args(["component", "add", component])
        .current_dir(workspace())
        .status()
    {
        Ok(status) if status.success() => Ok(()),
        _ => error(format!(
            "{component} is missing.\nTry: rustup component add {component}"
        )),
    }
}

/// Debian packages by program.
fn package(program: &str) -> &str {
    match program {
        QEMU => "qemu-system-arm",
        "ip" => "iproute2",
        other => other,
    }
}

/// Installs a program's Debian package where the program is missing and the machine allows it.
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
    if install(package) && is_installed(program) {
        return Ok(());
    }
    error(by_hand)
}

/// Installs a Debian package where the machine has such packages and allows it.
fn install(package: &str) -> bool {
    if !is_installed("apt-get") {
        return false;
    }
    let prefix: &[&str] = if is_root() {
        &[]
    } else if is_installed("sudo") && (std::io::stdin().is_terminal() || sudo_needs_no_password()) {
        &["sudo"]
    } else {
        return false;
    };
    eprintln!("etherpen: installing {package}");
    let apt = |arguments: &[&str]| {
        let words: Vec<&str> = prefix
            .iter()
            .copied()
            .chain(["env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-q"])
            .chain(arguments.iter().copied())
            .collect();
        let mut command = Command::new(words[0]);
        // Data goes to stdout; what a package manager says is no data.
        command.args(&words[1..]).stdout(Stdio::null());
        command.status().is_ok_and(|status| status.success())
    };
    let install = ["install", "-y", "--no-install-recommends", package];
    apt(&install) || (apt(&["update"]) && apt(&install))
}

/// The version of vpype that the drawing is compared with.
const VPYPE: &str = "vpype==1.15.0";
/// The version of unicorn, a Cortex-M7 of its own, that the board's start-up is run on.
const UNICORN: &str = "unicorn==2.1.4";

/// A Python that has vpype, in a folder of its own below the target folder; it is set up where it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_vpype() -> Result<PathBuf, SetupError> {
    ensure_python("vpype", VPYPE, "; or leave vpype out: --subject etherpen")
}

/// A Python that has unicorn, in a folder of its own below the target folder; it is set up where it is missing.
///
/// # Errors
/// What is missing and how to get it.
pub fn ensure_unicorn() -> Result<PathBuf, SetupError> {
    ensure_python("unicorn", UNICORN, "")
}

/// A Python that has a module of PyPI's package of the same name in the given version.
fn ensure_python(module: &str, package: &str, otherwise: &str) -> Result<PathBuf, SetupError> {
    let dir = target_dir().join(module);
    let python = dir.join("bin/python");
    let is_there = || output(Command::new(&python).args(["-c", &format!("import {module}")])).is_some();
    if is_there() {
        return Ok(python);
    }
    ensure_program("python3")?;
    eprintln!("etherpen: setting up {package} in {}", dir.display());
    let environment = || output(Command::new("python3").args(["-m", "venv"]).arg(&dir)).is_some();
    let there = environment() || (install("python3-venv") && environment());
    if !there {
        return error(
            "Python's venv is needed and missing.\nTry: sudo apt-get install -y python3-venv, or your system's package",
        );
    }
    let mut pip = Command::new(&python);
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        package,
    ]);
    // Data goes to stdout; what a package manager says is no data.
    let installed = pip.stdin(Stdio::null()).stdout(Stdio::null()).status();
    if installed.is_ok_and(|status| status.success()) && is_there() {
        return Ok(python);
    }
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

/// The first line of what a program says about its version; `None` when it cannot be started.
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

/// Installs QEMU where it is missing and checks its version.
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
/// That the build failed; the compiler has said why.
pub fn build_firmware(board: &str) -> Result<PathBuf, SetupError> {
    build(board, board, &target_dir())
}

/// Builds a board's firmware with more features, in a folder of its own so that the board's image stays what it is;
/// without any, the board's image itself.
///
/// # Errors
/// As for [`build_firmware`].
pub fn build_variant(board: &str, features: &[&str]) -> Result<PathBuf, SetupError> {
    if features.is_empty() {
        return build_firmware(board);
    }
    let mut all = vec![board];
    all.extend(features);
    build(board, &all.join(","), &target_dir().join("variants"))
}

fn build(board: &str, features: &str, target_dir: &Path) -> Result<PathBuf, SetupError> {
    ensure_target()?;
    let mut command = cargo();
    command.arg("build").arg("--target-dir").arg(target_dir);
    command.args([
        "--release",
        "-p",
        "etherpen",
        "--target",
        TARGET,
        "--no-default-features",
    ]);
    let status = command
        .args(["--features", features, "--bin", board])
        .stdout(Stdio::null())
        .status();
    match status {
        Ok(status) if status.success() => Ok(target_dir.join(TARGET).join("release").join(board)),
        Ok(status) => error(format!(
            "the firmware image `{board}` could not be built (cargo: {status})"
        )),
        Err(cause) => error(format!("cargo cannot be started: {cause}")),
    }
}

//! The seam between a kind of robot and everything else: only a kind's own files name its parts.
//!
//! Kinds share words for their parts, so a kind's file may use those of another, but not its name. A test may choose a
//! kind by its name.
//!
//! A kind of robot has its own files in `motion`, in the monitor, in the cell and on the page. The test checks all Rust,
//! JavaScript and HTML files of the repository, names and comments alike.

use std::fs;
use std::io;
use std::path::Path;

/// A kind of robot.
struct Kind {
    /// Name of the kind, in lower case.
    name: &'static str,
    /// Words of the kind, as whole words or parts of names, in lower case.
    words: &'static [&'static str],
    /// The kind's own files, or folders of them: mathematics and dimensions, mechanism in the cell, drawing on the
    /// page.
    own: &'static [&'static str],
}

/// All kinds.
const KINDS: [Kind; 5] = [
    Kind {
        name: "delta",
        words: &["delta", "deltas", "arm", "arms", "forearm", "forearms"],
        own: &[
            "crates/certify/src/robot/delta.rs",
            "crates/certify/tests/certify/planning.rs",
            "crates/monitor/src/robot/delta.rs",
            "crates/motion/src/robots/delta/",
            "host-tools/src/calibration/tests/delta.rs",
            "host-tools/src/campaign/robot/delta.rs",
            "host-tools/src/cell/calibration.rs",
            "host-tools/src/cell/mechanism/delta.rs",
            "host-tools/src/planning/dimensions.rs",
        ],
    },
    Kind {
        name: "gantry",
        words: &["gantry", "gantries"],
        own: &[
            "crates/certify/src/robot/gantry.rs",
            "crates/monitor/src/robot/gantry.rs",
            "crates/motion/src/robots/gantry.rs",
        ],
    },
    Kind {
        name: "corexy",
        words: &["corexy"],
        own: &[
            "crates/certify/src/robot/corexy.rs",
            "crates/monitor/src/robot/corexy.rs",
            "crates/motion/src/robots/corexy.rs",
        ],
    },
    Kind {
        name: "scara",
        words: &["scara", "scaras", "elbow", "elbows"],
        own: &[
            "crates/certify/src/robot/scara.rs",
            "crates/monitor/src/robot/scara.rs",
            "crates/motion/src/robots/scara.rs",
        ],
    },
    Kind {
        name: "lineardelta",
        words: &["lineardelta", "tower", "towers", "carriage", "carriages", "rod", "rods"],
        own: &[
            "crates/certify/src/robot/linear_delta.rs",
            "crates/monitor/src/robot/linear_delta.rs",
            "crates/motion/src/robots/linear_delta.rs",
            "host-tools/src/campaign/robot/linear_delta.rs",
        ],
    },
];

/// Ways to write the name of a kind that has two words, and its name in [`KINDS`].
const NAMES: [(&str, &str); 6] = [
    ("LinearDelta", "Lineardelta"),
    ("linear_delta", "lineardelta"),
    ("linear-delta", "lineardelta"),
    ("inear delta", "ineardelta"),
    ("CoreXy", "Corexy"),
    ("CoreXY", "Corexy"),
];

/// This check, which names the words of all kinds.
const CHECK: &str = "tests/robots.rs";

/// Files that choose a kind, and may name it, but none of its parts.
const SEAMS: [&str; 13] = [
    "crates/certify/src/robot/mod.rs",
    "crates/monitor/src/robot/mod.rs",
    "crates/motion/src/robots/geometry.rs",
    "crates/motion/src/robots/kind.rs",
    "crates/motion/src/robots/mod.rs",
    "crates/certify/tests/certify/planning.rs",
    "host-tools/src/campaign/robot/mod.rs",
    "host-tools/src/planning/dimensions.rs",
    "host-tools/src/cell/mechanism/mod.rs",
    "host-tools/src/console/assets.rs",
    "host-tools/src/commands/mod.rs",
    "host-tools/src/settings/machines.rs",
    "tests/machines.rs",
];

/// Files in which all kinds stand side by side, with their parts.
const SIDE_BY_SIDE: [&str; 8] = [
    "crates/motion/src/robots/errors.rs",
    "host-tools/assets/console/robot.js",
    "host-tools/src/axes.rs",
    "host-tools/src/calibration/parameters.rs",
    "host-tools/src/cell/mechanism/linked.rs",
    "host-tools/src/commands/configuration.rs",
    "host-tools/src/console/skeleton.rs",
    "host-tools/src/settings/starting.rs",
];

/// Phrases in which a word has another meaning.
const OTHER_MEANINGS: [(&str, &[&str]); 4] = [
    (
        "the processor's architecture",
        &[
            "qemu-system-arm",
            "EM_ARM",
            "SHT_ARM_ATTRIBUTES",
            "an Arm has",
            "ARM ELF",
            "the Arm Architecture",
            "(Arm)",
        ],
    ),
    (
        "to arm a trigger",
        &[
            "Request::Arm ",
            "    Arm {",
            "Arm a capture",
            "Arms a trigger",
            "Arms a viewer's trigger",
            "fn arm(",
            "hub.arm(",
            "hub().arm(",
            "type: \"arm\"",
            "\"type\":\"arm\"",
            "trigger-arm",
            "\"Disarm\" : \"Arm\"",
            ">Arm<",
        ],
    ),
    ("the turn of a mouse's wheel", &["event.deltaY"]),
    ("a library's name", &["TowerToHyperService"]),
];

/// Keys of the configuration that tests write.
const KEYS: [&str; 10] = [
    "upper_arm_mm",
    "forearm_mm",
    "arm_azimuths_deg",
    "arm_range_rad",
    "arm_margin_rad",
    "elbow: ",
    "elbow_range_rad",
    "tower_azimuths_deg",
    "rod_mm",
    "carriage_range_mm",
];

#[test]
fn only_a_robots_own_files_name_its_parts() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    collect(root, "", &mut files).expect("the repository can be read");
    assert!(files.len() > 300, "{} files", files.len());
    let found: Vec<String> = files.iter().flat_map(|(path, text)| findings(path, text)).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
    for file in KINDS
        .iter()
        .flat_map(|kind| kind.own)
        .chain(&SEAMS)
        .chain(&SIDE_BY_SIDE)
    {
        assert!(files.iter().any(|(path, _)| path.starts_with(file)), "no file {file}");
    }
    for phrase in OTHER_MEANINGS.iter().flat_map(|(_, phrases)| *phrases) {
        let stands = files.iter().any(|(path, text)| path != CHECK && text.contains(phrase));
        assert!(stands, "the phrase {phrase} stands nowhere");
    }
}

#[test]
fn a_part_is_found_in_names_comments_and_texts() {
    for line in [
        "let delta = 1;",
        "struct DeltaArm;",
        "const ARM_LENGTH: f64 = 1.0;",
        "// The forearms meet.",
        "say(\"arm 1\");",
        "settings.upper_arm_mm",
        "event.deltaY - arm",
    ] {
        assert_eq!(findings("host-tools/src/x.rs", line).len(), 1, "{line}");
    }
    for line in [
        "// An alarm warms the army.",
        "qemu-system-arm",
        "hub.arm(7)",
        "harmless",
    ] {
        assert_eq!(findings("host-tools/src/x.rs", line), [""; 0], "{line}");
    }
    let seam = findings(SEAMS[0], "Self::Delta(delta) => delta.arms,");
    assert_eq!(
        seam,
        [format!("{}:1: arms: Self::Delta(delta) => delta.arms,", SEAMS[0])]
    );
    assert_eq!(findings("crates/motion/src/robots/delta/mod.rs", "arm"), [""; 0]);
}

#[test]
fn tests_may_quote_what_users_read_and_write() {
    let text =
        "let arm = 1;\n#[cfg(test)]\nmod tests {\nsay(\"arm 1\"); // \"x\"\ngeometry.arm_range_rad;\nlet arm = 1;\n";
    let lines: Vec<String> = findings("src/x.rs", text);
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert_eq!(findings("tests/x.rs", "say(\"arm \\\" 1\");"), [""; 0]);
    assert_eq!(findings("tests/x.rs", "say(\"\"); // an arm").len(), 1);
}

/// Reads the sources of a folder, each with its path inside the repository.
fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, String)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = format!("{prefix}{name}");
        if entry.file_type()?.is_dir() {
            if name != "target" && !name.starts_with('.') {
                collect(&entry.path(), &format!("{path}/"), files)?;
            }
        } else if [".rs", ".js", ".html"].iter().any(|end| name.ends_with(end)) {
            files.push((path, fs::read_to_string(entry.path())?));
        }
    }
    Ok(())
}

/// Lines of a file with a robot's words, each with place and words.
fn findings(path: &str, text: &str) -> Vec<String> {
    let foreign = |kind: &&Kind| !kind.own.iter().any(|own| path.starts_with(own));
    let kinds: Vec<&Kind> = KINDS.iter().filter(foreign).collect();
    if path == CHECK || SIDE_BY_SIDE.contains(&path) || kinds.is_empty() {
        return Vec::new();
    }
    let is_seam = SEAMS.contains(&path);
    let is_own = kinds.len() < KINDS.len();
    let is_test_file = path.starts_with("tests/") || path.contains("/tests/") || path.contains("/checks/");
    let mut is_test = is_test_file || path.ends_with("tests.rs");
    let mut before = "";
    let mut found = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        is_test |= before == "#[cfg(test)]" && line.starts_with("mod ");
        before = line;
        let line = NAMES
            .iter()
            .fold(line.to_owned(), |line, (written, name)| line.replace(written, name));
        let line = line.as_str();
        let lower = line.to_lowercase();
        // Most lines end here.
        if !kinds
            .iter()
            .flat_map(|kind| kind.words)
            .any(|word| lower.contains(word))
        {
            continue;
        }
        let is_named = |word: &String| {
            kinds.iter().any(|kind| {
                let is_name = word == kind.name;
                kind.words.contains(&word.as_str()) && if is_name { !(is_seam || is_test) } else { !is_own }
            })
        };
        let words: Vec<String> = parts(&meant(line, is_test)).into_iter().filter(is_named).collect();
        if !words.is_empty() {
            found.push(format!("{path}:{number}: {}: {}", words.join(", "), line.trim()));
        }
    }
    found
}

/// A line without the phrases of other meanings; in tests also without keys of the configuration and texts.
fn meant(line: &str, is_test: bool) -> String {
    let phrases = OTHER_MEANINGS.iter().flat_map(|(_, phrases)| *phrases);
    let mut line = phrases.fold(line.to_owned(), |line, phrase| line.replace(phrase, " "));
    if is_test {
        line = KEYS.iter().fold(line, |line, key| line.replace(key, " "));
        // Escaped quotation marks do not end a text.
        let line = line.replace("\\\"", " ");
        return line.split('"').step_by(2).collect::<Vec<_>>().join(" ");
    }
    line
}

/// The words and the parts of names of a line, in lower case.
fn parts(line: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut was_lower = false;
    for letter in line.chars() {
        if !letter.is_alphabetic() || (letter.is_uppercase() && was_lower) {
            parts.push(String::new());
        }
        was_lower = letter.is_lowercase();
        if let (true, Some(part)) = (letter.is_alphabetic(), parts.last_mut()) {
            part.extend(letter.to_lowercase());
        }
    }
    parts.retain(|part| !part.is_empty());
    parts
}

//! The program without its sources, and on a computer whose package manager is busy.

use crate::program::{Folder, etherpen, run};
use host_tools::error::code;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};

#[test]
fn commands_that_need_the_sources_say_so_and_the_others_do_not() {
    let folder = Folder::new();
    folder.file("lines.csv", "x_mm,y_mm,pen\n10,10,0\n40,10,1\n");
    let needing: [&[&str]; 8] = [
        &["demo"],
        &["demo", "--photo", "lines.csv"],
        &["emulate"],
        &["console", "--emulate"],
        &["flash"],
        &["verify"],
        &["bench", "drawing"],
        &["bench", "motion"],
    ];
    for words in needing {
        let absent = folder.join("absent");
        let (status, _, stderr) = run(etherpen(&folder).args(words).env("ETHERPEN_SOURCES", &absent));
        assert_eq!(status, Some(i32::from(code::TOOL)), "{words:?}: {stderr}");
        let said = [
            absent.to_string_lossy().into_owned(),
            "ETHERPEN_SOURCES".into(),
            "checkout".into(),
        ];
        assert!(said.iter().all(|part| stderr.contains(part)), "{words:?}: {stderr}");
    }
    let free: [&[&str]; 6] = [
        &["simulate", "lines.csv"],
        &["preview", "lines.csv", "-o", "lines.svg"],
        &["kinematics", "inverse", "--position", "-10,0,-800"],
        &["config", "show"],
        &["man", "pages"],
        &["jobs"],
    ];
    for words in free {
        let (status, _, stderr) = run(etherpen(&folder)
            .args(words)
            .env("ETHERPEN_SOURCES", folder.join("absent")));
        assert_eq!(status, Some(0), "{words:?}: {stderr}");
    }
}

#[test]
fn help_lists_first_what_people_do_first() {
    let folder = Folder::new();
    let (_, help, _) = run(etherpen(&folder).arg("--help"));
    let commands: Vec<&str> = (help.lines())
        .skip_while(|line| !line.starts_with("Commands:"))
        .filter_map(|line| line.strip_prefix("  ")?.split_whitespace().next())
        .collect();
    let place = |name: &str| {
        commands
            .iter()
            .position(|command| *command == name)
            .unwrap_or_else(|| panic!("no {name}: {help}"))
    };
    assert!(
        commands.starts_with(&["demo", "console", "draw", "stop", "status"]),
        "{commands:?}"
    );
    for late in ["bench", "bus", "verify", "segment", "completions"] {
        assert!(
            place(late) > place("record") && place(late) > place("preview"),
            "{late}: {commands:?}"
        );
    }
}

#[test]
fn set_up_waits_for_another_package_manager_and_says_for_which() {
    let folder = Folder::new();
    let bin = folder.join("bin");
    fs::create_dir(&bin).expect("a folder");
    let script = |name: &str, text: &str| {
        let path = folder.file(&format!("bin/{name}"), format!("#!/bin/sh\n{text}\n"));
        fs::set_permissions(path, fs::Permissions::from_mode(0o755)).expect("a script");
    };
    for tool in ["env", "cat", "chmod", "rm"] {
        symlink(format!("/usr/bin/{tool}"), bin.join(tool)).expect("a tool");
    }
    script("id", "echo 0");
    // Locked twice, as by a fresh system's upgrades; then it installs an emulator that is too old.
    script(
        "apt-get",
        "[ \"$1\" = --version ] && exit 0\n\
         if ! [ -e locked ]; then echo x > locked; fi\n\
         case \"$(cat locked)\" in x|xx)\n\
         echo \"x$(cat locked)\" > locked\n\
         echo 'E: Could not get lock /var/lib/dpkg/lock-frontend. It is held by process 1423 (unattended-upgr)' >&2\n\
         exit 100;; esac\n\
         echo '#!/bin/sh\necho QEMU emulator version 5.0' > bin/qemu-system-arm; chmod 755 bin/qemu-system-arm",
    );
    let (status, stdout, stderr) = run(etherpen(&folder).arg("emulate").env("PATH", &bin));
    assert_eq!(status, Some(i32::from(code::TOOL)), "{stderr}");
    let waiting = "waiting for another package manager, process 1423 (unattended-upgr), at most 15 minutes";
    assert_eq!(stderr.matches(waiting).count(), 1, "{stderr}");
    assert!(stderr.contains("is too old"), "it was installed: {stderr}");
    assert_eq!(fs::read_to_string(folder.join("locked")).expect("a note"), "xxx\n");
    assert!(stdout.is_empty(), "{stdout}");
}

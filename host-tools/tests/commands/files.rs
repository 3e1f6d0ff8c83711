//! Files of slaves (FoE) through the program: `bus foe` against the segment's file server, with its faults.

use crate::program::{Folder, etherpen, run};
use crate::segment::{Segment, tell};
use host_tools::error::code;
use std::path::PathBuf;

/// Bytes of a packet in BOOT of the generic drive: 400 bytes of mailbox out, 300 in, less both headers.
const PACKET_OUT: usize = 388;
const PACKET_IN: usize = 288;

/// A segment with one generic drive whose files have a password.
struct Drive {
    folder: Folder,
    place: PathBuf,
    socket: PathBuf,
    _segment: Segment,
}

impl Drive {
    fn new() -> Self {
        let folder = Folder::new();
        let (place, socket) = (folder.join("segment.sock"), folder.join("control.sock"));
        let mut command = etherpen(&folder);
        command
            .args([
                "segment",
                "--slaves",
                "ek1100,cia402@password=0xC0DE,el1008",
                "--control",
            ])
            .arg(&socket)
            .arg("--unix")
            .arg(&place);
        let segment = Segment::start(&mut command);
        Self {
            folder,
            place,
            socket,
            _segment: segment,
        }
    }

    /// Runs `etherpen bus`: exit code, stdout, stderr.
    fn bus(&self, words: &[&str]) -> (Option<i32>, String, String) {
        let mut command = etherpen(&self.folder);
        run(command.arg("bus").args(words).arg("--unix").arg(&self.place))
    }

    fn write(&self, content: &[u8], options: &[&str]) -> (Option<i32>, String, String) {
        let path = self.folder.file("out.bin", content);
        let path = path.to_str().expect("UTF-8");
        let words = ["foe", "write", "2", "fw.bin", path, "--password", "0xC0DE"];
        self.bus(&[&words[..], options].concat())
    }

    fn read(&self, options: &[&str]) -> Result<Vec<u8>, String> {
        let path = self.folder.join("in.bin");
        let words = [
            "foe",
            "read",
            "2",
            "fw.bin",
            path.to_str().expect("UTF-8"),
            "--password",
            "49374",
        ];
        match self.bus(&[&words[..], options].concat()) {
            (Some(0), ..) => Ok(std::fs::read(&path).expect("the file")),
            (_, _, stderr) => Err(stderr),
        }
    }

    fn fault(&self, words: &str) {
        let (status, _, stderr) = tell(&self.folder, &self.socket, &format!("fault {words}"));
        assert_eq!(status, Some(0), "{stderr}");
    }

    fn state(&self) -> String {
        let (_, answer, _) = tell(&self.folder, &self.socket, "get 2");
        answer["al_state"].as_str().expect("a state").to_owned()
    }
}

fn content(length: usize) -> Vec<u8> {
    (0..length).map(|at| (at * 7 + at / 251) as u8).collect()
}

#[test]
fn files_of_every_length_come_back_as_they_were_written() {
    let drive = Drive::new();
    for length in [
        0,
        1,
        PACKET_IN,
        PACKET_OUT - 1,
        PACKET_OUT,
        PACKET_OUT + 1,
        3 * PACKET_OUT,
        4 * PACKET_IN * 97,
    ] {
        let content = content(length);
        let (status, stdout, stderr) = drive.write(&content, &["--json"]);
        assert_eq!(status, Some(0), "{length}: {stderr}");
        let told: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
        assert_eq!((&told["bytes"], &told["name"]), (&length.into(), &"fw.bin".into()));
        assert_eq!(drive.state(), "INIT", "BOOT was left");
        assert!(drive.read(&[]) == Ok(content), "{length} bytes");
    }
    // The mailbox of PREOP works as before, and files are read there too.
    let (status, stdout, stderr) = drive.bus(&["sdo", "read", "2", "1018:1"]);
    assert!(status == Some(0) && stdout.contains("0x00000e7e"), "{stdout}{stderr}");
    assert_eq!(
        drive.read(&["--no-boot"]).map(|file| file.len()),
        Ok(4 * PACKET_IN * 97)
    );
    assert_eq!(drive.state(), "PREOP");
}

#[test]
fn what_the_slave_refuses_is_told_with_its_code_and_leaves_it_usable() {
    let drive = Drive::new();
    let missing = drive.read(&[]).expect_err("there is no file");
    assert!(missing.contains("0x8001") && missing.contains("not found"), "{missing}");
    assert_eq!(drive.state(), "INIT");
    let (status, _, stderr) = drive.write(&content(1_000), &["--no-boot"]);
    assert_eq!(status, Some(i32::from(code::FAILED)));
    assert!(stderr.contains("0x8008") && stderr.contains("bootstrap"), "{stderr}");
    let path = drive.folder.file("other.bin", content(9));
    let words = [
        "foe",
        "write",
        "2",
        "fw.bin",
        path.to_str().expect("UTF-8"),
        "--password",
        "1",
    ];
    let (_, _, stderr) = drive.bus(&words);
    assert!(stderr.contains("0x800a") && stderr.contains("password"), "{stderr}");
    drive.fault("foe 2 error 0x8003");
    let (status, _, stderr) = drive.write(&content(1_000), &[]);
    assert_eq!(status, Some(i32::from(code::FAILED)));
    assert!(stderr.contains("disk full"), "{stderr}");
    let (_, _, stderr) = drive.bus(&["foe", "read", "1", "x", "x.bin"]);
    assert!(stderr.contains("no files"), "{stderr}");
    let (status, _, stderr) = drive.bus(&["foe", "write", "2", "x", "/nowhere/x.bin"]);
    assert!(
        status == Some(i32::from(code::USAGE)) && stderr.contains("/nowhere/x.bin"),
        "{stderr}"
    );
    let (status, _, stderr) = drive.bus(&["foe", "read", "2", &"x".repeat(65), "x.bin"]);
    assert!(
        status == Some(i32::from(code::USAGE)) && stderr.contains("64 bytes"),
        "{stderr}"
    );
    assert_eq!(drive.write(&content(1_000), &[]).0, Some(0));
    assert_eq!(drive.read(&[]), Ok(content(1_000)));
}

#[test]
fn a_busy_slave_lost_frames_and_lost_answers_cost_time_only() {
    let drive = Drive::new();
    let file = content(10 * PACKET_OUT + 5);
    drive.fault("foe 2 busy 7");
    assert_eq!(drive.write(&file, &[]).0, Some(0));
    drive.fault("foe 2 busy 3");
    assert!(drive.read(&[]) == Ok(file.clone()), "with a busy slave");
    for fault in ["lose", "drop", "mailbox 2 2 lost", "eoe 2"] {
        drive.fault(fault);
        let (status, _, stderr) = drive.write(&file, &[]);
        assert_eq!(status, Some(0), "{fault}: {stderr}");
        drive.fault(fault);
        assert!(drive.read(&[]) == Ok(file.clone()), "{fault}");
    }
}

#[test]
fn a_wrong_packet_number_ends_the_transfer_and_the_next_one_works() {
    let drive = Drive::new();
    assert_eq!(drive.write(&content(1_000), &[]).0, Some(0));
    drive.fault("foe 2 packet");
    let wrong = drive.read(&[]).expect_err("packet 2 instead of 1");
    assert!(wrong.contains("packet 2") && wrong.contains("packet 1"), "{wrong}");
    drive.fault("foe 2 packet");
    let (_, _, stderr) = drive.write(&content(5), &[]);
    assert!(
        stderr.contains("packet 1 of the file came instead of packet 0"),
        "{stderr}"
    );
    assert_eq!(drive.read(&[]), Ok(content(1_000)), "the old file is whole");
}

#[test]
fn a_silent_slave_is_given_up_after_its_time() {
    let drive = Drive::new();
    drive.fault("foe 2 silent 1");
    let silent = drive.read(&[]).expect_err("no answer");
    assert!(silent.contains("silent"), "{silent}");
    assert_eq!(drive.write(&content(3), &[]).0, Some(0));
}

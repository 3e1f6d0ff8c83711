//! Named inputs and outputs over the command line, with the emulator.

use crate::program::{Folder, Running, etherpen, run};
use host_tools::error::code;
use host_tools::setup;
use serde_json::Value;

const POINTS: &str = "
[[io]]
name = \"stop\"
slave = 5
bit = 0
role = \"emergency_stop\"

[[io]]
name = \"sensors\"
slave = 5
bit = 0
type = \"u8\"

[[io]]
name = \"valve\"
slave = 6
direction = \"out\"
object = \"0x7010:01\"
";

#[test]
fn points_are_listed_read_and_set_and_every_refusal_says_why() {
    let folder = Folder::new();
    let config = folder.file("robot.toml", POINTS);
    setup::build_firmware("emulated").expect("the firmware builds");
    let mut emulate = Running::start(etherpen(&folder).arg("emulate").arg("--config").arg(&config));
    let port = emulate.wait_for("port", |program| program.stdout().lines().next().map(str::to_owned));
    let tell = |words: &[&str]| {
        let mut command = etherpen(&folder);
        command.args(words).args(["--port", &port]).arg("--config").arg(&config);
        run(&mut command)
    };
    let json = |words: &[&str]| -> Value {
        let (status, stdout, stderr) = tell(&[words, &["--json"]].concat());
        assert_eq!(status, Some(0), "{words:?}: {stderr}");
        serde_json::from_str(&stdout).expect("JSON")
    };
    let refused = |words: &[&str], code: u8, why: &str| {
        let (status, _, stderr) = tell(words);
        assert_eq!(status, Some(i32::from(code)), "{words:?}: {stderr}");
        assert!(stderr.contains(why), "{words:?}: {stderr}");
    };
    refused(&["io", "get", "pump"], code::USAGE, "there are stop, sensors, valve");
    refused(&["io", "set", "sensors", "1"], code::USAGE, "is an input");
    refused(&["io", "set", "valve", "2"], code::USAGE, "allowed is 0 to 1");
    json(&["enable"]);
    let points = json(&["io"]);
    let values: Vec<&Value> = points
        .as_array()
        .expect("a list")
        .iter()
        .map(|point| &point["value"])
        .collect();
    assert_eq!(
        values,
        [1, 1, 0],
        "the contact of the emergency stop is closed: {points}"
    );
    assert_eq!(points[0]["role"], "emergency_stop");
    assert_eq!(points[2]["object"], "0x7010:01");
    assert_eq!(json(&["status"])["io"], points, "the state shows them too");
    let valve = json(&["io", "set", "valve", "on"]);
    assert_eq!(
        (&valve["name"], &valve["value"]),
        (&"valve".into(), &1.into()),
        "{valve}"
    );
    assert_eq!(json(&["io", "get", "valve"])["value"], 1);
    json(&["stop"]);
    refused(&["io", "set", "valve", "1"], code::FAILED, "stopped by a fault");
    assert_eq!(json(&["io", "get", "valve"])["value"], 0, "a fault switches it off");
    json(&["acknowledge"]);
    json(&["io", "set", "valve", "0x1"]);
    json(&["disable"]);
    let other = folder.file("other.toml", POINTS.replace("valve", "pump"));
    let mut command = etherpen(&folder);
    command
        .args(["io", "get", "pump", "--port", &port])
        .arg("--config")
        .arg(&other);
    let (status, _, stderr) = run(&mut command);
    assert_eq!(status, Some(i32::from(code::FAILED)), "{stderr}");
    assert!(stderr.contains("another configuration"), "{stderr}");
}

//! A drawing resumed immediately after it has failed: late messages about its first end do not end it a second time.

use super::client::{Client, Rig, TOKEN};
use super::page::short_drawing;
use serde_json::{Value, json};

/// How often the drawing fails and is resumed.
const FAILURES: u64 = 3;

/// Prepares and starts the short drawing; returns the number of its job.
fn begin(rig: &Rig, viewer: &mut Client) -> Value {
    let head = format!(
        "POST /file HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: {TOKEN}\r\nx-etherpen-viewer: {}\r\nx-etherpen-name: waves.csv",
        rig.address(),
        viewer.sections["you"]["id"]
    );
    let answer = rig.http(&head, short_drawing().as_bytes());
    assert!(answer.starts_with("HTTP/1.1 2"), "{answer}");
    let made = viewer.state("studio", |made| made["state"] == "ready");
    viewer.send(&json!({"type": "enqueue", "preparation": made["number"]}));
    let jobs = viewer.state("jobs", |jobs| {
        jobs["waiting"].as_array().is_some_and(|waiting| !waiting.is_empty())
    });
    let job = jobs["waiting"][0]["number"].clone();
    viewer.send(&json!({"type": "start", "job": job}));
    job
}

#[test]
fn a_drawing_that_goes_on_at_once_is_not_ended_by_its_first_failure() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    let job = begin(&rig, &mut viewer);
    for failure in 1..=FAILURES {
        viewer.state("status", |status| status["mode"] == "Drawing");
        viewer.until("progress", |progress| {
            progress["executed_mm"].as_f64() > Some(100.0 * failure as f64)
        });
        viewer.send(&json!({"type": "inject", "fault": {"what": "fault", "slave": 2}}));
        viewer.until("status", |status| status["mode"] == "Fault");
        viewer.state("jobs", |jobs| jobs["past"][0]["unfinished"] == true);
        // Nothing is awaited that is not needed.
        while viewer.sections["status"]["mode"] != "DrivesOff" {
            viewer.command(json!({"do": "acknowledge"}));
            viewer.until("status", |_| true);
        }
        viewer.send(&json!({"type": "continue", "job": job}));
        viewer.until("jobs", |jobs| !jobs["active"].is_null());
    }
    let jobs = viewer.until("jobs", |jobs| jobs["active"].is_null());
    assert_eq!(jobs["past"][0]["done"], true, "{jobs}, {:#?}", viewer.log);
}

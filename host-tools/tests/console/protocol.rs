//! What a viewer may and may not do, and the effects on the other viewers.

use super::client::{Client, PATIENCE, Rig, TOKEN};
use etherpen::application::Mode;
use serde_json::json;
use std::time::{Duration, Instant};

#[test]
fn another_page_and_another_name_are_refused_before_anything_is_said() {
    let rig = Rig::start();
    let address = rig.address();
    for origin in ["http://evil.example", "https://127.0.0.1", "null"] {
        let refused = Client::try_connect(address, origin).err().unwrap_or_default();
        assert!(refused.contains("403"), "{origin}: {refused}");
    }
    let answer = rig.http("GET / HTTP/1.1\r\nHost: evil.example", b"");
    assert!(answer.starts_with("HTTP/1.1 403"), "{answer}");
    let head =
        format!("POST /stop HTTP/1.1\r\nHost: {address}\r\nOrigin: http://evil.example\r\nx-etherpen-token: {TOKEN}");
    assert!(rig.http(&head, b"").starts_with("HTTP/1.1 403"));
}

#[test]
fn the_page_may_load_nothing_from_elsewhere() {
    let rig = Rig::start();
    let answer = rig.http(&format!("GET / HTTP/1.1\r\nHost: {}", rig.address()), b"");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let head = answer.to_lowercase();
    assert!(head.contains("content-security-policy: default-src 'none'"));
    assert!(head.contains("referrer-policy: no-referrer") && head.contains("x-content-type-options: nosniff"));
}

#[test]
fn a_viewer_without_the_token_looks_but_neither_commands_nor_stops() {
    let rig = Rig::start();
    let mut guest = Client::connect(rig.address());
    guest.send(&json!({"type": "hello", "token": "0123456789abcdee", "page": "guest"}));
    assert_eq!(guest.until("you", |_| true)["may_command"], false);
    guest.mode("DrivesOff");
    for request in [
        json!({"type": "take"}),
        json!({"type": "stop"}),
        json!({"type": "command", "action": {"do": "enable"}}),
        json!({"type": "inject", "fault": {"what": "remove", "slave": 1}}),
    ] {
        guest.send(&request);
        guest.until("refused", |_| true);
    }
    let head = format!(
        "POST /stop HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: wrong",
        rig.address()
    );
    assert!(rig.http(&head, b"").starts_with("HTTP/1.1 403"));
    assert_eq!(guest.until("status", |_| true)["fault"], json!(null));
}

#[test]
fn one_viewer_commands_and_every_viewer_with_the_token_stops() {
    let rig = Rig::start();
    let (mut first, mut second) = (rig.viewer("first"), rig.viewer("second"));
    first.enable();
    second.command(json!({"do": "disable"}));
    second.until("refused", |why| why.as_str().is_some_and(|why| why.contains("control")));
    second.send(&json!({"type": "take"}));
    second.until("refused", |why| {
        why.as_str().is_some_and(|why| why.contains("another viewer"))
    });
    second.send(&json!({"type": "stop"}));
    for viewer in [&mut first, &mut second] {
        let stopped = viewer.state("status", |status| status["stopped"] == true);
        assert_eq!(stopped["mode"], "Fault");
    }
    first.send(&json!({"type": "release"}));
    first.state("control", |control| control["holder"].is_null());
    second.send(&json!({"type": "take"}));
    let you = second.sections["you"]["id"].clone();
    second.state("control", |control| control["holder"] == you);
    second.command(json!({"do": "acknowledge"}));
    second.state("status", |status| status["mode"] == "DrivesOff");
}

#[test]
fn what_is_no_request_is_refused_and_too_much_of_it_ends_the_connection() {
    let rig = Rig::start();
    let mut other = rig.viewer("other");
    let mut malformed = rig.viewer("malformed");
    for text in ["{", "[]", "\u{0}", "{\"type\":\"fly\"}"] {
        malformed.send_text(text);
        malformed.until("refused", |why| {
            why.as_str().is_some_and(|why| why.contains("no request"))
        });
    }
    (0..20).for_each(|_| malformed.send_text("nonsense"));
    while malformed.take().is_some() {}
    let mut oversized = rig.viewer("oversized");
    oversized.send_text(&format!("{{\"type\":\"hello\",\"page\":\"{}\"}}", "x".repeat(1 << 20)));
    while oversized.take().is_some() {}
    let address = rig.address();
    let head = format!("POST /file HTTP/1.1\r\nHost: {address}\r\nx-etherpen-token: {TOKEN}\r\nx-etherpen-viewer: 1");
    let answer = rig.http(&head, &vec![0; 33 << 20]);
    assert!(!answer.starts_with("HTTP/1.1 2"), "{answer}");
    other.until("pose", |_| true);
}

/// Numbers of the columns of a plot, in the order in which they arrived.
fn columns(client: &Client) -> Vec<u32> {
    let word = |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let of = |bytes: &Vec<u8>| {
        let count = word(bytes, 12) as usize;
        (0..count)
            .map(|column| word(bytes, 16 + 4 * column))
            .collect::<Vec<_>>()
    };
    client
        .binary
        .iter()
        .filter(|bytes| bytes[0] == 1)
        .flat_map(of)
        .collect()
}

#[test]
fn ten_viewers_see_every_millisecond_although_an_eleventh_never_reads() {
    let rig = Rig::start();
    let signals: Vec<_> = (0..16).collect();
    let watch = json!({"type": "watch", "id": 1, "signals": signals, "window_ms": 1000, "columns": 1000});
    let mut slow = rig.viewer("slow");
    slow.send(&watch);
    let mut viewers: Vec<_> = (0..10).map(|number| rig.viewer(&format!("viewer {number}"))).collect();
    viewers.iter_mut().for_each(|viewer| viewer.send(&watch));
    for viewer in &mut viewers {
        viewer.state("control", |control| control["viewers"] == 11);
    }
    let threads: Vec<_> = viewers
        .into_iter()
        .map(|mut viewer| {
            std::thread::spawn(move || {
                let begun = Instant::now();
                while columns(&viewer).len() < 1_500 {
                    assert!(begun.elapsed() < PATIENCE, "{} columns", columns(&viewer).len());
                    viewer.listen(Duration::from_millis(200));
                }
                viewer
            })
        })
        .collect();
    for thread in threads {
        let viewer = thread.join().unwrap();
        let columns = columns(&viewer);
        assert!(
            columns.windows(2).all(|pair| pair[1] == pair[0] + 1),
            "a millisecond is missing"
        );
    }
    slow.until("binary", |_| true);
    assert!(columns(&slow).windows(2).all(|pair| pair[1] > pair[0]));
}

#[test]
fn a_viewer_that_vanishes_while_it_jogs_stops_the_robot_and_loses_control_later() {
    let rig = Rig::start();
    let mut watching = rig.viewer("watching");
    let mut jogging = rig.viewer("jogging");
    jogging.enable();
    let begun = Instant::now();
    loop {
        jogging.send(&json!({"type": "jog", "velocity_mm_s": [20.0, 0.0, 0.0]}));
        jogging.listen(Duration::from_millis(20));
        if jogging.sections["pose"]["mode"] == "Moving" {
            break;
        }
        assert!(begun.elapsed() < PATIENCE);
    }
    drop(jogging);
    rig.until("standstill", |console| {
        console.hub().history().last().is_some_and(|row| row.mode == Mode::Idle)
    });
    watching.until_told("has gone with control");
    rig.until("free control", |console| console.hub().control.holder().is_none());
    watching.send(&json!({"type": "take"}));
    let you = watching.sections["you"]["id"].clone();
    watching.state("control", |control| control["holder"] == you);
}

#[test]
fn a_jog_that_is_not_repeated_ends() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("jogging");
    viewer.enable();
    let before = rig.rows();
    viewer.send(&json!({"type": "jog", "velocity_mm_s": [0.0, 20.0, 0.0]}));
    rig.until("a motion that has ended", |console| {
        let (_, rows) = console.hub().history().since(before);
        let ended = rows.last().is_some_and(|row| row.mode == Mode::Idle);
        ended && rows.iter().any(|row| row.mode == Mode::Moving)
    });
}

#[test]
fn a_restart_of_the_firmware_is_told_and_survived() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    let before = viewer.until("pose", |_| true)["time_ms"].as_u64().unwrap();
    viewer.send(&json!({"type": "inject", "fault": {"what": "restart"}}));
    viewer.until("link", |link| link["state"] == "lost");
    viewer.until("link", |link| link["state"] == "connected");
    viewer.mode("DrivesOff");
    let after = viewer.until("pose", |_| true)["time_ms"].as_u64().unwrap();
    assert!(after > before, "the time axis goes on: {before}, {after}");
}

#[test]
fn a_stop_while_the_firmware_is_away_is_repeated_until_the_firmware_confirms_it() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    viewer.send(&json!({"type": "inject", "fault": {"what": "restart"}}));
    viewer.until("link", |link| link["state"] == "lost");
    viewer.send(&json!({"type": "stop"}));
    viewer.state("status", |status| status["stopped"] == true);
}

#[test]
fn an_unplugged_drive_is_a_fault_that_can_be_acknowledged_once_it_is_back() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    viewer.send(&json!({"type": "inject", "fault": {"what": "remove", "slave": 2}}));
    viewer.until("status", |status| status["mode"] == "Fault");
    viewer.send(&json!({"type": "inject", "fault": {"what": "insert", "slave": 2}}));
    viewer.state("segment", |segment| segment["removed"] == json!([]));
    let begun = Instant::now();
    while viewer.sections["status"]["mode"] != "DrivesOff" {
        assert!(begun.elapsed() < PATIENCE);
        viewer.command(json!({"do": "acknowledge"}));
        viewer.listen(Duration::from_millis(300));
    }
}

#[test]
fn a_capture_holds_what_was_before_and_after_the_event() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    viewer.until("pose", |pose| pose["time_ms"].as_u64() > Some(500));
    viewer.send(
        &json!({"type": "arm", "signal": 0, "condition": "fault", "level": 0.0, "before_ms": 200, "after_ms": 300}),
    );
    viewer.until("capture", |capture| capture["state"] == "armed");
    viewer.send(&json!({"type": "stop"}));
    let caught = viewer.until("capture", |capture| capture["state"] == "caught");
    let time = |name: &str| caught[name].as_u64().unwrap();
    assert_eq!(
        (time("event_ms") - time("from_ms"), time("to_ms") - time("event_ms")),
        (200, 300)
    );
    viewer.binary.clear();
    let range = json!({"type": "range", "id": 9, "signals": [0, 1], "from_ms": time("from_ms"), "to_ms": time("to_ms"), "columns": 0});
    viewer.send(&range);
    viewer.until("binary", |_| true);
    assert_eq!(columns(&viewer).len(), 501);
}

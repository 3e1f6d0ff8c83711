//! Malicious viewers, and a stop that gets through nevertheless.

use super::client::{Client, PATIENCE, Rig, TOKEN};
use host_tools::cell::DriveState;
use host_tools::console::gate::Passage;
use host_tools::console::hub::{GUESTS_MAX, VIEWERS_MAX};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Connections kept open by each thread that connects as often as it can.
const OPEN_AT_ONCE: usize = 300;
/// Requests of other viewers that are started before a stop is sent.
const BEGUN_BETWEEN: usize = 30;

fn range(id: u32) -> Value {
    let signals: Vec<_> = (0..28).collect();
    json!({"type": "range", "id": id, "signals": signals, "from_ms": 0, "to_ms": 60_000, "columns": 0})
}

/// Sends as many requests as it can, in a separate thread, until told to end.
fn flood(rig: &Rig, ended: &Arc<AtomicBool>) -> std::thread::JoinHandle<()> {
    let (address, ended) = (rig.address(), ended.clone());
    std::thread::spawn(move || {
        let (mut client, mut id) = (Client::connect(address), 0);
        while !ended.load(Ordering::Relaxed) {
            for _ in 0..20 {
                id += 1;
                client.send(&range(id));
            }
            if client.take().is_none() {
                client = Client::connect(address);
            }
            client.binary.clear();
        }
    })
}

fn post_stop(rig: &Rig) {
    let head = format!(
        "POST /stop HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: {TOKEN}",
        rig.address()
    );
    let answer = rig.http(&head, b"");
    assert!(answer.starts_with("HTTP/1.1 202"), "{answer}");
}

#[test]
fn no_request_is_begun_between_a_stop_and_its_writing_to_the_port() {
    let rig = Rig::start();
    let passed = Arc::new(Mutex::new(Vec::new()));
    let seen = passed.clone();
    rig.console()
        .gate()
        .watch(Box::new(move |passage| seen.lock().unwrap().push(passage)));
    let mut operator = rig.viewer("operator");
    operator.mode("DrivesOff");
    let ended = Arc::new(AtomicBool::new(false));
    let floods: Vec<_> = (0..3).map(|_| flood(&rig, &ended)).collect();
    let count = |wanted: fn(&Passage) -> bool| passed.lock().unwrap().iter().filter(|passage| wanted(passage)).count();
    let begun = || count(|passage| matches!(passage, Passage::Begun(viewer) if *viewer > 0));
    for stop in 1..=10 {
        let before = begun();
        rig.until("requests of the others", |_| begun() >= before + BEGUN_BETWEEN);
        match stop % 2 {
            0 => post_stop(&rig),
            _ => operator.send(&json!({"type": "stop"})),
        }
        rig.until("a stop that was written", |_| {
            count(|passage| *passage == Passage::StopWritten) == stop
        });
    }
    ended.store(true, Ordering::Relaxed);
    floods.into_iter().for_each(|flood| flood.join().unwrap());
    let (mut on_its_way, mut stops) = (0, 0);
    for passage in passed.lock().unwrap().iter() {
        match passage {
            Passage::StopArrived => on_its_way += 1,
            Passage::StopWritten => {
                on_its_way -= 1;
                stops += 1;
            }
            Passage::Begun(viewer) => assert_eq!(on_its_way, 0, "viewer {viewer} was served before a stop"),
        }
    }
    println!("{stops} stops among {} requests of three floods", begun());
    assert_eq!((stops, on_its_way), (10, 0));
    operator.state("status", |status| status["stopped"] == true);
}

#[test]
fn a_stop_reaches_the_drives_while_no_request_can_be_served_at_all() {
    for by_socket in [true, false] {
        let rig = Rig::start();
        let mut operator = rig.viewer("operator");
        operator.enable();
        let enabled = || {
            let slaves = rig.cell().state().slaves;
            slaves.iter().any(|slave| slave.drive == DriveState::OperationEnabled)
        };
        rig.until("drives with power", |_| enabled());
        // Everything that serves viewers waits for this lock.
        let hub = rig.console().hub();
        match by_socket {
            true => operator.send(&json!({"type": "stop"})),
            false => post_stop(&rig),
        }
        let begun = Instant::now();
        while enabled() {
            assert!(begun.elapsed() < PATIENCE, "the drives go on; by socket: {by_socket}");
            std::thread::sleep(Duration::from_millis(5));
        }
        drop(hub);
        operator.state("status", |status| status["stopped"] == true);
    }
}

/// Whether something comes within some seconds.
fn comes(is: &dyn Fn() -> bool) -> bool {
    let begun = Instant::now();
    while !is() && begun.elapsed() < Duration::from_secs(3) {
        std::thread::sleep(Duration::from_millis(5));
    }
    is()
}

/// The robot is in a fault latched by a stop.
fn stopped(rig: &Rig) -> Client {
    let mut operator = rig.viewer("operator");
    operator.enable();
    operator.send(&json!({"type": "stop"}));
    operator.until("status", |status| {
        status["mode"] == "Fault" && status["stopped"] == true
    });
    operator
}

#[test]
fn requests_before_a_stop_are_dropped_and_later_ones_are_carried_out() {
    // Messages on two connections are in order only once the first one has been started.
    for (begun, by_socket) in [(false, true), (true, true), (true, false)] {
        let rig = Rig::start();
        let mut operator = stopped(&rig);
        let passed = Arc::new(Mutex::new(Vec::new()));
        let seen = passed.clone();
        let watcher = Box::new(move |passage| seen.lock().unwrap().push(passage));
        rig.console().gate().watch(watcher);
        let has = |wanted: &dyn Fn(&Passage) -> bool| passed.lock().unwrap().iter().any(wanted);
        let stop = |operator: &mut Client| match by_socket {
            true => operator.send(&json!({"type": "stop"})),
            false => post_stop(&rig),
        };
        // Everything that serves viewers waits for this lock, before or after the request is started.
        let mut tries = 0;
        let hub = loop {
            passed.lock().unwrap().clear();
            let hub = rig.console().hub();
            operator.command(json!({"do": "acknowledge"}));
            if !begun || comes(&|| has(&|passage| matches!(passage, Passage::Begun(1..)))) {
                break hub;
            }
            // What reads the request waited for the lock already.
            drop(hub);
            tries += 1;
            assert!(tries < 20, "the request is never started under the lock");
            operator.until("status", |status| status["mode"] == "DrivesOff");
            operator.send(&json!({"type": "stop"}));
            operator.until("status", |status| {
                status["mode"] == "Fault" && status["stopped"] == true
            });
        };
        stop(&mut operator);
        rig.until("a stop that was written", |_| {
            has(&|passage| *passage == Passage::StopWritten)
        });
        drop(hub);
        operator.listen(Duration::from_secs(1));
        let mode = &operator.sections["status"]["mode"];
        assert_eq!(mode, "Fault", "begun: {begun}, by socket: {by_socket}");
        operator.state("refused", |said| {
            said.as_str()
                .is_some_and(|said| said.contains("a stop has overtaken it"))
        });
        operator.command(json!({"do": "acknowledge"}));
        operator.until("status", |status| status["mode"] == "DrivesOff");
    }
}

#[test]
fn requests_that_make_no_sense_are_refused_with_the_reason() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("viewer");
    viewer.enable();
    let huge = u64::MAX;
    for (request, why) in [
        (
            json!({"type": "range", "id": 1, "signals": [0], "from_ms": 9, "to_ms": 8, "columns": 10}),
            "before it begins",
        ),
        (
            json!({"type": "range", "id": 1, "signals": [0], "from_ms": 0, "to_ms": huge, "columns": 0}),
            "at most",
        ),
        (
            json!({"type": "range", "id": 1, "signals": [0], "from_ms": 0, "to_ms": 9, "columns": huge}),
            "columns",
        ),
        (
            json!({"type": "watch", "id": 1, "signals": [0], "window_ms": 1_000, "columns": 0}),
            "columns",
        ),
        (
            json!({"type": "watch", "id": 1, "signals": [0], "window_ms": huge, "columns": 10}),
            "ms",
        ),
        (
            json!({"type": "arm", "signal": 0, "condition": "above", "level": 1e300, "before_ms": 1, "after_ms": 1}),
            "level",
        ),
        (json!({"type": "jog", "velocity_mm_s": [1e300, 0.0, 0.0]}), "velocity"),
    ] {
        viewer.send(&request);
        viewer.until("refused", |said| said.as_str().is_some_and(|said| said.contains(why)));
    }
    viewer.send_text(r#"{"type":"jog","velocity_mm_s":[NaN,0,0]}"#);
    viewer.until("refused", |said| {
        said.as_str().is_some_and(|said| said.contains("no request"))
    });
}

#[test]
fn there_is_room_for_the_token_however_many_look_without_it() {
    let rig = Rig::start();
    let mut guests: Vec<_> = (0..VIEWERS_MAX + 8).map(|_| Client::connect(rig.address())).collect();
    let mut operators: Vec<_> = (0..VIEWERS_MAX - GUESTS_MAX)
        .map(|number| rig.viewer(&format!("operator {number}")))
        .collect();
    for operator in &mut operators {
        operator.mode("DrivesOff");
    }
    let viewers = operators[0].state("control", |_| true)["viewers"].as_u64();
    assert!(viewers <= Some(VIEWERS_MAX as u64), "{viewers:?}");
    while guests[0].take().is_some() {}
    operators[0].enable();
}

#[test]
fn the_token_is_looked_at_before_the_file_and_half_a_request_ends() {
    let rig = Rig::start();
    let mut stream = TcpStream::connect(rig.address()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let head = format!(
        "POST /file HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: wrong\r\nContent-Length: {}\r\n\r\n",
        rig.address(),
        30 << 20
    );
    // The file itself is never sent.
    stream.write_all(head.as_bytes()).unwrap();
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 403");
    let mut halves: Vec<_> = (0..100)
        .map(|_| {
            let mut half = TcpStream::connect(rig.address()).unwrap();
            half.set_read_timeout(Some(PATIENCE)).unwrap();
            half.write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap();
            half
        })
        .collect();
    post_stop(&rig);
    for half in &mut halves {
        // It is closed, with or without an answer.
        let _ = half.read_to_end(&mut Vec::new());
    }
}

/// Connects as often as it can and sends nothing, in a separate thread, until told to end; returns the number.
fn connect_often(rig: &Rig, ended: &Arc<AtomicBool>) -> std::thread::JoinHandle<usize> {
    let (address, ended) = (rig.address(), ended.clone());
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let connect = async move {
        let (mut open, mut count) = (VecDeque::new(), 0);
        while !ended.load(Ordering::Relaxed) {
            count += 1;
            // It waits for none of them.
            open.push_back(tokio::spawn(tokio::net::TcpStream::connect(address)));
            if open.len() > OPEN_AT_ONCE
                && let Some(oldest) = open.pop_front()
            {
                oldest.abort();
            }
            tokio::task::yield_now().await;
        }
        count
    };
    std::thread::spawn(move || runtime.block_on(connect))
}

#[test]
fn a_stop_is_answered_while_others_connect_as_often_as_they_can() {
    let rig = Rig::start();
    let ended = Arc::new(AtomicBool::new(false));
    let begun = Instant::now();
    let floods: Vec<_> = (0..2).map(|_| connect_often(&rig, &ended)).collect();
    std::thread::sleep(Duration::from_millis(500));
    for _ in 0..20 {
        post_stop(&rig);
        std::thread::sleep(Duration::from_millis(20));
    }
    ended.store(true, Ordering::Relaxed);
    let count: usize = floods.into_iter().map(|flood| flood.join().unwrap()).sum();
    println!(
        "{:.0} connections/s beside 20 stops",
        count as f64 / begun.elapsed().as_secs_f64()
    );
    assert!(count > 5_000, "{count}");
}

#[test]
fn every_load_lets_stops_through_and_keeps_the_console_small() {
    let program = std::path::Path::new(env!("CARGO_BIN_EXE_etherpen"));
    let report = host_tools::bench::console::run(&Default::default(), program, 3, |what| println!("{what}")).unwrap();
    for row in &report.rows {
        println!("{}: {:.1} {}", row.case, row.value, row.unit);
    }
    assert_eq!(report.rows.len(), 3 * 9);
    let memory = report.rows.iter().filter(|row| row.unit == "MiB");
    let large: Vec<_> = memory.filter(|row| row.met() != Some(true)).collect();
    assert!(large.is_empty(), "{large:?}");
}

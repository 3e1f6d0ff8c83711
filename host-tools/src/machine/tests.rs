//! A machine over a socket against the rig that answers as the firmware does.

use super::*;
use crate::error::code;
use crate::job::DrawTask;
use crate::job::progress::PathMeasure;
use crate::job::verification::Verification;
use crate::link::ownership::socket_path;
use crate::link::rig::{Rig, path, serve};
use etherpen::application::Mode;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;

/// Longest wait for anything; no result depends on it.
const PATIENCE: Duration = Duration::from_secs(60);

/// A port at which one rig after the other answers, each until its line is cut.
struct Place(PathBuf, UnixListener);

impl Place {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("etherpen-machine-{name}-{}", std::process::id()));
        // An earlier test may have been killed.
        let _ = std::fs::remove_file(&path);
        let listener = UnixListener::bind(&path).expect("the socket can be made");
        Self(path, listener)
    }

    fn start(&self) -> Machine {
        let options = MachineOptions::default();
        Machine::start(PortName::Unix(self.0.clone()), Config::default(), options).expect("somebody listens")
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn wait(news: &Subscription, mut wanted: impl FnMut(&News) -> bool) {
    loop {
        let next = news.next_within(PATIENCE).expect("the machine has something to say");
        if wanted(&next) {
            return;
        }
    }
}

fn draw(count: usize) -> Order {
    Order::Draw(DrawOrder {
        drawing: DrawTask::new(path(count)),
        name: "a path".into(),
        keep_samples: true,
    })
}

#[test]
fn a_drawing_is_drawn_while_others_watch_ask_and_hold() {
    let place = Place::new("draw");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let firmware = std::thread::spawn(move || serve(&mut Rig::new(1, 0), &stream));
    let (news, slow) = (machine.subscribe(10_000), machine.subscribe(2));
    let drawn = machine.order(draw(300));
    assert!(
        machine.carry_out(Order::Prepare(Ready::Enabled)).is_err(),
        "one task at a time"
    );
    wait(
        &news,
        |news| matches!(news, News::Progress(progress) if progress.vertices > 20),
    );
    assert_eq!(machine.carry_out(Order::Hold), Ok(Reply::Done));
    wait(
        &news,
        |news| matches!(news, News::Status(status) if status.mode == Mode::Holding),
    );
    assert!(machine.carry_out(Order::Hold).is_err(), "it holds already");
    assert!(matches!(
        machine.carry_out(Order::Bus(ServiceRequest::Bus)),
        Ok(Reply::Bus(Ok(_)))
    ));
    assert_eq!(machine.carry_out(Order::Resume), Ok(Reply::Done));
    assert_eq!(drawn.recv_timeout(PATIENCE), Ok(Ok(Reply::Done)));
    let mut report = None;
    wait(&news, |news| match news {
        News::Ended { report: ended, .. } => {
            report = ended.clone();
            true
        }
        _ => false,
    });
    let report = report.expect("a drawing leaves a report");
    assert!(report.samples.len() >= 300 && report.held_s > 0.0);
    assert_eq!(report.progress.vertices, 300);
    assert!(slow.take_lost() > 0);
    drop(machine);
    firmware.join().unwrap();
}

#[test]
fn a_broken_line_is_told_and_the_drawing_goes_on_by_an_order_only() {
    let place = Place::new("broken");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let news = machine.subscribe(10_000);
    let (cut, until_cut) = (stream.try_clone().unwrap(), stream);
    let mut rig = Rig::new(1, 0);
    let firmware = std::thread::spawn(move || {
        serve(&mut rig, &until_cut);
        rig
    });
    let drawn = machine.order(draw(500));
    wait(
        &news,
        |news| matches!(news, News::Progress(progress) if progress.vertices > 50),
    );
    cut.shutdown(std::net::Shutdown::Both).unwrap();
    let mut rig = firmware.join().unwrap();
    wait(&news, |news| matches!(news, News::Lost(_)));
    let stream = place.1.accept().unwrap().0;
    let firmware = std::thread::spawn(move || {
        serve(&mut rig, &stream);
        rig
    });
    wait(
        &news,
        |news| matches!(news, News::Status(status) if status.mode == Mode::Holding),
    );
    assert!(machine.snapshot().interrupted);
    assert_eq!(machine.carry_out(Order::Resume), Ok(Reply::Done));
    assert_eq!(drawn.recv_timeout(PATIENCE), Ok(Ok(Reply::Done)));
    drop(machine);
    let rig = firmware.join().unwrap();
    assert_eq!(rig.vertices, path(500));
    let draws = rig
        .commands
        .iter()
        .filter(|command| matches!(command, Command::Draw { .. }));
    assert_eq!(draws.count(), 1, "the drawing was begun once");
}

#[test]
fn a_machine_that_cannot_be_opened_is_an_error_or_waited_for() {
    let absent = PortName::Unix("/absent/socket".into());
    assert!(Machine::start(absent.clone(), Config::default(), MachineOptions::default()).is_err());
    let patient = MachineOptions {
        patient: true,
        ..MachineOptions::default()
    };
    let machine = Machine::start(absent, Config::default(), patient).unwrap();
    let news = machine.subscribe(10);
    wait(&news, |news| matches!(news, News::Reconnecting { .. }));
    let refused = machine.carry_out(Order::Stop).unwrap_err();
    assert_eq!(refused.code, crate::error::code::CONNECTION);
    assert!(refused.text.contains("etherpen emulate"), "{refused}");
}

#[test]
fn another_process_finds_the_owner_and_works_through_it() {
    let place = Place::new("shared");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let firmware = std::thread::spawn(move || serve(&mut Rig::new(1, 0), &stream));
    let mut client = Client::find(machine.port()).expect("the machine is shared");
    assert_eq!(client.owner().pid, std::process::id());
    assert_eq!(client.carry_out(Order::Prepare(Ready::Enabled)), Ok(Reply::Done));
    let mode = |snapshot: Snapshot| snapshot.status.map(|status| status.mode);
    assert_eq!(mode(client.snapshot().unwrap()), Some(Mode::Idle));
    let refused = client.carry_out(Order::Hold).unwrap_err();
    assert!(refused.text.contains("not possible now"), "{refused}");
    assert!(matches!(
        client.carry_out(Order::Bus(ServiceRequest::Bus)),
        Ok(Reply::Bus(Ok(_)))
    ));
    let taken = Machine::start(machine.port().clone(), Config::default(), MachineOptions::default()).unwrap_err();
    assert!(
        taken.to_string().contains(&format!("process {}", std::process::id())),
        "{taken}"
    );
    let port = machine.port().clone();
    drop(machine);
    firmware.join().unwrap();
    assert!(Client::find(&port).is_none(), "nothing is left behind");
    assert_eq!(
        client.carry_out(Order::Stop).unwrap_err().code,
        crate::error::code::CONNECTION
    );
}

#[test]
fn a_follower_in_another_process_hears_every_sample_of_a_drawing() {
    let place = Place::new("followed");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let firmware = std::thread::spawn(move || serve(&mut Rig::new(1, 0), &stream));
    assert_eq!(machine.carry_out(Order::Prepare(Ready::Enabled)), Ok(Reply::Done));
    let news = machine.subscribe(100_000);
    let mut source = Source::follow(Client::find(machine.port()).expect("it is shared")).unwrap();
    assert!(matches!(source.next_within(PATIENCE), Ok(Account::Connected(_))));
    assert_eq!(machine.carry_out(draw(300)), Ok(Reply::Done));
    let (mut heard, mut told) = (Vec::new(), Vec::new());
    while !told.iter().any(|text| text == "ended") {
        match source.next_within(PATIENCE).expect("the owner is there") {
            Account::Samples { missing, samples } => {
                heard.extend(samples.into_iter().map(|sample| (missing, sample.t_ms)))
            }
            Account::Task { text, .. } => told.push(text),
            _ => {}
        }
    }
    let owned = std::iter::from_fn(|| news.try_next()).filter_map(|news| match news {
        News::Samples { missing, samples } => {
            Some(samples.iter().map(|sample| (missing, sample.t_ms)).collect::<Vec<_>>())
        }
        _ => None,
    });
    let owned: Vec<_> = owned.flatten().collect();
    let first = heard
        .first()
        .and_then(|first| owned.iter().position(|sample| sample == first));
    let same = owned.iter().skip(first.unwrap_or(usize::MAX)).take(heard.len());
    assert!(
        heard.len() >= 300 && same.eq(&heard),
        "{} of {}",
        heard.len(),
        owned.len()
    );
    assert!(told.iter().any(|text| text == "a path is drawn"), "{told:?}");
    drop(machine);
    firmware.join().unwrap();
    let end = std::iter::repeat_with(|| source.next_within(PATIENCE)).find_map(Result::err);
    assert_eq!(end, Some(NoNews::Closed));
}

/// A port whose other end repeats these bytes and ignores everything it receives.
fn babble(says: &'static [u8]) -> PortName {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let name = PortName::Tcp(listener.local_addr().unwrap().to_string());
    std::thread::spawn(move || {
        use std::io::Write;
        let (mut stream, _) = listener.accept().unwrap();
        while stream.write_all(says).is_ok() {
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    name
}

#[test]
fn a_port_that_is_silent_or_says_what_is_no_message_is_told_as_such() {
    for says in [&b""[..], b"\x00login: \xff\x00\x01\x02 garbage \x00"] {
        let machine = Machine::start(babble(says), Config::default(), MachineOptions::default()).unwrap();
        let failure = machine.carry_out(Order::Prepare(Ready::Bus)).unwrap_err();
        assert_eq!(failure.code, crate::error::code::CONNECTION);
        assert!(failure.text.contains("no firmware answered"), "{failure}");
        assert!(failure.text.contains("no other program has it open"), "{failure}");
    }
}

#[test]
fn stops_that_come_together_are_all_done() {
    let place = Place::new("stops");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let firmware = std::thread::spawn(move || {
        let mut rig = Rig::new(1, 0);
        serve(&mut rig, &stream);
        rig
    });
    assert_eq!(machine.carry_out(Order::Prepare(Ready::Enabled)), Ok(Reply::Done));
    let answers: Vec<_> = (0..20)
        .map(|_| {
            // Some arrive in the same millisecond, some while an earlier one is in transit.
            std::thread::sleep(Duration::from_micros(300));
            machine.order(Order::Stop)
        })
        .collect();
    for answer in answers {
        assert_eq!(answer.recv_timeout(PATIENCE), Ok(Ok(Reply::Done)));
    }
    drop(machine);
    assert_eq!(firmware.join().unwrap().commands.last(), Some(&Command::Stop));
}

/// A client that was greeted and then sent these lines over the machine's socket; `None` if it was not admitted.
fn says(machine: &Machine, lines: &str) -> Option<BufReader<UnixStream>> {
    let stream = UnixStream::connect(socket_path(machine.port()).unwrap()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut program = BufReader::new(stream);
    let greeted = program.read_line(&mut String::new()).is_ok_and(|length| length > 0);
    greeted.then(|| program.get_mut().write_all(lines.as_bytes()).unwrap())?;
    Some(program)
}

fn line_of(id: u64, motion: Motion) -> String {
    let order = serde_json::to_value(Order::Motion(motion)).unwrap();
    format!("{}\n", serde_json::json!({"id": id, "ask": {"order": order}}))
}

const MOVE: Motion = Motion::Move(etherpen::robots::Position {
    x_mm: 0.0,
    y_mm: 10.0,
    z_mm: -830.0,
});

#[test]
fn a_program_that_ends_takes_its_own_motion_with_it_and_nobody_elses_drawing() {
    let place = Place::new("ends");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let firmware = std::thread::spawn(move || {
        let mut rig = Rig::new(1, 0);
        serve(&mut rig, &stream);
        rig
    });
    let news = machine.subscribe(10_000);
    let drawn = machine.order(draw(300));
    wait(
        &news,
        |news| matches!(news, News::Progress(progress) if progress.vertices > 20),
    );
    for _ in 0..5 {
        // It is refused, and may be gone before the refusal is sent.
        assert!(says(&machine, &line_of(1, MOVE)).is_some());
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(drawn.recv_timeout(PATIENCE), Ok(Ok(Reply::Done)));

    let news = machine.subscribe(10_000);
    // The malformed line ends the conversation while the client still has its end open.
    let _open = says(&machine, &(line_of(1, MOVE) + "{\n"));
    let mut result = Ok(());
    wait(&news, |news| match news {
        News::Ended { result: ended, .. } => {
            result = ended.clone();
            true
        }
        _ => false,
    });
    assert!(result.is_err(), "a motion ends with its program");
    drop(machine);
    let rig = firmware.join().unwrap();
    assert_eq!(rig.vertices, path(300));
    assert!(
        !rig.commands
            .iter()
            .any(|command| matches!(command, Command::Move { .. })),
        "{:?}",
        rig.commands
    );
}

#[test]
fn however_many_programs_are_connected_and_say_nothing_a_stop_finds_its_way() {
    let place = Place::new("crowd");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let firmware = std::thread::spawn(move || serve(&mut Rig::new(1, 0), &stream));
    assert_eq!(machine.carry_out(Order::Prepare(Ready::Enabled)), Ok(Reply::Done));
    let mut follower = Source::follow(Client::find(machine.port()).expect("it is shared")).unwrap();
    assert!(matches!(follower.next_within(PATIENCE), Ok(Account::Connected(_))));
    let idle: Vec<_> = (0..100).filter_map(|_| says(&machine, "")).collect();
    assert_eq!(idle.len(), 100, "each is let in");
    let mut client = Client::find(machine.port()).expect("there is room for one more");
    assert_eq!(client.carry_out(Order::Stop), Ok(Reply::Done));
    let stopped = |account: &Account| matches!(account, Account::Status(status) if status.mode == Mode::Fault);
    while !stopped(&follower.next_within(PATIENCE).expect("who follows is not sent away")) {}
    drop((client, follower, machine));
    firmware.join().unwrap();
}

#[test]
fn a_drawing_that_is_cancelled_while_the_line_is_down_is_not_shown_any_more() {
    let place = Place::new("down");
    let (machine, stream) = (place.start(), place.1.accept().unwrap().0);
    let news = machine.subscribe(10_000);
    let (cut, until_cut) = (stream.try_clone().unwrap(), stream);
    let firmware = std::thread::spawn(move || serve(&mut Rig::new(1, 0), &until_cut));
    let drawn = machine.order(draw(500));
    wait(
        &news,
        |news| matches!(news, News::Progress(progress) if progress.vertices > 50),
    );
    std::fs::remove_file(&place.0).unwrap();
    cut.shutdown(std::net::Shutdown::Both).unwrap();
    firmware.join().unwrap();
    wait(&news, |news| matches!(news, News::Lost(_)));
    let shown = machine.snapshot();
    assert!(shown.interrupted && shown.drawing.is_some());
    assert!(machine.carry_out(Order::Cancel).is_err(), "there is nobody to tell");
    assert!(drawn.recv_timeout(PATIENCE).unwrap().is_err());
    let shown = machine.snapshot();
    assert_eq!((shown.interrupted, shown.drawing), (false, None));
}

#[test]
fn a_connection_that_hears_nothing_of_a_drawing_takes_nothing_from_what_is_executed() {
    let of = |vertices, vertices_total| {
        let mut report = JobReport::default();
        (report.progress.vertices, report.progress.vertices_total) = (vertices, vertices_total);
        report
    };
    for (before, last, executed) in [
        ((800, 1_000), (0, 1_000), 800),
        ((800, 1_000), (0, 0), 800),
        ((800, 1_000), (900, 1_000), 900),
        ((0, 1_000), (900, 1_000), 900),
    ] {
        let merged = work::merged(Some(of(before.0, before.1)), of(last.0, last.1));
        assert_eq!(merged.progress.vertices, executed, "{before:?}, {last:?}");
        assert_eq!(merged.progress.vertices_total, 1_000);
    }
}

#[test]
fn a_part_that_any_connection_found_missing_is_drawn_again_from_there_however_the_drawing_ended() {
    let (path, config) = (path(100), Config::default());
    let measure = PathMeasure::new(&path, &config);
    let of = |vertices, verification: Verification| JobReport {
        progress: measure
            .progress(0, vertices, 1.0)
            .complete_to(verification.complete_vertices()),
        verification,
        drawn_s: 1.0,
        ..JobReport::default()
    };
    let saw = Verification::of_strokes;
    let ends = || {
        [
            (Ok(()), code::INCOMPLETE),
            (
                Err(Failure::new(code::INCOMPLETE, "stroke 8 is missing")),
                code::INCOMPLETE,
            ),
            (Err(Failure::new(code::FAULT, "the machine stopped")), code::FAULT),
            (Err(Failure::new(code::INTERRUPTED, "cancelled")), code::INTERRUPTED),
        ]
    };
    // The strokes that the connections saw, and those that they found missing.
    for (first, last, complete) in [
        (saw(0..5, Some(3)), saw(5..10, None), Some(30)),
        (saw(0..5, None), saw(5..10, Some(7)), Some(70)),
        (saw(0..5, Some(3)), saw(5..10, Some(7)), Some(30)),
        // A stroke that one of them saw whole is there.
        (saw(0..5, Some(3)), saw(3..10, Some(7)), Some(70)),
        (saw(0..8, Some(3)), saw(3..10, None), None),
        (saw(0..5, None), saw(5..10, None), None),
    ] {
        for (result, found_code) in ends() {
            let mut report = work::merged(Some(of(50, first.clone())), of(100, last.clone()));
            let judged = work::judged(result.clone(), &mut report, &path, &config);
            let Some(complete) = complete else {
                assert_eq!((judged, report.progress.missing_from()), (result, None));
                continue;
            };
            let failure = judged.expect_err("a stroke is missing");
            assert_eq!(failure.code, found_code, "{failure}");
            match found_code {
                // It counts as drawn up to there.
                code::INCOMPLETE => assert_eq!(report.progress, measure.progress(0, complete, 2.0), "{failure}"),
                _ => assert_eq!(
                    (report.progress.vertices, report.progress.missing_from()),
                    (100, Some(complete as usize)),
                    "{failure}"
                ),
            }
            let names_the_stroke = failure.text.contains(&format!("stroke {}", complete / 10 + 1));
            assert!(names_the_stroke || found_code != code::INCOMPLETE, "{failure}");
        }
    }
}

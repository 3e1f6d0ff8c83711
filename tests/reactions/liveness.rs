//! Once all faults have ended, an acknowledgement leads to a drawing or to the remaining cause.

use crate::STILL_RAD_S;
use crate::robot::{Robot, path};
use crate::true_times::Steps;
use etherpen::application::{Fault, Mode, Refusal};
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest};
use etherpen::ethercat::state::AlState as Wanted;
use etherpen::messages::Command;
use host_tools::cell::{
    AlState, CellOptions, ClockOptions, Fault as CellFault, Product, SiiFault, SlaveList, parse_slaves,
};

/// Longest time from an acknowledgement to what follows from it, ms.
const ANSWER_MAX_MS: u32 = 15_000;
/// Longest time for the drawing, ms.
const DRAWING_MAX_MS: u32 = 40_000;
/// How often an operator acknowledges before calling for help.
const ACKNOWLEDGEMENTS_MAX: u32 = 3;

/// A robot with or without distributed clocks.
pub(crate) fn with(clocks: bool) -> Robot {
    let mut config = Config::default();
    config.bus.clocks = clocks;
    Robot::of(&config, CellOptions::default())
}

/// Acknowledges once and waits for what follows: the fault that remains, if one does.
pub(crate) fn acknowledge(robot: &mut Robot) -> Option<Fault> {
    for _ in 0..ANSWER_MAX_MS {
        match robot.command(Command::Acknowledge) {
            Ok(()) => break,
            // An earlier acknowledgement has just ended.
            Err(Refusal::NotInMode(_)) => break,
            Err(Refusal::Moving | Refusal::Recovering) => robot.run(10),
            Err(other) => panic!("{other:?}, {:?}", robot.status),
        }
    }
    robot.run(20);
    for _ in 0..ANSWER_MAX_MS {
        if !robot.status.as_ref().is_some_and(|status| status.recovering) {
            return robot.fault();
        }
        robot.run(1);
    }
    panic!("no answer within {ANSWER_MAX_MS} ms: {:?}", robot.status);
}

/// Gives a command as an operator would: again, as long as the robot is reported as moving.
fn insist(robot: &mut Robot, command: Command) {
    for _ in 0..100 {
        match robot.command(command) {
            Err(Refusal::Moving | Refusal::NoPosition { .. }) => robot.run(100),
            result => return assert_eq!(result, Ok(()), "{command:?}, {:?}", robot.status),
        }
    }
    panic!("{command:?} is refused for ever: {:?}", robot.status);
}

/// From rest without a fault: takes the reference and enables. Returns false if a fault occurs meanwhile.
fn home_and_enable(robot: &mut Robot) -> bool {
    if !robot.status.as_ref().is_some_and(|status| status.referenced) {
        // The joints are not at the marks: the operator measures the pose.
        let pose = robot.cell().joints;
        insist(robot, Command::HomeAt { pose, position: None });
        robot.run(100);
    }
    if robot.mode() == Mode::DrivesOff {
        insist(robot, Command::Enable);
    }
    for _ in 0..ANSWER_MAX_MS {
        match (robot.mode(), robot.fault()) {
            (Mode::Idle, None) => return true,
            (Mode::Fault, Some(_)) => return false,
            _ => robot.run(1),
        }
    }
    panic!("neither rest nor a fault: {:?}", robot.status);
}

/// Draws, and checks the ink.
fn draws(robot: &mut Robot) {
    let before = inked(robot).len();
    robot.draw(path());
    for _ in 0..DRAWING_MAX_MS {
        if robot.has_drawn() {
            break;
        }
        assert_eq!(robot.fault(), None, "{:?} {:?}", robot.status, robot.cell());
        robot.run(1);
    }
    assert!(robot.has_drawn(), "{:?}", robot.status);
    assert_ink(robot, before);
}

/// All points of ink, mm in the sheet.
fn inked(robot: &Robot) -> Vec<[f64; 2]> {
    robot.ink().iter().flat_map(|stroke| stroke.points_mm.clone()).collect()
}

/// Asserts that the ink after `from` points is the path's: each vertex has ink within 0.2 mm, in order.
fn assert_ink(robot: &Robot, from: usize) {
    let drawn = inked(robot).split_off(from);
    let mut at = 0;
    for vertex in path().iter().filter(|vertex| vertex.pen == etherpen::motion::Pen::Down) {
        let [x_mm, y_mm] = [0, 1].map(|axis| f64::from(vertex.position_um[axis]) / 1e3);
        let paper = Config::default().paper;
        let wanted = [
            x_mm - paper.centre_mm[0] + 0.5 * paper.size_mm[0],
            paper.centre_mm[1] + 0.5 * paper.size_mm[1] - y_mm,
        ];
        let near = drawn[at..]
            .iter()
            .position(|point| (point[0] - wanted[0]).hypot(point[1] - wanted[1]) < 0.2);
        at += near.unwrap_or_else(|| panic!("no ink at {wanted:?} among {} points", drawn.len()));
    }
}

/// Acknowledges as an operator would, at most `most` times, enables and draws; returns the number of acknowledgements.
pub(crate) fn come_back(robot: &mut Robot, most: u32) -> u32 {
    for tries in 0..=most {
        if robot.mode() == Mode::Stopping {
            robot.run_until("it stands", |robot| robot.mode() != Mode::Stopping);
        }
        if robot.mode() != Mode::Fault && home_and_enable(robot) {
            draws(robot);
            return tries;
        }
        if tries < most {
            println!("    {:?}, acknowledged: {:?}", robot.fault(), acknowledge(robot));
        }
    }
    panic!("{:?} after {most} acknowledgements: {:?}", robot.fault(), robot.cell());
}

#[test]
fn a_reference_clock_that_was_off_for_a_moment_is_followed_again() {
    for off_ms in [1, 5, 30, 200, 3_000] {
        for slave in [1, 3] {
            println!("slave {slave} off for {off_ms} ms");
            let mut robot = with(true).enabled().in_a_drawing();
            robot.inject(CellFault::Power(slave, off_ms));
            robot.run_until("a fault is told", |robot| robot.fault().is_some());
            robot.run(off_ms as u32 + 1_000);
            println!("    {:?}", robot.fault());
            come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
        }
    }
}

/// Differences of the slaves' clocks from the reference as their own registers show them, ns.
fn differences_ns(robot: &mut Robot) -> Vec<i32> {
    let mut differences = Vec::new();
    for slave in 0..4 {
        robot.bus_answers.clear();
        robot.ask(ServiceRequest::Slave { slave });
        robot.run_until("the slave is described", |robot| !robot.bus_answers.is_empty());
        match &robot.bus_answers[0] {
            Ok(ServiceReply::Slave(info)) => differences.extend(info.clock.map(|clock| clock.difference_ns)),
            other => panic!("{other:?}"),
        }
    }
    differences
}

/// Most that a clock gains or loses in a millisecond of true time while nothing corrects it, ns: it drifts by 30 ppm, and one
/// that is cut off keeps as much as it has learnt.
const DRIFT_MAX_NS: i64 = 60;

/// How far clocks may leave true time besides their drift, ns: in a millisecond, and altogether.
type Bounds = [i64; 2];

/// They go on as if nothing had happened.
const UNTOUCHED: Bounds = [DRIFT_MAX_NS, 0];
/// A reference falls silent: its time goes on by the master's cycles until another one is named.
const CONTINUED_BY_CYCLES: Bounds = [100, 10_000];
/// The first one is set to their time by a measurement, and distributes it again.
const SET_AGAIN: Bounds = [200, 2_000];

/// Slaves that are away for ten seconds, and the clocks of the others.
struct Absence {
    faults: &'static [CellFault],
    returns: Option<CellFault>,
    /// Slaves that keep their power and their place, from 1.
    stay: &'static [usize],
    /// What the loss may do to their clocks, and what the repair may.
    loss: Bounds,
    repair: Bounds,
}

const ABSENCES: [Absence; 3] = [
    Absence {
        faults: &[CellFault::Power(3, 10_000), CellFault::Power(4, 10_000)],
        returns: None,
        stay: &[1, 2],
        loss: UNTOUCHED,
        repair: UNTOUCHED,
    },
    Absence {
        faults: &[CellFault::Power(1, 10_000)],
        returns: None,
        stay: &[2, 3, 4],
        loss: UNTOUCHED,
        repair: SET_AGAIN,
    },
    Absence {
        faults: &[CellFault::Remove(1)],
        returns: Some(CellFault::Insert(1)),
        stay: &[2, 3, 4],
        loss: CONTINUED_BY_CYCLES,
        repair: SET_AGAIN,
    },
];

/// Asserts that the true clocks of these slaves have not jumped since the last call.
fn assert_no_jump(robot: &mut Robot, slaves: &[usize], [step_max_ns, sum_max_ns]: Bounds, when: &str) {
    let steps = robot.steps.replace(Steps::default()).expect("the clocks are seen");
    assert!(steps.seen() >= 100, "{when}");
    for slave in slaves {
        let [step_ns, sum_ns] = steps.of(*slave);
        println!(
            "    {when}, slave {slave}: {step_ns} ns in a millisecond, {sum_ns} ns in {} ms",
            steps.seen()
        );
        let drift_max_ns = DRIFT_MAX_NS * i64::from(steps.seen());
        assert!(step_ns <= step_max_ns, "{when}, slave {slave}: {step_ns} ns");
        assert!(
            sum_ns.abs() <= sum_max_ns + drift_max_ns,
            "{when}, slave {slave}: {sum_ns} ns"
        );
    }
}

#[test]
fn drives_that_were_off_or_away_for_long_get_the_time_back_with_one_acknowledgement() {
    for absence in &ABSENCES {
        println!("{:?}", absence.faults);
        let mut robot = with(true).enabled().in_a_drawing();
        robot.steps = Some(Steps::default());
        for fault in absence.faults {
            robot.inject(*fault);
        }
        robot.run(200);
        assert_no_jump(&mut robot, absence.stay, absence.loss, "lost");
        robot.run(10_000);
        if let Some(fault) = absence.returns {
            robot.inject(fault);
            robot.run(200);
        }
        assert_no_jump(&mut robot, absence.stay, UNTOUCHED, "away");
        assert_eq!(acknowledge(&mut robot), None);
        robot.run(1_000);
        assert_no_jump(&mut robot, absence.stay, absence.repair, "taken back");
        let differences = differences_ns(&mut robot);
        println!("    differences {differences:?} ns");
        assert_eq!(differences.len(), 4);
        assert!(differences.iter().all(|off_ns| off_ns.abs() < 1_000));
        assert_truly_agree(&mut robot, &[1, 2, 3, 4], "taken back");
        assert_eq!(come_back(&mut robot, 0), 0);
        assert_no_jump(&mut robot, &[1, 2, 3, 4], UNTOUCHED, "drawn");
        assert_truly_agree(&mut robot, &[1, 2, 3, 4], "drawn");
        let is_of_clocks = |fault: &Fault| matches!(fault, Fault::ClockJump { .. } | Fault::ClockLost { .. });
        println!("    told: {:?}", robot.faults);
        assert!(!robot.faults.is_empty() && !robot.faults.iter().any(is_of_clocks));
    }
}

#[test]
fn slaves_that_were_away_when_the_clocks_were_set_up_do_not_keep_them_lost() {
    let mut config = Config::default();
    config.bus.clocks = true;
    // From when the addresses are given until the clocks are asked for, and back while the drives go to OP, or later.
    let absences = (20..80)
        .step_by(5)
        .flat_map(|from| [120, 200, 1_000].map(|ms| (from, ms)));
    let absences: Vec<_> = absences.flat_map(|(from, ms)| [(1, from, ms), (3, from, ms)]).collect();
    for (slave, from_ms, away_ms) in absences {
        println!("slave {slave} away from {from_ms} ms, for {away_ms} ms");
        let options = CellOptions {
            slaves: parse_slaves("ek1100,ax2000*4").expect("a list"),
            ..CellOptions::default()
        };
        let mut robot = Robot::of(&config, options);
        robot.configure(&config);
        robot.run(from_ms);
        robot.inject(CellFault::Remove(slave));
        robot.run(away_ms);
        robot.inject(CellFault::Insert(slave));
        robot.run(12_000);
        come_back(&mut robot, 1);
        assert_truly_agree(&mut robot, &[2, 3, 4, 5], "drawn");
    }
}

#[test]
fn clocks_that_return_keep_their_time_if_the_one_that_distributed_its_time_goes() {
    // In the same look at the slaves, in the next ones, and long after it, before anybody has acknowledged.
    let in_one_look = (40..120).step_by(8).map(|away_ms| (away_ms, 0));
    for (away_ms, gap_ms) in in_one_look.chain([(60, 1), (60, 5), (60, 30), (60, 300), (60, 5_000), (2_000, 300)]) {
        println!("away for {away_ms} ms, the first off {gap_ms} ms later");
        let mut robot = with(true).enabled().in_a_drawing();
        robot.inject(CellFault::Cut(1));
        robot.run(away_ms);
        robot.inject(CellFault::Join);
        robot.run(gap_ms);
        robot.inject(CellFault::Power(1, 2));
        robot.run(2_500);
        robot.steps = Some(Steps::default());
        assert_eq!(acknowledge(&mut robot), None);
        robot.run(1_000);
        assert_no_jump(&mut robot, &[2, 3, 4], [1_000, 10_000], "taken back");
        assert_truly_agree(&mut robot, &[1, 2, 3, 4], "taken back");
        assert_eq!(come_back(&mut robot, 0), 0);
    }
}

#[test]
fn clocks_without_their_distributor_keep_one_time_until_somebody_acknowledges() {
    // The first drive is switched off after the others have been away: all for so long, or the second or fourth for longer.
    let away = |fault, returns, ms| (fault, returns, ms);
    let all = |ms| [away(CellFault::Cut(1), CellFault::Join, ms)].to_vec();
    let one = |slave, ms, last_ms| {
        let alone = away(CellFault::Remove(slave), CellFault::Insert(slave), ms);
        [alone, away(CellFault::Cut(1), CellFault::Join, last_ms)].to_vec()
    };
    for (absences, gap_ms) in [
        (all(60), 0),
        (all(60), 300),
        (all(10_000), 300),
        (all(30_000), 900),
        (one(2, 30_000, 60), 0),
        (one(4, 30_000, 60), 100),
    ] {
        println!("{absences:?}, the first off {gap_ms} ms later");
        let mut robot = with_clocks_far_from_each_other();
        for (fault, returns, ms) in absences {
            robot.inject(fault);
            robot.run(ms);
            robot.inject(returns);
        }
        robot.run(gap_ms);
        robot.inject(CellFault::Power(1, 2));
        robot.run(60_000);
        assert_truly_agree(&mut robot, &[2, 3, 4], "a minute later");
        robot.steps = Some(Steps::default());
        assert_eq!(acknowledge(&mut robot), None);
        robot.run(1_000);
        // The crystals are as far from true time as that.
        assert_no_jump(&mut robot, &[2, 3, 4], [1_000, 100_000], "taken back");
        assert_truly_agree(&mut robot, &[1, 2, 3, 4], "taken back");
        assert_eq!(come_back(&mut robot, 0), 0);
    }
}

/// A drawing robot whose drives have crystals of up to 100 parts per million.
fn with_clocks_far_from_each_other() -> Robot {
    let mut config = Config::default();
    config.bus.clocks = true;
    let clocks = ClockOptions {
        drift_max_ppm: 100.0,
        ..ClockOptions::default()
    };
    let options = CellOptions {
        clocks,
        ..CellOptions::default()
    };
    Robot::of(&config, options).enabled().in_a_drawing()
}

/// True differences of the clocks of these slaves, from 1, from that of the first of them, ns.
fn true_differences_ns(robot: &mut Robot, slaves: &[usize]) -> Vec<i64> {
    let mut times_ns = Vec::new();
    robot.change_cell(|cell| times_ns = cell.system_times_ns());
    let time_ns = |slave: usize| times_ns[slave - 1].expect("a clock");
    let off_ns = |slave: &usize| time_ns(*slave).wrapping_sub(time_ns(slaves[0])) as i64;
    slaves.iter().map(off_ns).collect()
}

/// Asserts that the clocks of these slaves truly show the same time, to a microsecond.
fn assert_truly_agree(robot: &mut Robot, slaves: &[usize], when: &str) {
    let differences_ns = true_differences_ns(robot, slaves);
    println!("    {when}: {differences_ns:?} ns");
    assert!(differences_ns.iter().all(|off_ns| off_ns.abs() < 1_000), "{when}");
}

/// A drawing robot with clocks and 400 m of cable between any two slaves: delays count from the reference, so those from
/// another slave are wrong by microseconds.
fn drawing_over_long_cables() -> Robot {
    let mut config = Config::default();
    config.bus.clocks = true;
    let options = CellOptions {
        clocks: ClockOptions {
            cable_ns: 2_000,
            ..ClockOptions::default()
        },
        ..CellOptions::default()
    };
    Robot::of(&config, options).enabled().in_a_drawing()
}

#[test]
fn clocks_agree_in_truth_when_another_slave_becomes_the_reference_and_when_the_first_is_back() {
    for slave in [1, 2] {
        for (lost, returned) in [
            (CellFault::Remove(slave), CellFault::Insert(slave)),
            (CellFault::Power(slave, 4_000), CellFault::Join),
        ] {
            println!("{lost:?}");
            let mut robot = drawing_over_long_cables();
            robot.run(2_000);
            assert_truly_agree(&mut robot, &[1, 2, 3, 4], "before");
            robot.inject(lost);
            robot.run(3_000);
            let others: Vec<usize> = (1..=4)
                .filter(|other| *other != slave && robot.cell().slaves[other - 1].reached)
                .collect();
            assert_truly_agree(&mut robot, &others, "without it");
            robot.inject(returned);
            robot.run(2_000);
            assert_truly_agree(&mut robot, &others, "returned");
            let _ = acknowledge(&mut robot);
            robot.run(1_000);
            assert_truly_agree(&mut robot, &[1, 2, 3, 4], "taken back");
            assert_eq!(come_back(&mut robot, 0), 0);
            assert_truly_agree(&mut robot, &[1, 2, 3, 4], "drawn");
        }
    }
}

#[test]
fn clocks_agree_in_truth_when_a_slave_that_nobody_knows_is_plugged_in() {
    // In the line, or at a junction: in its first branch that frames pass, or in the last.
    for (list, stranger, drives) in [
        ("ek1100,el1008,ax2000*4", 2, [3, 4, 5, 6]),
        ("ek1122(3:el1008),ax2000*4", 2, [3, 4, 5, 6]),
        ("ek1122(2:el1008),ax2000*4", 6, [2, 3, 4, 5]),
        ("ek1122,ek1122(3:el2004,el1008),ax2000*4", 3, [5, 6, 7, 8]),
    ] {
        println!("{list}");
        let mut config = Config::default();
        config.bus.clocks = true;
        let list: SlaveList = list.parse().expect("a list");
        let options = CellOptions {
            slaves: list.slaves,
            places: list.places,
            branches: list.branches,
            clocks: ClockOptions {
                cable_ns: 2_000,
                ..ClockOptions::default()
            },
            ..CellOptions::default()
        };
        let mut robot = Robot::of(&config, options);
        robot.inject(CellFault::Remove(stranger));
        let mut robot = robot.enabled().in_a_drawing();
        robot.run(2_000);
        assert_truly_agree(&mut robot, &drives, "before");
        robot.inject(CellFault::Insert(stranger));
        robot.run(3_000);
        assert_truly_agree(&mut robot, &drives, "with the stranger");
        robot.inject(CellFault::Power(drives[1], 1_000));
        robot.run_until("the stop has ended", |robot| robot.mode() == Mode::Fault);
        robot.run(1_000);
        assert_eq!(acknowledge(&mut robot), None);
        robot.run(1_000);
        assert_truly_agree(&mut robot, &drives, "a drive taken back");
        assert_eq!(come_back(&mut robot, 0), 0);
        assert_truly_agree(&mut robot, &drives, "drawn");
    }
}

#[test]
fn a_bus_whose_number_of_slaves_is_given_waits_for_all_of_them() {
    for given in [0, 6] {
        let mut config = Config::default();
        config.bus.slaves = given;
        let options = CellOptions {
            slaves: parse_slaves("ax2000*4,el1008,el2004").expect("a list"),
            ..CellOptions::default()
        };
        let mut robot = Robot::of(&config, options);
        robot.inject(CellFault::Remove(6));
        robot.configure(&config);
        robot.run(4_000);
        let is_up = robot.mode() == Mode::DrivesOff;
        assert_eq!(is_up, given == 0, "{given} slaves: {:?}", robot.status);
        robot.inject(CellFault::Insert(6));
        robot.run(4_000);
        come_back(&mut robot, 1);
    }
}

#[test]
fn frames_that_stay_away_for_a_moment_cost_the_clocks_nothing_for_ever() {
    for stall_ms in [15, 60, 500, 5_000] {
        println!("nothing for {stall_ms} ms");
        let mut robot = with(true).enabled().in_a_drawing();
        robot.inject(CellFault::Stall(stall_ms));
        robot.run_until("a fault is told", |robot| robot.fault().is_some());
        robot.run(stall_ms as u32 + 500);
        println!("    {:?}", robot.fault());
        come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
    }
}

#[test]
fn an_information_memory_that_could_not_be_read_is_read_when_it_is_whole() {
    let faults = [
        SiiFault::Busy,
        SiiFault::Acknowledge,
        SiiFault::Blank,
        SiiFault::Damaged,
        SiiFault::Owned,
    ];
    for (fault, clocks) in faults.iter().flat_map(|fault| [(*fault, false), (*fault, true)]) {
        for for_ms in [50, 500, 4_000] {
            println!("{fault:?} for {for_ms} ms after a power dip, clocks {clocks}");
            let mut robot = with(clocks).enabled().in_a_drawing();
            robot.inject(CellFault::Power(2, 100));
            robot.inject(CellFault::Sii(2, fault));
            robot.run_until("a fault is told", |robot| robot.mode() == Mode::Fault);
            robot.run(for_ms);
            if for_ms > 500 {
                println!("    acknowledged too early: {:?}", acknowledge(&mut robot));
            }
            robot.inject(CellFault::Sii(2, SiiFault::Whole));
            robot.run(10);
            come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
        }
    }
}

#[test]
fn an_information_memory_that_takes_half_a_second_a_reading_is_read() {
    let options = CellOptions {
        sii_busy_us: 500_000,
        ..CellOptions::default()
    };
    let mut robot = Robot::of(&Config::default(), options).enabled().in_a_drawing();
    robot.inject(CellFault::Power(2, 100));
    robot.run_until("a fault is told", |robot| robot.mode() == Mode::Fault);
    robot.run(1_000);
    come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
}

#[test]
fn another_product_is_named_until_the_right_one_is_back() {
    for (product, clocks) in [
        (Product::Cia402, false),
        (Product::Ek1100, false),
        (Product::Cia402, true),
    ] {
        println!("{product:?}, clocks {clocks}");
        let mut robot = with(clocks).enabled().in_a_drawing();
        for _ in 0..2 {
            robot.inject(CellFault::Swap(2, product));
            robot.run_until("a fault is told", |robot| robot.mode() == Mode::Fault);
            robot.run(1_000);
            for _ in 0..2 {
                let left = acknowledge(&mut robot);
                assert!(
                    matches!(left, Some(Fault::OtherProduct { slave: 1, expected, found })
                        if expected == 0x07D0_6014 && found != expected),
                    "{left:?}"
                );
            }
            robot.inject(CellFault::Swap(2, Product::Ax2000));
            robot.run(1_000);
            come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
            robot.run(10);
        }
    }
}

#[test]
fn a_slave_that_someone_brought_down_is_brought_up_by_an_acknowledgement() {
    for clocks in [false, true] {
        for state in [Wanted::Init, Wanted::PreOperational, Wanted::SafeOperational] {
            println!("{state:?}, clocks {clocks}");
            let mut robot = with(clocks).enabled();
            robot.command(Command::Disable).unwrap();
            robot.wait_for(Mode::DrivesOff);
            robot.ask(ServiceRequest::SetState { slave: 2, state });
            robot.run(1_000);
            assert_ne!(robot.cell().slaves[2].al_state, AlState::Operational);
            assert_eq!(robot.mode(), Mode::DrivesOff);
            robot.command(Command::Enable).unwrap();
            robot.wait_for(Mode::Fault);
            println!("    {:?}", robot.fault());
            come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
        }
    }
}

#[test]
fn a_slave_that_falls_back_by_itself_is_a_fault_and_is_brought_up_by_an_acknowledgement() {
    for clocks in [false, true] {
        for state in [AlState::Init, AlState::PreOperational, AlState::SafeOperational] {
            for drawing in [false, true] {
                println!("{state:?}, clocks {clocks}, drawing {drawing}");
                let robot = with(clocks).enabled();
                let mut robot = if drawing { robot.in_a_drawing() } else { robot };
                robot.inject(CellFault::Fall(3, state, 0x001B));
                robot.run_until("a fault is told", |robot| robot.fault().is_some());
                println!("    {:?}", robot.fault());
                robot.run(200);
                assert!(robot.speed_rad_s() < STILL_RAD_S, "{} rad/s", robot.speed_rad_s());
                come_back(&mut robot, ACKNOWLEDGEMENTS_MAX);
            }
        }
    }
}

//! Machines with fewer drives than axes: the missing ones are where the path wants them, and hold up nothing.

use crate::feedback::apart_mm;
use crate::robot::Robot;
use crate::{assert_described_standstill, assert_recovers_and_draws};
use etherpen::application::Fault;
use etherpen::config::Config;
use host_tools::cell::Fault as CellFault;

/// How far ink may be from that of the robot with all axes, mm.
const APART_MM: f64 = 0.01;

fn without_fourth() -> Config {
    let mut config = Config::default();
    config.bus.drives = 3;
    config
}

#[test]
pub(crate) fn a_robot_without_its_fourth_axis_draws_the_same_lines() {
    let mut whole = Robot::idle_with(&Config::default()).in_a_drawing();
    whole.run_until("the path is executed", Robot::has_drawn);
    let mut robot = Robot::idle_with(&without_fourth()).in_a_drawing();
    robot.run_until("the path is executed", Robot::has_drawn);
    assert_eq!(robot.fault(), None);
    assert_eq!(robot.cell().slaves.len(), 3);
    let apart_mm = apart_mm(&robot.ink(), &whole.ink());
    println!("ink {apart_mm:.4} mm from that of the robot with four axes");
    assert!(apart_mm < APART_MM, "{apart_mm} mm");
}

#[test]
pub(crate) fn faults_of_a_robot_without_its_fourth_axis_are_told_as_with_it_and_it_comes_back() {
    for slave in [1, 3] {
        let mut robot = Robot::idle_with(&without_fourth()).in_a_drawing();
        robot.inject(CellFault::Drive(slave, 0x2310));
        let axis = slave as u8 - 1;
        assert_described_standstill(
            &mut robot,
            |fault| matches!(fault, Fault::Drive { axis: named, .. } if *named == axis),
        );
        assert_recovers_and_draws(&mut robot);
        let mut robot = Robot::idle_with(&without_fourth()).in_a_drawing();
        robot.inject(CellFault::Power(slave, 800));
        assert_described_standstill(&mut robot, |fault| {
            matches!(
                fault,
                Fault::SlaveLost { .. } | Fault::SlaveState { .. } | Fault::Drive { .. }
            )
        });
        robot.run(2_000);
        assert_recovers_and_draws(&mut robot);
    }
}

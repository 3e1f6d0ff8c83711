use super::*;
use crate::moment::{Clocks, Joint, Moment};

struct Desk {
    cell: Cell,
    bounds: Bounds,
    motion: Motion,
    disturbances: Disturbances,
    orders: Orders,
}

impl Desk {
    fn new() -> Self {
        let cell = Cell::default();
        let mut desk = Self {
            bounds: Bounds::new(&cell),
            cell,
            motion: Motion::default(),
            disturbances: Disturbances::default(),
            orders: Orders::default(),
        };
        desk.take(Input::Configured);
        desk.command(Command::Home);
        desk.command(Command::Enable);
        desk
    }

    fn take(&mut self, input: Input) {
        self.orders
            .take(&self.cell, &self.bounds, &self.motion, &self.disturbances, &input);
    }

    fn hear(&mut self, report: &Report) {
        self.orders.hear(&self.bounds, &self.motion, &self.disturbances, report);
    }

    fn command(&mut self, command: Command) {
        self.take(Input::Commanded(command));
        self.hear(&Report::Accepted(command));
    }

    fn at(&mut self, time_ms: u64) {
        let joints = [Joint::default(); 4];
        let moment = Moment {
            time_ms,
            joints: &joints,
            pen_touches: false,
            inputs: &[],
            reports: &[],
            wire: &[],
            clocks: Clocks::default(),
        };
        self.motion.step(&self.cell, &self.bounds, &moment);
        self.orders
            .step(&self.cell, &self.bounds, &self.motion, &self.disturbances);
    }

    fn may_move(&self) -> bool {
        self.orders.may_move(&self.bounds, self.motion.now_ms)
    }

    fn percent(&self) -> u8 {
        self.orders.percent_max(self.motion.now_ms)
    }
}

#[test]
fn an_override_counts_from_its_command_up_and_from_its_effect_down() {
    let mut desk = Desk::new();
    assert_eq!(desk.percent(), 100);
    desk.take(Input::Commanded(Command::Override { percent: 150 }));
    assert_eq!(desk.percent(), 150);
    desk.hear(&Report::Refused(Command::Override { percent: 150 }));
    assert_eq!(desk.percent(), 100);
    desk.command(Command::Override { percent: 50 });
    desk.at(1);
    assert_eq!(desk.percent(), 100, "the path still slows down");
    desk.at(desk.bounds.slowing_ms + 1);
    assert_eq!(desk.percent(), 50);
    desk.take(Input::Commanded(Command::Override { percent: 201 }));
    assert_eq!(desk.percent(), 50, "outside of the range");
}

#[test]
fn an_answer_that_is_lost_counts_as_yes_and_a_late_one_after_a_stop_as_nothing() {
    let mut desk = Desk::new();
    desk.take(Input::Commanded(Command::Draw { job: 1 }));
    assert!(desk.may_move());
    desk.at(1_500);
    assert!(desk.may_move());
    assert_eq!(desk.orders.order, Order::Path);
    desk.command(Command::Stop);
    desk.hear(&Report::Accepted(Command::Enable));
    desk.hear(&Report::Accepted(Command::Draw { job: 1 }));
    assert!(!desk.orders.may_have_power() && !desk.may_move());
}

/// The order at `end_ms`, of commands at their times, ms, of which those with an answer are accepted at 30 ms.
fn order_at(end_ms: u64, commands: &[(u64, Command, bool)]) -> Order {
    let mut desk = Desk::new();
    for time_ms in 1..=end_ms {
        desk.at(time_ms);
        for (at_ms, command, is_accepted) in commands {
            if time_ms == *at_ms {
                desk.take(Input::Commanded(*command));
            }
            if time_ms == 30 && *is_accepted {
                desk.hear(&Report::Accepted(*command));
            }
        }
    }
    desk.orders.order
}

#[test]
fn a_command_without_an_answer_is_none_once_a_later_one_of_another_kind_is_accepted() {
    let draw = Command::Draw { job: 1 };
    let go = Command::Move { position_mm: [0.0; 3] };
    let pen = Command::Pen { down: true };
    for single in [go, pen] {
        for drawn in [draw, Command::Resume] {
            // In the same millisecond their order counts.
            for later_ms in [10, 20] {
                let lost_first = [(10, drawn, false), (later_ms, single, true)];
                assert_eq!(order_at(2_000, &lost_first), Order::Single, "{lost_first:?}");
                let lost_first = [(10, single, false), (later_ms, drawn, true)];
                assert_eq!(order_at(2_000, &lost_first), Order::Path, "{lost_first:?}");
                let lost_last = [(10, single, true), (later_ms, drawn, false)];
                assert_eq!(order_at(2_000, &lost_last), Order::Path, "{lost_last:?}");
                let lost_last = [(10, drawn, true), (later_ms, single, false)];
                assert_eq!(order_at(2_000, &lost_last), Order::Single, "{lost_last:?}");
            }
        }
    }
    // The answer may be that to the first move: the drawing, and later the second move, may have been accepted.
    let moves = [(10, go, true), (15, draw, false), (20, go, false)];
    let orders = [100, 1_018, 1_100].map(|end_ms| order_at(end_ms, &moves));
    assert_eq!(orders, [Order::Single, Order::Path, Order::Single]);
}

#[test]
fn a_stop_that_is_heard_of_after_its_acknowledgement_is_no_other_stop() {
    for (fault, may_have_power) in [("EmergencyStop(Link)", true), ("EmergencyStop(Input)", false)] {
        let mut desk = Desk::new();
        desk.command(Command::Stop);
        desk.command(Command::Acknowledge);
        // Noise on the line has hidden it until now.
        desk.hear(&Report::Fault(Some(fault.to_owned())));
        desk.command(Command::Enable);
        assert_eq!(desk.orders.may_have_power(), may_have_power, "{fault}");
    }
}

#[test]
fn a_stop_needs_an_acknowledgement_before_enabling() {
    let mut desk = Desk::new();
    desk.command(Command::Stop);
    desk.command(Command::Enable);
    assert!(!desk.orders.may_have_power());
    desk.command(Command::Acknowledge);
    desk.command(Command::Enable);
    assert!(desk.orders.may_have_power() && desk.orders.stop.is_none());
}

#[test]
fn an_open_input_outlasts_acknowledgements() {
    let mut desk = Desk::new();
    desk.take(Input::StopInput(true));
    desk.at(3);
    assert!(desk.orders.may_have_power(), "it may be a pulse");
    for time_ms in 4..100 {
        desk.at(time_ms);
        desk.command(Command::Acknowledge);
        desk.at(time_ms);
        desk.command(Command::Enable);
        assert!(!desk.orders.may_have_power());
    }
}

#[test]
fn a_refused_jog_is_none_and_leaves_an_accepted_one() {
    let jog = Command::Jog {
        velocity_mm_s: [1.0, 0.0, 0.0],
    };
    let mut desk = Desk::new();
    desk.take(Input::Commanded(jog));
    assert!(desk.may_move());
    desk.hear(&Report::Refused(jog));
    assert!(!desk.may_move());
    desk.command(jog);
    desk.take(Input::Commanded(jog));
    desk.hear(&Report::Refused(jog));
    assert!(desk.may_move());
}

#[test]
fn a_move_before_a_jog_stays_an_order() {
    let mut desk = Desk::new();
    desk.command(Command::Pen { down: true });
    desk.command(Command::Jog {
        velocity_mm_s: [1.0, 0.0, 0.0],
    });
    desk.at(2_000);
    assert!(desk.may_move());
    desk.hear(&Report::Mode(Mode::Idle));
    assert!(!desk.may_move());
}

#[test]
fn a_search_permits_motion_with_unknown_joints_until_it_is_refused_cancelled_or_over() {
    use crate::rig::{Rig, broken};
    let powered = || {
        let mut rig = Rig::new();
        rig.input(Input::Configured);
        rig.command(Command::Enable);
        rig.power(true);
        rig.report(Report::Homed(false));
        assert_eq!(rig.run(600), Ok(()));
        rig
    };
    let searching = || {
        let mut rig = powered();
        rig.command(Command::Search);
        rig.report(Report::Homed(false));
        rig.report(Report::Mode(Mode::Homing));
        rig.accelerate_to(0.1);
        assert_eq!(rig.run(400), Ok(()));
        rig
    };
    assert_eq!(searching().run(1_000), Ok(()));
    // A drawing that was asked for before, and whose refusal was lost, is not the order that counts.
    let mut rig = powered();
    rig.input(Input::Commanded(Command::Resume));
    assert_eq!(rig.run(400), Ok(()));
    rig.command(Command::Search);
    rig.report(Report::Homed(false));
    rig.report(Report::Mode(Mode::Homing));
    rig.accelerate_to(0.1);
    assert_eq!(rig.run(1_500), Ok(()));
    // The answers to a search and to a motion behind it were lost: the mode tells which of them goes on.
    let mut rig = powered();
    rig.input(Input::Commanded(Command::Search));
    rig.input(Input::Commanded(Command::Pen { down: true }));
    rig.report(Report::Homed(false));
    rig.accelerate_to(0.1);
    assert_eq!(rig.run(400), Ok(()));
    rig.report(Report::Mode(Mode::Homing));
    assert_eq!(rig.run(2_000), Ok(()));
    let mut rig = powered();
    rig.input(Input::Commanded(Command::Search));
    rig.report(Report::Refused(Command::Search));
    rig.accelerate_to(0.1);
    assert!(broken(&rig.run(400), Rule::Permission), "refused");
    let mut rig = searching();
    rig.command(Command::Cancel);
    assert!(broken(&rig.run(3_000), Rule::Permission), "cancelled");
    let mut rig = searching();
    rig.report(Report::Homed(true));
    rig.report(Report::Mode(Mode::Idle));
    assert!(broken(&rig.run(400), Rule::Permission), "over");
}

//! Pen: the tip touches the paper only where it was ordered to.
//!
//! It may touch within the tolerance and the following error of a leg of the present drawing, or of a move or pen
//! order, where that leg lies within the pen's spring of the paper; anywhere during a jog, which the operator steers;
//! where it stands; and wherever it was put before a drive had power for the first time. In a stop it may slide on: twice the tool's speed times reaction and ramp, and 2 mm. While
//! feedback is not true the deviation that is promised for it comes on top.

use crate::scene::{Finding, Scene};
use crate::vector::{Vector, length, subtract};
use crate::violation::Rule;

/// How far a pen that stands on the paper may move while motors take over their load, mm: 0.02 rad of a joint.
const SAG_MM: f64 = 7.0;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pen {
    /// Where the pen was last allowed to touch, mm.
    rest: Option<Vector>,
    /// Where the tool was when it last moved as ordered, mm: a stop lets it slide on from there.
    ordered: Option<Vector>,
    /// Whether a drive has had power.
    was_powered: bool,
}

impl Pen {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let Some(tool) = scene.motion.tool.filter(|_| !scene.cell.always_touches) else {
            return Ok(());
        };
        let Some(more_mm) = scene.more_mm else {
            // Nobody knows where the joints are.
            (self.rest, self.ordered) = (Some(tool), Some(tool));
            return Ok(());
        };
        self.was_powered |= scene.moment.joints.iter().any(|joint| joint.has_power);
        if !self.was_powered {
            (self.rest, self.ordered) = (Some(tool), Some(tool));
            return Ok(());
        }
        if !scene.moment.pen_touches {
            self.rest = None;
            if !scene.is_stopping {
                self.ordered = Some(tool);
            }
            return Ok(());
        }
        if self.is_ordered(scene, &tool) {
            (self.rest, self.ordered) = (Some(tool), Some(tool));
            return Ok(());
        }
        if more_mm > 0.0
            && self
                .ordered
                .is_some_and(|place| length(subtract(tool, place)) <= more_mm)
        {
            self.rest = Some(tool);
            return Ok(());
        }
        let sag_mm = if scene.is_power_changing { SAG_MM } else { 0.0 };
        if self
            .rest
            .is_some_and(|rest| beside(rest, tool) <= scene.bounds.drawn_mm + sag_mm)
        {
            return Ok(());
        }
        let [x, y, z] = tool;
        let text = format!("the pen touches at {x:.2}, {y:.2}, {z:.2} mm without an order");
        Err((Rule::Pen, text))
    }

    fn is_ordered(&self, scene: &Scene<'_>, tool: &Vector) -> bool {
        let by_feedback = if scene.disturbances.feedback() {
            scene.cell.disturbed_mm
        } else {
            0.0
        };
        scene.orders.may_jog(scene.now_ms()) || scene.drawing.may_touch(scene.bounds, tool, by_feedback)
    }
}

/// Distance in plan view, mm.
fn beside(a: Vector, b: Vector) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Input, Mode, Report};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    #[test]
    fn ink_on_the_line_is_ordered_and_ink_beside_it_is_not() {
        let mut rig = Rig::drawing_on_paper();
        assert_eq!(rig.go_to([20.0, 0.0, -850.0], 100), Ok(()));
        let mut rig = Rig::drawing_on_paper();
        let found = rig.go_to([10.0, 3.0, -850.0], 100);
        // Both rules tell, whichever is first.
        assert!(
            broken(&found, Rule::Pen) || broken(&found, Rule::Following),
            "{found:?}"
        );
    }

    #[test]
    fn a_pen_that_was_not_lowered_by_order_breaks_the_rule() {
        let mut rig = Rig::idle_at([0.0, 0.0, -840.0]);
        let target = [0.0, 0.0, -848.0];
        rig.command(Command::Move { position_mm: target });
        assert_eq!(rig.go_to(target, 100), Ok(()));
        let found = rig.go_to([0.0, 0.0, -850.0], 50);
        assert!(broken(&found, Rule::Pen), "{found:?}");
    }

    #[test]
    fn a_flat_move_that_rises_from_the_paper_may_draw_as_long_as_the_tool_follows_low() {
        let mut rig = Rig::idle_at([0.0, 0.0, -847.0]);
        rig.command(Command::Pen { down: true });
        assert_eq!(rig.go_to([0.0, 0.0, -850.0], 50), Ok(()));
        let target = [100.0, 0.0, -848.0];
        rig.command(Command::Move { position_mm: target });
        assert_eq!(rig.go_to([30.0, 0.0, -849.6], 300), Ok(()), "0.2 mm below the line");
    }

    #[test]
    fn a_pen_order_and_a_jog_may_touch() {
        let mut rig = Rig::idle_at([5.0, 0.0, -847.0]);
        rig.command(Command::Pen { down: true });
        assert_eq!(rig.go_to([5.0, 0.0, -850.0], 50), Ok(()));
        let mut rig = Rig::idle_at([5.0, 0.0, -847.0]);
        for step in 1..=10 {
            rig.command(Command::Jog {
                velocity_mm_s: [0.0, 0.0, -6.0],
            });
            assert_eq!(rig.go_to([5.0, 0.0, -847.0 - 0.3 * f64::from(step)], 50), Ok(()));
        }
    }

    /// Ink beside a line along x is found, by one rule or the other.
    fn assert_beside_is_found(rig: &mut Rig, x: f64) {
        let found = rig.go_to([x, 4.0, -850.0], 40);
        assert!(
            broken(&found, Rule::Pen) || broken(&found, Rule::Following),
            "{found:?}"
        );
    }

    #[test]
    fn a_drawing_whose_refusal_was_lost_excuses_no_touch_later() {
        let mut rig = Rig::idle_at([0.0, 0.0, -840.0]);
        rig.input(Input::Commanded(Command::Draw { job: 9 }));
        assert_eq!(rig.run(300), Ok(()));
        rig.report(Report::Mode(Mode::Idle));
        assert_eq!(rig.run(10), Ok(()));
        let target = [0.0, 0.0, -848.0];
        rig.command(Command::Move { position_mm: target });
        assert_eq!(rig.go_to(target, 100), Ok(()));
        let found = rig.go_to([0.0, 0.0, -850.0], 50);
        assert!(broken(&found, Rule::Pen), "{found:?}");
    }

    #[test]
    fn a_drawing_whose_refusal_was_lost_does_not_replace_the_present_one() {
        let mut rig = Rig::drawing_on_paper();
        rig.input(Input::Commanded(Command::Draw { job: 9 }));
        assert_eq!(rig.run(1_200), Ok(()));
        assert_eq!(rig.go_to([20.0, 0.0, -850.0], 200), Ok(()));
        assert_beside_is_found(&mut rig, 20.0);
    }

    #[test]
    fn a_drawing_whose_answer_was_lost_may_be_drawn() {
        let mut rig = Rig::idle_at([0.0, 0.0, -847.0]);
        rig.input(Input::Commanded(Command::Draw { job: 9 }));
        for (index, (x, z, pen_down)) in (0..).zip([(0.0, -850.0, false), (40.0, -850.0, true), (40.0, -847.0, false)])
        {
            rig.input(Input::PathVertex {
                job: 9,
                index,
                position_mm: [x, 0.0, z],
                pen_down,
            });
        }
        rig.report(Report::Mode(Mode::Drawing));
        assert_eq!(rig.go_to([0.0, 0.0, -850.0], 60), Ok(()));
        assert_eq!(rig.run(1_200), Ok(()));
        assert_eq!(rig.go_to([30.0, 0.0, -850.0], 200), Ok(()));
        assert_beside_is_found(&mut rig, 30.0);
    }

    #[test]
    fn after_a_stop_the_pen_may_slide_and_stand_where_it_came_to_rest() {
        for is_cut in [false, true] {
            let mut rig = Rig::drawing_on_paper();
            assert_eq!(rig.go_to([20.0, 0.0, -850.0], 100), Ok(()));
            rig.command(Command::Stop);
            if is_cut {
                // The mains fail, and the brakes close.
                rig.disturb_machine(true);
                rig.power(false);
            }
            assert_eq!(rig.go_to([21.0, 1.2, -850.0], 10), Ok(()));
            rig.report(Report::Mode(Mode::Fault));
            rig.power(false);
            rig.disturb_machine(false);
            assert_eq!(rig.run(2_000), Ok(()), "cut: {is_cut}");
            rig.input(Input::Commanded(Command::Acknowledge));
            rig.report(Report::Fault(None));
            assert_eq!(rig.run(500), Ok(()));
        }
    }
}

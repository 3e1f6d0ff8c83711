//! Following: while drawing, the tool is never far from the path.
//!
//! The setpoints stay within the tolerance of the polyline of legs, and the tool within the following error of them:
//! 0.3 mm (`Cell::following_mm`), and half the acceleration times the square of a lag of 4 ms. Between parts of a
//! drawing the pen is lifted and lowered straight above the path. A disturbance widens the bound as it does for the
//! pen. A robot that stands without power follows nothing. A drawing whose answer was lost may have been refused: then
//! an earlier move may go on.

use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Following;

impl Following {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let (Some(place), Some(more_mm), Some([x, y, z])) = (scene.place, scene.more_mm, scene.motion.tool) else {
            return Ok(());
        };
        // A robot that stands without power was stopped, and the report of it may be lost.
        let stands_off = !scene.motion.moves && !scene.motion.has_power.contains(&true);
        let may_be_refused = scene
            .motion
            .tool
            .is_some_and(|tool| scene.drawing.may_be_refused_at(scene.bounds, &tool, more_mm));
        if place.is_on_path || stands_off || may_be_refused {
            return Ok(());
        }
        let bound = scene.bounds.travel_mm + more_mm;
        let text = format!(
            "the tool is at {x:.2}, {y:.2}, {z:.2} mm, {:.2} mm from the nearest leg, bound {:.2} mm, {bound:.2} mm with \
             the pen up",
            place.off_mm,
            scene.bounds.drawn_mm + more_mm,
        );
        Err((Rule::Following, text))
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Input};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    #[test]
    fn a_tool_on_its_path_or_lifted_above_it_follows() {
        let mut rig = Rig::drawing_on_paper();
        assert_eq!(rig.go_to([20.0, 0.3, -850.0], 100), Ok(()));
        assert_eq!(rig.go_to([20.0, 0.3, -847.0], 50), Ok(()));
        assert_eq!(rig.go_to([20.0, 0.0, -850.0], 50), Ok(()));
    }

    #[test]
    fn after_a_lost_answer_a_move_may_go_on_and_nothing_else() {
        for target in [[0.0, 80.0, -800.0], [0.0, 160.0, -800.0]] {
            let mut rig = Rig::idle_at([0.0, 0.0, -800.0]);
            rig.command(Command::Move {
                position_mm: [0.0, 100.0, -800.0],
            });
            assert_eq!(rig.go_to([0.0, 20.0, -800.0], 200), Ok(()));
            rig.input(Input::Commanded(Command::Draw { job: 9 }));
            for (index, x) in (0..).zip([100.0, 140.0]) {
                rig.input(Input::PathVertex {
                    job: 9,
                    index,
                    position_mm: [x, 0.0, -847.0],
                    pen_down: false,
                });
            }
            assert_eq!(rig.run(1_200), Ok(()), "the answer was lost");
            let found = rig.go_to(target, 800);
            assert_eq!(
                broken(&found, Rule::Following),
                target[1] > 100.0,
                "{target:?}: {found:?}"
            );
        }
    }

    #[test]
    fn a_tool_beside_its_path_breaks_the_rule() {
        let mut rig = Rig::drawing_on_paper();
        assert_eq!(rig.go_to([20.0, 0.0, -847.0], 100), Ok(()));
        let found = rig.go_to([20.0, 4.0, -847.0], 50);
        assert!(broken(&found, Rule::Following), "{found:?}");
        let mut rig = Rig::drawing_on_paper();
        let found = rig.go_to([10.0, 0.0, -840.0], 100);
        assert!(broken(&found, Rule::Following), "{found:?}");
    }

    #[test]
    fn a_robot_that_false_feedback_led_astray_may_stand_there_without_power() {
        let mut rig = Rig::drawing_on_paper();
        assert_eq!(rig.go_to([20.0, 0.0, -847.0], 100), Ok(()));
        rig.input(Input::Feedback {
            axis: 1,
            disturbed: true,
        });
        assert_eq!(rig.go_to([20.0, 2.0, -847.0], 50), Ok(()));
        rig.power(false);
        rig.input(Input::Feedback {
            axis: 1,
            disturbed: false,
        });
        assert_eq!(rig.run(1_000), Ok(()), "the report of its fault is lost");
        rig.power(true);
        let found = rig.run(1_000);
        assert!(found.is_err(), "with power it has to be on its path");
    }

    #[test]
    fn a_joint_that_runs_away_at_drawing_speed_is_found_at_once() {
        let mut rig = Rig::drawing_on_paper();
        rig.accelerate_to(1.0);
        let found = rig.run(12);
        assert!(
            broken(&found, Rule::Following) || broken(&found, Rule::Pen),
            "{found:?}"
        );
    }

    #[test]
    fn false_feedback_widens_the_bound_to_what_is_promised() {
        let mut rig = Rig::drawing_on_paper();
        rig.input(Input::Feedback {
            axis: 0,
            disturbed: true,
        });
        assert_eq!(rig.go_to([20.0, 15.0, -847.0], 100), Ok(()));
        let found = rig.go_to([20.0, 60.0, -847.0], 200);
        assert!(broken(&found, Rule::Following), "{found:?}");
    }
}

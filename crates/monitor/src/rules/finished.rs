//! Finished: a drawing that is reported as finished has all of its ink, and the tool has been at the end of its path.
//!
//! Each half millimetre of each leg with the pen down has a point of ink within the tolerance, the following error, and
//! half the way of the pen in a millisecond at twice the drawing speed; a configured share of these places may have
//! none. A drawing during which the feedback was not true is not judged: its ink is where the controller believed the
//! pen to be. A drive that could not obey is no excuse: the controller has to notice that.

use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Half of a second's way in a millisecond, at an override of 200 %, s.
const HALF_STEP_S: f64 = 1.0e-3;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Finished;

impl Finished {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        if !scene.drawing.is_finished_now {
            return Ok(());
        }
        let distance_mm = scene.bounds.drawn_mm + scene.cell.tool_speed_mm_s * HALF_STEP_S;
        if let Some(off_mm) = scene.drawing.short_of_end(distance_mm) {
            let text = format!(
                "the drawing is reported as finished, and the tool came no nearer to its end than {off_mm:.2} mm"
            );
            return Err((Rule::Finished, text));
        }
        match scene.drawing.missing(distance_mm, scene.cell.ink_missing_part) {
            None => Ok(()),
            Some([x, y, _]) => {
                let text = format!("the drawing is reported as finished without ink at {x:.2}, {y:.2} mm");
                Err((Rule::Finished, text))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Input, Report};
    use crate::rig::{JOB, Rig, broken};
    use crate::violation::Rule;

    #[test]
    fn a_drawing_with_all_of_its_ink_is_finished() {
        let mut rig = Rig::drawing_on_paper();
        assert_eq!(rig.go_to([40.0, 0.0, -850.0], 220), Ok(()));
        assert_eq!(rig.go_to([40.0, 0.0, -847.0], 50), Ok(()));
        rig.report(Report::Finished { job: JOB });
        assert_eq!(rig.step(), Ok(()));
    }

    #[test]
    fn a_drawing_without_a_part_of_its_ink_is_not() {
        let mut rig = Rig::drawing_on_paper();
        assert_eq!(rig.go_to([38.0, 0.0, -850.0], 220), Ok(()));
        assert_eq!(rig.go_to([38.0, 0.0, -847.0], 50), Ok(()));
        rig.report(Report::Finished { job: JOB + 1 });
        assert_eq!(rig.step(), Ok(()), "another job");
        rig.report(Report::Finished { job: JOB });
        assert!(broken(&rig.step(), Rule::Finished));
    }

    #[test]
    fn a_drawing_whose_pen_was_not_lifted_in_the_end_is_not() {
        let finished_at = |z_mm: f64| {
            let mut rig = Rig::drawing_on_paper();
            assert_eq!(rig.go_to([40.0, 0.0, -850.0], 220), Ok(()));
            assert_eq!(rig.go_to([40.0, 0.0, z_mm], 50), Ok(()));
            rig.report(Report::Finished { job: JOB });
            rig.step()
        };
        assert!(broken(&finished_at(-848.5), Rule::Finished));
        assert_eq!(finished_at(-847.0), Ok(()));
    }

    #[test]
    fn a_drive_that_could_not_obey_is_no_excuse_and_false_feedback_is_one() {
        let finished_short = |input: Input| {
            let mut rig = Rig::drawing_on_paper();
            rig.input(input);
            assert_eq!(rig.go_to([38.0, 0.0, -850.0], 220), Ok(()));
            rig.report(Report::Finished { job: JOB });
            rig.step()
        };
        assert!(broken(
            &finished_short(Input::Drive { axis: 0, deaf: true }),
            Rule::Finished
        ));
        let disturbed = Input::Feedback {
            axis: 0,
            disturbed: true,
        };
        assert_eq!(finished_short(disturbed), Ok(()));
    }

    #[test]
    fn a_refused_vertex_ends_the_path() {
        let mut rig = Rig::drawing_on_paper();
        rig.report(Report::VertexRefused { job: JOB, index: 3 });
        rig.input(Input::PathVertex {
            job: JOB,
            index: 4,
            position_mm: [90.0, 0.0, -850.0],
            pen_down: true,
        });
        assert_eq!(rig.go_to([40.0, 0.0, -850.0], 220), Ok(()));
        rig.report(Report::Finished { job: JOB });
        assert_eq!(rig.step(), Ok(()));
    }
}

//! Wire: every frame of the master is well-formed EtherCAT, and there are few of them.
//!
//! In a millisecond the master sends a telegram for the inputs and one for the outputs, and in UDP at most one frame of
//! its IP stack; a controller that ends sends one more. Working counters are zero when a frame is sent. Replies are not
//! judged: the machine may damage them.

use crate::scene::{Finding, Scene};
use crate::telegram;
use crate::violation::Rule;

/// Most frames of the master in a millisecond.
const FRAMES_MAX: usize = 3;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wire;

impl Wire {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let mut frames = 0;
        for frame in scene.moment.wire.iter().filter(|frame| frame.from_master) {
            frames += 1;
            if let Err(flaw) = telegram::check(frame.bytes, scene.cell.raw_wire) {
                return Err((Rule::Wire, format!("{flaw}, sent at {} ns", frame.time_ns)));
            }
        }
        if frames > FRAMES_MAX {
            return Err((
                Rule::Wire,
                format!("{frames} frames in a millisecond, at most {FRAMES_MAX} belong there"),
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::rig::{Rig, broken};
    use crate::telegram::tests::frame;
    use crate::violation::Rule;

    #[test]
    fn telegrams_are_judged_and_replies_are_not() {
        let mut rig = Rig::new();
        let sent = frame(&[32, 8]);
        let mut answered = sent.clone();
        answered[58] = 4;
        rig.frame(true, &sent);
        rig.frame(false, &answered);
        rig.frame(true, &sent);
        assert_eq!(rig.step(), Ok(()));
        rig.frame(true, &answered);
        assert!(broken(&rig.step(), Rule::Wire));
    }

    #[test]
    fn more_frames_than_a_cycle_needs_break_the_rule() {
        let mut rig = Rig::new();
        for _ in 0..4 {
            rig.frame(true, &frame(&[2]));
        }
        assert!(broken(&rig.step(), Rule::Wire));
    }
}

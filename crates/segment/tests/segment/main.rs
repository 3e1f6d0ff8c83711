//! The segment as a whole, driven by hand-made frames and by recorded ones; no master takes part.

mod checks;
mod devices;
mod faults;
mod files;
mod frames;
mod identity;
mod replay;
mod soem;
mod terminals;
mod wiring;

use etherpen_segment::rig::Rig;
use etherpen_segment::{DriveOptions, Flywheel, MotorState, Segment, SegmentOptions, SlaveKind};

type TestRig = Rig<Segment<Flywheel>>;

fn rig_of(options: SegmentOptions) -> TestRig {
    Rig::new(Segment::new(&options, Flywheel::default()))
}

/// Four AX2000 as the frames of the rig configure them, with motors at different angles.
fn four_drives() -> SegmentOptions {
    SegmentOptions {
        slaves: vec![SlaveKind::Ax2000; 4],
        drives: [0.1, -0.7, 30.0, -2.0]
            .map(|angle_rad| DriveOptions {
                angle_rad,
                ..DriveOptions::default()
            })
            .to_vec(),
        ..SegmentOptions::default()
    }
}

fn rig() -> TestRig {
    rig_of(four_drives())
}

fn script(text: &str) -> TestRig {
    rig_of(SegmentOptions {
        faults: text.parse().expect("a script"),
        ..four_drives()
    })
}

fn motors(rig: &TestRig) -> Vec<MotorState> {
    rig.bus.motors().collect()
}

//! Messages between the page and the console.
//!
//! The page sends requests as JSON text; the console sends sections of its state as JSON text, `{"section", "data"}`,
//! and rows of numbers and pictures as binary messages whose layout is documented at [`columns`], [`path`] and
//! [`picture`]. Invariant: a
//! malformed message is refused with the reason; no part of it is carried out.

use super::capture::Condition;
use super::history::Bucket;
use super::preparation::PageOptions;
use crate::identification::seen::Seen;
use etherpen::messages::PathVertex;
use etherpen::motion::Pen;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use std::sync::Arc;

/// Longest request, bytes.
pub const REQUEST_BYTES_MAX: usize = 4 * 1024;
/// Longest photograph or drawing, bytes.
pub const FILE_BYTES_MAX: usize = 32 * 1024 * 1024;
/// Most columns of a plot.
pub const COLUMNS_MAX: u64 = 4_000;
/// Longest span of a plot, ms.
pub const WINDOW_MAX_MS: u64 = 60_000;

/// First byte of a binary message.
const KIND_COLUMNS: u8 = 1;
const KIND_PATH: u8 = 2;
const KIND_PICTURE: u8 = 3;

/// A number in a tagged message. serde_json passes it on as digits, because the decoder of the firmware's log makes
/// serde_json keep all digits of a number.
fn real<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let number = serde_json::Number::deserialize(from)?;
    number
        .as_f64()
        .ok_or_else(|| D::Error::custom("a number that is too large"))
}

fn reals<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 3], D::Error> {
    let numbers = <[serde_json::Number; 3]>::deserialize(from)?;
    let reals = numbers.map(|number| number.as_f64().unwrap_or(f64::NAN));
    match reals.iter().all(|real| real.is_finite()) {
        true => Ok(reals),
        false => Err(D::Error::custom("a number that is too large")),
    }
}

/// An operator's command to the robot.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Action {
    /// Take the reference at the marks.
    Reference,
    /// Take the reference at the last pose in which the joints were referenced.
    ReferenceHere,
    /// Switch the drives' power on.
    Enable,
    /// Switch the drives' power off.
    Disable,
    /// Hold the drawing.
    Hold,
    /// Resume the drawing.
    Resume,
    /// End the drawing.
    Cancel,
    /// Acknowledge the fault.
    Acknowledge,
    /// Lift or lower the pen.
    Pen {
        /// Whether to lower it.
        down: bool,
    },
    /// Scale the path speed.
    Override {
        /// Percent, 10 to 200.
        percent: u8,
    },
    /// Move to a position, mm.
    Move {
        /// Target.
        #[serde(deserialize_with = "reals")]
        position_mm: [f64; 3],
    },
}

/// A fault of the virtual segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "what", rename_all = "snake_case", deny_unknown_fields)]
pub enum Injection {
    /// Unplug a slave.
    Remove {
        /// The slave, from 1.
        slave: usize,
    },
    /// Plug a slave in again.
    Insert {
        /// The slave, from 1.
        slave: usize,
    },
    /// Make the slave's drive fault.
    Fault {
        /// The slave, from 1.
        slave: usize,
    },
    /// Make the slave fall back to SAFEOP.
    Retreat {
        /// The slave, from 1.
        slave: usize,
    },
    /// Switch the slave's power off for a second.
    Power {
        /// The slave, from 1.
        slave: usize,
    },
    /// Freeze the slave's resolver for 200 ms.
    Stuck {
        /// The slave, from 1.
        slave: usize,
    },
    /// Pull the cable behind a slave; 0 is the master's.
    Cut {
        /// The slave, from 1; 0 for the master's cable.
        slave: usize,
    },
    /// Plug all cables in.
    Join,
    /// Let no frame through for 50 ms.
    Stall,
    /// Lose one reply.
    Lose,
    /// Restart the firmware.
    Restart,
}

/// What the operator does to find where the sheet lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TouchAction {
    /// The pen touches the sheet where it is.
    Add,
    /// Forget the last touch.
    Undo,
    /// Store the sheet's place in the configuration file.
    Store,
}

/// A request from the page.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// First message: the token that allows commands, and a name of the page that survives a reload.
    Hello {
        /// The token.
        #[serde(default)]
        token: String,
        /// The page's name.
        page: String,
    },
    /// Sign of life.
    Alive,
    /// Stop at once.
    Stop,
    /// Take control.
    Take {
        /// Take control even if another viewer has it.
        #[serde(default)]
        force: bool,
    },
    /// Release control.
    Release,
    /// Command the robot.
    Command {
        /// The command.
        action: Action,
    },
    /// Move while this is repeated; mm/s.
    Jog {
        /// Velocity.
        #[serde(deserialize_with = "reals")]
        velocity_mm_s: [f64; 3],
    },
    /// Move one axis alone while this is repeated, slowly.
    JogAxis {
        /// The axis, from 1.
        axis: u8,
        /// Whether it goes forwards.
        forward: bool,
        /// Number of the press, of which the page counts every one: a press ends after its way.
        press: u64,
    },
    /// The operator saw what moved.
    Saw {
        /// The axis that was told to, from 1.
        axis: u8,
        /// What moved; null forgets it.
        seen: Option<Seen>,
    },
    /// Plot these signals live.
    Watch {
        /// Number of the plot, repeated in the columns.
        id: u32,
        /// Numbers of signals in the catalogue.
        signals: Vec<usize>,
        /// Length of the time axis, ms.
        window_ms: u64,
        /// Columns of the plot.
        columns: u64,
    },
    /// Freeze the present history for [`Request::Range`].
    Freeze,
    /// Remove the frozen history.
    Thaw,
    /// A part of the frozen history.
    Range {
        /// Number of the plot.
        id: u32,
        /// Numbers of signals.
        signals: Vec<usize>,
        /// Beginning, ms.
        from_ms: u64,
        /// End, ms.
        to_ms: u64,
        /// Columns; 0 for every millisecond.
        columns: u64,
    },
    /// Arm a capture.
    Arm {
        /// Number of the signal.
        signal: usize,
        /// The trigger condition.
        condition: Condition,
        /// The level.
        #[serde(deserialize_with = "real")]
        level: f64,
        /// Time before the event, ms.
        before_ms: u64,
        /// Time after the event, ms.
        after_ms: u64,
    },
    /// Disarm the capture.
    Disarm,
    /// Inject a fault into the virtual segment.
    Inject {
        /// The fault.
        fault: Injection,
    },
    /// Prepare the present file with other options.
    Replan {
        /// The options.
        wishes: PageOptions,
    },
    /// Draw the present photograph in several ways, to choose from.
    Vary,
    /// Add the prepared drawing to the queue.
    Enqueue {
        /// Number of the preparation.
        preparation: u64,
        /// Whether the drawing pauses between its layers.
        #[serde(default)]
        pauses: bool,
    },
    /// Start a drawing of the queue.
    Start {
        /// Number of the drawing.
        job: u64,
    },
    /// Continue an unfinished drawing where its ink ends.
    Continue {
        /// Number of the drawing.
        job: u64,
    },
    /// Draw the next layer of a drawing: its pen is in place.
    PenIsIn {
        /// Number of the drawing.
        job: u64,
    },
    /// Remove a drawing from the queue.
    Discard {
        /// Number of the drawing.
        job: u64,
    },
    /// Find where the sheet lies.
    Touch {
        /// What the operator does.
        action: TouchAction,
    },
    /// Read the firmware's measurements.
    Measure {
        /// Whether to reset them.
        #[serde(default)]
        reset: bool,
    },
}

/// A text message with one section of the state.
pub fn section(name: &str, data: &impl Serialize) -> Arc<str> {
    #[derive(Serialize)]
    struct Section<'a, T> {
        section: &'a str,
        data: &'a T,
    }
    // Maps with keys that are not strings do not occur; all other values can be serialised.
    let text = serde_json::to_string(&Section { section: name, data });
    text.unwrap_or_default().into()
}

/// Columns of a plot, little-endian: kind, flags (1: discard earlier columns, 2: the last part of an answer), number of
/// signals as `u16`; number of the plot, length of a column in ms and number of columns as `u32`; the number of each
/// column as `u32`; then the smallest and the largest value as `f32` for each column and signal.
pub fn columns(id: u32, flags: u8, signals: usize, bucket_ms: u64, buckets: &[Bucket]) -> Vec<u8> {
    let mut bytes = vec![KIND_COLUMNS, flags];
    bytes.extend((signals as u16).to_le_bytes());
    for word in [id, bucket_ms as u32, buckets.len() as u32] {
        bytes.extend(word.to_le_bytes());
    }
    for bucket in buckets {
        bytes.extend((bucket.number as u32).to_le_bytes());
    }
    for value in buckets.iter().flat_map(|bucket| &bucket.spans).flatten() {
        bytes.extend(value.to_le_bytes());
    }
    bytes
}

/// Use of the path in a binary message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PathUse {
    /// The path being drawn.
    Job = 1,
    /// The path that can be queued.
    Preview = 2,
}

/// A path in plan view, little-endian: kind, use, two bytes of padding; its number and its number of vertices as `u32`;
/// for each vertex its index in the path as `u32`, bit 31 set if the leg to it is drawn, and x and y in mm as `f32`. A
/// path with more than `vertices_max` vertices is thinned out; where its strokes are so many that twice as many are left, whole
/// strokes are left out.
pub fn path(kind: PathUse, number: u64, vertices: &[PathVertex], vertices_max: usize) -> Vec<u8> {
    const DRAWN: u32 = 1 << 31;
    let every = vertices.len().div_ceil(vertices_max.max(1)).max(1);
    let last = vertices.len().saturating_sub(1);
    // A vertex at which the pen changes is kept with its stroke.
    let turns = |index: usize| {
        let pen = |index: usize| vertices.get(index).map(|vertex| vertex.pen);
        pen(index) != pen(index + 1) || index.checked_sub(1).is_some_and(|before| pen(before) != pen(index))
    };
    let kept = |(index, _): &(usize, &PathVertex)| index.is_multiple_of(every) || *index == last || turns(*index);
    let mut kept: Vec<_> = vertices.iter().enumerate().filter(kept).collect();
    while kept.len() > 2 * vertices_max.max(1) {
        let before = kept.len();
        keep_every_other_stroke(&mut kept);
        if kept.len() == before {
            break;
        }
    }
    let mut bytes = vec![KIND_PATH, kind as u8, 0, 0];
    bytes.extend((number as u32).to_le_bytes());
    bytes.extend((kept.len() as u32).to_le_bytes());
    for (index, vertex) in kept {
        let drawn = if vertex.pen == Pen::Down { DRAWN } else { 0 };
        bytes.extend((index as u32 & !DRAWN | drawn).to_le_bytes());
        let [x_um, y_um, _] = vertex.position_um;
        for um in [x_um, y_um] {
            bytes.extend((um as f32 / 1_000.0).to_le_bytes());
        }
    }
    bytes
}

/// Leaves out every other stroke with the way to it.
fn keep_every_other_stroke(kept: &mut Vec<(usize, &PathVertex)>) {
    let (mut stroke, mut before) = (0_u32, Pen::Up);
    kept.retain(|(_, vertex)| {
        stroke += u32::from(before == Pen::Down && vertex.pen == Pen::Up);
        before = vertex.pen;
        stroke.is_multiple_of(2)
    });
}

/// Use of a picture in a binary message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PictureUse {
    /// The photograph of the preparation, a JPEG.
    Photograph = 1,
    /// A variant of the photograph, a PNG.
    Variant = 2,
}

/// A picture, little-endian: kind, use, two bytes of padding; its number as `u32`; the bytes of its file.
pub fn picture(kind: PictureUse, number: u64, file: &[u8]) -> Vec<u8> {
    let mut bytes = vec![KIND_PICTURE, kind as u8, 0, 0];
    bytes.extend((number as u32).to_le_bytes());
    bytes.extend(file);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_as_they_are_written_by_the_page() {
        let read = |text: &str| serde_json::from_str::<Request>(text);
        assert_eq!(read(r#"{"type":"stop"}"#).unwrap(), Request::Stop);
        assert_eq!(read(r#"{"type":"vary"}"#).unwrap(), Request::Vary);
        assert_eq!(
            read(r#"{"type":"command","action":{"do":"override","percent":80}}"#).unwrap(),
            Request::Command {
                action: Action::Override { percent: 80 }
            }
        );
        assert_eq!(
            read(r#"{"type":"inject","fault":{"what":"remove","slave":2}}"#).unwrap(),
            Request::Inject {
                fault: Injection::Remove { slave: 2 }
            }
        );
    }

    #[test]
    fn numbers_may_be_whole_or_not() {
        for (text, velocity_mm_s) in [("[20,0,-5]", [20.0, 0.0, -5.0]), ("[0.5,-2.50,1e1]", [0.5, -2.5, 10.0])] {
            let request = format!(r#"{{"type":"jog","velocity_mm_s":{text}}}"#);
            let read = serde_json::from_str::<Request>(&request).unwrap();
            assert_eq!(read, Request::Jog { velocity_mm_s });
        }
        let request = r#"{"type":"arm","signal":1,"condition":"above","level":0.25,"before_ms":1,"after_ms":2}"#;
        let read = serde_json::from_str::<Request>(request).unwrap();
        assert!(matches!(read, Request::Arm { level, .. } if level == 0.25), "{read:?}");
        let request = r#"{"type":"command","action":{"do":"move","position_mm":[0.1,2,-850.5]}}"#;
        let read = serde_json::from_str::<Request>(request).unwrap();
        let position_mm = [0.1, 2.0, -850.5];
        assert_eq!(
            read,
            Request::Command {
                action: Action::Move { position_mm }
            }
        );
    }

    #[test]
    fn an_invalid_request_is_refused() {
        for text in [
            "",
            "null",
            "[]",
            r#"{"type":"fly"}"#,
            r#"{"type":"jog","velocity_mm_s":[1,2]}"#,
            r#"{"type":"jog","velocity_mm_s":[1,2,1e999]}"#,
            r#"{"type":"command","action":{"do":"override","percent":300}}"#,
            r#"{"type":"command","action":{"do":"pen"}}"#,
            r#"{"type":"watch","id":-1,"signals":[],"window_ms":0,"columns":0}"#,
        ] {
            assert!(serde_json::from_str::<Request>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn columns_have_the_layout_that_the_page_reads() {
        let buckets = [Bucket {
            number: 7,
            spans: vec![[1.0, 2.0], [3.0, 4.0]],
        }];
        let bytes = columns(9, 1, 2, 10, &buckets);
        assert_eq!(bytes.len(), 16 + 4 + 4 * 4);
        assert_eq!(&bytes[..4], [1, 1, 2, 0]);
        assert_eq!(&bytes[16..20], 7_u32.to_le_bytes());
        assert_eq!(&bytes[32..36], 4.0_f32.to_le_bytes());
    }

    #[test]
    fn a_long_path_is_thinned_out_but_never_loses_a_lift() {
        let vertex = |index: i32| PathVertex {
            position_um: [index * 1_000, 0, 0],
            pen: if index % 500 == 0 { Pen::Up } else { Pen::Down },
            stroke: 0,
        };
        let vertices: Vec<_> = (0..10_000).map(vertex).collect();
        let bytes = path(PathUse::Job, 3, &vertices, 100);
        let count = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
        assert_eq!(bytes.len(), 12 + 12 * count);
        assert!((100..250).contains(&count), "{count}");
        let lifts = bytes[12..].chunks(12).filter(|vertex| vertex[3] & 0x80 == 0).count();
        assert_eq!(lifts, 20);
    }

    #[test]
    fn a_path_of_many_short_strokes_has_a_bounded_length() {
        let vertices = |strokes: i32| -> Vec<_> {
            let legs = |stroke| [(stroke, Pen::Up), (stroke, Pen::Down), (stroke + 1, Pen::Down)];
            let legs = (0..strokes).flat_map(legs);
            legs.map(|(x_mm, pen)| PathVertex {
                position_um: [x_mm * 1_000, 0, 0],
                pen,
                stroke: 0,
            })
            .collect()
        };
        for strokes in [50, 70, 1_000, 90_000] {
            let bytes = path(PathUse::Preview, 3, &vertices(strokes), 100);
            let count = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
            assert_eq!(bytes.len(), 12 + 12 * count);
            assert!((90..=200).contains(&count), "{strokes} strokes: {count}");
            // What is shown as drawn is a stroke, never the way to one.
            let seen: Vec<_> = bytes[12..].chunks(12).collect();
            for pair in seen.windows(2) {
                let index = |vertex: &[u8]| u32::from_le_bytes(vertex[..4].try_into().unwrap()) & !(1 << 31);
                let is_drawn = pair[1][3] & 0x80 != 0;
                assert!(!is_drawn || index(pair[1]) - index(pair[0]) == 1, "{strokes} strokes");
            }
        }
    }
}

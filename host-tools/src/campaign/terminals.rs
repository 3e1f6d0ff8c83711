//! The terminals of an episode: a coupler, inputs and outputs behind the drives, and their names.

use super::chance::Chance;
use super::episode::What;
use etherpen::config::{IoDirection, IoName, IoPoint, IoPoints, IoRole, OnFault};

/// Place of the inputs in the chain, from 0; the coupler is before it, the outputs are behind it.
const INPUTS: u8 = 5;
/// The inputs' number in the segment's script.
pub(super) const INPUTS_NUMBER: usize = INPUTS as usize + 1;
/// The slaves' numbers in the segment's script.
pub(super) const NUMBERS: std::ops::RangeInclusive<usize> = INPUTS_NUMBER - 1..=INPUTS_NUMBER + 1;
/// The inputs in operation: emergency stop, door and hold closed, start open.
pub(super) const CLOSED: u8 = 0b0111;
/// The emergency stop's input.
pub(super) const STOP: u8 = 0b0001;
/// Longest time for which contacts change, ms.
const LASTS_MAX_MS: u32 = 2_000;

/// The named inputs and outputs.
pub(super) fn points() -> IoPoints {
    let point = |name: &str, direction, bit, role| IoPoint {
        // All names are short.
        name: IoName::try_from(name).unwrap_or_default(),
        slave: INPUTS + u8::from(direction == IoDirection::Out),
        direction,
        bit: Some(bit),
        role,
        ..IoPoint::default()
    };
    let points = [
        point("stop", IoDirection::In, 0, IoRole::EmergencyStop),
        point("door", IoDirection::In, 1, IoRole::Door),
        point("hold", IoDirection::In, 2, IoRole::Hold),
        point("start", IoDirection::In, 3, IoRole::Start),
        point("lamp", IoDirection::Out, 0, IoRole::Lamp),
        IoPoint {
            on_fault: OnFault::Hold,
            ..point("valve", IoDirection::Out, 1, IoRole::None)
        },
    ];
    points.into_iter().collect()
}

/// Something that happens to the terminals or their contacts.
pub(super) fn event(chance: &mut Chance) -> What {
    let slave = NUMBERS.start() + chance.below(3) as usize;
    let lasts_ms = chance.milliseconds(LASTS_MAX_MS);
    match chance.below(6) {
        0 => What::Fault(format!("power {slave} {lasts_ms}")),
        1 => What::Fault(format!("remove {slave}")),
        _ => What::Contacts(1 << chance.below(4), lasts_ms),
    }
}

//! The chain of a cell whose options name no slaves: the configured drives, and the terminals that `[[io]]` names.
//!
//! Each named place gets a digital terminal of eight channels, inputs or outputs, or one with two words if an output there is no
//! bit or an input longer than eight; the place before terminals gets a coupler, and
//! so do the places that no drive is left for.
//! The contacts of roles that are closed in operation are closed at the start.

use etherpen::config::{AxisMode, Config, IoDirection, IoRole};
use etherpen_segment::SlaveKind;

/// The slaves of a configuration in the order of the chain. Each drive is of the type that has the axis's mode: an AX2000, or
/// a CiA 402 drive for position mode.
#[must_use]
pub fn usual_slaves(config: &Config) -> Vec<SlaveKind> {
    let mut drives = config
        .axes
        .iter()
        .take(config.bus.drives.into())
        .map(|axis| match axis.mode {
            AxisMode::Position => SlaveKind::Cia402,
            _ => SlaveKind::Ax2000,
        });
    let mut drive = drives.next();
    let places = config
        .io
        .iter()
        .map(|point| usize::from(point.slave) + 1)
        .max()
        .unwrap_or(0);
    let has_words = |place: usize, bits_max: u8| {
        let mut points = config.io.iter().filter(|point| usize::from(point.slave) == place);
        points.any(|point| point.kind.bits() > bits_max)
    };
    let mut chain = Vec::new();
    while chain.len() < places || drive.is_some() {
        let at = |place: usize| config.io.iter().find(|point| usize::from(point.slave) == place);
        let place = chain.len();
        chain.push(match at(place).map(|point| point.direction) {
            Some(IoDirection::In) if has_words(place, 8) => SlaveKind::Ai2,
            Some(IoDirection::In) => SlaveKind::El1008,
            Some(IoDirection::Out) if has_words(place, 1) => SlaveKind::Ao2,
            Some(IoDirection::Out) => SlaveKind::El2008,
            None if at(place + 1).is_some() => SlaveKind::Ek1100,
            None => std::mem::replace(&mut drive, drives.next()).unwrap_or(SlaveKind::Ek1100),
        });
    }
    chain
}

/// The inputs of a terminal, by its place from 0, at the start.
pub(crate) fn closed_contacts(config: &Config, place: usize) -> u8 {
    let closed = config.io.iter().filter(|point| {
        let is_closed = matches!(
            point.role,
            IoRole::EmergencyStop | IoRole::Door | IoRole::Hold | IoRole::Limit
        );
        is_closed && usize::from(point.slave) == place
    });
    closed.fold(0, |bits, point| {
        // The entry of channel n is object 0x6000 + 0x10 n.
        let by_object = point.object.map(|object| object.index.wrapping_sub(0x6000) / 0x10);
        let bit = point.bit.or(by_object).filter(|bit| *bit < 8);
        bits | bit.map_or(0, |bit| 1 << bit)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::config::{IoPoint, IoType};

    #[test]
    fn named_places_get_terminals_and_closed_contacts_wherever_they_are() {
        let mut config = Config::default();
        assert_eq!(usual_slaves(&config), vec![SlaveKind::Ax2000; 4]);
        let point = |slave, direction, bit, role| IoPoint {
            slave,
            direction,
            bit: Some(bit),
            role,
            ..IoPoint::default()
        };
        config.io.extend([
            point(1, IoDirection::In, 0, IoRole::EmergencyStop),
            point(1, IoDirection::In, 3, IoRole::Start),
            point(1, IoDirection::In, 5, IoRole::Door),
            point(7, IoDirection::Out, 0, IoRole::Lamp),
        ]);
        let kinds = [
            SlaveKind::Ek1100,
            SlaveKind::El1008,
            SlaveKind::Ax2000,
            SlaveKind::Ax2000,
            SlaveKind::Ax2000,
            SlaveKind::Ax2000,
            SlaveKind::Ek1100,
            SlaveKind::El2008,
        ];
        assert_eq!(usual_slaves(&config), kinds);
        assert_eq!(
            (closed_contacts(&config, 1), closed_contacts(&config, 7)),
            (0b10_0001, 0)
        );
    }

    #[test]
    fn words_get_terminals_of_their_direction() {
        let mut config = Config::default();
        let point = |slave, direction, kind| IoPoint {
            slave,
            direction,
            bit: Some(0),
            kind,
            ..IoPoint::default()
        };
        config.io.extend([
            point(5, IoDirection::In, IoType::I16),
            point(6, IoDirection::Out, IoType::U16),
            point(7, IoDirection::In, IoType::U8),
        ]);
        let kinds = [SlaveKind::Ai2, SlaveKind::Ao2, SlaveKind::El1008];
        assert_eq!(usual_slaves(&config)[5..], kinds);
    }
}

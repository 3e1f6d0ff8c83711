//! Which drive a multi-turn encoder's offset belongs to: its serial number, read from the bus.

use super::Arguments;
use crate::bus::{connection, slaves};
use crate::error::ProgramError;
use etherpen::config::{Axis, Config, Encoder};

/// Gives the axes that are homed by a multi-turn encoder the serial numbers of their drives, as far as they have none yet.
///
/// # Errors
/// The bus cannot be read.
pub(super) fn name_drives(arguments: &Arguments, config: &mut Config) -> Result<(), ProgramError> {
    let before = unnamed(config).len();
    if before == 0 {
        return Ok(());
    }
    if !arguments.simulate {
        let port = arguments.port.find()?;
        let bus = slaves::read(&mut *connection::firmware(&port, config)?.access, None)?;
        let drives = bus.slaves.iter().filter_map(|slave| Some((slave.axis?, slave.serial)));
        name(config, drives);
        if unnamed(config).len() < before {
            eprintln!("The machine does not know the serial numbers of the file yet: say etherpen home once more.");
        }
    }
    for number in unnamed(config) {
        let why = match arguments.simulate {
            true => "the virtual one is not yours",
            false => "its drive shows none",
        };
        eprintln!("axis {number}: no serial number is stored ({why}), so another drive in its place goes unnoticed");
    }
    Ok(())
}

/// The axes, from 1, whose encoder's offset belongs to no drive.
fn unnamed(config: &Config) -> Vec<usize> {
    let axes = (1..).zip(config.axes.iter().take(config.bus.drives.into()));
    axes.filter(|(_, axis)| needs_name(axis))
        .map(|(number, _)| number)
        .collect()
}

fn needs_name(axis: &Axis) -> bool {
    axis.encoder == Encoder::MultiTurn && axis.serial == 0 && axis.home.io.is_none()
}

/// Takes the serial numbers of the drives, each with its axis, from 1.
fn name(config: &mut Config, drives: impl Iterator<Item = (u16, u32)>) {
    for (number, serial) in drives {
        let axis = usize::from(number)
            .checked_sub(1)
            .and_then(|axis| config.axes.get_mut(axis));
        if let Some(axis) = axis.filter(|axis| needs_name(axis)) {
            axis.serial = serial;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_homed_by_multi_turn_encoders_get_the_numbers_of_their_drives_and_keep_them() {
        let mut config = Config::default();
        config.bus.drives = 3;
        for axis in &mut config.axes {
            axis.encoder = Encoder::MultiTurn;
        }
        config.axes[1].encoder = Encoder::SingleTurn;
        let serials = |config: &Config| config.axes.each_ref().map(|axis| axis.serial);
        assert_eq!(unnamed(&config), [1, 3]);
        name(&mut config, [(3, 33), (1, 0), (2, 22), (0, 5), (9, 9)].into_iter());
        assert_eq!((serials(&config), unnamed(&config)), ([0, 0, 33, 0], vec![1]));
        name(&mut config, [(1, 11), (3, 44)].into_iter());
        assert_eq!((serials(&config), unnamed(&config)), ([11, 0, 33, 0], vec![]));
        config.axes[2].serial = 0;
        config.axes[2].home.io = Some(0);
        assert!(unnamed(&config).is_empty());
    }
}

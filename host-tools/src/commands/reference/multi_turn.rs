//! Which drive a multi-turn encoder's offset belongs to: its serial number, read from the bus.

use super::Arguments;
use crate::bus::connection;
use crate::commands::configuration::scan;
use crate::error::ProgramError;
use crate::settings::starting::Found;
use etherpen::config::{Axis, Config, Encoder};

/// Gives the axes with a multi-turn encoder the serial numbers of their drives, as far as they have none yet.
///
/// # Errors
/// The bus cannot be read.
pub(super) fn name_drives(arguments: &Arguments, config: &mut Config) -> Result<(), ProgramError> {
    if unnamed(config).is_empty() {
        return Ok(());
    }
    if !arguments.simulate {
        let port = arguments.port.find()?;
        let chain = scan::chain(&mut *connection::firmware(&port, config)?.access)?;
        name(config, &chain);
    }
    for number in unnamed(config) {
        let why = match arguments.simulate {
            true => "the virtual one is not yours",
            false => "the bus does not show one",
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
    axis.encoder == Encoder::MultiTurn && axis.serial == 0
}

/// Takes the serial numbers from the slaves of the bus. An axis has the drive with its alias or its switches; axes without them
/// have the drives in their order, and if some axes have them and others not, these get no number.
fn name(config: &mut Config, chain: &[Found]) {
    let drives: Vec<&Found> = chain.iter().filter(|slave| slave.is_drive).collect();
    let used = usize::from(config.bus.drives);
    let is_told = |axis: &Axis| axis.alias != 0 || axis.switch != 0 || axis.serial != 0;
    let is_in_order = drives.len() == used && !config.axes.iter().take(used).any(is_told);
    for (index, axis) in config.axes.iter_mut().enumerate().take(used) {
        if !needs_name(axis) {
            continue;
        }
        let is_its = |slave: &&&Found| {
            (axis.alias != 0 || axis.switch != 0)
                && (axis.alias == 0 || axis.alias == slave.alias)
                && (axis.switch == 0 || axis.switch == slave.switch)
        };
        let of_order = drives.get(index).filter(|_| is_in_order);
        if let Some(drive) = drives.iter().find(is_its).or(of_order) {
            axis.serial = drive.serial;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slave(is_drive: bool, serial: u32, alias: u16, switch: u16) -> Found {
        Found {
            is_drive,
            vendor: 1,
            product: 2,
            serial,
            alias,
            switch,
            name: "drive".into(),
        }
    }

    fn machine(encoders: [Encoder; 4], drives: u8) -> Config {
        let mut config = Config::default();
        config.bus.drives = drives;
        for (axis, encoder) in config.axes.iter_mut().zip(encoders) {
            axis.encoder = encoder;
        }
        config
    }

    fn serials(config: &Config) -> [u32; 4] {
        config.axes.each_ref().map(|axis| axis.serial)
    }

    const MULTI: Encoder = Encoder::MultiTurn;

    #[test]
    fn drives_in_the_order_of_the_axes_give_their_numbers_to_multi_turn_encoders_alone() {
        let mut config = machine([MULTI, Encoder::SingleTurn, MULTI, MULTI], 3);
        let chain = [
            slave(false, 9, 0, 0),
            slave(true, 11, 0, 0),
            slave(true, 22, 0, 0),
            slave(false, 8, 0, 0),
            slave(true, 33, 0, 0),
        ];
        name(&mut config, &chain);
        assert_eq!(serials(&config), [11, 0, 33, 0]);
        assert!(unnamed(&config).is_empty());
        // With a drive more nobody knows which is which.
        let mut config = machine([MULTI; 4], 2);
        name(&mut config, &chain);
        assert_eq!((serials(&config), unnamed(&config)), ([0; 4], vec![1, 2]));
    }

    #[test]
    fn an_axis_that_tells_its_drive_gets_the_number_of_that_one() {
        let mut config = machine([MULTI; 4], 3);
        (config.axes[0].alias, config.axes[1].switch) = (7, 5);
        let chain = [slave(true, 11, 0, 5), slave(true, 22, 7, 0), slave(true, 33, 0, 0)];
        name(&mut config, &chain);
        assert_eq!((serials(&config), unnamed(&config)), ([22, 11, 0, 0], vec![3]));
        // A number that is stored stays.
        config.axes[2].serial = 44;
        name(&mut config, &[]);
        assert_eq!((serials(&config), unnamed(&config)), ([22, 11, 44, 0], vec![]));
    }
}

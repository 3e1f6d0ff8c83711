use super::*;
use crate::campaign::machine::DEFAULT_MACHINE;
use crate::cell::SlaveKind;
use crate::settings::checking;
use crate::settings::machines::MACHINES;
use etherpen::config::{AxisMode, Config, Encoder, PenLiftKind};
use etherpen::control::search::Approach;
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::motion::WorkArea;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// Seeds whose configurations are looked at.
const SEEDS: u64 = 200;

fn machine(name: &str) -> Machine {
    Machine::load(name).expect("a bundled machine")
}

#[test]
fn every_episode_has_a_valid_configuration_and_drawings() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let mut values = 0;
        for seed in 0..120 {
            let episode = episode(&machine, seed, Profile::All);
            let config = episode
                .configuration()
                .unwrap_or_else(|cause| panic!("{}, seed {seed}: {cause}", machine.name));
            values += episode.config.len();
            for figure in &episode.figures {
                let path = figure.path(&config);
                assert!(path.len() >= 4, "seed {seed}");
                let repeats = path.windows(2).any(|pair| pair[0].position_um == pair[1].position_um);
                assert!(!repeats, "seed {seed}: a vertex repeats the one before it");
            }
        }
        assert!(values > 200, "{}: {values} values of the configuration", machine.name);
    }
}

#[test]
fn sheets_lie_aslant_where_the_pen_has_an_axis() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let tilts = (0..200).filter(|seed| {
            let config = episode(&machine, *seed, Profile::Quiet).configuration();
            config.expect("a valid configuration").paper.slope != [0.0; 2]
        });
        let tilts = tilts.count();
        match machine.config.pen.kind {
            PenLiftKind::Axis => assert!(tilts > 15, "{}: {tilts} of 200", machine.name),
            _ => assert_eq!(tilts, 0, "{}", machine.name),
        }
    }
}

#[test]
fn both_kinds_of_exchange_are_tried_on_every_machine() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let combined = (0..100).filter(|seed| {
            let config = episode(&machine, *seed, Profile::Quiet).configuration();
            config.expect("a valid configuration").bus.exchange == ExchangeKind::Combined
        });
        let combined = combined.count();
        assert!((10..50).contains(&combined), "{}: {combined} of 100", machine.name);
    }
}

/// The configurations of the first seeds of a machine without faults.
fn configurations(machine: &Machine) -> impl Iterator<Item = Config> {
    (0..SEEDS).map(|seed| {
        let config = episode(machine, seed, Profile::Quiet).configuration();
        config.expect("a valid configuration")
    })
}

#[test]
fn robots_of_other_dimensions_reach_their_sheet_on_every_machine() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let usual = machine.config.geometry;
        let [mut others, mut unlike] = [0; 2];
        for config in configurations(&machine).filter(|config| config.geometry != usual) {
            others += 1;
            let area = WorkArea::new(&config.motion_settings()).expect("a robot");
            assert_eq!(checking::unreached(&config, &area), None, "{}", machine.name);
            let reaches = [config.geometry, usual].map(|geometry| geometry.reach_mm());
            unlike += u32::from((reaches[0] / reaches[1] - 1.0).abs() > 0.02);
        }
        assert!(
            others >= 30,
            "{}: {others} of {SEEDS} have other dimensions",
            machine.name
        );
        assert!(unlike >= 3, "{}: {unlike} of {others} differ by much", machine.name);
    }
}

#[test]
fn searches_come_to_rest_within_their_axes() {
    let (mut searching, mut weak) = (0, 0);
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        for profile in [Profile::Quiet, Profile::Bus, Profile::All] {
            // The last one ran against its end.
            for seed in (0..SEEDS).chain([93_010_041]) {
                let config = episode(&machine, seed, profile).configuration();
                let config = config.expect("a valid configuration");
                for (axis, settings) in config.axes.iter().enumerate().take(machine.axes()) {
                    let Some(room_rad) = checking::room_behind_switch_rad(&config, axis) else {
                        continue;
                    };
                    let way_rad = Approach::of(config.geometry.kind(), &config.axes, axis).way_behind_switch_rad();
                    assert!(
                        way_rad <= room_rad,
                        "{}, {profile:?}, seed {seed}, axis {axis}: {way_rad} > {room_rad}",
                        machine.name
                    );
                    searching += 1;
                    weak += u32::from(settings.quick_stop_rad_s2 < 0.1 * machine.config.axes[axis].quick_stop_rad_s2);
                }
            }
        }
    }
    println!("{weak} of {searching} have a weak quick stop");
    assert!(
        searching >= 100 && weak >= 10,
        "{weak} of {searching} have a weak quick stop"
    );
}

#[test]
fn gears_turn_either_way_and_encoders_have_any_resolution_and_mark() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let (mut ratios, mut resolutions) = (BTreeSet::new(), BTreeSet::new());
        let [mut backwards, mut marked] = [0; 2];
        for config in configurations(&machine) {
            let used = config.axes.iter().zip(&machine.config.axes).take(machine.axes());
            for (axis, usual) in used {
                ratios.insert(((axis.gear / usual.gear).abs() * 4.0) as u32);
                resolutions.insert(axis.increments_per_revolution);
                backwards += u32::from(axis.gear < 0.0);
                marked += u32::from(axis.sync_increments > 0);
                let rpm = axis.output_max_rad_s * axis.gear.abs() * 60.0 / TAU;
                assert!(rpm < 6_010.0 || axis.gear.abs() == usual.gear.abs(), "{rpm} rpm");
            }
        }
        let name = &machine.name;
        assert!(
            ratios.len() >= 4 && resolutions.len() >= 8,
            "{name}: {ratios:?} {resolutions:?}"
        );
        assert!(backwards >= 20 && marked >= 50, "{name}: {backwards} and {marked}");
    }
}

#[test]
fn encoders_know_all_turns_or_nothing_where_the_machine_can_be_homed_so() {
    let [mut multi_turn, mut incremental, mut far] = [0; 3];
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        for config in configurations(&machine) {
            for axis in config.axes.iter().take(machine.axes()) {
                match axis.encoder {
                    Encoder::SingleTurn => continue,
                    Encoder::MultiTurn => multi_turn += 1,
                    Encoder::Incremental => incremental += 1,
                }
                far += u32::from(axis.sync_increments.unsigned_abs() > 1 << 30);
                let is_searched = axis.home.io.is_some();
                assert_eq!(is_searched, axis.encoder == Encoder::Incremental);
                assert!(is_searched || axis.mode == AxisMode::Position);
            }
        }
    }
    println!("{multi_turn} multi-turn, {far} of them near an end of 32 bits, {incremental} incremental");
    assert!(multi_turn >= 50 && far >= 20 && incremental >= 50);
}

#[test]
fn ethercat_travels_in_udp_near_and_behind_a_gateway_on_every_machine() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let networks: Vec<_> = configurations(&machine)
            .filter_map(|config| config.bus.network())
            .collect();
        let far = networks.iter().filter(|network| network.gateway.is_some()).count();
        let near = networks.len() - far;
        assert!(near >= 8 && far >= 8, "{}: {near} near, {far} far", machine.name);
    }
}

#[test]
fn some_machines_stand_folded_at_the_start_and_others_never() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let folds = (0..200).filter(|seed| {
            let config = episode(&machine, *seed, Profile::Quiet).configuration();
            let config = config.expect("a valid configuration");
            let has_other_switches = config.has_home_switches() != machine.config.has_home_switches();
            (config.axes.iter().zip(&machine.config.axes))
                .filter(|_| !has_other_switches)
                .any(|(axis, usual)| axis.sync_angle_rad != usual.sync_angle_rad)
        });
        let folds = folds.count();
        match machine.name.as_str() {
            "irb340" | "scara" => assert!((10..100).contains(&folds), "{}: {folds} of 200", machine.name),
            _ => assert_eq!(folds, 0, "{}", machine.name),
        }
    }
}

#[test]
fn axes_that_move_together_have_switches_in_every_other_episode() {
    for machine in MACHINES.map(|machine| self::machine(machine.name)) {
        let configs: Vec<_> = configurations(&machine).collect();
        let searching: Vec<_> = configs.iter().filter(|config| config.has_home_switches()).collect();
        let expected = match (
            machine.config.has_home_switches(),
            machine.config.geometry.kind().coupled_axes(),
        ) {
            (true, _) => configs.len()..configs.len() + 1,
            (false, 0) => 0..1,
            (false, _) => configs.len() / 3..configs.len() * 2 / 3,
        };
        assert!(
            expected.contains(&searching.len()),
            "{}: {}",
            machine.name,
            searching.len()
        );
        for config in searching {
            config.check().expect("values within their bounds");
            config.check_io().expect("a switch for each");
        }
    }
}

#[test]
fn stops_come_before_the_greeting_encoders_slip_without_power_and_processors_stand_still_for_a_moment() {
    let machine = machine(DEFAULT_MACHINE);
    let [mut greetings, mut slips, mut standstills] = [0; 3];
    for seed in 0..100 {
        let link = episode(&machine, seed, Profile::Link).events;
        let has_noise = link
            .iter()
            .any(|event| event.at_ms == 0 && matches!(event.what, What::Noise(..)));
        let stops = |event: &Event| event.at_ms < seldom::STOPPED_MAX_MS && event.what == What::Beside(Command::Stop);
        greetings += u32::from(has_noise && link.iter().any(stops));
        let drives = episode(&machine, seed, Profile::Drives).events;
        slips += u32::from(drives.iter().any(|event| matches!(event.what, What::Beside(_))));
        let is_short = |event: &Event| matches!(&event.what, What::Fault(words) if words.starts_with("pdi"));
        standstills += u32::from(episode(&machine, seed, Profile::Bus).events.iter().any(is_short));
    }
    assert!((5..30).contains(&greetings), "{greetings} of 100");
    assert!((8..30).contains(&slips), "{slips} of 100");
    assert!(standstills >= 20, "{standstills} of 100");
}

#[test]
fn a_profile_keeps_to_its_faults() {
    let machine = machine(DEFAULT_MACHINE);
    for seed in 0..300 {
        assert!(episode(&machine, seed, Profile::Quiet).events.is_empty());
        for event in episode(&machine, seed, Profile::Link).events {
            assert!(matches!(
                event.what,
                What::Reconnect | What::Unplug(_) | What::Noise(..) | What::Beside(Command::Stop)
            ));
        }
    }
}

#[test]
fn terminals_are_behind_the_drives_so_that_the_numbers_of_slaves_are_those_of_the_axes() {
    for seed in 0..50 {
        let episode = episode(&machine(DEFAULT_MACHINE), seed, Profile::Terminals);
        let config = episode.configuration().unwrap_or_else(|cause| panic!("{cause}"));
        let chain = crate::cell::usual_slaves(&config);
        let (drives, terminals) = chain.split_at(config.axes.len());
        assert!(drives.iter().all(|kind| kind.is_drive()), "{chain:?}");
        assert_eq!(terminals, [SlaveKind::Ek1100, SlaveKind::El2008, SlaveKind::El1008]);
    }
}

#[test]
fn every_kind_of_event_and_wish_occurs() {
    let machine = machine(DEFAULT_MACHINE);
    let mut seen = BTreeSet::new();
    for seed in 0..400 {
        let episode = episode(&machine, seed, Profile::All);
        for event in &episode.events {
            let words = match &event.what {
                What::Fault(words) | What::Frames(words, _) => words.split(' ').next().unwrap_or_default().to_owned(),
                other => format!("{other:?}")
                    .split(['(', ' '])
                    .next()
                    .unwrap_or_default()
                    .to_owned(),
            };
            seen.insert(words);
        }
        seen.extend(episode.wishes.iter().map(|wish| {
            format!("wish {wish:?}")
                .split('(')
                .next()
                .unwrap_or_default()
                .to_owned()
        }));
    }
    assert!(seen.len() >= 50, "{} kinds: {seen:?}", seen.len());
}

//! Episodes that are drawn by the program's own jobs: mishaps of the program, its computer and its log, a bad line, and stops.

use super::super::chance::Chance;
use super::super::episode::{Episode, Event, Mishap, What};
use toml::Value;

/// Gives mishaps random numbers of their own.
const MISHAP_SEED: u64 = 0x0F11_E500_0000;
/// Most mishaps of an episode.
const MISHAPS_MAX: u64 = 10;
/// Longest time for which a program does not run, or for which its log is away, ms.
const ABSENT_MAX_MS: u32 = 4_000;
/// Speeds and accelerations of an episode, as parts of the machine's: a drawing has to come to its end many times.
const PACE: [f64; 2] = [0.3, 1.5];

/// Gives an episode its pace and its events.
pub(super) fn befall(episode: &mut Episode, usual: &etherpen::config::MotionLimits, seed: u64) {
    let mut chance = Chance::new(seed ^ MISHAP_SEED);
    // In torque mode short strokes may stay above the paper, and nobody is told.
    episode.config.retain(|place, _| !place.starts_with("axes."));
    let values = [
        ("motion.speed_mm_s", usual.speed_mm_s, PACE[1]),
        ("motion.travel_speed_mm_s", usual.travel_speed_mm_s, 1.0),
        ("motion.acceleration_mm_s2", usual.acceleration_mm_s2, 1.0),
    ];
    for (place, usual, most) in values {
        let value = (usual * chance.scaled(PACE[0], most) * 1e3).round() / 1e3;
        episode.config.insert(place.to_owned(), Value::Float(value));
    }
    for _ in 0..chance.below(MISHAPS_MAX + 1) {
        let at_ms = chance.below(episode.duration_ms.into()) as u32;
        let what = what(&mut chance);
        let ends_program = matches!(
            what,
            What::Program(Mishap::Killed(_) | Mishap::KilledWriting(..) | Mishap::PowerCut(_))
        );
        episode.events.push(Event { at_ms, what });
        // Files are damaged while nobody writes them.
        if ends_program && chance.one_in(2) {
            let what = What::Program(damage(&mut chance));
            episode.events.push(Event { at_ms, what });
        }
        // What the machine holds is ended before the next program comes.
        if ends_program && chance.one_in(3) {
            let what = What::StopInput(20 + chance.milliseconds(500));
            let at_ms = (at_ms + chance.milliseconds(1_000)).min(episode.duration_ms);
            episode.events.push(Event { at_ms, what });
        }
    }
    episode.events.sort_by_key(|event| event.at_ms);
}

fn what(chance: &mut Chance) -> What {
    let absent_ms = chance.milliseconds(ABSENT_MAX_MS);
    let place = chance.below(1_000) as u32;
    match chance.below(12) {
        0..=2 => What::Program(Mishap::Killed(absent_ms)),
        3 => What::Program(Mishap::KilledWriting(place, absent_ms)),
        4 | 5 => What::Program(Mishap::PowerCut(absent_ms)),
        6 => What::Program(Mishap::Stands(absent_ms)),
        7 => What::Program(Mishap::Away(absent_ms)),
        8 => What::Program(damage(chance)),
        9 => What::Unplug(absent_ms),
        10 => What::Noise(absent_ms, chance.scaled(1.0, 300.0) as u32),
        _ => What::StopInput(absent_ms),
    }
}

/// What becomes of the newest entry.
fn damage(chance: &mut Chance) -> Mishap {
    let place = chance.below(1_000) as u32;
    match chance.below(8) {
        0..=2 => Mishap::Changed(place, 1 + chance.below(255) as u8),
        3 => Mishap::Cut(0),
        4 => Mishap::Cut(place),
        5 | 6 => Mishap::Zeroed(place),
        _ => Mishap::Removed,
    }
}

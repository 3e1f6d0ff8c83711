//! What operators and other programs order.

use super::super::chance::Chance;
use super::super::episode::Wish;
use super::super::machine::Machine;
use etherpen::messages::Command;
use etherpen::motion::Pen;
use etherpen::robots::Position;
use std::f64::consts::TAU;

/// Something that the operator wants.
pub(super) fn wish(chance: &mut Chance, machine: &Machine, figures: usize) -> Wish {
    match chance.below(16) {
        0..=6 => Wish::Draw(chance.below(figures as u64) as usize),
        7 => Wish::Move(position(chance, machine)),
        8 => Wish::Move(near_a_border(chance, machine)),
        9 => Wish::Jog(velocity(chance), chance.milliseconds(1_500)),
        10 => Wish::Jog(straight(chance), chance.milliseconds(6_000)),
        11 | 12 => Wish::AtOnce(at_once(chance, machine)),
        13 | 14 => chance.one_of(&[Wish::Pen, Wish::Disable]),
        _ => Wish::Override(chance.one_of(&[10, 50, 100, 150, 200])),
    }
}

/// A command at a moment that nobody chose. Homing is left to the operator, who knows the robot's pose.
pub(super) fn command(chance: &mut Chance, machine: &Machine) -> Command {
    match chance.below(14) {
        0 | 1 => Command::Stop,
        2 => Command::Enable,
        3 => Command::Disable,
        4 => Command::Hold,
        5 => Command::Resume,
        6 => Command::Cancel,
        7 => Command::Acknowledge,
        8 => Command::Override {
            percent: chance.below(256) as u8,
        },
        9 => Command::Pen {
            pen: chance.one_of(&[Pen::Up, Pen::Down]),
        },
        10 => Command::Jog {
            velocity_mm_s: velocity(chance),
        },
        11 => Command::Draw {
            job: chance.below(4) as u16,
        },
        _ => {
            let [x_mm, y_mm, z_mm] = position(chance, machine);
            Command::Move {
                position: Position { x_mm, y_mm, z_mm },
            }
        }
    }
}

/// A velocity of a jog, mm/s.
pub(super) fn velocity(chance: &mut Chance) -> [f32; 3] {
    let speed_mm_s = chance.scaled(0.5, 400.0);
    [0; 3].map(|_| chance.between(-speed_mm_s, speed_mm_s) as f32)
}

/// A velocity along one axis of the robot.
fn straight(chance: &mut Chance) -> [f32; 3] {
    let mut velocity_mm_s = [0.0; 3];
    velocity_mm_s[chance.below(3) as usize] = (chance.scaled(0.5, 400.0) * chance.one_of(&[-1.0, 1.0])) as f32;
    velocity_mm_s
}

/// A position above the paper; one in eight may lie far outside the work area.
fn position(chance: &mut Chance, machine: &Machine) -> [f64; 3] {
    let (paper, area) = (&machine.config.paper, &machine.config.work_area);
    let sheets = if chance.one_in(8) { 4.5 } else { 1.25 };
    let mut beside = |axis: usize| {
        let reach_mm = sheets * paper.size_mm[axis];
        paper.centre_mm[axis] + chance.between(-reach_mm, reach_mm)
    };
    let (x_mm, y_mm) = (beside(0), beside(1));
    let low_mm = paper.pen_down_z_mm + 2.0;
    let high_mm = (paper.pen_down_z_mm + 70.0).min(area.z_high_mm).max(low_mm);
    [x_mm, y_mm, chance.between(low_mm, high_mm)]
}

/// A place near a border of the work area, on either side.
fn near_a_border(chance: &mut Chance, machine: &Machine) -> [f64; 3] {
    let area = &machine.config.work_area;
    let off_mm = chance.scaled(0.01, 20.0) * chance.one_of(&[-1.0, 1.0]);
    let (direction_rad, z_mm) = (chance.between(0.0, TAU), chance.between(area.z_low_mm, area.z_high_mm));
    let at = |radius_mm: f64, z_mm| [radius_mm * direction_rad.cos(), radius_mm * direction_rad.sin(), z_mm];
    let is_box = area.x_mm.iter().chain(&area.y_mm).all(|side_mm| side_mm.is_finite());
    let side = chance.below(3);
    if is_box {
        let mut place = [
            chance.between(area.x_mm[0], area.x_mm[1]),
            chance.between(area.y_mm[0], area.y_mm[1]),
            z_mm,
        ];
        let sides = [area.x_mm, area.y_mm, [area.z_low_mm, area.z_high_mm]];
        let [low_mm, high_mm] = sides[side as usize];
        place[side as usize] = off_mm + if chance.one_in(2) { low_mm } else { high_mm };
        return place;
    }
    match side {
        0 => at(
            chance.between(area.inner_radius_mm, area.radius_mm),
            area.z_high_mm + off_mm,
        ),
        1 => at(
            chance.between(area.inner_radius_mm, area.radius_mm),
            area.z_low_mm + off_mm,
        ),
        _ if area.inner_radius_mm > 0.0 && chance.one_in(2) => at(area.inner_radius_mm + off_mm, z_mm),
        _ => at(area.radius_mm + off_mm, z_mm),
    }
}

/// Two or three commands for one millisecond.
fn at_once(chance: &mut Chance, machine: &Machine) -> Vec<Command> {
    let mut commands: Vec<Command> = (0..1 + chance.below(2)).map(|_| command(chance, machine)).collect();
    let place = chance.below(commands.len() as u64 + 1) as usize;
    let first = if chance.one_in(2) {
        Command::Home
    } else {
        command(chance, machine)
    };
    commands.insert(place, first);
    commands
}

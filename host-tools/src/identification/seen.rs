//! What a person saw while one axis was told to move alone, and what follows from it.

use serde::{Deserialize, Serialize};

/// What follows after anything was changed: marks that were stored before belong to other motors or directions.
const AGAIN: &str = "then find the pose anew (home by the switches, or measure the marks: `etherpen home --calibrate --store`), and \
                     try the axes again";

/// What a person saw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Seen {
    /// The axis moved, and as it was told.
    AsTold,
    /// The axis moved, the other way.
    Reversed,
    /// Another axis moved, from 1.
    Other(u8),
    /// Nothing that a person could name.
    Unclear,
}

/// What to do, a line for each finding; `seen` has the axes, from 1, that were tried. Two axes that each moved instead of the
/// other are one.
#[must_use]
pub fn advice(seen: &[(u8, Seen)]) -> Vec<String> {
    let instead_of = |wanted: u8| match seen.iter().find(|(axis, _)| *axis == wanted)?.1 {
        Seen::Other(other) => Some(other),
        _ => None,
    };
    let line = |&(axis, seen): &(u8, Seen)| {
        Some(match seen {
            Seen::AsTold => return None,
            Seen::Other(other) if instead_of(other) == Some(axis) && other < axis => return None,
            Seen::Other(other) if instead_of(other) == Some(axis) => format!(
                "axes {axis} and {other} are exchanged: exchange the places of their drives on the bus, or the motors' cables (power and \
                 encoder together)"
            ),
            Seen::Other(other) => format!(
                "axis {other} moved instead of axis {axis}: [[axes]] stand in the order of the drives on the bus; put the drives, or \
                 their motors' cables (power and encoder together), into that order"
            ),
            Seen::Reversed => {
                format!("axis {axis} goes the other way: change the sign of its gear in the configuration")
            }
            Seen::Unclear => format!(
                "axis {axis} is not confirmed: look at its drive, its brake and its motor's cable, then try it again"
            ),
        })
    };
    let changes = |(_, seen): &(u8, Seen)| matches!(seen, Seen::Other(_) | Seen::Reversed);
    let again = seen.iter().any(changes).then(|| AGAIN.to_owned());
    seen.iter().filter_map(line).chain(again).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exchanged_reversed_and_turned_round_axes_have_their_advice() {
        let told = |seen: &[Seen]| {
            let seen: Vec<(u8, Seen)> = (1..).zip(seen.iter().copied()).collect();
            advice(&seen).join("\n")
        };
        assert_eq!(told(&[Seen::AsTold; 3]), "");
        let exchanged = told(&[Seen::Other(3), Seen::AsTold, Seen::Other(1)]);
        assert!(exchanged.starts_with("axes 1 and 3 are exchanged"), "{exchanged}");
        assert_eq!(exchanged.lines().count(), 2);
        let round = told(&[Seen::Other(2), Seen::Other(3), Seen::Other(1)]);
        assert_eq!(round.lines().count(), 4);
        let both = told(&[Seen::AsTold, Seen::Reversed, Seen::Unclear]);
        assert!(
            both.contains("axis 2 goes the other way") && both.contains("axis 3 is not confirmed"),
            "{both}"
        );
        assert!(both.ends_with(AGAIN), "{both}");
        assert_eq!(told(&[Seen::Unclear]).lines().count(), 1);
    }
}

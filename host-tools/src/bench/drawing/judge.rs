//! The independent judges of portraits: whether a drawing shows a face, and whose.
//!
//! dlib compares faces by 128 numbers. A drawing's distance to its photograph alone says little, because a drawing is far
//! from every photograph; how much nearer it is to its own than to other people's is the figure. mediapipe finds the places of
//! eyes, nose, mouth and outline; how far they are from the photograph's is the figure.

use super::failed;
use crate::bench::BenchError;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// dlib's judge.
const JUDGE: &str = concat!(include_str!("pictures.py"), include_str!("judge.py"));
/// mediapipe's.
const MESH: &str = concat!(include_str!("pictures.py"), include_str!("mesh.py"));

/// A photograph and its drawings.
#[derive(Debug, Serialize)]
pub(super) struct Judged {
    /// Name of the photograph.
    pub(super) name: &'static str,
    /// The part that is drawn.
    pub(super) picture: PathBuf,
    /// How much each pixel belongs to the subject, if one was found.
    pub(super) subject: Option<PathBuf>,
    /// The drawings' pictures by their names.
    pub(super) drawings: BTreeMap<&'static str, PathBuf>,
}

/// Distances to the photographs of faces, by their names.
pub(super) type Distances = BTreeMap<String, f64>;

/// How far the points of a face are from the photograph's for each blur, in distances between the eyes; `None` where no face is
/// found at the photograph's.
pub(super) type Errors = Vec<Option<f64>>;

/// What the judges say of a photograph.
#[derive(Debug, Deserialize)]
pub(super) struct Verdict {
    /// Distances of an empty sheet; `None` if the judge finds no face in the photograph.
    pub(super) blank: Option<Distances>,
    /// What dlib says of the drawings, by their names.
    pub(super) drawings: BTreeMap<String, DrawingVerdict>,
    /// What mediapipe says of them; `None` if it finds no face in the photograph, or was not asked.
    #[serde(skip)]
    pub(super) meshes: Meshes,
}

/// What mediapipe says of a photograph's drawings, by their names; `None` if it finds no face in the photograph.
pub(super) type Meshes = Option<BTreeMap<String, Errors>>;

/// What dlib says of a drawing.
#[derive(Debug, Deserialize)]
pub(super) struct DrawingVerdict {
    /// Correlation of tone in the subject.
    pub(super) tone_subject: f64,
    /// Correlation of tone in the face, if the photograph has one.
    pub(super) tone_face: Option<f64>,
    /// Distances for each blur; `None` where no face is found at the photograph's.
    pub(super) distances: Vec<Option<Distances>>,
}

/// What dlib says of all drawings; `folder` takes the list of them.
///
/// # Errors
/// The judge fails.
pub(super) fn verdicts(python: &Path, folder: &Path, orders: &[Judged]) -> Result<Vec<Verdict>, BenchError> {
    let list = list(folder);
    let text = serde_json::to_string(orders).map_err(|cause| failed("judge", cause))?;
    std::fs::write(&list, text).map_err(|cause| failed("judge", cause))?;
    said("judge", python, JUDGE, &list)
}

/// Adds what mediapipe says of the drawings that [`verdicts`] has judged.
///
/// # Errors
/// The judge fails; nothing was added.
pub(super) fn add_meshes(python: &Path, folder: &Path, verdicts: &mut [Verdict]) -> Result<(), BenchError> {
    let meshes: Vec<Meshes> = said("mesh", python, MESH, &list(folder))?;
    if meshes.len() != verdicts.len() {
        let counts = format_args!("{} answers for {} photographs", meshes.len(), verdicts.len());
        return Err(failed("mesh", counts));
    }
    for (verdict, meshes) in verdicts.iter_mut().zip(meshes) {
        verdict.meshes = meshes;
    }
    Ok(())
}

fn list(folder: &Path) -> PathBuf {
    folder.join("drawings.json")
}

/// What a judge prints about the list of drawings.
fn said<T: DeserializeOwned>(judge: &str, python: &Path, script: &str, list: &Path) -> Result<T, BenchError> {
    let of_judge = |cause: &dyn std::fmt::Display| failed(judge, cause);
    let mut command = Command::new(python);
    let output = command.args(["-c", script]).arg(list).stdin(Stdio::null()).output();
    let output = output.map_err(|cause| of_judge(&cause))?;
    if !output.status.success() {
        return Err(of_judge(&String::from_utf8_lossy(&output.stderr)));
    }
    serde_json::from_slice(&output.stdout).map_err(|cause| of_judge(&cause))
}

/// How much nearer a face is to the photograph `own` than to those of other people: the mean distance to them less that
/// to it. `None` if one of the two is missing.
pub(super) fn margin<'a>(own: &str, person: impl Fn(&str) -> &'a str, distances: &Distances) -> Option<f64> {
    let to_own = distances.get(own)?;
    let others = distances.iter().filter(|(name, _)| person(name) != person(own));
    let others: Vec<f64> = others.map(|(_, distance)| *distance).collect();
    (!others.is_empty()).then(|| others.iter().sum::<f64>() / others.len() as f64 - to_own)
}

/// The mean margin over the blurs; a face that is not found has none, which counts as 0.
pub(super) fn mean_margin<'a>(
    own: &str,
    person: impl Fn(&str) -> &'a str,
    distances: &[Option<Distances>],
) -> Option<f64> {
    let margin = |distances: &Option<Distances>| match distances {
        Some(distances) => margin(own, &person, distances),
        None => Some(0.0),
    };
    let margins: Option<Vec<f64>> = distances.iter().map(margin).collect();
    margins
        .filter(|margins| !margins.is_empty())
        .map(|margins| margins.iter().sum::<f64>() / margins.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn person(name: &str) -> &'static str {
        match name {
            "ann" | "ann again" => "ann",
            "ben" => "ben",
            _ => "cleo",
        }
    }

    fn distances(list: &[(&str, f64)]) -> Distances {
        list.iter()
            .map(|&(name, distance)| (name.to_owned(), distance))
            .collect()
    }

    #[test]
    fn a_margin_is_the_distance_to_other_people_less_that_to_the_own_photograph() {
        let all = distances(&[("ann", 0.5), ("ann again", 0.1), ("ben", 0.7), ("cleo", 0.9)]);
        assert!((margin("ann", person, &all).expect("a margin") - 0.3).abs() < 1e-12);
        // Nearer to the wrong person.
        let wrong = distances(&[("ann", 0.8), ("ben", 0.6)]);
        assert!((margin("ann", person, &wrong).expect("a margin") + 0.2).abs() < 1e-12);
        assert_eq!(
            margin("ann", person, &distances(&[("ann", 0.5), ("ann again", 0.1)])),
            None
        );
        assert_eq!(margin("ann", person, &distances(&[("ben", 0.5)])), None);
    }

    #[test]
    fn a_face_that_is_not_found_is_a_miss_and_not_left_out() {
        let all = distances(&[("ann", 0.5), ("ben", 0.9)]);
        let mean = mean_margin("ann", person, &[Some(all.clone()), None]);
        assert!((mean.expect("a margin") - 0.2).abs() < 1e-12);
        assert_eq!(mean_margin("ann", person, &[None, None]), Some(0.0));
        assert_eq!(mean_margin("ann", person, &[]), None);
    }
}

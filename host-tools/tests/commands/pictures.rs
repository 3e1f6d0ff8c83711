//! Golden pictures: the photographs of `samples/` in each style.
//!
//! `ETHERPEN_RENEW_GOLDEN=1 cargo test -p host-tools --test commands pictures` redraws them in `docs/styles`.

use host_tools::drawing::{
    Crop, Input, Style, Subject, VectorizeOptions, load, render_rgb, vectorize_image, vectorize_subject,
};
use host_tools::setup::workspace;
use image::{GrayImage, imageops};

/// Scale of the pictures.
const PX_PER_MM: f64 = 2.2;
/// Largest mean difference from the golden picture, of 255.
const DIFFERENCE_MAX: f64 = 2.0;

fn drawn(photograph: &str, style: &str, seed: u64) -> GrayImage {
    let options = VectorizeOptions {
        style: Style::from_name(style).expect("a style"),
        seed,
        ..VectorizeOptions::default()
    };
    let file = workspace().join("samples").join(format!("{photograph}.png"));
    let Ok(Input::Photograph(picture)) = load(&file) else {
        panic!("{} is no photograph", file.display());
    };
    let subject = Subject::of(&picture, None);
    let size_px = [picture.width(), picture.height()];
    let drawing = match subject.window(size_px, Crop::Auto, options.room_mm(), options.pen_width_mm) {
        Some(window) => {
            let (part, subject) = subject.cut(&picture, window);
            vectorize_subject(&part, &subject, &options)
        }
        None => vectorize_image(&picture, &options),
    };
    let drawing = drawing.expect("strokes");
    let picture = render_rgb(&drawing.strokes, drawing.sheet_mm, options.pen_width_mm, PX_PER_MM);
    imageops::grayscale(&picture)
}

fn difference(a: &GrayImage, b: &GrayImage) -> f64 {
    if a.dimensions() != b.dimensions() {
        return f64::INFINITY;
    }
    let sum: u64 = a
        .as_raw()
        .iter()
        .zip(b.as_raw())
        .map(|(a, b)| u64::from(a.abs_diff(*b)))
        .sum();
    sum as f64 / a.as_raw().len() as f64
}

fn compare(style: &str) {
    for photograph in ["astronaut", "camera"] {
        let file = workspace()
            .join("docs/styles")
            .join(format!("{photograph}-{style}.png"));
        let picture = drawn(photograph, style, VectorizeOptions::default().seed);
        if std::env::var_os("ETHERPEN_RENEW_GOLDEN").is_some() {
            picture.save(&file).expect("the golden picture");
        }
        let golden = image::open(&file).expect("the golden picture").into_luma8();
        let difference = difference(&picture, &golden);
        assert!(
            difference <= DIFFERENCE_MAX,
            "{}: {difference:.2} of 255",
            file.display()
        );
    }
}

#[test]
fn sketches_are_the_golden_ones() {
    compare("sketch");
}

#[test]
fn hatchings_are_the_golden_ones() {
    compare("hatch");
}

#[test]
fn flows_are_the_golden_ones() {
    compare("flow");
}

#[test]
fn engravings_are_the_golden_ones() {
    compare("engrave");
}

#[test]
fn tours_are_the_golden_ones_and_another_seed_is_not() {
    compare("tsp");
    let [one, other] = [1, 2].map(|seed| drawn("camera", "tsp", seed));
    assert!(difference(&one, &other) > DIFFERENCE_MAX);
}

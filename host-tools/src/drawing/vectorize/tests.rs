//! Photographs as strokes: tone, lines, budgets, seeds, refusals.

use super::*;
use crate::drawing::{Crop, render_rgb, tone_correlation};
use image::Rgb;
use image::imageops::{FilterType, resize};
use std::sync::OnceLock;

struct Sample {
    name: &'static str,
    picture: RgbImage,
    drawing: Drawing,
}

/// The sample photographs, vectorised once with the default options.
fn samples() -> &'static [Sample] {
    static SAMPLES: OnceLock<Vec<Sample>> = OnceLock::new();
    SAMPLES.get_or_init(|| {
        let sample = |name: &'static str| {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../samples").join(name);
            let Ok(Input::Photograph(picture)) = load(path) else {
                panic!("{name} is no photograph")
            };
            let drawing = vectorize_image(&picture, &VectorizeOptions::default()).expect(name);
            Sample { name, picture, drawing }
        };
        ["astronaut.png", "camera.png"].map(sample).into()
    })
}

fn assert_inside(drawing: &Drawing, margin_mm: f64) {
    for [x, y] in drawing.strokes.iter().flat_map(|stroke| stroke.points.iter().copied()) {
        assert!((margin_mm..=drawing.sheet_mm[0] - margin_mm).contains(&x), "x {x}");
        assert!((margin_mm..=drawing.sheet_mm[1] - margin_mm).contains(&y), "y {y}");
    }
    assert!(drawing.strokes.iter().all(|stroke| stroke.points.len() > 1));
}

#[test]
fn a_tall_picture_is_compared_where_it_lies_on_the_sheet() {
    let Sample { picture, .. } = &samples()[0];
    let tall = image::imageops::crop_imm(picture, 60, 0, 300, 400).to_image();
    let options = VectorizeOptions {
        sheet_mm: [140.0, 100.0],
        ..VectorizeOptions::default()
    };
    let drawing = vectorize_image(&tall, &options).expect("a drawing");
    let [left, top, width, height] = options.picture_mm(300, 400).expect("room");
    assert_eq!([left, top, width, height], [35.5, 4.0, 69.0, 92.0]);
    let rendered = render_rgb(&drawing.strokes, drawing.sheet_mm, 0.5, 5.0);
    let window = [left, top, width, height].map(|mm| (mm * 5.0) as u32);
    let part = image::imageops::crop_imm(&rendered, window[0], window[1], window[2], window[3]).to_image();
    let (here, whole) = (tone_correlation(&tall, &part), tone_correlation(&tall, &rendered));
    assert!(here > 0.85 && here > whole, "{here}, {whole}");
}

#[test]
fn the_tone_of_a_drawing_follows_its_photograph() {
    for Sample { name, picture, .. } in samples() {
        let options = VectorizeOptions {
            background: Background::Keep,
            ..VectorizeOptions::default()
        };
        let drawing = vectorize_image(picture, &options).expect(name);
        let rendered = render_rgb(&drawing.strokes, drawing.sheet_mm, 0.5, 2.56);
        let tone = tone_correlation(picture, &rendered);
        assert!(tone > 0.85, "{name}: {tone}");
    }
}

#[test]
fn the_tone_of_a_head_alone_follows_its_photograph_in_every_style() {
    let Sample { picture, .. } = &samples()[0];
    let subject = Subject::of(picture, None);
    let window = subject.window([512, 512], Crop::Auto, [192.0; 2], 0.5).expect("a head");
    let (head, subject) = subject.cut(picture, window);
    for style in Style::NAMES.into_iter().filter_map(Style::from_name) {
        let options = VectorizeOptions {
            style,
            ..VectorizeOptions::default()
        };
        let drawing = vectorize_subject(&head, &subject, &options).expect("a drawing");
        let rendered = render_rgb(&drawing.strokes, drawing.sheet_mm, 0.5, 5.0);
        let place = options.picture_mm(head.width(), head.height()).expect("room");
        let [left, top, width, height] = place.map(|mm| (mm * 5.0) as u32);
        let part = image::imageops::crop_imm(&rendered, left, top, width, height).to_image();
        let tone = tone_correlation(&head, &part);
        println!("{style:?}: {tone:.3}, {:?}", estimate(&drawing));
        assert!(tone > 0.8, "{style:?}: {tone}");
    }
}

#[test]
fn a_background_of_none_leaves_white_paper_and_keep_draws_it() {
    let Sample { picture, .. } = &samples()[0];
    let corner_mm = |background: Background| {
        let options = VectorizeOptions {
            background,
            ..VectorizeOptions::default()
        };
        let drawing = vectorize_image(picture, &options).expect("a drawing");
        let points = drawing.strokes.iter().flat_map(|stroke| stroke.points.windows(2));
        let in_corner = points.filter(|pair| pair.iter().all(|[x, y]| *x < 40.0 && *y < 60.0));
        in_corner
            .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]))
            .sum::<f64>()
    };
    let [keep, fade, none] = [Background::Keep, Background::Fade, Background::None].map(corner_mm);
    assert!(
        keep > 300.0 && fade < 0.6 * keep && none < 0.05 * keep,
        "{keep} {fade} {none}"
    );
}

#[test]
fn dark_flat_backlit_and_tiny_pictures_are_drawn() {
    let Sample { picture, .. } = &samples()[0];
    let mapped = |f: &dyn Fn(f64) -> f64| {
        RgbImage::from_fn(512, 512, |x, y| {
            Rgb(picture.get_pixel(x, y).0.map(|value| f(f64::from(value)) as u8))
        })
    };
    let mut backlit = mapped(&|value| 0.3 * value);
    for (x, y, pixel) in backlit.enumerate_pixels_mut() {
        if (f64::from(x) - 225.0).hypot(f64::from(y) - 110.0) > 130.0 && y < 200 {
            *pixel = Rgb([250; 3]);
        }
    }
    let tiny = resize(picture, 32, 32, FilterType::Triangle);
    let cases = [
        ("dark", mapped(&|value| 0.12 * value)),
        ("flat", mapped(&|value| 120.0 + 0.1 * value)),
        ("backlit", backlit),
        ("tiny", tiny),
    ];
    for (name, case) in cases {
        let drawing = vectorize_image(&case, &VectorizeOptions::default()).expect(name);
        assert!(drawing.pen_down_mm() > 3_000.0, "{name}: {}", drawing.pen_down_mm());
        assert_inside(&drawing, 4.0);
    }
}

#[test]
fn a_portrait_takes_about_a_minute_and_a_half_and_stays_inside_its_margin() {
    for Sample { name, drawing, .. } in samples() {
        let estimate = estimate(drawing);
        assert!((60.0..110.0).contains(&estimate.time_s), "{name}: {estimate:?}");
        assert!((100..=900).contains(&estimate.lifts), "{name}: {estimate:?}");
        assert!(estimate.pen_up_mm < 0.2 * estimate.pen_down_mm, "{name}: {estimate:?}");
        assert_inside(drawing, 4.0);
    }
}

#[test]
fn the_points_of_one_line_stay_vertices_though_they_lie_in_line() {
    // Where it is evenly dark, points stand in rows.
    let half = RgbImage::from_fn(300, 300, |x, _| Rgb([if x < 150 { 40 } else { 230 }; 3]));
    let options = VectorizeOptions {
        style: Style::Tsp,
        ..VectorizeOptions::default()
    };
    let drawing = vectorize_image(&half, &options).expect("a drawing");
    let count = |strokes: &[Vec<[f64; 2]>]| strokes.iter().map(Vec::len).sum::<usize>();
    let all: Vec<_> = drawing.strokes.into_iter().map(|stroke| stroke.points).collect();
    let simplified: Vec<_> = all
        .iter()
        .map(|points| crate::drawing::line::simplified(points, 0.04))
        .collect();
    assert!(
        count(&all) > 100 && count(&simplified) < count(&all),
        "{}, {}",
        count(&all),
        count(&simplified)
    );
}

#[test]
fn strokes_are_long_and_few_enough_to_be_worth_their_lifts() {
    for Sample { name, drawing, .. } in samples() {
        let short = drawing.strokes.iter().filter(|stroke| stroke.length_mm() < 2.0).count();
        assert!(
            short * 20 < drawing.strokes.len(),
            "{name}: {short} of {}",
            drawing.strokes.len()
        );
        assert!(drawing.pen_down_mm() / drawing.strokes.len() as f64 > 25.0, "{name}");
    }
}

#[test]
fn the_same_photograph_and_seed_give_the_same_strokes() {
    let Sample { picture, .. } = &samples()[0];
    let small = resize(picture, 128, 128, FilterType::Triangle);
    let options = VectorizeOptions {
        sheet_mm: [60.0, 60.0],
        ..VectorizeOptions::default()
    };
    let first = vectorize_image(&small, &options);
    assert_eq!(first, vectorize_image(&small, &options));
    assert_ne!(first, vectorize_image(&small, &VectorizeOptions { seed: 2, ..options }));
}

#[test]
fn budgets_are_kept() {
    let Sample { picture, .. } = &samples()[1];
    for (strokes_max, time_max_s) in [(900, 15.0), (40, 110.0), (5, 3.0)] {
        let options = VectorizeOptions {
            sheet_mm: [100.0, 100.0],
            strokes_max,
            time_max_s,
            ..VectorizeOptions::default()
        };
        let drawing = vectorize_image(picture, &options).expect("a drawing within any budget");
        let estimate = estimate(&drawing);
        assert!(
            estimate.lifts <= strokes_max && estimate.time_s <= time_max_s,
            "{estimate:?}"
        );
    }
}

#[test]
fn every_shape_of_picture_and_sheet_stays_inside() {
    let noise = |x: u32, y: u32| Rgb([(x.wrapping_mul(73) ^ y.wrapping_mul(151) ^ (x * y)) as u8; 3]);
    for (width, height) in [(16, 16), (16, 700), (700, 16), (150, 100)] {
        for sheet_mm in [[40.0, 40.0], [80.0, 30.0]] {
            let picture = RgbImage::from_fn(width, height, noise);
            let options = VectorizeOptions {
                sheet_mm,
                margin_mm: 2.0,
                ..VectorizeOptions::default()
            };
            match vectorize_image(&picture, &options) {
                Ok(drawing) => assert_inside(&drawing, 2.0),
                Err(error) => assert_eq!(error, DrawingError::Blank, "{width} x {height}"),
            }
        }
    }
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    let options = VectorizeOptions::default();
    let grey = RgbImage::from_pixel(100, 100, Rgb([90; 3]));
    assert_eq!(vectorize_image(&grey, &options).err(), Some(DrawingError::Blank));
    let dot = RgbImage::new(1, 1);
    assert!(matches!(
        vectorize_image(&dot, &options),
        Err(DrawingError::TooSmall { .. })
    ));
    let picture = RgbImage::from_fn(100, 100, |x, _| Rgb([x as u8; 3]));
    for bad in [
        VectorizeOptions {
            margin_mm: 100.0,
            ..options
        },
        VectorizeOptions {
            margin_mm: f64::NAN,
            ..options
        },
        VectorizeOptions {
            pen_width_mm: 0.0,
            ..options
        },
        VectorizeOptions {
            time_max_s: -1.0,
            ..options
        },
        VectorizeOptions {
            sheet_mm: [f64::INFINITY, 200.0],
            ..options
        },
    ] {
        assert_eq!(
            vectorize_image(&picture, &bad).err(),
            Some(DrawingError::BadOptions),
            "{bad:?}"
        );
    }
}

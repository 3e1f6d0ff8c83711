//! Analysis of a photograph before it is drawn: light, faces, background, directions, required ink.

use super::silhouette::{edge, kept, of_size, outline, pale_edge, squared};
use super::{DrawingError, Frame, VectorizeOptions};
use crate::drawing::edges::Flow;
use crate::drawing::face::Face;
use crate::drawing::focus::focus;
use crate::drawing::light::{TO_CHIN, TO_NECK, darkness_in_faces, exposed, ovals, with_even_skin};
use crate::drawing::raster::Plane;
use crate::drawing::render::{grey, reduced};
use crate::drawing::subject::Subject;
use image::RgbImage;
use image::imageops::{FilterType, resize, thumbnail};

/// Direction of hatching where the picture has none, and inside faces, radians.
const HATCH_ANGLE_RAD: f32 = -0.8;
/// Weight of the one direction inside a face: far more than the gradients there.
const FACE_ANGLE_WEIGHT: f32 = 0.2;
/// Lightness of hair and of sure skin, of the median in the face's oval.
const SKIN_FROM: f32 = 0.45;
const SKIN_SURE: f32 = 0.66;
/// Upper end of a high forehead above the centre of its face, in radii of the face.
const FOREHEAD_ABOVE: f64 = 1.75;
/// Differences of colour and of lightness from those of the sure skin at which a forehead beyond the oval is no skin, of 1.
const SKIN_COLOUR: f32 = 0.04;
const SKIN_LIGHTNESS: f32 = 0.25;
/// How much rougher than the median of the sure skin a forehead may be; from half of that on it counts less. Roughness is at least a
/// picture's noise.
const ROUGH_MAX: f32 = 3.0;
const ROUGHNESS_MIN: f32 = 0.003;
/// Least colour of skin in a photograph with colours, of 1.
const COLOUR_MIN: f32 = 0.02;
/// Exponent from darkness to points in a face.
const GRAIN_POWER: f32 = 1.3;
/// Ink of the darkest shade of skin.
const SHADE_MAX: f32 = 0.62;
/// Ink of a feature begins at this darkness, and is full after that much more.
const FEATURE_FROM: f32 = 0.46;
const FEATURE_OVER: f32 = 0.36;

/// A photograph as planes of the size in which it is processed.
pub(super) struct Study {
    pub(super) frame: Frame,
    /// Pen's width, pixels.
    pub(super) pen: f64,
    /// Faces, pixels.
    pub(super) faces: Vec<Face>,
    /// How much a pixel belongs to the most important part, which is drawn finest.
    pub(super) focus: Plane,
    /// How much a pixel belongs to the oval of a face.
    pub(super) ovals: Plane,
    /// How much a pixel belongs to the skin of a face.
    pub(super) skin: Plane,
    /// How much a pixel belongs to eyes, brows, nose or mouth.
    pub(super) features: Plane,
    /// How much a pixel belongs to the outline of a portrait: the edge of its subject, and of a face's oval.
    pub(super) outline: Plane,
    /// How much a pixel belongs to the edge of a subject as light as the paper.
    pub(super) pale_edge: Plane,
    /// Share of what is drawn that the background leaves, 0 to 1.
    pub(super) kept: Plane,
    /// Lightness without noise, 0 to 1.
    pub(super) calm: Plane,
    /// Required ink at full strength, 0 to 1.
    pub(super) ink: Plane,
    /// Required ink for points instead of lines, 0 to 1: with all shades and details of a face.
    pub(super) grain: Plane,
    /// Directions of strokes.
    pub(super) hatch_flow: Flow,
}

impl Study {
    pub(super) fn of(
        picture: &RgbImage,
        subject: &Subject,
        frame: Frame,
        options: &VectorizeOptions,
    ) -> Result<Self, DrawingError> {
        // Means first: a filter over every pixel of a large photograph takes seconds.
        let side_max = 2 * frame.work_px[0].max(frame.work_px[1]);
        let small = resize(
            &*reduced(picture, side_max),
            frame.work_px[0],
            frame.work_px[1],
            FilterType::CatmullRom,
        );
        let scale = f64::from(small.width()) / f64::from(picture.width().max(1));
        let faces: Vec<Face> = subject.faces.iter().map(|face| face.moved([0.0, 0.0], scale)).collect();
        let (width, height) = (small.width() as usize, small.height() as usize);
        let oval_to = |below: f64| ovals(width, height, &faces, below);
        let (ovals, with_neck) = (oval_to(TO_CHIN), oval_to(TO_NECK));
        let light = exposed(&grey(&small), &ovals).ok_or(DrawingError::Blank)?;
        let pen = options.pen_width_mm / frame.mm_per_px;
        let sigma = |pens: f64| (pens * pen) as f32;
        let calm = denoised(&light, sigma(1.0) as usize + 1);
        let focus = if faces.is_empty() {
            let detail = light.zip(&light.blurred(sigma(2.0)), |value, around| (value - around).abs());
            focus(&small, &detail)
        } else {
            nearness(width, height, &faces)
        };
        // A face is never part of the background.
        let kept = kept(subject, &faces, &calm, options.background).zip(&ovals, f32::max);
        let edge = edge(subject, &faces, [width, height], pen);
        let outline = outline(&ovals, &edge);
        let features = features(width, height, &faces);
        let radius = faces.first().map_or(0.0, |face| face.radius);
        let forehead = forehead(&small, subject, &faces, &ovals);
        let skin = skin(&calm, &ovals, &with_neck.zip(&forehead, f32::max), radius);
        let bare = skin.zip(&features, |skin, feature| skin * (1.0 - feature));
        let on_face = on_face(&light, &calm, &ovals, &features, radius);
        let ink = ink(&light, &calm, [&focus, &skin, &on_face], pen).zip(&kept, |ink, kept| ink * kept);
        let pale_edge = pale_edge(subject, &edge, &ink, pen);
        let dark = darkness_in_faces(&calm, &ovals).map(|dark| ((dark - 0.04) / 0.96).max(0.0).powf(GRAIN_POWER));
        let grain = ink.mixed(&dark, &skin);
        let hatch_flow = Flow::of(&calm.blurred(sigma(1.0)), sigma(7.0), HATCH_ANGLE_RAD, 0.006).mixed(
            &Flow::of(&calm.blurred(sigma(0.6)), sigma(3.0), HATCH_ANGLE_RAD, 0.006),
            &focus,
        );
        let hatch_flow = hatch_flow.turned_to(HATCH_ANGLE_RAD, FACE_ANGLE_WEIGHT, &bare);
        Ok(Self {
            frame,
            pen,
            faces,
            focus,
            ovals,
            skin,
            features,
            outline,
            pale_edge,
            kept,
            calm,
            ink,
            grain,
            hatch_flow,
        })
    }
}

/// The ink that each pixel requires, 0 to 1, from the light and the planes of focus, skin and ink on skin.
fn ink(light: &Plane, calm: &Plane, [focus, skin, on_face]: [&Plane; 3], pen: f64) -> Plane {
    let sigma = |pens: f64| (pens * pen) as f32;
    let tone = denoised(light, sigma(3.0) as usize + 1).mixed(calm, focus);
    let (near, far) = (calm.blurred(sigma(6.0)), calm.blurred(sigma(30.0)));
    Plane::from_fn(calm.width(), calm.height(), |x, y| {
        let (x, y) = (x as isize, y as isize);
        let (value, face) = (tone.at(x, y), focus.at(x, y));
        let lifted = value + 0.25 * (value - far.at(x, y)) + 1.2 * face * (value - near.at(x, y));
        let dark = (1.0 - lifted).clamp(0.0, 1.0);
        let elsewhere = ((dark - 0.1) / 0.9).max(0.0).powf(1.35);
        elsewhere + skin.at(x, y) * (on_face.at(x, y) - elsewhere)
    })
}

/// How much each pixel belongs to the skin of a face or to a feature in it, not to hair: 0 to 1. `around` is where skin may be.
fn skin(calm: &Plane, ovals: &Plane, around: &Plane, radius: f64) -> Plane {
    let Some(median) = median_inside(calm, ovals) else {
        return Plane::filled(calm.width(), calm.height(), 0.0);
    };
    // Wider than an eye, narrower than hair.
    let wide = calm.blurred((0.16 * radius) as f32);
    around.zip(&wide, |oval, value| {
        let share = (value / median.max(0.05) - SKIN_FROM) / (SKIN_SURE - SKIN_FROM);
        oval * share.clamp(0.0, 1.0)
    })
}

/// How much each pixel belongs to a high forehead, which goes on beyond the oval of its face in the colour of the skin, 0 to 1.
fn forehead(picture: &RgbImage, subject: &Subject, faces: &[Face], ovals: &Plane) -> Plane {
    if !faces.iter().any(|face| face.has_features) {
        return ovals.map(|_| 0.0);
    }
    // Skin and hair are much wider than a pixel.
    let half = thumbnail(picture, picture.width().div_ceil(2), picture.height().div_ceil(2));
    let size = [half.width() as usize, half.height() as usize];
    let scale = f64::from(half.width()) / f64::from(picture.width());
    let faces: Vec<Face> = faces.iter().map(|face| face.moved([0.0, 0.0], scale)).collect();
    let inside = of_size(ovals, size);
    let radius = faces.iter().map(|face| face.radius).fold(0.0, f64::max);
    let even = |plane: &Plane| plane.blurred((0.05 * radius) as f32);
    let colour = |weights: [f32; 3]| {
        Plane::from_fn(size[0], size[1], |x, y| {
            let parts = half.get_pixel(x as u32, y as u32).0.map(f32::from);
            (weights[0] * parts[0] + weights[1] * parts[1] + weights[2] * parts[2]) / 255.0
        })
    };
    let light = grey(&half);
    let even_light = even(&light);
    // Hair is rougher than skin.
    let rough = even(&light.zip(&even_light, |value, even| (value - even).abs()));
    let rough_max = (ROUGH_MAX * median_inside(&rough, &inside).unwrap_or_default()).max(ROUGHNESS_MIN);
    let above = Plane::from_fn(size[0], size[1], |x, y| {
        let above = faces.iter().filter(|face| face.has_features).map(|face| {
            let [across, down] = face.relative([x as f64, y as f64]);
            let away = across.hypot(down / FOREHEAD_ABOVE) as f32;
            if down < 0.0 { 1.0 / (1.0 + away.powi(10)) } else { 0.0 }
        });
        above.fold(0.0, f32::max)
    });
    let mut alike = above.zip(&rough, |above, rough| {
        above * (rough_max / rough.max(1e-4) - 1.0).clamp(0.0, 1.0)
    });
    if let Some(mask) = &subject.mask {
        alike = alike.zip(&of_size(mask, size), f32::min);
    }
    // Differences of colour, Rec. 601.
    let planes = [
        (even(&colour([-0.169, -0.331, 0.5])), SKIN_COLOUR),
        (even(&colour([0.5, -0.419, -0.081])), SKIN_COLOUR),
        (even_light, SKIN_LIGHTNESS),
    ];
    let middles = planes
        .each_ref()
        .map(|(plane, _)| median_inside(plane, &inside).unwrap_or_default());
    if middles[0].hypot(middles[1]) < COLOUR_MIN {
        // Without colours grey hair is like skin.
        return ovals.map(|_| 0.0);
    }
    for ((plane, most), middle) in planes.into_iter().zip(middles) {
        let share = plane.map(|value| (2.0 - 2.0 * (value - middle).abs() / most).clamp(0.0, 1.0));
        alike = alike.zip(&share, |alike, share| alike * share);
    }
    of_size(&alike, [ovals.width(), ovals.height()])
}

/// The median of the values inside ovals.
fn median_inside(plane: &Plane, ovals: &Plane) -> Option<f32> {
    let mut inside: Vec<f32> = (plane.values().iter().zip(ovals.values()))
        .filter(|(_, oval)| **oval > 0.7)
        .map(|(value, _)| *value)
        .collect();
    let middle = inside.len() / 2;
    (!inside.is_empty()).then(|| *inside.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Ink on a face, 0 to 1: the soft shade of the skin, without folds and noise, and what is dark in the features.
fn on_face(light: &Plane, calm: &Plane, ovals: &Plane, features: &Plane, radius: f64) -> Plane {
    if radius <= 0.0 {
        return features.clone();
    }
    let smooth = denoised(
        &denoised(light, (0.10 * radius) as usize + 1),
        (0.05 * radius) as usize + 1,
    );
    let even = with_even_skin(&smooth.blurred((0.035 * radius) as f32), ovals, radius);
    let shade = even.map(|value| SHADE_MAX * ((1.0 - value - 0.06) / 0.94).max(0.0).powf(1.1));
    let dark = darkness_in_faces(calm, ovals).zip(features, |dark, feature| {
        feature * ((dark - FEATURE_FROM) / FEATURE_OVER).clamp(0.0, 1.0)
    });
    shade.zip(&dark, f32::max)
}

/// How near each pixel is to a face, 0 to 1.
fn nearness(width: usize, height: usize, faces: &[Face]) -> Plane {
    Plane::from_fn(width, height, |x, y| {
        let near = faces.iter().map(|face| {
            let [across, down] = face.relative([x as f64, y as f64]);
            1.0 / (1.0 + (squared([across, (down + 0.1) / 1.2]) as f32 / 2.25).powi(3))
        });
        near.fold(0.0, f32::max)
    })
}

/// How much each pixel belongs to eyes, brows, nose or mouth, 0 to 1.
fn features(width: usize, height: usize, faces: &[Face]) -> Plane {
    Plane::from_fn(width, height, |x, y| {
        let at = [x as f64, y as f64];
        let near = faces.iter().filter(|face| face.has_features).map(|face| {
            let here = face.relative(at);
            let bell = |place: [f64; 2], size: [f64; 2]| {
                let away = [0, 1].map(|k| (here[k] - place[k]) / size[k]);
                (1.0 / (1.0 + squared(away).powi(3))) as f32
            };
            let eyes = face.eyes.map(|eye| face.relative(eye));
            let mouth = face.relative(face.mouth);
            let between = [0, 1].map(|k| 0.5 * (eyes[0][k] + eyes[1][k]));
            let nose = [0, 1].map(|k| between[k] + 0.6 * (mouth[k] - between[k]));
            let brows = eyes.map(|[across, down]| bell([across, down - 0.12], [0.40, 0.34]));
            let others = [bell(mouth, [0.52, 0.24]), bell(nose, [0.34, 0.2])];
            brows.into_iter().chain(others).fold(0.0, f32::max)
        });
        near.fold(0.0, f32::max)
    })
}

/// The picture without noise, its edges kept (guided filter, He, Sun and Tang, 2010).
pub(super) fn denoised(light: &Plane, radius: usize) -> Plane {
    const NOISE: f32 = 0.03;
    let mean = light.averaged(radius);
    let square = light.map(|value| value * value).averaged(radius);
    let slope = square.zip(&mean, |square, mean| {
        let variance = (square - mean * mean).max(0.0);
        variance / (variance + NOISE * NOISE)
    });
    let offset = mean.zip(&slope, |mean, slope| mean * (1.0 - slope));
    let (slope, offset) = (slope.averaged(radius), offset.averaged(radius));
    slope
        .zip(light, |slope, value| slope * value)
        .zip(&offset, |scaled, offset| scaled + offset)
}

//! The subject against its background: what the background leaves, and the edge between both.

use crate::drawing::background::{Background, is_portrait};
use crate::drawing::face::Face;
use crate::drawing::raster::Plane;
use crate::drawing::subject::Subject;

/// Widest distance of the background from the subject without fading, and the distance at which it fades to a third,
/// in face radii from the nearest face.
const FADE_FROM: f64 = 1.3;
const FADE_OVER: f64 = 0.9;
/// Background beside the subject of a portrait.
const FADE_SHARE: f32 = 0.3;
/// Reach of the edge of the subject to either side, in widths of the pen.
const EDGE_PENS: f64 = 2.5;
/// Lightness of a subject from which white paper alone would be left of it, and by how much darker a background sets it
/// off fully, of 1; how far that reaches, in radii of the largest face.
const LIGHT_FROM: f32 = 0.6;
const LIGHT_FULL: f32 = 0.85;
const DARKER_FULL: f32 = 0.25;
const SET_OFF_RADII: f64 = 0.35;
/// How sure the edge of the subject is against the rim of a face's oval.
pub(super) const MASK_SURE: f32 = 0.6;
/// Ink inside an edge up to which nothing else shows it.
const PALE_MAX: f32 = 0.2;
/// How far from the edge that ink is looked for, in widths of the pen.
const BESIDE_PENS: f64 = 4.0;

/// How much each pixel belongs to the edge of a portrait's subject or to the rim of a face's oval, where jaw and cheeks end:
/// 0 to 1.
pub(super) fn outline(ovals: &Plane, edge: &Plane) -> Plane {
    ovals.zip(edge, |oval, edge| at_edge(oval).max(MASK_SURE * edge))
}

/// How much each pixel belongs to the edge of a portrait's subject, 0 to 1.
pub(super) fn edge(subject: &Subject, faces: &[Face], size: [usize; 2], pen: f64) -> Plane {
    let Some(mask) = subject.mask.as_ref().filter(|_| is_portrait(faces, size)) else {
        return Plane::filled(size[0], size[1], 0.0);
    };
    // The line of a step lies on its dark side, beside the edge itself.
    of_size(mask, size).averaged((EDGE_PENS * pen) as usize).map(at_edge)
}

/// How much each pixel of the edge belongs to a subject that is as light as the paper, 0 to 1: no ink inside shows the edge
/// of white hair.
pub(super) fn pale_edge(subject: &Subject, edge: &Plane, ink: &Plane, pen: f64) -> Plane {
    let size = [ink.width(), ink.height()];
    let Some(mask) = &subject.mask else {
        return ink.map(|_| 0.0);
    };
    let sigma = (BESIDE_PENS * pen) as f32;
    let inside = of_size(mask, size).map(|inside| ((inside - 0.5) * 2.0).max(0.0));
    let pale = ink.zip(&inside, |ink, inside| ink * inside).blurred(sigma);
    let pale = pale.zip(&inside.blurred(sigma), |ink, inside| {
        (2.0 - ink / inside.max(1e-3) / PALE_MAX).clamp(0.0, 1.0)
    });
    pale.zip(edge, |pale, edge| pale * edge)
}

/// 1 where a share is a half, 0 where it is whole or nothing.
fn at_edge(share: f32) -> f32 {
    4.0 * share * (1.0 - share)
}

/// A plane in another size.
pub(super) fn of_size(plane: &Plane, [width, height]: [usize; 2]) -> Plane {
    let scale = [
        plane.width() as f32 / width as f32,
        plane.height() as f32 / height as f32,
    ];
    let place = |at: usize, k: usize| (at as f32 + 0.5) * scale[k] - 0.5;
    Plane::from_fn(width, height, |x, y| plane.sample(place(x, 0), place(y, 1)))
}

/// Share of what is drawn that the background leaves. A scene around a small face does not fade: it is the picture.
pub(super) fn kept(subject: &Subject, faces: &[Face], calm: &Plane, background: Background) -> Plane {
    let size = [calm.width(), calm.height()];
    let is_whole = match background {
        Background::Keep => true,
        Background::Fade => !is_portrait(faces, size),
        Background::None => false,
    };
    let Some(mask) = subject.mask.as_ref().filter(|_| !is_whole) else {
        return calm.map(|_| 1.0);
    };
    let inside = of_size(mask, size).map(|inside| ((inside - 0.25) / 0.5).clamp(0.0, 1.0));
    if background == Background::None {
        return inside;
    }
    let set_off = set_off(&inside, faces, calm);
    Plane::from_fn(size[0], size[1], |x, y| {
        let (column, row) = (x as isize, y as isize);
        let at = [x as f64, y as f64];
        let away = faces.iter().map(|face| squared(face.relative(at)));
        let away = away.fold(f64::INFINITY, f64::min).sqrt();
        let outside = FADE_SHARE * (-(away - FADE_FROM).max(0.0) / FADE_OVER).exp() as f32;
        let inside = inside.at(column, row);
        inside + (1.0 - inside) * (outside + (1.0 - outside) * set_off.at(column, row))
    })
}

/// How much the background is needed to show a light subject before it, 0 to 1: white hair has no ink of its own.
fn set_off(inside: &Plane, faces: &[Face], calm: &Plane) -> Plane {
    let radius = faces.iter().map(|face| face.radius).fold(0.0, f64::max);
    let sigma = (SET_OFF_RADII * radius).max(1.0) as f32;
    let near = inside.blurred(sigma);
    let lightness = calm.zip(inside, |light, inside| light * inside).blurred(sigma);
    let lightness = lightness.zip(&near, |sum, near| sum / near.max(1e-3));
    let needed = lightness.zip(calm, |subject, here| {
        let light = (subject - LIGHT_FROM) / (LIGHT_FULL - LIGHT_FROM);
        light.clamp(0.0, 1.0) * ((subject - here) / DARKER_FULL).clamp(0.0, 1.0)
    });
    needed.zip(&near, |needed, near| needed * (2.0 * near).min(1.0))
}

/// Squared length.
pub(super) fn squared([across, down]: [f64; 2]) -> f64 {
    across * across + down * down
}

//! Who or what a photograph shows: faces, the subject around them, and the part of the picture worth drawing.

use super::background::subject_mask;
use super::face::{Face, find_faces};
use super::raster::Plane;
use image::{RgbImage, imageops};

/// Width of a face on the sheet at which eyes and mouth have enough lines, in widths of the pen.
pub const FACE_PENS_WANTED: f64 = 150.0;
/// Width of a face below which it is hardly recognised, in widths of the pen.
pub const FACE_PENS_MIN: f64 = 60.0;
/// Least width of a face for an automatic crop, as a share of the picture's shorter side: smaller faces belong to a
/// scene.
const PORTRAIT_SHARE: f64 = 0.15;
/// Least ratio of a face's width to the next one's for a portrait of one person.
const PORTRAIT_RATIO: f64 = 1.6;
/// Window around a head, in radii of its face from the face's centre: to both sides, above and below.
const HEAD_SIDE: f64 = 2.05;
const HEAD_ABOVE: f64 = 2.3;
const HEAD_BELOW: f64 = 2.15;
/// Border around a subject, as a share of its size.
const SUBJECT_BORDER: f64 = 0.05;

/// Part of a photograph that is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Crop {
    /// The head, if the picture is a portrait of one person whose face would be small on the sheet; otherwise all.
    #[default]
    Auto,
    /// The heads of all faces.
    Head,
    /// The subject with its body.
    Subject,
    /// The whole photograph.
    None,
    /// A window: left, top, width and height, in pixels of the upright photograph.
    Window([f64; 4]),
}

impl Crop {
    /// Reads `auto`, `head`, `subject`, `none` or `X,Y,W,H`.
    ///
    /// # Errors
    /// Any other text.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "head" => Ok(Self::Head),
            "subject" => Ok(Self::Subject),
            "none" => Ok(Self::None),
            _ => match numbers::<4>(text) {
                Some(window) if window[2] > 0.0 && window[3] > 0.0 => Ok(Self::Window(window)),
                _ => Err("auto, head, subject, none, or X,Y,W,H in pixels is needed".to_owned()),
            },
        }
    }
}

/// Reads the centre and radius of a face, `X,Y,R`, pixels of the photograph.
///
/// # Errors
/// Any other text.
pub fn parse_focus(text: &str) -> Result<[f64; 3], String> {
    match numbers::<3>(text) {
        Some(focus) if focus[2] > 0.0 => Ok(focus),
        _ => Err("the face's centre and radius, X,Y,R in pixels, are needed".to_owned()),
    }
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let read: Option<Vec<f64>> = text
        .split(',')
        .map(|part| {
            part.trim()
                .parse::<f64>()
                .ok()
                .filter(|value| value.is_finite() && *value >= 0.0)
        })
        .collect();
    read?.try_into().ok()
}

/// What was found in a photograph; places are in its pixels.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Faces, the largest first.
    pub faces: Vec<Face>,
    /// How much each pixel of a small copy belongs to the subject, 0 to 1; `None` without a face.
    pub(crate) mask: Option<Plane>,
}

impl Subject {
    /// Looks for faces; `focus` is the centre and radius of a face that a person has pointed at.
    #[must_use]
    pub fn of(picture: &RgbImage, focus: Option<[f64; 3]>) -> Self {
        let mut faces = find_faces(picture);
        if let Some(pointed) = focus {
            // A detected face at that place knows its eyes.
            let same = |face: &&Face| {
                let away = (face.centre[0] - pointed[0]).hypot(face.centre[1] - pointed[1]);
                away < 0.6 * pointed[2] && (0.6..1.7).contains(&(face.radius / pointed[2]))
            };
            faces = vec![faces.iter().find(same).copied().unwrap_or(Face::pointed_at(pointed))];
        }
        let mask = subject_mask(picture, &faces);
        Self { faces, mask }
    }

    /// The window of the picture to draw: left, top, width and height, pixels.
    ///
    /// `room_mm` is the largest width and height on the sheet, `pen_mm` the pen's width. `None` draws the whole picture.
    #[must_use]
    pub fn window(&self, size_px: [u32; 2], crop: Crop, room_mm: [f64; 2], pen_mm: f64) -> Option<[u32; 4]> {
        let size = size_px.map(f64::from);
        let window = match crop {
            Crop::None => return None,
            Crop::Window(window) => window,
            Crop::Head => self.heads(&self.faces)?,
            Crop::Subject => self.body(size)?,
            Crop::Auto => {
                let face = self.faces.first()?;
                let portrait = 2.0 * face.radius >= PORTRAIT_SHARE * size[0].min(size[1]);
                let alone = self
                    .faces
                    .get(1)
                    .is_none_or(|next| face.radius >= PORTRAIT_RATIO * next.radius);
                if !portrait || !alone || face_pens(face, size, room_mm, pen_mm) >= FACE_PENS_WANTED {
                    return None;
                }
                self.heads(&[*face])?
            }
        };
        let [left, top] = [0, 1].map(|k| window[k].clamp(0.0, size[k]).floor());
        let [right, bottom] = [0, 1].map(|k| (window[k] + window[k + 2]).clamp(0.0, size[k]).ceil());
        let cut = [left, top, right - left, bottom - top].map(|value| value as u32);
        (cut != [0, 0, size_px[0], size_px[1]]).then_some(cut)
    }

    /// Width of the largest face on the sheet, in widths of the pen.
    #[must_use]
    pub fn face_pens(&self, size_px: [u32; 2], room_mm: [f64; 2], pen_mm: f64) -> Option<f64> {
        Some(face_pens(self.faces.first()?, size_px.map(f64::from), room_mm, pen_mm))
    }

    /// What is left of this in a window of the picture.
    #[must_use]
    pub fn cut(&self, picture: &RgbImage, window: [u32; 4]) -> (RgbImage, Self) {
        let [left, top, width, height] = window;
        let part = imageops::crop_imm(picture, left, top, width, height).to_image();
        let size = [width, height].map(f64::from);
        let corner = [left, top].map(f64::from);
        let inside = |face: &Face| (0..2).all(|k| (0.0..=size[k]).contains(&face.centre[k]));
        let faces: Vec<Face> = self
            .faces
            .iter()
            .map(|face| face.moved(corner, 1.0))
            .filter(inside)
            .collect();
        let mask = subject_mask(&part, &faces);
        (part, Self { faces, mask })
    }

    /// A window with all these heads.
    fn heads(&self, faces: &[Face]) -> Option<[f64; 4]> {
        let around = faces.iter().map(|face| {
            let ([x, y], r) = (face.centre, face.radius);
            [
                x - HEAD_SIDE * r,
                y - HEAD_ABOVE * r,
                x + HEAD_SIDE * r,
                y + HEAD_BELOW * r,
            ]
        });
        let all = around.reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])])?;
        let [left, top] = [all[0].max(0.0), all[1].max(0.0)];
        Some([left, top, all[2] - left, all[3] - top])
    }

    /// A window with the whole subject.
    fn body(&self, size: [f64; 2]) -> Option<[f64; 4]> {
        let mask = self.mask.as_ref()?;
        let (mut low, mut high) = (size, [0.0_f64; 2]);
        let scale = [size[0] / mask.width() as f64, size[1] / mask.height() as f64];
        for y in 0..mask.height() {
            for x in (0..mask.width()).filter(|&x| mask.at(x as isize, y as isize) > 0.5) {
                for (k, at) in [(0, x), (1, y)] {
                    low[k] = low[k].min(at as f64 * scale[k]);
                    high[k] = high[k].max((at + 1) as f64 * scale[k]);
                }
            }
        }
        let border = [0, 1].map(|k| SUBJECT_BORDER * (high[k] - low[k]));
        let [left, top] = [0, 1].map(|k| (low[k] - border[k]).max(0.0));
        (high[0] > low[0]).then(|| [left, top, high[0] + border[0] - left, high[1] + border[1] - top])
    }
}

fn face_pens(face: &Face, size: [f64; 2], room_mm: [f64; 2], pen_mm: f64) -> f64 {
    let scale = (room_mm[0] / size[0].max(1.0)).min(room_mm[1] / size[1].max(1.0));
    2.0 * face.radius * scale / pen_mm
}

#[cfg(test)]
mod tests {
    use super::*;

    fn subject(faces: &[[f64; 3]]) -> Subject {
        Subject {
            faces: faces.iter().map(|&face| Face::pointed_at(face)).collect(),
            mask: None,
        }
    }

    #[test]
    fn parts_are_read_and_other_texts_refused() {
        assert_eq!(Crop::parse("head"), Ok(Crop::Head));
        assert_eq!(
            Crop::parse("10, 20,300,400"),
            Ok(Crop::Window([10.0, 20.0, 300.0, 400.0]))
        );
        for wrong in ["", "face", "1,2,3", "1,2,0,4", "1,2,3,nan", "1,2,3,4,5", "-1,0,5,5"] {
            assert!(Crop::parse(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_focus("5,6,7"), Ok([5.0, 6.0, 7.0]));
        assert!(parse_focus("5,6,0").is_err() && parse_focus("5,6").is_err());
    }

    #[test]
    fn a_portrait_with_a_small_face_is_cropped_until_the_face_is_large_enough() {
        let portrait = subject(&[[256.0, 150.0, 50.0]]);
        let window = portrait
            .window([512, 512], Crop::Auto, [192.0, 192.0], 0.5)
            .expect("a window");
        let (_, part) = portrait.cut(&RgbImage::new(512, 512), window);
        let pens = part
            .face_pens([window[2], window[3]], [192.0, 192.0], 0.5)
            .expect("a face");
        assert!(pens >= FACE_PENS_WANTED, "{pens}");
        assert_eq!(portrait.window([512, 512], Crop::None, [192.0, 192.0], 0.5), None);
        // With a finer pen the whole picture shows the face well.
        assert_eq!(portrait.window([512, 512], Crop::Auto, [192.0, 192.0], 0.2), None);
    }

    #[test]
    fn a_scene_a_group_and_a_picture_without_a_face_stay_whole() {
        for faces in [
            &[[256.0, 150.0, 20.0]][..],
            &[[150.0, 150.0, 50.0], [350.0, 150.0, 45.0]],
            &[],
        ] {
            assert_eq!(
                subject(faces).window([512, 512], Crop::Auto, [192.0, 192.0], 0.5),
                None,
                "{faces:?}"
            );
        }
    }

    #[test]
    fn a_window_beyond_the_picture_is_limited_to_it() {
        let window = subject(&[]).window([100, 80], Crop::Window([60.0, 50.0, 500.0, 500.0]), [192.0, 192.0], 0.5);
        assert_eq!(window, Some([60, 50, 40, 30]));
        let heads = subject(&[[5.0, 5.0, 20.0]]).window([100, 80], Crop::Head, [192.0, 192.0], 0.5);
        assert_eq!(heads.map(|window| [window[0], window[1]]), Some([0, 0]));
    }
}

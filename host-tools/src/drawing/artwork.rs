//! Strokes with their own page, before they are placed on a sheet.
//!
//! A vector file defines its size. Position, scale and rotation on the robot's sheet are set when it is drawn. Layers
//! stay separate until then, because each may need a different pen.
//!
//! Invariant: every stroke has two points or more, all finite.

use super::line::Point;
use super::{Drawing, DrawingError, Stroke};
use serde::{Deserialize, Serialize};

/// Distance beyond the sheet's edge within which a pen position counts as rounding, mm.
const EDGE_MM: f64 = 0.01;

/// Strokes that belong together: a layer of the file, or all strokes of one colour.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// The layer's label, or its colour as `#rrggbb`.
    pub name: String,
    /// Colour of its first stroke: red, green, blue.
    pub colour: [u8; 3],
}

/// A stroke and the layer it belongs to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LayerStroke {
    /// Index of the layer.
    pub layer: usize,
    /// The line, mm on the page: x to the right, y down, origin at the page's top left.
    pub stroke: Stroke,
}

/// Content of a vector file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Artwork {
    /// Width and height of the page, mm; `None` if the file has no page size.
    pub page_mm: Option<[f64; 2]>,
    /// The layers, in the order in which they first appear.
    pub layers: Vec<Layer>,
    /// All strokes in the file's order.
    pub strokes: Vec<LayerStroke>,
    /// Relation of the file's own coordinates to millimetres, and its size attributes; for writing the file again.
    pub user_space: UserSpace,
    /// Warnings for the user: what was left out, what was assumed.
    pub warnings: Vec<String>,
}

/// The coordinates in which a file was written.
#[derive(Clone, Debug, PartialEq)]
pub struct UserSpace {
    /// The attributes width, height and viewBox of the file's root, as far as present.
    pub attributes: Vec<(&'static str, String)>,
    /// User units per millimetre.
    pub units_per_mm: [f64; 2],
    /// The page's top left corner in user units.
    pub origin: [f64; 2],
}

impl Default for UserSpace {
    /// Millimetres from the page's corner.
    fn default() -> Self {
        Self {
            attributes: Vec::new(),
            units_per_mm: [1.0; 2],
            origin: [0.0; 2],
        }
    }
}

/// Placement of artwork on the sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// Scale the page to the sheet inside its margin, instead of keeping its true size.
    pub fit: bool,
    /// Scale the page to fit into this width and height, mm.
    pub size_mm: Option<[f64; 2]>,
    /// White border of the sheet that `fit` leaves, mm.
    pub margin_mm: f64,
    /// Clockwise rotation, degrees.
    pub rotate_deg: f64,
    /// Position of the page's top left corner on the sheet, mm; without it the page is centred.
    pub origin_mm: Option<[f64; 2]>,
    /// Only the layers of these names or numbers (the first is 1); empty: all.
    pub layers: Vec<String>,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            fit: false,
            size_mm: None,
            margin_mm: 4.0,
            rotate_deg: 0.0,
            origin_mm: None,
            layers: Vec::new(),
        }
    }
}

impl Artwork {
    /// All strokes in the file's order.
    pub fn in_sequence(&self) -> Drawing {
        Drawing {
            sheet_mm: self.page_mm.unwrap_or_default(),
            strokes: self.strokes.iter().map(|stroke| stroke.stroke.clone()).collect(),
        }
    }

    /// The strokes of each layer.
    pub fn by_layers(&self) -> Vec<Drawing> {
        let of = |layer: usize| {
            let own = self.strokes.iter().filter(|stroke| stroke.layer == layer);
            Drawing {
                sheet_mm: self.page_mm.unwrap_or_default(),
                strokes: own.map(|stroke| stroke.stroke.clone()).collect(),
            }
        };
        (0..self.layers.len()).map(of).collect()
    }

    /// This artwork with other strokes in its layers.
    pub fn with_strokes(&self, layers: Vec<Drawing>) -> Self {
        let strokes = layers.into_iter().enumerate().flat_map(|(layer, drawing)| {
            let strokes = drawing.strokes.into_iter();
            strokes.map(move |stroke| LayerStroke { layer, stroke })
        });
        Self {
            strokes: strokes.collect(),
            ..self.clone()
        }
    }

    /// The smallest axis-aligned rectangle around all strokes: left, top, width, height, mm.
    #[must_use]
    pub fn bounds_mm(&self) -> [f64; 4] {
        bounds(self.strokes.iter().flat_map(|stroke| &stroke.stroke.points))
    }

    /// Whether a layer, by its index, is selected by `names`; all are if `names` is empty.
    fn is_wanted(&self, layer: usize, names: &[String]) -> bool {
        let is_named = |name: &String| {
            let number = name.parse() == Ok(layer + 1);
            number
                || self
                    .layers
                    .get(layer)
                    .is_some_and(|known| known.name.eq_ignore_ascii_case(name))
        };
        names.is_empty() || names.iter().any(is_named)
    }

    /// Places the selected layers on a sheet: one drawing for each of them, with the layer's name and the size of the
    /// whole page on the sheet, mm.
    ///
    /// # Errors
    /// [`DrawingError::BadOptions`], [`DrawingError::NoSuchLayer`] or [`DrawingError::NothingDrawn`].
    pub fn placed(&self, sheet_mm: [f64; 2], placement: &Placement) -> Result<Placed, DrawingError> {
        let frame = self.frame(sheet_mm, placement)?;
        if self.strokes.is_empty() {
            return Err(DrawingError::NothingDrawn);
        }
        let mut layers: Vec<Vec<Stroke>> = vec![Vec::new(); self.layers.len()];
        for stroke in &self.strokes {
            let Some(strokes) = layers.get_mut(stroke.layer) else {
                continue;
            };
            strokes.push(Stroke {
                points: stroke.stroke.points.iter().map(|&point| frame.place(point)).collect(),
            });
        }
        let wanted =
            (self.layers.iter().zip(layers).enumerate()).filter(|(index, _)| self.is_wanted(*index, &placement.layers));
        let parts: Vec<(Layer, Drawing)> = wanted
            .map(|(_, (layer, strokes))| (layer.clone(), Drawing { sheet_mm, strokes }))
            .collect();
        if parts.is_empty() {
            return Err(DrawingError::NoSuchLayer {
                layers: self.layers.len(),
            });
        }
        Ok(Placed {
            parts,
            size_mm: frame.size_mm,
            scale: frame.scale,
        })
    }

    fn frame(&self, sheet_mm: [f64; 2], placement: &Placement) -> Result<Frame, DrawingError> {
        let [left, top, width, height] = match self.page_mm {
            Some([width, height]) => [0.0, 0.0, width, height],
            None => self.bounds_mm(),
        };
        let room = sheet_mm.map(|side| side - 2.0 * placement.margin_mm);
        let numbers = [room[0], room[1], width + height, 400.0 + placement.rotate_deg];
        if !numbers.iter().all(|value| value.is_finite() && *value > 0.0) {
            return Err(DrawingError::BadOptions);
        }
        let (sine, cosine) = placement.rotate_deg.to_radians().sin_cos();
        let turned = [
            width * cosine.abs() + height * sine.abs(),
            width * sine.abs() + height * cosine.abs(),
        ];
        let filling = |room: [f64; 2]| (room[0] / turned[0].max(1e-9)).min(room[1] / turned[1].max(1e-9));
        let scale = match placement.size_mm {
            Some(size) => filling(size),
            None if placement.fit => filling(room),
            None => 1.0,
        };
        let size_mm = turned.map(|side| side * scale);
        let corner = |axis: usize| {
            let free = 0.5 * (sheet_mm[axis] - size_mm[axis]);
            placement.origin_mm.map_or(free, |origin| origin[axis])
        };
        Ok(Frame {
            middle: [left + 0.5 * width, top + 0.5 * height],
            direction: [cosine, sine],
            scale,
            target: [corner(0) + 0.5 * size_mm[0], corner(1) + 0.5 * size_mm[1]],
            size_mm,
        })
    }
}

/// Artwork on a sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// The layers and their strokes on the sheet.
    pub parts: Vec<(Layer, Drawing)>,
    /// Width and height of the turned and scaled page, mm.
    pub size_mm: [f64; 2],
    /// Millimetres on the sheet of one on the page.
    pub scale: f64,
}

/// The first point of a stroke that is not on the sheet.
#[must_use]
pub fn off_sheet(stroke: &Stroke, sheet_mm: [f64; 2]) -> Option<[f64; 2]> {
    let is_off =
        |point: &&Point| (point.iter().zip(sheet_mm)).any(|(&at, side)| !(-EDGE_MM..=side + EDGE_MM).contains(&at));
    stroke.points.iter().find(is_off).copied()
}

/// Transformation from the page to the sheet.
struct Frame {
    middle: Point,
    direction: Point,
    scale: f64,
    target: Point,
    size_mm: [f64; 2],
}

impl Frame {
    fn place(&self, point: Point) -> Point {
        let [cosine, sine] = self.direction;
        let (x, y) = (point[0] - self.middle[0], point[1] - self.middle[1]);
        [
            self.target[0] + self.scale * (x * cosine - y * sine),
            self.target[1] + self.scale * (x * sine + y * cosine),
        ]
    }
}

/// The smallest axis-aligned rectangle around points: left, top, width, height; zero without points.
pub(super) fn bounds<'a>(points: impl Iterator<Item = &'a Point>) -> [f64; 4] {
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    for point in points {
        for axis in 0..2 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    if low[0] > high[0] {
        return [0.0; 4];
    }
    [low[0], low[1], high[0] - low[0], high[1] - low[1]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn artwork() -> Artwork {
        let stroke = |layer, points: &[Point]| LayerStroke {
            layer,
            stroke: Stroke {
                points: points.to_vec(),
            },
        };
        let layer = |name: &str| Layer {
            name: name.to_owned(),
            colour: [0; 3],
        };
        Artwork {
            page_mm: Some([100.0, 50.0]),
            layers: vec![layer("lines"), layer("Hatching")],
            strokes: vec![
                stroke(0, &[[0.0, 0.0], [100.0, 50.0]]),
                stroke(1, &[[50.0, 25.0], [60.0, 25.0]]),
            ],
            ..Artwork::default()
        }
    }

    const SHEET: [f64; 2] = [200.0, 200.0];

    #[test]
    fn the_true_size_is_kept_and_centred_unless_something_else_is_asked_for() {
        let points = |placement: &Placement| {
            let placed = artwork().placed(SHEET, placement).expect("it fits");
            placed.parts[0].1.strokes[0].points.clone()
        };
        let plain = Placement::default();
        assert_eq!(points(&plain), [[50.0, 75.0], [150.0, 125.0]]);
        let fit = Placement {
            fit: true,
            ..plain.clone()
        };
        assert_eq!(points(&fit), [[4.0, 52.0], [196.0, 148.0]]);
        let size = Placement {
            size_mm: Some([50.0, 50.0]),
            ..plain.clone()
        };
        assert_eq!(points(&size), [[75.0, 87.5], [125.0, 112.5]]);
        let origin = Placement {
            origin_mm: Some([10.0, 20.0]),
            ..plain.clone()
        };
        assert_eq!(points(&origin), [[10.0, 20.0], [110.0, 70.0]]);
        let turned = points(&Placement {
            rotate_deg: 90.0,
            ..plain
        });
        for (at, wanted) in turned.iter().zip([[125.0, 50.0], [75.0, 150.0]]) {
            assert!(
                (at[0] - wanted[0]).abs() < 1e-9 && (at[1] - wanted[1]).abs() < 1e-9,
                "{at:?}"
            );
        }
    }

    #[test]
    fn layers_are_chosen_by_name_or_number() {
        let with = |names: &[&str]| {
            let layers = names.iter().map(|&name| name.to_owned()).collect();
            artwork().placed(
                SHEET,
                &Placement {
                    layers,
                    ..Placement::default()
                },
            )
        };
        for name in ["hatching", "2"] {
            let placed = with(&[name]).expect("the layer");
            assert_eq!(placed.parts.len(), 1);
            assert_eq!(placed.parts[0].0.name, "Hatching");
        }
        assert_eq!(with(&["shadow"]), Err(DrawingError::NoSuchLayer { layers: 2 }));
    }

    #[test]
    fn what_does_not_lie_on_the_sheet_is_found() {
        let sheet_mm = [90.0, 90.0];
        let placed = artwork().placed(sheet_mm, &Placement::default()).expect("layers");
        let found = |part: usize| off_sheet(&placed.parts[part].1.strokes[0], sheet_mm);
        assert_eq!((found(0), found(1)), (Some([-5.0, 20.0]), None));
    }
}

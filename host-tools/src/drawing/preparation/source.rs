//! Options for the conversion of a file into strokes, shared by all commands that draw or show one.

use crate::drawing::{
    Background, Crop, FontFile, Placement, Style, TextFont, VectorizeOptions, parse_duration_s, parse_focus,
    parse_length_mm, parse_point_mm, parse_size_mm,
};
use etherpen::config::Config;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// How a file becomes strokes on the sheet. Lengths take a unit (mm, cm, in, pt, px); without one they are millimetres.
#[derive(clap::Args, Clone, Debug, Default, Serialize, Deserialize)]
#[command(next_help_heading = "From the file to strokes")]
pub struct SourceArguments {
    /// Scale vectors to the sheet inside its margin, instead of keeping their true size.
    #[arg(long, conflicts_with = "size")]
    fit: bool,
    /// Largest width and height on the sheet: 120x80mm, 90mm, a6, a6-landscape; the shape is kept.
    #[arg(long, value_name = "SIZE", value_parser = parse_size_mm)]
    size: Option<Size>,
    /// White border that photographs and --fit leave on the sheet [default: 4mm].
    #[arg(long, value_name = "LENGTH", value_parser = parse_length_mm)]
    margin: Option<f64>,
    /// Rotate clockwise; photographs only by multiples of 90.
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true)]
    rotate: f64,
    /// Position of the drawing's upper left corner, from the sheet's upper left corner. Default: centred.
    #[arg(long, value_name = "X,Y", value_parser = parse_point_mm, allow_hyphen_values = true)]
    origin: Option<Size>,
    /// Draw only this layer of the vectors: its name (Inkscape's label, or the colour as #rrggbb) or its number; can be
    /// repeated.
    #[arg(long, value_name = "LAYER")]
    layer: Vec<String>,
    #[command(flatten)]
    text: TextArguments,
    /// Keep the file's order and directions; close only gaps smaller than the pen's width.
    #[arg(long)]
    keep_order: bool,
    /// Line width of the pen [default: 0.5mm].
    #[arg(long, value_name = "LENGTH", value_parser = parse_length_mm)]
    pen_width: Option<f64>,
    /// Photographs: the part that is drawn: the head, the subject with its body, everything (none), or a window X,Y,W,H
    /// in pixels of the upright picture. auto draws the head of a portrait whose face would be small on the sheet.
    #[arg(long, value_name = "PART", default_value = "auto", value_parser = crop)]
    crop: String,
    /// Photographs: centre and radius of the face, in pixels of the upright picture; it is drawn finest. Default: faces
    /// are looked for.
    #[arg(long, value_name = "X,Y,R", value_parser = parse_focus)]
    focus: Option<Circle>,
    /// Photographs with a face: what is drawn of the background: all (keep), less with the distance from the subject,
    /// and more where it sets off white hair (fade), nothing (none).
    #[arg(long, value_name = "HOW", default_value = "fade", value_parser = Background::NAMES)]
    background: String,
    /// Photographs: edges with hatching along the picture's flow (sketch), edges with crossed hatching over the form
    /// (hatch), hatching along the flow with lines at the eyes and mouth alone (flow), one single line (tsp), edges with
    /// long parallel lines that bend with the form (engrave).
    #[arg(long, value_name = "STYLE", default_value = "sketch", value_parser = Style::NAMES)]
    style: String,
    /// Photographs: amount of detail, 0 (coarse) to 1 (fine) [default: 0.5].
    #[arg(long, value_name = "SHARE", value_parser = share)]
    detail: Option<f64>,
    /// Photographs: longest drawing time by the firmware's planner: 90s, 3m. Detail is reduced until the drawing
    /// fits, in faces last; it then uses at least 97 percent of the time, unless the complete picture takes less [default: as
    /// detailed as suits about 110s].
    #[arg(long, value_name = "TIME", value_parser = parse_duration_s)]
    max_time: Option<f64>,
    /// Photographs: maximum number of strokes [default: 900; with --max-time as many as fit].
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1..))]
    max_strokes: Option<u32>,
    /// Photographs: random seed [default: 1].
    #[arg(long, value_name = "NUMBER")]
    seed: Option<u64>,
}

/// Font of text in an SVG.
#[derive(clap::Args, Clone, Debug, Default, Serialize, Deserialize)]
pub struct TextArguments {
    /// SVG text: draw single-line letters instead of the outlines of a font.
    #[arg(long)]
    single_stroke: bool,
    /// SVG text: use this TrueType or OpenType font instead of the installed ones.
    #[arg(long, value_name = "FILE", value_parser = |path: &str| FontFile::read(path), conflicts_with = "single_stroke")]
    font: Option<FontFile>,
}

impl TextArguments {
    /// The font for text.
    #[must_use]
    pub fn font(&self) -> TextFont {
        match &self.font {
            Some(file) => TextFont::File(file.clone()),
            None if self.single_stroke => TextFont::SingleStroke,
            None => TextFont::Installed,
        }
    }

    /// All files that a command with these options reads, among them the configuration file.
    #[must_use]
    pub fn inputs(&self, file: &Path, config: Option<PathBuf>) -> Vec<PathBuf> {
        let font = self.font.as_ref().map(|font| font.path().to_owned());
        [Some(file.to_owned()), config, font].into_iter().flatten().collect()
    }
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=1.0).contains(&value) => Ok(value),
        _ => Err("a number from 0 to 1 is needed".to_owned()),
    }
}

/// A drawing time that limits no drawing, s.
const UNBOUNDED_S: f64 = 1e9;

fn crop(text: &str) -> Result<String, String> {
    Crop::parse(text).map(|_| text.to_owned())
}

/// Centre and radius, pixels.
type Circle = [f64; 3];

/// Two lengths, mm.
type Size = [f64; 2];

impl SourceArguments {
    /// Placement of vectors on the sheet.
    #[must_use]
    pub fn placement(&self) -> Placement {
        let plain = Placement::default();
        Placement {
            fit: self.fit,
            size_mm: self.size,
            margin_mm: self.margin.unwrap_or(plain.margin_mm),
            rotate_deg: self.rotate,
            origin_mm: self.origin,
            layers: self.layer.clone(),
        }
    }

    /// Whether any option differs from its default.
    #[must_use]
    pub fn is_given(&self) -> bool {
        #[derive(clap::Parser)]
        struct Plain {
            #[command(flatten)]
            source: SourceArguments,
        }
        let plain = <Plain as clap::Parser>::try_parse_from([""]).map(|plain| plain.source);
        // Both are made of the same fields in the same order.
        plain.is_ok_and(|plain| serde_json::to_value(self).ok() != serde_json::to_value(plain).ok())
    }

    /// These options for one layer alone.
    #[must_use]
    pub fn only(&self, layer: &str) -> Self {
        Self {
            layer: vec![layer.to_owned()],
            ..self.clone()
        }
    }

    /// Options for converting a photograph into strokes on the configured sheet.
    #[must_use]
    pub fn vectorize_options(&self, config: &Config) -> VectorizeOptions {
        let plain = VectorizeOptions::default();
        VectorizeOptions {
            sheet_mm: config.paper.size_mm,
            margin_mm: self.margin.unwrap_or(plain.margin_mm),
            size_mm: self.size,
            origin_mm: self.origin,
            pen_width_mm: self.pen_width.unwrap_or(plain.pen_width_mm),
            style: Style::from_name(&self.style).unwrap_or_default(),
            detail: self.detail.unwrap_or(plain.detail),
            // A requested time is met by planning, with all the detail that the pen's width allows.
            strokes_max: match (self.max_strokes, self.max_time) {
                (Some(count), _) => count as usize,
                (None, Some(_)) => usize::MAX,
                (None, None) => plain.strokes_max,
            },
            time_max_s: self.max_time.map_or(plain.time_max_s, |_| UNBOUNDED_S),
            seed: self.seed.unwrap_or(plain.seed),
            background: Background::from_name(&self.background).unwrap_or_default(),
            focus: self.focus,
        }
    }

    /// These options with another style, crop and background of photographs.
    #[must_use]
    pub fn varied(&self, [style, crop, background]: [&str; 3]) -> Self {
        Self {
            style: style.to_owned(),
            crop: crop.to_owned(),
            background: background.to_owned(),
            ..self.clone()
        }
    }

    /// Style, crop and background of photographs.
    #[must_use]
    pub fn look(&self) -> [&str; 3] {
        [&self.style, &self.crop, &self.background]
    }

    /// The part of a photograph that is drawn.
    #[must_use]
    pub fn crop(&self) -> Crop {
        Crop::parse(&self.crop).unwrap_or_default()
    }

    /// Longest drawing time of a photograph, s, if one is requested.
    #[must_use]
    pub fn time_budget_s(&self) -> Option<f64> {
        self.max_time
    }

    /// Clockwise quarter turns of a photograph, 0 to 3; `None` if the rotation is not a multiple of 90 degrees.
    #[must_use]
    pub fn quarters(&self) -> Option<u8> {
        let quarters = self.rotate / 90.0;
        (quarters.fract() == 0.0).then(|| quarters.rem_euclid(4.0) as u8)
    }

    /// Line width of the pen, mm.
    #[must_use]
    pub fn pen_width_mm(&self) -> f64 {
        self.pen_width.unwrap_or(VectorizeOptions::default().pen_width_mm)
    }

    /// The font for text.
    #[must_use]
    pub fn font(&self) -> TextFont {
        self.text.font()
    }

    /// All files that a command with these options reads, among them the configuration file.
    #[must_use]
    pub fn inputs(&self, file: &Path, config: Option<PathBuf>) -> Vec<PathBuf> {
        self.text.inputs(file, config)
    }

    /// Whether the file's order is kept.
    #[must_use]
    pub fn keeps_order(&self) -> bool {
        self.keep_order
    }
}

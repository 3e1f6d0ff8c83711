//! Variants of the photograph, to choose from: complete preparations, made one after the other in a separate thread.
//!
//! A variant is chosen by requesting its options: the drawing is then there at once. Invariants: the drawing that is
//! chosen is the one whose picture was shown; variants of one file are never shown beside another.

use super::hub::Topic;
use super::preparation::{self, Made, PageOptions};
use super::{Console, Preparation, Source, lock};
use crate::drawing::preparation::variants::looks;
use crate::drawing::preparation::wire::from_wire;
use crate::drawing::{VectorizeOptions, from_path, render_rgb};
use axum::body::Bytes;
use etherpen::config::Config;
use etherpen::motion::Vertex;
use image::imageops::{FilterType, resize};
use image::{DynamicImage, ImageFormat};
use serde::Serialize;
use std::collections::VecDeque;
use std::io::Cursor;
use std::sync::Arc;

/// Most variants.
const VARIANTS_MAX: usize = 6;
/// Longest side of a variant's picture, pixels.
const SIDE_PX: f64 = 300.0;
/// Scale at which a picture is rendered before it is reduced.
const FINE: f64 = 3.0;

/// A variant, complete.
struct Variant {
    /// Number of the variant and of its picture; later ones have larger numbers.
    number: u64,
    /// The options that it was made with, none of them a default of style, crop and background.
    wishes: PageOptions,
    made: Made,
    /// The drawing as a PNG.
    picture: Bytes,
}

/// The variants of one file.
#[derive(Default)]
pub(super) struct Variants {
    /// Counts the requests; the result of an older one is dropped.
    asked: u64,
    source: Option<Arc<Source>>,
    /// Options that have not been tried, the first with its drawing if that is known.
    untried: VecDeque<(PageOptions, Option<Made>)>,
    /// Number of variants that are made.
    wanted: usize,
    made: Vec<Variant>,
    /// Number of the last variant.
    last: u64,
    /// Why the first variant that failed cannot be drawn.
    error: String,
    /// Whether a thread makes variants.
    is_running: bool,
}

/// The variants as shown on the page.
#[derive(Debug, Serialize)]
pub(super) struct VariantsView<'a> {
    /// `idle`, `working`, `ready` or `failed`.
    state: &'static str,
    /// Number of variants that there will be at most.
    wanted: usize,
    items: Vec<VariantView<'a>>,
    /// Why there are none.
    error: &'a str,
}

/// A variant as shown on the page.
#[derive(Debug, Serialize)]
struct VariantView<'a> {
    /// Number of its picture.
    number: u64,
    /// Options that draw it.
    wishes: &'a PageOptions,
    strokes: u32,
    planned_s: f64,
}

impl Variants {
    /// Begins variants of a photograph, the first with these options and this drawing. Returns whether a thread is needed.
    fn begin(&mut self, preparation: &Preparation, explicit: &PageOptions, first: &Made) -> bool {
        self.end();
        let looks = looks([&explicit.style, &explicit.crop, &explicit.background]);
        let has_face = first
            .photograph
            .as_ref()
            .is_some_and(|(part, _)| part.face_px.is_some());
        let mut styles = Vec::new();
        for look in looks {
            // Crop and background depend on a face; without one they change nothing.
            if has_face || !styles.contains(&look[0]) {
                styles.push(look[0].clone());
                let known = self.untried.is_empty().then(|| first.clone());
                self.untried.push_back((PageOptions::varied(look, explicit), known));
            }
        }
        self.source = Some(preparation.source.clone());
        self.wanted = self.untried.len().min(VARIANTS_MAX);
        !std::mem::replace(&mut self.is_running, true)
    }

    /// Removes all variants.
    fn end(&mut self) {
        *self = Self {
            asked: self.asked + 1,
            last: self.last,
            is_running: self.is_running,
            ..Self::default()
        };
    }

    /// The next options to try; `None`, once, when no more variants are wanted.
    fn next(&mut self) -> Option<(u64, Arc<Source>, PageOptions, Option<Made>)> {
        if self.made.len() >= self.wanted {
            self.untried.clear();
        }
        let next = self.source.clone().zip(self.untried.pop_front());
        self.is_running = next.is_some();
        next.map(|(source, (wishes, known))| (self.asked, source, wishes, known))
    }

    /// Takes a result, unless it is outdated, or the lines are those of an earlier variant.
    fn take(&mut self, asked: u64, wishes: PageOptions, result: Result<(Made, Bytes), String>) {
        if asked != self.asked {
            return;
        }
        match result {
            Err(why) if self.error.is_empty() => self.error = why,
            Ok((made, picture))
                if self
                    .made
                    .iter()
                    .all(|other| other.made.drawing.path != made.drawing.path) =>
            {
                self.last += 1;
                self.made.push(Variant {
                    number: self.last,
                    wishes,
                    made,
                    picture,
                });
            }
            _ => {}
        }
    }

    /// The variants as shown on the page.
    pub(super) fn view(&self) -> VariantsView<'_> {
        VariantsView {
            state: match (&self.source, self.is_running, self.made.is_empty()) {
                (None, _, _) => "idle",
                (_, true, _) => "working",
                (_, false, false) => "ready",
                (_, false, true) => "failed",
            },
            wanted: self.wanted,
            items: (self.made.iter())
                .map(|variant| VariantView {
                    number: variant.number,
                    wishes: &variant.wishes,
                    strokes: variant.made.drawing.strokes,
                    planned_s: variant.made.drawing.planned_s,
                })
                .collect(),
            error: &self.error,
        }
    }
}

/// The sheet with a drawing on it, as the bytes of a PNG.
fn picture_of(made: &Made, config: &Config) -> Option<Bytes> {
    let path: Vec<Vertex> = made.drawing.path.iter().map(from_wire).collect();
    let drawing = from_path(&path, &config.paper);
    let [width, height] = drawing.sheet_mm;
    let px_per_mm = SIDE_PX / width.max(height);
    let pen_mm = VectorizeOptions::default().pen_width_mm;
    let fine = render_rgb(&drawing.strokes, drawing.sheet_mm, pen_mm, FINE * px_per_mm);
    let side = |mm: f64| ((mm * px_per_mm).round() as u32).max(1);
    let small = resize(&fine, side(width), side(height), FilterType::Triangle);
    let mut png = Cursor::new(Vec::new());
    let grey = DynamicImage::from(small).into_luma8();
    grey.write_to(&mut png, ImageFormat::Png).ok()?;
    Some(png.into_inner().into())
}

impl Console {
    /// Begins to draw the present photograph in several ways.
    pub(super) fn vary(self: &Arc<Self>) -> Result<(), String> {
        // Held until the variants belong to its file: another one may be dropped at any time.
        let preview = lock(&self.preview);
        let made = preview.made.clone().filter(|made| made.photograph.is_some());
        let Some((preparation, first)) = preview.wanted.clone().zip(made) else {
            return Err("variants are made of a photograph; drop one, and wait for its preview".to_owned());
        };
        let explicit = preparation.wishes.explicit()?;
        let begins = self.change_variants(|variants| variants.begin(&preparation, &explicit, &first));
        drop(preview);
        if !begins {
            return Ok(());
        }
        let console = self.clone();
        let spawned = std::thread::Builder::new()
            .name("variants".to_owned())
            .spawn(move || while console.make_variant() {});
        spawned.map(|_| ()).map_err(|cause| {
            self.change_variants(|variants| variants.is_running = false);
            self.end_variants();
            format!("no thread for it: {cause}")
        })
    }

    /// Makes the next variant; returns whether there was one.
    fn make_variant(&self) -> bool {
        let Some((asked, source, wishes, known)) = self.change_variants(Variants::next) else {
            return false;
        };
        let made = known.map_or_else(
            || preparation::compose(&self.config, &source.name, &wishes, &source.content),
            Ok,
        );
        let result = made.and_then(|made| match picture_of(&made, &self.config) {
            Some(picture) => Ok((made, picture)),
            None => Err("its picture cannot be made".to_owned()),
        });
        self.change_variants(|variants| variants.take(asked, wishes, result));
        true
    }

    /// Removes all variants.
    pub(super) fn end_variants(&self) {
        self.change_variants(Variants::end);
    }

    fn change_variants<R>(&self, change: impl FnOnce(&mut Variants) -> R) -> R {
        let mut variants = lock(&self.variants);
        let result = change(&mut variants);
        self.change(|hub| hub.say(Topic::Variants, &variants.view()));
        result
    }

    /// The variant of a file with these options.
    pub(super) fn variant_of(&self, preparation: &Preparation) -> Option<Made> {
        let explicit = preparation.wishes.explicit().ok()?;
        let variants = lock(&self.variants);
        let source = variants.source.as_ref()?;
        let is_same = Arc::ptr_eq(source, &preparation.source);
        let found = variants.made.iter().find(|variant| variant.wishes == explicit);
        found.filter(|_| is_same).map(|variant| variant.made.clone())
    }

    /// Pictures of the variants after a number, each with its own number.
    pub(super) fn variants_since(&self, number: u64) -> Vec<(u64, Bytes)> {
        let variants = lock(&self.variants);
        let newer = variants.made.iter().filter(|variant| variant.number > number);
        newer.map(|variant| (variant.number, variant.picture.clone())).collect()
    }
}

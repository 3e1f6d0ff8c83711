//! Fonts for text in an SVG, and what is told where there is none.
//!
//! Text becomes the outlines of a font, or the pen's own way along each letter: the single-stroke font that ships with
//! the program holds open lines, which every TrueType reader closes and this one opens again ([`Fonts::are_open`]). Place,
//! size, anchor and spacing come from usvg in all cases.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::path::Path;
use std::sync::{Arc, OnceLock};
use usvg::fontdb::Database;
use usvg::roxmltree::{Document, Node};
use usvg::{FontResolver, Options};

/// Hershey's Simplex Roman, see `assets/hershey/README.md`.
const SINGLE_STROKE: &[u8] = include_bytes!("../../../assets/hershey/single-stroke.ttf");

/// What text in vector files is drawn with.
#[derive(Clone, Debug, Default)]
pub enum TextFont {
    /// Outlines of the installed fonts that the file names, else of any.
    #[default]
    Installed,
    /// Letters of single lines.
    SingleStroke,
    /// Outlines of one font.
    File(FontFile),
}

/// A font of one's own.
#[derive(Clone, Debug)]
pub struct FontFile(Arc<Database>);

impl FontFile {
    /// Reads a TrueType or OpenType font.
    ///
    /// # Errors
    /// The file cannot be read, or holds no font.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, String> {
        let data = std::fs::read(path).map_err(|cause| cause.to_string())?;
        let mut database = Database::new();
        database.load_font_data(data);
        if database.is_empty() {
            return Err("this is no TrueType or OpenType font".to_owned());
        }
        Ok(Self(Arc::new(database)))
    }

    /// A machine's fonts where none is installed.
    #[cfg(test)]
    pub(super) fn none() -> Self {
        Self(Arc::default())
    }
}

impl Serialize for FontFile {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let face = self.0.faces().next().map(|face| face.id);
        let data = face.and_then(|id| self.0.with_face_data(id, |data, _| data.to_vec()));
        data.unwrap_or_default().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for FontFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut database = Database::new();
        database.load_font_data(Vec::deserialize(deserializer)?);
        Ok(Self(Arc::new(database)))
    }
}

/// Fonts for one file.
pub(super) struct Fonts {
    database: Arc<Database>,
    by_name: bool,
    texts: usize,
    /// Whether the letters' lines are open: the closing line is not drawn.
    pub(super) are_open: bool,
}

impl Fonts {
    /// Finds the fonts, when the file has text at all.
    pub(super) fn find(document: &Document, font: &TextFont) -> Self {
        let is_text = |node: &Node| node.is_element() && node.tag_name().name() == "text";
        let texts = document.descendants().filter(is_text).count();
        Self {
            database: match font {
                _ if texts == 0 => Arc::default(),
                TextFont::Installed => installed(),
                TextFont::SingleStroke => single_stroke(),
                TextFont::File(file) => file.0.clone(),
            },
            by_name: matches!(font, TextFont::Installed),
            texts,
            are_open: matches!(font, TextFont::SingleStroke),
        }
    }

    /// Puts the fonts into usvg's options.
    pub(super) fn give_to(&self, options: &mut Options<'static>) {
        options.fontdb = self.database.clone();
        let (by_name, named) = (self.by_name, FontResolver::default_font_selector());
        options.font_resolver = FontResolver {
            select_font: Box::new(move |font, database| {
                let named = by_name.then(|| named(font, database)).flatten();
                named.or_else(|| database.faces().next().map(|face| face.id))
            }),
            select_fallback: FontResolver::default_fallback_selector(),
        };
    }

    /// What a person should know of a file with text for which there is no font.
    pub(super) fn warning(&self) -> Option<String> {
        (self.texts > 0 && self.database.is_empty()).then(|| {
            format!(
                "{} <text> not drawn, for no font is installed: --single-stroke draws text with the pen's own letters, \
                 --font FILE with another font",
                self.texts
            )
        })
    }
}

/// The installed fonts, looked for once.
fn installed() -> Arc<Database> {
    static INSTALLED: OnceLock<Arc<Database>> = OnceLock::new();
    let fonts = INSTALLED.get_or_init(|| {
        let mut database = Database::new();
        database.load_system_fonts();
        Arc::new(database)
    });
    fonts.clone()
}

fn single_stroke() -> Arc<Database> {
    let mut database = Database::new();
    database.load_font_data(SINGLE_STROKE.to_vec());
    Arc::new(database)
}

//! The styles in which a photograph is drawn.

/// Style in which a photograph is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// Edges and dark lines, and tone by strokes along the picture's flow.
    #[default]
    Sketch,
    /// Edges and dark lines, and tone by lines over the form, which cross where it is dark.
    Hatch,
    /// Tone by strokes along the picture's flow, with edges at the features of a face alone.
    Flow,
    /// One line without many crossings, through points whose density follows the picture's darkness.
    Tsp,
    /// Edges and dark lines, and tone by long lines side by side that bend with the form.
    Engrave,
}

impl Style {
    /// The names of all styles.
    pub const NAMES: [&'static str; 5] = ["sketch", "hatch", "flow", "tsp", "engrave"];

    /// The style with a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let styles = [Self::Sketch, Self::Hatch, Self::Flow, Self::Tsp, Self::Engrave];
        let known = Self::NAMES.iter().position(|known| *known == name)?;
        styles.get(known).copied()
    }
}

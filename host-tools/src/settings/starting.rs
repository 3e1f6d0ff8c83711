//! A first configuration file out of what a machine's owner has: kind, sizes, pitch or gear, drives.
//!
//! The file is the bundled machine of the same kind with its comments, and other numbers. Work area and sheet follow the
//! sizes.
//!
//! Invariant: the text has no error of [`check`], or none is returned.

mod chain;

pub use chain::{Found, notes};

use super::checking::{Gravity, check};
use super::machines::MACHINES;
use crate::axes::{Motion, motions};
use etherpen::robots::{AXES, Kind, MAIN_AXES};
use toml_edit::{Array, DocumentMut, Item, TableLike, Value};

/// How many of the first axes the gear is told for: those that turn ahead of linear main axes, or else all.
fn geared(kind: Kind) -> usize {
    let turns = |motion: &Motion| *motion == Motion::Rotary;
    match motions(kind).into_iter().take(MAIN_AXES).take_while(turns).count() {
        0 | MAIN_AXES => AXES,
        turning => turning,
    }
}

/// Sizes of a machine that can be told.
pub const SIZES: [Size; 7] = [
    Size::new(
        "width",
        "travel along x, mm",
        "x_range_mm",
        &[Kind::Gantry, Kind::CoreXy],
    ),
    Size::new(
        "depth",
        "travel along y, mm",
        "y_range_mm",
        &[Kind::Gantry, Kind::CoreXy],
    ),
    Size::new(
        "height",
        "travel along z, mm",
        "z_range_mm",
        &[Kind::Gantry, Kind::Scara],
    ),
    Size::new(
        "inner-link",
        "length of the inner link, mm",
        "inner_link_mm",
        &[Kind::Scara],
    ),
    Size::new(
        "outer-link",
        "length of the outer link, mm",
        "outer_link_mm",
        &[Kind::Scara],
    ),
    Size::new(
        "radius",
        "from the axis to a rod's upper joint, less that of the lower joint, mm",
        "radius_mm",
        &[Kind::LinearDelta],
    ),
    Size::new("rod", "length of a rod, mm", "rod_mm", &[Kind::LinearDelta]),
];

/// A size of a machine.
#[derive(Clone, Copy, Debug)]
pub struct Size {
    /// Its name as an option.
    pub name: &'static str,
    /// What it is.
    pub what: &'static str,
    /// The value of `[geometry]`: a length, or a range with this width.
    key: &'static str,
    kinds: &'static [Kind],
}

impl Size {
    const fn new(name: &'static str, what: &'static str, key: &'static str, kinds: &'static [Kind]) -> Self {
        Self { name, what, key, kinds }
    }

    /// Whether machines of this kind have the size.
    #[must_use]
    pub fn suits(&self, kind: Kind) -> bool {
        self.kinds.contains(&kind)
    }
}

/// What somebody has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wishes {
    /// Values of [`SIZES`], in their order, mm.
    pub sizes_mm: [Option<f64>; SIZES.len()],
    /// Travel of the linear axes for a turn of pulley or screw, mm.
    pub pitch_mm: Option<f64>,
    /// Motor turns for a turn of the joint, pulley or screw.
    pub gear: Option<f64>,
    /// Number of drives.
    pub drives: Option<usize>,
    /// The slaves of the machine's bus, if it was scanned.
    pub chain: Vec<Found>,
}

/// The numbers of the bundled machine of a kind: its sizes, pitch, gear and drives.
#[must_use]
pub fn usual(kind: Kind) -> Wishes {
    let Ok(document) = sample(kind) else {
        return Wishes::default();
    };
    let geometry = document.get("geometry");
    let size = |size: Size| {
        let value = geometry?.get(size.key).filter(|_| size.suits(kind))?;
        match value.as_array() {
            Some(range) => Some(number(range.get(1)?)? - number(range.get(0)?)?),
            None => number(value.as_value()?),
        }
    };
    let axes = document.get("axes").and_then(Item::as_array_of_tables);
    let of_axis = |key: &str| {
        let shared = document.get("axis_defaults").and_then(|shared| shared.get(key));
        let first = axes.and_then(|axes| axes.iter().find_map(|axis| axis.get(key)));
        number(shared.or(first)?.as_value()?)
    };
    let has_linear = motions(kind).contains(&Motion::Linear);
    Wishes {
        sizes_mm: SIZES.map(size),
        pitch_mm: of_axis("pitch_mm").filter(|_| has_linear),
        gear: Some(of_axis("gear").unwrap_or(1.0)),
        drives: axes.map(toml_edit::ArrayOfTables::len),
        chain: Vec::new(),
    }
}

fn number(value: &Value) -> Option<f64> {
    value
        .as_float()
        .or_else(|| value.as_integer().map(|whole| whole as f64))
}

fn sample(kind: Kind) -> Result<DocumentMut, String> {
    let is_of_kind = |text: &&str| text.contains(&format!("kind = \"{}\"", kind.name()));
    let text = MACHINES.iter().map(|machine| machine.text).find(is_of_kind);
    text.unwrap_or_default().parse().map_err(|cause| format!("{cause}"))
}

/// The text of a configuration file.
///
/// # Errors
/// A value that does not suit the kind, or why the machine would not work.
pub fn compose(kind: Kind, wishes: &Wishes) -> Result<String, String> {
    for (size, value) in SIZES.iter().zip(wishes.sizes_mm) {
        match value {
            Some(_) if !size.suits(kind) => return Err(format!("a {} has no {}", kind.name(), size.name)),
            Some(mm) if !(mm > 0.0 && mm.is_finite()) => {
                return Err(format!("{} is {mm}; it is a length, more than 0 mm", size.name));
            }
            _ => {}
        }
    }
    let mut document = sample(kind)?;
    if wishes.sizes_mm.iter().any(Option::is_some) {
        let usual = usual(kind).sizes_mm;
        let mut sizes_mm = [0.0; SIZES.len()];
        for (place, (own, usual)) in sizes_mm.iter_mut().zip(wishes.sizes_mm.iter().zip(usual)) {
            *place = own.or(usual).unwrap_or(0.0);
        }
        resize(&mut document, kind, sizes_mm);
    }
    set_axes(&mut document, kind, wishes)?;
    if !wishes.chain.is_empty() {
        chain::write(&mut document, &wishes.chain);
    }
    let text = document.to_string();
    let errors: Vec<String> = check(&text)
        .iter()
        .filter(|finding| finding.gravity == Gravity::Error)
        .map(|finding| finding.text.clone())
        .collect();
    match errors.first() {
        Some(error) => Err(format!("such a machine would not work: {error}")),
        None => Ok(text),
    }
}

/// Sets a value, and keeps the comment behind it.
fn set(table: Option<&mut Item>, key: &str, value: impl Into<Value>) {
    if let Some(item) = table.and_then(|table| table.get_mut(key))
        && let Some(place) = item.as_value_mut()
    {
        let mut value = value.into();
        *value.decor_mut() = place.decor().clone();
        *place = value;
    }
}

fn range([low, high]: [f64; 2]) -> Array {
    [low, high].into_iter().map(rounded).collect()
}

/// A length in steps of a tenth of a millimetre.
fn rounded(mm: f64) -> f64 {
    (mm * 10.0).round() / 10.0
}

/// Writes the sizes, and the work area and the sheet that belong to them.
fn resize(document: &mut DocumentMut, kind: Kind, sizes_mm: [f64; SIZES.len()]) {
    let [width, depth, height, inner, outer, radius, rod] = sizes_mm;
    let mut geometry = |key: &str, value: Value| set(document.get_mut("geometry"), key, value);
    match kind {
        Kind::Delta => {}
        Kind::Gantry | Kind::CoreXy => {
            // A gantry's origin is a corner, that of crossed belts the middle.
            let middle = kind == Kind::CoreXy;
            let ends = |length: f64| match middle {
                true => [-0.5 * length, 0.5 * length],
                false => [0.0, length],
            };
            let inside = |[low, high]: [f64; 2]| {
                let margin = (0.06 * (high - low)).min(10.0);
                [low + margin, high - margin]
            };
            let (x_mm, y_mm) = (ends(width), ends(depth));
            geometry("x_range_mm", range(x_mm).into());
            geometry("y_range_mm", range(y_mm).into());
            set(document.get_mut("work_area"), "x_mm", range(inside(x_mm)));
            set(document.get_mut("work_area"), "y_mm", range(inside(y_mm)));
            // Not farther than the farthest corner.
            let corner_mm = width.hypot(depth) * if middle { 0.5 } else { 1.0 };
            set(
                document.get_mut("work_area"),
                "radius_mm",
                (corner_mm * 10.0).floor() / 10.0,
            );
            let centre = if middle { [0.0; 2] } else { [0.5 * width, 0.5 * depth] };
            let side = (0.6 * width.min(depth)).min(200.0);
            sheet(document, centre, side);
            if kind == Kind::Gantry {
                heights(document, height, 5.0);
                set_travels(document, [width, depth, height]);
            }
        }
        Kind::Scara => {
            geometry("inner_link_mm", rounded(inner).into());
            geometry("outer_link_mm", rounded(outer).into());
            // The elbow is bent by 0.35 rad at least, and by 2.5 rad at most.
            let at = |elbow_rad: f64| {
                let square = inner * inner + outer * outer + 2.0 * inner * outer * elbow_rad.cos();
                square.max(0.0).sqrt()
            };
            let [near, far] = [1.05 * at(2.5), 0.98 * at(0.35)];
            set(document.get_mut("work_area"), "radius_mm", rounded(far));
            set(document.get_mut("work_area"), "inner_radius_mm", rounded(near));
            sheet(document, [0.5 * (near + far), 0.0], (0.75 * (far - near)).min(200.0));
            heights(document, height, 5.0);
        }
        Kind::LinearDelta => {
            geometry("radius_mm", rounded(radius).into());
            geometry("rod_mm", rounded(rod).into());
            // Rods stay steeper than 0.4 of their length at the far side.
            let area_mm = (0.82 * radius).min(0.9 * rod - radius).max(1.0);
            let steepest = rod;
            let flattest = (rod * rod - (radius + area_mm).powi(2)).max(0.0).sqrt();
            set(document.get_mut("work_area"), "radius_mm", rounded(area_mm));
            let [low, high] = [flattest - 30.0, steepest + 100.0];
            set(document.get_mut("geometry"), "carriage_range_mm", range([low, high]));
            sheet(document, [0.0; 2], (1.2 * area_mm).min(200.0));
            let axes = document.get_mut("axis_defaults");
            set(
                axes,
                "sync_mm",
                rounded((rod * rod - radius * radius).max(0.0).sqrt() + 40.0),
            );
        }
    }
}

/// Writes the range of z, from -`height` to a little above 0, and the heights within it.
fn heights(document: &mut DocumentMut, height_mm: f64, above_mm: f64) {
    let low = above_mm - height_mm;
    set(document.get_mut("geometry"), "z_range_mm", range([low, above_mm]));
    set(document.get_mut("work_area"), "z_low_mm", rounded(0.9 * low));
    set(document.get_mut("paper"), "pen_down_z_mm", rounded(0.5 * low));
}

/// Writes the longest way to the home switch of each axis, from the axes' lengths.
fn set_travels(document: &mut DocumentMut, lengths_mm: [f64; 3]) {
    let axes = document.get_mut("axes").and_then(Item::as_array_of_tables_mut);
    let axes = axes.into_iter().flat_map(|axes| axes.iter_mut());
    for (axis, length_mm) in axes.zip(lengths_mm) {
        set(axis.get_mut("home"), "travel_max_mm", rounded(1.1 * length_mm));
    }
}

fn sheet(document: &mut DocumentMut, centre_mm: [f64; 2], side_mm: f64) {
    set(document.get_mut("paper"), "centre_mm", range(centre_mm));
    set(document.get_mut("paper"), "size_mm", range([side_mm, side_mm]));
}

/// The number of drives that the file uses: what is wished, or else those of the chain that the kind has axes for.
fn used_drives(wishes: &Wishes, axes: usize) -> Result<Option<usize>, String> {
    if wishes.chain.is_empty() {
        return Ok(wishes.drives);
    }
    let found = chain::drives(&wishes.chain).count();
    match wishes.drives {
        _ if found == 0 => Err("no drive was found on the bus".into()),
        Some(drives) if drives > found => Err(format!("{drives} drives are asked for, and {found} drives were found")),
        None => Ok(Some(found.min(axes))),
        drives => Ok(drives),
    }
}

/// Writes pitch and gear, and as many axes as there are drives. The gear is that of [`geared`] axes.
fn set_axes(document: &mut DocumentMut, kind: Kind, wishes: &Wishes) -> Result<(), String> {
    let has_linear = motions(kind).contains(&Motion::Linear);
    if wishes.pitch_mm.is_some() && !has_linear {
        return Err(format!("a {} has no linear axis, and so no pitch", kind.name()));
    }
    let mut tables: Vec<&mut dyn TableLike> = Vec::new();
    let mut axes = None;
    for (name, item) in document.iter_mut() {
        match (name.get(), item) {
            ("axis_defaults", Item::Table(shared)) => tables.push(shared),
            ("axes", Item::ArrayOfTables(all)) => axes = Some(all),
            _ => {}
        }
    }
    let Some(axes) = axes else { return Ok(()) };
    if let Some(drives) = used_drives(wishes, axes.len())? {
        if !(2..=axes.len()).contains(&drives) {
            return Err(format!(
                "{drives} drives: this program writes a {} with up to {}; write further [[axes]] yourself",
                kind.name(),
                axes.len()
            ));
        }
        while axes.len() > drives {
            axes.remove(axes.len() - 1);
        }
    }
    let drives = axes.len();
    let shared = tables.len();
    tables.extend(axes.iter_mut().map(|axis| axis as &mut dyn TableLike));
    for (number, table) in tables.into_iter().enumerate() {
        let gear = wishes.gear.filter(|_| number < shared + geared(kind));
        for (key, value) in [("pitch_mm", wishes.pitch_mm), ("gear", gear)] {
            let place = table.get_mut(key).and_then(Item::as_value_mut);
            if let (Some(place), Some(value)) = (place, value) {
                let mut value = Value::from(value);
                *value.decor_mut() = place.decor().clone();
                *place = value;
            }
        }
    }
    for list in ["joint_speed", "joint_acceleration"] {
        let list = document.get_mut("motion").and_then(|motion| motion.get_mut(list));
        if let Some(values) = list.and_then(Item::as_array_mut) {
            while values.len() > drives {
                values.remove(values.len() - 1);
            }
        }
    }
    // Where no axis has a gear, the axes share it.
    if let (Some(gear), Some(Item::Table(shared))) = (wishes.gear, document.get_mut("axis_defaults"))
        && geared(kind) == AXES
    {
        shared.entry("gear").or_insert(toml_edit::value(gear));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::reading::configuration;
    use etherpen::robots::Geometry;

    fn sized(kind: Kind, sizes: &[(&str, f64)]) -> Wishes {
        let mut wishes = Wishes::default();
        for (name, mm) in sizes {
            let index = SIZES.iter().position(|size| size.name == *name).unwrap();
            assert!(SIZES[index].suits(kind));
            wishes.sizes_mm[index] = Some(*mm);
        }
        wishes
    }

    #[test]
    fn a_machine_without_wishes_is_the_bundled_one() {
        for kind in Kind::ALL {
            let text = compose(kind, &Wishes::default()).unwrap();
            assert!(MACHINES.iter().any(|machine| machine.text == text), "{}", kind.name());
        }
    }

    #[test]
    fn machines_of_other_sizes_pass_the_check_and_keep_their_comments() {
        let wishes = [
            (
                Kind::Gantry,
                sized(Kind::Gantry, &[("width", 1200.0), ("depth", 800.0), ("height", 90.0)]),
            ),
            (Kind::Gantry, sized(Kind::Gantry, &[("width", 120.0), ("depth", 80.0)])),
            (Kind::CoreXy, sized(Kind::CoreXy, &[("width", 250.0), ("depth", 500.0)])),
            (
                Kind::Scara,
                sized(Kind::Scara, &[("inner-link", 325.0), ("outer-link", 275.0)]),
            ),
            (
                Kind::Scara,
                sized(
                    Kind::Scara,
                    &[("inner-link", 150.0), ("outer-link", 150.0), ("height", 80.0)],
                ),
            ),
            (
                Kind::LinearDelta,
                sized(Kind::LinearDelta, &[("radius", 250.0), ("rod", 480.0)]),
            ),
            (
                Kind::LinearDelta,
                sized(Kind::LinearDelta, &[("radius", 90.0), ("rod", 200.0)]),
            ),
        ];
        for (kind, wishes) in wishes {
            let text = compose(kind, &wishes).unwrap_or_else(|error| panic!("{wishes:?}: {error}"));
            assert_eq!(check(&text), [], "{text}");
            assert!(text.contains("# "), "comments");
            if kind == Kind::Gantry {
                let ranges = configuration(&text).unwrap().geometry.ranges_rad();
                let axes = configuration(&text).unwrap().axes;
                for (axis, [low, high]) in axes.iter().zip(ranges) {
                    assert!(axis.home.travel_max_rad > high - low, "{text}");
                }
            }
            if let (Geometry::Gantry(of), Some(width)) = (configuration(&text).unwrap().geometry, wishes.sizes_mm[0]) {
                assert_eq!(of.x_range_mm, [0.0, width]);
            }
        }
    }

    #[test]
    fn pitch_gear_and_drives_are_written() {
        let wishes = Wishes {
            pitch_mm: Some(60.0),
            gear: Some(3.0),
            drives: Some(3),
            ..Wishes::default()
        };
        let text = compose(Kind::Gantry, &wishes).unwrap();
        assert!(
            text.matches("pitch_mm = 60.0").count() == 3 && text.contains("gear = 3.0"),
            "{text}"
        );
        let scara = compose(
            Kind::Scara,
            &Wishes {
                gear: None,
                pitch_mm: None,
                ..wishes.clone()
            },
        )
        .unwrap();
        assert_eq!(configuration(&scara).unwrap().bus.drives, 3);
        let geared = compose(
            Kind::Scara,
            &Wishes {
                gear: Some(80.0),
                ..Wishes::default()
            },
        )
        .unwrap();
        let [shoulder, elbow, height, tool] = configuration(&geared).unwrap().axes.map(|axis| axis.gear);
        let [.., height_before, tool_before] = MACHINES[3].load().unwrap().axes.map(|axis| axis.gear);
        assert_eq!((shoulder, elbow), (80.0, 80.0));
        assert_eq!((height, tool), (height_before, tool_before));
        let belts = compose(Kind::CoreXy, &Wishes { drives: None, ..wishes }).unwrap();
        assert!(belts.contains("gear = 3.0"), "{belts}");
    }

    #[test]
    fn what_does_not_suit_the_kind_is_refused() {
        let refusal = |kind, wishes: Wishes| compose(kind, &wishes).unwrap_err();
        let rod = sized(Kind::LinearDelta, &[("rod", 300.0)]);
        assert_eq!(refusal(Kind::Gantry, rod), "a gantry has no rod");
        let zero = sized(Kind::Gantry, &[("width", 0.0)]);
        assert!(refusal(Kind::Gantry, zero).contains("more than 0"));
        let two = Wishes {
            drives: Some(2),
            ..Wishes::default()
        };
        assert!(refusal(Kind::Gantry, two).contains("3 to 4 axes"));
        let pitch = Wishes {
            pitch_mm: Some(5.0),
            ..Wishes::default()
        };
        assert!(refusal(Kind::Delta, pitch).contains("no linear axis"));
    }
}

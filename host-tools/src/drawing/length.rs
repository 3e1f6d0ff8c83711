//! Lengths with units, and page sizes, as users write them.
//!
//! A user unit of an SVG is 1/96 inch; a bare number on the command line is a millimetre. All other units have their
//! common meaning (CSS Values and Units, absolute lengths; ISO 216 for the page names).

/// Millimetres per inch.
pub(crate) const MM_PER_INCH: f64 = 25.4;
/// Millimetres per SVG user unit, 1/96 inch.
pub(crate) const MM_PER_PX: f64 = MM_PER_INCH / 96.0;
/// Longest length accepted, mm.
const LENGTH_MAX_MM: f64 = 1e6;

/// Page names with width and height, mm, portrait.
const PAGES: [(&str, [f64; 2]); 12] = [
    ("a0", [841.0, 1189.0]),
    ("a1", [594.0, 841.0]),
    ("a2", [420.0, 594.0]),
    ("a3", [297.0, 420.0]),
    ("a4", [210.0, 297.0]),
    ("a5", [148.0, 210.0]),
    ("a6", [105.0, 148.0]),
    ("a7", [74.0, 105.0]),
    ("letter", [215.9, 279.4]),
    ("legal", [215.9, 355.6]),
    ("tabloid", [279.4, 431.8]),
    ("postcard", [100.0, 148.0]),
];

/// Millimetres of a length such as `12`, `1.2cm`, `0.5in`, `72pt`; `bare_mm` is the unit of a bare number, mm.
pub(crate) fn to_mm(text: &str, bare_mm: f64) -> Option<f64> {
    let text = text.trim();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let scale = match text.get(digits.len()..)?.to_ascii_lowercase().as_str() {
        "" => bare_mm,
        "mm" => 1.0,
        "cm" => 10.0,
        "m" => 1_000.0,
        "in" => MM_PER_INCH,
        "pt" => MM_PER_INCH / 72.0,
        "pc" => MM_PER_INCH / 6.0,
        "px" => MM_PER_PX,
        "q" => 0.25,
        _ => return None,
    };
    let value = digits.trim().parse::<f64>().ok()? * scale;
    (value.is_finite() && value.abs() <= LENGTH_MAX_MM).then_some(value)
}

/// Parses a length of the command line, mm: not negative.
///
/// # Errors
/// Text that describes what is accepted.
pub fn parse_length_mm(text: &str) -> Result<f64, String> {
    to_mm(text, 1.0)
        .filter(|value| *value >= 0.0)
        .ok_or_else(|| "a length is needed, such as 12, 12mm, 1.2cm, 0.5in or 36pt".to_owned())
}

/// Parses a width and height of the command line, mm: `120x80mm`, `5x7in`, one length for a square, or a page name such
/// as `a5` and `a5-landscape`.
///
/// # Errors
/// Text that describes what is accepted.
pub fn parse_size_mm(text: &str) -> Result<[f64; 2], String> {
    let name = text.trim().to_ascii_lowercase();
    let (page, lies) = match name.strip_suffix("-landscape") {
        Some(page) => (page, true),
        None => (name.as_str(), false),
    };
    if let Some((_, [width, height])) = PAGES.iter().find(|(known, _)| *known == page) {
        return Ok(if lies { [*height, *width] } else { [*width, *height] });
    }
    let both = name.split_once('x').filter(|(_, height)| !height.is_empty());
    let size = match both {
        Some((width, height)) => {
            let unit = height.trim_start_matches(|c: char| !c.is_ascii_alphabetic());
            let bare_mm = to_mm(&format!("1{unit}"), 1.0).unwrap_or(1.0);
            [to_mm(width, bare_mm), to_mm(height, 1.0)]
        }
        None => [to_mm(&name, 1.0); 2],
    };
    match size {
        [Some(width), Some(height)] if width > 0.0 && height > 0.0 => Ok([width, height]),
        _ => Err("a size is needed, such as 120x80mm, 5x7in, 90mm, a5 or a5-landscape".to_owned()),
    }
}

/// Parses two coordinates of the command line, mm: `10,20`, `1cm,2cm`; they may be negative.
///
/// # Errors
/// Text that describes what is accepted.
pub fn parse_point_mm(text: &str) -> Result<[f64; 2], String> {
    let parsed = text.split_once(',').map(|(x, y)| [to_mm(x, 1.0), to_mm(y, 1.0)]);
    match parsed {
        Some([Some(x), Some(y)]) => Ok([x, y]),
        _ => Err("two lengths are needed, such as 10,20 or 1cm,2cm".to_owned()),
    }
}

/// Parses a duration of the command line, s: `90`, `90s`, `3m`, `3min`, `1h`.
///
/// # Errors
/// Text that describes what is accepted.
pub fn parse_duration_s(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let scale = match text.get(digits.len()..) {
        Some("" | "s") => Some(1.0),
        Some("m" | "min") => Some(60.0),
        Some("h") => Some(3_600.0),
        _ => None,
    };
    match (digits.parse::<f64>(), scale) {
        (Ok(value), Some(scale)) if value > 0.0 && value * scale <= 86_400.0 => Ok(value * scale),
        _ => Err("a duration above 0 and up to a day is needed, such as 90, 90s, 3m or 1h".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_length_takes_a_unit() {
        for (text, mm) in [
            ("12", 12.0),
            ("12mm", 12.0),
            ("1.2 cm", 12.0),
            ("1in", 25.4),
            ("72pt", 25.4),
            ("96px", 25.4),
            ("4q", 1.0),
        ] {
            assert!((parse_length_mm(text).expect(text) - mm).abs() < 1e-9, "{text}");
        }
        for text in ["", "mm", "-1", "nan", "inf", "1e99", "12 parsec", "1,2"] {
            assert!(parse_length_mm(text).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes_are_pages_pairs_or_squares() {
        for (text, size) in [
            ("a5", [148.0, 210.0]),
            ("A5-landscape", [210.0, 148.0]),
            ("120x80mm", [120.0, 80.0]),
            ("12x8cm", [120.0, 80.0]),
            ("120mmx8cm", [120.0, 80.0]),
            ("90", [90.0, 90.0]),
        ] {
            assert_eq!(parse_size_mm(text), Ok(size), "{text}");
        }
        for text in ["a99", "0x3", "x", "3x", "-3x4"] {
            assert!(parse_size_mm(text).is_err(), "{text}");
        }
    }

    #[test]
    fn durations_and_points_are_read() {
        assert_eq!(parse_duration_s("3m"), Ok(180.0));
        assert_eq!(parse_duration_s("90"), Ok(90.0));
        assert!(parse_duration_s("0").is_err() && parse_duration_s("2d").is_err());
        assert_eq!(parse_point_mm("-10,2cm"), Ok([-10.0, 20.0]));
        assert!(parse_point_mm("10").is_err());
    }
}

//! Vector files as programs write them, and malformed ones.

use super::*;

fn svg(head: &str, body: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" \
         xmlns:inkscape=\"{INKSCAPE}\" {head}>{body}</svg>"
    )
}

fn read(head: &str, body: &str) -> Artwork {
    read_svg(&svg(head, body)).expect("an SVG")
}

fn points(artwork: &Artwork) -> Vec<Vec<[f64; 2]>> {
    let rounded = |point: &Point| point.map(|mm| (mm * 1e3).round() / 1e3);
    let line = |stroke: &LayerStroke| stroke.stroke.points.iter().map(rounded).collect();
    artwork.strokes.iter().map(line).collect()
}

#[test]
fn units_and_boxes_give_millimetres() {
    let line = "<line x1='10' y1='20' x2='30' y2='20' stroke='red'/>";
    for (head, expected) in [
        (
            "width='100mm' height='100mm' viewBox='0 0 100 100'",
            [[10.0, 20.0], [30.0, 20.0]],
        ),
        (
            "width='10cm' height='10cm' viewBox='0 0 50 50'",
            [[20.0, 40.0], [60.0, 40.0]],
        ),
        ("width='960' height='960'", [[2.646, 5.292], [7.938, 5.292]]),
        ("viewBox='0 0 100 100'", [[2.646, 5.292], [7.938, 5.292]]),
        (
            "width='100mm' height='100mm' viewBox='10 20 100 100'",
            [[0.0, 0.0], [20.0, 0.0]],
        ),
    ] {
        assert_eq!(points(&read(head, line)), [expected], "{head}");
    }
    let warned = |head: &str| read(head, line).warnings.iter().any(|text| text.contains("no size"));
    assert!(warned("viewBox='0 0 100 100'") && warned(""));
    assert!(!warned("width='10cm' height='10cm'"));
}

#[test]
fn user_units_are_found_again() {
    for head in [
        "width='100mm' height='80mm' viewBox='0 0 1000 800'",
        "width='100mm' height='80mm' viewBox='-5 7 50 50'",
        "width='300' height='300'",
        "viewBox='3 4 300 200'",
        "width='100mm' height='80mm' viewBox='0 0 10 10' preserveAspectRatio='none'",
        "width='100mm' height='80mm' viewBox='0 0 10 10' preserveAspectRatio='xMinYMax slice'",
    ] {
        let artwork = read(head, "<path d='M4 5L8 6' stroke='red'/>");
        let space = &artwork.user_space;
        let back: Vec<Point> = (artwork.strokes[0].stroke.points.iter())
            .map(|point| [0, 1].map(|k| space.origin[k] + point[k] * space.units_per_mm[k]))
            .collect();
        for (at, wanted) in back.iter().zip([[4.0, 5.0], [8.0, 6.0]]) {
            assert!(line::distance(*at, wanted) < 1e-4, "{head}: {at:?}");
        }
    }
}

#[test]
fn every_shape_is_drawn_whatever_its_style() {
    let body = "<style>.a{fill:none;stroke:blue}</style><g transform='translate(10 0) scale(2)'>\
        <line x1='0' y1='0' x2='1' y2='0'/><polyline points='0,0 1,1 2,0' fill='none'/>\
        <polygon points='0,0 1,1 2,0' class='a'/><rect width='3' height='2' fill='red' stroke='none'/></g>\
        <circle r='5' cx='9' cy='9'/><ellipse rx='5' ry='2'/><path d='M0 0h5m1 0h4'/>\
        <defs><path id='p' d='M0 0v3'/></defs><use xlink:href='#p' x='7'/>\
        <path d='M1 1h8' stroke-width='0.01'/>";
    let artwork = read("width='100mm' height='100mm' viewBox='0 0 100 100'", body);
    let all = points(&artwork);
    assert_eq!(all.len(), 10, "{all:?}");
    assert_eq!(all[0], [[10.0, 0.0], [12.0, 0.0]]);
    assert_eq!(all[1], [[10.0, 0.0], [12.0, 2.0], [14.0, 0.0]]);
    assert_eq!((all[2].len(), all[3].len()), (4, 5));
    assert_eq!(all[6], [[0.0, 0.0], [5.0, 0.0]]);
    assert_eq!(all[8], [[7.0, 0.0], [7.0, 3.0]]);
    for point in &all[4] {
        assert!(
            (line::distance(*point, [9.0, 9.0]) - 5.0).abs() < TOLERANCE_MM + 0.002,
            "{point:?}"
        );
    }
    let hidden = "<g display='none'><path d='M0 0h5'/></g><path d='M0 0h5' visibility='hidden'/>";
    assert_eq!(read("width='10' height='10'", hidden).strokes.len(), 0);
}

#[test]
fn layers_are_groups_with_labels_or_colours() {
    let body = "<g inkscape:groupmode='layer' inkscape:label='Empty'/>\
        <g inkscape:groupmode='layer' inkscape:label='Ink' id='l1'><path d='M0 0h5' stroke='#00f'/></g>\
        <g inkscape:groupmode='layer' inkscape:label='Wash'><g><path d='M0 0h6'/></g></g>";
    let names = |artwork: &Artwork| {
        artwork
            .layers
            .iter()
            .map(|layer| layer.name.clone())
            .collect::<Vec<_>>()
    };
    let artwork = read("width='10' height='10'", body);
    assert_eq!(names(&artwork), ["Ink", "Wash"]);
    assert_eq!(artwork.layers[0].colour, [0, 0, 255]);
    assert_eq!(
        artwork.strokes.iter().map(|stroke| stroke.layer).collect::<Vec<_>>(),
        [0, 1]
    );
    let body = "<path d='M0 0h5' stroke='#00f'/><path d='M0 0h6' stroke='red'/><path d='M0 0h7' stroke='blue'/>";
    let artwork = read("width='10' height='10'", body);
    assert_eq!(names(&artwork), ["#0000ff", "#ff0000"]);
}

#[test]
fn dashes_clips_and_paper_are_what_they_look_like() {
    let head = "width='100mm' height='100mm' viewBox='0 0 100 100'";
    let dashed = read(
        head,
        "<path d='M0 0h10' stroke='red' stroke-dasharray='3 1' stroke-dashoffset='1'/>",
    );
    assert_eq!(
        points(&dashed),
        [
            [[0.0, 0.0], [2.0, 0.0]],
            [[3.0, 0.0], [6.0, 0.0]],
            [[7.0, 0.0], [10.0, 0.0]]
        ]
    );
    let body = "<clipPath id='c'><rect x='2' y='-1' width='3' height='9'/></clipPath>\
        <g clip-path='url(#c)' transform='scale(2)'><path d='M0 0h10'/></g>";
    assert_eq!(points(&read(head, body)), [[[4.0, 0.0], [10.0, 0.0]]]);
    let paper = read(
        head,
        "<rect width='100%' height='100%' fill='#fff'/><rect width='100' height='100' stroke='red'/>",
    );
    assert_eq!(paper.strokes.len(), 1);
    assert!(paper.warnings.iter().any(|text| text.contains("paper")));
}

#[test]
fn what_is_left_out_is_said() {
    let body = "<path d='M0 0 L NaN 5'/><polyline points='0,0 nan,3 4,5'/>\
        <image href='no/such.png' width='3' height='3'/><path d='M0 0h5'/>";
    let artwork = read("width='10' height='10'", body);
    assert_eq!(artwork.strokes.len(), 1, "{:?}", points(&artwork));
    for part in ["path parsing", "Polyline", "<image>"] {
        assert!(
            artwork.warnings.iter().any(|text| text.contains(part)),
            "{part}: {:?}",
            artwork.warnings
        );
    }
}

#[test]
fn files_that_go_round_in_circles_end() {
    let cycles = "<g id='a'><use xlink:href='#b'/></g><g id='b'><use xlink:href='#a'/></g><path d='M0 0h5'/>";
    let head = "width='10' height='10'";
    assert_eq!(read_svg(&svg(head, cycles)).err(), Some(DrawingError::SvgCycle));
    let clips = "<clipPath id='c' clip-path='url(#c)'><path d='M0 0h9v9z'/></clipPath>\
        <g clip-path='url(#c)'><path d='M0 0h5'/></g><path d='M0 0h5'/>";
    assert!((1..=2).contains(&read(head, clips).strokes.len()));
    let deep = format!("{}<path d='M0 0h5'/>{}", "<g>".repeat(100_000), "</g>".repeat(100_000));
    assert!(read_svg(&svg("width='10' height='10'", &deep)).is_err());
    let bomb = "<!DOCTYPE svg [<!ENTITY a 'x'><!ENTITY b '&a;&b;'>]><svg xmlns='http://www.w3.org/2000/svg'>&b;</svg>";
    assert!(read_svg(bomb).is_err());
    assert_eq!(
        read_svg("<svg").err(),
        Some(DrawingError::SvgSyntax { line: 1, column: 1 })
    );
}

/// Text of one letter, 100 units high, drawn with a font.
fn letter(letter: &str, attributes: &str, font: &TextFont) -> Artwork {
    let text = format!("<text x='10' y='120' font-size='100' {attributes}>{letter}</text>");
    let head = "width='200mm' height='200mm' viewBox='0 0 200 200'";
    read_svg_with(&svg(head, &text), font).expect("an SVG")
}

#[test]
fn single_stroke_letters_are_the_pens_own_way() {
    // A vertical bar and a cross bar of T, and a round o that ends where it began.
    let artwork = letter("T", "", &TextFont::SingleStroke);
    let lines = points(&artwork);
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(lines.iter().all(|line| line.len() == 2), "no way back: {lines:?}");
    let bar = &lines[0];
    assert!(
        (bar[0][1] - 48.0).abs() < 0.2 && (bar[1][1] - 120.0).abs() < 0.2,
        "capitals are 0.72 of the size: {bar:?}"
    );
    assert_eq!(bar[0][0], bar[1][0]);
    let round = points(&letter("o", "", &TextFont::SingleStroke));
    assert_eq!((round.len(), round[0].first()), (1, round[0].last()));
    // The dots of a letter with a mark.
    assert_eq!(points(&letter("\u{e4}", "", &TextFont::SingleStroke)).len(), 4);
    assert_eq!(artwork.warnings, Vec::<String>::new());
}

#[test]
fn text_keeps_its_place_anchor_and_transform() {
    let left = |attributes: &str| {
        let lines = points(&letter("HH", attributes, &TextFont::SingleStroke));
        lines
            .concat()
            .iter()
            .fold(f64::INFINITY, |least, point| least.min(point[0]))
    };
    let width = left("text-anchor='start'") - left("text-anchor='end'");
    assert!(width > 100.0, "{width}");
    assert!((left("") - left("text-anchor='middle'") - 0.5 * width).abs() < 0.01);
    assert!((left("transform='translate(7 3)'") - left("") - 7.0).abs() < 0.01);
}

#[test]
fn outlines_are_closed_and_a_missing_font_is_told() {
    let font = std::env::temp_dir().join(format!("etherpen-font-{}.ttf", std::process::id()));
    std::fs::write(&font, include_bytes!("../../../assets/hershey/single-stroke.ttf")).expect("a file");
    let file = FontFile::read(&font).expect("a font");
    // The two strokes of an L, with the line back to their start.
    let lines = points(&letter("L", "", &TextFont::File(file)));
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(
        lines.iter().all(|line| line.len() == 3 && line.first() == line.last()),
        "{lines:?}"
    );
    std::fs::write(&font, "no font").expect("a file");
    assert!(FontFile::read(&font).is_err_and(|cause| cause.contains("no TrueType")));
    std::fs::remove_file(&font).expect("the file");
    let none = TextFont::File(FontFile::none());
    let artwork = letter("L", "", &none);
    assert!(artwork.strokes.is_empty());
    assert!(
        artwork.warnings.iter().any(|text| text.contains("--single-stroke")),
        "{:?}",
        artwork.warnings
    );
}

#[test]
fn a_shape_with_a_number_that_no_drawing_has_is_refused_and_named() {
    let text = "<svg xmlns='http://www.w3.org/2000/svg' width='100mm' height='100mm' viewBox='0 0 100 100'>\n\
        <path d='M1 1h9'/>\n<path d='M0 0L1e39 10'/></svg>";
    let far = |line| {
        Some(DrawingError::FarAway {
            place: FilePlace::Line(line),
        })
    };
    assert_eq!(read_svg(text).err(), far(3));
    // An arc with so many pieces that a library would take hours; numbers without spaces between them.
    for arc in ["M1 1A9e25-1e15 1e9 1 0-1e6 1e30", "M1 1a.5.5 0 0 1-1e10.5"] {
        let text = format!("<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 9 9'><path\nd='{arc}'/></svg>");
        assert_eq!(read_svg(&text).err(), far(1), "{arc}");
    }
}

#[test]
fn a_size_that_is_no_length_is_refused() {
    for size in ["NaN", "wide", "", "inf", "1e999mm"] {
        let text =
            format!("<svg xmlns='http://www.w3.org/2000/svg' width='{size}' height='9mm'><path d='M0 0h9'/></svg>");
        assert_eq!(read_svg(&text), Err(DrawingError::SvgSize), "{size}");
    }
    for size in ["100%", "auto", " 12.5mm ", "3e1", "20"] {
        let text =
            format!("<svg xmlns='http://www.w3.org/2000/svg' width='{size}' height='9mm'><path d='M0 0h9'/></svg>");
        assert!(read_svg(&text).is_ok(), "{size}");
    }
}

#[test]
fn characters_that_no_font_has_are_named_and_leave_their_place_free() {
    let font = &TextFont::SingleStroke;
    let warned = |artwork: &Artwork, part: &str| artwork.warnings.iter().any(|warning| warning.contains(part));
    let lines = |artwork: &Artwork| points(artwork).len();
    for missing in ["\u{6f22}", "&#x6f22;", "&#28450;"] {
        let artwork = letter(&format!("T{missing}L"), "", font);
        assert_eq!(
            lines(&artwork),
            lines(&letter("T", "", font)) + lines(&letter("L", "", font)),
            "{missing}"
        );
        assert!(
            warned(&artwork, "\u{6f22} (U+6F22)"),
            "{missing}: {:?}",
            artwork.warnings
        );
        assert_eq!(points(&artwork), points(&letter("T L", "", font)), "{missing}");
    }
    // Labels and identifiers with such a character are not text.
    let text = "<text x='1' y='9' font-size='9'>T\u{6f22}</text><path id='\u{6f22}' d='M0 0h5'/><use xlink:href='#\u{6f22}' y='3'/>";
    let artwork = read_svg_with(&svg("width='50' height='50'", text), font).expect("an SVG");
    assert_eq!(lines(&artwork), 2 + 2, "{:?}", artwork.warnings);
}

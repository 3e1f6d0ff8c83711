//! Any bytes as a file to draw.
//!
//! Text is drawn with letters of single lines: outlines would depend on the fonts of the computer.

use host_tools::drawing::{Input, TextFont, load_content};
use image::{DynamicImage, ImageFormat, RgbImage, RgbaImage};
use std::io::Cursor;
use std::path::Path;

/// Largest coordinate of a drawing, mm, with the rounding of a curve's chords.
const PLACE_MAX_MM: f64 = 1.001e6;
/// Most pixels of a picture while fuzzing; `tests/limits.rs` reads larger ones.
const PIXELS_MAX: u64 = 1 << 20;

/// Reads a file by its name.
fn read(name: &str, bytes: &[u8]) {
    match load_content(Path::new(name), bytes, &TextFont::SingleStroke) {
        Err(error) => assert!(!error.to_string().is_empty()),
        Ok(input) => drop(count(input)),
    }
}

/// Counts points or pixels, and checks that the points are finite and near.
pub(crate) fn count(input: Input) -> usize {
    match input {
        Input::Photograph(picture) => picture.len() / 3,
        Input::Artwork(artwork) => {
            assert!(artwork.warnings.len() <= 20);
            let layers = artwork.layers.len();
            assert!(artwork.strokes.iter().all(|stroke| stroke.layer < layers));
            near(
                artwork
                    .strokes
                    .iter()
                    .flat_map(|stroke| stroke.stroke.points.iter().copied()),
            )
        }
        Input::Drawing(drawing) => near(drawing.strokes.iter().flat_map(|stroke| stroke.points.iter().copied())),
        Input::Path(path) => {
            assert_eq!(path.lines.len(), path.vertices.len());
            near(
                path.vertices
                    .iter()
                    .map(|vertex| [vertex.position.x_mm, vertex.position.y_mm]),
            )
        }
    }
}

/// Counts points, all of which are finite and near.
fn near(points: impl Iterator<Item = [f64; 2]>) -> usize {
    let is_near = |point: &[f64; 2]| point.iter().all(|mm| mm.abs() <= PLACE_MAX_MM);
    points.inspect(|point| assert!(is_near(point), "{point:?}")).count()
}

/// Reads an SVG.
pub(crate) fn svg(bytes: &[u8]) {
    read("fuzz.svg", bytes);
}

/// Shapes, styles, text, references, clip paths, layers, and the first lines of a sample.
pub(crate) fn svg_seeds() -> Vec<Vec<u8>> {
    let head = "<svg xmlns='http://www.w3.org/2000/svg' xmlns:xlink='http://www.w3.org/1999/xlink' \
                xmlns:inkscape='http://www.inkscape.org/namespaces/inkscape' width='90mm' height='90mm' viewBox='0 0 90 90'>";
    let bodies = [
        "<path d='M1 1h5v-5l2 2zC1 2 3 4 5 6S7 8 9 9Q1 2 3 4T5 6A5 6 30 1 0 9 9'/>",
        "<rect x='1' y='2' width='30' height='40' rx='3'/><circle cx='9' cy='9' r='5'/><ellipse rx='3' ry='4'/>",
        "<polyline points='1,2 3,4 5 6'/><polygon points='1 2 3 4 5 6'/><line x2='9' y2='9'/>",
        "<g transform='rotate(30 1 2) scale(2,3) translate(4) skewX(5) matrix(1 0 0 1 2 3)'><path d='M0 0L9 9'/></g>",
        "<style>.a{stroke:#f00;stroke-dasharray:1 2}</style><path class='a' d='M0 0H80'/>",
        "<text x='5' y='9' font-size='8'>Robot <tspan dy='3'>4</tspan></text>",
        "<defs><path id='p' d='M0 0h9'/></defs><use xlink:href='#p' x='3'/><use href='#p'/>",
        "<clipPath id='c'><circle r='20'/></clipPath><g clip-path='url(#c)'><path d='M0 0L80 80'/></g>",
        "<g inkscape:groupmode='layer' inkscape:label='one'><path stroke='#00f' d='M0 0h9'/></g>",
        "<svg x='3' viewBox='0 0 5 5' preserveAspectRatio='xMinYMid slice'><path d='M0 0h9'/></svg><image href='a.png'/>",
        "<marker id='m'><path d='M0 0h1'/></marker><path marker-end='url(#m)' d='M0 0h9'/><mask id='k'/>",
    ];
    let mut seeds: Vec<Vec<u8>> = bodies
        .iter()
        .map(|body| format!("{head}{body}</svg>").into_bytes())
        .collect();
    let sample = include_str!("../../../samples/vectors/grass.svg");
    let lines: Vec<&str> = sample.lines().take(12).collect();
    seeds.push(format!("{}\n</svg>", lines.join("\n")).into_bytes());
    seeds.push(
        b"<!DOCTYPE svg [<!ENTITY a '<path d=\"M0 0h9\"/>'>]><svg xmlns='http://www.w3.org/2000/svg'>&a;</svg>"
            .to_vec(),
    );
    seeds
}

/// Reads G-code.
pub(crate) fn gcode(bytes: &[u8]) {
    read("fuzz.gcode", bytes);
}

/// Every dialect of the pen, arcs, units and offsets.
pub(crate) fn gcode_seeds() -> Vec<Vec<u8>> {
    let texts = [
        "G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F100\nX10\nG0 Z5\nG0 X10 Y5\nG1 Z-1\nG1 X0\nG0 Z5\n",
        "M300 S50\nG1 X0 Y0\nM300 S30.0\nG4 P150\nG1 X10 Y0\nM300 S50\n",
        "N10 G0 X0Y0\nM3 S1000\nG1X10\nM5\nG0Y5 *33\nM3\nG1X0\nM5 (up) ; done\n",
        "G20\nM3\nG2 X0 Y0 I1 J0\nG3 X1 Y1 R-3\nM5\nT2 M6\nG28\n",
        "%\n/G91\nG0 X5 Y5\nG92 X0 Y0\nG1 X1\nM117\nG91.1\n",
    ];
    texts.iter().map(|text| text.as_bytes().to_vec()).collect()
}

/// Reads HPGL.
pub(crate) fn hpgl(bytes: &[u8]) {
    read("fuzz.hpgl", bytes);
}

/// Pens, moves and every shape.
pub(crate) fn hpgl_seeds() -> Vec<Vec<u8>> {
    let texts = [
        "IN;SP1;PU400,0;PD800,0,800,400;PU;SP2;PA0 0;PD;PR40,0;PR0,40;PU;PA0,0;CI400;EA80,80;VS10;LBhi;\u{3}PU;",
        "IN;SP1;PD0,0;AA10,10,90;AR5,5,-180;ER40,40;SC;DT\u{3};CO text;PU;SP0;PG;",
        "PEabc;PD40,40;",
    ];
    texts.iter().map(|text| text.as_bytes().to_vec()).collect()
}

/// Reads a list of coordinates.
pub(crate) fn csv(bytes: &[u8]) {
    read("fuzz.csv", bytes);
}

/// Both headings, and the beginnings of the samples.
pub(crate) fn csv_seeds() -> Vec<Vec<u8>> {
    let beginning = |text: &str| text.lines().take(8).fold(String::new(), |all, line| all + line + "\n");
    let texts = [
        "x_mm,y_mm,pen\n1,1,0\n2,1,1\n3,1,1\n\n5,5,0\n9,9,0\n9,8,1\n".to_owned(),
        "x_mm,y_mm,z_mm,pen\n0,0,-847,0\n0,0,-850,0\n9.5,0,-850,1\n".to_owned(),
        "\u{feff}x_mm, y_mm, pen\r\n1,2,1\r\n3,4e0,1\r\n".to_owned(),
        beginning(include_str!("../../../samples/strokes.csv")),
        beginning(include_str!("../../../samples/motion/circle.csv")),
    ];
    texts.into_iter().map(String::into_bytes).collect()
}

/// Reads a picture, unless its header announces so many pixels that the fuzzer would only decode.
pub(crate) fn picture(bytes: &[u8]) {
    if pixels(bytes).is_none_or(|pixels| pixels <= PIXELS_MAX) {
        read("fuzz.png", bytes);
    }
}

/// Pixels that the header of a picture announces.
fn pixels(bytes: &[u8]) -> Option<u64> {
    let reader = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok()?;
    let (width, height) = reader.into_dimensions().ok()?;
    Some(u64::from(width) * u64::from(height))
}

/// Small pictures of every kind of pixel, by the encoders of the product's dependency.
pub(crate) fn picture_seeds() -> Vec<Vec<u8>> {
    let colour = RgbImage::from_fn(17, 19, |x, y| image::Rgb([9 * x as u8, 7 * y as u8, 128]));
    let clear = RgbaImage::from_fn(18, 16, |x, y| image::Rgba([9 * x as u8, 7 * y as u8, 0, 13 * x as u8]));
    let grey = DynamicImage::ImageRgb8(colour.clone()).into_luma8();
    let deep = DynamicImage::ImageRgb8(colour.clone()).into_luma16();
    let pictures = [
        (DynamicImage::ImageRgb8(colour.clone()), ImageFormat::Png),
        (DynamicImage::ImageRgba8(clear), ImageFormat::Png),
        (DynamicImage::ImageLuma8(grey.clone()), ImageFormat::Png),
        (DynamicImage::ImageLuma16(deep), ImageFormat::Png),
        (DynamicImage::ImageRgb8(colour), ImageFormat::Jpeg),
        (DynamicImage::ImageLuma8(grey), ImageFormat::Jpeg),
    ];
    let written = pictures.into_iter().map(|(picture, format)| {
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).expect("a picture is written");
        bytes.into_inner()
    });
    written.collect()
}

//! Small files that demand much: every reader refuses them or converts them into a bounded drawing.

use super::plot::PLACE_MAX_MM;
use super::{DrawingError, FilePlace, Input, TextFont, load_content};
use crate::random::Lcg;
use std::fmt::Write;
use std::path::Path;

/// Most points that any of these files may become.
const POINTS_MAX: usize = 20_000_000;
/// Files of each kind.
const FILES: u64 = 150;

/// Random words and numbers, which depend on a seed alone.
struct Chance(Lcg);

impl Chance {
    fn below(&mut self, count: usize) -> usize {
        self.0.below(count)
    }

    fn of<'a>(&mut self, words: &[&'a str]) -> &'a str {
        words[self.below(words.len())]
    }

    /// A number as in a hostile file.
    fn number(&mut self) -> &'static str {
        self.of(&[
            "0",
            "1",
            "-7.5",
            "50",
            "1e3",
            "1e6",
            "-1e6",
            "1e9",
            "-1e15",
            "1e30",
            "-1e30",
            "3.4e38",
            "1e39",
            "1e308",
            "-1e308",
            "1e999",
            "1e-30",
            "1e-308",
            "NaN",
            "inf",
            "-inf",
            "99999999999999999999999999",
            "0.000000000000001",
            "2147483648",
        ])
    }
}

fn read(name: &str, content: &[u8]) -> Result<Input, DrawingError> {
    load_content(Path::new(name), content, &TextFont::SingleStroke)
}

/// Reads a file and checks that the result is finite, near and bounded.
fn assert_bounded(name: &str, content: &str) {
    let result = read(name, content.as_bytes());
    let shown: String = content.chars().take(400).collect();
    let points: Vec<[f64; 2]> = match result {
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return;
        }
        Ok(Input::Artwork(artwork)) => {
            assert!(artwork.warnings.len() <= 20, "{shown}");
            artwork
                .strokes
                .into_iter()
                .flat_map(|stroke| stroke.stroke.points)
                .collect()
        }
        Ok(Input::Drawing(drawing)) => drawing.strokes.into_iter().flat_map(|stroke| stroke.points).collect(),
        Ok(Input::Path(path)) => path
            .vertices
            .iter()
            .map(|vertex| [vertex.position.x_mm, vertex.position.y_mm])
            .collect(),
        Ok(Input::Photograph(picture)) => panic!("{} pixels of a text", picture.len()),
    };
    assert!(points.len() <= POINTS_MAX, "{} points: {shown}", points.len());
    // A chord of a curve lies within the curve's corners, up to rounding.
    assert!(
        points.iter().flatten().all(|mm| mm.abs() <= 1.001 * PLACE_MAX_MM),
        "{shown}"
    );
}

const HEAD: &str = "<svg xmlns='http://www.w3.org/2000/svg' xmlns:xlink='http://www.w3.org/1999/xlink'";

#[test]
fn a_curve_that_would_need_terabytes_is_refused_with_its_line() {
    let text = format!(
        "{HEAD} width='100mm' height='100mm' viewBox='0 0 100 100'>\n<path d='M1 1h5'/>\n<path d='M 50 50 C 1e30 1e30 -1e30 -1e30 50 50'/></svg>"
    );
    let refused = read("c.svg", text.as_bytes()).err();
    assert_eq!(
        refused,
        Some(DrawingError::FarAway {
            place: FilePlace::Line(3)
        })
    );
    let error = refused.map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("line 3") && error.contains("kilometre"), "{error}");
}

#[test]
fn vector_files_with_numbers_of_all_sizes_are_refused_or_bounded() {
    for seed in 1..=FILES {
        let random = &mut Chance(Lcg::new(seed));
        let mut text = format!(
            "{HEAD} width='{}' height='100mm' viewBox='0 0 {} {}'>",
            random.of(&["100mm", "1e30mm", "1e-30mm", "1e9", "10mm"]),
            random.number(),
            random.number()
        );
        for _ in 0..1 + random.below(4) {
            let n: Vec<&str> = (0..8).map(|_| random.number()).collect();
            let dashes = random.of(&["1 1", "1e-6 1e-6", "1e-30 10", "0 0", "1e30", "0.001", "5 0 0 0"]);
            let style = format!(
                "stroke='black' stroke-dasharray='{dashes}' stroke-dashoffset='{}'",
                n[7]
            );
            let transform = match random.below(4) {
                0 => format!("transform='matrix({} 0 0 {} {} {})'", n[0], n[1], n[2], n[3]),
                1 => format!("transform='scale({})'", n[0]),
                _ => String::new(),
            };
            let shape = match random.below(8) {
                0 => format!(
                    "<path d='M 1 1 C {} {} {} {} {} {}' {style} {transform}/>",
                    n[0], n[1], n[2], n[3], n[4], n[5]
                ),
                1 => format!(
                    "<path d='M 1 1 A {} {} {} 1 0 {} {} Q {} {} 5 5' {style} {transform}/>",
                    n[0], n[1], n[2], n[3], n[4], n[5], n[6]
                ),
                2 => format!("<circle cx='{}' cy='{}' r='{}' {style} {transform}/>", n[0], n[1], n[2]),
                3 => format!(
                    "<rect x='{}' y='{}' width='{}' height='{}' rx='{}' {style} {transform}/>",
                    n[0], n[1], n[2], n[3], n[4]
                ),
                4 => format!(
                    "<text x='{}' y='{}' font-size='{}' textLength='{}' {transform}>Hg</text>",
                    n[0], n[1], n[2], n[3]
                ),
                5 => format!(
                    "<polyline points='{} {} {} {} 3 3' {style} {transform}/>",
                    n[0], n[1], n[2], n[3]
                ),
                6 => format!(
                    "<clipPath id='c'><circle r='{}'/></clipPath><path clip-path='url(#c)' d='M0 0L{} {}' {style}/>",
                    n[0], n[1], n[2]
                ),
                _ => format!("<line x1='0' y1='0' x2='900000' y2='{}' {style} {transform}/>", n[0]),
            };
            text.push_str(&shape);
        }
        text.push_str("</svg>");
        println!("seed {seed}");
        assert_bounded("hostile.svg", &text);
    }
}

#[test]
fn nested_elements_references_and_entities_end() {
    let nested = |depth: usize| {
        format!(
            "{HEAD}>{}<path d='M0 0h9'/>{}</svg>",
            "<g transform='scale(1.1)'>".repeat(depth),
            "</g>".repeat(depth)
        )
    };
    for depth in [100, 1_000, 20_000] {
        assert_bounded("nested.svg", &nested(depth));
    }
    let mut uses = format!("{HEAD} viewBox='0 0 9 9'><g id='u0'><path d='M0 0h9'/></g>");
    let mut entities = "<!DOCTYPE svg [<!ENTITY e0 '<path d=\"M0 0h9\"/>'>".to_owned();
    for k in 1..=24 {
        let before = k - 1;
        write!(
            uses,
            "<g id='u{k}'><use xlink:href='#u{before}'/><use xlink:href='#u{before}'/></g>"
        )
        .expect("memory");
        write!(entities, "<!ENTITY e{k} '&e{before};&e{before};'>").expect("memory");
    }
    assert_bounded("uses.svg", &(uses + "</svg>"));
    assert_bounded("entities.svg", &format!("{entities}]>{HEAD}>&e24;</svg>"));
    assert_bounded(
        "entity.svg",
        &format!("<!DOCTYPE svg [<!ENTITY a '&a;'>]>{HEAD}>&a;</svg>"),
    );
}

#[test]
fn many_tiny_dashes_on_many_long_lines_are_drawn_solid_in_the_end() {
    let line = "<path d='M0 0H90000' stroke-dasharray='1'/>";
    let text = format!(
        "{HEAD} stroke='black' width='90000mm' height='90mm' viewBox='0 0 90000 90'>{}</svg>",
        line.repeat(400)
    );
    assert_bounded("dashes.svg", &text);
}

#[test]
fn plotter_files_with_numbers_of_all_sizes_are_refused_or_bounded() {
    for seed in 1..=FILES {
        let random = &mut Chance(Lcg::new(seed));
        let (mut gcode, mut hpgl) = ("G21\nG0 X0 Y0\nM3\n".to_owned(), "IN;SP1;PD0,0;".to_owned());
        for _ in 0..1 + random.below(12) {
            let n: Vec<String> = (0..6)
                .map(|_| match random.below(6) {
                    0 => "9".repeat(400),
                    1 => format!("-0.{}1", "0".repeat(300)),
                    _ => random
                        .of(&["0", "1", "-7.5", "999999", "1000000", "-99999999", "360", "3600000"])
                        .to_owned(),
                })
                .collect();
            let word = random.of(&["G0", "G1", "G2", "G3", "G92", "G20", "G91", "T", "M3", "M5"]);
            let radius = random.of(&["", "R"]);
            if radius.is_empty() {
                writeln!(gcode, "{word} X{} Y{} I{} J{}", n[0], n[1], n[2], n[3]).expect("memory");
            } else {
                writeln!(gcode, "{word} X{} Y{} R{}", n[0], n[1], n[2]).expect("memory");
            }
            let instruction = random.of(&["PA", "PR", "PD", "PU", "CI", "AA", "AR", "EA", "ER", "SP"]);
            write!(hpgl, "{instruction}{},{},{};", n[0], n[1], n[2]).expect("memory");
            if random.below(2) == 0 {
                write!(hpgl, "{instruction}{},{};CI{};", n[3], n[4], random.number()).expect("memory");
            }
        }
        println!("seed {seed}");
        assert_bounded("hostile.gcode", &gcode);
        assert_bounded("hostile.hpgl", &hpgl);
        let row = |random: &mut Chance| format!("{},{},{}", random.number(), random.number(), random.of(&["0", "1"]));
        let rows: Vec<String> = (0..5).map(|_| row(random)).collect();
        assert_bounded("hostile.csv", &format!("x_mm,y_mm,pen\n{}\n", rows.join("\n")));
    }
    // Circles with the most chords, with the pen up and down.
    assert_bounded(
        "circles.hpgl",
        &format!("IN;SP1;{}", "PU;AA39999999,0,360;".repeat(20_000)),
    );
    assert_bounded(
        "circles.gcode",
        &format!("G21\nM5\n{}", "G2 X0 Y0 I400000 J0\n".repeat(20_000)),
    );
}

#[test]
fn a_place_that_is_too_far_is_named() {
    let refused = |name: &str, text: &str| read(name, text.as_bytes()).err();
    let far = |place| Some(DrawingError::FarAway { place });
    assert_eq!(
        refused("a.gcode", "G21\nM3\nG1 X1\nG1 X99999999\n"),
        far(FilePlace::Line(4))
    );
    assert_eq!(
        refused("a.hpgl", "IN;SP1;PD0,0;PA99999999999,0;"),
        far(FilePlace::Instruction(4))
    );
    assert_eq!(
        refused("a.csv", "x_mm,y_mm,pen\n1,1,0\n1,1e9,1\n"),
        far(FilePlace::Line(3))
    );
    let text = format!("{HEAD}>\n<g transform='scale(1e12)'>\n<path d='M1 1h5'/></g></svg>");
    assert_eq!(refused("a.svg", &text), far(FilePlace::Line(2)));
}

#[test]
fn a_picture_that_says_it_is_huge_is_refused_before_it_is_decoded() {
    // Signature and header of a PNG of 65,535 x 65,535 pixels, and a JPEG's of the same size.
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0\xff\xff\0\0\xff\xff\x08\x06\0\0\0".to_vec();
    let crc = !png[12..29].iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg())
        })
    });
    png.extend(crc.to_be_bytes());
    png.extend(b"\0\0\0\x01IDAT\0\0\0\0\0\0\0\0\0IEND\xae\x42\x60\x82");
    let refused = read("huge.png", &png).err();
    assert!(
        matches!(
            refused,
            Some(DrawingError::TooLarge {
                width: 65_535,
                height: 65_535,
                ..
            })
        ),
        "{refused:?}"
    );
    let jpeg = b"\xff\xd8\xff\xc0\0\x0b\x08\xff\xff\xff\xff\x01\x01\x11\0\xff\xda\0\x08\x01\x01\0\0\x3f\0\0\xff\xd9";
    let refused = read("huge.jpg", jpeg).err();
    assert!(
        matches!(refused, Some(DrawingError::TooLarge { .. } | DrawingError::Damaged)),
        "{refused:?}"
    );
}

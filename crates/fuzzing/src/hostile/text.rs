//! G-code, HPGL, lists of coordinates, configurations, fault scripts.

use super::{FILE_BYTES, Hostile, filled, numbered};

pub(super) const FILES: &[Hostile] = &[
    Hostile {
        name: "moves.gcode",
        make: || filled("G21\nM3\n", "G1X1\nX0\n", ""),
    },
    Hostile {
        name: "one-line.gcode",
        make: || filled("M3 ", "G1X1Y1", "\n"),
    },
    Hostile {
        name: "functions-in-one-line.gcode",
        make: || filled("", "M3", "\n"),
    },
    Hostile {
        name: "offsets-in-one-line.gcode",
        make: || filled("", "G92", "\n"),
    },
    Hostile {
        name: "arcs.gcode",
        make: || filled("G21\nM3\n", "G2I400000\n", ""),
    },
    Hostile {
        name: "pens.gcode",
        make: || numbered("M3\n", |n| format!("T{n}\nX{}\n", n % 9), ""),
    },
    Hostile {
        name: "strokes.gcode",
        make: || filled("", "M3\nX1\nM5\nX0\n", ""),
    },
    Hostile {
        name: "comments.gcode",
        make: || filled("G1X1", "(", ""),
    },
    Hostile {
        name: "short-comments.gcode",
        make: || filled("G1X1", "()", ""),
    },
    Hostile {
        name: "digits.gcode",
        make: || filled("G1X", "9", "\n"),
    },
    Hostile {
        name: "heights.gcode",
        make: || numbered("", |n| format!("Z{n}\n"), ""),
    },
    Hostile {
        name: "warnings.gcode",
        make: || numbered("", |n| format!("M{}\nB1\n", 400 + n), ""),
    },
    Hostile {
        name: "moves.hpgl",
        make: || filled("IN;SP1;PD", "1,1,0,0,", "0,0;"),
    },
    Hostile {
        name: "circles.hpgl",
        make: || filled("IN;", "CI39999999;", ""),
    },
    Hostile {
        name: "arcs.hpgl",
        make: || filled("IN;PD;", "AA39999999,0,360;", ""),
    },
    Hostile {
        name: "pens.hpgl",
        make: || numbered("IN;", |n| format!("SP{n};PD{},0;", n % 9), ""),
    },
    Hostile {
        name: "unknown.hpgl",
        make: || numbered("IN;", |n| format!("{}{};", letter(n / 26), letter(n)), ""),
    },
    Hostile {
        name: "labels.hpgl",
        make: || filled("IN;", "LBa\u{3}", ""),
    },
    Hostile {
        name: "label-without-end.hpgl",
        make: || filled("IN;LB", "LB", ""),
    },
    Hostile {
        name: "letters.hpgl",
        make: || filled("IN;", "PU", ""),
    },
    Hostile {
        name: "rows.csv",
        make: || filled("x_mm,y_mm,pen\n", "0,1,1\n1,1,1\n", ""),
    },
    Hostile {
        name: "strokes.csv",
        make: || filled("x_mm,y_mm,pen\n", "0,1,0\n1,1,1\n", ""),
    },
    Hostile {
        name: "path.csv",
        make: || filled("x_mm,y_mm,z_mm,pen\n", "0,0,0,1\n", ""),
    },
    Hostile {
        name: "columns.csv",
        make: || filled("x_mm,y_mm,pen\n", ",", "\n"),
    },
    Hostile {
        name: "heading.csv",
        make: || filled("", "x_mm,", "\n"),
    },
    Hostile {
        name: "digits.csv",
        make: || filled("x_mm,y_mm,pen\n0.", "0", ",1,1\n"),
    },
    Hostile {
        name: "arrays.toml",
        make: || filled("axes = ", "[", ""),
    },
    Hostile {
        name: "tables.toml",
        make: || filled("axes = ", "{a=", ""),
    },
    Hostile {
        name: "dotted-key.toml",
        make: || filled("a", ".a", " = 1\n"),
    },
    Hostile {
        name: "dotted-table.toml",
        make: || filled("[a", ".a", "]\n"),
    },
    Hostile {
        name: "dotted-keys.toml",
        make: || filled("", "a.b.c.d.e = 1\n", ""),
    },
    Hostile {
        name: "keys.toml",
        make: || numbered("", |n| format!("k{n}=1\n"), ""),
    },
    Hostile {
        name: "keys-of-a-table.toml",
        make: || numbered("axes = [{", |n| format!("k{n}=1,"), "a=1}]\n"),
    },
    Hostile {
        name: "array.toml",
        make: || filled("axes = [", "{},", "]\n"),
    },
    Hostile {
        name: "tables-of-an-array.toml",
        make: || filled("", "[[axes]]\n", ""),
    },
    Hostile {
        name: "text.toml",
        make: || filled("[motion]\nspeed_mm_s = \"\"\"", "a\n", "\"\"\"\n"),
    },
    Hostile {
        name: "digits.toml",
        make: || filled("[motion]\nspeed_mm_s = ", "9", "\n"),
    },
    Hostile {
        name: "comments.toml",
        make: || filled("", "#\n", ""),
    },
    Hostile {
        name: "errors.toml",
        make: || filled("", "=", "\n"),
    },
    Hostile {
        name: "faults.script",
        make: || filled("", "frame 1 drop\n", ""),
    },
    Hostile {
        name: "frames.script",
        make: || numbered("", |n| format!("frame {n}..{} lose\n", n + 100), ""),
    },
    Hostile {
        name: "one-line.script",
        make: || filled("frame 1 drop", " #", ""),
    },
    Hostile {
        name: "words.script",
        make: || filled("frame ", "1 ", ""),
    },
];

const _: () = assert!(FILE_BYTES > 1 << 20);

fn letter(number: usize) -> char {
    char::from(b'A' + (number % 26) as u8)
}

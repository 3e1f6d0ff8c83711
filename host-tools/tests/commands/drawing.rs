//! From a file to strokes, as a user runs it: vectorize, order, preview, and what they refuse.

use crate::program::{Folder, etherpen, run, strokes};
use host_tools::drawing::{Artwork, read_svg};
use host_tools::error::code;
use host_tools::setup::workspace;
use serde_json::Value;
use std::fs;
use std::path::Path;

const HEAD: &str = "<svg xmlns='http://www.w3.org/2000/svg' width='100mm' height='100mm' viewBox='0 0 100 100' \
    stroke='black' fill='none'>";

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("one JSON document and nothing else")
}

/// Length of ink in each square millimetre, mm.
fn ink(artwork: &Artwork) -> Vec<f64> {
    let mut squares = vec![0.0; 300 * 300];
    for stroke in &artwork.strokes {
        for pair in stroke.stroke.points.windows(2) {
            let [a, b] = [pair[0], pair[1]];
            let length = (a[0] - b[0]).hypot(a[1] - b[1]);
            let pieces = (length / 0.01).ceil().max(1.0);
            for k in 0..pieces as u32 {
                let t = (f64::from(k) + 0.5) / pieces;
                let [x, y] = [0, 1].map(|axis| (a[axis] + t * (b[axis] - a[axis]) + 10.0) as usize);
                squares[y.min(299) * 300 + x.min(299)] += length / pieces;
            }
        }
    }
    squares
}

fn assert_same_ink(before: &Artwork, after: &Artwork, bridged_mm: f64) {
    let (before, after) = (ink(before), ink(after));
    let missing: f64 = before
        .iter()
        .zip(&after)
        .map(|(before, after)| (before - after).max(0.0))
        .sum();
    let added: f64 = before
        .iter()
        .zip(&after)
        .map(|(before, after)| (after - before).max(0.0))
        .sum();
    // Lines on the border of two squares may count for either.
    assert!(
        missing < 1.0 && added < 1.0 + bridged_mm,
        "missing {missing} mm, added {added} mm"
    );
}

fn read(path: &Path) -> Artwork {
    read_svg(&fs::read_to_string(path).expect("a file")).expect("an SVG")
}

#[test]
fn the_order_costs_less_and_keeps_scale_and_ink() {
    let folder = Folder::new();
    for name in ["grass", "streets", "contours"] {
        let file = workspace().join(format!("samples/vectors/{name}.svg"));
        let out = folder.join("ordered.svg");
        let mut command = etherpen(&folder);
        let (status, stdout, stderr) = run(command.arg("order").arg(&file).arg("-o").arg(&out).arg("--json"));
        assert_eq!(status, Some(0), "{stderr}");
        let answer = json(&stdout);
        let figure = |key: &str| answer[key].as_f64().expect(key);
        assert!(figure("lifts_after") <= figure("lifts_before"), "{stdout}");
        assert!(figure("pen_up_mm_after") < 0.2 * figure("pen_up_mm_before"), "{stdout}");
        assert!(figure("drawing_s_after") < figure("drawing_s_before"), "{stdout}");
        assert!(figure("seconds") > 0.0);
        let (before, after) = (read(&file), read(&out));
        assert_eq!(after.strokes.len() as f64, figure("strokes"));
        assert_eq!(before.page_mm, after.page_mm);
        assert_eq!(before.user_space, after.user_space);
        assert_same_ink(&before, &after, figure("bridged_mm"));
        let again = folder.join("again.svg");
        let (_, stdout, _) = run(etherpen(&folder)
            .arg("order")
            .arg(&out)
            .arg("-o")
            .arg(again)
            .arg("--json"));
        let second = json(&stdout);
        assert!(
            second["pen_up_mm_after"].as_f64() <= second["pen_up_mm_before"].as_f64(),
            "{stdout}"
        );
        assert_eq!(second["lifts_after"], second["lifts_before"]);
    }
}

#[test]
fn a_debug_preview_shows_the_stages_of_a_photograph_and_refuses_anything_else() {
    let folder = Folder::new();
    let debug = |file: &Path, out: &str| {
        let mut command = etherpen(&folder);
        run(command
            .args(["preview", "--debug", "--json"])
            .arg(file)
            .arg("-o")
            .arg(folder.join(out)))
    };
    let photograph = workspace().join("samples/astronaut.png");
    let (status, stdout, stderr) = debug(&photograph, "stages.png");
    assert_eq!(status, Some(0), "{stderr}");
    assert!(json(&stdout)["strokes"].as_u64() > Some(100), "{stdout}");
    let picture = image::open(folder.join("stages.png")).expect("a PNG").into_rgb8();
    // Three panels in a row, three rows, each above its name.
    assert_eq!(picture.dimensions(), (3 * 740 + 20, 3 * 772 + 20));
    // The landmarks of the face that is in this photograph, in their colour.
    let landmarks = picture.pixels().filter(|pixel| pixel.0 == [240, 180, 0]).count();
    assert!(landmarks > 20, "{landmarks} pixels");
    let (status, _, stderr) = debug(&photograph, "stages.svg");
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
    assert!(stderr.contains(".png"), "{stderr}");
    let (status, _, stderr) = debug(&strokes(), "strokes.png");
    assert_eq!(status, Some(i32::from(code::INPUT)), "{stderr}");
    assert!(stderr.contains("a photograph"), "{stderr}");
    assert!(!folder.join("strokes.png").exists());
}

#[test]
fn a_preview_counts_shows_and_names_what_is_refused() {
    let folder = Folder::new();
    for out in ["preview.svg", "preview.png"] {
        let out = folder.join(out);
        let mut command = etherpen(&folder);
        let (status, stdout, stderr) = run(command.arg("preview").arg(strokes()).arg("-o").arg(&out).arg("--json"));
        assert_eq!(status, Some(0), "{stderr}");
        let answer = json(&stdout);
        assert_eq!(
            (&answer["strokes"], &answer["lifts"], &answer["refused"]),
            (&6.into(), &6.into(), &0.into())
        );
        let seconds = answer["estimated_s"].as_f64().expect("a duration");
        assert!((3.0..8.0).contains(&seconds), "{seconds}");
        assert!(fs::metadata(&out).is_ok_and(|file| file.len() > 500));
    }
    let file = folder.file("large.svg", format!("{HEAD}<path d='M10 10h20M10 20h150'/></svg>"));
    let out = folder.join("large-preview.svg");
    let preview = |extra: &[&str]| {
        let mut command = etherpen(&folder);
        run(command
            .arg("preview")
            .arg(&file)
            .arg("-o")
            .arg(&out)
            .arg("--json")
            .args(extra))
    };
    let (status, stdout, stderr) = preview(&["--origin", "100,0"]);
    assert_eq!(status, Some(i32::from(code::INPUT)), "a refused stroke is no success");
    assert!(stderr.contains("1 of 2 strokes would be refused"), "{stderr}");
    assert!(
        fs::metadata(&out).is_ok_and(|file| file.len() > 500),
        "the picture shows it"
    );
    let answer = json(&stdout);
    assert_eq!(answer["refused"], 1, "{stdout}");
    assert!(
        answer["refusals"][0]["reason"]
            .as_str()
            .is_some_and(|reason| reason.contains("sheet")),
        "{stdout}"
    );
    let mut command = etherpen(&folder);
    let (status, _, stderr) = run(command.arg("simulate").arg(&file).args(["--origin", "100,0"]));
    assert_eq!(status, Some(i32::from(code::INPUT)));
    assert!(
        stderr.contains("leaves the sheet") && stderr.contains("--fit"),
        "{stderr}"
    );
}

#[test]
fn files_that_cannot_be_drawn_are_refused_with_a_place_and_a_remedy() {
    let folder = Folder::new();
    let many = format!("{HEAD}{}</svg>", "<path d='M0 0h1'/>".repeat(1_000_001));
    for (name, content, expected) in [
        ("cut.svg", "<svg><g>".to_owned(), "line 1"),
        (
            "nan.svg",
            "<svg xmlns='http://www.w3.org/2000/svg' width='NaN' height='9mm'><path d='M0 0h9'/></svg>".to_owned(),
            "give the page a size",
        ),
        (
            "cycle.svg",
            format!("{}<g id='a'><use href='#a'/></g></svg>", HEAD),
            "Recursive",
        ),
        (
            "zero.svg",
            "<svg xmlns='http://www.w3.org/2000/svg' width='0' height='5'/>".to_owned(),
            "size",
        ),
        ("empty.svg", format!("{HEAD}</svg>"), "nothing to draw"),
        ("many.svg", many, "1000000 elements"),
        ("arc.gcode", "G0 X0 Y0\nM3\nG2 X10 Y0\n".to_owned(), "line 3"),
        ("word.gcode", "G21\nG1 X10 Y#5\n".to_owned(), "line 2"),
        ("cut.plt", "IN;PD10,20,30;".to_owned(), "instruction 2"),
        ("text.csv", "x_mm,y_mm,pen\n1,2,1\nhello,2,1\n".to_owned(), "line 3"),
    ] {
        let file = folder.file(name, content);
        let out = folder.join("out.svg");
        let (status, stdout, stderr) = run(etherpen(&folder).arg("preview").arg(&file).arg("-o").arg(out));
        assert_eq!(status, Some(i32::from(code::INPUT)), "{name}: {stderr}");
        assert!(
            stdout.is_empty() && stderr.contains(expected) && stderr.contains(name),
            "{name}: {stderr}"
        );
    }
}

#[test]
fn a_photograph_becomes_lines_of_the_same_page_in_each_run() {
    let folder = Folder::new();
    let vectorize = |name: &str| {
        let out = folder.join(name);
        let mut command = etherpen(&folder);
        command
            .arg("vectorize")
            .arg(workspace().join("samples/camera.png"))
            .arg("-o")
            .arg(&out);
        let (status, stdout, stderr) =
            run(command.args(["--json", "--style", "hatch", "--size", "60mm", "--max-time", "20s"]));
        assert_eq!(status, Some(0), "{stderr}");
        (json(&stdout), fs::read_to_string(out).expect("the SVG"))
    };
    let ((answer, svg), (_, again)) = (vectorize("a.svg"), vectorize("b.svg"));
    assert_eq!(svg, again);
    let artwork = read_svg(&svg).expect("an SVG");
    assert_eq!(answer["strokes"], artwork.strokes.len());
    assert_eq!(answer["size_mm"], serde_json::json!([60.0, 60.0]));
    let length: f64 = (artwork.strokes.iter()).map(|stroke| stroke.stroke.length_mm()).sum();
    assert!((answer["pen_down_mm"].as_f64().expect("a length") - length).abs() < 1.0);
}

#[test]
fn variants_of_a_photograph_are_shown_side_by_side() {
    let folder = Folder::new();
    let sheet = folder.join("sheet.png");
    let mut command = etherpen(&folder);
    command.arg("vectorize").arg(workspace().join("samples/astronaut.png"));
    let (status, stdout, stderr) = run(command
        .args(["--json", "--size", "60mm", "--variants", "3", "--contact-sheet"])
        .arg(&sheet));
    assert_eq!(status, Some(0), "{stderr}");
    assert!(stderr.contains("--crop none draws everything"), "{stderr}");
    let answer = json(&stdout);
    let variants = answer["variants"].as_array().expect("variants");
    assert_eq!(variants.len(), 3);
    assert_eq!(variants[0]["strokes"], answer["strokes"]);
    assert_eq!(variants[1]["options"], "--style hatch --crop auto --background fade");
    let picture = image::open(&sheet).expect("the contact sheet");
    assert!(picture.width() > 3 * 720 && picture.height() > 720);
    let (status, _, stderr) = run(etherpen(&folder)
        .arg("vectorize")
        .arg(workspace().join("samples/astronaut.png"))
        .args(["--variants", "3"]));
    assert_eq!(status, Some(i32::from(code::USAGE)), "{stderr}");
}

#[test]
fn no_variant_repeats_another_where_a_crop_changes_nothing() {
    let folder = Folder::new();
    // Without a face, nothing is cropped.
    let (status, stdout, stderr) = run(etherpen(&folder)
        .arg("vectorize")
        .arg(workspace().join("samples/camera.png"))
        .args(["--json", "--size", "40mm", "--variants", "7", "--contact-sheet"])
        .arg(folder.join("sheet.png")));
    assert_eq!(status, Some(0), "{stderr}");
    let answer = json(&stdout);
    let variants = answer["variants"].as_array().expect("variants");
    assert_eq!(variants.len(), 7);
    for (index, variant) in variants.iter().enumerate() {
        let same = |other: &&serde_json::Value| {
            (&other["strokes"], &other["pen_down_mm"]) == (&variant["strokes"], &variant["pen_down_mm"])
        };
        assert_eq!(variants[..index].iter().find(same), None, "{variant}");
    }
}

#[test]
fn a_camera_takes_the_photograph_that_is_drawn() {
    let folder = Folder::new();
    let picture = image::RgbImage::from_fn(96, 64, |x, y| {
        image::Rgb([if (x / 12 + y / 16).is_multiple_of(2) { 30 } else { 220 }; 3])
    });
    let mut stream = Vec::new();
    for _ in 0..3 {
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut stream);
        encoder.encode_image(&picture).expect("a picture");
    }
    let stream = folder.file("recorded.mjpeg", stream);
    let nobody = "tcp:127.0.0.1:1";
    let (status, _, stderr) = run(etherpen(&folder)
        .arg("draw")
        .arg("--camera")
        .arg(&stream)
        .args(["--port", nobody]));
    assert_eq!(status, Some(i32::from(code::CONNECTION)), "{stderr}");
    let kept = stderr
        .split("kept as ")
        .nth(1)
        .and_then(|rest| rest.lines().next())
        .expect("the picture's name");
    let kept = image::open(kept).expect("the picture");
    assert_eq!((kept.width(), kept.height()), (96, 64));
    for (arguments, part) in [
        (["--camera", "/dev/null"], "no camera"),
        (["--camera", "/dev/no-such-camera"], "no such camera"),
    ] {
        let (status, _, stderr) = run(etherpen(&folder).arg("draw").args(arguments).args(["--port", nobody]));
        assert!(
            status == Some(i32::from(code::INPUT)) && stderr.contains(part),
            "{stderr}"
        );
    }
    let (status, _, stderr) = run(etherpen(&folder).args(["draw", "--pause", "-", "--port", nobody]));
    assert!(
        status == Some(i32::from(code::USAGE)) && stderr.contains("--pause"),
        "{stderr}"
    );
}

#[test]
fn text_is_drawn_with_the_pens_own_letters() {
    let folder = Folder::new();
    let text = "<text x='10' y='50' font-size='20'>etherpen \u{e4}\u{df}</text>";
    let file = folder.file("text.svg", format!("{HEAD}{text}</svg>"));
    let out = folder.join("out.svg");
    let order = |more: &[&str]| run(etherpen(&folder).arg("order").arg(&file).arg("-o").arg(&out).args(more));
    let (status, _, stderr) = order(&["--single-stroke"]);
    assert_eq!(status, Some(0), "{stderr}");
    let drawn = read(&out);
    assert!(
        drawn.strokes.len() >= 9,
        "one line a letter at least: {}",
        drawn.strokes.len()
    );
    assert!(
        drawn
            .strokes
            .iter()
            .any(|stroke| stroke.stroke.points.first() != stroke.stroke.points.last())
    );
    let (status, _, stderr) = order(&["--font", file.to_str().expect("a name")]);
    assert!(
        status == Some(i32::from(code::USAGE)) && stderr.contains("no TrueType"),
        "{stderr}"
    );
}

#[test]
fn a_crop_and_a_focus_outside_the_photograph_are_refused_with_its_size() {
    let folder = Folder::new();
    let photo = host_tools::setup::workspace().join("samples/camera.png");
    let vectorize = |words: &[&str]| run(etherpen(&folder).arg("vectorize").arg(&photo).args(words));
    for (option, value) in [
        ("--crop", "600,600,100,100"),
        ("--crop", "100,100,9,200"),
        ("--focus", "900,100,50"),
        ("--focus", "256,200,1e9"),
        ("--focus", "256,200,1e300"),
    ] {
        let (status, _, stderr) = vectorize(&["-o", "out.svg", option, value]);
        assert_eq!(status, Some(i32::from(code::INPUT)), "{option} {value}: {stderr}");
        assert!(
            stderr.contains(option) && stderr.contains("512 x 512"),
            "{option} {value}: {stderr}"
        );
    }
    for (words, why) in [
        (["-o", "a.png", "--contact-sheet", "a.png"], "name two files"),
        (["-o", "a.svg", "--contact-sheet", "a.jpg"], ".png"),
    ] {
        let (status, _, stderr) = vectorize(&words);
        assert_eq!(status, Some(i32::from(code::USAGE)), "{words:?}: {stderr}");
        assert!(stderr.contains(why), "{words:?}: {stderr}");
    }
    // As large as the picture, and no more.
    let (status, _, stderr) = vectorize(&["-o", "out.svg", "--focus", "256,200,700", "--max-strokes", "50"]);
    assert_eq!(status, Some(0), "{stderr}");
}

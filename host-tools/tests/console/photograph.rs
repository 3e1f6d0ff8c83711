//! A photograph on the page: the part that is drawn, its background, and variants to choose from.
//!
//! What was drawn is read from the ink on the sheet and from the path, never from the options that the console repeats.

use super::client::{Client, Rig, TOKEN};
use super::page::small_photograph;
use etherpen::config::Config;
use image::{GrayImage, ImageFormat, Rgb, RgbImage};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Cursor;

/// A drawn vertex, mm from the sheet's upper left corner: x to the right, y down.
type Point = [f64; 2];

/// White border around a photograph, mm.
const MARGIN_MM: f64 = 4.0;
/// Largest distance of an end of the ink from the edge of the disc, mm, and as a share of the disc's radius: hatching
/// ends inside.
const NEAR_MM: f64 = 1.0;
const NEAR_SHARE: f64 = 0.05;
/// Size of the photograph with a disc, and the disc's centre and radius, pixels.
const SIZE_PX: [f64; 2] = [600.0, 400.0];
const DISC_PX: [f64; 3] = [300.0, 110.0, 36.0];

fn png(picture: &RgbImage) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    picture.write_to(&mut file, ImageFormat::Png).unwrap();
    file.into_inner()
}

/// A dark disc on white.
pub(crate) fn disc() -> Vec<u8> {
    let [x0, y0, radius] = DISC_PX;
    png(&RgbImage::from_fn(SIZE_PX[0] as u32, SIZE_PX[1] as u32, |x, y| {
        let away = (f64::from(x) + 0.5 - x0).hypot(f64::from(y) + 0.5 - y0);
        Rgb([if away < radius { 40 } else { 250 }; 3])
    }))
}

pub(crate) fn astronaut() -> Vec<u8> {
    std::fs::read(host_tools::setup::workspace().join("samples/astronaut.png")).unwrap()
}

fn sheet_mm() -> Point {
    Config::default().paper.size_mm
}

/// Sends a file, and waits until it is prepared.
fn upload(rig: &Rig, viewer: &mut Client, name: &str, content: &[u8], wishes: &Value) -> Value {
    let plain: String = wishes.to_string().bytes().map(|byte| format!("%{byte:02X}")).collect();
    let head = format!(
        "POST /file HTTP/1.1\r\nHost: {}\r\nx-etherpen-token: {TOKEN}\r\nx-etherpen-viewer: {}\r\nx-etherpen-name: {name}\r\n\
         x-etherpen-options: {plain}",
        rig.address(),
        viewer.sections["you"]["id"]
    );
    let before = viewer.sections["studio"]["number"].as_u64().unwrap_or(0);
    let answer = rig.http(&head, content);
    assert!(answer.starts_with("HTTP/1.1 202"), "{answer}");
    prepared(viewer, before, "ready")
}

/// Requests other options for the present file, and waits until they are used or refused.
fn replan(viewer: &mut Client, wishes: &Value, state: &str) -> Value {
    let before = viewer.sections["studio"]["number"].as_u64().unwrap_or(0);
    viewer.send(&json!({"type": "replan", "wishes": wishes}));
    prepared(viewer, before, state)
}

fn prepared(viewer: &mut Client, before: u64, state: &str) -> Value {
    let made = viewer.state("studio", |made| {
        made["number"].as_u64() > Some(before) && made["state"] != "working"
    });
    assert_eq!(made["state"], state, "{made}");
    made
}

fn controlling(rig: &Rig) -> Client {
    let mut viewer = rig.viewer("one");
    viewer.send(&json!({"type": "take"}));
    let you = viewer.sections["you"]["id"].clone();
    viewer.state("control", |control| control["holder"] == you);
    viewer
}

/// Keeps control and the connection while time passes.
fn keep_control(viewer: &mut Client) {
    viewer.send(&json!({"type": "take", "force": true}));
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// The lines of the preview with this number, each from vertex to vertex.
fn lines(viewer: &mut Client, number: &Value) -> Vec<[Point; 2]> {
    let is_it = |bytes: &&Vec<u8>| bytes.starts_with(&[2, 2]) && json!(word(bytes, 4)) == *number;
    while viewer.binary.iter().rfind(is_it).is_none() {
        viewer.take().expect("the connection stands");
    }
    let bytes = viewer.binary.iter().rfind(is_it).unwrap().clone();
    let paper = Config::default().paper;
    let number_at = |bytes: &[u8], at: usize| f64::from(f32::from_bits(word(bytes, at)));
    let vertices: Vec<(bool, Point)> = bytes[12..]
        .chunks(12)
        .map(|vertex| {
            let x_mm = number_at(vertex, 4) - paper.centre_mm[0] + 0.5 * paper.size_mm[0];
            let y_mm = paper.centre_mm[1] - number_at(vertex, 8) + 0.5 * paper.size_mm[1];
            (word(vertex, 0) >> 31 == 1, [x_mm, y_mm])
        })
        .collect();
    let legs = vertices.windows(2).filter(|pair| pair[1].0);
    legs.map(|pair| [pair[0].1, pair[1].1]).collect()
}

fn length_mm([[x0, y0], [x1, y1]]: &[Point; 2]) -> f64 {
    (x1 - x0).hypot(y1 - y0)
}

/// Left, top, right and bottom of some points.
fn extent(points: impl Iterator<Item = Point>) -> [f64; 4] {
    let nothing = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    points.fold(nothing, |[left, top, right, bottom], [x, y]| {
        [left.min(x), top.min(y), right.max(x), bottom.max(y)]
    })
}

/// Where a disc belongs on the sheet if this window of the photograph fills it: centre and radius, mm.
fn disc_mm([left, top, width, height]: [f64; 4]) -> [f64; 3] {
    let sheet = sheet_mm();
    let scale = ((sheet[0] - 2.0 * MARGIN_MM) / width).min((sheet[1] - 2.0 * MARGIN_MM) / height);
    let [x, y, radius] = DISC_PX;
    [
        0.5 * (sheet[0] - width * scale) + (x - left) * scale,
        0.5 * (sheet[1] - height * scale) + (y - top) * scale,
        radius * scale,
    ]
}

#[test]
fn the_ink_of_the_robot_lies_where_the_window_says() {
    let rig = Rig::start();
    let mut viewer = rig.viewer("one");
    viewer.enable();
    viewer.command(json!({"do": "override", "percent": 200}));
    let (whole, wide, square) = ("none", "150,50,420,200", "230,10,160,160");
    for (crop, window) in [
        (whole, [0.0, 0.0, SIZE_PX[0], SIZE_PX[1]]),
        (wide, [150.0, 50.0, 420.0, 200.0]),
        (square, [230.0, 10.0, 160.0, 160.0]),
    ] {
        let drawn = rig.cell().ink().len();
        let made = upload(
            &rig,
            &mut viewer,
            "disc.png",
            &disc(),
            &json!({"crop": crop, "max_time": "8s"}),
        );
        assert_eq!(made["photograph"]["window_px"], json!(window.map(|px| px as u32)));
        assert_eq!(made["photograph"]["size_px"], json!([600, 400]));
        keep_control(&mut viewer);
        viewer.send(&json!({"type": "enqueue", "preparation": made["number"]}));
        let jobs = viewer.state("jobs", |jobs| !jobs["waiting"][0].is_null());
        viewer.send(&json!({"type": "start", "job": jobs["waiting"][0]["number"]}));
        let job = jobs["waiting"][0]["number"].clone();
        let ended = |jobs: &Value| jobs["active"].is_null() && jobs["past"][0]["number"] == job;
        while !viewer.sections.get("jobs").is_some_and(ended) {
            viewer.send(&json!({"type": "alive"}));
            viewer.take().expect("the connection stands");
        }
        assert_eq!(viewer.sections["jobs"]["past"][0]["done"], true);
        let ink = rig.cell().ink();
        let [left, top, right, bottom] =
            extent(ink[drawn..].iter().flat_map(|stroke| stroke.points_mm.iter().copied()));
        let [x, y, radius] = disc_mm(window);
        println!(
            "{crop}: ink {left:.1} to {right:.1}, {top:.1} to {bottom:.1} mm; disc {radius:.1} mm at {x:.1}, {y:.1}"
        );
        for (found, wanted) in [
            (left, x - radius),
            (right, x + radius),
            (top, y - radius),
            (bottom, y + radius),
        ] {
            assert!(
                (found - wanted).abs() < NEAR_MM + NEAR_SHARE * radius,
                "{crop}: {found} mm, not {wanted} mm"
            );
        }
    }
}

#[test]
fn the_background_is_drawn_or_left_out_and_the_face_can_be_pointed_at() {
    let rig = Rig::start();
    let mut viewer = controlling(&rig);
    let wishes = |background: &str| json!({"crop": "none", "background": background, "size": "120mm"});
    let made = upload(&rig, &mut viewer, "astronaut.png", &astronaut(), &wishes("keep"));
    let face = made["photograph"]["face_px"].clone();
    let face: [f64; 3] = [0, 1, 2].map(|k| face[k].as_f64().expect("a face"));
    assert!(
        (180.0..270.0).contains(&face[0]) && (70.0..150.0).contains(&face[1]),
        "{face:?}"
    );
    // A flag and a model of a rocket are beside her, in the upper corners.
    let scale = 120.0 / 512.0;
    let corner_mm = |lines: &[[Point; 2]]| -> f64 {
        let is_beside = |[[x, y], _]: &&[Point; 2]| {
            let [x, y] = [x - 40.0, y - 40.0].map(|mm| mm / scale);
            y < 150.0 && !(100.0..400.0).contains(&x)
        };
        lines.iter().filter(is_beside).map(length_mm).sum()
    };
    let keep = corner_mm(&lines(&mut viewer, &made["number"]));
    keep_control(&mut viewer);
    let made = replan(&mut viewer, &wishes("none"), "ready");
    let none = corner_mm(&lines(&mut viewer, &made["number"]));
    println!("beside the head: {keep:.0} mm with the background, {none:.0} mm without");
    assert!(keep > 200.0 && none < 0.1 * keep, "{keep} mm, {none} mm");

    // A circle elsewhere moves the part that is chosen for the face.
    keep_control(&mut viewer);
    let made = replan(
        &mut viewer,
        &json!({"crop": "head", "focus": "400,300,40", "size": "120mm"}),
        "ready",
    );
    let window = [0, 1, 2, 3].map(|k| made["photograph"]["window_px"][k].as_f64().unwrap());
    assert!(
        window[0] > 300.0 && window[1] > 180.0 && window[0] + window[2] <= 512.0,
        "{window:?}"
    );
    assert_eq!(made["photograph"]["face_px"], json!([400.0, 300.0, 40.0]));
}

#[test]
fn windows_and_circles_that_make_no_sense_are_refused_and_the_photograph_stays() {
    let rig = Rig::start();
    let mut viewer = controlling(&rig);
    let plain = json!({"size": "40mm", "max_time": "8s"});
    let first = upload(&rig, &mut viewer, "disc.png", &disc(), &plain);
    let long = "9".repeat(3_000);
    for (option, value, why) in [
        ("crop", "NaN,0,10,10", "the part: "),
        ("crop", "0,0,inf,10", "the part: "),
        ("crop", "-5,0,100,100", "the part: "),
        ("crop", "0,0,0,100", "the part: "),
        ("crop", "0,0,100", "the part: "),
        ("crop", long.as_str(), "the part: "),
        ("crop", "--size=5mm", "the part: "),
        ("crop", "601,0,50,50", "less than 16 x 16 pixels"),
        ("crop", "1e308,1e308,1e308,1e308", "less than 16 x 16 pixels"),
        ("crop", "10,10,4,300", "less than 16 x 16 pixels"),
        ("background", "blur", "the background: "),
        ("focus", "1e308,5,5", "not a face in it"),
        ("focus", "5,5,1e308", "not a face in it"),
        ("focus", "5,5,-1", "the face: "),
    ] {
        let mut wishes = plain.clone();
        wishes[option] = json!(value);
        let made = replan(&mut viewer, &wishes, "failed");
        let error = made["error"].as_str().unwrap();
        assert!(
            error.contains(why) && !error.contains(" --"),
            "{option} {value}: {error}"
        );
        assert_eq!(
            made["photograph"], first["photograph"],
            "what can be corrected is still shown"
        );
        keep_control(&mut viewer);
    }
    // Beyond the edges, the picture ends.
    let mut wishes = plain.clone();
    wishes["crop"] = json!("200,0,1e300,1e300");
    let made = replan(&mut viewer, &wishes, "ready");
    assert_eq!(made["photograph"]["window_px"], json!([200, 0, 400, 400]));
    viewer.send(&json!({"type": "replan", "wishes": {"crop": 5}}));
    viewer.until("refused", |why| {
        why.as_str().is_some_and(|why| why.contains("no request"))
    });
}

/// Pictures of variants, by their numbers.
fn pictures(viewer: &Client) -> BTreeMap<u32, GrayImage> {
    let variants = viewer.binary.iter().filter(|bytes| bytes.starts_with(&[3, 2]));
    let read = |bytes: &Vec<u8>| {
        image::load_from_memory_with_format(&bytes[8..], ImageFormat::Png)
            .unwrap()
            .into_luma8()
    };
    variants.map(|bytes| (word(bytes, 4), read(bytes))).collect()
}

/// Share of the lines' length that is dark in a picture of the sheet.
fn dark_share(lines: &[[Point; 2]], picture: &GrayImage) -> f64 {
    let [width_mm, _] = sheet_mm();
    let scale = f64::from(picture.width()) / width_mm;
    let is_dark = |line: &&[Point; 2]| {
        let middle = [0, 1].map(|k| 0.5 * (line[0][k] + line[1][k]) * scale);
        let [x, y] = middle.map(|px| (px as u32).min(picture.width() - 1));
        picture.get_pixel(x, y.min(picture.height() - 1)).0[0] < 225
    };
    let all: f64 = lines.iter().map(length_mm).sum();
    lines.iter().filter(is_dark).map(length_mm).sum::<f64>() / all
}

#[test]
fn the_variant_that_is_chosen_is_the_one_in_its_picture_and_is_there_at_once() {
    let rig = Rig::start();
    let mut viewer = controlling(&rig);
    let portrait = small_photograph();
    let first = upload(
        &rig,
        &mut viewer,
        "portrait.png",
        &portrait,
        &json!({"size": "80mm", "max_time": "20s"}),
    );
    viewer.send(&json!({"type": "vary"}));
    let all = viewer.until("variants", |all| all["state"] == "ready");
    let items = all["items"].as_array().unwrap();
    assert!(
        items.len() >= 4 && items.len() as u64 <= all["wanted"].as_u64().unwrap(),
        "{all}"
    );
    assert_eq!(
        items[0]["strokes"], first["strokes"],
        "the first is the present drawing"
    );
    keep_control(&mut viewer);
    viewer.catch_up();
    let pictures = pictures(&viewer);
    assert_eq!(pictures.len(), items.len());
    for item in items {
        let before = viewer.sections["studio"]["number"].as_u64().unwrap();
        viewer.send(&json!({"type": "replan", "wishes": item["wishes"]}));
        let made = viewer.until("studio", |made| made["number"].as_u64() > Some(before));
        assert_eq!(made["state"], "ready", "nothing is computed anew");
        assert_eq!(
            (&made["strokes"], &made["planned_s"]),
            (&item["strokes"], &item["planned_s"])
        );
        assert_eq!(made["explicit"], item["wishes"]);
        let drawn = lines(&mut viewer, &made["number"]);
        let own = item["number"].as_u64().unwrap() as u32;
        let shares: BTreeMap<u32, f64> = (pictures.iter())
            .map(|(number, picture)| (*number, dark_share(&drawn, picture)))
            .collect();
        println!("{}: {shares:.2?}", item["wishes"]["style"]);
        let other = shares
            .iter()
            .filter(|(number, _)| **number != own)
            .map(|(_, share)| *share);
        assert!(
            // Two styles may share most of their lines on so small a sheet.
            shares[&own] > 0.98 && other.fold(0.0, f64::max) < shares[&own] - 0.01,
            "{own}: {shares:?}"
        );
    }

    // A new file ends them; the same options computed anew lead to the same lines.
    let last = items.last().unwrap();
    let number = viewer.sections["studio"]["number"].clone();
    let chosen = lines(&mut viewer, &number);
    let again = upload(&rig, &mut viewer, "portrait.png", &portrait, &last["wishes"]);
    assert_eq!(viewer.sections["variants"]["state"], "idle");
    assert_eq!(lines(&mut viewer, &again["number"]), chosen);
}

#[test]
fn variants_are_made_of_a_photograph_alone_and_end_with_it() {
    let rig = Rig::start();
    let mut viewer = controlling(&rig);
    let refused = |viewer: &mut Client, why: &str| {
        viewer.send(&json!({"type": "vary"}));
        viewer.until("refused", |said| said.as_str().is_some_and(|said| said.contains(why)));
    };
    refused(&mut viewer, "drop one");
    upload(&rig, &mut viewer, "line.svg", b"<svg xmlns='http://www.w3.org/2000/svg' width='50mm' height='50mm'><path fill='none' stroke='red' d='M10 10H100'/></svg>", &json!({}));
    assert_eq!(viewer.sections["studio"]["photograph"], Value::Null);
    refused(&mut viewer, "made of a photograph");
    let mut guest = rig.viewer("two");
    refused(&mut guest, "control");

    // Asked for many times, and overtaken by another file: none of the first one's variants appears beside the other.
    let wishes = json!({"size": "50mm", "max_time": "10s"});
    upload(&rig, &mut viewer, "portrait.png", &small_photograph(), &wishes);
    for _ in 0..20 {
        viewer.send(&json!({"type": "vary"}));
    }
    viewer.until("variants", |all| all["state"] == "working");
    keep_control(&mut viewer);
    upload(&rig, &mut viewer, "disc.png", &disc(), &wishes);
    viewer.state("variants", |all| all["state"] == "idle");
    keep_control(&mut viewer);
    viewer.send(&json!({"type": "vary"}));
    let all = viewer.until("variants", |all| {
        let items = all["items"].as_array().unwrap();
        assert!(items.len() < 7);
        all["state"] == "ready"
    });
    // Without a face, crop and background change nothing: a variant for each style.
    let mut styles: Vec<String> = all["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|item| item["wishes"]["style"].to_string())
        .collect();
    let count = styles.len();
    styles.sort();
    styles.dedup();
    assert!(styles.len() == count && count >= 3, "{styles:?}");
    viewer.catch_up();
    let middle = disc_mm([0.0, 0.0, SIZE_PX[0], SIZE_PX[1]]);
    println!(
        "{count} variants; the disc's middle is at {:.0} mm of {:.0} mm",
        middle[0],
        sheet_mm()[0]
    );
    for item in all["items"].as_array().unwrap() {
        let made = replan(&mut viewer, &item["wishes"].clone(), "ready");
        let [left, _, right, _] = extent(lines(&mut viewer, &made["number"]).into_iter().flatten());
        assert!(
            (0.5 * (left + right) - 0.5 * sheet_mm()[0]).abs() < NEAR_MM,
            "{left} to {right} mm"
        );
    }
}

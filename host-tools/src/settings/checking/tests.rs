use super::*;
use crate::settings::machines::MACHINES;

const GANTRY: &str = include_str!("../../../../samples/machines/gantry.toml");
const COREXY: &str = include_str!("../../../../samples/machines/corexy.toml");
const SCARA: &str = include_str!("../../../../samples/machines/scara.toml");

/// The only finding about a sample with a replaced part; its line is the one that has `at`.
fn finding(sample: &str, from: &str, to: &str, at: &str) -> Finding {
    assert!(sample.contains(from), "{from}");
    let text = sample.replacen(from, to, 1);
    let findings = check(&text);
    let [finding] = &findings[..] else {
        panic!("{findings:#?}")
    };
    let line = text.lines().position(|line| line.contains(at)).map(|line| line + 1);
    assert_eq!(finding.line, line, "{finding}");
    finding.clone()
}

#[test]
fn nothing_is_found_in_the_bundled_machines() {
    for machine in MACHINES {
        assert_eq!(check(machine.text), [], "{}", machine.name);
    }
}

#[test]
fn a_kind_with_the_wrong_number_of_axes_is_named() {
    let (before, rest) = GANTRY
        .split_once("[[axes]]                     # z: the pen")
        .expect("z");
    let (_, after) = rest.split_once("[bus]").expect("the bus");
    let two = format!("{before}[bus]{after}")
        .replacen("[1000.0, 1000.0, 300.0]", "[1000.0, 1000.0]", 1)
        .replacen("[8000.0, 8000.0, 4000.0]", "[8000.0, 8000.0]", 1);
    let found = finding(&two, "A2", "A2", "[[axes]]");
    assert_eq!(found.gravity, Gravity::Error);
    assert!(
        found.text.contains("a gantry has 3 to 4 axes, and there are 2"),
        "{found}"
    );
    assert!(found.text.contains("[pen]"), "{found}");
}

#[test]
fn two_axes_on_one_drive_are_named() {
    let one = SCARA.replacen("sync_angle_rad = -0.65", "sync_angle_rad = -0.65\nserial = 7", 1);
    let found = finding(
        &one,
        "sync_angle_rad = 1.6",
        "sync_angle_rad = 1.6\nserial  = 7",
        "serial  = 7",
    );
    assert!(
        found.text.contains("axis 2") && found.text.contains("same drive"),
        "{found}"
    );
}

#[test]
fn a_linear_axis_without_pitch_is_named() {
    let found = finding(
        GANTRY,
        "# y: the beam\npitch_mm = 40.0\n",
        "# y: the beam\n",
        "# y: the beam",
    );
    assert!(
        found.text.contains("pitch_mm") && found.text.contains("missing"),
        "{found}"
    );
}

#[test]
fn a_sheet_and_a_work_area_outside_the_reach_are_named() {
    let found = finding(
        GANTRY,
        "centre_mm = [320.0, 240.0]",
        "centre_mm = [600.0, 240.0]",
        "centre_mm",
    );
    assert_eq!(found.gravity, Gravity::Error);
    assert!(
        found.text.contains("x 700.0") && found.text.contains("[paper]"),
        "{found}"
    );
    let found = finding(
        GANTRY,
        "x_mm = [10.0, 630.0]",
        "x_mm = [10.0, 690.0]",
        "x_mm = [10.0, 690.0]",
    );
    assert!(
        found.text.contains("x 690.0") && found.text.contains("[work_area]"),
        "{found}"
    );
    let found = finding(SCARA, "radius_mm = 385.0", "radius_mm = 405.0", "radius_mm = 405.0");
    assert_eq!(found.gravity, Gravity::Error);
    assert!(
        found.text.contains("work_area.radius_mm is 405") && found.text.contains("to 400"),
        "{found}"
    );
}

#[test]
fn a_hole_in_the_sheet_is_told_though_its_corners_and_its_middle_are_reached() {
    let found = finding(
        SCARA,
        "centre_mm = [260.0, 0.0]\nsize_mm = [200.0, 200.0]",
        "centre_mm = [180.0, 0.0]\nsize_mm = [200.0, 400.0]",
        "centre_mm",
    );
    assert_eq!(found.gravity, Gravity::Warning);
    // Nearer to the shoulder than the ring's inner edge, 140 mm.
    let number = |name: &str| -> f64 {
        let (_, rest) = found.text.split_once(&format!("{name} ")).expect(name);
        rest.split(',')
            .next()
            .and_then(|number| number.parse().ok())
            .expect(name)
    };
    let away_mm = number("x").hypot(number("y"));
    assert!((80.0..140.0).contains(&away_mm), "{found}");
    assert!(found.text.ends_with("a drawing that comes there is refused"), "{found}");
}

#[test]
fn limits_of_zero_are_named_in_the_unit_of_the_axis() {
    let found = finding(
        GANTRY,
        "output_max_mm_s = 1300.0",
        "output_max_mm_s = 0.0",
        "output_max_mm_s",
    );
    assert!(
        found
            .text
            .starts_with("axes.output_max_mm_s of axis 1 is 0, allowed is 1 to "),
        "{found}"
    );
    let found = finding(
        GANTRY,
        "joint_speed = [1000.0, 1000.0, 300.0]",
        "joint_speed = [1000.0, 0.0, 300.0]",
        "joint_speed",
    );
    assert!(
        found.text.contains("motion.joint_speed") && found.text.contains("is 0"),
        "{found}"
    );
    let found = finding(GANTRY, "speed_mm_s = 250.0", "speed_mm_s = 0.0", "speed_mm_s = 0.0");
    assert!(found.text.contains("motion.speed_mm_s is 0"), "{found}");
}

#[test]
fn a_pen_without_its_output_is_named() {
    let found = finding(COREXY, "role = \"pen\"", "role = \"none\"", "kind = \"output\"");
    assert!(found.text.contains("role = \"pen\""), "{found}");
}

#[test]
fn words_without_room_in_the_samples_are_named() {
    let point = |number: usize, kind: &str| {
        format!(
            "\n[[io]]\nname = \"w{number}\"\nslave = 9\nbit = {}\ntype = \"{kind}\"\n",
            32 * number
        )
    };
    let with = |kinds: &[&str]| {
        let points: String = kinds
            .iter()
            .enumerate()
            .map(|(number, kind)| point(number, kind))
            .collect();
        check(&format!("{COREXY}{points}"))
    };
    assert_eq!(with(&["u16", "i16", "bool", "u16", "u16"]), vec![]);
    let found = with(&["u32", "u16", "u32", "bool", "u8"]);
    assert_eq!(found.len(), 1, "the byte has room: {found:#?}");
    for (finding, name) in found.iter().zip(["w2"]) {
        assert!(
            finding.gravity == Gravity::Warning && finding.text.contains(name),
            "{finding}"
        );
        assert!(
            finding.line.is_some() && finding.text.contains("first 4 words"),
            "{finding}"
        );
    }
}

#[test]
fn unlikely_values_are_warnings() {
    let found = check(&COREXY.replacen("quick_stop_mm_s2 = 12000.0", "quick_stop_mm_s2 = 2500.0", 1));
    assert_eq!(found.len(), 2, "one for each belt: {found:#?}");
    assert!(
        found[0].gravity == Gravity::Warning && found[0].text.contains("2500 mm/s2"),
        "{}",
        found[0]
    );
}

#[test]
fn motors_that_turn_too_fast_and_commands_that_end_too_early_are_warnings() {
    let found = check(&COREXY.replacen("output_max_mm_s = 1500.0", "output_max_mm_s = 1000.0", 1));
    assert_eq!(found.len(), 2, "{found:#?}");
    assert!(
        found[0].text.contains("1200 mm/s") && found[0].text.contains("1000 mm/s"),
        "{}",
        found[0]
    );
    let found = check(&COREXY.replacen("pitch_mm = 40.0", "pitch_mm = 5.0", 1));
    assert!(found[0].text.contains("14400 revolutions"), "{found:#?}");
}

#[test]
fn what_is_missing_is_told_without_a_line() {
    let found = check("[motion]\nspeed_mm_s = 100.0\n");
    let names: Vec<_> = found.iter().map(|finding| &finding.text[..10]).collect();
    assert_eq!(names, ["[geometry]", "[work_area", "[paper] is", "[[axes]] i"]);
    assert!(check("[motion\n")[0].text.contains("line 1"));
}

#[test]
fn a_jerk_window_that_the_planner_shortens_is_named_with_the_longest() {
    let sample = include_str!("../../../../samples/etherpen.toml");
    let (from, at) = ("jerk_window_ms = 4 ", "jerk_window_ms");
    let found = finding(sample, from, "jerk_window_ms = 32 ", at);
    assert_eq!(found.gravity, Gravity::Warning);
    assert!(found.text.contains("jerk_window_ms = 7,"), "{found}");
    let longest = sample.replacen(from, "jerk_window_ms = 7 ", 1);
    assert_eq!(check(&longest), []);
}

/// The CoreXY with a laser at its output terminal.
fn laser(tool: &str, point: &str) -> String {
    let pen = "[pen]\nkind = \"output\"              # the output with the role \"pen\" lowers it\ndown_ms = 50                 \
               # from the output to the paper\nup_ms = 40                   # and back\n";
    assert!(COREXY.contains(pen));
    let text = COREXY.replacen(pen, &format!("[pen]\nkind = \"none\"\n\n[tool]\n{tool}\n"), 1);
    let text = text.replacen("[[io]]\nname = \"pen\"", "[[io]] # the laser\nname = \"pen\"", 1);
    text.replacen("role = \"pen\"", point, 1)
}

#[test]
fn a_tool_is_right_or_named_with_its_line_and_what_to_write() {
    let word = "role = \"tool\"\ntype = \"u16\"";
    let speed = "follows = \"speed\"\nnominal_mm_s = 200.0\nminimum = 100\nmaximum = 1000";
    for (tool, point) in [
        (speed, word),
        (speed, "role = \"tool\""),
        ("follows = \"distance\"\npitch_um = 100", word),
        ("follows = \"distance\"\npitch_um = 400", "role = \"tool\""),
    ] {
        assert_eq!(check(&laser(tool, point)), [], "{tool}, {point}");
    }
    for (tool, point, at, said) in [
        (speed, "role = \"none\"", "follows", "role = \"tool\""),
        ("lead_ms = 1", word, "# the laser", "follows = \"speed\""),
        (
            "follows = \"speed\"\nmaximum = 1000",
            word,
            "[tool]",
            "tool.nominal_mm_s is 0, allowed is 1 to 10000",
        ),
        (
            "follows = \"speed\"\nnominal_mm_s = 0.0\nmaximum = 1000",
            word,
            "nominal_mm_s = 0.0",
            "tool.nominal_mm_s is 0, allowed is 1 to 10000",
        ),
        (
            "follows = \"speed\"\nnominal_mm_s = 200.0\nmaximum = 40000",
            "role = \"tool\"\ntype = \"i16\"",
            "maximum = 40000",
            "1 to 32767",
        ),
        (
            "follows = \"speed\"\nnominal_mm_s = 200.0\nminimum = 2000\nmaximum = 1000",
            word,
            "maximum = 1000",
            "minimum not above maximum",
        ),
        (
            "follows = \"distance\"\npitch_um = 100",
            "role = \"tool\"",
            "pitch_um",
            "pitch_um = 400 or more",
        ),
        (
            speed,
            "role = \"tool\"\ntype = \"u16\"\non_fault = \"hold\"",
            "# the laser",
            "no on_fault",
        ),
    ] {
        let text = laser(tool, point);
        let found = finding(&text, "[tool]", "[tool]", at);
        assert_eq!(found.gravity, Gravity::Error, "{found}");
        assert!(found.text.contains(said), "{found}");
    }
    // A way of 0 is out of its bounds, and pulses come faster than any output shows them.
    let found = check(&laser("follows = \"distance\"", word));
    assert!(
        found.len() == 2 && found[0].text.contains("tool.pitch_um is 0, allowed is 10 to 65535"),
        "{found:#?}"
    );
    let slow = laser(speed, word).replacen("[bus]", "[bus]\nwatchdog_ms = 100", 1);
    let found = finding(&slow, "[tool]", "[tool]", "watchdog_ms");
    assert!(
        found.gravity == Gravity::Warning && found.text.contains("watchdog_ms = "),
        "{found}"
    );
}

/// The findings about the CoreXY, whose axes have no switch, with these lines for all of its axes.
fn with_encoders(lines: &str) -> Vec<String> {
    let text = COREXY.replacen("[axis_defaults]", &format!("[axis_defaults]\n{lines}"), 1);
    check(&text)
        .iter()
        .map(|finding| format!("{:?} {finding}", finding.gravity))
        .collect()
}

#[test]
fn what_an_encoder_does_not_know_is_told() {
    for (lines, words) in [
        ("encoder = \"multi-turn\"", "never calibrated"),
        ("encoder = \"multi-turn\"\nsync_increments = -7", "--store writes it"),
        ("encoder = \"incremental\"", "no home switch"),
    ] {
        let findings = with_encoders(lines);
        assert_eq!(findings.len(), 2, "{lines}: {findings:?}");
        for finding in findings {
            assert!(finding.starts_with("Warning") && finding.contains(words), "{finding}");
        }
    }
    // An axis whose drive and mark are known.
    let text = COREXY.replacen(
        "[[axes]]                     # belt a: x + y",
        "[[axes]]\nencoder = \"multi-turn\"\nserial = 5\nsync_increments = 77",
        1,
    );
    assert_ne!(text, COREXY);
    assert_eq!(check(&text), []);
}

#[test]
fn a_multi_turn_encoder_whose_position_repeats_within_its_range_is_refused() {
    let mut long = COREXY.replacen("quick_stop_mm_s2 = 12000.0", "quick_stop_mm_s2 = 6000.0", 1);
    for axis in ["x", "y"] {
        let range = format!("{axis}_range_mm = [-170.0, 170.0]");
        assert!(long.contains(&range));
        long = long.replacen(&range, &format!("{axis}_range_mm = [-1700.0, 1700.0]"), 1);
    }
    // 3,400 mm of each belt from its mark, 40 for a turn: 85 turns.
    for (gear, refused) in [(24.0, 0), (24.2, 2)] {
        let lines = format!("[axis_defaults]\nencoder = \"multi-turn\"\nsync_increments = 5\ngear = {gear}");
        let findings = check(&long.replacen("[axis_defaults]", &lines, 1));
        let errors: Vec<_> = findings
            .iter()
            .filter(|finding| finding.gravity == Gravity::Error)
            .collect();
        assert_eq!(errors.len(), refused, "{gear}: {findings:?}");
        assert!(
            errors.iter().all(|finding| finding.text.contains("repeats")),
            "{findings:?}"
        );
    }
}

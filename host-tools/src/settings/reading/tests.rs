use super::*;
use etherpen::config::Axis;

fn error(text: &str) -> String {
    configuration(text).unwrap_err().to_string()
}

#[test]
fn axes_have_the_shared_values_that_they_do_not_set_themselves() {
    let text =
        "[axis_defaults]\ngear = 10.0\nfeed_forward_gain = 0.9\n[[axes]]\n[[axes]]\ngear = -5\n[[axes]]\n[[axes]]\n";
    let config = configuration(text).unwrap();
    assert_eq!(config.axes.map(|axis| axis.gear), [10.0, -5.0, 10.0, 10.0]);
    assert_eq!(config.axes.map(|axis| axis.feed_forward_gain), [0.9; AXES]);
    let config = configuration("[axis_defaults]\ngear = 10.0\n").unwrap();
    assert_eq!(config.axes.map(|axis| axis.gear), [10.0; AXES]);
    assert!(error("axis_defaults = 3\n").contains("line 1: axis_defaults is a table"));
    let unknown = error("[axis_defaults]\ngears = 10.0\n[[axes]]\n");
    assert!(unknown.contains("line 2") && unknown.contains("gears"), "{unknown}");
}

#[test]
fn fewer_axes_are_a_machine_with_fewer_drives() {
    let config = configuration("[[axes]]\n[[axes]]\n[[axes]]\ngear = 7.0\n").unwrap();
    assert_eq!((config.bus.drives, config.axes[2].gear), (3, 7.0));
    assert_eq!(config.axes[3], Axis::default());
    assert_eq!(configuration("axes = [{}, {}, {}, {}]").unwrap().bus.drives, 4);
    assert_eq!(
        error("axes = [{}, {},\n {}, {}, {}]"),
        "line 2: a machine has at most 4 axes"
    );
}

/// The error of the bundled gantry with a replaced part.
fn gantry(from: &str, to: &str) -> String {
    let sample = include_str!("../../../../samples/machines/gantry.toml");
    assert!(sample.contains(from), "{from}");
    error(&sample.replacen(from, to, 1))
}

#[test]
fn what_no_axis_takes_and_what_is_written_twice_is_refused() {
    let radians = gantry("quick_stop_mm_s2 = 10000.0", "quick_stop_rad_s2 = 100.0");
    assert!(
        radians.contains("axis_defaults.quick_stop_rad_s2") && radians.contains("write quick_stop_mm_s2"),
        "{radians}"
    );
    let two = gantry(
        "joint_speed = [1000.0, 1000.0, 300.0]",
        "joint_speed = [1000.0, 1000.0]",
    );
    assert!(two.contains("3 are needed, and there are 2"), "{two}");
    let drives = gantry("[bus]\n", "[bus]\ndrives = 4\n");
    assert!(drives.contains("bus.drives is 4, and there are 3"), "{drives}");
    let twice =
        error("axes = [{}, {}, {}, {}]\n[motion]\njoint_speed = [1, 1, 1, 1]\njoint_speed_rad_s = [1, 1, 1, 1]\n");
    assert!(
        twice.starts_with("line 3: ") && twice.contains("write one of them"),
        "{twice}"
    );
}

#[test]
fn a_home_without_switch_or_speed_is_refused() {
    let no_switch = gantry("switch = \"x_home\", ", "");
    assert!(no_switch.contains("axis 1: home has no switch"), "{no_switch}");
    let no_speed = gantry("speed_mm_s = -60.0, ", "");
    assert!(no_speed.contains("speed_mm_s of home is missing"), "{no_speed}");
    let both = gantry("switch = \"x_home\"", "switch = \"x_home\", io = 0");
    assert!(both.contains("switch and io"), "{both}");
    // The program itself writes the values of a machine without switches.
    let written = toml::to_string(&Config::default()).unwrap();
    assert!(written.contains("home"), "{written}");
    assert_eq!(configuration(&written), Ok(Config::default()));
}

#[test]
fn a_kind_that_does_not_exist_or_is_missing_is_told_first_with_all_kinds() {
    let misspelt = gantry("kind = \"gantry\"", "kind = \"gantri\"");
    assert!(
        misspelt.contains("gantri") && misspelt.contains("\"linear-delta\""),
        "{misspelt}"
    );
    let missing = gantry("kind = \"gantry\"\n", "");
    assert!(
        missing.starts_with("line 5: [geometry] has no kind") && missing.contains("\"corexy\""),
        "{missing}"
    );
    assert!(
        configuration("[geometry]\nforearm_mm = 810.0\n").is_ok(),
        "a delta needs none"
    );
}

#[test]
fn numbers_that_are_not_finite_are_refused_by_name() {
    let text = gantry("speed_mm_s = 250.0", "speed_mm_s = nan");
    assert!(text.contains("motion.speed_mm_s is nan"), "{text}");
    let text = gantry("sync_mm = 2.0", "sync_mm = -inf");
    assert!(text.contains("axes.sync_mm is -inf"), "{text}");
    let text = gantry("centre_mm = [320.0, 240.0]", "centre_mm = [320.0, nan]");
    assert!(text.contains("paper.centre_mm is nan"), "{text}");
}

#[test]
fn a_file_without_any_of_it_is_read_as_toml_reads_it() {
    let sample = include_str!("../../../../samples/etherpen.toml");
    assert_eq!(configuration(sample).unwrap(), toml::from_str(sample).unwrap());
    assert_eq!(configuration("").unwrap(), Config::default());
    for wrong in [
        "[motion]\nsped = 3\n",
        "axes = 3\n",
        "[motion\n",
        "[motion]\nspeed_mm_s = 'fast'\n",
    ] {
        let expected = toml::from_str::<Config>(wrong).unwrap_err().to_string();
        assert_eq!(error(wrong), expected);
    }
}

//! Values of the cells, their file, and their documentation.

use super::*;
use std::fmt::Write;

/// `docs/cell.md`.
const DOCUMENT: &str = include_str!("../../../../docs/cell.md");

#[test]
fn both_cells_are_within_the_bounds_and_name_every_value_once() {
    for physics in [Physics::NOMINAL, Physics::PESSIMISTIC] {
        assert_eq!(physics.check(), Ok(()));
    }
    let mut names = Physics::NOMINAL.values().map(|value| value.name).to_vec();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), VALUES);
}

#[test]
fn the_table_of_the_document_has_the_values_of_both_cells_and_a_source_for_each() {
    let rows: Vec<Vec<&str>> = DOCUMENT
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    let mut expected = vec![["`velocity_loop.kind`", "", "lag", "pi"].map(str::to_owned)];
    for (nominal, pessimistic) in Physics::NOMINAL.values().iter().zip(Physics::PESSIMISTIC.values()) {
        expected.push([
            format!("`{}`", nominal.name),
            nominal.unit.to_owned(),
            nominal.value.to_string(),
            pessimistic.value.to_string(),
        ]);
    }
    let mut table = String::new();
    expected
        .iter()
        .for_each(|row| writeln!(table, "| {} |", row.join(" | ")).expect("memory"));
    let documented: Vec<&[&str]> = rows.iter().map(|row| row.get(..4).unwrap_or_default()).collect();
    assert_eq!(documented, expected, "docs/cell.md needs these rows:\n{table}");
    for row in &rows {
        assert_eq!(row.len(), 5, "{row:?}");
        assert!(row[4].len() > 10, "{} has no source", row[0]);
    }
}

#[test]
fn the_example_of_the_document_is_a_cell() {
    let (_, behind) = DOCUMENT.split_once("```toml\n").expect("an example");
    let (example, _) = behind.split_once("```").expect("its end");
    let physics: Physics = example.parse().expect("a valid example");
    assert_ne!(physics, Physics::NOMINAL);
}

#[test]
fn a_sheet_lies_where_its_section_says_and_else_as_configured() {
    let configured = Paper::default();
    assert_eq!(Physics::PESSIMISTIC.paper(&configured), configured);
    let physics: Physics = "[sheet]\nz_mm = -851.5\nslope_x = 0.0087".parse().expect("a sheet");
    let paper = physics.paper(&configured);
    assert_eq!((paper.pen_down_z_mm, paper.slope), (-851.5, [0.0087, 0.0]));
    assert_eq!(paper.centre_mm, configured.centre_mm);
    let text = toml::to_string(&physics).expect("a text");
    assert_eq!(text.parse::<Physics>().expect("its own text"), physics);
}

#[test]
fn a_written_cell_reads_as_itself_and_an_empty_file_is_nominal() {
    let text = toml::to_string(&Physics::PESSIMISTIC).expect("a text");
    assert_eq!(text.parse::<Physics>().expect("its own text"), Physics::PESSIMISTIC);
    assert_eq!("".parse::<Physics>().expect("nothing"), Physics::NOMINAL);
}

#[test]
fn every_name_is_the_key_of_its_value_and_both_bounds_hold() {
    for (place, value) in Physics::NOMINAL.values().into_iter().enumerate() {
        let (section, key) = value.name.split_once('.').expect("a section");
        let read = |number: f64| format!("[{section}]\n{key} = {number}").parse::<Physics>();
        for bound in [value.low, value.high] {
            let values = read(bound).expect(value.name).values();
            assert_eq!(values[place].value, bound, "{}", value.name);
            let changed = values
                .iter()
                .zip(Physics::NOMINAL.values())
                .filter(|(now, before)| *now != before);
            assert!(changed.count() <= 1, "{}", value.name);
        }
        for beyond in [value.low - 1.0, value.high + 1.0] {
            assert!(read(beyond).is_err(), "{} = {beyond}", value.name);
        }
    }
}

#[test]
fn unknown_keys_and_values_outside_their_bounds_are_refused_by_name() {
    for (text, part) in [
        ("[velocity_loop]\nbandwith_hz = 50.0", "bandwith_hz"),
        ("[gearbox]\nratio = 3", "gearbox"),
        ("[velocity_loop]\nkind = \"pid\"", "pid"),
        (
            "[velocity_loop]\nbandwidth_hz = 0.0",
            "velocity_loop.bandwidth_hz = 0 is outside its bounds of 1 to 1000",
        ),
        ("[payload]\nmass_kg = nan", "payload.mass_kg = NaN"),
        ("[dead_time]\ncommand_cycles = 21", "dead_time.command_cycles = 21"),
        ("[dead_time]\ncommand_cycles = -1", "command_cycles"),
        ("[payload", "payload"),
        ("[sheet]\nslope_x = 0.01", "z_mm"),
        (
            "[sheet]\nz_mm = -850\nslope_y = 0.6",
            "sheet.slope_y = 0.6 is outside its bounds of -0.5 to 0.5",
        ),
    ] {
        let error = text.parse::<Physics>().expect_err(text).to_string();
        assert!(error.contains(part), "{text}: {error}");
    }
}

#[test]
fn a_file_that_cannot_be_read_is_named_with_what_is_possible() {
    let choice: CellChoice = "no/such/cell.toml".parse().expect("any text is a choice");
    let message = choice.load().expect_err("no such file").message;
    assert!(
        message.contains("no/such/cell.toml") && message.contains("pessimistic"),
        "{message}"
    );
    assert_eq!("pessimistic".parse(), Ok(CellChoice::Pessimistic));
}

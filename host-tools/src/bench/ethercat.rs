//! Cost of the EtherCAT master: instructions of a cycle, memory, code size, frames of a bring-up; compared with
//! ethercrab.

use super::programs::{self, Machine};
use super::{BenchError, BenchReport, BenchRow, Selection, bring_up};

const SUBJECTS: [&str; 2] = ["etherpen", "ethercrab"];
/// Cyclic exchanges of four drives, by their names in the crate `benchmarks`.
const CYCLIC: [&str; 6] = [
    "cyclic/lrw",
    "cyclic/lrw+frmw+brd",
    "cyclic/split",
    "cyclic/lrw/ax2000",
    "cyclic/lrw+frmw+brd/ax2000",
    "cyclic/split/ax2000",
];
/// The cycle with AL status and clock of sixteen drives, measured for this project's master only.
const SIXTEEN: &str = "cyclic/lrw+frmw+brd/16";
/// Most instructions of a cycle with AL status and clock on the Cortex-M7.
const CYCLE_INSTRUCTIONS_MAX: f64 = 560.0;
/// Most instructions that each further slave with process data adds to it.
const SLAVE_INSTRUCTIONS_MAX: f64 = 60.0;
/// Most static memory of a master for 16 slaves, bytes.
const RAM_BYTES_MAX: f64 = 32_768.0;
/// Most acyclic frames until four identical drives with clocks are in OP.
const BRING_UP_FRAMES_MAX: f64 = 400.0;

/// A row that is selected but not measured yet.
struct Wanted {
    case: String,
    subject: &'static str,
    unit: &'static str,
    target: Option<f64>,
    measure: Measure,
}

/// Method of measurement.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Measure {
    /// A line of the program in the emulator, by the case's name there.
    Emulated(&'static str),
    /// Counted by callgrind.
    Callgrind(&'static str),
    /// The size of an image.
    Code,
    /// Acyclic frames to OP, with clocks.
    BringUp,
    /// Cyclic frames to OP, most of them while the clocks settle; of this project's master.
    Settling,
}

/// All rows, in the order of the report.
fn rows() -> Vec<Wanted> {
    let mut rows = Vec::new();
    let mut row = |case: String, unit, target: Option<f64>, measure| {
        let is_own = matches!(measure, Measure::Emulated(SIXTEEN) | Measure::Settling);
        for subject in &SUBJECTS[..if is_own { 1 } else { SUBJECTS.len() }] {
            rows.push(Wanted {
                case: case.clone(),
                subject,
                unit,
                target: target.filter(|_| *subject == "etherpen"),
                measure,
            });
        }
    };
    for case in CYCLIC {
        let target = case.contains("+frmw+brd").then_some(CYCLE_INSTRUCTIONS_MAX);
        row(
            format!("{case}@cortex-m7"),
            "instructions",
            target,
            Measure::Emulated(case),
        );
    }
    row(
        format!("{SIXTEEN}@cortex-m7"),
        "instructions",
        Some(CYCLE_INSTRUCTIONS_MAX + 12.0 * SLAVE_INSTRUCTIONS_MAX),
        Measure::Emulated(SIXTEEN),
    );
    for case in CYCLIC {
        row(format!("{case}@host"), "instructions", None, Measure::Callgrind(case));
    }
    row(
        "ram_bytes".into(),
        "bytes",
        Some(RAM_BYTES_MAX),
        Measure::Emulated("ram_bytes"),
    );
    row("code_bytes".into(), "bytes", None, Measure::Code);
    row(
        "bringup_frames".into(),
        "frames",
        Some(BRING_UP_FRAMES_MAX),
        Measure::BringUp,
    );
    row("settling_frames".into(), "frames", None, Measure::Settling);
    rows
}

/// Measures the selected rows; `progress` gets a description of each step.
///
/// # Errors
/// The first failure.
pub fn run(selection: &Selection, mut progress: impl FnMut(&str)) -> Result<BenchReport, BenchError> {
    let mut wanted = rows();
    wanted.retain(|row| selection.wants(&row.case, row.subject));
    build(&wanted, &mut progress)?;
    let mut printed = None;
    let mut rows = Vec::new();
    for Wanted {
        case,
        subject,
        unit,
        target,
        measure,
    } in wanted
    {
        let value = match measure {
            Measure::Emulated(name) => {
                let lines = match &printed {
                    Some(lines) => lines,
                    None => {
                        progress("counting in the emulator");
                        printed.insert(programs::emulate("cortex_m7")?)
                    }
                };
                find(lines, name, subject)?
            }
            Measure::Callgrind(name) => {
                progress(&format!("counting {case} of {subject}"));
                programs::callgrind(subject, name)?
            }
            Measure::Code => {
                let image = programs::code_bytes(&format!("code_{subject}"))?;
                image.saturating_sub(programs::code_bytes("code_none")?)
            }
            Measure::BringUp if subject == "etherpen" => bring_up::etherpen()?.acyclic,
            Measure::Settling => bring_up::etherpen()?.cyclic,
            Measure::BringUp => bring_up::ethercrab()?,
        };
        let value = value as f64;
        rows.push(BenchRow {
            case,
            subject,
            value,
            unit,
            target,
        });
    }
    Ok(BenchReport {
        bench: "ethercat",
        rows,
    })
}

/// Builds the programs for the selected rows.
fn build(wanted: &[Wanted], progress: &mut impl FnMut(&str)) -> Result<(), BenchError> {
    let any = |needs: fn(&Wanted) -> bool| wanted.iter().any(needs);
    let mut emulated = Vec::new();
    if any(|row| matches!(row.measure, Measure::Emulated(_))) {
        emulated.push("cortex_m7");
    }
    if any(|row| row.measure == Measure::Code) {
        emulated.extend(["code_none", "code_etherpen", "code_ethercrab"]);
    }
    let mut host = Vec::new();
    if any(|row| matches!(row.measure, Measure::Callgrind(_))) {
        host.push("callgrind");
    }
    if any(|row| row.measure == Measure::BringUp && row.subject == "ethercrab") {
        host.push("bring_up");
    }
    for (machine, programs) in [(Machine::CortexM7, emulated), (Machine::Host, host)] {
        if !programs.is_empty() {
            progress(&format!("building {}", programs.join(", ")));
            programs::build(machine, &programs)?;
        }
    }
    Ok(())
}

/// The number in the line `CASE SUBJECT NUMBER`.
fn find(lines: &str, case: &str, subject: &str) -> Result<u64, BenchError> {
    let mut words = lines.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    words
        .find_map(|words| match words.as_slice() {
            [named, by, number] if *named == case && *by == subject => number.parse().ok(),
            _ => None,
        })
        .ok_or_else(|| BenchError::Program {
            program: "cortex_m7".into(),
            cause: format!("it printed no number for {case} of {subject}:\n{lines}"),
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_of_the_contract_has_a_row_for_both_masters() {
        let rows = rows();
        for case in CYCLIC {
            for machine in ["cortex-m7", "host"] {
                let named = |row: &&Wanted| row.case == format!("{case}@{machine}");
                assert_eq!(rows.iter().filter(named).count(), 2);
            }
        }
        for (case, target) in [("ram_bytes", 32_768.0), ("bringup_frames", 400.0)] {
            let of = |subject| rows.iter().find(|row| row.case == case && row.subject == subject);
            assert_eq!(of("etherpen").map(|row| row.target), Some(Some(target)));
            assert_eq!(of("ethercrab").map(|row| row.target), Some(None));
        }
    }

    #[test]
    fn a_line_is_found_by_case_and_subject_and_its_lack_is_an_error() {
        let lines = "ram_bytes etherpen 7\ncyclic/lrw ethercrab 12\ncyclic/lrw etherpen 11\n";
        assert!(matches!(find(lines, "cyclic/lrw", "etherpen"), Ok(11)));
        assert!(find(lines, "cyclic", "etherpen").is_err());
        assert!(find("cyclic/lrw etherpen many", "cyclic/lrw", "etherpen").is_err());
    }
}

//! The result of a drawing as text on stderr.

use super::Report;
use crate::terminal::{counted, in_colour};
use std::path::Path;

/// Largest distance from the intended line reported as good, mm.
const DEVIATION_GOOD_MM: f64 = 0.1;

/// Prints the result of the drawing.
pub fn summarise(report: &Report, dir: Option<&Path>) {
    eprintln!();
    eprintln!(
        "Drew {}, {:.2} m of line, in {:.1} s (planned {:.1} s).",
        counted(report.strokes, "stroke"),
        report.pen_down_mm / 1_000.0,
        report.drawn_s,
        report.planned_s
    );
    deviations(report);
    cycles(report);
    if let (Some(ratio), Some(processor_s)) = (report.virtual_to_processor_ratio, report.processor_s) {
        eprintln!("Virtual time ran {ratio:.0} times as fast as this process' processor time ({processor_s:.2} s).");
    }
    if let Some(correlation) = report.tone_correlation {
        eprintln!("Seen from afar, the drawing correlates with the photograph by {correlation:.2}.");
    }
    if let Some(dir) = dir {
        let pictures = if report.drives.is_some() {
            "drawn.png, drawn.svg, bus.pcapng, "
        } else {
            ""
        };
        eprintln!(
            "Written to {}: {pictures}report.json, telemetry.csv, telemetry.mcap, tracking.svg, intended.csv",
            dir.display()
        );
    }
}

/// A text in green, or in red if it is not as it should be.
fn good(ok: bool, text: String) -> String {
    in_colour(&text, if ok { "32" } else { "1;31" })
}

/// Prints how far pen and ink were from the lines.
fn deviations(report: &Report) {
    eprintln!(
        "The pen stayed within {} of the intended lines ({:.3} mm rms).",
        good(
            report.path_deviation_max_mm <= DEVIATION_GOOD_MM,
            format!("{:.3} mm", report.path_deviation_max_mm)
        ),
        report.path_deviation_rms_mm
    );
    eprintln!(
        "Of that the shaping takes {:.3} of its {:.3} mm; the axes follow the shaped path within {:.3} mm ({:.3} mm rms).",
        report.shaping_deviation_max_mm,
        report.shaping_tolerance_mm,
        report.tracking_error_max_mm,
        report.tracking_error_rms_mm
    );
    if report.drives.is_some() {
        eprintln!(
            "The ink lies within {} of the lines ({:.3} mm rms); missing: {}.",
            good(
                report.ink_deviation_max_mm <= DEVIATION_GOOD_MM,
                format!("{:.3} mm", report.ink_deviation_max_mm)
            ),
            report.ink_deviation_rms_mm,
            good(report.ink_missing_mm == 0.0, format!("{:.1} mm", report.ink_missing_mm))
        );
    }
    if report.not_verified_mm > 0.0 {
        eprintln!(
            "Not verified: {:.1} of {:.1} mm, for which telemetry was lost on the line.",
            report.not_verified_mm,
            report.followed_mm + report.not_followed_mm + report.not_verified_mm
        );
    }
    let shares = report.limits.iter().map(|axis| {
        let [most, limit] = axis.acceleration;
        most / limit
    });
    let share = shares.fold(0.0_f64, f64::max);
    eprintln!(
        "Joints used at most {:.0} % of their acceleration limit.",
        100.0 * share
    );
}

/// Prints what went wrong in the cycles.
fn cycles(report: &Report) {
    let clean = report.cycles_late == 0
        && report.frames_lost == 0
        && report.working_counter_errors == 0
        && report.reference_underruns == 0;
    eprintln!(
        "{}{}: {}.",
        counted(report.cycles, "millisecond"),
        if report.drives.is_some() {
            ""
        } else {
            " since the drawing began"
        },
        good(
            clean,
            format!(
                "{} late, {} lost, {}, {}",
                report.cycles_late,
                counted(report.frames_lost, "frame"),
                counted(report.working_counter_errors, "working counter error"),
                counted(report.reference_underruns, "reference underrun")
            )
        )
    );
}

//! The table of a benchmark as text.

use super::{BenchReport, BenchRow};

/// One line for each case: the project's figure, its target, the peers' figures, and the ratio of the project's to the
/// smallest of them.
pub fn table(report: &BenchReport) -> String {
    let mut text = format!(
        "{:<52} {:>9} {:<13} {:>16} {:>7}  peers\n",
        "case", "etherpen", "", "target", "ratio"
    );
    let ours = report.rows.iter().filter(|row| row.subject == "etherpen");
    for row in ours {
        let peers = || {
            let others = report.rows.iter();
            others.filter(|peer| peer.case == row.case && peer.subject != row.subject)
        };
        let theirs: Vec<String> = peers()
            .map(|peer| format!("{} {}", peer.subject, figure(peer.value)))
            .collect();
        let best = peers().map(|peer| peer.value).reduce(f64::min);
        let ratio = best.map_or_else(String::new, |best| format!("{:.2}", best / row.value));
        let line = format!(
            "{:<52} {:>9} {:<13} {:>16} {ratio:>7}  {}",
            row.case,
            figure(row.value),
            row.unit,
            target(row),
            theirs.join(", ")
        );
        text.push_str(line.trim_end());
        text.push('\n');
    }
    let alone =
        |row: &&BenchRow| row.subject != "etherpen" && !report.rows.iter().any(|other| other.subject == "etherpen");
    for row in report.rows.iter().filter(alone) {
        text.push_str(&format!(
            "{:<52} {:>9} {:<13} {}\n",
            row.case,
            figure(row.value),
            row.unit,
            row.subject
        ));
    }
    text
}

/// Whole numbers unchanged, others with four significant digits.
fn figure(value: f64) -> String {
    if value.fract() == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let places = (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.places$}")
}

fn target(row: &BenchRow) -> String {
    let sign = if row.is_more_better() { ">=" } else { "<=" };
    match (row.target, row.met()) {
        (Some(target), Some(true)) => format!("{sign} {} met", figure(target)),
        (Some(target), _) => format!("{sign} {} missed", figure(target)),
        (None, _) => String::new(),
    }
}

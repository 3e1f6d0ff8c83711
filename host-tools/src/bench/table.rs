//! The table of a benchmark as text.

use super::{BenchReport, BenchRow};

/// One line for each case: the project's figure, its target, the peers' figures, and the ratio to the best of them, above
/// 1 where the project is better; none if one of the two is not above 0.
pub fn table(report: &BenchReport) -> String {
    let mut text = format!(
        "{:<52} {:>9} {:<13} {:>16} {:>7}  peers\n",
        "case", "etherpen", "", "target", "ratio"
    );
    let ours = report.rows.iter().filter(|row| row.subject == "etherpen");
    for row in ours {
        let peers = || {
            let others = report.rows.iter();
            others.filter(|peer| is_compared(&row.case, &peer.case) && peer.subject != row.subject)
        };
        let theirs: Vec<String> = peers()
            .map(|peer| format!("{} {}", peer.subject, figure(peer.value)))
            .collect();
        let values = peers().map(|peer| peer.value);
        let ratio = match row.is_more_better() {
            true => values.reduce(f64::max).map(|best| (row.value, best)),
            false => values.reduce(f64::min).map(|best| (best, row.value)),
        };
        let ratio = ratio.filter(|(above, below)| *above > 0.0 && *below > 0.0);
        let ratio = ratio.map(|(above, below)| above / below);
        let ratio = ratio.map_or_else(String::new, |ratio| format!("{ratio:.2}"));
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

/// Whether a peer's case is compared with one of the project's: the same one, or one of which the project has several
/// kinds (`tone/cat/sketch` with a peer's `tone/cat`).
fn is_compared(case: &str, peers: &str) -> bool {
    case.strip_prefix(peers)
        .is_some_and(|kind| kind.is_empty() || kind.starts_with('/'))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_without_kinds_stands_beside_each_kind_of_the_project() {
        let row = |case: &str, subject, value| BenchRow {
            case: case.to_owned(),
            subject,
            value,
            unit: "share",
            target: None,
        };
        let rows = vec![
            row("edges/cat/sketch", "etherpen", 0.5),
            row("edges/cat/tsp", "etherpen", 0.25),
            row("edges/cats", "etherpen", 0.125),
            row("edges/cat", "hatched", 0.75),
        ];
        let shown = table(&BenchReport { bench: "drawing", rows });
        let beside = |ratio: &str| format!("{ratio}  hatched 0.7500");
        let lines: Vec<&str> = shown.lines().skip(1).collect();
        assert!(
            lines[0].ends_with(&beside("0.67")) && lines[1].ends_with(&beside("0.33")),
            "{shown}"
        );
        assert!(!lines[2].contains("hatched"), "{shown}");
    }

    #[test]
    fn figures_that_are_zero_or_negative_have_no_ratio() {
        let ratio = |unit, own: f64, peers: f64| {
            let row = |subject, value| BenchRow {
                case: "margin/cat".to_owned(),
                subject,
                value,
                unit,
                target: None,
            };
            let rows = vec![row("etherpen", own), row("hatched", peers)];
            let shown = table(&BenchReport { bench: "drawing", rows });
            let line = shown.lines().nth(1).expect("a line");
            let (figures, _) = line.split_once("  hatched").expect("a peer");
            let words: Vec<&str> = figures.split_whitespace().skip(3).collect();
            words.join(" ")
        };
        for unit in ["margin", "s"] {
            for (own, peers) in [(0.5, 0.0), (0.5, -0.25), (-0.5, -0.25), (-0.5, 0.25), (0.0, 0.0)] {
                assert_eq!(ratio(unit, own, peers), "", "{own} and {peers} {unit}");
            }
        }
        assert_eq!(ratio("margin", 0.5, 0.25), "2.00");
        assert_eq!(ratio("s", 0.5, 0.25), "0.50");
    }
}

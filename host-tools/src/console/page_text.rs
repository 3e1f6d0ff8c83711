//! The program's messages, worded for the page.
//!
//! The page has buttons and fields; a message with a terminal command does not help there. Invariant: the result of
//! [`for_page`] names no command and no option, and is empty only for an empty message.

/// Whether a text names a command of this program or an option.
fn is_terminal(text: &str) -> bool {
    let names = |(at, mark): (usize, &str)| {
        let before = text.get(..at).and_then(|before| before.chars().next_back());
        let after = text.get(at + mark.len()..).and_then(|after| after.chars().next());
        let begins = before.is_none_or(|before| !before.is_alphanumeric() && before != '-');
        begins && after.is_some_and(|after| after.is_ascii_lowercase())
    };
    text.match_indices("etherpen ").any(names) || text.match_indices("--").any(names)
}

/// Removes parenthesised remarks that are for the terminal.
fn without_asides(text: &str) -> String {
    let (mut told, mut rest) = (String::new(), text);
    while let Some((before, aside)) = rest.split_once('(') {
        let Some((inside, after)) = aside.split_once(')') else {
            break;
        };
        told.push_str(before);
        if is_terminal(inside) {
            told.truncate(told.trim_end().len());
        } else {
            told.push_str(&format!("({inside})"));
        }
        rest = after;
    }
    told + rest
}

/// A text without its parts that are for the terminal.
fn without(text: &str, separator: &str, part: impl Fn(&str) -> Option<String>) -> Option<String> {
    let kept: Vec<String> = text.split(separator).filter_map(part).collect();
    (!kept.is_empty()).then(|| kept.join(separator))
}

/// A message without advice that is for the terminal.
pub(super) fn for_page(message: &str) -> String {
    if !is_terminal(message) {
        return message.to_owned();
    }
    let plain = without_asides(message);
    let phrase = |text: &str| (!is_terminal(text)).then(|| text.to_owned());
    let told = without(&plain, ";", |clause| without(clause, ",", phrase));
    let told = told.unwrap_or_default();
    match told.trim_matches([' ', ';', ',', ':']) {
        "" => "this is not possible now".to_owned(),
        _ => told,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::{Path, PathBuf};

    #[test]
    fn advice_for_the_terminal_is_left_out_and_the_rest_stays() {
        for (message, told) in [
            ("slave 2 does not answer", "slave 2 does not answer"),
            (
                "the robot is busy: Drawing; wait for it, or end what it does (etherpen cancel)",
                "the robot is busy: Drawing; wait for it, or end what it does",
            ),
            (
                "the fault is latched; etherpen acknowledge (or draw --acknowledge) clears it",
                "the fault is latched",
            ),
            (
                "check the pose (it moved) and home the robot (etherpen home), then draw --resume",
                "check the pose (it moved) and home the robot",
            ),
            ("etherpen cancel", "this is not possible now"),
            ("x -- y, 3--4 and a-b", "x -- y, 3--4 and a-b"),
        ] {
            assert_eq!(for_page(message), told);
        }
    }

    fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                sources(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }

    /// Texts in quotation marks of a source, joined where a line ends in a backslash.
    fn texts(source: &str) -> Vec<String> {
        let joined: Vec<&str> = source.split("\\\n").map(str::trim_start).collect();
        let joined = joined.concat();
        let lines = joined.lines().filter(|line| !line.trim_start().starts_with("//"));
        lines
            .flat_map(|line| line.split('"').skip(1).step_by(2))
            .map(str::to_owned)
            .collect()
    }

    #[test]
    fn no_message_that_can_reach_the_page_names_a_command() {
        let mut files = Vec::new();
        for folder in ["link", "machine", "drawing"] {
            sources(
                &Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(folder),
                &mut files,
            );
        }
        let all: Vec<String> = files
            .iter()
            .flat_map(|file| texts(&std::fs::read_to_string(file).unwrap()))
            .collect();
        let advising: Vec<&String> = all.iter().filter(|text| is_terminal(text)).collect();
        assert!(advising.len() > 5, "the search finds them: {advising:?}");
        for text in advising {
            let told = for_page(text);
            assert!(!is_terminal(&told) && !told.is_empty(), "{text}: {told}");
            // With any text around it.
            let told = for_page(&format!("portrait.png: stroke 1; {text}"));
            assert!(
                told.starts_with("portrait.png: stroke 1") && !is_terminal(&told),
                "{told}"
            );
        }
    }
}

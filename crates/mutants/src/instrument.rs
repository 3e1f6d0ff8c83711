//! Writes the chosen mutants into a text, and finds the mutant that an error of the compiler is about.

use crate::site::{ORDERED, SWITCH, Site};
use std::ops::Range;

/// Name of the crate with the switch, in the instrumented copy.
pub(crate) const SWITCH_CRATE: &str = "etherpen-mutant-switch";

/// A text with its mutants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Instrumented {
    /// The new text.
    pub text: String,
    /// Bytes of the new text that belong to each mutant, with the mutant's number.
    pub places: Vec<(Range<usize>, u32)>,
}

/// Replaces the sites of one file, which do not overlap; each comes with its mutant's number.
#[must_use]
pub(crate) fn instrument(text: &str, sites: &[(u32, &Site)]) -> Instrumented {
    let mut sites: Vec<_> = sites.to_vec();
    sites.sort_by_key(|(_, site)| site.range.start);
    let mut instrumented = Instrumented {
        text: String::with_capacity(text.len() * 2),
        places: Vec::new(),
    };
    let mut end = 0;
    for (number, site) in sites {
        let new = &mut instrumented.text;
        new.push_str(&text[end..site.range.start]);
        let start = new.len();
        let switch = format!("::{}", SWITCH_CRATE.replace('-', "_"));
        let replacement = site.replacement.replace(SWITCH, &format!("{switch}::on({number})"));
        new.push_str(&replacement.replace(ORDERED, &format!("{switch}::ordered")));
        instrumented.places.push((start..new.len(), number));
        end = site.range.end;
    }
    instrumented.text.push_str(&text[end..]);
    instrumented
}

impl Instrumented {
    /// The mutant whose code shares bytes with a range.
    #[must_use]
    pub(crate) fn mutant_at(&self, bytes: &Range<usize>) -> Option<u32> {
        let shares = |place: &Range<usize>| place.start < bytes.end && bytes.start < place.end;
        self.places
            .iter()
            .find(|(place, _)| shares(place))
            .map(|(_, number)| *number)
    }
}

/// A manifest that depends on the crate with the switch; `path` leads there from the manifest's folder.
///
/// # Errors
/// The manifest has no dependencies.
pub(crate) fn with_switch(manifest: &str, path: &str) -> Result<String, String> {
    const HEADING: &str = "\n[dependencies]\n";
    match manifest.split_once(HEADING) {
        Some((before, after)) => Ok(format!(
            "{before}{HEADING}{SWITCH_CRATE} = {{ path = \"{path}\" }}\n{after}"
        )),
        None => Err("a manifest without [dependencies]".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operators;
    use crate::site::Operator;

    const TEXT: &str = "fn f(a: u8, b: u8) -> bool { a < 3 && !(b == 4) }";

    #[test]
    fn an_error_between_the_bytes_of_a_mutant_is_the_mutants() {
        let sites = operators::sites("f.rs", TEXT).unwrap();
        let of = |code: &str| {
            let is_it = |site: &&Site| site.operator == Operator::Turned && &TEXT[site.range.clone()] == code;
            sites.iter().find(is_it).unwrap()
        };
        let (first, second) = (of("a < 3"), of("b == 4"));
        let instrumented = instrument(TEXT, &[(7, second), (5, first)]);
        let expected = "fn f(a: u8, b: u8) -> bool { (if ::etherpen_mutant_switch::on(5) { (a) >= (3) } else { a < 3 }) && \
             !((if ::etherpen_mutant_switch::on(7) { (b) != (4) } else { b == 4 })) }";
        assert_eq!(instrumented.text, expected);
        let at = |code: &str| {
            let start = expected.find(code).unwrap();
            instrumented.mutant_at(&(start..start + code.len()))
        };
        assert_eq!(at("(a) >= (3)"), Some(5));
        assert_eq!(at("(b) != (4)"), Some(7));
        assert_eq!(at("bool"), None);
    }

    #[test]
    fn a_text_without_sites_stays_as_it_is() {
        let same = instrument(TEXT, &[]);
        assert_eq!((same.text.as_str(), same.places.len()), (TEXT, 0));
    }

    #[test]
    fn the_switch_is_the_first_dependency() {
        let manifest = "[package]\nname = \"a\"\n\n[dependencies]\nb = \"1\"\n";
        let with = with_switch(manifest, "../switch").unwrap();
        let expected =
            "[package]\nname = \"a\"\n\n[dependencies]\netherpen-mutant-switch = { path = \"../switch\" }\nb = \"1\"\n";
        assert_eq!(with, expected);
        assert!(with_switch("[package]\n", "x").is_err());
    }
}

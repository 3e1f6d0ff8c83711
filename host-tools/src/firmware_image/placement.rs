//! Linker patterns for functions: the section names that a function may have, whichever compiler built it.
//!
//! The compiler puts each function into a section of its own that carries its mangled name. Names change with the
//! mangling scheme and with each build (a hash, the number of a code generation unit); the identifiers of a path and
//! their order do not. A pattern therefore consists of the identifiers, each with its length in front of it as both
//! schemes write them, and accepts anything between them.

/// The pattern of a function's section, in the language of linker scripts.
///
/// ```
/// use host_tools::firmware_image::section_pattern;
/// let legacy = "_ZN8etherpen5queue3put17h0123456789abcdefE.llvm.42";
/// assert_eq!(section_pattern(legacy), ".text.*8etherpen*5queue*3put*");
/// assert_eq!(section_pattern("_RNvNtCs7ldSeZOOJos_4core3fmt5write"), ".text._RNvNtCs*_4core3fmt5write");
/// assert_eq!(section_pattern("TIM1_UP"), ".text.TIM1_UP");
/// assert_eq!(section_pattern("__aeabi_memcpy4"), ".text.*memcpy*");
/// ```
#[must_use]
pub fn section_pattern(name: &str) -> String {
    if let Some(helper) = name.strip_prefix("__aeabi_") {
        // The compiler's helpers share a section between entry points for different alignments; its name lacks the
        // prefix.
        return format!(".text.*{}*", helper.trim_end_matches(|c: char| c.is_ascii_digit()));
    }
    let Some(path) = name.strip_prefix("_ZN") else {
        return format!(".text.{}", without_hash(name));
    };
    let mut identifiers = Vec::new();
    let mut rest = path;
    while let Some((segment, after)) = segment(rest) {
        rest = after;
        match segment.contains('$') {
            true => identifiers.extend(words(segment)),
            false => identifiers.push(format!("{}{segment}", segment.len())),
        }
    }
    // The last one is a hash.
    identifiers.pop();
    format!(".text.*{}*", identifiers.join("*"))
}

/// The next length and identifier of a legacy name, and what follows.
fn segment(path: &str) -> Option<(&str, &str)> {
    let digits = path.find(|c: char| !c.is_ascii_digit())?;
    let length: usize = path[..digits].parse().ok()?;
    path[digits..].split_at_checked(length)
}

/// Identifiers in a segment that names a type or an implementation, without `$` codes, punctuation, keywords and type
/// parameters. Their lengths are left out too, because both schemes write them only in front of plain identifiers.
fn words(segment: &str) -> Vec<String> {
    let is_code = |part: &&str| !matches!(*part, "LT" | "GT" | "RF" | "BP" | "LP" | "RP" | "C" | "SP");
    let names = segment
        .split('$')
        .filter(is_code)
        .flat_map(|part| part.split(['.', ' ']));
    let is_kept =
        |word: &&str| word.len() > 1 && !matches!(*word, "as" | "impl" | "mut" | "const" | "dyn" | "u20" | "u3b");
    names
        .filter(is_kept)
        .filter(|word| !is_character_code(word))
        .map(String::from)
        .collect()
}

/// Codes such as `u5b` stand for a character.
fn is_character_code(word: &str) -> bool {
    word.strip_prefix('u')
        .is_some_and(|digits| u32::from_str_radix(digits, 16).is_ok())
}

/// A name of the newer scheme without the base-62 number after `Cs`, which distinguishes two versions of one crate.
fn without_hash(name: &str) -> String {
    let mut kept = String::new();
    let mut rest = name;
    while let Some(at) = rest.find("Cs").filter(|_| name.starts_with("_R")) {
        let (before, number) = rest.split_at(at + "Cs".len());
        kept.push_str(before);
        let end = number.find('_').unwrap_or(0);
        kept.push('*');
        rest = &number[end..];
    }
    kept + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn implementations_and_generic_functions_are_named_by_their_identifiers() {
        for (name, pattern) in [
            (
                "_ZN8etherpen8ethercat6cyclic21Exchange$LT$_$C$_$GT$5adopt17h9d93a367888fdcf0E",
                ".text.*8etherpen*8ethercat*6cyclic*Exchange*5adopt*",
            ),
            (
                "_ZN68_$LT$nucleo..eth..Ethernet$u20$as$u20$embassy_net_driver..Driver$GT$7receive17h433bb671e9d0674eE",
                ".text.*nucleo*eth*Ethernet*embassy_net_driver*Driver*7receive*",
            ),
            (
                "_ZN4core5array40_$LT$impl$u20$$u5b$T$u3b$$u20$N$u5d$$GT$7try_map17h9aa66093feeaf42cE",
                ".text.*4core*5array*7try_map*",
            ),
        ] {
            assert_eq!(section_pattern(name), pattern);
        }
    }

    #[test]
    fn no_name_is_refused() {
        for name in ["", "_ZN", "_ZN9", "_ZN99a", "_R", "_RCs", "Cs", "_ZN1", "_ZN0E"] {
            assert!(section_pattern(name).starts_with(".text."), "{name}");
        }
    }
}

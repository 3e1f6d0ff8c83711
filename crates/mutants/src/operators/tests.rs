use super::*;
use crate::instrument::instrument;

/// What each operator does to the body of a function: operator, and the code with the switch.
fn mutants(body: &str) -> Vec<(Operator, String)> {
    let text = format!("impl A {{ fn f(&mut self) {{ {body} }} }}");
    let sites = sites("a.rs", &text).expect("Rust");
    let of = |site: &Site| {
        assert_eq!(site.function, "A::f");
        let instrumented = instrument(&text, &[(1, site)]).text;
        syn::parse_file(&instrumented).unwrap_or_else(|error| panic!("{instrumented}: {error}"));
        (site.operator, site.replacement.clone())
    };
    sites.iter().map(of).collect()
}

/// The replacements by one operator.
fn by(operator: Operator, body: &str) -> Vec<String> {
    let mutants = mutants(body).into_iter().filter(|(other, _)| *other == operator);
    mutants.map(|(_, replacement)| replacement).collect()
}

#[test]
fn comparisons_are_turned_round_and_their_borders_moved() {
    for (sign, turned, moved) in [("<", ">=", "<="), ("<=", ">", "<"), (">", "<=", ">="), (">=", "<", ">")] {
        let expected = [
            (
                Operator::Turned,
                format!("(if $on {{ (a) {turned} (b as u8) }} else {{ a {sign} b as u8 }})"),
            ),
            (
                Operator::Boundary,
                format!("(if $on {{ $ordered(&(a)) {moved} $ordered(&(b as u8)) }} else {{ a {sign} b as u8 }})"),
            ),
        ];
        assert_eq!(mutants(&format!("let c = a {sign} b as u8;")), expected);
    }
    assert_eq!(
        mutants("g(a == b);"),
        [(Operator::Turned, "(if $on { (a) != (b) } else { a == b })".to_owned())]
    );
    assert_eq!(
        mutants("g(a != b);"),
        [(Operator::Turned, "(if $on { (a) == (b) } else { a != b })".to_owned())]
    );
}

#[test]
fn what_is_set_is_forgotten() {
    for code in [
        "self.a = true",
        "self.a = Some(b)",
        "self.a = Mode::Idle",
        "self.a = Mode::Since { ms: 3 }",
        "*a = [true; 4]",
        "self.a.latch(b)",
    ] {
        assert_eq!(
            by(Operator::Latch, &format!("{code};")),
            [format!("(if !$on {{ {code}; }})")],
            "{code}"
        );
    }
    // A value that is computed is not a latch, and a local variable cannot stay without a value.
    for code in ["self.a = b;", "let a; a = true;", "let a = self.latch(b);"] {
        assert_eq!(mutants(code), [], "{code}");
    }
}

#[test]
fn what_is_set_back_or_counted_stays() {
    for code in [
        "self.a = 0",
        "self.a = [0.0; 4]",
        "self.a = None",
        "self.a = false",
        "(self.a, self.b) = (0, 0)",
    ] {
        assert_eq!(
            by(Operator::Reset, &format!("{code};")),
            [format!("(if !$on {{ {code}; }})")],
            "{code}"
        );
    }
    for code in ["*self = Self::new()", "self.a.clear()"] {
        assert_eq!(
            by(Operator::Reset, &format!("{code};")),
            [format!("(if !$on {{ {code}; }})")],
            "{code}"
        );
    }
    for code in ["self.a += 1", "self.a = self.a.saturating_add(1)", "self.a[1] += b"] {
        assert_eq!(
            by(Operator::Count, &format!("{code};")),
            [format!("(if !$on {{ {code}; }})")],
            "{code}"
        );
    }
    assert_eq!(mutants("let mut a = 0; a += 1;"), []);
}

#[test]
fn an_assignment_that_is_a_branch_of_a_match_is_left_out_too() {
    let expected = ["(if !$on { self.a = true; })"];
    assert_eq!(by(Operator::Latch, "match b { 1 => self.a = true, _ => {} }"), expected);
}

#[test]
fn limits_are_dropped() {
    for (code, without) in [
        ("a.b.min(c)", "a.b"),
        ("(a + b).max(0.0)", "(a + b)"),
        ("a.clamp(-b, b)", "a"),
        ("limited(a, b)", "a"),
    ] {
        let expected = [(Operator::Limit, format!("(if $on {{ {without} }} else {{ {code} }})"))];
        assert_eq!(mutants(&format!("g({code});")), expected);
    }
    // The smallest of an iterator is no limit.
    assert_eq!(mutants("a.iter().min();"), []);
}

#[test]
fn each_side_of_a_condition_is_left_out_unless_it_binds_a_name() {
    assert_eq!(
        by(Operator::Side, "g(a && b && c);"),
        ["($on || (a))", "($on || (b))", "($on || (c))"]
    );
    assert_eq!(by(Operator::Side, "g(a || b);"), ["(!$on && (a))", "(!$on && (b))"]);
    assert_eq!(
        by(Operator::Side, "if let Some(a) = b && c { g(a); }"),
        ["($on || (c))"]
    );
}

#[test]
fn negations_and_guards_are_left_out() {
    assert_eq!(
        mutants("g(!a);"),
        [(Operator::Not, "(if $on { a } else { !a })".to_owned())]
    );
    assert_eq!(by(Operator::Guard, "if a { return; }"), ["!$on && (a)"]);
    assert_eq!(
        by(Operator::Guard, "loop { if let Some(a) = b { g(a); break } }"),
        ["!$on && let Some(a) = b"]
    );
    for code in ["if a { g(); }", "if a { return; } else { g(); }"] {
        assert_eq!(mutants(code), [], "{code}");
    }
}

#[test]
fn tests_constants_patterns_and_display_have_no_mutants() {
    let text = "
        const A: bool = 1 < 2;
        static B: [u8; 1 + (2 < 3) as usize] = [0; (1 < 2) as usize];
        const fn c(a: u8) -> bool { a < 3 }
        impl D { const fn e(a: u8) -> bool { a < 3 } const F: bool = 1 < 2; }
        impl core::fmt::Display for D { fn fmt(&self, f: &mut F) -> R { g(1 < 2) } }
        #[cfg(test)] mod tests { fn f() { g(1 < 2); } }
        #[cfg(target_os = \"none\")] fn f() { g(1 < 2); }
        #[test] fn g() { g(1 < 2); }
        fn h() { match a { 1..=3 => {} _ => {} } assert!(1 < 2); let b = [0; (1 < 2) as usize]; }
    ";
    assert_eq!(sites("a.rs", text).unwrap(), []);
}

#[test]
fn modules_with_tests_in_files_of_their_own_are_known() {
    let text = "mod a; #[cfg(test)] mod tests; #[cfg(test)] mod inner { fn f() {} }";
    assert_eq!(test_modules(text).unwrap(), ["tests"]);
    assert!(test_modules("mod").is_err() && sites("a.rs", "fn").is_err());
}

#[test]
fn equal_changes_of_one_function_are_numbered_and_others_are_not() {
    let text = "impl A { fn f(&mut self) { self.a = 0; self.b = 0; self.a = 0; } fn g(&mut self) { self.a = 0; } }
        impl B { fn f(&mut self) { self.a = 0; } }";
    let numbered: Vec<_> = sites("a.rs", text)
        .unwrap()
        .into_iter()
        .map(|site| (site.function, site.change, site.occurrence))
        .collect();
    let expected = [
        ("A::f", "`self.a = 0` left out", Some(1)),
        ("A::f", "`self.b = 0` left out", None),
        ("A::f", "`self.a = 0` left out", Some(2)),
        ("A::g", "`self.a = 0` left out", None),
        ("B::f", "`self.a = 0` left out", None),
    ];
    let expected = expected.map(|(function, change, occurrence)| (function.to_owned(), change.to_owned(), occurrence));
    assert_eq!(numbered, expected);
}

#[test]
fn a_change_is_told_in_one_short_line() {
    let text = "fn f() { g(a(1,\n    2) < b); }";
    let sites = sites("a.rs", text).unwrap();
    assert_eq!(sites[0].change, "`a(1, 2) < b` becomes `a(1, 2) >= b`");
    let long = format!("fn f() {{ g(!{}); }}", "a".repeat(200));
    let change = &super::sites("a.rs", &long).unwrap()[0].change;
    assert!(change.len() < 180 && change.contains('…'), "{change}");
}

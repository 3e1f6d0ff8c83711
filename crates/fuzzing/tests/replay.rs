//! Every target with its seeds, with its corpus in `fuzz/corpus/`, and with seeded mutations of both.
//!
//! The fuzzer itself needs the nightly toolchain; this test does not. What it found once stays found.

use etherpen_fuzzing::mutation::mutated;
use etherpen_fuzzing::{TARGETS, Target, corpus, folder};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::sync::Mutex;

/// Mutations of a target. The server's targets open a connection for each.
const MUTATIONS: u64 = 3_000;
const MUTATIONS_OF_SERVER: u64 = 300;

/// Panics of any thread since the last look; a thread of a server ends without a word.
static PANICS: Mutex<Vec<String>> = Mutex::new(Vec::new());

fn run(target: &Target, what: &str, bytes: &[u8]) {
    let ended = catch_unwind(AssertUnwindSafe(|| (target.run)(bytes)));
    let panics = std::mem::take(&mut *PANICS.lock().expect("no panic while locked"));
    assert!(
        ended.is_ok() && panics.is_empty(),
        "{}: {what}: {panics:?}\n{}",
        target.name,
        bytes.escape_ascii()
    );
}

fn replay(target: &Target) {
    let seeds = (target.seeds)();
    assert!(!seeds.is_empty(), "{}: no seeds", target.name);
    let kept = corpus(target.name);
    assert!(!kept.is_empty(), "{}: no corpus", target.name);
    let named = seeds
        .iter()
        .enumerate()
        .map(|(number, seed)| (format!("seed {number}"), seed.clone()));
    let inputs: Vec<_> = named.chain(kept).chain([("nothing".to_owned(), Vec::new())]).collect();
    for (name, bytes) in &inputs {
        run(target, name, bytes);
    }
    let mutations = match target.name {
        "console" | "http" => MUTATIONS_OF_SERVER,
        _ => MUTATIONS,
    };
    let count = inputs.len() as u64;
    for seed in 0..mutations {
        let (name, bytes) = &inputs[(seed % count) as usize];
        let (_, other) = &inputs[(seed * 7 / 3 % count) as usize];
        run(
            target,
            &format!("mutation {seed} of {name}"),
            &mutated(bytes, other, seed),
        );
    }
    println!("{}: {count} inputs, {mutations} mutations", target.name);
}

#[test]
fn no_reader_panics_with_the_corpora_and_their_mutations() {
    set_hook(Box::new(|info| {
        PANICS.lock().expect("no panic while locked").push(info.to_string());
    }));
    let name = std::env::var("ETHERPEN_FUZZ_TARGET").ok();
    let chosen = TARGETS
        .iter()
        .filter(|target| name.as_deref().is_none_or(|name| name == target.name));
    chosen.for_each(replay);
}

#[test]
fn every_target_has_a_fuzz_target_and_every_corpus_belongs_to_one() {
    let manifest = std::fs::read_to_string(folder().join("Cargo.toml")).expect("the manifest");
    for target in TARGETS {
        let name = target.name;
        assert!(manifest.contains(&format!("name = \"{name}\"")), "{name}");
        let source = std::fs::read_to_string(folder().join(format!("fuzz_targets/{name}.rs"))).expect(name);
        assert!(source.contains(&format!("run(\"{name}\"")), "{name}");
    }
    for folder_name in ["corpus", "dictionaries"] {
        for entry in std::fs::read_dir(folder().join(folder_name)).expect(folder_name) {
            let name = entry.expect("an entry").file_name();
            let name = name.to_string_lossy();
            let name = name.trim_end_matches(".dict");
            assert!(TARGETS.iter().any(|target| target.name == name), "{folder_name}/{name}");
        }
    }
}

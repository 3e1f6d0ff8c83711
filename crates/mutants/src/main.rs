//! `etherpen-mutants`: mutants of a seed, judged by tests and campaigns.
#![forbid(unsafe_code)]

use clap::Parser;
use etherpen_mutants::{Options, run};
use std::path::PathBuf;
use std::process::ExitCode;

/// Put small errors into the firmware and see whether the tests and campaigns find them
#[derive(Parser)]
#[command(name = "etherpen-mutants")]
struct Arguments {
    /// Chooses the mutants
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of mutants
    #[arg(long, default_value_t = 100, value_parser = count)]
    count: usize,
    /// File of results. An interrupted run goes on from there unless a file of the sources has changed. Default:
    /// mutants/results.json in cargo's output folder
    #[arg(long, value_name = "FILE")]
    results: Option<PathBuf>,
    /// Judge all mutants, even those that were judged before
    #[arg(long, conflicts_with_all = ["only", "list"])]
    fresh: bool,
    /// Judge this mutant alone, even if it was judged before
    #[arg(long, value_name = "NUMBER", conflicts_with = "list")]
    only: Option<u32>,
    /// Print the mutants and judge none
    #[arg(long)]
    list: bool,
    /// Write this document at the end, of what is known then: docs/mutants.md
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

fn count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count @ 1..=1_000) => Ok(count),
        _ => Err("give a number from 1 to 1000".to_owned()),
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let options = Options {
        seed: arguments.seed,
        count: arguments.count,
        results: arguments.results,
        fresh: arguments.fresh,
        only: arguments.only,
        list: arguments.list,
        report: arguments.report,
    };
    match run(&options) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => {
            eprintln!("error: too few mutants were found");
            ExitCode::FAILURE
        }
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

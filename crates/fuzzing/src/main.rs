//! Writes the seeds of all targets, and runs a target with files: `etherpen-fuzzing seeds FOLDER`,
//! `etherpen-fuzzing run TARGET FILE...`.

use etherpen_fuzzing::TARGETS;
use std::io;
use std::path::Path;
use std::process::ExitCode;

fn main() -> io::Result<ExitCode> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.as_slice() {
        ["seeds", folder] => seeds(Path::new(folder))?,
        ["run", target, files @ ..] => {
            for file in files {
                eprintln!("{file}");
                etherpen_fuzzing::run(target, &std::fs::read(file)?);
            }
        }
        _ => {
            eprintln!("usage: etherpen-fuzzing seeds FOLDER | run TARGET FILE...");
            return Ok(ExitCode::from(2));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the seeds of every target into a folder with its name.
fn seeds(folder: &Path) -> io::Result<()> {
    for target in TARGETS {
        let folder = folder.join(target.name);
        std::fs::create_dir_all(&folder)?;
        for (number, seed) in (target.seeds)().iter().enumerate() {
            std::fs::write(folder.join(format!("seed-{number:02}")), seed)?;
        }
    }
    Ok(())
}

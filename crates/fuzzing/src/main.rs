//! Seeds, single inputs and hostile files of the fuzz targets; see [`USAGE`].

use etherpen_fuzzing::{TARGETS, hostile, limits};
use std::io;
use std::path::Path;
use std::process::ExitCode;

const USAGE: &str = "\
etherpen-fuzzing seeds FOLDER                 write the seeds of all targets
etherpen-fuzzing run TARGET FILE...           run a target with files
etherpen-fuzzing hostile FOLDER [WORD]        write the hostile files with this word in their names
etherpen-fuzzing read MEBIBYTES SECONDS FILE  read a file with this much memory and processor time";

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
        ["hostile", folder] => write_hostile(Path::new(folder), "")?,
        ["hostile", folder, word] => write_hostile(Path::new(folder), word)?,
        ["read", mebibytes, seconds, file] => {
            let number = |text: &str| text.parse().map_err(io::Error::other);
            limits::restrict(number(mebibytes)? << 20, number(seconds)?)?;
            let told = limits::read(Path::new(file))?;
            let (mebibytes, seconds) = limits::used()?;
            println!("{mebibytes} MiB, {seconds:.2} s: {told}");
        }
        _ => {
            eprintln!("{USAGE}");
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

fn write_hostile(folder: &Path, word: &str) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    for file in hostile::files().iter().filter(|file| file.name.contains(word)) {
        std::fs::write(folder.join(file.name), (file.make)())?;
    }
    Ok(())
}

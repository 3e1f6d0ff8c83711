//! The tasks of both boards as their code declares them, against the table in the documentation.
//!
//! Every task's comment states period, priority, deadline and what an overrun does; `docs/tasks.md` is the table of
//! them. After a change to a task, run `ETHERPEN_RENEW_TASKS=1 cargo test --test tasks`.

use std::fmt::Write;
use std::path::PathBuf;

const BOARDS: [&str; 2] = ["nucleo", "emulated"];
const LABELS: [&str; 4] = ["Period: ", " Priority: ", " Deadline: ", " Overrun: "];
const TABLE: &str = "docs/tasks.md";
/// Set to write the table instead of comparing with it.
const RENEW: &str = "ETHERPEN_RENEW_TASKS";
const HEADER: &str = "\
# Tasks

Every task of both boards, most urgent first, as its comment in `src/bin/BOARD.rs` states it; a test compares
(`cargo test --test tasks`). Tasks of one priority never preempt each other. Critical sections mask up to priority 14.
";

/// A task as the code has it.
#[derive(Debug)]
struct Task {
    name: String,
    released_by: String,
    priority: u8,
    /// Period, priority, deadline, overrun.
    stated: [String; 4],
}

fn root(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The value behind `key = ` in an attribute.
fn value<'a>(attribute: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = attribute.split_once(&format!("{key} = "))?;
    rest.split([',', ')', ' ', '\n']).next()
}

fn stated(name: &str, comment: &str) -> [String; 4] {
    let mut rest = comment;
    let mut parts = LABELS.map(|label| {
        let (before, behind) = rest
            .split_once(label)
            .unwrap_or_else(|| panic!("the comment of {name} has no `{}`", label.trim()));
        rest = behind;
        before.trim().trim_end_matches('.').to_owned()
    });
    // Text before a label belongs to the previous label; text before the first label is the summary.
    parts.rotate_left(1);
    parts[3] = rest.trim().trim_end_matches('.').to_owned();
    parts
}

fn tasks(board: &str) -> Vec<Task> {
    let path = root(&format!("src/bin/{board}.rs"));
    let code = std::fs::read_to_string(&path).expect("the board's code");
    let (mut comment, mut tasks) = (String::new(), Vec::new());
    let mut lines = code.lines().map(str::trim);
    while let Some(line) = lines.next() {
        if let Some(text) = line.strip_prefix("///") {
            comment.push_str(text);
        } else if line.starts_with("#[task(") {
            let mut attribute = line.to_owned();
            // On one line, or with its end alone on a line.
            while line == "#[task(" && !attribute.ends_with("\n)]") {
                attribute.push('\n');
                attribute.push_str(lines.next().expect("the attribute ends"));
            }
            let function = lines.next().expect("a task has a function");
            let name = function.split("fn ").nth(1).and_then(|rest| rest.split('(').next());
            let name = name.expect("a task has a name").to_owned();
            tasks.push(Task {
                released_by: value(&attribute, "binds").unwrap_or("software").to_owned(),
                priority: value(&attribute, "priority")
                    .and_then(|text| text.parse().ok())
                    .unwrap_or_else(|| panic!("{name} has no priority")),
                stated: stated(&name, &comment),
                name,
            });
            comment.clear();
        } else {
            comment.clear();
        }
    }
    tasks
}

fn table() -> String {
    let mut text = HEADER.to_owned();
    for board in BOARDS {
        let mut tasks = tasks(board);
        tasks.sort_by_key(|task| std::cmp::Reverse(task.priority));
        write!(text, "\n## Board {board}\n\n").expect("a string takes everything");
        text.push_str("| task | interrupt | priority | period | deadline | overrun |\n|---|---|---|---|---|---|\n");
        for task in tasks {
            let [period, priority, deadline, overrun] = &task.stated;
            let (name, interrupt) = (&task.name, &task.released_by);
            writeln!(
                text,
                "| `{name}` | {interrupt} | {priority} | {period} | {deadline} | {overrun} |"
            )
            .expect("a string takes everything");
        }
    }
    text
}

#[test]
fn every_task_states_the_priority_that_it_has() {
    for board in BOARDS {
        let tasks = tasks(board);
        assert!(tasks.len() >= 8, "{board}: {tasks:?}");
        for task in tasks {
            let number = task.stated[1].split(',').next().and_then(|text| text.parse().ok());
            assert_eq!(number, Some(task.priority), "{board}: {}", task.name);
            let critical = task.stated[1].ends_with("critical");
            assert_eq!(critical, task.priority == 15, "{board}: {}", task.name);
        }
    }
}

#[test]
fn the_table_in_the_documentation_is_that_of_the_code() {
    let path = root(TABLE);
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(&path, table()).expect("the table can be written");
    }
    let written = std::fs::read_to_string(&path).expect("the table");
    assert!(
        written == table(),
        "{TABLE} is not what the code says; renew it with {RENEW}=1"
    );
}

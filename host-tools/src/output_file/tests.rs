use super::*;
use std::os::unix::fs::{PermissionsExt, symlink};

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("etherpen-output-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a folder for the test");
        Self(path)
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).expect("the test's folder").flatten();
        let mut names: Vec<String> = entries
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn the_last_good_content_stays_until_the_new_one_is_complete() {
    let folder = Folder::new("whole");
    let path = folder.0.join("out.svg");
    write(&path, b"old").unwrap();
    let mut out = OutputFile::create(&path).unwrap();
    out.write_all(b"new, but not comple").unwrap();
    out.flush().unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"old");
    drop(out);
    assert_eq!(
        (fs::read(&path).unwrap(), folder.names()),
        (b"old".to_vec(), vec!["out.svg".into()])
    );
    let mut out = OutputFile::create(&path).unwrap();
    out.write_all(b"new").unwrap();
    out.commit().unwrap();
    assert_eq!(
        (fs::read(&path).unwrap(), folder.names()),
        (b"new".to_vec(), vec!["out.svg".into()])
    );
}

#[test]
fn a_hidden_file_of_a_killed_program_is_removed_and_one_in_use_is_not() {
    let folder = Folder::new("left");
    let path = folder.0.join("out.svg");
    fs::write(folder.0.join(".out.svg.4711-0.part"), "left").unwrap();
    fs::write(folder.0.join(".out.svg.notes.part"), "the user's own").unwrap();
    let mut first = OutputFile::create(&path).unwrap();
    first.write_all(b"first").unwrap();
    let mut second = OutputFile::create(&path).unwrap();
    second.write_all(b"second").unwrap();
    second.commit().unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"second");
    first.commit().unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"first");
    assert_eq!(folder.names(), [".out.svg.notes.part", "out.svg"]);
}

#[test]
fn links_permissions_and_protection_are_kept() {
    let folder = Folder::new("links");
    let (path, link, dangling) = (folder.0.join("a.svg"), folder.0.join("b.svg"), folder.0.join("c.svg"));
    write(&path, b"old").unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
    symlink("a.svg", &link).unwrap();
    symlink("d.svg", &dangling).unwrap();
    write(&link, b"new").unwrap();
    write(&dangling, b"there").unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().file_type().is_symlink());
    assert_eq!(fs::read(&path).unwrap(), b"new");
    assert_eq!(fs::read(folder.0.join("d.svg")).unwrap(), b"there");
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o640);
    assert_eq!(write(&folder.0, b"").unwrap_err().kind(), ErrorKind::IsADirectory);
}

#[test]
fn one_file_is_known_by_all_its_names() {
    let folder = Folder::new("names");
    let [path, hard, soft, other] = ["a", "b", "c", "d"].map(|name| folder.0.join(name));
    fs::write(&path, "a").unwrap();
    fs::write(&other, "a").unwrap();
    fs::hard_link(&path, &hard).unwrap();
    symlink(&path, &soft).unwrap();
    for name in [&path, &hard, &soft, &folder.0.join("./a")] {
        assert!(
            is_same_file(name, &path) && is_same_file(&path, name),
            "{}",
            name.display()
        );
    }
    assert!(!is_same_file(&other, &path) && !is_same_file(&folder.0.join("absent"), &path));
    // A device has no content.
    assert!(!is_same_file(Path::new("/dev/null"), Path::new("/dev/null")));
}

#[test]
fn a_device_is_written_directly_and_its_error_is_told() {
    write(Path::new("/dev/null"), b"gone").unwrap();
    assert_eq!(
        write(Path::new("/dev/full"), b"no room").unwrap_err().kind(),
        ErrorKind::StorageFull
    );
    assert!(!Path::new("/dev/full").metadata().unwrap().is_file());
}

#[test]
fn a_stream_grows_under_its_name_once_it_has_begun() {
    let folder = Folder::new("stream");
    let path = folder.0.join("run.mcap");
    write(&path, b"old").unwrap();
    let out = OutputFile::create(&path).unwrap();
    let mut stream = out.stream().unwrap();
    stream.write_all(b"head").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"old");
    out.commit().unwrap();
    stream.write_all(b", tail").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"head, tail");
}

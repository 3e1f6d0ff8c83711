//! The page's files, embedded in the program.
//!
//! Invariant: the page requests nothing but these files, and its policy forbids requests to other servers.

/// A file of the page.
pub(super) struct Asset {
    /// Path in the URL.
    pub(super) path: &'static str,
    /// Media type.
    pub(super) media: &'static str,
    /// Content.
    pub(super) content: &'static str,
}

macro_rules! asset {
    ($path:literal, $file:literal, $media:literal) => {
        Asset {
            path: $path,
            media: $media,
            content: include_str!(concat!("../../assets/console/", $file)),
        }
    };
}

/// All files.
pub(super) const ASSETS: &[Asset] = &[
    asset!("/", "index.html", "text/html; charset=utf-8"),
    asset!("/style.css", "style.css", "text/css; charset=utf-8"),
    asset!("/icon.svg", "icon.svg", "image/svg+xml"),
    asset!("/stop.js", "stop.js", "text/javascript; charset=utf-8"),
    asset!("/main.js", "main.js", "text/javascript; charset=utf-8"),
    asset!("/choice.js", "choice.js", "text/javascript; charset=utf-8"),
    asset!("/link.js", "link.js", "text/javascript; charset=utf-8"),
    asset!("/dom.js", "dom.js", "text/javascript; charset=utf-8"),
    asset!("/operate.js", "operate.js", "text/javascript; charset=utf-8"),
    asset!("/axes.js", "axes.js", "text/javascript; charset=utf-8"),
    asset!("/paper.js", "paper.js", "text/javascript; charset=utf-8"),
    asset!("/robot.js", "robot.js", "text/javascript; charset=utf-8"),
    asset!("/plot.js", "plot.js", "text/javascript; charset=utf-8"),
    asset!("/scope.js", "scope.js", "text/javascript; charset=utf-8"),
    asset!("/jobs.js", "jobs.js", "text/javascript; charset=utf-8"),
    asset!("/options.js", "options.js", "text/javascript; charset=utf-8"),
    asset!("/crop.js", "crop.js", "text/javascript; charset=utf-8"),
    asset!("/variants.js", "variants.js", "text/javascript; charset=utf-8"),
    asset!("/drives.js", "drives.js", "text/javascript; charset=utf-8"),
];

/// Content security policy: the browser may load this server's files, nothing else.
pub(super) const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                          connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_asks_nobody_else() {
        for asset in ASSETS {
            for line in asset.content.lines() {
                let foreign = line.contains("http:") || line.contains("https:") || line.contains("//cdn");
                let names_a_standard = line.contains("http://www.w3.org/");
                assert!(!foreign || names_a_standard, "{}: {line}", asset.path);
            }
            assert!(
                !asset.content.contains("style=\""),
                "{}: the policy forbids it",
                asset.path
            );
            assert!(
                !asset.content.contains("innerHTML"),
                "{}: text is no markup",
                asset.path
            );
        }
    }

    #[test]
    fn every_file_that_is_asked_for_is_there_and_every_file_is_asked_for() {
        let mut asked = vec!["/".to_owned()];
        for asset in ASSETS {
            for line in asset.content.lines() {
                let imported = line.strip_prefix("import ").and_then(|line| line.split('"').nth(1));
                asked.extend(imported.and_then(|file| file.strip_prefix('.')).map(str::to_owned));
                for attribute in ["src=\"", "href=\"/"] {
                    let start = attribute.len() - usize::from(attribute.ends_with('/'));
                    let files = line
                        .match_indices(attribute)
                        .filter_map(|(at, _)| line.get(at + start..));
                    asked.extend(files.filter_map(|file| file.split('"').next()).map(str::to_owned));
                }
            }
        }
        for path in &asked {
            assert!(ASSETS.iter().any(|asset| asset.path == path), "{path}");
        }
        for asset in ASSETS {
            assert!(asked.iter().any(|path| path == asset.path), "{}", asset.path);
        }
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/console");
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), ASSETS.len());
    }
}

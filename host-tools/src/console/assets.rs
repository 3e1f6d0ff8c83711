//! The page, in the program.
//!
//! Invariant: the page asks for nothing that is not here, and its policy allows it to ask nobody else.

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
    asset!("/main.js", "main.js", "text/javascript; charset=utf-8"),
    asset!("/link.js", "link.js", "text/javascript; charset=utf-8"),
    asset!("/dom.js", "dom.js", "text/javascript; charset=utf-8"),
    asset!("/operate.js", "operate.js", "text/javascript; charset=utf-8"),
    asset!("/paper.js", "paper.js", "text/javascript; charset=utf-8"),
    asset!("/robot.js", "robot.js", "text/javascript; charset=utf-8"),
    asset!("/plot.js", "plot.js", "text/javascript; charset=utf-8"),
    asset!("/scope.js", "scope.js", "text/javascript; charset=utf-8"),
    asset!("/jobs.js", "jobs.js", "text/javascript; charset=utf-8"),
    asset!("/drives.js", "drives.js", "text/javascript; charset=utf-8"),
];

/// What the browser may load: this server's files, nothing else.
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
    fn every_module_that_is_imported_is_there() {
        for asset in ASSETS {
            for line in asset.content.lines().filter(|line| line.starts_with("import ")) {
                let file = line.split('"').nth(1).unwrap_or_default();
                let path = file.strip_prefix('.').unwrap_or(file);
                assert!(ASSETS.iter().any(|asset| asset.path == path), "{}: {line}", asset.path);
            }
        }
    }
}

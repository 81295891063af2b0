//! The page itself: built into the binary where it was built before luxel was, or read from a folder.

use std::path::{Path, PathBuf};

use super::http::{Answer, Body, Refusal};

/// A file of the page.
struct Part {
    /// As it is asked for, without the leading `/`.
    name: &'static str,
    content_type: &'static str,
}

/// All there is: nothing else of any folder is ever served as a part of the page.
const PARTS: [Part; 3] = [
    Part { name: "index.html", content_type: HTML },
    Part { name: "preview.js", content_type: "text/javascript; charset=utf-8" },
    Part { name: "preview.css", content_type: "text/css; charset=utf-8" },
];

const HTML: &str = "text/html; charset=utf-8";

/// No part of the page is larger.
const MAX_PART: u64 = 16 << 20;

/// What to do where there is no page.
pub const NOT_BUILT: &str =
    "the preview page was not built: run `npm ci && npm run build` in assets/preview, then build luxel again";

/// The same as a page, for who has opened it.
const NOT_BUILT_PAGE: &[u8] = b"<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>luxel</title>
<h1>The preview page was not built</h1>
<p>luxel is running and bakes, but this binary holds no page to show it with. Run
<pre>npm ci &amp;&amp; npm run build</pre>
<p>in the folder <code>assets/preview</code> of its sources, then build luxel again.</html>
";

/// Where the page comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Bundle {
    /// What was built into the binary, if anything was.
    #[default]
    Embedded,
    /// A folder, read anew at every request: for work on the page.
    Folder(PathBuf),
}

/// Name and content of each part; empty where the page was not built when luxel was.
const EMBEDDED: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/bundle.rs"));

impl Bundle {
    /// The page is there, whole.
    pub fn is_built(&self) -> bool {
        PARTS.iter().all(|part| match self {
            Self::Embedded => EMBEDDED.iter().any(|(name, _)| *name == part.name),
            Self::Folder(folder) => folder.join(part.name).is_file(),
        })
    }

    /// A part of the page by its path.
    pub fn answer(&self, path: &str) -> Result<Answer, Refusal> {
        let name = if path == "/" { "index.html" } else { path.trim_start_matches('/') };
        let part = PARTS.iter().find(|p| p.name == name && path.len() <= name.len() + 1).ok_or(Refusal::Missing)?;
        if !self.is_built() {
            let body = Body::Static(NOT_BUILT_PAGE);
            return Ok(Answer { status: "503 Service Unavailable", content_type: HTML, body });
        }
        Ok(Answer::ok(part.content_type, self.body(part.name)?))
    }

    fn body(&self, name: &str) -> Result<Body, Refusal> {
        match self {
            Self::Embedded => {
                let found = EMBEDDED.iter().find(|(n, _)| *n == name).ok_or(Refusal::Missing)?;
                Ok(Body::Static(found.1))
            }
            Self::Folder(folder) => read(&folder.join(name)).ok_or(Refusal::Broken).map(Body::Bytes),
        }
    }
}

fn read(path: &Path) -> Option<Vec<u8>> {
    let is_small = |m: std::fs::Metadata| m.is_file() && m.len() <= MAX_PART;
    std::fs::metadata(path).is_ok_and(is_small).then(|| std::fs::read(path).ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_parts_are_served_and_their_absence_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let bundle = Bundle::Folder(folder.path().into());
        std::fs::write(folder.path().join("index.html"), "page").unwrap();
        std::fs::write(folder.path().join("other.js"), "x").unwrap();
        assert!(!bundle.is_built());
        let told = bundle.answer("/").unwrap();
        assert_eq!(told.status, "503 Service Unavailable");
        assert!(matches!(told.body, Body::Static(text) if String::from_utf8_lossy(text).contains("npm run build")));
        for name in ["preview.js", "preview.css"] {
            std::fs::write(folder.path().join(name), name).unwrap();
        }
        assert!(bundle.is_built());
        let text = |path: &str| match bundle.answer(path).map(|a| a.body) {
            Ok(Body::Bytes(bytes)) => String::from_utf8(bytes).map_err(|_| Refusal::Broken),
            other => Err(other.map(|_| Refusal::Broken).unwrap_or_else(|refusal| refusal)),
        };
        assert_eq!(text("/"), Ok("page".into()));
        assert_eq!(text("/preview.css"), Ok("preview.css".into()));
        for path in ["/other.js", "//preview.js", "/./preview.js", "/../preview.js", "/preview.js/", "preview", ""] {
            assert_eq!(text(path), Err(Refusal::Missing), "{path}");
        }
    }

    #[test]
    fn the_embedded_page_is_whole_or_not_there() {
        assert!(EMBEDDED.is_empty() || Bundle::Embedded.is_built());
        assert_eq!(Bundle::Embedded.answer("/").unwrap().status == "200 OK", Bundle::Embedded.is_built());
    }
}

//! What can be wrong with a file, and how a person is told.
//!
//! Inside the importer a [`Fault`] knows the place within the file but not the file itself; [`ImportError`] adds the
//! file at the outermost call, so that a message always reads *file: place: fault; what to do*.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::Cancelled;

/// The nature of a fault, for programs; people read the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// A file is missing or cannot be read.
    Unreadable,
    /// The bytes contradict the specification.
    Invalid,
    /// The specification allows it, luxel does not read it.
    Unsupported,
    /// A limit of [`Limits`](super::Limits) is exceeded.
    Limit,
    /// Nothing is wrong with the file: whoever asked for it does not want it any more.
    Cancelled,
}

/// A bound on untrusted input: a field of [`Limits`](super::Limits).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    FileBytes,
    InputBytes,
    JsonBytes,
    JsonDepth,
    Nodes,
    Instances,
    Triangles,
    GeometryBytes,
    Expansion,
    ImagePixels,
    TextureBytes,
}

impl Bound {
    /// The field's name.
    fn name(self) -> &'static str {
        match self {
            Self::FileBytes => "file_bytes",
            Self::InputBytes => "input_bytes",
            Self::JsonBytes => "json_bytes",
            Self::JsonDepth => "json_depth",
            Self::Nodes => "nodes",
            Self::Instances => "instances",
            Self::Triangles => "triangles",
            Self::GeometryBytes => "geometry_bytes",
            Self::Expansion => "expansion",
            Self::ImagePixels => "image_pixels",
            Self::TextureBytes => "texture_bytes",
        }
    }

    /// What whoever made the file can do.
    fn remedy(self) -> &'static str {
        match self {
            Self::FileBytes | Self::InputBytes => "split the scene into several, or make its meshes and images smaller",
            Self::JsonBytes => "split the scene into several",
            Self::JsonDepth => "leave out the extras or extensions that are nested so deeply",
            Self::Nodes | Self::Instances => "merge objects before the export, or split the scene into several",
            Self::Triangles | Self::GeometryBytes => "simplify the meshes, or split the scene into several",
            Self::Expansion => {
                "export the geometry plainly: the file claims far more of it than it stores, by sparse, compressed or \
                 shared accessors"
            }
            Self::ImagePixels => "make the image smaller",
            Self::TextureBytes => "make the images smaller, or let materials share them",
        }
    }
}

/// A scene or sky that was not read, and why.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{}: {fault}", file.display())]
pub struct ImportError {
    /// The file that was to be loaded.
    pub file: PathBuf,
    pub fault: Fault,
}

/// A fault within a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    pub kind: FaultKind,
    /// Where, such as `mesh 3 "Wall" primitive 0`; empty when it concerns the file as a whole.
    pub place: String,
    /// What is wrong.
    pub what: String,
    /// What to do about it.
    pub hint: String,
}

/// Result of everything inside the importer.
pub type Checked<T> = Result<T, Fault>;

impl Fault {
    pub fn new(kind: FaultKind, place: impl Into<String>, what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { kind, place: place.into(), what: what.into(), hint: hint.into() }
    }

    /// A violation of the specification.
    pub fn invalid(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self::new(FaultKind::Invalid, place, what, "export the scene again, or look at it with a glTF validator")
    }

    /// Something that luxel does not read.
    pub fn unsupported(place: impl Into<String>, what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(FaultKind::Unsupported, place, what, hint)
    }

    /// More of something than a bound allows.
    pub fn limit(place: impl Into<String>, what: impl fmt::Display, bound: Bound, limit: u64) -> Self {
        let what = format!("{what}, more than the limit `{}` of {limit}", bound.name());
        Self::new(FaultKind::Limit, place, what, bound.remedy())
    }

    /// The reading was cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.kind == FaultKind::Cancelled
    }

    /// Attaches the file.
    pub fn in_file(self, file: &Path) -> ImportError {
        ImportError { file: file.to_path_buf(), fault: self }
    }
}

impl From<Cancelled> for Fault {
    fn from(cancelled: Cancelled) -> Self {
        Self::new(FaultKind::Cancelled, "", cancelled.to_string(), "read it again")
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.place.is_empty() {
            write!(f, "{}: ", self.place)?;
        }
        write!(f, "{}; {}", self.what, self.hint)
    }
}

/// `mesh 3 "Wall"`: how messages name an element of a glTF file. Names come from the file, so they are quoted, with
/// control characters escaped, and cut to a readable length.
pub fn place(kind: &str, index: usize, name: Option<&str>) -> String {
    match name.filter(|name| !name.is_empty()) {
        Some(name) => format!("{kind} {index} {}", quoted(name)),
        None => format!("{kind} {index}"),
    }
}

/// A string from a file as it may stand in a message.
pub fn quoted(text: &str) -> String {
    const LONGEST: usize = 80;
    let mut short: String = text.chars().take(LONGEST).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("{short:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_names_file_place_fault_and_remedy() {
        let fault = Fault::invalid(place("mesh", 3, Some("Wall")), "it has no triangles");
        let text = fault.in_file(Path::new("level.glb")).to_string();
        assert_eq!(
            text,
            "level.glb: mesh 3 \"Wall\": it has no triangles; export the scene again, or look at it with a glTF validator"
        );
    }

    #[test]
    fn a_limit_tells_what_can_be_done_about_the_file() {
        let text = Fault::limit("image 3", "it has 9 × 9 pixels", Bound::ImagePixels, 80).to_string();
        assert_eq!(
            text,
            "image 3: it has 9 × 9 pixels, more than the limit `image_pixels` of 80; make the image smaller"
        );
        let deep = Fault::limit("JSON", "it is nested more deeply", Bound::JsonDepth, 96);
        assert!(deep.hint.contains("leave out") && !deep.hint.contains("limit"), "{deep}");
    }

    #[test]
    fn names_from_files_cannot_break_a_message() {
        assert_eq!(place("node", 1, Some("a\n\u{1b}[2J\"")), "node 1 \"a\\n\\u{1b}[2J\\\"\"");
        assert!(place("node", 1, Some(&"x".repeat(5000))).len() < 120);
        assert_eq!(place("node", 1, Some("")), "node 1");
    }
}

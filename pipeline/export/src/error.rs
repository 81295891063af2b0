//! What can go wrong on the way out, said with the file and the place.

use std::path::PathBuf;

use luxel_scene::{Cancelled, ImportError};

/// An export that did not happen. Whatever file was there before is still there.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Reading or writing a file failed.
    #[error("cannot {what} {}: {cause}; see whether there is space and permission", path.display())]
    Io { what: &'static str, path: PathBuf, cause: std::io::Error },
    /// The scene file breaks the glTF specification or a limit at a place that the export needs.
    #[error(transparent)]
    Scene(ImportError),
    /// A file of the scene is another one than was baked.
    #[error("{}: it has changed while it was baked; bake again", path.display())]
    Changed { path: PathBuf },
    /// An image holds a value that is no light, or has the wrong size.
    #[error("{what}: {fault}")]
    Image { what: String, fault: String },
    /// An encoder refused what it was given.
    #[error("cannot encode {what}: {fault}")]
    Encode { what: String, fault: String },
    /// The outputs cannot be placed where they were asked for.
    #[error("{}: {fault}", path.display())]
    Place { path: PathBuf, fault: String },
    /// Whoever asked for it does not want it any more.
    #[error("cancelled")]
    Cancelled,
}

impl From<Cancelled> for ExportError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<ImportError> for ExportError {
    fn from(error: ImportError) -> Self {
        if error.fault.is_cancelled() { Self::Cancelled } else { Self::Scene(error) }
    }
}

impl ExportError {
    pub(crate) fn io(what: &'static str, path: &std::path::Path, cause: std::io::Error) -> Self {
        if Cancelled::caused(&cause) {
            return Self::Cancelled;
        }
        Self::Io { what, path: path.into(), cause }
    }

    pub(crate) fn encode(what: impl Into<String>, fault: impl ToString) -> Self {
        Self::Encode { what: what.into(), fault: fault.to_string() }
    }
}

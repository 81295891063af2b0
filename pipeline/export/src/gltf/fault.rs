//! A fault in a scene file: where, and what.

use std::path::Path;

use crate::ExportError;

/// Not yet bound to a file; [`Fault::of`] adds it.
#[derive(Debug)]
pub struct Fault {
    pub place: String,
    pub fault: String,
}

pub type Checked<T> = Result<T, Fault>;

impl Fault {
    pub fn new(place: impl Into<String>, fault: impl Into<String>) -> Self {
        Self { place: place.into(), fault: fault.into() }
    }

    pub fn of(self, path: &Path) -> ExportError {
        ExportError::Scene { path: path.into(), place: self.place, fault: self.fault }
    }
}

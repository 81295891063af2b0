//! What can go wrong in a bake, said with the file, the place and what to do.

use std::path::PathBuf;

use luxel_atlas::{AtlasError, FinishError};
use luxel_export::ExportError;
use luxel_scene::{Cancelled, ImportError};
use luxel_transport::{gather::FieldError, solve::SolveError, surfel::SurfelError};

use crate::settings::SettingsError;
use crate::verify::gate::Refusal;

/// A bake that did not happen. Files of an earlier bake are untouched.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error(transparent)]
    Settings(#[from] SettingsError),
    #[error(transparent)]
    Import(ImportError),
    #[error("cannot place the scene's texels")]
    Atlas(#[source] AtlasError),
    #[error("cannot finish the images")]
    Finish(#[source] FinishError),
    #[error("cannot turn the scene into surfels; another --voxels may help")]
    Surfels(#[source] SurfelError),
    #[error("light cannot be propagated")]
    Solve(#[source] SolveError),
    #[error("the light at surfels does not fit the scene")]
    Field(#[source] FieldError),
    #[error("cannot write to the folder {path}; choose another one with --out")]
    Folder { path: PathBuf, source: std::io::Error },
    #[error("an export does not replace {what} in {folder}: choose another folder with --to")]
    OverBake { folder: PathBuf, what: String },
    #[error(
        "the setting only leaves light out of lightmaps, and other methods show all of it: add --only all, or take \
         --method lightmap"
    )]
    OnlyLightmap,
    #[error("a picture does not replace {}, which the scene is made from: choose another name with --to", path.display())]
    OverInput { path: PathBuf },
    #[error("there is no light group {name:?}; the scene has: {groups}")]
    Group { name: String, groups: String },
    #[error(
        "the factor {factor:e} makes the light group {name:?} brighter than luxel computes; it can be {most:e} at most"
    )]
    Factor { name: String, factor: f32, most: f32 },
    #[error("its factor makes the light group {name:?} brighter than a lightmap can hold; choose a smaller one")]
    TooBright { name: String },
    #[error(
        "{what} is not stored in {store}: bake the scene with the same settings first (luxel \
         bake), and name its folder or store as then (--out, --store)"
    )]
    NotStored { what: String, store: PathBuf },
    #[error("{0}")]
    NotGoodEnough(Box<Refusal>),
    #[error("there is no camera {name:?}; the scene has: {cameras}")]
    Camera { name: String, cameras: String },
    #[error(
        "a picture of {width} × {height} pixels is too large: at most {} on a side and {} in all",
        crate::render::lens::MOST_SIDE,
        crate::render::lens::MOST_PIXELS
    )]
    PictureSize { width: u32, height: u32 },
    #[error(transparent)]
    Export(ExportError),
    #[error(
        "the bake needs about {needed} MiB of memory, more than the {most} MiB that can be had; the largest part are \
         {part} ({part_needs} MiB): {remedy}, or give luxel more memory (swap counts)"
    )]
    Memory { needed: u64, most: u64, part: &'static str, part_needs: u64, remedy: &'static str },
    #[error("the target is out of reach: {what}")]
    Target { what: String },
    #[error("cannot write the report: {what}")]
    Report { what: String },
    #[error("cannot start {threads} threads; try fewer with --threads")]
    Threads { threads: u32, source: rayon::ThreadPoolBuildError },
    /// A fault of luxel: something panicked. Other scenes are not concerned.
    #[error("internal error: {what}; this is a bug in luxel, not in your scene")]
    Internal { what: String },
    #[error("cancelled")]
    Cancelled,
}

impl From<Cancelled> for Error {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<ImportError> for Error {
    fn from(error: ImportError) -> Self {
        if error.fault.is_cancelled() { Self::Cancelled } else { Self::Import(error) }
    }
}

impl From<FinishError> for Error {
    fn from(error: FinishError) -> Self {
        match error {
            FinishError::Cancelled(_) => Self::Cancelled,
            other => Self::Finish(other),
        }
    }
}

impl From<FieldError> for Error {
    fn from(error: FieldError) -> Self {
        match error {
            FieldError::Cancelled(_) => Self::Cancelled,
            other => Self::Field(other),
        }
    }
}

impl From<ExportError> for Error {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::Cancelled => Self::Cancelled,
            other => Self::Export(other),
        }
    }
}

impl From<AtlasError> for Error {
    fn from(error: AtlasError) -> Self {
        match error {
            AtlasError::Cancelled(_) => Self::Cancelled,
            other => Self::Atlas(other),
        }
    }
}

impl From<SurfelError> for Error {
    fn from(error: SurfelError) -> Self {
        match error {
            SurfelError::Cancelled(_) => Self::Cancelled,
            other => Self::Surfels(other),
        }
    }
}

impl From<SolveError> for Error {
    fn from(error: SolveError) -> Self {
        match error {
            SolveError::Cancelled(_) => Self::Cancelled,
            other => Self::Solve(other),
        }
    }
}

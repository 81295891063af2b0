//! Where texels are: unwrap, packing, texel positions, dilation, seam stitching.
//!
//! | stage | modules | in → out |
//! |---|---|---|
//! | choose | [`layout`], [`authored`] | scene → per instance: its TEXCOORD_1, or the unwrap of its mesh |
//! | unwrap | [`unwrap`] with `segment`, `planar`, `shape`; [`worker`], `xatlas` | mesh → [`charts::Charts`] in object units, shared by instances |
//! | pack | `blocks`, `place` with `shelves`, `pack` | charts of all instances → rectangles on pages |
//! | rasterise | `texels` | placed charts → [`Texel`]s with coverage |
//! | audit | `audit` | atlas → what of it lies on each other |
//! | finish | [`mod@finish`] with `canvas`, `seams` | values per texel → dilated, stitched images |
//!
//! [`build`] goes from the scene to the atlas; [`Layout::complete`] and [`Packing`] are its parts, for callers that
//! keep unwraps and placements.
//!
//! This room knows nothing of light and opens no file.

mod assemble;
pub mod atlas;
mod audit;
pub mod authored;
mod blocks;
mod canvas;
pub mod charts;
pub mod finish;
pub mod layout;
mod mesh;
mod overlap;
mod pack;
mod place;
mod planar;
mod seams;
mod segment;
mod settings;
mod shape;
mod shelves;
mod texels;
pub mod unwrap;
pub mod worker;
mod xatlas;

pub use assemble::{Packing, assemble, build};
pub use atlas::{Atlas, Chart, Page, Placed, Texel};
pub use audit::{Overlapping, overlapping};
pub use charts::Charts;
pub use finish::{FinishError, FinishReport, FinishSettings, Image, finish};
pub use layout::{Layout, Source, Unwraps};
pub use mesh::mesh_key;
pub use place::Placement;
pub use settings::{AtlasError, AtlasReport, AtlasSettings, MAX_SIZE};
pub use unwrap::{InProcess, UnwrapError, Unwrapper};
pub use worker::{Worker, worker_main};

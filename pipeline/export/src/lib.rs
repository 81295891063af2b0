//! What engines get: image encodings, glTF writing and the report.
//!
//! | product | module | unit of its texels |
//! |---|---|---|
//! | `level.lightmap.exr`, `level.bound.exr` | [`openexr`] | E (lux) |
//! | `level.glb` | [`gltf`] | E / intensity, 8 bit |
//! | `level.preview.png` | [`tonemap`], [`png`] | sRGB display light |
//! | `level.bake.json` | [`report`] | |
//! | names, order, hashes | [`output`], [`atomic`] | |
//!
//! Nothing here decides a value by a clock, a date or the number of threads: the same light gives the same bytes.

pub mod atomic;
pub mod error;
pub mod gltf;
pub mod lightmap;
pub mod openexr;
pub mod output;
pub mod png;
pub mod report;
pub mod tonemap;

pub use atomic::{write_atomic, write_atomic_with};
pub use error::ExportError;
pub use gltf::{Glb, Original};
pub use lightmap::{BoundMap, Lightmap, sample_lightmap};
pub use openexr::Depth;
pub use output::{Images, OutputSet, StagedImages, is_output};
pub use png::{Effort, Image8, encode_png, encode_png_with};
pub use report::Report;
pub use tonemap::ToneMap;

//! Where texels are: unwrap, packing, texel positions, dilation, seam stitching.
//!
//! | stage | module | in → out |
//! |---|---|---|
//! | unwrap | `unwrap` | mesh → charts in object space (xatlas, or an authored TEXCOORD_1 that is valid) |
//! | pack | `pack` | charts of all instances → pages of texels |
//! | rasterise | `texels` | placed charts → [`Texel`]s with coverage |
//! | finish | `finish` | values per texel → dilated, stitched images |
//!
//! This room knows nothing of light and opens no file.

pub mod atlas;

pub use atlas::{Atlas, Chart, Page, Placed, Texel};

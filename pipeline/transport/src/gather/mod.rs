//! Light at a point: the one interface of every way to gather it.
//!
//! | mode | module | indirect light at a receiver | error |
//! |---|---|---|---|
//! | lightcuts | [`lightcuts`] | clusters of surfels with shadow rays, near field by rays | stated bound |
//! | final gather | [`final_gather`] | cosine rays that look up the cache where they hit | noise, falls with rays |
//! | photon map | [`photon_map`] | clusters of photons with shadow rays, near field by rays | noise, falls with photons |
//! | random sample voxels | [`voxel_samples`] | surfels drawn by area and solid angle, near field by rays | noise, estimated |
//! | look-up | [`lookup`] | the cache itself, interpolated | that of the voxels |
//!
//! All but the photon map read one [`field::Field`]: rays, surfels and the irradiance at them. [`refresh`] feeds a final gather at the
//! surfels back into the cache; [`nodes`] evaluate any mode at few texels and interpolate between them. Random sample
//! voxels know their noise, which [`crate::methods::RandomVoxels`] tells.
//!
//! Indirect light here is what surfaces reflect. All but the look-up leave out the sky as seen from the receiver
//! itself (a ray that escapes brings nothing); the look-up reads a cache that already contains it.

mod cut;
pub mod field;
pub mod final_gather;
mod hemisphere;
pub mod lightcuts;
pub mod lookup;
mod near;
pub mod nodes;
pub mod photon_map;
pub mod refresh;
mod run;
mod smooth;
mod surfaces;
pub mod surfel_index;
pub mod voxel_samples;

pub use field::{Field, FieldError};
pub use final_gather::FinalGather;
pub use lightcuts::Lightcuts;
pub use lookup::Lookup;
pub use photon_map::PhotonMap;
pub use refresh::refresh;
pub use voxel_samples::VoxelSamples;

use glam::Vec3;
use luxel_scene::{Cancelled, Progress};

use crate::{Rgb, geometry::Geometry};

/// A point on the front side of a surface that wants to know its irradiance.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Frame position, on the surface.
    pub position: Vec3,
    /// Unit geometric normal: sides, self-shadowing, horizon.
    pub normal: Vec3,
    /// Unit interpolated normal: the cosine. Light from below the geometric horizon never counts.
    pub shading_normal: Vec3,
    /// Side of the patch that the receiver stands for, frame units.
    pub footprint: f32,
    /// Stable identity (primitive and chart-local cell): the only seed of sampling.
    pub seed: u64,
}

impl Receiver {
    /// A receiver at barycentric coordinates (1−u−v, u, v) of a world triangle.
    pub fn on_triangle(geometry: &Geometry, triangle: u32, u: f32, v: f32, footprint: f32, seed: u64) -> Self {
        let t = &geometry.triangles[triangle as usize];
        Self {
            position: t.at(u, v),
            normal: t.normal,
            shading_normal: geometry.shading_normal(triangle, u, v),
            footprint,
            seed,
        }
    }

    /// Cosine at the shading normal of light that arrives from `direction` (unit, towards the light), 0 below the
    /// geometric horizon.
    pub fn cosine(&self, direction: Vec3) -> f32 {
        if self.normal.dot(direction) <= 0.0 { 0.0 } else { self.shading_normal.dot(direction).max(0.0) }
    }
}

/// Irradiance with what is known about it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gathered {
    /// E [lux].
    pub irradiance: Rgb,
    /// Stated bound of the error of the band mean of E [lux]; 0 for methods that state none.
    pub bound: f32,
    /// Continuous rays spent, and clusters of the cut.
    pub rays: u32,
    pub cut: u32,
}

/// A way to gather light at receivers. Implementations are pure: the same receiver gives the same bits, in any
/// order, on any thread.
pub trait Gather: Sync {
    /// Irradiance at every receiver, in their order. Reports one unit of progress per receiver of a stage that the
    /// caller has begun.
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled>;
}

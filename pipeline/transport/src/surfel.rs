//! Surfels: what is left of the surfaces inside one voxel, one per orientation (design: voxel × orientation cluster).

use glam::{IVec3, Vec3};

use crate::Rgb;

/// A regular grid over the normalised frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Frame position of the corner of voxel (0, 0, 0).
    pub origin: Vec3,
    /// Voxel edge h in frame units.
    pub edge: f32,
    pub size: IVec3,
}

/// One oriented patch of surface in one voxel. Lengths are in frame units.
#[derive(Clone, Copy, Debug)]
pub struct Surfel {
    pub voxel: IVec3,
    /// Area-weighted centroid of the clipped fragments; on a curved surface it lies slightly under it.
    pub centroid: Vec3,
    /// Unit area-weighted normal.
    pub normal: Vec3,
    /// Exact clipped area (times coverage), squared frame units.
    pub area: f32,
    /// Area-weighted Lambertian albedo ρ.
    pub albedo: Rgb,
    /// Area-weighted emitted radiance Lₑ [cd/m²].
    pub emission: Rgb,
    /// Share of its plane within the voxel that the surfel fills, in (0, 1].
    pub fill: f32,
    /// A point on a real triangle of the surfel, for shadow rays: triangle, barycentric u and v, and whether the
    /// surfel is the triangle's back side.
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    pub back: bool,
}

/// All surfels of a scene, sorted by voxel (x, then y, then z), then by a stable order within the voxel.
#[derive(Clone, Debug)]
pub struct Surfels {
    pub grid: Grid,
    pub list: Vec<Surfel>,
}

/// Irradiance at every surfel [lux], band by band.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// Light straight from lamps, emitters and sun; sky light counts as indirect (it arrives with the sweep).
    pub direct: Vec<Rgb>,
    /// Everything that arrives after at least one reflection, and sky light.
    pub indirect: Vec<Rgb>,
}

//! Surfels: what is left of the surfaces inside one voxel, one per orientation (design: voxel × orientation cluster).
//!
//! The paper keeps one voxel with one normal and the area of its equation (1), which counts free faces. Here a voxel
//! holds one surfel per orientation (fragments whose normals have a cosine above 0.9 share one) and the area is that
//! of the triangles clipped to the voxel, so that the total surfel area is the area of the mesh; [`AreaRule`] keeps
//! equation (1) for comparison.
//!
//! Sides: a double-sided material gives two surfels that look away from each other. The back of a single-sided
//! material needs none: the sweep lets the front surfel hide what lies behind it, and a line that has gone through a
//! surface from its front sees black. Holes of a masked material carry no area; a veil carries its coverage, and
//! [`Surfel::fill`] tells which share of the lines it stops. Surfaces that are unlit or do not cast give none.

mod blocks;
mod cluster;
mod face_count;
mod fill;
mod fragment;
mod polygon;
mod record;
mod voxelize;
mod walls;

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec3};
use luxel_scene::Progress;

use crate::{Rgb, geometry::Geometry};

pub use cluster::MAX_PER_VOXEL;
pub use record::{Patch, Surfel};
pub use voxelize::{MAX_SIDE, MAX_SURFELS, SurfelError};

/// Least cosine between the normals of surfels of a voxel that are parts of one surface, on the sides of a wall.
const TWIN: f32 = 0.99;

/// A regular grid over the normalised frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Frame position of the corner of voxel (0, 0, 0).
    pub origin: Vec3,
    /// Voxel edge h in frame units.
    pub edge: f32,
    pub size: IVec3,
}

impl Grid {
    /// A frame position in voxel units: voxel (i, j, k) spans [i, i+1) × [j, j+1) × [k, k+1).
    pub fn local(&self, position: Vec3) -> Vec3 {
        (position - self.origin) / self.edge
    }

    /// The voxel that holds a frame position; it may lie outside of [`Grid::size`].
    pub fn voxel(&self, position: Vec3) -> IVec3 {
        self.local(position).floor().as_ivec3()
    }
}

/// All surfels of a scene, sorted by voxel (x, then y, then z), then by a stable order within the voxel.
#[derive(Clone, Debug)]
pub struct Surfels {
    pub grid: Grid,
    pub list: Vec<Surfel>,
    /// What surfels emit, sorted by surfel; those that are not named emit nothing.
    pub emission: Vec<Emission>,
}

/// What one surfel emits.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Emission {
    /// Index in [`Surfels::list`].
    pub surfel: u32,
    /// Area-weighted emitted radiance Lₑ [cd/m²].
    pub radiance: Rgb,
}

/// How fine the voxels are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Resolution {
    /// About this many surfels, whatever the scene.
    Budget(u32),
    /// This many voxels along the longest side of the scene.
    Side(u32),
    /// A voxel edge in scene units.
    Edge(f64),
}

/// What a surfel's area is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum AreaRule {
    /// The area of the triangles clipped to the voxel: exact in total.
    #[default]
    Clipped,
    /// Equation (1) of the paper, for comparison: the free faces of the voxel, each weighted by the cosine between
    /// the face and the normal. A third of a tilted scene's voxels get none.
    FaceCount,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelSettings {
    pub resolution: Resolution,
    pub area: AreaRule,
}

impl Default for VoxelSettings {
    /// The medium preset: 100 000 surfels with exact areas.
    fn default() -> Self {
        Self { resolution: Resolution::Budget(100_000), area: AreaRule::Clipped }
    }
}

/// Irradiance at every surfel [lux], band by band.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// Light straight from lamps, emitters and sun; sky light counts as indirect (it arrives with the sweep).
    pub direct: Vec<Rgb>,
    /// Everything that arrives after at least one reflection, and sky light.
    pub indirect: Vec<Rgb>,
}

impl Solution {
    /// Direct and indirect irradiance of one surfel [lux].
    #[inline]
    pub fn total(&self, surfel: usize) -> Rgb {
        self.direct[surfel] + self.indirect[surfel]
    }
}

impl Surfels {
    /// Voxelizes everything that casts. Same geometry and settings, same bytes, whatever the number of threads.
    ///
    /// # Errors
    /// When the work is cancelled, or when the settings ask for a grid beyond [`MAX_SIDE`] or more than
    /// [`MAX_SURFELS`] surfels. A scene in which nothing casts gives an empty list.
    pub fn new(geometry: &Geometry, settings: &VoxelSettings, progress: &dyn Progress) -> Result<Self, SurfelError> {
        let mut surfels = voxelize::voxelize(geometry, settings.resolution, progress)?;
        if settings.area == AreaRule::FaceCount {
            face_count::replace_areas(&mut surfels);
        }
        Ok(surfels)
    }

    /// Surfels that emit nothing, in the order that [`Surfels`] asks for.
    pub fn dark(grid: Grid, list: Vec<Surfel>) -> Self {
        Self { grid, list, emission: Vec::new() }
    }

    /// The surfels of a voxel, as a range of [`Surfels::list`].
    pub fn in_voxel(&self, voxel: IVec3) -> std::ops::Range<usize> {
        let key = voxel.to_array();
        let start = self.list.partition_point(|s| s.voxel().to_array() < key);
        let count = self.list[start..].iter().take_while(|s| s.voxel() == voxel).count();
        start..start + count
    }

    /// The surfel that a point on a surface belongs to: in its voxel, the one whose normal is closest to `normal`
    /// and looks to the same side.
    pub fn find(&self, position: Vec3, normal: Vec3) -> Option<usize> {
        let mut best = None;
        let mut best_cosine = 0.0;
        for i in self.in_voxel(self.grid.voxel(position)) {
            let cosine = self.list[i].normal.dot(normal);
            if cosine > best_cosine {
                (best, best_cosine) = (Some(i), cosine);
            }
        }
        best.map(|best| {
            Self::owner(&self.list, self.grid.edge, self.in_voxel(self.grid.voxel(position)), best, position)
        })
    }

    /// The voxel mate of a surfel, or the surfel itself, that a point of its plane belongs to: of those that look the same
    /// way, the one that lies on the point's side of the other surfels of the voxel. `mates` are the surfels of the voxel,
    /// `edge` is its edge.
    pub fn owner(list: &[Surfel], edge: f32, mates: std::ops::Range<usize>, surfel: usize, point: Vec3) -> usize {
        let normal = list[surfel].normal;
        if mates.len() < 2 || !mates.clone().any(|i| i != surfel && list[i].normal.dot(normal) > TWIN) {
            return surfel;
        }
        // As when the surfels were made: what runs across has two sides, what looks the other way is looked at or not.
        let side = |wall: &Surfel, p: Vec3| {
            let (cosine, height) = (wall.normal.dot(normal), wall.normal.dot(p - wall.centroid));
            height > if cosine.abs() < walls::ACROSS as f32 { 0.0 } else { walls::AWAY as f32 * edge }
        };
        let parts = |i: usize| {
            let is_wall = |w: &Surfel| {
                let cosine = w.normal.dot(normal);
                cosine.abs() < walls::ACROSS as f32 || cosine < walls::FACING as f32
            };
            let parted = |w: &usize| side(&list[*w], point) != side(&list[*w], list[i].centroid);
            mates.clone().filter(|&w| is_wall(&list[w])).filter(parted).count()
        };
        let far = |i: usize| list[i].centroid.distance_squared(point);
        let twins = mates.clone().filter(|&i| list[i].normal.dot(normal) > TWIN);
        let nearer = |&a: &usize, &b: &usize| parts(a).cmp(&parts(b)).then(far(a).total_cmp(&far(b))).then(a.cmp(&b));
        twins.min_by(nearer).unwrap_or(surfel)
    }

    /// Total area in squared frame units.
    pub fn area(&self) -> f64 {
        self.list.iter().map(|s| f64::from(s.area)).sum()
    }
}

/// Interleaves the bits of a voxel's coordinates: its place on the Z-order curve, and its path in an
/// octree from the root, three bits a level.
pub fn morton(voxel: IVec3) -> u64 {
    let spread = |v: i32| {
        let mut x = v as u64 & 0x1f_ffff;
        x = (x | x << 32) & 0x1f_0000_0000_ffff;
        x = (x | x << 16) & 0x1f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(voxel.x) << 2 | spread(voxel.y) << 1 | spread(voxel.z)
}

#[cfg(test)]
mod tests;

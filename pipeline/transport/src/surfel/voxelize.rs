//! Voxelization: where the grid lies, and how fine it is.
//!
//! The grid is shifted by an irrational fraction of a voxel, so that the walls of axis-aligned scenes do not lie on
//! voxel borders, where rounding would split them. Triangles are cut at its planes block by block ([`blocks`]); memory
//! follows the surface, never the volume.

use glam::{DVec3, IVec3, Vec3};
use luxel_scene::{Cancelled, Progress};

use super::{Grid, Resolution, Surfels, blocks};
use crate::geometry::Geometry;

/// Voxels along the longest side, at most: the sweep's table of lines grows with its square.
pub const MAX_SIDE: u32 = 2048;

/// Largest side that a budget may choose.
const MAX_BUDGET_SIDE: f64 = 1024.0;

/// Surfels of a scene, at most.
pub const MAX_SURFELS: usize = 1 << 26;

/// Shift of the grid in voxels.
const OFFSET: DVec3 = DVec3::new(0.47, 0.53, 0.59);

/// Why a scene has no surfels.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SurfelError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error(
        "a voxel edge of {edge} scene units needs {side:.0} voxels along the longest side, more than {MAX_SIDE}: \
         choose larger voxels or a surfel budget"
    )]
    TooFine { edge: f64, side: f64 },
    #[error("the voxel edge must be a positive number of scene units, not {0}")]
    BadEdge(f64),
    #[error("more than {MAX_SURFELS} surfels: choose larger voxels")]
    TooMany,
}

pub fn voxelize(geometry: &Geometry, resolution: Resolution, progress: &dyn Progress) -> Result<Surfels, SurfelError> {
    let solid = solid_triangles(geometry);
    let Some((lo, hi)) = bounds(geometry, &solid) else {
        let grid = Grid { origin: Vec3::ZERO, edge: 1.0, size: IVec3::ZERO };
        return Ok(Surfels::dark(grid, Vec::new()));
    };
    let longest = (hi - lo).max_element().max(f64::from(f32::MIN_POSITIVE));
    match resolution {
        Resolution::Side(n) => at_edge(geometry, &solid, (lo, hi), longest / f64::from(n.max(1)), progress),
        Resolution::Edge(edge) if edge > 0.0 && edge.is_finite() => {
            at_edge(geometry, &solid, (lo, hi), edge * geometry.frame.scale, progress)
        }
        Resolution::Edge(edge) => Err(SurfelError::BadEdge(edge)),
        Resolution::Budget(budget) => within_budget(geometry, &solid, (lo, hi), f64::from(budget.max(1)), progress),
    }
}

/// Triangles that block and bounce light.
fn solid_triangles(geometry: &Geometry) -> Vec<u32> {
    let solid = |i: &u32| {
        let t = &geometry.triangles[*i as usize];
        let there = geometry.scene.instances[t.instance as usize].casts && !geometry.material(*i).unlit;
        there && !t.is_degenerate() && t.corners.iter().all(|p| p.is_finite())
    };
    (0..geometry.triangles.len() as u32).filter(solid).collect()
}

fn bounds(geometry: &Geometry, solid: &[u32]) -> Option<(DVec3, DVec3)> {
    let corners = solid.iter().flat_map(|&i| geometry.triangles[i as usize].corners);
    corners.map(|p| (p.as_dvec3(), p.as_dvec3())).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Surfels scale with 1/h², but for edges and small objects: two corrections of the first guess come close enough.
fn within_budget(
    geometry: &Geometry,
    solid: &[u32],
    (lo, hi): (DVec3, DVec3),
    budget: f64,
    progress: &dyn Progress,
) -> Result<Surfels, SurfelError> {
    let area: f64 = solid.iter().map(|&i| f64::from(geometry.triangles[i as usize].area())).sum();
    let longest = (hi - lo).max_element();
    // A plane in general position passes through 1.5 voxels per squared edge of it.
    let finest = longest / MAX_BUDGET_SIDE;
    let coarsest = longest.max(1e-3);
    let mut edge = (1.5 * area / budget).sqrt().clamp(finest, coarsest);
    for _ in 0..2 {
        let surfels = at_edge(geometry, solid, (lo, hi), edge, progress)?;
        let ratio = surfels.list.len() as f64 / budget;
        let next = (edge * ratio.sqrt()).clamp(finest, coarsest);
        if (0.9..=1.1).contains(&ratio) || next == edge {
            return Ok(surfels);
        }
        edge = next;
    }
    at_edge(geometry, solid, (lo, hi), edge, progress)
}

fn at_edge(
    geometry: &Geometry,
    solid: &[u32],
    (lo, hi): (DVec3, DVec3),
    edge: f64,
    progress: &dyn Progress,
) -> Result<Surfels, SurfelError> {
    let side = (hi - lo).max_element() / edge;
    if side > f64::from(MAX_SIDE) + 0.5 || edge.is_nan() {
        return Err(SurfelError::TooFine { edge: edge / geometry.frame.scale, side });
    }
    let edge = edge as f32;
    let origin = (lo - OFFSET * f64::from(edge)).as_vec3();
    let size = ((hi - origin.as_dvec3()) / f64::from(edge)).floor().as_ivec3() + 1;
    blocks::surfels(geometry, Grid { origin, edge, size }, solid, progress)
}

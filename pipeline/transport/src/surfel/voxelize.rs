//! Voxelization: triangles are cut at the planes of a grid, slab by slab.
//!
//! The grid is shifted by an irrational fraction of a voxel, so that the walls of axis-aligned scenes do not lie on
//! voxel borders, where rounding would split them. Slabs of slices are independent of each other, bound the memory
//! of fragments, and are put together in order: the result does not depend on the number of threads. Memory follows
//! the surface, never the volume.

use glam::{DVec3, IVec3, Vec3};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{
    Grid, Resolution, Surfel, Surfels, cluster,
    fragment::{Cutter, Fragment},
    polygon::{Polygon, slice},
};
use crate::geometry::Geometry;

/// Voxels along the longest side, at most: the sweep's table of lines grows with its square.
pub const MAX_SIDE: u32 = 2048;

/// Largest side that a budget may choose.
const MAX_BUDGET_SIDE: f64 = 1024.0;

/// Surfels of a scene, at most.
pub const MAX_SURFELS: usize = 1 << 26;

/// Shift of the grid in voxels.
const OFFSET: DVec3 = DVec3::new(0.47, 0.53, 0.59);

/// Slices per slab, at most.
const SLAB: usize = 8;

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
        return Ok(Surfels { grid, list: Vec::new() });
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
    let grid = Grid { origin, edge, size };
    let width = (size.x as usize / 64).clamp(1, SLAB);
    let bins = bin(geometry, &grid, solid, width);
    progress.begin("voxelize", bins.len() as u64);
    let slabs: Result<Vec<Vec<Surfel>>, SurfelError> = bins
        .par_iter()
        .enumerate()
        .map(|(i, triangles)| {
            progress.check()?;
            let slab = surfels_of_slab(geometry, &grid, triangles, i * width, width);
            progress.advance(1);
            Ok(slab)
        })
        .collect();
    let slabs = slabs?;
    if slabs.iter().map(Vec::len).sum::<usize>() > MAX_SURFELS {
        return Err(SurfelError::TooMany);
    }
    Ok(Surfels { grid, list: slabs.into_iter().flatten().collect() })
}

/// The triangles that touch each slab.
fn bin(geometry: &Geometry, grid: &Grid, solid: &[u32], width: usize) -> Vec<Vec<u32>> {
    let mut bins = vec![Vec::new(); (grid.size.x as usize).div_ceil(width)];
    let last = bins.len() - 1;
    for &i in solid {
        let x = geometry.triangles[i as usize].corners.map(|p| {
            let x = (f64::from(p.x) - f64::from(grid.origin.x)) / f64::from(grid.edge);
            (x.max(0.0) as usize / width).min(last)
        });
        let (lo, hi) = (x[0].min(x[1]).min(x[2]), x[0].max(x[1]).max(x[2]));
        bins[lo..=hi].iter_mut().for_each(|bin| bin.push(i));
    }
    bins
}

fn surfels_of_slab(geometry: &Geometry, grid: &Grid, triangles: &[u32], start: usize, width: usize) -> Vec<Surfel> {
    let mut fragments: Vec<Fragment> = Vec::new();
    for &triangle in triangles {
        let cutter = Cutter::new(geometry, grid, triangle);
        if let Some(part) = within_slab(cutter.polygon(), grid, start, width) {
            cut(&cutter, part, grid, start as i32, (start + width) as i32 - 1, &mut fragments);
        }
    }
    fragments.sort_unstable_by_key(Fragment::key);
    let mut surfels = Vec::new();
    for voxel in fragments.chunk_by(|a, b| a.voxel == b.voxel) {
        cluster::surfels(geometry, grid, voxel, &mut surfels);
    }
    surfels
}

/// The part of a polygon within a slab; the first and the last slab keep what rounding puts beyond the grid.
fn within_slab(polygon: Polygon, grid: &Grid, start: usize, width: usize) -> Option<Polygon> {
    let end = start + width;
    let (lo, hi) = polygon.range(0);
    let mut part = polygon;
    if start > 0 && lo < start as f64 {
        part = part.split(0, start as f64).1;
    }
    if end < grid.size.x as usize && hi > end as f64 {
        part = part.split(0, end as f64).0;
    }
    // A polygon in the plane between two slabs belongs to the upper one, as `floor` says.
    let in_upper_plane = end < grid.size.x as usize && lo >= end as f64;
    (part.corners().len() >= 3 && !in_upper_plane).then_some(part)
}

fn cut(cutter: &Cutter, part: Polygon, grid: &Grid, lo: i32, hi: i32, out: &mut Vec<Fragment>) {
    slice(part, 0, lo, hi.min(grid.size.x - 1), |x, part| {
        slice(part, 1, 0, grid.size.y - 1, |y, part| {
            slice(part, 2, 0, grid.size.z - 1, |z, piece| {
                out.extend(cutter.fragment(IVec3::new(x, y, z), &piece));
            });
        });
    });
}

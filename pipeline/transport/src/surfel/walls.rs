//! Walls: flat surfaces that divide their voxel, so that what lies on both sides of them never shares a surfel.
//!
//! A floor runs on below a thin wall that stands on it; both sides lie in one voxel. As one surfel they would hold the
//! light of the lit room, and the dark room would see it: 0.3–0.6 % of the light went through a wall of a tenth of a voxel.
//! So each fragment is cut at the planes of the walls of its voxel, and only pieces of one side make a surfel.
//!
//! A wall that cuts is a cluster that is flat and fills most of its plane within the voxel. The plane counts beyond the wall, too:
//! where a wall ends within a voxel, a floor has more surfels there than it needs.
//!
//! Nor do surfaces share a surfel that look the same way when one looks at the back of the other: a ceiling, and the lower
//! face of a panel that hangs just below it. Between them lies a face that looks at the first one, and what is in front of
//! that face is parted from what is not.

use glam::{DVec3, IVec3};

use super::{
    Grid,
    cluster::Cluster,
    fill,
    fragment::{Cutter, Fragment, corners},
    polygon::Polygon,
};
use crate::geometry::Geometry;

/// Least share of its plane within the voxel that a wall fills.
const FILLED: f64 = 0.6;

/// Largest cosine between the normals of a wall and of what it cuts: more is the wall itself.
pub const ACROSS: f64 = 0.9;

/// Pieces of less area, in squared voxel edges, are not worth a cut.
const PIECE: f64 = 1e-4;

/// Walls of a voxel, at most, in the order of its clusters.
const MOST: usize = 16;

/// Distance between parallel planes, in voxel edges, from which on each is a wall of its own.
pub const APART: f64 = 0.15;

/// Cosine up to which a face looks the other way than a surface: within a degree, so that curved sheets part nothing.
pub const FACING: f64 = -0.9998;

/// Distance in front of a face, in voxel edges, from which on a surface looks at it: more than a flat cluster bends.
pub const AWAY: f64 = 0.02;

/// A plane that divides a voxel, in voxel units.
#[derive(Clone, Copy)]
pub struct Wall {
    pub point: DVec3,
    pub normal: DVec3,
    /// It fills most of its plane.
    fills: bool,
}

impl Wall {
    /// The wall runs across a surface of this normal, and cuts it.
    pub fn crosses(&self, normal: DVec3) -> bool {
        self.fills && self.normal.dot(normal).abs() < ACROSS
    }

    /// The wall looks the other way than a surface of this normal.
    fn faces(&self, normal: DVec3) -> bool {
        self.normal.dot(normal) < FACING
    }

    pub fn is_front(&self, point: DVec3) -> bool {
        self.height(point) > 0.0
    }

    fn height(&self, point: DVec3) -> f64 {
        self.normal.dot(point - self.point)
    }
}

/// The walls of a voxel by its clusters.
pub fn walls(voxel: IVec3, clusters: &[Cluster]) -> Vec<Wall> {
    let wall = |i: usize| {
        let fills = fill::fraction(voxel, clusters, i, &[]) >= FILLED;
        Wall { point: clusters[i].centroid, normal: clusters[i].normal, fills }
    };
    let flat = (0..clusters.len()).filter(|i| clusters[*i].is_flat());
    if clusters.len() < 2 { Vec::new() } else { flat.map(wall).take(MOST).collect() }
}

/// The sides of all walls on which a point of a surface with this normal lies: a bit each, 0 for walls that neither cross
/// the surface nor face it.
pub fn sides(walls: &[Wall], point: DVec3, normal: DVec3) -> u32 {
    let is_parted = |w: &Wall| w.crosses(normal) && w.is_front(point) || w.faces(normal) && w.height(point) > AWAY;
    walls.iter().enumerate().map(|(i, w)| u32::from(is_parted(w)) << i).sum()
}

/// Fragments of a voxel, cut at its walls.
pub fn divided(geometry: &Geometry, grid: &Grid, walls: &[Wall], fragments: &[Fragment]) -> Vec<Fragment> {
    let mut out = Vec::with_capacity(fragments.len() + walls.len());
    for f in fragments {
        let normal = geometry.triangles[f.triangle as usize].normal.as_dvec3();
        let corners = corners(geometry, grid, f.triangle);
        let mut pieces = vec![piece(grid, f.voxel, &corners)];
        for wall in walls.iter().filter(|w| w.crosses(normal)) {
            pieces = pieces.iter().flat_map(|p| cut(p, wall)).flatten().collect();
        }
        if pieces.len() < 2 {
            out.push(*f);
            continue;
        }
        let cutter = Cutter::new(geometry, f.triangle, corners);
        out.extend(pieces.iter().filter_map(|p| cutter.fragment(f.voxel, p)));
    }
    out
}

/// A triangle within a voxel; the first and the last voxel of the grid keep what rounding puts beyond it.
fn piece(grid: &Grid, voxel: IVec3, corners: &[DVec3; 3]) -> Polygon {
    let mut part = Polygon::new(corners);
    for axis in 0..3 {
        if voxel[axis] > 0 {
            part = part.split(axis, f64::from(voxel[axis])).1;
        }
        if voxel[axis] + 1 < grid.size[axis] {
            part = part.split(axis, f64::from(voxel[axis] + 1)).0;
        }
    }
    part
}

/// Both parts of a polygon, or the polygon where one of them is next to nothing.
fn cut(polygon: &Polygon, wall: &Wall) -> [Option<Polygon>; 2] {
    let parts = [wall.normal, -wall.normal].map(|normal| polygon.in_front(wall.point, normal));
    let counts = |p: &Polygon| p.area_and_centroid().is_some_and(|(area, _)| area > PIECE);
    if parts.iter().all(counts) { parts.map(Some) } else { [Some(*polygon), None] }
}

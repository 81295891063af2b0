//! How much of its plane within the voxel a surfel fills: what share of the lines through that plane it stops.
//!
//! A voxel that a surface merely touches would otherwise block and re-light the whole tube of lines through it, so
//! that objects look half a voxel bigger than they are. φ = A / area(plane ∩ voxel ∩ fronts), where the plane is cut
//! by the front half-space of every other surfel of the voxel that this one's centroid lies in front of: at the foot
//! of a wall the floor fills all that is to be had. Interior surfels of a surface get exactly 1.

use glam::{DVec3, IVec3};

use super::{
    cluster::{COSINE, Cluster},
    polygon::Polygon,
    walls::Wall,
};

/// Above this, what is missing is rounding and curvature.
const FULL: f64 = 0.99;

/// How far, in voxel edges, a centroid has to lie in front of another surfel to be cut by it.
const IN_FRONT: f64 = 1e-3;

/// φ of cluster `i` of a voxel, in (0, 1]. It lies on one side of each of the walls that cross it.
pub fn fraction(voxel: IVec3, clusters: &[Cluster], i: usize, walls: &[Wall]) -> f64 {
    let me = &clusters[i];
    let mut plane = section(voxel, me);
    for (j, other) in clusters.iter().enumerate() {
        if j != i && other.normal.dot(me.centroid - other.centroid) > IN_FRONT {
            plane = plane.in_front(other.centroid, other.normal);
        }
    }
    // What goes on behind a wall goes on: only at walls that part a surface does its share of the plane end.
    let goes_on =
        |k: usize| clusters.iter().any(|c| c.normal.dot(me.normal) > COSINE && (c.sides ^ me.sides) >> k & 1 == 1);
    for (_, wall) in walls.iter().enumerate().filter(|(k, wall)| wall.crosses(me.normal) && goes_on(*k)) {
        let side = if wall.is_front(me.centroid) { wall.normal } else { -wall.normal };
        plane = plane.in_front(wall.point, side);
    }
    match plane.area_and_centroid() {
        Some((area, _)) if me.area < FULL * area => me.area / area,
        _ => 1.0,
    }
}

/// Area of the plane of a cluster within its voxel, with a margin for rounding and for what curvature adds.
pub fn whole(voxel: IVec3, cluster: &Cluster) -> f64 {
    section(voxel, cluster).area_and_centroid().map_or(f64::INFINITY, |(area, _)| area / FULL)
}

/// The plane of a cluster within its voxel.
fn section(voxel: IVec3, cluster: &Cluster) -> Polygon {
    let mut plane = square(cluster.centroid, cluster.normal);
    let lo = voxel.as_dvec3();
    for axis in 0..3 {
        plane = plane.split(axis, lo[axis]).1.split(axis, lo[axis] + 1.0).0;
    }
    plane
}

/// A square of the plane (point, normal) that covers a voxel around the point.
fn square(point: DVec3, normal: DVec3) -> Polygon {
    let a = normal.any_orthonormal_vector() * 2.0;
    let b = normal.cross(a);
    Polygon::new(&[point - a - b, point + a - b, point + a + b, point - a + b])
}

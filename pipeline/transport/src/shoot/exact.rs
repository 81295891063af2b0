//! Direct light at surfels without noise.
//!
//! A surfel's own point on a real triangle is used, never its centroid, which lies under curved surfaces and would
//! be shadowed by them. Where the surfel is a good part of a flat triangle, four more points of the same triangle
//! and voxel spread the estimate over its area.

use glam::Vec3;
use luxel_scene::{Cancelled, Progress};

use super::Shot;
use crate::{
    Rgb,
    direct::CHUNK,
    gather::{Gather, Receiver},
    geometry::Geometry,
    lighttree::identity,
    sampling::{basis, combine},
    surfel::{Surfel, Surfels, morton},
};

/// Surfels whose receivers form chunks together; the next ones begin a chunk of their own.
const RUN: usize = 1 << 16;

/// Direct irradiance of every surfel by `light`, as the mean over up to `points` (1 or 5) points of each.
pub fn exact(
    geometry: &Geometry,
    surfels: &Surfels,
    light: &dyn Gather,
    points: u32,
    progress: &dyn Progress,
) -> Result<Shot, Cancelled> {
    let mut shot = Shot { irradiance: vec![Rgb::ZERO; surfels.list.len()], ..Shot::default() };
    let batch = batch();
    for run in by_place(surfels).chunks(RUN) {
        let mut places = run.iter().flat_map(|i| places(geometry, surfels, *i, points));
        loop {
            let (owners, receivers): (Vec<Owner>, Vec<Receiver>) = places.by_ref().take(batch).unzip();
            if receivers.is_empty() {
                break;
            }
            for (owner, gathered) in owners.iter().zip(light.gather(&receivers, progress)?) {
                let irradiance = &mut shot.irradiance[owner.surfel as usize];
                *irradiance += gathered.irradiance;
                if owner.last {
                    *irradiance /= f32::from(owner.points);
                }
                shot.rays += u64::from(gathered.rays);
            }
        }
    }
    Ok(shot)
}

/// Receivers gathered at a time, so that memory stays small beside the surfels: whole chunks of what threads take, so
/// that their number changes no bit.
fn batch() -> usize {
    CHUNK * 8 * rayon::current_num_threads()
}

/// The surfel that a receiver belongs to.
#[derive(Clone, Copy)]
struct Owner {
    surfel: u32,
    /// How many receivers it has, and whether this is the last.
    points: u8,
    last: bool,
}

/// The receivers of one surfel.
fn places(
    geometry: &Geometry,
    surfels: &Surfels,
    surfel: u32,
    points: u32,
) -> impl Iterator<Item = (Owner, Receiver)> + use<> {
    let all = receivers(geometry, surfels, surfel as usize, points);
    let count = all.iter().flatten().count();
    let owner = move |number: usize| Owner { surfel, points: count as u8, last: number + 1 == count };
    all.into_iter().flatten().enumerate().map(move |(number, receiver)| (owner(number), receiver))
}

/// The surfels in an order in which neighbours lie close together and face one way, so that one shaft serves many:
/// by dominant axis and sense of the normal, then along the Morton curve of their voxels.
fn by_place(surfels: &Surfels) -> Vec<u32> {
    let key = |i: &u32| {
        let surfel = &surfels.list[*i as usize];
        let axis = surfel.normal.abs().max_position() as u64;
        let sense = u64::from(surfel.normal[axis as usize] < 0.0);
        (2 * axis + sense, morton(surfel.voxel()))
    };
    let mut order: Vec<u32> = (0..surfels.list.len() as u32).collect();
    order.sort_by_cached_key(key);
    order
}

/// The surfel's own point, and its neighbours where they lie on the same triangle, in the same voxel, and on the same
/// side of the walls there.
pub(super) fn receivers(geometry: &Geometry, surfels: &Surfels, number: usize, points: u32) -> [Option<Receiver>; 5] {
    let (grid, surfel) = (&surfels.grid, &surfels.list[number]);
    let (center, normal) = surfel.place(geometry);
    let at = |position: Vec3, i: u64| Receiver {
        position,
        normal,
        shading_normal: normal,
        footprint: surfel.area.sqrt(),
        // The surfel's own identity: an edit of another mesh, which renumbers triangles, changes nobody's noise.
        seed: combine(identity(surfel), i),
    };
    let mut found = [Some(at(center, 0)), None, None, None, None];
    if points < 2 {
        return found;
    }
    let corners = geometry.triangles[surfel.triangle as usize].corners;
    let axes = basis(normal);
    let step = 0.3 * grid.edge;
    for (i, (x, y)) in [(1.0, 0.4), (-0.4, 1.0), (-1.0, -0.4), (0.4, -1.0)].into_iter().enumerate() {
        let p = center + (axes.x_axis * x + axes.y_axis * y) * step;
        let voxel = ((p - grid.origin) / grid.edge).floor().as_ivec3();
        let is_own = || Surfels::owner(&surfels.list, grid.edge, mates(surfels, number), number, p) == number;
        if voxel == surfel.voxel() && contains(corners, p) && is_own() {
            found[i + 1] = Some(at(p, i as u64 + 1));
        }
    }
    found
}

/// The surfels of a surfel's voxel.
fn mates(surfels: &Surfels, number: usize) -> std::ops::Range<usize> {
    let voxel = surfels.list[number].voxel();
    let is_mate = |s: &&Surfel| s.voxel() == voxel;
    let before = surfels.list[..number].iter().rev().take_while(is_mate).count();
    number - before..number + surfels.list[number..].iter().take_while(is_mate).count()
}

/// A point of the triangle's plane lies within the triangle.
fn contains([a, b, c]: [Vec3; 3], p: Vec3) -> bool {
    let n = (b - a).cross(c - a);
    [(a, b), (b, c), (c, a)].iter().all(|&(x, y)| n.dot((y - x).cross(p - x)) >= 0.0)
}

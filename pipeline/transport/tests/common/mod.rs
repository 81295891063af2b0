//! Scenes of axis-aligned quads with surfels made by hand, so that the gather is tested apart from voxelizer and solver.
#![allow(dead_code, reason = "every test and bench that shares this module uses a part of it")]

use glam::{IVec3, Vec3};
use luxel_scene::{Scene, build::Builder};
use luxel_transport::{
    Rgb,
    gather::{Receiver, nodes::Cell},
    geometry::Geometry,
    surfel::{Grid, Patch, Solution, Surfel, Surfels},
};

/// An inward room [−1, 1]³ with walls of one albedo.
pub fn room(albedo: f32) -> Scene {
    let mut b = Builder::new("room");
    let grey = b.matte(Vec3::splat(albedo));
    b.cuboid("room", Vec3::NEG_ONE, Vec3::ONE, grey, true);
    b.build()
}

/// The room with a block that stands free in it.
pub fn room_with_block(albedo: f32) -> Scene {
    let mut b = Builder::new("room with block");
    let grey = b.matte(Vec3::splat(albedo));
    b.cuboid("room", Vec3::NEG_ONE, Vec3::ONE, grey, true);
    b.cuboid("block", Vec3::new(-0.5, -0.6, -0.45), Vec3::new(0.1, 0.2, 0.25), grey, false);
    b.build()
}

/// Surfels of a scene whose triangles come in pairs that form axis-aligned rectangles: one for every voxel that a
/// rectangle meets, `n` voxels along the longest side.
pub fn surfels(geometry: &Geometry, n: u32) -> Surfels {
    let corners = || geometry.triangles.iter().flat_map(|t| t.corners);
    let lo = corners().reduce(Vec3::min).unwrap_or(Vec3::ZERO);
    let hi = corners().reduce(Vec3::max).unwrap_or(Vec3::ZERO);
    let edge = (hi - lo).max_element() / n as f32;
    let origin = lo - edge * Vec3::new(0.47, 0.53, 0.59);
    let size = ((hi - origin) / edge).ceil().as_ivec3();
    let mut list = Vec::new();
    for first in (0..geometry.triangles.len() as u32).step_by(2) {
        tessellate(geometry, first, origin, edge, &mut list);
    }
    list.sort_by_key(|s: &Surfel| s.voxel().to_array());
    Surfels::dark(Grid { origin, edge, size }, list)
}

fn tessellate(geometry: &Geometry, first: u32, origin: Vec3, edge: f32, list: &mut Vec<Surfel>) {
    let pair = [0, 1].map(|i| geometry.triangles[(first + i) as usize]);
    let corners = || pair.iter().flat_map(|t| t.corners);
    let (lo, hi) = (corners().reduce(Vec3::min).unwrap(), corners().reduce(Vec3::max).unwrap());
    let axis = (0..3).find(|&a| hi[a] - lo[a] < 1e-3).expect("an axis-aligned rectangle");
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let cell = |p: Vec3| ((p - origin) / edge).floor().as_ivec3();
    let (from, to) = (cell(lo), cell(hi));
    for y in from[j]..=to[j] {
        for z in from[k]..=to[k] {
            let mut voxel = IVec3::ZERO;
            (voxel[axis], voxel[j], voxel[k]) = (from[axis], y, z);
            let corner = origin + voxel.as_vec3() * edge;
            let (a, b) = (corner.max(lo), (corner + edge).min(hi));
            let area = (b[j] - a[j]) * (b[k] - a[k]);
            let mut centroid = 0.5 * (a + b);
            centroid[axis] = lo[axis];
            if area <= 0.0 {
                continue;
            }
            let (triangle, u, v) = locate(&pair, first, centroid);
            let surface = geometry.surface(triangle, u, v, 0.0);
            let sides = if geometry.material(triangle).double_sided { 2 } else { 1 };
            for side in 0..sides {
                let back = side == 1;
                list.push(Surfel::from(Patch {
                    voxel,
                    centroid,
                    normal: if back { -pair[0].normal } else { pair[0].normal },
                    area: area * surface.coverage,
                    albedo: surface.albedo,
                    fill: area / (edge * edge),
                    triangle,
                    u,
                    v,
                    back,
                }));
            }
        }
    }
}

/// The triangle of a pair that holds a point, and its barycentric coordinates.
fn locate(pair: &[luxel_transport::geometry::Triangle; 2], first: u32, p: Vec3) -> (u32, f32, f32) {
    let coordinates = |t: &luxel_transport::geometry::Triangle| {
        let [a, b, c] = t.corners;
        let n = (b - a).cross(c - a);
        let area = n.length_squared();
        ((p - a).cross(c - a).dot(n) / area, (b - a).cross(p - a).dot(n) / area)
    };
    let (u, v) = coordinates(&pair[0]);
    if u >= -1e-4 && v >= -1e-4 && u + v <= 1.0 + 1e-4 {
        return (first, u.clamp(0.0, 1.0), v.clamp(0.0, 1.0));
    }
    let (u, v) = coordinates(&pair[1]);
    (first + 1, u.clamp(0.0, 1.0), v.clamp(0.0, 1.0))
}

/// Irradiance at surfels by position and normal, all of it indirect.
pub fn solution(surfels: &Surfels, irradiance: impl Fn(Vec3, Vec3) -> Rgb) -> Solution {
    let indirect: Vec<Rgb> = surfels.list.iter().map(|s| irradiance(s.centroid, s.normal)).collect();
    Solution { direct: vec![Rgb::ZERO; indirect.len()], indirect }
}

/// A receiver every `step` surfels, on the surface and off the surfel's middle.
pub fn receivers(geometry: &Geometry, surfels: &Surfels, step: usize) -> Vec<Receiver> {
    let at = |(i, s): (usize, &Surfel)| {
        let (u, v) = (0.93 * s.u() + 0.02, 0.93 * s.v() + 0.03);
        Receiver::on_triangle(geometry, s.triangle, u, v, surfels.grid.edge, i as u64)
    };
    surfels.list.iter().enumerate().step_by(step).map(at).collect()
}

/// A chart of n × n texels on each of the first `quads` quads of a scene.
pub fn charts(geometry: &Geometry, quads: u32, n: u32) -> (Vec<Receiver>, Vec<Cell>) {
    let (mut receivers, mut cells) = (Vec::new(), Vec::new());
    for chart in 0..quads {
        let footprint = (2.0 * geometry.triangles[2 * chart as usize].area()).sqrt() / n as f32;
        for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))) {
            let (s, t) = ((x as f32 + 0.5) / n as f32, (y as f32 + 0.5) / n as f32);
            // The first triangle lies beside the quad's first edge, the second one beside its last.
            let (triangle, u, v) = if s >= t { (2 * chart, s - t, t) } else { (2 * chart + 1, s, t - s) };
            let seed = u64::from((chart * n + y) * n + x);
            receivers.push(Receiver::on_triangle(geometry, triangle, u, v, footprint, seed));
            cells.push(Cell { chart, x, y });
        }
    }
    (receivers, cells)
}

/// A smooth field with bright and dark regions, in relative coordinates of the frame.
pub fn gradient(p: Vec3, n: Vec3) -> Rgb {
    let q = p / 2048.0;
    let base = 1.0 + 0.5 * q.x + 0.2 * q.y * q.z + 0.15 * n.y;
    Rgb::new(base, 1.0 + 0.4 * q.y, 1.2 - 0.5 * q.z) * 10.0
}

//! Emitters that lie on each other.
//!
//! A ray meets one surface of a plane, and where distances round alike that is the first. They seldom do where corners
//! differ, so for opaque emitters it is decided here, for rays that find them and next events that aim at them alike: of
//! those in one plane at a point, a ray meets the first one that shines its way.

use glam::{DVec3, Vec3};

use crate::{
    geometry::{Geometry, Triangle},
    rays::{Hit, OFFSET},
};

/// Up to so far apart triangles are in one plane, or merely touch [frame units].
const NEAR: f64 = 0.25 * OFFSET as f64;

/// Every two emitters that overlap, once from each of them; sorted.
pub(super) struct Overlaps(Vec<(u32, u32)>);

impl Overlaps {
    /// Those among `emitters` that are opaque.
    pub fn new(geometry: &Geometry, emitters: &[u32]) -> Self {
        let triangle = |i: u32| &geometry.triangles[i as usize];
        let low = |i: u32| triangle(i).corners.iter().fold(f32::INFINITY, |x, c| x.min(c.x));
        let high = |i: u32| triangle(i).corners.iter().fold(f32::NEG_INFINITY, |x, c| x.max(c.x));
        let mut list: Vec<(f32, u32)> =
            emitters.iter().filter(|&&i| geometry.material(i).is_opaque()).map(|&i| (low(i), i)).collect();
        list.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut pairs = Vec::new();
        for (k, &(_, i)) in list.iter().enumerate() {
            let end = high(i) + OFFSET;
            for &(_, j) in list[k + 1..].iter().take_while(|(from, _)| *from <= end) {
                if overlap(triangle(i), triangle(j)) {
                    pairs.extend([(i, j), (j, i)]);
                }
            }
        }
        pairs.sort_unstable();
        Self(pairs)
    }

    /// What a ray along `direction` meets that hits a surface at `hit`.
    pub fn met(&self, geometry: &Geometry, hit: Hit, direction: Vec3) -> Hit {
        if self.0.is_empty() {
            return hit;
        }
        let first = self.0.partition_point(|(i, _)| *i < hit.triangle);
        let others = self.0[first..].iter().take_while(|(i, _)| *i == hit.triangle).map(|(_, j)| *j);
        let shines = |i: u32, back: bool| !back || geometry.material(i).double_sided;
        let own = shines(hit.triangle, hit.back);
        let position = geometry.triangles[hit.triangle as usize].at(hit.u, hit.v);
        let met = others.take_while(|j| !own || *j < hit.triangle).find_map(|j| {
            let t = &geometry.triangles[j as usize];
            let back = t.normal.dot(direction) > 0.0;
            let [u, v] = inside(t, position).filter(|_| shines(j, back))?;
            Some(Hit { triangle: j, u, v, back, ..hit })
        });
        met.unwrap_or(hit)
    }
}

/// Two triangles lie in one plane, and no edge of either parts them.
fn overlap(a: &Triangle, b: &Triangle) -> bool {
    let flat = |a: &Triangle, b: &Triangle| {
        let height = |c: &Vec3| a.normal.as_dvec3().dot((*c - a.corners[0]).as_dvec3());
        b.corners.iter().all(|c| height(c).abs() <= NEAR)
    };
    let apart = |a: &Triangle, b: &Triangle| {
        inward(a).iter().any(|(at, n)| b.corners.iter().all(|c| n.dot(c.as_dvec3() - *at) <= NEAR))
    };
    a.normal.dot(b.normal).abs() > 1.0 - 1e-6 && (flat(a, b) || flat(b, a)) && !apart(a, b) && !apart(b, a)
}

/// A corner of each edge with the unit vector from there into the triangle.
fn inward(t: &Triangle) -> [(DVec3, DVec3); 3] {
    std::array::from_fn(|i| {
        let [a, b, c] = [0, 1, 2].map(|k| t.corners[(i + k) % 3].as_dvec3());
        let edge = (b - a).normalize_or_zero();
        (a, (c - a - edge * edge.dot(c - a)).normalize_or_zero())
    })
}

/// Barycentric coordinates of a point of the triangle's plane that is inside.
fn inside(t: &Triangle, p: Vec3) -> Option<[f32; 2]> {
    let [a, b, c] = t.corners.map(Vec3::as_dvec3);
    let (e, f, g) = (b - a, c - a, p.as_dvec3() - a);
    let n = e.cross(f);
    let (u, v) = (g.cross(f).dot(n) / n.length_squared(), e.cross(g).dot(n) / n.length_squared());
    (u > 0.0 && v > 0.0 && u + v < 1.0).then_some([u as f32, v as f32])
}

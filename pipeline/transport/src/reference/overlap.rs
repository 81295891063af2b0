//! Emitters that lie on each other.
//!
//! A ray meets one surface of a plane, and where distances round alike that is the first. They seldom do where corners
//! differ, so for opaque emitters it is decided here, for rays that find them and next events that aim at them alike: of
//! those in one plane at a point, a ray meets the first one that shines its way.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::{
    boxes::{Boxes, around},
    geometry::{Geometry, Triangle},
    rays::{Hit, OFFSET},
};

/// Up to so far apart triangles are in one plane, or merely touch [frame units].
const NEAR: f64 = 0.25 * OFFSET as f64;

/// The emitters that overlap others. Who overlaps whom is asked where a ray hits: in a stack everybody does.
pub(super) struct Overlaps {
    /// Sorted.
    triangles: Vec<u32>,
    /// In their order.
    boxes: Boxes,
}

impl Overlaps {
    /// Those among `emitters`, which are sorted, that are opaque.
    pub fn new(geometry: &Geometry, emitters: &[u32]) -> Self {
        let triangle = |i: u32| &geometry.triangles[i as usize];
        let opaque: Vec<u32> = emitters.iter().copied().filter(|&i| geometry.material(i).is_opaque()).collect();
        let boxes = |list: &[u32]| Boxes::new(list.iter().map(|&i| around(&triangle(i).corners)));
        let all = boxes(&opaque);
        let is_one = |&i: &u32| {
            let mut found = false;
            let (lo, hi) = around(&triangle(i).corners);
            all.meeting((lo - OFFSET, hi + OFFSET), |k| {
                let other = opaque[k as usize];
                found = other != i && overlap(triangle(i), triangle(other));
                !found
            });
            found
        };
        let triangles: Vec<u32> = opaque.par_iter().copied().filter(is_one).collect();
        let boxes = boxes(&triangles);
        Self { triangles, boxes }
    }

    /// What a ray along `direction` meets that hits a surface at `hit`.
    pub fn met(&self, geometry: &Geometry, hit: Hit, direction: Vec3) -> Hit {
        if self.triangles.binary_search(&hit.triangle).is_err() {
            return hit;
        }
        let shines = |i: u32, back: bool| !back || geometry.material(i).double_sided;
        let own = shines(hit.triangle, hit.back);
        let mine = &geometry.triangles[hit.triangle as usize];
        let position = mine.at(hit.u, hit.v);
        let mut met = hit;
        self.boxes.meeting((position - OFFSET, position + OFFSET), |k| {
            let j = self.triangles[k as usize];
            let found = met.triangle != hit.triangle;
            let is_before = if found { j < met.triangle } else { j < hit.triangle || !own };
            if j != hit.triangle && is_before {
                let t = &geometry.triangles[j as usize];
                let back = t.normal.dot(direction) > 0.0;
                let at = inside(t, position).filter(|_| shines(j, back) && overlap(mine, t));
                met = at.map_or(met, |[u, v]| Hit { triangle: j, u, v, back, ..hit });
            }
            true
        });
        met
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

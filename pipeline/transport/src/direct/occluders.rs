//! What can block light: the casting triangles under a binary BVH that answers shafts and segments.
//!
//! Segments use the same shadow cones as whole targets ([`super::cone`]), so that the choice between the two, made
//! for speed, does not change what is visible.

use std::time::Duration;

use glam::Vec3;
use luxel_scene::{Cancelled, Progress, watched};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};

use super::{
    cone::Cone,
    shaft::Shaft,
    target::{Plane, Points},
};
use crate::aside::aside;
use crate::geometry::Geometry;

/// Triangles whose tree takes longer than a look can wait: obvhs needs about a microsecond for each, and nothing
/// interrupts it.
const LONG: usize = 1 << 15;

/// Marks an occluder that is not simply solid: holes, veils, coloured glass.
pub const VEIL: u32 = 1 << 31;

/// How a segment fares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Passage {
    Open,
    /// Only surfaces in the way that may let light pass.
    Veiled,
    Blocked,
}

/// The casting triangles of a scene.
pub struct Occluders<'a> {
    geometry: &'a Geometry<'a>,
    bvh: Bvh2,
    /// Triangles in the order of the BVH's leaves, with [`VEIL`].
    order: Vec<u32>,
}

fn boxed([a, b, c]: &[Vec3; 3]) -> Aabb {
    Aabb::new(a.min(*b).min(*c).into(), a.max(*b).max(*c).into())
}

impl<'a> Occluders<'a> {
    /// For those who ask shadow rays alone: no tree.
    pub fn none(geometry: &'a Geometry<'a>) -> Self {
        Self { geometry, bvh: Bvh2::default(), order: Vec::new() }
    }

    pub fn new(geometry: &'a Geometry<'a>, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let mut ids = Vec::new();
        for item in watched(geometry.triangles.iter().enumerate(), progress) {
            let (i, t) = item?;
            let material = geometry.material(i as u32);
            if !t.is_degenerate() && !material.unlit && geometry.scene.instances[t.instance as usize].casts {
                ids.push(i as u32 | if material.is_opaque() { 0 } else { VEIL });
            }
        }
        let boxed = |i: &u32| boxed(&geometry.triangles[(i & !VEIL) as usize].corners);
        let boxes = watched(&ids, progress).map(|i| Ok(boxed(i?))).collect::<Result<Vec<Aabb>, Cancelled>>()?;
        let bvh = if boxes.is_empty() {
            Bvh2::default()
        } else {
            let build = move || build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
            aside(ids.len() >= LONG, progress, build)?
        };
        let order = bvh.primitive_indices.iter().map(|&i| ids[i as usize]).collect();
        Ok(Self { geometry, bvh, order })
    }

    /// Corners of an occluder.
    #[inline]
    pub fn corners(&self, id: u32) -> [Vec3; 3] {
        self.geometry.triangles[(id & !VEIL) as usize].corners
    }

    /// Appends every occluder that may reach into the shaft; false, with some missing, when there are more than
    /// `limit`.
    pub fn query(&self, shaft: &Shaft, limit: usize, out: &mut Vec<u32>) -> bool {
        let start = out.len();
        let reached = self.visit(
            |lo, hi| !shaft.misses_box(lo, hi),
            |id| {
                if !shaft.misses_triangle(self.corners(id)) {
                    out.push(id);
                }
                out.len() - start <= limit
            },
        );
        if !reached {
            out.truncate(start);
        }
        reached
    }

    /// What is between `point` and one point of a target. `last` is the solid occluder found before, which is asked
    /// first: neighbouring points are mostly hidden by the same one.
    pub fn passage(&self, point: Vec3, plane: &Plane, points: &Points, at: usize, last: &mut Option<u32>) -> Passage {
        let (u, v) = (points.u[at], points.v[at]);
        let hides =
            |id| Cone::new(point, self.corners(id), plane, &points.corners).as_ref().is_some_and(|c| c.hides(u, v));
        if last.is_some_and(hides) {
            return Passage::Blocked;
        }
        let to = plane.at(u, v);
        // Finite, so that 0 · ∞ never arises where the segment runs along an axis.
        let inverse = to.recip().clamp(Vec3::splat(-1e30), Vec3::splat(1e30));
        let mut passage = Passage::Open;
        let clear = self.visit(
            |lo, hi| segment_meets_box(point, inverse, lo, hi),
            |id| {
                if hides(id) {
                    passage = Passage::Veiled;
                    if id & VEIL == 0 {
                        *last = Some(id);
                        return false;
                    }
                }
                true
            },
        );
        if clear { passage } else { Passage::Blocked }
    }

    /// Visits the triangles of all boxes that `enter` accepts until `leaf` returns false; whether it never did.
    fn visit(&self, enter: impl Fn(Vec3, Vec3) -> bool, mut leaf: impl FnMut(u32) -> bool) -> bool {
        if self.order.is_empty() {
            return true;
        }
        let enters = |at: u32| {
            let aabb = self.bvh.nodes[at as usize].aabb();
            enter(aabb.min.into(), aabb.max.into())
        };
        // What a degenerate tree has beyond the fixed stack waits in a list that is mostly never allocated.
        let (mut stack, mut top, mut more) = ([0u32; 64], 0, Vec::new());
        let mut next = enters(0).then_some(0u32);
        while let Some(at) = next {
            let node = &self.bvh.nodes[at as usize];
            next = None;
            if node.is_leaf() {
                let first = node.first_index as usize;
                for &id in &self.order[first..first + node.prim_count as usize] {
                    if !leaf(id) {
                        return false;
                    }
                }
            } else {
                let (first, second) = (node.first_index, node.first_index + 1);
                next = enters(first).then_some(first);
                if enters(second) {
                    match next {
                        None => next = Some(second),
                        Some(_) if top < stack.len() => {
                            stack[top] = second;
                            top += 1;
                        }
                        Some(_) => more.push(second),
                    }
                }
            }
            if next.is_none() {
                next = more.pop();
                if next.is_none() && top > 0 {
                    top -= 1;
                    next = Some(stack[top]);
                }
            }
        }
        true
    }
}

/// Slab test of the segment from `p` with per-axis inverse of its extent, grown by a little.
fn segment_meets_box(p: Vec3, inverse: Vec3, lo: Vec3, hi: Vec3) -> bool {
    const GROW: f32 = 1e-3;
    let (a, b) = ((lo - GROW - p) * inverse, (hi + GROW - p) * inverse);
    let (near, far) = (a.min(b), a.max(b));
    near.x.max(near.y).max(near.z).max(0.0) <= far.x.min(far.y).min(far.z).min(1.0)
}

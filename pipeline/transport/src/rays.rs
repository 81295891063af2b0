//! Continuous rays: closest hits, walks through veils, and coloured transmittance.
//!
//! Every surface that casts and is not unlit takes part; both of its sides stop rays (a single-sided back absorbs,
//! which is the caller's business: [`Hit::back`]). Texels of a MASK material under its cut-off are holes. BLEND and
//! transmitting surfaces are *veils*: they are hit, and pass their coloured transmittance T from either side. Along a
//! ray through veils 1, 2, … the light that passes is T₁·T₂·…, and the k-th surface is seen through T₁…T₍ₖ₋₁₎.
//!
//! What a query returns depends on the geometry alone, not on the order in which the hierarchy was traversed: ties go
//! to the lower triangle index and veils are multiplied from front to back.
//!
//! **Contacts.** The hierarchy's node test has an absolute tolerance of 1e-4 and rounds like every f32 computation, so
//! each triangle's box is padded by [`PAD`]; together with the normalised frame that leaves no gap at any scene scale.
//! A ray starts [`OFFSET`] above the surface that it leaves ([`leave`]) and, when it aims at a point of an emitter,
//! ends as far in front of that one ([`Rays::between`]).

mod hierarchy;
mod triangle;

use std::sync::Arc;

use glam::{Vec3, Vec3A};
use luxel_scene::{Alpha, Cancelled, Material, Progress, Silent, watched};
use obvhs::{
    aabb::Aabb,
    cwbvh::CwBvh,
    ray::{Ray, RayHit},
};

use crate::{Rgb, geometry::Geometry};
use triangle::{Corners, Crossing, Shear};

/// How far a ray starts from the surface that it leaves, in frame units: 16 ulp of the largest coordinate, and less
/// than a thousandth of a texel of a 4096² map.
pub const OFFSET: f32 = 4e-3;

/// Margin of every triangle's box, frame units: four roundings of the longest distance (4096 · 2⁻²³ each).
const PAD: f32 = 2e-3;

/// What less than this share of the light passes is taken for opaque by [`Rays::transmittance`].
const OPAQUE: f32 = 1e-6;

/// [`Rays::first_hits`] ends where less than this share of the light is left.
const FAINT: f32 = 1e-3;

/// Where a ray met a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, frame units.
    pub distance: f32,
    /// Index among [`Geometry::triangles`].
    pub triangle: u32,
    /// Barycentric coordinates of the second and third corner.
    pub u: f32,
    pub v: f32,
    /// The ray came from behind.
    pub back: bool,
}

impl Hit {
    /// Front to back, the lower index first where two surfaces coincide.
    fn order(&self, other: &Hit) -> std::cmp::Ordering {
        self.distance.total_cmp(&other.distance).then(self.triangle.cmp(&other.triangle))
    }
}

/// Where a ray along `direction` starts that leaves a surface of unit geometric normal `normal` at `position`: a little
/// above it, on the side to which the ray goes.
pub fn leave(position: Vec3, normal: Vec3, direction: Vec3) -> Vec3 {
    position + normal * OFFSET.copysign(normal.dot(direction))
}

/// What a triangle does to a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Solid,
    /// Holes by alpha test.
    Masked,
    /// Passes part of the light.
    Veil,
}

impl Kind {
    fn of(material: &Material) -> Self {
        match material.alpha {
            _ if material.transmission > 0.0 => Kind::Veil,
            Alpha::Opaque => Kind::Solid,
            Alpha::Mask(_) => Kind::Masked,
            Alpha::Blend => Kind::Veil,
        }
    }
}

/// Index of a triangle with its kind in the two upper bits.
#[derive(Clone, Copy, Debug)]
struct Id(u32);

impl Id {
    const SHIFT: u32 = 30;

    fn new(triangle: u32, kind: Kind) -> Self {
        Self(triangle | (kind as u32) << Self::SHIFT)
    }

    fn triangle(self) -> u32 {
        self.0 & ((1 << Self::SHIFT) - 1)
    }

    fn kind(self) -> Kind {
        match self.0 >> Self::SHIFT {
            0 => Kind::Solid,
            1 => Kind::Masked,
            _ => Kind::Veil,
        }
    }
}

/// A ray-tracing view of a [`Geometry`]: everything that casts and is not unlit.
pub struct Rays<'a> {
    pub geometry: &'a Geometry<'a>,
    tree: Arc<Tree>,
}

/// What rays need beside their geometry.
#[derive(Debug)]
pub struct Tree {
    bvh: CwBvh,
    /// In the order of the hierarchy's leaves, as are `ids`.
    corners: Vec<Corners>,
    ids: Vec<Id>,
    all_solid: bool,
}

impl<'a> Rays<'a> {
    pub fn new(geometry: &'a Geometry<'a>) -> Self {
        match Self::build(geometry, &Silent) {
            Ok(rays) => rays,
            Err(Cancelled) => unreachable!("nobody cancels"),
        }
    }

    /// [`Rays::new`] that can be cancelled.
    pub fn build(geometry: &'a Geometry<'a>, progress: &dyn Progress) -> Result<Self, Cancelled> {
        Ok(Self::with(geometry, Arc::new(Tree::build(geometry, progress)?)))
    }

    /// The rays of a geometry whose tree is known: that of one with the same surfaces, all that the material says of
    /// holes and veils included.
    pub fn with(geometry: &'a Geometry<'a>, tree: Arc<Tree>) -> Self {
        Self { geometry, tree }
    }

    pub fn tree(&self) -> &Arc<Tree> {
        &self.tree
    }

    /// The nearest surface along `direction` (unit) within `[0, max)`, holes skipped, veils included.
    pub fn closest(&self, origin: Vec3, direction: Vec3, max: f32) -> Option<Hit> {
        let mut nearest: Option<Hit> = None;
        self.traverse(origin, direction, max, |hit, kind| {
            if kind != Kind::Solid && !self.is_there(&hit) {
                return f32::INFINITY;
            }
            if nearest.is_none_or(|n| hit.order(&n).is_lt()) {
                nearest = Some(hit);
            }
            hit.distance
        });
        nearest.map(|hit| self.sided(hit, direction))
    }

    /// Visits the surfaces along `direction` (unit) within `[0, max)` from front to back, with the share of the light
    /// that reaches the ray's origin from there, until less than a thousandth of it is left. Returns what is left at
    /// the end of the ray: 0 behind an opaque surface.
    pub fn first_hits(&self, origin: Vec3, direction: Vec3, max: f32, f: impl FnMut(&Hit, Rgb)) -> Rgb {
        self.walk(origin, direction, max, FAINT, f)
    }

    /// [`Rays::first_hits`] that ends where no more than `faint` is left; with 0 it leaves nothing out.
    pub fn walk(&self, origin: Vec3, direction: Vec3, max: f32, faint: f32, mut f: impl FnMut(&Hit, Rgb)) -> Rgb {
        if self.tree.all_solid {
            return match self.closest(origin, direction, max) {
                Some(hit) => {
                    f(&hit, Rgb::ONE);
                    Rgb::ZERO
                }
                None => Rgb::ONE,
            };
        }
        let (mut veils, mut nearest) = (Vec::new(), None::<Hit>);
        self.traverse(origin, direction, max, |hit, kind| {
            if kind != Kind::Solid {
                let surface = self.geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
                if surface.coverage <= 0.0 {
                    return f32::INFINITY;
                }
                if surface.transmittance != Rgb::ZERO {
                    veils.push((hit, surface.transmittance));
                    return f32::INFINITY;
                }
            }
            if nearest.is_none_or(|n| hit.order(&n).is_lt()) {
                nearest = Some(hit);
            }
            hit.distance
        });
        veils.sort_unstable_by(|(a, _), (b, _)| a.order(b));
        let mut share = Rgb::ONE;
        for (hit, transmittance) in veils {
            if nearest.is_some_and(|n| n.order(&hit).is_lt()) {
                break;
            }
            f(&self.sided(hit, direction), share);
            share *= transmittance;
            if share.max_element() <= faint {
                return Rgb::ZERO;
            }
        }
        match nearest {
            Some(hit) => {
                f(&self.sided(hit, direction), share);
                Rgb::ZERO
            }
            None => share,
        }
    }

    /// The share of light that passes along `direction` (unit) within `[0, max)`: 1 where nothing is in the way.
    pub fn transmittance(&self, origin: Vec3, direction: Vec3, max: f32) -> Rgb {
        if self.tree.all_solid {
            let missed = self.traverse_any(origin, direction, max, |hit, _| hit.distance);
            return if missed { Rgb::ONE } else { Rgb::ZERO };
        }
        let mut veils = Vec::new();
        let mut pass = Rgb::ONE;
        let missed = self.traverse_any(origin, direction, max, |hit, kind| {
            if kind == Kind::Solid {
                return hit.distance;
            }
            let transmittance = self.geometry.surface(hit.triangle, hit.u, hit.v, 0.0).transmittance;
            if transmittance == Rgb::ONE {
                return f32::INFINITY;
            }
            veils.push((hit, transmittance));
            pass *= transmittance;
            if pass.max_element() > OPAQUE { f32::INFINITY } else { hit.distance }
        });
        if !missed {
            return Rgb::ZERO;
        }
        if veils.len() < 2 {
            return pass;
        }
        veils.sort_unstable_by(|(a, _), (b, _)| a.order(b));
        veils.iter().fold(Rgb::ONE, |pass, (_, transmittance)| pass * transmittance)
    }

    /// The share of light that passes between two surface points, given their unit geometric normals.
    pub fn between(&self, (p, np): (Vec3, Vec3), (q, nq): (Vec3, Vec3)) -> Rgb {
        let origin = leave(p, np, q - p);
        let step = leave(q, nq, p - q) - origin;
        let length = step.length();
        if length > 0.0 { self.transmittance(origin, step / length, length) } else { Rgb::ONE }
    }

    /// Every surface is solid, so [`Rays::transmittance`] is 0 or 1.
    pub fn all_solid(&self) -> bool {
        self.tree.all_solid
    }

    /// Calls `accept` for every triangle hit in front of the nearest distance that it has returned so far.
    #[inline(always)]
    fn traverse(&self, origin: Vec3, direction: Vec3, max: f32, mut accept: impl FnMut(Hit, Kind) -> f32) {
        if self.tree.ids.is_empty() {
            return;
        }
        let shear = Shear::new(origin, direction);
        let ray = ray(origin, direction, max);
        self.tree.bvh.ray_traverse(ray, &mut RayHit::none(), |ray, at| {
            // Ties with the nearest so far are hits; the end of the ray itself does not belong to it.
            let Some(crossing) = self.tree.corners[at].intersect(&shear, ray.tmax) else { return f32::INFINITY };
            if crossing.distance < max { self.meet(at, &crossing, &mut accept) } else { f32::INFINITY }
        });
    }

    /// Calls `accept` for triangles hit until it returns a distance. True when it never did.
    #[inline(always)]
    fn traverse_any(&self, origin: Vec3, direction: Vec3, max: f32, mut accept: impl FnMut(Hit, Kind) -> f32) -> bool {
        if self.tree.ids.is_empty() {
            return true;
        }
        let shear = Shear::new(origin, direction);
        self.tree.bvh.ray_traverse_miss(ray(origin, direction, max), |_, at| {
            let Some(crossing) = self.tree.corners[at].intersect(&shear, max) else { return f32::INFINITY };
            if crossing.distance < max { self.meet(at, &crossing, &mut accept) } else { f32::INFINITY }
        })
    }

    #[inline(always)]
    fn meet(&self, at: usize, crossing: &Crossing, accept: &mut impl FnMut(Hit, Kind) -> f32) -> f32 {
        let id = self.tree.ids[at];
        let kind = id.kind();
        // Opaque surfaces stop a ray at either neighbour of an edge; veils must not weaken it twice.
        if kind == Kind::Veil && !crossing.owned {
            return f32::INFINITY;
        }
        let Crossing { distance, u, v, .. } = *crossing;
        accept(Hit { distance, triangle: id.triangle(), u, v, back: false }, kind)
    }

    fn sided(&self, hit: Hit, direction: Vec3) -> Hit {
        Hit { back: self.geometry.triangles[hit.triangle as usize].normal.dot(direction) > 0.0, ..hit }
    }

    fn is_there(&self, hit: &Hit) -> bool {
        self.geometry.surface(hit.triangle, hit.u, hit.v, 0.0).coverage > 0.0
    }
}

impl Tree {
    fn build(geometry: &Geometry, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let mut boxes = Vec::new();
        let mut ids = Vec::new();
        for item in watched(geometry.triangles.iter().enumerate(), progress) {
            let (i, t) = item?;
            let material = geometry.material(i as u32);
            if t.is_degenerate() || material.unlit || !geometry.scene.instances[t.instance as usize].casts {
                continue;
            }
            let [a, b, c] = t.corners;
            boxes.push(Aabb::new((a.min(b).min(c) - PAD).into(), (a.max(b).max(c) + PAD).into()));
            ids.push(Id::new(i as u32, Kind::of(material)));
        }
        let all_solid = ids.iter().all(|id| id.kind() == Kind::Solid);
        let mut bvh = hierarchy::build(&boxes, progress)?;
        drop(boxes);
        let order = std::mem::take(&mut bvh.primitive_indices);
        bvh.nodes.shrink_to_fit();
        let ids: Vec<Id> = order.iter().map(|&i| ids[i as usize]).collect();
        let corners = |id: &Id| Corners::new(geometry.triangles[id.triangle() as usize].corners);
        let corners = watched(&ids, progress).map(|id| Ok(corners(id?))).collect::<Result<_, Cancelled>>()?;
        Ok(Self { bvh, corners, ids, all_solid })
    }

    /// Bytes that it holds.
    pub fn bytes(&self) -> usize {
        std::mem::size_of_val(&self.bvh.nodes[..])
            + std::mem::size_of_val(&self.corners[..])
            + std::mem::size_of_val(&self.ids[..])
    }
}

/// The hierarchy takes −0 for a positive direction with a negative inverse and then misses every box: adding +0 makes
/// it +0.
fn ray(origin: Vec3, direction: Vec3, max: f32) -> Ray {
    Ray::new(Vec3A::from(origin), Vec3A::from(direction) + Vec3A::ZERO, 0.0, max)
}

#[cfg(test)]
mod tests;

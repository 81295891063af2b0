//! Emissive polygons that lie on each other: a ray meets one surface of a plane, the first.
//!
//! So of polygons with equal corners each side shines once, that of the first, and of one that earlier ones of its plane and
//! front cover in part only what is left of it shines: cut along the edges of each of them (a convex polygon minus another one
//! is a convex piece for every edge at most), into pieces of at most four corners. The sides of two-sided polygons are
//! covered each by itself. Polygons of varying radiance are not cut and cut no others, and neither do veils, through which
//! others are seen.

use std::collections::HashMap;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::AreaLight;
use crate::{
    boxes::{Boxes, around},
    geometry::Geometry,
    rays::OFFSET,
};

/// What is closer lies in one plane, or does not overlap in it: corners are rounded by an eighth of it at most [frame
/// units].
const NEAR: f64 = 0.25 * OFFSET as f64;

/// Pieces of a smaller share of a polygon's area are nothing.
const SLIVER: f64 = 1e-6;

/// Least cosine between the normals of one plane; the corners decide.
const PARALLEL: f32 = 1.0 - 1e-6;

/// What of the polygons rays may meet, in their order.
pub(super) fn uncovered(geometry: &Geometry, areas: Vec<AreaLight>) -> Vec<AreaLight> {
    let areas = singled(geometry, areas);
    let is_even = |light: &AreaLight| light.table.is_none() && geometry.material(light.triangle).is_opaque();
    let even: Vec<usize> = (0..areas.len()).filter(|&i| is_even(&areas[i])).collect();
    let boxes = Boxes::new(even.iter().map(|&i| around(areas[i].corners())));
    let near = Vec3::splat(NEAR as f32);
    // What covers one is forgotten before the next: in a stack everybody covers everybody.
    let left = even.par_iter().map(|&i| {
        let light = &areas[i];
        let (lo, hi) = around(light.corners());
        let mut earlier = Vec::new();
        boxes.meeting((lo - near, hi + near), |k| {
            earlier.extend(Some(even[k as usize]).filter(|j| *j < i));
            true
        });
        earlier.sort_unstable();
        remainder(light, earlier.into_iter().map(|j| &areas[j]).filter(|other| overlap(light, other)))
    });
    let left: Vec<Option<Vec<AreaLight>>> = left.collect();
    if left.iter().all(Option::is_none) {
        return areas;
    }
    let mut parts = even.into_iter().zip(left).peekable();
    let mut out = Vec::with_capacity(areas.len());
    for (i, light) in areas.into_iter().enumerate() {
        match parts.next_if(|(k, _)| *k == i) {
            Some((_, Some(parts))) => out.extend(parts),
            _ => out.push(light),
        }
    }
    out
}

/// Of opaque polygons with equal corners each side shines once, that of the first.
fn singled(geometry: &Geometry, areas: Vec<AreaLight>) -> Vec<AreaLight> {
    let place = |light: &AreaLight| {
        let bits = |v: &Vec3| (*v + 0.0).to_array().map(f32::to_bits);
        let mut corners: Vec<[u32; 3]> = light.corners().iter().map(bits).collect();
        corners.sort_unstable();
        corners
    };
    // The front of a place is that of its first polygon.
    let mut taken: HashMap<Vec<[u32; 3]>, (Vec3, Sides)> = HashMap::with_capacity(areas.len());
    let one = |mut light: AreaLight| {
        if !geometry.material(light.triangle).is_opaque() {
            return Some(light);
        }
        let own = Sides::of(&light);
        let (front, sides) = taken.entry(place(&light)).or_insert((light.normal, Sides::default()));
        let same = front.dot(light.normal) > 0.0;
        let left = own.less(sides.seen(same));
        *sides = sides.with(own.seen(same));
        if left == Sides::default() {
            return None;
        }
        if !left.front {
            light.normal = -light.normal;
        }
        light.two_sided = left.front && left.back;
        Some(light)
    };
    areas.into_iter().filter_map(one).collect()
}

/// `earlier` covers a part of a side that shines of `later`.
fn overlap(later: &AreaLight, earlier: &AreaLight) -> bool {
    if later.normal.dot(earlier.normal).abs() < PARALLEL
        || Sides::of(later).less(Sides::under(later, earlier)).is_all(later)
    {
        return false;
    }
    let plane = Plane::of(later);
    // The small one may say little about the plane of a large one.
    let in_plane = plane.holds(earlier) || Plane::of(earlier).holds(later);
    in_plane && !plane.polygon(later).is_apart(&plane.polygon(earlier))
}

/// What the earlier ones leave of a polygon; `None` where that is all of it.
fn remainder<'a>(light: &AreaLight, earlier: impl Iterator<Item = &'a AreaLight>) -> Option<Vec<AreaLight>> {
    let plane = Plane::of(light);
    let whole = plane.polygon(light);
    let least = SLIVER * whole.area();
    let mut pieces = vec![(whole, Sides::of(light))];
    let mut is_whole = true;
    for other in earlier {
        let (cover, covered) = (plane.polygon(other), Sides::under(light, other));
        let mut left = Vec::with_capacity(pieces.len() + 4);
        for (piece, sides) in pieces {
            let rest = sides.less(covered);
            match if rest == sides { None } else { piece.cut(&cover, least) } {
                None => left.push((piece, sides)),
                Some((inside, outside)) => {
                    is_whole = false;
                    left.extend(outside.into_iter().map(|part| (part, sides)));
                    left.extend((rest != Sides::default()).then_some((inside, rest)));
                }
            }
        }
        pieces = left;
        if pieces.is_empty() {
            break;
        }
    }
    if is_whole {
        return None;
    }
    let parts = pieces.iter().flat_map(|(piece, sides)| piece.quads(least).map(move |quad| (quad, *sides)));
    let part = |(number, (quad, sides)): (u64, (Polygon, Sides))| {
        let corners: Vec<Vec3> = quad.0.iter().map(|&p| plane.place(p)).collect();
        let mut part = light.part(&corners, quad.area() as f32, number);
        part.normal = if sides.front { light.normal } else { -light.normal };
        part.two_sided = sides.front && sides.back;
        part
    };
    Some((1..).zip(parts).map(part).collect())
}

/// Sides of a polygon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Sides {
    front: bool,
    back: bool,
}

impl Sides {
    /// Those that shine.
    fn of(light: &AreaLight) -> Self {
        Self { front: true, back: light.two_sided }
    }

    /// Those of `light` that `other`, in its plane, covers.
    fn under(light: &AreaLight, other: &AreaLight) -> Self {
        let same = light.normal.dot(other.normal) > 0.0;
        Self { front: same || other.two_sided, back: !same || other.two_sided }
    }

    fn less(self, other: Self) -> Self {
        Self { front: self.front && !other.front, back: self.back && !other.back }
    }

    fn with(self, other: Self) -> Self {
        Self { front: self.front || other.front, back: self.back || other.back }
    }

    /// They as those of a polygon that looks the same way, or the other way.
    fn seen(self, same: bool) -> Self {
        if same { self } else { Self { front: self.back, back: self.front } }
    }

    fn is_all(self, light: &AreaLight) -> bool {
        self == Self::of(light)
    }
}

/// Coordinates in a polygon's plane, in f64.
struct Plane {
    origin: DVec3,
    x: DVec3,
    y: DVec3,
    normal: DVec3,
}

impl Plane {
    fn of(light: &AreaLight) -> Self {
        let normal = light.normal.as_dvec3().normalize();
        let (x, y) = normal.any_orthonormal_pair();
        Self { origin: light.corners()[0].as_dvec3(), x, y, normal }
    }

    fn holds(&self, light: &AreaLight) -> bool {
        light.corners().iter().all(|c| self.normal.dot(c.as_dvec3() - self.origin).abs() <= NEAR)
    }

    /// Counter-clockwise.
    fn polygon(&self, light: &AreaLight) -> Polygon {
        let flat = |c: &Vec3| {
            let step = c.as_dvec3() - self.origin;
            DVec2::new(self.x.dot(step), self.y.dot(step))
        };
        let mut polygon = Polygon(light.corners().iter().map(flat).collect());
        if polygon.twice() < 0.0 {
            polygon.0.reverse();
        }
        polygon
    }

    fn place(&self, p: DVec2) -> Vec3 {
        (self.origin + self.x * p.x + self.y * p.y).as_vec3()
    }
}

/// A convex polygon, counter-clockwise.
struct Polygon(Vec<DVec2>);

impl Polygon {
    fn edges(&self) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
        self.0.iter().zip(self.0.iter().cycle().skip(1)).map(|(p, q)| (*p, *q))
    }

    /// Twice the signed area.
    fn twice(&self) -> f64 {
        let Some(&origin) = self.0.first() else { return 0.0 };
        self.edges().map(|(p, q)| (p - origin).perp_dot(q - origin)).sum()
    }

    fn area(&self) -> f64 {
        0.5 * self.twice().abs()
    }

    /// There is nothing of it but rounding.
    fn is_sliver(&self, least: f64) -> bool {
        let longest = self.edges().map(|(p, q)| p.distance(q)).fold(0.0, f64::max);
        self.area() <= least.max(NEAR * longest)
    }

    /// Some edge of one of them has nothing of the other one on its inner side.
    fn is_apart(&self, other: &Self) -> bool {
        let parts = |a: &Self, b: &Self| {
            a.edges().any(|(p, q)| {
                let inward = (q - p).perp().normalize_or_zero();
                b.0.iter().all(|&c| inward.dot(c - p) <= NEAR)
            })
        };
        parts(self, other) || parts(other, self)
    }

    /// The parts inside and outside of an edge of another one.
    fn split(&self, (from, to): (DVec2, DVec2)) -> [Self; 2] {
        let side = |p: DVec2| (to - from).perp_dot(p - from);
        let mut parts = [Vec::new(), Vec::new()];
        for (p, q) in self.edges() {
            let (a, b) = (side(p), side(q));
            if a >= 0.0 {
                parts[0].push(p);
            }
            if a <= 0.0 {
                parts[1].push(p);
            }
            if (a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0) {
                let cut = p + (q - p) * (a / (a - b));
                parts.iter_mut().for_each(|part| part.push(cut));
            }
        }
        parts.map(Self)
    }

    /// The part inside of another one, and what is outside; none where nothing is inside.
    fn cut(&self, cover: &Self, least: f64) -> Option<(Self, Vec<Self>)> {
        if self.is_apart(cover) {
            return None;
        }
        let mut inside = Self(self.0.clone());
        let mut outside = Vec::new();
        for edge in cover.edges() {
            let [inner, outer] = inside.split(edge);
            if inner.is_sliver(least) {
                return None;
            }
            if !outer.is_sliver(least) {
                outside.push(outer);
            }
            inside = inner;
        }
        Some((inside, outside))
    }

    /// Without corners that rounding may move to where they bend the other way.
    fn tidy(&self) -> Self {
        let mut corners = self.0.clone();
        let mut i = 0;
        while i < corners.len() && corners.len() > 2 {
            let (before, after) = (corners[(i + corners.len() - 1) % corners.len()], corners[(i + 1) % corners.len()]);
            let along = (after - before).normalize_or_zero();
            if along.perp_dot(corners[i] - before).abs() <= NEAR {
                corners.remove(i);
            } else {
                i += 1;
            }
        }
        Self(corners)
    }

    /// It in pieces of at most four corners.
    fn quads(&self, least: f64) -> impl Iterator<Item = Self> {
        let corners = self.tidy().0;
        let fan = (1..corners.len().saturating_sub(1)).step_by(2).map(move |i| {
            let end = (i + 3).min(corners.len());
            Self(std::iter::once(corners[0]).chain(corners[i..end].iter().copied()).collect())
        });
        fan.filter(move |quad| !quad.is_sliver(least))
    }
}

#[cfg(test)]
mod tests;

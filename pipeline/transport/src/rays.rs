//! Continuous rays: closest hits and coloured transmittance through holes and veils.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use luxel_scene::{Alpha, Material};
use obvhs::{
    BvhBuildParams,
    cwbvh::{CwBvh, builder::build_cwbvh},
    ray::{Ray, RayHit},
};

use crate::{Rgb, geometry::Geometry};

/// How far a ray starts from the surface that it leaves, in frame units: 16 ulp of the largest coordinate, and less
/// than a thousandth of a texel of a 4096² map.
pub const OFFSET: f32 = 4e-3;

/// Barycentric slack at shared edges, so that no ray slips between two triangles.
const EDGE: f32 = 1e-6;

/// Where a ray met a surface.
#[derive(Clone, Copy, Debug)]
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

/// What a triangle does to a ray.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Solid,
    /// Holes by alpha test.
    Masked,
    /// Passes part of the light.
    Veil,
}

impl obvhs::Boundable for Primitive {
    fn aabb(&self) -> obvhs::aabb::Aabb {
        let (a, b, c) = (self.a, self.a + self.ab, self.a + self.ac);
        obvhs::aabb::Aabb::new(a.min(b).min(c).into(), a.max(b).max(c).into())
    }
}

#[derive(Clone, Copy)]
struct Primitive {
    a: Vec3,
    ab: Vec3,
    ac: Vec3,
    triangle: u32,
    kind: Kind,
}

impl Primitive {
    /// Möller–Trumbore: (t, u, v, seen from behind).
    #[inline(always)]
    fn intersect(&self, ray: &Ray, normal_is_flipped: bool) -> Option<(f32, f32, f32, bool)> {
        let d = Vec3::from(ray.direction);
        let p = d.cross(self.ac);
        let det = self.ab.dot(p);
        let inverse = 1.0 / det;
        let s = Vec3::from(ray.origin) - self.a;
        let u = s.dot(p) * inverse;
        let q = s.cross(self.ab);
        let v = d.dot(q) * inverse;
        let t = self.ac.dot(q) * inverse;
        // Written so that a NaN (det = 0) fails.
        let inside = u >= -EDGE && v >= -EDGE && u + v <= 1.0 + EDGE && t >= ray.tmin && t <= ray.tmax;
        inside.then_some((t, u, v, (det < 0.0) != normal_is_flipped))
    }
}

/// A ray-tracing view of a [`Geometry`]: everything that casts and is not unlit.
pub struct Rays<'a> {
    pub geometry: &'a Geometry<'a>,
    bvh: CwBvh,
    /// In the order of the BVH's leaves.
    primitives: Vec<Primitive>,
    /// Every surface is solid: no material is ever looked up along a ray.
    all_solid: bool,
}

fn kind(material: &Material) -> Kind {
    match material.alpha {
        _ if material.transmission > 0.0 => Kind::Veil,
        Alpha::Opaque => Kind::Solid,
        Alpha::Mask(_) => Kind::Masked,
        Alpha::Blend => Kind::Veil,
    }
}

impl<'a> Rays<'a> {
    pub fn new(geometry: &'a Geometry<'a>) -> Self {
        let mut primitives = Vec::new();
        for (i, t) in geometry.triangles.iter().enumerate() {
            let material = geometry.material(i as u32);
            if t.is_degenerate() || material.unlit || !geometry.scene.instances[t.instance as usize].casts {
                continue;
            }
            let [a, b, c] = t.corners;
            primitives.push(Primitive { a, ab: b - a, ac: c - a, triangle: i as u32, kind: kind(material) });
        }
        let mut time = Duration::ZERO;
        let bvh = if primitives.is_empty() {
            CwBvh::default()
        } else {
            build_cwbvh(&primitives, BvhBuildParams::medium_build(), &mut time)
        };
        let primitives: Vec<_> = bvh.primitive_indices.iter().map(|&i| primitives[i as usize]).collect();
        let all_solid = primitives.iter().all(|p| p.kind == Kind::Solid);
        Self { geometry, bvh, primitives, all_solid }
    }

    /// The nearest surface along `direction` (unit) within `(0, max)`, holes skipped, veils included.
    pub fn closest(&self, origin: Vec3, direction: Vec3, max: f32) -> Option<Hit> {
        let mut found = None;
        let mut hit = RayHit::none();
        if self.primitives.is_empty() {
            return None;
        }
        let ray = Ray::new(Vec3A::from(origin), Vec3A::from(direction), 0.0, max);
        self.bvh.ray_traverse(ray, &mut hit, |ray, id| {
            let p = &self.primitives[id];
            match self.test(p, ray) {
                Some(h) if p.kind != Kind::Masked || self.is_there(&h) => {
                    found = Some(h);
                    h.distance
                }
                _ => f32::INFINITY,
            }
        });
        found
    }

    /// The share of light that passes along `direction` (unit) within `(0, max)`: 1 where nothing is in the way.
    pub fn transmittance(&self, origin: Vec3, direction: Vec3, max: f32) -> Rgb {
        if self.primitives.is_empty() {
            return Rgb::ONE;
        }
        let ray = Ray::new(Vec3A::from(origin), Vec3A::from(direction), 0.0, max);
        let mut pass = Rgb::ONE;
        let missed = self.bvh.ray_traverse_miss(ray, |ray, id| {
            let p = &self.primitives[id];
            let Some(h) = self.test(p, ray) else { return f32::INFINITY };
            if p.kind == Kind::Solid {
                return h.distance;
            }
            pass *= self.geometry.surface(h.triangle, h.u, h.v, 0.0).transmittance;
            if pass.max_element() > 1e-4 { f32::INFINITY } else { h.distance }
        });
        if missed { pass } else { Rgb::ZERO }
    }

    /// Every surface is solid, so [`Rays::transmittance`] is 0 or 1.
    pub fn all_solid(&self) -> bool {
        self.all_solid
    }

    fn test(&self, p: &Primitive, ray: &Ray) -> Option<Hit> {
        let normal = self.geometry.triangles[p.triangle as usize].normal;
        let flipped = p.ab.cross(p.ac).dot(normal) < 0.0;
        let (distance, u, v, back) = p.intersect(ray, flipped)?;
        Some(Hit { distance, triangle: p.triangle, u: u.clamp(0.0, 1.0), v: v.clamp(0.0, 1.0), back })
    }

    fn is_there(&self, hit: &Hit) -> bool {
        self.geometry.surface(hit.triangle, hit.u, hit.v, 0.0).coverage > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::build::Builder;

    #[test]
    fn a_box_is_hit_from_inside_on_its_front() {
        let mut b = Builder::new("box");
        let white = b.matte(Vec3::splat(0.5));
        b.cuboid("room", Vec3::ZERO, Vec3::ONE, white, true);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let hit = rays.closest(Vec3::ZERO, Vec3::X, f32::INFINITY).unwrap();
        assert!(!hit.back);
        assert!((hit.distance - 2048.0).abs() < 1e-2, "{}", hit.distance);
        assert_eq!(rays.transmittance(Vec3::ZERO, Vec3::X, 2000.0), Rgb::ONE);
        assert_eq!(rays.transmittance(Vec3::ZERO, Vec3::X, 3000.0), Rgb::ZERO);
    }
}

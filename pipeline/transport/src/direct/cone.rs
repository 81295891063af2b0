//! The shadow of one triangle on the plane of a light, seen from one point.
//!
//! With vᵢ the corners relative to the point p and N the area normal, x = q − p is blocked exactly where
//!
//!   s (vᵢ × vᵢ₊₁) · x ≥ 0  for the three edges,   s N · (x − v₀) ≥ 0,   s = sign(N · v₀).
//!
//! On the target's plane every one of these is affine in (u, v). The edge function of a shared edge is the exact
//! negative in the neighbouring triangle, so no light slips between the two.

use glam::{Vec2, Vec3};

use super::target::{LANES, Plane, Points};

/// An affine function of (u, v).
#[derive(Clone, Copy, Debug)]
struct Affine {
    c: f32,
    u: f32,
    v: f32,
}

impl Affine {
    fn new(normal: Vec3, to: Vec3, plane: &Plane) -> Self {
        Self { c: normal.dot(to), u: normal.dot(plane.a), v: normal.dot(plane.b) }
    }

    #[inline(always)]
    fn at(&self, u: f32, v: f32) -> f32 {
        (self.c + self.u * u) + self.v * v
    }
}

/// The four half-planes that bound a triangle's shadow.
pub struct Cone([Affine; 4]);

impl Cone {
    /// None where the point lies in the triangle's plane, or the shadow surely misses the target's corners.
    #[inline]
    pub fn new(point: Vec3, triangle: [Vec3; 3], plane: &Plane, corners: &[Vec2; 4]) -> Option<Self> {
        let [a, b, c] = triangle.map(|v| v - point);
        let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
        let height = normal.dot(a);
        if height == 0.0 {
            return None;
        }
        let s = 1f32.copysign(height);
        let sides = [
            Affine::new(normal * s, plane.to - a, plane),
            Affine::new(a.cross(b) * s, plane.to, plane),
            Affine::new(b.cross(c) * s, plane.to, plane),
            Affine::new(c.cross(a) * s, plane.to, plane),
        ];
        // NaN from overflow counts as not blocked.
        let reaches = |f: &Affine| corners.iter().any(|c| f.at(c.x, c.y) >= 0.0);
        sides.iter().all(reaches).then_some(Self(sides))
    }

    /// The point (u, v) of the target is hidden.
    #[inline(always)]
    pub fn hides(&self, u: f32, v: f32) -> bool {
        let [d, e, f, g] = &self.0;
        d.at(u, v).min(e.at(u, v)).min(f.at(u, v)).min(g.at(u, v)) >= 0.0
    }

    /// Sets `open` to 0 for every hidden point. Written without branches, for wide registers.
    #[inline]
    pub fn shade(&self, points: &Points, open: &mut [f32; LANES]) {
        if points.count == 1 {
            if self.hides(points.u[0], points.v[0]) {
                open[0] = 0.0;
            }
            return;
        }
        for ((open, &u), &v) in open.iter_mut().zip(&points.u).zip(&points.v) {
            *open = if self.hides(u, v) { 0.0 } else { *open };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{r2, sphere};
    use luxel_scene::build::Builder;

    #[test]
    fn shadows_agree_with_rays() {
        for k in 0..400 {
            let corner = |i: u32| sphere(r2(7 * k + i, Vec2::splat(0.17))) * (0.2 + 0.01 * (k % 90) as f32);
            let triangle = [corner(0), corner(1), corner(2)];
            let mut b = Builder::new("one");
            let m = b.matte(Vec3::ONE);
            b.mesh("t", triangle.to_vec(), vec![[0, 1, 2]], m);
            let scene = b.build();
            let geometry = crate::geometry::Geometry::new(&scene);
            let rays = crate::rays::Rays::new(&geometry);
            let triangle = geometry.triangles[0].corners;
            let point = Vec3::new(300.0, -200.0, -4000.0);
            let plane = Plane { to: Vec3::new(0.0, 0.0, 3500.0) - point, a: Vec3::X * 1500.0, b: Vec3::Y * 1500.0 };
            let square = [Vec2::NEG_ONE, Vec2::new(1.0, -1.0), Vec2::ONE, Vec2::new(-1.0, 1.0)];
            let cone = Cone::new(point, triangle, &plane, &square);
            let mut differ = 0;
            for i in 0..256 {
                let x = r2(i, Vec2::ZERO) * 2.0 - 1.0;
                let to = plane.at(x.x, x.y);
                let hidden = cone.as_ref().is_some_and(|c| c.hides(x.x, x.y));
                let ray = rays.transmittance(point, to.normalize(), to.length()) == Vec3::ZERO;
                differ += u32::from(hidden != ray);
            }
            // A ray may pass on the other side of an edge by rounding.
            assert!(differ <= 1, "{k}: {differ}");
        }
    }
}

//! What a receiver looks at: a planar patch of light, or a disc at a lamp or the sun, with 64 fixed points on it,
//! or 16 of them.
//!
//! A point of the target is `origin + u·a + v·b`, so that everything which is linear in space is affine in (u, v) and
//! can be tested for all 64 points at once. The points are a rank-1 lattice, the same for every receiver: in a
//! penumbra the error is a fine regular step, and the same receiver always gives the same bits.

use glam::{Vec2, Vec3};

use crate::sampling;

/// Points per block.
pub const LANES: usize = 64;

/// Points of a block where light has to be found soon.
pub const FEW: usize = 16;

/// The plane of a target, relative to the point that looks at it.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// From the point to the origin of (u, v).
    pub to: Vec3,
    pub a: Vec3,
    pub b: Vec3,
}

impl Plane {
    /// From the point to (u, v).
    pub fn at(&self, u: f32, v: f32) -> Vec3 {
        self.to + self.a * u + self.b * v
    }
}

/// Points in the plane of a target, and corners of a convex polygon that holds them.
#[derive(Clone, Debug)]
pub struct Points {
    pub u: [f32; LANES],
    pub v: [f32; LANES],
    /// How many of the points count; the first ones.
    pub count: usize,
    pub corners: [Vec2; 4],
}

impl Points {
    /// The origin alone.
    pub fn single() -> Self {
        Self { u: [0.0; LANES], v: [0.0; LANES], count: 1, corners: [Vec2::ZERO; 4] }
    }

    /// Uniform in area over a convex polygon of three or four corners.
    pub fn polygon(corners: &[Vec2], pattern: &Pattern) -> Self {
        let [p, q, r] = [corners[0], corners[1], corners[2]];
        let s = corners.get(3).copied().unwrap_or(r);
        let mut points = Self { corners: [p, q, r, s], count: pattern.0.len(), ..Self::single() };
        let (first, second) = ((q - p).perp_dot(r - p).abs(), (r - p).perp_dot(s - p).abs());
        let share = if first + second > 0.0 { first / (first + second) } else { 1.0 };
        // A parallelogram keeps the lattice whole; other quads are two triangles.
        let parallel = corners.len() == 4 && (p - q + r - s).length_squared() <= 1e-6 * (r - p).length_squared();
        for (i, &x) in pattern.0.iter().enumerate() {
            let at = if parallel {
                p + (q - p) * x.x + (s - p) * x.y
            } else if x.x < share {
                let (u, v) = sampling::triangle(Vec2::new(x.x / share, x.y));
                p + (q - p) * u + (r - p) * v
            } else {
                let (u, v) = sampling::triangle(Vec2::new((x.x - share) / (1.0 - share), x.y));
                p + (r - p) * u + (s - p) * v
            };
            (points.u[i], points.v[i]) = (at.x, at.y);
        }
        points
    }

    /// Directions uniform in solid angle within a cone, as points of the disc that fills the cone; `distance` is the
    /// disc's distance, `cosine` and `sine` belong to the half angle.
    pub fn cone(distance: f32, cosine: f32, sine: f32, pattern: &Pattern) -> Self {
        // 1 − cos, without cancellation for small angles.
        let height = sine * sine / (1.0 + cosine);
        let rim = distance * sine / cosine;
        let mut points = Self { count: pattern.0.len(), ..Self::single() };
        points.corners = [Vec2::new(-rim, -rim), Vec2::new(rim, -rim), Vec2::new(rim, rim), Vec2::new(-rim, rim)];
        for (i, &x) in pattern.0.iter().enumerate() {
            let z = 1.0 - x.x * height;
            let radius = distance * (x.x * height * (1.0 + z)).sqrt() / z;
            let phi = std::f32::consts::TAU * x.y;
            (points.u[i], points.v[i]) = (radius * libm::cosf(phi), radius * libm::sinf(phi));
        }
        points
    }
}

/// Points of the unit square: 64, or [`FEW`].
#[derive(Clone, Debug)]
pub struct Pattern(Vec<Vec2>);

impl Pattern {
    /// The rank-1 lattice (i, 19 i mod 64), shifted for the blocks after the first.
    pub fn new(block: u32) -> Self {
        let shift = if block == 0 { Vec2::ZERO } else { sampling::r2(block, Vec2::ZERO) };
        Self::lattice(LANES, 19, shift)
    }

    /// The rank-1 lattice (i, 3 i mod 16).
    pub fn few() -> Self {
        Self::lattice(FEW, 3, Vec2::ZERO)
    }

    fn lattice(count: usize, factor: usize, shift: Vec2) -> Self {
        let point = |i: usize| {
            let lattice = Vec2::new(i as f32 + 0.5, (factor * i % count) as f32 + 0.5) / count as f32;
            let moved = lattice + shift;
            (moved - moved.floor()).min(Vec2::splat(1.0 - f32::EPSILON))
        };
        Self((0..count).map(point).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_uniform_in_area_and_inside() {
        let quad = [Vec2::ZERO, Vec2::new(4.0, 0.0), Vec2::new(3.0, 1.0), Vec2::new(0.0, 2.0)];
        // Of few points: within a cell of their lattice.
        for (pattern, most) in [(Pattern::new(0), 0.03), (Pattern::few(), 4.0 / 16.0)] {
            let points = Points::polygon(&quad, &pattern);
            let of = |values: &[f32]| values[..points.count].iter().sum::<f32>() / points.count as f32;
            let mean = Vec2::new(of(&points.u), of(&points.v));
            assert!((mean - Vec2::new(23.0 / 15.0, 11.0 / 15.0)).length() < most, "{mean}");
            for i in 0..points.count {
                let x = Vec2::new(points.u[i], points.v[i]);
                assert!((0..4).all(|k| (quad[(k + 1) % 4] - quad[k]).perp_dot(x - quad[k]) >= -1e-5));
            }
        }
    }

    #[test]
    fn cone_points_are_uniform_in_solid_angle() {
        for angle in [1e-3f32, 0.2, 1.2] {
            let (cosine, sine) = (libm::cosf(angle), libm::sinf(angle));
            let points = Points::cone(10.0, cosine, sine, &Pattern::new(0));
            let mean: f32 = (0..LANES)
                .map(|i| 10.0 / (100.0 + points.u[i] * points.u[i] + points.v[i] * points.v[i]).sqrt())
                .sum::<f32>()
                / LANES as f32;
            assert!((mean - 0.5 * (1.0 + cosine)).abs() < 1e-3, "{angle} {mean}");
            let rim = points.corners[2].x;
            assert!((0..LANES).all(|i| points.u[i].hypot(points.v[i]) <= rim * (1.0 + 1e-5)));
        }
    }
}

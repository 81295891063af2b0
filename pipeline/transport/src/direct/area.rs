//! Irradiance from a convex planar emitter.
//!
//!   E = F · Σ wᵢ Lᵢ Vᵢ / Σ wᵢ ,   wᵢ = cos θᵢ cos θ'ᵢ / rᵢ²
//!
//! F is Lambert's formula (exact), the sums run over fixed points of the emitter: a ratio estimator, exact wherever
//! everything is visible or nothing is. An emitter that is larger than its distance is split, each part with its own
//! F and its own points. The visible polygon is lifted off the emitter by the ray offset, so that the emitter and
//! whatever lies in its plane never hide it.

use glam::{DVec3, Vec2, Vec3};

use super::{
    lambert,
    shaft::{HalfSpace, Outline},
    target::{LANES, Pattern, Plane, Points},
    tiles::{Tile, eye},
    visibility::{Between, Lanes, Screen, Sight, View},
};
use crate::{Rgb, gather::Receiver, lights::AreaLight, rays::OFFSET, sampling};

/// How often an emitter is quartered at most.
const DEPTH: u32 = 4;

/// An area light prepared for gathering.
pub struct AreaTarget<'a> {
    light: &'a AreaLight,
    center: Vec3,
    a: Vec3,
    b: Vec3,
    /// Corners in the plane of a and b.
    corners: [Vec2; 4],
    /// Points over the whole light, block by block.
    points: Vec<Points>,
    /// From (u, v) of the plane to barycentric coordinates of the triangle, where the radiance varies.
    barycentric: [Vec2; 2],
}

/// What one receiver has of a part of the light.
struct Part {
    irradiance: Rgb,
    /// Every point was seen.
    free: bool,
    rays: u32,
}

/// The light as one receiver sees it.
struct Outlook<'b> {
    receiver: &'b Receiver,
    sight: &'b Sight<'b>,
    patterns: &'b [Pattern],
    eye: Vec3,
    /// Plane of the visible polygon, relative to the eye.
    plane: Plane,
    /// Plane of the light itself, relative to the receiver.
    true_plane: Plane,
    between: Between<'b>,
}

impl<'a> AreaTarget<'a> {
    pub fn new(light: &'a AreaLight, patterns: &[Pattern]) -> Self {
        let center = light.center();
        let basis = sampling::basis(light.normal);
        let (a, b) = (basis.x_axis, basis.y_axis);
        let flat = |p: Vec3| Vec2::new(a.dot(p - center), b.dot(p - center));
        let mut corners = [Vec2::ZERO; 4];
        for (slot, &c) in corners.iter_mut().zip(light.corners()) {
            *slot = flat(c);
        }
        let count = light.corners().len();
        let points = patterns.iter().map(|p| Points::polygon(&corners[..count], p)).collect();
        let (e, f) = (corners[1] - corners[0], corners[2] - corners[0]);
        let det = e.perp_dot(f);
        let barycentric = [Vec2::new(f.y, -f.x) / det, Vec2::new(-e.y, e.x) / det];
        Self { light, center, a, b, corners, points, barycentric }
    }

    /// No receiver of the tile can see the light, whatever is between.
    pub fn is_behind(&self, tile: &Tile) -> bool {
        let n = self.light.normal;
        let behind = !self.light.two_sided && tile.bounds.support(n) <= n.dot(self.center);
        behind || tile.plane.is_some_and(|(n, d)| self.light.corners().iter().all(|&c| n.dot(c) <= d - 2.0 * OFFSET))
    }

    /// Outline of what is looked at, lifted off the light towards the tile where only one side can be meant, and the
    /// half-space in front of it.
    pub fn outline(&self, tile: &Tile) -> (Outline, Option<HalfSpace>) {
        let n = self.light.normal;
        let height = n.dot(self.center);
        let (above, below) = (tile.bounds.support(n) > height, -tile.bounds.support(-n) < height);
        if self.light.two_sided && above && below {
            let mut both = [Vec3::ZERO; 8];
            let count = self.light.corners().len();
            for (i, &c) in self.light.corners().iter().enumerate() {
                (both[i], both[count + i]) = (c + n * OFFSET, c - n * OFFSET);
            }
            return (Outline::polygon(&both[..2 * count]), None);
        }
        let n = if self.light.two_sided && below { -n } else { n };
        let lifted = self.light.corners().iter().map(|&c| c + n * OFFSET);
        let mut corners = [Vec3::ZERO; 4];
        let count = self.light.corners().len();
        corners.iter_mut().zip(lifted).for_each(|(slot, c)| *slot = c);
        // A quarter of the offset keeps what lies in the light's own plane out, rounding included.
        let space = HalfSpace { n, d: n.dot(self.center) + 0.25 * OFFSET };
        (Outline::polygon(&corners[..count]), Some(space))
    }

    /// Irradiance at a receiver, and rays spent.
    pub fn irradiance(&self, r: &Receiver, sight: &Sight, patterns: &[Pattern], between: Between) -> (Rgb, u32) {
        let light = self.light;
        let height = light.normal.dot(r.position - self.center);
        // Whatever lies in the light's own plane, the light's own surface included, gets nothing from it.
        if height.abs() < 0.5 * OFFSET || (height < 0.0 && !light.two_sided) {
            return (Rgb::ZERO, 0);
        }
        let corners = light.corners();
        let f = lambert::irradiance(r, corners, light.normal, light.area);
        if f <= 0.0 {
            return (Rgb::ZERO, 0);
        }
        // Nothing fits between a light and a receiver that almost touch.
        let between = if height.abs() <= 2.0 * OFFSET { Between::Nothing } else { between };
        if matches!(between, Between::Nothing) && light.table.is_none() {
            return (light.radiance * f as f32, 0);
        }
        let eye = eye(r);
        let lift = light.normal * OFFSET.copysign(height);
        let view = Outlook {
            receiver: r,
            sight,
            patterns,
            eye,
            plane: Plane { to: self.center + lift - eye, a: self.a, b: self.b },
            true_plane: Plane { to: self.center - r.position, a: self.a, b: self.b },
            between,
        };
        let whole = self.part(&view, &self.corners[..corners.len()], f, DEPTH);
        debug_assert!(whole.irradiance.is_finite() && whole.irradiance.min_element() >= 0.0);
        (whole.irradiance, whole.rays)
    }

    /// Light from a part of the emitter; `f` is its unoccluded irradiance at unit radiance.
    fn part(&self, view: &Outlook, corners: &[Vec2], f: f64, depth: u32) -> Part {
        let uniform = self.light.table.is_none();
        if depth > 0 && self.is_near(view, corners) {
            let mut quad = [corners[corners.len() - 1]; 4];
            quad[..corners.len()].copy_from_slice(corners);
            return match view.sight.screen(view.eye, &view.plane, &quad, view.between) {
                Screen::Covers => Part { irradiance: Rgb::ZERO, free: false, rays: 0 },
                Screen::Misses if uniform => Part { irradiance: self.light.radiance * f as f32, free: true, rays: 0 },
                _ => self.quarters(view, corners, f, depth),
            };
        }
        let mut lanes = Lanes { open: [1.0; LANES], clear: [1.0; LANES] };
        let (mut sum, mut weights, mut rays, mut free) = (DVec3::ZERO, 0.0, 0, true);
        for (block, pattern) in view.patterns.iter().enumerate() {
            let own;
            let points = if depth == DEPTH {
                &self.points[block]
            } else {
                own = Points::polygon(corners, pattern);
                &own
            };
            free &= view.sight.look(view.eye, &view.plane, points, view.between, &mut lanes) == View::Free;
            if free && uniform && block + 1 == view.patterns.len() {
                break;
            }
            for i in 0..points.count {
                let w = weight(view, points, i);
                weights += f64::from(w);
                let (pass, cost) = view.sight.transmittance(view.eye, &view.plane, points, &lanes, i);
                rays += cost;
                sum += (self.radiance(points.u[i], points.v[i]) * pass * w).as_dvec3();
            }
        }
        let irradiance = match free && uniform {
            true => self.light.radiance * f as f32,
            false if weights > 0.0 => (sum * (f / weights)).as_vec3(),
            false => Rgb::ZERO,
        };
        Part { irradiance, free, rays }
    }

    fn quarters(&self, view: &Outlook, corners: &[Vec2], f: f64, depth: u32) -> Part {
        let mut sum = Part { irradiance: Rgb::ZERO, free: true, rays: 0 };
        for part in quartered(corners) {
            let part = &part[..corners.len()];
            let mut space = [Vec3::ZERO; 4];
            for (slot, c) in space.iter_mut().zip(part) {
                *slot = self.center + self.a * c.x + self.b * c.y;
            }
            let normal = self.light.normal;
            let f = lambert::irradiance(view.receiver, &space[..corners.len()], normal, area(part));
            if f > 0.0 {
                let part = self.part(view, part, f, depth - 1);
                sum.irradiance += part.irradiance;
                sum.free &= part.free;
                sum.rays += part.rays;
            }
        }
        // Whatever the way to find out that nothing is hidden, the value is the same.
        if sum.free && self.light.table.is_none() {
            sum.irradiance = self.light.radiance * f as f32;
        }
        sum
    }

    /// The part is larger than its distance.
    fn is_near(&self, view: &Outlook, corners: &[Vec2]) -> bool {
        let center = corners.iter().sum::<Vec2>() / corners.len() as f32;
        let radius = corners.iter().map(|&c| (c - center).length_squared()).fold(0.0, f32::max);
        4.0 * radius > view.true_plane.at(center.x, center.y).length_squared()
    }

    fn radiance(&self, u: f32, v: f32) -> Rgb {
        match &self.light.table {
            None => self.light.radiance,
            Some(table) => {
                let x = Vec2::new(u, v) - self.corners[0];
                table.at(self.barycentric[0].dot(x), self.barycentric[1].dot(x))
            }
        }
    }
}

/// cos θ / r³, which is cos θ cos θ' / r² up to the receiver's height above the light's plane.
#[inline(always)]
fn weight(view: &Outlook, points: &Points, at: usize) -> f32 {
    let d = view.true_plane.at(points.u[at], points.v[at]);
    let squared = d.length_squared();
    let above = view.receiver.normal.dot(d) > 0.0 && squared > 0.0;
    if above { view.receiver.shading_normal.dot(d).max(0.0) / (squared * squared) } else { 0.0 }
}

/// Area of a polygon that runs either way round.
fn area(p: &[Vec2]) -> f32 {
    0.5 * (1..p.len() - 1).map(|i| (p[i] - p[0]).perp_dot(p[i + 1] - p[0])).sum::<f32>().abs()
}

/// Four parts of a triangle or convex quad, by the midpoints of its edges.
fn quartered(corners: &[Vec2]) -> [[Vec2; 4]; 4] {
    if let [a, b, c, d] = *corners {
        let (ab, bc, cd, da) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + d), 0.5 * (d + a));
        let m = 0.5 * (ab + cd);
        return [[a, ab, m, da], [ab, b, bc, m], [m, bc, c, cd], [da, m, cd, d]];
    }
    let [a, b, c] = [corners[0], corners[1], corners[2]];
    let (ab, bc, ca) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a));
    [[a, ab, ca, ca], [ab, b, bc, bc], [ca, bc, c, c], [ab, bc, ca, ca]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarters_cover_the_whole() {
        let quad = [Vec2::ZERO, Vec2::new(4.0, 0.0), Vec2::new(3.0, 1.0), Vec2::new(0.0, 2.0)];
        for corners in [&quad[..], &quad[..3]] {
            let parts: f32 = quartered(corners).iter().map(|p| area(&p[..corners.len()])).sum();
            assert!((parts - area(corners)).abs() < 1e-5);
        }
    }
}

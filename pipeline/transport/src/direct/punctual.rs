//! Irradiance from lamps and suns: a point, a direction, or the disc that a luminous sphere shows.
//!
//!   lamp  E = I cos θ / d²   exact for a sphere of any radius that lies above the horizon
//!   sun   E = E⊥ cos θ       exact for a disc of uniform radiance above the horizon
//!
//! The visible share is the cosine-weighted mean over 64 directions, uniform in the solid angle of the disc.

use glam::Vec3;

use super::{
    shaft::{Bounds, Outline},
    target::{LANES, Pattern, Plane, Points},
    tiles::{Tile, eye},
    visibility::{Between, Lanes, Sight, View},
};
use crate::{
    Rgb,
    gather::Receiver,
    lights::{BRIGHTEST, Lamp, SunLight},
    rays::OFFSET,
    sampling,
};

/// A distance beyond every scene, frame units.
const FAR: f32 = 16384.0;

/// Half angles below this [rad] are points.
const POINT: f32 = 1e-6;

/// A disc of light as one receiver sees it.
struct Disc {
    /// Unit direction to its centre, and the centre's distance.
    direction: Vec3,
    distance: f32,
    /// Receiver's cosine to the light's centre.
    exact: f32,
    cosine: f32,
    sine: f32,
    /// Irradiance of a surface that faces the whole disc.
    facing: Rgb,
}

/// Irradiance of a lamp at a receiver, and rays spent.
pub fn lamp(lamp: &Lamp, r: &Receiver, sight: &Sight, patterns: &[Pattern], between: Between) -> (Rgb, u32) {
    let facing = lamp.intensity_towards(r.position) / lamp.squared_distance(r.position);
    let facing = facing.min(Rgb::splat(BRIGHTEST));
    let to = lamp.position - eye(r);
    let distance = to.length();
    if facing == Rgb::ZERO || distance <= OFFSET {
        return (Rgb::ZERO, 0);
    }
    // Inside the sphere the disc fills the hemisphere, as near as a plane can.
    let sine = (lamp.radius / distance).min(0.999);
    let cosine = (1.0 - sine * sine).sqrt();
    // The disc that fills the cone lies in front of the sphere's centre, where its rim touches the sphere.
    let near = distance * cosine * cosine;
    // A bare lamp on a wall, or closer to it than a ray starts from one, is not hidden by that wall.
    let near = if lamp.radius == 0.0 { (near - 2.0 * OFFSET).max(0.5 * near) } else { near };
    let exact = r.cosine((lamp.position - r.position).normalize_or_zero());
    let disc = Disc { direction: to / distance, distance: near, exact, cosine, sine, facing };
    disc.irradiance(r, sight, patterns, between)
}

/// Irradiance of a sun at a receiver, and rays spent.
pub fn sun(sun: &SunLight, r: &Receiver, sight: &Sight, patterns: &[Pattern], between: Between) -> (Rgb, u32) {
    let (sine, cosine) = (libm::sinf(sun.half_angle), libm::cosf(sun.half_angle));
    let disc = Disc {
        direction: sun.direction,
        distance: FAR,
        exact: r.cosine(sun.direction),
        cosine,
        sine,
        facing: sun.illuminance,
    };
    disc.irradiance(r, sight, patterns, between)
}

impl Disc {
    fn irradiance(&self, r: &Receiver, sight: &Sight, patterns: &[Pattern], between: Between) -> (Rgb, u32) {
        let horizon = r.normal.dot(self.direction).min(r.shading_normal.dot(self.direction));
        if horizon <= -self.sine {
            return (Rgb::ZERO, 0);
        }
        if self.sine < POINT {
            return self.point(r, sight, between);
        }
        let basis = sampling::basis(self.direction);
        let plane = Plane { to: self.direction * self.distance, a: basis.x_axis, b: basis.y_axis };
        let whole = horizon >= self.sine;
        let exact = self.exact;
        if whole && matches!(between, Between::Nothing) {
            return (self.facing * exact, 0);
        }
        let mut lanes = Lanes { open: [1.0; LANES], clear: [1.0; LANES] };
        let (mut sum, mut weights, mut count, mut rays) = (Rgb::ZERO, 0.0, 0.0, 0);
        let mut free = true;
        for pattern in patterns {
            let points = Points::cone(self.distance, self.cosine, self.sine, pattern);
            free &= sight.look(eye(r), &plane, &points, between, &mut lanes) == View::Free;
            for i in 0..points.count {
                let cosine = r.cosine(plane.at(points.u[i], points.v[i]).normalize_or_zero());
                let (pass, cost) = sight.transmittance(eye(r), &plane, &points, &lanes, i);
                sum += pass * cosine;
                weights += cosine;
                count += 1.0;
                rays += cost;
            }
        }
        let e = if whole && free {
            self.facing * exact
        } else if whole && weights > 0.0 {
            self.facing * sum * (exact / weights)
        } else {
            // Radiance times solid angle times mean cosine: E⊥ = π L sin².
            self.facing * sum * (2.0 * (1.0 - self.cosine) / (self.sine * self.sine * count))
        };
        (e, rays)
    }

    fn point(&self, r: &Receiver, sight: &Sight, between: Between) -> (Rgb, u32) {
        let e = self.facing * self.exact;
        if e == Rgb::ZERO || matches!(between, Between::Nothing) {
            return (e, 0);
        }
        let plane = Plane { to: self.direction * self.distance, a: Vec3::ZERO, b: Vec3::ZERO };
        let points = Points::single();
        let mut lanes = Lanes { open: [1.0; LANES], clear: [1.0; LANES] };
        match sight.look(eye(r), &plane, &points, between, &mut lanes) {
            View::Free => (e, 0),
            View::Dark => (Rgb::ZERO, 0),
            View::Partial => {
                let (pass, rays) = sight.transmittance(eye(r), &plane, &points, &lanes, 0);
                (e * pass, rays)
            }
        }
    }
}

/// What a tile of receivers sees of a lamp.
pub fn lamp_outline(lamp: &Lamp) -> Outline {
    let r = Vec3::splat(lamp.radius);
    if lamp.radius == 0.0 {
        return Outline::polygon(&[lamp.position]);
    }
    Outline::cuboid(Bounds { lo: lamp.position - r, hi: lamp.position + r })
}

/// No receiver of the tile can be lit by the lamp: out of range, out of the cone, or below every horizon.
pub fn is_lamp_out(lamp: &Lamp, tile: &Tile) -> bool {
    let near = lamp.position.clamp(tile.bounds.lo, tile.bounds.hi);
    // The receiver itself is up to an offset away from the point that it looks from.
    let slack = 2.0 * OFFSET;
    let far = lamp.range.is_some_and(|range| near.distance(lamp.position) > range + slack);
    let out = lamp.spot.is_some_and(|spot| {
        let reach = (tile.bounds.hi - tile.bounds.lo).length() * 0.5 + slack;
        let to = tile.bounds.center() - lamp.position;
        let distance = to.length();
        // The cone about the axis, widened by the sphere around the tile.
        distance > reach && {
            let widen = reach / distance;
            let c = spot.cos_outer as f32;
            let s = (1.0 - c * c).max(0.0).sqrt();
            let (cw, sw) = ((1.0 - widen * widen).sqrt(), widen);
            // cos(outer + widening), which must stay below π for the comparison to hold.
            let limit = if cw > -c { c * cw - s * sw } else { -1.0 };
            spot.direction.as_vec3().dot(to) < distance * limit - 1e-4 * distance
        }
    });
    far || out || tile.plane.is_some_and(|(n, d)| n.dot(lamp.position) + lamp.radius <= d - slack)
}

/// What a tile of receivers sees of a sun: the tile itself, far away and wider.
pub fn sun_outline(sun: &SunLight, tile: &Tile) -> Outline {
    let shift = sun.direction * FAR;
    let wider = Vec3::splat(FAR * libm::tanf(sun.half_angle));
    Outline::cuboid(Bounds { lo: tile.bounds.lo + shift - wider, hi: tile.bounds.hi + shift + wider })
}

pub fn is_sun_out(sun: &SunLight, tile: &Tile) -> bool {
    tile.plane.is_some_and(|(n, _)| n.dot(sun.direction) <= -libm::sinf(sun.half_angle))
}

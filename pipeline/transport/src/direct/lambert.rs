//! Lambert's formula: irradiance of a polygon of unit radiance, in closed form.
//!
//!   E = ½ | Σ θᵢ γᵢ · n |       θᵢ angle that edge i subtends, γᵢ unit normal of the plane through receiver and edge
//!
//! (Lambert 1760, Photometria; Baum, Rushmeier & Winget 1989.) With unit vectors a, b to the ends of an edge,
//! θγ = (θ / sin θ)(a × b), which needs no normalisation of a vanishing vector. The polygon is first clipped to what
//! lies above the geometric horizon and above the plane of the shading normal. Evaluated in f64: the sum cancels to
//! θ² of terms of size θ.

use glam::{DVec3, Vec3};

use crate::gather::Receiver;

/// Corners of a quad after two clips: at most half of them again each time, even where rounding has bent it.
const MAX_CORNERS: usize = 12;

/// Below this ratio of diameter to distance Gauss points do: their relative error is about a tenth of its fourth power
/// for parallelograms, measured in the tests, and much less than a texel's worth of light.
const FAR: f32 = 0.2;

/// The same for triangles and other quads, which are taken as a point: relative error about the square.
const POINT_LIKE: f32 = 0.01;

/// Irradiance [lux] of a convex polygon (at most four corners) of radiance 1 cd/m² that faces the receiver, without
/// occlusion. 0 where nothing of it lies above the horizon.
pub fn irradiance(receiver: &Receiver, corners: &[Vec3], normal: Vec3, area: f32) -> f64 {
    let p = receiver.position;
    let to = corners[0] - p;
    let spread = corners.iter().map(|&c| (c - corners[0]).length_squared()).fold(0.0, f32::max);
    let squared = to.length_squared();
    if spread < FAR * FAR * squared {
        if let [a, b, c, d] = *corners
            && let Some(e) = gauss(receiver, [a, b, c, d], normal, area, spread)
        {
            return e;
        }
        if spread < POINT_LIKE * POINT_LIKE * squared {
            return point_like(receiver, corners, normal, area);
        }
    }
    let mut polygon = [DVec3::ZERO; MAX_CORNERS];
    let mut count = corners.len();
    for (slot, &c) in polygon.iter_mut().zip(corners) {
        *slot = c.as_dvec3() - p.as_dvec3();
    }
    let geometric = receiver.normal.as_dvec3();
    let shading = receiver.shading_normal.as_dvec3();
    count = clip(&mut polygon, count, geometric);
    if shading != geometric {
        count = clip(&mut polygon, count, shading);
    }
    edges(&mut polygon[..count], shading)
}

/// The product rule of two Gauss points along each side of a parallelogram that lies wholly above both horizons.
fn gauss(receiver: &Receiver, [a, b, c, d]: [Vec3; 4], normal: Vec3, area: f32, spread: f32) -> Option<f64> {
    /// 1/(2√3): the Gauss points' distance from the middle of a side, in sides.
    const POINT: f32 = 0.288_675_13;
    let center = 0.5 * (a + c) - receiver.position;
    let height = receiver.normal.dot(center).min(receiver.shading_normal.dot(center));
    let parallel = (a - b + c - d).length_squared() <= 1e-8 * spread;
    if !parallel || height <= 0.0 || height * height <= spread {
        return None;
    }
    let (s, t) = ((b - a) * POINT, (d - a) * POINT);
    let mut sum = 0.0;
    for point in [center - s - t, center + s - t, center - s + t, center + s + t] {
        let squared = point.length_squared();
        sum += receiver.shading_normal.dot(point) / (squared * squared);
    }
    Some(f64::from(0.25 * sum * normal.dot(center).abs() * area))
}

/// The far limit A cos θ cos θ' / r² at the mean of the corners, exact to the square of diameter over distance.
fn point_like(receiver: &Receiver, corners: &[Vec3], normal: Vec3, area: f32) -> f64 {
    let center = corners.iter().sum::<Vec3>() / corners.len() as f32;
    let to = center - receiver.position;
    let squared = to.length_squared();
    let direction = to / squared.sqrt();
    f64::from(receiver.cosine(direction) * normal.dot(direction).abs() * area / squared)
}

/// Sutherland–Hodgman against the half-space n·x > 0, in place; returns the new number of corners.
fn clip(polygon: &mut [DVec3; MAX_CORNERS], count: usize, n: DVec3) -> usize {
    let above = polygon[..count].iter().filter(|v| n.dot(**v) > 0.0).count();
    if above == count || above == 0 {
        return above;
    }
    let source = *polygon;
    let mut out = 0;
    for i in 0..count {
        let (a, b) = (source[i], source[(i + 1) % count]);
        let (ha, hb) = (n.dot(a), n.dot(b));
        if ha > 0.0 {
            polygon[out] = a;
            out += 1;
        }
        if (ha > 0.0) != (hb > 0.0) {
            polygon[out] = a + (b - a) * (ha / (ha - hb));
            out += 1;
        }
    }
    out
}

/// ½ |Σ θγ·n| over the edges of a polygon of vectors from the receiver, which are normalised in place.
fn edges(polygon: &mut [DVec3], n: DVec3) -> f64 {
    if polygon.len() < 3 {
        return 0.0;
    }
    for v in polygon.iter_mut() {
        // A corner at the receiver itself subtends nothing; any direction serves.
        *v = v.try_normalize().unwrap_or(n);
    }
    let mut sum = 0.0;
    for i in 0..polygon.len() {
        let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
        let cross = a.cross(b);
        sum += angle_over_sine(cross.length_squared(), a.dot(b)) * cross.dot(n);
    }
    0.5 * sum.abs()
}

/// θ / sin θ from sin² θ and cos θ; 0 for opposite vectors, whose plane is undefined.
fn angle_over_sine(squared_sine: f64, cosine: f64) -> f64 {
    if cosine > 0.0 && squared_sine < 0.04 {
        // asin(s)/s as a series; the first term left out is below 2e-11.
        let x = squared_sine;
        return 1.0
            + x * (1.0 / 6.0
                + x * (3.0 / 40.0
                    + x * (15.0 / 336.0 + x * (105.0 / 3456.0 + x * (945.0 / 42240.0 + x * (10395.0 / 599_040.0))))));
    }
    let sine = squared_sine.sqrt();
    if sine < 1e-12 { 0.0 } else { libm::atan2(sine, cosine) / sine }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    pub(crate) fn up(position: Vec3) -> Receiver {
        Receiver { position, normal: Vec3::Z, shading_normal: Vec3::Z, footprint: 1.0, seed: 0 }
    }

    /// Irradiance of a rectangle [x0,x1]×[y0,y1] at height h over a horizontal receiver at the origin, unit radiance:
    /// sums of the corner form factor (Howell C-… differential element to parallel rectangle).
    fn parallel_rectangle(x0: f64, x1: f64, y0: f64, y1: f64, h: f64) -> f64 {
        let corner = |a: f64, b: f64| {
            let (a, b) = (a / h, b / h);
            let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
            0.5 * (a / p * libm::atan(b / p) + b / q * libm::atan(a / q))
        };
        corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)
    }

    fn rectangle(x0: f32, x1: f32, y0: f32, y1: f32, h: f32) -> [Vec3; 4] {
        [Vec3::new(x0, y0, h), Vec3::new(x0, y1, h), Vec3::new(x1, y1, h), Vec3::new(x1, y0, h)]
    }

    #[test]
    fn a_parallel_rectangle_agrees_with_its_form_factor_near_and_far() {
        for h in [0.01, 0.3, 1.0, 7.0, 60.0, 900.0, 4000.0] {
            for (x0, x1, y0, y1) in [(-1.0, 1.0, -2.0, 2.0), (0.5, 3.0, -1.0, 0.2), (-9.0, -8.0, 4.0, 4.5)] {
                let corners = rectangle(x0, x1, y0, y1, h);
                let e = irradiance(&up(Vec3::ZERO), &corners, Vec3::NEG_Z, (x1 - x0) * (y1 - y0));
                let [x0, x1, y0, y1, h] = [x0, x1, y0, y1, h].map(f64::from);
                let exact = parallel_rectangle(x0, x1, y0, y1, h);
                assert!((e - exact).abs() <= 1e-4 * exact + 1e-12, "{h} {x0}: {e} {exact}");
            }
        }
    }

    #[test]
    fn the_horizon_cuts_a_wall_in_half() {
        let wall = |z0: f32| [(-1.0, z0), (1.0, z0), (1.0, 2.0), (-1.0, 2.0)].map(|(y, z)| Vec3::new(1.0, y, z));
        let whole = irradiance(&up(Vec3::ZERO), &wall(-2.0), Vec3::NEG_X, 8.0);
        let above = irradiance(&up(Vec3::ZERO), &wall(0.0), Vec3::NEG_X, 4.0);
        assert!((whole - above).abs() < 1e-9 && above > 0.1);
        let buried = wall(-2.0).map(|c| c - Vec3::Z * 4.0);
        assert_eq!(irradiance(&up(Vec3::ZERO), &buried, Vec3::NEG_X, 8.0), 0.0);
    }

    #[test]
    fn a_polygon_around_the_whole_sky_gives_pi_and_contact_stays_finite() {
        let huge = rectangle(-1e6, 1e6, -1e6, 1e6, 1.0);
        let e = irradiance(&up(Vec3::ZERO), &huge, Vec3::NEG_Z, 4e12);
        assert!((e - PI).abs() < 1e-5, "{e}");
        for position in [Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), Vec3::new(0.0, 1.0, 0.0), Vec3::new(5.0, 0.0, 0.0)] {
            let e = irradiance(&up(position), &rectangle(-1.0, 1.0, -1.0, 1.0, 0.0), Vec3::NEG_Z, 4.0);
            assert!(e.is_finite() && (0.0..=PI).contains(&e), "{position} {e}");
        }
    }

    #[test]
    fn a_bent_shading_normal_turns_the_cosine_but_not_the_horizon() {
        let mut receiver = up(Vec3::ZERO);
        receiver.shading_normal = Vec3::new(0.6, 0.0, 0.8);
        // Far and small: E = cos θ A / r² with the light straight up.
        let corners = rectangle(-0.5, 0.5, -0.5, 0.5, 20.0);
        let e = irradiance(&receiver, &corners, Vec3::NEG_Z, 1.0);
        assert!((e - 0.8 / 400.0).abs() < 1e-3 / 400.0, "{e}");
        let below = corners.map(|c| Vec3::new(20.0, c.x, -0.6 + c.y));
        assert_eq!(irradiance(&receiver, &below.map(|c| c - Vec3::Z), Vec3::NEG_X, 1.0), 0.0);
    }

    #[test]
    fn the_series_meets_the_arc_tangent() {
        for s in [0.19999f64, 0.200001] {
            let c = (1.0 - s * s).sqrt();
            let exact = libm::asin(s) / s;
            assert!((angle_over_sine(s * s, c) - exact).abs() < 1e-10);
        }
    }
}

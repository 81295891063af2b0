//! Giving a flattened chart its true size and the best angle.
//!
//! A chart comes as UVs in any unit. With P the object-space point, the two stretches of the map are
//! s_u = √(Σ A |∂P/∂u|² / Σ A) and s_v alike, A the triangle areas; the UVs are multiplied by them and
//! then scaled so that UV area equals surface area. This also undoes an unwrapper's own snapping to texels. At last
//! the chart is turned so that its smallest bounding rectangle is axis-aligned (a side of that rectangle always
//! lies along an edge of the convex hull; Freeman & Shapira 1975).

use glam::{DVec2, DVec3};

use crate::mesh::Solid;
use crate::overlap;

/// A triangle whose share of the chart's UV area is so much smaller than its share of the surface is starved.
const STARVED: f64 = 0.02;

/// Scales, turns and checks the UVs that an unwrapper made of `triangles`.
///
/// # Errors
/// What is wrong with the chart.
pub(crate) fn checked(solid: &Solid, triangles: &[u32], uvs: Vec<[DVec2; 3]>) -> Result<Vec<[DVec2; 3]>, &'static str> {
    if !uvs.iter().flatten().all(|p| p.is_finite()) {
        return Err("the chart has coordinates that are not finite");
    }
    let uvs = fitted(solid, triangles, uvs).ok_or("the chart has no area")?;
    let turned = uvs.iter().filter(|t| overlap::signed_area(t) < 0.0).count();
    // A mirrored chart is as good as any, but all its triangles have to agree.
    if turned != 0 && turned != uvs.len() {
        return Err("the chart folds over");
    }
    let starved = |(t, uv): (&u32, &[DVec2; 3])| overlap::signed_area(uv).abs() < STARVED * solid.areas[*t as usize];
    if triangles.iter().zip(&uvs).any(starved) {
        return Err("the chart squeezes triangles to nothing");
    }
    match overlap::check(&uvs) {
        Ok(()) => Ok(upright(uvs)),
        Err(_) => Err("the chart overlaps itself"),
    }
}

/// World or object area and stretches of a map from UV to space.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Stretch {
    /// Area in space.
    pub area: f64,
    pub uv_area: f64,
    energy: DVec2,
}

impl Stretch {
    pub fn add(&mut self, uv: &[DVec2; 3], points: &[DVec3; 3]) {
        let (e, f) = (points[1] - points[0], points[2] - points[0]);
        let area = 0.5 * e.cross(f).length();
        let (p, q) = (uv[1] - uv[0], uv[2] - uv[0]);
        let twice = p.perp_dot(q);
        if !area.is_finite() || area <= 0.0 {
            return;
        }
        self.area += area;
        self.uv_area += 0.5 * twice.abs();
        let du = (e * q.y - f * p.y) / twice;
        let dv = (f * p.x - e * q.x) / twice;
        let energy = DVec2::new(du.length_squared(), dv.length_squared());
        // A triangle without UV area says nothing about stretch.
        if energy.is_finite() {
            self.energy += area * energy;
        }
    }

    /// Factors on u and v that make UV lengths true on average and the UV area exact. None without area.
    pub fn factors(&self) -> Option<DVec2> {
        let s = DVec2::new((self.energy.x / self.area).sqrt(), (self.energy.y / self.area).sqrt());
        let exact = (self.area / (self.uv_area * s.x * s.y)).sqrt();
        let s = s * exact;
        (s.is_finite() && s.min_element() > 0.0).then_some(s)
    }
}

fn fitted(solid: &Solid, triangles: &[u32], mut uvs: Vec<[DVec2; 3]>) -> Option<Vec<[DVec2; 3]>> {
    let mut stretch = Stretch::default();
    for (&t, uv) in triangles.iter().zip(&uvs) {
        stretch.add(uv, &solid.corners(t));
    }
    let factors = stretch.factors()?;
    uvs.iter_mut().flatten().for_each(|p| *p *= factors);
    Some(uvs)
}

/// Turns the chart onto its smallest bounding rectangle, longer side along u, lower corner at the origin.
pub(crate) fn upright(mut uvs: Vec<[DVec2; 3]>) -> Vec<[DVec2; 3]> {
    let axis = best_axis(&hull(uvs.iter().flatten().copied().collect()));
    let turned = |p: DVec2| DVec2::new(axis.dot(p), axis.perp_dot(p));
    uvs.iter_mut().flatten().for_each(|p| *p = turned(*p));
    let lo = uvs.iter().flatten().fold(DVec2::INFINITY, |lo, p| lo.min(*p));
    let size = uvs.iter().flatten().fold(DVec2::ZERO, |hi, p| hi.max(*p - lo));
    for p in uvs.iter_mut().flatten() {
        *p -= lo;
        if size.y > size.x {
            *p = DVec2::new(p.y, size.x - p.x);
        }
    }
    uvs
}

/// Unit direction of the hull edge whose bounding rectangle is smallest; the x axis where there is none.
fn best_axis(hull: &[DVec2]) -> DVec2 {
    // Round charts have long hulls, and any angle suits them: a few edges will do.
    let step = hull.len().div_ceil(128).max(1);
    let mut best = (f64::INFINITY, DVec2::X);
    for i in (0..hull.len()).step_by(step) {
        let Some(axis) = (hull[(i + 1) % hull.len()] - hull[i]).try_normalize() else { continue };
        let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for &p in hull {
            let q = DVec2::new(axis.dot(p), axis.perp_dot(p));
            (lo, hi) = (lo.min(q), hi.max(q));
        }
        let area = (hi - lo).element_product();
        // A clear gain only, so that rounding does not choose between the sides of a square.
        if area < best.0 * (1.0 - 1e-9) {
            best = (area, axis);
        }
    }
    best.1
}

/// Convex hull, counter-clockwise (Andrew's monotone chain).
fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let mut out: Vec<DVec2> = Vec::new();
    let extend = |out: &mut Vec<DVec2>, base: usize, p: DVec2| {
        while out.len() >= base + 2 && (out[out.len() - 1] - out[out.len() - 2]).perp_dot(p - out[out.len() - 1]) <= 0.0
        {
            out.pop();
        }
        out.push(p);
    };
    for &p in &points {
        extend(&mut out, 0, p);
    }
    let base = out.len().saturating_sub(1);
    for &p in points.iter().rev().skip(1) {
        extend(&mut out, base, p);
    }
    out.pop();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_rectangle_comes_upright() {
        let (c, s) = (libm::cos(0.3), libm::sin(0.3));
        let at = |x: f64, y: f64| DVec2::new(c * x - s * y + 5.0, s * x + c * y - 2.0);
        let quad = [at(0.0, 0.0), at(2.0, 0.0), at(2.0, 3.0), at(0.0, 3.0)];
        let uvs = upright(vec![[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
        let hi = uvs.iter().flatten().fold(DVec2::ZERO, |hi, p| hi.max(*p));
        assert!((hi - DVec2::new(3.0, 2.0)).length() < 1e-12, "{hi}");
        for p in uvs.iter().flatten() {
            assert!((p.x.min(3.0 - p.x)).abs() < 1e-12 && (p.y.min(2.0 - p.y)).abs() < 1e-12, "{p}");
        }
    }

    #[test]
    fn stretch_of_a_scaled_square_is_exact() {
        let uv = [DVec2::ZERO, DVec2::X, DVec2::ONE];
        let points = [DVec3::ZERO, 4.0 * DVec3::X, DVec3::new(4.0, 0.5, 0.0)];
        let mut stretch = Stretch::default();
        stretch.add(&uv, &points);
        assert!((stretch.factors().unwrap() - DVec2::new(4.0, 0.5)).length() < 1e-12);
    }

    #[test]
    fn the_hull_of_a_grid_is_its_corners() {
        let grid = (0..25).map(|i| DVec2::new(f64::from(i % 5), f64::from(i / 5))).collect();
        assert_eq!(hull(grid).len(), 4);
    }
}

//! Shafts: everything that can stand between a box of receivers and a light.
//!
//! The shaft is the convex hull of the box and of the light's outline (Haines & Wallace 1991), kept as its three
//! axis-aligned projections: in each, the edges of the convex hull of both are half-planes that hold every segment.
//! Tests are conservative: what they call a miss cannot block; what they keep may yet miss.

use glam::{Vec2, Vec3};

/// Slack of every half-space, frame units: above f32's rounding at coordinates of 4096, below the ray offset.
const SLACK: f32 = 2e-3;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    pub lo: Vec3,
    pub hi: Vec3,
}

impl Bounds {
    pub const EMPTY: Self = Self { lo: Vec3::INFINITY, hi: Vec3::NEG_INFINITY };

    pub fn grow(&mut self, p: Vec3) {
        self.lo = self.lo.min(p);
        self.hi = self.hi.max(p);
    }

    pub fn center(&self) -> Vec3 {
        0.5 * (self.lo + self.hi)
    }

    /// Largest n·x over the box.
    pub fn support(&self, n: Vec3) -> f32 {
        let half = 0.5 * (self.hi - self.lo);
        n.dot(self.center()) + n.abs().dot(half)
    }
}

/// The outline of a light: at most eight points whose hull holds it.
#[derive(Clone, Copy, Debug)]
pub struct Outline {
    points: [Vec3; 8],
    count: usize,
}

impl Outline {
    /// At most eight points.
    pub fn polygon(corners: &[Vec3]) -> Self {
        let mut points = [Vec3::ZERO; 8];
        points[..corners.len()].copy_from_slice(corners);
        Self { points, count: corners.len() }
    }

    pub fn cuboid(b: Bounds) -> Self {
        let corner = |i: usize| {
            let pick = |bit: usize, lo: f32, hi: f32| if i >> bit & 1 == 0 { lo } else { hi };
            Vec3::new(pick(0, b.lo.x, b.hi.x), pick(1, b.lo.y, b.hi.y), pick(2, b.lo.z, b.hi.z))
        };
        Self { points: std::array::from_fn(corner), count: 8 }
    }

    fn points(&self) -> &[Vec3] {
        &self.points[..self.count]
    }
}

/// A half-plane of one projection: n·(x_i, x_j) ≤ d holds inside.
#[derive(Clone, Copy, Debug)]
struct Side {
    axes: (usize, usize),
    n: Vec2,
    d: f32,
}

/// A half-space: n·x > d holds inside.
#[derive(Clone, Copy, Debug)]
pub struct HalfSpace {
    pub n: Vec3,
    pub d: f32,
}

/// The hull of a tile of receivers and a light.
#[derive(Debug)]
pub struct Shaft {
    bounds: Bounds,
    sides: Vec<Side>,
    /// In front of the light's plane, above the receivers' plane.
    spaces: Vec<HalfSpace>,
    tile: Bounds,
    outline: Outline,
}

impl Shaft {
    pub fn new(tile: Bounds, outline: Outline, spaces: impl IntoIterator<Item = HalfSpace>) -> Self {
        let mut bounds = tile;
        outline.points().iter().for_each(|&p| bounds.grow(p));
        let mut sides = Vec::with_capacity(24);
        for axes in [(0, 1), (1, 2), (2, 0)] {
            push_hull_sides(axes, &tile, outline.points(), &mut sides);
        }
        Self { bounds, sides, spaces: spaces.into_iter().collect(), tile, outline }
    }

    /// No part of the box is inside.
    pub fn misses_box(&self, lo: Vec3, hi: Vec3) -> bool {
        if lo.cmpgt(self.bounds.hi + SLACK).any() || hi.cmplt(self.bounds.lo - SLACK).any() {
            return true;
        }
        let b = Bounds { lo, hi };
        self.sides.iter().any(|s| {
            let pick = |n: f32, axis: usize| n * if n > 0.0 { lo[axis] } else { hi[axis] };
            pick(s.n.x, s.axes.0) + pick(s.n.y, s.axes.1) > s.d
        }) || self.spaces.iter().any(|h| b.support(h.n) <= h.d)
    }

    /// The triangle cannot block any segment from the tile to the light.
    pub fn misses_triangle(&self, t: [Vec3; 3]) -> bool {
        let (lo, hi) = (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]));
        if lo.cmpgt(self.bounds.hi + SLACK).any() || hi.cmplt(self.bounds.lo - SLACK).any() {
            return true;
        }
        self.sides.iter().any(|s| t.iter().all(|v| s.n.x * v[s.axes.0] + s.n.y * v[s.axes.1] > s.d))
            || self.spaces.iter().any(|h| t.iter().all(|&v| h.n.dot(v) <= h.d))
            || self.is_on_one_side(t)
    }

    /// Tile and light lie strictly on the same side of the triangle's plane.
    fn is_on_one_side(&self, t: [Vec3; 3]) -> bool {
        let normal = (t[1] - t[0]).cross(t[2] - t[0]);
        let Some(n) = normal.try_normalize() else { return false };
        let tile = Bounds { lo: self.tile.lo - t[0], hi: self.tile.hi - t[0] };
        let (mut least, mut most) = (-tile.support(-n), tile.support(n));
        for &p in self.outline.points() {
            let h = n.dot(p - t[0]);
            (least, most) = (least.min(h), most.max(h));
        }
        least > 0.5 * SLACK || most < -0.5 * SLACK
    }
}

/// The edges of the convex hull of a rectangle and points, in one projection (Andrew's monotone chain).
fn push_hull_sides(axes: (usize, usize), tile: &Bounds, points: &[Vec3], sides: &mut Vec<Side>) {
    let (i, j) = axes;
    let flat = |p: Vec3| Vec2::new(p[i], p[j]);
    let (lo, hi) = (flat(tile.lo), flat(tile.hi));
    let mut all = [Vec2::ZERO; 12];
    all[..4].copy_from_slice(&[lo, Vec2::new(hi.x, lo.y), hi, Vec2::new(lo.x, hi.y)]);
    let count = 4 + points.len();
    for (slot, &p) in all[4..].iter_mut().zip(points) {
        *slot = flat(p);
    }
    let all = &mut all[..count];
    all.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut hull = [Vec2::ZERO; 26];
    let mut size = 0;
    let mut chain = |p: Vec2, floor: usize, size: &mut usize| {
        while *size >= floor + 2 && (hull[*size - 1] - hull[*size - 2]).perp_dot(p - hull[*size - 2]) <= 0.0 {
            *size -= 1;
        }
        hull[*size] = p;
        *size += 1;
    };
    all.iter().for_each(|&p| chain(p, 0, &mut size));
    let floor = size - 1;
    all.iter().rev().skip(1).for_each(|&p| chain(p, floor, &mut size));
    for k in 0..size.saturating_sub(1) {
        let edge = hull[k + 1] - hull[k];
        // The hull runs counter-clockwise, so its outside is to the right. Rounding may have left a point outside by
        // a little, hence the largest value over all points; edges along an axis are in the box already.
        let Some(n) = Vec2::new(edge.y, -edge.x).try_normalize() else { continue };
        if n.x.abs() < 1e-6 || n.y.abs() < 1e-6 {
            continue;
        }
        let d = all.iter().map(|&p| n.dot(p)).fold(f32::NEG_INFINITY, f32::max);
        sides.push(Side { axes, n, d: d + SLACK });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{combine, mix, unit};

    fn random(seed: u64, k: u64) -> Vec3 {
        let h = combine(seed, k);
        Vec3::new(unit(h), unit(mix(h)), unit(mix(mix(h)))) * 200.0 - 100.0
    }

    /// The segment crosses the triangle, in f64.
    fn crosses(p: Vec3, q: Vec3, t: [Vec3; 3]) -> bool {
        let (p, q) = (p.as_dvec3(), q.as_dvec3());
        let [a, b, c] = t.map(|v| v.as_dvec3());
        let n = (b - a).cross(c - a);
        let (hp, hq) = (n.dot(p - a), n.dot(q - a));
        if hp * hq > 0.0 || hp == hq {
            return false;
        }
        let x = p + (q - p) * (hp / (hp - hq));
        [(a, b), (b, c), (c, a)].iter().all(|&(a, b)| n.dot((b - a).cross(x - a)) >= 0.0)
    }

    #[test]
    fn nothing_that_blocks_a_segment_is_ever_culled() {
        let (mut blocked, mut kept, mut total) = (0, 0, 0);
        for seed in 0..3000u64 {
            let mut tile = Bounds::EMPTY;
            tile.grow(random(seed, 0));
            tile.grow(tile.lo + (random(seed, 1) + 100.0) * 0.1);
            let (o, a, b) = (random(seed, 2), random(seed, 3) * 0.2, random(seed, 4) * 0.2);
            let corners = [o, o + a, o + a + b, o + b];
            let shaft = Shaft::new(tile, Outline::polygon(&corners), []);
            let at = random(seed, 5);
            let t = [at, at + random(seed, 6), at + random(seed, 7)];
            let misses = shaft.misses_triangle(t);
            let box_misses = shaft.misses_box(t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]));
            let mut any = false;
            for k in 0..64 {
                let (x, y) = (random(seed, 100 + k) * 0.005 + 0.5, random(seed, 200 + k) * 0.005 + 0.5);
                let p = tile.lo + (tile.hi - tile.lo) * x;
                any |= crosses(p, o + a * y.x + b * y.y, t);
            }
            assert!(!(any && (misses || box_misses)), "{seed}");
            blocked += u32::from(any);
            kept += u32::from(!misses);
            total += 1;
        }
        // The promise would be empty if hardly anything blocked, and lazy if nearly everything were kept.
        assert!(blocked > total / 60 && kept < 4 * blocked, "{blocked} {kept} {total}");
    }
}

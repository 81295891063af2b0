//! Whether triangles in the plane lie on each other, by exact clipping of candidate pairs.

use glam::DVec2;

/// Overlap beyond this share of the total area refuses a layout. Exporters' rounding stays far below.
const TOLERANCE: f64 = 1e-3;
/// A pair of triangles may overlap by this share of the smaller one …
const PAIR_TOLERANCE: f64 = 0.05;
/// … or by this share of the total area: ten texels where the layout fills a page of 1024².
const NEGLIGIBLE: f64 = 1e-5;
/// Work allowed: so many steps per triangle, and so many besides.
const STEPS_PER_TRIANGLE: usize = 256;
const STEPS: usize = 1 << 20;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Overlap {
    /// Indices of two triangles, and the share of the smaller one that the other covers.
    Pair(usize, usize, f64),
    /// So many long triangles cross each other's bounds that a check would never end.
    Entangled,
}

pub(crate) fn signed_area(t: &[DVec2; 3]) -> f64 {
    0.5 * (t[1] - t[0]).perp_dot(t[2] - t[0])
}

/// Looks for overlap beyond the tolerances. Coordinates must be finite.
///
/// # Errors
/// The worst pair met by the time that the sum of overlaps went beyond the tolerance.
pub(crate) fn check(triangles: &[[DVec2; 3]]) -> Result<(), Overlap> {
    let total: f64 = triangles.iter().map(|t| signed_area(t).abs()).sum();
    let (mut sum, mut worst) = (0.0, (0.0, Overlap::Entangled));
    each_pair(
        triangles,
        || Ok(()),
        |a, b, area| {
            let smaller = signed_area(&triangles[a]).abs().min(signed_area(&triangles[b]).abs());
            let found = Overlap::Pair(a, b, area / smaller);
            sum += area;
            if area > worst.0 {
                worst = (area, found);
            }
            if area > PAIR_TOLERANCE * smaller && area > NEGLIGIBLE * total {
                return Err(found);
            }
            if sum > TOLERANCE * total { Err(worst.1) } else { Ok(()) }
        },
    )
}

/// Visits every pair of triangles that share area, with the area, each once; looks up at every cell of the grid that
/// finds them.
///
/// # Errors
/// What the two callers say; [`Overlap::Entangled`] where there are too many pairs.
pub(crate) fn each_pair<E: From<Overlap>>(
    triangles: &[[DVec2; 3]],
    mut look_up: impl FnMut() -> Result<(), E>,
    mut visit: impl FnMut(usize, usize, f64) -> Result<(), E>,
) -> Result<(), E> {
    let grid = Grid::new(triangles).ok_or(Overlap::Entangled)?;
    let mut steps = STEPS + STEPS_PER_TRIANGLE * triangles.len();
    for (cell, entries) in grid.entries.chunk_by(|a, b| a.0 == b.0).map(|run| (run[0].0, run)) {
        look_up()?;
        for (i, &(_, a)) in entries.iter().enumerate() {
            for &(_, b) in &entries[i + 1..] {
                steps = steps.checked_sub(1).ok_or(Overlap::Entangled)?;
                let (s, t) = (&triangles[a as usize], &triangles[b as usize]);
                // Pairs that meet in several cells count in the first one only.
                let Some(corner) = common_corner(s, t) else { continue };
                if grid.cell(corner) != cell {
                    continue;
                }
                let area = intersection(s, t);
                if area > 0.0 {
                    visit(a as usize, b as usize, area)?;
                }
            }
        }
    }
    Ok(())
}

/// Lower corner of the rectangle that two triangles' bounds share, or None where the bounds do not overlap.
fn common_corner(s: &[DVec2; 3], t: &[DVec2; 3]) -> Option<DVec2> {
    let ((a, b), (c, d)) = (bounds(s), bounds(t));
    let (lo, hi) = (a.max(c), b.min(d));
    (lo.x < hi.x && lo.y < hi.y).then_some(lo)
}

fn bounds(t: &[DVec2; 3]) -> (DVec2, DVec2) {
    (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]))
}

/// Triangles by the cells of a uniform grid that their bounds touch, sorted by cell, then by triangle.
struct Grid {
    lo: DVec2,
    per_unit: DVec2,
    side: u32,
    entries: Vec<(u32, u32)>,
}

impl Grid {
    /// None where the entries would exceed the allowed work.
    fn new(triangles: &[[DVec2; 3]]) -> Option<Self> {
        let all = triangles.iter().map(bounds);
        let (lo, hi) = all.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(l, h), (a, b)| (l.min(a), h.max(b)));
        let side = ((triangles.len() as f64).sqrt().ceil() as u32).clamp(1, 2048);
        let per_unit = f64::from(side) / (hi - lo).max(DVec2::splat(f64::MIN_POSITIVE));
        let mut grid = Self { lo, per_unit, side, entries: Vec::new() };
        let limit = (STEPS / 4).max(16 * triangles.len());
        for (number, t) in triangles.iter().enumerate() {
            let (a, b) = bounds(t);
            let (from, to) = (grid.cell(a), grid.cell(b));
            let (x0, y0, x1, y1) = (from % side, from / side, to % side, to / side);
            let cells = u64::from(x1 - x0 + 1) * u64::from(y1 - y0 + 1);
            if grid.entries.len() as u64 + cells > limit as u64 {
                return None;
            }
            for y in y0..=y1 {
                grid.entries.extend((x0..=x1).map(|x| (y * side + x, number as u32)));
            }
        }
        grid.entries.sort_unstable();
        Some(grid)
    }

    fn cell(&self, p: DVec2) -> u32 {
        let q = (p - self.lo) * self.per_unit;
        // `as` saturates; a huge quotient ends in the last cell.
        let at = |c: f64| (c as u32).min(self.side - 1);
        at(q.y) * self.side + at(q.x)
    }
}

/// Area that two triangles share.
fn intersection(s: &[DVec2; 3], t: &[DVec2; 3]) -> f64 {
    let sign = if signed_area(t) < 0.0 { -1.0 } else { 1.0 };
    let mut polygon = Polygon::new(s);
    for k in 0..3 {
        let (a, b) = (t[k], t[(k + 1) % 3]);
        polygon.clip(|p| sign * (b - a).perp_dot(p - a));
    }
    polygon.area()
}

/// A convex polygon of at most eleven corners: a triangle clipped by up to eight half-planes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Polygon {
    points: [DVec2; 11],
    len: usize,
}

impl Polygon {
    pub fn new(t: &[DVec2; 3]) -> Self {
        let mut points = [DVec2::ZERO; 11];
        points[..3].copy_from_slice(t);
        Self { points, len: 3 }
    }

    pub fn points(&self) -> &[DVec2] {
        &self.points[..self.len]
    }

    /// Keeps the part where `side`, an affine function, is not negative (Sutherland & Hodgman 1974).
    pub fn clip(&mut self, side: impl Fn(DVec2) -> f64) {
        let (old, n) = (self.points, self.len);
        self.len = 0;
        for i in 0..n {
            let (p, q) = (old[i], old[(i + 1) % n]);
            let (a, b) = (side(p), side(q));
            if a >= 0.0 {
                self.push(p);
            }
            if (a < 0.0) != (b < 0.0) {
                self.push(p + (q - p) * (a / (a - b)));
            }
        }
    }

    fn push(&mut self, p: DVec2) {
        // A convex polygon gains at most one corner per clip; rounding could make it look otherwise.
        if self.len < self.points.len() {
            self.points[self.len] = p;
            self.len += 1;
        }
    }

    pub fn area(&self) -> f64 {
        let p = self.points();
        let twice: f64 = (1..p.len().saturating_sub(1)).map(|i| (p[i] - p[0]).perp_dot(p[i + 1] - p[0])).sum();
        0.5 * twice.abs()
    }

    /// Centre of gravity; the mean corner where there is no area.
    pub fn centroid(&self) -> DVec2 {
        let p = self.points();
        let (mut sum, mut weight) = (DVec2::ZERO, 0.0);
        for i in 1..p.len().saturating_sub(1) {
            let area = (p[i] - p[0]).perp_dot(p[i + 1] - p[0]);
            sum += area * (p[0] + p[i] + p[i + 1]) / 3.0;
            weight += area;
        }
        let centre = sum / weight;
        if centre.is_finite() { centre } else { p.iter().sum::<DVec2>() / p.len().max(1) as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64) -> DVec2 {
        DVec2::new(x, y)
    }

    #[test]
    fn two_halves_of_a_square_do_not_overlap() {
        let t = [[at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)], [at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]];
        assert_eq!(check(&t), Ok(()));
    }

    #[test]
    fn overlap_is_measured_whatever_the_winding() {
        // The second triangle, mirrored, covers a quarter of the first.
        let t = [[at(0.0, 0.0), at(2.0, 0.0), at(0.0, 2.0)], [at(1.0, 0.0), at(1.0, 2.0), at(3.0, 0.0)]];
        let Err(Overlap::Pair(0, 1, share)) = check(&t) else { panic!("{:?}", check(&t)) };
        assert!((share - 0.25).abs() < 1e-12, "{share}");
    }

    #[test]
    fn crossing_slivers_end_early() {
        let spike = |i: usize| {
            let y = i as f64 * 1e-5;
            if i.is_multiple_of(2) {
                [at(0.0, y), at(1.0, y), at(1.0, y + 1e-9)]
            } else {
                [at(y, 0.0), at(y, 1.0), at(y + 1e-9, 1.0)]
            }
        };
        let t: Vec<_> = (0..20_000).map(spike).collect();
        assert!(check(&t).is_err());
    }
}

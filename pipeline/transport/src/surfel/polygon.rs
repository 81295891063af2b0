//! Convex polygons in voxel units, cut at grid planes (Sutherland & Hodgman 1974).
//!
//! A cut gives both halves from one set of intersection points, so the areas of all pieces add up to the area of the
//! whole but for the rounding of f64.

use glam::DVec3;

/// A triangle cut by the six planes of a voxel has at most nine corners; the slack takes up what rounding may add.
const MAX_CORNERS: usize = 16;

#[derive(Clone, Copy)]
pub struct Polygon {
    corners: [DVec3; MAX_CORNERS],
    len: usize,
}

impl Polygon {
    pub fn new(points: &[DVec3]) -> Self {
        let mut polygon = Self { corners: [DVec3::ZERO; MAX_CORNERS], len: 0 };
        points.iter().for_each(|&p| polygon.push(p));
        polygon
    }

    fn push(&mut self, p: DVec3) {
        if let Some(slot) = self.corners.get_mut(self.len) {
            *slot = p;
            self.len += 1;
        }
    }

    pub fn corners(&self) -> &[DVec3] {
        &self.corners[..self.len]
    }

    /// Smallest and largest coordinate along an axis.
    pub fn range(&self, axis: usize) -> (f64, f64) {
        self.corners().iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), p| (lo.min(p[axis]), hi.max(p[axis])))
    }

    /// The parts below and above the plane `axis = at`.
    pub fn split(&self, axis: usize, at: f64) -> (Self, Self) {
        let (mut below, mut above) = (Self::new(&[]), Self::new(&[]));
        for (i, &p) in self.corners().iter().enumerate() {
            let q = self.corners[if i + 1 == self.len { 0 } else { i + 1 }];
            let (a, b) = (p[axis] - at, q[axis] - at);
            if a <= 0.0 {
                below.push(p);
            }
            if a >= 0.0 {
                above.push(p);
            }
            if (a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0) {
                let mut cut = p + (q - p) * (a / (a - b));
                cut[axis] = at;
                below.push(cut);
                above.push(cut);
            }
        }
        (below, above)
    }

    /// The part on the side of the plane (point, normal) into which the normal looks.
    pub fn in_front(&self, point: DVec3, normal: DVec3) -> Self {
        let mut front = Self::new(&[]);
        for (i, &p) in self.corners().iter().enumerate() {
            let q = self.corners[if i + 1 == self.len { 0 } else { i + 1 }];
            let (a, b) = (normal.dot(p - point), normal.dot(q - point));
            if a >= 0.0 {
                front.push(p);
            }
            if (a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0) {
                front.push(p + (q - p) * (a / (a - b)));
            }
        }
        front
    }

    /// Area and centroid of a flat polygon; None where there is no area.
    pub fn area_and_centroid(&self) -> Option<(f64, DVec3)> {
        let origin = *self.corners().first()?;
        let mut cross = DVec3::ZERO;
        for pair in self.corners().get(1..)?.windows(2) {
            cross += (pair[0] - origin).cross(pair[1] - origin);
        }
        let double = cross.length();
        let direction = cross.try_normalize()?;
        let mut moment = DVec3::ZERO;
        for pair in self.corners()[1..].windows(2) {
            let part = (pair[0] - origin).cross(pair[1] - origin).dot(direction);
            moment += part * ((pair[0] - origin) + (pair[1] - origin)) / 3.0;
        }
        Some((0.5 * double, origin + moment / double))
    }

    /// `count` points that spread evenly over the area: stratified over the triangles of the fan.
    pub fn points(&self, count: u32) -> Vec<DVec3> {
        let Some((area, _)) = self.area_and_centroid() else { return Vec::new() };
        let origin = self.corners[0];
        let mut points = Vec::with_capacity(count as usize);
        let (mut sum, mut i) = (0.0, 0u32);
        for pair in self.corners()[1..].windows(2) {
            let (b, c) = (pair[0] - origin, pair[1] - origin);
            sum += 0.5 * b.cross(c).length();
            while i < count && (f64::from(i) + 0.5) / f64::from(count) * area <= sum {
                let (u, v) = crate::sampling::triangle(crate::sampling::r2(i, glam::Vec2::ZERO));
                points.push(origin + b * f64::from(u) + c * f64::from(v));
                i += 1;
            }
        }
        points
    }
}

/// Cuts a polygon at the grid planes between voxel `lo` and voxel `hi` of an axis and hands on the pieces with their
/// voxel. Coordinates beyond the range stay with its first and last voxel.
pub fn slice(polygon: Polygon, axis: usize, lo: i32, hi: i32, mut piece: impl FnMut(i32, Polygon)) {
    let (min, max) = polygon.range(axis);
    let first = (min.floor() as i32).clamp(lo, hi);
    let last = (max.floor() as i32).clamp(first, hi);
    let mut rest = polygon;
    for k in first..last {
        let (below, above) = rest.split(axis, f64::from(k + 1));
        if below.len >= 3 {
            piece(k, below);
        }
        rest = above;
    }
    if rest.len >= 3 {
        piece(last, rest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_add_up_to_the_whole() {
        let whole = Polygon::new(&[DVec3::new(0.1, 0.2, 0.3), DVec3::new(17.3, 4.1, -2.0), DVec3::new(5.0, 11.7, 9.9)]);
        let (area, centroid) = whole.area_and_centroid().unwrap();
        let (mut sum, mut moment, mut pieces) = (0.0, DVec3::ZERO, 0);
        for axis in 0..3 {
            slice(whole, axis, -5, 20, |k, piece| {
                let (lo, hi) = piece.range(axis);
                assert!(lo >= f64::from(k) && hi <= f64::from(k + 1));
                if let Some((a, c)) = piece.area_and_centroid() {
                    sum += a;
                    moment += a * c;
                    pieces += 1;
                }
            });
        }
        assert!(pieces > 30);
        assert!((sum / area - 3.0).abs() < 1e-12, "{sum}");
        assert!((moment / sum - centroid).length() < 1e-10);
    }

    #[test]
    fn a_polygon_in_a_grid_plane_belongs_to_one_voxel() {
        let flat = Polygon::new(&[DVec3::new(2.0, 0.0, 0.0), DVec3::new(2.0, 0.5, 0.0), DVec3::new(2.0, 0.5, 0.5)]);
        let mut seen = Vec::new();
        slice(flat, 0, 0, 9, |k, _| seen.push(k));
        assert_eq!(seen, [2]);
    }

    #[test]
    fn points_lie_inside_and_average_to_the_centroid() {
        let quad = Polygon::new(&[DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]);
        let points = quad.points(64);
        assert_eq!(points.len(), 64);
        let mean = points.iter().sum::<DVec3>() / 64.0;
        assert!((mean - DVec3::new(0.5, 0.5, 0.0)).length() < 0.05, "{mean}");
        assert!(points.iter().all(|p| p.min_element() >= -1e-9 && p.max_element() <= 1.0 + 1e-9));
    }
}

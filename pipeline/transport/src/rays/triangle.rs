//! Ray against triangle without gaps (Woop, Benthin & Wald 2013, "Watertight Ray/Triangle Intersection", JCGT 2(1)).
//!
//! The corners are moved to the ray's origin and sheared so that the ray runs along its dominant axis; what is left is
//! a point in a triangle of the plane, decided by three edge functions
//!
//!   U = Cx·By − Cy·Bx,  V = Ax·Cy − Ay·Cx,  W = Bx·Ay − By·Ax.
//!
//! Two triangles that share an edge see the same sheared corners, and a difference of two rounded products is never of
//! the wrong sign (at worst zero), so a ray that one of them refuses is accepted by the other: no ray slips through a
//! closed mesh. Zeros count as inside, hence a ray that meets a shared edge exactly is accepted twice. Where that
//! matters, one of the two owns the edge: the one that, turned counter-clockwise, runs through it upwards (the fill rule
//! of rasterisers).

use glam::{Vec3, Vec3A, Vec3Swizzles};

/// A triangle's corners by axis: all x, all y, all z. 48 bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corners([Vec3A; 3]);

/// A ray in the form that the test wants.
pub(super) struct Shear {
    /// Axes of the sheared x, y and z; z is the one along which the direction is longest.
    axes: [usize; 3],
    /// The origin's coordinate on each of them, in every lane.
    origin: [Vec3A; 3],
    x: f32,
    y: f32,
    z: f32,
}

impl Shear {
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let size = direction.abs();
        // Without branches: the axes of incoherent rays cannot be predicted.
        let is_y = (size.y > size.x) & (size.y >= size.z);
        let is_z = (size.z > size.x) & (size.z > size.y);
        let axes = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][usize::from(is_y) + 2 * usize::from(is_z)];
        let [x, y, z] = axes;
        let inverse = 1.0 / direction[z];
        Self {
            axes,
            origin: axes.map(|axis| Vec3A::splat(origin[axis])),
            x: direction[x] * inverse,
            y: direction[y] * inverse,
            z: inverse,
        }
    }
}

/// Where a ray's line passes through a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crossing {
    pub distance: f32,
    /// Barycentric coordinates of the second and third corner.
    pub u: f32,
    pub v: f32,
    /// False where the ray meets an edge that belongs to the neighbour.
    pub owned: bool,
}

impl Corners {
    pub fn new([a, b, c]: [Vec3; 3]) -> Self {
        Self([Vec3A::new(a.x, b.x, c.x), Vec3A::new(a.y, b.y, c.y), Vec3A::new(a.z, b.z, c.z)])
    }

    /// The crossing, from either side, at a distance in `[0, max]`.
    #[inline(always)]
    pub fn intersect(&self, ray: &Shear, max: f32) -> Option<Crossing> {
        let [kx, ky, kz] = ray.axes;
        let z = self.0[kz] - ray.origin[2];
        let x = self.0[kx] - ray.origin[0] - z * ray.x;
        let y = self.0[ky] - ray.origin[1] - z * ray.y;
        let edges = x.zxy() * y.yzx() - y.zxy() * x.yzx();
        if edges.cmplt(Vec3A::ZERO).any() && edges.cmpgt(Vec3A::ZERO).any() {
            return None;
        }
        let [u, v, w] = edges.to_array();
        let sum = u + v + w;
        let inverse = 1.0 / sum;
        let distance = (u * z.x + v * z.y + w * z.z) * ray.z * inverse;
        // Written so that the NaN of an edge-on triangle (sum = 0) fails.
        if !(distance >= 0.0 && distance <= max) {
            return None;
        }
        let owned = (u != 0.0 && v != 0.0 && w != 0.0) || owns([u, v, w], x, y);
        Some(Crossing { distance, u: v * inverse, v: w * inverse, owned })
    }
}

/// Whether the edges that the ray meets (edge function 0) belong to the triangle of the sheared corners (x, y).
#[cold]
fn owns(edges: [f32; 3], x: Vec3A, y: Vec3A) -> bool {
    let turn = if edges[0] + edges[1] + edges[2] > 0.0 { 1.0 } else { -1.0 };
    (0..3).all(|i| {
        let (from, to) = ((i + 1) % 3, (i + 2) % 3);
        let (dx, dy) = (turn * (x[to] - x[from]), turn * (y[to] - y[from]));
        edges[i] != 0.0 || dy > 0.0 || (dy == 0.0 && dx > 0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rays through the edges and corners of a fan of triangles, wound either way: each is owned by exactly one.
    #[test]
    fn every_edge_and_corner_has_one_owner() {
        let rim = [(2.0, 0.0), (1.0, 2.0), (-1.0, 1.0), (-2.0, -1.0), (0.0, -2.0), (1.5, -1.0)];
        let rim = rim.map(|(x, y)| Vec3::new(x, y, 0.0));
        let fan: Vec<Corners> = (0..6)
            .map(|i| {
                let (a, b) = (rim[i], rim[(i + 1) % 6]);
                Corners::new(if i % 2 == 0 { [Vec3::ZERO, a, b] } else { [b, a, Vec3::ZERO] })
            })
            .collect();
        for target in rim.iter().map(|r| *r * 0.5).chain([Vec3::ZERO]) {
            for side in [-1.0, 1.0] {
                let ray = Shear::new(target + Vec3::Z * side, -Vec3::Z * side);
                let met: Vec<_> = fan.iter().filter_map(|t| t.intersect(&ray, 2.0)).collect();
                assert!(met.len() > 1, "{target} is not on an edge");
                assert_eq!(met.iter().filter(|c| c.owned).count(), 1, "{target} {met:?}");
            }
        }
    }

    #[test]
    fn it_is_found_from_both_sides_at_the_right_place() {
        let corners = Corners::new([Vec3::ZERO, Vec3::X, Vec3::Y]);
        for side in [1.0, -1.0] {
            let origin = Vec3::new(0.25, 0.5, 2.0 * side);
            let ray = Shear::new(origin, Vec3::new(0.0, 0.0, -side));
            let crossing = Crossing { distance: 2.0, u: 0.25, v: 0.5, owned: true };
            assert_eq!(corners.intersect(&ray, 3.0), Some(crossing));
            assert_eq!(corners.intersect(&ray, 1.99), None);
            let away = Shear::new(origin, Vec3::new(0.0, 0.0, side));
            assert_eq!(corners.intersect(&away, 3.0), None);
        }
        let along = Shear::new(Vec3::new(-1.0, 0.25, 0.0), Vec3::X);
        assert_eq!(corners.intersect(&along, 9.0), None, "edge-on triangles have no thickness");
    }
}

//! Emissive triangles as targets of next events.
//!
//! Every emitting triangle is a list of cells: itself where it shines evenly, else the k² parts of a regular
//! subdivision. A vertex chooses a cell in proportion to an estimate of what it could receive from it, and a point of
//! the cell evenly: density p(cell)/area per unit area, that is p(cell)/area · d²/cos θ′ per unit solid angle.

use glam::{DVec3, Vec3};

use super::{
    noise::{pick, weight},
    overlap::Overlaps,
    path::Vertex,
};
use crate::{Rgb, geometry::Geometry, rays::Hit};

/// Cells that all textured emitters share.
const CELLS: f64 = 131_072.0;
const MAX_SPLIT: u32 = 16;

/// Up to so many cells each vertex weighs all of them; beyond, they are chosen by power alone.
const WEIGHED: usize = 512;

pub(super) struct Emitters {
    cells: Vec<Cell>,
    /// The emitting triangles in ascending order, with their first cell and their k.
    triangles: Vec<(u32, u32, u32)>,
    /// Running sums of the cells' powers.
    powers: Vec<f64>,
    overlaps: Overlaps,
}

/// A part of an emitting triangle.
struct Cell {
    triangle: u32,
    /// Barycentric (u, v) of its corners.
    corners: [[f32; 2]; 3],
    /// Squared frame units.
    area: f64,
    center: Vec3,
    radius: f32,
    normal: Vec3,
    double_sided: bool,
    /// Area × mean of coverage × Lₑ over bands and a few points.
    power: f64,
}

/// A point that shines on a vertex.
pub(super) struct Target {
    pub position: Vec3,
    /// Unit geometric normal.
    pub normal: Vec3,
    /// Unit, from the vertex.
    pub direction: Vec3,
    /// Coverage × Lₑ [cd/m²] towards the vertex.
    pub radiance: DVec3,
    /// Per steradian.
    pub density: f64,
}

impl Emitters {
    pub fn new(geometry: &Geometry) -> Self {
        let scene = geometry.scene;
        let emitting = |&i: &u32| {
            let t = &geometry.triangles[i as usize];
            let material = geometry.material(i);
            let casts = scene.instances[t.instance as usize].casts;
            material.emits() && !material.unlit && casts && !t.is_degenerate() && t.area() > 0.0
        };
        let is_even = |i: u32| {
            let material = geometry.material(i);
            material.emissive_texture.is_none() && material.is_opaque()
        };
        let list: Vec<u32> = (0..geometry.triangles.len() as u32).filter(emitting).collect();
        let overlaps = Overlaps::new(geometry, &list);
        let uneven = list.iter().filter(|&&i| !is_even(i)).count().max(1);
        let split = ((CELLS / uneven as f64).sqrt() as u32).clamp(1, MAX_SPLIT);
        let (mut cells, mut triangles) = (Vec::new(), Vec::with_capacity(list.len()));
        for i in list {
            let k = if is_even(i) { 1 } else { split };
            triangles.push((i, cells.len() as u32, k));
            cells.extend(subdivision(k).map(|corners| Cell::new(geometry, i, corners)));
        }
        let mut sum = 0.0;
        let powers = cells.iter().map(|c: &Cell| {
            sum += c.power;
            sum
        });
        let powers = powers.collect();
        Self { cells, triangles, powers, overlaps }
    }

    /// What a ray along `direction` meets that hits a surface at `hit`.
    pub fn met(&self, geometry: &Geometry, hit: &Hit, direction: Vec3) -> Hit {
        self.overlaps.met(geometry, *hit, direction)
    }

    /// Running sums of the weights with which a vertex chooses among the cells. `scratch` may hold them.
    pub fn weigh<'s>(&'s self, vertex: &Vertex, scratch: &'s mut Vec<f64>) -> &'s [f64] {
        if self.cells.len() > WEIGHED {
            return &self.powers;
        }
        scratch.clear();
        let mut sum = 0.0;
        scratch.extend(self.cells.iter().map(|cell| {
            sum += cell.promise(vertex);
            sum
        }));
        scratch
    }

    /// A point that may shine on the vertex and that no other emitter covers, by two numbers in [0, 1).
    pub fn sample(&self, geometry: &Geometry, vertex: &Vertex, sums: &[f64], [x, y]: [f64; 2]) -> Option<Target> {
        let (at, x) = pick(sums, x)?;
        let cell = &self.cells[at];
        let s = x.sqrt();
        let (b, c) = ((s * (1.0 - y)) as f32, (s * y) as f32);
        let [p, q, r] = cell.corners;
        let blend = |i: usize| p[i] + (q[i] - p[i]) * b + (r[i] - p[i]) * c;
        let (u, v) = (blend(0), blend(1));
        let t = &geometry.triangles[cell.triangle as usize];
        let position = t.at(u, v);
        let step = position - vertex.position;
        let squared = step.length_squared();
        if squared <= 0.0 {
            return None;
        }
        let direction = step / squared.sqrt();
        let facing = -t.normal.dot(direction);
        if facing == 0.0 || (facing < 0.0 && !cell.double_sided) {
            return None;
        }
        let hit = Hit { distance: squared.sqrt(), triangle: cell.triangle, u, v, back: facing < 0.0 };
        if self.met(geometry, &hit, direction).triangle != cell.triangle {
            return None;
        }
        let surface = geometry.surface(cell.triangle, u, v, 0.0);
        let density = cell.density(sums, at, squared, facing.abs());
        let radiance = (surface.emission * surface.coverage).max(Rgb::ZERO).as_dvec3();
        Some(Target { position, normal: t.normal, direction, radiance, density })
    }

    /// The density per steradian with which [`Emitters::sample`] would have found a hit along `direction` (unit).
    pub fn density(&self, geometry: &Geometry, vertex: &Vertex, sums: &[f64], hit: &Hit, direction: Vec3) -> f64 {
        let Ok(found) = self.triangles.binary_search_by_key(&hit.triangle, |t| t.0) else { return 0.0 };
        let (_, first, k) = self.triangles[found];
        let at = first as usize + cell_of(k, hit.u, hit.v);
        let t = &geometry.triangles[hit.triangle as usize];
        let squared = (t.at(hit.u, hit.v) - vertex.position).length_squared();
        self.cells[at].density(sums, at, squared, t.normal.dot(direction).abs())
    }
}

impl Cell {
    fn new(geometry: &Geometry, triangle: u32, corners: [[f32; 2]; 3]) -> Self {
        let t = &geometry.triangles[triangle as usize];
        let points = corners.map(|[u, v]| t.at(u, v));
        let center = (points[0] + points[1] + points[2]) / 3.0;
        let edge = |i: usize| (points[i] - points[0]).as_dvec3();
        let area = 0.5 * edge(1).cross(edge(2)).length();
        let middle = |i: usize| (corners[0][i] + corners[1][i] + corners[2][i]) / 3.0;
        let middle = [middle(0), middle(1)];
        let shine = |[u, v]: [f32; 2]| {
            let surface = geometry.surface(triangle, u, v, 0.0);
            f64::from((surface.emission * surface.coverage).max(Rgb::ZERO).element_sum() / 3.0)
        };
        let towards = |p: [f32; 2]| [0, 1].map(|i| middle[i] + (p[i] - middle[i]) * 0.67);
        let mean = (shine(middle) + corners.iter().map(|&p| shine(towards(p))).sum::<f64>()) / 4.0;
        Self {
            triangle,
            corners,
            area,
            center,
            radius: points.iter().map(|p| p.distance(center)).fold(0.0, f32::max),
            normal: t.normal,
            double_sided: geometry.material(triangle).double_sided,
            power: area * mean,
        }
    }

    /// A weight that is positive wherever the cell may shine on the vertex: power over squared distance, with cosines
    /// at the centre, widened by the cell's radius.
    fn promise(&self, vertex: &Vertex) -> f64 {
        let step = self.center - vertex.position;
        let distance = step.length().max(self.radius).max(f32::MIN_POSITIVE);
        let reach = self.radius / distance;
        let above = vertex.normal.dot(step) / distance + reach;
        let facing = -self.normal.dot(step) / distance;
        let facing = if self.double_sided { facing.abs() } else { facing } + reach;
        if above <= 0.0 || facing <= 0.0 {
            return 0.0;
        }
        self.power * f64::from(above.min(1.0) * facing.min(1.0)) / (f64::from(distance) * f64::from(distance))
    }

    fn density(&self, sums: &[f64], at: usize, squared: f32, facing: f32) -> f64 {
        let total = sums.last().copied().unwrap_or(0.0);
        if total <= 0.0 || self.area <= 0.0 || facing <= 0.0 {
            return 0.0;
        }
        weight(sums, at) / total / self.area * f64::from(squared) / f64::from(facing)
    }
}

/// The k² cells of a triangle, in the order of [`cell_of`].
fn subdivision(k: u32) -> impl Iterator<Item = [[f32; 2]; 3]> {
    let at = move |i: u32, j: u32| [i as f32 / k as f32, j as f32 / k as f32];
    (0..k).flat_map(move |i| {
        (0..2 * (k - i) - 1).map(move |n| {
            let j = n / 2;
            if n % 2 == 0 {
                [at(i, j), at(i + 1, j), at(i, j + 1)]
            } else {
                [at(i + 1, j + 1), at(i, j + 1), at(i + 1, j)]
            }
        })
    })
}

/// Which of the k² cells holds the barycentric (u, v): row i begins at i(2k − i), cells alternate upright and reversed.
fn cell_of(k: u32, u: f32, v: f32) -> usize {
    let (x, y) = (u * k as f32, v * k as f32);
    // `as` saturates; the clamps keep rounding at the hypotenuse inside.
    let i = (x as u32).min(k - 1);
    let j = (y as u32).min(k - 1 - i);
    let reversed = x - i as f32 + (y - j as f32) > 1.0 && i + j + 1 < k;
    (i * (2 * k - i) + 2 * j + u32::from(reversed)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_found_in_the_cell_that_it_lies_in() {
        for k in [1, 2, 5, 16] {
            let cells: Vec<_> = subdivision(k).collect();
            assert_eq!(cells.len(), (k * k) as usize);
            for (n, corners) in cells.iter().enumerate() {
                let middle = |i: usize| (corners[0][i] + corners[1][i] + corners[2][i]) / 3.0;
                assert_eq!(cell_of(k, middle(0), middle(1)), n, "k {k}");
            }
            for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (1.0, 1.0)] {
                assert!(cell_of(k, u, v) < cells.len(), "{u} {v}");
            }
        }
    }
}

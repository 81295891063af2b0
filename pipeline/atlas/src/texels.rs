//! Blocks to texels: conservative rasterisation with exact coverage.
//!
//! Every texel square that a block's triangles touch is clipped against each of them (f64), so coverage sums to the
//! chart's area. The sample point is the texel's centre where a triangle holds it; else the nearest point of the
//! covered part, drawn an eighth of the way towards that part's centroid so that it does not lie in the very corner
//! where two walls meet. World area is gathered alike: a texel's footprint is the side of the square that has the
//! world area of the whole texel.

use glam::DVec2;

use crate::Texel;
use crate::blocks::{Block, Face};
use crate::overlap::Polygon;
use crate::place::Place;

/// Less coverage than this is rounding, not surface.
const LEAST_COVERAGE: f64 = 1e-6;
/// How far a displaced sample moves from the border towards the middle of the covered part.
const INWARD: f64 = 0.125;

/// What is known of one texel so far.
#[derive(Clone, Copy)]
struct Cell {
    coverage: f64,
    /// World area of the covered part.
    area: f64,
    /// Squared distance of the sample from the centre; infinite where there is none.
    distance: f64,
    sample: DVec2,
    face: u32,
}

const EMPTY: Cell = Cell { coverage: 0.0, area: 0.0, distance: f64::INFINITY, sample: DVec2::ZERO, face: 0 };

/// A texel and the instance that its sample lies on, for blocks of several instances.
pub(crate) struct Found {
    pub instance: u32,
    pub texel: Texel,
}

/// The texels of a block at its place, in rows of the page. `seed` gives each instance's chart seed.
pub(crate) fn texels(block: &Block, place: &Place, seed: impl Fn(u32) -> u64) -> Vec<Found> {
    let [width, height] = place.size;
    let mut cells = vec![EMPTY; width as usize * height as usize];
    let scale = DVec2::new(width.into(), height.into());
    let corners: Vec<[DVec2; 3]> = block.faces.iter().map(|f| f.uv.map(|p| p * scale)).collect();
    for (number, (face, t)) in block.faces.iter().zip(&corners).enumerate() {
        draw(&mut cells, width, height, number as u32, face, t);
    }
    let mut found: Vec<Found> = Vec::new();
    for (at, cell) in cells.iter().enumerate() {
        if cell.coverage < LEAST_COVERAGE || cell.distance.is_infinite() {
            continue;
        }
        let (i, j) = (at as u32 % width, at as u32 / width);
        let face = &block.faces[cell.face as usize];
        let (u, v) = barycentric(&corners[cell.face as usize], cell.sample);
        let (x, y) = turned((i, j), place);
        let texel = Texel {
            x: (place.x + x) as u16,
            y: (place.y + y) as u16,
            page: place.page as u16,
            chart: 0,
            instance: face.instance,
            triangle: face.triangle,
            u,
            v,
            coverage: cell.coverage.min(1.0) as f32,
            footprint: (cell.area / cell.coverage).sqrt() as f32,
            seed: mixed(seed(face.instance), i, j),
        };
        found.push(Found { instance: face.instance, texel });
    }
    found.sort_unstable_by_key(|f| (f.texel.y, f.texel.x));
    found
}

/// The cell of the placed, turned block that a cell of the block becomes.
fn turned((i, j): (u32, u32), place: &Place) -> (u32, u32) {
    let [w, h] = place.size;
    match place.turn {
        0 => (i, j),
        1 => (h - 1 - j, i),
        2 => (w - 1 - i, h - 1 - j),
        _ => (j, w - 1 - i),
    }
}

/// A point of the block's unit square on its page [texels].
pub(crate) fn placed(p: DVec2, place: &Place) -> DVec2 {
    let [w, h] = place.size.map(f64::from);
    let (x, y) = (p.x * w, p.y * h);
    let turned = match place.turn {
        0 => DVec2::new(x, y),
        1 => DVec2::new(h - y, x),
        2 => DVec2::new(w - x, h - y),
        _ => DVec2::new(y, w - x),
    };
    turned + DVec2::new(place.x.into(), place.y.into())
}

fn draw(cells: &mut [Cell], width: u32, height: u32, number: u32, face: &Face, t: &[DVec2; 3]) {
    let twice = (t[1] - t[0]).perp_dot(t[2] - t[0]);
    let world_per_texel = face.area / (0.5 * twice.abs());
    if !world_per_texel.is_finite() {
        return;
    }
    let lo = t[0].min(t[1]).min(t[2]).floor().max(DVec2::ZERO);
    let hi = t[0].max(t[1]).max(t[2]).ceil();
    let (x0, y0) = (lo.x as u32, lo.y as u32);
    let (x1, y1) = ((hi.x as u32).min(width), (hi.y as u32).min(height));
    let edges = Edges::new(t, twice);
    for y in y0..y1 {
        for x in x0..x1 {
            let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let covered = match edges.meet(centre) {
                Meeting::Outside => continue,
                Meeting::Inside => None,
                Meeting::Border => Some(clipped(t, centre)),
            };
            let cell = &mut cells[y as usize * width as usize + x as usize];
            let area = covered.as_ref().map_or(1.0, Polygon::area);
            if area <= 0.0 {
                continue;
            }
            cell.coverage += area;
            cell.area += area * world_per_texel;
            let (distance, sample) = match &covered {
                Some(part) if !edges.holds(centre) => displaced(part, centre),
                _ => (0.0, centre),
            };
            if distance < cell.distance {
                (cell.distance, cell.sample, cell.face) = (distance, sample, number);
            }
        }
    }
}

/// The three edge functions of a triangle, positive inside.
struct Edges {
    normals: [DVec2; 3],
    offsets: [f64; 3],
}

enum Meeting {
    Outside,
    Inside,
    Border,
}

impl Edges {
    fn new(t: &[DVec2; 3], twice: f64) -> Self {
        let sign = if twice < 0.0 { -1.0 } else { 1.0 };
        let normals = [0, 1, 2].map(|k| sign * (t[(k + 1) % 3] - t[k]).perp());
        Self { normals, offsets: [0, 1, 2].map(|k| normals[k].dot(t[k])) }
    }

    fn holds(&self, p: DVec2) -> bool {
        (0..3).all(|k| self.normals[k].dot(p) >= self.offsets[k])
    }

    /// How the unit square around a centre lies to the triangle, edge by edge.
    fn meet(&self, centre: DVec2) -> Meeting {
        let mut inside = true;
        for k in 0..3 {
            let n = self.normals[k];
            let reach = 0.5 * (n.x.abs() + n.y.abs());
            let side = n.dot(centre) - self.offsets[k];
            if side <= -reach {
                return Meeting::Outside;
            }
            inside &= side >= reach;
        }
        if inside { Meeting::Inside } else { Meeting::Border }
    }
}

fn clipped(t: &[DVec2; 3], centre: DVec2) -> Polygon {
    let mut part = Polygon::new(t);
    part.clip(|p| p.x - (centre.x - 0.5));
    part.clip(|p| centre.x + 0.5 - p.x);
    part.clip(|p| p.y - (centre.y - 0.5));
    part.clip(|p| centre.y + 0.5 - p.y);
    part
}

/// Squared distance from the centre to the covered part, and a sample near its nearest point.
fn displaced(part: &Polygon, centre: DVec2) -> (f64, DVec2) {
    let p = part.points();
    let mut best = (f64::INFINITY, centre);
    for i in 0..p.len() {
        let (a, b) = (p[i], p[(i + 1) % p.len()]);
        let edge = b - a;
        let along = ((centre - a).dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        let near = if along.is_finite() { a + along * edge } else { a };
        let distance = near.distance_squared(centre);
        if distance < best.0 {
            best = (distance, near);
        }
    }
    (best.0, best.1.lerp(part.centroid(), INWARD))
}

/// Barycentric coordinates of the second and third corner, kept inside the triangle.
fn barycentric(t: &[DVec2; 3], p: DVec2) -> (f32, f32) {
    let (e, f, d) = (t[1] - t[0], t[2] - t[0], p - t[0]);
    let twice = e.perp_dot(f);
    let u = (d.perp_dot(f) / twice).clamp(0.0, 1.0) as f32;
    let v = (e.perp_dot(d) / twice).clamp(0.0, 1.0) as f32;
    (u, v.min(1.0 - u))
}

/// SplitMix64 (Steele, Lea & Flood 2014) over the chart's seed and the cell.
fn mixed(seed: u64, i: u32, j: u32) -> u64 {
    let mut z = seed.wrapping_add((u64::from(j) << 32 | u64::from(i)).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn block(faces: Vec<Face>) -> Block {
        Block {
            group: 0,
            instances: vec![0],
            number: 0,
            size: DVec2::ONE,
            origin: DVec2::ZERO,
            extent: DVec2::ONE,
            faces,
            filled: 1.0,
        }
    }

    fn face(uv: [DVec2; 3], triangle: u32) -> Face {
        Face { instance: 0, triangle, uv, area: 8.0 }
    }

    fn place(w: u32, h: u32, turn: u8) -> Place {
        Place { page: 0, x: 3, y: 5, size: [w, h], turn }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn coverage_sums_to_the_area(c in prop::array::uniform6(0.0_f64..1.0), w in 1_u32..40, h in 1_u32..40) {
            let uv = [DVec2::new(c[0], c[1]), DVec2::new(c[2], c[3]), DVec2::new(c[4], c[5])];
            let exact = crate::overlap::signed_area(&uv).abs() * f64::from(w * h);
            prop_assume!(exact > 0.1);
            let found = texels(&block(vec![face(uv, 7)]), &place(w, h, 0), |_| 1);
            let sum: f64 = found.iter().map(|f| f64::from(f.texel.coverage)).sum();
            prop_assert!((sum / exact - 1.0).abs() < 1e-4, "{sum} {exact}");
            let world: f64 =
                found.iter().map(|f| f64::from(f.texel.coverage) * f64::from(f.texel.footprint).powi(2)).sum();
            prop_assert!((world / 8.0 - 1.0).abs() < 1e-4, "{world}");
            for f in &found {
                prop_assert!(f.texel.u >= 0.0 && f.texel.v >= 0.0 && f.texel.u + f.texel.v <= 1.0);
            }
        }
    }

    #[test]
    fn turning_moves_texels_as_it_moves_points() {
        let uv = [DVec2::new(0.1, 0.2), DVec2::new(0.9, 0.1), DVec2::new(0.4, 0.95)];
        let block = block(vec![face(uv, 0)]);
        for turn in 0..4 {
            let place = place(9, 6, turn);
            for found in texels(&block, &place, |_| 1) {
                let t = found.texel;
                let w = [1.0 - f64::from(t.u) - f64::from(t.v), t.u.into(), t.v.into()];
                let at = placed(w[0] * uv[0] + w[1] * uv[1] + w[2] * uv[2], &place);
                assert!(
                    (at - DVec2::new(f64::from(t.x) + 0.5, f64::from(t.y) + 0.5)).abs().max_element() <= 0.5 + 1e-5
                );
            }
        }
    }

    #[test]
    fn seeds_belong_to_the_cell_and_not_to_the_place() {
        let uv = [DVec2::ZERO, DVec2::X, DVec2::ONE];
        let block = block(vec![face(uv, 0)]);
        let seeds = |turn| {
            let mut s: Vec<u64> = texels(&block, &place(8, 8, turn), |_| 42).iter().map(|f| f.texel.seed).collect();
            s.sort_unstable();
            s
        };
        assert_eq!(seeds(0), seeds(3));
    }
}

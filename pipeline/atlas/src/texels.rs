//! Blocks to texels: conservative rasterisation with exact coverage.
//!
//! Every texel square that a block's triangles touch is clipped against each of them (f64), so coverage sums to the
//! chart's area. The sample point is the texel's centre where a triangle holds it; else the nearest point of the
//! covered part, drawn an eighth of the way towards that part's centroid so that it does not lie in the very corner
//! where two walls meet. A centre on the very border of a triangle is drawn inwards likewise: there may stand a wall, and
//! whoever is in its plane sees past it. World area is gathered alike: a texel's footprint is the side of the square that has the
//! world area of the whole texel.

use std::ops::Range;

use glam::DVec2;
use luxel_scene::{Cancelled, Progress, watched};
use rayon::prelude::*;

use crate::Texel;
use crate::blocks::{Block, Face};
use crate::overlap::Polygon;
use crate::place::Place;

/// Less coverage than this is rounding, not surface.
const LEAST_COVERAGE: f64 = 1e-6;
/// How far a displaced sample moves from the border towards the middle of the covered part.
const INWARD: f64 = 0.125;
/// Coverage from which on a texel lies within its chart, but for rounding.
const WHOLE: f64 = 1.0 - 1e-6;
/// A centre that is less than this share of a texel from the border counts as on it.
const BORDER: f64 = 1.0 / 64.0;

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
    /// The centre, and the first face that holds it, border or not.
    centre: Option<(DVec2, u32)>,
}

impl Cell {
    /// Where the texel is sampled. A centre on a border that the chart goes on behind, as on the diagonal of a quad, is
    /// as good as any.
    fn place(&self) -> (DVec2, u32) {
        self.centre.filter(|_| self.coverage >= WHOLE).unwrap_or((self.sample, self.face))
    }
}

const EMPTY: Cell =
    Cell { coverage: 0.0, area: 0.0, distance: f64::INFINITY, sample: DVec2::ZERO, face: 0, centre: None };

/// Rows whose cells exist at the same time; every strip looks at all faces of its block.
const STRIP: u32 = 64;

/// The texels of a block at its place, in rows of the page.
pub(crate) fn texels(block: &Block, place: &Place, progress: &dyn Progress) -> Result<Vec<(u32, Texel)>, Cancelled> {
    let [width, height] = place.size;
    let scale = DVec2::new(width.into(), height.into());
    let corners: Vec<[DVec2; 3]> = block.faces.iter().map(|f| f.uv.map(|p| p * scale)).collect();
    let strip = |k: u32| strip(block, place, &corners, k * STRIP..height.min((k + 1) * STRIP), progress);
    let strips = (0..height.div_ceil(STRIP)).into_par_iter().map(strip);
    let strips = strips.collect::<Result<Vec<Vec<(u32, Texel)>>, Cancelled>>()?;
    let mut texels = Vec::with_capacity(strips.iter().map(Vec::len).sum());
    strips.into_iter().for_each(|strip| texels.extend(strip));
    progress.check()?;
    texels.sort_unstable_by_key(|(_, t)| (t.y, t.x));
    Ok(texels)
}

/// The texels of some rows of a block, before it is turned.
fn strip(
    block: &Block,
    place: &Place,
    corners: &[[DVec2; 3]],
    rows: Range<u32>,
    progress: &dyn Progress,
) -> Result<Vec<(u32, Texel)>, Cancelled> {
    let width = place.size[0];
    let mut cells = vec![EMPTY; width as usize * rows.len()];
    for item in watched(block.faces.iter().zip(corners).enumerate(), progress) {
        let (number, (face, t)) = item?;
        draw(&mut cells, width, &rows, number as u32, face, t);
    }
    let is_there = |cell: &Cell| cell.coverage >= LEAST_COVERAGE && cell.distance.is_finite();
    let mut texels = Vec::with_capacity(cells.iter().filter(|c| is_there(c)).count());
    for item in watched(cells.iter().enumerate().filter(|(_, c)| is_there(c)), progress) {
        let (at, cell) = item?;
        let (i, j) = (at as u32 % width, at as u32 / width + rows.start);
        let (sample, number) = cell.place();
        let face = &block.faces[number as usize];
        let (u, v) = barycentric(&corners[number as usize], sample);
        let (x, y) = turned((i, j), place);
        let place = [(place.x + x) as u16, (place.y + y) as u16];
        let footprint = (cell.area / cell.coverage).sqrt() as f32;
        texels.push((face.instance, Texel::new(place, face.triangle, [u, v], cell.coverage as f32, footprint)));
    }
    Ok(texels)
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

/// Adds a face to the cells of some rows.
fn draw(cells: &mut [Cell], width: u32, rows: &Range<u32>, number: u32, face: &Face, t: &[DVec2; 3]) {
    let twice = (t[1] - t[0]).perp_dot(t[2] - t[0]);
    let world_per_texel = face.area / (0.5 * twice.abs());
    if !world_per_texel.is_finite() {
        return;
    }
    let lo = t[0].min(t[1]).min(t[2]).floor().max(DVec2::ZERO);
    let hi = t[0].max(t[1]).max(t[2]).ceil();
    let (x0, y0) = (lo.x as u32, (lo.y as u32).max(rows.start));
    let (x1, y1) = ((hi.x as u32).min(width), (hi.y as u32).min(rows.end));
    let edges = Edges::new(t, twice);
    for y in y0..y1 {
        for x in x0..x1 {
            let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let covered = match edges.meet(centre) {
                Meeting::Outside => continue,
                Meeting::Inside => None,
                Meeting::Border => Some(clipped(t, centre)),
            };
            let cell = &mut cells[(y - rows.start) as usize * width as usize + x as usize];
            let area = covered.as_ref().map_or(1.0, Polygon::area);
            if area <= 0.0 {
                continue;
            }
            cell.coverage += area;
            cell.area += area * world_per_texel;
            let (distance, sample) = match &covered {
                Some(part) if !edges.holds(centre, BORDER) => displaced(part, centre),
                _ => (0.0, centre),
            };
            if cell.centre.is_none() && edges.holds(centre, 0.0) {
                cell.centre = Some((centre, number));
            }
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

    /// The triangle holds a point that is at least so far from its border.
    fn holds(&self, p: DVec2, border: f64) -> bool {
        (0..3).all(|k| self.normals[k].dot(p) >= self.offsets[k] + border * self.normals[k].length())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Chart;
    use luxel_scene::Silent;
    use proptest::prelude::*;

    fn texels(block: &Block, place: &Place) -> Vec<(u32, Texel)> {
        super::texels(block, place, &Silent).unwrap()
    }

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
            let found = texels(&block(vec![face(uv, 7)]), &place(w, h, 0));
            let sum: f64 = found.iter().map(|(_, f)| f64::from(f.coverage())).sum();
            // Each coverage is rounded by at most half of its steps; the least is one step.
            let rounding = found.len() as f64 / f64::from(u16::MAX);
            prop_assert!((sum - exact).abs() < 1e-4 * exact + rounding, "{sum} {exact}");
            let world: f64 =
                found.iter().map(|(_, f)| f64::from(f.coverage()) * f64::from(f.footprint()).powi(2)).sum();
            prop_assert!((world / 8.0 - 1.0).abs() < 1e-4 + rounding / exact, "{world}");
            for (_, f) in &found {
                let [u, v] = f.barycentric();
                prop_assert!(u >= 0.0 && v >= 0.0 && u + v <= 1.0);
            }
        }
    }

    #[test]
    fn turning_moves_texels_as_it_moves_points() {
        let uv = [DVec2::new(0.1, 0.2), DVec2::new(0.9, 0.1), DVec2::new(0.4, 0.95)];
        let block = block(vec![face(uv, 0)]);
        for turn in 0..4 {
            let place = place(9, 6, turn);
            for (_, t) in texels(&block, &place) {
                let [u, v] = t.barycentric().map(f64::from);
                let w = [1.0 - u - v, u, v];
                let at = placed(w[0] * uv[0] + w[1] * uv[1] + w[2] * uv[2], &place);
                assert!(
                    (at - DVec2::new(f64::from(t.x) + 0.5, f64::from(t.y) + 0.5)).abs().max_element() <= 0.5 + 1e-5
                );
            }
        }
    }

    #[test]
    fn seeds_belong_to_the_cell_and_not_to_the_place() {
        let uv = [DVec2::new(0.1, 0.2), DVec2::new(0.9, 0.1), DVec2::new(0.4, 0.95)];
        let block = block(vec![face(uv, 0)]);
        // By the point on the triangle, so that turned copies are compared cell by cell.
        let seeds = |turn: u8| {
            let place = place(9, 6, turn);
            let (width, height) = if turn.is_multiple_of(2) { (9, 6) } else { (6, 9) };
            let (x, y, seed) = (place.x, place.y, 42);
            let chart = Chart { instance: 0, page: 0, x, y, width, height, turn, first_texel: 0, texels: 0, seed };
            let mut s: Vec<_> = texels(&block, &place)
                .iter()
                .map(|(_, t)| (t.barycentric().map(f32::to_bits), chart.texel_seed(t.x, t.y)))
                .collect();
            s.sort_unstable();
            s
        };
        let straight = seeds(0);
        assert!(straight.len() > 20 && (1..4).all(|turn| seeds(turn) == straight));
        let mut own: Vec<u64> = straight.iter().map(|s| s.1).collect();
        own.sort_unstable();
        own.dedup();
        assert_eq!(own.len(), straight.len());
    }
}

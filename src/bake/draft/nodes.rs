//! The few texels at which a draft gathers, and what the others make of them.
//!
//! Every chart is cut into square cells of s × s texels; the open texel nearest to a cell's middle is its node. Texels
//! take the mean of the nodes of their own cell and of those around it that the own one is linked to, weighted by a tent,
//!
//! ```text
//! E = Σⱼ wⱼ Eⱼ / Σⱼ wⱼ,   wⱼ = max(0, 1 − |xⱼ − x|/s) · max(0, 1 − |yⱼ − y|/s)      in texels
//! ```
//!
//! Two nodes are linked when one smooth surface leads from one to the other with nothing standing on it: so no light
//! crosses the foot of a wall but within a cell. Every chart has its own s, the smallest of a scale with which it has no
//! more nodes than one and its share of the rest: so many for so many texels that all charts together keep to [`MOST`]. A
//! small lightmap is gathered at every texel.

use std::ops::Range;

use luxel_scene::Progress;
use luxel_transport::{
    Rgb,
    gather::{Gather, Receiver},
    rays::Rays,
};
use rayon::prelude::*;

use crate::Error;
use crate::bake::journal::Counters;
use crate::bake::receivers::Side;

/// Most nodes, unless there are more charts.
const MOST: usize = 10_000;

/// Texels for a node from one try to the next.
const COARSER: f64 = 1.25;

/// Least cosine between the normals of two nodes that are linked.
const SMOOTH: f32 = 0.8;

/// Longest distance between two linked nodes, in texels between them.
const STRETCH: f32 = 3.0;

/// How far above the surface nodes look for each other, as a share of their distance: over the bulge of a surface whose
/// normals turn as far as [`SMOOTH`] admits, (1 − cos θ/2) / (2 sin θ/2) = 0.08.
const LIFT: f32 = 0.12;

/// What lets so much light pass stands in nobody's way.
const CLEAR: f32 = 0.5;

/// No node, no texel.
const NONE: u32 = u32::MAX;

/// Nodes of all charts of one side of the surfaces.
pub struct Nodes {
    charts: Vec<Chart>,
    /// Chart by chart, row by row.
    pub receivers: Vec<Receiver>,
    /// By texel of the side.
    pub buried: Vec<bool>,
}

/// The cells of one chart.
struct Chart {
    /// Its texels.
    texels: Range<usize>,
    /// Number of its first node.
    first: usize,
    /// Side of a cell in texels.
    stride: u32,
    /// Cells of a row.
    width: usize,
    /// By cell, row by row.
    cells: Vec<Cell>,
    /// Where the nodes are, and what they are.
    places: Vec<[u32; 2]>,
    receivers: Vec<Receiver>,
}

#[derive(Clone, Copy)]
struct Cell {
    /// Among those of the chart.
    node: u32,
    /// The node is linked to that of the next cell in the row, and in the column.
    right: bool,
    below: bool,
}

/// Texels that may be a cell's node with the square of their distance from where one is wanted: the middle of the cell,
/// then those of its quarters.
type Candidates = [(u32, u32); 5];

impl Nodes {
    /// Chooses the nodes of a side. Where nobody has cleared it yet, only texels that may be nodes are, and all of a cell
    /// without an open one count as buried.
    pub fn new(side: &Side, is_cleared: bool, rays: &Rays, progress: &dyn Progress) -> Result<Self, Error> {
        let runs = runs(side);
        let strides = strides(side, &runs);
        let charts = runs.into_par_iter().zip(strides).map(|(texels, stride)| {
            progress.check()?;
            Ok(Chart::new(side, is_cleared, rays, texels, stride))
        });
        let mut charts: Vec<Chart> = charts.collect::<Result<_, Error>>()?;
        let (mut receivers, mut buried) = (Vec::new(), side.buried.clone());
        for chart in &mut charts {
            chart.first = receivers.len();
            receivers.append(&mut chart.receivers);
            for texel in chart.texels.clone() {
                let (cell, _) = chart.cell_of(side, texel);
                buried[texel] |= chart.cells[cell].node == NONE;
            }
        }
        Ok(Self { charts, receivers, buried })
    }

    pub fn len(&self) -> u64 {
        self.receivers.len() as u64
    }

    /// Adds the light that is found at the nodes, so many times, to a sum [lux].
    pub fn gather(
        &self,
        gatherer: &dyn Gather,
        factor: Rgb,
        sum: &mut [Rgb],
        progress: &dyn Progress,
        counters: &mut Counters,
    ) -> Result<(), Error> {
        let mut rays = 0;
        for (sum, found) in sum.iter_mut().zip(gatherer.gather(&self.receivers, progress)?) {
            *sum += factor * found.irradiance;
            rays += u64::from(found.rays);
        }
        *counters.entry("gathered_texels".into()).or_default() += self.len();
        *counters.entry("continuous_rays".into()).or_default() += rays;
        Ok(())
    }

    /// Adds to the light of all texels of the side what they take from the nodes: two lights that are kept apart [lux].
    pub fn spread(&self, side: &Side, light: [&[Rgb]; 2], sums: [&mut [Rgb]; 2]) {
        let [mut first, mut second] = sums;
        let parts = self.charts.iter().map(|chart| {
            let of_chart;
            (of_chart, first) = std::mem::take(&mut first).split_at_mut(chart.texels.len());
            let also;
            (also, second) = std::mem::take(&mut second).split_at_mut(chart.texels.len());
            (chart, [of_chart, also])
        });
        let parts: Vec<(&Chart, [&mut [Rgb]; 2])> = parts.collect();
        parts.into_par_iter().for_each(|(chart, sums)| chart.spread(self, side, light, sums));
    }
}

/// Texels of one chart follow each other.
fn runs(side: &Side) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    let mut last = None;
    for texel in 0..side.len() {
        let chart = Some(side.cell(texel).chart);
        match runs.last_mut().filter(|_| chart == last) {
            Some(run) => run.end = texel + 1,
            None => runs.push(texel..texel + 1),
        }
        last = chart;
    }
    runs
}

/// Sides of the cells, by chart.
fn strides(side: &Side, runs: &[Range<usize>]) -> Vec<u32> {
    // By chart, the cells that hold an open texel, for every side of the scale until there is one.
    let counts: Vec<Vec<usize>> = runs.par_iter().map(|run| counts(side, run)).collect();
    let chosen = |texels: f64| {
        let level = move |(run, counts): (&Range<usize>, &Vec<usize>)| {
            let most = 1 + (run.len() as f64 / texels) as usize;
            counts.iter().position(|count| *count <= most).unwrap_or(counts.len() - 1)
        };
        runs.iter().zip(&counts).map(level).collect::<Vec<usize>>()
    };
    let mut texels = 1.0;
    let mut levels = chosen(texels);
    let total = |levels: &[usize]| levels.iter().zip(&counts).map(|(level, counts)| counts[*level]).sum::<usize>();
    while total(&levels) > MOST && texels < side.len() as f64 {
        texels *= COARSER;
        levels = chosen(texels);
    }
    levels.into_iter().map(side_of).collect()
}

/// Sides of cells from the smallest on: 1, 2, 3, 4, 6, 8, 12, 16, 24 …
fn side_of(level: usize) -> u32 {
    match level {
        0 => 1,
        _ if level % 2 == 1 => 2 << (level / 2),
        _ => 3 << (level / 2 - 1),
    }
}

fn counts(side: &Side, run: &Range<usize>) -> Vec<usize> {
    let mut counts = Vec::new();
    // Every second side of the scale is twice another: a chart is looked at for the first of both kinds.
    let (mut even, mut odd) = (Occupied::new(side, run, side_of(0)), Occupied::new(side, run, side_of(2)));
    // No page is so large that the last of these is too small.
    for level in 0..32 {
        let occupied = if level == 0 || level % 2 == 1 { &mut even } else { &mut odd };
        if level != 0 && level != 2 {
            *occupied = occupied.halved();
        }
        counts.push(occupied.count());
        if occupied.cells.len() == 1 {
            break;
        }
    }
    counts
}

/// Which cells of a chart hold an open texel, row by row.
struct Occupied {
    width: usize,
    cells: Vec<bool>,
}

impl Occupied {
    fn new(side: &Side, run: &Range<usize>, stride: u32) -> Self {
        let (width, height) = extent(side, run, stride);
        let mut cells = vec![false; width * height];
        for texel in run.clone().filter(|texel| !side.buried[*texel]) {
            let at = side.cell(texel);
            cells[(at.y / stride) as usize * width + (at.x / stride) as usize] = true;
        }
        Self { width, cells }
    }

    /// Of cells that are twice as wide and high.
    fn halved(&self) -> Self {
        let width = self.width.div_ceil(2);
        let mut cells = vec![false; width * (self.cells.len() / self.width).div_ceil(2)];
        for (y, row) in self.cells.chunks(self.width).enumerate() {
            for (x, is) in row.iter().enumerate() {
                cells[y / 2 * width + x / 2] |= is;
            }
        }
        Self { width, cells }
    }

    fn count(&self) -> usize {
        self.cells.iter().filter(|is| **is).count()
    }
}

/// Cells of a chart in a row and in a column.
fn extent(side: &Side, run: &Range<usize>, stride: u32) -> (usize, usize) {
    let far = run.clone().map(|texel| side.cell(texel)).fold((0, 0), |(x, y), cell| (cell.x.max(x), cell.y.max(y)));
    ((far.0 / stride) as usize + 1, (far.1 / stride) as usize + 1)
}

impl Chart {
    fn new(side: &Side, is_cleared: bool, rays: &Rays, texels: Range<usize>, stride: u32) -> Self {
        let (width, height) = extent(side, &texels, stride);
        let mut candidates: Vec<Candidates> = vec![[(NONE, NONE); 5]; width * height];
        for texel in texels.clone().filter(|texel| !side.buried[*texel]) {
            let at = side.cell(texel);
            let cell = (at.y / stride) as usize * width + (at.x / stride) as usize;
            consider(&mut candidates[cell], texel as u32, [at.x, at.y], stride);
        }
        let mut chart =
            Self { texels, first: 0, stride, width, cells: Vec::new(), places: Vec::new(), receivers: Vec::new() };
        for list in candidates {
            let node = list.into_iter().filter(|(_, texel)| *texel != NONE).find_map(|(_, texel)| {
                let texel = texel as usize;
                let receiver = if is_cleared { Some(side.receiver(texel)) } else { side.cleared(rays, texel) };
                Some((texel, receiver?))
            });
            chart.cells.push(Cell { node: NONE, right: false, below: false });
            if let (Some((texel, receiver)), Some(cell)) = (node, chart.cells.last_mut()) {
                let at = side.cell(texel);
                cell.node = chart.receivers.len() as u32;
                chart.places.push([at.x, at.y]);
                chart.receivers.push(receiver);
            }
        }
        chart.link(rays);
        chart
    }

    fn link(&mut self, rays: &Rays) {
        for cell in 0..self.cells.len() {
            let is_last = (cell + 1).is_multiple_of(self.width);
            self.cells[cell].right = !is_last && self.are_joined(rays, cell, cell + 1);
            self.cells[cell].below = self.are_joined(rays, cell, cell + self.width);
        }
    }

    /// One smooth surface leads from the node of one cell to that of the other.
    fn are_joined(&self, rays: &Rays, a: usize, b: usize) -> bool {
        let node = |cell: usize| self.cells.get(cell).map(|c| c.node as usize).filter(|n| *n < self.receivers.len());
        let (Some(a), Some(b)) = (node(a), node(b)) else { return false };
        let ([ax, ay], [bx, by]) = (self.places[a], self.places[b]);
        let texels = ax.abs_diff(bx).max(ay.abs_diff(by)) as f32;
        let (a, b) = (&self.receivers[a], &self.receivers[b]);
        let distance = a.position.distance(b.position);
        if a.normal.dot(b.normal) < SMOOTH || distance > STRETCH * texels * a.footprint.max(b.footprint) {
            return false;
        }
        let lift = LIFT * distance;
        let from = a.position + a.normal * lift;
        let way = b.position + b.normal * lift - from;
        let length = way.length();
        length <= 0.0 || rays.transmittance(from, way / length, length).max_element() > CLEAR
    }

    /// The cell of a texel, and where the texel is.
    fn cell_of(&self, side: &Side, texel: usize) -> (usize, [u32; 2]) {
        let (at, stride) = (side.cell(texel), self.stride);
        ((at.y / stride) as usize * self.width + (at.x / stride) as usize, [at.x, at.y])
    }

    /// The next cell to the left (−1) or right (1), where the nodes are linked.
    fn beside(&self, cell: usize, step: i32) -> Option<usize> {
        match step {
            0 => Some(cell),
            1 => self.cells[cell].right.then(|| cell + 1),
            _ => (!cell.is_multiple_of(self.width) && self.cells[cell - 1].right).then(|| cell - 1),
        }
    }

    /// The same above and below.
    fn along(&self, cell: usize, step: i32) -> Option<usize> {
        match step {
            0 => Some(cell),
            1 => self.cells[cell].below.then(|| cell + self.width),
            _ => cell.checked_sub(self.width).filter(|above| self.cells[*above].below),
        }
    }

    /// The cell so many steps away, where linked nodes lead there over one of the two ways.
    fn towards(&self, cell: usize, x: i32, y: i32) -> Option<usize> {
        let first = self.beside(cell, x).and_then(|next| self.along(next, y));
        first.or_else(|| self.along(cell, y).and_then(|next| self.beside(next, x)))
    }

    fn spread(&self, nodes: &Nodes, side: &Side, light: [&[Rgb]; 2], [first, second]: [&mut [Rgb]; 2]) {
        for ((texel, first), second) in self.texels.clone().zip(first).zip(second).filter(|t| !nodes.buried[t.0.0]) {
            let (own, [x, y]) = self.cell_of(side, texel);
            let (mut sums, mut weights) = ([Rgb::ZERO; 2], 0.0);
            for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
                let Some(cell) = self.towards(own, dx, dy) else { continue };
                let node = self.cells[cell].node as usize;
                let [nx, ny] = self.places[node];
                let tent = |a: u32, b: u32| (1.0 - a.abs_diff(b) as f32 / self.stride as f32).max(0.0);
                let weight = tent(x, nx) * tent(y, ny);
                for (sum, light) in sums.iter_mut().zip(light) {
                    *sum += light[self.first + node] * weight;
                }
                weights += weight;
            }
            // The own node is nearer than a cell is wide, so its weight is not nothing.
            *first += sums[0] / weights;
            *second += sums[1] / weights;
        }
    }
}

/// Takes a texel for a candidate where it is nearer to what is wanted than the one before; the first of equals stays.
fn consider(list: &mut Candidates, texel: u32, [x, y]: [u32; 2], stride: u32) {
    // In quarters of a texel, from the middle of the cell.
    let offset = |v: u32| 4 * (v % stride) as i32 + 2 - 2 * stride as i32;
    let (dx, dy) = (offset(x), offset(y));
    let quarter = usize::from(dx > 0) + 2 * usize::from(dy > 0);
    let from = |d: i32| d.abs().abs_diff(stride as i32);
    let offers = [(0, dx.unsigned_abs(), dy.unsigned_abs()), (1 + quarter, from(dx), from(dy))];
    for (slot, dx, dy) in offers {
        let distance = dx * dx + dy * dy;
        if distance < list[slot].0 {
            list[slot] = (distance, texel);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_atlas::{Atlas, AtlasSettings, InProcess, build};
    use luxel_scene::{Scene, Silent, build::Builder};
    use luxel_transport::geometry::Geometry;

    /// A floor of 2 × 1, with a wall across it at x = 1 or without one.
    fn floor(wall: bool) -> Scene {
        let mut b = Builder::new("floor");
        let grey = b.matte(Vec3::splat(0.5));
        b.quad("floor", Vec3::ZERO, Vec3::Z, Vec3::X * 2.0, grey);
        if wall {
            let wall = b.cuboid("wall", Vec3::new(0.99, 0.0, -0.1), Vec3::new(1.01, 1.0, 1.1), grey, false);
            b.scene_mut().instances[wall].receives = false;
        }
        b.build()
    }

    fn atlas(scene: &Scene, size: u32) -> Atlas {
        build(scene, &AtlasSettings { size, ..AtlasSettings::default() }, &InProcess, &Silent).unwrap().0
    }

    /// Light at all open texels with their places, from that at the nodes.
    fn spread(scene: &Scene, size: u32, light: impl Fn(Vec3) -> f32) -> (Nodes, Vec<(Vec3, f32)>) {
        let (geometry, atlas) = (Geometry::new(scene), atlas(scene, size));
        let (rays, side) = (Rays::new(&geometry), Side::front(&geometry, &atlas));
        let nodes = Nodes::new(&side, false, &rays, &Silent).unwrap();
        let place = |receiver: &Receiver| geometry.frame.world(receiver.position).as_vec3();
        let at_nodes: Vec<Rgb> = nodes.receivers.iter().map(|r| Rgb::splat(light(place(r)))).collect();
        let twice: Vec<Rgb> = at_nodes.iter().map(|light| *light * 2.0).collect();
        let (mut found, mut doubled) = (vec![Rgb::ZERO; side.len()], vec![Rgb::ONE; side.len()]);
        nodes.spread(&side, [&at_nodes, &twice], [&mut found, &mut doubled]);
        let open = || (0..side.len()).filter(|i| !nodes.buried[*i]);
        assert!(open().all(|i| doubled[i] == found[i] * 2.0 + Rgb::ONE));
        let texels = open().map(|i| (place(&side.receiver(i)), found[i].x)).collect();
        (nodes, texels)
    }

    #[test]
    fn cells_are_counted_alike_at_every_side() {
        let scene = floor(false);
        let (geometry, atlas) = (Geometry::new(&scene), atlas(&scene, 96));
        let mut side = Side::front(&geometry, &atlas);
        side.buried.iter_mut().step_by(7).for_each(|buried| *buried = true);
        let run = runs(&side).remove(0);
        let counts = counts(&side, &run);
        let direct = |level: usize| Occupied::new(&side, &run, side_of(level)).count();
        assert_eq!(counts, (0..counts.len()).map(direct).collect::<Vec<_>>());
        assert_eq!(counts.last(), Some(&1));
    }

    #[test]
    fn a_small_map_is_gathered_at_every_texel() {
        let slope = |p: Vec3| 1.0 + p.x + 3.0 * p.z;
        let (nodes, texels) = spread(&floor(false), 64, slope);
        assert_eq!(nodes.receivers.len(), texels.len());
        assert!(texels.iter().all(|(p, e)| (e - slope(*p)).abs() < 1e-3));
    }

    #[test]
    fn a_large_one_keeps_to_its_nodes_and_to_the_light() {
        let even = spread(&floor(false), 512, |_| 7.0);
        assert!(even.1.iter().all(|(_, e)| (e - 7.0).abs() < 1e-5));
        assert!((MOST / 2..=MOST).contains(&even.0.receivers.len()), "{}", even.0.receivers.len());
        let slope = |p: Vec3| 1.0 + p.x + 3.0 * p.z;
        let (nodes, texels) = spread(&floor(false), 512, slope);
        // Nobody takes light from further away than a cell is wide.
        let cell = nodes.charts[0].stride as f32 * (2.0 / texels.len() as f32).sqrt();
        let worst = texels.iter().map(|(p, e)| (e - slope(*p)).abs()).fold(0.0, f32::max);
        assert!(worst < 4.0 * cell, "{worst} of {cell}");
        let mean = texels.iter().map(|(p, e)| f64::from(e - slope(*p))).sum::<f64>() / texels.len() as f64;
        assert!(mean.abs() < 0.02 * f64::from(cell), "{mean} of {cell}");
    }

    #[test]
    fn no_light_goes_through_a_wall_that_stands_on_the_floor() {
        let (nodes, texels) = spread(&floor(true), 512, |p| if p.x < 1.0 { 5.0 } else { 0.0 });
        let cell = nodes.charts[0].stride as f32 * (2.0 / texels.len() as f32).sqrt();
        let beyond: Vec<_> = texels.iter().filter(|(p, _)| p.x > 1.01 + cell).collect();
        assert!(beyond.len() > 1000 && beyond.iter().all(|(_, e)| *e == 0.0));
        let before: Vec<_> = texels.iter().filter(|(p, _)| p.x < 0.99 - cell).collect();
        assert!(before.len() > 1000 && before.iter().all(|(_, e)| (*e - 5.0).abs() < 1e-5));
    }

    #[test]
    fn cells_grow_by_halves() {
        assert_eq!((0..9).map(side_of).collect::<Vec<_>>(), [1, 2, 3, 4, 6, 8, 12, 16, 24]);
        assert!(side_of(31) > 1 << 15);
    }
}

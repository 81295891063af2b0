//! Adaptive nodes: indirect light is smooth nearly everywhere, so a gather is evaluated at few texels of a chart and
//! interpolated between them.
//!
//! Node lines run every `stride` texels, with an extra line stride/4 inside the chart's border, because irradiance is
//! concave towards corners and chords lie below it. A patch between four nodes is interpolated bilinearly when all four
//! exist, lie on one smooth surface and differ by less than `refine` of their largest; otherwise it is halved, down to
//! single texels. All patches of a level are gathered together, so the work stays parallel and its order fixed. When all
//! nodes are known, one pass averages each with its neighbours where they agree, before anything is interpolated.

use luxel_scene::{Cancelled, Progress, watched};
use rayon::prelude::*;

use super::{
    Gather, Gathered, Receiver,
    smooth::{Place, Smoothing},
};

/// Least cosine between the normals of two nodes of a patch.
const SMOOTH: f32 = 0.9;

/// Longest distance between neighbouring nodes, in texels between them: beyond it the chart has a gap.
const STRETCH: f32 = 3.0;

/// Where a receiver lies in its chart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cell {
    pub chart: u32,
    pub x: u32,
    pub y: u32,
}

/// How far nodes are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeSettings {
    /// Texels between node lines.
    pub stride: u32,
    /// Largest difference between the nodes of a patch, as a share of the largest.
    pub refine: f32,
}

impl Default for NodeSettings {
    fn default() -> Self {
        Self { stride: 4, refine: 0.2 }
    }
}

/// Light at all receivers, and how many of them were really gathered.
#[derive(Clone, Debug, Default)]
pub struct Interpolated {
    pub light: Vec<Gathered>,
    pub nodes: usize,
}

/// Gathers at nodes and interpolates between them. `cells` has the place of every receiver; the receivers of a chart
/// follow each other. An interpolated bound is that of the nodes plus half of what they differ by: an estimate.
pub fn interpolate(
    gather: &dyn Gather,
    settings: NodeSettings,
    receivers: &[Receiver],
    cells: &[Cell],
    progress: &dyn Progress,
) -> Result<Interpolated, Cancelled> {
    assert_eq!(receivers.len(), cells.len(), "every receiver has a place");
    progress.check()?;
    let charts = charts(cells);
    progress.check()?;
    let mut nodes =
        Nodes { receivers, light: vec![Gathered::default(); cells.len()], state: vec![State::Empty; cells.len()] };
    let mut patches: Vec<Patch> = Vec::new();
    for (chart, grid) in (0u32..).zip(&charts) {
        let (xs, ys) = (spans(grid.width, settings.stride), spans(grid.height, settings.stride));
        patches.extend(ys.iter().flat_map(|&y| xs.iter().map(move |&x| Patch { chart, x, y })));
    }
    let (mut gathered, mut settled) = (0, Vec::new());
    while !patches.is_empty() {
        gathered += nodes.gather(gather, &charts, &patches, progress)?;
        patches = nodes.settle(&charts, patches, settings.refine, &mut settled, progress)?;
    }
    nodes.smooth(&charts, settings, progress)?;
    for item in watched(&settled, progress) {
        let (patch, corners) = item?;
        nodes.fill(&charts[patch.chart as usize], patch, *corners);
    }
    gathered += nodes.gather_rest(gather, progress)?;
    progress.advance((receivers.len() - gathered) as u64);
    Ok(Interpolated { light: nodes.light, nodes: gathered })
}

/// The texels of one chart as a grid.
struct Grid {
    width: u32,
    height: u32,
    /// Receiver of each texel, row by row.
    index: Vec<Option<u32>>,
}

/// A rectangle of texels with nodes in its corners, both ends included.
#[derive(Clone, Copy)]
struct Patch {
    chart: u32,
    x: (u32, u32),
    y: (u32, u32),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Empty,
    Interpolated,
    Gathered,
}

struct Nodes<'a> {
    receivers: &'a [Receiver],
    light: Vec<Gathered>,
    state: Vec<State>,
}

impl Grid {
    fn at(&self, x: u32, y: u32) -> Option<usize> {
        self.index[(y * self.width + x) as usize].map(|i| i as usize)
    }

    fn corners(&self, patch: &Patch) -> [Option<usize>; 4] {
        let ((x0, x1), (y0, y1)) = (patch.x, patch.y);
        [self.at(x0, y0), self.at(x1, y0), self.at(x0, y1), self.at(x1, y1)]
    }

    /// The corners, where none is missing.
    fn whole(&self, patch: &Patch) -> Option<[usize; 4]> {
        let [a, b, c, d] = self.corners(patch);
        Some([a?, b?, c?, d?])
    }

    /// The texel at a place that may lie outside.
    fn find(&self, x: i64, y: i64) -> Option<usize> {
        let (x, y) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?);
        if x < self.width && y < self.height { self.at(x, y) } else { None }
    }
}

impl Nodes<'_> {
    /// Gathers all corners that are not gathered yet; returns how many there were.
    fn gather(
        &mut self,
        gather: &dyn Gather,
        charts: &[Grid],
        patches: &[Patch],
        progress: &dyn Progress,
    ) -> Result<usize, Cancelled> {
        let mut wanted = Vec::new();
        for patch in watched(patches, progress) {
            let patch = patch?;
            for i in charts[patch.chart as usize].corners(patch).into_iter().flatten() {
                if self.state[i] != State::Gathered {
                    self.state[i] = State::Gathered;
                    wanted.push(i);
                }
            }
        }
        self.gather_all(gather, &wanted, progress)
    }

    /// Every texel of a grid lies in a patch; receivers that share their place with another one are in no grid.
    fn gather_rest(&mut self, gather: &dyn Gather, progress: &dyn Progress) -> Result<usize, Cancelled> {
        let rest: Vec<usize> = (0..self.state.len()).filter(|&i| self.state[i] == State::Empty).collect();
        self.gather_all(gather, &rest, progress)
    }

    fn gather_all(
        &mut self,
        gather: &dyn Gather,
        wanted: &[usize],
        progress: &dyn Progress,
    ) -> Result<usize, Cancelled> {
        let receiver = |i: Result<&usize, Cancelled>| i.map(|i| self.receivers[*i]);
        let receivers = watched(wanted, progress).map(receiver).collect::<Result<Vec<Receiver>, Cancelled>>()?;
        for (i, light) in wanted.iter().zip(gather.gather(&receivers, progress)?) {
            self.light[*i] = light;
        }
        Ok(wanted.len())
    }

    /// Puts the patches that may be interpolated aside and halves the others.
    fn settle(
        &self,
        charts: &[Grid],
        patches: Vec<Patch>,
        refine: f32,
        settled: &mut Vec<(Patch, [usize; 4])>,
        progress: &dyn Progress,
    ) -> Result<Vec<Patch>, Cancelled> {
        let mut next = Vec::new();
        for patch in watched(patches, progress) {
            let patch = patch?;
            match self.smooth_corners(&charts[patch.chart as usize], &patch, refine) {
                Some(corners) => settled.push((patch, corners)),
                None => next.extend(halves(&patch)),
            }
        }
        Ok(next)
    }

    /// Smooths all nodes, each from what was gathered.
    fn smooth(&mut self, charts: &[Grid], settings: NodeSettings, progress: &dyn Progress) -> Result<(), Cancelled> {
        let joined = |a: usize, b: usize, texels: u32| self.joined(a, b, texels);
        let smoothed = charts
            .par_iter()
            .map(|grid| {
                let at = |x: i64, y: i64| match grid.find(x, y) {
                    Some(i) if self.state[i] == State::Gathered => Place::Node(i),
                    Some(_) => Place::Between,
                    None => Place::Nothing,
                };
                let how = Smoothing { at: &at, joined: &joined, reach: settings.stride, alike: settings.refine };
                let node = |[x, y]: [i64; 2]| match at(x, y) {
                    Place::Node(i) => Some((i, how.smoothed(&self.light, i, [x, y]))),
                    _ => None,
                };
                let mut nodes = Vec::new();
                for y in 0..grid.height {
                    progress.check()?;
                    nodes.extend((0..grid.width).filter_map(|x| node([x.into(), y.into()])));
                }
                Ok(nodes)
            })
            .collect::<Result<Vec<Vec<(usize, Gathered)>>, Cancelled>>()?;
        for (i, light) in smoothed.into_iter().flatten() {
            self.light[i] = light;
        }
        Ok(())
    }

    /// Two receivers lie on one smooth surface, so many texels apart.
    fn joined(&self, a: usize, b: usize, texels: u32) -> bool {
        let (a, b) = (&self.receivers[a], &self.receivers[b]);
        let reach = STRETCH * texels as f32 * a.footprint.max(b.footprint);
        a.normal.dot(b.normal) >= SMOOTH && a.position.distance(b.position) <= reach
    }

    /// The corners of a patch that may be interpolated.
    fn smooth_corners(&self, grid: &Grid, patch: &Patch, refine: f32) -> Option<[usize; 4]> {
        let corners = grid.whole(patch)?;
        let light = corners.map(|i| self.light[i].irradiance);
        let (low, high) = (light.into_iter().reduce(|a, b| a.min(b))?, light.into_iter().reduce(|a, b| a.max(b))?);
        let (width, height) = (patch.x.1 - patch.x.0, patch.y.1 - patch.y.0);
        let [a, b, c, d] = corners;
        let whole = self.joined(a, b, width)
            && self.joined(c, d, width)
            && self.joined(a, c, height)
            && self.joined(b, d, height);
        let alike = (high - low).max_element() <= refine * high.element_sum() / 3.0;
        (whole && alike).then_some(corners)
    }

    /// Bilinear interpolation of all texels of a patch that are no nodes.
    fn fill(&mut self, grid: &Grid, patch: &Patch, corners: [usize; 4]) {
        let [a, b, c, d] = corners.map(|i| self.light[i]);
        let share = |v: u32, (v0, v1): (u32, u32)| if v1 > v0 { (v - v0) as f32 / (v1 - v0) as f32 } else { 0.0 };
        let light = [a, b, c, d].map(|g| g.irradiance);
        let mean = light.map(|e| e.element_sum() / 3.0);
        let spread = mean.into_iter().fold(0.0, f32::max) - mean.into_iter().fold(f32::INFINITY, f32::min);
        let bound = [a, b, c, d].map(|g| g.bound).into_iter().fold(0.0, f32::max) + 0.5 * spread;
        for y in patch.y.0..=patch.y.1 {
            for x in patch.x.0..=patch.x.1 {
                let Some(i) = grid.at(x, y).filter(|&i| self.state[i] == State::Empty) else { continue };
                let (s, t) = (share(x, patch.x), share(y, patch.y));
                let irradiance = light[0].lerp(light[1], s).lerp(light[2].lerp(light[3], s), t);
                self.light[i] = Gathered { irradiance, bound, rays: 0, cut: 0 };
                self.state[i] = State::Interpolated;
            }
        }
    }
}

/// A patch cut in two along every side that is longer than one step. Nothing of a single step: its nodes are all there is.
fn halves(patch: &Patch) -> impl Iterator<Item = Patch> + use<> {
    let parts = |(a, b): (u32, u32)| {
        let middle = a + (b - a) / 2;
        if b - a > 1 { [Some((a, middle)), Some((middle, b))] } else { [Some((a, b)), None] }
    };
    let divisible = patch.x.1 - patch.x.0 > 1 || patch.y.1 - patch.y.0 > 1;
    let (xs, ys, chart) = (parts(patch.x), parts(patch.y), patch.chart);
    let all = ys.into_iter().flatten().flat_map(move |y| xs.into_iter().flatten().map(move |x| Patch { chart, x, y }));
    all.filter(move |_| divisible)
}

/// The spans between node lines over a side of `size` texels.
fn spans(size: u32, stride: u32) -> Vec<(u32, u32)> {
    let (last, stride) = (size.saturating_sub(1), stride.max(1));
    let inset = stride / 4;
    let mut lines: Vec<u32> = (0..size).step_by(stride as usize).collect();
    lines.extend([last, inset.min(last), last.saturating_sub(inset)]);
    lines.sort_unstable();
    lines.dedup();
    match lines[..] {
        [only] => vec![(only, only)],
        _ => lines.windows(2).map(|w| (w[0], w[1])).collect(),
    }
}

fn charts(cells: &[Cell]) -> Vec<Grid> {
    let mut first = 0u32;
    cells
        .chunk_by(|a, b| a.chart == b.chart)
        .map(|run| {
            let span = |of: fn(&Cell) -> u32| {
                let values = || run.iter().map(of);
                (values().min().unwrap_or(0), values().max().unwrap_or(0))
            };
            let ((x0, x1), (y0, y1)) = (span(|c| c.x), span(|c| c.y));
            let (width, height) = (x1 - x0 + 1, y1 - y0 + 1);
            let mut index = vec![None; width as usize * height as usize];
            for (i, cell) in (first..).zip(run) {
                index[((cell.y - y0) * width + cell.x - x0) as usize] = Some(i);
            }
            first += run.len() as u32;
            Grid { width, height, index }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rgb;
    use glam::Vec3;
    use luxel_scene::Silent;

    /// Light as a function of the place.
    struct Analytic<F>(F);

    impl<F: Fn(Vec3) -> f32 + Sync> Gather for Analytic<F> {
        fn gather(&self, receivers: &[Receiver], _: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
            let at = |r: &Receiver| Gathered { irradiance: Rgb::splat(self.0(r.position)), ..Gathered::default() };
            Ok(receivers.iter().map(at).collect())
        }
    }

    /// Texels of flat charts, those that `keep` wants.
    fn texels(charts: u32, size: u32, keep: impl Fn(u32, u32) -> bool) -> (Vec<Receiver>, Vec<Cell>) {
        let mut out = (Vec::new(), Vec::new());
        for chart in 0..charts {
            for (y, x) in (0..size).flat_map(|y| (0..size).map(move |x| (y, x))).filter(|&(y, x)| keep(x, y)) {
                let position = Vec3::new(x as f32, y as f32, 100.0 * chart as f32);
                out.0.push(Receiver {
                    position,
                    normal: Vec3::Z,
                    shading_normal: Vec3::Z,
                    footprint: 1.0,
                    seed: u64::from(chart),
                });
                out.1.push(Cell { chart, x: x + 7, y: y + 3 });
            }
        }
        out
    }

    fn worst(light: &[Gathered], receivers: &[Receiver], exact: impl Fn(Vec3) -> f32) -> f32 {
        let off = |(g, r): (&Gathered, &Receiver)| (g.irradiance.x - exact(r.position)).abs();
        light.iter().zip(receivers).map(off).fold(0.0, f32::max)
    }

    #[test]
    fn bilinear_light_is_exact_from_few_nodes() {
        let (receivers, cells) = texels(3, 65, |_, _| true);
        let exact = |p: Vec3| 100.0 + p.x + 0.5 * p.y + 0.01 * p.x * p.y;
        let settings = NodeSettings { stride: 8, refine: 0.2 };
        let found = interpolate(&Analytic(exact), settings, &receivers, &cells, &Silent).unwrap();
        assert!(worst(&found.light, &receivers, exact) < 1e-3);
        assert!(found.nodes < receivers.len() / 20, "{} of {}", found.nodes, receivers.len());
    }

    #[test]
    fn an_edge_of_light_is_followed_texel_by_texel() {
        let (receivers, cells) = texels(1, 65, |_, _| true);
        let exact = |p: Vec3| if p.x + 0.3 * p.y < 30.0 { 10.0 } else { 1.0 };
        let found = interpolate(&Analytic(exact), NodeSettings::default(), &receivers, &cells, &Silent).unwrap();
        assert!(worst(&found.light, &receivers, exact) < 1e-5);
        assert!(found.nodes < receivers.len() / 2, "{}", found.nodes);
    }

    #[test]
    fn a_curved_light_is_as_good_as_the_spacing_of_its_nodes() {
        let (receivers, cells) = texels(1, 64, |_, _| true);
        let exact = |p: Vec3| 10.0 + 3.0 * libm::sinf(p.x / 12.0) * libm::cosf(p.y / 15.0);
        let error = |stride| {
            let settings = NodeSettings { stride, refine: 1.0 };
            let found = interpolate(&Analytic(exact), settings, &receivers, &cells, &Silent).unwrap();
            worst(&found.light, &receivers, exact)
        };
        // A chord of length s lies at most s²/8 of the curvature below: 3/12² · 16/8 in x, and less in y. Where a border
        // leaves three nodes on a line, smoothing adds at most their cubic error, s·s·2s/6 of the third derivative.
        let most = |s: f32| (3.0 / 144.0 + 3.0 / 225.0) * s * s / 8.0 + 3.0 / 1728.0 * s * s * s / 3.0;
        assert!(error(4) < most(4.0) && error(8) < most(8.0), "{} {}", error(4), error(8));
        assert!(error(4) < 0.5 * error(8), "{} {}", error(4), error(8));
    }

    #[test]
    fn holes_and_odd_shapes_leave_no_texel_out() {
        // A disc with a hole and a cut, charts of one texel, one row, and nothing at all.
        let exact = |p: Vec3| 50.0 + p.x - p.y;
        type Shape = fn(u32, u32) -> bool;
        let shapes: [Shape; 5] = [
            |x, y| {
                let square = (x as i32 - 20).pow(2) + (y as i32 - 20).pow(2);
                square < 380 && square > 30 && x != 23
            },
            |x, y| (x, y) == (4, 9),
            |_, y| y == 3,
            |x, y| x == y,
            |_, _| false,
        ];
        for shape in shapes {
            let (receivers, cells) = texels(2, 41, shape);
            let found = interpolate(&Analytic(exact), NodeSettings::default(), &receivers, &cells, &Silent).unwrap();
            assert!(worst(&found.light, &receivers, exact) < 1e-3);
            assert!(found.nodes <= receivers.len());
            // Two receivers at one place both get light.
            let cells = vec![Cell { chart: 0, x: 0, y: 0 }; cells.len()];
            let found = interpolate(&Analytic(exact), NodeSettings::default(), &receivers, &cells, &Silent).unwrap();
            assert_eq!((worst(&found.light, &receivers, exact), found.nodes), (0.0, receivers.len()));
        }
    }

    #[test]
    fn nothing_is_interpolated_across_a_fold_or_a_gap() {
        let (mut receivers, cells) = texels(1, 33, |_, _| true);
        // Half of the chart is far away and looks sideways; its light is its own.
        for r in &mut receivers {
            if r.position.x > 13.0 {
                r.position.z = 500.0;
                r.normal = Vec3::X;
            }
        }
        let exact = |p: Vec3| if p.z > 100.0 { 10.0 + p.y } else { 11.0 + p.y };
        let found = interpolate(&Analytic(exact), NodeSettings::default(), &receivers, &cells, &Silent).unwrap();
        assert!(worst(&found.light, &receivers, exact) < 1e-3);
    }
}

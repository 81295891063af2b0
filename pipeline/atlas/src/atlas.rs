//! The result of unwrapping and packing: where every texel of every instance is.

use glam::Vec2;

/// Texels of a whole scene. Deterministic: the same scene and settings give the same bytes.
#[derive(Clone, Debug, Default)]
pub struct Atlas {
    pub pages: Vec<Page>,
    /// One entry per scene instance; None where the instance does not receive.
    pub placed: Vec<Option<Placed>>,
    pub charts: Vec<Chart>,
    /// Grouped by chart in chart order, row-major within a chart; every texel that a triangle covers at least in
    /// part, none twice.
    pub texels: Vec<Texel>,
}

impl Atlas {
    pub fn chart(&self, texel: &Texel) -> &Chart {
        &self.charts[texel.chart as usize]
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    pub width: u32,
    pub height: u32,
}

/// The unwrapped copy of one instance's mesh, in atlas space.
#[derive(Clone, Debug)]
pub struct Placed {
    pub page: u32,
    /// For each new vertex the vertex of the mesh that it copies (seams split vertices).
    pub source: Vec<u32>,
    /// Atlas coordinates of each new vertex in \[0, 1\]², (0,0) the upper left corner of the page.
    pub uvs: Vec<Vec2>,
    /// The mesh's triangles, in the mesh's order, over the new vertices.
    pub triangles: Vec<[u32; 3]>,
}

/// One connected patch of the unwrap, placed on a page.
#[derive(Clone, Debug)]
pub struct Chart {
    pub instance: u32,
    pub page: u32,
    /// Bounding rectangle in texels, padding not included.
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
    /// Quarter turns from the chart's own axes to those of the page.
    pub turn: u8,
    /// Its run in [`Atlas::texels`].
    pub first_texel: u32,
    pub texels: u32,
    /// Stable identity of the chart: hash of mesh content, chart number and instance name, not of its place on the page.
    pub seed: u64,
}

impl Chart {
    /// The identity of one of the chart's texels: its cell in the chart's own axes mixed with the chart's seed, stable
    /// under re-packing. The texel is given by its place on the page.
    pub fn texel_seed(&self, x: u16, y: u16) -> u64 {
        let (x, y) = (u32::from(x).wrapping_sub(self.x), u32::from(y).wrapping_sub(self.y));
        let (right, bottom) = (self.width.wrapping_sub(1), self.height.wrapping_sub(1));
        let (i, j) = match self.turn {
            0 => (x, y),
            1 => (y, right.wrapping_sub(x)),
            2 => (right.wrapping_sub(x), bottom.wrapping_sub(y)),
            _ => (bottom.wrapping_sub(y), x),
        };
        mixed(self.seed, i, j)
    }
}

/// SplitMix64 (Steele, Lea & Flood 2014) over the chart's seed and the cell.
fn mixed(seed: u64, i: u32, j: u32) -> u64 {
    let mut z = seed.wrapping_add((u64::from(j) << 32 | u64::from(i)).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// One lightmap texel that lies at least partly on its chart: 24 bytes, because a large atlas has millions of them.
/// Page and instance are those of its chart; its identity is [`Chart::texel_seed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    pub x: u16,
    pub y: u16,
    pub chart: u32,
    /// Triangle of the instance's mesh that holds the sample point.
    pub triangle: u32,
    /// In 2⁻²⁴, the step of the f32 below one, low byte first.
    barycentric: [[u8; 3]; 2],
    coverage: u16,
    footprint: f32,
}

/// Steps of a barycentric coordinate from 0 to 1.
const STEPS: f32 = 16_777_216.0;

impl Texel {
    /// A texel that is still to be given to its chart. `coverage` lies in (0, 1], `footprint` in scene units.
    pub(crate) fn new([x, y]: [u16; 2], triangle: u32, [u, v]: [f32; 2], coverage: f32, footprint: f32) -> Self {
        let coverage = (coverage.clamp(0.0, 1.0) * f32::from(u16::MAX)).round().max(1.0);
        // Exact but for the last bits of coordinates below one half; their sum stays at most 1.
        let u_steps = ((u * STEPS) as u32).min(STEPS as u32 - 1);
        let v_steps = ((v * STEPS) as u32).min(STEPS as u32 - 1).min(STEPS as u32 - u_steps);
        let barycentric = [u_steps, v_steps].map(|steps| {
            let [low, middle, high, _] = steps.to_le_bytes();
            [low, middle, high]
        });
        Self { x, y, chart: 0, triangle, barycentric, coverage: coverage as u16, footprint }
    }

    /// Barycentric coordinates of the sample point at the second and third corner of its triangle, each in \[0, 1)
    /// and together at most 1. The point is the texel's centre, or the nearest point of the chart where the centre
    /// lies outside.
    pub fn barycentric(&self) -> [f32; 2] {
        self.barycentric.map(|[low, middle, high]| u32::from_le_bytes([low, middle, high, 0]) as f32 / STEPS)
    }

    /// Share of the texel's square that its chart covers, in (0, 1].
    pub fn coverage(&self) -> f32 {
        f32::from(self.coverage) / f32::from(u16::MAX)
    }

    /// World length of the texel's side, as the square root of its world area [scene units].
    pub fn footprint(&self) -> f32 {
        self.footprint
    }
}

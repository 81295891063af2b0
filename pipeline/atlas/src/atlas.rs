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
    /// Its run in [`Atlas::texels`].
    pub first_texel: u32,
    pub texels: u32,
    /// Stable identity of the chart: hash of mesh content, chart number and instance name, not of its place on the page.
    pub seed: u64,
}

/// One lightmap texel that lies at least partly on its chart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    pub x: u16,
    pub y: u16,
    pub page: u16,
    pub chart: u32,
    pub instance: u32,
    /// Triangle of the instance's mesh that holds the sample point, and barycentric coordinates of its second and
    /// third corner. The point is the texel's centre, or the nearest point of the chart where the centre lies outside.
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    /// Share of the texel's square that its chart covers, in (0, 1].
    pub coverage: f32,
    /// World length of the texel's side, as the square root of its world area [scene units].
    pub footprint: f32,
    /// Chart-local cell mixed with the chart's seed: stable under re-packing.
    pub seed: u64,
}

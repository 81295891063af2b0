//! The unwrap of one mesh: an artefact of its own, keyed by the mesh's content and shared by all its instances.

use std::collections::HashMap;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use crate::mesh::Solid;

/// A triangle without a chart: no area, or not finite.
pub const NO_CHART: u32 = u32::MAX;

/// Charts of a mesh in object units, before any packing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Charts {
    /// For each new vertex the vertex of the mesh that it copies.
    pub source: Vec<u32>,
    /// Place of each new vertex in its chart [object units]; the chart's lower corner is the origin.
    pub uvs: Vec<[f32; 2]>,
    /// Chart of each new vertex; [`NO_CHART`] where only triangles without a chart use it.
    pub vertex_chart: Vec<u32>,
    /// The mesh's triangles, in the mesh's order, over the new vertices.
    pub triangles: Vec<[u32; 3]>,
    /// Chart of each triangle, or [`NO_CHART`].
    pub chart_of: Vec<u32>,
    /// Number of charts.
    pub charts: u32,
    /// What the unwrapper could not flatten: reason and number of triangles that were projected instead.
    pub fallbacks: Vec<(String, u32)>,
}

impl Charts {
    /// Whether lengths and indices agree with each other and with a mesh of so many vertices and triangles: to be
    /// asked of everything that comes from a file.
    pub fn is_consistent(&self, vertices: usize, triangles: usize) -> bool {
        let n = self.source.len();
        let chart_ok = |c: &u32| *c == NO_CHART || *c < self.charts;
        self.uvs.len() == n
            && self.vertex_chart.len() == n
            && self.triangles.len() == triangles
            && self.chart_of.len() == triangles
            && self.charts as usize <= triangles
            && self.source.iter().all(|&v| (v as usize) < vertices)
            && self.uvs.iter().flatten().all(|c| c.is_finite() && *c >= 0.0)
            && self.triangles.iter().flatten().all(|&v| (v as usize) < n)
            && self.vertex_chart.iter().chain(&self.chart_of).all(chart_ok)
            && self.triangles.iter().zip(&self.chart_of).all(|(corners, &chart)| {
                chart == NO_CHART || corners.iter().all(|&v| self.vertex_chart[v as usize] == chart)
            })
    }

    /// Whether every unwrap of the mesh gives these charts: not where its worker died or took too long over a piece.
    pub fn is_reproducible(&self) -> bool {
        self.fallbacks.iter().all(|(why, _)| !why.starts_with(crate::worker::FAILED))
    }

    /// Triangles of each chart, ascending.
    pub(crate) fn members(&self) -> Vec<Vec<u32>> {
        let mut members = vec![Vec::new(); self.charts as usize];
        for (t, &chart) in self.chart_of.iter().enumerate() {
            if chart != NO_CHART {
                members[chart as usize].push(t as u32);
            }
        }
        members
    }
}

/// Charts while they are found, corner by corner.
pub(crate) struct Corners {
    chart_of: Vec<u32>,
    uvs: Vec<[DVec2; 3]>,
    charts: u32,
    fallbacks: Vec<(String, u32)>,
}

impl Corners {
    pub fn new(triangles: usize) -> Self {
        Self {
            chart_of: vec![NO_CHART; triangles],
            uvs: vec![[DVec2::ZERO; 3]; triangles],
            charts: 0,
            fallbacks: Vec::new(),
        }
    }

    pub fn add_chart(&mut self, triangles: &[u32], uvs: &[[DVec2; 3]]) {
        for (&t, uv) in triangles.iter().zip(uvs) {
            self.chart_of[t as usize] = self.charts;
            self.uvs[t as usize] = *uv;
        }
        self.charts += 1;
    }

    pub fn fallback(&mut self, triangles: usize, why: &str) {
        match self.fallbacks.iter_mut().find(|(reason, _)| reason == why) {
            Some((_, count)) => *count += triangles as u32,
            None => self.fallbacks.push((why.into(), triangles as u32)),
        }
    }

    /// Numbers charts by their first triangles and joins corners into vertices.
    pub fn finish(self, solid: &Solid) -> Charts {
        let mut out = Charts { charts: self.charts, fallbacks: self.fallbacks, ..Charts::default() };
        let mut renumbered = vec![NO_CHART; self.charts as usize];
        let mut next = 0;
        let mut vertices: HashMap<(u32, u32, [u32; 2]), u32> = HashMap::new();
        let mut any_copy = vec![u32::MAX; solid.mesh.positions.len()];
        for (t, triangle) in solid.mesh.triangles.iter().enumerate() {
            let old = self.chart_of[t];
            if old == NO_CHART {
                out.chart_of.push(NO_CHART);
                out.triangles.push([0; 3]);
                continue;
            }
            let chart = &mut renumbered[old as usize];
            if *chart == NO_CHART {
                *chart = next;
                next += 1;
            }
            let corners = [0, 1, 2].map(|k| {
                let uv = self.uvs[t][k].max(DVec2::ZERO).as_vec2().to_array();
                let fresh = out.source.len() as u32;
                let vertex = *vertices.entry((*chart, triangle[k], uv.map(f32::to_bits))).or_insert(fresh);
                if vertex == fresh {
                    out.source.push(triangle[k]);
                    out.uvs.push(uv);
                    out.vertex_chart.push(*chart);
                }
                any_copy[triangle[k] as usize] = any_copy[triangle[k] as usize].min(vertex);
                vertex
            });
            out.chart_of.push(*chart);
            out.triangles.push(corners);
        }
        out.place_leftovers(solid, &mut any_copy);
        out
    }
}

impl Charts {
    /// Triangles without a chart use the copies that their vertices have elsewhere, or lone copies.
    fn place_leftovers(&mut self, solid: &Solid, any_copy: &mut [u32]) {
        for (t, triangle) in solid.mesh.triangles.iter().enumerate() {
            if self.chart_of[t] != NO_CHART {
                continue;
            }
            self.triangles[t] = triangle.map(|v| {
                // An index out of range cannot be copied; the scene promises that there is none.
                let v = (v as usize).min(any_copy.len().saturating_sub(1));
                if any_copy[v] == u32::MAX {
                    any_copy[v] = self.source.len() as u32;
                    self.source.push(v as u32);
                    self.uvs.push([0.0; 2]);
                    self.vertex_chart.push(NO_CHART);
                }
                any_copy[v]
            });
        }
    }
}

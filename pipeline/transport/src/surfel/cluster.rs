//! Clusters: fragments of one voxel that share an orientation become one surfel, unless a wall stands between them, and
//! whether they emit light or not: lamps that are switched off and on leave the surfels as they are.

use glam::{DVec3, IVec3};

use super::{
    Grid, Patch, fill,
    fragment::Fragment,
    walls::{self, Wall},
};
use crate::{Rgb, geometry::Geometry};

/// Fragments whose normals have a larger cosine share a surfel.
pub const COSINE: f64 = 0.9;

/// Surfels of one voxel, at most; further fragments join the surfel that looks most like them. Foliage would
/// otherwise give dozens, which neither the voxel size nor the sweep can tell apart.
pub const MAX_PER_VOXEL: usize = 32;

/// Clusters with less area, in squared voxel edges, are rounding.
const SLIVER: f64 = 1e-6;

/// Length of the mean of the unit normals of a flat surface, at least: all lie within a degree.
const FLAT: f64 = 0.9998;

/// A surfel that is being collected; sums are weighted by covered area.
pub struct Cluster {
    pub normal: DVec3,
    /// Area without regard to coverage, squared voxel edges.
    pub area: f64,
    pub centroid: DVec3,
    /// Its sides of the voxel's walls.
    pub sides: u32,
    /// Length of the mean of its unit normals.
    coherence: f64,
    covered: f64,
    opaque: f64,
    albedo: DVec3,
    emission: DVec3,
    largest: f64,
    triangle: u32,
    u: f32,
    v: f32,
    back: bool,
}

impl Cluster {
    fn new(f: &Fragment, back: bool, sides: u32) -> Self {
        Self {
            normal: DVec3::ZERO,
            area: 0.0,
            centroid: DVec3::ZERO,
            sides,
            coherence: 0.0,
            covered: 0.0,
            opaque: 0.0,
            albedo: DVec3::ZERO,
            emission: DVec3::ZERO,
            largest: 0.0,
            triangle: f.triangle,
            u: f.u,
            v: f.v,
            back,
        }
    }

    fn add(&mut self, f: &Fragment, normal: DVec3, back: bool) {
        let covered = f.area * f64::from(f.coverage);
        self.normal += f.area * normal;
        self.area += f.area;
        self.centroid += covered * f.centroid;
        self.covered += covered;
        self.opaque += f.area * f64::from(f.opacity);
        self.albedo += covered * f.albedo.as_dvec3();
        self.emission += covered * f.emission.as_dvec3();
        if covered > self.largest {
            (self.largest, self.triangle, self.u, self.v, self.back) = (covered, f.triangle, f.u, f.v, back);
        }
    }

    /// Turns sums into means; `None` for rounding, and where normals cancel.
    fn finish(mut self) -> Option<Self> {
        self.coherence = self.normal.length() / self.area;
        self.normal = self.normal.try_normalize()?;
        self.centroid /= self.covered;
        (self.covered > SLIVER).then_some(self)
    }

    pub fn is_flat(&self) -> bool {
        self.coherence > FLAT
    }

    /// `whole` is the area of its plane within the voxel, for a flat cluster: faces that overlap in one plane have more,
    /// but only one of them is seen.
    fn patch(&self, grid: &Grid, voxel: IVec3, fill: f64, whole: f64) -> Patch {
        let edge = f64::from(grid.edge);
        let lo = voxel.as_dvec3();
        let centroid = self.centroid.clamp(lo, lo + 1.0);
        Patch {
            voxel,
            centroid: (grid.origin.as_dvec3() + edge * centroid).as_vec3(),
            normal: self.normal.as_vec3(),
            area: (self.covered * (whole / self.area).min(1.0) * edge * edge) as f32,
            albedo: (self.albedo / self.covered).as_vec3(),
            fill: (fill * self.opaque / self.area) as f32,
            triangle: self.triangle,
            u: self.u,
            v: self.v,
            back: self.back,
        }
    }
}

/// The surfels of one voxel from its fragments, which come in the order of their triangles, each with the radiance
/// that it emits.
pub fn surfels(geometry: &Geometry, grid: &Grid, fragments: &[Fragment], mut out: impl FnMut(Patch, Rgb)) {
    let Some(voxel) = fragments.first().map(|f| f.voxel) else { return };
    // Planes that lie one behind the other are walls of their own.
    let walls = walls::walls(voxel, &clustered(geometry, fragments, &[], walls::APART));
    let mut clusters = clustered(geometry, fragments, &walls, f64::INFINITY);
    if walls.iter().any(|wall| clusters.iter().any(|c| wall.crosses(c.normal))) {
        clusters = clustered(geometry, &walls::divided(geometry, grid, &walls, fragments), &walls, f64::INFINITY);
    }
    for (i, cluster) in clusters.iter().enumerate() {
        let emission = (cluster.emission / cluster.covered).as_vec3();
        let whole = if cluster.is_flat() { fill::whole(voxel, cluster) } else { f64::INFINITY };
        out(cluster.patch(grid, voxel, fill::fraction(voxel, &clusters, i, &walls), whole), emission);
    }
}

/// The clusters of fragments that lie on one side of every wall each, and not farther from their plane than `depth`.
fn clustered(geometry: &Geometry, fragments: &[Fragment], walls: &[Wall], depth: f64) -> Vec<Cluster> {
    let mut clusters: Vec<Cluster> = Vec::new();
    for f in fragments {
        let normal = geometry.triangles[f.triangle as usize].normal.as_dvec3();
        let sides = walls::sides(walls, f.centroid, normal);
        put(&mut clusters, f, (normal, false), sides, depth);
        if geometry.material(f.triangle).double_sided {
            put(&mut clusters, f, (-normal, true), sides, depth);
        }
    }
    clusters.into_iter().filter_map(Cluster::finish).collect()
}

fn put(clusters: &mut Vec<Cluster>, f: &Fragment, (normal, back): (DVec3, bool), sides: u32, depth: f64) {
    let cosine = |c: &Cluster| c.normal.dot(normal) / c.normal.length().max(f64::MIN_POSITIVE);
    let near = |c: &Cluster| depth.is_infinite() || normal.dot(f.centroid - c.centroid / c.covered).abs() <= depth;
    let matching = clusters.iter().position(|c| c.sides == sides && cosine(c) > COSINE && near(c));
    let index = match matching {
        Some(i) => i,
        None if clusters.len() < MAX_PER_VOXEL => {
            clusters.push(Cluster::new(f, back, sides));
            clusters.len() - 1
        }
        None => (1..clusters.len()).fold(0, |b, i| if cosine(&clusters[i]) > cosine(&clusters[b]) { i } else { b }),
    };
    clusters[index].add(f, normal, back);
}

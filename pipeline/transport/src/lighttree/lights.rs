//! The lights of a tree: surfels, from which they are made when they are looked at, or samples that are given.

use glam::Vec3;

use crate::{
    Rgb,
    geometry::Geometry,
    rays::OFFSET,
    sampling::combine,
    surfel::{Solution, Surfel, Surfels},
};

/// A point light that emits by Lambert's law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Where the kernel G is evaluated: the centroid of the patch.
    pub position: Vec3,
    /// Unit normal on the emitting side.
    pub normal: Vec3,
    /// I = B·A/π.
    pub intensity: Rgb,
    /// A/π of a surfel; 0 for samples of emitters, whose area the surfels already carry.
    pub area: f32,
}

/// A light and its stable identity, which alone decides who represents a cluster.
#[derive(Clone, Copy, Debug)]
pub struct Seeded {
    pub light: Light,
    pub seed: u64,
}

/// Where a tree finds its lights.
#[derive(Clone)]
pub(super) enum Lights<'a> {
    Surfels { geometry: &'a Geometry<'a>, surfels: &'a Surfels, solution: &'a Solution },
    Samples(Vec<Seeded>),
}

impl Default for Lights<'_> {
    fn default() -> Self {
        Self::Samples(Vec::new())
    }
}

impl Lights<'_> {
    pub fn len(&self) -> usize {
        match self {
            Self::Surfels { surfels, .. } => surfels.list.len(),
            Self::Samples(samples) => samples.len(),
        }
    }

    #[inline]
    pub fn light(&self, i: u32) -> Light {
        let i = i as usize;
        match self {
            Self::Surfels { surfels, solution, .. } => {
                let surfel = &surfels.list[i];
                let area = surfel.area / std::f32::consts::PI;
                let intensity = surfel.albedo() * solution.total(i) * area;
                Light { position: surfel.centroid, normal: surfel.normal, intensity, area }
            }
            Self::Samples(samples) => samples[i].light,
        }
    }

    /// Position and normal.
    #[inline]
    pub fn place(&self, i: u32) -> (Vec3, Vec3) {
        match self {
            Self::Surfels { surfels, .. } => {
                let surfel = &surfels.list[i as usize];
                (surfel.centroid, surfel.normal)
            }
            Self::Samples(samples) => {
                let light = &samples[i as usize].light;
                (light.position, light.normal)
            }
        }
    }

    #[inline]
    pub fn target(&self, i: u32) -> Vec3 {
        match self {
            Self::Surfels { geometry, surfels, .. } => {
                let (point, side) = surfels.list[i as usize].place(geometry);
                point + side * OFFSET
            }
            Self::Samples(samples) => {
                let light = &samples[i as usize].light;
                light.position + light.normal * OFFSET
            }
        }
    }

    pub fn seed(&self, i: u32) -> u64 {
        match self {
            Self::Surfels { surfels, .. } => identity(&surfels.list[i as usize]),
            Self::Samples(samples) => samples[i as usize].seed,
        }
    }
}

/// What a surfel is, wherever it stands in the list: its voxel and its orientation. The normal counts in steps coarse
/// enough that rounding, which differs between copies of a scene at other places and scales, decides next to nothing.
pub fn identity(surfel: &Surfel) -> u64 {
    let normal = (surfel.normal * 64.0).round().as_ivec3();
    let words = surfel.voxel().to_array().into_iter().chain(normal.to_array());
    words.fold(0, |seed, word| combine(seed, u64::from(word as u32)))
}

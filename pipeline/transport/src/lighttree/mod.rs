//! Binary light trees (Walter et al. 2005, §3; paper §4.2): point lights, and clusters of them with everything that a
//! bound of their light needs.
//!
//! A light stands for a small Lambertian patch of area A and radiosity B:
//!
//! ```text
//! I = B·A/π   intensity along its normal [lux × squared frame units]
//! E = I·G·V   irradiance at a receiver,   G = cos θ · cos θ′ / r²,   V transmittance
//! ```
//!
//! A cluster is represented by one of its lights j, chosen with probability pⱼ in proportion to Iⱼ + β·Aⱼ (band mean),
//! so that Iⱼ/pⱼ and Aⱼ/pⱼ stand for its intensity and area without bias. β is the *ambient* radiosity of the tree: 0
//! where only intensity matters (then the exact sums stand for themselves, as in the paper), the mean radiosity of
//! the scene where a control variate also needs the area that is covered.
//!
//! One choice of representatives would give all receivers of a region the same error, which no average over receivers
//! takes away. So every node has a representative in each of [`VARIANTS`] variants of the tree, and a receiver's seed
//! tells which variant it sees. At every node the variants divide between the two halves as exactly as their number
//! allows (each draws from its own stratum), so that their mean is close to the truth.
//!
//! There are two trees: *indirect* over all surfels (B = ρE, dark ones included: they cover part of the hemisphere,
//! which the control variate of [`crate::gather::lightcuts`] needs to know), and *direct* over samples of emissive
//! surfaces. The root that joins them is no useful cluster, so a cut starts with both trees' own roots.

mod bound;
mod build;
mod emitters;

use glam::Vec3;

pub use bound::Vantage;
pub use emitters::{EmitterSamples, emitter_samples};

use crate::{
    Rgb,
    geometry::Geometry,
    rays::OFFSET,
    sampling::{combine, mix},
    surfel::{Solution, Surfel, Surfels},
};

/// A point light that emits by Lambert's law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Where the kernel G is evaluated: the centroid of the patch.
    pub position: Vec3,
    /// Unit normal on the emitting side.
    pub normal: Vec3,
    /// End of its shadow rays: a point of the real surface, lifted off it on the emitting side.
    pub target: Vec3,
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

/// All lights below one inner node of the tree.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Box of the lights' positions.
    pub lo: Vec3,
    pub hi: Vec3,
    /// Cone that holds the lights' normals: unit axis, cosine and sine of the half angle.
    pub axis: Vec3,
    pub cos: f32,
    pub sin: f32,
    /// Sums over the lights.
    pub intensity: Rgb,
    pub area: f32,
    /// Least and largest radiosity B, band by band, of the lights that have an area.
    pub low: Rgb,
    pub high: Rgb,
    /// The light j that stands for all, in each variant of the tree.
    pub representatives: [u32; VARIANTS],
    first: u32,
    count: u32,
}

/// A part of the tree: one light, or an inner node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cluster {
    Light(u32),
    Node(u32),
}

/// A binary tree over lights, split at the median. The layout is implied by the counts: the inner nodes of the left
/// half follow their parent, those of the right half come after them.
#[derive(Clone, Debug, Default)]
pub struct LightTree {
    /// In the tree's order.
    pub lights: Vec<Light>,
    pub nodes: Vec<Node>,
    /// The ambient radiosity β.
    ambient: f32,
}

impl LightTree {
    /// Builds the tree for the ambient radiosity β; lights that are neither bright nor large are left out.
    pub fn new(lights: Vec<Seeded>, ambient: f32) -> Self {
        build::build(lights, ambient)
    }

    /// The tree over all surfels that have an area. The solution has a value for each of them.
    pub fn indirect(geometry: &Geometry, surfels: &Surfels, solution: &Solution, ambient: f32) -> Self {
        let light = |s: &Surfel, e: Rgb| {
            let (point, side) = s.place(geometry);
            let area = s.area / std::f32::consts::PI;
            Light {
                position: s.centroid,
                normal: s.normal,
                target: point + side * OFFSET,
                intensity: s.albedo() * e * area,
                area,
            }
        };
        let irradiance = solution.direct.iter().zip(&solution.indirect).map(|(d, i)| *d + *i);
        let lights = surfels.list.iter().zip(irradiance);
        Self::new(lights.map(|(s, e)| Seeded { light: light(s, e), seed: identity(s) }).collect(), ambient)
    }

    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    pub fn root(&self) -> Option<Cluster> {
        match self.lights.len() {
            0 => None,
            1 => Some(Cluster::Light(0)),
            _ => Some(Cluster::Node(0)),
        }
    }

    /// The two halves of an inner node.
    pub fn children(&self, node: u32) -> [Cluster; 2] {
        let Node { first, count, .. } = self.nodes[node as usize];
        let left = left_count(count as usize) as u32;
        let part = |first: u32, count: u32, at: u32| if count == 1 { Cluster::Light(first) } else { Cluster::Node(at) };
        [part(first, left, node + 1), part(first + left, count - left, node + left)]
    }

    /// What the kernel of a node's representative is multiplied by: Iⱼ/pⱼ and Aⱼ/pⱼ, or the sums where β = 0.
    #[inline]
    pub fn stand_in(&self, node: u32, variant: usize) -> (Rgb, f32) {
        let node = &self.nodes[node as usize];
        if self.ambient <= 0.0 {
            return (node.intensity, node.area);
        }
        let light = &self.lights[node.representatives[variant] as usize];
        let own = weight(light.intensity, light.area, self.ambient);
        // Every light with an area has a weight where there is an ambient part; one without any is never chosen.
        let inverse = if own > 0.0 { weight(node.intensity, node.area, self.ambient) / own } else { 0.0 };
        (light.intensity * inverse, light.area * inverse)
    }
}

/// Number of variants of a tree.
pub const VARIANTS: usize = 8;

/// Mixed into a receiver's seed, so that its variant has nothing to do with its rays.
const VARIANT: u64 = 0x7a31;

/// The variant of a tree that a receiver with this seed sees.
pub fn variant(seed: u64) -> usize {
    (mix(seed ^ VARIANT) % VARIANTS as u64) as usize
}

/// A light's share in the choice of representatives, before it is divided by the sum: I + β·A, band mean.
fn weight(intensity: Rgb, area: f32, ambient: f32) -> f32 {
    intensity.element_sum() / 3.0 + ambient * area
}

fn left_count(count: usize) -> usize {
    count / 2
}

/// What a surfel is, wherever it stands in the list: its voxel and its orientation. The normal counts in steps coarse
/// enough that rounding, which differs between copies of a scene at other places and scales, decides next to nothing.
pub fn identity(surfel: &Surfel) -> u64 {
    let normal = (surfel.normal * 64.0).round().as_ivec3();
    let words = surfel.voxel().to_array().into_iter().chain(normal.to_array());
    words.fold(0, |seed, word| combine(seed, u64::from(word as u32)))
}

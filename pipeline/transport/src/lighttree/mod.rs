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
//!
//! **Memory.** A tree over surfels has as many clusters as surfels, so it keeps little of each: lights are made from their
//! surfels when they are looked at, a node of two lights is made from them, and who represents a small node is one bit a
//! variant, *left* or *right*, to be followed down to a light. What remains is 80 bytes for every node of more than two
//! lights (a half to two thirds of their number), 32 for every node of more than sixteen, and 5 for every light.

mod bound;
mod build;
mod emitters;
mod lights;

use glam::Vec3;
use luxel_scene::{Cancelled, Progress, Silent};

pub use bound::Vantage;
pub use emitters::{EmitterSamples, emitter_samples};
pub use lights::{Light, Seeded, identity};

use self::lights::Lights;
use crate::{
    Rgb,
    geometry::Geometry,
    sampling::mix,
    surfel::{Solution, Surfels},
};

/// All lights below one inner node of the tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Box of the lights' positions.
    pub lo: Vec3,
    pub hi: Vec3,
    /// Cone that holds the lights' normals: unit axis and cosine of the half angle.
    pub axis: Vec3,
    pub cos: f32,
    /// Sums over the lights.
    pub intensity: Rgb,
    pub area: f32,
    /// Least and largest radiosity B, band by band, of the lights that have an area.
    pub low: Rgb,
    pub high: Rgb,
}

/// An inner node by its place in the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Branch {
    /// Number among the inner nodes: the parent, those of its left half, those of its right half.
    pub id: u32,
    /// The lights below it.
    first: u32,
    count: u32,
    /// Number among the nodes that are stored.
    slot: u32,
    /// Number among those that name their representatives.
    wide: u32,
}

impl Branch {
    /// Whether a light is below this node.
    pub fn holds(&self, light: u32) -> bool {
        (self.first..self.first + self.count).contains(&light)
    }
}

/// A part of the tree: one light, or an inner node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cluster {
    /// By its place in the tree's order.
    Light(u32),
    Node(Branch),
}

/// A binary tree over lights, split at the median, so that its layout follows from their number.
#[derive(Clone, Default)]
pub struct LightTree<'a> {
    lights: Lights<'a>,
    /// The light at each place of the tree.
    order: Vec<u32>,
    /// Nodes of more than two lights, parents before their left halves before their right halves.
    nodes: Vec<Node>,
    /// For every inner node the variants (bits) whose representative is in its right half.
    choices: Vec<u8>,
    /// The representatives of nodes of more than [`WIDE`] lights, in every variant.
    chosen: Vec<[u32; VARIANTS]>,
    /// The ambient radiosity β.
    ambient: f32,
}

impl<'a> LightTree<'a> {
    /// Builds the tree for the ambient radiosity β; lights that are neither bright nor large are left out.
    pub fn new(lights: Vec<Seeded>, ambient: f32) -> Self {
        Self::samples(lights, ambient, &Silent).unwrap_or_else(|Cancelled| unreachable!("nobody cancels"))
    }

    /// [`LightTree::new`] that can be cancelled.
    pub fn samples(lights: Vec<Seeded>, ambient: f32, progress: &dyn Progress) -> Result<Self, Cancelled> {
        build::build(Lights::Samples(lights), ambient, progress)
    }

    /// The tree over all surfels that have an area. The solution has a value for each of them.
    pub fn indirect(
        geometry: &'a Geometry<'a>,
        surfels: &'a Surfels,
        solution: &'a Solution,
        ambient: f32,
        progress: &dyn Progress,
    ) -> Result<LightTree<'a>, Cancelled> {
        build::build(Lights::Surfels { geometry, surfels, solution }, ambient, progress)
    }

    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Number of lights.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    pub fn root(&self) -> Option<Cluster> {
        match self.order.len() as u32 {
            0 => None,
            1 => Some(Cluster::Light(0)),
            count => Some(Cluster::Node(Branch { id: 0, first: 0, count, slot: 0, wide: 0 })),
        }
    }

    /// The two halves of an inner node.
    #[inline]
    pub fn children(&self, parent: Branch) -> [Cluster; 2] {
        let Branch { id, first, count, slot, wide } = parent;
        let left = left_count(count as usize) as u32;
        let part = |branch: Branch| match branch.count {
            1 => Cluster::Light(branch.first),
            _ => Cluster::Node(branch),
        };
        // A node that has no number of its own has none below it either.
        let after = |number: u32, below: usize| number + 1 + below as u32;
        [
            part(Branch { id: id + 1, first, count: left, slot: slot + 1, wide: wide + 1 }),
            part(Branch {
                id: id + left,
                first: first + left,
                count: count - left,
                slot: after(slot, stored_count(left as usize)),
                wide: after(wide, wide_count(left as usize)),
            }),
        ]
    }

    /// The light at a place of the tree.
    #[inline]
    pub fn light(&self, place: u32) -> Light {
        self.lights.light(self.order[place as usize])
    }

    /// End of a light's shadow rays: a point of the real surface, lifted off it on the emitting side.
    #[inline]
    pub fn target(&self, place: u32) -> Vec3 {
        self.lights.target(self.order[place as usize])
    }

    #[inline]
    pub fn node(&self, branch: Branch) -> Node {
        match branch.count {
            2 => build::pair(&self.light(branch.first), &self.light(branch.first + 1)),
            _ => self.nodes[branch.slot as usize],
        }
    }

    /// The light that stands for a node in a variant of the tree.
    #[inline]
    pub fn representative(&self, branch: Branch, variant: usize) -> u32 {
        match branch.count as usize {
            0..=WIDE => self.follow(branch, variant),
            _ => self.chosen[branch.wide as usize][variant],
        }
    }

    /// The same by the choices of all nodes on the way down.
    #[inline]
    fn follow(&self, branch: Branch, variant: usize) -> u32 {
        let Branch { mut id, mut first, mut count, .. } = branch;
        while count > 1 {
            let left = left_count(count as usize) as u32;
            if self.choices[id as usize] >> variant & 1 == 0 {
                (id, count) = (id + 1, left);
            } else {
                (id, first, count) = (id + left, first + left, count - left);
            }
        }
        first
    }

    /// What the kernel of a node's representative is multiplied by: Iⱼ/pⱼ and Aⱼ/pⱼ, or the sums where β = 0.
    #[inline]
    pub fn stand_in(&self, node: &Node, representative: u32) -> (Rgb, f32) {
        if self.ambient <= 0.0 {
            return (node.intensity, node.area);
        }
        let light = self.light(representative);
        let own = weight(light.intensity, light.area, self.ambient);
        // Every light with an area has a weight where there is an ambient part; one without any is never chosen.
        let inverse = if own > 0.0 { weight(node.intensity, node.area, self.ambient) / own } else { 0.0 };
        (light.intensity * inverse, light.area * inverse)
    }
}

/// Number of variants of a tree.
pub const VARIANTS: usize = 8;

/// Most lights of a node whose representatives are found by following the choices: they lie side by side.
const WIDE: usize = 16;

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

/// Number of nodes of more than `least` lights in a tree over `count`. The l-th halving leaves 2ˡ parts of ⌊count/2ˡ⌋
/// lights or one more: all of them count as long as the smaller ones do, then those that have one more than `least`.
#[inline]
fn larger_nodes(count: usize, least: usize) -> usize {
    if count <= least {
        return 0;
    }
    let levels = (count / (least + 1)).ilog2() + 1;
    let last = if count >> levels == least { count - (least << levels) } else { 0 };
    (1 << levels) - 1 + last
}

/// Number of nodes that are stored.
#[inline]
fn stored_count(count: usize) -> usize {
    larger_nodes(count, 2)
}

/// Number of nodes that name their representatives.
#[inline]
fn wide_count(count: usize) -> usize {
    larger_nodes(count, WIDE)
}

#[cfg(test)]
impl LightTree<'_> {
    /// All inner nodes by their numbers.
    pub(crate) fn branches(&self) -> Vec<Branch> {
        let mut open: Vec<Cluster> = self.root().into_iter().collect();
        let mut found = Vec::new();
        while let Some(cluster) = open.pop() {
            if let Cluster::Node(branch) = cluster {
                found.push(branch);
                let [left, right] = self.children(branch);
                open.extend([right, left]);
            }
        }
        found
    }

    /// The lights below a node.
    pub(crate) fn below(&self, branch: Branch) -> impl Iterator<Item = (u32, Light)> {
        (branch.first..branch.first + branch.count).map(|place| (place, self.light(place)))
    }
}

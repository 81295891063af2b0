//! Random sample voxels (Piwowar & Malgouyres 2009, §4.1): a few surfels of the cached solution as point lights, drawn
//! for each receiver.
//!
//! ```text
//! E = (1/n) Σᵢ Bⱼ·(Aⱼ/π)·K(rⱼ)·V(rⱼ) / pⱼ  +  near field         j = j(i), drawn with probability pⱼ
//! ```
//!
//! The paper's equation (2) is C = B·cos θ cos θ′/r²·V, without Aⱼ/π and 1/pⱼ. Where p is exactly in proportion to ΔA, as
//! its text wants, the two differ by the constant factor ΣA/π, which is what its pictures must have been scaled by; with
//! the solid angle in p no constant does. Here p is known for every draw, so the estimator is right as it stands.
//!
//! **Draws.** From the root of the light tree down, each half with the weight A·K*: the area of its surfels times about
//! what the kernel is for the cluster ([`Vantage::promise`]), the paper's area times solid angle; for a single surfel
//! A·K. p is the product of the shares on the way. K* is positive where K of any surfel below is, so no surfel that
//! shines on the receiver is left out. The bound K⁺ of lightcuts would do as well for that, but nodes of the receiver's
//! own wall touch it: their bound is the cap, and nearly all draws would end there. B has no part in p, as in the paper.
//!
//! **Two sets.** Draws are points of a Kronecker sequence of the golden ratio through the tree's order, shifted at random
//! for each receiver and set: two independent estimates a and b without bias. The result is their mean, and |a − b|/2
//! the standard error of it, from one degree of freedom. Draw i depends on the receiver and the set alone, so more passes
//! begin with those of fewer ([`Tally`]).
//!
//! K = min(G, b) and the near rays are those of lightcuts (see `near`); each pass of a set has its own.

use glam::DVec3;
use luxel_scene::{Cancelled, Progress, Silent};
use rayon::prelude::*;

use super::{
    Field, Receiver,
    near::{NearField, cap},
};
use crate::{
    Rgb,
    lighttree::{Cluster, LightTree, Vantage},
    rays::OFFSET,
    sampling::{combine, mix},
};

/// Draws of each set in one pass.
pub const DRAWS: u32 = 64;

/// Near rays of each set in one pass.
pub const NEAR_RAYS: u32 = 8;

/// 1/φ as a fraction of 2⁶⁴.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Gathers by random sample voxels.
pub struct VoxelSamples<'a> {
    field: &'a Field<'a>,
    tree: LightTree<'a>,
    near: NearField,
    /// Bound b of the kernel.
    cap: f32,
    passes: u32,
}

/// What all passes so far have found at one receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    passes: u32,
    /// Of both sets, irradiance [lux] times passes.
    sums: [DVec3; 2],
    rays: u32,
}

impl Tally {
    /// Reflected irradiance [lux]; 0 before the first pass.
    pub fn irradiance(&self) -> Rgb {
        (self.sums.iter().sum::<DVec3>() / (2.0 * f64::from(self.passes.max(1)))).as_vec3()
    }

    /// Estimated standard error of the band mean of the irradiance [lux]; infinite before the first pass.
    pub fn error(&self) -> f32 {
        if self.passes == 0 {
            return f32::INFINITY;
        }
        let [a, b] = self.sums.map(|sum| sum.element_sum() / 3.0);
        ((a - b).abs() / (2.0 * f64::from(self.passes))) as f32
    }

    /// Continuous rays spent.
    pub fn rays(&self) -> u32 {
        self.rays
    }
}

impl<'a> VoxelSamples<'a> {
    /// `passes` of [`DRAWS`] draws of each set, at least one, for whoever gathers once.
    pub fn new(field: &'a Field<'a>, passes: u32) -> Self {
        match Self::build(field, passes, &Silent) {
            Ok(samples) => samples,
            Err(Cancelled) => unreachable!("nobody cancels"),
        }
    }

    /// [`VoxelSamples::new`] that can be cancelled.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn build(field: &'a Field<'a>, passes: u32, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let tree = LightTree::indirect(field.rays.geometry, field.surfels, field.solution, 0.0, progress)?;
        let cap = cap(field.surfels.grid.edge);
        Ok(Self { field, tree, near: NearField::new(NEAR_RAYS), cap, passes: passes.max(1) })
    }

    /// The passes that this gather was made for.
    pub fn passes(&self) -> u32 {
        self.passes
    }

    /// The tallies of all receivers after so many passes, in their order. Reports one unit of progress per receiver.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn tallies(
        &self,
        receivers: &[Receiver],
        passes: u32,
        progress: &dyn Progress,
    ) -> Result<Vec<Tally>, Cancelled> {
        let one = |receiver| {
            let mut tally = Tally::default();
            for _ in 0..passes {
                progress.check()?;
                self.pass(receiver, &mut tally);
            }
            progress.advance(1);
            Ok(tally)
        };
        receivers.par_iter().map(one).collect()
    }

    /// One more pass of both sets.
    fn pass(&self, receiver: &Receiver, tally: &mut Tally) {
        let vantage = Vantage::new(receiver, self.cap);
        for set in 0..2 {
            let seed = combine(receiver.seed, set as u64 + 1);
            let near = self.near.look(receiver, combine(seed, u64::from(tally.passes)), |near, ray| {
                let (_, rays) = self.field.walk(ray.origin, ray.direction, |e| {
                    let [weight] = ray.excess(e, [self.cap]);
                    near.reflect(e, weight);
                });
                near.rays += rays;
            });
            let first = u64::from(tally.passes) * u64::from(DRAWS);
            let mut sum = DVec3::ZERO;
            for i in first..first + u64::from(DRAWS) {
                let point = mix(seed).wrapping_add(i.wrapping_mul(GOLDEN));
                if let Some((light, probability)) = self.draw(&vantage, fraction(point)) {
                    sum += self.arriving(receiver, &vantage, light) / probability;
                    tally.rays += 1;
                }
            }
            tally.sums[set] += sum / f64::from(DRAWS) + near.reflected.as_dvec3();
            tally.rays += near.rays;
        }
        tally.passes += 1;
    }

    /// A surfel by its place in the tree, and its probability, for a number in [0, 1); none where the way down ends
    /// before clusters that do not shine on the receiver.
    fn draw(&self, vantage: &Vantage, mut at: f64) -> Option<(u32, f64)> {
        let (mut cluster, mut probability) = (self.tree.root()?, 1.0);
        loop {
            let branch = match cluster {
                Cluster::Light(light) => return Some((light, probability)),
                Cluster::Node(branch) => branch,
            };
            let [left, right] = self.tree.children(branch);
            let (a, b) = (self.weight(vantage, left), self.weight(vantage, right));
            let all = a + b;
            if all <= 0.0 {
                return None;
            }
            let share = a / all;
            (cluster, at, probability) = if at < share {
                (left, at / share, probability * share)
            } else {
                (right, (at - share) / (1.0 - share), probability * (b / all))
            };
            at = at.clamp(0.0, 1.0 - f64::EPSILON);
        }
    }

    /// A·K* of a cluster.
    fn weight(&self, vantage: &Vantage, cluster: Cluster) -> f64 {
        let (area, kernel) = match cluster {
            Cluster::Light(light) => {
                let light = self.tree.light(light);
                (light.area, vantage.kernel(&light))
            }
            Cluster::Node(branch) => {
                let node = self.tree.node(branch);
                (node.area, vantage.promise(&node))
            }
        };
        f64::from(area) * f64::from(kernel)
    }

    /// I·K·V of a surfel [lux].
    fn arriving(&self, receiver: &Receiver, vantage: &Vantage, place: u32) -> DVec3 {
        let light = self.tree.light(place);
        let reflected = light.intensity * vantage.kernel(&light);
        let origin = receiver.position + receiver.normal * OFFSET;
        let d = self.tree.target(place) - origin;
        let distance = d.length();
        if distance <= 0.0 {
            return reflected.as_dvec3();
        }
        (reflected * self.field.rays.transmittance(origin, d / distance, distance)).as_dvec3()
    }
}

/// The upper 53 bits as a number in [0, 1).
fn fraction(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

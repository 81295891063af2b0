//! The kernel between a receiver and a light, and its upper bound over a cluster (Walter et al. 2005, §3.3).
//!
//! ```text
//! G  = cos θ cos θ′ / r²      θ at the receiver, θ′ at the light
//! K  = min(G, b)              bounded kernel: what lies above b is left to rays (Kollig & Keller 2004)
//! K⁺ = min(b, max cos θ · max cos θ′ / min r²)   over the cluster's box and cone of normals
//! ```
//!
//! Every maximum is taken for itself, so K⁺ ≥ K for every light of the cluster.

use glam::{Mat3, Vec3};

use super::{Light, Node};
use crate::{gather::Receiver, sampling::basis};

/// Slack of lengths in the bound, frame units: several ulp of the largest coordinate.
const SLACK: f32 = 1e-3;

/// Slack of the bound itself: rounding of its dozen operations.
const ROUNDING: f32 = 1.0 + 1e-5;

/// A receiver as the kernel sees it.
#[derive(Clone, Copy, Debug)]
pub struct Vantage {
    pub position: Vec3,
    /// Geometric normal: the horizon.
    normal: Vec3,
    /// Shading normal (third column) with two tangents, and the absolute values of all.
    frame: Mat3,
    absolute: Mat3,
    tilted: bool,
    /// Largest value of the kernel: b [1/squared frame units].
    pub cap: f32,
}

impl Vantage {
    /// `cap` is the bound b of the kernel, or infinity.
    pub fn new(receiver: &Receiver, cap: f32) -> Self {
        let frame = basis(receiver.shading_normal);
        let absolute = Mat3::from_cols(frame.x_axis.abs(), frame.y_axis.abs(), frame.z_axis.abs());
        let tilted = receiver.normal != receiver.shading_normal;
        Self { position: receiver.position, normal: receiver.normal, frame, absolute, tilted, cap }
    }

    /// K of one light; 0 where either does not face the other, or where they coincide.
    #[inline]
    pub fn kernel(&self, light: &Light) -> f32 {
        let d = light.position - self.position;
        let (near, far) = (self.frame.z_axis.dot(d), -light.normal.dot(d));
        // Written so that a NaN fails.
        if !(near > 0.0 && far > 0.0 && self.normal.dot(d) > 0.0) {
            return 0.0;
        }
        let square = d.length_squared();
        (near * far / (square * square)).min(self.cap)
    }

    /// K⁺: no light of the node has a larger kernel.
    #[inline]
    pub fn bound(&self, node: &Node) -> f32 {
        let half = 0.5 * (node.hi - node.lo) + SLACK;
        let d = 0.5 * (node.hi + node.lo) - self.position;
        if self.tilted && self.normal.dot(d) + self.normal.abs().dot(half) <= 0.0 {
            return 0.0;
        }
        let near = self.cosine(d, half);
        if near <= 0.0 {
            return 0.0;
        }
        let far = emitter_cosine(node, -d, half);
        let square = (d.abs() - half).max(Vec3::ZERO).length_squared();
        // A box that holds the receiver has no least distance: 0/0 and x/0 both end at the cap.
        (near * far / square * ROUNDING).min(self.cap)
    }

    /// About what the kernel is over a node: largest height over the receiver's plane and largest cos θ′, at the distance
    /// of the middle but no nearer than the half diagonal. No bound; positive wherever a light of the node has a kernel.
    pub fn promise(&self, node: &Node) -> f32 {
        let half = 0.5 * (node.hi - node.lo) + SLACK;
        let d = 0.5 * (node.hi + node.lo) - self.position;
        let height = self.frame.z_axis.dot(d) + self.absolute.z_axis.dot(half);
        if height <= 0.0 {
            return 0.0;
        }
        let square = d.length_squared().max(half.length_squared());
        let near = (height / square.sqrt()).min(1.0);
        (near * emitter_cosine(node, -d, half) / square).min(self.cap)
    }

    /// Upper bound of cos θ over a box: its highest point over the least distance from the normal's line.
    fn cosine(&self, d: Vec3, half: Vec3) -> f32 {
        let z = self.frame.z_axis.dot(d) + self.absolute.z_axis.dot(half);
        let x = (self.frame.x_axis.dot(d).abs() - self.absolute.x_axis.dot(half)).max(0.0);
        let y = (self.frame.y_axis.dot(d).abs() - self.absolute.y_axis.dot(half)).max(0.0);
        if z <= 0.0 { 0.0 } else { z / (x * x + y * y + z * z).sqrt() }
    }
}

/// Upper bound of cos θ′ over a node's box and normals; `e` leads from the box's middle to the receiver.
fn emitter_cosine(node: &Node, e: Vec3, half: Vec3) -> f32 {
    let along = node.axis.dot(e);
    let across = (e.length_squared() - along * along).max(0.0).sqrt();
    let z = along + node.axis.abs().dot(half);
    let radius = half.length();
    // Towards the axis the nearest point of the box counts, away from it the farthest.
    let rho = if z > 0.0 { (across - radius).max(0.0) } else { across + radius };
    let length = (z * z + rho * rho).sqrt();
    let cos = if length > 0.0 { z / length } else { 1.0 };
    if cos >= node.cos {
        return 1.0;
    }
    // cos(θ − α), with the angle θ to the axis beyond the cone's half angle α.
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let node_sin = (1.0 - node.cos * node.cos).max(0.0).sqrt();
    (cos * node.cos + sin * node_sin).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Rgb,
        lighttree::{LightTree, Seeded},
        sampling::sphere,
    };
    use glam::Vec2;
    use proptest::prelude::*;

    fn point(reach: f32) -> impl Strategy<Value = Vec3> {
        (-reach..reach, -reach..reach, -reach..reach).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    fn direction() -> impl Strategy<Value = Vec3> {
        (0.0f32..1.0, 0.0f32..1.0).prop_map(|(x, y)| sphere(Vec2::new(x, y)))
    }

    fn light(position: Vec3, normal: Vec3) -> Seeded {
        Seeded { light: Light { position, normal, intensity: Rgb::ONE, area: 1.0 }, seed: 7 }
    }

    fn receiver(position: Vec3, normal: Vec3, shading_normal: Vec3) -> Receiver {
        Receiver { position, normal, shading_normal, footprint: 1.0, seed: 0 }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// The promise itself, for receivers far away, near by and inside the box, with and without a cap.
        #[test]
        fn no_light_exceeds_the_bound_of_its_cluster(
            lights in prop::collection::vec((point(1.0), direction()), 2..9),
            size in 0.01f32..300.0,
            centre in point(1500.0),
            away in point(4.0),
            aim in direction(),
            spread in 0.0f32..2.0,
            (normal, lean) in (direction(), direction()),
            cap in prop::option::of(1e-6f32..1.0),
        ) {
            let lights: Vec<Seeded> = lights.into_iter().map(|(p, n)| {
                light(centre + p * size, (aim + spread * n).try_normalize().unwrap_or(aim))
            }).collect();
            let tree = LightTree::new(lights, 0.0);
            let shading = (normal + 0.5 * lean).normalize();
            for shading in [normal, shading] {
                let r = receiver(centre + away * size, normal, shading);
                let v = Vantage::new(&r, cap.unwrap_or(f32::INFINITY));
                for branch in tree.branches() {
                    let bound = v.bound(&tree.node(branch));
                    let promise = v.promise(&tree.node(branch));
                    prop_assert!(!bound.is_nan() && bound >= 0.0);
                    for (_, l) in tree.below(branch) {
                        let k = v.kernel(&l);
                        prop_assert!(k <= bound, "kernel {k} above bound {bound}");
                        prop_assert!(promise.is_finite() && (k <= 0.0 || promise > 0.0), "kernel {k} not promised");
                    }
                }
            }
        }
    }

    #[test]
    fn the_bound_of_a_far_small_cluster_is_tight() {
        let c = Vec3::new(300.0, 400.0, 1000.0);
        let n = -c.normalize();
        let tree = LightTree::new(vec![light(c, n), light(c + Vec3::X, n)], 0.0);
        let v = Vantage::new(&receiver(Vec3::ZERO, Vec3::Z, Vec3::Z), f32::INFINITY);
        let (k, bound) = (v.kernel(&tree.light(0)), v.bound(&tree.node(tree.branches()[0])));
        assert!(bound >= k && bound < 1.01 * k, "{bound} against {k}");
    }

    #[test]
    fn what_lies_behind_or_looks_away_is_bounded_by_zero() {
        let v = Vantage::new(&receiver(Vec3::ZERO, Vec3::Z, Vec3::Z), f32::INFINITY);
        let behind = LightTree::new(vec![light(Vec3::new(0.0, 0.0, -9.0), Vec3::Z); 2], 0.0);
        assert_eq!(v.bound(&behind.node(behind.branches()[0])), 0.0);
        let averted = LightTree::new(vec![light(Vec3::new(0.0, 0.0, 9.0), Vec3::Z); 2], 0.0);
        assert_eq!(v.bound(&averted.node(averted.branches()[0])), 0.0);
    }

    #[test]
    fn a_receiver_on_a_light_gets_nothing_from_it_and_no_nan() {
        let v = Vantage::new(&receiver(Vec3::ONE, Vec3::Z, Vec3::Z), 0.25);
        let here = LightTree::new(vec![light(Vec3::ONE, Vec3::Z); 2], 0.0);
        assert_eq!(v.kernel(&here.light(0)), 0.0);
        assert_eq!(v.bound(&here.node(here.branches()[0])), 0.25);
    }
}

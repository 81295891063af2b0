//! Photon mapping with reconstruction by lightcuts: a comparator of the paper's Figure 3.
//!
//! Photons go from the lights through all their reflections (`trace`). Each arrival of flux Φ is a point light of
//! intensity I = cρΦ/π along the surface's normal (instant radiosity, Keller 1997), and a cut through a tree over all of
//! them gives the reflected light at a receiver:
//!
//! ```text
//! E = Σ_C I_C·min(G, b)·V  +  (1/N) Σᵢ Bᵢ·max(0, 1 − b/Gᵢ)       b = 1/(3h)², h = √(area of all surfaces / arrivals)
//!     clusters of the cut     near field (see `near`)
//! ```
//!
//! The radiosity Bᵢ = ρE that the near rays see comes from the photons' density (`density`). The first part has no bias
//! but what the cut's threshold leaves and noise that falls with the root of the number of photons; the second has the
//! bias of the density, weighted by the share of the light that comes from nearer than about 3 h. No voxels are needed,
//! and nothing is read of a solution.
//!
//! **Noise.** A photon at the border of the near field brings B/9π whatever their number, so within about 3 h of another
//! surface noise does not fall as photons are added, but that region shrinks with h: half the error takes four times the
//! photons away from corners, and up to sixteen over a whole room.

mod density;
mod nearest;
mod trace;

use luxel_scene::{Cancelled, Progress, Silent};

pub use self::trace::Ledger;

use self::{density::Density, nearest::Found};
use super::{
    Gather, Gathered, Receiver,
    cut::{Cut, Limits, Source},
    near::{Near, NearField, NearRay, cap},
    run,
    surfaces::Surfaces,
};
use crate::{
    Rgb,
    lights::Emitters,
    lighttree::{LightTree, Vantage, variant},
    rays::{OFFSET, Rays},
};

/// How photons are traced and gathered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Photons from all lights and the sky together, about; each leaves as many arrivals as it meets surfaces, as far as
    /// [`most_arrivals`] lets it.
    pub photons: u32,
    /// Largest bound of a cluster, as a share of the total.
    pub threshold: f32,
    /// Most clusters in a cut.
    pub limit: u32,
    /// Cosine rays for the near field.
    pub near_rays: u32,
    /// Independent maps have different ones.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { photons: 50_000, threshold: 0.02, limit: 1000, near_rays: 32, seed: 0 }
    }
}

/// What a map holds and what it took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Facts {
    /// Photons sent.
    pub photons: u64,
    /// Their arrivals on surfaces that are kept.
    pub arrivals: u64,
    /// Rays that followed them.
    pub rays: u64,
    /// Where their flux went.
    pub ledger: Ledger,
}

/// Arrivals that a map of so many photons keeps, at most.
pub fn most_arrivals(photons: u32) -> u64 {
    trace::most(photons)
}

/// Gathers what photons brought.
pub struct PhotonMap<'a> {
    rays: &'a Rays<'a>,
    surfaces: Surfaces<'a>,
    tree: LightTree<'a>,
    density: Density,
    near: NearField,
    /// Bound b of the kernel.
    cap: f32,
    limits: Limits,
    facts: Facts,
}

/// Memory that is used again for the next receiver.
#[derive(Default)]
struct Scratch {
    cut: Cut,
    found: Vec<Found>,
}

impl<'a> PhotonMap<'a> {
    pub fn new(rays: &'a Rays<'a>, emitters: &Emitters, settings: Settings) -> Self {
        match Self::build(rays, emitters, settings, &Silent) {
            Ok(map) => map,
            Err(Cancelled) => unreachable!("nobody cancels"),
        }
    }

    /// [`PhotonMap::new`] that can be cancelled.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn build(
        rays: &'a Rays<'a>,
        emitters: &Emitters,
        settings: Settings,
        progress: &dyn Progress,
    ) -> Result<Self, Cancelled> {
        let traced = trace::trace(rays, emitters, settings.photons, settings.seed, progress)?;
        let facts = Facts {
            photons: traced.photons,
            arrivals: traced.deposits.len() as u64,
            rays: traced.rays,
            ledger: traced.ledger,
        };
        let density = Density::new(rays, &traced.deposits, progress)?;
        let spacing = (area(rays) / traced.deposits.len().max(1) as f64).sqrt() as f32;
        let lights = traced.deposits.into_iter().map(|deposit| deposit.light).collect();
        Ok(Self {
            rays,
            surfaces: Surfaces::new(rays),
            tree: LightTree::samples(lights, 0.0, progress)?,
            density,
            near: NearField::new(settings.near_rays),
            cap: cap(spacing.max(OFFSET)),
            limits: Limits { threshold: settings.threshold, clusters: settings.limit },
            facts,
        })
    }

    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    fn at(&self, Scratch { cut, found }: &mut Scratch, receiver: &Receiver) -> Gathered {
        if self.tree.is_empty() {
            return Gathered::default();
        }
        let near = self.near.look(receiver, receiver.seed, |near, ray| self.near_ray(near, ray, found));
        let source = Source {
            tree: &self.tree,
            vantage: Vantage::new(receiver, self.cap),
            control: Rgb::ZERO,
            variant: variant(receiver.seed),
        };
        let origin = receiver.position + receiver.normal * OFFSET;
        let found = cut.find(&[source], self.rays, origin, near.reflected, near.irradiance, &self.limits);
        Gathered {
            irradiance: found.sum.as_vec3().max(Rgb::ZERO),
            bound: found.bound,
            rays: near.rays + found.rays,
            cut: found.clusters,
        }
    }

    fn near_ray(&self, near: &mut Near, ray: &NearRay, found: &mut Vec<Found>) {
        let found = std::cell::RefCell::new(found);
        let irradiance = |point, normal| self.density.at(point, normal, &mut found.borrow_mut());
        let (_, rays) = self.surfaces.walk(ray.origin, ray.direction, irradiance, |e| {
            let [weight] = ray.excess(e, [self.cap]);
            near.reflect(e, weight);
        });
        near.rays += rays;
    }
}

impl Gather for PhotonMap<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        run::each(receivers, progress, Scratch::default, |scratch, receiver| self.at(scratch, receiver))
    }
}

/// Area of all sides that can reflect light, squared frame units.
fn area(rays: &Rays) -> f64 {
    let geometry = rays.geometry;
    let side = |i: u32| {
        let triangle = &geometry.triangles[i as usize];
        let material = geometry.material(i);
        let there = geometry.scene.instances[triangle.instance as usize].casts && !material.unlit;
        let sides = if material.double_sided { 2.0 } else { 1.0 };
        if there { f64::from(triangle.area()) * sides } else { 0.0 }
    };
    (0..geometry.triangles.len() as u32).map(side).sum()
}

#[cfg(test)]
mod tests;

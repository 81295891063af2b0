//! Photons from the lights through all their reflections (Jensen 1996; 2001, §5).
//!
//! A photon of flux Φ that meets a surface of coverage c, albedo ρ and transmittance T splits, by expectation, into
//!
//! ```text
//! Φ = cρΦ  +  TΦ  +  (1 − cρ − T)Φ
//!     reflected  passed  absorbed
//! ```
//!
//! Russian roulette keeps one of the three, chosen by the shares of the band means, and divides by its probability: the
//! band mean of a photon never changes, and the books of the mean close for every single photon. Bands of their own
//! close in the mean only. Backs of single-sided surfaces reflect nothing. Every arrival is deposited before the
//! roulette, so a deposit is light that a surface receives, whatever becomes of it.

use glam::{DVec3, Vec3};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use crate::{
    Rgb,
    lights::Emitters,
    lighttree::{Light, Seeded},
    rays::{Hit, OFFSET, Rays},
    sampling::{basis, combine, cosine_hemisphere, mix, unit, unit2},
    shoot::{
        dome::Dome,
        emission::{Beam, Photon, beams},
    },
};

/// Primary samples per unit of parallel work.
const CHUNK: u32 = 64;

/// Photons from each primary sample: their directions are stratified.
const DIRECTIONS: u32 = 16;

/// Surfaces that one photon meets at most. In a closed room of albedo 0.999 one photon in 20 000 meets so many.
const MEETINGS: u64 = 10_000;

/// Where the flux of the photons went [lm].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ledger {
    pub emitted: DVec3,
    /// By surfaces, by their backs, by veils and by the distance windows of lamps.
    pub absorbed: DVec3,
    /// Left the scene.
    pub escaped: DVec3,
    /// Of photons that were no longer followed.
    pub lost: DVec3,
}

impl Ledger {
    /// Emitted less everything that is accounted for [lm]: rounding only in the band mean, in single bands the noise of
    /// the roulette too.
    pub fn imbalance(&self) -> DVec3 {
        self.emitted - self.absorbed - self.escaped - self.lost
    }

    fn parts(&mut self) -> [&mut DVec3; 4] {
        [&mut self.emitted, &mut self.absorbed, &mut self.escaped, &mut self.lost]
    }

    fn add(&mut self, mut other: Self) {
        for (sum, part) in self.parts().into_iter().zip(other.parts()) {
            *sum += *part;
        }
    }
}

/// Light that arrived somewhere.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deposit {
    /// What the surface sends back: I = cρΦ/π along its normal.
    pub light: Seeded,
    /// Φ, as if all of the surface were there [lux × squared frame units].
    pub flux: Rgb,
}

/// All deposits and their books.
#[derive(Default)]
pub(super) struct Traced {
    pub deposits: Vec<Deposit>,
    pub ledger: Ledger,
    /// Photons sent, and rays that followed them.
    pub photons: u64,
    pub rays: u64,
}

/// Traces about `photons` photons from all lights and the sky; `seed` makes independent maps.
pub(super) fn trace(
    rays: &Rays,
    emitters: &Emitters,
    photons: u32,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Traced, Cancelled> {
    let dome = Dome::new(&rays.geometry.scene.sky);
    let mut beams = beams(rays.geometry, emitters, dome.as_ref(), photons.div_ceil(DIRECTIONS));
    beams.iter_mut().for_each(|beam| beam.seed = combine(beam.seed, seed));
    let jobs: Vec<(&Beam, u32)> = beams
        .iter()
        .flat_map(|beam| (0..beam.primary).step_by(CHUNK as usize).map(move |first| (beam, first)))
        .collect();
    let mut all = Traced::default();
    // Groups of jobs run in parallel and are put together in order, whatever the number of threads.
    for group in jobs.chunks(64) {
        progress.check()?;
        let parts: Vec<Traced> = group
            .par_iter()
            .map(|&(beam, first)| {
                progress.check()?;
                let mut tracer = Tracer { rays, found: Traced::default() };
                for k in first..(first + CHUNK).min(beam.primary) {
                    for i in 0..DIRECTIONS {
                        let number = u64::from(k) * u64::from(DIRECTIONS) + u64::from(i);
                        tracer.follow(&beam.photon(k, i, DIRECTIONS), combine(beam.seed, mix(number)));
                    }
                }
                Ok(tracer.found)
            })
            .collect::<Result<_, Cancelled>>()?;
        for part in parts {
            all.deposits.extend(part.deposits);
            all.ledger.add(part.ledger);
            all.photons += part.photons;
            all.rays += part.rays;
        }
    }
    // From lux times squared frame units to lumen.
    let scale = 1.0 / (emitters.scale * emitters.scale);
    all.ledger.parts().into_iter().for_each(|part| *part *= scale);
    Ok(all)
}

struct Tracer<'t> {
    rays: &'t Rays<'t>,
    found: Traced,
}

/// What becomes of a photon where it meets a surface.
enum Fate {
    Reflected,
    Passed,
    Absorbed,
}

impl Tracer<'_> {
    fn follow(&mut self, photon: &Photon, seed: u64) {
        let Photon { mut origin, mut direction, mut flux, .. } = *photon;
        self.found.photons += 1;
        self.found.ledger.emitted += flux;
        // The distance window of a lamp holds until the first reflection; a straight line meets a triangle once.
        let (mut straight, mut last) = (true, u32::MAX);
        for number in 0..MEETINGS {
            if mean(flux) <= 0.0 {
                break;
            }
            self.found.rays += 1;
            let Some(hit) = self.rays.closest(origin, direction, f32::INFINITY) else {
                self.found.ledger.escaped += flux;
                return;
            };
            let triangle = &self.rays.geometry.triangles[hit.triangle as usize];
            let point = triangle.at(hit.u, hit.v);
            if hit.triangle == last {
                origin = point + direction * OFFSET;
                continue;
            }
            let window = if straight { photon.window(point) } else { 1.0 };
            let normal = if hit.back { -triangle.normal } else { triangle.normal };
            let state = combine(seed, number);
            let (fate, left) = self.meet(&hit, (point, normal), flux, window, state);
            flux = left;
            match fate {
                Fate::Absorbed => {
                    self.found.ledger.absorbed += flux;
                    return;
                }
                Fate::Passed => {
                    last = hit.triangle;
                    origin = point + direction * OFFSET;
                }
                Fate::Reflected => {
                    (straight, last) = (false, u32::MAX);
                    origin = point + normal * OFFSET;
                    direction = (basis(normal) * cosine_hemisphere(unit2(mix(state)))).normalize();
                }
            }
        }
        self.found.ledger.lost += flux;
    }

    /// Deposits what arrives, and says what of the photon is left and what becomes of it.
    fn meet(&mut self, hit: &Hit, place: (Vec3, Vec3), flux: DVec3, window: f32, state: u64) -> (Fate, DVec3) {
        let geometry = self.rays.geometry;
        let surface = geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
        let passed = flux * surface.transmittance.as_dvec3();
        let mut reflected = DVec3::ZERO;
        if !hit.back || geometry.material(hit.triangle).double_sided {
            let arriving = flux * f64::from(window);
            reflected = arriving * surface.albedo.as_dvec3() * f64::from(surface.coverage);
            let (position, normal) = place;
            let intensity = (reflected / std::f64::consts::PI).as_vec3();
            let light = Seeded { light: Light { position, normal, intensity, area: 0.0 }, seed: state };
            self.found.deposits.push(Deposit { light, flux: arriving.as_vec3() });
        }
        let absorbed = (flux - reflected - passed).max(DVec3::ZERO);
        let all = mean(reflected) + mean(passed) + mean(absorbed);
        let draw = f64::from(unit(state)) * all;
        let keep = |fate, part: DVec3| (fate, part * (all / mean(part)));
        if draw < mean(reflected) {
            keep(Fate::Reflected, reflected)
        } else if draw < mean(reflected) + mean(passed) {
            keep(Fate::Passed, passed)
        } else if mean(absorbed) > 0.0 {
            keep(Fate::Absorbed, absorbed)
        } else {
            // Rounding: nothing is absorbed here, and the draw fell on the border.
            (Fate::Absorbed, flux)
        }
    }
}

fn mean(flux: DVec3) -> f64 {
    flux.element_sum() / 3.0
}

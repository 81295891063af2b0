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
//!
//! **Memory.** A photon arrives 1/(1 − ρ) times in the mean, which has no end as ρ comes near 1, and every light sends some.
//! So no more deposits are kept than [`most`]: whenever there would be, every second one goes by lot, and the others count
//! twice. Each lot is fair whatever was drawn before, so that has no bias.

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

/// Deposits that are kept of every photon that was asked for, at most: above an albedo of 15/16, not all are.
const KEPT: u64 = 16;

/// Fewer photons than these keep as many deposits.
const FEW: u32 = 1024;

/// Most jobs that share out the deposits of all, twice over: a group of them takes some times the memory of what is kept.
const SHARES: usize = 32;

/// Deposits of a map of so many photons, at most.
pub(super) fn most(photons: u32) -> u64 {
    KEPT * u64::from(photons.max(FEW))
}

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

impl Deposit {
    /// Lots that it draws before the one that removes it.
    fn lots(&self) -> u32 {
        mix(self.light.seed ^ 0x6c6f_7473).trailing_ones()
    }
}

/// All deposits and their books.
#[derive(Default)]
pub(super) struct Traced {
    pub deposits: Vec<Deposit>,
    /// Times that deposits have drawn lots: those that are left count twice as much each time.
    draws: u32,
    pub ledger: Ledger,
    /// Photons sent, and rays that followed them.
    pub photons: u64,
    pub rays: u64,
}

impl Traced {
    /// Has all deposits have drawn lots so many times, at least.
    fn draw(&mut self, draws: u32) {
        if draws > self.draws {
            self.draws = draws;
            self.deposits.retain(|deposit| deposit.lots() >= draws);
        }
    }

    /// Has them draw until no more are left than `most`.
    fn thin(&mut self, most: u64) {
        while self.deposits.len() as u64 > most {
            self.draw(self.draws + 1);
        }
    }

    /// Has the deposits count for those that are gone.
    fn weigh(&mut self) {
        let factor = libm::exp2f(self.draws as f32);
        for deposit in &mut self.deposits {
            deposit.flux *= factor;
            deposit.light.light.intensity *= factor;
        }
    }
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
    let most = most(photons);
    let most_of_job = 2 * most / jobs.len().clamp(2, SHARES) as u64;
    // Groups of jobs run in parallel and are put together in order, whatever the number of threads.
    for group in jobs.chunks(64) {
        progress.check()?;
        let draws = all.draws;
        let parts: Vec<Traced> = group
            .par_iter()
            .map(|&(beam, first)| {
                progress.check()?;
                let mut tracer = Tracer { rays, found: Traced { draws, ..Traced::default() } };
                for k in first..(first + CHUNK).min(beam.primary) {
                    for i in 0..DIRECTIONS {
                        let number = u64::from(k) * u64::from(DIRECTIONS) + u64::from(i);
                        tracer.follow(&beam.photon(k, i, DIRECTIONS), combine(beam.seed, mix(number)));
                    }
                    tracer.found.thin(most_of_job);
                }
                Ok(tracer.found)
            })
            .collect::<Result<_, Cancelled>>()?;
        for mut part in parts {
            all.draw(part.draws);
            part.draw(all.draws);
            all.deposits.extend(part.deposits);
            all.thin(most);
            all.ledger.add(part.ledger);
            all.photons += part.photons;
            all.rays += part.rays;
        }
    }
    all.weigh();
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
            let deposit = Deposit { light, flux: arriving.as_vec3() };
            if deposit.lots() >= self.found.draws {
                self.found.deposits.push(deposit);
            }
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

//! Photons from the lights by ray tracing, first hits only (Piwowar & Malgouyres 2009, §3).
//!
//! Photons start as [`super::emission`] says, some from each of the primary samples on the lights. One that arrives on a
//! surfel of area A adds Φᵢ/A to its irradiance. Sums are in f64 and in a fixed order.

use std::ops::Range;

use glam::{DVec3, IVec3, Vec3};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{
    Flux, Shot,
    emission::{self, Beam, Photon, beams},
};
use crate::{
    Rgb,
    lights::Emitters,
    rays::{Hit, OFFSET, Rays, leave},
    sampling::{basis, combine, cosine_hemisphere, mix, r2, unit, unit2},
    surfel::Surfels,
};

/// Primary samples per unit of parallel work.
const CHUNK: u32 = 256;

/// Veils that one photon passes at most; what is left then counts as absorbed.
const LAYERS: u32 = 64;

#[derive(Clone, Copy, Debug)]
pub struct PhotonSettings {
    /// Points on all lights together; every light has at least one.
    pub primary: u32,
    /// Photons from each point.
    pub directions: u32,
}

impl Default for PhotonSettings {
    fn default() -> Self {
        Self { primary: 4000, directions: 256 }
    }
}

/// Direct irradiance of every surfel by photons.
pub fn photons(
    rays: &Rays,
    emitters: &Emitters,
    surfels: &Surfels,
    settings: PhotonSettings,
    progress: &dyn Progress,
) -> Result<Shot, Cancelled> {
    let beams = beams(rays.geometry, emitters, None, settings.primary);
    let mut jobs = Vec::new();
    for (i, beam) in beams.iter().enumerate() {
        jobs.extend((0..beam.primary).step_by(CHUNK as usize).map(|first| (i, first)));
    }
    let mut sums = vec![DVec3::ZERO; surfels.list.len()];
    let mut shot = Shot::default();
    // Groups of jobs run in parallel; their deposits are added in order, so the sums do not depend on threads.
    for group in jobs.chunks(64) {
        progress.check()?;
        let traced: Vec<_> = group
            .par_iter()
            .map(|&(i, first)| {
                let beam = &beams[i];
                let mut tracer = Tracer { rays, surfels, deposits: Vec::new(), flux: Flux::default(), traced: 0 };
                for k in first..(first + CHUNK).min(beam.primary) {
                    for i in 0..settings.directions {
                        tracer.trace(&beam.photon(k, i, settings.directions));
                    }
                }
                (tracer.deposits, tracer.flux, tracer.traced)
            })
            .collect();
        for (deposits, flux, traced) in traced {
            shot.arrived_photons += deposits.len() as u64;
            shot.rays += traced;
            shot.ledger.add(&flux);
            deposits.iter().for_each(|&(surfel, flux)| sums[surfel as usize] += flux);
        }
        progress.advance(group.len() as u64);
    }
    shot.primary_photons = beams.iter().map(|b| u64::from(b.primary)).sum();
    let per_area = |(sum, surfel): (&DVec3, &crate::surfel::Surfel)| match surfel.area {
        area if area > 0.0 => (*sum / f64::from(area)).as_vec3(),
        _ => Rgb::ZERO,
    };
    shot.irradiance = sums.iter().zip(&surfels.list).map(per_area).collect();
    // From lux times squared frame units to lumen.
    shot.ledger = shot.ledger.scaled(1.0 / (emitters.scale * emitters.scale));
    Ok(shot)
}

/// Where the light of beams goes, by `count` photons of all of them in proportion to their flux, some from each point:
/// what becomes of it [lux × squared frame units], and of that what is booked at surfels although it goes on (veils).
/// The seed and the order of the beams are all that the photons depend on, not what lights are called.
pub(crate) fn shone(
    rays: &Rays,
    surfels: &Surfels,
    beams: &[Beam],
    (count, directions, seed): (u32, u32, u64),
    progress: &dyn Progress,
) -> Result<(Flux, DVec3), Cancelled> {
    let total: f64 = beams.iter().map(|b| b.power).sum();
    let mut jobs = Vec::new();
    for (number, photons) in emission::dealt(beams, count, unit(mix(seed))) {
        let step = CHUNK * directions;
        jobs.extend((0..photons).step_by(step as usize).map(|first| (number, first..(first + step).min(photons))));
    }
    let some = |jobs: &[(usize, Range<u32>)]| {
        progress.check()?;
        let mut tracer = Tracer { rays, surfels, deposits: Vec::new(), flux: Flux::default(), traced: 0 };
        for (number, photons) in jobs {
            let mut beam = beams[*number];
            beam.seed = combine(seed, *number as u64);
            // Its share of all photons, which it has in the mean.
            let share = beam.power / total * f64::from(count);
            for photon in photons.clone() {
                tracer.trace(&beam.one_of(share, (photon / directions, photon % directions, directions)));
            }
        }
        Ok((tracer.flux, tracer.deposits.iter().map(|(_, flux)| *flux).sum::<DVec3>()))
    };
    let parts = jobs.par_chunks(64).map(some).collect::<Result<Vec<_>, _>>()?;
    let (mut sum, mut received) = (Flux::default(), DVec3::ZERO);
    for (flux, deposited) in parts {
        sum.add(&flux);
        received += deposited;
    }
    Ok((sum, received - sum.deposited))
}

/// Where the light that surfels send goes, by `count` photons from them in proportion to their flux: what becomes of it
/// [lux × squared frame units], and of that what is booked at surfels although it goes on (veils).
pub(crate) fn sent(
    rays: &Rays,
    surfels: &Surfels,
    radiosity: &dyn Fn(usize) -> Rgb,
    (count, seed): (u32, u64),
    progress: &dyn Progress,
) -> Result<(Flux, DVec3), Cancelled> {
    let flux = |i: usize| f64::from(surfels.list[i].area) * radiosity(i).as_dvec3();
    let mut all = 0.0f64;
    let ends: Vec<f64> = (0..surfels.list.len())
        .map(|i| {
            all += flux(i).element_sum();
            all
        })
        .collect();
    let (mut sum, mut received) = (Flux::default(), DVec3::ZERO);
    if all <= 0.0 {
        return Ok((sum, received));
    }
    let shift = unit2(mix(seed));
    for first in (0..count).step_by(CHUNK as usize) {
        progress.check()?;
        let mut tracer = Tracer { rays, surfels, deposits: Vec::new(), flux: Flux::default(), traced: 0 };
        for k in first..(first + CHUNK).min(count) {
            let place = (f64::from(k) + f64::from(unit(combine(seed, u64::from(k))))) / f64::from(count) * all;
            let i = ends.partition_point(|end| *end <= place).min(ends.len() - 1);
            let (point, normal) = surfels.list[i].place(rays.geometry);
            let direction = (basis(normal) * cosine_hemisphere(r2(k, shift))).normalize_or(normal);
            let own = flux(i);
            let flux = own / own.element_sum().max(f64::MIN_POSITIVE) * (all / f64::from(count));
            tracer.trace(&Photon::reflected(leave(point, normal, direction), direction, flux));
        }
        sum.add(&tracer.flux);
        received += tracer.deposits.iter().map(|(_, flux)| *flux).sum::<DVec3>();
    }
    Ok((sum, received - sum.deposited))
}

/// Follows photons and notes where they arrive.
struct Tracer<'t> {
    rays: &'t Rays<'t>,
    surfels: &'t Surfels,
    deposits: Vec<(u32, DVec3)>,
    /// In lux times squared frame units.
    flux: Flux,
    traced: u64,
}

impl Tracer<'_> {
    fn trace(&mut self, photon: &Photon) {
        let Photon { mut origin, direction, flux, .. } = *photon;
        self.flux.emitted += flux;
        let mut left = flux;
        for _ in 0..LAYERS {
            self.traced += 1;
            let Some(hit) = self.rays.closest(origin, direction, f32::INFINITY) else {
                self.flux.escaped += left;
                return;
            };
            let surface = self.rays.geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
            let point = origin + direction * hit.distance;
            let passed = left * surface.transmittance.as_dvec3();
            self.arrive(&hit, point, left, passed, surface.coverage, photon.window(point));
            left = passed;
            if left.max_element() <= 1e-4 * flux.max_element() {
                self.flux.absorbed += left;
                return;
            }
            origin = point + direction * OFFSET;
        }
        self.flux.absorbed += left;
    }

    /// Deposits what a surface receives by its coverage; what neither arrives nor passes is absorbed.
    fn arrive(&mut self, hit: &Hit, point: Vec3, left: DVec3, passed: DVec3, coverage: f32, window: f32) {
        let geometry = self.rays.geometry;
        let stays = left - passed;
        let normal = geometry.triangles[hit.triangle as usize].normal;
        if hit.back && !geometry.material(hit.triangle).double_sided {
            self.flux.absorbed += stays;
            return;
        }
        match find(self.surfels, point, if hit.back { -normal } else { normal }) {
            None => self.flux.lost += stays,
            Some(surfel) => {
                // Glass receives light that it also lets through; only what stays is booked.
                self.deposits.push((surfel, left * f64::from(coverage * window)));
                let booked = stays.min(left * f64::from(coverage)) * f64::from(window);
                self.flux.deposited += booked;
                self.flux.absorbed += stays - booked;
            }
        }
    }
}

/// The surfel that holds a surface point with this normal: the best oriented one of its voxel, or, where rounding has
/// put the point next door, of a voxel within a hundredth of a voxel's edge.
fn find(surfels: &Surfels, point: Vec3, normal: Vec3) -> Option<u32> {
    let place = (point - surfels.grid.origin) / surfels.grid.edge;
    let voxel = |shift: Vec3| (place + shift * 0.01).floor().as_ivec3();
    find_in(surfels, voxel(Vec3::ZERO), point, normal).or_else(|| {
        let corners = (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 1.0);
        corners.filter_map(|c| find_in(surfels, voxel(c), point, normal)).next()
    })
}

/// The surfel of a voxel that faces most nearly along `normal`, and not away from it.
fn find_in(surfels: &Surfels, voxel: IVec3, point: Vec3, normal: Vec3) -> Option<u32> {
    let key = |v: IVec3| (v.x, v.y, v.z);
    let list = &surfels.list;
    let start = list.partition_point(|s| key(s.voxel()) < key(voxel));
    let mates = start..start + list[start..].iter().take_while(|s| s.voxel() == voxel).count();
    let mut best: Option<(usize, f32)> = None;
    for i in mates.clone() {
        let cosine = list[i].normal.dot(normal);
        if cosine > best.map_or(0.0, |b| b.1) {
            best = Some((i, cosine));
        }
    }
    // Walls may part a surface of one direction into several surfels.
    best.map(|b| Surfels::owner(list, surfels.grid.edge, mates, b.0, point) as u32)
}

//! Lamps that almost touch a surface.
//!
//! A lamp 1 µm in front of a wall sends half of its light into a spot of some µm, which no point of a surfel sees: the
//! whole spot, and all that it reflects, would be missing. What a surfel receives is the flux through the cone that it
//! fills, Φ = ∫ I dΩ, and E = Φ/A. Where a lamp is nearer to a surfel than [`NEAR`] voxels, that integral is taken by
//! rays from the lamp, evenly over its sphere or cone and through veils, in place of the mean over points of the surfel.

use std::collections::BTreeMap;

use glam::{DVec3, Vec2};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{emission, exact::receivers};
use crate::{
    Rgb,
    direct::{Direct, DirectSettings, Visibility},
    gather::{Gather, Receiver},
    lights::{Emitters, Lamp},
    rays::Rays,
    sampling::{r2, unit2},
    surfel::{Grid, Surfels},
};

/// Nearer than this many voxel edges, points of a surfel are no measure of its light.
const NEAR: f32 = 1.0;

/// Radius of lamps that are points to a surfel, in voxel edges.
const SMALL: f32 = 0.25;

/// Rays from a lamp: a surfel at that distance gets some hundreds.
const RAYS: u32 = 1 << 14;

/// Rays between two looks at the progress, and per unit of parallel work.
const BREATH: u32 = 1 << 10;

/// [`Rays::walk`] of these ends where less than this share of the light is left.
const FAINT: f32 = 1e-4;

/// Replaces the light of lamps at the surfels that they almost touch; `irradiance` has that of `points` points (1 or 5)
/// of each surfel. Returns the rays spent.
///
/// # Errors
/// When the work is cancelled.
pub fn close(
    rays: &Rays,
    emitters: &Emitters,
    surfels: &Surfels,
    points: u32,
    irradiance: &mut [Rgb],
    progress: &dyn Progress,
) -> Result<u64, Cancelled> {
    let mut spent = 0;
    // A luminous sphere of some size has no spot of light but a pool.
    for lamp in emitters.lamps.iter().filter(|lamp| lamp.radius < SMALL * surfels.grid.edge) {
        progress.check()?;
        let near = near(surfels, lamp);
        if near.is_empty() {
            continue;
        }
        let found = by_rays(rays, surfels, lamp, near, progress)?;
        spent += u64::from(RAYS);
        let alone = Emitters { areas: Vec::new(), lamps: vec![lamp.clone()], suns: Vec::new(), scale: emitters.scale };
        let how = DirectSettings { visibility: Visibility::Rays, ..DirectSettings::default() };
        let direct = Direct::build(rays, &alone, how, progress)?;
        for (surfel, flux) in found {
            let places: Vec<Receiver> =
                receivers(rays.geometry, surfels, surfel, points).into_iter().flatten().collect();
            let at_points: Rgb = direct.gather(&places, progress)?.iter().map(|g| g.irradiance).sum();
            let flux = flux / f64::from(surfels.list[surfel].area);
            let rest = irradiance[surfel] - at_points / places.len() as f32;
            irradiance[surfel] = rest.max(Rgb::ZERO) + flux.as_vec3();
        }
    }
    Ok(spent)
}

/// The surfels that a lamp is near to, each without light. Those without area receive no flux, whatever it is.
fn near(surfels: &Surfels, lamp: &Lamp) -> BTreeMap<usize, DVec3> {
    let Grid { edge, .. } = surfels.grid;
    let at = surfels.grid.voxel(lamp.position);
    let reach = NEAR.ceil() as i32 + 1;
    let mut near = BTreeMap::new();
    for x in -reach..=reach {
        for y in -reach..=reach {
            for z in -reach..=reach {
                for i in surfels.in_voxel(at + glam::IVec3::new(x, y, z)).filter(|i| surfels.list[*i].area > 0.0) {
                    let way = surfels.list[i].centroid - lamp.position;
                    let height = surfels.list[i].normal.dot(way).abs();
                    // Along its plane a surfel reaches further than its centroid.
                    if height < NEAR * edge && way.length() < (NEAR + 1.0) * edge {
                        near.insert(i, DVec3::ZERO);
                    }
                }
            }
        }
    }
    near
}

/// The flux of a lamp that arrives at each of these surfels [lux × squared frame units].
fn by_rays(
    rays: &Rays,
    surfels: &Surfels,
    lamp: &Lamp,
    mut near: BTreeMap<usize, DVec3>,
    progress: &dyn Progress,
) -> Result<BTreeMap<usize, DVec3>, Cancelled> {
    let shift: Vec2 = unit2(lamp.identity);
    let some = |first: u32| -> Result<Vec<(usize, DVec3)>, Cancelled> {
        progress.check()?;
        let mut found = Vec::new();
        for k in first..first + BREATH {
            arrivals(rays, surfels, lamp, r2(k, shift), |i, flux| {
                if near.contains_key(&i) {
                    found.push((i, flux));
                }
            });
        }
        Ok(found)
    };
    let firsts: Vec<u32> = (0..RAYS).step_by(BREATH as usize).collect();
    let found = firsts.into_par_iter().map(some).collect::<Result<Vec<_>, _>>()?;
    // In the order of the rays, whoever traced them.
    for (i, flux) in found.into_iter().flatten() {
        near.entry(i).and_modify(|sum| *sum += flux);
    }
    Ok(near)
}

/// The surfels along one of a lamp's rays, each with the flux that it receives.
fn arrivals(rays: &Rays, surfels: &Surfels, lamp: &Lamp, p: Vec2, mut receive: impl FnMut(usize, DVec3)) {
    let (direction, share) = emission::towards(lamp, p);
    let flux = lamp.intensity.as_dvec3() * (share / f64::from(RAYS));
    rays.walk(lamp.position, direction, f32::INFINITY, FAINT, |hit, passed| {
        if hit.back && !rays.geometry.material(hit.triangle).double_sided {
            return;
        }
        let triangle = &rays.geometry.triangles[hit.triangle as usize];
        let normal = if hit.back { -triangle.normal } else { triangle.normal };
        if let Some(i) = surfels.find(triangle.at(hit.u, hit.v), normal) {
            let coverage = rays.geometry.surface(hit.triangle, hit.u, hit.v, 0.0).coverage;
            receive(i, flux * passed.as_dvec3() * f64::from(coverage * lamp.window(hit.distance)));
        }
    });
}
